//! The update of compartments, sixteen at a time.
//!
//! - `step`: a step of a shard, compiled for its types of sums and payloads.
//! - `state`: the state of a shard, and the blocks that a step updates or skips.
//! - `kernel`, `vectors`: the update of a chunk of Loihi 1's compartments; other kinds are in
//!   [`nsim_dynamics::kinds`].
//! - `width`: the widest vectors of the processor.

pub mod kernel;
pub(crate) mod state;
pub(crate) mod step;
#[cfg(target_arch = "x86_64")]
pub(crate) mod vectors;
pub mod width;
