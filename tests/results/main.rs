//! Energies compared with published work and other tools, and the memory that commands take.

// A test that cannot continue has failed.
#![allow(clippy::unwrap_used)]

#[path = "../common/mod.rs"]
mod common;
mod energy_memory;
mod energy_scaling;
mod published;
mod sanafe;
mod scenes;
