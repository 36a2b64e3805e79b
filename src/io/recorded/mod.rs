//! What a run recorded, as files: registers that were probed, and a row for each timestep.

pub mod column;
#[cfg(feature = "parquet")]
mod parquet;
pub mod probes;
pub mod steps;
