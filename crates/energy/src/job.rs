//! From a finished run to its report.

use crate::report::compared::{Comparison, PerDecision, per_sample, ratios};
use crate::report::table::{EnergyReport, Saved, constant_entries};
use nsim_cost::estimate::{Case, EnergyRow, estimate, spent};
use nsim_ir::hardware::Target;
use nsim_session::Outcome;
use nsim_session::decision::Rule;
use nsim_session::detail::Detail;

/// The level of intervals by the errors of works.
const LEVEL: f64 = 0.8;

/// What ending samples when they are decided would save of the whole run: equation (16).
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
pub fn per_decision(rule: Rule, case: &Case<'_>, outcomes: &[Outcome]) -> PerDecision {
    let until_decided = &case.meter.lanes()[case.preset].until_decided;
    let (spent, samples) = (spent(case, until_decided), outcomes.len().max(1) as f64);
    let decided = outcomes.iter().filter(|outcome| outcome.decided_at.is_some()).count() as f64;
    PerDecision {
        hardware: case.hardware.to_string(),
        rule: rule.to_string(),
        time_us: spent.time_us / samples,
        energy_uj: spent.energy_uj / samples,
        early: decided / samples,
    }
}

/// From a finished run to its report: its counts and the conditions of the estimate, of which the
/// first of the target's presets is one, and rows of other hardware with their sources. Its notes
/// belong on stderr when the output is for programs.
pub fn report(
    model: &str,
    target: &Target,
    case: &Case<'_>,
    samples: u64,
    baselines: Vec<(EnergyRow, String)>,
) -> EnergyReport {
    let estimate = estimate(case);
    let total = estimate.rows.iter().find(|row| row.unit == "total");
    let ratios = total.map_or_else(Vec::new, |total| ratios(total, &baselines));
    let steps = case.activity.steps() as f64 / samples.max(1) as f64;
    let rows = estimate.rows.iter().chain(baselines.iter().map(|(row, _)| row));
    let preset = &target.constants()[case.preset];
    let inherited = (preset.hardware != case.hardware && !preset.hardware.is_empty()).then(|| {
        let (theirs, own) = (&preset.hardware, case.hardware);
        format!("Constants that are not stated for {own}, static power too, are {theirs}'s (--constants FILE).")
    });
    EnergyReport {
        model: model.to_string(),
        target: target.name().to_string(),
        deployment: case.deployment.clone(),
        mode: case.mode,
        preset: case.meter.tables()[case.preset].name().to_string(),
        seed: None,
        input: Vec::new(),
        samples,
        timesteps: case.activity.steps(),
        level: case.errors.iter().all(|error| error.works > 0).then_some(LEVEL),
        accounting: case.accounting,
        accuracy: None,
        labelled: 0,
        job: None,
        printed: None,
        transport: case.meter.transport(),
        comparison: Comparison { ratios, per_sample: per_sample(rows, steps), per_decision: None },
        baselines,
        early_exit: None,
        detail: Detail::default(),
        expected: None,
        constants: constant_entries(preset),
        notes: estimate.notes.clone(),
        inherited,
        estimate,
    }
}
