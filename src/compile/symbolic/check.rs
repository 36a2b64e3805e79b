//! Whether a mapping that was counted from geometry is right, by code that enumerates synapses.
//!
//! No program is written of such a network, so there is none to compare with it. Instead:
//!
//! 1. every compartment has exactly one seat (the constructor of [`Partition`]);
//! 2. the synapses of all cores add up to the network's;
//! 3. of each kind of box one core is filled with its compartments' synapses one by one, and uses what was counted;
//! 4. the spikes of that core's compartments, followed synapse by synapse to the seats of their targets, take the output
//!    axons that were counted.
//!
//! Boxes of one kind have the same patterns of rows, columns and channels; output axons also depend on where a box stands,
//! and are compared for the cores of 3 only.

use std::collections::BTreeSet;

use rayon::prelude::*;

use crate::base::id::{CompartmentId, CoreId, Id, IdVec};
use crate::compile::resources::exact::profiles;
use crate::compile::resources::fan_in::FanIn;
use crate::compile::resources::incremental::{Filling, Newcomer};
use crate::desc::target::Limits;
use crate::ir::partition::{CoreUsage, Partition};
use crate::ir::quantised::{Quantised, Units};

/// Compares counts with synapses; `cores` has one of each kind.
///
/// # Errors
/// A sentence about the first core that uses something else.
pub fn check(
    network: &Quantised,
    partition: &Partition,
    cores: &[CoreId],
    chips: &IdVec<CoreId, u32>,
    limits: &Limits,
) -> Result<(), String> {
    let (counted, meant): (u64, u64) = (partition.usage().iter().map(|used| used.synapses).sum(), network.synapses());
    if counted != meant {
        return Err(format!("the cores have {counted} synapses and the network {meant}"));
    }
    let fan_in = FanIn::new(network);
    let wrong = cores
        .par_iter()
        .map_init(
            || Filling::new(network, &fan_in, limits),
            |filling, &core| {
                let (told, found) =
                    (partition.usage()[core], enumerated(network, partition, filling, core, chips, limits));
                (told != found).then(|| format!("{core} was counted to use {told:?} and uses {found:?}"))
            },
        )
        .find_map_first(|wrong| wrong);
    wrong.map_or(Ok(()), Err)
}

fn enumerated(
    network: &Quantised,
    partition: &Partition,
    filling: &mut Filling,
    core: CoreId,
    chips: &IdVec<CoreId, u32>,
    limits: &Limits,
) -> CoreUsage {
    filling.next_core();
    let held = partition.members()[core].iter().filter_map(|&id| {
        let (population, index) = network.population_of(id);
        let Units::Loihi { neurons, .. } = &network.populations()[population].units else { return None };
        Some(Newcomer { id, population, index, neuron: neurons.get(index), slots_out: 0 })
    });
    let held: Vec<Newcomer> = held.collect();
    // What does not fit is seen in the counts.
    let _ = filling.add_whole(held.iter().copied());
    let (mut slots, mut most) = (0, 0);
    let (mut of_compartments, mut thresholds) = (BTreeSet::new(), BTreeSet::new());
    for Newcomer { population, index, neuron, .. } in held {
        let (profile, threshold) = profiles(&neuron);
        of_compartments.insert(profile);
        thresholds.insert(threshold);
        let mut reached = BTreeSet::new();
        for &projection in network.outgoing(population) {
            let projection = &network.projections()[projection];
            let Some(first) = network.populations()[projection.target].first_compartment() else { continue };
            projection.connectivity.for_each_target(index, |target| {
                reached.insert(partition.seats()[CompartmentId(first.0 + target)].core);
            });
        }
        let near = reached.iter().filter(|&&to| chips[to] == chips[core]).count() as u32;
        let all = reached.len() as u32;
        slots += near * limits.axon_out_slots + (all - near) * limits.axon_out_slots_off_chip;
        most = most.max(all);
    }
    CoreUsage {
        axons_out: slots,
        axons_out_per_compartment: most,
        compartment_profiles: of_compartments.len() as u32,
        threshold_profiles: thresholds.len() as u32,
        ..filling.usage_shared()
    }
}

/// One core of each kind, in order; `kinds` has the kind of every core.
#[must_use]
pub fn one_of_each<K: Ord>(kinds: impl Iterator<Item = K>) -> Vec<CoreId> {
    let mut seen = BTreeSet::new();
    let firsts = kinds.enumerate().filter_map(|(core, kind)| seen.insert(kind).then(|| CoreId::new(core)));
    firsts.collect()
}
