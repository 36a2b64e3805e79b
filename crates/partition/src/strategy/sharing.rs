//! Compartments grouped core by core, each next to the compartments that share most sources with
//! it.
//!
//! Input: a network whose synapses are listed, and an estimate of each compartment's output axons.
//! Output: the compartments of each core. A core begins with the next compartment in the order of
//! the file. It then takes the compartment that shares most sources with its own, until a limit
//! would be broken. A source that reaches a core already costs no further input axon and no further
//! message there.
//!
//! Candidates are a pool of consecutive compartments. Compartments with k synapses in and out take
//! k^2 * `POOL` steps in all and a pass over the pool each; pools are filled in parallel. With
//! random connectivity, a pool of 8,192 out of 32,768 saves 7 % of the messages; a pool of all
//! would save 9 % in five times the time. Pools shrink until a round stays within the effort.
//! Nothing is grouped where that leaves few candidates, or where a pool is a small part of a random
//! network.

use std::ops::Range;

use rayon::prelude::*;

use crate::resources::fan_out::slots_of_core;
use crate::resources::incremental::{Filling, Newcomer};
use crate::strategy::members::Members;
use crate::strategy::order::{Chips, FilledCores, Filler};
use nsim_ir::base::csr::Csr;
use nsim_ir::base::id::{CompartmentId, Id};
use nsim_ir::quantised::Quantised;
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::resource::Resource;

/// Compartments of a pool, unless the effort requires fewer.
const POOL: u32 = 1 << 13;
/// Compartments below which a pool offers too little choice.
const LEAST_POOL: u64 = 1 << 8;
/// Most pools of a network with random connectivity. With a million compartments in 122 pools,
/// grouping saved 2 % of the messages and took as long as all other stages of the mapping together.
const PART: u64 = 32;
/// Rounds of grouping: the first estimates output axons by the order of the file, the next by the
/// round before.
const ROUNDS: u32 = 2;
/// Divisor for the part of a core's output axons that stays free, because output axons are known in
/// the mean only.
const FREE: u64 = 100;
/// Most times that compartments are taken from cores with too many output axons.
const TRIMS: usize = 6;

/// Whether every synapse is listed, so that sources differ in their targets.
pub fn is_listed(network: &Quantised) -> bool {
    let listed =
        |connectivity: &Connectivity| matches!(connectivity, Connectivity::Sparse { .. } | Connectivity::Random { .. });
    network.projections().iter().all(|projection| listed(&projection.connectivity))
}

/// Number of compartments of a pool for which a round takes at most `work`; `None` where grouping
/// is not worth its time.
fn pool_size(network: &Quantised, is_uniform: bool, work: u64) -> Option<u32> {
    let compartments = u64::from(network.compartments());
    let sources = (u64::from(network.channels()) + compartments).max(1);
    if is_uniform && compartments > u64::from(POOL) * PART {
        return None;
    }
    // Each synapse that adds a source to a core visits all compartments of the pool that the source
    // reaches.
    let synapses = u128::from(network.synapses());
    let reached =
        |pool: u64| synapses * synapses * u128::from(pool) / u128::from(sources) / u128::from(compartments.max(1));
    let sizes = std::iter::successors(Some(u64::from(POOL)), |&n| Some(n / 2)).take_while(|&n| n >= LEAST_POOL);
    sizes.into_iter().find(|&size| reached(size.min(compartments)) <= u128::from(work)).map(|size| size as u32)
}

/// Compartments on cores, grouped by shared sources; `sequential` is the order of the file on such
/// chips. `None` where a core cannot be kept within every limit, and where grouping within this
/// work would gain little.
pub fn shared_outputs(
    filler: &Filler<'_>,
    sequential: &FilledCores,
    chips: Chips,
    is_uniform: bool,
    work: u64,
) -> Option<FilledCores> {
    let pool = pool_size(filler.network, is_uniform, work)?;
    let most = u64::from(filler.target.limits()[Resource::AxonsOut]);
    let mut estimate = match &sequential.fan_out {
        Some(fan_out) => fan_out.slots.clone(),
        None => filler.fan_out(&sequential.members, chips).0.slots,
    };
    let mut best: Option<FilledCores> = None;
    for round in 0..ROUNDS {
        let members = fill(filler, pool, &estimate)?;
        let Some(found) = within_axons(filler, members, chips) else { break };
        let fan_out = found.fan_out.as_ref()?;
        let full = found.members.iter().map(|held| slots_of_core(held, fan_out)).max().unwrap_or(0);
        estimate = fan_out.slots.iter().map(|&slots| slots + slots.div_ceil(FREE as u32)).collect();
        if best.as_ref().is_none_or(|best| found.members.len() <= best.members.len()) {
            best = Some(found);
        }
        // Where output axons do not decide, another round finds an equal result.
        if round == 0 && full < most / 2 {
            break;
        }
    }
    best
}

/// Trims each core to its limit of output axons, and puts the removed compartments on further
/// cores.
fn within_axons(filler: &Filler<'_>, mut members: Members, chips: Chips) -> Option<FilledCores> {
    let most = u64::from(filler.target.limits()[Resource::AxonsOut]);
    for _ in 0..TRIMS {
        let (fan_out, _) = filler.fan_out(&members, chips);
        let mut spare: Vec<u32> = Vec::new();
        for held in members.iter_mut() {
            let mut slots = slots_of_core(held, &fan_out);
            if slots > most {
                while held.len() > 1 && slots > most - most / FREE {
                    let last = held.pop()?;
                    slots -= u64::from(fan_out.slots[last.index()]);
                    spare.push(last.0);
                }
                if slots > most {
                    return None;
                }
            }
        }
        if spare.is_empty() {
            let most = filler.target.limits()[Resource::AxonsOutPerCompartment];
            let fits = fan_out.axons.iter().all(|&axons| axons <= most);
            return fits.then_some(FilledCores { members, fan_out: Some(fan_out), usage: None });
        }
        spare.sort_unstable();
        for held in filled(filler, &spare, &fan_out.slots)? {
            members.push(held);
        }
    }
    None
}

/// Groups every pool, then fills cores with the compartments of each pool's last core.
fn fill(filler: &Filler<'_>, pool: u32, estimate: &[u32]) -> Option<Members> {
    let all = filler.network.compartments();
    let pools: Vec<Range<u32>> = (0..all).step_by(pool as usize).map(|first| first..(first + pool).min(all)).collect();
    let alone = pools.len() == 1;
    let found: Vec<Option<Vec<Vec<CompartmentId>>>> = pools
        .into_par_iter()
        .map_init(
            || Filling::new(filler.network, &filler.fan_in, filler.target.limits()),
            |filling, pool| pool_of(filler, filling, &pool, estimate),
        )
        .collect();
    let (mut members, mut rest) = (Vec::new(), Vec::new());
    for pool in found {
        let mut pool = pool?;
        if !alone {
            rest.extend(pool.pop().unwrap_or_default().into_iter().map(|id| id.0));
        }
        members.extend(pool);
    }
    members.extend(filled(filler, &rest, estimate)?);
    Some(members.into())
}

fn newcomer(filler: &Filler<'_>, id: CompartmentId, estimate: &[u32]) -> Option<Newcomer> {
    Some(Newcomer { slots_out: estimate[id.index()], ..Newcomer::new(filler.network, id)? })
}

/// Cores filled with these compartments in this order.
fn filled(filler: &Filler<'_>, ids: &[u32], estimate: &[u32]) -> Option<Vec<Vec<CompartmentId>>> {
    let mut filling = Filling::new(filler.network, &filler.fan_in, filler.target.limits());
    let mut members = Vec::new();
    for &id in ids {
        let newcomer = newcomer(filler, CompartmentId(id), estimate)?;
        if filling.add(&newcomer).is_err() {
            members.push(filling.next_core());
            filling.add(&newcomer).ok()?;
        }
    }
    members.push(filling.next_core());
    members.retain(|held| !held.is_empty());
    Some(members)
}

/// The cores of one pool, the last of which need not be full.
fn pool_of(
    filler: &Filler<'_>,
    filling: &mut Filling<'_>,
    pool: &Range<u32>,
    estimate: &[u32],
) -> Option<Vec<Vec<CompartmentId>>> {
    filling.next_core();
    let sources = (filler.network.channels() + filler.network.compartments()) as usize;
    let sources_of = |id: CompartmentId, f: &mut dyn FnMut(u32)| {
        let (population, index) = filler.network.population_of(id);
        filler.fan_in.for_each_into(population, index, |source, _, _, _| f(source));
    };
    // The compartments of the pool that each source reaches.
    let reached: Csr<u16> = Csr::by_row(sources, |put| {
        for (at, id) in pool.clone().enumerate() {
            sources_of(CompartmentId(id), &mut |source| put(source as usize, at as u16));
        }
    });
    // One more than the sources shared with the core that is being filled; 0 once a compartment is
    // on a core.
    let mut shared = vec![1i16; pool.len()];
    let (mut core_of_source, mut core) = (vec![0u32; sources], 1u32);
    let (mut members, mut next) = (Vec::new(), 0);
    for _ in 0..pool.len() {
        let mut at = if filling.is_empty() { None } else { most_shared(&shared) };
        loop {
            let taken = at.unwrap_or_else(|| {
                while shared[next] == 0 {
                    next += 1;
                }
                next
            });
            let id = CompartmentId(pool.start + taken as u32);
            if filling.add(&newcomer(filler, id, estimate)?).is_ok() {
                shared[taken] = 0;
                sources_of(id, &mut |source| {
                    if std::mem::replace(&mut core_of_source[source as usize], core) != core {
                        for &other in reached.get(source as usize) {
                            let count = &mut shared[usize::from(other)];
                            *count += i16::from(*count > 0 && *count < i16::MAX);
                        }
                    }
                });
                break;
            }
            let held = filling.next_core();
            if held.is_empty() {
                return None;
            }
            members.push(held);
            core += 1;
            shared.iter_mut().for_each(|count| *count = (*count).min(1));
            at = None;
        }
    }
    members.push(filling.next_core());
    Some(members)
}

/// Index of the first compartment with the most shared sources.
fn most_shared(shared: &[i16]) -> Option<usize> {
    let most = shared.iter().fold(0, |most: i16, &count| most.max(count));
    shared.iter().position(|&count| count == most && most > 0)
}
