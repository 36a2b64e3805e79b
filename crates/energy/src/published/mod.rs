//! Files that hold what others published: figures of other hardware, tables of measurements, the
//! jobs measured, workloads rebuilt.

pub mod baseline;
pub mod measurement;
pub mod scenario;
pub mod workload;
