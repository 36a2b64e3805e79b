//! From what a user named to something that runs: the only way there.
//!
//! Input: a [`Request`]: model, engine, target, saved mapping, copies, pruning, relays. Output: a
//! [`Job`], or every reason why the network does not fit ([`Error::DoesNotFit`]). [`begin`] stops
//! before mapping, for those who compare mappings. Each of several processes makes the same request
//! and holds its share of the program ([`Options::share`]).

use std::path::{Path, PathBuf};
use std::sync::Arc;

use nsim_compile::{
    CompileError, DEFAULT_RATE, Front, Mapping, Options, Strategy, compile, explore, load, mapping_file, refuse_large,
    refuse_to_run,
};
use nsim_files::mapping::load_mapping;
use nsim_files::network::Network;
use nsim_files::target::load_target;
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
use crate::front::{has_srm, real_and_integers};
use crate::{inputs, shapes};

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

/// How a network becomes integers: [`crate::front::front`], or a conversion of its spike response
/// neurons.
pub type Integers<'a> = &'a dyn Fn(&Network) -> Result<Front, Error>;

/// What a network is mapped onto.
#[derive(Clone, Copy)]
pub enum TargetChoice<'a> {
    /// A target file or the name of a shipped target; `None` for the model's own, or the usual one.
    Named(Option<&'a str>),
    /// A target that has been loaded.
    Loaded(&'a Target),
}

/// What a user named.
#[derive(Clone, Copy)]
pub struct Request<'a> {
    /// The model as the user named it.
    pub model: &'a str,
    /// The model as its file says.
    pub network: &'a Network,
    /// How it becomes integers.
    pub integers: Integers<'a>,
    /// The engine.
    pub wanted: Wanted,
    /// The target.
    pub target: TargetChoice<'a>,
    /// The file of a saved mapping.
    pub mapping: Option<&'a Path>,
    /// Copies of the network; `None` for those of the saved mapping, or 1.
    pub copies: Option<u32>,
    /// How to map; a saved mapping has a strategy and a seed of its own.
    pub options: Options,
    /// What to leave out, as `--prune` takes it.
    pub prune: &'a [String],
    /// Patterns of populations that stay whole however much is pruned.
    pub probed: &'a [&'a str],
    /// Whether to add relays where output axons are few.
    pub relays: bool,
}

impl<'a> Request<'a> {
    /// A network on its usual target, mapped as usual.
    pub fn new(model: &'a str, network: &'a Network, integers: Integers<'a>) -> Self {
        Request {
            model,
            network,
            integers,
            wanted: Wanted::Mapped,
            target: TargetChoice::Named(None),
            mapping: None,
            copies: None,
            options: Options::default(),
            prune: &[],
            probed: &[],
            relays: false,
        }
    }

    /// Whether anything is to be pruned.
    fn prunes(&self) -> bool {
        !self.prune.is_empty() && self.prune != ["none"]
    }

    /// What to leave out, if anything.
    fn plan(&self, network: &Quantised) -> Result<Option<Plan>, Error> {
        let plan = match self.prune {
            _ if !self.prunes() => return Ok(None),
            [only] if only == "static" => Plan::fixed(),
            several if several.iter().any(|word| word == "none" || word == "static") => {
                return Err(Error::Usage("--prune none and --prune static stand alone".to_string()));
            }
            given => Plan::for_stimulus(network, &inputs::stimulus(network, given, None, None)?),
        };
        let is_probed = |name: &str| self.probed.iter().any(|pattern| fits_pattern(pattern, name));
        let populations = network.populations().enumerate();
        let probed = populations.filter(|(_, population)| is_probed(&population.name));
        Ok(Some(plan.probing(probed.map(|(id, _)| id).collect::<Vec<PopulationId>>())))
    }

    /// The network in integers, without what is to be pruned.
    fn front(&self) -> Result<Front, Error> {
        let front = (self.integers)(self.network)?;
        let Some(plan) = self.plan(front.quantised())? else { return Ok(front) };
        refuse_large("--prune", front.quantised(), 1)?;
        Ok(front.prune(&plan)?)
    }

    /// How to map; what a saved mapping was made with counts.
    fn options(&self, saved: Option<&MappingFile>) -> Options {
        let copies = self.copies.or(saved.map(|file| file.copies)).unwrap_or(1);
        let options = Options { copies, ..self.options };
        let Some(file) = saved else { return options };
        // A file may have been made by other hands than any of these strategies.
        let strategy = Strategy::ALL.into_iter().find(|strategy| strategy.name() == file.strategy);
        Options { strategy: strategy.unwrap_or(options.strategy), seed: file.seed, ..options }
    }
}

/// A network ready to run; each with the model's own stimulus.
#[derive(Debug)]
pub enum Job {
    /// Mapped onto a target.
    Mapped(Box<Mapping>, Box<Target>, Option<String>),
    /// Only quantised, for the golden engine.
    Quantised(Box<Quantised>, Option<String>),
    /// In real numbers, for the reference engine; and in integers, with the same unit numbers.
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

/// A network that is ready to run.
///
/// # Errors
/// [`Error`] when what was named cannot be used, or the network does not fit.
pub fn obtain(request: &Request<'_>) -> Result<Job, Error> {
    let Request { network, mapping, wanted, .. } = *request;
    let scene = network.file().scene.clone();
    let real = match wanted {
        Wanted::Mapped | Wanted::Quantised => false,
        Wanted::Real => true,
        // A mapping and pruning are of integers.
        Wanted::ByModel => has_srm(network) && mapping.is_none() && !request.prunes(),
    };
    if real {
        if mapping.is_some() || request.prunes() {
            let message = "--engine reference runs the whole network in real numbers, without --mapping or --prune";
            return Err(Error::Usage(message.to_string()));
        }
        let (graph, quantised) = real_and_integers(network)?;
        return Ok(Job::Real(Box::new(graph), Box::new(quantised), scene));
    }
    if wanted == Wanted::Quantised {
        let quantised = request.front()?.into_quantised();
        refuse_large("--engine golden", &quantised, 1)?;
        say_notes(&quantised);
        return Ok(Job::Quantised(Box::new(quantised), scene));
    }
    let (front, goal) = begin(request)?;
    let mut compiled = goal.compiled(front)?;
    if goal.options.share.rank > 0 {
        // Of several ranks the first alone needs the weights once the tables are there.
        compiled.one = compiled.one.without_projections();
        compiled.quantised = compiled.quantised.without_projections();
    }
    say_notes(&compiled.quantised);
    Ok(Job::Mapped(Box::new(compiled), Box::new(goal.target), scene))
}

/// A network that is in integers already, mapped as where a [`Request`] asks for nothing else.
///
/// # Errors
/// [`CompileError`].
pub fn mapped_as_usual(network: Quantised, target: &Target) -> Result<Mapping, CompileError> {
    compile(network, target, &Options::default())
}

/// Where a network is to be mapped.
#[derive(Debug)]
pub struct Goal {
    /// The target.
    pub target: Target,
    /// How to map.
    pub options: Options,
    /// The saved mapping and its file, and the model as the user named it.
    pub saved: Option<(MappingFile, PathBuf, String)>,
}

/// The network in integers, pruned and with relays, and where it is to be mapped.
///
/// # Errors
/// As [`obtain`].
pub fn begin(request: &Request<'_>) -> Result<(Front, Goal), Error> {
    let Request { network, mapping, .. } = *request;
    let target = match request.target {
        TargetChoice::Loaded(target) => target.clone(),
        TargetChoice::Named(name) => load_target(network.file().target_or_usual(name))?,
    };
    let mut saved = mapping.map(load_mapping).transpose()?;
    if saved.is_some() && !request.prune.is_empty() {
        return Err(Error::Usage("--prune: a saved mapping says itself what was pruned".to_string()));
    }
    let options = request.options(saved.as_ref());
    if let Some(file) = saved.as_mut().filter(|file| options.copies == 1 && file.copies > 1) {
        // Copies share nothing, so one of them is the whole of what a run shows.
        tracing::info!("the mapping is of {} copies; the first one runs, on its own cores", file.copies);
        *file = mapping_file::one_copy(file);
    }
    if saved.is_none() && !request.prunes() {
        shapes::check(network, &target, options.copies)?;
    }
    let front = request.front()?;
    let front = if request.relays { front.relay(&target)? } else { front };
    let saved = saved.zip(mapping).map(|(file, path)| (file, path.to_path_buf(), request.model.to_string()));
    Ok((front, Goal { target, options, saved }))
}

impl Goal {
    /// The mapping of a network that has begun so: the saved one, or the best for sources of one
    /// copy that spike this often.
    ///
    /// # Errors
    /// [`CompileError`]; about a saved mapping with its file.
    pub fn mapped(&self, front: Front, rates: &Rates) -> Result<Mapping, CompileError> {
        let Goal { target, options, saved } = self;
        let Some((file, path, model)) = saved else { return explore::map(front, target, options, rates) };
        let mapped = load(front, target, options, file);
        // A stored mapping stays what it is; what it costs follows the rates that are asked for.
        let mapped = mapped.map(|mapped| Mapping { rates: rates.copies(options.copies), ..mapped });
        mapped.map_err(|error| mapping_file::explained(error, path, model))
    }

    /// The mapping for the usual rates, with its program.
    ///
    /// # Errors
    /// As [`Goal::mapped`], and for a network of too many synapses.
    pub fn compiled(&self, front: Front) -> Result<Mapping, Error> {
        refuse_to_run(front.quantised(), self.options.copies)?;
        Ok(self.mapped(front, &Rates::assumed(DEFAULT_RATE))?)
    }
}

fn say_notes(quantised: &Quantised) {
    for note in &quantised.parts().notes {
        tracing::info!("{}: {}", note.entity, note.message);
    }
}
