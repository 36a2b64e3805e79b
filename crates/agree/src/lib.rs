//! Differences of two networks, and their causes.
//!
//! Input: a network as it was trained, its deployed form, samples. Output: differences of spikes
//! and potentials by layer ([`trace`], [`metrics`]), and the step from real numbers to the machine
//! that causes them ([`staged`], [`attribution`]).
//!
//! Results do not depend on the number of threads: samples run in parallel, and their sums are
//! added in the order of the run.

pub mod attribution;
pub mod causes;
pub mod classes;
pub mod compare;
mod links;
pub mod metrics;
pub mod pipeline;
pub mod recording;
pub mod staged;
mod state;
pub mod stress;
pub mod trace;
