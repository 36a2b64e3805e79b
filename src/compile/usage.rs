//! What each core of a given membership uses of each resource, exactly.
//!
//! In come a network, the compartments of each core in slot order and the chip of each core; out goes a [`CoreUsage`] each.
//! It counts what [`crate::compile::route`] will write:
//!
//! - input axons: distinct sources with a synapse on the core;
//! - output axons: one for each compartment and destination core; it takes `axon_out_slots` slots when the destination is
//!   on the same chip (the own core included), `axon_out_slots_off_chip` otherwise;
//! - words: as [`crate::compile::packing`] counts them, without runs or with them ([`Tallies`]); formats: distinct (synapse
//!   format, delayed or not, compression), because widths are the same for all groups of a core;
//! - compartment profiles: distinct (du, dv, refractory period); threshold profiles: distinct mantissas;
//! - accumulators: compartments times [`packing::delay_slots`] of the longest delay of a synapse into the core.
//!
//! Whether any of it is too much is not asked here.

use std::collections::BTreeSet;

use crate::base::fixed::Delay;
use crate::base::id::{CompartmentId, CoreId, Id, IdVec};
use crate::compile::formats::Formats;
use crate::compile::gather::{self, Key};
use crate::compile::packing::{self, Compression, Group, Widths};
use crate::compile::sent;
use crate::desc::target::Limits;
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
    let longest = longest_delays(network, seats, members.len());
    let formats = Formats::of(network);
    let counted = gather::by_core(network, &formats, seats, members.len(), |core, keys| {
        of_core(keys, members[core].len() as u32, longest[core], &formats, limits)
    });
    let mut usage: IdVec<CoreId, CoreUsage> = counted.into();
    count_profiles(network, seats, &mut usage);
    let core_of = seats.iter().map(|seat| seat.core).collect();
    let sent = sent::sent(network, &core_of, chips, limits);
    for (used, held) in usage.iter_mut().zip(members) {
        used.axons_out = u32::try_from(sent::slots_of(held, &sent)).unwrap_or(u32::MAX);
        used.axons_out_per_compartment = held.iter().map(|id| sent.axons[id.index()]).max().unwrap_or(0);
    }
    usage
}

/// What a core's synapses use.
fn of_core(keys: &[Key], compartments: u32, longest: Delay, formats: &Formats, limits: &Limits) -> CoreUsage {
    let widths = Widths::of(compartments, longest, limits.packing);
    let tallies = Tallies::of(keys, formats, widths, limits);
    let stored = tallies.stored(limits);
    CoreUsage {
        compartments,
        axons_in: tallies.axons,
        synapses: keys.len() as u64,
        synapse_words: stored.words,
        synapse_words_per_axon: stored.widest,
        synapse_formats: stored.formats.len() as u32,
        accumulators: compartments.saturating_mul(packing::delay_slots(longest)),
        ..CoreUsage::default()
    }
}

/// What lists take in one way of storing them.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Tally {
    /// Words of all lists.
    pub words: u64,
    /// The most words of a list.
    pub widest: u32,
    /// Formats in use.
    pub formats: BTreeSet<(u16, bool, Compression)>,
}

impl Tally {
    fn group(&mut self, kind: (u16, bool, Compression), last: &mut Option<(u16, bool, Compression)>) {
        // Neighbours mostly agree.
        if last.replace(kind) != Some(kind) {
            self.formats.insert(kind);
        }
    }

    fn list(&mut self, words: u32) {
        self.words += u64::from(words);
        self.widest = self.widest.max(words);
    }
}

/// A core's lists without and with runs.
#[derive(Debug, Clone, Default)]
pub struct Tallies {
    /// Input axons.
    pub axons: u32,
    plain: Tally,
    with_runs: Tally,
}

impl Tallies {
    /// Of the synapses of a core.
    #[must_use]
    pub fn of(keys: &[Key], formats: &Formats, widths: Widths, limits: &Limits) -> Self {
        let mut tallies = Tallies::default();
        let (mut last, mut last_of_runs) = (None, None);
        for list in gather::lists(keys) {
            let (mut plain, mut with_runs) = (0, 0);
            for group in gather::groups(list) {
                let (format, group) = group_of(group, formats);
                let words = packing::words(group, widths, limits);
                let compression = if group.dense { Compression::Dense } else { Compression::Sparse };
                tallies.plain.group((format, group.delayed, compression), &mut last);
                let (compression, fewest) = packing::best(group, widths, limits);
                tallies.with_runs.group((format, group.delayed, compression), &mut last_of_runs);
                (plain, with_runs) = (plain + words, with_runs + fewest);
            }
            tallies.axons += 1;
            tallies.plain.list(plain);
            tallies.with_runs.list(with_runs);
        }
        tallies
    }

    /// Counts so many lists of one such group each.
    pub fn lists(&mut self, format: u16, group: Group, lists: u64, widths: Widths, limits: &Limits) {
        let plain = packing::words(group, widths, limits);
        let compression = if group.dense { Compression::Dense } else { Compression::Sparse };
        self.plain.formats.insert((format, group.delayed, compression));
        let (compression, fewest) = packing::best(group, widths, limits);
        self.with_runs.formats.insert((format, group.delayed, compression));
        self.axons = self.axons.saturating_add(u32::try_from(lists).unwrap_or(u32::MAX));
        for (tally, words) in [(&mut self.plain, plain), (&mut self.with_runs, fewest)] {
            tally.words += lists * u64::from(words);
            tally.widest = tally.widest.max(words);
        }
    }

    /// Whether the core stores runs: where that takes fewer words and its formats suffice.
    #[must_use]
    pub fn runs(&self, limits: &Limits) -> bool {
        let Tallies { plain, with_runs, .. } = self;
        with_runs.words < plain.words && with_runs.formats.len() as u64 <= u64::from(limits.synapse_formats)
    }

    /// The way of storing that is taken.
    #[must_use]
    pub fn stored(&self, limits: &Limits) -> &Tally {
        if self.runs(limits) { &self.with_runs } else { &self.plain }
    }
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
        let Units::Loihi { first, neurons, .. } = &population.units else { continue };
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
    pairs.iter().for_each(|(core, _)| usage[*core].compartment_profiles += 1);
    thresholds.iter().for_each(|(core, _)| usage[*core].threshold_profiles += 1);
}
