//! The process around a command: its log, progress, threads, ranks, signals and panics.
//!
//! However a command ends, the exit status is 0 to 4, or 130 and 143 for SIGINT and SIGTERM, and
//! each written file is absent, old or complete.

pub mod advice;
pub mod log;
pub mod panics;
pub mod progress;
pub mod ranks;
pub mod signals;
pub mod threads;
