//! Readers and writers of files: what users hand over becomes a mirror of [`crate::desc`] or plain events.
//!
//! Comes in: arguments and paths. Goes out: values of `desc`, or a [`crate::base::diagnostic::Diagnostic`] that names the
//! file and the place. Nothing here trusts a size that a file claims: a header is checked against the bytes that are
//! there before anything is allocated for it. Whether a network or a stimulus makes sense is for later stages to say.

pub mod dataset;
pub mod draft;
pub mod event_csv;
pub mod events;
pub mod foreign;
pub mod half;
pub mod mapping;
pub mod measurement;
pub mod model;
pub mod npy;
pub mod safetensors;
pub mod shipped;
pub mod stimulus;
pub mod target;
pub mod text;
pub mod trace;
pub mod write;
