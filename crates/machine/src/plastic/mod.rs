//! Plastic synapses, whose weights a run may change between steps.
//!
//! - `places`: the plastic synapses of each projection of a network.
//! - `learning`: the phase in which a rule changes weights.

pub mod places;
