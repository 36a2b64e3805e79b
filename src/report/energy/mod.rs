//! The results of `nsim energy`: the table with its breakdown, what it compares with, its chart, and calibrations.

pub mod calibration;
mod chart;
pub mod compared;
mod format;
pub mod table;
