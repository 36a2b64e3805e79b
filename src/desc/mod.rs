//! What files say, as they say it: mirrors of networks, targets, mappings and stimuli.
//!
//! Values here are parsed and know where they stood in their file, so that any later stage can point at them. Whether
//! they make sense together is for `compile::frontend::lower` to find out.

pub mod dataset;
mod lists;
pub mod mapping;
pub mod network;
pub mod neurons;
pub mod published;
pub mod resource;
pub mod spanned;
pub mod stimulus;
pub mod synapses;
pub mod target;
pub mod tensor;
pub mod training;
