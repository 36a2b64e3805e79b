//! Speed of the machine and quality of mappings, measured on standard networks.
//!
//! Input: the name of a standard network. Output: medians with their spread, the counts of a step,
//! and the machine of the measurement. `docs/benchmarks.md` describes the meaning and the method of
//! each figure.
//!
//! Only [`ladders`] have goals: for other figures, documents say whether they are good.

pub mod early;
pub mod ladders;
pub mod mapping;
pub mod networks;
pub mod pareto;
pub mod published;
pub mod suite;
pub mod sweep;
