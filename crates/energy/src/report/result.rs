//! The energy report and its object `nsim.energy/1`, with full precision.

use serde::Serialize;
use serde_json::{Map, Value, json};

use super::compared::Comparison;
use crate::published::scenario::ScenarioFile;
use nsim_compile::explore::cost_estimate::Score;
use nsim_cost::deployment::Deployment;
use nsim_cost::estimate::{Convention, EnergyRow, Estimate, RowUnit};
use nsim_cost::job::{Accounting, Mode};
use nsim_cost::{Host, Transport};
use nsim_ir::hardware::constants::{Constants, Status, Unit};
use nsim_session::decision::Rule;
use nsim_session::detail::Detail;

/// Savings of a run if samples ended at their decisions: equation (16).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct EarlyExitSavings {
    /// The rule that decides a sample.
    pub rule: Rule,
    /// Samples that were decided before their end.
    pub decided: u64,
    /// Timesteps after the decisions, of all samples.
    pub steps_saved: u64,
    /// Time of these timesteps, us.
    pub time_saved_us: f64,
    /// Energy of these timesteps, uJ, with all power of the `total` row: the chip is then off.
    pub energy_saved_uj: f64,
    /// Share of this in the energy of the whole run; `None` when the whole is zero.
    pub energy_saved_share: Option<f64>,
    /// The share if the chip stays on and idles, which saves none of its constant power.
    pub idle_saved_share: Option<f64>,
    /// Share of the samples whose class is right when decided; `None` unless all have labels.
    pub accuracy: Option<f64>,
    /// Median step of the early decisions, from 0.
    pub median_step: Option<u32>,
    /// Mean energy of one copy until a sample is decided, uJ.
    pub energy_uj: f64,
}

/// A unit of the published job, as computed here and as printed by its source.
#[derive(Debug, Clone, PartialEq)]
pub struct JobPart {
    /// The row by the constants of the report.
    pub here: EnergyRow,
    /// The printed row of this unit.
    pub printed: EnergyRow,
}

impl JobPart {
    /// Ratios of static, dynamic and total power here to the printed ones; `None` if not printed.
    pub(super) fn ratios(&self) -> [Option<f64>; 3] {
        fn powers(row: &EnergyRow) -> [Option<f64>; 3] {
            [row.static_mw, row.dynamic_mw, row.total_mw]
        }
        let (here, printed) = (powers(&self.here), powers(&self.printed));
        std::array::from_fn(|at| Some(here[at]? / printed[at].filter(|mw| *mw > 0.0)?))
    }

    fn json(&self) -> Value {
        let [static_mw, dynamic_mw, total_mw] = self.ratios();
        let ratio = json!({ "static_mw": static_mw, "dynamic_mw": dynamic_mw, "total_mw": total_mw });
        json!({ "unit": self.here.unit, "here": self.here, "printed": self.printed, "ratio": ratio })
    }
}

/// A constant of the report.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ConstantEntry {
    /// Its name; barriers carry their number of tiles.
    pub name: String,
    /// Value, in `unit`.
    pub value: f64,
    /// Its unit.
    pub unit: Unit,
    /// Its source.
    pub source: String,
    /// Its status: published, calibrated, assumed or not given.
    pub status: Status,
    /// The least value that its sources leave open.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub low: Option<f64>,
    /// The greatest value that its sources leave open.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub high: Option<f64>,
}

/// The constants of a preset, barriers last.
pub fn constant_entries(constants: &Constants) -> Vec<ConstantEntry> {
    let barriers = constants.barrier.iter().map(|entry| {
        let (number, parts) = entry.parts();
        (format!("barrier_time_{number}_{parts}"), &entry.time)
    });
    let singles = constants.listed().map(|(name, constant)| (name.to_string(), constant));
    singles
        .chain(barriers)
        .map(|(name, constant)| ConstantEntry {
            name,
            value: constant.value.value,
            unit: constant.unit,
            source: constant.source.clone(),
            status: constant.status,
            low: constant.bounds.map(|bounds| bounds.0),
            high: constant.bounds.map(|bounds| bounds.1),
        })
        .collect()
}

/// The object of `nsim.energy/1` for a network that did not run.
pub fn empty_result(copies: u32, mode: Mode, convention: Convention) -> Value {
    json!({
        "schema": "nsim.energy/1", "model": null, "target": null, "copies": copies, "deployment": null,
        "mode": mode.name(), "convention": convention.name(), "fits": false, "reasons": [], "seed": null, "rows": [],
        "cores_used": null, "breakdown_pj_per_timestep": null, "per_timestep_uj": null, "early_exit": null,
        "parts": [], "constants": [], "populations": [], "inputs": [], "cores": [], "warnings": [],
    })
}

/// A finished energy report.
#[derive(Debug, Clone)]
pub struct EnergyReport {
    /// The model's name.
    pub model: String,
    /// The target's name.
    pub target: String,
    /// Numbers of cores.
    pub deployment: Deployment,
    /// Offline or real time.
    pub mode: Mode,
    /// Name of the preset of the figures.
    pub preset: String,
    /// The seed of the input, if one was used.
    pub seed: Option<u64>,
    /// Origin of the input samples.
    pub input: Vec<String>,
    /// Samples of the run.
    pub samples: u64,
    /// Timesteps of all samples.
    pub timesteps: u64,
    /// Share of the samples whose class is their label; `None` unless all have labels.
    pub accuracy: Option<f64>,
    /// Number of samples with a label.
    pub labelled: u64,
    /// Rows of the simulated chip, breakdown, spread.
    pub estimate: Estimate,
    /// Rows of other hardware and of published jobs, with their sources.
    pub baselines: Vec<(EnergyRow, String)>,
    /// The job's row with inputs already on the chip, where injection is more than half of a step.
    pub inputs_on_chip: Option<EnergyRow>,
    /// The level of the intervals; `None` where they bound modelled constants.
    pub level: Option<f64>,
    /// The accounting of power.
    pub accounting: Accounting,
    /// The model of the mesh.
    pub transport: Transport,
    /// Comparison with other hardware.
    pub comparison: Comparison,
    /// Savings if samples ended at their decisions.
    pub early_exit: Option<EarlyExitSavings>,
    /// The constants of the preset.
    pub constants: Vec<ConstantEntry>,
    /// Counts by population, input and core, and warnings.
    pub detail: Detail,
    /// Number of samples without a decision.
    pub undecided: usize,
    /// Cost of a mean step that `nsim map` expects at the firing rates of the run.
    pub expected: Option<Score>,
    /// The published job of the model, if there is one.
    pub job: Option<ScenarioFile>,
    /// Energy and energy-delay product as printed for that job and other published hardware.
    pub printed: Vec<[f64; 2]>,
    /// Units of the published job, here and as printed.
    pub parts: Vec<JobPart>,
    /// Number of copies counted in the run.
    pub copies_counted: u32,
    /// Remarks on the constants: hardware, absence, no effect, figures without an interval.
    pub constant_notes: Vec<String>,
}

/// Cost of a sample of one copy, power times time.
#[derive(Debug, Clone, Copy, Serialize)]
pub(super) struct SampleCost {
    /// Mean number of its timesteps.
    pub(super) steps: f64,
    pub(super) time_us: f64,
    pub(super) energy_uj: f64,
    /// Energy of the neuron cores alone.
    pub(super) cores_uj: Option<f64>,
}

#[derive(Serialize)]
pub(super) struct Job {
    pub(super) total_mw: Option<f64>,
    pub(super) share_mw: Option<f64>,
}

impl EnergyReport {
    pub(super) fn rows(&self) -> impl Iterator<Item = &EnergyRow> {
        self.estimate.rows.iter().chain(self.baselines.iter().map(|(row, _)| row))
    }

    pub(super) fn convention(&self) -> Convention {
        self.estimate.rows.first().map_or(Convention::Physical, |row| row.convention)
    }

    pub(super) fn hardware(&self) -> &str {
        self.estimate.rows.first().map_or("chip", |row| &row.hardware)
    }

    pub(super) fn total(&self) -> Option<&EnergyRow> {
        self.estimate.row(RowUnit::Total)
    }

    /// Powers of all copies, and a copy's share, by the report's accounting.
    pub(super) fn job(&self) -> Job {
        let total_mw = self.estimate.job.total(self.accounting);
        Job { total_mw, share_mw: total_mw.map(|all| all / f64::from(self.deployment.copies.max(1))) }
    }

    /// The object of `nsim.energy/1`.
    pub fn json(&self) -> Value {
        let breakdown = self
            .estimate
            .breakdown_pj
            .as_ref()
            .map(|parts| parts.iter().map(|&(name, pj)| (name.to_string(), json!(pj))).collect::<Map<_, _>>());
        fn times(times: [(&str, f64); 6]) -> [(String, Value); 6] {
            times.map(|(name, us)| (name.replace(' ', "_"), json!(us)))
        }
        let Deployment { x86_cores, x86_chips, host, .. } = self.deployment;
        let injecting = if host == Host::Stream { x86_chips } else { 0 };
        let (deployment, estimate, total) = (&self.deployment, &self.estimate, self.total());
        let mut result = json!({
            "schema": "nsim.energy/1", "model": self.model, "target": self.target, "copies": deployment.copies,
            "deployment": deployment.name, "mode": self.mode, "convention": self.convention(), "fits": true,
            "preset": self.preset, "level": self.level, "seed": self.seed, "input": self.input,
            "samples": self.samples, "timesteps": self.timesteps, "accuracy": self.accuracy,
            "rows": self.rows().collect::<Vec<_>>(), "inputs_on_chip": self.inputs_on_chip,
            "cores_used": deployment.cores_used, "tiles_used": deployment.tiles_used,
            "chips_used": deployment.chips_used, "x86_cores": x86_cores,
            "host": {
                "kind": host, "x86_cores": x86_cores, "chips_injecting": injecting, "x86_share": estimate.x86_share,
            },
            "job": self.job(), "breakdown_pj_per_timestep": breakdown, "per_timestep_uj": estimate.per_timestep_uj,
            "per_timestep_dynamic_uj": estimate.per_timestep_dynamic_uj,
            "time_us_per_timestep": estimate.time_us.map(|all| times(all).into_iter().collect::<Map<_, _>>()),
            "transport": self.transport, "accounting": self.accounting, "sample": self.sample(),
            "ratios": self.comparison.ratios, "per_sample": self.comparison.per_sample,
            "per_decision": self.comparison.per_decision, "early_exit": self.early_exit,
            "parts": self.parts.iter().map(JobPart::json).collect::<Vec<_>>(), "constants": self.constants,
            "expected": self.expected, "notes": self.constant_notes,
            "low": total.and_then(|row| row.low).unwrap_or_default(),
            "high": total.and_then(|row| row.high).unwrap_or_default(), "share": total.and_then(|row| row.share),
        });
        if let (Value::Object(fields), Value::Object(detail)) = (&mut result, json!(self.detail)) {
            fields.retain(|name, value| name != "inputs_on_chip" || !value.is_null());
            fields.extend(detail);
        }
        result
    }

    /// Physical cost of a mean sample, and of its neuron cores; `None` without timesteps.
    pub(super) fn sample(&self) -> Option<SampleCost> {
        let steps = (self.samples > 0).then(|| self.timesteps as f64 / self.samples as f64)?;
        let time_us = steps * self.total()?.latency_us?;
        let energy_uj = |row: &EnergyRow| Some(row.total_mw? * time_us / 1e3);
        let cores_uj = self.estimate.row(RowUnit::Neuron).and_then(energy_uj);
        Some(SampleCost { steps, time_us, energy_uj: energy_uj(self.total()?)?, cores_uj })
    }
}
