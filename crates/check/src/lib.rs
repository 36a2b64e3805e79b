//! Proof that a mapping keeps its limits and equals its network. It shares with what made it the
//! plain data of `nsim_ir`, limits and their comparison included, and `nsim_dynamics::synapses`,
//! the list of a network's synapses, which `nsim_golden` has again.

pub mod equivalence;
pub mod relays;
mod shifts;
pub mod verify;
mod words;
