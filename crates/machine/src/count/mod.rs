//! Counts of the mapped program, from its spikes.
//!
//! - `effects`: events of a message that selects a list of synapses.
//! - `tally`: messages, hops and synaptic events of spikes.
//! - `spike_counts`: spikes of each source, and the activity that they cause.
//! - `routing_tables`: the list of synapses that a message selects.
//! - `residual`: synaptic events that are counted at the end of a run instead of in steps.

pub(crate) mod effects;
pub(crate) mod residual;
pub(crate) mod routing_tables;
pub(crate) mod spike_counts;
pub mod tally;
