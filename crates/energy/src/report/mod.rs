//! The results of `nsim energy`: the table with its breakdown, and comparisons.

pub mod compared;
pub mod result;
mod table;
mod text;
