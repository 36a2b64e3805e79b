//! Other hardware's rows of the energy table, and the workloads for which they hold.
//!
//! A measured row says nothing about another network: for one that does not match, [`Baseline::row`] gives the reason
//! instead of a row.

use crate::base::diagnostic::{Diagnostic, SourceText};
use crate::base::units::Picoseconds;
use crate::cost::estimate::{Convention, Row, RowSource};
use crate::desc::baseline::{BaselineFile, DenseLayer, Mode};
use crate::desc::spanned::parse;
use crate::desc::target::Status;
use crate::ir::quantised::{Connectivity, Quantised, Units};

/// Baselines that come with the program: name and file.
pub const SHIPPED: &[(&str, &str)] = &[("rtx-2080-ti", include_str!("../../mapping/baselines/rtx-2080-ti.ron"))];

/// Sizes that decide whether two networks are the same workload for dense hardware.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NetworkShape {
    inputs: Vec<u32>,
    layers: Vec<DenseLayer>,
    /// Projections that are not all to all.
    others: usize,
}

impl NetworkShape {
    /// The shape of one copy of a network, as it was before any pruning.
    #[must_use]
    pub fn of(network: &Quantised) -> Self {
        let network = network.original();
        let inputs = network.populations().iter().filter(|population| matches!(population.units, Units::Input(_)));
        let dense = network.projections().iter().filter(|p| matches!(p.connectivity, Connectivity::Dense { .. }));
        let size = |id| network.populations()[id].shape.len();
        let layers: Vec<DenseLayer> =
            dense.map(|projection| DenseLayer { from: size(projection.source), to: size(projection.target) }).collect();
        let others = network.projections().len() - layers.len();
        NetworkShape::new(inputs.map(|population| population.shape.len()).collect(), layers, others)
    }

    /// The shape with these sizes; their order does not matter.
    #[must_use]
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

/// A checked baseline.
#[derive(Debug, Clone)]
pub struct Baseline {
    file: BaselineFile,
    shape: NetworkShape,
}

impl Baseline {
    /// A baseline that comes with the program.
    ///
    /// # Errors
    /// A diagnostic when there is none of this name.
    pub fn shipped(name: &str) -> Result<Self, Diagnostic> {
        match SHIPPED.iter().find(|(shipped, _)| *shipped == name) {
            Some((_, text)) => Baseline::parse(&SourceText::new(format!("mapping/baselines/{name}.ron"), *text)),
            None => {
                let names: Vec<&str> = SHIPPED.iter().map(|&(name, _)| name).collect();
                Err(Diagnostic::new("baseline.unknown", format!("there is no baseline {name}"))
                    .help(format!("baselines are {}", names.join(", "))))
            }
        }
    }

    /// A baseline from its file.
    ///
    /// # Errors
    /// A diagnostic where the file is malformed, a figure is negative, or static and dynamic power are not the total.
    pub fn parse(source: &SourceText) -> Result<Self, Diagnostic> {
        let file: BaselineFile = parse(source, "baseline.syntax")?;
        for row in &file.rows {
            let figures = [
                &row.static_mw,
                &row.dynamic_mw,
                &row.total_mw,
                &row.latency_us,
                &row.printed_energy_uj,
                &row.printed_edp,
            ];
            if let Some(figure) = figures.into_iter().find(|figure| !(0.0..=1e15).contains(&figure.value)) {
                return Err(Diagnostic::new("baseline.figure", format!("{} is outside 0..=10^15", figure.value))
                    .at(source, figure.span));
            }
            let sum = row.static_mw.value + row.dynamic_mw.value;
            // Printed figures are rounded; a hundredth is more than any rounding.
            if (sum - row.total_mw.value).abs() > 0.01 * row.total_mw.value {
                return Err(Diagnostic::new(
                    "baseline.sum",
                    format!("static and dynamic power add up to {sum} mW, not {}", row.total_mw.value),
                )
                .at(source, row.total_mw.span));
            }
        }
        let on = &file.measured_on;
        let shape = NetworkShape::new(on.inputs.clone(), on.layers.clone(), 0);
        Ok(Baseline { file, shape })
    }

    /// What the file says.
    #[must_use]
    pub fn file(&self) -> &BaselineFile {
        &self.file
    }

    /// Its name on the command line.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.file.name
    }

    /// Where its figures are printed, and how they were measured.
    #[must_use]
    pub fn source(&self) -> String {
        format!("{}. {}", self.file.source, self.file.notes)
    }

    /// Its row for a workload.
    ///
    /// # Errors
    /// Why there is none: it was measured on another workload, or not in this mode.
    pub fn row(
        &self,
        shape: &NetworkShape,
        steps: Option<u32>,
        timestep: Picoseconds,
        mode: Mode,
        convention: Convention,
    ) -> Result<Row, String> {
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
        Ok(Row {
            hardware: self.file.hardware.clone(),
            unit: "total",
            convention,
            static_mw: Some(row.static_mw.value),
            dynamic_mw: Some(row.dynamic_mw.value),
            total_mw: Some(total),
            latency_us: Some(latency),
            energy_uj: Some(energy),
            edp_pjs: Some(edp),
            low: None,
            high: None,
            source: match self.file.status {
                Status::Published => RowSource::Published,
                Status::Calibrated => RowSource::Modelled,
                Status::Assumed => RowSource::Assumed,
            },
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

    #[test]
    fn the_gpu_row_is_printed_or_recomputed() {
        let gpu = Baseline::shipped("rtx-2080-ti").unwrap();
        let row = |mode, convention| {
            let row = gpu.row(&vtsnn(), Some(150), MS, mode, convention).unwrap();
            assert!(matches!(row.source, RowSource::Published));
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
            gpu.row(shape, steps, timestep, Mode::Offline, Convention::Physical).unwrap_err()
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

    #[test]
    fn a_baseline_that_does_not_add_up_is_refused_where_it_stands() {
        let text = SHIPPED[0].1.replacen("59890.0", "69890.0", 1);
        let problem = Baseline::parse(&SourceText::new("b.ron", text)).unwrap_err();
        assert_eq!(problem.code, "baseline.sum");
        assert!(problem.position().is_some());
        assert_eq!(Baseline::shipped("gtx").unwrap_err().code, "baseline.unknown");
    }
}
