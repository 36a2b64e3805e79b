//! Filling cores along an order of compartments, until output axons fit too.
//!
//! Input: segments of compartments in an order. Output: the compartments of each core. A core is
//! closed when the next compartment would break a limit. Two decisions are made around the filling:
//!
//! - *Whether to keep a segment whole* that fits into an empty core but not into the rest of the
//!   current one. Both are tried for the whole network. The result with fewer cores is taken, on a
//!   tie the result with whole segments, because it sends fewer messages.
//! - *Output axons*, which depend on the number of cores with targets and on their chips (cores are
//!   numbered chip by chip, as `nsim_compile::place` keeps them). The first filling ignores them;
//!   in large networks it expects the slots of random connectivity. If a core then sends too much,
//!   each compartment is charged its counted slots and a margin, which doubles from round to round,
//!   and the filling is repeated. It ends because estimates only grow, and a core with a single
//!   neuron is never split.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use foldhash::HashMap;
use rayon::prelude::*;

use crate::error::CompileError;
use crate::reason::Reason;
use crate::resources::axon_sharing::Places;
use crate::resources::even_draws;
use crate::resources::exact::{CoreUse, Usages, unzipped, uses};
use crate::resources::fan_in::FanIn;
use crate::resources::fan_out::{ALONE, FanOut, SharedPlaces, by_position, cores_of, network_fan_out, slots_of_core};
use crate::resources::incremental::{Filling, Newcomer};
use crate::resources::sorted_synapses::Seats;
use crate::strategy::members::{Members, row_of_chips};
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::id::{CompartmentId, CoreId, Id, IdVec, PopulationId};
use nsim_ir::hardware::Target;
use nsim_ir::partition::{CoreUsage, seats};
use nsim_ir::quantised::Quantised;
use nsim_ir::resource::{Capacity, OutputAxons, Resource};

/// Rounds of filling after which the network is refused for its output axons: the margin is then
/// 2^9 times the fan-out.
const ROUNDS: u32 = 14;
/// The first margin is the fan-out / 2^5.
const FIRST_MARGIN: u32 = 5;

/// Number of memberships whose cores' uses are cached.
const KNOWN: usize = 4;

/// Compartments from which an order is filled in parts, and compartments of a part.
const LARGE: u64 = 1 << 18;
const PART: u32 = 1 << 15;

/// Assumption about the chips of cores while output axons are counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Chips {
    /// Cores are numbered chip by chip.
    Row,
    /// The worst: no two cores share a chip.
    Apart,
}

/// Neurons of one population to be filled into cores together, in this order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Segment {
    /// The population, which is no child of another.
    pub population: PopulationId,
    /// Their indices in it and in its children.
    pub indices: Indices,
}

/// Indices of a population's compartments.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Indices {
    /// This number of indices, from 0 on.
    All(u32),
    /// These indices.
    Listed(Vec<u32>),
    /// These indices, which are a tile: their lists may be shared when they are on one core.
    Tile(Vec<u32>),
}

impl Indices {
    /// Number of indices.
    pub fn len(&self) -> u32 {
        match self {
            Indices::All(count) => *count,
            Indices::Listed(indices) | Indices::Tile(indices) => indices.len() as u32,
        }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn get(&self, at: u32) -> u32 {
        match self {
            Indices::All(_) => at,
            Indices::Listed(indices) | Indices::Tile(indices) => indices[at as usize],
        }
    }
}

/// Parts of an order that are filled in parallel; long segments are cut. `None` unless the order is
/// so long that the core left open at the end of each part is negligible.
fn parts(order: &[Segment]) -> Option<Vec<Segment>> {
    let all: u64 = order.iter().map(|segment| u64::from(segment.indices.len())).sum();
    let longest = order.iter().map(|segment| segment.indices.len()).max()?;
    if all < LARGE || longest < PART {
        return None;
    }
    let mut parts = Vec::new();
    for Segment { population, indices } in order {
        for from in (0..indices.len()).step_by(PART as usize) {
            let to = (from + PART).min(indices.len());
            let indices = Indices::Listed((from..to).map(|at| indices.get(at)).collect());
            parts.push(Segment { population: *population, indices });
        }
    }
    Some(parts)
}

/// Every population as a segment, in the order of the model file; children come with their parents.
pub fn file_order(network: &Quantised) -> Vec<Segment> {
    let parents = network.populations().enumerate();
    let parents = parents.filter(|(_, p)| p.first_compartment().is_some() && !p.stack().pushes);
    parents.map(|(population, p)| Segment { population, indices: Indices::All(p.shape.len()) }).collect()
}

/// The needs beyond a limit, the greatest for each population and resource.
#[derive(Default)]
struct Misfits(BTreeMap<(PopulationId, Capacity), (u64, u64)>);

impl Misfits {
    fn note(&mut self, population: PopulationId, capacity: Capacity, need: u64, limit: u64) {
        let known = self.0.entry((population, capacity)).or_insert((need, limit));
        known.0 = known.0.max(need);
    }

    fn none(&self) -> bool {
        self.0.is_empty()
    }

    fn reasons(self, network: &Quantised) -> CompileError {
        let mut reasons = Vec::with_capacity(self.0.len());
        for ((population, capacity), (need, limit)) in self.0 {
            reasons.push(Reason::of_population(network, population, capacity, need, limit));
        }
        CompileError::DoesNotFit(reasons)
    }
}

/// Compartments of each core, with the counts made so far.
#[derive(Debug, Clone)]
pub struct FilledCores {
    /// The compartments.
    pub members: Members,
    /// Their fan-out on the assumed chips, where it has been counted.
    pub fan_out: Option<FanOut>,
    /// Use of each core, where it has been counted exactly; without output axons where `fan_out`
    /// has them.
    pub usage: Option<Usages>,
}

/// Compartments of a filled core, and their use where it is known.
type Filled = (Vec<CompartmentId>, Option<CoreUsage>);

/// Estimated output axons of compartments ([`FanOut`]).
#[derive(Debug)]
struct Estimate {
    slots: Vec<u32>,
    /// Empty where no compartment shares output axons.
    together: Vec<u64>,
}

impl Estimate {
    fn nothing(network: &Quantised) -> Self {
        Estimate { slots: vec![0; network.compartments() as usize], together: Vec::new() }
    }

    /// Returns the expected slots of random connectivity; a large network is then filled only once.
    fn expected(network: &Quantised, target: &Target) -> Self {
        let mut estimate = Estimate::nothing(network);
        for (id, population) in network.populations().enumerate() {
            let Some(first) = population.first_compartment() else { continue };
            let of_population = first.index()..first.index() + population.shape.len() as usize;
            estimate.slots[of_population].fill(even_draws::expected_slots(network, id, target));
        }
        estimate
    }
}

/// Fills cores with one network's compartments.
#[derive(Debug)]
pub struct Filler<'a> {
    /// The network.
    pub network: &'a Quantised,
    /// The target.
    pub target: &'a Target,
    /// The network, transposed.
    pub fan_in: FanIn,
    /// Cached uses of cores by their compartments: most cores stay unchanged from round to round.
    known: Mutex<HashMap<Vec<CompartmentId>, CoreUse>>,
}

impl<'a> Filler<'a> {
    /// Returns a filler with an empty cache.
    pub fn new(network: &'a Quantised, target: &'a Target) -> Self {
        Filler { network, target, fan_in: FanIn::new(network), known: Mutex::default() }
    }

    /// Returns the better result of keeping segments whole and of filling every core up.
    ///
    /// # Errors
    /// [`CompileError::DoesNotFit`] with a reason for each population that has a compartment that
    /// fits no core.
    pub fn fewest_cores(&self, order: &[Segment], chips: Chips) -> Result<FilledCores, CompileError> {
        let filled = self.at_most(usize::MAX, order, chips)?;
        filled.ok_or_else(|| CompileError::fault("a mapping of any number of cores was given up"))
    }

    /// As [`Filler::fewest_cores`]; `None` once it is certain that an order takes more than `most`
    /// cores.
    ///
    /// # Errors
    /// As [`Filler::fewest_cores`].
    pub fn at_most(&self, most: usize, order: &[Segment], chips: Chips) -> Result<Option<FilledCores>, CompileError> {
        let whole = || {
            let (estimate, filled) = self.first_filling(order, true)?;
            self.settled(most, order, chips, true, estimate, filled)
        };
        if !self.may_keep_whole(order) {
            return whole();
        }
        let (whole, full) = rayon::join(whole, || self.first_filling(order, false));
        let whole = whole?;
        // Settling never takes fewer cores. A network whose compartments are all pruned has none.
        let fewer = whole.as_ref().map_or(most, |whole| whole.members.len().saturating_sub(1));
        let full = full.ok().filter(|(_, full)| full.len() <= fewer);
        match full.map(|(estimate, full)| self.settled(fewer, order, chips, false, estimate, full)) {
            Some(Ok(Some(full))) => Ok(Some(full)),
            _ => Ok(whole),
        }
    }

    /// Fills once, in large networks with the expected output axons.
    fn first_filling(&self, order: &[Segment], keep_whole: bool) -> Result<(Estimate, Vec<Filled>), CompileError> {
        let estimate = match parts(order).is_some() {
            true => Estimate::expected(self.network, self.target),
            false => Estimate::nothing(self.network),
        };
        let filled = self.fill(order, &estimate, keep_whole)?;
        Ok((estimate, filled))
    }

    /// Whether keeping segments whole could change the result. A segment that is no tile stays
    /// whole only where an earlier one has begun a core, and where a core has slots for all of it.
    /// Parts of a long order begin their own cores.
    fn may_keep_whole(&self, order: &[Segment]) -> bool {
        let seats = self.target.limits()[Resource::Compartments];
        order.iter().any(|segment| matches!(segment.indices, Indices::Tile(_)))
            || order.iter().skip(1).any(|segment| segment.indices.len() <= seats) && parts(order).is_none()
    }

    /// Fills once, regardless of the fan-out.
    ///
    /// # Errors
    /// As [`Filler::fewest_cores`].
    pub fn fill_members(&self, order: &[Segment], keep_whole: bool) -> Result<Members, CompileError> {
        let filled = self.fill(order, &Estimate::nothing(self.network), keep_whole)?;
        Ok(filled.into_iter().map(|(held, _)| held).collect())
    }

    /// Returns the fan-out of these members on such chips; and the use of each core without output
    /// axons, where it had to be counted exactly to find the shared ones.
    pub fn fan_out(&self, members: &Members, chips: Chips) -> (FanOut, Option<Usages>) {
        let (network, limits) = (self.network, self.target.limits());
        let core_of = cores_of(network.compartments(), members);
        let chips = match chips {
            Chips::Row => row_of_chips(members.len(), self.target),
            Chips::Apart => (0..members.len() as u32).collect(),
        };
        let places = Places::for_network(network, limits);
        let seats = || seats(network.compartments(), members).ok();
        let counted = if by_position(&places, limits) { seats() } else { None };
        let counted = counted.map(|seats| self.uses(members, &seats, &places));
        let (usage, shared) = counted.map(unzipped).unzip();
        let shared = shared.as_ref().map(|members| SharedPlaces { places: &places, members });
        (network_fan_out(network, &core_of, &chips, limits, shared.as_ref()), usage.map(IdVec::from))
    }

    /// Returns the use of each core, counted where it is not cached. The lock is not held
    /// meanwhile, because a thread that waits for others may be given work that takes it.
    fn uses(&self, members: &Members, seats: &Seats, places: &Places) -> Vec<CoreUse> {
        let known = || self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let mut of_cores: Vec<Option<CoreUse>> = {
            let known = known();
            members.iter().map(|held| known.get(held).cloned()).collect()
        };
        if of_cores.iter().any(Option::is_none) {
            let is_new = |core: CoreId| of_cores[core.index()].is_none();
            let counted = uses(self.network, members, seats, self.target.limits(), places, is_new);
            let mut known = known();
            // Bounds the memory of the cache.
            if known.len() > KNOWN * members.len() {
                known.clear();
            }
            for ((of_core, held), counted) in of_cores.iter_mut().zip(members).zip(counted) {
                if of_core.is_none() {
                    known.insert(held.clone(), counted.clone());
                    *of_core = Some(counted);
                }
            }
        }
        of_cores.into_iter().flatten().collect()
    }

    /// Fills again until output axons fit too; `None` once there are more than `most` cores, which
    /// never become fewer.
    fn settled(
        &self,
        most: usize,
        order: &[Segment],
        chips: Chips,
        keep_whole: bool,
        mut estimate: Estimate,
        mut filled: Vec<Filled>,
    ) -> Result<Option<FilledCores>, CompileError> {
        let limits = self.target.limits();
        for round in 0.. {
            if filled.len() > most {
                return Ok(None);
            }
            let (members, usage): (Vec<_>, Vec<_>) = filled.into_iter().unzip();
            let members: Members = members.into();
            let (fan_out, counted) = self.fan_out(&members, chips);
            let mut misfits = Misfits::default();
            for (id, population) in self.network.populations().enumerate() {
                let Some(first) = population.first_compartment() else { continue };
                let of_population = &fan_out.axons[first.index()..first.index() + population.shape.len() as usize];
                let (need, limit) = (of_population.iter().max(), limits[Resource::AxonsOutPerCompartment]);
                if let Some(&need) = need.filter(|&&need| need > limit) {
                    misfits.note(id, Resource::AxonsOutPerCompartment.into(), need.into(), limit.into());
                }
            }
            let mut again = false;
            for held in &members {
                let (need, limit) = (slots_of_core(held, &fan_out), u64::from(limits[Resource::AxonsOut]));
                if need > limit && (held.len() == 1 || round == ROUNDS) {
                    let (population, _) = self.network.population_of(held[0]);
                    misfits.note(population, Resource::AxonsOut.into(), need, limit);
                }
                again |= need > limit && held.len() > 1;
            }
            if !misfits.none() {
                return Err(misfits.reasons(self.network));
            }
            if !again {
                let usage = counted.or_else(|| usage.into_iter().collect());
                return Ok(Some(FilledCores { members, fan_out: Some(fan_out), usage }));
            }
            self.raise(&mut estimate.slots, &fan_out, round);
            estimate.together = fan_out.together;
            filled = self.fill(order, &estimate, keep_whole)?;
        }
        unreachable!("the last round gives reasons or members")
    }

    /// Raises each estimate to the counted slots and a margin, at most to the slots of every
    /// synapse on a core of its own.
    fn raise(&self, estimate: &mut [u32], FanOut { slots, together, .. }: &FanOut, round: u32) {
        let limits = self.target.limits();
        let more = match limits.output_axons {
            OutputAxons::PerPosition { more_slots, .. } if !together.is_empty() => more_slots,
            OutputAxons::PerPosition { .. } | OutputAxons::PerCompartment => 0,
        };
        let dearest = u64::from(limits.axon_out_slots.max(limits.axon_out_slots_off_chip) + more);
        for (population, description) in self.network.populations().enumerate() {
            let Some(first) = description.first_compartment() else { continue };
            for index in 0..description.shape.len() {
                let at = first.index() + index as usize;
                let margin = (u64::from(slots[at]) << round) >> FIRST_MARGIN;
                let outgoing = self.network.outgoing(population).iter();
                let synapses: u64 =
                    outgoing.map(|&id| self.network.projections()[id].connectivity.count_from(index)).sum();
                let raised = (u64::from(slots[at]) + margin).min(synapses.saturating_mul(dearest));
                estimate[at] = estimate[at].max(u32::try_from(raised).unwrap_or(u32::MAX));
            }
        }
    }

    /// Fills cores in order, with these estimates of output axon slots.
    fn fill(&self, order: &[Segment], estimate: &Estimate, keep_whole: bool) -> Result<Vec<Filled>, CompileError> {
        let limits = self.target.limits();
        let filling = || Filling::new(self.network, &self.fan_in, limits);
        let (filled, misfits) = match parts(order) {
            None => self.fill_part(&mut filling(), order, estimate, keep_whole),
            Some(parts) => {
                let of_parts: Vec<(Vec<Filled>, Misfits)> = parts
                    .par_iter()
                    .map_init(filling, |filling, part| {
                        self.fill_part(filling, std::slice::from_ref(part), estimate, keep_whole)
                    })
                    .collect();
                let (mut filled, mut misfits) = (Vec::new(), Misfits::default());
                for (part, of_part) in of_parts {
                    filled.extend(part);
                    for ((population, capacity), (need, limit)) in of_part.0 {
                        misfits.note(population, capacity, need, limit);
                    }
                }
                (filled, misfits)
            }
        };
        if misfits.none() { Ok(filled) } else { Err(misfits.reasons(self.network)) }
    }

    /// Fills cores with a part of an order.
    fn fill_part(
        &self,
        filling: &mut Filling,
        order: &[Segment],
        estimate: &Estimate,
        keep_whole: bool,
    ) -> (Vec<Filled>, Misfits) {
        filling.next_core();
        let (mut filled, mut misfits) = (Vec::new(), Misfits::default());
        for &Segment { population, ref indices } in order {
            // Compartments of a neuron follow each other, children first.
            let compartments = self.network.neuron(population).into_iter().filter_map(|id| {
                let population = &self.network.populations()[id];
                Some((id, population.first_compartment()?, population.neurons()?))
            });
            let compartments: Vec<_> = compartments.collect();
            let each = compartments.len() as u32;
            let newcomer = |at: u32| {
                let ((population, first, neurons), index) =
                    (compartments[(at % each) as usize], indices.get(at / each));
                let id = CompartmentId(first.0 + index);
                let slots_out = estimate.slots[id.index()];
                let together = estimate.together.get(id.index()).copied().unwrap_or(ALONE);
                let (neuron, neuron_size) = (neurons.get(index), each as usize);
                Newcomer { id, population, index, neuron, neuron_size, slots_out, together }
            };
            let size = indices.len() * each;
            if keep_whole && matches!(indices, Indices::Tile(_)) {
                let before = filling.len();
                if filling.add_whole((0..size).map(newcomer)).is_ok() {
                    continue;
                }
                let mut held = filling.next_core();
                held.truncate(before);
                if !held.is_empty() {
                    filled.push((held, None));
                    if filling.add_whole((0..size).map(newcomer)).is_ok() {
                        continue;
                    }
                    filling.next_core();
                }
            }
            let before = filling.len();
            let mut may_move = keep_whole && before > 0 && size <= self.target.limits()[Resource::Compartments];
            let mut next = 0;
            while next < size {
                let Err(used) = filling.add(&newcomer(next)) else {
                    next += 1;
                    continue;
                };
                // A neuron begins on another core as a whole.
                let begun = next % each;
                next -= begun;
                let used_by_held = filling.used().filter(|_| begun == 0);
                let mut held = filling.next_core();
                held.truncate(held.len() - begun as usize);
                if held.is_empty() {
                    for (capacity, need, limit) in used.excesses(self.target.limits()) {
                        misfits.note(population, capacity, need, limit);
                    }
                    next += each;
                } else if std::mem::take(&mut may_move) {
                    if (0..size).all(|at| filling.add(&newcomer(at)).is_ok()) {
                        held.truncate(before);
                        next = size;
                    } else {
                        filling.next_core();
                    }
                    filled.push((held, None));
                } else {
                    filled.push((held, used_by_held));
                }
            }
        }
        if !filling.is_empty() {
            let used = filling.used();
            filled.push((filling.next_core(), used));
        }
        (filled, misfits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_testing::{limits, random_network, target};

    #[test]
    fn an_order_is_given_up_where_it_takes_more_cores_than_allowed_and_only_there() {
        let mut several = 0;
        for seed in 0..60 {
            let target = target(4, 4, limits().with(Resource::Compartments, 9).with(Resource::AxonsOut, 40));
            let network = random_network(seed);
            let filler = Filler::new(&network, &target);
            let order = file_order(&network);
            let Ok(filled) = filler.fewest_cores(&order, Chips::Row) else { continue };
            let cores = filled.members.len();
            several += u32::from(cores > 1);
            let allowed = filler.at_most(cores, &order, Chips::Row).unwrap().unwrap();
            assert_eq!(allowed.members, filled.members, "seed {seed}");
            assert!(filler.at_most(cores - 1, &order, Chips::Row).unwrap().is_none(), "seed {seed}");
        }
        assert!(several > 20, "{several}");
    }
}
