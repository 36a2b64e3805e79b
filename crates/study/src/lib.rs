//! How fast the machine is, and how good mappings are: standard networks, steps of them measured,
//! and mapped.
//!
//! Input: the name of a standard network. Output: medians with their spread, along with what a step
//! did and the machine it was measured on. What a figure is good for, and how it was taken:
//! `docs/benchmarks.md`.
//!
//! There are no goals here: documents say whether a figure is good.

pub mod early;
pub mod ladders;
pub mod mapping;
pub mod networks;
pub mod pareto;
pub mod published;
pub mod suite;
pub mod sweep;
