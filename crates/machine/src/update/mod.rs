//! The update of compartments, sixteen at a time.
//!
//! - `step`: a step of a shard, in the form of its sums and of what its spikes carry.
//! - `state`: the state of a shard, which blocks a step updates and which it skips.
//! - `kernel`, `vectors`: the update of a chunk of Loihi 1's compartments; other kinds are in
//!   [`nsim_dynamics::kinds`].
//! - `width`: the widest vectors of the processor.

pub mod kernel;
pub(crate) mod state;
pub(crate) mod step;
#[cfg(target_arch = "x86_64")]
pub(crate) mod vectors;
pub mod width;
