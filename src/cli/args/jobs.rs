//! From MODEL, `--target` and `--mapping` to a job that an engine can run.

use std::path::PathBuf;

use crate::cli::args::conversion::TapsArgs;
use crate::cli::args::reading::ReadingArgs;
use crate::cli::context::{Answer, Context};
use crate::cli::diagnostics;
use crate::cli::process::advice::with_owners;
use crate::cli::process::progress;
use crate::cli::process::ranks;
use nsim_compile::{CopyPlacement, Options, Reason};
use nsim_files as io;
use nsim_files::network::Network;
use nsim_ir::hardware::Target;
use nsim_session::error::{Error, Result};
use nsim_session::inputs;
use nsim_session::obtain::{EngineKind, Job, Request, TargetChoice, obtain};
use nsim_train::convert::prepare::conversion;
use nsim_train::convert::taps;

/// Parses a population and the compartments of a core of it.
fn cores_of(typed: &str) -> Result<(String, u32), String> {
    let parsed = typed.rsplit_once('=').and_then(|(name, each)| Some((name, each.parse().ok()?)));
    match parsed {
        Some((name, each @ 1..)) if !name.is_empty() => Ok((name.to_string(), each)),
        _ => Err("is not POPULATION=N with N neurons a core, at least 1".to_string()),
    }
}

/// Options of a new mapping, for every command that maps a network.
#[derive(Debug, Clone, clap::Args)]
pub struct MappingArgs {
    /// Add relay compartments where spikes reach more cores than a compartment or a core has output
    /// axons; let sources share input axons where a core has too few
    #[arg(help_heading = "Mapping", long)]
    pub relays: bool,
    /// Prune parts that change no output: none; static, for every input; or for an INPUT as in
    /// --input, which also removes channels that never spike in it
    #[arg(help_heading = "Mapping", long, value_name = "none|static|INPUT")]
    pub prune: Vec<String>,
    #[command(flatten)]
    pub taps: TapsArgs,
}

impl Default for MappingArgs {
    fn default() -> Self {
        MappingArgs { relays: false, prune: Vec::new(), taps: TapsArgs { most_taps: taps::DEFAULT_TAPS as u32 } }
    }
}

/// Network and hardware of a job.
#[derive(Debug, Clone, clap::Args)]
pub struct JobArgs {
    /// A model file or the name of a shipped model
    #[arg(value_name = "MODEL", default_value = "vtsnn-slip")]
    pub model: String,
    #[command(flatten)]
    pub reading: ReadingArgs,
    /// A target file or the name of a shipped target [default: the model's own, or nahuku-32]
    #[arg(long)]
    pub target: Option<String>,
    /// A mapping saved by `nsim map -o`
    #[arg(help_heading = "Mapping", long, value_name = "MAPPING.ron")]
    pub mapping: Option<PathBuf>,
    /// Neurons a core, by population, such as from the log of a board; the last core takes the rest
    #[arg(
        help_heading = "Mapping", long, value_name = "POP=N,..", value_delimiter = ',', value_parser = cores_of,
        conflicts_with = "mapping"
    )]
    pub cores_of: Vec<(String, u32)>,
    #[command(flatten)]
    pub anew: MappingArgs,
    /// Placement of copies of the model.
    #[arg(skip)]
    pub placement: CopyPlacement,
    /// Whether the model has to name a scene: energy depends on activity, and no input is given.
    #[arg(skip)]
    pub needs_scene: bool,
}

impl JobArgs {
    /// A model on the default target, unpruned.
    pub fn for_model(model: &str) -> Self {
        JobArgs {
            model: model.to_string(),
            reading: ReadingArgs::default(),
            target: None,
            mapping: None,
            cores_of: Vec::new(),
            anew: MappingArgs::default(),
            placement: CopyPlacement::default(),
            needs_scene: false,
        }
    }

    /// Request for a loaded network.
    pub fn request<'a>(&'a self, network: &'a Network) -> Request<'a> {
        Request {
            target: TargetChoice::Named(self.target.as_deref()),
            mapping: self.mapping.as_deref(),
            options: Options { placement: self.placement, share: ranks::share(), ..Options::default() },
            prune: &self.anew.prune,
            relays: self.anew.relays,
            cores_of: &self.cores_of,
            ..Request::new(&self.model, network, conversion(self.anew.taps.most()))
        }
    }
}

/// Reasons for which a model does not fit its target.
#[derive(Debug)]
pub struct Refusal {
    model: String,
    target: Box<Target>,
    reasons: Vec<Reason>,
}

impl Refusal {
    /// Refusal of a model on a target, with advice for the running command.
    pub fn new(model: &str, target: Target, mut reasons: Vec<Reason>) -> Self {
        reasons.iter_mut().for_each(|reason| reason.help = with_owners(&reason.help));
        Refusal { model: model.to_string(), target: Box::new(target), reasons }
    }

    /// The reasons.
    pub fn reasons(&self) -> &[Reason] {
        &self.reasons
    }

    /// Prints the reasons on stderr. With JSON it also prints `object`, the empty result of the
    /// command, with model, target and reasons.
    pub fn print(&self, mut object: serde_json::Value, context: Context) -> Result<Answer> {
        let text = nsim_report::map::refusal(&self.model, &self.target, &self.reasons);
        diagnostics::write_stderr(&text);
        if context.format == crate::cli::context::Format::Json {
            object["model"] = self.model.as_str().into();
            object["target"] = self.target.name().into();
            object["fits"] = false.into();
            object["reasons"] = serde_json::json!(self.reasons);
            progress::print(&format!("{object:#}\n"))?;
        }
        Ok(Answer::No)
    }
}

/// Loads a model and prepares it for an engine, or returns the reasons for which it does not fit.
/// `copies` defaults to the number of the saved mapping, else 1. Populations that match a pattern
/// of `probed` are never pruned.
pub fn prepare(
    args: &JobArgs,
    engine: EngineKind,
    copies: Option<u32>,
    probed: &[&str],
) -> Result<Result<Job, Refusal>> {
    let network = args.reading.load(&args.model)?;
    if args.needs_scene {
        let help = "give spikes with --input FILE, or --input scene:noise to try";
        inputs::require_scene(&args.model, network.file().scene.as_deref(), help)?;
    }
    prepare_loaded(args, &network, engine, copies, probed)
}

/// As [`prepare`], for a loaded model.
pub fn prepare_loaded(
    args: &JobArgs,
    network: &Network,
    engine: EngineKind,
    copies: Option<u32>,
    probed: &[&str],
) -> Result<Result<Job, Refusal>> {
    let request = Request { engine, copies, probed, ..args.request(network) };
    let _busy = progress::stage(if args.mapping.is_some() { "checking the mapping" } else { "mapping" });
    match obtain(&request) {
        Err(Error::DoesNotFit(reasons)) => {
            let target = io::target::load_target(network.file().target_or_usual(args.target.as_deref()))?;
            Ok(Err(Refusal::new(&network.file().name, target, reasons)))
        }
        job => job.map(Ok),
    }
}
