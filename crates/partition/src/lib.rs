//! Assignment of compartments to cores: resource use of a core, and partitions within its limits.
//!
//! Input: a network in integers, a target, [`options::Options`]. Output: a `Partition`, or every
//! [`reason::Reason`] for which there is none. [`resources`] counts, [`strategy`] searches.

pub mod error;
pub mod large;
pub mod options;
pub mod reason;
pub mod resources;
pub mod strategy;
