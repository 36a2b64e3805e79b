//! A program laid out for the processor: the image that a run only reads.
//!
//! - `image`, `shard`: compartments in lanes, and all that a run reads of them.
//! - `flatten`: synapses from the tables of cores, by source.
//! - `planner`, `delivery_cost`: the form of each source's synapses.
//! - `weight_rows`, `dense_blocks`, `lists`, `padded_runs`: the four forms.
//! - `fan_out`: all forms of a source together.
//! - `plastic`: targets of plastic synapses; their weights are in the state of a shard.
//! - `residual`: synaptic events that are counted at the end of a run instead of in steps.

pub mod delivery_cost;
pub(crate) mod dense_blocks;
pub(crate) mod fan_out;
pub(crate) mod flatten;
pub mod image;
pub(crate) mod lists;
pub(crate) mod padded_runs;
pub(crate) mod planner;
pub(crate) mod plastic;
pub(crate) mod residual;
pub(crate) mod shard;
pub(crate) mod weight_rows;
