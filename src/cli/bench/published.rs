//! `nsim bench published`: published measurements next to the predictions of nsim.

use std::path::PathBuf;

use crate::cli::context::{Answer, Context};
use crate::cli::output;
use crate::cli::process::progress;
use nsim_energy::published::workload;
use nsim_files as io;
use nsim_report::bench::published as report;
use nsim_report::charts::picture::FILE;
use nsim_session::error::Error;
use nsim_study::published::rows;

/// Preset of constants whose findings are excluded, one work at a time.
const CONSTANTS: &str = "loihi1-evidence";

const EXAMPLES: &str = "\
EXAMPLES:
  nsim bench published                            every published figure, predicted with and without its own work
  nsim bench published --only vt-snn              of one work
  nsim bench published --plot published.svg       published against predicted, with intervals
  nsim bench published --format csv > rows.csv    a row a figure";

/// Published energies, powers and times of the chip, and nsim's predictions for their workloads:
/// once from all evidence for the constants, once without evidence from the work itself
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct PublishedArgs {
    /// Only works or workloads whose name contains this, for example vt-snn
    #[arg(long, value_name = "WORK")]
    only: Option<String>,
    /// Write a chart of published against predicted figures
    #[arg(long, visible_alias = "svg", value_name = FILE)]
    plot: Option<PathBuf>,
}

pub fn run(args: &PublishedArgs, context: Context) -> Result<Answer, Error> {
    let taken = output::check_files(None, &args.plot, context)?;
    let constants = io::target::load_constants(CONSTANTS)?;
    let mut workloads = workload::shipped()?;
    if let Some(only) = &args.only {
        let only = only.to_lowercase();
        let mut works: Vec<String> = workloads.iter().map(|file| file.work.clone()).collect();
        workloads.retain(|file| [&file.work, &file.name].iter().any(|name| name.to_lowercase().contains(&only)));
        if workloads.is_empty() {
            works.dedup();
            return Err(Error::Usage(format!("--only {only}: no such work; there are {}", works.join(", "))));
        }
    }
    let rows = progress::with_bar(context, workloads.len(), "workloads", |done| {
        rows(&workloads, &constants, |name| Ok(io::target::load_target(name)?), done)
    })?;
    if let Some(path) = &args.plot {
        output::write_picture(path, &report::svg(&rows), context)?;
    }
    if !taken {
        output::print(context.format, || report::text(&rows), || report::json(&rows), || report::csv(&rows))?;
    }
    Ok(Answer::Yes)
}
