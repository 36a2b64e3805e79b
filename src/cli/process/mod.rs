//! The process around a command: its log, its threads, signals, and what becomes of a panic.
//!
//! However a command ends, the exit status is 0 to 4, or 130 and 143 for SIGINT and SIGTERM, and
//! what was being written is absent, old or complete.

pub mod advice;
pub mod log;
pub mod panics;
pub mod ranks;
pub mod signals;
pub mod threads;
