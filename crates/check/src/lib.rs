//! Proof that a mapping keeps its limits and equals its network, by code that shares with what made
//! it only `nsim_dynamics::synapses`, the list of a network's synapses. `nsim_golden` has that
//! again.

pub mod equivalence;
pub mod relays;
mod shifts;
pub mod verify;
mod words;
