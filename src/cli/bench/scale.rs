//! `nsim bench scale`: a step on one and two ranks, and what many would take.

use std::time::Duration;

use crate::cli::args::values;
use crate::cli::context::{Answer, Context};
use crate::cli::output;
use crate::cli::process::ranks;
use nsim_compile::Options;
use nsim_energy::environment::Environment;
use nsim_energy::measure::Budget;
use nsim_files as io;
use nsim_report::bench::scale::{Modelled, ScaleReport};
use nsim_session::error::Error;
use nsim_session::handed::compile_on;
use nsim_study::networks::{BenchNetwork, StandardNetwork};
use nsim_study::scale::measured::{MeasuredStep, PROGRAM_BYTES, exchange, on_all, on_one};
use nsim_study::scale::model::{Costs, ScaleJob};

const EXAMPLES: &str = "\
EXAMPLES:
  mpirun -n 2 nsim bench scale                              a step on one and two ranks here, and on 10 to 10,000
  nsim bench scale                                          without an exchange measured
  nsim bench scale --latency-us 1.2 --bandwidth-gb-s 25     on another network between ranks
  nsim bench scale --network random-1m --compartments 1e8 --format json";

/// Numbers of ranks that are modelled.
const RANKS: [u32; 7] = [1, 10, 30, 100, 1_000, 3_000, 10_000];
/// Time of an id where none was measured: it is written once, sorted out, and read once.
const ID_NS: f64 = 1.0;
/// What is near: the share of synapses that stay on a rank, and the ranks around it, in three
/// dimensions.
const NEAR: (f64, u32) = (0.9, 26);

/// Time, exchange and memory of a step on one and two ranks, and by a model of latency and
/// bandwidth on 10 to 10,000
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct ScaleArgs {
    /// The standard network that is measured
    #[arg(long, value_name = "NAME", default_value = "random-32k", value_parser = random)]
    network: StandardNetwork,
    /// Seconds of each measurement
    #[arg(long, value_name = "S", default_value = "1", value_parser = values::seconds)]
    seconds: Duration,
    /// Compartments that are modelled
    #[arg(long, value_name = "N", default_value = "1e9", value_parser = positive)]
    compartments: f64,
    /// Time from rank to rank, on the network between them
    #[arg(long, value_name = "US", default_value = "1.5", value_parser = positive)]
    latency_us: f64,
    /// Time that a rank spends on each message
    #[arg(long, value_name = "US", default_value = "0.3", value_parser = positive)]
    overhead_us: f64,
    /// Bytes that a rank sends, in gigabytes a second
    #[arg(long, value_name = "GB/S", default_value = "12.5", value_parser = positive)]
    bandwidth_gb_s: f64,
}

fn random(name: &str) -> Result<StandardNetwork, String> {
    let known = [StandardNetwork::Random32k, StandardNetwork::Random1m];
    let named = StandardNetwork::named(name).filter(|standard| known.contains(standard));
    named.ok_or_else(|| "networks are: random-32k, random-1m".to_string())
}

fn positive(text: &str) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|_| format!("'{text}' is not a number"))?;
    Some(number)
        .filter(|number| *number > 0.0 && *number <= 1e15)
        .ok_or_else(|| "a number above 0, at most 1e15".into())
}

/// Runs the command.
///
/// # Errors
/// [`Error::Fault`] when a standard network cannot be made.
pub fn run(args: &ScaleArgs, context: Context) -> Result<Answer, Error> {
    ranks::price();
    let environment = Environment::here();
    output::warn_of_debug_build(&environment);
    let name = args.network.name();
    let fault = |error: &dyn std::fmt::Display| Error::Fault(format!("{name}: {error}"));
    let BenchNetwork { network, period, target } = args.network.build().map_err(|error| fault(&error))?;
    let target = io::target::load_target(target)?;
    let options = Options { share: ranks::share(), ..Options::default() };
    let program = compile_on(ranks::several(), network, &target, &options).map_err(|error| fault(&error))?.program;
    let budget = Budget::Time(args.seconds);
    let (mut measured, mut exchanges) = (Vec::new(), Vec::new());
    if program.held_rank().is_none() {
        measured.push(on_one(&program, &period, budget)?);
    }
    if let Some(ranks) = ranks::several() {
        // The others wait here until the first has measured itself alone.
        let step = on_all(&program, ranks, &period, budget)?;
        let of_rank = ranks.agreed((step.spikes / f64::from(ranks.ranks())) as u64) as usize;
        measured.push(step);
        exchanges.extend([0, 110, of_rank.max(1)].map(|ids| exchange(ranks, ids)));
    }
    ranks::leave_to_first();
    let costs = costs(
        args,
        &measured,
        exchanges.first().zip(exchanges.last()).map(|(none, some)| {
            let more = (some.ids - none.ids).max(1) as f64;
            ((some.us - none.us) / more * 1e3).max(0.0)
        }),
    );
    let even = ScaleJob { compartments: args.compartments, fan_out: 64.0, rate: 0.01, local: 0.0, neighbours: None };
    let near = ScaleJob { local: NEAR.0, neighbours: Some(NEAR.1), ..even };
    let on_many = |name, job: ScaleJob| {
        let steps = RANKS.iter().map(|&ranks| costs.step(&job, ranks)).collect();
        Modelled { name, job, steps }
    };
    let modelled = [
        on_many("64 synapses to compartments anywhere, 1 % firing", even),
        on_many("the same, nine in ten on their rank and the rest on 26 ranks around it", near),
    ];
    let report = ScaleReport {
        environment: &environment,
        network: name,
        measured: &measured,
        exchanges: &exchanges,
        costs,
        modelled: &modelled,
    };
    output::print(context.format, || report.text(), || report.json(), || report.csv())?;
    Ok(Answer::Yes)
}

/// What a rank costs, from what was measured, and what the network costs that is given. `id_ns` is
/// the time of an id in an exchange.
fn costs(args: &ScaleArgs, measured: &[MeasuredStep], id_ns: Option<f64>) -> Costs {
    let one = measured.first().copied();
    let per_compartment = |value: f64, step: &MeasuredStep| value / step.compartments.max(1) as f64;
    let compartment_ns = one.map_or(0.0, |step| per_compartment(step.timing.us_per_timestep * 1e3, &step));
    // Of a rank among R: a N + b S / R bytes; of one, a N + b S.
    let split = |one: &MeasuredStep, all: &MeasuredStep| {
        let parts = f64::from(all.ranks);
        let of_synapses = (one.bytes as f64 - all.bytes as f64) / (1.0 - 1.0 / parts);
        (per_compartment(one.bytes as f64 - of_synapses, one).max(0.0), of_synapses / one.synapses.max(1) as f64)
    };
    let (machine, synapse_bytes) = match measured {
        [one, .., all] => split(one, all),
        [one] => (0.0, one.bytes as f64 / one.synapses.max(1) as f64),
        [] => (0.0, 0.0),
    };
    Costs {
        compartment_ns,
        id_ns: id_ns.unwrap_or(ID_NS),
        latency_us: args.latency_us,
        overhead_us: args.overhead_us,
        bandwidth_gb_s: args.bandwidth_gb_s,
        replicated_bytes: machine + PROGRAM_BYTES as f64,
        synapse_bytes,
    }
}
