//! Results as people and scripts read them: text, JSON, CSV.
//!
//! Input: finished results. Output: strings; writing them is the command line's. Nothing is
//! computed here but the rounding of what is printed.

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

/// Where samples came from: what was typed, and the seed of a scene.
fn origin(input: &[String], seed: Option<u64>) -> String {
    let seed = seed.map_or(String::new(), |seed| format!(" (seed {seed})"));
    input.join(" ") + &seed
}
