//! From seats and sites to the tables of a program.
//!
//! Input: a network, its partition and placement. Output: a [`Program`]. Each source sends one
//! message to each core that holds a target of it, its own core included. There a separate input
//! axon selects the list of its synapses, which is part of a table where
//! [`nsim_partition::resources::axon_sharing`] decides so. Input axons of a core are numbered by
//! source: channels in order, then compartments in order. A list is sorted by format, then slot,
//! delay and weight; formats are numbered as they first appear. Widths come from
//! [`nsim_partition::resources::packing`].
//!
//! Cores are written in parallel, from their own synapses alone. Then each core's input axons are
//! sorted by the cores that send to them. Cores with equal messages to other cores share them.

use std::sync::Arc;

use foldhash::HashMap;
use rayon::prelude::*;

use crate::emit::classes::{Classes, CoreClasses, Shift};
use crate::emit::tables::Tables;
use nsim_ir::base::csr::Csr;
use nsim_ir::base::id::{ClassId, CompartmentId, CoreId, Id, IdVec};
use nsim_ir::messages::{AxonTarget, AxonsOut, IndexedTarget};
use nsim_ir::partition::{Partition, Seat};
use nsim_ir::placement::Placement;
use nsim_ir::program::{Compartments, CoreClass, CoreImage, Graded, Parts, Program, ProgramLearning};
use nsim_ir::quantised::{Population, Quantised};
use nsim_ir::ranks::RankAssignment;
use nsim_ir::resource::Limits;
use nsim_ir::spikes::Message;

/// Returns the program of a network, of `copies` equal copies that share nothing, on its places.
/// Tables of equal cores are written once. Of a program distributed over ranks, only the part held
/// is written.
///
/// # Errors
/// A sentence when the tables contradict each other or a core has more formats than can be
/// numbered: an internal error, because limits of earlier stages exclude it.
pub fn route(
    network: &Quantised,
    partition: &Partition,
    places: (&Placement, Option<RankAssignment>),
    copies: u32,
    limits: &Limits,
) -> Result<Program, String> {
    let holds = |core: CoreId| places.1.as_ref().is_none_or(|assignment| assignment.is_local(core));
    let classes = CoreClasses::new(network, partition, copies, holds);
    route_classes(network, partition, places.0, places.1, &classes, limits)
}

/// The program of [`route`], with cores in these classes.
pub(crate) fn route_classes(
    network: &Quantised,
    partition: &Partition,
    placement: &Placement,
    assignment: Option<RankAssignment>,
    by_class: &CoreClasses<'_>,
    limits: &Limits,
) -> Result<Program, String> {
    if partition.cores() != placement.len() {
        return Err("the partition and the placement have different numbers of cores".to_string());
    }
    let (channels, classes) = (network.channels(), &by_class.classes);
    let holds = |core: CoreId| assignment.as_ref().is_none_or(|assignment| assignment.is_local(core));
    let written = Tables::new(network, partition, limits).of_classes(by_class, holds)?;
    let (written, of_first): (Vec<CoreClass>, Vec<Vec<u32>>) = written.into_iter().unzip();
    let all: Vec<CoreId> = partition.members().ids().collect();
    let sources = |core: CoreId| shifted(&of_first[classes.of[core].index()], by_class.shifts(core));
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
        learning: ProgramLearning::in_network(network),
        assignment,
    })
    .map_err(|error| error.to_string())
}

/// Ascending sources, each shifted by the distance of its range.
fn shifted(sources: &[u32], shifts: Vec<Shift>) -> impl Iterator<Item = u32> {
    let mut shifts = shifts.into_iter().peekable();
    sources.iter().map(move |&source| {
        while shifts.next_if(|(_, end, _)| *end <= source).is_some() {}
        shifts.peek().map_or(source, |(_, _, by)| (i64::from(source) + by) as u32)
    })
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

/// Number of parts of the senders for each thread.
const PARTS: usize = 8;

/// Messages that a core receives.
struct Incoming {
    /// Cores that send them, ascending.
    senders: Vec<CoreId>,
    /// The first core of its class with equal messages from as many senders.
    first_equal: CoreId,
    /// The messages, which all these cores share.
    received: Arc<Received>,
}

/// Messages to a core from each of its senders: slots there and input axons here.
#[derive(Default, PartialEq, Eq, Hash)]
struct Received {
    /// Index of the first message of each sender, and the end.
    firsts: Vec<u32>,
    /// Slot in the upper half, axon in the lower; ascending.
    messages: Vec<u32>,
}

impl Received {
    /// The senders of a core, ascending, and its messages from them, from seats of sources and
    /// axons; `keys` is scratch memory.
    fn by_sender(messages: impl Iterator<Item = (Seat, u16)>, keys: &mut Vec<u64>) -> (Vec<CoreId>, Self) {
        keys.clear();
        keys.extend(
            messages.map(|(seat, axon)| u64::from(seat.core.0) << 32 | u64::from(seat.slot) << 16 | u64::from(axon)),
        );
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
    }
}

/// The messages that each core receives.
fn received<M: Iterator<Item = (Seat, u16)>>(
    classes: &Classes,
    messages: impl Fn(CoreId) -> M + Sync,
) -> IdVec<CoreId, Incoming> {
    let mut members: IdVec<ClassId, Vec<CoreId>> = vec![Vec::new(); classes.firsts.len()].into();
    classes.of.enumerate().for_each(|(core, &class)| members[class].push(core));
    let of_class = |cores: &Vec<CoreId>| {
        let (mut keys, mut known) = (Vec::new(), HashMap::<Arc<Received>, CoreId>::default());
        let mut all = Vec::with_capacity(cores.len());
        for &core in cores {
            let (senders, received) = Received::by_sender(messages(core), &mut keys);
            let equal = known.get_key_value(&received).map(|(received, &first)| (received.clone(), first));
            let (received, first_equal) = equal.unwrap_or_else(|| (Arc::new(received), core));
            if cores.len() > 1 {
                known.entry(received.clone()).or_insert(core);
            }
            all.push((core, Incoming { senders, first_equal, received }));
        }
        all
    };
    let mut all: Vec<_> = members.as_slice().par_iter().flat_map_iter(of_class).collect();
    all.sort_unstable_by_key(|(core, _)| *core);
    all.into_iter().map(|(_, incoming)| incoming).collect()
}

/// The messages of each core, from the messages that all cores receive.
///
/// # Errors
/// A core that sends to more cores than can be numbered.
fn axons_out(partition: &Partition, incoming: &IdVec<CoreId, Incoming>) -> Result<Vec<AxonsOut>, CoreId> {
    let mut sent: IdVec<CoreId, Vec<(CoreId, u32)>> = vec![Vec::new(); partition.cores()].into();
    for (to, of_core) in incoming.enumerate() {
        (0..).zip(&of_core.senders).for_each(|(number, &from)| sent[from].push((to, number)));
    }
    let from = |&(to, number): &(CoreId, u32)| (incoming[to].first_equal, number);
    let slots = |core: CoreId| partition.members()[core].len();
    let key = |(core, sent): (CoreId, &Vec<(CoreId, u32)>)| (slots(core), sent.iter().map(from).collect::<Vec<_>>());
    if let Some((core, _)) = sent.enumerate().find(|(_, sent)| sent.len() > 1 << 16) {
        return Err(core);
    }
    let sender_classes = Classes::by_key(sent.enumerate().map(key));
    // Each task reads the messages of consecutive senders, core by core: they are contiguous.
    let lists = |firsts: &[CoreId]| {
        let mut messages: Vec<Vec<(u16, IndexedTarget)>> = vec![Vec::new(); firsts.len()];
        let mut reached = vec![0u32; firsts.len()];
        for Incoming { senders, received, .. } in incoming {
            let begin = senders.partition_point(|sender| *sender < firsts[0]);
            let those = (begin..).zip(&senders[begin..]).take_while(|(_, sender)| Some(*sender) <= firsts.last());
            for (number, sender) in those {
                let Ok(place) = firsts.binary_search(sender) else { continue };
                let part = received.firsts[number] as usize..received.firsts[number + 1] as usize;
                let core = reached[place] as u16;
                messages[place].extend(received.messages[part].iter().map(|&message| {
                    ((message >> 16) as u16, IndexedTarget { core_index: core, axon: message as u16 })
                }));
                reached[place] += 1;
            }
        }
        let by_slot = |(&core, messages): (&CoreId, Vec<(u16, IndexedTarget)>)| {
            let put_all = |put: &mut dyn FnMut(usize, IndexedTarget)| {
                messages.iter().for_each(|&(slot, reached)| put(slot.into(), reached));
            };
            Arc::new(Csr::by_row(slots(core), put_all))
        };
        firsts.iter().zip(messages).map(by_slot).collect::<Vec<_>>()
    };
    let some = sender_classes.firsts.len().div_ceil(PARTS * rayon::current_num_threads()).max(1);
    let lists = sender_classes.firsts.as_slice().par_chunks(some).flat_map_iter(lists);
    let lists: IdVec<ClassId, Arc<Csr<IndexedTarget>>> = lists.collect::<Vec<_>>().into();
    let of_core = |(core, sent): (CoreId, &Vec<(CoreId, u32)>)| {
        let cores: Vec<CoreId> = sent.iter().map(|(to, _)| *to).collect();
        AxonsOut::new(cores, lists[sender_classes.of[core]].clone()).map_err(|_| core)
    };
    sent.enumerate().map(of_core).collect()
}
