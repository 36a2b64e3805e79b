//! The types that the stages of nsim hand to each other: plain data without a rule of the dynamics.
//!
//! Each type's constructor checks what the type promises, so that owning a value proves that the
//! stage before it succeeded: [`graph::Graph`], [`quantised::Quantised`], [`partition::Partition`],
//! [`placement::Placement`], [`program::Program`], then [`activity::Activity`]. [`spikes`] holds
//! what goes into a run and what comes out, [`hardware`] what a target has. [`base`] is below all
//! of them: ids, fixed-point fields, units, diagnostics.

pub mod activity;
pub mod arithmetic;
pub mod base;
pub mod firing_rates;
pub mod graph;
pub mod groups;
pub mod hardware;
pub mod learning;
pub mod locate;
pub mod mapping;
pub mod messages;
pub mod microcode;
pub mod neurons;
pub mod partition;
pub mod placement;
pub mod potentials;
pub mod program;
pub mod pruned;
pub mod quantised;
pub mod ranks;
pub mod resource;
pub mod source_counts;
pub mod spanned;
pub mod spikes;
pub mod stimulus;
pub mod tensor;
