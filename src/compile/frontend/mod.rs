//! From a model file to a network in range-checked integers.

pub mod analytic;
pub mod copies;
pub mod lower;
pub mod prune;
pub mod quantise;
