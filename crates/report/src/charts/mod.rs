//! Charts and pictures as SVG.

pub mod board;
pub mod picture;
pub mod plot;
pub mod raster;
pub mod results;
pub mod sample;
