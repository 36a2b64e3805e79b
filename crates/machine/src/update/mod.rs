//! The update of compartments, sixteen at a time.

pub mod kernel;
pub(crate) mod state;
#[cfg(target_arch = "x86_64")]
pub(crate) mod vectors;
pub mod width;
