//! Arguments that several commands share, and what they stand for.

pub(super) mod columns;
pub mod conversion;
pub mod input;
pub mod jobs;
pub mod removed;
pub mod saved;
pub mod steps;
pub mod timestep;
pub mod values;
