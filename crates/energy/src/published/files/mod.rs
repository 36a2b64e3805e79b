//! Readers of files that hold what others published: tables of measurements, the jobs that they
//! measured, and workloads rebuilt.

pub mod measurement;
pub mod scenario;
pub mod workload;
