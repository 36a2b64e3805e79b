//! The program of the machine: classes of equal cores, and one closed image for each core, with
//! names resolved to indices.
//!
//! Cores of one class store identical tables: parameters, formats, input axons and lists. They
//! differ in their places, the ids of their compartments and their messages.
//!
//! A compartment's spike sends one message to each core that has a target of it; there the
//! message's input axon selects a list of synapses. Input channels send messages likewise. Input
//! axons whose lists differ only by a shift of all slots can be members of population axons and
//! select one stored list ([`PopulationAxon`]). Invariants of a [`Program`]: every table is closed:
//! each message has an existing axon, each synapse an existing compartment. No axon has two
//! sources, every stored list is selected, and every class has a core. `nsim_check::equivalence`
//! proves that a program equals its `Quantised` network.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;
use serde::{Deserialize, Serialize, Serializer};

use crate::activity::CoreCounts;
use crate::arithmetic::{ReadOut, Semantics, ThresholdTest};
use crate::base::csr::Csr;
use crate::base::fixed::Delay;
use crate::base::id::{ChannelId, ClassId, CompartmentId, CoreId, Id, IdVec, PopulationId, ProjectionId, RuleId};
use crate::learning::{Learning, Plastic, Variable};
pub use crate::messages::{AxonTarget, AxonsOut, Messages};
use crate::partition::Seat;
use crate::placement::{Mesh, Site};
use crate::quantised::connectivity::{Connectivity, SeparateSum, SynapseFormat};
use crate::quantised::{Neuron, Output, Population, Projection, Quantised, Reset};
use crate::ranks::RankAssignment;
use crate::spikes::Message;

/// A synapse of an input axon's list.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Synapse {
    /// Slot of the target compartment.
    pub slot: u16,
    /// Weight mantissa.
    pub weight: i16,
    /// Index into the core's formats.
    pub format: u8,
    /// Delay field.
    pub delay: Delay,
}

/// A synapse format of a core.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CoreFormat {
    /// Exponent, sign mode and bits of its weights.
    pub synapse: SynapseFormat,
    /// Bits of its delays.
    pub delay_bits: u8,
    /// Bits of its target indices; `None` for a dense list, whose targets follow each other.
    pub index_bits: Option<u8>,
    /// Bits of the number of slots skipped before each synapse, in a list that has an index for its
    /// first synapse only.
    pub skip_bits: Option<u8>,
}

/// A core's entry for several sources, the channels at one position of a population. The atom in a
/// message identifies the channel. Population axons with the same table store it once, each with
/// its own base.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct PopulationAxon {
    /// Index of the list of atom 0; the lists of the other atoms follow it.
    pub table: u32,
    /// Number of lists of the table.
    pub atoms: u16,
    /// Added to every slot of the lists.
    pub base: u16,
}

/// The list that the message of one source selects on a core.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub enum InputAxon {
    /// A list for this axon alone, with the slots as they are stored.
    Discrete {
        /// The list.
        list: u32,
    },
    /// The list of its atom in the table of a population axon.
    Member {
        /// The population axon.
        axon: u16,
        /// The atom.
        atom: u16,
    },
}

/// A stored list as an input axon selects it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SelectedList<'a> {
    /// Added to every slot.
    pub base: u16,
    /// The synapses as they are stored.
    pub stored: &'a [Synapse],
}

impl<'a> SelectedList<'a> {
    /// The synapses with the slots of their targets.
    #[inline]
    pub fn synapses(self) -> impl ExactSizeIterator<Item = Synapse> + Clone + 'a {
        self.stored.iter().map(move |synapse| Synapse { slot: synapse.slot + self.base, ..*synapse })
    }
}

/// A core's lists of synapses and the input axons that select them.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct InputTable {
    /// The tables of population axons, then the lists of discrete axons.
    pub lists: Csr<Synapse>,
    /// Population axons; usually few or none.
    pub populations: Vec<PopulationAxon>,
    /// Input axons up to the last member of a population axon. All axons after it are discrete and
    /// have the last lists, in order. So without population axons there are none here, and axon i
    /// has list i.
    pub axons: Vec<InputAxon>,
    /// Number of input axons after these.
    pub plain: u32,
}

impl InputTable {
    /// Input axons that are all discrete, one for each list.
    pub fn discrete(lists: Csr<Synapse>) -> Self {
        InputTable { plain: lists.len() as u32, lists, ..InputTable::default() }
    }

    /// Input axons of a core with population axons, one for each source that reaches it.
    pub fn with_populations(lists: Csr<Synapse>, populations: Vec<PopulationAxon>, mut axons: Vec<InputAxon>) -> Self {
        let discrete = |(back, axon): &(usize, &InputAxon)| match **axon {
            InputAxon::Discrete { list } => list as usize + back + 1 == lists.len(),
            InputAxon::Member { .. } => false,
        };
        let plain = axons.iter().rev().enumerate().take_while(discrete).count();
        axons.truncate(axons.len() - plain);
        axons.shrink_to_fit();
        InputTable { lists, populations, axons, plain: plain as u32 }
    }

    /// Number of sources that reach the core.
    pub fn len(&self) -> usize {
        self.axons.len() + self.plain as usize
    }

    /// Whether no source reaches the core.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// An input axon.
    #[inline]
    pub fn axon(&self, axon: usize) -> InputAxon {
        self.axons.get(axon).copied().unwrap_or_else(|| {
            let from_end = self.len() - axon;
            InputAxon::Discrete { list: (self.lists.len() - from_end) as u32 }
        })
    }

    /// Index of the list that an input axon selects, and the offset added to every slot of it.
    #[inline]
    pub fn selected(&self, axon: usize) -> (usize, u16) {
        match self.axon(axon) {
            InputAxon::Discrete { list } => (list as usize, 0),
            InputAxon::Member { axon, atom } => {
                let population = self.populations[usize::from(axon)];
                (population.table as usize + usize::from(atom), population.base)
            }
        }
    }

    /// The list that an input axon selects.
    #[inline]
    pub fn get(&self, axon: usize) -> SelectedList<'_> {
        let (list, base) = self.selected(axon);
        SelectedList { base, stored: self.lists.get(list) }
    }

    /// The lists that the input axons select, in order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = SelectedList<'_>> {
        (0..self.len()).map(|axon| self.get(axon))
    }

    /// Indices of the lists of discrete axons, in the order of axons.
    pub fn iter_discrete(&self) -> impl Iterator<Item = usize> {
        (0..self.len()).filter_map(|axon| match self.axon(axon) {
            InputAxon::Discrete { list } => Some(list as usize),
            InputAxon::Member { .. } => None,
        })
    }

    /// Every synapse, with the slot of its target. A synapse that several sources share comes once
    /// for each.
    pub fn synapses(&self) -> impl Iterator<Item = Synapse> {
        self.iter().flat_map(SelectedList::synapses)
    }

    /// Number of synapses; a synapse that several sources share counts once for each.
    pub fn count(&self) -> u64 {
        match self.populations.is_empty() {
            true => self.lists.items().len() as u64,
            false => self.iter().map(|list| list.stored.len() as u64).sum(),
        }
    }

    /// Whether there are as many lists as axons without an entry, or more.
    fn has_lists(&self) -> bool {
        self.plain as usize <= self.lists.len()
    }

    /// Whether every axon selects a list and every list is selected, by one axon if that is
    /// discrete. Atoms must be in their tables, and slots below `slots`.
    fn is_closed(&self, slots: usize) -> bool {
        let most = |lists: Range<usize>| lists.flat_map(|list| self.lists.get(list)).map(|s| s.slot).max();
        if self.axons.is_empty() && self.populations.is_empty() {
            let below = |synapse: &Synapse| usize::from(synapse.slot) < slots;
            return self.plain as usize == self.lists.len() && self.lists.items().iter().all(below);
        }
        let mut selected = vec![false; self.lists.len()];
        for population in &self.populations {
            let table = population.table as usize..population.table as usize + usize::from(population.atoms);
            let below = |slot: u16| usize::from(slot) + usize::from(population.base) < slots;
            if population.atoms == 0 || table.end > selected.len() || !most(table.clone()).is_none_or(below) {
                return false;
            }
            selected[table].fill(true);
        }
        let axons = (0..self.len()).all(|axon| match self.axon(axon) {
            InputAxon::Discrete { list } => match selected.get_mut(list as usize) {
                Some(list_of @ false) => {
                    *list_of = true;
                    self.lists.get(list as usize).iter().all(|synapse| usize::from(synapse.slot) < slots)
                }
                _ => false,
            },
            InputAxon::Member { axon, atom } => {
                self.populations.get(usize::from(axon)).is_some_and(|population| atom < population.atoms)
            }
        });
        axons && selected.iter().all(|&selected| selected)
    }
}

/// A compartment's parameters on its core.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Compartment {
    /// The parameters.
    pub neuron: Neuron,
    /// The step before which it is held at zero.
    pub start_step: u32,
}

/// Tables that equal cores store.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CoreClass {
    /// Compartments by slot.
    pub compartments: Vec<Compartment>,
    /// Formats of the synapses.
    pub formats: Vec<CoreFormat>,
    /// Input axons and the synapses that they select.
    pub inputs: InputTable,
}

impl CoreClass {
    /// A class of cores whose tables another process stores.
    pub fn without_tables(compartments: Vec<Compartment>) -> Self {
        CoreClass { compartments, formats: Vec::new(), inputs: InputTable::default() }
    }

    /// Number of dense and of sparse synapses of a stored list. A list of a class without dense
    /// formats is not read.
    pub fn dense_and_sparse(&self, list: &[Synapse]) -> (u32, u32) {
        let is_dense = |format: &CoreFormat| format.index_bits.is_none();
        let dense = match self.formats.iter().any(is_dense) {
            true => list.iter().filter(|synapse| is_dense(&self.formats[usize::from(synapse.format)])).count(),
            false => 0,
        };
        (dense as u32, (list.len() - dense) as u32)
    }

    /// Counts of a visit to each compartment.
    pub fn visit(&self) -> CoreCounts {
        let mut sum = CoreCounts::default();
        self.compartments.iter().for_each(|compartment| sum += CoreCounts::of_visit(compartment.neuron.kind));
        sum
    }

    /// Counts of a step in which no neuron is idle, without messages.
    pub fn updates(&self) -> CoreCounts {
        let visit = self.visit();
        CoreCounts { active: visit.visited, stated_active: visit.stated, ..visit }
    }

    /// The error of a synapse to a missing sum; every synapse must have an existing target.
    fn sums_not_closed(&self) -> Option<&'static str> {
        if self.formats.iter().all(|format| format.synapse.port.is_first() && format.synapse.apart.is_none()) {
            return None;
        }
        let has_sum = |synapse: Synapse| {
            let table = self.compartments[usize::from(synapse.slot)].neuron.kind.table();
            let SynapseFormat { port, apart, .. } = self.formats[usize::from(synapse.format)].synapse;
            port.index() < usize::from(table.ports)
                && apart.is_none_or(|apart| !table.registers && usize::from(apart.number) < SeparateSum::MOST)
        };
        let closed = (0..self.inputs.len()).all(|axon| self.inputs.get(axon).synapses().all(has_sum));
        (!closed).then_some("a synapse leads to a sum that its compartment does not have")
    }
}

/// A core: its class, and the tables of its own.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CoreImage {
    /// Its physical core.
    pub site: Site,
    /// Its class.
    pub class: ClassId,
    /// The network's id of each compartment, by slot.
    pub ids: Arc<Vec<CompartmentId>>,
    /// Messages that a spike sends, by slot, in ascending order of cores.
    pub axons_out: AxonsOut,
}

/// Consecutive sources whose messages carry an integer. Sources are numbered channels first, then
/// compartments.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Graded {
    /// The sources.
    pub sources: Range<u32>,
    /// The content of their messages, other than a binary spike.
    pub message: Message,
}

/// The compartments of a population.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Compartments {
    /// The first compartment.
    pub first: CompartmentId,
    /// Number of compartments.
    pub count: u32,
    /// Positions of its shape over space, at least 1. Compartments are numbered channel by channel:
    /// channel c at position p is number `c * positions + p`.
    pub positions: u32,
}

impl Compartments {
    /// The compartments of a population; `None` for an input.
    pub fn in_population(population: &Population) -> Option<Self> {
        let (count, positions) = (population.shape.len(), population.shape.positions());
        population.first_compartment().map(|first| Compartments { first, count, positions })
    }
}

/// The plastic synapses of a projection, as the network numbers them.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct PlasticProjection {
    /// The state of its synapses besides weights and delays.
    pub plastic: Arc<Plastic>,
    /// Its sources, channels first, then compartments.
    pub sources: Range<u32>,
    /// Its targets.
    pub targets: Range<u32>,
    /// Its synapses, by source.
    pub connectivity: Connectivity,
    /// Format of its synapses.
    pub format: SynapseFormat,
    /// Delay field of its synapses, at first.
    pub delay: Delay,
    /// The channels whose values replace y1, y2 and y3.
    pub signals: [Option<Range<u32>>; 3],
    /// The sources whose spikes are rewards, channels first, then compartments.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reward: Option<Range<u32>>,
}

/// The learning rules of a program and the projections that they change.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct ProgramLearning {
    /// The rules of the network.
    pub rules: IdVec<RuleId, Learning>,
    /// The plastic projections in the order of the network.
    pub projections: Vec<PlasticProjection>,
}

impl ProgramLearning {
    /// The learning of a network.
    pub fn in_network(network: &Quantised) -> Self {
        let units = |id: PopulationId| {
            let population = &network.populations()[id];
            let first = network.first_source(population);
            first..first + population.shape.len()
        };
        let of = |(_, projection): (ProjectionId, &Projection)| {
            let plastic = projection.plastic.clone()?;
            let targets = units(projection.target);
            Some(PlasticProjection {
                sources: units(projection.source),
                targets: targets.start - network.channels()..targets.end - network.channels(),
                connectivity: projection.connectivity.clone(),
                format: projection.format,
                delay: projection.delay,
                signals: plastic.signals.map(|signal| signal.map(units)),
                reward: plastic.reward.map(units),
                plastic,
            })
        };
        let rules = network.parts().rules.clone();
        ProgramLearning { rules, projections: network.plastic().filter_map(of).collect() }
    }

    /// Whether a rule changes delays that act, by rule.
    pub fn moves_delays(&self) -> IdVec<RuleId, bool> {
        let moves =
            |learning: &Learning| learning.rule.semantics().delays_act() && learning.rule.changes(Variable::Delay);
        self.rules.iter().map(moves).collect()
    }

    /// Whether no projection is plastic.
    pub fn is_empty(&self) -> bool {
        self.projections.is_empty()
    }
}

/// Parts of a [`Program`].
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, rename = "Program")]
pub struct Parts {
    /// The mesh that sites are on.
    pub mesh: Mesh,
    /// Tables of each class of cores.
    pub classes: IdVec<ClassId, CoreClass>,
    /// Core images.
    pub cores: IdVec<CoreId, CoreImage>,
    /// Messages that an input spike sends, by channel, in ascending order of cores.
    pub channels: Csr<AxonTarget>,
    /// The seat of each compartment of the network.
    pub seats: Arc<IdVec<CompartmentId, Seat>>,
    /// The compartments of each population; `None` for inputs.
    pub populations: IdVec<PopulationId, Option<Compartments>>,
    /// Sources of graded spikes, ascending; all others send binary spikes.
    pub graded: Vec<Graded>,
    /// The output population.
    pub output: PopulationId,
    /// The score that decides.
    pub decision: ReadOut,
    /// The step before which the output population is held at zero.
    pub output_start: u32,
    /// The arithmetic.
    pub semantics: Semantics,
    /// The threshold test.
    pub threshold: ThresholdTest,
    /// Periodic reset.
    pub reset: Option<Reset>,
    /// Learning rules and plastic projections.
    #[serde(default, skip_serializing_if = "ProgramLearning::is_empty")]
    pub learning: ProgramLearning,
    /// The rank of each core, where there are several processes.
    pub assignment: Option<RankAssignment>,
}

/// Input axons that a message has reached, one bit each.
struct AxonMarks(IdVec<CoreId, Box<[AtomicU64]>>);

impl AxonMarks {
    fn new(parts: &Parts) -> Self {
        let of = |core| {
            // The bits after the last axon are set.
            let axons = parts.class_of(core).inputs.len();
            let word = |first: usize| AtomicU64::new(u64::MAX.checked_shl((axons - first) as u32).unwrap_or(0));
            (0..axons).step_by(64).map(word).collect()
        };
        AxonMarks(parts.cores.ids().map(of).collect())
    }

    /// Marks an input axon; returns whether it exists and no message reached it before.
    fn mark(&self, target: AxonTarget) -> bool {
        let bit = 1 << (target.axon % 64);
        let word = self.0.get(target.core).and_then(|words| words.get(usize::from(target.axon / 64)));
        word.is_some_and(|word| word.fetch_or(bit, Ordering::Relaxed) & bit == 0)
    }

    fn all_marked(&self, core: CoreId) -> bool {
        self.0[core].iter().all(|word| word.load(Ordering::Relaxed) == u64::MAX)
    }
}

impl Parts {
    /// The class of a core.
    ///
    /// # Panics
    /// When the core or its class does not exist.
    #[inline]
    pub fn class_of(&self, core: CoreId) -> &CoreClass {
        &self.classes[self.cores[core].class]
    }

    /// The class of a core, mutable for this core alone: a shared class is copied.
    ///
    /// # Panics
    /// When the core or its class does not exist.
    pub fn class_mut(&mut self, core: CoreId) -> &mut CoreClass {
        let class = self.cores[core].class;
        if self.cores.iter().filter(|image| image.class == class).count() > 1 {
            self.cores[core].class = self.classes.push(self.classes[class].clone());
        }
        &mut self.classes[self.cores[core].class]
    }

    /// The first core of each class; `None` for a class without cores.
    fn first_cores(&self) -> IdVec<ClassId, Option<CoreId>> {
        let mut firsts: IdVec<ClassId, Option<CoreId>> = vec![None; self.classes.len()].into();
        for (core, image) in self.cores.enumerate() {
            firsts[image.class].get_or_insert(core);
        }
        firsts
    }

    /// The first error in the tables of a core; its class is checked with the `first` core only.
    fn not_closed(&self, core: CoreId, first: bool, marks: &AxonMarks) -> Option<&'static str> {
        let (image, class) = (&self.cores[core], self.class_of(core));
        let slots = class.compartments.len();
        let seat = |(slot, id): (usize, &CompartmentId)| self.seats.get(*id) == Some(&Seat { core, slot: slot as u16 });
        let has_format = |synapse: &Synapse| usize::from(synapse.format) < class.formats.len();
        if image.axons_out.len() != slots || image.ids.len() != slots {
            return Some("a table has not one entry for each compartment");
        }
        if self.mesh.number(image.site).is_none() {
            return Some("it is placed outside the mesh");
        }
        if !image.ids.iter().enumerate().all(seat) {
            return Some("a compartment does not sit where its core says");
        }
        if first && !class.inputs.lists.items().iter().all(has_format) {
            return Some("a synapse has no format");
        }
        if first && !class.inputs.is_closed(slots) {
            return Some("a synapse leads to no compartment, or an input axon and a list do not find each other");
        }
        if let Some(what) = first.then(|| class.sums_not_closed()).flatten() {
            return Some(what);
        }
        let reach = image.axons_out.items().all(|target| marks.mark(target));
        (!reach).then_some("an output axon leads nowhere or shares its input axon")
    }
}

/// The error of a dangling table entry.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct NotClosed(pub String);

/// A closed image for each core.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(try_from = "Parts")]
pub struct Program {
    parts: Parts,
}

impl TryFrom<Parts> for Program {
    type Error = NotClosed;

    fn try_from(parts: Parts) -> Result<Self, NotClosed> {
        Program::new(parts)
    }
}

impl Serialize for Program {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.parts.serialize(serializer)
    }
}

impl Program {
    /// A program from its parts.
    ///
    /// # Errors
    /// [`NotClosed`] when a message, a synapse, a seat or a site is dangling, or two sources
    /// share an axon.
    pub fn new(parts: Parts) -> Result<Self, NotClosed> {
        let wrong = |core: CoreId, what: &str| Err(NotClosed(format!("{core}: {what}")));
        if !parts.mesh.is_countable() {
            return Err(NotClosed("the mesh has no cores, or more than can be numbered".to_string()));
        }
        if let Some((core, _)) = parts.cores.enumerate().find(|(_, image)| parts.classes.get(image.class).is_none()) {
            return wrong(core, "its class does not exist");
        }
        let firsts = parts.first_cores();
        if let Some((class, _)) = firsts.enumerate().find(|(_, first)| first.is_none()) {
            return Err(NotClosed(format!("no core is of {class}")));
        }
        if let Some(core) = parts.cores.ids().find(|&core| !parts.class_of(core).inputs.has_lists()) {
            return wrong(core, "it has more discrete input axons than lists");
        }
        let marks = AxonMarks::new(&parts);
        let core = |marks: &AxonMarks, core| {
            let core = CoreId::new(core);
            let first = firsts[parts.cores[core].class] == Some(core);
            parts.not_closed(core, first, marks).map(|what| (core, what))
        };
        if (0..parts.cores.len()).into_par_iter().any(|index| core(&marks, index).is_some()) {
            // Of two that share an input axon the second is reported, for any order of threads.
            let marks = AxonMarks::new(&parts);
            if let Some((core, what)) = (0..parts.cores.len()).find_map(|index| core(&marks, index)) {
                return wrong(core, what);
            }
        }
        if !parts.channels.items().par_iter().all(|&target| marks.mark(target)) {
            return Err(NotClosed("an input channel leads nowhere or shares its input axon".to_string()));
        }
        if let Some(core) = parts.cores.ids().find(|&core| !marks.all_marked(core)) {
            return wrong(core, "an input axon is reached by no source");
        }
        let seated: usize = parts.cores.iter().map(|image| image.ids.len()).sum();
        if seated != parts.seats.len() {
            return Err(NotClosed("a compartment has no seat".to_string()));
        }
        let ends = parts.graded.iter().map(|graded| graded.sources.end);
        let begins = parts.graded.iter().map(|graded| graded.sources.start);
        let sources = (parts.channels.len() + parts.seats.len()) as u32;
        if std::iter::once(0).chain(ends).zip(begins.chain([sources])).any(|(end, begin)| begin < end) {
            return Err(NotClosed("a payload has no source, or a source has two".to_string()));
        }
        if parts.assignment.as_ref().is_some_and(|assignment| !assignment.is_of(parts.cores.len())) {
            return Err(NotClosed("a core is not assigned to a rank".to_string()));
        }
        if parts.populations.get(parts.output).copied().flatten().is_none() {
            return Err(NotClosed("the output is not a population of compartments".to_string()));
        }
        Ok(Program { parts })
    }

    /// The parts.
    pub fn parts(&self) -> &Parts {
        &self.parts
    }

    /// The parts, to be changed and checked again, as tests of mutated programs do.
    #[must_use]
    pub fn into_parts(self) -> Parts {
        self.parts
    }

    /// Whether this process stores the tables of a core.
    pub fn is_local(&self, core: CoreId) -> bool {
        self.parts.assignment.as_ref().is_none_or(|assignment| assignment.is_local(core))
    }

    /// The rank whose part of a program this is; `None` for a whole program.
    pub fn local_rank(&self) -> Option<u32> {
        self.parts.assignment.as_ref().and_then(|assignment| assignment.held)
    }

    /// The part of a distributed program for one rank: the tables of its cores and the messages to
    /// them. Every rank has all other data, such as the seats of compartments.
    ///
    /// # Errors
    /// [`NotClosed`] when the program is not distributed, or is a part already.
    pub fn part(&self, rank: u32) -> Result<Program, NotClosed> {
        let whole = &self.parts;
        let assignment = whole.assignment.as_ref().filter(|assignment| assignment.held.is_none());
        let assignment = RankAssignment {
            held: Some(rank),
            ..assignment
                .cloned()
                .ok_or_else(|| NotClosed("the program is not distributed, or is a part".to_string()))?
        };
        let mut channels = Csr::default();
        for list in whole.channels.iter() {
            channels.push(list.iter().copied().filter(|target| assignment.is_local(target.core)));
        }
        channels.shrink_to_fit();
        // A class becomes two: one of local cores, with tables, and one of cores of other ranks.
        let mut classes = IdVec::new();
        let mut known: HashMap<(ClassId, bool), ClassId> = HashMap::new();
        let image = |(core, image): (CoreId, &CoreImage)| {
            let is_local = assignment.is_local(core);
            let class = *known.entry((image.class, is_local)).or_insert_with(|| {
                let class = &whole.classes[image.class];
                classes.push(if is_local {
                    class.clone()
                } else {
                    CoreClass::without_tables(class.compartments.clone())
                })
            });
            let axons_out = image.axons_out.filtered(|core| assignment.is_local(core));
            CoreImage { site: image.site, class, ids: image.ids.clone(), axons_out }
        };
        let cores: Vec<CoreImage> = whole.cores.enumerate().map(image).collect();
        Program::new(Parts {
            classes,
            cores: cores.into(),
            channels,
            seats: whole.seats.clone(),
            populations: whole.populations.clone(),
            graded: whole.graded.clone(),
            learning: whole.learning.clone(),
            assignment: Some(assignment),
            ..*whole
        })
    }

    /// The cores.
    pub fn cores(&self) -> &IdVec<CoreId, CoreImage> {
        &self.parts.cores
    }

    /// The classes of cores.
    pub fn classes(&self) -> &IdVec<ClassId, CoreClass> {
        &self.parts.classes
    }

    /// The class of a core.
    #[inline]
    pub fn class_of(&self, core: CoreId) -> &CoreClass {
        self.parts.class_of(core)
    }

    /// The first core of each class.
    pub fn first_cores(&self) -> IdVec<ClassId, CoreId> {
        self.parts.first_cores().iter().copied().flatten().collect()
    }

    /// Number of synapses of some cores; one that several sources share counts once for each.
    pub fn synapses_of(&self, cores: impl Fn(CoreId) -> bool) -> u64 {
        let of_classes: IdVec<ClassId, u64> = self.classes().iter().map(|class| class.inputs.count()).collect();
        self.cores().enumerate().filter(|(core, _)| cores(*core)).map(|(_, image)| of_classes[image.class]).sum()
    }

    /// The seat of each compartment of the network.
    pub fn seats(&self) -> &IdVec<CompartmentId, Seat> {
        &self.parts.seats
    }

    /// Messages of a channel's spike.
    pub fn channel(&self, channel: ChannelId) -> &[AxonTarget] {
        self.parts.channels.get(channel.index())
    }

    /// Messages of a source's spike. Sources are numbered channels first, then compartments.
    #[inline]
    pub fn messages(&self, source: u32) -> Messages<'_> {
        match source.checked_sub(self.channels()) {
            None => Messages::Channel(self.channel(ChannelId(source)).iter()),
            Some(compartment) => {
                let seat = self.parts.seats[CompartmentId(compartment)];
                self.parts.cores[seat.core].axons_out.get(usize::from(seat.slot))
            }
        }
    }

    /// The mesh that sites are on.
    pub fn mesh(&self) -> &Mesh {
        &self.parts.mesh
    }

    /// The output compartments, and the score that decides.
    ///
    /// # Panics
    /// Never: the constructor has checked it.
    pub fn output(&self) -> Output {
        let output = self.parts.populations[self.parts.output].expect("checked by the constructor");
        let Parts { decision, output_start: start_step, .. } = self.parts;
        Output { first: output.first, count: output.count, decision, start_step }
    }

    /// Number of compartments.
    pub fn compartments(&self) -> u32 {
        self.parts.seats.len() as u32
    }

    /// Number of input channels.
    pub fn channels(&self) -> u32 {
        self.parts.channels.len() as u32
    }
}
