//! From seats and sites to tables: the program.
//!
//! Input: a network, its partition and placement. Output: a [`Program`]. Each source sends one
//! message to each core that holds a target of it, the own core included; there an input axon of
//! its own leads to the list of its synapses, which is one of a table where
//! [`nsim_partition::resources::axon_sharing`] says so. Input axons of a core are numbered by
//! source: channels in order, then compartments in order. A list is sorted by format, then slot,
//! delay and weight; formats are numbered as they first appear. Widths are those of
//! [`nsim_partition::resources::packing`].
//!
//! Cores are written down in parallel, from their own synapses alone. Then each core's input axons
//! are sorted by the cores that send to them. Cores that send the same to other cores share what
//! they send.

use std::collections::HashSet;
use std::sync::Arc;

use rayon::prelude::*;

use crate::emit::classes::Classes;
use nsim_ir::base::csr::Csr;
use nsim_ir::base::fixed::Delay;
use nsim_ir::base::id::{ClassId, CompartmentId, CoreId, Id, IdVec, PopulationId};
use nsim_ir::dealt::Dealt;
use nsim_ir::messages::{AxonTarget, AxonsOut, Reached};
use nsim_ir::partition::{Partition, Seat};
use nsim_ir::placement::Placement;
use nsim_ir::program::{
    Compartment, Compartments, CoreClass, CoreFormat, CoreImage, Graded, InputAxon, Parts, PopulationAxon, Program,
    Stored, Synapse,
};
use nsim_ir::quantised::{Population, Quantised, Units};
use nsim_ir::resource::Limits;
use nsim_ir::spikes::Message;
use nsim_partition::resources::axon_sharing::{EqualPlace, Places};
use nsim_partition::resources::by_core::{self, Key};
use nsim_partition::resources::exact::{StoredLists, group_of, longest_delays};
use nsim_partition::resources::formats::Formats;
use nsim_partition::resources::packing::{Compression, Group, Widths, stored};

/// The program of a network, this many equal copies that share nothing, on its places. What equal
/// cores store is written once. Of a program that is dealt out and held in part,
/// only what is held is written.
///
/// # Errors
/// A sentence when the tables contradict each other or a core has more formats than can be
/// numbered: a fault of the stages before, whose limits exclude it.
pub fn route(
    network: &Quantised,
    partition: &Partition,
    (placement, dealt): (&Placement, Option<Dealt>),
    copies: u32,
    limits: &Limits,
) -> Result<Program, String> {
    let tables = Tables::new(network, partition, limits);
    let (channels, compartments) = (network.channels(), network.compartments());
    let of_copy = |units: usize| (units as u32 / copies.max(1)).max(1);
    let copy_size = of_copy(compartments as usize);
    let holds = |core: CoreId| dealt.as_ref().is_none_or(|dealt| dealt.holds(core));
    // Copies are equal and share nothing. So cores with the same compartments, of other copies, are
    // of one class, and their sources are as many copies apart. A rank writes the classes that it
    // holds.
    let members = |core: CoreId| &partition.members()[core];
    let copy_of = |core: CoreId| members(core).iter().map(|id| id.0 / copy_size).min().unwrap_or(0);
    let key = |core: CoreId| {
        let first = copy_of(core) * copy_size;
        (holds(core), members(core).iter().map(|id| id.0 - first).collect::<Vec<u32>>())
    };
    let classes = Classes::by_key(partition.members().ids().map(key));
    // The copies that the first cores of classes hold.
    let mut written_down = vec![false; copies as usize];
    for &core in classes.firsts.iter().filter(|core| holds(**core)) {
        members(core).iter().for_each(|id| written_down[(id.0 / copy_size) as usize] = true);
    }
    let populations = of_copy(network.populations().len());
    let counts = |id: PopulationId| written_down.get((id.0 / populations) as usize).copied().unwrap_or(true);
    let (seats, cores) = (partition.seats(), partition.cores());
    let longest = longest_delays(network, seats, cores, counts);
    let written = by_core::by_core(network, &tables.formats, seats, cores, (counts, holds), |core, keys| {
        (classes.first(core) == core).then(|| match holds(core) {
            true => tables.class(core, keys, longest[core]),
            false => Ok((CoreClass::without_tables(parameters(network, members(core))), Vec::new())),
        })
    });
    let written: Vec<(CoreClass, Vec<u32>)> = written.into_iter().flatten().collect::<Result<_, String>>()?;
    let shifts = |first: CoreId, core: CoreId| {
        let later = i64::from(copy_of(core)) - i64::from(copy_of(first));
        let by = |units: u32| later * i64::from(of_copy(units as usize));
        vec![(0, channels, by(channels)), (channels, channels + compartments, by(compartments))]
    };
    assemble(network, partition, (placement, dealt), (written, &classes, shifts))
}

/// Sources of these numbers, below the second, and how far they lie from those of another core.
pub(super) type Shift = (u32, u32, i64);

/// Ascending sources, each shifted as those of its range.
fn shifted(sources: &[u32], shifts: Vec<Shift>) -> impl Iterator<Item = u32> {
    let mut shifts = shifts.into_iter().peekable();
    sources.iter().map(move |&source| {
        while shifts.next_if(|(_, end, _)| *end <= source).is_some() {}
        shifts.peek().map_or(source, |(_, _, by)| (i64::from(source) + by) as u32)
    })
}

/// The program of these classes: of each its tables and the sources of its first core's input
/// axons; and how far those of another core lie from them.
///
/// # Errors
/// As [`route`].
pub(super) fn assemble(
    network: &Quantised,
    partition: &Partition,
    (placement, dealt): (&Placement, Option<Dealt>),
    (written, classes, shifts): (Vec<(CoreClass, Vec<u32>)>, &Classes, impl Fn(CoreId, CoreId) -> Vec<Shift> + Sync),
) -> Result<Program, String> {
    if partition.cores() != placement.len() {
        return Err("the partition and the placement have different numbers of cores".to_string());
    }
    let channels = network.channels();
    let (written, of_first): (Vec<CoreClass>, Vec<Vec<u32>>) = written.into_iter().unzip();
    let all: Vec<CoreId> = partition.members().ids().collect();
    let sources = |core: CoreId| shifted(&of_first[classes.of[core].index()], shifts(classes.first(core), core));
    let axons = |core: CoreId| (0..=u16::MAX).zip(sources(core));
    let of_channels = Csr::by_row(channels as usize, |put| {
        for &core in &all {
            let messages = axons(core).take_while(|(_, source)| *source < channels);
            messages.for_each(|(axon, source)| put(source as usize, AxonTarget { core, axon }));
        }
    });
    let seats = partition.seats();
    let received = received(classes, |core| {
        let of_compartments = axons(core).skip_while(move |(_, source)| *source < channels);
        of_compartments.map(move |(axon, source)| (seats[CompartmentId(source - channels)], axon))
    });
    drop(of_first);
    let axons_out = axons_out(partition, &received).map_err(|core| format!("{core} sends to too many cores"))?;
    drop(received);
    let image = |(&core, axons_out): (&CoreId, AxonsOut)| {
        let (site, class, ids) = (placement.site(core), classes.of[core], partition.members()[core].clone());
        CoreImage { site, class, ids, axons_out }
    };
    let cores: Vec<CoreImage> = all.iter().zip(axons_out).map(image).collect();
    let populations = network.populations().iter().map(Compartments::in_population).collect();
    let parts = network.parts();
    Program::new(Parts {
        mesh: *placement.mesh(),
        classes: written.into(),
        cores: cores.into(),
        channels: of_channels,
        seats: partition.seats().clone(),
        populations,
        graded: graded(network),
        output: parts.output,
        decision: parts.decision,
        output_start: network.output().start_step,
        semantics: parts.semantics,
        threshold: parts.threshold,
        reset: parts.reset,
        dealt,
    })
    .map_err(|error| error.to_string())
}

/// The populations of graded spikes, channels first.
fn graded(network: &Quantised) -> Vec<Graded> {
    let of = |population: &Population| {
        let first = network.first_source(population);
        let message = Some(population.message).filter(|message| *message != Message::Spike)?;
        Some(Graded { sources: first..first + population.shape.len(), message })
    };
    let mut graded: Vec<Graded> = network.populations().iter().filter_map(of).collect();
    graded.sort_unstable_by_key(|graded| graded.sources.start);
    graded
}

/// What the tables of every core are written from.
pub(super) struct Tables<'a> {
    network: &'a Quantised,
    partition: &'a Partition,
    limits: &'a Limits,
    pub(super) formats: Formats,
    places: Places,
}

impl<'a> Tables<'a> {
    pub(super) fn new(network: &'a Quantised, partition: &'a Partition, limits: &'a Limits) -> Self {
        let (formats, places) = (Formats::for_network(network), Places::for_network(network, limits));
        Tables { network, partition, limits, formats, places }
    }

    /// What a core with these synapses stores, and the source of each input axon.
    pub(super) fn class(&self, core: CoreId, keys: &[Key], longest: Delay) -> Result<(CoreClass, Vec<u32>), String> {
        let held = &self.partition.members()[core];
        let widths = Widths::for_core(held.len() as u32, longest, self.limits.packing);
        let lists = StoredLists::new(keys, &self.formats, widths, self.limits, &self.places);
        let (formats, inputs, sources) = write_lists(keys, &self.formats, widths, &lists, self.limits)
            .ok_or_else(|| format!("{core} has too many input axons or synapse formats"))?;
        Ok((CoreClass { compartments: parameters(self.network, held), formats, inputs }, sources))
    }
}

/// Parameters of compartments in slot order.
pub(super) fn parameters(network: &Quantised, held: &[CompartmentId]) -> Vec<Compartment> {
    let mut known = None;
    held.iter()
        .filter_map(|&id| {
            // Neighbours mostly are of one population.
            let inside = |population: &PopulationId| {
                let population = &network.populations()[*population];
                population
                    .first_compartment()
                    .is_some_and(|first| id.0.checked_sub(first.0).is_some_and(|index| index < population.shape.len()))
            };
            let population = known.filter(inside).unwrap_or_else(|| network.population_of(id).0);
            known = Some(population);
            let Units::Compartments { first, neurons, start_step } = &network.populations()[population].units else {
                return None;
            };
            Some(Compartment { neuron: neurons.get(id.0 - first.0), start_step: *start_step })
        })
        .collect()
}

/// The formats of a core, its input axons with their lists, and the source of each input axon.
type Written = (Vec<CoreFormat>, Stored, Vec<u32>);

/// Writes the lists of a core's image.
struct Writer<'a> {
    formats: &'a Formats,
    widths: Widths,
    limits: &'a Limits,
    runs: bool,
    known: Vec<CoreFormat>,
    /// The last group's make-up and the number of its format.
    last: Option<((u16, Group), u8)>,
    lists: Csr<Synapse>,
}

impl Writer<'_> {
    /// The number of the format of a group of this make-up, a new one where the core has none.
    fn number(&mut self, (format, made): (u16, Group)) -> Option<u8> {
        if let Some((_, number)) = self.last.filter(|(last, _)| *last == (format, made)) {
            return Some(number);
        }
        let [_, (compression, _)] = stored(made, self.widths, self.limits);
        let stored = CoreFormat {
            synapse: self.formats.get(format),
            delay_bits: if made.delayed { self.widths.delay } else { 0 },
            index_bits: (!made.dense).then_some(self.widths.index),
            skip_bits: match compression {
                Compression::RunLength(bits) if self.runs => Some(bits),
                _ => None,
            },
        };
        let number = self.known.iter().position(|&known| known == stored).unwrap_or_else(|| {
            self.known.push(stored);
            self.known.len() - 1
        });
        let number = u8::try_from(number).ok()?;
        self.last = Some(((format, made), number));
        Some(number)
    }

    /// Writes a list, its slots counted from a base.
    fn list(&mut self, list: &[Key], base: u16) -> Option<()> {
        for group in by_core::groups(list) {
            let number = self.number(group_of(group, self.formats))?;
            for key in group {
                let delay = Delay::new(key.delay().into()).ok()?;
                let synapse = Synapse { slot: key.slot() - base, weight: key.weight(), format: number, delay };
                self.lists.extend_last([synapse]);
            }
        }
        self.lists.end();
        Some(())
    }
}

/// What a core keeps of its synapses; `None` when it has more input axons or formats than can be
/// numbered.
fn write_lists(
    keys: &[Key],
    formats: &Formats,
    widths: Widths,
    stored: &StoredLists,
    limits: &Limits,
) -> Option<Written> {
    let (runs, lists) = (stored.stores_runs(limits), Csr::with_capacity(0, keys.len()));
    let mut writer = Writer { formats, widths, limits, runs, known: Vec::new(), last: None, lists };
    let shared: Vec<_> = stored.shared(limits).filter(|&(_, places)| places > 0).collect();
    let sources: Vec<u32> = by_core::lists(keys).map(|list| list[0].source()).collect();
    u16::try_from(sources.len().saturating_sub(1)).ok()?;
    if shared.is_empty() {
        by_core::lists(keys).try_for_each(|list| writer.list(list, 0))?;
        writer.lists.shrink_to_fit();
        return Some((writer.known, Stored::discrete(writer.lists), sources));
    }
    let all: Vec<&[Key]> = by_core::lists(keys).collect();
    let (mut populations, mut members) = (Vec::new(), vec![None; all.len()]);
    for (alike, places) in shared {
        let (first, table) = (&alike[0], writer.lists.len() as u32);
        let atoms = first.atoms();
        let mut of_atoms = first.lists.iter().peekable();
        for atom in 0..atoms {
            match of_atoms.next_if(|(of, _)| *of == atom) {
                Some((_, number)) => writer.list(all[*number as usize], first.base)?,
                None => writer.lists.end(),
            }
        }
        for EqualPlace { base, lists, .. } in &alike[..places as usize] {
            let axon = u16::try_from(populations.len()).ok()?;
            populations.push(PopulationAxon { table, atoms, base: *base });
            lists.iter().for_each(|&(atom, number)| members[number as usize] = Some(InputAxon::Member { axon, atom }));
        }
    }
    let mut axons = Vec::with_capacity(all.len());
    for (list, member) in all.into_iter().zip(members) {
        axons.push(member.unwrap_or(InputAxon::Discrete { list: writer.lists.len() as u32 }));
        if member.is_none() {
            writer.list(list, 0)?;
        }
    }
    writer.lists.shrink_to_fit();
    Some((writer.known, Stored::with_populations(writer.lists, populations, axons), sources))
}

/// Parts of the senders that each thread takes one after the other.
const PARTS: usize = 8;

/// What a core receives from each of its senders: slots there and input axons here.
#[derive(Default, PartialEq, Eq, Hash)]
struct Received {
    /// Where what each sender sends begins, and where the last ends.
    firsts: Vec<u32>,
    /// The slot in the upper half, the axon in the lower; ascending.
    messages: Vec<u32>,
}

/// For each core its senders, ascending, and what it receives from them. Cores of a class that
/// receive the same of as many senders share it.
fn received<M: Iterator<Item = (Seat, u16)>>(
    classes: &Classes,
    messages: impl Fn(CoreId) -> M + Sync,
) -> IdVec<CoreId, (Vec<CoreId>, Arc<Received>)> {
    let mut members: IdVec<ClassId, Vec<CoreId>> = vec![Vec::new(); classes.firsts.len()].into();
    classes.of.enumerate().for_each(|(core, &class)| members[class].push(core));
    let of_core = |keys: &mut Vec<u64>, core: CoreId| {
        let key =
            |(seat, axon): (Seat, u16)| u64::from(seat.core.0) << 32 | u64::from(seat.slot) << 16 | u64::from(axon);
        keys.clear();
        keys.extend(messages(core).map(key));
        if !keys.is_sorted() {
            keys.sort_unstable();
        }
        let (mut senders, mut received) = (Vec::new(), Received::default());
        for (at, &key) in (0..).zip(&*keys) {
            let sender = CoreId((key >> 32) as u32);
            if senders.last() != Some(&sender) {
                senders.push(sender);
                received.firsts.push(at);
            }
            received.messages.push(key as u32);
        }
        received.firsts.push(keys.len() as u32);
        (senders, received)
    };
    let of_class = |cores: &Vec<CoreId>| {
        let (mut keys, mut known) = (Vec::new(), HashSet::<Arc<Received>>::new());
        let one = |&core: &CoreId| {
            let (senders, received) = of_core(&mut keys, core);
            let same = known.get(&received).cloned();
            let same = same.unwrap_or_else(|| Arc::new(received));
            if cores.len() > 1 {
                known.insert(same.clone());
            }
            (core, (senders, same))
        };
        cores.iter().map(one).collect::<Vec<_>>()
    };
    let mut all: Vec<_> = members.as_slice().par_iter().flat_map_iter(of_class).collect();
    all.sort_unstable_by_key(|(core, _)| *core);
    all.into_iter().map(|(_, received)| received).collect()
}

/// The messages of each core, from what all receive.
///
/// # Errors
/// A core that sends to more cores than can be numbered.
fn axons_out(
    partition: &Partition,
    received: &IdVec<CoreId, (Vec<CoreId>, Arc<Received>)>,
) -> Result<Vec<AxonsOut>, CoreId> {
    let mut sent: IdVec<CoreId, Vec<(CoreId, u32)>> = vec![Vec::new(); partition.cores()].into();
    for (to, (senders, _)) in received.enumerate() {
        (0..).zip(senders).for_each(|(number, &from)| sent[from].push((to, number)));
    }
    let from = |&(to, number): &(CoreId, u32)| (Arc::as_ptr(&received[to].1), number);
    let slots = |core: CoreId| partition.members()[core].len();
    let key = |(core, sent): (CoreId, &Vec<(CoreId, u32)>)| (slots(core), sent.iter().map(from).collect::<Vec<_>>());
    if let Some((core, _)) = sent.enumerate().find(|(_, sent)| sent.len() > 1 << 16) {
        return Err(core);
    }
    let alike = Classes::by_key(sent.enumerate().map(key));
    // Some senders at a time read what each core receives in turn: their part of it lies together.
    let lists = |firsts: &[CoreId]| {
        let mut messages: Vec<Vec<(u16, Reached)>> = vec![Vec::new(); firsts.len()];
        let mut reached = vec![0u32; firsts.len()];
        for (senders, received) in received {
            let begin = senders.partition_point(|sender| *sender < firsts[0]);
            let those = (begin..).zip(&senders[begin..]).take_while(|(_, sender)| Some(*sender) <= firsts.last());
            for (number, sender) in those {
                let Ok(place) = firsts.binary_search(sender) else { continue };
                let part = received.firsts[number] as usize..received.firsts[number + 1] as usize;
                let core = reached[place] as u16;
                let reached_by = |&message: &u32| ((message >> 16) as u16, Reached { core, axon: message as u16 });
                messages[place].extend(received.messages[part].iter().map(reached_by));
                reached[place] += 1;
            }
        }
        let by_slot = |(&core, messages): (&CoreId, Vec<(u16, Reached)>)| {
            let put_all = |put: &mut dyn FnMut(usize, Reached)| {
                messages.iter().for_each(|&(slot, reached)| put(slot.into(), reached));
            };
            Arc::new(Csr::by_row(slots(core), put_all))
        };
        firsts.iter().zip(messages).map(by_slot).collect::<Vec<_>>()
    };
    let some = alike.firsts.len().div_ceil(PARTS * rayon::current_num_threads()).max(1);
    let lists = alike.firsts.as_slice().par_chunks(some).flat_map_iter(lists);
    let lists: IdVec<ClassId, Arc<Csr<Reached>>> = lists.collect::<Vec<_>>().into();
    let of_core = |(core, sent): (CoreId, &Vec<(CoreId, u32)>)| {
        let cores: Vec<CoreId> = sent.iter().map(|(to, _)| *to).collect();
        AxonsOut::new(cores, lists[alike.of[core]].clone()).map_err(|_| core)
    };
    sent.enumerate().map(of_core).collect()
}
