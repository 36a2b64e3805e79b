//! A program laid out for the processor: the image that a run only reads.

pub mod delivery_cost;
pub(crate) mod dense_blocks;
pub(crate) mod fan_out;
pub(crate) mod flatten;
pub mod image;
pub(crate) mod lane_order;
pub(crate) mod lists;
pub(crate) mod padded_runs;
pub(crate) mod planner;
pub(crate) mod shard;
pub(crate) mod store;
pub(crate) mod weight_rows;
