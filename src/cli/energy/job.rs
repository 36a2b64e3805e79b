//! From a finished run to its report.

use crate::base::units::Picoseconds;
use crate::cost::baseline::{Baseline, NetworkShape};
use crate::cost::estimate::{Case, Convention, estimate, spent};
use crate::cost::{Deployment, StepMeter};
use crate::desc::baseline::Mode;
use crate::desc::target::Target;
use crate::drive::Outcome;
use crate::drive::decision::Rule;
use crate::ir::activity::Activity;
use crate::report::energy::{EnergyReport, Saved, constant_entries};

/// A finished run and what is asked about it.
#[derive(Debug, Clone, Copy)]
pub struct EnergyJob<'a> {
    /// The model's name.
    pub model: &'a str,
    /// Where it ran.
    pub target: &'a Target,
    /// Sizes of one copy, to find out which baselines hold.
    pub shape: &'a NetworkShape,
    /// The preset of the figures, an index into the target's (from [`tables`]).
    pub preset: usize,
    /// Counts of the run.
    pub activity: &'a Activity,
    /// Its steps, under all of the target's presets and with the deployment's tiles in the barrier.
    pub meter: &'a StepMeter,
    /// Copies whose activity was counted: 1 when one stands for all.
    pub copies_counted: u32,
    /// Where all copies are.
    pub deployment: &'a Deployment,
    /// Offline or real time.
    pub mode: Mode,
    /// What energy means.
    pub convention: Convention,
    /// Length of the model's timestep.
    pub timestep: Picoseconds,
    /// Timesteps of a sample; `None` when samples differ.
    pub steps_per_sample: Option<u32>,
    /// Samples that were run, repeats included.
    pub samples: u64,
    /// Seed of the input, if it was made from one.
    pub seed: Option<u64>,
    /// Hardware to show beside.
    pub baselines: &'a [Baseline],
    /// What ending samples when they are decided would save.
    pub early_exit: Option<Saved>,
}

impl<'a> EnergyJob<'a> {
    pub(super) fn case(&self) -> Case<'a> {
        Case {
            activity: self.activity,
            meter: self.meter,
            preset: self.preset,
            copies_counted: self.copies_counted,
            deployment: self.deployment,
            mode: self.mode,
            timestep: self.timestep,
            convention: self.convention,
            steps_per_sample: self.steps_per_sample,
        }
    }
}

/// What a run spends less than the whole one: equation (16).
pub(super) fn saved(rule: Rule, whole: &EnergyJob<'_>, outcomes: &[Outcome], early: &EnergyJob<'_>) -> Saved {
    let (whole, early) = (spent(&whole.case()), spent(&early.case()));
    let energy_saved_uj = whole.energy_uj - early.energy_uj;
    Saved {
        rule,
        decided: outcomes.iter().filter(|outcome| outcome.decided_at.is_some()).count() as u64,
        steps_saved: outcomes.iter().map(|outcome| u64::from(outcome.steps_saved)).sum(),
        time_saved_us: whole.time_us - early.time_us,
        energy_saved_uj,
        energy_saved_share: (whole.energy_uj > 0.0).then(|| energy_saved_uj / whole.energy_uj),
    }
}

/// From a finished run to its report. Its notes belong on stderr when the output is for programs.
#[must_use]
pub fn report(job: &EnergyJob<'_>) -> EnergyReport {
    let estimate = estimate(&job.case());
    let mut notes = estimate.notes.clone();
    let mut rows = Vec::new();
    for baseline in job.baselines {
        match baseline.row(job.shape, job.steps_per_sample, job.timestep, job.mode, job.convention) {
            Ok(row) => rows.push((row, baseline.source())),
            Err(reason) => notes.push(reason),
        }
    }
    let tables = job.meter.tables();
    if tables[job.preset].injection.0 == 0 && job.mode == Mode::Offline {
        notes.push(
            "these constants give no time for injecting a spike, which bounds offline runs on the board: the latency is that \
             of the neuron cores alone"
                .to_string(),
        );
    }
    if job.mode == Mode::Realtime {
        notes.push(
            "a step is held to the model's timestep; what the host adds to it is not modelled (39.9 us in the VT-SNN paper's \
             table, which no offline figure contains)"
                .to_string(),
        );
    }
    if job.deployment.name == "paper" {
        notes.push("numbers of cores are the VT-SNN paper's; activity is this mapping's".to_string());
    }
    EnergyReport {
        model: job.model.to_string(),
        target: job.target.name().to_string(),
        deployment: job.deployment.clone(),
        mode: job.mode,
        preset: tables[job.preset].name().to_string(),
        presets: tables.iter().map(|table| table.name().to_string()).collect(),
        seed: job.seed,
        samples: job.samples,
        timesteps: job.activity.steps(),
        estimate,
        baselines: rows,
        early_exit: job.early_exit,
        constants: constant_entries(&job.target.constants()[job.preset]),
        notes,
    }
}
