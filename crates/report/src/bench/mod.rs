//! Results of `nsim bench`.

pub mod ladders;
pub mod mapping;
pub mod paper;
pub mod pareto;
pub mod published;
pub mod step;
