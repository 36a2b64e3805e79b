//! `nsim run`: simulates a network and says what came out.

use std::path::{Path, PathBuf};

use crate::base::diagnostic::Diagnostic;
use crate::base::id::Id;
use crate::cli::args::input::{InputArgs, check_pruned, select};
use crate::cli::args::jobs::Wanted;
use crate::cli::args::values::Switch;
use crate::cli::args::{inputs, jobs};
use crate::cli::context::{Answer, Context};
use crate::cli::{output, simulate};
use crate::drive::decision::{EarlyExit, Rule};
use crate::drive::{Keep, Outcome, Probe, Quantity};
use crate::error::Error;
use crate::io;
use crate::io::trace::Trace;
use crate::ir::quantised::Quantised;
use crate::ir::spikes::Sample;
use crate::reference::{self, Kernel, Model};
use crate::report::run::RunReport;

/// Which engine runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum EngineChoice {
    /// The mapped program on simulated cores.
    Fast,
    /// The slow, obvious interpreter of the quantised network.
    Golden,
    /// The network in real numbers: spike response neurons as they were trained, current-based ones without integers.
    Reference,
}

/// How the reference engine applies spike response kernels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum KernelChoice {
    /// Without end.
    Exact,
    /// Cut as SLAYER cuts them.
    Truncated,
}

impl EngineChoice {
    /// What a job must be ready for.
    fn wanted(choice: Option<EngineChoice>) -> Wanted {
        match choice {
            Some(EngineChoice::Fast) => Wanted::Mapped,
            Some(EngineChoice::Golden) => Wanted::Quantised,
            Some(EngineChoice::Reference) => Wanted::Real,
            None => Wanted::ByModel,
        }
    }
}

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

const EXAMPLES: &str = "\
EXAMPLES:
  nsim run                                             the shipped network on its shipped scene
  nsim run model.ron --input spikes.npy                one array of spikes, [channels.., T] or [samples, channels.., T]
  nsim run --input tactile=t.npy --input vision=v.npy --samples 0..20
  nsim run --input 'scene:noise?samples=5&seed=7&rate=0.02'
  nsim run model.ron --input s.npy --probe hidden.spikes --probe hidden.v -o traces
  nsim run --early-exit certain                        leave off what can no longer change a decision
  nsim run --engine golden --format json
  nsim run srm.ron --input s.npy --probe hidden.u -o traces     potentials of spike response neurons, as float64";

/// Simulate a network: spikes in, decisions out.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    job: jobs::JobArgs,
    #[command(flatten)]
    input: InputArgs,
    /// Which engine [default: fast; reference for a model with spike response neurons]
    #[arg(long, value_enum)]
    engine: Option<EngineChoice>,
    /// How the reference engine applies spike response kernels
    #[arg(long, value_enum, default_value = "exact")]
    kernel: KernelChoice,
    /// Leave out work that cannot change anything
    #[arg(long, value_enum, default_value = "on")]
    skip: Switch,
    /// End a sample when an output leads by so many spikes, or when no other can overtake it any more
    #[arg(long, value_name = "MARGIN|certain")]
    early_exit: Option<Rule>,
    /// Record POPULATION.spikes, .u, .v or .v_register into -o
    #[arg(long, value_name = "POP.WHAT", requires = "output")]
    probe: Vec<String>,
    /// How probes are written
    #[arg(long, value_enum, value_name = "FORMAT", default_value = "npy")]
    probe_format: ProbeFormat,
    /// Folder for probes, `POP.WHAT.npy` each, [samples, compartments, T], or with the ending of --probe-format
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
}

struct NamedProbe {
    name: String,
    probe: Probe,
}

fn probe(network: &Quantised, text: &str) -> Result<NamedProbe, Error> {
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

/// The command.
///
/// # Errors
/// [`Error`] when an input cannot be used.
pub fn run(args: &Args, context: Context) -> Result<Answer, Error> {
    if args.early_exit.is_some() && !args.probe.is_empty() {
        let message = "--probe records every step of a sample, --early-exit leaves some off: use one of them";
        return Err(Error::Usage(message.to_string()));
    }
    let probed: Vec<&str> = args.probe.iter().filter_map(|text| Some(text.rsplit_once('.')?.0)).collect();
    let job = match jobs::prepare_probed(&args.job, EngineChoice::wanted(args.engine), Some(1), &probed)? {
        jobs::Prepared::Ready(job) => job,
        jobs::Prepared::DoesNotFit(refusal) => return refusal.say(crate::report::run::nothing("fast"), context),
    };
    let network = job.quantised();
    let stimulus = inputs::stimulus(network, &args.input.input, job.scene(), args.input.seed)?;
    let samples = select(&stimulus.samples, &args.input)?;
    check_pruned(network, &samples, &args.input)?;
    let probes = args.probe.iter().map(|text| probe(network, text)).collect::<Result<Vec<_>, _>>()?;
    let output = &network.populations()[network.parts().output];
    let first = output.first_compartment().unwrap_or_else(|| Id::new(0));
    let keep = Keep {
        output: (first, output.shape.len()),
        probes: probes.iter().map(|p| p.probe).collect(),
        early_exit: args.early_exit.map(|rule| EarlyExit::new(rule, network)),
    };
    check_room(&keep, &samples)?;
    if let Some(index) = (1..probes.len()).find(|&index| probes[..index].iter().any(|p| p.name == probes[index].name)) {
        return Err(Error::Usage(format!("--probe {} is given twice", probes[index].name)));
    }
    if args.output.is_some() && probes.is_empty() {
        tracing::warn!("-o is for probes and there is none: nothing is written");
    }
    for named in &probes {
        io::write::check_free(&probe_path(args, named), context.force)?;
    }
    let mut traces = None;
    let (outcomes, activity, skipped_updates, wall_s) = match &job {
        jobs::Job::Mapped(compiled, ..) => {
            let skip = args.skip == Switch::On;
            let run = simulate::fast(&compiled.program, &samples, &keep, (skip, false), context, || (), |(), _, _| ())?;
            (run.outcomes, Some(run.activity), run.skipped_updates, run.wall_s)
        }
        jobs::Job::Quantised(..) => {
            let (outcomes, wall_s) = simulate::golden(network, &samples, &keep, context);
            (outcomes, None, 0, wall_s)
        }
        jobs::Job::Real(graph, ..) => {
            refuse_registers(&keep.probes)?;
            let kernel = match args.kernel {
                KernelChoice::Exact => Kernel::Exact,
                KernelChoice::Truncated => Kernel::Truncated,
            };
            let model = Model::<f64>::new(graph, reference::Options { kernel });
            let (outcomes, reals, wall_s) = simulate::reference(&model, &samples, &keep, context);
            traces = Some(reals);
            (outcomes, None, 0, wall_s)
        }
    };
    let dt_ms = network.parts().timestep_ms;
    let files = match &traces {
        Some(traces) => write_traces((args, dt_ms), &probes, traces, context)?,
        None => write_probes((args, dt_ms), &probes, &outcomes, context)?,
    };
    let labels: Vec<Option<u32>> = samples.iter().map(|sample| sample.label()).collect();
    let report = RunReport {
        network,
        target: job.program().map(|_| job.target_name()),
        engine: match &job {
            jobs::Job::Mapped(..) => "fast",
            jobs::Job::Quantised(..) => "golden",
            jobs::Job::Real(..) => "reference",
        },
        input: &stimulus.origin,
        seed: stimulus.seed,
        outcomes: &outcomes,
        labels: &labels,
        activity: activity.as_ref(),
        skipped_updates,
        early_exit: args.early_exit,
        wall_s,
        files: &files,
    };
    if let Some(warning) = report.warning() {
        tracing::warn!("{warning}");
    }
    output::print(context.format, || report.text(), || report.json(), || report.csv())?;
    Ok(Answer::Yes)
}

/// Probes are kept in memory until they are written: at most this many numbers.
const MOST_PROBED: u64 = 1 << 30;

fn check_room(keep: &Keep, samples: &[&Sample]) -> Result<(), Error> {
    let steps: u64 = samples.iter().map(|sample| u64::from(sample.steps())).sum();
    let rows: u64 = keep.probes.iter().map(|probe| u64::from(probe.count)).sum();
    if rows.saturating_mul(steps) > MOST_PROBED {
        return Err(Error::Usage(format!(
            "the probes would record {rows} compartments over {steps} steps, more than {MOST_PROBED} numbers; choose fewer --samples"
        )));
    }
    let equal = samples.windows(2).all(|pair| pair[0].steps() == pair[1].steps());
    if !keep.probes.is_empty() && !equal {
        let message = "samples have different numbers of steps, so probes do not fill [samples, compartments, T]";
        return Err(Diagnostic::new("run.probe-shape", message).help("choose one sample with --samples").into());
    }
    Ok(())
}

fn probe_path(args: &Args, named: &NamedProbe) -> PathBuf {
    let folder = args.output.as_deref().unwrap_or(Path::new("."));
    let extension = match args.probe_format {
        ProbeFormat::Npy => "npy",
        ProbeFormat::Csv => "csv",
        ProbeFormat::Nir => "nir",
        #[cfg(feature = "parquet")]
        ProbeFormat::Parquet => "parquet",
    };
    folder.join(format!("{}.{extension}", named.name))
}

/// Writes a probe in a form other than NumPy's; whether there was one.
fn write_other(
    args: &Args,
    named: &NamedProbe,
    shape: &[u64; 3],
    dt_ms: f64,
    force: bool,
    numbers: impl Iterator<Item = f64>,
) -> Result<bool, Error> {
    let (population, register) = named.name.rsplit_once('.').unwrap_or((&named.name, ""));
    let trace = Trace { population, register, shape: shape.map(|axis| axis as usize), dt_s: dt_ms / 1e3 };
    let path = probe_path(args, named);
    match args.probe_format {
        ProbeFormat::Npy => return Ok(false),
        ProbeFormat::Csv => trace.csv(&path, force, numbers)?,
        ProbeFormat::Nir => trace.nir(&path, force, numbers)?,
        #[cfg(feature = "parquet")]
        ProbeFormat::Parquet => trace.parquet(&path, force, numbers)?,
    }
    Ok(true)
}

fn write_probes(
    (args, dt_ms): (&Args, f64),
    probes: &[NamedProbe],
    outcomes: &[Outcome],
    context: Context,
) -> Result<Vec<String>, Error> {
    let mut files = Vec::new();
    for (index, named) in probes.iter().enumerate() {
        let path = probe_path(args, named);
        let steps = outcomes.first().map_or(0, |outcome| outcome.steps);
        let shape = [outcomes.len() as u64, u64::from(named.probe.count), u64::from(steps)];
        let numbers = outcomes.iter().flat_map(|outcome| outcome.probes[index].iter().copied());
        if write_other(args, named, &shape, dt_ms, context.force, numbers.clone().map(f64::from))? {
            files.push(path.display().to_string());
            continue;
        }
        io::write::file(&path, context.force, |out| match named.probe.quantity {
            Quantity::Spikes => io::npy::write_u8(out, &shape, numbers.map(|number| number as u8)),
            _ => io::npy::write_i32(out, &shape, numbers),
        })?;
        files.push(path.display().to_string());
    }
    Ok(files)
}

/// Real neurons have no register of the chip to read.
fn refuse_registers(probes: &[Probe]) -> Result<(), Error> {
    match probes.iter().any(|probe| probe.quantity == Quantity::VRegister) {
        true => Err(Error::Usage("--probe .v_register: the reference engine has no registers; probe .v".to_string())),
        false => Ok(()),
    }
}

/// As [`write_probes`], in real numbers but for spikes.
fn write_traces(
    (args, dt_ms): (&Args, f64),
    probes: &[NamedProbe],
    traces: &[simulate::Traces],
    context: Context,
) -> Result<Vec<String>, Error> {
    let mut files = Vec::new();
    for (index, named) in probes.iter().enumerate() {
        let path = probe_path(args, named);
        let count = named.probe.count as usize;
        let steps = traces.first().map_or(0, |sample| sample[index].len() / count.max(1));
        let shape = [traces.len() as u64, count as u64, steps as u64];
        let numbers = traces.iter().flat_map(|sample| sample[index].iter().copied());
        if write_other(args, named, &shape, dt_ms, context.force, numbers.clone())? {
            files.push(path.display().to_string());
            continue;
        }
        io::write::file(&path, context.force, |out| match named.probe.quantity {
            Quantity::Spikes => io::npy::write_u8(out, &shape, numbers.map(|number| number as u8)),
            _ => io::npy::write_f64(out, &shape, numbers),
        })?;
        files.push(path.display().to_string());
    }
    Ok(files)
}
