//! `nsim show NAME`: a shipped file as it is, or a stage of the compiler (`--as`), as RON.
//!
//! Input: the name of a shipped file, or its kind and name (`chips/tiny`) where several have it, or
//! the path of a file; a training file is found by its name where no other file has it. With `--as`
//! a model. Output: its text, which can be saved, changed and used instead of it; or the network in
//! integers, its cores, their places, or their tables, as `nsim::ir` reads them.

use std::path::{Path, PathBuf};

use serde_json::json;

use crate::cli::args::jobs::{JobArgs, prepare};
use crate::cli::args::values::one_of;
use crate::cli::context::{Answer, Context, Format};
use crate::cli::output;
use crate::cli::process::progress;
use nsim_files as io;
use nsim_files::mapping::pretty;
use nsim_files::shipped::{self, Shipped};
use nsim_ir::base::names::named_variants;
use nsim_session::error::Error;
use nsim_session::obtain::EngineKind;

named_variants! {
    /// A stage of the compiler.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum Stage {
        /// The network in integers.
        Quantised = "quantised",
        /// Its compartments on logical cores.
        Partition = "partition",
        /// The cores' places on the mesh.
        Placement = "placement",
        /// The tables of the cores.
        Program = "program",
    }
}

/// Print a shipped model, training file, target, chip or preset of constants, or a stage of the
/// compiler, as RON
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "EXAMPLES:
  nsim show nahuku-32                      a target
  nsim show chips/loihi1 > chip.ron        its chip, to be changed
  nsim show davies2018                     a preset of constants
  nsim show                                all names
  nsim show model.ron --as quantised       a model in integers that fit their hardware fields
  nsim show model.ron --as program --target loihi1-chip -o program.ron   the tables of its cores")]
pub struct Args {
    /// A shipped name, with its kind before it where several files have it, or a file; with --as, a
    /// model file or the name of a shipped model
    pub name: Option<String>,
    /// A stage of the compiler instead: the network in integers, its compartments on cores, the
    /// places of the cores, or their tables
    #[arg(long = "as", value_name = "STAGE", value_parser = one_of(&Stage::ALL, Stage::name), requires = "name")]
    pub stage: Option<Stage>,
    /// The target of the compiler: a file or the name of a shipped target [default: the model's
    /// own, or nahuku-32]
    #[arg(long, requires = "stage")]
    pub target: Option<String>,
    /// Copies of the model that the compiler maps
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), requires = "stage")]
    pub copies: Option<u32>,
    /// Where to save the text
    #[arg(short, long)]
    pub output: Option<PathBuf>,
}

/// A model that does not fit is an answer, not an error.
pub fn run(args: &Args, context: Context) -> Result<Answer, Error> {
    let Some(name) = &args.name else {
        let names: Vec<&str> = all().map(without_extension).collect();
        let text = match context.format {
            Format::Json => format!("{:#}\n", json!({ "schema": "nsim.show/1", "names": names })),
            _ => names.iter().map(|name| format!("{name}\n")).collect(),
        };
        progress::print(&text)?;
        return Ok(Answer::Yes);
    };
    output::check_files(&args.output, [], context)?;
    let (name, text) = match args.stage {
        None if shipped::is_path(name) && Path::new(name).is_file() => {
            (name.as_str(), io::text::read_text(Path::new(name))?.text().to_string())
        }
        None => find(name).map(|file| (without_extension(file), file.text.to_string()))?,
        Some(stage) => {
            let job = JobArgs { target: args.target.clone(), ..JobArgs::for_model(name) };
            let engine = if stage == Stage::Quantised { EngineKind::Quantised } else { EngineKind::Mapped };
            let job = match prepare(&job, engine, args.copies.or(Some(1)), &[])? {
                Ok(job) => job,
                Err(why) => return why.print(json!({ "schema": "nsim.show/1", "name": name }), context),
            };
            // At these depths an entry of a table takes a line.
            let text = match (stage, job.mapped()) {
                (Stage::Partition, Some((compiled, _))) => pretty(&compiled.partition, 2)?,
                (Stage::Placement, Some((compiled, _))) => pretty(&compiled.placement, 2)?,
                (Stage::Program, Some((compiled, _))) => pretty(&compiled.program, 5)?,
                _ => pretty(job.quantised(), 3)?,
            };
            (name.as_str(), text)
        }
    };
    if let Some(path) = &args.output {
        io::write::text(path, context.force, &text)?;
    } else if context.format == Format::Json {
        progress::print(&format!("{:#}\n", json!({ "schema": "nsim.show/1", "name": name, "text": text })))?;
    } else {
        progress::print(&text)?;
    }
    Ok(Answer::Yes)
}

fn all() -> impl Iterator<Item = &'static Shipped> {
    shipped::TABLES.iter().flat_map(|table| table.iter()).chain(shipped::TRAININGS)
}

fn without_extension(file: &'static Shipped) -> &'static str {
    file.path.strip_suffix(".ron").unwrap_or(file.path)
}

fn find(name: &str) -> Result<&'static Shipped, Error> {
    let stem = name.strip_suffix(".ron").unwrap_or(name);
    let is = |file: &&'static Shipped| {
        let path = without_extension(file);
        path == stem || file.name == stem || path.strip_suffix(stem).is_some_and(|folder| folder.ends_with('/'))
    };
    // Many training files have the name of their model.
    let is_training = |file: &&'static Shipped| file.path.starts_with("models/train/");
    let (trainings, mut found): (Vec<_>, Vec<_>) = all().filter(is).partition(is_training);
    if found.is_empty() {
        found = trainings;
    }
    match found.as_slice() {
        [one] => Ok(*one),
        [] => Err(Error::Usage(format!("there is no shipped file {name}; nsim show lists them"))),
        several => {
            let names: Vec<&str> = several.iter().map(|file| without_extension(file)).collect();
            let (first, names) = (names[0], names.join(", "));
            let help = format!("type one, as in nsim show {first}: {names}");
            Err(Error::Usage(format!("several files are named {name}; {help}")))
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::cli::inspect::show::*;

    #[test]
    fn shipped_files_are_found_by_name_and_by_kind() {
        assert!(find("nahuku-32").unwrap().text.contains("Target("));
        assert!(find("chips/tiny").unwrap().text.contains("Chip("));
        assert_eq!(find("mapping/chips/tiny.ron").unwrap().text, find("chips/tiny").unwrap().text);
        assert_eq!(find("slip-tactile").unwrap().path, "models/slip-tactile.ron");
        assert_eq!(find("train/slip-tactile").unwrap().path, "models/train/slip-tactile.ron");
        assert_eq!(find("paper-slip-both").unwrap().path, "models/train/paper/slip-both.ron");
        assert!(find("tiny").unwrap_err().to_string().contains("mapping/targets/tiny"));
        assert_eq!(find("iny").unwrap_err().exit_status(), 2);
        assert!(all().count() > 20);
    }
}
