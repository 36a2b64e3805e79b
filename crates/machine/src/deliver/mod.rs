//! Delivery of spikes: sums of weights by lane and step of arrival.

pub(crate) mod accumulate;
pub(crate) mod delay_ring;
pub(crate) mod exchange;
pub(crate) mod prefetch;
