//! Files of nsim's own: models, targets, mappings, arrays, data sets, and the writing of results.
//!
//! Values are parsed with their place in the file, so any later stage can report it. [`lower`]
//! checks that they are consistent. No size that a file claims is trusted: a header is checked
//! against the bytes that are present before memory is allocated.

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
pub mod warnings;
pub mod write;
