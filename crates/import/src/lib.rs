//! Files of other tools: what a file is, models, checkpoints, spikes and recordings of event
//! cameras.
//!
//! Input: arguments and paths. Output: a model or plain spikes, or a
//! [`nsim_ir::base::diagnostic::Diagnostic`] that names the file and the place. [`kind`] says what
//! a file is, by its content. Nothing here trusts a size that a file claims.

pub mod foreign;
pub mod fuzz_entry;
pub mod kind;
pub mod model;
pub mod probes;
pub mod spikes;
