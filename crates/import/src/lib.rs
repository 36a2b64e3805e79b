//! Files of other tools: detection of kinds, models, checkpoints, spikes and recordings of event
//! cameras.
//!
//! Input: arguments and paths. Output: a model or spikes, or a
//! [`nsim_ir::base::diagnostic::Diagnostic`] that names the file and the place. [`kind`] detects
//! the kind of a file by its content. No size that a file claims is trusted.

pub mod draws;
pub mod foreign;
pub mod fuzz_entry;
pub mod hdf5;
mod hdf5_links;
pub mod kind;
pub mod model;
pub mod probes;
pub mod spikes;
