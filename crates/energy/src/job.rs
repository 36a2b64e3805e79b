//! From a finished run to its report.

use crate::published::scenario::ScenarioFile;
use crate::report::compared::{Comparison, PerDecision, per_sample, ratios};
use crate::report::table::{EnergyReport, Saved, constant_entries};
use nsim_cost::estimate::{Case, EnergyRow, Estimate, spent};
use nsim_ir::hardware::Target;
use nsim_session::Outcome;
use nsim_session::decision::Rule;
use nsim_session::detail::Detail;

/// A finished run and what is asked about it.
#[derive(Debug, Clone)]
pub struct EnergyJob<'a> {
    /// The model's name.
    pub model: &'a str,
    /// Where it ran.
    pub target: &'a Target,
    /// Its counts and the conditions of the estimate; the first of the target's presets is its.
    pub case: Case<'a>,
    /// Power, latency and energy by it.
    pub estimate: Estimate,
    /// Samples that were run, repeats included.
    pub samples: u64,
    /// Seed of the input, if it was made from one.
    pub seed: Option<u64>,
    /// What it was shown.
    pub input: &'a [String],
    /// Rows of other hardware with their sources.
    pub baselines: &'a [(EnergyRow, String)],
    /// The cost of a decision.
    pub per_decision: Option<&'a PerDecision>,
    /// The published job of the model, if there is one.
    pub scenario: Option<&'a ScenarioFile>,
    /// What ending samples when they are decided would save.
    pub early_exit: Option<Saved>,
}

/// What ending samples when they are decided would save of the whole run: equation (16).
#[must_use]
pub fn saved(rule: Rule, case: &Case<'_>, outcomes: &[Outcome]) -> Saved {
    let lane = &case.meter.lanes()[case.preset];
    let (whole, early) = (spent(case, &lane.whole), spent(case, &lane.until_decided));
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

/// The mean cost of a sample until it is decided.
#[must_use]
pub fn per_decision(rule: Rule, case: &Case<'_>, outcomes: &[Outcome]) -> PerDecision {
    let until_decided = &case.meter.lanes()[case.preset].until_decided;
    let (spent, samples) = (spent(case, until_decided), outcomes.len().max(1) as f64);
    let decided = outcomes.iter().filter(|outcome| outcome.decided_at.is_some()).count() as f64;
    PerDecision {
        rule: rule.to_string(),
        time_us: spent.time_us / samples,
        energy_uj: spent.energy_uj / samples,
        early: decided / samples,
    }
}

/// From a finished run to its report. Its notes belong on stderr when the output is for programs.
#[must_use]
pub fn report(job: &EnergyJob<'_>) -> EnergyReport {
    let estimate = job.estimate.clone();
    let notes = estimate.notes.clone();
    let tables = job.case.meter.tables();
    let baselines = job.baselines.to_vec();
    let total = estimate.rows.iter().find(|row| row.unit == "total");
    let ratios = total.map_or_else(Vec::new, |total| ratios(total, &baselines));
    let steps = job.case.activity.steps() as f64 / job.samples.max(1) as f64;
    let rows = estimate.rows.iter().chain(baselines.iter().map(|(row, _)| row));
    let comparison =
        Comparison { ratios, per_sample: per_sample(rows, steps), per_decision: job.per_decision.cloned() };
    EnergyReport {
        model: job.model.to_string(),
        target: job.target.name().to_string(),
        deployment: job.case.deployment.clone(),
        mode: job.case.mode,
        preset: tables[job.case.preset].name().to_string(),
        seed: job.seed,
        input: job.input.to_vec(),
        samples: job.samples,
        timesteps: job.case.activity.steps(),
        estimate,
        accounting: job.case.accounting,
        accuracy: None,
        labelled: 0,
        job: job.scenario.cloned(),
        printed: None,
        transport: job.case.meter.transport(),
        comparison,
        baselines,
        early_exit: job.early_exit,
        detail: Detail::default(),
        expected: None,
        constants: constant_entries(&job.target.constants()[job.case.preset]),
        notes,
    }
}
