//! `--probe`: registers of a population, recorded over a run and written as files.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use clap::builder::PossibleValue;

use crate::base::diagnostic::Diagnostic;
use crate::drive::samples::Traces;
use crate::drive::{Outcome, Probe, Quantity};
use crate::error::{Error, Result};
use crate::io;
use crate::io::trace::Trace;
use crate::ir::quantised::Quantised;
use crate::ir::spikes::Sample;

/// How probes are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum ProbeFormat {
    /// A NumPy array, [samples, compartments, T].
    Npy,
    /// A row for each spike, or for each number.
    Csv,
    /// NIR data: spikes as events, other registers on a grid of time.
    Nir,
    /// Parquet, with CSV's columns; in builds with the feature `parquet`.
    #[cfg(feature = "parquet")]
    Parquet,
}

/// What is recorded, and where it goes.
#[derive(Debug, Clone, clap::Args)]
pub struct ProbeArgs {
    /// Record POPULATION.spikes, .u, .v or .v_register into -o
    #[arg(long, value_name = "POP.WHAT", requires = "output")]
    pub probe: Vec<String>,
    /// How probes are written
    #[arg(long, value_enum, value_name = "FORMAT", default_value = "npy")]
    pub probe_format: ProbeFormat,
    /// Folder for probes, `POP.WHAT.npy` each, [samples, compartments, T], or with the ending of --probe-format
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,
}

/// A probe and the name of its file, `POP.WHAT`.
#[derive(Debug)]
pub struct NamedProbe {
    name: String,
    /// What it records.
    pub probe: Probe,
}

/// What probes recorded: the chip's registers, or real numbers.
#[derive(Debug, Clone, Copy)]
pub enum Recorded<'a> {
    /// Of engines of integers.
    Integers(&'a [Outcome]),
    /// Of the reference engine.
    Reals(&'a [Traces]),
}

impl Recorded<'_> {
    /// Samples, and numbers of a sample of a probe.
    fn size(&self, probe: usize) -> (usize, usize) {
        match self {
            Recorded::Integers(outcomes) => (outcomes.len(), outcomes.first().map_or(0, |o| o.probes[probe].len())),
            Recorded::Reals(traces) => (traces.len(), traces.first().map_or(0, |sample| sample[probe].len())),
        }
    }

    /// All samples of a probe, `[compartments][steps]` each; every integer is exact in an f64.
    fn numbers(&self, probe: usize) -> Box<dyn Iterator<Item = f64> + '_> {
        match self {
            Recorded::Integers(outcomes) => {
                Box::new(outcomes.iter().flat_map(move |outcome| outcome.probes[probe].iter().copied().map(f64::from)))
            }
            Recorded::Reals(traces) => Box::new(traces.iter().flat_map(move |sample| sample[probe].iter().copied())),
        }
    }
}

/// Probes are kept in memory until they are written: at most this many numbers.
const MOST_PROBED: u64 = 1 << 30;

impl ProbeArgs {
    /// The populations that are named, which pruning leaves whole.
    #[must_use]
    pub fn populations(&self) -> Vec<&str> {
        self.probe.iter().filter_map(|text| Some(text.rsplit_once('.')?.0)).collect()
    }

    /// The probes of a network and the samples that they record.
    ///
    /// # Errors
    /// [`Error::Usage`] for a probe that there is not, is given twice, or takes too much memory; `run.probe-pruned` and
    /// `run.probe-shape`.
    pub fn probes(&self, network: &Quantised, samples: &[&Sample]) -> Result<Vec<NamedProbe>> {
        let probes = self.probe.iter().map(|text| probe(network, text)).collect::<Result<Vec<_>, _>>()?;
        check_room(&probes, samples)?;
        let twice = (1..probes.len()).find(|&index| probes[..index].iter().any(|p| p.name == probes[index].name));
        if let Some(index) = twice {
            return Err(Error::Usage(format!("--probe {} is given twice", probes[index].name)));
        }
        if self.output.is_some() && probes.is_empty() {
            tracing::warn!("-o is for probes and there is none: nothing is written");
        }
        Ok(probes)
    }

    /// The file of a probe.
    #[must_use]
    pub fn path(&self, named: &NamedProbe) -> PathBuf {
        let folder = self.output.as_deref().unwrap_or(Path::new("."));
        let format = self.probe_format.to_possible_value();
        let extension = format.as_ref().map_or("", PossibleValue::get_name);
        folder.join(format!("{}.{extension}", named.name))
    }

    /// Writes what was recorded in steps of so many milliseconds; returns the files.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write(&self, probes: &[NamedProbe], recorded: Recorded<'_>, dt_ms: f64, force: bool) -> Result<Vec<String>> {
        let mut files = Vec::new();
        let mut batch = io::write::Batch::new(force);
        for (index, named) in probes.iter().enumerate() {
            let path = self.path(named);
            let ((samples, length), count) = (recorded.size(index), named.probe.count as usize);
            let shape = [samples, count, length / count.max(1)];
            let numbers = recorded.numbers(index);
            let (population, register) = named.name.rsplit_once('.').unwrap_or((&named.name, ""));
            let trace = Trace { population, register, shape, dt_s: dt_ms / 1e3 };
            match self.probe_format {
                ProbeFormat::Npy => batch.add(&path, |out| {
                    let shape = shape.map(|axis| axis as u64);
                    match (named.probe.quantity, recorded) {
                        (Quantity::Spikes, _) => io::npy::write(out, &shape, numbers.map(|number| number as u8)),
                        (_, Recorded::Integers(_)) => io::npy::write(out, &shape, numbers.map(|number| number as i32)),
                        (_, Recorded::Reals(_)) => io::npy::write(out, &shape, numbers),
                    }
                })?,
                ProbeFormat::Csv => trace.csv(&path, &mut batch, numbers)?,
                ProbeFormat::Nir => trace.nir(&path, &mut batch, numbers)?,
                #[cfg(feature = "parquet")]
                ProbeFormat::Parquet => trace.parquet(&path, &mut batch, numbers)?,
            }
            files.push(path.display().to_string());
        }
        batch.commit()?;
        Ok(files)
    }
}

fn probe(network: &Quantised, text: &str) -> Result<NamedProbe> {
    let wrong = |why: String| Error::Usage(format!("--probe {text}: {why}"));
    let (population, what) =
        text.rsplit_once('.').ok_or_else(|| wrong("write POPULATION.spikes, .u, .v or .v_register".into()))?;
    let quantity = Quantity::ALL.iter().find(|(_, name)| *name == what).map(|(quantity, _)| *quantity);
    let quantity = quantity.ok_or_else(|| wrong(format!("'{what}' is none of spikes, u, v, v_register")))?;
    let id = network.population_named(population);
    let found = id.map(|id| &network.populations()[id]);
    if let Some(lost) = id.and_then(|id| Some(network.units_shown(id) - network.kept(id)?.len() as u32)) {
        let message =
            format!("--probe {text}: {lost} compartments of '{population}' were pruned and have no registers");
        let help = "map again without --prune, or let this run prune (--prune): it leaves what is probed whole";
        return Err(Diagnostic::new("run.probe-pruned", message).help(help).into());
    }
    match found.and_then(|p| Some((p.first_compartment()?, p.shape.len()))) {
        Some((first, count)) => Ok(NamedProbe { name: text.to_string(), probe: Probe { first, count, quantity } }),
        None => {
            let names: Vec<&str> = network
                .populations()
                .iter()
                .filter(|p| p.first_compartment().is_some())
                .map(|p| p.name.as_str())
                .collect();
            Err(wrong(format!("populations with compartments are: {}", names.join(", "))))
        }
    }
}

fn check_room(probes: &[NamedProbe], samples: &[&Sample]) -> Result<()> {
    let steps: u64 = samples.iter().map(|sample| u64::from(sample.steps())).sum();
    let rows: u64 = probes.iter().map(|named| u64::from(named.probe.count)).sum();
    if rows.saturating_mul(steps) > MOST_PROBED {
        return Err(Error::Usage(format!(
            "the probes would record {rows} compartments over {steps} steps, more than {MOST_PROBED} numbers; choose fewer --samples"
        )));
    }
    let equal = samples.windows(2).all(|pair| pair[0].steps() == pair[1].steps());
    if !probes.is_empty() && !equal {
        let message = "samples have different numbers of steps, so probes do not fill [samples, compartments, T]";
        return Err(Diagnostic::new("run.probe-shape", message).help("choose one sample with --samples").into());
    }
    Ok(())
}
