//! Files of nsim's own: models, targets, mappings, arrays, data sets, and the writing of results.
//!
//! Values here are parsed and know where they stood in their file, so that any later stage can
//! point at them. Whether they make sense together is for [`lower`] to find out. Nothing here
//! trusts a size that a file claims: a header is checked against the bytes that are there before
//! anything is allocated for it.

pub mod budget;
pub mod changes;
pub mod dataset;
pub mod disk;
pub mod element;
pub mod lower;
pub mod mapping;
pub mod network;
pub mod npy;
mod numbers;
pub mod safetensors;
pub mod shipped;
pub mod steps;
pub mod synapses;
pub mod table;
pub mod target;
pub mod text;
pub mod training;
pub mod write;
