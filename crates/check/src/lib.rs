//! Proof that a mapping keeps its limits and equals its network. With the compiler it shares only
//! the plain data of `nsim_ir`, with limits and their comparison, and `nsim_dynamics::synapses`,
//! the list of a network's synapses. `nsim_golden` has its own version of that list.

pub mod equivalence;
pub mod memory;
pub mod relays;
mod shifts;
pub mod verify;
mod words;
