//! Ratios to other hardware, and the cost of a sample and of a decision.
//!
//! Energy here is physical, power times time, for every convention of the table.

use std::fmt::Write;

use serde::Serialize;

use nsim_cost::estimate::{EnergyRow, FigureSource, RowUnit};
use nsim_files::table::{table, three, wrapped};

/// Other hardware over the simulated chip: above 1, the chip needs less.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Ratio {
    /// The other hardware.
    pub hardware: String,
    /// Ratio of total power.
    pub total_mw: f64,
    /// Ratio of the time of a timestep.
    pub latency_us: f64,
    /// Ratio of energy.
    pub energy_uj: f64,
    /// Ratio of the energy-delay product.
    pub edp_pjs: f64,
}

/// Time and energy of one sample on one piece of hardware.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PerSample {
    /// Name of the hardware, as in the energy table.
    pub hardware: String,
    /// Time from its first timestep to its last, us.
    pub time_us: f64,
    /// Energy with all power included, uJ.
    pub energy_uj: f64,
}

/// Time and energy until a sample is decided, on the simulated chip.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PerDecision {
    /// The chip.
    pub hardware: String,
    /// The rule that decides it.
    pub rule: String,
    /// Mean time of a sample until its decision, us.
    pub time_us: f64,
    /// Mean energy of one copy until the decision, all power included, uJ.
    pub energy_uj: f64,
    /// Share of the samples that were decided before their end.
    pub early: f64,
    /// Share of samples whose class at the decision is their label; `None` unless all have one.
    pub accuracy: Option<f64>,
    /// Median step of the early decisions, from 0.
    pub median_step: Option<u32>,
    /// Length of a timestep of the sample, ms.
    #[serde(skip)]
    pub timestep_ms: f64,
}

/// Power times time of a row in uJ.
fn energy(row: &EnergyRow) -> Option<f64> {
    Some(row.total_mw? * row.latency_us? / 1e3)
}

/// Returns the ratios of other rows to the chip's total; none to a row whose power is assumed.
pub fn ratios(chip: &EnergyRow, others: &[(EnergyRow, String)]) -> Vec<Ratio> {
    let of = |other: &EnergyRow| {
        let over = |this: Option<f64>, that: Option<f64>| Some(that? / this.filter(|this| *this > 0.0)?);
        // A ratio to an assumed power would be an assumption.
        if other.power_source == FigureSource::Assumed {
            return None;
        }
        let latency_us = over(chip.latency_us, other.latency_us)?;
        let energy_uj = over(energy(chip), energy(other))?;
        Some(Ratio {
            hardware: other.hardware.clone(),
            total_mw: over(chip.total_mw, other.total_mw)?,
            latency_us,
            energy_uj,
            edp_pjs: energy_uj * latency_us,
        })
    };
    others.iter().filter_map(|(other, _)| of(other)).collect()
}

/// Returns the cost of a sample of `steps` timesteps on each row's hardware.
pub fn per_sample<'r>(rows: impl Iterator<Item = &'r EnergyRow>, steps: f64) -> Vec<PerSample> {
    let of = |row: &EnergyRow| {
        Some(PerSample {
            hardware: row.hardware.clone(),
            time_us: row.latency_us? * steps,
            energy_uj: energy(row)? * steps,
        })
    };
    rows.filter(|row| row.unit == RowUnit::Total).filter_map(of).collect()
}

/// Comparison with other hardware.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// Other hardware over the chip.
    pub ratios: Vec<Ratio>,
    /// Time and energy of a sample.
    pub per_sample: Vec<PerSample>,
    /// Time and energy of a decision.
    pub per_decision: Option<PerDecision>,
}

impl Comparison {
    /// Text with the shares of right samples, decided and at their end, and the cost of a decision.
    pub(super) fn decisions(&self, whole: Option<f64>) -> String {
        let Some(decision) = &self.per_decision else { return String::new() };
        let right = decision.accuracy.zip(whole);
        let right = right.map(|(then, end)| format!("Right when decided: {then:.3} ({end:.3} at the end)"));
        // A decision falls at the end of its step.
        let after = |step: u32| {
            let ms = (f64::from(step) + 1.0) * decision.timestep_ms;
            format!(
                "{} ms of the sample (step {step} from 0)",
                if ms.fract() == 0.0 { format!("{ms}") } else { three(ms) }
            )
        };
        let step = decision.median_step.map(|step| format!("median after {}", after(step)));
        let energy = Some(format!("{} uJ per decision", three(decision.energy_uj)));
        let said: Vec<String> = right.into_iter().chain(step).chain(energy).collect();
        said.join("; ") + "."
    }

    /// Text with tables.
    pub(super) fn text(&self, accuracy: Option<f64>) -> String {
        let mut out = String::new();
        if !self.ratios.is_empty() {
            let row = |ratio: &Ratio| {
                let times = |x: f64| format!("{} x", three(x));
                let ratios = [ratio.total_mw, ratio.latency_us, ratio.energy_uj, ratio.edp_pjs].map(times);
                std::iter::once(ratio.hardware.clone()).chain(ratios).collect()
            };
            let rows: Vec<Vec<String>> = self.ratios.iter().map(row).collect();
            let header = ["Over the chip's", "Power", "Latency", "Energy", "EDP"];
            let _ = writeln!(out, "Other hardware, physical:\n{}", table(&header, &rows));
        }
        if !self.per_sample.is_empty() {
            let row = |name: String, time_us: f64, energy_uj: f64| vec![name, three(time_us / 1e3), three(energy_uj)];
            let samples = self.per_sample.iter().map(|on| row(on.hardware.clone(), on.time_us, on.energy_uj));
            let decided = self.per_decision.iter().map(|decision| {
                row(
                    format!("{}, until decided ({})", decision.hardware, decision.rule),
                    decision.time_us,
                    decision.energy_uj,
                )
            });
            let rows: Vec<Vec<String>> = samples.chain(decided).collect();
            out += &table(&["One sample on", "Time (ms)", "Energy (uJ)"], &rows);
            if let Some(decision) = &self.per_decision {
                out += &wrapped(&format!(
                    "{:.1} % of the samples are decided before their end. {} Times are on the chip; with --mode \
                     realtime they follow the sensor.",
                    100.0 * decision.early,
                    self.decisions(accuracy)
                ));
            }
            out.push('\n');
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_cost::estimate::Convention;

    fn row(hardware: &str, total_mw: f64, latency_us: f64) -> EnergyRow {
        let (powers, published) = ((0.0, Some(total_mw)), FigureSource::Published);
        let row =
            EnergyRow::new(hardware, RowUnit::Total, Convention::Published, powers, Some(latency_us), published, None);
        EnergyRow { energy_uj: Some(1.0), edp_pjs: Some(1.0), ..row }
    }

    #[test]
    fn ratios_are_physical_whatever_the_convention() {
        // VT-SNN in real time: 61930 mW and 1045.6 us against 32.3 mW and 1039.9 us.
        let found = ratios(&row("loihi", 32.3, 1039.9), &[(row("gpu", 61_930.0, 1045.6), String::new())]);
        assert_eq!(found.len(), 1);
        assert!((found[0].total_mw - 1917.3).abs() < 0.1 && (found[0].energy_uj - 1927.8).abs() < 0.1, "{found:?}");
        let unknown = EnergyRow { latency_us: None, ..row("x", 1.0, 1.0) };
        assert!(ratios(&row("loihi", 1.0, 1.0), &[(unknown, String::new())]).is_empty());
        assert!(ratios(&row("loihi", 0.0, 1.0), &[(row("x", 1.0, 1.0), String::new())]).is_empty());
    }

    #[test]
    fn a_sample_costs_its_steps() {
        let rows = [row("loihi", 33.7, 231.0), EnergyRow { unit: RowUnit::X86, ..row("loihi", 1.0, 231.0) }];
        let found = per_sample(rows.iter(), 150.0);
        assert_eq!(found.len(), 1);
        assert!(
            (found[0].time_us - 34_650.0).abs() < 1e-6 && (found[0].energy_uj - 1167.705).abs() < 1e-6,
            "{found:?}"
        );
    }
}
