//! The mirror of tables of measurements (`mapping/measurements`): what a published workload needed
//! on the chip.

use serde::Deserialize;

use nsim_cost::job::Mode;
use nsim_ir::spanned::Spanned;

/// One cell of a table.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeasuredCell {
    /// `x86`, `neuron` or `total`.
    pub unit: Spanned<String>,
    /// A figure of a report's row, such as `static_mw`.
    pub figure: Spanned<String>,
    /// As it is printed; its last digit says how far it is rounded.
    pub printed: Spanned<String>,
}

impl MeasuredCell {
    /// The value and half a unit of its last digit, when it is a positive decimal.
    pub fn value(&self) -> Option<(f64, f64)> {
        let text = self.printed.value.trim();
        let digits = text.split_once('.').map_or(0, |(_, fraction)| fraction.len());
        let value: f64 = text.parse().ok().filter(|value: &f64| value.is_finite() && *value > 0.0)?;
        (digits <= 12).then(|| (value, 0.5 * 10f64.powi(-(digits as i32))))
    }
}

/// A table of measurements of one workload.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename = "Measurements")]
pub struct MeasurementsFile {
    /// The table's name.
    pub name: String,
    /// Paper and table.
    pub source: String,
    /// How it was measured, and what is not known of that.
    pub notes: String,
    /// The model whose activity stands for the workload's.
    pub model: String,
    /// The target.
    pub target: String,
    /// Copies, whose share each figure is.
    pub copies: u32,
    /// How samples were passed.
    pub mode: Mode,
    /// Timesteps of a sample.
    pub steps_per_sample: u32,
    /// The cells.
    pub cells: Vec<MeasuredCell>,
}
