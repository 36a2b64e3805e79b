//! Spikes of each source and overflows of each compartment over a run.
//!
//! An engine makes the counts, and its callers sum them over populations. Merging is addition, so
//! neither the order of samples nor threads can change a sum.

use std::ops::AddAssign;

use serde::{Deserialize, Serialize};

use crate::base::id::{ChannelId, CompartmentId, Id, IdVec};

/// Counts of overflows of one compartment.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
pub struct OverflowCounts {
    /// Number of accumulators and currents that wrapped.
    pub wrapped: u64,
    /// Number of voltages that were clipped.
    pub clipped: u64,
    /// Clipped voltages at the upper end without a reset to zero, so the loss changes later steps.
    pub cut: u64,
}

impl AddAssign for OverflowCounts {
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
    /// Overflows of each compartment; empty where there are none.
    pub overflows: IdVec<CompartmentId, OverflowCounts>,
}

impl SourceCounts {
    /// Zero counts of a network with these numbers of channels and compartments.
    pub fn new(channels: usize, compartments: usize) -> Self {
        SourceCounts {
            channels: vec![0; channels].into(),
            compartments: vec![0; compartments].into(),
            overflows: IdVec::new(),
        }
    }

    /// Adds overflows of a compartment.
    ///
    /// # Panics
    /// When the compartment is not of this network.
    pub fn add_overflows(&mut self, compartment: CompartmentId, more: OverflowCounts) {
        if self.overflows.is_empty() {
            self.overflows = vec![OverflowCounts::default(); self.compartments.len()].into();
        }
        self.overflows.as_mut_slice()[compartment.index()] += more;
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
        let more = other.overflows.enumerate().filter(|(_, more)| **more != OverflowCounts::default());
        more.for_each(|(compartment, more)| self.add_overflows(compartment, *more));
    }

    /// Overflows of a compartment.
    pub fn overflows(&self, compartment: CompartmentId) -> OverflowCounts {
        self.overflows.get(compartment).copied().unwrap_or_default()
    }
}
