//! One program run by several processes.
//!
//! - `transport`: the messages between processes, for any carrier.
//! - `exchange`: spikes of a step, to the ranks with axons of their sources.
//! - `threads`: ranks that are threads of one process, for tests.
//! - `mpi`: ranks of an MPI job, with the feature of that name.

pub mod exchange;
#[cfg(feature = "mpi")]
pub mod mpi;
pub mod threads;
pub mod transport;
