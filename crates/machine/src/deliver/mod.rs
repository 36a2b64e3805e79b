//! Delivery of spikes: sums of weights by lane and step of arrival.
//!
//! - `delay_ring`: the loops over dense blocks and lists, and the sums that they add to.
//! - `rows`: the loops over rows of weights.
//! - `accumulate`: what one spike adds, the weight or weight times payload.
//! - `exchange`: the spikes of all shards in one list, before they are delivered.
//! - `sums`: the sums of a compartment, and where they lie.
//! - `prefetch`: cache lines of lists to come.

pub(crate) mod accumulate;
pub(crate) mod delay_ring;
pub(crate) mod exchange;
pub(crate) mod prefetch;
pub(crate) mod rows;
pub(crate) mod sums;
