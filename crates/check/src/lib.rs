//! Proof that a mapping keeps its limits and equals its network, by code that shares nothing with
//! what made it.

pub mod equivalence;
pub mod relays;
mod shifts;
pub mod verify;
mod words;
