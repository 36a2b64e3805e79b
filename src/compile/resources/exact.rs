//! What each core of a given membership uses of each resource, exactly.
//!
//! In come a network, the compartments of each core in slot order and the chip of each core; out goes a [`CoreUsage`] each.
//! It counts what [`crate::compile::emit::route`] will write:
//!
//! - input axons: distinct sources with a synapse on the core, the members of a population axon as one ([`crate::compile::resources::axon_sharing`]);
//! - output axons: one for each compartment and destination core; it takes `axon_out_slots` slots when the destination is
//!   on the same chip (the own core included), `axon_out_slots_off_chip` otherwise;
//! - words: as [`crate::compile::resources::packing`] counts them, without runs or with them ([`Tallies`]), a table of population axons
//!   once; formats: distinct (synapse format, delayed or not, compression), because widths are the same for all groups of a
//!   core;
//! - compartment profiles: distinct (du, dv, refractory period); threshold profiles: distinct mantissas;
//! - accumulators: compartments times [`packing::delay_slots`] of the longest delay of a synapse into the core.
//!
//! Whether any of it is too much is not asked here.

use std::collections::BTreeSet;

use crate::base::fixed::Delay;
use crate::base::id::{CompartmentId, CoreId, Id, IdVec};
use crate::compile::resources::axon_sharing::{self, Alike, Class, Places};
use crate::compile::resources::by_core::{self, Key};
use crate::compile::resources::fan_out::{self, Sent};
use crate::compile::resources::formats::Formats;
use crate::compile::resources::packing::{self, Compression, Group, Widths};
use crate::desc::resource::{Limits, PerResource, Resource};
use crate::ir::partition::{CoreUsage, Seat};
use crate::ir::quantised::{Neuron, Quantised, Units};

/// A compartment's share of the profile tables: (du, dv, refractory period), threshold mantissa.
#[must_use]
pub fn profiles(neuron: &Neuron) -> ((u16, u16, u8), u32) {
    ((neuron.du.get(), neuron.dv.get(), neuron.refractory.get()), neuron.vth.get())
}

/// The longest delay of a synapse into each core.
#[must_use]
pub fn longest_delays(network: &Quantised, seats: &IdVec<CompartmentId, Seat>, cores: usize) -> IdVec<CoreId, Delay> {
    let mut longest: IdVec<CoreId, Delay> = vec![Delay::MIN; cores].into();
    for projection in network.projections().iter().filter(|p| p.delay > Delay::MIN) {
        let Some(first) = network.populations()[projection.target].first_compartment() else { continue };
        for source in 0..network.populations()[projection.source].shape.len() {
            projection.connectivity.for_each_from(source, |target, _| {
                let core = seats[CompartmentId(first.0 + target)].core;
                longest[core] = longest[core].max(projection.delay);
            });
        }
    }
    longest
}

/// The use of each core.
///
/// # Panics
/// When `seats` and `members` differ or `chips` is shorter than `members`: a mistake of the caller.
#[must_use]
pub fn usage(
    network: &Quantised,
    members: &IdVec<CoreId, Vec<CompartmentId>>,
    seats: &IdVec<CompartmentId, Seat>,
    chips: &IdVec<CoreId, u32>,
    limits: &Limits,
) -> IdVec<CoreId, CoreUsage> {
    let core_of = seats.iter().map(|seat| seat.core).collect();
    usage_sending(network, members, seats, &fan_out::sent(network, &core_of, chips, limits), limits)
}

/// The use of each core, where it is known what compartments send.
///
/// # Panics
/// As [`usage`].
#[must_use]
pub fn usage_sending(
    network: &Quantised,
    members: &IdVec<CoreId, Vec<CompartmentId>>,
    seats: &IdVec<CompartmentId, Seat>,
    sent: &Sent,
    limits: &Limits,
) -> IdVec<CoreId, CoreUsage> {
    let longest = longest_delays(network, seats, members.len());
    let (formats, places) = (Formats::of(network), Places::of(network));
    let counted = by_core::by_core(network, &formats, seats, members.len(), |core, keys| {
        let compartments = members[core].len() as u32;
        let widths = Widths::of(compartments, longest[core], limits.packing);
        let tallies = Tallies::of(keys, &formats, widths, limits, &places);
        tallies.usage(compartments, keys.len() as u64, longest[core], limits)
    });
    let mut usage: IdVec<CoreId, CoreUsage> = counted.into();
    count_profiles(network, seats, &mut usage);
    for (used, held) in usage.iter_mut().zip(members) {
        used[Resource::AxonsOut] = fan_out::slots_of(held, sent);
        used[Resource::AxonsOutPerCompartment] = held.iter().map(|id| sent.axons[id.index()]).max().unwrap_or(0).into();
    }
    usage
}

/// What lists take in one way of storing them.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Tally {
    /// Input axons.
    pub axons: u32,
    /// Words of all lists.
    pub words: u64,
    /// The most words of a list.
    pub widest: u32,
    /// Formats in use.
    pub formats: BTreeSet<(u16, bool, Compression)>,
}

impl Tally {
    fn lists(&mut self, lists: u64, words: u32) {
        self.axons = self.axons.saturating_add(u32::try_from(lists).unwrap_or(u32::MAX));
        self.words += lists * u64::from(words);
        self.widest = self.widest.max(words);
    }

    /// Stores the tables of these classes instead of a list for each of their sources.
    fn share(&mut self, classes: &[Class], limits: &Limits) -> Vec<u32> {
        let sharing = axon_sharing::sharing(classes, limits);
        (self.words, self.axons) = axon_sharing::left(self.words, self.axons, classes, &sharing);
        let tables = classes.iter().zip(&sharing).filter(|(_, places)| **places > 0);
        self.widest = tables.map(|(class, _)| class.list_words.1).fold(self.widest, u32::max);
        sharing
    }
}

/// A core's lists without and with runs.
#[derive(Debug, Clone, Default)]
pub struct Tallies {
    /// Without runs, with runs.
    ways: [Tally; 2],
    /// Places whose lists are the same.
    alike: Vec<Alike>,
    /// How many places of each class share its table, without runs and with runs.
    sharing: [Vec<u32>; 2],
}

impl Tallies {
    /// Of the synapses of a core.
    #[must_use]
    pub fn of(keys: &[Key], formats: &Formats, widths: Widths, limits: &Limits, places: &Places) -> Self {
        let mut tallies = Tallies::default();
        // Neighbours mostly are made up alike.
        let mut last: Option<((u16, Group), [Words; 2])> = None;
        // Words of each list, of a discrete axon and in a table.
        let mut of_lists: Vec<[Words; 2]> = Vec::new();
        for list in by_core::lists(keys) {
            let mut of_list = [Words::default(); 2];
            for group in by_core::groups(list) {
                let made = group_of(group, formats);
                let words = match last {
                    Some((same, words)) if same == made => words,
                    _ => {
                        let words = tallies.group(made, widths, limits);
                        last = Some((made, words));
                        words
                    }
                };
                for (of_list, words) in of_list.iter_mut().zip(words) {
                    of_list.discrete += words.discrete;
                    of_list.in_table += words.in_table;
                }
            }
            for (tally, words) in tallies.ways.iter_mut().zip(of_list) {
                tally.lists(1, words.discrete);
            }
            if !places.is_empty() {
                of_lists.push(of_list);
            }
        }
        if !places.is_empty() {
            tallies.alike = axon_sharing::alike(keys, places);
            for (way, tally) in tallies.ways.iter_mut().enumerate() {
                let class = |alike: &Alike| {
                    let lists = alike.places.first().map_or(&[][..], |(_, lists)| lists);
                    let words = || lists.iter().map(|&(_, number)| of_lists[number as usize][way]);
                    Class {
                        places: alike.places.len() as u32,
                        lists: lists.len() as u32,
                        atoms: lists.last().map_or(0, |(atom, _)| atom + 1),
                        words: words().map(|words| words.discrete).sum(),
                        list_words: words()
                            .map(|words| words.in_table)
                            .fold((u32::MAX, 0), |(least, most), words| (least.min(words), most.max(words))),
                    }
                };
                let classes: Vec<Class> = tallies.alike.iter().map(class).collect();
                tallies.sharing[way] = tally.share(&classes, limits);
            }
        }
        tallies
    }

    /// Notes the format of a group; returns what the group takes without and with runs.
    fn group(&mut self, (format, group): (u16, Group), widths: Widths, limits: &Limits) -> [Words; 2] {
        let ways = ways_of(group, widths, limits);
        for (way, (compression, _)) in self.ways.iter_mut().zip(ways) {
            way.formats.insert((format, group.delayed, compression));
        }
        ways.map(|(compression, discrete)| Words {
            discrete,
            in_table: packing::words_in_table(group, compression, widths, limits),
        })
    }

    /// Counts so many lists of one such group each; returns what one of them takes without and with runs.
    pub fn lists(&mut self, format: u16, group: Group, lists: u64, widths: Widths, limits: &Limits) -> [Words; 2] {
        let of_list = self.group((format, group), widths, limits);
        for (way, words) in self.ways.iter_mut().zip(of_list) {
            way.lists(lists, words.discrete);
        }
        of_list
    }

    /// Stores tables for these classes of the lists counted so far, given without and with runs.
    pub fn share(&mut self, classes: [&[Class]; 2], limits: &Limits) {
        for (way, classes) in classes.into_iter().enumerate() {
            self.sharing[way] = self.ways[way].share(classes, limits);
        }
    }

    /// Whether the core stores runs: where that takes fewer words and its formats suffice.
    #[must_use]
    pub fn runs(&self, limits: &Limits) -> bool {
        let [plain, with_runs] = &self.ways;
        with_runs.words < plain.words && with_runs.formats.len() as u64 <= u64::from(limits[Resource::SynapseFormats])
    }

    /// The way of storing that is taken.
    #[must_use]
    pub fn stored(&self, limits: &Limits) -> &Tally {
        &self.ways[usize::from(self.runs(limits))]
    }

    /// Classes of places, and how many places of each share its table in the way of storing that is taken.
    pub fn shared(&self, limits: &Limits) -> impl Iterator<Item = (&Alike, u32)> {
        self.alike.iter().zip(self.sharing[usize::from(self.runs(limits))].iter().copied())
    }

    /// What a core with these lists uses, output axons and profiles left out.
    #[must_use]
    pub fn usage(&self, compartments: u32, synapses: u64, longest: Delay, limits: &Limits) -> CoreUsage {
        let stored = self.stored(limits);
        let of = |resource| match resource {
            Resource::Compartments => u64::from(compartments),
            Resource::AxonsIn => u64::from(stored.axons),
            Resource::SynapseWords => stored.words,
            Resource::SynapseWordsPerAxon => u64::from(stored.widest),
            Resource::SynapseFormats => stored.formats.len() as u64,
            Resource::Accumulators => u64::from(compartments) * u64::from(packing::delay_slots(longest)),
            Resource::AxonsOut
            | Resource::AxonsOutPerCompartment
            | Resource::CompartmentProfiles
            | Resource::ThresholdProfiles => 0,
        };
        CoreUsage { synapses, of: PerResource::from_fn(of) }
    }
}

/// Words of a list.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Words {
    /// As the list of a discrete axon.
    pub discrete: u32,
    /// In the table of a population axon.
    pub in_table: u32,
}

/// How a group of a discrete axon is stored without runs and with runs, and in how many words.
#[inline]
#[must_use]
pub fn ways_of(group: Group, widths: Widths, limits: &Limits) -> [(Compression, u32); 2] {
    let compression = if group.dense { Compression::Dense } else { Compression::Sparse };
    let plain = (compression, packing::words(group, widths, limits));
    if group.dense { [plain; 2] } else { [plain, packing::best(group, widths, limits)] }
}

/// The fewest bits of runs over these distances between slots.
#[must_use]
pub fn skip_of(mut distances: impl Iterator<Item = u16>) -> Option<u8> {
    let widest = distances.try_fold(0, |widest: u16, distance| Some(widest.max(distance.checked_sub(1)?)))?;
    packing::skip_bits(widest)
}

/// The make-up of a group, and its format.
#[must_use]
pub fn group_of(group: &[Key], formats: &Formats) -> (u16, Group) {
    let format = group[0].format();
    let made = Group {
        weight_bits: formats.get(format).bits,
        synapses: group.len() as u32,
        delayed: group.iter().any(|key| key.delay() > 0),
        dense: group.windows(2).all(|pair| pair[1].slot() == pair[0].slot() + 1),
        skip: skip_of(group.windows(2).map(|pair| pair[1].slot() - pair[0].slot())),
    };
    (format, made)
}

fn count_profiles(network: &Quantised, seats: &IdVec<CompartmentId, Seat>, usage: &mut IdVec<CoreId, CoreUsage>) {
    let mut pairs: Vec<(CoreId, (u16, u16, u8))> = Vec::new();
    let mut thresholds: Vec<(CoreId, u32)> = Vec::new();
    for population in network.populations() {
        let Units::Compartments { first, neurons, .. } = &population.units else { continue };
        for index in 0..population.shape.len() {
            let core = seats[CompartmentId(first.0 + index)].core;
            let (profile, threshold) = profiles(&neurons.get(index));
            // Neighbours mostly agree; keeping one of them keeps the lists short.
            if pairs.last() != Some(&(core, profile)) {
                pairs.push((core, profile));
            }
            if thresholds.last() != Some(&(core, threshold)) {
                thresholds.push((core, threshold));
            }
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    thresholds.sort_unstable();
    thresholds.dedup();
    pairs.iter().for_each(|(core, _)| usage[*core][Resource::CompartmentProfiles] += 1);
    thresholds.iter().for_each(|(core, _)| usage[*core][Resource::ThresholdProfiles] += 1);
}
