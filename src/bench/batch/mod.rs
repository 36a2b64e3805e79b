//! Samples beside each other on a GPU, in the chip's integers.
//!
//! Input: a network in integers and samples. Output: which compartments spiked in which step of which sample, bit for bit
//! what the machine gives. The network is one list of synapses by target, random, convolved and dense ones alike: a
//! compartment of a sample is one invocation, so that nothing is added by two at once and no order matters. All of the
//! window's spikes stay on the device, a bit a sample. Every step visits every synapse: nothing at rest is left out.
//!
//! Refused: arithmetics other than the chip's, and what is larger than the device allows. Feature `gpu`.

pub mod device;
pub mod form;

pub use device::{Batches, Gpu};
pub use form::{BatchForm, Trains};
