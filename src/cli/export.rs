//! `nsim export MODEL -o FILE.nir`: a model in a form that other tools read.
//!
//! Input: a model of any kind that nsim reads. Output: a NIR file, and notes on what other tools
//! will not see of the model. nsim itself reads it back without loss.

use std::path::PathBuf;

use serde_json::json;

use crate::cli::args::timestep::TimestepArgs;
use crate::cli::context::{Answer, Context};
use crate::cli::output;
use nsim_files::write;
use nsim_import::foreign::{hdf5, nir_export};
use nsim_report::inspect::Findings;
use nsim_session::error::Error;

/// What was typed.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "EXAMPLES:
  nsim export vtsnn-slip -o slip.nir
  nsim export network.net -o network.nir        from one foreign form to another")]
pub struct Args {
    /// A model file or the name of a shipped model
    pub model: String,
    #[command(flatten)]
    timestep: TimestepArgs,
    /// The NIR file to write
    #[arg(short, long, value_name = "FILE.nir")]
    output: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// When the model cannot be read, is one that no command would run, or has parts that NIR has no
/// form for.
pub fn run(args: &Args, context: Context) -> Result<Answer, Error> {
    if args.output.extension().is_none_or(|extension| !extension.eq_ignore_ascii_case("nir")) {
        return Err(Error::Usage(format!("-o {}: models are exported as .nir", args.output.display())));
    }
    write::check_free(&args.output, context.force)?;
    let network = args.timestep.load(&args.model)?;
    nsim_session::front::check(&network)?;
    let model = network.resolved()?;
    let (tree, notes) = nir_export::export(&model)?;
    let bytes = hdf5::write(&tree)?;
    write::file(&args.output, context.force, |out| out.write_all(&bytes))?;
    for note in &notes {
        tracing::warn!("{note}");
    }
    let nodes = tree.group("node/nodes").map_or(0, |nodes| nodes.items.len());
    let found = Findings {
        kind: "NIR",
        facts: vec![
            ("model", json!(args.model)),
            ("written", json!(args.output.display().to_string())),
            ("nodes", json!(nodes)),
            ("bytes", json!(bytes.len())),
            ("notes", json!(notes)),
        ],
        tables: Vec::new(),
    };
    let file = args.output.display().to_string();
    output::print(context.format, || found.text(&file), || found.json("nsim.export/1", &file), || found.csv())?;
    Ok(Answer::Yes)
}
