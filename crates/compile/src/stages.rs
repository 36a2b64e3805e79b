//! The stages of the compiler: what each hands to the next.
//!
//! A [`Front`] is partitioned, a [`Partitioned`] network placed, a [`Placed`] one emitted, an
//! [`Unchecked`] mapping checked. Comparing mappings begins again at any of them.

use std::collections::BTreeMap;
use std::time::Instant;

use crate::emit::boxes::route_boxes;
use crate::emit::route::route;
use crate::emit::sample::sample;
use crate::mapping::{Checked, Compiled, Mapping, Synapses};
use crate::mapping_file;
use crate::mapping_file::pruned::plan;
use crate::place;
use crate::place::anneal;
use crate::place::deal::deal;
use nsim_check::sampled::SampledCore;
use nsim_check::{equivalence, relays, sampled, verify};
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::id::{CoreId, IdVec};
use nsim_ir::dealt::{Dealt, Share};
use nsim_ir::firing_rates::Rates;
use nsim_ir::hardware::Target;
use nsim_ir::mapping::MappingFile;
use nsim_ir::neurons::NeuronKind;
use nsim_ir::partition::Partition;
use nsim_ir::placement::{Mesh, Placement, Site};
use nsim_ir::program::Program;
use nsim_ir::quantised::{Note, Parts, Quantised, Units};
use nsim_ir::resource::Resource;
use nsim_partition::error::{CompileError, Result};
use nsim_partition::form::Form;
use nsim_partition::options::{DEFAULT_RATE, Effort, Options};
use nsim_partition::resources::axon_sharing::Places;
use nsim_partition::resources::even_draws;
use nsim_partition::strategy;
use nsim_partition::strategy::boxes;
use nsim_partition::strategy::boxes::Boxes;
use nsim_partition::strategy::members::Members;
use nsim_partition::strategy::{partition, within_bounds};
use nsim_quantise::copies::copies;
use nsim_quantise::prune::{Plan, prune};
use nsim_quantise::relays::{Relayed, relayed};

/// Synapses of a network up to which it is tried without relays first: larger ones would be
/// partitioned twice for long.
const TRIED: u64 = 1 << 24;

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

/// A network in integers, before it is mapped.
#[derive(Debug, Clone)]
pub struct Front {
    one: Quantised,
    clock: Clock,
    relays: Option<AddedRelays>,
}

/// Relays that were added to a network.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct AddedRelays {
    /// How many.
    pub relays: u32,
    /// Levels of the deepest tree of them.
    pub levels: u32,
    /// By population of the model, the steps by which its spikes come later, where they do.
    pub later: BTreeMap<String, u32>,
}

impl From<Quantised> for Front {
    fn from(one: Quantised) -> Self {
        Front { one, clock: Clock::default(), relays: None }
    }
}

impl Front {
    /// A network in integers, made in stages that took this many seconds each.
    #[must_use]
    pub fn measured(one: Quantised, seconds: Vec<(&'static str, f64)>) -> Self {
        Front { one, clock: Clock(seconds), relays: None }
    }

    /// The network.
    #[must_use]
    pub fn quantised(&self) -> &Quantised {
        &self.one
    }

    /// The relays that it has besides those of the model, if any.
    #[must_use]
    pub fn relays(&self) -> Option<&AddedRelays> {
        self.relays.as_ref()
    }

    /// The network.
    #[must_use]
    pub fn into_quantised(self) -> Quantised {
        self.one
    }

    /// The network without what the plan makes superfluous.
    ///
    /// # Errors
    /// [`CompileError::Fault`] when the plan is of another network, or the network has been pruned
    /// already.
    pub fn prune(mut self, plan: &Plan) -> Result<Front> {
        self.one = self.clock.stage("prune", || prune(&self.one, plan)).map_err(CompileError::fault)?;
        Ok(self)
    }

    /// The network with relays where compartments have more targets than output axons, unless it
    /// maps without; proved to spike alike. Populations then have notes that say how many relays,
    /// and how many steps later their spikes come.
    ///
    /// # Errors
    /// [`CompileError::Input`] when delays leave no time for relays, or the network was pruned;
    /// [`CompileError::DoesNotFit`] when relays cannot help.
    pub fn relay(mut self, target: &Target) -> Result<Front> {
        if self.one.pruned().is_some() {
            let refused = Diagnostic::new("map.relays", "a pruned network cannot be given relays");
            return Err(refused.help("leave --prune or --relays out").into());
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

    /// Lets sources be gathered in population axons where a compartment has more of them than a
    /// core has input axons.
    fn gather(&mut self, target: &Target) -> Result<()> {
        let mut parts = Parts { gathers: true, ..self.one.parts().clone() };
        let gathered = Quantised::new(parts.clone()).map_err(CompileError::fault)?;
        let places = Places::for_network(&gathered, target.limits());
        if !places.are_of_need() {
            return Ok(());
        }
        for (id, population) in gathered.populations().enumerate() {
            if let Some(axons) = places.positions(&gathered, id) {
                let message = format!("its spikes go to {axons} population axons of a core, for want of input axons");
                parts.notes.push(Note { entity: population.name.clone(), message, rounded: None });
            }
        }
        self.one = Quantised::new(parts).map_err(CompileError::fault)?;
        Ok(())
    }

    /// Whether output axons are no reason against the network as it is.
    fn fits_without_relays(self, target: &Target) -> bool {
        let options = Options { effort: Effort::Work(0), ..Options::default() };
        match self.partition(target, &options, &Rates::assumed(DEFAULT_RATE), Form::Written) {
            Err(CompileError::DoesNotFit(reasons)) => !reasons.iter().any(|reason| {
                reason.resource == Resource::AxonsOut || reason.resource == Resource::AxonsOutPerCompartment
            }),
            _ => true,
        }
    }

    /// Compartments on logical cores, for sources of one copy that spike this often.
    ///
    /// # Errors
    /// [`CompileError`].
    pub fn partition(self, target: &Target, options: &Options, rates: &Rates, form: Form) -> Result<Partitioned> {
        let search = strategy::Search::new(options, rates);
        let (front, all) = self.copied(target, options, search, form)?;
        let Front { one, mut clock, .. } = front;
        let (partition, boxes) = clock.stage("partition", || match form {
            Form::Written => Ok((partition(&one, &all, target, search)?, None)),
            Form::Symbolic => boxes::partition(&all, target, options),
        })?;
        Ok(Partitioned { one, all, partition, boxes, rates: rates.copies(options.copies), clock })
    }

    /// Compartments on the cores that a saved mapping says, of the network pruned as it was for the
    /// mapping.
    ///
    /// # Errors
    /// [`CompileError::Input`] when the mapping is of another network, target or number of copies;
    /// [`CompileError::DoesNotFit`] when a core exceeds a limit.
    pub fn place_as(self, target: &Target, options: &Options, file: &MappingFile, form: Form) -> Result<Placed> {
        mapping_file::of_copies(file, options.copies)?;
        let rates = Rates::assumed(DEFAULT_RATE);
        let pruned = match form {
            Form::Written => self.prune_as(file)?,
            Form::Symbolic => self,
        };
        let (front, all) = pruned.copied(target, options, strategy::Search::new(options, &rates), form)?;
        let Front { one, mut clock, .. } = front;
        let (partition, placement, boxes) = clock.stage("mapping", || mapping_file::load(file, &all, target, form))?;
        Ok(Placed {
            partitioned: Partitioned { one, all, partition, boxes, rates, clock },
            placement,
            name: place::SAVED,
        })
    }

    /// Compartments on these cores at these sites, which were found for this network, target and
    /// options before.
    ///
    /// # Errors
    /// [`CompileError`] when they are of another network or target.
    pub fn place_on(
        self,
        target: &Target,
        options: &Options,
        rates: &Rates,
        (members, sites): (Members, IdVec<CoreId, Site>),
        name: &'static str,
    ) -> Result<Placed> {
        let search = strategy::Search::new(options, rates);
        let (front, all) = self.copied(target, options, search, Form::Written)?;
        let Front { one, mut clock, .. } = front;
        let partition = clock.stage("partition", || mapping_file::partition_on(&all, members, &sites, target))?;
        let mesh = Mesh::for_target(target);
        let placement = clock.stage("place", || Placement::new(mesh, sites)).map_err(CompileError::fault)?;
        let rates = rates.copies(options.copies);
        Ok(Placed { partitioned: Partitioned { one, all, partition, boxes: None, rates, clock }, placement, name })
    }

    /// All copies, if their sizes alone do not exceed the target.
    fn copied(
        mut self,
        target: &Target,
        options: &Options,
        search: strategy::Search<'_>,
        form: Form,
    ) -> Result<(Self, Quantised)> {
        let (one, clock) = (&self.one, &mut self.clock);
        has_kinds_and_messages(one, target)?;
        clock.stage("bounds", || within_bounds(one, target, options.copies, form, search))?;
        let all = clock.stage("copies", || copies(one, options.copies));
        let all = all.map_err(|error| Diagnostic::new("map.copies", error.to_string()))?;
        Ok((self, all))
    }

    /// The network pruned as a mapping says that it was.
    fn prune_as(self, file: &MappingFile) -> Result<Front> {
        match (&file.pruned, self.one.pruned()) {
            (Some(recorded), None) => {
                let plan = plan(recorded, &self.one)?;
                self.prune(&plan)
            }
            (None, Some(_)) => {
                let message = "the mapping is of the whole network, not of a pruned one";
                Err(Diagnostic::new("mapping.pruned", message).into())
            }
            // What was pruned in another way has other compartments, which the file's cores will
            // show.
            (None, None) | (Some(_), Some(_)) => Ok(self),
        }
    }
}

/// Refuses neurons that no compartment of the target can be, and messages that it cannot send.
fn has_kinds_and_messages(network: &Quantised, target: &Target) -> Result<()> {
    let (kinds, widest) = (&target.chip().neuron_kinds, target.chip().message_bits);
    for population in network.populations() {
        let bits = population.message.bits();
        if bits > widest {
            let carry = if widest == 0 { "carry no integers".to_string() } else { format!("carry {widest} bits") };
            let (name, target) = (&population.name, target.name());
            let message =
                format!("messages of population '{name}' carry integers of {bits} bits, those of {target} {carry}");
            return Err(Diagnostic::new("map.message", message)
                .help("choose a target with wider messages (its message_bits): docs/loihi2.md names one")
                .into());
        }
        let Units::Compartments { neurons, .. } = &population.units else { continue };
        let mut lacking = NeuronKind::ALL.into_iter().filter(|kind| !kinds.contains(kind));
        if let Some(kind) = lacking.find(|kind| neurons.any(|neuron| neuron.kind == *kind)) {
            let message = format!(
                "population '{}' has {} neurons, which {} does not have",
                population.name,
                kind.name(),
                target.name()
            );
            return Err(Diagnostic::new("map.neuron-kind", message)
                .help(match kind {
                    NeuronKind::SoftReset => {
                        "nsim convert makes it reset to zero and measures the loss; or choose a target with these \
                         neuron_kinds"
                    }
                    _ => "choose a target with these neuron_kinds: docs/loihi2.md names one",
                })
                .into());
        }
    }
    Ok(())
}

/// A network on logical cores, for placing in several ways.
#[derive(Debug, Clone)]
pub struct Partitioned {
    one: Quantised,
    /// The network, all copies.
    pub all: Quantised,
    /// Compartments on cores.
    pub partition: Partition,
    /// The boxes of a symbolic mapping.
    pub boxes: Option<Boxes>,
    rates: Rates,
    clock: Clock,
}

impl Partitioned {
    /// The network, one copy.
    #[must_use]
    pub fn one(&self) -> &Quantised {
        &self.one
    }

    /// The same for a target with other limits than it was made for.
    ///
    /// # Errors
    /// [`CompileError::Fault`] when a core exceeds them.
    pub fn within(mut self, target: &Target) -> Result<Self> {
        self.partition = self.partition.within(target.limits()).map_err(CompileError::fault)?;
        Ok(self)
    }

    /// Places of cores on the board, and the name of how they were found.
    ///
    /// # Errors
    /// [`CompileError::DoesNotFit`] when there are more than the target has.
    pub fn placement(&self, target: &Target, options: &Options) -> Result<(Placement, &'static str)> {
        let Partitioned { all, partition, boxes, rates, .. } = self;
        let search = anneal::Search::new(options, rates);
        Ok(match boxes {
            _ if !options.place => (place::sequential(partition.cores(), target)?, place::SEQUENTIAL),
            None => place::place(all, partition, target, search)?,
            Some(boxes) => place::place_boxes(all, boxes, target, search)?,
        })
    }

    /// Cores on the board.
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

/// The cores dealt out to the processes that run the program together, if there are several.
fn dealt(network: &Quantised, partition: &Partition, placement: &Placement, share: Share) -> Option<Dealt> {
    let Share { rank, ranks, whole } = share;
    (ranks > 1).then(|| {
        let owners = deal(network, partition, placement, ranks).into();
        Dealt { ranks, owners, held: (!whole).then_some(rank) }
    })
}

/// The mapping with its program, which is written here if it was mapped by its kernels, and then
/// verified and checked: every synapse of one core of each pattern.
///
/// # Errors
/// [`CompileError::Fault`].
pub fn with_program(mapping: Mapping, target: &Target) -> Result<Compiled> {
    if mapping.form() == Form::Written {
        return mapping.into_compiled();
    }
    let mut clock = Clock(mapping.seconds.clone());
    let Mapping { quantised: network, partition, placement, options, .. } = &mapping;
    let dealt = dealt(network, partition, placement, options.share);
    let placed = (placement, dealt);
    let (program, checked) = by_patterns((network, options.copies), partition, placed, target, &mut clock)?;
    Mapping { program: Synapses::Written(program.into()), checked, seconds: clock.0, ..mapping }.into_compiled()
}

/// The program of a network that is mapped by its kernels, written, verified and checked.
fn by_patterns(
    (network, copies): (&Quantised, u32),
    partition: &Partition,
    (placement, dealt): (&Placement, Option<Dealt>),
    target: &Target,
    clock: &mut Clock,
) -> Result<(Program, Checked)> {
    let target = &*Form::Symbolic.counted_on(network, target);
    let route = || route_boxes(network, partition, (placement, dealt), target.limits());
    let (program, sample) = clock.stage("write", route).map_err(CompileError::Fault)?;
    if program.held_rank().is_none() {
        let checked = checked_whole(network, &program, target, copies, clock)?;
        return Ok((program, checked));
    }
    clock.stage("verify", || verify::verify(&program, target)).map_err(CompileError::fault)?;
    let chips: IdVec<CoreId, u32> = placement.sites().iter().map(|site| site.chip).collect();
    let check = || sampled::check(network, partition, &chips, &sample, target.limits());
    clock.stage("check", check).map_err(CompileError::Fault)?;
    Ok((program, Checked { how: "sampled", share: 0.0 }))
}

/// How a program was compared with its network, once its limits have been verified and all of it
/// compared.
fn checked_whole(
    network: &Quantised,
    program: &Program,
    target: &Target,
    copies: u32,
    clock: &mut Clock,
) -> Result<Checked> {
    clock.stage("verify", || verify::verify(program, target)).map_err(CompileError::fault)?;
    let check = || equivalence::check_copies(network, program, copies);
    let proven = clock.stage("check", check).map_err(CompileError::fault)?;
    Ok(Checked { how: if proven > 0 { "pattern" } else { "whole" }, share: 1.0 })
}

/// A network on the cores of the board, and the name of how they were placed.
#[derive(Debug, Clone)]
pub struct Placed {
    /// The network on logical cores.
    pub partitioned: Partitioned,
    /// Cores on the board.
    pub placement: Placement,
    /// Name of the placement.
    pub name: &'static str,
}

impl Placed {
    /// How far its synapses are expanded.
    #[must_use]
    pub fn form(&self) -> Form {
        if self.partitioned.boxes.is_some() { Form::Symbolic } else { Form::Written }
    }

    /// The tables of all cores; of a symbolic mapping those of one core of each kind.
    ///
    /// # Errors
    /// [`CompileError::Fault`].
    pub fn emit(self, target: &Target, options: &Options) -> Result<Unchecked> {
        let Placed { partitioned, placement, name: placed } = self;
        let Partitioned { one, all: quantised, partition, boxes, rates, mut clock } = partitioned;
        let limits = target.limits();
        let (program, sample) = clock
            .stage("route", || match boxes {
                None => {
                    let dealt = dealt(&quantised, &partition, &placement, options.share);
                    let program = route(&quantised, &partition, &placement, (options.copies, dealt), limits)?;
                    Ok((Synapses::Written(program.into()), Vec::new()))
                }
                Some(boxes) => {
                    let sample = sample(&quantised, &partition, &boxes.to_be_checked(), limits)?;
                    Ok((Synapses::Symbolic(Box::new(boxes)), sample))
                }
            })
            .map_err(CompileError::Fault)?;
        let (seconds, target, options) = (clock.0, target.name().to_string(), *options);
        let checked = Checked { how: "sampled", share: 0.0 };
        let mapping =
            Mapping { one, quantised, partition, placement, program, checked, seconds, target, options, placed, rates };
        Ok(Unchecked { mapping, sample })
    }
}

/// A mapping that has not been verified and checked, for comparing what mappings cost.
#[derive(Debug, Clone)]
pub struct Unchecked {
    mapping: Mapping,
    /// Tables of one core of each kind, of a symbolic mapping.
    sample: Vec<SampledCore>,
}

impl Unchecked {
    /// The mapping, which may be wrong.
    #[must_use]
    pub fn mapping(&self) -> &Mapping {
        &self.mapping
    }

    /// The mapping once its limits have been verified and its synapses compared with the network's.
    ///
    /// # Errors
    /// [`CompileError::Fault`].
    pub fn check(self, target: &Target) -> Result<Mapping> {
        let Unchecked { mut mapping, sample } = self;
        let mut clock = Clock(std::mem::take(&mut mapping.seconds));
        let Mapping { quantised: network, partition, placement, .. } = &mapping;
        mapping.checked = match &mapping.program {
            Synapses::Written(program) => checked_whole(network, program, target, mapping.options.copies, &mut clock)?,
            Synapses::Symbolic(_) => {
                let chips: IdVec<CoreId, u32> = placement.sites().iter().map(|site| site.chip).collect();
                let check = || sampled::check(network, partition, &chips, &sample, target.limits());
                clock.stage("check", check).map_err(CompileError::Fault)?;
                Checked { how: "sampled", share: sample.len() as f64 / partition.cores().max(1) as f64 }
            }
        };
        mapping.seconds = clock.0;
        Ok(mapping)
    }
}
