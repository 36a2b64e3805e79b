//! `nsim export MODEL -o FILE.nir`: writes a model in a format of other tools.
//!
//! Input: a model of any kind that nsim reads. Output: a NIR file or a netx file of lava-dl, and
//! notes on the parts of the model that other tools ignore. nsim itself reads it back without loss.

use std::path::PathBuf;

use serde_json::json;

use crate::cli::args::reading::ReadingArgs;
use crate::cli::context::{Answer, Context};
use crate::cli::output;
use nsim_files::write;
use nsim_import::foreign::{self, netx_export, nir_export};
use nsim_report::inspect::Findings;
use nsim_session::error::Error;

/// Command-line arguments.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "EXAMPLES:
  nsim export vtsnn-slip -o slip.nir
  nsim export network.net -o network.nir        from one foreign form to another
  nsim export pilotnet.ron -o pilotnet.net      layers in a row, for lava-dl's netx")]
pub struct Args {
    /// A model file or the name of a shipped model
    pub model: String,
    #[command(flatten)]
    reading: ReadingArgs,
    /// The NIR file to write, or the netx file (.net)
    #[arg(short, long, value_name = "FILE.nir")]
    output: PathBuf,
}

pub fn run(args: &Args, context: Context) -> Result<Answer, Error> {
    let has = |other: &str| args.output.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(other));
    let (kind, parts, path) = match (has("nir"), has("net")) {
        (true, _) => ("NIR", "nodes", "node/nodes"),
        (_, true) => ("lava-dl netx", "layers", "layer"),
        _ => return Err(Error::Usage(format!("-o {}: models are exported as .nir or .net", args.output.display()))),
    };
    write::check_free(&args.output, context.force)?;
    let network = args.reading.load(&args.model)?;
    nsim_session::front::check(&network)?;
    let model = network.resolved()?;
    let (tree, notes) = if has("nir") { nir_export::export(&model)? } else { netx_export::export(&model)? };
    let count = tree.group(path).map_or(0, |group| group.items.len());
    let bytes = foreign::exported(&args.output, tree, &model)?;
    write::file(&args.output, context.force, |out| out.write_all(&bytes))?;
    for note in &notes {
        tracing::warn!("{note}");
    }
    let findings = Findings {
        kind,
        facts: vec![
            ("model", json!(args.model)),
            ("written", json!(args.output.display().to_string())),
            (parts, json!(count)),
            ("bytes", json!(bytes.len())),
            ("notes", json!(notes)),
        ],
        tables: Vec::new(),
    };
    let file = args.output.display().to_string();
    output::print(
        context.format,
        || findings.text(&file),
        || findings.json("nsim.export/1", &file),
        || findings.csv(),
    )?;
    Ok(Answer::Yes)
}
