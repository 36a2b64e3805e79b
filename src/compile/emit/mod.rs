//! A program written out: routes, axon tables, synapse words.

pub mod memory;
pub mod route;
pub mod sample;
