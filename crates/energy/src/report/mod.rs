//! The results of `nsim energy`: the table with its breakdown, and what it compares with.

pub mod compared;
pub mod table;
