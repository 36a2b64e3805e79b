//! Plastic synapses: those whose weights a run may change between steps.
//!
//! - `synapses`: where each leads, by source; their weights are in the state of a shard.
//! - `places`: which of them are those of a network's projection.
//! - `learning`: the phase in which a rule changes weights.

pub(crate) mod learning;
pub mod places;
pub(crate) mod synapses;
