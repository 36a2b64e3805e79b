//! Fan-out of each compartment: its output axons, from the cores of its targets.
//!
//! Input: a network, the core of each compartment and the chip of each core. Output: for each
//! compartment, the number of distinct cores that its spikes reach, and the output axon slots that
//! these take.
//!
//! Where a target counts output axons by position ([`OutputAxons::PerPosition`]), population axons
//! are an input too ([`SharedPlaces`]). Some compartments of a core at one position take the slots
//! of one: all their spikes go to population axons, on the same cores.

use rayon::prelude::*;

use crate::resources::axon_sharing::Places;
use crate::resources::fan_in::bundle;
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::id::{CompartmentId, CoreId, Id, IdVec, PopulationId};
use nsim_ir::base::rng;
use nsim_ir::firing_rates::Rates;
use nsim_ir::quantised::Quantised;
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::resource::{Limits, OutputAxons};

/// Number of compartments of one task; fixed, so that nothing depends on threads.
const PIECE: usize = 1 << 14;

/// Compartments of each core, in slot order.
pub type Members = IdVec<CoreId, Vec<CompartmentId>>;
/// The core of each compartment.
pub type CoreOf = IdVec<CompartmentId, CoreId>;
/// The chip of each core.
pub type ChipOf = IdVec<CoreId, u32>;

/// The fan-out of each compartment.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FanOut {
    /// Output axon slots by compartment, as if it shared none.
    pub slots: Vec<u32>,
    /// Output axons by compartment.
    pub axons: Vec<u32>,
    /// Group of each compartment: compartments of a core with equal numbers share output axons, and
    /// [`ALONE`] shares none. Empty where no compartment shares.
    pub together: Vec<u64>,
}

/// Group of a compartment that shares no output axon.
pub const ALONE: u64 = 0;

/// The places that are members of population axons on each core, ascending, and whether the axon of
/// each is a pop32 axon.
pub type MembersOfCores = IdVec<CoreId, Vec<(u32, bool)>>;

/// Places on which the number of output axons depends.
#[derive(Debug)]
pub struct SharedPlaces<'a> {
    /// The places of sources.
    pub places: &'a Places,
    /// Places that are members of population axons, by core.
    pub members: &'a MembersOfCores,
}

/// Whether output axons depend on population axons. Input channels have no output axons.
pub fn by_position(places: &Places, limits: &Limits) -> bool {
    places.are_of_compartments() && matches!(limits.output_axons, OutputAxons::PerPosition { .. })
}

/// The core of each compartment of a membership.
pub fn cores_of(compartments: u32, members: &Members) -> CoreOf {
    let mut core_of: CoreOf = vec![CoreId(0); compartments as usize].into();
    for (core, held) in members.enumerate() {
        held.iter().for_each(|&id| core_of[id] = core);
    }
    core_of
}

/// Cores of each population, ascending; all sources of a dense layer reach the same cores.
fn cores_of_populations(network: &Quantised, core_of: &CoreOf) -> IdVec<PopulationId, Vec<CoreId>> {
    let of = |population: &nsim_ir::quantised::Population| {
        let Some(first) = population.first_compartment() else { return Vec::new() };
        let mut cores = core_of.as_slice()[first.index()..first.index() + population.shape.len() as usize].to_vec();
        cores.sort_unstable();
        cores.dedup();
        cores
    };
    network.populations().as_slice().par_iter().map(of).collect::<Vec<_>>().into()
}

/// The fan-out of each compartment; `shared` is given where [`by_position`] is true.
pub fn network_fan_out(
    network: &Quantised,
    core_of: &CoreOf,
    chips: &ChipOf,
    limits: &Limits,
    shared: Option<&SharedPlaces<'_>>,
) -> FanOut {
    let counted = by_source(network, core_of, chips.len(), false, |source, own, reached: &[CoreId]| {
        let slots = axon_slots(own, reached.iter().copied(), chips, limits);
        let (more, together) = shared.map_or((0, ALONE), |shared| shared.of_source(source, reached, limits));
        (slots + more, reached.len() as u32, together)
    });
    let together = if shared.is_some() { counted.iter().map(|of| of.2).collect() } else { Vec::new() };
    let (slots, axons) = counted.into_iter().map(|(slots, axons, _)| (slots, axons)).unzip();
    FanOut { slots, axons, together }
}

impl SharedPlaces<'_> {
    /// Extra slots of a source's messages to pop32 axons, and its group of compartments that share
    /// output axons.
    fn of_source(&self, source: u32, reached: &[CoreId], limits: &Limits) -> (u32, u64) {
        let OutputAxons::PerPosition { more_slots, .. } = limits.output_axons else { return (0, ALONE) };
        let Some((place, _)) = self.places.of_source(source).filter(|_| !reached.is_empty()) else { return (0, ALONE) };
        let (mut more, mut everywhere, mut cores) = (0, true, 0u64);
        for &core in reached {
            let members = &self.members[core];
            match members.binary_search_by_key(&place, |&(place, _)| place) {
                Ok(at) => more += if members[at].1 { more_slots } else { 0 },
                Err(_) => everywhere = false,
            }
            // Sums do not depend on the order in which cores are reached.
            cores = cores.wrapping_add(rng::bits(0, u64::from(place), u64::from(core.0)));
        }
        (more, if everywhere { cores.max(ALONE + 1) } else { ALONE })
    }
}

/// Output axon slots of a source on core `own` that reaches the cores `reached`.
pub fn axon_slots(own: Option<CoreId>, reached: impl Iterator<Item = CoreId>, chips: &ChipOf, limits: &Limits) -> u32 {
    let own = own.map(|own| chips[own]);
    reached.map(|to| if Some(chips[to]) == own { limits.axon_out_slots } else { limits.axon_out_slots_off_chip }).sum()
}

/// Messages between cores, inputs' included, in the steps that `rates` counts.
pub fn messages(network: &Quantised, core_of: &CoreOf, cores: usize, rates: &Rates) -> u64 {
    let of = |source: u32, own: Option<CoreId>, reached: &[CoreId]| {
        let others = reached.iter().filter(|&&core| Some(core) != own).count() as u64;
        rates.rate_of(source) * others
    };
    by_source(network, core_of, cores, true, of).into_iter().sum()
}

/// Consecutive sources of a population, counted by one task; for sources in bundles
/// ([`crate::resources::fan_in`]), the same positions of every channel of a bundle.
#[derive(Debug, Clone)]
struct Piece {
    population: PopulationId,
    /// Index of the first source.
    first: u32,
    /// Number of sources in a channel.
    length: u32,
    /// Distance from a channel to the next of its bundle, and number of channels.
    channels: (u32, u32),
}

/// All sources in pieces: channels (if asked for), then compartments.
fn pieces(network: &Quantised, with_channels: bool) -> Vec<Piece> {
    let mut pieces = Vec::new();
    for (id, population) in network.populations().enumerate() {
        if population.first_channel().is_some() && !with_channels {
            continue;
        }
        let size = population.shape.len();
        if size == 0 {
            // All its units are pruned.
            continue;
        }
        let (positions, bundle) = match (bundle(network, id), population.shape.volume()) {
            (bundle, Some((_, height, width))) if bundle > 1 => (height * width, bundle),
            _ => (size, 1),
        };
        for group in (0..size).step_by(positions as usize * bundle as usize) {
            let of = |from| Piece {
                population: id,
                first: group + from,
                length: (PIECE / bundle as usize).max(1).min((positions - from) as usize) as u32,
                channels: (positions, bundle),
            };
            pieces.extend((0..positions).step_by((PIECE / bundle as usize).max(1)).map(of));
        }
    }
    pieces
}

/// Results of `f(source, own core, cores reached)` for every source, in order: channels (if asked
/// for), then compartments. Cores are in the order in which they are first reached.
pub fn by_source<T: Send>(
    network: &Quantised,
    core_of: &CoreOf,
    cores: usize,
    with_channels: bool,
    f: impl Fn(u32, Option<CoreId>, &[CoreId]) -> T + Sync,
) -> Vec<T> {
    let of_population = cores_of_populations(network, core_of);
    let counted: Vec<Vec<(u32, Vec<T>)>> = pieces(network, with_channels)
        .into_par_iter()
        .map_init(
            || (vec![0u32; cores], 0u32, Vec::new()),
            |(seen, mark, reached), Piece { population: id, first, length, channels: (positions, bundle) }| {
                let population = &network.populations()[id];
                let number = network.first_source(population);
                let mut results: Vec<(u32, Vec<T>)> = (0..bundle)
                    .map(|k| (number + first + k * positions, Vec::with_capacity(length as usize)))
                    .collect();
                for index in first..first + length {
                    // Marks distinguish sources; a task has too few sources to overflow them.
                    *mark += 1;
                    reached.clear();
                    let mut reach = |core: CoreId| {
                        if std::mem::replace(&mut seen[core.index()], *mark) != *mark {
                            reached.push(core);
                        }
                    };
                    for (_, projection, target) in network.targets_of(id) {
                        match &projection.connectivity {
                            Connectivity::Dense { .. } => {
                                of_population[projection.target].iter().for_each(|&core| reach(core));
                            }
                            connectivity => connectivity.for_each_target(index, |t| {
                                reach(core_of[CompartmentId(target.0 + t)]);
                            }),
                        }
                    }
                    for (k, (_, results)) in (0..).zip(&mut results) {
                        let index = index + k * positions;
                        let own = population.first_compartment().map(|first| core_of[CompartmentId(first.0 + index)]);
                        results.push(f(number + index, own, reached));
                    }
                }
                results
            },
        )
        .collect();
    let mut counted: Vec<(u32, Vec<T>)> = counted.into_iter().flatten().collect();
    counted.sort_unstable_by_key(|(first, _)| *first);
    counted.into_iter().flat_map(|(_, results)| results).collect()
}

/// Output axon slots of all compartments of a core together.
pub fn slots_of_core(held: &[CompartmentId], fan_out: &FanOut) -> u64 {
    let slots = |id: &CompartmentId| u64::from(fan_out.slots[id.index()]);
    if fan_out.together.is_empty() {
        return held.iter().map(slots).sum();
    }
    let mut shared: Vec<(u64, u64)> = held.iter().map(|id| (fan_out.together[id.index()], slots(id))).collect();
    shared.sort_unstable();
    let groups = shared.chunk_by(|a, b| a.0 == b.0 && a.0 != ALONE);
    groups.map(|group| group[0].1).sum()
}
