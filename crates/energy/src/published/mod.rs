//! Files of published data: figures of other hardware, tables of measurements, measured jobs,
//! rebuilt workloads.

pub mod baseline;
pub mod measurement;
pub mod scenario;
pub mod workload;
