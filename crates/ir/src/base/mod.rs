//! The lowest layer: ids, range-checked integers, units, random numbers, diagnostics, warnings.
//!
//! Every other module may use it; it uses none of them.

pub mod csr;
pub mod depths;
pub mod diagnostic;
pub mod fixed;
pub mod folds;
pub mod id;
pub mod names;
pub mod rng;
pub mod stats;
pub mod units;
pub mod warning;
