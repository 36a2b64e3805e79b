//! Intervals of rows, from errors of classes over published works or from bounds of constants.

use crate::estimate_input::EstimateInput;
use crate::job::{Accounting, Convention, Mode};
use crate::meter::Lane;
use crate::row::{Bound, EnergyRow, RowUnit};
use nsim_ir::hardware::constants::FigureClass;

/// A part of a row's power, and the error factor of its class.
type Part = (f64, Option<f64>);

/// Logarithm of a sum's error factor: root of the summed squares of its parts, weighted by share.
fn log_factor(parts: &[Part]) -> Option<f64> {
    let total: f64 = parts.iter().map(|(power, _)| power).sum();
    let squares = parts.iter().filter(|(power, _)| *power > 0.0).map(|&(power, factor)| {
        let share = power / total;
        Some((share * factor?.ln()).powi(2))
    });
    Some(squares.sum::<Option<f64>>()?.sqrt())
}

impl EstimateInput<'_> {
    fn within(&self, class: FigureClass) -> Option<f64> {
        self.errors.iter().find(|error| error.class == class).map(|error| error.within_80)
    }

    /// Sets the intervals of the rows from the corners of the preset's bounds.
    pub(crate) fn corner_bounds(&self, rows: &mut [EnergyRow], [slow, fast]: [usize; 2]) {
        let per_step = |time: u128| time as f64 / 1e6 / self.activity.steps().max(1) as f64;
        let free = |table: usize| per_step(self.lane(table).whole.time);
        let latency_us = per_step(self.time(&self.lane(self.preset).whole));
        // What the work of a step may take longer is added to a paced step, as in `bounds`.
        let longest = latency_us + free(slow) - free(self.preset);
        let shortest = per_step(self.time(&self.lane(fast).whole)).min(latency_us);
        let corner = |table: usize, us: f64| {
            let time = (us * 1e6 * self.activity.steps() as f64).round() as u128;
            let job = self.job_in_time(&self.meter.tables()[table], self.activity.steps(), time);
            self.rows(&job, (us > 0.0).then_some(us))
        };
        // Energy is least with the least powers, energies and times; power with the greatest times.
        let [lows, highs] =
            [(slow, longest, shortest), (fast, shortest, longest)].map(|(table, of_power, of_energy)| {
                let bound = |(power, energy): (EnergyRow, EnergyRow)| Bound {
                    total_mw: power.total_mw,
                    latency_us: energy.latency_us,
                    energy_uj: energy.energy_uj,
                    edp_pjs: energy.edp_pjs,
                };
                corner(table, of_power).into_iter().zip(corner(table, of_energy)).map(bound).collect::<Vec<_>>()
            });
        for ((row, low), high) in rows.iter_mut().zip(lows).zip(highs) {
            (row.low, row.high) = (Some(low), Some(high));
        }
    }

    /// Sets the intervals of the rows from the errors of classes.
    pub(crate) fn bounds(&self, rows: &mut [EnergyRow], lane: &Lane) {
        let free_us = lane.whole.time as f64 / 1e6 / lane.whole.steps.max(1) as f64;
        let latency_us = self.latency_us(&lane.whole).unwrap_or(free_us);
        let time = self.within(FigureClass::Time);
        // A paced step is at least as long as its timestep.
        let is_paced = self.mode == Mode::Realtime && latency_us > free_us;
        let least = if self.mode == Mode::Realtime { self.meter.settings().timestep.microseconds() } else { 0.0 };
        let ends = time.map(|factor| {
            let low = (free_us / factor).max(least).min(latency_us);
            // Longer work is added to a paced step: its overlap with the host's clock is unknown.
            (low, latency_us + free_us * (factor - 1.0))
        });
        let events = if is_paced { FigureClass::CoreEnergy } else { FigureClass::CoreDynamic };
        let factors = self.power_factors(rows, events);
        let low_time = ends.map(|(low, _)| (latency_us / low).ln());
        let high_time = ends.map(|(_, high)| (high / latency_us).ln());
        for (row, power) in rows.iter_mut().zip(factors) {
            let (low, high) = (self.end(row, -1.0, power, low_time), self.end(row, 1.0, power, high_time));
            let any = low.total_mw.or(low.latency_us).is_some();
            (row.low, row.high) = (any.then_some(low), any.then_some(high));
        }
    }

    /// Logarithms of the error factors of the rows' powers; `events` is the class of core events.
    fn power_factors(&self, rows: &[EnergyRow], events: FigureClass) -> Vec<Option<f64>> {
        if self.accounting != Accounting::Profiler {
            let log_factor = |row: &EnergyRow| {
                let class = if row.unit == RowUnit::X86 { FigureClass::X86Rails } else { FigureClass::Rails };
                self.within(class).map(f64::ln)
            };
            return rows.iter().map(log_factor).collect();
        }
        let part = |power: Option<f64>, class| (power.unwrap_or(0.0), self.within(class));
        let (x86_static, x86) =
            (part(rows[0].static_mw, FigureClass::Static), part(rows[0].dynamic_mw, FigureClass::X86Dynamic));
        let (core_static, cores) = (part(rows[1].static_mw, FigureClass::Static), part(rows[1].dynamic_mw, events));
        // Both static powers follow from one constant and a ratio, so their errors are common.
        let both = (x86_static.0 + core_static.0, x86_static.1);
        vec![log_factor(&[x86_static, x86]), log_factor(&[core_static, cores]), log_factor(&[both, x86, cores])]
    }

    /// The end of a row's intervals above (`sign` 1) or below (-1), by logarithms of error factors.
    fn end(&self, row: &EnergyRow, sign: f64, power: Option<f64>, time: Option<f64>) -> Bound {
        let scaled = |figure: Option<f64>, log: Option<f64>| Some(figure? * (sign * log?).exp());
        // Energy is power times time; the paper's energy is power alone.
        let exponents = if self.convention == Convention::Physical { [1.0, 2.0] } else { [0.0, 1.0] };
        let [energy, edp] = exponents.map(|exponent| {
            let time = if exponent == 0.0 { 0.0 } else { exponent * time? };
            Some(power?.hypot(time))
        });
        Bound {
            total_mw: scaled(row.total_mw, power),
            latency_us: scaled(row.latency_us, time),
            energy_uj: scaled(row.energy_uj, energy),
            edp_pjs: scaled(row.edp_pjs, edp),
        }
    }
}
