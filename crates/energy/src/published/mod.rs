//! Mirrors of files that hold what others published: figures of other hardware, tables of
//! measurements, the jobs measured, workloads rebuilt, and the evidence for constants.

pub mod baseline;
pub mod files;
pub mod measurement;
pub mod scenario;
pub mod workload;
