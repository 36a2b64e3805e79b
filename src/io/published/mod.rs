//! Readers of files that hold what others published: tables of measurements, and the jobs that they measured.

pub mod measurement;
pub mod scenario;
