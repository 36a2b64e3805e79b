//! Plastic synapses, which a rule changes while a network runs.
//!
//! - `places`: the plastic synapses of each projection of a network.
//! - `traces`: notes and traces of sources and targets.
//! - `learning`: the phase in which a rule changes weights, delays and tags.

pub(crate) mod learning;
pub mod places;
pub(crate) mod traces;
