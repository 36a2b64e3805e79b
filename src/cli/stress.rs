//! `nsim stress`: does the arithmetic hold at its edges?

use rayon::prelude::*;

use crate::cli::context::{Answer, Context};
use crate::cli::output;
use crate::cli::process::progress;
use nsim_agree::stress::{CASES, Case, Verdict};
use nsim_files as io;
use nsim_report::stress as report;
use nsim_session::error::Error;

const EXAMPLES: &str = "\
EXAMPLES:
  nsim stress                                 every case, with its verdict
  nsim stress --case ten-million-steps        one of them
  nsim stress --format json";

/// Run the numerical stability tests: overflow, rounding and long runs at the limits of every field
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Only these cases [default: all]
    #[arg(long, value_name = "NAME", num_args = 1.., value_parser = case)]
    case: Vec<&'static Case>,
}

fn case(name: &str) -> Result<&'static Case, String> {
    CASES.iter().find(|case| case.name == name).ok_or_else(|| {
        let names: Vec<&str> = CASES.iter().map(|case| case.name).collect();
        format!("cases are: {}", names.join(", "))
    })
}

/// The answer is no when a case fails.
pub fn run(args: &Args, context: Context) -> Result<Answer, Error> {
    let cases: Vec<&Case> = if args.case.is_empty() { CASES.iter().collect() } else { args.case.clone() };
    let target = io::target::load_target("loihi1-chip")?;
    let verdicts: Vec<Verdict> = progress::with_bar(context, cases.len(), "cases", |done| {
        cases.par_iter().with_max_len(1).map(|case| case.run(&target)).inspect(|_| done()).collect()
    });
    output::print(context.format, || report::text(&verdicts), || report::json(&verdicts), || report::csv(&verdicts))?;
    Ok(if verdicts.iter().all(|verdict| verdict.pass) { Answer::Yes } else { Answer::No })
}
