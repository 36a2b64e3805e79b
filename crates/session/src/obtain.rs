//! Makes a named model ready to run; no other module does.
//!
//! Input: a [`Request`]: model, engine, target, saved mapping, copies, pruning, relays. Output: a
//! [`Job`], or every reason why the network does not fit ([`Error::DoesNotFit`]).
//! [`prepare_mapping`] stops before mapping, for callers that compare mappings. Each of several
//! processes makes an equal request and gets its share of the program ([`Options::share`]).

use std::path::{Path, PathBuf};
use std::sync::Arc;

use nsim_compile::{
    CompileError, DEFAULT_RATE, Front, Mapping, Options, Strategy, compile, explore, load, mapping_file, refuse_large,
    refuse_to_run,
};
use nsim_files::mapping::load_mapping;
use nsim_files::network::Network;
use nsim_files::target::load_target;
use nsim_files::warnings::show;
use nsim_ir::base::id::PopulationId;
use nsim_ir::base::names::fits_pattern;
use nsim_ir::firing_rates::Rates;
use nsim_ir::graph::Graph;
use nsim_ir::hardware::Target;
use nsim_ir::mapping::MappingFile;
use nsim_ir::program::Program;
use nsim_ir::quantised::Quantised;
use nsim_quantise::prune::Plan;

use crate::error::Error;
use crate::front::{front, has_srm, real_and_integers};
use crate::{inputs, shapes};

/// The engine for which a job is prepared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EngineKind {
    /// The fast engine: mapped onto a target.
    Mapped,
    /// The golden engine.
    Quantised,
    /// The reference engine.
    Real,
    /// The reference engine when the model has spike response neurons, the fast one otherwise.
    ByModel,
}

/// One way to convert networks to integers.
#[derive(Debug, Clone, Copy)]
pub struct ConversionStage {
    /// Name, for the log.
    pub name: &'static str,
    /// Whether it converts a network.
    pub applies: fn(&Network) -> bool,
    /// Converts a network, with at most this many taps of an input population.
    pub convert: fn(&Network, usize) -> Result<Front, Error>,
}

impl ConversionStage {
    /// Lowers and quantises: any network, spike response neurons by analysis.
    pub const QUANTISE: ConversionStage =
        ConversionStage { name: "quantise", applies: |_| true, convert: |network, _| Ok(front(network)?) };
}

/// A conversion of networks to integers: the first stage that applies is used.
#[derive(Debug, Clone, Copy)]
pub struct Conversion {
    /// Its stages; the last applies to any network.
    pub stages: &'static [ConversionStage],
    /// Most taps of an input population.
    pub most_taps: usize,
}

impl Conversion {
    /// Converts a network.
    ///
    /// # Errors
    /// Those of the stage.
    pub fn convert(&self, network: &Network) -> Result<Front, Error> {
        let stage = self.stages.iter().find(|stage| (stage.applies)(network)).unwrap_or(&ConversionStage::QUANTISE);
        tracing::debug!(stage = stage.name, "converts");
        (stage.convert)(network, self.most_taps)
    }
}

/// The target of a mapping.
#[derive(Clone, Copy)]
pub enum TargetChoice<'a> {
    /// A target file or the name of a shipped target; `None` for the model's own or the default.
    Named(Option<&'a str>),
    /// A target that has been loaded.
    Loaded(&'a Target),
}

/// A user's request: a model, and how it runs.
#[derive(Clone, Copy)]
pub struct Request<'a> {
    /// The model as the user named it.
    pub model: &'a str,
    /// The parsed model file.
    pub network: &'a Network,
    /// Its conversion to integers.
    pub conversion: Conversion,
    /// The engine.
    pub engine: EngineKind,
    /// The target.
    pub target: TargetChoice<'a>,
    /// The file of a saved mapping.
    pub mapping: Option<&'a Path>,
    /// Copies of the network; `None` for the number of the saved mapping, or 1.
    pub copies: Option<u32>,
    /// Options of the mapping; a saved mapping has its own strategy and seed.
    pub options: Options,
    /// Arguments of `--prune`.
    pub prune: &'a [String],
    /// Patterns of the names of populations that are never pruned.
    pub probed: &'a [&'a str],
    /// Whether to add relays where there are too few output axons.
    pub relays: bool,
    /// Compartments of a core, by population.
    pub cores_of: &'a [(String, u32)],
}

impl<'a> Request<'a> {
    /// Returns the request for a network on its default target, with default options.
    pub fn new(model: &'a str, network: &'a Network, conversion: Conversion) -> Self {
        Request {
            model,
            network,
            conversion,
            engine: EngineKind::Mapped,
            target: TargetChoice::Named(None),
            mapping: None,
            copies: None,
            options: Options::default(),
            prune: &[],
            probed: &[],
            relays: false,
            cores_of: &[],
        }
    }

    /// Whether anything is to be pruned.
    fn prunes(&self) -> bool {
        !self.prune.is_empty() && self.prune != ["none"]
    }

    /// Returns the pruning plan, if anything is to be pruned.
    fn plan(&self, network: &Quantised) -> Result<Option<Plan>, Error> {
        let plan = match self.prune {
            _ if !self.prunes() => return Ok(None),
            [only] if only == "static" => Plan::fixed(),
            several if several.iter().any(|word| word == "none" || word == "static") => {
                return Err(Error::Usage(
                    "--prune none and --prune static cannot be combined with other values".to_string(),
                ));
            }
            given => Plan::for_stimulus(network, &inputs::stimulus(network, given, None, None)?),
        };
        let populations = network.populations().enumerate();
        let probed = populations
            .filter(|(_, population)| self.probed.iter().any(|pattern| fits_pattern(pattern, &population.name)));
        Ok(Some(plan.probing(probed.map(|(id, _)| id).collect::<Vec<PopulationId>>())))
    }

    fn front(&self) -> Result<Front, Error> {
        self.pruned(self.conversion.convert(self.network)?)
    }

    fn pruned(&self, front: Front) -> Result<Front, Error> {
        let Some(plan) = self.plan(front.quantised())? else { return Ok(front) };
        refuse_large("--prune", front.quantised(), 1)?;
        Ok(front.prune(&plan)?)
    }

    /// Returns the options of the mapping. A saved mapping has its own strategy and seed.
    fn options(&self, saved: Option<&MappingFile>) -> Options {
        let copies = self.copies.or(saved.map(|file| file.copies)).unwrap_or(1);
        let options = Options { copies, ..self.options };
        let Some(file) = saved else { return options };
        // The mapping in a file may come from none of these strategies.
        let strategy = Strategy::ALL.into_iter().find(|strategy| strategy.name() == file.strategy);
        Options { strategy: strategy.unwrap_or(options.strategy), seed: file.seed, ..options }
    }
}

/// A network ready to run, with the model's own stimulus.
#[derive(Debug)]
pub enum Job {
    /// Mapped onto a target.
    Mapped(Box<Mapping>, Box<Target>, Option<String>),
    /// Only quantised, for the golden engine.
    Quantised(Box<Quantised>, Option<String>),
    /// In real numbers, for the reference engine; and in integers, with equal unit numbers.
    Real(Box<Graph>, Box<Quantised>, Option<String>),
}

impl Job {
    /// The network in integers.
    pub fn quantised(&self) -> &Quantised {
        match self {
            Job::Mapped(compiled, ..) => &compiled.quantised,
            Job::Quantised(quantised, _) | Job::Real(_, quantised, _) => quantised,
        }
    }

    /// The program, when it is mapped.
    pub fn program(&self) -> Option<&Arc<Program>> {
        self.mapped().map(|(compiled, _)| &compiled.program)
    }

    /// The compiled network and its target, when it is mapped.
    pub fn mapped(&self) -> Option<(&Mapping, &Target)> {
        match self {
            Job::Mapped(compiled, target, _) => Some((compiled, target)),
            Job::Quantised(..) | Job::Real(..) => None,
        }
    }

    /// The model's own stimulus.
    pub fn scene(&self) -> Option<&str> {
        match self {
            Job::Mapped(_, _, scene) | Job::Quantised(_, scene) | Job::Real(_, _, scene) => scene.as_deref(),
        }
    }
}

/// Makes a network ready to run.
///
/// # Errors
/// [`Error`] when a part of the request cannot be used, or the network does not fit.
pub fn obtain(request: &Request<'_>) -> Result<Job, Error> {
    let Request { network, mapping, engine, .. } = *request;
    let scene = network.file().scene.clone();
    let real = match engine {
        EngineKind::Mapped | EngineKind::Quantised => false,
        EngineKind::Real => true,
        // Mappings and pruning apply to integers only.
        EngineKind::ByModel => has_srm(network) && mapping.is_none() && !request.prunes(),
    };
    if real {
        if mapping.is_some() || request.prunes() {
            let message = "--engine reference runs the whole network in real numbers, without --mapping or --prune";
            return Err(Error::Usage(message.to_string()));
        }
        let (graph, quantised) = real_and_integers(network)?;
        show("", &quantised.parts().warnings);
        return Ok(Job::Real(Box::new(graph), Box::new(quantised), scene));
    }
    if engine == EngineKind::Quantised {
        let quantised = request.front()?.into_quantised();
        refuse_large("--engine golden", &quantised, 1)?;
        log_changes(&quantised);
        return Ok(Job::Quantised(Box::new(quantised), scene));
    }
    let (front, settings) = prepare_mapping(request)?;
    let mut compiled = settings.compiled(front)?;
    if settings.options.share.rank > 0 {
        // Once the tables exist, only rank 0 needs the weights.
        compiled.one = compiled.one.without_projections();
        compiled.quantised = compiled.quantised.without_projections();
    }
    log_changes(&compiled.quantised);
    Ok(Job::Mapped(Box::new(compiled), Box::new(settings.target), scene))
}

/// Maps a network in integers, as a [`Request`] with default options does.
///
/// # Errors
/// [`CompileError`].
pub fn map_with_defaults(network: Quantised, target: &Target) -> Result<Mapping, CompileError> {
    compile(network, target, &Options::default())
}

/// Target and options of a mapping.
#[derive(Debug)]
pub struct MappingSettings {
    /// The target.
    pub target: Target,
    /// Options of the mapping.
    pub options: Options,
    /// The saved mapping and its file, and the model as the user named it.
    pub saved: Option<(MappingFile, PathBuf, String)>,
}

/// Returns the network in integers, pruned and with relays, and the goal of its mapping.
/// Errors are those of [`obtain`].
pub fn prepare_mapping(request: &Request<'_>) -> Result<(Front, MappingSettings), Error> {
    prepare_converted(request, || request.conversion.convert(request.network))
}

/// As [`prepare_mapping`], for a network whose conversion the caller stores.
/// Errors are those of [`obtain`].
pub fn prepare_converted(
    request: &Request<'_>,
    converted: impl FnOnce() -> Result<Front, Error>,
) -> Result<(Front, MappingSettings), Error> {
    let Request { network, mapping, .. } = *request;
    let target = match request.target {
        TargetChoice::Loaded(target) => target.clone(),
        TargetChoice::Named(name) => load_target(network.file().target_or_usual(name))?,
    };
    let mut saved = mapping.map(load_mapping).transpose()?;
    if saved.is_some() && !request.prune.is_empty() {
        return Err(Error::Usage("--prune: a saved mapping has its own record of pruning".to_string()));
    }
    let options = request.options(saved.as_ref());
    if let Some(file) = saved.as_mut().filter(|file| options.copies == 1 && file.copies > 1) {
        // Copies share nothing, so a run of one copy gives all results.
        tracing::info!("the mapping has {} copies; the first copy runs, on its own cores", file.copies);
        *file = mapping_file::one_copy(file);
    }
    if saved.is_none() && !request.prunes() {
        shapes::check(network, &target, options.copies)?;
    }
    let front = request.pruned(converted()?)?.with_cores_of(request.cores_of)?;
    let front = if request.relays { front.relay(&target)? } else { front };
    let saved = saved.zip(mapping).map(|(file, path)| (file, path.to_path_buf(), request.model.to_string()));
    Ok((front, MappingSettings { target, options, saved }))
}

impl MappingSettings {
    /// Returns the mapping of a network from [`prepare_mapping`]: the saved one, or the best
    /// for these firing rates of the sources of one copy.
    ///
    /// # Errors
    /// [`CompileError`]; it names the file of a saved mapping.
    pub fn mapped(&self, front: Front, rates: &Rates) -> Result<Mapping, CompileError> {
        let MappingSettings { target, options, saved } = self;
        let Some((file, path, model)) = saved else { return explore::map(front, target, options, rates) };
        let mapped = load(front, target, options, file);
        // A saved mapping stays unchanged; its cost follows the requested rates.
        let mapped = mapped.map(|mapped| Mapping { rates: rates.copies(options.copies), ..mapped });
        mapped.map_err(|error| mapping_file::explained(error, path, model))
    }

    /// Returns the mapping for the default rate, with its program.
    ///
    /// # Errors
    /// As [`MappingSettings::mapped`], and for a network with too many synapses.
    pub fn compiled(&self, front: Front) -> Result<Mapping, Error> {
        refuse_to_run(front.quantised(), self.options.copies)?;
        Ok(self.mapped(front, &Rates::assumed(DEFAULT_RATE))?)
    }
}

/// Logs the notes of a network, and shows its warnings.
fn log_changes(quantised: &Quantised) {
    show("", &quantised.parts().warnings);
    for note in &quantised.parts().notes {
        tracing::info!("{}: {}", note.entity, note.message);
    }
}
