//! Compartments in lanes, sixteen at a time: what all parts of the machine are built on.
//!
//! - `lane_order`: the compartment of each lane; `sums`: the sums of each compartment.
//! - `kernel`, `vectors`: the update of a chunk of Loihi 1's compartments; other kinds are in
//!   [`nsim_dynamics::kinds`].
//! - `width`: the widest vectors of the processor.

pub mod kernel;
pub(crate) mod lane_order;
pub(crate) mod sums;
#[cfg(target_arch = "x86_64")]
pub(crate) mod vectors;
pub mod width;
