//! From MODEL, `--target` and `--mapping` to something that can run.

use std::path::PathBuf;
use std::sync::Arc;

use crate::cli::args::conversion::CopiesArgs;
use crate::cli::args::prune::PruneArgs;
use crate::cli::args::timestep::TimestepArgs;
use crate::cli::context::{Answer, Context};
use crate::cli::diagnostics;
use crate::cli::output;
use crate::cli::process::advice::with_owners;
use crate::cli::process::ranks;
use nsim_compile as compile;
use nsim_compile::parcel::Opened;
use nsim_compile::{
    CompileError, Compiled, CopyPlacement, DEFAULT_RATE, Form, Front, Mapping, Options, Reason, explore, mapping_file,
};
use nsim_files as io;
use nsim_files::network::Network;
use nsim_files::network::USUAL_TARGET;
use nsim_ir::base::id::PopulationId;
use nsim_ir::base::names::fits_pattern;
use nsim_ir::firing_rates::Rates;
use nsim_ir::graph::Graph;
use nsim_ir::hardware::Target;
use nsim_ir::mapping::MappingFile;
use nsim_ir::program::Program;
use nsim_ir::quantised::Quantised;
use nsim_machine::ranks::transport::Ranks;
use nsim_report as report;
use nsim_session::error::Error;
use nsim_session::front::real_and_integers;
use nsim_session::handed;
use nsim_session::inputs;
use nsim_train::convert::copies;
use nsim_train::convert::prepare::{has_srm, integers};

/// What names the network and the hardware.
#[derive(Debug, Clone, clap::Args)]
pub struct JobArgs {
    /// A model file or the name of a shipped model
    #[arg(value_name = "MODEL", default_value = "vtsnn-slip")]
    pub model: String,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub timestep: TimestepArgs,
    /// A target file or the name of a shipped target [default: the model's own, or nahuku-32]
    #[arg(long)]
    pub target: Option<String>,
    /// A mapping saved by `nsim map -o`
    #[arg(help_heading = "Mapping", long, value_name = "MAPPING.ron")]
    pub mapping: Option<PathBuf>,
    /// Add relay compartments where spikes reach more cores than a compartment or a core has output
    /// axons
    #[arg(help_heading = "Mapping", long)]
    pub relays: bool,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub prune: PruneArgs,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub copies: CopiesArgs,
    /// Where copies of the model are mapped.
    #[arg(skip)]
    pub placement: CopyPlacement,
    /// Whether a model has to name a scene: energy follows activity, and no spikes are given.
    #[arg(skip)]
    pub needs_scene: bool,
}

impl JobArgs {
    /// A model on the default target, unpruned.
    #[must_use]
    pub fn for_model(model: &str) -> Self {
        let prune = PruneArgs { prune: Vec::new() };
        let copies = CopiesArgs { delayed_copies: copies::USUAL as u32 };
        let placement = CopyPlacement::default();
        JobArgs {
            model: model.to_string(),
            timestep: TimestepArgs::default(),
            target: None,
            mapping: None,
            relays: false,
            prune,
            copies,
            placement,
            needs_scene: false,
        }
    }

    /// An error about the saved mapping, with its file and what to do.
    #[must_use]
    pub fn with_mapping_file(&self, error: CompileError) -> CompileError {
        match &self.mapping {
            Some(path) => mapping_file::explained(error, path, &self.model),
            None => error,
        }
    }
}

/// A network ready to run.
#[derive(Debug)]
pub enum Job {
    /// Mapped onto a target.
    Mapped(Box<Compiled>, Box<Target>, Option<String>),
    /// Only quantised, for the golden engine.
    Quantised(Box<Quantised>, Option<String>),
    /// In real numbers, for the reference engine; and in integers, which number its units alike.
    Real(Box<Graph>, Box<Quantised>, Option<String>),
}

/// What a job is to be ready for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wanted {
    /// The fast engine: mapped onto a target.
    Mapped,
    /// The golden engine.
    Quantised,
    /// The reference engine.
    Real,
    /// The reference engine when the model has spike response neurons, the fast one otherwise.
    ByModel,
}

/// A job, or the answer that there is none.
#[derive(Debug)]
pub enum Prepared {
    /// It can run.
    Ready(Job),
    /// It does not fit.
    DoesNotFit(Refusal),
}

/// Why something does not fit.
#[derive(Debug)]
pub struct Refusal {
    model: String,
    target: Box<Target>,
    reasons: Vec<Reason>,
}

impl Refusal {
    /// That this model does not fit this target for these reasons, to the user of this command.
    #[must_use]
    pub fn new(model: &str, target: Target, mut reasons: Vec<Reason>) -> Self {
        reasons.iter_mut().for_each(|reason| reason.help = with_owners(&reason.help));
        Refusal { model: model.to_string(), target: Box::new(target), reasons }
    }

    /// Prints the reasons on stderr and, as JSON, the command's own object with the keys of a run
    /// left empty.
    ///
    /// # Errors
    /// When stdout cannot be written.
    pub fn say(&self, mut object: serde_json::Value, context: Context) -> Result<Answer, Error> {
        let text = report::map::refusal(&self.model, &self.target, &self.reasons);
        diagnostics::say(&text);
        if context.format == crate::cli::context::Format::Json {
            object["model"] = self.model.as_str().into();
            object["target"] = self.target.name().into();
            object["fits"] = false.into();
            object["reasons"] = self.reasons.iter().map(report::map::reason_json).collect();
            io::write::stdout(&format!("{object:#}\n"))?;
        }
        Ok(Answer::No)
    }
}

impl Job {
    /// The network in integers.
    #[must_use]
    pub fn quantised(&self) -> &Quantised {
        match self {
            Job::Mapped(compiled, _, _) => &compiled.quantised,
            Job::Quantised(quantised, _) | Job::Real(_, quantised, _) => quantised,
        }
    }

    /// The program, when it is mapped.
    #[must_use]
    pub fn program(&self) -> Option<&Arc<Program>> {
        self.mapped().map(|(compiled, _)| &compiled.program)
    }

    /// The compiled network and its target, when it is mapped.
    #[must_use]
    pub fn mapped(&self) -> Option<(&Compiled, &Target)> {
        match self {
            Job::Mapped(compiled, target, _) => Some((compiled, target)),
            Job::Quantised(..) | Job::Real(..) => None,
        }
    }

    /// The target's name.
    #[must_use]
    pub fn target_name(&self) -> &str {
        self.mapped().map_or("", |(_, target)| target.name())
    }

    /// Copies of the model.
    #[must_use]
    pub fn copies(&self) -> u32 {
        self.mapped().map_or(1, |(compiled, _)| compiled.options.copies)
    }

    /// The model's own stimulus.
    #[must_use]
    pub fn scene(&self) -> Option<&str> {
        match self {
            Job::Mapped(_, _, scene) | Job::Quantised(_, scene) | Job::Real(_, _, scene) => scene.as_deref(),
        }
    }
}

/// Loads a model and makes it ready for an engine.
///
/// # Errors
/// [`Error`] when a file cannot be used.
pub fn prepare(args: &JobArgs, wanted: Wanted, copies: u32) -> Result<Prepared, Error> {
    prepare_probed(args, wanted, Some(copies), &[])
}

/// The same, with as many copies as a saved mapping has, or 1, unless it is said, and with the
/// populations that fit these patterns whole however much is pruned.
///
/// # Errors
/// As [`prepare`].
pub fn prepare_probed(args: &JobArgs, wanted: Wanted, copies: Option<u32>, probed: &[&str]) -> Result<Prepared, Error> {
    let Some(ranks) = ranks::several().filter(|_| matches!(wanted, Wanted::Mapped | Wanted::ByModel)) else {
        return prepare_here(args, wanted, copies, probed);
    };
    if ranks.rank() > 0 {
        return received(args, ranks);
    }
    let prepared = prepare_here(args, wanted, copies, probed)?;
    if let (None, Prepared::Ready(Job::Mapped(_, target, _))) = (&args.target, &prepared)
        && target.name() != USUAL_TARGET
    {
        handed::refuse(ranks)?;
        return Err(Error::Usage(format!("a job of several processes names its target: --target {}", target.name())));
    }
    if matches!(prepared, Prepared::DoesNotFit(_)) {
        handed::refuse(ranks)?;
    }
    Ok(prepared)
}

/// The part of a job that rank 0 has mapped, which alone reads the model.
fn received(args: &JobArgs, ranks: &Ranks) -> Result<Prepared, Error> {
    // Rank 0 refuses a model with a target of its own unless it is named.
    let target = Box::new(io::target::load_target(args.target.as_deref().unwrap_or(USUAL_TARGET))?);
    let options = Options { share: ranks::share(), ..Options::default() };
    match handed::receive(&target, &options, ranks) {
        Ok(Opened { compiled, note: scene }) => Ok(Prepared::Ready(Job::Mapped(Box::new(compiled), target, scene))),
        Err(CompileError::DoesNotFit(reasons)) => {
            Ok(Prepared::DoesNotFit(Refusal { model: args.model.clone(), target, reasons }))
        }
        Err(other) => Err(other.into()),
    }
}

fn prepare_here(args: &JobArgs, wanted: Wanted, copies: Option<u32>, probed: &[&str]) -> Result<Prepared, Error> {
    let network = args.timestep.load(&args.model)?;
    let scene = network.file().scene.clone();
    if args.needs_scene {
        let help = "give spikes with --input FILE, or --input scene:noise to try";
        inputs::require_scene(&args.model, scene.as_deref(), help)?;
    }
    let real = match wanted {
        Wanted::Mapped | Wanted::Quantised => false,
        Wanted::Real => true,
        // A mapping and pruning are of integers.
        Wanted::ByModel => has_srm(&network) && args.mapping.is_none() && !args.prune.asked(),
    };
    if real {
        if args.mapping.is_some() || args.prune.asked() {
            let message = "--engine reference runs the whole network in real numbers, without --mapping or --prune";
            return Err(Error::Usage(message.to_string()));
        }
        let (graph, quantised) = real_and_integers(&network)?;
        return Ok(Prepared::Ready(Job::Real(Box::new(graph), Box::new(quantised), scene)));
    }
    if wanted == Wanted::Quantised {
        let quantised = front(args, &network, probed)?.into_quantised();
        Form::require_written("--engine golden", &quantised, 1)?;
        say_notes(&quantised);
        return Ok(Prepared::Ready(Job::Quantised(Box::new(quantised), scene)));
    }
    let target = io::target::load_target(network.file().target_or_usual(args.target.as_deref()))?;
    let mut mapping = args.mapping.as_deref().map(io::mapping::load_mapping).transpose()?;
    let copies = copies.or(mapping.as_ref().map(|file| file.copies)).unwrap_or(1);
    let (placement, share) = (args.placement, ranks::share());
    let options = Options { copies, placement, share, ..Options::default() };
    if let Some(file) = mapping.as_mut().filter(|file| copies == 1 && file.copies > 1) {
        // Copies share nothing, so one of them is the whole of what a run shows.
        tracing::info!("the mapping is of {} copies; the first one runs, on its own cores", file.copies);
        *file = mapping_file::one_copy(file);
    }
    if mapping.is_none()
        && !args.prune.asked()
        && let Err(CompileError::DoesNotFit(reasons)) = nsim_session::shapes::check(&network, &target, copies)
    {
        let model = network.file().name.clone();
        return Ok(Prepared::DoesNotFit(Refusal { model, target: Box::new(target), reasons }));
    }
    match compiled(args, &network, &target, &options, mapping.as_ref(), probed)? {
        Ok(compiled) => {
            say_notes(&compiled.quantised);
            Ok(Prepared::Ready(Job::Mapped(Box::new(compiled), Box::new(target), scene)))
        }
        Err(CompileError::DoesNotFit(reasons)) => {
            let model = network.file().name.clone();
            Ok(Prepared::DoesNotFit(Refusal { model, target: Box::new(target), reasons }))
        }
        Err(other) => Err(other.into()),
    }
}

/// A network in integers, without what `--prune` leaves out.
///
/// # Errors
/// [`Error`] when the network or what it is pruned for cannot be used.
pub fn front(args: &JobArgs, network: &Network, probed: &[&str]) -> Result<Front, Error> {
    let front = integers(network, args.copies.most())?;
    let is_probed = |name: &str| probed.iter().any(|pattern| fits_pattern(pattern, name));
    let populations = front.quantised().populations().enumerate();
    let probed: Vec<PopulationId> =
        populations.filter(|(_, population)| is_probed(&population.name)).map(|(id, _)| id).collect();
    Ok(match args.prune.plan(front.quantised(), &probed)? {
        Some(plan) => {
            Form::require_written("--prune", front.quantised(), 1)?;
            front.prune(&plan)?
        }
        None => front,
    })
}

/// The network with the relays that `--relays` asks for.
///
/// # Errors
/// [`CompileError`] when delays leave no time for them, or they cannot help.
pub fn with_relays(args: &JobArgs, front: Front, target: &Target) -> Result<Front, CompileError> {
    if args.relays { front.relay(target) } else { Ok(front) }
}

/// Compiles a network, onto the cores of a saved mapping when there is one.
///
/// # Errors
/// [`Error`] when the network or what it is pruned for cannot be used.
pub fn compiled(
    args: &JobArgs,
    network: &Network,
    target: &Target,
    options: &Options,
    mapping: Option<&MappingFile>,
    probed: &[&str],
) -> Result<Result<Compiled, CompileError>, Error> {
    args.prune.not_with_mapping(mapping.is_some())?;
    let front = match with_relays(args, front(args, network, probed)?, target) {
        Ok(front) => front,
        Err(error) => return Ok(Err(error)),
    };
    front.form(options.copies).require_program(front.quantised(), options.copies)?;
    if let Some(ranks) = ranks::several() {
        let placed = match mapping {
            Some(file) => front.place_as(target, options, file).map_err(|error| args.with_mapping_file(error)),
            None => {
                let _busy = output::busy("mapping");
                compile::place(front, target, options, &Rates::assumed(DEFAULT_RATE))
            }
        };
        let scene = network.file().scene.as_deref();
        return Ok(placed.and_then(|placed| handed::hand_out(placed, target, options, (ranks, scene))));
    }
    Ok(match mapping {
        Some(file) => {
            let _busy = output::busy("checking the mapping");
            compile::compile_saved(front, target, options, file).map_err(|error| args.with_mapping_file(error))
        }
        None => mapped(front, target, options, &Rates::assumed(DEFAULT_RATE)),
    })
}

/// The best mapping of a network.
///
/// # Errors
/// As [`explore::map`].
pub fn mapped(front: Front, target: &Target, options: &Options, rates: &Rates) -> Result<Mapping, CompileError> {
    let _busy = output::busy("mapping");
    explore::map(front, target, options, rates)
}

fn say_notes(quantised: &Quantised) {
    for note in &quantised.parts().notes {
        tracing::info!("{}: {}", note.entity, note.message);
    }
}
