//! What each compartment sends: its output axons, from where its targets sit.
//!
//! In come a network, the core of each compartment and the chip of each core; out go, compartment by compartment, the
//! number of distinct cores that its spikes reach and the output axon slots that these take.

use rayon::prelude::*;

use crate::base::id::{CompartmentId, CoreId, Id, IdVec, PopulationId};
use crate::compile::fanin::first_source;
use crate::compile::rates::Rates;
use crate::desc::target::Limits;
use crate::ir::quantised::{Connectivity, Quantised};

/// Compartments that one task looks at; fixed, so that nothing depends on threads.
const PIECE: usize = 1 << 14;

/// What each compartment sends.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sent {
    /// Output axon slots by compartment.
    pub slots: Vec<u32>,
    /// Output axons by compartment.
    pub axons: Vec<u32>,
}

/// The core of each compartment of a membership.
#[must_use]
pub fn cores_of(compartments: u32, members: &IdVec<CoreId, Vec<CompartmentId>>) -> IdVec<CompartmentId, CoreId> {
    let mut core_of: IdVec<CompartmentId, CoreId> = vec![CoreId(0); compartments as usize].into();
    for (core, held) in members.enumerate() {
        held.iter().for_each(|&id| core_of[id] = core);
    }
    core_of
}

/// Cores of whole populations, for dense layers: all of their sources reach the same ones.
#[must_use]
pub fn cores_of_populations(
    network: &Quantised,
    core_of: &IdVec<CompartmentId, CoreId>,
) -> IdVec<PopulationId, Vec<CoreId>> {
    let of = |population: &crate::ir::quantised::Population| {
        let Some(first) = population.first_compartment() else { return Vec::new() };
        let mut cores = core_of.as_slice()[first.index()..first.index() + population.shape.len() as usize].to_vec();
        cores.sort_unstable();
        cores.dedup();
        cores
    };
    network.populations().as_slice().par_iter().map(of).collect::<Vec<_>>().into()
}

/// Counts what each compartment sends.
#[must_use]
pub fn sent(
    network: &Quantised,
    core_of: &IdVec<CompartmentId, CoreId>,
    chips: &IdVec<CoreId, u32>,
    limits: &Limits,
) -> Sent {
    let counted = by_source(network, core_of, chips.len(), false, |_, own, reached: &[CoreId]| {
        let near = reached.iter().filter(|&&core| own.is_some_and(|own| chips[core] == chips[own])).count() as u32;
        let axons = reached.len() as u32;
        (near * limits.axon_out_slots + (axons - near) * limits.axon_out_slots_off_chip, axons)
    });
    let (slots, axons) = counted.into_iter().unzip();
    Sent { slots, axons }
}

/// Messages between cores, inputs' included, in as many steps as rates count.
#[must_use]
pub fn messages(network: &Quantised, core_of: &IdVec<CompartmentId, CoreId>, cores: usize, rates: &Rates) -> u64 {
    let of = |source: u32, own: Option<CoreId>, reached: &[CoreId]| {
        let others = reached.iter().filter(|&&core| Some(core) != own).count() as u64;
        rates.of(source) * others
    };
    by_source(network, core_of, cores, true, of).into_iter().sum()
}

/// What `f(source, own core, cores reached)` says of every source, in order: channels (if asked for), then compartments.
/// Cores are in the order in which they are first reached.
pub fn by_source<T: Send>(
    network: &Quantised,
    core_of: &IdVec<CompartmentId, CoreId>,
    cores: usize,
    with_channels: bool,
    f: impl Fn(u32, Option<CoreId>, &[CoreId]) -> T + Sync,
) -> Vec<T> {
    let of_population = cores_of_populations(network, core_of);
    let mut pieces = Vec::new();
    for inputs in [true, false] {
        for (id, population) in network.populations().enumerate() {
            if population.first_channel().is_some() != inputs || (inputs && !with_channels) {
                continue;
            }
            let size = population.shape.len();
            pieces.extend((0..size).step_by(PIECE).map(|from| (id, population, from..(from + PIECE as u32).min(size))));
        }
    }
    let counted: Vec<Vec<T>> = pieces
        .into_par_iter()
        .map_init(
            || (vec![0u32; cores], 0u32, Vec::new()),
            |(seen, mark, reached), (id, population, range)| {
                let first = first_source(network, population);
                range
                    .map(|index| {
                        // Marks tell sources apart; a task of few sources never comes near the end of their range.
                        *mark += 1;
                        reached.clear();
                        let mut reach = |core: CoreId| {
                            if std::mem::replace(&mut seen[core.index()], *mark) != *mark {
                                reached.push(core);
                            }
                        };
                        for &projection in network.outgoing(id) {
                            let projection = &network.projections()[projection];
                            let Some(target) = network.populations()[projection.target].first_compartment() else {
                                continue;
                            };
                            match &projection.connectivity {
                                Connectivity::Dense { .. } => {
                                    of_population[projection.target].iter().for_each(|&core| reach(core));
                                }
                                connectivity => connectivity.for_each_target(index, |t| {
                                    reach(core_of[CompartmentId(target.0 + t)]);
                                }),
                            }
                        }
                        let own = population.first_compartment().map(|first| core_of[CompartmentId(first.0 + index)]);
                        f(first + index, own, reached)
                    })
                    .collect()
            },
        )
        .collect();
    counted.into_iter().flatten().collect()
}

/// Output axon slots of all compartments of a core together.
#[must_use]
pub fn slots_of(held: &[CompartmentId], sent: &Sent) -> u64 {
    held.iter().map(|id| u64::from(sent.slots[id.index()])).sum()
}
