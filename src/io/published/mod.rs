//! Readers of files that hold what others published: tables of measurements, the jobs that they
//! measured, workloads rebuilt, and the evidence for constants.

pub mod evidence;
pub mod measurement;
pub mod scenario;
pub mod workload;
