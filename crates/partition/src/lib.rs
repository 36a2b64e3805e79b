//! Compartments onto cores: what a core uses, counted, and partitions that keep its limits.
//!
//! Input: a network in integers, a target, [`options::Options`]. Output: a `Partition`, or every
//! [`reason::Reason`] for which there is none. [`resources`] counts, [`strategy`] searches.

pub mod error;
pub mod large;
pub mod options;
pub mod reason;
pub mod resources;
pub mod strategy;
