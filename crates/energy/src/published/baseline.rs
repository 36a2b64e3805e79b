//! Types of baseline files (`mapping/baselines`): measured power and time of other hardware.

use serde::Deserialize;

use nsim_cost::job::Mode;
use nsim_ir::hardware::constants::Status;
use nsim_ir::spanned::Spanned;

/// All-to-all synapses between two populations, by their sizes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DenseLayer {
    /// Size of the source.
    pub from: u32,
    /// Size of the target.
    pub to: u32,
}

/// The workload that a baseline was measured on.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeasuredOn {
    /// Sizes of the input populations.
    pub inputs: Vec<u32>,
    /// Its projections.
    pub layers: Vec<DenseLayer>,
    /// Timesteps of a sample.
    pub steps: u32,
    /// Length of a timestep, ms.
    pub timestep_ms: f64,
}

/// One printed row.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BaselineRow {
    /// The mode of the run.
    pub mode: Mode,
    /// Power at idle, mW.
    pub static_mw: Spanned<f64>,
    /// Dynamic power, above idle, mW.
    pub dynamic_mw: Spanned<f64>,
    /// Their sum as printed, mW.
    pub total_mw: Spanned<f64>,
    /// Time of a timestep, us.
    pub latency_us: Spanned<f64>,
    /// Energy of a timestep as the source prints it.
    pub printed_energy_uj: Spanned<f64>,
    /// Energy-delay product as the source prints it, in pJ s regardless of the unit it names.
    pub printed_edp: Spanned<f64>,
}

/// A figure of a roofline, with its origin.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RooflineFigure {
    /// The number, in the unit of the field's name.
    pub value: Spanned<f64>,
    /// Place where it is printed, data of its fit, or reason for its assumption.
    pub source: String,
    /// Its status: published, calibrated or assumed.
    pub status: Status,
}

/// Bounds of dense hardware, for workloads on which it was not measured.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Roofline {
    /// Peak rate of f32 operations, in 10^9 a second.
    pub peak_gflops: RooflineFigure,
    /// Peak memory bandwidth, in 10^9 bytes a second.
    pub bandwidth_gb_s: RooflineFigure,
    /// Least time of a layer in a window, us: launches and the framework around them.
    pub layer_overhead_us: RooflineFigure,
    /// Power at idle, in mW.
    pub idle_mw: RooflineFigure,
    /// Power while launches follow each other without filling the hardware, in mW.
    pub active_mw: RooflineFigure,
    /// Power at the peak, in mW.
    pub peak_mw: RooflineFigure,
}

impl Roofline {
    /// Name and value of each figure.
    pub fn list(&self) -> [(&'static str, &RooflineFigure); 6] {
        [
            ("peak_gflops", &self.peak_gflops),
            ("bandwidth_gb_s", &self.bandwidth_gb_s),
            ("layer_overhead_us", &self.layer_overhead_us),
            ("idle_mw", &self.idle_mw),
            ("active_mw", &self.active_mw),
            ("peak_mw", &self.peak_mw),
        ]
    }
}

/// A baseline file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename = "Baseline")]
pub struct BaselineFile {
    /// Its name on the command line.
    pub name: String,
    /// Name of the hardware in tables.
    pub hardware: String,
    /// Paper and table.
    pub source: String,
    /// Its status: published, calibrated or assumed.
    pub status: Status,
    /// Method of measurement.
    pub notes: String,
    /// The only workload for which it holds.
    pub measured_on: MeasuredOn,
    /// Its rows.
    pub rows: Vec<BaselineRow>,
    /// Its bounds for other workloads.
    pub roofline: Option<Roofline>,
}
