//! Compartments updated, sixteen at a time.

pub mod kernel;
pub(crate) mod lanes;
#[cfg(target_arch = "x86_64")]
pub(crate) mod vectors;
