//! Makes the report of a finished run.

use crate::report::compared::{Comparison, PerDecision, per_sample, ratios};
use crate::report::result::{EarlyExitSavings, EnergyReport, constant_entries};
use std::collections::BTreeSet;

use nsim_cost::charged::is_charged;
use nsim_cost::constants::CostTable;
use nsim_cost::estimate::{Bound, EnergyRow, EstimateInput, RowUnit, estimate, spent};
use nsim_cost::model::{CORE_TIMES, StepTime, energy};
use nsim_files::shipped::{CONSTANTS, Shipped};
use nsim_files::table::three;
use nsim_ir::hardware::Target;
use nsim_ir::hardware::constants::{BARRIER, Constants, SET_OPTION, Status, Unit};
use nsim_session::decision::Rule;
use nsim_session::detail::Detail;
use nsim_session::{Outcome, median_decision};

/// Level of intervals that follow from errors over published works.
const LEVEL: f64 = 0.8;

/// Savings of the whole run if samples ended at their decisions, at this cost: equation (16).
pub fn early_exit_savings(
    rule: Rule,
    case: &EstimateInput<'_>,
    outcomes: &[Outcome],
    decision: &PerDecision,
) -> EarlyExitSavings {
    let lane = &case.meter.lanes()[case.preset];
    let (whole, early) = (spent(case, &lane.whole), spent(case, &lane.until_decided));
    // The steps until the decision are a part of all steps, but rounding may say otherwise.
    let energy_saved_uj = (whole.energy_uj - early.energy_uj).max(0.0);
    let time_saved_us = (whole.time_us - early.time_us).max(0.0);
    let standing_uj = case.price(&case.meter.tables()[case.preset]).always_mw * time_saved_us / 1e3;
    let share = |uj: f64| (whole.energy_uj > 0.0).then(|| uj / whole.energy_uj);
    EarlyExitSavings {
        rule,
        decided: outcomes.iter().filter(|outcome| outcome.decided_at.is_some()).count() as u64,
        steps_saved: outcomes.iter().map(|outcome| u64::from(outcome.steps_saved)).sum(),
        time_saved_us,
        energy_saved_uj,
        energy_saved_share: share(energy_saved_uj),
        idle_saved_share: share((energy_saved_uj - standing_uj).max(0.0)),
        accuracy: decision.accuracy,
        median_step: decision.median_step,
        energy_uj: decision.energy_uj,
    }
}

/// The mean cost of a sample until it is decided; `accuracy` is the accuracy at that time.
pub fn per_decision(rule: Rule, case: &EstimateInput<'_>, outcomes: &[Outcome], accuracy: Option<f64>) -> PerDecision {
    let until_decided = &case.meter.lanes()[case.preset].until_decided;
    let (spent, samples) = (spent(case, until_decided), outcomes.len().max(1) as f64);
    let decided = outcomes.iter().filter(|outcome| outcome.decided_at.is_some()).count() as f64;
    PerDecision {
        hardware: case.hardware.to_string(),
        rule: rule.to_string(),
        time_us: spent.time_us / samples,
        energy_uj: spent.energy_uj / samples,
        early: decided / samples,
        accuracy,
        median_step: median_decision(outcomes),
        timestep_ms: case.meter.settings().timestep.0 as f64 / 1e9,
    }
}

/// Remarks on the constants of the `total` row, a sentence each: their hardware, absent constants,
/// constants without effect, figures without an interval.
pub fn constant_notes(target: &Target, case: &EstimateInput<'_>, total: &EnergyRow) -> Vec<String> {
    let preset = &target.constants()[case.preset];
    let foreign = !target.is_measured_by(preset) && !preset.hardware.is_empty();
    let inherited =
        foreign.then(|| format!("Uses constants of {}, also for static power (--constants FILE).", preset.hardware));
    let notes = [
        inherited,
        borrowed(preset, case),
        absent(preset, case),
        not_counted(target, preset),
        without_effect(target, preset, case),
        without_interval(target, preset, total),
    ];
    notes.into_iter().flatten().collect()
}

/// Remark on constants that the preset does not give.
fn absent(preset: &Constants, case: &EstimateInput<'_>) -> Option<String> {
    let absent = preset
        .list()
        .into_iter()
        .filter(|(name, constant)| constant.status == Status::NotGiven && is_charged(case, name))
        // Microcode neurons then take the time of any compartment; Loihi 1's rails show no core.
        .filter(|(name, _)| !Constants::ADDED.contains(name))
        // Leakage is given by core or by chip.
        .filter(|(name, _)| *name != "chip_static_power" || preset.core_static_power.value.value == 0.0);
    let names: Vec<&str> = absent.map(|(name, _)| name).collect();
    (!names.is_empty()).then(|| format!("Not given in {}, counted as 0: {}.", preset.name, names.join(", ")))
}

/// Remark on constants of the host that a file states for a chip without x86 cores.
fn not_counted(target: &Target, preset: &Constants) -> Option<String> {
    if target.chip().x86_cores > 0 || Shipped::find(CONSTANTS, &preset.name).is_some() {
        return None;
    }
    let of_host =
        |name: &str| name.starts_with("x86_") || ["injection_time", "turn_time", "reset_word_time"].contains(&name);
    let stated = preset.list().into_iter().filter(|(name, constant)| {
        !preset.stated_in.contains_key(name) && of_host(name) && constant.value.value != 0.0
    });
    let names: Vec<&str> = stated.map(|(name, _)| name).collect();
    let is = if names.len() == 1 { "is" } else { "are" };
    (!names.is_empty())
        .then(|| format!("{} {is} not counted: {} has no x86 core.", names.join(", "), target.chip().hardware()))
}

/// Remark on set constants of which the run has no cost.
fn without_effect(target: &Target, preset: &Constants, case: &EstimateInput<'_>) -> Option<String> {
    let set = preset.stated_in.iter().filter(|(_, from)| *from == SET_OPTION).map(|(name, _)| *name);
    let names: Vec<&str> = set.filter(|name| !is_charged(case, name)).collect();
    let why = match target.chip().x86_cores_in_use {
        0 => format!(", and {} uses no x86 core", target.chip().hardware()),
        _ => String::new(),
    };
    (!names.is_empty())
        .then(|| format!("Without effect: {}. This run has no cost of this kind{why}.", names.join(", ")))
}

/// Maximum number of constants of a kind that a remark names as borrowed from other hardware.
const NAMED: usize = 3;

/// Remark on a preset that is not shipped: its number of constants of other hardware, and their
/// greatest contributions to energy, time and power.
fn borrowed(preset: &Constants, case: &EstimateInput<'_>) -> Option<String> {
    if preset.borrowed.is_empty() || Shipped::find(CONSTANTS, &preset.name).is_some() {
        return None;
    }
    let whose: BTreeSet<&str> =
        preset.borrowed.iter().filter_map(|name| preset.stated_in.get(name)).map(String::as_str).collect();
    let events = |constants: &Constants| Some(energy(case.activity, &CostTable::new(constants).ok()?).total().0);
    let all = events(preset)?;
    let weighed = |name: &&'static str| {
        let mut without = preset.clone();
        let constant = without.get_mut(name).filter(|constant| constant.unit == Unit::pJ)?;
        let shown = format!("{name} {} pJ", constant.value.value);
        constant.value = 0.0.into();
        Some(((all - events(&without)?) as f64, shown))
    };
    let energies = most(preset.borrowed.iter().filter_map(weighed));
    let sums = &case.meter.lanes()[case.preset].whole;
    let parts = sums.parts.map(|part| part as f64 / 1e6 / sums.steps.max(1) as f64);
    let of_core = case.meter.core_time_shares().map(|share| share * parts[StepTime::SLOWEST_CORE]);
    let names = ["injection_time", "turn_time", "", "", BARRIER, "reset_word_time"];
    let times = names.into_iter().zip(parts).chain(CORE_TIMES.into_iter().zip(of_core));
    let is_theirs =
        |name: &str| preset.borrowed.contains(name) || name == BARRIER && preset.stated_in.contains_key(name);
    let shown = |(name, us): (&str, f64)| (us, format!("{name} {} us", three(us)));
    let times = most(times.filter(|(name, _)| is_theirs(name)).map(shown));
    let constants = preset.list().into_iter().filter(|(name, constant)| {
        constant.unit == Unit::mW && preset.borrowed.contains(name) && is_charged(case, name)
    });
    let powers =
        most(constants.map(|(name, constant)| (constant.value.value, format!("{name} {} mW", constant.value.value))));
    let said = [("energy of events", energies), ("time of a step", times), ("power", powers)]
        .map(|(what, named)| if named.is_empty() { String::new() } else { format!("; {what}: {}", named.join(", ")) });
    let (some, every) = (preset.borrowed.len(), Constants::NAMES.len());
    let whose = whose.into_iter().collect::<Vec<_>>().join(" and ");
    let twice = preset.chip_static_power.value.value > 0.0 && preset.borrowed.contains("core_static_power");
    let twice = if twice { " Static power counts cores and chips." } else { "" };
    Some(format!("{some} of {every} constants are from {whose}{}.{twice}", said.concat()))
}

/// Texts of the greatest positive weights, at most [`NAMED`].
fn most(weighed: impl Iterator<Item = (f64, String)>) -> Vec<String> {
    let mut weighed: Vec<_> = weighed.filter(|(weight, _)| *weight > 0.0).collect();
    weighed.sort_by(|a, b| b.0.total_cmp(&a.0));
    weighed.into_iter().take(NAMED).map(|(_, shown)| shown).collect()
}

/// Remark on figures of the `total` row without an interval, because errors of constants are
/// unknown: on another chip, of a changed constant, or of a whole preset.
fn without_interval(target: &Target, preset: &Constants, total: &EnergyRow) -> Option<String> {
    type Figure = (&'static str, Option<f64>, fn(&Bound) -> Option<f64>);
    let figures: [Figure; 4] = [
        ("power", total.total_mw, |low| low.total_mw),
        ("latency", total.latency_us, |low| low.latency_us),
        ("energy", total.energy_uj, |low| low.energy_uj),
        ("EDP", total.edp_pjs, |low| low.edp_pjs),
    ];
    let is_without = |(_, figure, low): &Figure| figure.is_some() && total.low.and_then(|all| low(&all)).is_none();
    let names: Vec<&str> = figures.iter().filter(|figure| is_without(figure)).map(|(name, ..)| *name).collect();
    let (has_base, hardware) = (preset.stated_in.values().any(|from| from != SET_OPTION), target.chip().hardware());
    let is_changed = |name: &&str| preset.stated_in.get(name).map_or(has_base, |from| from == SET_OPTION);
    let changed: Vec<&str> = Constants::NAMES.iter().copied().chain([BARRIER]).filter(is_changed).collect();
    let why = match changed.as_slice() {
        _ if !target.is_measured_by(preset) => format!("the constants' errors on {hardware} are unknown"),
        _ if preset.errors.is_empty() => format!("the errors of preset {} are unknown", preset.name),
        [] => return None,
        [one] => format!("{one} is changed, and its error is unknown"),
        several if several.len() <= 3 => format!("{} are changed, and their errors are unknown", several.join(", ")),
        several => format!("the errors of {} constants of {} are unknown", several.len(), preset.name),
    };
    (!names.is_empty()).then(|| format!("No interval of {}: {why}.", names.join(", ")))
}

/// Returns the report of a finished run; `baselines` are rows of other hardware with sources.
pub fn report(
    model: &str,
    target: &Target,
    case: &EstimateInput<'_>,
    samples: u64,
    baselines: Vec<(EnergyRow, String)>,
) -> EnergyReport {
    let estimate = estimate(case);
    let total = estimate.row(RowUnit::Total);
    let preset = &target.constants()[case.preset];
    let constant_notes = total.map_or_else(Vec::new, |total| constant_notes(target, case, total));
    let ratios = total.map_or_else(Vec::new, |total| ratios(total, &baselines));
    let steps = case.activity.steps() as f64 / samples.max(1) as f64;
    let rows = estimate.rows.iter().chain(baselines.iter().map(|(row, _)| row));
    // Runs without learning have no figure by the constants of learning.
    let is_listed = |name: &str| !name.starts_with("synapse_update") || is_charged(case, name);
    let constants = constant_entries(preset).into_iter().filter(|entry| is_listed(&entry.name)).collect();
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
        level: (case.corners.is_none() && case.errors.iter().all(|error| error.works > 0)).then_some(LEVEL),
        accounting: case.accounting,
        accuracy: None,
        labelled: 0,
        undecided: 0,
        inputs_on_chip: None,
        job: None,
        printed: Vec::new(),
        parts: Vec::new(),
        copies_counted: case.copies_counted,
        transport: case.meter.settings().timing.transport,
        comparison: Comparison { ratios, per_sample: per_sample(rows, steps), per_decision: None },
        baselines,
        early_exit: None,
        detail: Detail::default(),
        expected: None,
        constants,
        constant_notes,
        estimate,
    }
}
