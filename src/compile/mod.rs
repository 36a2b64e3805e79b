//! From a network to a program, one stage a line.

pub mod lower;
pub mod quantise;
