//! Networks in real numbers -> integers, searched on samples.

pub mod calibration;
mod copies;
pub mod model_file;
mod rounding;
pub mod search;
pub mod staged;
