//! Readers and writers of files: what users hand over becomes a mirror of [`crate::desc`] or plain spikes.
//!
//! Input: arguments and paths. Output: values of `desc`, or a [`crate::base::diagnostic::Diagnostic`] that names the file
//! and the place. Nothing here trusts a size that a file claims: a header is checked against the bytes that are there
//! before anything is allocated for it. Whether a network or a stimulus makes sense is for later stages to say.

pub mod budget;
pub mod changes;
pub mod disk;
mod element;
pub mod foreign;
pub mod fuzz_entry;
pub mod kind;
pub mod mapping;
pub mod model;
pub mod model_builder;
pub mod npy;
pub mod published;
pub mod recorded;
pub mod safetensors;
pub mod shipped;
pub mod spikes;
pub mod target;
pub mod text;
pub mod write;
