//! The ground floor: ids, range-checked integers, units, randomness, diagnostics.
//!
//! Nothing in here knows of networks or cores. Everything above may use it; it uses nothing above.

pub mod diagnostic;
pub mod fixed;
pub mod folds;
pub mod id;
pub mod rng;
pub mod units;
