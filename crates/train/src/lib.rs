//! SLAYER: networks of dense spiking layers trained on labelled spikes (Shrestha, Orchard, NeurIPS
//! 2018).
//!
//! Input: a training file and labelled samples. Output: weights, and a model file that the rest of
//! nsim maps and runs. In the forward pass, SRM neurons compute in f32, Loihi compartments in the
//! machine's own integers with the weights as stored. A trained Loihi network thus decides as the
//! deployed one, spike by spike. In the backward pass, both use SLAYER's temporal credit assignment
//! and surrogate; rounding has a derivative of 1. Convolutions, recurrent projections and trained
//! delays are omitted on purpose.

pub mod augment;
pub mod cells;
pub mod checkpoint;
pub mod convert;
pub mod export;
pub mod fit;
pub mod job;
pub mod loihi2;
pub mod loss;
pub mod network;
pub mod optimiser;
pub mod plan;
pub mod raster;
pub mod surrogate;
pub mod trace;
