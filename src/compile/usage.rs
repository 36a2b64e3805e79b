//! What each core of a given membership uses of each resource, exactly.
//!
//! In come a network, the compartments of each core in slot order and the chip of each core; out goes a [`CoreUsage`] each.
//! It counts what [`crate::compile::route`] will write:
//!
//! - input axons: distinct sources with a synapse on the core;
//! - output axons: one for each compartment and destination core; it takes `axon_out_slots` slots when the destination is
//!   on the same chip (the own core included), `axon_out_slots_off_chip` otherwise;
//! - words: as [`crate::compile::packing`] counts them; formats: distinct (synapse format, delayed or not, dense or
//!   sparse), because widths are the same for all groups of a core;
//! - compartment profiles: distinct (du, dv, refractory period); threshold profiles: distinct mantissas;
//! - accumulators: compartments times [`packing::delay_slots`] of the longest delay of a synapse into the core.
//!
//! Whether any of it is too much is not asked here.

use std::collections::BTreeSet;

use crate::base::fixed::Delay;
use crate::base::id::{CompartmentId, CoreId, Id, IdVec};
use crate::compile::formats::Formats;
use crate::compile::gather::{self, Key};
use crate::compile::packing::{self, Group, Widths};
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
    let mut used_formats = BTreeSet::new();
    let accumulators = compartments.saturating_mul(packing::delay_slots(longest));
    let mut used = CoreUsage { compartments, accumulators, synapses: keys.len() as u64, ..CoreUsage::default() };
    let mut last = None;
    for list in gather::lists(keys) {
        let mut words = 0;
        for group in gather::groups(list) {
            let (format, group) = group_of(group, formats);
            words += packing::words(group, widths, limits);
            // Neighbours mostly agree.
            let kind = (format, group.delayed, group.dense);
            if last.replace(kind) != Some(kind) {
                used_formats.insert(kind);
            }
        }
        used.axons_in += 1;
        used.synapse_words += u64::from(words);
        used.synapse_words_per_axon = used.synapse_words_per_axon.max(words);
    }
    used.synapse_formats = used_formats.len() as u32;
    used
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
