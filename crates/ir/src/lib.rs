//! Data types exchanged between the stages of nsim, without any rule of the dynamics.
//!
//! Each constructor checks the invariants of its type, so a value proves that the previous stage
//! succeeded. The order is [`graph::Graph`], [`quantised::Quantised`], [`partition::Partition`],
//! [`placement::Placement`], [`program::Program`] and [`activity::Activity`]. [`spikes`] has
//! samples and the engine interface, [`hardware`] targets. [`base`] depends on none of these: ids,
//! fixed-point fields, units, diagnostics.

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
