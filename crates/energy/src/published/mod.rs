//! Files of published data: other hardware, measurements, measured jobs, rebuilt workloads.

pub mod baseline;
pub mod measurement;
pub mod scenario;
pub mod workload;
