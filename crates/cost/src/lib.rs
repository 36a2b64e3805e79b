//! Cost of a run: energy, time and power from counts.
//!
//! Input: the counts of each timestep ([`nsim_ir::activity`]), a target's constants, and the cores
//! in use. Output: energy in whole femtojoules and time in whole picoseconds, and from them the
//! rows of the report. Sums are exact, so the order of addition does not change them. Equation
//! numbers refer to `docs/energy.md`.
//!
//! Not modelled: temperature, voltage and the measurement chain, which the sources do not separate.
//! Of the host, only work for each spike, step or value is modelled.

pub mod charged;
pub mod constants;
pub mod deployment;
pub mod estimate;
mod estimate_input;
mod intervals;
pub mod job;
pub mod meter;
pub mod model;
mod power;
pub mod quantiles;
mod row;
pub mod transport;

pub use constants::CostTable;
pub use deployment::{Deployment, Host, HostWork, Streams};
pub use meter::{MeterSettings, StepMeter, StepPrice};
pub use transport::{MessageRoutes, Timing, Transport};
