//! What a run recorded, as files: a row for each timestep, and columns.

pub mod column;
pub mod steps;
