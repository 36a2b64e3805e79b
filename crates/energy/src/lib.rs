//! Cost of a mapped network: from a program and samples to a finished report.
//!
//! Input: a mapped network, samples, options of deployment and cost. Output: the run and its
//! [`evaluate::Evaluation`] report. [`options`] interprets deployments, presets and baselines,
//! [`workload`] runs, [`job`] makes the report. Errors: a deployment or preset that does not fit
//! the job. The command line and the Python module both use this crate.

pub mod baseline;
pub mod cpu;
pub mod environment;
pub mod evaluate;
pub mod gpu;
pub mod job;
pub mod measure;
pub mod options;
pub mod other_hardware;
pub mod paper;
pub mod power;
pub mod published;
pub mod report;
pub mod sanafe;
#[cfg(test)]
mod tests;
pub mod workload;
