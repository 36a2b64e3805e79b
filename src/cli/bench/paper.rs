//! `nsim bench paper`: the tables of the paper on visual and tactile sensing beside what was measured here.

use std::path::PathBuf;

use crate::bench::published::paper;
use crate::cli::context::{Answer, Context};
use crate::cli::output;
use crate::error::Error;
use crate::io;
use crate::report::bench::paper::PaperReport;

const EXAMPLES: &str = "\
EXAMPLES:
  nsim bench paper                          every table, printed figures beside stored results
  nsim bench paper --format csv > rows.csv  a row a figure
  nsim bench paper --markdown tables.md     as sections of a document
  nsim bench paper --results mine.json      with rows of one's own instead of those stored";

/// The tables of Taunyazov et al. 2020 on classification, early decisions and hardware: each figure as printed beside what
/// trainings with nsim came to, and what those rest on
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct PaperArgs {
    /// Files of rows that take the place of stored ones: {"rows": [{"table": .., "task": .., "measured": ..}]}
    #[arg(long, value_name = "FILE.json")]
    results: Vec<PathBuf>,
    /// Write the tables as Markdown
    #[arg(long, value_name = "FILE.md")]
    markdown: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// [`Error`] when a file of results cannot be read, or the document cannot be written.
pub fn run(args: &PaperArgs, context: Context) -> Result<Answer, Error> {
    let taken = output::check_files(&args.markdown, None, context)?;
    let mut given = Vec::new();
    for path in &args.results {
        let source = io::text::read_text(path)?;
        given.extend(paper::parse(&path.display().to_string(), source.text())?);
    }
    let rows = paper::rows(given)?;
    let report = PaperReport { rows: &rows };
    if let Some(path) = &args.markdown {
        io::write::text(path, context.force, &report.markdown())?;
    }
    if !taken {
        output::print(context.format, || report.text(), || report.json(), || report.csv())?;
    }
    Ok(Answer::Yes)
}
