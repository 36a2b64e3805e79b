//! From a network to a program, one stage a line.
//!
//! In comes a [`Network`] and a [`Target`]; out goes a [`Compiled`] program with the stages that led to it, or every
//! reason why the network does not fit. A program that leaves this module has been verified against the target's limits
//! and checked against its network by code that shares nothing with the stages that made it.

pub mod check;
pub mod emit;
pub mod explore;
pub mod frontend;
pub mod mapping_file;
pub mod partition;
pub mod place;
pub mod reason;
pub mod resources;
pub mod symbolic;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;

use std::time::Instant;

use crate::base::diagnostic::Diagnostic;
use crate::base::id::{CoreId, IdVec};
use crate::compile::explore::traffic::DEFAULT_RATE;
use crate::desc::mapping::MappingFile;
use crate::desc::network::Network;
use crate::desc::target::Target;
use crate::ir::firing_rates::Rates;
use crate::ir::graph::Graph;
use crate::ir::partition::{Partition, Resource, seats};
use crate::ir::placement::{Mesh, Placement};
use crate::ir::program::Program;
use crate::ir::quantised::Quantised;

pub use partition::Strategy;
pub use reason::Reason;

/// What a mapping is to be good for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Objective {
    /// Few cores.
    #[default]
    Cores,
    /// Little energy.
    Energy,
    /// Short timesteps.
    Latency,
}

impl Objective {
    /// Every objective.
    pub const ALL: [Objective; 3] = [Objective::Cores, Objective::Energy, Objective::Latency];

    /// Its name on the command line and in results.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Objective::Cores => "cores",
            Objective::Energy => "energy",
            Objective::Latency => "latency",
        }
    }
}

/// How to compile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Options {
    /// Copies of the network, at least 1.
    pub copies: u32,
    /// How compartments are gathered on cores.
    pub strategy: Strategy,
    /// What for.
    pub objective: Objective,
    /// Seed of strategies that draw; recorded in any case.
    pub seed: u64,
    /// Whether cores are placed near what they talk to; otherwise one after the other.
    pub place: bool,
    /// Seconds that looking for a better partition and placement may take, counted in work, so that the result is the
    /// same on every machine.
    pub effort_s: u32,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            copies: 1,
            strategy: Strategy::default(),
            objective: Objective::default(),
            seed: 0,
            place: true,
            effort_s: DEFAULT_EFFORT_S,
        }
    }
}

/// The effort of a mapping of which nothing else is said.
pub const DEFAULT_EFFORT_S: u32 = 4;
/// Destinations of nets that placing looks at in a second, roughly.
const PLACED_PER_SECOND: u64 = 25_000_000;

/// Why there is no program.
#[derive(Debug, thiserror::Error)]
pub enum CompileError {
    /// The network or the mapping cannot be used.
    #[error("{0}")]
    Input(Diagnostic),
    /// The network does not fit, for all of these reasons.
    #[error("the network does not fit the target: {}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("; also "))]
    DoesNotFit(Vec<Reason>),
    /// The compiler has contradicted itself.
    #[error("{0}")]
    Fault(String),
}

impl From<partition::Failure> for CompileError {
    fn from(failure: partition::Failure) -> Self {
        match failure {
            partition::Failure::DoesNotFit(reasons) => CompileError::DoesNotFit(reasons),
            partition::Failure::Fault(message) => CompileError::Fault(message),
        }
    }
}

/// A program and the stages that led to it.
#[derive(Debug, Clone)]
pub struct Compiled {
    /// The network, one copy.
    pub one: Quantised,
    /// The network, all copies.
    pub quantised: Quantised,
    /// Compartments on cores.
    pub partition: Partition,
    /// Cores on the board.
    pub placement: Placement,
    /// The program; verified and checked.
    pub program: Program,
    /// Seconds of each stage, in order.
    pub seconds: Vec<(&'static str, f64)>,
    /// The target's name.
    pub target: String,
    /// How it was compiled.
    pub options: Options,
    /// Name of the placement: `sequential`, `annealed`, or `saved` when it came from a file.
    pub placed: &'static str,
    /// Rates of all sources that it was made for.
    pub rates: Rates,
}

/// Where everything of a network is, whether or not its program was written.
#[derive(Debug, Clone, Copy)]
pub struct Layout<'a> {
    /// The network, one copy.
    pub one: &'a Quantised,
    /// The network, all copies.
    pub quantised: &'a Quantised,
    /// Compartments on cores.
    pub partition: &'a Partition,
    /// Cores on the board.
    pub placement: &'a Placement,
    /// Seconds of each stage, in order.
    pub seconds: &'a [(&'static str, f64)],
    /// How it was made.
    pub options: &'a Options,
    /// Name of the placement.
    pub placed: &'static str,
    /// Rates of all sources that it was made for.
    pub rates: &'a Rates,
    /// Whether there is a program, checked against the network; otherwise see [`symbolic`].
    pub written: bool,
}

impl Compiled {
    /// Where everything is.
    #[must_use]
    pub fn layout(&self) -> Layout<'_> {
        Layout {
            one: &self.one,
            quantised: &self.quantised,
            partition: &self.partition,
            placement: &self.placement,
            seconds: &self.seconds,
            options: &self.options,
            placed: self.placed,
            rates: &self.rates,
            written: true,
        }
    }

    /// The mapping as a file.
    #[must_use]
    pub fn mapping_file(&self) -> MappingFile {
        let origin = mapping_file::Origin {
            target: self.target.clone(),
            copies: self.options.copies,
            strategy: self.options.strategy.name().to_string(),
            seed: self.options.seed,
        };
        mapping_file::save(&self.quantised, &self.partition, &self.placement, origin)
    }
}

/// Measures stages.
#[derive(Debug, Clone, Default)]
struct Clock(Vec<(&'static str, f64)>);

impl Clock {
    fn stage<T>(&mut self, name: &'static str, stage: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = stage();
        let seconds = start.elapsed().as_secs_f64();
        tracing::debug!(stage = name, seconds, "compiled");
        self.0.push((name, seconds));
        result
    }
}

/// Compiles a network for a target.
///
/// # Errors
/// [`CompileError`].
pub fn compile(network: &Network, target: &Target, options: &Options) -> Result<Compiled, CompileError> {
    front(network)?.map(target, options)
}

/// Compiles a network that is quantised already.
///
/// # Errors
/// [`CompileError`].
pub fn compile_quantised(one: Quantised, target: &Target, options: &Options) -> Result<Compiled, CompileError> {
    mapped(one, target, options, &Rates::assumed(DEFAULT_RATE), Clock::default())
}

/// Compiles a quantised network with a saved mapping's partition and places, pruned as it was for the mapping.
/// `options.copies` must be the file's.
///
/// # Errors
/// [`CompileError`].
pub fn compile_with_mapping(
    one: Quantised,
    target: &Target,
    options: &Options,
    file: &MappingFile,
) -> Result<Compiled, CompileError> {
    remapped(one, target, options, file, Clock::default())
}

/// Compiles a network with a saved mapping.
///
/// # Errors
/// [`CompileError`].
pub fn compile_network_with_mapping(
    network: &Network,
    target: &Target,
    options: &Options,
    file: &MappingFile,
) -> Result<Compiled, CompileError> {
    front(network)?.map_saved(target, options, file)
}

/// A network in integers, before it is mapped.
#[derive(Debug)]
pub struct Front {
    graph: Graph,
    one: Quantised,
    clock: Clock,
}

/// Brings a network into integers.
///
/// # Errors
/// [`CompileError`].
pub fn front(network: &Network) -> Result<Front, CompileError> {
    let mut clock = Clock::default();
    let graph = clock.stage("lower", || frontend::lower::lower(network)).map_err(CompileError::Input)?;
    let one = clock.stage("quantise", || integers(&graph)).map_err(CompileError::Input)?;
    Ok(Front { graph, one, clock })
}

/// A network in integers, spike response neurons by way of [`frontend::analytic`].
///
/// # Errors
/// As [`frontend::quantise::quantise`].
pub fn integers(graph: &Graph) -> Result<Quantised, Diagnostic> {
    match graph.has_srm() {
        true => frontend::quantise::quantise(&frontend::analytic::convert(graph)),
        false => frontend::quantise::quantise(graph),
    }
}

impl Front {
    /// The network in real numbers, as the file means it.
    #[must_use]
    pub fn graph(&self) -> &Graph {
        &self.graph
    }

    /// The network.
    #[must_use]
    pub fn quantised(&self) -> &Quantised {
        &self.one
    }

    /// The network.
    #[must_use]
    pub fn into_quantised(self) -> Quantised {
        self.one
    }

    /// The network in real numbers and in integers.
    #[must_use]
    pub fn into_both(self) -> (Graph, Quantised) {
        (self.graph, self.one)
    }

    /// The network without what the plan makes superfluous.
    ///
    /// # Errors
    /// [`CompileError`].
    pub fn prune(mut self, plan: &frontend::prune::Plan) -> Result<Front, CompileError> {
        self.one = self.clock.stage("prune", || pruned(&self.one, plan))?;
        Ok(self)
    }

    /// Candidates of mappings onto a target.
    ///
    /// # Errors
    /// As [`explore::search::candidates`].
    pub fn candidates(
        &self,
        target: &Target,
        options: &Options,
        rates: &Rates,
    ) -> Result<Vec<explore::search::Found>, CompileError> {
        explore::search::candidates(&self.one, target, options, rates)
    }

    /// The network on a target.
    ///
    /// # Errors
    /// [`CompileError`].
    pub fn map(self, target: &Target, options: &Options) -> Result<Compiled, CompileError> {
        self.map_for(target, options, &Rates::assumed(DEFAULT_RATE))
    }

    /// The network on a target, for sources that spike this often; `rates` are of one copy.
    ///
    /// # Errors
    /// [`CompileError`].
    pub fn map_for(self, target: &Target, options: &Options, rates: &Rates) -> Result<Compiled, CompileError> {
        mapped(self.one, target, options, rates, self.clock)
    }

    /// The network on the cores of a saved mapping, pruned as it was for the mapping.
    ///
    /// # Errors
    /// [`CompileError`].
    pub fn map_saved(self, target: &Target, options: &Options, file: &MappingFile) -> Result<Compiled, CompileError> {
        remapped(self.one, target, options, file, self.clock)
    }
}

fn pruned(one: &Quantised, plan: &frontend::prune::Plan) -> Result<Quantised, CompileError> {
    frontend::prune::prune(one, plan).map_err(|error| CompileError::Fault(error.to_string()))
}

fn mapped(
    one: Quantised,
    target: &Target,
    options: &Options,
    rates: &Rates,
    clock: Clock,
) -> Result<Compiled, CompileError> {
    if options.objective != Objective::Cores {
        let mut best = explore::search::best(&one, target, options, rates)?;
        best.seconds.splice(0..0, clock.0);
        return Ok(best);
    }
    partitioned_from(one, target, options, rates, clock)?
        .sited(target, options)?
        .routed(target, options)?
        .proved(target)
}

/// A network on logical cores, for placing in several ways.
#[derive(Debug, Clone)]
pub struct Partitioned {
    one: Quantised,
    all: Quantised,
    partition: Partition,
    rates: Rates,
    clock: Clock,
}

/// Gathers a network on cores, for sources that spike this often.
///
/// # Errors
/// [`CompileError`].
pub fn partitioned(
    one: Quantised,
    target: &Target,
    options: &Options,
    rates: &Rates,
) -> Result<Partitioned, CompileError> {
    partitioned_from(one, target, options, rates, Clock::default())
}

fn partitioned_from(
    one: Quantised,
    target: &Target,
    options: &Options,
    rates: &Rates,
    mut clock: Clock,
) -> Result<Partitioned, CompileError> {
    let search = partition_search(options, rates);
    clock.stage("bounds", || within_bounds(&one, target, options, search))?;
    let all = clock.stage("copies", || all_copies(&one, options))?;
    let partition = clock.stage("partition", || partition::partition(&one, &all, target, search))?;
    Ok(Partitioned { one, all, partition, rates: rates.copies(options.copies), clock })
}

impl Partitioned {
    /// Makes sure that it fits a target with other limits than it was made for.
    ///
    /// # Errors
    /// [`CompileError::DoesNotFit`] when it has more cores; [`CompileError::Fault`] when the limits are lower.
    pub fn within(&mut self, target: &Target) -> Result<(), CompileError> {
        let (members, usage) = (self.partition.members().clone(), self.partition.usage().clone());
        let partition = Partition::new(self.all.compartments(), members, usage, target.limits());
        self.partition = partition.map_err(|e| CompileError::Fault(e.to_string()))?;
        Ok(())
    }

    /// Places it and brings it to an end, with the options that it was made with but for how it is placed.
    ///
    /// # Errors
    /// [`CompileError`].
    pub fn placed(&self, target: &Target, options: &Options) -> Result<Compiled, CompileError> {
        self.routed(target, options)?.proved(target)
    }

    /// Places it and writes its program, which is still to be verified and checked.
    fn routed(&self, target: &Target, options: &Options) -> Result<Routed, CompileError> {
        self.clone().sited(target, options)?.routed(target, options)
    }

    fn sited(mut self, target: &Target, options: &Options) -> Result<Sited, CompileError> {
        let Partitioned { all, partition, rates, clock, .. } = &mut self;
        let placed = clock.stage("place", || placed(all, partition, target, options, rates));
        let (placement, name) = placed.map_err(does_not_fit)?;
        Ok(Sited { partitioned: self, placement, name })
    }
}

/// A network on the cores of the board: all that comes before its program.
struct Sited {
    partitioned: Partitioned,
    placement: Placement,
    /// Name of the placement.
    name: &'static str,
}

impl Sited {
    /// The program, which is still to be verified and checked.
    fn routed(self, target: &Target, options: &Options) -> Result<Routed, CompileError> {
        let Sited { partitioned, placement, name: placed } = self;
        let Partitioned { one, all: quantised, partition, rates, mut clock } = partitioned;
        let limits = target.limits();
        let routed = clock.stage("route", || emit::route::route(&quantised, &partition, &placement, limits));
        let program = routed.map_err(CompileError::Fault)?;
        let (seconds, target) = (clock.0, target.name().to_string());
        let options = *options;
        Ok(Routed(Compiled { one, quantised, partition, placement, program, seconds, target, options, placed, rates }))
    }
}

fn partition_search<'a>(options: &Options, rates: &'a Rates) -> partition::Search<'a> {
    let work = u64::from(options.effort_s) * partition::WORK_PER_SECOND;
    partition::Search { strategy: options.strategy, rates, work }
}

fn placed(
    all: &Quantised,
    partition: &Partition,
    target: &Target,
    options: &Options,
    rates: &Rates,
) -> Result<(Placement, &'static str), Reason> {
    if !options.place {
        return Ok((place::sequential(partition.cores(), target)?, place::SEQUENTIAL));
    }
    let work = u64::from(options.effort_s) * PLACED_PER_SECOND;
    place::place(
        all,
        partition,
        target,
        place::Search { objective: options.objective, rates, seed: options.seed, work },
    )
}

fn remapped(
    mut one: Quantised,
    target: &Target,
    options: &Options,
    file: &MappingFile,
    mut clock: Clock,
) -> Result<Compiled, CompileError> {
    mapping_file::of_copies(file, options.copies).map_err(CompileError::Input)?;
    symbolic::within_reach("running it on cores", &one, options.copies).map_err(CompileError::Input)?;
    one = match (&file.pruned, one.pruned()) {
        (Some(said), None) => {
            let plan = mapping_file::plan(said, &one).map_err(CompileError::Input)?;
            clock.stage("prune", || pruned(&one, &plan))?
        }
        (None, Some(_)) => {
            let message = "the mapping is of the whole network, not of a pruned one";
            return Err(CompileError::Input(Diagnostic::new("mapping.pruned", message)));
        }
        // What was pruned otherwise than the file says has other compartments to map.
        (None, None) | (Some(_), Some(_)) => one,
    };
    let rates = Rates::assumed(DEFAULT_RATE);
    clock.stage("bounds", || within_bounds(&one, target, options, partition_search(options, &rates)))?;
    let all = clock.stage("copies", || all_copies(&one, options))?;
    let (partition, placement) = clock.stage("mapping", || from_file(&all, target, file))?;
    let partitioned = Partitioned { one, all, partition, rates, clock };
    Sited { partitioned, placement, name: place::SAVED }.routed(target, options)?.proved(target)
}

/// A program that has not been verified and checked, for comparing what mappings cost.
#[derive(Debug, Clone)]
struct Routed(Compiled);

impl Routed {
    /// The program once it is known to be right.
    fn proved(self, target: &Target) -> Result<Compiled, CompileError> {
        let Routed(mut compiled) = self;
        let mut clock = Clock(std::mem::take(&mut compiled.seconds));
        let (network, program) = (&compiled.quantised, &compiled.program);
        let fault = CompileError::Fault;
        clock.stage("verify", || check::verify::verify(program, target)).map_err(|e| fault(e.to_string()))?;
        clock.stage("check", || check::equivalence::check(network, program)).map_err(|e| fault(e.to_string()))?;
        compiled.seconds = clock.0;
        Ok(compiled)
    }
}

fn does_not_fit(reason: Reason) -> CompileError {
    CompileError::DoesNotFit(vec![reason])
}

fn all_copies(one: &Quantised, options: &Options) -> Result<Quantised, CompileError> {
    frontend::copies::copies(one, options.copies)
        .map_err(|error| CompileError::Input(Diagnostic::new("map.copies", error.to_string())))
}

/// Refuses what cannot fit by its sizes alone, before anything large is made; with the reasons of a single copy, if any.
fn within_bounds(
    one: &Quantised,
    target: &Target,
    options: &Options,
    search: partition::Search<'_>,
) -> Result<(), CompileError> {
    let (limits, copies) = (target.limits(), u64::from(options.copies));
    let (compartments, room) =
        (u64::from(one.compartments()), u64::from(target.cores()) * u64::from(limits.compartments));
    let cores = partition::least_cores(one, options.copies, limits);
    let bound = if compartments * copies > room {
        Reason::of_compartments(target, limits, options.copies, compartments * copies)
    } else if cores > u64::from(target.cores()) && copies > 1 {
        Reason::of_cores(target, options.copies, cores)
    } else {
        return Ok(());
    };
    let mut reasons = vec![bound];
    if compartments <= room
        && let Err(partition::Failure::DoesNotFit(more)) = partition::partition(one, one, target, search)
    {
        reasons.extend(more.into_iter().filter(|reason| reason.resource != Resource::Cores));
    }
    Err(CompileError::DoesNotFit(reasons))
}

/// A partition and placement as a file has them.
fn from_file(all: &Quantised, target: &Target, file: &MappingFile) -> Result<(Partition, Placement), CompileError> {
    let (members, sites) = mapping_file::membership(file, all, target).map_err(CompileError::Input)?;
    let fault = |error: &dyn std::fmt::Display| CompileError::Fault(error.to_string());
    let placement = Placement::new(Mesh::of(target), sites).map_err(|e| fault(&e))?;
    let seats = seats(all.compartments(), &members).map_err(|e| fault(&e))?;
    let chips: IdVec<CoreId, u32> = placement.sites().iter().map(|site| site.chip).collect();
    let usage = resources::exact::usage(all, &members, &seats, &chips, target.limits());
    let reasons: Vec<Reason> = usage
        .enumerate()
        .flat_map(|(core, used)| used.excesses(target.limits()).map(move |e| (core, e)))
        .map(|(core, (resource, need, limit))| Reason::of_core(core, resource, need, limit))
        .collect();
    if !reasons.is_empty() {
        return Err(CompileError::DoesNotFit(reasons));
    }
    let partition = Partition::new(all.compartments(), members, usage, target.limits()).map_err(|e| fault(&e))?;
    Ok((partition, placement))
}
