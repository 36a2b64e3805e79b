//! Hostile input and generated command lines.

// A test that cannot continue has failed.
#![allow(clippy::unwrap_used)]

mod input;
mod lines;
#[path = "../common/torch.rs"]
mod torch;
