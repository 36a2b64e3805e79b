//! What a run costs: energy, time and power from counts.
//!
//! Goes in: the counts of each timestep ([`crate::ir::activity`]), a target's constants, and how many cores are in use
//! and powered. Comes out: energy in whole femtojoules and time in whole picoseconds, exact sums whatever the order, and
//! from them the rows of the report. The equations are numbered in `docs/energy.md`.
//!
//! Left out on purpose: temperature, voltage and the measurement chain, none of which the sources let one separate;
//! contention in the mesh (a message takes as long as an empty mesh lets it); the host.

pub mod baseline;
pub mod constants;
pub mod deployment;
pub mod estimate;
pub mod meter;
pub mod model;

pub use constants::CostTable;
pub use deployment::Deployment;
pub use meter::StepMeter;
