//! Charts and pictures as SVG.

pub mod board;
pub mod plot;
pub mod raster;
