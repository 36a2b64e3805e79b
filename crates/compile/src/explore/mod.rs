//! Comparison of several mappings: cost estimates, traffic, remedies. It calls the pipeline and is
//! never called by it.

pub mod box_costs;
pub mod bursts;
pub mod choice;
pub mod cost_estimate;
pub mod remedy;
pub mod search;
#[cfg(test)]
mod tests;
pub mod traffic;

pub use search::{candidates, map};
