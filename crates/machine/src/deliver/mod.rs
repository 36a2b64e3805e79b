//! Delivery of spikes: sums of weights by lane and step of arrival.
//!
//! - `delivery`: delivery of a step's spikes, form by form.
//! - `blocks`, `rows`, `lists`: the loops over dense blocks, rows of weights, lists of synapses.
//! - `plastic`: the loop over synapses whose weights are state.
//! - `accumulate`: the contribution of one spike, the weight or weight times payload.
//! - `delay_ring`: the sums of arrivals.

pub(crate) mod accumulate;
pub(crate) mod blocks;
pub(crate) mod delay_ring;
pub(crate) mod delivery;
pub(crate) mod lists;
pub(crate) mod plastic;
pub(crate) mod rows;
