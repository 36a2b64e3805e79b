//! Spikes of each source and overflows of each compartment over a run.
//!
//! An engine makes the counts, and its callers sum them over populations. Merging is addition, so
//! neither the order of samples nor threads can change a sum.

use std::ops::AddAssign;

use serde::{Deserialize, Serialize};

use crate::base::id::{ChannelId, CompartmentId, Id, IdVec};

/// Counts of overflows of one compartment.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
pub struct LeftField {
    /// Accumulators and currents that wrapped.
    pub wrapped: u64,
    /// Number of voltages that were clipped.
    pub clipped: u64,
    /// Clipped voltages at the upper end without a reset to zero, so the loss changes later steps.
    pub cut: u64,
}

impl AddAssign for LeftField {
    fn add_assign(&mut self, more: Self) {
        self.wrapped += more.wrapped;
        self.clipped += more.clipped;
        self.cut += more.cut;
    }
}

/// Spikes by source and overflows by compartment, of a run or a part of it.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize, Serialize)]
pub struct SourceCounts {
    /// Spikes of each channel.
    pub channels: IdVec<ChannelId, u64>,
    /// Spikes of each compartment.
    pub compartments: IdVec<CompartmentId, u64>,
    /// What left its field; empty where nothing did.
    pub left_fields: IdVec<CompartmentId, LeftField>,
}

impl SourceCounts {
    /// Zero counts of a network with these numbers of channels and compartments.
    pub fn new(channels: usize, compartments: usize) -> Self {
        SourceCounts {
            channels: vec![0; channels].into(),
            compartments: vec![0; compartments].into(),
            left_fields: IdVec::new(),
        }
    }

    /// Adds overflows of a compartment.
    ///
    /// # Panics
    /// When the compartment is not of this network.
    pub fn add_left_field(&mut self, compartment: CompartmentId, more: LeftField) {
        if self.left_fields.is_empty() {
            self.left_fields = vec![LeftField::default(); self.compartments.len()].into();
        }
        self.left_fields.as_mut_slice()[compartment.index()] += more;
    }

    /// Adds the counts of another part of the run.
    ///
    /// # Panics
    /// When the other network has another size.
    pub fn merge(&mut self, other: &SourceCounts) {
        assert_eq!(self.channels.len(), other.channels.len(), "counts of another network");
        assert_eq!(self.compartments.len(), other.compartments.len(), "counts of another network");
        self.channels.iter_mut().zip(&other.channels).for_each(|(sum, more)| *sum += more);
        self.compartments.iter_mut().zip(&other.compartments).for_each(|(sum, more)| *sum += more);
        let left = other.left_fields.enumerate().filter(|(_, left)| **left != LeftField::default());
        left.for_each(|(compartment, left)| self.add_left_field(compartment, *left));
    }

    /// What left its field at a compartment.
    pub fn left_field(&self, compartment: CompartmentId) -> LeftField {
        self.left_fields.get(compartment).copied().unwrap_or_default()
    }
}
