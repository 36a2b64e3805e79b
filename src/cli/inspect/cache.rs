//! `nsim cache`: what is kept of mappings, and emptying it.

use serde_json::json;

use crate::cli::context::{Answer, Context};
use crate::cli::output;
use nsim_files::write::cache;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_session::error::Error;

/// Show or empty the cache of mappings
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "EXAMPLES:
  nsim cache                   where it is, and how much it holds
  nsim cache --clear           remove every mapping that is kept
  nsim run model.ron --no-cache    neither read nor write it")]
pub struct Args {
    /// Remove every mapping that is kept
    #[arg(long)]
    clear: bool,
}

/// The command.
///
/// # Errors
/// When the system names no folder for it, or the folder cannot be listed.
pub fn run(args: &Args, context: Context) -> Result<Answer, Error> {
    let none = || {
        Diagnostic::new("cache.folder", "the system names no folder for what users' programs keep")
            .help("set XDG_CACHE_HOME or HOME; without a folder nothing is kept")
    };
    let folder = cache::folder().ok_or_else(none)?;
    let removed = if args.clear { cache::keep(&folder, 0)? } else { 0 };
    let entries = cache::entries(&folder)?;
    let bytes: u64 = entries.iter().map(|entry| entry.bytes).sum();
    let (place, most) = (folder.display().to_string(), cache::MOST_BYTES);
    let text = || {
        let removed = if args.clear { format!("removed {removed}; ") } else { String::new() };
        format!("{place}\n{removed}{} mappings, {:.1} of at most {} MiB\n", entries.len(), mib(bytes), most >> 20)
    };
    let json = || {
        json!({
            "schema": "nsim.cache/1", "folder": place, "entries": entries.len(), "bytes": bytes, "most_bytes": most,
            "removed": removed,
        })
    };
    let csv = || {
        Ok(format!("folder,entries,bytes,most_bytes,removed\n\"{place}\",{},{bytes},{most},{removed}\n", entries.len()))
    };
    output::print(context.format, text, json, csv)?;
    Ok(Answer::Yes)
}

fn mib(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 20)
}
