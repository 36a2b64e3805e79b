//! From MODEL, `--target` and `--mapping` to something that can run.

use std::path::PathBuf;

use crate::cli::{Answer, Context, complain};
use crate::compile::{self, CompileError, Compiled, Options, Reason};
use crate::desc::mapping::MappingFile;
use crate::desc::network::Network;
use crate::desc::target::Target;
use crate::error::Error;
use crate::io;
use crate::ir::program::Program;
use crate::ir::quantised::Quantised;
use crate::report;

/// What names the network and the hardware.
#[derive(Debug, Clone, clap::Args)]
pub struct JobArgs {
    /// A model file or the name of a shipped model
    #[arg(value_name = "MODEL", default_value = "vtsnn-slip")]
    pub model: String,
    /// A target file or the name of a shipped target
    #[arg(long, default_value = "nahuku-32")]
    pub target: String,
    /// A mapping saved by `nsim map -o`
    #[arg(long, value_name = "MAPPING.ron")]
    pub mapping: Option<PathBuf>,
}

/// A network ready to run.
#[derive(Debug)]
pub enum Job {
    /// Mapped onto a target.
    Mapped(Box<Compiled>, Box<Target>, Option<String>),
    /// Only quantised, for the golden engine.
    Quantised(Box<Quantised>, Option<String>),
}

/// A job, or the answer that there is none.
#[derive(Debug)]
pub enum Prepared {
    /// It can run.
    Ready(Job),
    /// It does not fit; the reasons have been said.
    DoesNotFit(Answer),
}

impl Job {
    /// The network in integers.
    #[must_use]
    pub fn quantised(&self) -> &Quantised {
        match self {
            Job::Mapped(compiled, _, _) => &compiled.quantised,
            Job::Quantised(quantised, _) => quantised,
        }
    }

    /// The program, when it is mapped.
    #[must_use]
    pub fn program(&self) -> Option<&Program> {
        match self {
            Job::Mapped(compiled, _, _) => Some(&compiled.program),
            Job::Quantised(..) => None,
        }
    }

    /// The compiled network and its target, when it is mapped.
    #[must_use]
    pub fn mapped(&self) -> Option<(&Compiled, &Target)> {
        match self {
            Job::Mapped(compiled, target, _) => Some((compiled, target)),
            Job::Quantised(..) => None,
        }
    }

    /// The target's name.
    #[must_use]
    pub fn target_name(&self) -> &str {
        match self {
            Job::Mapped(_, target, _) => target.name(),
            Job::Quantised(..) => "",
        }
    }

    /// The model's own stimulus.
    #[must_use]
    pub fn scene(&self) -> Option<&str> {
        match self {
            Job::Mapped(_, _, scene) | Job::Quantised(_, scene) => scene.as_deref(),
        }
    }
}

/// Loads a model, and maps it unless only the golden engine is wanted.
///
/// # Errors
/// [`Error`] when a file cannot be used.
pub fn prepare(args: &JobArgs, mapped: bool, copies: u32, context: Context) -> Result<Prepared, Error> {
    let network = io::model::load_model(&args.model)?;
    let scene = network.file().scene.clone();
    if !mapped {
        let quantised = compile::quantise::quantise(&compile::lower::lower(&network)?)?;
        say_notes(&quantised);
        return Ok(Prepared::Ready(Job::Quantised(Box::new(quantised), scene)));
    }
    let target = io::target::load_target(&args.target)?;
    let options = Options { copies, ..Options::default() };
    let mapping = args.mapping.as_deref().map(io::mapping::load_mapping).transpose()?;
    match compiled(&network, &target, &options, mapping.as_ref()) {
        Ok(compiled) => {
            say_notes(&compiled.quantised);
            Ok(Prepared::Ready(Job::Mapped(Box::new(compiled), Box::new(target), scene)))
        }
        Err(error) => does_not_fit(error, &args.model, &target, context).map(Prepared::DoesNotFit),
    }
}

/// Compiles a network, onto the cores of a saved mapping when there is one.
///
/// # Errors
/// As [`compile::compile`].
pub fn compiled(
    network: &Network,
    target: &Target,
    options: &Options,
    mapping: Option<&MappingFile>,
) -> Result<Compiled, CompileError> {
    match mapping {
        Some(file) => compile::compile_network_with_mapping(network, target, options, file),
        None => compile::compile(network, target, options),
    }
}

fn say_notes(quantised: &Quantised) {
    for note in &quantised.parts().notes {
        tracing::info!("{}: {}", note.entity, note.message);
    }
}

/// Says why something does not fit; other errors pass through.
///
/// # Errors
/// [`Error`] unless the error is that it does not fit.
pub fn does_not_fit(error: CompileError, model: &str, target: &Target, context: Context) -> Result<Answer, Error> {
    match error {
        CompileError::Input(diagnostic) => Err(diagnostic.into()),
        CompileError::Fault(message) => Err(Error::Fault(message)),
        CompileError::DoesNotFit(reasons) => {
            say_reasons(model, target, &reasons, context)?;
            Ok(Answer::No)
        }
    }
}

fn say_reasons(model: &str, target: &Target, reasons: &[Reason], context: Context) -> Result<(), Error> {
    complain::say(&report::map::refusal(model, target, reasons));
    if context.format == crate::cli::Format::Json {
        let reasons: Vec<_> = reasons.iter().map(report::map::reason_json).collect();
        let object = serde_json::json!({
            "schema": "nsim.error/1", "code": "does-not-fit", "message": format!("{model} does not fit on {}", target.name()),
            "help": "see reasons; nsim map shows the same", "reasons": reasons,
        });
        io::write::stdout(&format!("{object:#}\n"))?;
    }
    Ok(())
}
