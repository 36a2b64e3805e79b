//! Results as people and scripts read them: text, JSON, CSV.
//!
//! Input: finished results. Output: strings, which the command line writes. Figures are not changed
//! here except for the rounding of printed ones.

pub mod agree;
pub mod bench;
pub mod charts;
pub mod compare;
pub mod convert;
pub mod inspect;
pub mod map;
pub mod page;
pub mod run;
pub mod scene;
pub mod side_by_side;
pub mod stress;
pub mod sweep;
pub mod train;

/// Sources of samples: the arguments, and the seed of a scene.
fn origin(input: &[String], seed: Option<u64>) -> String {
    let seed = seed.map_or(String::new(), |seed| format!(" (seed {seed})"));
    input.join(" ") + &seed
}
