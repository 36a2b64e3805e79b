//! The mirror of the evidence for constants (`mapping/constants/evidence.ron`): for each constant what its sources say, side
//! by side.
//!
//! A constant's value and interval follow from its sources by one rule (`cost::evidence`), so that they can be found again
//! without the sources that come from one work.

use serde::Deserialize;

use super::workload::Accounting;
use crate::desc::spanned::Spanned;
use crate::desc::target::constants::{Status, Unit};

/// The time in which an x86 core sets one 32-bit word of a core's state registers to zero.
pub const RESET_WORD_TIME: &str = "reset_word_time";
/// What a chip's x86 cores draw once a program is loaded, above the idle of a chip that was only switched on.
pub const X86_BOOT_POWER: &str = "x86_boot_power";

/// Constants of what a host does besides injecting spikes, with their units. No count of a simulated run multiplies them, so that presets
/// do not have them.
pub const HOST_CONSTANTS: [(&str, Unit); 2] = [(RESET_WORD_TIME, Unit::ns), (X86_BOOT_POWER, Unit::mW)];

/// Jobs that a finding speaks of, where a profiler attributes the same thing differently to jobs of one chip and of several.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
pub enum Jobs {
    /// Jobs on one chip.
    OneChip,
    /// Jobs on more chips.
    SeveralChips,
}

impl Jobs {
    /// The jobs that one on so many chips belongs to.
    #[must_use]
    pub fn on_chips(chips: u64) -> Self {
        if chips > 1 { Jobs::SeveralChips } else { Jobs::OneChip }
    }
}

/// What one source says of a constant.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Finding {
    /// The work that it comes from, as workloads name it.
    pub work: String,
    /// Further works that it rests on, or that share its authors: it is left out with each of them.
    #[serde(default)]
    pub shared_with: Vec<String>,
    /// The jobs that it speaks of; all where it does not say.
    #[serde(default)]
    pub jobs: Option<Jobs>,
    /// The constant by it.
    pub value: Spanned<f64>,
    /// What it attributes to the chip.
    pub accounting: Accounting,
    /// Published, fitted or assumed.
    pub status: Status,
    /// Where it is printed, or how it follows from what is.
    pub source: String,
}

impl Finding {
    /// Whether it comes from this work or rests on it.
    #[must_use]
    pub fn is_of(&self, work: &str) -> bool {
        self.work == work || self.shared_with.iter().any(|other| other == work)
    }
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
