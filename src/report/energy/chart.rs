//! A chart of where the energy of a timestep goes.

use super::compared::energy;
use super::format::short;
use super::table::EnergyReport;
use crate::report::charts::plot::{self, Axis};

impl EnergyReport {
    /// Where the energy of a timestep goes: all of it, and the dynamic part of the neuron cores. `None` without timesteps.
    #[must_use]
    pub fn svg(&self) -> Option<String> {
        let parts = self.estimate.breakdown_pj.as_ref()?;
        let row = |unit: &str| self.estimate.rows.iter().find(|row| row.unit == unit);
        let (x86, neuron) = (row("x86")?, row("neuron")?);
        let powers = [
            ("x86 static", x86.static_mw?),
            ("x86 busy", x86.dynamic_mw?),
            ("neuron static", neuron.static_mw?),
            ("neuron dynamic", neuron.dynamic_mw?),
        ];
        let share = |value: f64, total: f64| if total > 0.0 { 100.0 * value / total } else { 0.0 };
        let (all, dynamic): (f64, f64) = (powers.iter().map(|(_, mw)| mw).sum(), parts.iter().map(|(_, pj)| pj).sum());
        let mut series: Vec<(String, Vec<f64>)> =
            powers.iter().map(|(name, mw)| ((*name).to_string(), vec![share(*mw, all), 0.0])).collect();
        for (name, pj) in parts.iter().filter(|(_, pj)| *pj > 0.0) {
            series.push((name.replace('_', " "), vec![0.0, share(*pj, dynamic)]));
        }
        let title = format!("{} on {}: where the energy of a timestep goes", self.model, self.target);
        let total = |name: &str, uj: f64| format!("{name}: {} uJ", short(uj));
        let whole = energy(row("total")?)?;
        let categories = [total("all", whole), total("neuron dynamic", dynamic / 1e6)];
        Some(plot::stacked(&title, &Axis::linear("share (%)"), &categories, &series))
    }
}
