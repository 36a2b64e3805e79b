//! Where and why two networks disagree.
//!
//! Input: a network as it was trained, what it became, samples. Output: how far spikes and
//! potentials differ layer by layer ([`trace`], [`metrics`]), which of the steps from real numbers
//! to the machine is to blame ([`ladder`], [`attribution`]).
//!
//! Results do not depend on threads: samples are taken in parallel, their sums added in the order
//! of the run.

pub mod attribution;
pub mod causes;
pub mod classes;
pub mod compare;
pub mod ladder;
mod links;
pub mod metrics;
pub mod pipeline;
mod state;
pub mod stress;
pub mod trace;
