//! Networks in real numbers -> integers, searched on samples.

pub mod search;
