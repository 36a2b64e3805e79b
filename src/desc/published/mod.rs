//! Mirrors of files that hold what others published: figures of other hardware, tables of measurements, the jobs measured.

pub mod baseline;
pub mod measurement;
pub mod scenario;
