//! Networks in real numbers -> integers, searched on samples.

pub mod calibration;
pub mod deployed;
pub mod fine_tune;
pub mod job;
pub mod model_file;
pub mod next;
pub mod prepare;
pub mod resets;
pub mod search;
pub mod staged;
pub mod taps;
