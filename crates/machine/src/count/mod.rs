//! Counts of the mapped program, from its spikes.
//!
//! - `effects`: events of a message that selects a list of synapses.
//! - `tally`: messages, hops and synaptic events of spikes.
//! - `routing_tables`: the list of synapses that a message selects.

pub(crate) mod effects;
pub(crate) mod routing_tables;
pub mod tally;
