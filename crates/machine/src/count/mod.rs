//! Counts of the mapped program, from who spiked.

pub(crate) mod residual;
pub(crate) mod routing_tables;
pub(crate) mod spike_counts;
pub mod tally;
