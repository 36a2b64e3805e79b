//! Spikes on their way: sums by compartment and arrival step.

pub(crate) mod delay_ring;
pub(crate) mod prefetch;
