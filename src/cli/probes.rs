//! `--probe`: registers of a population, recorded over a run and written as files.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use clap::builder::PossibleValue;

use crate::cli::args::learning::rule_named;
use crate::cli::context::refuse_if;
use crate::cli::process::ranks;
use nsim_files as io;
use nsim_import::probes::Trace;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::id::ChannelId;
use nsim_ir::base::names::fits_pattern;
use nsim_ir::quantised::{Population, Quantised, Units};
use nsim_ir::spikes::{Message, Sample, Spikes};
use nsim_session::error::{Error, Result};
use nsim_session::learning;
use nsim_session::samples::Traces;
use nsim_session::{Outcome, Probe, Quantity};

/// Formats of probe files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum ProbeFormat {
    /// A NumPy array, [samples, compartments, T].
    Npy,
    /// A row for each spike, or for each number.
    Csv,
    /// NIR data: spikes as events, other registers on a grid of time.
    Nir,
}

/// Recorded quantities and their output files.
#[derive(Debug, Clone, clap::Args)]
pub struct ProbeArgs {
    /// Record POPULATION.spikes, .message, .u, .v, .v_register or a word of the kind's state into
    /// -o; spikes for a name alone, which may have * and ?. Of a projection that learns record
    /// NAME.weight, .delay, .tag, .x1, .x2, .y1, .y2 or .y3, with .last only after the last step
    #[arg(long, value_name = "NAME[.WHAT]", requires = "output")]
    pub probe: Vec<String>,
    /// Format of probe files
    #[arg(long, value_enum, value_name = "FORMAT", default_value = "npy")]
    pub probe_format: ProbeFormat,
    /// Folder for probes, `POP.WHAT.npy` each, [samples, compartments, T], or with the ending of
    /// --probe-format
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,
}

/// A probe and the name of its file, `POP.WHAT`.
#[derive(Debug)]
pub struct NamedProbe {
    name: String,
    source: Source,
}

/// Source of a probe.
#[derive(Debug, Clone, Copy)]
enum Source {
    /// A register of compartments.
    Engine(Probe),
    /// Input channels.
    Input(InputProbe),
}

/// Spikes of consecutive input channels, or the integers of their messages.
#[derive(Debug, Clone, Copy)]
struct InputProbe {
    first: ChannelId,
    count: u32,
    message: Option<Message>,
}

impl NamedProbe {
    /// Probe of the engine; none for an input.
    pub fn engine(&self) -> Option<Probe> {
        match self.source {
            Source::Engine(probe) => Some(probe),
            Source::Input(..) => None,
        }
    }

    fn count(&self) -> u32 {
        match self.source {
            Source::Engine(probe) => probe.count,
            Source::Input(channels) => channels.count,
        }
    }

    /// Whether one value is recorded for each sample.
    fn is_last(&self) -> bool {
        matches!(self.source, Source::Engine(probe) if probe.is_last())
    }

    fn is_spikes(&self) -> bool {
        match self.source {
            Source::Engine(probe) => probe.quantity == Quantity::Spikes,
            Source::Input(channels) => channels.message.is_none(),
        }
    }
}

/// The numbers of a probe, `[channels][steps]` for each sample.
fn input_numbers<'s>(samples: &'s [&Sample], probe: InputProbe) -> impl Iterator<Item = f64> + 's {
    let InputProbe { first, count, message } = probe;
    samples.iter().flat_map(move |sample| {
        let steps = sample.steps() as usize;
        let mut numbers = vec![0.0; count as usize * steps];
        for step in 0..sample.steps() {
            let Spikes { ids, values } = sample.input(step);
            for (place, channel) in ids.iter().enumerate() {
                let Some(index) = channel.0.checked_sub(first.0).filter(|&index| index < count) else { continue };
                let payload = values.get(place).copied().unwrap_or(1);
                let carried = message.map_or(1, |message| message.factor().unwrap_or(payload));
                numbers[index as usize * steps + step as usize] = carried.into();
            }
        }
        numbers
    })
}

/// Recordings of probes: registers of the chip, or real numbers.
#[derive(Debug, Clone, Copy)]
pub enum ProbeRecordings<'a> {
    /// From engines with integers.
    Integers(&'a [Outcome]),
    /// From the reference engine.
    Reals(&'a [Traces]),
}

impl ProbeRecordings<'_> {
    /// All samples of a probe, `[compartments][steps]` each; an f64 is exact for every integer.
    fn numbers(&self, probe: usize) -> Box<dyn Iterator<Item = f64> + '_> {
        match self {
            ProbeRecordings::Integers(outcomes) => {
                Box::new(outcomes.iter().flat_map(move |outcome| outcome.probes[probe].iter().copied().map(f64::from)))
            }
            ProbeRecordings::Reals(traces) => {
                Box::new(traces.iter().flat_map(move |sample| sample[probe].iter().copied()))
            }
        }
    }
}

/// Most recorded numbers: probes stay in memory until they are written.
const MOST_PROBED: u64 = 1 << 30;

impl ProbeArgs {
    /// Patterns of the probed populations, which pruning leaves whole.
    pub fn populations(&self) -> Vec<&str> {
        self.probe.iter().map(|text| parts(text).0).collect()
    }

    /// Probes of a network in a run of samples.
    ///
    /// # Errors
    /// [`Error::Usage`] for a probe that does not exist, is given twice, or takes too much memory;
    /// `run.probe-pruned` and `run.probe-shape`.
    pub fn probes(&self, network: &Quantised, samples: &[&Sample]) -> Result<Vec<NamedProbe>> {
        let of_texts = self.probe.iter().map(|text| named_probes(network, text)).collect::<Result<Vec<_>, _>>()?;
        let probes: Vec<NamedProbe> = of_texts.into_iter().flatten().collect();
        check_room(&probes, samples)?;
        let twice = (1..probes.len()).find(|&index| probes[..index].iter().any(|p| p.name == probes[index].name));
        if let Some(index) = twice {
            return Err(Error::Usage(format!("--probe {} is given twice", probes[index].name)));
        }
        if self.output.is_some() && probes.is_empty() {
            tracing::warn!("-o writes probes, but there is no --probe: nothing is written");
        }
        Ok(probes)
    }

    /// The file of a probe.
    pub fn path(&self, named: &NamedProbe) -> PathBuf {
        let folder = self.output.as_deref().unwrap_or(Path::new("."));
        let format = self.probe_format.to_possible_value();
        let extension = format.as_ref().map_or("", PossibleValue::get_name);
        folder.join(format!("{}.{extension}", named.name))
    }

    /// Writes the recordings under temporary names, in steps of `dt_ms` and without the last
    /// `drain` steps; returns the files.
    pub fn write(
        &self,
        probes: &[NamedProbe],
        recorded: ProbeRecordings<'_>,
        given: &[&Sample],
        dt_ms: f64,
        drain: u32,
        batch: &mut io::write::Batch,
    ) -> Result<Vec<String>> {
        let mut files = Vec::new();
        // `check_room` requires samples of one length.
        let steps = given.first().map_or(0, |sample| sample.steps() as usize);
        let written_steps = steps.saturating_sub(drain as usize);
        let mut of_engine = 0;
        for named in probes {
            let path = self.path(named);
            let numbers: Box<dyn Iterator<Item = f64> + '_> = match named.source {
                Source::Engine(_) => {
                    of_engine += 1;
                    recorded.numbers(of_engine - 1)
                }
                Source::Input(probe) => Box::new(input_numbers(given, probe)),
            };
            let (steps, written_steps) = if named.is_last() { (1, 1) } else { (steps, written_steps) };
            let numbers = numbers.enumerate();
            let numbers =
                numbers.filter(move |(place, _)| place % steps.max(1) < written_steps).map(|(_, number)| number);
            let shape = [given.len(), named.count() as usize, written_steps];
            let (population, register) = named.name.rsplit_once('.').unwrap_or((&named.name, ""));
            let trace = Trace { population, register, shape, dt_s: dt_ms / 1e3 };
            match self.probe_format {
                ProbeFormat::Npy => batch.add(&path, |out| {
                    let shape = shape.map(|axis| axis as u64);
                    match (named.is_spikes(), recorded) {
                        (true, _) => io::npy::write(out, &shape, numbers.map(|number| number as u8)),
                        (_, ProbeRecordings::Integers(_)) => {
                            io::npy::write(out, &shape, numbers.map(|number| number as i32))
                        }
                        (_, ProbeRecordings::Reals(_)) => io::npy::write(out, &shape, numbers),
                    }
                })?,
                ProbeFormat::Csv => trace.csv(&path, batch, numbers)?,
                ProbeFormat::Nir => trace.nir(&path, batch, numbers)?,
            }
            files.push(path.display().to_string());
        }
        Ok(files)
    }
}

/// Pattern and quantity of a probe. A population name has a dot only if nsim added it as relays.
fn parts(text: &str) -> (&str, Option<&str>) {
    match text.rsplit_once('.') {
        Some((pattern, what)) if what != "relays" => (pattern, Some(what)),
        _ => (text, None),
    }
}

/// The probe of a column of a rule: `NAME.WHAT` or `NAME.WHAT.last`; `None` for another text.
fn rule_probe(network: &Quantised, text: &str) -> Result<Option<NamedProbe>> {
    let Some((name, column, last)) = learning::parse_probe(text) else { return Ok(None) };
    // Neurons may have words of state with the names of columns.
    let rules = &network.parts().rules;
    if !rules.iter().any(|learning| learning.name == name) && network.population_named(name).is_some() {
        return Ok(None);
    }
    ranks::refuse_several("--probe of a rule")?;
    let rule = rule_named(network, "--probe", name)?;
    let source = Source::Engine(learning::probe(network, rule, column, last));
    Ok(Some(NamedProbe { name: text.to_string(), source }))
}

/// Source of a quantity of a population; `None` if the population lacks it.
fn source(population: &Population, what: &str) -> Option<Source> {
    let count = population.shape.len();
    match &population.units {
        Units::Compartments { .. } => Probe::named(population, what).map(Source::Engine),
        Units::Input(first) => match what {
            "spikes" => Some(Source::Input(InputProbe { first: *first, count, message: None })),
            "message" => Some(Source::Input(InputProbe { first: *first, count, message: Some(population.message) })),
            _ => None,
        },
    }
}

/// Probes of one argument: one for each population that matches its pattern and has the register.
fn named_probes(network: &Quantised, text: &str) -> Result<Vec<NamedProbe>> {
    if let Some(probe) = rule_probe(network, text)? {
        return Ok(vec![probe]);
    }
    let (pattern, asked) = parts(text);
    let what = asked.unwrap_or("spikes");
    let mut probes = Vec::new();
    for (id, population) in network.populations().enumerate() {
        if !fits_pattern(pattern, &population.name) {
            continue;
        }
        let Some(source) = source(population, what) else { continue };
        if let Some(lost) = network.kept_units(id).map(|kept| network.units_before_pruning(id) - kept.len() as u32) {
            let name = &population.name;
            let message = format!("--probe {text}: {lost} compartments of '{name}' were pruned and have no registers");
            let help = "map again without --prune, or prune in this run (--prune), which does not prune probed \
                        populations";
            return Err(Diagnostic::new("run.probe-pruned", message).help(help).into());
        }
        probes.push(NamedProbe { name: format!("{}.{what}", population.name), source });
    }
    if probes.is_empty() && network.parts().rules.iter().any(|rule| rule.name == pattern) {
        let known = "a rule has .weight, .delay, .tag, .x1, .x2, .y1, .y2, .y3 and .r1, each also with .last";
        return Err(Error::Usage(format!("--probe {text}: there is no {what}; {known}")));
    }
    if probes.is_empty() {
        let has_it = |p: &&Population| source(p, what).is_some();
        let names: Vec<&str> = network.populations().iter().filter(has_it).map(|p| p.name.as_str()).collect();
        let hint = "write POPULATION, or POPULATION.spikes, .message, .u, .v, .v_register or a word of its state";
        return Err(Error::Usage(format!("--probe {text}: populations with {what} are: {}; {hint}", names.join(", "))));
    }
    Ok(probes)
}

fn check_room(probes: &[NamedProbe], samples: &[&Sample]) -> Result<()> {
    let steps: u64 = samples.iter().map(|sample| u64::from(sample.steps())).sum();
    let each_step = probes.iter().filter(|named| !named.is_last());
    let rows: u64 = each_step.clone().map(|named| u64::from(named.count())).sum();
    let message = format!(
        "the probes would record {rows} compartments over {steps} steps, more than {MOST_PROBED} numbers; choose \
         fewer --samples"
    );
    refuse_if(rows.saturating_mul(steps) > MOST_PROBED, message)?;
    let equal = samples.windows(2).all(|pair| pair[0].steps() == pair[1].steps());
    if each_step.count() > 0 && !equal {
        let message = "samples have different numbers of steps, so probes do not fill [samples, compartments, T]";
        return Err(Diagnostic::new("run.probe-shape", message).help("choose one sample with --samples").into());
    }
    Ok(())
}
