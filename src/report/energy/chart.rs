//! A chart of where the energy of a timestep goes.

use super::table::EnergyReport;
use crate::report::charts::results;

impl EnergyReport {
    /// Where the energy of a timestep goes: all of it, and the dynamic part of the neuron cores. `None` without timesteps.
    #[must_use]
    pub fn svg(&self) -> Option<String> {
        results::energy(&self.json())
    }
}
