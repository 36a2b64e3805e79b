//! The types that the stages of the compiler and the machine hand to each other.
//!
//! Each type's constructor checks what the type promises, so that owning a value proves that the stage before it
//! succeeded: [`graph::Graph`], [`quantised::Quantised`], [`partition::Partition`], [`placement::Placement`],
//! [`program::Program`], then [`activity::Activity`]. [`spikes`] holds what goes into a run and what comes out.
pub mod activity;
pub mod dealt;
pub mod firing_rates;
pub mod graph;
pub mod groups;
pub mod partition;
pub mod placement;
pub mod potentials;
pub mod program;
pub mod pruned;
pub mod quantised;
pub mod source_counts;
pub mod spikes;
