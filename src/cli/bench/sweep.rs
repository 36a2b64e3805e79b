//! `nsim bench sweep`: run time a synaptic event along properties of networks and runs.

use crate::cli::context::{Answer, Context};
use crate::cli::output;
use crate::cli::process::progress;
use nsim_report::bench::ladders as report;
use nsim_session::error::Error;
use nsim_study::ladders::{LadderCase, ladder_cases, mark_cliffs};

const EXAMPLES: &str = "\
EXAMPLES:
  nsim bench sweep                            fan-out, delays, sample length, kernels and more, step by step
  nsim bench sweep --seed 7                   the same ladders on other networks
  nsim bench sweep --format json > sweep.json with the environment, for comparison";

/// Run time of a synaptic event along fan-out, delays, steps of a sample, sparsity, populations,
/// kernels, strategies and threads, on networks sampled by a seed; cliffs are marked
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct SweepArgs {
    /// Seed of the networks
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
}

/// The answer is no when there is a cliff.
pub fn run(args: &SweepArgs, context: Context) -> Result<Answer, Error> {
    let environment = output::environment();
    let cases = ladder_cases(args.seed, context.threads);
    let mut rows = progress::with_bar(context, cases.len(), "rungs", |done| {
        cases.iter().map(LadderCase::measure).inspect(|_| done()).collect::<Result<Vec<_>, _>>()
    })?;
    mark_cliffs(&mut rows);
    let json = || report::json(args.seed, &environment, &rows);
    output::print(context.format, || report::text(args.seed, &environment, &rows), json, || report::csv_of(&json()))?;
    Ok(if rows.iter().any(|row| row.is_cliff) { Answer::No } else { Answer::Yes })
}
