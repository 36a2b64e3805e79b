//! Counts of the mapped program, from who spiked.

pub(crate) mod routing_tables;
pub mod tally;
