//! Delivery of spikes: sums of weights by lane and step of arrival.
//!
//! - `delivery`: what a step's spikes reach, form by form.
//! - `blocks`, `rows`, `lists`: the loops over dense blocks, rows of weights, lists of synapses.
//! - `plastic`: the loop over synapses whose weights are state.
//! - `accumulate`: what one spike adds, the weight or weight times payload.
//! - `delay_ring`: the sums that they add to.
//! - `prefetch`: cache lines of lists to come.

pub(crate) mod accumulate;
pub(crate) mod blocks;
pub(crate) mod delay_ring;
pub(crate) mod delivery;
pub(crate) mod lists;
pub(crate) mod plastic;
pub(crate) mod prefetch;
pub(crate) mod rows;
