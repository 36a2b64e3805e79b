//! `nsim bench`: measures speed and the quality of mappings.

#[cfg(feature = "ann")]
pub mod ann;
pub mod paper;
pub mod pareto;
pub mod published;
mod scenes;
pub mod sweep;

use std::cell::OnceCell;
use std::hint::black_box;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::cli::args::values;
use crate::cli::bench::paper::PaperArgs;
use crate::cli::bench::pareto::ParetoArgs;
use crate::cli::bench::published::PublishedArgs;
use crate::cli::bench::sweep::SweepArgs;
use crate::cli::context::{Answer, Context};
use crate::cli::output;
use crate::cli::process::progress;
use crate::cli::process::ranks;
use nsim_compile::{CompileError, Options, compile};
use nsim_energy::measure::{Budget, StepTiming, measure_agreed};
use nsim_files as io;
use nsim_ir::activity::Totals;
use nsim_ir::program::Program;
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::Sample;
use nsim_machine::ranks::transport::Ranks;
use nsim_machine::{Image, Machine, Settings};
use nsim_report::bench as report;
use nsim_report::bench::step::StepRow;
use nsim_session::error::Error;
use nsim_session::ranks::part_of;
use nsim_study::mapping;
use nsim_study::networks::{BenchNetwork, StandardNetwork};
use nsim_study::suite::{self, SuiteCase};

const EXAMPLES: &str = "\
EXAMPLES:
  nsim bench step                                   microseconds per timestep on standard networks
  nsim bench step --network vtsnn-1pct --seconds 5  one of them, for longer
  nsim bench step --format json > speed.json        with the environment, for comparison
  nsim bench map                                    cores, traffic, energy and time of mappings by every strategy
  nsim bench map --network lenet pilotnet           of these networks
  nsim bench map --full                             with networks of a million compartments
  nsim bench pareto --samples 0..50                 run time against error of variants of the shipped network
  nsim bench published                              published measurements next to predictions
  nsim bench paper                                  the tables of the seed paper next to measurements
  nsim bench sweep                                  jumps in the run time per synaptic event";

/// Measure speed and mappings on standard networks, and run time against error
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(subcommand)]
    bench: BenchCommand,
}

impl Args {
    /// Whether several processes can share the work.
    pub fn has_ranks(&self) -> bool {
        matches!(self.bench, BenchCommand::Step(_))
    }
}

#[derive(Debug, clap::Subcommand)]
enum BenchCommand {
    Step(StepArgs),
    Map(MapArgs),
    Pareto(Box<ParetoArgs>),
    Published(PublishedArgs),
    Paper(PaperArgs),
    Sweep(SweepArgs),
    #[cfg(feature = "ann")]
    Ann(ann::AnnArgs),
}

/// Cores, traffic, energy and step time of mappings by every strategy, placed and unplaced; each
/// mapping is run and its spikes are compared with the reference interpreter's
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct MapArgs {
    /// Only these networks, for example vtsnn-slip-x32, lenet, pilotnet, small-world-10k [default:
    /// all below a million]
    #[arg(long, value_name = "NAME", num_args = 1.., value_parser = case)]
    network: Vec<SuiteCase>,
    /// Also map networks of a million compartments
    #[arg(long)]
    full: bool,
    /// Effort of each search for a better mapping, in seconds of a reference machine
    #[arg(
        long, value_name = "S", default_value_t = nsim_compile::DEFAULT_EFFORT_S,
        value_parser = clap::value_parser!(u32).range(0..=86_400)
    )]
    time_budget: u32,
}

fn case(name: &str) -> Result<SuiteCase, String> {
    let cases = suite::cases();
    let names: Vec<&str> = cases.iter().map(|case| case.name).collect();
    let unknown = format!("networks are: {}", names.join(", "));
    cases.into_iter().find(|case| case.name == name).ok_or(unknown)
}

/// Microseconds per timestep on standard networks: median and interquartile range
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct StepArgs {
    /// Only these networks, for example vtsnn-1pct, random-32k, conv-98k [default: all; those of a
    /// million compartments and more take a minute and 4 GiB to be mapped]
    #[arg(long, value_name = "NAME", num_args = 1.., value_parser = standard)]
    network: Vec<StandardNetwork>,
    /// Seconds of measurement per row, without set-up
    #[arg(long, value_name = "S", default_value = "1", value_parser = values::seconds)]
    seconds: Duration,
    /// Run exactly N steps, once, without warm-up, to count instructions
    #[arg(
        long, value_name = "N", conflicts_with = "seconds",
        value_parser = clap::value_parser!(u64).range(1..=1_000_000_000)
    )]
    steps: Option<u64>,
}

fn standard(name: &str) -> Result<StandardNetwork, String> {
    StandardNetwork::ALL.into_iter().find(|standard| standard.name() == name).ok_or_else(|| {
        let names: Vec<&str> = StandardNetwork::ALL.iter().map(|standard| standard.name()).collect();
        format!("standard networks are: {}", names.join(", "))
    })
}

pub fn run(args: &Args, context: Context) -> Result<Answer, Error> {
    match &args.bench {
        BenchCommand::Step(args) => step(args, context),
        BenchCommand::Map(args) => map_suite(args, context),
        BenchCommand::Pareto(args) => pareto::run(args, context),
        BenchCommand::Published(args) => published::run(args, context),
        BenchCommand::Paper(args) => paper::run(args, context),
        BenchCommand::Sweep(args) => sweep::run(args, context),
        #[cfg(feature = "ann")]
        BenchCommand::Ann(args) => ann::run(args, context),
    }
}

/// `nsim bench map`.
fn map_suite(args: &MapArgs, context: Context) -> Result<Answer, Error> {
    let cases: Vec<SuiteCase> = match args.network.as_slice() {
        [] => suite::cases().into_iter().filter(|case| args.full || !case.large).collect(),
        given => given.to_vec(),
    };
    let environment = output::environment();
    let ways: usize = mapping::MAPPING_VARIANTS.iter().map(|(_, _, places)| places.len()).sum();
    let rows = progress::with_bar(context, cases.len() * ways, "mappings", |done| {
        let mut rows = Vec::new();
        for case in &cases {
            let bench = case.build().map_err(|error| Error::Fault(format!("{}: {error}", case.name)))?;
            let target = io::target::load_target(bench.target)?;
            mapping::map_all(case, &bench, &target, args.time_budget, |row| {
                tracing::info!("{} {} placed {}: {:.1} s", row.network, row.strategy.name(), row.placed, row.seconds);
                rows.push(row);
                done();
            })?;
        }
        Ok::<_, Error>(rows)
    })?;
    let json = || report::mapping::json(&environment, &rows);
    let text = || report::mapping::text(&environment, &rows);
    output::print(context.format, text, json, || report::mapping::csv_of(&json()))?;
    Ok(Answer::Yes)
}

/// `nsim bench step`.
fn step(args: &StepArgs, context: Context) -> Result<Answer, Error> {
    let networks: Vec<StandardNetwork> = match args.network.as_slice() {
        [] => StandardNetwork::ALL.to_vec(),
        given => given.to_vec(),
    };
    let environment = output::environment();
    let budget = args.steps.map_or(Budget::Time(args.seconds), Budget::Steps);
    let bar = progress::bar(context, networks.len() as u64, "networks");
    let mut rows = Vec::new();
    // Networks that share a program are mapped and flattened once.
    for same in networks.chunk_by(|a, b| a.program_of() == b.program_of()) {
        fn build(standard: StandardNetwork) -> Result<BenchNetwork, Error> {
            standard.build().map_err(|e| fault(standard, &e))
        }
        let BenchNetwork { network, target, .. } = build(same[0])?;
        let program = map(same[0], network, target)?;
        let part = match ranks::several() {
            Some(ranks) => part_of(&program, ranks)?,
            None => program,
        };
        let images = Images::new(part);
        for standard in same {
            let BenchNetwork { period, .. } = build(*standard)?;
            rows.extend(step_rows(*standard, &images, &period, budget, context)?);
            bar.add(1);
        }
    }
    drop(bar);
    ranks::leave_to_first();
    let json = || report::step::json(&environment, &rows);
    let text = || report::step::text(&environment, &rows);
    output::print(context.format, text, json, || report::step::csv_of(&json()))?;
    Ok(Answer::Yes)
}

/// Images of a program for one thread and for all threads, each made on first use.
struct Images {
    program: Arc<Program>,
    one: OnceCell<Arc<Image>>,
    shared: OnceCell<Arc<Image>>,
}

impl Images {
    fn new(program: Arc<Program>) -> Self {
        Images { program, one: OnceCell::new(), shared: OnceCell::new() }
    }

    fn get(&self, standard: StandardNetwork, threads: usize) -> Result<&Arc<Image>, Error> {
        let place = if threads == 1 { &self.one } else { &self.shared };
        if let Some(image) = place.get() {
            return Ok(image);
        }
        let begin = Instant::now();
        let image = Image::new(&self.program, threads).map_err(|e| fault(standard, &e))?;
        tracing::info!("{}: image {:.3} s", standard.name(), begin.elapsed().as_secs_f64());
        Ok(place.get_or_init(|| image))
    }
}

/// Rows of one network: with and without skipping on one thread, and on all threads where that may
/// be faster.
fn step_rows(
    standard: StandardNetwork,
    images: &Images,
    period: &Sample,
    budget: Budget,
    context: Context,
) -> Result<Vec<StepRow>, Error> {
    let mut wanted = vec![(1, true)];
    if let Budget::Time(_) = budget {
        wanted.push((1, false));
    }
    if standard.wants_threads() && context.threads > 1 {
        wanted.push((context.threads, true));
    }
    let own = images.program.synapses_of(|_| true);
    let measured = wanted.into_iter().map(|(threads, skip)| {
        let image = images.get(standard, threads)?;
        let settings = Settings { skip, per_step: false };
        let ranks = ranks::several();
        let mut machine =
            ranks.map_or_else(|| Machine::new(image, settings), |ranks| Machine::of_part(image, settings, ranks, None));
        let agreed = |number| ranks.map_or(number, |ranks| ranks.agreed(number));
        // The threads of a step need a caller in their pool, as in a run.
        let measured = match threads {
            1 => measure_agreed(&mut machine, period, budget, agreed),
            _ => rayon::scope(|_| measure_agreed(&mut machine, period, budget, agreed)),
        };
        let bytes = (image.bytes() + machine.bytes()) as u64;
        let (measured, bytes, synapses) = sum_over_ranks(measured, bytes, own);
        let begin = Instant::now();
        black_box(machine.take_activity());
        Ok(StepRow {
            network: standard.name(),
            threads,
            skip,
            measured,
            bytes_per_synapse: bytes as f64 / synapses.max(1) as f64,
            sums_ms: begin.elapsed().as_secs_f64() * 1e3,
            ranks: ranks.map_or(1, Ranks::ranks),
        })
    });
    measured.collect()
}

/// Measurement of this rank with the counts, bytes and synapses of all ranks on the first rank;
/// with its own on every other rank.
fn sum_over_ranks(measured: StepTiming, bytes: u64, synapses: u64) -> (StepTiming, u64, u64) {
    let Some(ranks) = ranks::several() else { return (measured, bytes, synapses) };
    let (mut totals, mut sums) = (measured.totals, (bytes, synapses));
    for (other, bytes, synapses) in ranks.gather::<_, (Totals, u64, u64)>(&(totals, bytes, synapses)) {
        totals += other;
        sums = (sums.0 + bytes, sums.1 + synapses);
    }
    (StepTiming { totals, ..measured }, sums.0, sums.1)
}

fn map(standard: StandardNetwork, network: Quantised, target: &str) -> Result<Arc<Program>, Error> {
    let target = io::target::load_target(target)?;
    let options = Options { share: ranks::share(), ..Options::default() };
    let compiled = compile(network, &target, &options).map_err(|error| match error {
        CompileError::Input(diagnostic) => diagnostic.into(),
        other => fault(standard, &other),
    })?;
    for (stage, seconds) in &compiled.seconds {
        tracing::info!("{}: {stage} {seconds:.3} s", standard.name());
    }
    Ok(compiled.program)
}

fn fault(standard: StandardNetwork, error: &dyn std::fmt::Display) -> Error {
    Error::Fault(format!("{}: {error}", standard.name()))
}
