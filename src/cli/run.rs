//! `nsim run`: simulates a network and reports decisions, counts and probes.

use std::path::PathBuf;

use crate::cli::args::input::{InputArgs, check_pruned, select};
use crate::cli::args::jobs;
use crate::cli::args::learning::LearningArgs;
use crate::cli::args::steps::{self, run_with_step_rows};
use crate::cli::args::values::{Switch, one_of};
use crate::cli::context::{Answer, Context, refuse_if};
use crate::cli::output;
use crate::cli::probes::{NamedProbe, ProbeArgs, ProbeRecordings};
use crate::cli::process::progress;
use crate::cli::process::ranks;
use nsim_files as io;
use nsim_files::warnings::show;
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::Sample;
use nsim_reference::{Kernel, Model};
use nsim_report::run::RunReport;
use nsim_session::cores::core_rows;
use nsim_session::decision::{EarlyExit, Rule};
use nsim_session::detail::Detail;
use nsim_session::error::Error;
use nsim_session::neurobench::NeuroBench;
use nsim_session::obtain::{EngineKind, Job};
use nsim_session::populations::CountsByPopulation;
use nsim_session::priced::MeteredMapping;
use nsim_session::samples::{self, Progress, Run, RunSettings, Traces, fast, golden};
use nsim_session::warnings::{FinishedRun, RunEngine, warnings};
use nsim_session::{Probe, Quantity, SampleSettings};

/// Engines of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum EngineChoice {
    /// The mapped program on simulated cores.
    Fast,
    /// The slow reference interpreter of the quantised network.
    Golden,
    /// The network in real numbers: spike response neurons as they were trained, current-based ones
    /// without integers.
    Reference,
}

impl EngineChoice {
    /// Form of the network that an engine needs.
    fn network_form(choice: Option<EngineChoice>) -> EngineKind {
        match choice {
            Some(EngineChoice::Fast) => EngineKind::Mapped,
            Some(EngineChoice::Golden) => EngineKind::Quantised,
            Some(EngineChoice::Reference) => EngineKind::Real,
            None => EngineKind::ByModel,
        }
    }
}

const EXAMPLES: &str = "\
EXAMPLES:
  nsim run                                             the shipped network on its shipped scene
  nsim run model.ron --input spikes.npy                one array of spikes, [channels.., T] or [samples, channels.., T]
  nsim run --input tactile=t.npy --input vision=v.npy --samples 0..20
  nsim run --input 'scene:noise?samples=5&seed=7&rate=0.02'
  nsim run model.ron --input s.npy --probe hidden.spikes --probe hidden.v -o traces
  nsim run stdp.ron --input s.npy --probe stdp.weight -o traces --learned after.ron    a projection that learns
  nsim run --early-exit certain                        end each sample once its decision cannot change
  nsim run --steps steps.csv                           a row per timestep: spikes, time and energy
  nsim run --neurobench                                operations, sparsity and membrane updates as NeuroBench counts
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
    /// Engine [default: fast; reference for a model with spike response neurons]
    #[arg(long, value_enum)]
    engine: Option<EngineChoice>,
    /// Whether the reference engine uses exact spike response kernels, or truncates them as SLAYER
    /// does
    #[arg(long, default_value = "exact", value_parser = one_of(&Kernel::ALL, Kernel::name))]
    kernel: Kernel,
    /// Skip work that cannot change the result
    #[arg(long, value_enum, default_value = "on")]
    skip: Switch,
    /// End a sample as soon as one output leads by MARGIN spikes, or (certain) can no longer be
    /// overtaken
    #[arg(long, value_name = "MARGIN|certain")]
    early_exit: Option<Rule>,
    #[command(flatten)]
    probes: ProbeArgs,
    #[command(flatten)]
    learning: LearningArgs,
    /// A row for each timestep of each sample: spikes by population, events, messages, hops, time
    /// and energy by part, under the target's first constants
    #[arg(long, value_name = "FILE.csv|npy")]
    steps: Option<PathBuf>,
    /// Add the metrics of NeuroBench's harness, which takes a second run
    #[arg(long, conflicts_with = "early_exit")]
    neurobench: bool,
}

pub fn run(args: &Args, context: Context) -> Result<Answer, Error> {
    let message = "--probe records every step of a sample, but --early-exit ends samples early: use one of them";
    refuse_if(args.early_exit.is_some() && !args.probes.probe.is_empty(), message)?;
    args.steps.iter().try_for_each(|path| steps::check(path, context.force))?;
    if args.steps.is_some() {
        ranks::price();
    }
    let wanted = EngineChoice::network_form(args.engine);
    let file = args.job.reading.load(&args.job.model)?;
    let job = match jobs::prepare_loaded(&args.job, &file, wanted, Some(1), &args.probes.populations())? {
        Ok(job) => job,
        Err(refusal) => return refusal.print(nsim_report::run::empty_result("fast"), context),
    };
    let file = Some(file).filter(|_| args.learning.learned.is_some());
    let network = job.quantised();
    let stimulus = args.input.stimulus(network, job.scene())?;
    let samples = select(&stimulus.samples, &args.input)?;
    check_pruned(network, &samples, &args.input)?;
    let probes = args.probes.probes(network, &samples)?;
    io::write::check_all_free(probes.iter().map(|named| args.probes.path(named)), context.force)?;
    let keep = SampleSettings {
        output: network.output(),
        probes: probes.iter().filter_map(NamedProbe::engine).collect(),
        early_exit: args.early_exit.map(|rule| EarlyExit::new(rule, network)).transpose()?,
        learning: args.learning.settings(network, &samples, &args.input)?,
    };
    args.learning.check_files(network, context.force)?;
    let mut batch = io::write::Batch::new(context.force);
    let Run { outcomes, activity, counts, meter: traces, skipped_updates, wall_s, ranks: rows, learned } =
        progress::with_bar(context, samples.len(), "samples", |done| {
            run_samples(args, &job, &samples, &keep, &mut batch, done)
        })?;
    let neurobench = if args.neurobench { neurobench(args, &job, &samples, &keep)? } else { None };
    ranks::leave_to_first();
    let recorded = traces.as_deref().map_or(ProbeRecordings::Integers(&outcomes), ProbeRecordings::Reals);
    let mut files = write_recordings(args, network, (&probes, recorded), &samples, &keep, batch)?;
    if let Some(file) = &file {
        files.extend(args.learning.write_learned(file, network, &learned, context.force)?);
    }
    let labels: Vec<Option<u32>> = samples.iter().map(|sample| sample.label()).collect();
    let sums = CountsByPopulation::new(network, &counts);
    let (engine, ran) = engine_of(&job);
    let warnings = warnings(FinishedRun {
        network,
        engine: ran,
        sums: &sums,
        samples: &samples,
        of_input: &stimulus.warnings,
        outcomes: &outcomes,
    });
    let cores = job.program().map_or_else(Vec::new, |program| core_rows(program, &activity, None));
    let detail = Detail { sums, cores, warnings, ranks: ranks::rows(&rows, job.program().map(|program| &**program)) };
    show("", &detail.warnings);
    let report = RunReport {
        network,
        target: job.mapped().map(|(_, target)| target.name()),
        engine,
        input: &stimulus.origin,
        seed: stimulus.seed,
        outcomes: &outcomes,
        labels: &labels,
        activity: job.program().map(|_| &activity),
        skipped_updates,
        early_exit: args.early_exit,
        wall_s,
        detail: &detail,
        neurobench: neurobench.as_ref(),
        learning: &nsim_session::learning::rows(network, &learned, &outcomes),
        files: &files,
    };
    if let (Some((compiled, _)), None) = (job.mapped(), &args.job.mapping) {
        warn_if_mapping_was_longer(&compiled.seconds, wall_s, &args.job);
    }
    output::print(context.format, || report.text(), || report.json(), || report.csv())?;
    Ok(Answer::Yes)
}

/// Name of the engine that ran a job, and what it ran.
fn engine_of(job: &Job) -> (&'static str, RunEngine<'_>) {
    match job {
        // Ranks have parts of the program; the interpreter finds the same potentials.
        Job::Mapped(..) if ranks::several().is_some() => ("fast", RunEngine::Integers),
        Job::Mapped(compiled, ..) => ("fast", RunEngine::Program(&compiled.program)),
        Job::Quantised(..) => ("golden", RunEngine::Integers),
        Job::Real(..) => ("reference", RunEngine::Reals),
    }
}

/// Writes probes and random numbers, and the rows of steps; returns the files.
fn write_recordings(
    args: &Args,
    network: &Quantised,
    (probes, recorded): (&[NamedProbe], ProbeRecordings<'_>),
    samples: &[&Sample],
    keep: &SampleSettings,
    mut batch: io::write::Batch,
) -> Result<Vec<String>, Error> {
    let (timestep_ms, drain) = (network.parts().timestep_ms, network.parts().drain);
    let mut files = args.probes.write(probes, recorded, samples, timestep_ms, drain, &mut batch)?;
    let steps = samples.first().map_or(0, |sample| sample.steps());
    files.extend(args.learning.record(network, &keep.learning.draws, steps, &mut batch)?);
    batch.commit()?;
    files.extend(args.steps.iter().map(|path| path.display().to_string()));
    Ok(files)
}

/// Metrics of NeuroBench's harness; none for the reference engine, which `run_samples` refuses.
fn neurobench(args: &Args, job: &Job, samples: &[&Sample], run: &SampleSettings) -> Result<Option<NeuroBench>, Error> {
    let learning = |keep: &SampleSettings| SampleSettings { learning: run.learning.clone(), ..keep.clone() };
    let measured = match job {
        Job::Mapped(compiled, ..) => NeuroBench::measure(&compiled.one, samples, |samples, keep| {
            let skip = args.skip == Switch::On;
            fast(&compiled.program, samples, RunSettings { skip, ..RunSettings::new(&learning(keep)) }, || ())
        }),
        Job::Quantised(quantised, _) => NeuroBench::measure(quantised, samples, |samples, keep| {
            Ok(golden(quantised, samples, &learning(keep), &|| ()))
        }),
        Job::Real(..) => return Ok(None),
    };
    Ok(Some(measured?))
}

/// Seconds of mapping up to which there is no warning.
const SHORT_S: f64 = 0.5;

/// Warns of a mapping that took longer than the run, with the command that saves it.
fn warn_if_mapping_was_longer(stages: &[(&'static str, f64)], wall_s: f64, job: &jobs::JobArgs) {
    let seconds: f64 = stages.iter().filter(|(stage, _)| ["partition", "place"].contains(stage)).map(|(_, s)| s).sum();
    if seconds > wall_s.max(SHORT_S) {
        let target = job.target.as_ref().map_or(String::new(), |target| format!(" --target {target}"));
        let help = format!("nsim map {}{target} -o FILE saves the mapping, and --mapping FILE uses it", job.model);
        tracing::warn!("mapping took {seconds:.1} s and running {wall_s:.1} s: {help}");
    }
}

/// Runs the samples on the engine of the job. The reference engine returns probes instead of a
/// meter.
fn run_samples(
    args: &Args,
    job: &Job,
    samples: &[&Sample],
    keep: &SampleSettings,
    batch: &mut io::write::Batch,
    progress: Progress<'_>,
) -> Result<Run<Option<Vec<Traces>>>, Error> {
    let is_unmapped = job.mapped().is_none();
    refuse_if(args.steps.is_some() && is_unmapped, "--steps records activity of cores: it needs --engine fast")?;
    if is_unmapped {
        ranks::refuse_several("--engine golden or reference")?;
    }
    if args.neurobench {
        let is_real = matches!(job, Job::Real(..));
        refuse_if(is_real, "--neurobench counts operations on integers: it needs --engine fast or golden")?;
        ranks::refuse_several("--neurobench")?;
    }
    Ok(match job {
        Job::Mapped(compiled, target, _) => {
            let skip = args.skip == Switch::On;
            let run_settings = RunSettings { skip, progress, ranks: ranks::several(), ..RunSettings::new(keep) };
            match &args.steps {
                Some(path) => {
                    let metered = MeteredMapping::new(compiled);
                    let (settings, _) = metered.offline(target)?;
                    let run =
                        run_with_step_rows((path, batch), &compiled.one, &metered, settings, samples, run_settings)?;
                    run.map_meter(|_| None)
                }
                None => fast(&compiled.program, samples, run_settings, || ())?.map_meter(|()| None),
            }
        }
        Job::Quantised(quantised, _) => golden(quantised, samples, keep, progress).map_meter(|()| None),
        Job::Real(graph, quantised, _) => {
            fn is_of_chip(probe: &Probe) -> bool {
                [Quantity::VRegister, Quantity::Message].contains(&probe.quantity)
            }
            let message = "--engine reference does not support --probe .v_register and .message; probe .v or .spikes";
            refuse_if(keep.probes.iter().any(is_of_chip), message)?;
            let model = Model::<f64>::new(graph, nsim_reference::Options { kernel: args.kernel })?;
            let units = (quantised.channels(), quantised.compartments());
            samples::reference(&model, units, samples, keep, progress).map_meter(Some)
        }
    })
}
