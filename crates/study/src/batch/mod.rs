//! Samples beside each other on a GPU, in the chip's integers or in f32.
//!
//! Input: a network and samples. Output: which compartments spiked in which step of which sample:
//! in integers bit for bit what the machine gives, in f32 what the reference gives up to the
//! rounding of sums. The network is one list of synapses by target, random, convolved and dense
//! ones alike: a compartment of a sample is one invocation, so that nothing is added by two at once
//! and no order matters. All of the window's spikes stay on the device, a bit a sample. Every step
//! visits every synapse: nothing at rest is left out.
//!
//! Refused: integers other than the chip's, and what is larger than the device allows. Spike
//! response kernels are those without end. Feature `gpu`.

pub mod device;
pub mod form;

pub use device::{Batches, Gpu};
pub use form::{Arithmetic, BatchForm, Integers, Single, Trains};
