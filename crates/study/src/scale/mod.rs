//! What it takes to run a network on many machines: measured on one and two ranks, modelled beyond.
//!
//! - `measured`: time, exchange and memory of a step here.
//! - `model`: the same for any number of ranks and compartments on a network that is given.

pub mod measured;
pub mod model;
