//! The update of compartments, sixteen at a time.
//!
//! - `state`: a step of a shard, which blocks it updates and which it skips.
//! - `kernel`, `vectors`: the update of a chunk of Loihi 1's compartments; other kinds are in
//!   [`nsim_dynamics::kinds`].
//! - `width`: the widest vectors of the processor.

pub mod kernel;
pub(crate) mod state;
#[cfg(target_arch = "x86_64")]
pub(crate) mod vectors;
pub mod width;
