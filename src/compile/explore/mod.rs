//! Several mappings compared: cost estimates, traffic, remedies.

pub mod cost_estimate;
pub mod remedy;
pub mod search;
pub mod traffic;
