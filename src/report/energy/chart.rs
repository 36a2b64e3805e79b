//! A chart of all hardware of the table.

use super::table::EnergyReport;
use crate::report::charts::results;

impl EnergyReport {
    /// Power, time and energy of a timestep on all hardware. `None` without timesteps.
    #[must_use]
    pub fn svg(&self) -> Option<String> {
        results::hardware(&self.json())
    }
}
