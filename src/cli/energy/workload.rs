//! Runs the selected samples on the mapped program, with an optional file of its timesteps.

use std::path::Path;

use crate::cli::args::input::{InputArgs, check_pruned, select_numbers};
use crate::cli::args::steps::run_with_step_rows;
use crate::cli::context::Context;
use crate::cli::process::progress;
use crate::cli::process::ranks;
use nsim_compile::Mapping;
use nsim_cost::{MeterSettings, StepMeter};
use nsim_energy::workload::Workload;
use nsim_files as io;
use nsim_ir::learning::draws::Draws;
use nsim_ir::spikes::Sample;
use nsim_session::decision::EarlyExit;
use nsim_session::error::Error;
use nsim_session::obtain::Job;
use nsim_session::outcome::LearningSettings;
use nsim_session::samples::{Run, RunSettings};

/// A mapped job, or another mapping of its network, with its input.
pub fn workload<'j>(job: &'j Job, other: Option<&'j Mapping>, input: &InputArgs) -> Result<Workload<'j>, Error> {
    let Some((compiled, target)) = job.mapped() else {
        return Err(Error::Fault("energy needs a mapped job".to_string()));
    };
    let compiled = other.unwrap_or(compiled);
    let stimulus = input.stimulus(&compiled.one, job.scene())?;
    let order = select_numbers(stimulus.samples.len(), input)?;
    let samples: Vec<&Sample> = order.iter().map(|&sample| &stimulus.samples[sample]).collect();
    check_pruned(&compiled.one, &samples, input)?;
    let (samples, first) = (order.len(), input.samples.as_ref().map_or(0, |range| range.start));
    let draws = Draws::seeded(input.seed.unwrap_or(0));
    let mut workload = Workload::new(compiled, target, stimulus, order)?;
    workload.learning = LearningSettings { draws, ..LearningSettings::of_samples(samples, input.repeat, first) };
    Ok(workload)
}

/// Runs all samples under a progress bar. With `steps` each timestep is a row of that file.
pub fn simulate(
    workload: &Workload<'_>,
    settings: MeterSettings,
    early_exit: Option<EarlyExit>,
    skip: bool,
    steps: Option<&Path>,
    context: Context,
) -> Result<Run<StepMeter>, Error> {
    let (samples, ranks) = (workload.samples(), ranks::several());
    let Some(steps) = steps else {
        return progress::with_bar(context, samples.len(), "samples", |progress| {
            workload.simulate(settings, early_exit, skip, progress, ranks)
        });
    };
    let keep = workload.sample_settings(early_exit);
    let mut batch = io::write::Batch::new(context.force);
    let run = progress::with_bar(context, samples.len(), "samples", |progress| {
        let run_settings = RunSettings { skip, progress, ranks, ..RunSettings::new(&keep) };
        let network = &workload.compiled.one;
        run_with_step_rows((steps, &mut batch), network, workload.meter(), settings, &samples, run_settings)
    })?;
    ranks::leave_to_first();
    batch.commit()?;
    Ok(run)
}
