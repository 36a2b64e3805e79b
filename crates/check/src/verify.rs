//! Rules for a finished program, checked on its own tables.
//!
//! Input: a [`Program`] and a target. Output: nothing, or the first [`Violation`]. The check uses
//! nothing from the compiler's stages: every count is recomputed from the tables that the machine
//! reads. `Program::new` has checked that tables are closed. Beyond that, for every core (each
//! bullet is a variant of [`Violation`]):
//!
//! - the mesh is the target's (`Mesh`), and no two cores have one site (`Site`);
//! - an output axon table names each destination core once, in ascending order (`Multicast`);
//! - a list is selected exactly if it is not empty (`EmptyAxon`);
//! - population axons have atoms, bases and numbers that messages and tables can hold, tables are
//!   equal or disjoint, no two sources are one atom of an axon, and a source is one atom on all
//!   cores (`Population`);
//! - neurons are of kinds that the chip has (`Kind`), and no message is wider than the chip's
//!   (`Message`);
//! - a compartment pops exactly if the compartment before it pushes (`Neuron`);
//! - formats are distinct, each is used, and its fields can be stored: a rule that the program has,
//!   weights not of 7 bits, the core's index and delay widths or none (`Format`);
//! - in a list the synapses of one format are consecutive, and two groups do not differ in density
//!   or delay alone (`Scattered`);
//! - the slots of a dense group are consecutive; the slots of a sparse group ascend and fit its
//!   index, and a group with runs skips no more slots than a run holds (`Slots`);
//! - a group with delay bits has a delay, and each delay fits (`Delay`);
//! - weights are multiples of their format's least step, in its range (`Weight`);
//! - every resource of [`CoreUsage`] is within its limit (`Excess`).
//!
//! The tables of a class are checked once, for its first core.
//!
//! Words that depend on the network are not counted here but in [`crate::memory`].
//!
//! [`crate::equivalence`] compares the program's synapses with the network's.

use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

use rayon::prelude::*;

use nsim_ir::base::fixed::Delay;
use nsim_ir::base::id::{ClassId, CompartmentId, CoreId, Id, IdVec};
use nsim_ir::hardware::{Chip, Target};
use nsim_ir::neurons::Stack;
use nsim_ir::partition::{CoreUsage, Partition};
use nsim_ir::placement::Mesh;
use nsim_ir::program::{
    AxonTarget, Compartments, CoreClass, CoreFormat, CoreImage, Graded, InputAxon, InputTable, Messages,
    PopulationAxon, Program, Synapse,
};
use nsim_ir::quantised::Neuron;
use nsim_ir::resource::{Capacity, Limits, OutputAxons, PerResource, Resource};

use crate::words::{Layout, RUNS, bits_of_tag, delay_slots, has_all_delays, of_rules};

/// Bases of pop16 axons are multiples of this, and all bases are below the end (nengo-loihi e564f66
/// `hardware/builder.py`).
const BASE_STEP: u16 = 4;
const BASE_END: u16 = 256;
/// Total bits of an axon's number and its atom, where every population axon is pop16.
const NUMBER_AND_ATOM: u32 = 15;
/// Minimum and maximum bits of an atom.
const ATOM_BITS: (u32, u32) = (5, 9);

/// A rule that is broken.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Violation {
    /// The program is for another board.
    #[error("the mesh of the program differs from the target's")]
    Mesh,
    /// Two cores have one site; the later of them.
    #[error("{0} has the same place as another core")]
    Site(CoreId),
    /// Messages of a source do not name each core once, in ascending order.
    #[error("{0} does not name each destination core once, in ascending order")]
    Multicast(String),
    /// A list of a core that is selected without synapses, or has synapses but is not selected.
    #[error("{0}: list {1} is selected without synapses, or has synapses but is not selected")]
    EmptyAxon(CoreId, usize),
    /// Population axons, of a core or a source, that the hardware does not have.
    #[error("{0}: {1}")]
    Population(String, &'static str),
    /// Neurons of a kind that the chip does not have.
    #[error("{core} has {kind} neurons, which the chip does not have")]
    Kind {
        /// The core.
        core: CoreId,
        /// The kind.
        kind: &'static str,
    },
    /// A refractory period that the chip's compartments do not count.
    #[error("{core} has a refractory period of {period} steps, but the chip has at most {limit}")]
    Refractory {
        /// The core.
        core: CoreId,
        /// The period.
        period: u8,
        /// The chip's longest.
        limit: u8,
    },
    /// Integers that the chip's messages cannot carry.
    #[error("source {source_number} sends integers of {bits} bits, but messages of the chip carry {limit}")]
    Message {
        /// The first of the sources.
        source_number: u32,
        /// Bits of its message.
        bits: u32,
        /// Bits of a message of the chip.
        limit: u32,
    },
    /// A compartment without its child or its parent.
    #[error("{core}: slot {slot} pushes or pops, but has no compartment next to it")]
    Neuron {
        /// The core.
        core: CoreId,
        /// The slot.
        slot: usize,
    },
    /// A format that cannot be stored, is not used, or is duplicated.
    #[error("{core}: synapse format {format} {what}")]
    Format {
        /// The core.
        core: CoreId,
        /// The format's number.
        format: usize,
        /// The error.
        what: &'static str,
    },
    /// Synapses of one format that are not consecutive.
    #[error("{core}: the synapses of one format are not consecutive in list {list}")]
    Scattered {
        /// The core.
        core: CoreId,
        /// The list.
        list: usize,
    },
    /// A list of a core with slots that do not suit their format.
    #[error("{0}: list {1}: the slots of a group do not suit its format")]
    Slots(CoreId, usize),
    /// A list of a core with delays that do not suit their format.
    #[error("{0}: list {1}: the delays of a group do not suit its format")]
    Delay(CoreId, usize),
    /// A list of a core with a weight that its format does not have.
    #[error("{0}: list {1}: weight {2} is not in its format")]
    Weight(CoreId, usize, i16),
    /// Use of a resource or a pool beyond its limit.
    #[error("{core} uses {need} {}, the limit is {limit}", capacity.name())]
    Excess {
        /// The core.
        core: CoreId,
        /// The resource or pool.
        capacity: Capacity,
        /// Amount in use.
        need: u64,
        /// The limit.
        limit: u64,
    },
}

/// Checks every rule.
///
/// # Errors
/// The first [`Violation`], by core.
pub fn verify(program: &Program, target: &Target) -> Result<(), Violation> {
    used(program, target).map(drop)
}

/// Checks every rule; returns the usage of each core.
///
/// # Errors
/// The first [`Violation`], by core.
pub fn used(program: &Program, target: &Target) -> Result<IdVec<CoreId, CoreUsage>, Violation> {
    let (limits, chip) = (target.limits(), target.chip());
    if *program.mesh() != Mesh::for_target(target) {
        return Err(Violation::Mesh);
    }
    let mut taken = BTreeSet::new();
    if let Some(core) = program.cores().ids().find(|&core| !taken.insert(program.cores()[core].site)) {
        return Err(Violation::Site(core));
    }
    let limit = chip.message_bits;
    let sends = |graded: &&Graded| graded.sources.clone().any(|source| program.messages(source).next().is_some());
    let mut wide = program.parts().graded.iter().filter(|graded| graded.message.bits() > limit);
    if let Some(wide) = wide.find(sends) {
        return Err(Violation::Message { source_number: wide.sources.start, bits: wide.message.bits(), limit });
    }
    let populations = program.classes().iter().any(|class| !class.inputs.populations.is_empty());
    for channel in 0..program.channels() {
        let name = || format!("input channel {channel}");
        verify_messages(program, program.messages(channel), populations, name)?;
    }
    let firsts = program.first_cores();
    let of_core = |&core| {
        verify_neurons(program, core, chip)?;
        verify_tables(program, core, limits)
    };
    let tables = firsts.as_slice().par_iter().map(of_core);
    let tables: IdVec<ClassId, Result<CoreUsage, Violation>> = tables.collect::<Vec<_>>().into();
    let (groups, firsts) = equal_senders(program);
    let sent: Vec<_> = firsts.par_iter().map(|&core| verify_sent(program, core, populations, limits)).collect();
    // Threads may finish in any order; the violation of the lowest core is reported.
    let mut all = IdVec::new();
    for ((core, image), group) in program.cores().enumerate().zip(groups) {
        let mut usage = tables[image.class].clone()?;
        (usage[Resource::AxonsOut], usage[Resource::AxonsOutPerCompartment]) = sent[group].clone()?;
        if let Some((capacity, need, limit)) = usage.excesses(limits).next() {
            return Err(Violation::Excess { core, capacity, need, limit });
        }
        all.push(usage);
    }
    Ok(all)
}

/// Groups of cores with equal lists of messages, to cores of equal classes, equally on or off their
/// chip: the group of each core, and the first core of each group.
fn equal_senders(program: &Program) -> (Vec<usize>, Vec<CoreId>) {
    let (mut known, mut firsts) = (HashMap::<_, Vec<usize>>::new(), Vec::new());
    let group = |(core, image): (CoreId, &CoreImage)| {
        let (reached, lists) = (image.axons_out.cores(), image.axons_out.lists());
        let there = |&to: &CoreId| (program.cores()[to].class, program.cores()[to].site.chip == image.site.chip);
        let alone = (!reached.is_sorted_by(|a, b| a < b)).then_some(core);
        // Few lists that differ have these axons in common, so few are compared as a whole.
        let messages = lists.items();
        let sample: Vec<u16> = messages.iter().step_by(messages.len() / 4 + 1).map(|to| to.axon).collect();
        let key = (messages.len(), sample, reached.iter().map(there).collect::<Vec<_>>(), alone);
        let similar = known.entry(key).or_default();
        let is_equal = |first: &CoreId| {
            let other = program.cores()[*first].axons_out.lists();
            Arc::ptr_eq(other, lists) || other == lists
        };
        similar.iter().copied().find(|&group| is_equal(&firsts[group])).unwrap_or_else(|| {
            firsts.push(core);
            similar.push(firsts.len() - 1);
            firsts.len() - 1
        })
    };
    let groups = program.cores().enumerate().map(group).collect();
    (groups, firsts)
}

/// Checks that cores use exactly the counted synapses, and no more than counted of any resource. By
/// position (`OutputAxons::PerPosition`), fewer output axons may be used than geometry predicts.
///
/// # Errors
/// A message about the first core that differs.
pub fn confirm(partition: &Partition, used: &IdVec<CoreId, CoreUsage>) -> Result<(), String> {
    // Words that both count from the same compartments are equal.
    let is_exact = |resource: Resource| match resource {
        Resource::NeuronWords | Resource::AxonMapWords | Resource::Groups => true,
        Resource::AxonsIn | Resource::SynapseWords => partition.limits().counts_kernels(),
        _ => false,
    };
    fn is_held(counted: u64, used: u64, exact: bool) -> bool {
        used == counted || used < counted && !exact
    }
    let holds = |(counted, used): (&CoreUsage, &CoreUsage)| {
        counted.synapses == used.synapses
            && Resource::ALL.into_iter().all(|one| is_held(counted[one], used[one], is_exact(one)))
    };
    if partition.usage().len() != used.len() {
        return Err(format!("{} cores were counted, but the program has {}", partition.usage().len(), used.len()));
    }
    let pairs = || partition.usage().iter().zip(used);
    match pairs().position(|pair| !holds(pair)) {
        Some(core) => {
            let core = CoreId::new(core);
            Err(format!("{core}: counted usage is {:?}, actual usage is {:?}", partition.usage()[core], used[core]))
        }
        None => Ok(()),
    }
}

fn verify_neurons(program: &Program, core: CoreId, chip: &Chip) -> Result<(), Violation> {
    for neuron in program.class_of(core).compartments.iter().map(|compartment| compartment.neuron) {
        if !chip.neuron_kinds.contains(&neuron.kind.family()) {
            return Err(Violation::Kind { core, kind: neuron.kind.name() });
        }
        let (period, limit) = (neuron.refractory.get(), chip.refractory);
        if period > limit {
            return Err(Violation::Refractory { core, period, limit });
        }
    }
    Ok(())
}

fn verify_messages(
    program: &Program,
    messages: Messages<'_>,
    populations: bool,
    name: impl Fn() -> String,
) -> Result<(), Violation> {
    if !messages.clone().is_sorted_by(|a, b| a.core < b.core) {
        return Err(Violation::Multicast(name()));
    }
    if !populations {
        return Ok(());
    }
    let atom = |message: AxonTarget| match program.class_of(message.core).inputs.axon(message.axon.into()) {
        InputAxon::Member { atom, .. } => Some(atom),
        InputAxon::Discrete { .. } => None,
    };
    let mut atoms = messages.filter_map(atom);
    match atoms.next() {
        Some(first) if atoms.any(|atom| atom != first) => {
            Err(Violation::Population(name(), "its atom differs between cores"))
        }
        _ => Ok(()),
    }
}

/// Whether a population axon is a pop32 axon: more atoms than a pop16 axon has, or a base that it
/// cannot have.
fn is_long(axon: &PopulationAxon, limits: &Limits) -> bool {
    match limits.output_axons {
        OutputAxons::PerCompartment => false,
        OutputAxons::PerPosition { atoms, .. } => axon.atoms > atoms || !axon.base.is_multiple_of(BASE_STEP),
    }
}

/// Checks population axons; returns whether each list belongs to a table.
fn verify_populations(core: CoreId, inputs: &InputTable, limits: &Limits) -> Result<Vec<bool>, Violation> {
    let wrong = |what| Err(Violation::Population(core.to_string(), what));
    let (axons, mut in_table) = (&inputs.populations, vec![false; inputs.lists.len()]);
    if axons.is_empty() {
        return Ok(in_table);
    }
    let mut tables: Vec<(u32, u16)> = axons.iter().map(|axon| (axon.table, axon.atoms)).collect();
    tables.sort_unstable();
    tables.dedup();
    if tables.windows(2).any(|pair| pair[0].0 + u32::from(pair[0].1) > pair[1].0) {
        return wrong("two tables of population axons overlap");
    }
    let atoms = tables.iter().map(|table| table.1).max().unwrap_or(0);
    if u32::from(atoms) > 1 << ATOM_BITS.1 {
        return wrong("a population axon has more atoms than a message can number");
    }
    let short = axons.iter().filter(|axon| !is_long(axon, limits)).count() as u64;
    let (most_short, most) = match limits.output_axons {
        OutputAxons::PerCompartment => {
            let bits = (ATOM_BITS.0..ATOM_BITS.1).find(|&bits| u32::from(atoms) <= 1 << bits).unwrap_or(ATOM_BITS.1);
            (1 << (NUMBER_AND_ATOM - bits), u64::MAX)
        }
        OutputAxons::PerPosition { .. } => (1 << 10, 1 << 12),
    };
    if short > most_short || axons.len() as u64 > most {
        return wrong("there are more population axons than a message can number next to their atoms");
    }
    if axons.iter().any(|axon| !is_long(axon, limits) && !axon.base.is_multiple_of(BASE_STEP) || axon.base >= BASE_END)
    {
        return wrong("a population axon has a base that cannot be stored");
    }
    for &(table, atoms) in &tables {
        in_table[table as usize..table as usize + usize::from(atoms)].fill(true);
    }
    let members = inputs.axons.iter().filter_map(|axon| match *axon {
        InputAxon::Member { axon, atom } => Some((axon, atom)),
        InputAxon::Discrete { .. } => None,
    });
    let mut members: Vec<(u16, u16)> = members.collect();
    members.sort_unstable();
    if members.windows(2).any(|pair| pair[0] == pair[1]) {
        return wrong("two sources are the same atom of a population axon");
    }
    // A population axon has non-empty lists for exactly its members.
    let mut members = members.into_iter();
    for (number, axon) in axons.iter().enumerate() {
        for atom in 0..axon.atoms {
            let list = axon.table as usize + usize::from(atom);
            let selected = !inputs.lists.get(list).is_empty();
            if selected && members.next() != Some((number as u16, atom)) {
                return Err(Violation::EmptyAxon(core, list));
            }
        }
    }
    match members.next() {
        Some((axon, atom)) => {
            let list = axons[usize::from(axon)].table as usize + usize::from(atom);
            Err(Violation::EmptyAxon(core, list))
        }
        None => Ok(in_table),
    }
}

/// Returns the words of a core's lists, and of its longest list. A table takes its longest list
/// times its number of lists.
fn words_of(inputs: &InputTable, of_lists: &[u32], in_table: &[bool]) -> (u64, u32) {
    let widest = of_lists.iter().copied().max().unwrap_or(0);
    let discrete = of_lists.iter().zip(in_table).filter(|(_, shared)| !**shared).map(|(words, _)| u64::from(*words));
    let tables: BTreeSet<(u32, u16)> = inputs.populations.iter().map(|axon| (axon.table, axon.atoms)).collect();
    let of_table = |(table, atoms): (u32, u16)| {
        let lists = &of_lists[table as usize..table as usize + usize::from(atoms)];
        u64::from(atoms) * u64::from(lists.iter().copied().max().unwrap_or(0))
    };
    (discrete.sum::<u64>() + tables.into_iter().map(of_table).sum::<u64>(), widest)
}

/// Checks messages; returns a core's output axon slots and the most messages of a compartment.
fn verify_sent(program: &Program, core: CoreId, populations: bool, limits: &Limits) -> Result<(u64, u64), Violation> {
    let image = &program.cores()[core];
    for (slot, messages) in image.axons_out.iter().enumerate() {
        verify_messages(program, messages, populations, || format!("compartment {} of {core}", image.ids[slot]))?;
    }
    let most = image.axons_out.iter().map(|list| list.len() as u64).max().unwrap_or(0);
    Ok((output_slots(program, image, populations, limits), most))
}

/// Output axon slots of a core, from the messages of its compartments. By position, compartments
/// share one list if all their messages go to equal population axons.
fn output_slots(program: &Program, image: &CoreImage, populations: bool, limits: &Limits) -> u64 {
    let by_position = match limits.output_axons {
        OutputAxons::PerPosition { more_slots, .. } if populations => Some(more_slots),
        OutputAxons::PerPosition { .. } | OutputAxons::PerCompartment => None,
    };
    let population = |message: AxonTarget| match program.class_of(message.core).inputs.axon(message.axon.into()) {
        InputAxon::Member { axon, .. } => Some(axon),
        InputAxon::Discrete { .. } => None,
    };
    let slots = |message: AxonTarget| {
        let (target, tables) = (&program.cores()[message.core], &program.class_of(message.core).inputs);
        let on_chip = target.site.chip == image.site.chip;
        let plain = if on_chip { limits.axon_out_slots } else { limits.axon_out_slots_off_chip };
        // Tables of other cores are read only where this matters.
        let axon = by_position.and_then(|more| Some((more, population(message)?)));
        let is_long = |axon: u16| is_long(&tables.populations[usize::from(axon)], limits);
        plain + axon.filter(|&(_, axon)| is_long(axon)).map_or(0, |(more, _)| more)
    };
    let (mut sum, mut shared) = (0, BTreeSet::new());
    for messages in image.axons_out.iter() {
        let of_populations = messages.clone().map(|message| Some((message.core, population(message)?)));
        let list: Option<Vec<(CoreId, u16)>> = by_position.and_then(|_| of_populations.collect());
        if list.is_none_or(|list| shared.insert(list)) {
            sum += messages.map(|message| u64::from(slots(message))).sum::<u64>();
        }
    }
    sum
}

/// Checks the rules for a core's own tables; returns their usage, without output axons.
///
/// # Errors
/// The first [`Violation`].
fn verify_tables(program: &Program, core: CoreId, limits: &Limits) -> Result<CoreUsage, Violation> {
    let class = program.class_of(core);
    let mut stacks = vec![Stack::UNUSED];
    stacks.extend(class.compartments.iter().map(|compartment| compartment.neuron.stack));
    stacks.push(Stack::UNUSED);
    if let Some(slot) = stacks.windows(2).position(|pair| pair[0].pushes != pair[1].pops.is_some()) {
        return Err(Violation::Neuron { core, slot });
    }
    let in_table = verify_populations(core, &class.inputs, limits)?;
    let rules = &program.parts().learning.rules;
    let moves: Vec<bool> = class.formats.iter().map(|format| has_all_delays(rules, format.synapse)).collect();
    let delay = |s: &Synapse| if moves[usize::from(s.format)] { Delay::MAX } else { s.delay };
    let longest = class.inputs.lists.items().iter().map(delay).max().unwrap_or(Delay::MIN);
    let layout = Layout::of_core(class.compartments.len() as u32, longest, limits);
    verify_formats(core, class, layout, rules.len())?;
    let mut of_lists = Vec::with_capacity(class.inputs.lists.len());
    let (mut used, mut kinds) = (vec![false; class.formats.len()], Vec::new());
    for (list, synapses) in class.inputs.lists.iter().enumerate() {
        if synapses.is_empty() && !in_table[list] {
            return Err(Violation::EmptyAxon(core, list));
        }
        let mut list_words = 0;
        kinds.clear();
        for group in synapses.chunk_by(|a, b| a.format == b.format) {
            let format = class.formats[usize::from(group[0].format)];
            used[usize::from(group[0].format)] = true;
            if kinds.contains(&format.synapse) {
                return Err(Violation::Scattered { core, list });
            }
            kinds.push(format.synapse);
            verify_group(core, list, group, format, moves[usize::from(group[0].format)])?;
            list_words += layout.words(format, bits_of_tag(rules, format.synapse), group.len() as u32, in_table[list]);
        }
        of_lists.push(list_words);
    }
    if let Some(format) = used.iter().position(|&used| !used) {
        return Err(Violation::Format { core, format, what: "is not used" });
    }
    let stored = if limits.is_limited(Resource::StoredSynapses) { stored_synapses(program, core) } else { 0 };
    let (words, widest) = words_of(&class.inputs, &of_lists, &in_table);
    let (microcode, traces) = of_rules(rules, &class.formats);
    let usage = usage_of(class, longest, words, widest).with(Resource::StoredSynapses, stored);
    let usage = usage.with(Resource::RuleWords, microcode).with(Resource::TraceConfigurations, traces);
    Ok(if limits.counts_kernels() { usage.with(Resource::AxonsIn, 0).with(Resource::SynapseWords, 0) } else { usage })
}

/// Number of synapses that a core stores where the compartments of a channel share their weights. A
/// weight other than 0, with its format and delay, counts as often as in the compartment that has
/// it most often. It is exact for populations of one position, and for convolutions if a
/// compartment on the core has the whole kernel; otherwise a lower bound.
fn stored_synapses(program: &Program, core: CoreId) -> u64 {
    let (image, class) = (&program.cores()[core], program.class_of(core));
    let populations: Vec<&Compartments> = program.parts().populations.iter().flatten().collect();
    let channel = |id: &CompartmentId| {
        let of = populations.iter().find(|of| id.0.wrapping_sub(of.first.0) < of.count);
        of.map_or(id.0, |of| id.0 - (id.0 - of.first.0) % of.positions)
    };
    let channels: Vec<u32> = image.ids.iter().map(channel).collect();
    let format = |at: u8| class.formats.iter().position(|f| f.synapse == class.formats[usize::from(at)].synapse);
    let formats: Vec<Option<usize>> = (0..class.formats.len()).map(|at| format(at as u8)).collect();
    let stored = class.inputs.synapses().filter(|synapse| synapse.weight != 0);
    let key = |s: Synapse| (channels[usize::from(s.slot)], formats[usize::from(s.format)], s.delay, s.weight, s.slot);
    let mut weights: Vec<_> = stored.map(key).collect();
    weights.sort_unstable();
    let of_slots = weights.chunk_by(|a, b| (a.0, a.1, a.2, a.3) == (b.0, b.1, b.2, b.3));
    let most = of_slots.map(|weight| weight.chunk_by(|a, b| a.4 == b.4).map(<[_]>::len).max().unwrap_or(0) as u64);
    most.sum()
}

fn verify_formats(core: CoreId, class: &CoreClass, layout: Layout, rules: usize) -> Result<(), Violation> {
    let mut distinct = BTreeSet::new();
    for (number, format) in class.formats.iter().enumerate() {
        let wrong = |what| Err(Violation::Format { core, format: number, what });
        if !distinct.insert(format) {
            return wrong("is duplicated");
        }
        if format.synapse.rule.is_some_and(|rule| rule.index() >= rules) {
            return wrong("names a rule that the program does not have");
        }
        if format.synapse.bits.get() == 7 {
            return wrong("has weights of 7 bits");
        }
        if format.delay_bits != 0 && format.delay_bits != layout.delay {
            return wrong("has delays of a different width than its core");
        }
        if format.index_bits.is_some_and(|bits| bits != layout.index) {
            return wrong("has indices of a different width than its core");
        }
        if format.skip_bits.is_some_and(|bits| format.index_bits.is_none() || !RUNS.contains(&bits)) {
            return wrong("has runs of an unsupported width");
        }
    }
    Ok(())
}

fn verify_group(
    core: CoreId,
    list: usize,
    group: &[Synapse],
    format: CoreFormat,
    moves: bool,
) -> Result<(), Violation> {
    let in_order = match format.index_bits {
        None => group.windows(2).all(|pair| u32::from(pair[1].slot) == u32::from(pair[0].slot) + 1),
        Some(bits) => {
            group.windows(2).all(|pair| pair[0].slot <= pair[1].slot)
                && group.iter().all(|s| u32::from(s.slot) < 1 << bits)
        }
    };
    // A run holds the number of skipped slots, so no slot occurs twice and no gap is wider than a
    // run can hold.
    let holds = |bits: u8| {
        group.windows(2).all(|pair| {
            u32::from(pair[1].slot).checked_sub(u32::from(pair[0].slot) + 1).is_some_and(|gap| gap < 1 << bits)
        })
    };
    if !in_order || !format.skip_bits.is_none_or(holds) {
        return Err(Violation::Slots(core, list));
    }
    let longest = if moves { Delay::MAX } else { group.iter().map(|s| s.delay).max().unwrap_or(Delay::MIN) }.get();
    if (longest > 0) != (format.delay_bits > 0) || u32::from(longest) >= 1 << format.delay_bits {
        return Err(Violation::Delay(core, list));
    }
    let (low, high) = format.synapse.sign.range(format.synapse.bits);
    let step = format.synapse.sign.step(format.synapse.bits);
    match group.iter().find(|s| !(low..=high).contains(&s.weight) || s.weight % step != 0) {
        Some(synapse) => Err(Violation::Weight(core, list, synapse.weight)),
        None => Ok(()),
    }
}

fn usage_of(class: &CoreClass, longest: Delay, words: u64, widest: u32) -> CoreUsage {
    let compartments = class.compartments.len() as u32;
    let profiles = |neuron: &Neuron| (neuron.profile(), neuron.threshold());
    let distinct = class.compartments.iter().map(|c| profiles(&c.neuron));
    let (profiles, thresholds): (BTreeSet<_>, BTreeSet<_>) = distinct.unzip();
    let lists = class.inputs.lists.iter();
    // Traces of a source take a second entry.
    let learns =
        |synapses: &&[Synapse]| synapses.iter().any(|s| class.formats[usize::from(s.format)].synapse.rule.is_some());
    let learning = lists.filter(learns).count();
    let axons_in = (class.inputs.populations.len() + class.inputs.iter_discrete().count() + learning) as u64;
    let of = |resource| match resource {
        Resource::Compartments => u64::from(compartments),
        Resource::AxonsIn => axons_in,
        // These depend on the chips of other cores.
        Resource::AxonsOut | Resource::AxonsOutPerCompartment => 0,
        Resource::SynapseWords => words,
        Resource::SynapseWordsPerAxon => u64::from(widest),
        Resource::SynapseFormats => class.formats.len() as u64,
        Resource::CompartmentProfiles => profiles.len() as u64,
        Resource::ThresholdProfiles => thresholds.len() as u64,
        Resource::Accumulators => u64::from(compartments) * u64::from(delay_slots(longest)),
        // These depend on the populations of the compartments.
        Resource::StoredSynapses | Resource::NeuronWords | Resource::AxonMapWords | Resource::Groups => 0,
        // Of these the caller counts.
        Resource::RuleWords | Resource::TraceConfigurations => 0,
    };
    CoreUsage { synapses: class.inputs.count(), of: PerResource::from_fn(of) }
}
