//! `--steps`: a file with a row for each timestep of a run.

use std::path::Path;

use crate::cli::context::refuse_if;
use crate::cli::process::ranks;
use nsim_cost::{MeterSettings, StepMeter};
use nsim_files::steps::{StepFormat, StepWriter};
use nsim_files::text::is_standard_stream;
use nsim_files::write::{Batch, check_free};
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::Sample;
use nsim_session::error::Error;
use nsim_session::priced::MeteredMapping;
use nsim_session::samples::{Run, RunSettings};
use nsim_session::steps::{StepLayout, run_recorded};

/// Checks the file before the run.
///
/// # Errors
/// [`Error::Usage`] for a name that ends in neither .csv nor .npy, and for stdout, which carries
/// the result; `write.*`.
pub fn check(path: &Path, force: bool) -> Result<(), Error> {
    form(path)?;
    Ok(check_free(path, force)?)
}

fn form(path: &Path) -> Result<StepFormat, Error> {
    let known = StepFormat::from_name(path).filter(|_| !is_standard_stream(path));
    known.ok_or_else(|| Error::Usage(format!("--steps {}: name a file .csv or .npy", path.display())))
}

/// Runs samples and writes a row for each of their timesteps, under a temporary name.
///
/// # Errors
/// [`Error::Usage`] for a .npy file of samples that end early; as [`run_recorded`]; when the file
/// cannot be written.
pub fn run_with_step_rows(
    (path, batch): (&Path, &mut Batch),
    network: &Quantised,
    metered: &MeteredMapping<'_>,
    settings: MeterSettings,
    samples: &[&Sample],
    run_settings: RunSettings<'_>,
) -> Result<Run<StepMeter>, Error> {
    let format = form(path)?;
    let ends_early = run_settings.sample_settings.early_exit.as_ref().is_some_and(|exit| exit.ends);
    let message = "with --early-exit the number of rows is not known in advance, which .npy requires: name the file \
                   .csv";
    refuse_if(ends_early && format == StepFormat::Npy, format!("--steps {}: {message}", path.display()))?;
    let rows = samples.iter().map(|sample| u64::from(sample.steps())).sum();
    let layout = StepLayout::new(network);
    if ranks::several().is_some_and(|ranks| ranks.rank() > 0) {
        // Rank 0 writes the rows of all steps; the others run their part of each group of samples.
        let mut nowhere = std::io::sink();
        let table = StepWriter::new(&mut nowhere, StepFormat::Csv, layout.columns(), None)
            .map_err(|error| Error::Fault(error.to_string()))?;
        return Ok(run_recorded(metered, settings, samples, run_settings, &layout, table)?.0);
    }
    let run = batch.add(path, |out| {
        let table = StepWriter::new(out, format, layout.columns(), (!ends_early).then_some(rows))?;
        match run_recorded(metered, settings, samples, run_settings, &layout, table) {
            Ok((run, written)) => written.map(|()| Ok(run)),
            Err(problem) => Ok(Err(problem)),
        }
    })?;
    Ok(run?)
}
