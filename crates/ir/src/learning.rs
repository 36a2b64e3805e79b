//! Learning rules of plastic projections, whose weights change while a network runs.
//!
//! Time is divided into epochs of E steps. The delivery of step s > 0 *notes* the sources of its
//! messages: inputs of step s, compartments that spiked in step s - 1. Where s is a multiple of E,
//! each weight then changes, depending on whether its source and target were noted in the epoch.
//! Then notes are cleared. New weights act from the delivery of step s + 1 on.

use std::fmt::Debug;

/// The most steps of an epoch.
pub const LONGEST_EPOCH: u32 = 63;

/// The rule of all plastic synapses of a network.
pub trait LearningRule: Debug + Send + Sync {
    /// Steps of an epoch, 1 to [`LONGEST_EPOCH`].
    fn epoch(&self) -> u32;
    /// The weight after an epoch, in which messages of the source (`pre`) and of the target
    /// (`post`) were noted or not. It is rounded toward 0 to a weight of the synapse's format.
    fn learn(&self, weight: i16, pre: bool, post: bool) -> i16;
}
