//! Networks in real numbers -> integers, searched on samples.

pub mod calibration;
pub mod search;
