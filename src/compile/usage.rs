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
use crate::base::id::{CompartmentId, CoreId, IdVec};
use crate::compile::fanout::{self, Formats};
use crate::compile::packing::{self, Group, Widths};
use crate::desc::target::Limits;
use crate::ir::partition::{CoreUsage, Seat};
use crate::ir::quantised::{Neuron, Quantised, SpikeSource, Units};

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
    let mut usage: IdVec<CoreId, CoreUsage> = members
        .enumerate()
        .map(|(core, held)| {
            let compartments = held.len() as u32;
            let accumulators = compartments.saturating_mul(packing::delay_slots(longest[core]));
            CoreUsage { compartments, accumulators, ..CoreUsage::default() }
        })
        .collect();
    count_profiles(network, seats, &mut usage);
    let widths: IdVec<CoreId, Widths> =
        members.enumerate().map(|(core, held)| Widths::of(held.len() as u32, longest[core], limits.packing)).collect();
    let formats = Formats::of(network);
    let mut used_formats: IdVec<CoreId, BTreeSet<(u16, bool, bool)>> = vec![BTreeSet::new(); members.len()].into();
    let mut reaches = Vec::new();
    for (source, place) in fanout::sources(network) {
        fanout::collect(network, &formats, seats, place, &mut reaches);
        let own = match source {
            SpikeSource::Channel(_) => None,
            SpikeSource::Compartment(id) => Some(seats[id].core),
        };
        let (mut axons, mut slots) = (0, 0);
        for axon in reaches.chunk_by(|a, b| a.core == b.core) {
            let core = axon[0].core;
            let mut words = 0;
            for list in fanout::groups(axon) {
                let group = Group {
                    weight_bits: formats.get(list[0].format).bits,
                    synapses: list.len() as u32,
                    delayed: list.iter().any(|reach| reach.delay > 0),
                    dense: fanout::is_dense(list),
                };
                words += packing::words(group, widths[core], limits);
                used_formats[core].insert((list[0].format, group.delayed, group.dense));
            }
            let used = &mut usage[core];
            used.axons_in += 1;
            used.synapses += axon.len() as u64;
            used.synapse_words += u64::from(words);
            used.synapse_words_per_axon = used.synapse_words_per_axon.max(words);
            axons += 1;
            if let Some(own) = own {
                let near = chips[core] == chips[own];
                slots += if near { limits.axon_out_slots } else { limits.axon_out_slots_off_chip };
            }
        }
        if let Some(own) = own {
            let used = &mut usage[own];
            used.axons_out = used.axons_out.saturating_add(slots);
            used.axons_out_per_compartment = used.axons_out_per_compartment.max(axons);
        }
    }
    for (used, formats) in usage.iter_mut().zip(&used_formats) {
        used.synapse_formats = formats.len() as u32;
    }
    usage
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
