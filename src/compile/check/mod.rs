//! Proof that a program keeps its limits and equals its network.

pub mod equivalence;
pub mod verify;
