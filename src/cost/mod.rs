//! What a run costs: energy, time and power from counts.
//!
//! Goes in: the counts of each timestep ([`crate::ir::activity`]), a target's constants, and how many cores are in use
//! and powered. Comes out: energy in whole femtojoules and time in whole picoseconds, exact sums whatever the order, and
//! from them the rows of the report. The equations are numbered in `docs/energy.md`.
//!
//! Left out on purpose: temperature, voltage and the measurement chain, none of which the sources let one separate;
//! the host, but for the time that it takes to inject and to read out spikes.

pub mod baseline;
pub mod calibrate;
pub mod constants;
pub mod deployment;
pub mod estimate;
pub mod meter;
pub mod model;
pub mod transport;

pub use constants::CostTable;
pub use deployment::Deployment;
pub use meter::{Metered, StepMeter};
pub use transport::{Transport, Ways};
