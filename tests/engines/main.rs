//! The engines compared with each other, with silicon and recordings, and with changed programs.

// A test that cannot continue has failed.
#![allow(clippy::unwrap_used)]

mod agreement;
mod biases;
mod big_integers;
mod cases;
#[path = "../common/mod.rs"]
mod common;
mod compartments;
mod differential;
mod early_exit;
mod fuzzed;
mod integrate_and_fire;
mod learning;
mod loihi2;
mod microcode;
mod mutations;
mod neuron_vectors;
mod overflow;
mod parts;
mod payloads;
mod plastic;
mod pruning;
mod ranks;
mod reference;
mod relays;
mod sessions;
mod silicon;
mod skipping;
mod soft_reset;
mod stages;
mod step_rules;
mod vtsnn_random;
