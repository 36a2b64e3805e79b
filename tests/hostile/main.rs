//! Hostile input, faults while files are written, and generated command lines.

// A test that cannot go on has failed.
#![allow(clippy::unwrap_used)]

mod input;
mod lines;
mod writing;
