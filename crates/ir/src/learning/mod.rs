//! Learning: rules that change plastic synapses, and their random numbers.
//!
//! `docs/learning.md` has the equations; `nsim_dynamics` compiles rules, `nsim_golden` walks them.
//!
//! - `rule`: rules as data.
//! - `text`: rules as text, parsed and written.
//! - `draws`: the random numbers of learning, seeded or replayed.

pub mod draws;
mod rule;
mod text;

#[cfg(test)]
mod tests;

pub use rule::{
    Change, Column, Dependency, EXPONENTS, Factor, GREATEST_ERROR, GREATEST_TRACE, Graded, Impulse, LONGEST_EPOCH,
    Learning, LearningSemantics, MANTISSAS, PES_EPOCH, PES_TRACE_EPOCH, Plastic, Product, Quantity, Rule, RuleProblem,
    RuleText, SLOWEST, TRACES, Tau, Trace, TraceSettings, Variable, WIDEST,
};
pub use text::{Problem, parse};
