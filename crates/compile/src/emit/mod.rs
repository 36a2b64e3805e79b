//! A program written out: routes, axon tables, synapse words.

pub mod boxes;
pub mod classes;
pub mod route;
#[cfg(test)]
pub(crate) mod testing;
