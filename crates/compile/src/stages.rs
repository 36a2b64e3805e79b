//! The stages of the compiler, by the types that they pass to each other.
//!
//! A [`Front`] is partitioned, a [`Partitioned`] network placed, a [`Placed`] one emitted, an
//! [`Unchecked`] mapping checked. Comparing mappings begins again at any of them.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::time::Instant;

use crate::emit::route::route;
use crate::mapping::Mapping;
use crate::mapping_file;
use crate::mapping_file::pruned::plan;
use crate::place::ranks::assign;
use crate::place::{self, anneal};
use nsim_check::{equivalence, memory, relays, verify};
use nsim_ir::base::diagnostic::{Diagnostic, collect_all};
use nsim_ir::base::id::{CoreId, IdVec, PopulationId};
use nsim_ir::firing_rates::Rates;
use nsim_ir::hardware::Target;
use nsim_ir::mapping::MappingFile;
use nsim_ir::neurons::NeuronKind;
use nsim_ir::partition::Partition;
use nsim_ir::placement::{Mesh, Placement, Site};
use nsim_ir::quantised::{Inconsistent, Note, Parts, Population, Projection, Quantised, Units};
use nsim_ir::ranks::{RankAssignment, RankShare};
use nsim_ir::resource::Resource;
use nsim_partition::error::{CompileError, Result};
use nsim_partition::large::{counted_in_boxes, is_large};
use nsim_partition::options::{DEFAULT_RATE, Effort, Options};
use nsim_partition::resources::axon_sharing::Places;
use nsim_partition::resources::even_draws;
use nsim_partition::strategy::boxes::{Boxes, Lattices};
use nsim_partition::strategy::members::Members;
use nsim_partition::strategy::{self, boxes, partition, within_bounds};
use nsim_quantise::copies::copies;
use nsim_quantise::prune::{Plan, prune};
use nsim_quantise::relays::{Relayed, relayed};

/// Most synapses of a network that is tried without relays first: larger ones would take long to be
/// partitioned twice.
const TRIED: u64 = 1 << 24;

/// Measures the time of stages.
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

/// A network in integers, before it is mapped.
#[derive(Debug, Clone)]
pub struct Front {
    one: Quantised,
    clock: Clock,
    relays: Option<AddedRelays>,
    cuts: bool,
    stated: Vec<(PopulationId, u32)>,
}

/// Relays that were added to a network.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct AddedRelays {
    /// Number of relays.
    pub relays: u32,
    /// Levels of the deepest tree of them.
    pub levels: u32,
    /// By population of the model, the steps by which its spikes are later, where they are.
    pub later: BTreeMap<String, u32>,
}

impl From<Quantised> for Front {
    fn from(one: Quantised) -> Self {
        Front::measured(one, Vec::new())
    }
}

impl Front {
    /// Returns a network in integers, with the seconds of the stages that made it.
    pub fn measured(one: Quantised, seconds: Vec<(&'static str, f64)>) -> Self {
        Front { one, clock: Clock(seconds), relays: None, cuts: false, stated: Vec::new() }
    }

    /// The network, to be cut into boxes at any size.
    #[must_use]
    pub fn cut(self) -> Self {
        Front { cuts: true, ..self }
    }

    /// The network, with compartments of a core stated by names of populations.
    ///
    /// # Errors
    /// [`CompileError::Input`] when a population does not exist, is an input or is named twice.
    pub fn with_cores_of(mut self, stated: &[(String, u32)]) -> Result<Front> {
        for (name, each) in stated {
            let populations = self.one.populations();
            let found = populations.enumerate().find(|(_, population)| population.name == *name);
            let held = found.filter(|(_, population)| population.first_compartment().is_some()).map(|(id, _)| id);
            let Some(id) = held.filter(|id| !self.stated.iter().any(|(stated, _)| stated == id)) else {
                let with_cores = populations.iter().filter(|one| one.first_compartment().is_some());
                let names: Vec<&str> = with_cores.map(|one| one.name.as_str()).collect();
                let what = if held.is_some() { "is named twice" } else { "is no population with compartments" };
                let message = format!("--cores-of {name}={each}: {name} {what}");
                return Err(Diagnostic::new("map.cores-of", message)
                    .help(format!("name {} once", names.join(", ")))
                    .into());
            };
            self.stated.push((id, *each));
        }
        Ok(self)
    }

    /// Whether compartments of a core are stated.
    pub fn has_stated(&self) -> bool {
        !self.stated.is_empty()
    }

    /// Whether `copies` copies of it are cut into boxes.
    pub fn in_boxes(&self, copies: u32) -> bool {
        self.cuts || is_large(&self.one, copies)
    }

    /// The network.
    pub fn quantised(&self) -> &Quantised {
        &self.one
    }

    /// The relays that were added to the model's, if any.
    pub fn relays(&self) -> Option<&AddedRelays> {
        self.relays.as_ref()
    }

    /// The network.
    #[must_use]
    pub fn into_quantised(self) -> Quantised {
        self.one
    }

    /// The network without the parts that the plan makes superfluous.
    ///
    /// # Errors
    /// [`CompileError::Input`] when a projection is plastic; [`CompileError::Fault`] when the plan
    /// is of another network, or the network has been pruned already.
    pub fn prune(mut self, plan: &Plan) -> Result<Front> {
        let is_plastic = self.one.plastic().next().is_some();
        let refused = |error: Inconsistent| match is_plastic {
            true => Diagnostic::new("map.prune", error.to_string()).help("remove --prune").into(),
            false => CompileError::fault(error),
        };
        self.one = self.clock.stage("prune", || prune(&self.one, plan)).map_err(refused)?;
        Ok(self)
    }

    /// The network with relays where compartments have more targets than output axons, unless it
    /// maps without. A check proves that it spikes identically but for delays. Notes of its
    /// populations give the number of relays, and the steps by which their spikes are later.
    ///
    /// # Errors
    /// [`CompileError::Input`] when delays leave no time for relays, or the network was pruned;
    /// [`CompileError::DoesNotFit`] when relays cannot help.
    pub fn relay(mut self, target: &Target) -> Result<Front> {
        if self.one.pruned().is_some() {
            let refused = Diagnostic::new("map.relays", "relays cannot be added to a pruned network");
            return Err(refused.help("remove --prune or --relays").into());
        }
        let reasons = even_draws::reasons(&self.one, target, 1, true);
        if !reasons.is_empty() {
            return Err(CompileError::DoesNotFit(reasons));
        }
        self.gather(target)?;
        let limits = target.limits();
        let of_core = limits[Resource::AxonsOut] / limits.axon_out_slots_off_chip.max(1);
        let most = limits[Resource::AxonsOutPerCompartment].min(of_core);
        if self.one.synapses() <= TRIED && self.clone().fits_without_relays(target) {
            return Ok(self);
        }
        let relayed = self.clock.stage("relays", || relayed(&self.one, most))?;
        let Relayed { network, later, relays, levels } = relayed;
        let check = || relays::check(&self.one, &network, &later);
        self.clock.stage("check relays", check).map_err(CompileError::fault)?;
        let populations = self.one.populations().iter().zip(&later).filter(|(_, later)| **later > 0);
        let later = populations.map(|(population, &later)| (population.name.clone(), later)).collect();
        self.relays = Some(AddedRelays { relays, levels, later }).filter(|added| added.relays > 0);
        self.one = network;
        Ok(self)
    }

    /// Allows sources to be grouped into population axons where a compartment has more of them than
    /// a core has input axons.
    fn gather(&mut self, target: &Target) -> Result<()> {
        let mut parts = Parts { gathers: true, ..self.one.parts().clone() };
        let gathered = Quantised::new(parts.clone()).map_err(CompileError::fault)?;
        let places = Places::for_network(&gathered, target.limits());
        if !places.are_required() {
            return Ok(());
        }
        for (id, population) in gathered.populations().enumerate() {
            if let Some(axons) = places.positions(&gathered, id) {
                let message = format!("its spikes use {axons} population axons of a core, to save input axons");
                parts.notes.push(Note { entity: population.name.clone(), message, rounded: None });
            }
        }
        self.one = Quantised::new(parts).map_err(CompileError::fault)?;
        Ok(())
    }

    /// Whether output axons are no reason against the network without relays.
    fn fits_without_relays(self, target: &Target) -> bool {
        let options = Options { effort: Effort::Work(0), ..Options::default() };
        match self.partition(target, &options, &Rates::assumed(DEFAULT_RATE)) {
            Err(CompileError::DoesNotFit(reasons)) => !reasons.iter().any(|reason| {
                reason.resource == Resource::AxonsOut || reason.resource == Resource::AxonsOutPerCompartment
            }),
            _ => true,
        }
    }

    /// Assigns compartments to logical cores, for these firing rates of one copy.
    ///
    /// # Errors
    /// [`CompileError`].
    pub fn partition(self, target: &Target, options: &Options, rates: &Rates) -> Result<Partitioned> {
        let stated = self.stated.clone();
        let search = strategy::Search { stated: &stated, ..strategy::Search::new(options, rates) };
        let in_boxes = self.in_boxes(options.copies);
        if in_boxes && self.has_stated() {
            let message = "--cores-of: a network of this size is cut into boxes by nsim alone";
            return Err(Diagnostic::new("map.cores-of", message).help("remove --cores-of").into());
        }
        let target = &*counted_in_boxes(in_boxes, &self.one, target);
        let (front, all) = self.copied(target, options, search)?;
        let Front { one, mut clock, .. } = front;
        let (partition, boxes) = clock.stage("partition", || match in_boxes {
            true => boxes::partition(&all, target, options),
            false => Ok((partition(&one, &all, target, search)?, None)),
        })?;
        let lattices = boxes.as_ref().map(Boxes::lattices);
        Ok(Partitioned { one, all, partition, lattices, boxes, rates: rates.copies(options.copies), clock })
    }

    /// Assigns compartments to the cores of a saved mapping; the network is pruned as it was for
    /// the mapping.
    ///
    /// # Errors
    /// [`CompileError::Input`] when the mapping is of another network, target or number of copies;
    /// [`CompileError::DoesNotFit`] when a core exceeds a limit.
    pub fn place_as(self, target: &Target, options: &Options, file: &MappingFile) -> Result<Placed> {
        mapping_file::of_copies(file, options.copies)?;
        let (in_boxes, rates) = (self.in_boxes(options.copies), Rates::assumed(DEFAULT_RATE));
        let pruned = if in_boxes { self } else { self.prune_as(file)? };
        let target = &*counted_in_boxes(in_boxes, &pruned.one, target);
        let (front, all) = pruned.copied(target, options, strategy::Search::new(options, &rates))?;
        let Front { one, mut clock, .. } = front;
        let load = || mapping_file::load(file, &all, target, in_boxes);
        let (partition, placement, lattices) = clock.stage("mapping", load)?;
        let partitioned = Partitioned { one, all, partition, lattices, boxes: None, rates, clock };
        Ok(Placed { partitioned, placement, name: place::SAVED })
    }

    /// Assigns compartments to these cores at these sites, which were found for this network,
    /// target and options before.
    ///
    /// # Errors
    /// [`CompileError`] when they are of another network or target.
    pub fn place_on(
        self,
        target: &Target,
        options: &Options,
        rates: &Rates,
        cores: (Members, IdVec<CoreId, Site>),
        name: &'static str,
    ) -> Result<Placed> {
        let (members, sites) = cores;
        let (front, all) = self.copied(target, options, strategy::Search::new(options, rates))?;
        let Front { one, mut clock, .. } = front;
        let partition = clock.stage("partition", || mapping_file::partition_on(&all, members, &sites, target))?;
        let mesh = Mesh::for_target(target);
        let placement = clock.stage("place", || Placement::new(mesh, sites)).map_err(CompileError::fault)?;
        let rates = rates.copies(options.copies);
        let partitioned = Partitioned { one, all, partition, lattices: None, boxes: None, rates, clock };
        Ok(Placed { partitioned, placement, name })
    }

    /// All copies, if their sizes alone do not exceed the target.
    fn copied(mut self, target: &Target, options: &Options, search: strategy::Search<'_>) -> Result<(Self, Quantised)> {
        let in_boxes = self.in_boxes(options.copies);
        let (one, clock) = (&self.one, &mut self.clock);
        has_kinds_and_messages(one, target)?;
        clock.stage("bounds", || within_bounds(one, target, options.copies, in_boxes, search))?;
        let all = clock.stage("copies", || copies(one, options.copies));
        let all = all.map_err(|error| Diagnostic::new("map.copies", error.to_string()))?;
        Ok((self, all))
    }

    /// The network, pruned as a mapping records.
    fn prune_as(self, file: &MappingFile) -> Result<Front> {
        match (&file.pruned, self.one.pruned()) {
            (Some(recorded), None) => {
                let plan = plan(recorded, &self.one)?;
                self.prune(&plan)
            }
            (None, Some(_)) => {
                let message = "the mapping is for the whole network, not for a pruned one";
                Err(Diagnostic::new("mapping.pruned", message).into())
            }
            // A network that was pruned otherwise has other compartments, which the file's cores
            // will show.
            (None, None) | (Some(_), Some(_)) => Ok(self),
        }
    }
}

/// Refuses neurons and messages that the target does not support, all of them together.
fn has_kinds_and_messages(network: &Quantised, target: &Target) -> Result<()> {
    let checked = network.populations().enumerate().flat_map(|(id, population)| {
        // The values of a signal are read by rules, and sent to no core.
        let sends = population.first_channel().is_none() || !network.outgoing(id).is_empty();
        let messages = if sends { has_messages(population, target) } else { Ok(()) };
        [messages, has_kind(population, target), has_refractory(population, target)]
    });
    let learning = network.plastic().map(|(_, projection)| has_learning(network, projection, target));
    collect_all(checked.chain(learning))?;
    Ok(())
}

fn has_learning(network: &Quantised, projection: &Projection, target: &Target) -> Result<(), Diagnostic> {
    let Some(rule) = projection.format.rule.filter(|_| !target.chip().learning) else { return Ok(()) };
    let (name, target) = (&network.parts().rules[rule].name, target.name());
    let message = format!("projection '{name}' has a learning rule, and synapses of {target} do not learn");
    Err(Diagnostic::new("map.learning", message).help(
        "set learning: true in a chip of your own, choose a target that learns, or remove the projection's learning",
    ))
}

fn has_messages(population: &Population, target: &Target) -> Result<(), Diagnostic> {
    let (bits, widest) = (population.message.bits(), target.chip().message_bits);
    if bits <= widest {
        return Ok(());
    }
    let most = if widest == 0 { "carry no integers".to_string() } else { format!("carry {widest} bits") };
    let (name, target) = (&population.name, target.name());
    let message = format!("messages of population '{name}' carry integers of {bits} bits, messages of {target} {most}");
    Err(Diagnostic::new("map.message", message)
        .help(format!("set message_bits: {bits} in a chip of your own, or choose a target with wider messages")))
}

fn has_refractory(population: &Population, target: &Target) -> Result<(), Diagnostic> {
    let (period, most) = (population.longest_refractory(), target.chip().refractory);
    if period <= most {
        return Ok(());
    }
    let (name, target) = (&population.name, target.name());
    let message = format!("population '{name}' has a refractory period of {period} steps, {target} has at most {most}");
    Err(Diagnostic::new("map.refractory", message).help(format!(
        "shorten it, set refractory: {period} in a chip of your own, or choose a target with a longer one"
    )))
}

fn has_kind(population: &Population, target: &Target) -> Result<(), Diagnostic> {
    let kinds = &target.chip().neuron_kinds;
    let Units::Compartments { neurons, .. } = &population.units else { return Ok(()) };
    let mut of_neurons = neurons.values().iter().map(|neuron| neuron.kind);
    let Some(kind) = of_neurons.find(|kind| !kinds.contains(&kind.family())) else { return Ok(()) };
    let (name, of_kind, target) = (&population.name, kind.name(), target.name());
    let message = format!("population '{name}' has {of_kind} neurons, which {target} does not have");
    let family = kind.family().name();
    let own = format!("add it to a chip of your own, as neuron_kinds: [{family}], or choose a target that has it");
    let help = match kind {
        NeuronKind::SoftReset => format!(
            "train with a reset to zero (snnTorch: reset_mechanism='zero'), which needs no conversion. nsim convert \
             changes the reset to zero and measures the loss, which may be large. Or run it exactly: {own}"
        ),
        _ => own,
    };
    Err(Diagnostic::new("map.neuron-kind", message).help(help))
}

/// A network on logical cores, for several placements.
#[derive(Debug, Clone)]
pub struct Partitioned {
    one: Quantised,
    /// The network, all copies.
    pub all: Quantised,
    /// Assignment of compartments to cores.
    pub partition: Partition,
    /// Lattices of the layers, of a network that is cut into boxes.
    pub lattices: Option<Lattices>,
    /// Boxes with their fan-out, where they are still to be placed.
    pub boxes: Option<Boxes>,
    rates: Rates,
    clock: Clock,
}

impl Partitioned {
    /// The target with the limits by which its cores are counted.
    fn counted_on<'t>(&self, target: &'t Target) -> Cow<'t, Target> {
        counted_in_boxes(self.lattices.is_some(), &self.one, target)
    }

    /// This partition for a target with other limits.
    ///
    /// # Errors
    /// [`CompileError::Fault`] when a core exceeds them.
    pub fn within(mut self, target: &Target) -> Result<Self> {
        let target = &*self.counted_on(target);
        self.partition = self.partition.within(target.limits()).map_err(CompileError::fault)?;
        Ok(self)
    }

    /// Places of cores on the board, and the name of the placement.
    ///
    /// # Errors
    /// [`CompileError::DoesNotFit`] when there are more cores than the target has.
    pub fn placement(&self, target: &Target, options: &Options) -> Result<place::NamedPlacement> {
        let Partitioned { all, partition, boxes, rates, .. } = self;
        let search = anneal::Search::new(options, rates);
        Ok(match boxes {
            _ if !options.place => (place::sequential(partition.cores(), target)?, place::SEQUENTIAL),
            None => place::place(all, partition, target, search)?,
            Some(boxes) => place::place_boxes(all, boxes, target, search)?,
        })
    }

    /// Places the cores on the board.
    ///
    /// # Errors
    /// As [`Partitioned::placement`].
    pub fn place(mut self, target: &Target, options: &Options) -> Result<Placed> {
        let mut clock = std::mem::take(&mut self.clock);
        let (placement, name) = clock.stage("place", || self.placement(target, options))?;
        self.clock = clock;
        Ok(Placed { partitioned: self, placement, name })
    }
}

/// A network on the cores of the board, and the name of its placement.
#[derive(Debug, Clone)]
pub struct Placed {
    /// The network on logical cores.
    pub partitioned: Partitioned,
    /// Positions of cores on the board.
    pub placement: Placement,
    /// Name of the placement.
    pub name: &'static str,
}

impl Placed {
    /// Emits the tables of one core of each class, and the messages of all.
    ///
    /// # Errors
    /// [`CompileError::Fault`].
    pub fn emit(self, target: &Target, options: &Options) -> Result<Unchecked> {
        let Placed { partitioned, placement, name: placed } = self;
        let limits = partitioned.counted_on(target).limits().clone();
        let Partitioned { one, all: quantised, partition, lattices, boxes, rates, mut clock } = partitioned;
        drop(boxes);
        let RankShare { rank, ranks, whole } = options.share;
        let assignment = (ranks > 1).then(|| {
            let owners = assign(&quantised, &partition, &placement, ranks).into();
            RankAssignment { ranks, owners, held: (!whole).then_some(rank) }
        });
        let places = (&placement, assignment);
        let route = || route(&quantised, &partition, places, options.copies, &limits);
        let program = clock.stage("route", route).map_err(CompileError::Fault)?.into();
        let (seconds, target, options) = (clock.0, target.name().to_string(), *options);
        Ok(Unchecked(Mapping {
            one,
            quantised,
            partition,
            placement,
            lattices,
            program,
            shifts: 0,
            seconds,
            target,
            options,
            placed,
            rates,
        }))
    }
}

/// A mapping that has not been verified and checked, for comparing costs of mappings.
#[derive(Debug, Clone)]
pub struct Unchecked(Mapping);

impl Unchecked {
    /// The mapping, which may be wrong.
    pub fn mapping(&self) -> &Mapping {
        &self.0
    }

    /// Returns the mapping after its limits have been verified, its counts confirmed, and its
    /// synapses compared with the network's.
    ///
    /// # Errors
    /// [`CompileError::Fault`].
    pub fn check(self, target: &Target) -> Result<Mapping> {
        let mut mapping = self.0;
        let mut clock = Clock(std::mem::take(&mut mapping.seconds));
        let Mapping { quantised: network, partition, program, options, .. } = &mapping;
        let target = &*mapping.counted_on(target);
        let used = clock.stage("verify", || memory::used(program, network, target)).map_err(CompileError::fault)?;
        if program.local_rank().is_none() {
            verify::confirm(partition, &used).map_err(CompileError::Fault)?;
        }
        let check = || equivalence::check_copies(network, program, options.copies);
        mapping.shifts = clock.stage("check", check).map_err(CompileError::fault)?;
        mapping.seconds = clock.0;
        Ok(mapping)
    }
}
