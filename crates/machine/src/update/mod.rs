//! The update of compartments.
//!
//! - `step`: a step of a shard, compiled for its types of sums and payloads.
//! - `state`: the state of a shard, and the blocks that a step updates or skips.

pub(crate) mod state;
pub(crate) mod step;
