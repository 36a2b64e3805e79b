//! What a run recorded, as files: a row for each timestep, and columns.

pub mod column;
#[cfg(feature = "parquet")]
pub mod parquet;
pub mod steps;
