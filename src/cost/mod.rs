//! What a run costs: energy, time and power from counts.
//!
//! Input: the counts of each timestep ([`crate::ir::activity`]), a target's constants, and how many cores are in use
//! and powered. Output: energy in whole femtojoules and time in whole picoseconds, and from them the rows of the report.
//! Sums are exact, so no order of adding changes them. The equations are numbered in `docs/energy.md`.
//!
//! Not modelled: temperature, voltage and the measurement chain, which the sources do not separate; the host, except
//! the time of injecting and reading out spikes.

pub mod baseline;
pub mod calibrate;
pub mod constants;
pub mod deployment;
pub mod estimate;
pub mod evidence;
pub mod meter;
pub mod model;
pub mod quantiles;
pub mod transport;

pub use constants::CostTable;
pub use deployment::Deployment;
pub use meter::{MeterSettings, StepMeter, StepPrice};
pub use transport::{MessageRoutes, Transport};
