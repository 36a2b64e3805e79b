//! The resources of a core: what each is called, and how much of each a core has.
//!
//! - `table`: the resources, and a table by [`Resource`] of anything.
//! - `limits`: how much of each a core has, and the pools that resources share.

mod limits;
mod table;

pub use self::limits::{Capacity, LimitChanges, Limits, OutputAxons, Packing, Pool};
pub use self::table::{PerResource, Resource};
