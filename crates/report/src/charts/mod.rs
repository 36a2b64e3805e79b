//! Charts and pictures as SVG.

pub mod board;
pub mod draw;
pub mod picture;
pub mod plot;
pub mod results;
pub mod sample;
pub mod weights;
