//! Rows of the energy table, their intervals and their sources.

use serde::Serialize;

use crate::job::Convention;
use nsim_ir::base::names::named_variants;

impl Convention {
    /// Energy of a timestep in uJ. `published` needs the timesteps of a sample.
    pub fn energy_uj(self, total_mw: f64, latency_us: f64, steps_per_sample: Option<u32>) -> Option<f64> {
        match self {
            Convention::Physical => Some(total_mw * latency_us / 1e3),
            Convention::Published => {
                steps_per_sample.filter(|&steps| steps > 0).map(|steps| total_mw / f64::from(steps))
            }
        }
    }
}

named_variants! {
    /// Source of a row.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "lowercase")]
    pub enum FigureSource {
        /// From the counts of a simulated run.
        Simulated = "simulated",
        /// Measured on this machine.
        Measured = "measured",
        /// Printed by its source.
        Published = "published",
        /// From constants alone.
        Modelled = "modelled",
        /// Given by the user.
        Stated = "stated",
        /// An assumption.
        Assumed = "assumed",
        /// Computed from printed figures.
        Computed = "computed",
    }
}

named_variants! {
    /// The part of the hardware whose cost a row has.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "lowercase")]
    pub enum RowUnit {
        /// The x86 cores; by rails, their work.
        X86 = "x86",
        /// The neuron cores.
        Neuron = "neuron",
        /// The board after booting.
        Boot = "boot",
        /// The board with a loaded network that does not run.
        Idle = "idle",
        /// All of these.
        Total = "total",
    }
}

impl RowUnit {
    /// Whether the row counts a part of the cost only.
    pub fn is_part(self) -> bool {
        self != RowUnit::Total
    }
}

/// One end of the intervals of a row's figures.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Bound {
    /// Total power, mW.
    pub total_mw: Option<f64>,
    /// Time of a timestep, us.
    pub latency_us: Option<f64>,
    /// Energy of a timestep, uJ.
    pub energy_uj: Option<f64>,
    /// Energy-delay product, pJ s.
    pub edp_pjs: Option<f64>,
}

/// Shares of a figure by the status of the constants, 0..=1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct StatusShare {
    /// Share from constants printed by their sources.
    pub published: f64,
    /// Share from constants fitted to measurements.
    pub fitted: f64,
    /// Share from assumed constants.
    pub assumed: f64,
}

/// Shares by status of each column.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Shares {
    /// Shares of static power.
    pub static_mw: Option<StatusShare>,
    /// Shares of dynamic power.
    pub dynamic_mw: Option<StatusShare>,
    /// Shares of the time of a step.
    pub latency_us: Option<StatusShare>,
}

/// A row of the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EnergyRow {
    /// The simulated chip's name, or a baseline's hardware.
    pub hardware: String,
    /// The part: by the profiler x86, neuron, total; by rails boot, idle, x86, total.
    pub unit: RowUnit,
    /// x86 cores of the row; `None` for other hardware.
    pub x86_cores: Option<u64>,
    /// Definition of the energy and the energy-delay product.
    pub convention: Convention,
    /// Power drawn without activity, mW.
    pub static_mw: Option<f64>,
    /// Dynamic power, mW.
    pub dynamic_mw: Option<f64>,
    /// Their sum, mW.
    pub total_mw: Option<f64>,
    /// Time of a timestep, the mean over the run, us.
    pub latency_us: Option<f64>,
    /// Energy of a timestep, uJ.
    pub energy_uj: Option<f64>,
    /// Energy-delay product, pJ s.
    pub edp_pjs: Option<f64>,
    /// The low end of the 80 % interval of each figure.
    pub low: Option<Bound>,
    /// The high end of this interval.
    pub high: Option<Bound>,
    /// Shares of its total power by the status of the constants.
    pub share: Option<StatusShare>,
    /// Shares of its other columns.
    pub shares: Shares,
    /// Processors that were busy before it was measured, where they were many.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub busy: Option<f64>,
    /// Source of the row.
    pub source: FigureSource,
    /// Source of its power, which may differ from the source of its time.
    pub power_source: FigureSource,
    /// Source of its energy and energy-delay product: `computed` where power and time are printed.
    pub energy_source: FigureSource,
}

impl EnergyRow {
    /// Returns a row of given power and time, with its energy and energy-delay product.
    pub fn new(
        hardware: &str,
        unit: RowUnit,
        convention: Convention,
        (static_mw, dynamic_mw): (f64, Option<f64>),
        latency_us: Option<f64>,
        source: FigureSource,
        steps_per_sample: Option<u32>,
    ) -> Self {
        let total_mw = dynamic_mw.map(|dynamic_mw| static_mw + dynamic_mw);
        let energy_uj = total_mw
            .zip(latency_us)
            .and_then(|(total, latency)| convention.energy_uj(total, latency, steps_per_sample));
        EnergyRow {
            hardware: hardware.to_string(),
            unit,
            x86_cores: None,
            convention,
            static_mw: Some(static_mw),
            dynamic_mw,
            total_mw,
            latency_us,
            energy_uj,
            // 1 uJ for 1 us is 1 pJ s.
            edp_pjs: energy_uj.zip(latency_us).map(|(energy, latency)| energy * latency),
            low: None,
            high: None,
            share: None,
            shares: Shares::default(),
            busy: None,
            source,
            power_source: source,
            energy_source: if source == FigureSource::Published { FigureSource::Computed } else { source },
        }
    }

    /// Returns a figure by its name in tables of measurements.
    pub fn figure(&self, name: &str) -> Option<f64> {
        match name {
            "static_mw" => self.static_mw,
            "dynamic_mw" => self.dynamic_mw,
            "total_mw" => self.total_mw,
            "latency_us" => self.latency_us,
            "energy_uj" => self.energy_uj,
            "edp_pjs" => self.edp_pjs,
            _ => None,
        }
    }
}
