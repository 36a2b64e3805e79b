//! What a mapped network costs: from a program and samples to a finished report.
//!
//! Input: a mapped network, samples, how it is deployed and priced. Output: the run and its [`evaluate::Evaluated`] report.
//! [`options`] says what deployments, presets and baselines stand for, [`workload`] runs, [`job`] makes the report. Errors: a
//! deployment or preset that does not fit the job. The command line and the Python module both work through this room, so that they
//! cannot differ in a figure.

pub mod evaluate;
pub mod job;
pub mod options;
pub mod other_hardware;
pub mod page;
pub mod paper;
pub mod workload;
