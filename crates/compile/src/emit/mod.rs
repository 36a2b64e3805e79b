//! Emission of a program: routes, axon tables, synapse words.

pub mod classes;
pub mod route;
pub mod tables;
#[cfg(test)]
pub(crate) mod testing;
pub mod windows;
