//! A chart of all hardware of the energy table.

use nsim_energy::report::table::EnergyReport;

use crate::charts::results;

/// Power, time and energy of a timestep on all hardware. `None` without timesteps.
#[must_use]
pub fn svg(report: &EnergyReport) -> Option<String> {
    results::hardware(&report.json())
}
