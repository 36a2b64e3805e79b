//! Results as people and scripts read them: text, JSON, CSV.
//!
//! Goes in: finished results. Comes out: strings; writing them is the command line's. Nothing is computed here but the
//! rounding of what is printed.

pub mod bench;
pub mod energy;
pub mod map;
pub mod run;
