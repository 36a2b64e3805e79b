//! Plastic synapses, which a rule changes while a network runs.
//!
//! - `traces`: notes and traces of sources and targets.
//! - `signals`: values of input populations that replace traces.
//! - `epoch`: the end of an epoch, in which a rule changes weights, delays and tags.
//! - `pes`: weights that learn from an error.
//! - `learning`: the phase Learn, step by step.

pub(crate) mod epoch;
pub(crate) mod learning;
mod pes;
pub(crate) mod signals;
pub(crate) mod traces;
