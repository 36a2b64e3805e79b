//! A program laid out for the processor: the image that a run only reads.
//!
//! - `image`, `shard`, `lane_order`: compartments in lanes; `sums`: the sums of each compartment.
//! - `flatten`: synapses from the tables of cores, by source.
//! - `planner`, `delivery_cost`: the form of each source's synapses.
//! - `weight_rows`, `dense_blocks`, `lists`, `padded_runs`: the four forms.
//! - `fan_out`: all forms of a source together.

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
pub(crate) mod sums;
pub(crate) mod weight_rows;
