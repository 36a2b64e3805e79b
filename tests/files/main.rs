//! Files of nsim and of other tools: each field read, checked or refused.

// A test that cannot continue has failed.
#![allow(clippy::unwrap_used)]

#[path = "../common/mod.rs"]
mod common;
mod conventions;
mod fields;
mod foreign;
mod formats;
mod import;
mod labelled;
mod long_lists;
mod malformed;
#[path = "../common/memory.rs"]
mod memory;
mod nir_nodes;
mod readouts;
#[path = "../common/real.rs"]
mod real;
mod recordings;
mod state_dicts;
#[path = "../common/torch.rs"]
mod torch;
mod tree;
