//! Several mappings compared: cost estimates, traffic, remedies. Calls the pipeline and is never
//! called by it.

pub mod box_costs;
pub mod bursts;
pub mod choice;
pub mod cost_estimate;
pub mod estimate;
pub mod remedy;
pub mod search;
#[cfg(test)]
mod tests;
pub mod traffic;

pub use search::{candidates, map};
