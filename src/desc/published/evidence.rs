//! The mirror of the evidence for constants (`mapping/constants/evidence.ron`): for each constant what its sources say, side
//! by side.
//!
//! A constant's value and interval follow from its sources by one rule (`cost::evidence`), so that they can be found again
//! without the sources that come from one work.

use serde::Deserialize;

use super::workload::Accounting;
use crate::desc::spanned::Spanned;
use crate::desc::target::{Status, Unit};

/// The time for which the host is busy with each value that it hands over for an inference. No count of a simulated run
/// multiplies it, so that presets do not have it.
pub const VALUE_TRANSFER_TIME: &str = "value_transfer_time";

/// What one source says of a constant.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Finding {
    /// The work that it comes from, as workloads name it.
    pub work: String,
    /// The constant by it.
    pub value: Spanned<f64>,
    /// What it attributes to the chip.
    pub accounting: Accounting,
    /// Published, fitted or assumed.
    pub status: Status,
    /// Where it is printed, or how it follows from what is.
    pub source: String,
}

/// A constant and what is known of it.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ConstantEvidence {
    /// Its name.
    pub constant: Spanned<String>,
    /// Its unit.
    pub unit: Unit,
    /// Constants of one group are wrong together: they move as one when an interval is computed.
    pub group: String,
    /// Whether what sources measure may hold more than the constant, never less: of two middle findings the lower counts.
    #[serde(default)]
    pub upper_bounds: bool,
    /// The sources.
    pub findings: Vec<Finding>,
}

/// An evidence file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename = "Evidence")]
pub struct EvidenceFile {
    /// Its name.
    pub name: String,
    /// How to read it.
    pub notes: String,
    /// The preset that gives barrier times, and what no finding is about.
    pub base: Spanned<String>,
    /// The constants.
    pub constants: Vec<ConstantEvidence>,
}
