//! The results of `nsim energy`: the table with its breakdown, what it compares with, and its
//! chart.

mod chart;
pub mod compared;
mod format;
pub mod table;
