//! The resources of a core: their names and their limits.
//!
//! - `table`: the resources, and tables indexed by [`Resource`].
//! - `limits`: the limit of each resource, and the pools that resources share.

mod limits;
mod table;

pub use self::limits::{Capacity, LimitChanges, Limits, NeuronSizes, OutputAxons, Packing, Pool};
pub use self::table::{PerResource, Resource};
