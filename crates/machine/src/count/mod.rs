//! Counts of the mapped program, from who spiked.
//!
//! - `effects`: what reaching a list of synapses causes.
//! - `tally`: messages, hops and synaptic events of spikes.
//! - `spike_counts`: how often each source spiked, and what that caused.
//! - `routing_tables`: the list of synapses that a message selects.
//! - `residual`: synaptic events that steps leave to the end of a run.

pub(crate) mod effects;
pub(crate) mod residual;
pub(crate) mod routing_tables;
pub(crate) mod spike_counts;
pub mod tally;
