//! Plastic synapses, whose weights a run may change between steps.
//!
//! - `synapses`: their targets, by source; their weights are in the state of a shard.
//! - `places`: the plastic synapses of each projection of a network.
//! - `learning`: the phase in which a rule changes weights.

pub(crate) mod learning;
pub mod places;
pub(crate) mod synapses;
