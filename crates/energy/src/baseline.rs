//! Rows of other hardware in the energy table, and the workloads for which they hold.
//!
//! A measured row holds for one network only; [`Baseline::row`] gives the reason for no row.

use crate::published::baseline::{BaselineFile, DenseLayer};
use nsim_cost::estimate::{Convention, EnergyRow, FigureSource, RowUnit};
use nsim_cost::job::Mode;
use nsim_files::shipped::{BASELINES, Shipped};
use nsim_ir::base::diagnostic::{Diagnostic, SourceText};
use nsim_ir::base::units::Picoseconds;
use nsim_ir::hardware::constants::Status;
use nsim_ir::pruned::ProjectionSize;
use nsim_ir::quantised::Quantised;
use nsim_ir::spanned::{Spanned, parse};

/// Sizes that decide whether two networks are the same workload for dense hardware.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NetworkShape {
    inputs: Vec<u32>,
    layers: Vec<DenseLayer>,
    /// Number of projections that are not all to all.
    others: usize,
}

impl NetworkShape {
    /// The shape of one copy of a network, as it was before any pruning.
    pub fn from_network(network: &Quantised) -> Self {
        let inputs = network.inputs().map(|(_, population)| population.shape.len());
        let before = network.sizes_before();
        let dense = before.projections.iter().filter(|projection| projection.dense);
        let layer = |of: &ProjectionSize| DenseLayer { from: before.units[of.source], to: before.units[of.target] };
        let layers: Vec<DenseLayer> = dense.map(layer).collect();
        let others = network.projections().len() - layers.len();
        NetworkShape::new(inputs.collect(), layers, others)
    }

    /// The shape with these sizes; their order does not matter.
    pub fn new(mut inputs: Vec<u32>, mut layers: Vec<DenseLayer>, others: usize) -> Self {
        inputs.sort_unstable();
        layers.sort_unstable();
        NetworkShape { inputs, layers, others }
    }
}

impl std::fmt::Display for NetworkShape {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let few = |items: Vec<String>| match items.len() {
            0 => "none".to_string(),
            n if n > 8 => format!("{} and {} more", items[..8].join(", "), n - 8),
            _ => items.join(", "),
        };
        let inputs = self.inputs.iter().map(u32::to_string).collect();
        let layers = self.layers.iter().map(|layer| format!("{} -> {}", layer.from, layer.to)).collect();
        write!(f, "inputs {}, dense layers {}", few(inputs), few(layers))?;
        if self.others > 0 {
            write!(f, ", {} other projections", self.others)?;
        }
        Ok(())
    }
}

/// Work of dense hardware for a window of one copy of a network.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Work {
    /// Sizes and synapses of each projection: (source, target, synapses).
    pub projections: Vec<(u32, u32, u64)>,
    /// Sizes of the populations of compartments: each is a layer.
    pub layers: Vec<u32>,
}

impl Work {
    /// The work of a network, as it was before any pruning.
    pub fn from_network(network: &Quantised) -> Self {
        let before = network.sizes_before();
        let size = |of: &ProjectionSize| (before.units[of.source], before.units[of.target], of.synapses);
        let layers =
            network.populations().enumerate().filter(|(_, population)| population.first_compartment().is_some());
        Work {
            projections: before.projections.iter().map(size).collect(),
            layers: layers.map(|(id, _)| before.units[id]).collect(),
        }
    }

    /// Seconds of a window at a peak rate and bandwidth, without overheads: equation (18).
    fn roofline_s(&self, steps: f64, gflops: f64, gb_s: f64) -> f64 {
        let bound = |operations: f64, bytes: f64| (operations / (gflops * 1e9)).max(bytes / (gb_s * 1e9));
        let products: f64 = self
            .projections
            .iter()
            .map(|&(from, to, synapses)| {
                let (from, to, synapses) = (f64::from(from), f64::from(to), synapses as f64);
                bound(2.0 * synapses * steps, 4.0 * (synapses + (from + to) * steps))
            })
            .sum();
        // Six operations a neuron and step: two decays, two sums, a comparison, a reset.
        let neurons: f64 =
            self.layers.iter().map(|&size| f64::from(size) * steps).map(|n| bound(6.0 * n, 8.0 * n)).sum();
        products + neurons
    }
}

/// Power and time of other hardware for one timestep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Figures {
    /// Power at idle, mW.
    pub static_mw: f64,
    /// Dynamic power, above idle, mW.
    pub dynamic_mw: f64,
    /// Time of a timestep, us.
    pub latency_us: f64,
    /// Source of the time.
    pub source: FigureSource,
    /// Source of the power.
    pub power_source: FigureSource,
}

impl Figures {
    /// Returns the figures in real time, by (19). With `window`, hardware waits for a whole window
    /// and then computes; else it computes each step as it arrives. Dynamic power is drawn during
    /// computation, or all the time unless the hardware falls idle.
    pub fn in_real_time(self, timestep_us: f64, window: bool, falls_idle: bool) -> Figures {
        let latency_us = if window { timestep_us + self.latency_us } else { timestep_us.max(self.latency_us) };
        let share = if falls_idle { self.latency_us / latency_us } else { 1.0 };
        Figures { latency_us, dynamic_mw: self.dynamic_mw * share, ..self }
    }

    /// Returns these figures as a row of the table.
    pub fn row(&self, hardware: &str, convention: Convention, steps: Option<u32>) -> EnergyRow {
        let powers = (self.static_mw, Some(self.dynamic_mw));
        let row =
            EnergyRow::new(hardware, RowUnit::Total, convention, powers, Some(self.latency_us), self.source, steps);
        EnergyRow { power_source: self.power_source, ..row }
    }
}

/// Conditions of a row of other hardware.
#[derive(Debug, Clone, Copy)]
pub struct RowConditions {
    /// Timesteps of a sample; `None` when samples differ.
    pub steps: Option<u32>,
    /// Length of a timestep.
    pub timestep: Picoseconds,
    /// As fast as possible, or paced by the timestep.
    pub mode: Mode,
    /// The definition of energy.
    pub convention: Convention,
}

/// A checked baseline.
#[derive(Debug, Clone)]
pub struct Baseline {
    file: BaselineFile,
    shape: NetworkShape,
}

impl Baseline {
    /// Returns a shipped baseline.
    ///
    /// # Errors
    /// A diagnostic when there is none of this name.
    pub fn shipped(name: &str) -> Result<Self, Diagnostic> {
        let unknown = || Diagnostic::new("baseline.unknown", format!("there is no baseline {name}"));
        Baseline::parse(&Shipped::find(BASELINES, name).ok_or_else(unknown)?.source())
    }

    /// Parses and checks a baseline file.
    ///
    /// # Errors
    /// A diagnostic where the file is malformed, a figure out of range, or a sum of powers wrong.
    pub fn parse(source: &SourceText) -> Result<Self, Diagnostic> {
        let file: BaselineFile = parse(source, "baseline.syntax")?;
        let wrong =
            |code, message: String, figure: &Spanned<f64>| Diagnostic::new(code, message).at(source, figure.span);
        for row in &file.rows {
            let powers = [&row.static_mw, &row.dynamic_mw, &row.total_mw];
            let others = [&row.latency_us, &row.printed_energy_uj, &row.printed_edp];
            let outside = |figure: &&Spanned<f64>| !(0.0..=1e15).contains(&figure.value);
            if let Some(figure) = powers.into_iter().chain(others).find(outside) {
                return Err(wrong("baseline.figure", format!("{} is outside 0..=10^15", figure.value), figure));
            }
            let sum = row.static_mw.value + row.dynamic_mw.value;
            // Printed figures are rounded; a hundredth is more than any rounding.
            if (sum - row.total_mw.value).abs() > 0.01 * row.total_mw.value {
                let message = format!("static and dynamic power add up to {sum} mW, not {}", row.total_mw.value);
                return Err(wrong("baseline.sum", message, &row.total_mw));
            }
        }
        for (name, figure) in file.roofline.iter().flat_map(crate::published::baseline::Roofline::list) {
            if !(figure.value.value > 0.0 && figure.value.value <= 1e15) || figure.source.trim().is_empty() {
                let message = format!("{name} {} is not within 0..=10^15, or names no source", figure.value.value);
                return Err(wrong("baseline.figure", message, &figure.value));
            }
        }
        let on = &file.measured_on;
        let shape = NetworkShape::new(on.inputs.clone(), on.layers.clone(), 0);
        Ok(Baseline { file, shape })
    }

    /// The parsed file.
    pub fn file(&self) -> &BaselineFile {
        &self.file
    }

    /// Source of its figures, and their method of measurement.
    pub fn source(&self) -> String {
        format!("{}. {}", self.file.source, self.file.notes)
    }

    /// Returns its row for a workload.
    ///
    /// # Errors
    /// The reason for no row: it was measured on another workload, or not in this mode.
    pub fn row(&self, shape: &NetworkShape, conditions: RowConditions) -> Result<EnergyRow, String> {
        let RowConditions { steps, timestep, mode, convention } = conditions;
        let on = &self.file.measured_on;
        let name = &self.file.name;
        if *shape != self.shape {
            return Err(format!("no row for {name}: it was measured on {}; this network has {shape}", self.shape));
        }
        if steps != Some(on.steps) || (timestep.microseconds() / 1e3 - on.timestep_ms).abs() > 1e-9 {
            let here =
                steps.map_or_else(|| "samples of different lengths".to_string(), |n| format!("samples of {n} steps"));
            return Err(format!(
                "no row for {name}: it was measured on samples of {} steps of {} ms; this run has {here} of {} ms",
                on.steps,
                on.timestep_ms,
                timestep.microseconds() / 1e3
            ));
        }
        let Some(row) = self.file.rows.iter().find(|row| row.mode == mode) else {
            return Err(format!("no row for {name}: it was not measured {}", mode.name()));
        };
        let (total, latency) = (row.total_mw.value, row.latency_us.value);
        let (energy, edp) = match convention {
            // (13) of docs/energy.md, from the printed power and latency.
            Convention::Physical => (total * latency / 1e3, total * latency / 1e3 * latency),
            Convention::Published => (row.printed_energy_uj.value, row.printed_edp.value),
        };
        let figures = Figures {
            static_mw: row.static_mw.value,
            dynamic_mw: row.dynamic_mw.value,
            latency_us: latency,
            source: self.status(),
            power_source: self.status(),
        };
        let (total_mw, energy_uj, edp_pjs) = (Some(total), Some(energy), Some(edp));
        let energy_source = match convention {
            Convention::Published => self.status(),
            Convention::Physical => FigureSource::Computed,
        };
        let row = figures.row(&self.file.hardware, convention, steps);
        Ok(EnergyRow { total_mw, energy_uj, edp_pjs, energy_source, ..row })
    }

    fn status(&self) -> FigureSource {
        match self.file.status {
            Status::Published => FigureSource::Published,
            Status::Calibrated => FigureSource::Modelled,
            Status::Assumed | Status::NotGiven => FigureSource::Assumed,
        }
    }

    /// Its row for another workload, by its roofline; `None` without one or for unequal samples.
    pub fn modelled(&self, work: &Work, conditions: RowConditions) -> Option<EnergyRow> {
        let RowConditions { steps, timestep, mode, convention } = conditions;
        let window = f64::from(steps.filter(|&steps| steps > 0)?);
        let whole = self.windows(work, window)?;
        let offline = Figures { latency_us: whole.latency_us / window, ..whole };
        // The measured card draws equal power while it waits for a window.
        let figures = match mode {
            Mode::Offline => offline,
            Mode::Realtime => offline.in_real_time(timestep.microseconds(), true, false),
        };
        Some(figures.row(&self.file.hardware, convention, steps))
    }

    /// Equation (18) for the timesteps of one pass; the latency is of the whole pass.
    fn windows(&self, work: &Work, timesteps: f64) -> Option<Figures> {
        let roofline = self.file.roofline.as_ref()?;
        let value = |figure: &crate::published::baseline::RooflineFigure| figure.value.value;
        let busy_us = 1e6 * work.roofline_s(timesteps, value(&roofline.peak_gflops), value(&roofline.bandwidth_gb_s));
        let latency_us = busy_us + value(&roofline.layer_overhead_us) * work.layers.len() as f64;
        let (idle, active) = (value(&roofline.idle_mw), value(&roofline.active_mw));
        let filled = (value(&roofline.peak_mw) - active).max(0.0) * busy_us / latency_us.max(f64::MIN_POSITIVE);
        Some(Figures {
            static_mw: idle,
            dynamic_mw: (active - idle).max(0.0) + filled,
            latency_us,
            source: FigureSource::Modelled,
            power_source: FigureSource::Modelled,
        })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn vtsnn() -> NetworkShape {
        let layer = |from, to| DenseLayer { from, to };
        NetworkShape::new(vec![3150, 156], vec![layer(50, 2), layer(156, 50), layer(10, 2), layer(3150, 10)], 0)
    }

    const MS: Picoseconds = Picoseconds(1_000_000_000);

    /// Offline and physical, in steps of a millisecond.
    fn offline(steps: Option<u32>) -> RowConditions {
        RowConditions { steps, timestep: MS, mode: Mode::Offline, convention: Convention::Physical }
    }

    #[test]
    fn the_gpu_row_is_printed_or_recomputed() {
        let gpu = Baseline::shipped("rtx-2080-ti").unwrap();
        let row = |mode, convention| {
            let conditions = RowConditions { steps: Some(150), timestep: MS, mode, convention };
            let row = gpu.row(&vtsnn(), conditions).unwrap();
            assert!(matches!(row.source, FigureSource::Published));
            (row.energy_uj.unwrap(), row.edp_pjs.unwrap())
        };
        assert_eq!(row(Mode::Offline, Convention::Published), (399.0, 8431.0));
        assert_eq!(row(Mode::Realtime, Convention::Published), (412.9, 431_708.0));
        // 59890 mW * 21 us, and that * 21 us; 61930 mW * 1045.6 us, and that * 1045.6 us.
        let near =
            |(energy, edp): (f64, f64), e: f64, d: f64| (energy / e - 1.0).abs() < 1e-9 && (edp / d - 1.0).abs() < 1e-9;
        assert!(near(row(Mode::Offline, Convention::Physical), 1257.69, 26_411.49));
        assert!(near(row(Mode::Realtime, Convention::Physical), 64_754.008, 67_706_790.764_8));
    }

    #[test]
    fn another_workload_gets_a_reason_instead_of_a_row() {
        let gpu = Baseline::shipped("rtx-2080-ti").unwrap();
        let reason = |shape: &NetworkShape, steps, timestep| {
            gpu.row(shape, RowConditions { timestep, ..offline(steps) }).unwrap_err()
        };
        let small = NetworkShape::new(vec![156], vec![DenseLayer { from: 156, to: 50 }], 1);
        assert_eq!(
            reason(&small, Some(150), MS),
            "no row for rtx-2080-ti: it was measured on inputs 156, 3150, dense layers 10 -> 2, 50 -> 2, 156 -> 50, \
             3150 -> 10; this network has inputs 156, dense layers 156 -> 50, 1 other projections"
        );
        assert!(reason(&vtsnn(), Some(325), MS).contains("samples of 325 steps of 1 ms"));
        assert!(reason(&vtsnn(), None, MS).contains("different lengths"));
        assert!(reason(&vtsnn(), Some(150), Picoseconds(20_000_000_000)).contains("of 20 ms"));
    }

    /// The workload that the card was measured on.
    fn measured() -> Work {
        Work {
            projections: vec![(156, 50, 7_800), (3_150, 10, 31_500), (50, 2, 100), (10, 2, 20)],
            layers: vec![50, 10, 2],
        }
    }

    #[test]
    fn the_roofline_gives_back_what_it_was_fitted_to_and_predicts_real_time() {
        let gpu = Baseline::shipped("rtx-2080-ti").unwrap();
        let row = |mode| gpu.modelled(&measured(), RowConditions { mode, ..offline(Some(150)) }).unwrap();
        let (offline, realtime) = (row(Mode::Offline), row(Mode::Realtime));
        assert!(matches!(offline.source, FigureSource::Modelled));
        assert!((offline.latency_us.unwrap() - 21.0).abs() < 0.05, "{offline:?}");
        assert!((offline.total_mw.unwrap() / 59_890.0 - 1.0).abs() < 0.01, "{offline:?}");
        // Published in real time: 1045.6 us and 61930 mW.
        assert!((realtime.latency_us.unwrap() / 1045.6 - 1.0).abs() < 0.03, "{realtime:?}");
        assert!((realtime.total_mw.unwrap() / 61_930.0 - 1.0).abs() < 0.06, "{realtime:?}");
    }

    #[test]
    fn a_network_that_fills_the_card_is_bound_by_its_peak() {
        let gpu = Baseline::shipped("rtx-2080-ti").unwrap();
        let size = 100_000u32;
        let work = Work { projections: vec![(size, size, 10_000_000_000)], layers: vec![size] };
        let row = gpu.modelled(&work, offline(Some(1000))).unwrap();
        // 2 * 10^10 operations a step at 13.45 * 10^12 a second.
        assert!((row.latency_us.unwrap() / (2e10 / 13.45e6) - 1.0).abs() < 0.01, "{row:?}");
        assert!(row.total_mw.unwrap() > 245_000.0 && row.total_mw.unwrap() <= 250_000.0, "{row:?}");
        assert!(gpu.modelled(&work, offline(None)).is_none());
    }

    #[test]
    fn real_time_waits_for_the_window_or_takes_each_step_as_it_comes() {
        let figures = Figures {
            static_mw: 10.0,
            dynamic_mw: 100.0,
            latency_us: 25.0,
            source: FigureSource::Measured,
            power_source: FigureSource::Assumed,
        };
        let window = figures.in_real_time(1000.0, true, true);
        assert_eq!((window.latency_us, window.dynamic_mw), (1025.0, 100.0 * 25.0 / 1025.0));
        let steps = figures.in_real_time(1000.0, false, true);
        assert_eq!((steps.latency_us, steps.dynamic_mw), (1000.0, 2.5));
        assert_eq!(Figures { latency_us: 3000.0, ..figures }.in_real_time(1000.0, false, false).latency_us, 3000.0);
        let row = window.row("cpu", Convention::Published, Some(150));
        assert_eq!(row.energy_uj, row.total_mw.map(|mw| mw / 150.0));
    }

    #[test]
    fn a_baseline_that_does_not_add_up_is_refused_where_it_stands() {
        let text = BASELINES[0].text.replacen("59890.0", "69890.0", 1);
        let problem = Baseline::parse(&SourceText::new("b.ron", text)).unwrap_err();
        assert_eq!(problem.code, "baseline.sum");
        assert!(problem.position().is_some());
        assert_eq!(Baseline::shipped("gtx").unwrap_err().code, "baseline.unknown");
    }
}
