//! Compartments onto logical cores.
//!
//! In comes a quantised network; out goes a [`Partition`] in which every core keeps every limit, or every reason why there
//! is none.
//!
//! `Sequential` fills one core after another in the order of populations and compartments: a core is closed when the next
//! compartment would break a limit. Two things are not known while filling, and are settled around it:
//!
//! - *Whether to keep a population whole* that fits into an empty core but not into the rest of the current one. Both ways
//!   are tried for the whole network; the one with fewer cores is taken, on a tie the one that keeps populations whole,
//!   because it sends fewer messages.
//! - *Output axons*, which depend on how many cores the targets end up on and on which chips (cores are numbered chip by
//!   chip, as [`crate::compile::place`] places them). The first filling ignores them; if a core then sends too much, each
//!   compartment is charged what it sent and a margin, which doubles from round to round, and the filling is repeated. It
//!   ends because estimates only grow, and a core with a single compartment is never split.
//!
//! Copies of a network are one copy's partition repeated, so that no copy shares a core with another, unless filling all of
//! them together takes fewer cores.

use std::collections::BTreeMap;

use crate::base::id::{CompartmentId, CoreId, Id, IdVec, PopulationId};
use crate::compile::fanin::FanIn;
use crate::compile::fill::{Filling, Newcomer};
use crate::compile::reason::Reason;
use crate::compile::usage::usage;
use crate::desc::target::{Limits, Target};
use crate::ir::partition::{Partition, PartitionError, Resource, seats};
use crate::ir::quantised::{Connectivity, Quantised, Units};

/// How compartments are gathered on cores.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Strategy {
    /// In the order of the model file.
    #[default]
    Sequential,
}

impl Strategy {
    /// Every strategy.
    pub const ALL: [Strategy; 1] = [Strategy::Sequential];

    /// Its name on the command line and in results.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Strategy::Sequential => "sequential",
        }
    }
}

/// Why there is no partition.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Failure {
    /// The network does not fit, for all of these reasons.
    DoesNotFit(Vec<Reason>),
    /// The partitioner has contradicted itself.
    Fault(String),
}

/// Rounds of filling after which output axons are given up on: the margin is then 2^9 times what was sent.
const ROUNDS: u32 = 14;
/// The first margin is a 2^5th of what was sent.
const FIRST_MARGIN: u32 = 5;

type Members = IdVec<CoreId, Vec<CompartmentId>>;

/// Cores for a network of equal copies; `one` is a single copy and `all` is all of them, copy after copy.
///
/// # Errors
/// [`Failure`].
pub fn partition(one: &Quantised, all: &Quantised, target: &Target, strategy: Strategy) -> Result<Partition, Failure> {
    let Strategy::Sequential = strategy;
    let limits = target.limits();
    let copies = (all.compartments() / one.compartments().max(1)).max(1);
    let mut members = Sequential::new(one, target).fewest_cores(Chips::Row)?;
    if copies > 1 {
        if !sends_little_enough(all, &repeated(&members, one, copies), target) {
            members = Sequential::new(one, target).fewest_cores(Chips::Apart)?;
        }
        members = repeated(&members, one, copies);
        if members.len() as u64 > least_cores(one, copies, limits)
            && let Ok(together) = Sequential::new(all, target).fewest_cores(Chips::Row)
            && together.len() < members.len()
        {
            members = together;
        }
    }
    if members.len() as u64 > u64::from(target.cores()) {
        return Err(Failure::DoesNotFit(vec![Reason::of_cores(target, copies, members.len() as u64)]));
    }
    let fault = |error: PartitionError| Failure::Fault(error.to_string());
    let seats = seats(all.compartments(), &members).map_err(fault)?;
    let chips = row_of_chips(members.len(), target);
    let usage = usage(all, &members, &seats, &chips, limits);
    Partition::new(all.compartments(), members, usage, limits).map_err(fault)
}

/// A number of cores below which no partition can be, from what copies cannot share.
#[must_use]
pub fn least_cores(one: &Quantised, copies: u32, limits: &Limits) -> u64 {
    let active: u64 = one
        .populations()
        .enumerate()
        .map(|(id, population)| {
            let outgoing = one.outgoing(id);
            let active = |&index: &u32| {
                outgoing.iter().any(|&p| match &one.projections()[p].connectivity {
                    Connectivity::Random { fan_out, .. } => *fan_out > 0,
                    connectivity => connectivity.count_from(index) > 0,
                })
            };
            (0..population.shape.len()).filter(active).count() as u64
        })
        .sum();
    let (copies, compartments) = (u64::from(copies), u64::from(one.compartments()));
    let by_compartments = (compartments * copies).div_ceil(u64::from(limits.compartments));
    by_compartments.max((active * copies).div_ceil(u64::from(limits.axons_in)))
}

/// The chip of each core when cores are placed chip by chip.
#[must_use]
pub fn row_of_chips(cores: usize, target: &Target) -> IdVec<CoreId, u32> {
    (0..cores as u32).map(|core| core / target.chip().cores).collect()
}

/// One copy's cores for all copies.
fn repeated(members: &Members, one: &Quantised, copies: u32) -> Members {
    let of_copy = |k: u32| {
        let first = k * one.compartments();
        members.iter().map(move |held| held.iter().map(|id| CompartmentId(first + id.0)).collect())
    };
    (0..copies).flat_map(of_copy).collect()
}

/// What is assumed of the chips of cores while output axons are counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Chips {
    /// Cores are placed chip by chip.
    Row,
    /// The worst: no two cores share a chip.
    Apart,
}

/// What each compartment sends.
struct Sent {
    /// Output axon slots by compartment.
    slots: Vec<u32>,
    /// Output axons by compartment.
    axons: Vec<u32>,
}

/// Counts what each compartment sends under a membership.
fn sent(network: &Quantised, members: &Members, chips: &IdVec<CoreId, u32>, limits: &Limits) -> Sent {
    let mut core_of = vec![CoreId(0); network.compartments() as usize];
    for (core, held) in members.enumerate() {
        held.iter().for_each(|id| core_of[id.index()] = core);
    }
    // Cores of a whole population, for dense layers: all of their sources reach the same ones.
    let cores_of: IdVec<PopulationId, Vec<CoreId>> = network
        .populations()
        .iter()
        .map(|population| {
            let Some(first) = population.first_compartment() else { return Vec::new() };
            let mut cores = core_of[first.index()..first.index() + population.shape.len() as usize].to_vec();
            cores.sort_unstable();
            cores.dedup();
            cores
        })
        .collect();
    let (mut slots, mut axons) = (vec![0; core_of.len()], vec![0; core_of.len()]);
    let mut seen: IdVec<CoreId, u32> = vec![0; members.len()].into();
    for (id, population) in network.populations().enumerate() {
        let Some(first) = population.first_compartment() else { continue };
        for index in 0..population.shape.len() {
            let at = first.index() + index as usize;
            let own = chips[core_of[at]];
            // Sources are told apart by one more than their number, since nothing has been seen at first.
            let source = at as u32 + 1;
            let mut reach = |core: CoreId| {
                if seen[core] != source {
                    seen[core] = source;
                    axons[at] += 1;
                    slots[at] +=
                        if chips[core] == own { limits.axon_out_slots } else { limits.axon_out_slots_off_chip };
                }
            };
            for &projection in network.outgoing(id) {
                let projection = &network.projections()[projection];
                let Some(target) = network.populations()[projection.target].first_compartment() else { continue };
                match &projection.connectivity {
                    Connectivity::Dense { .. } => cores_of[projection.target].iter().for_each(|&core| reach(core)),
                    connectivity => {
                        connectivity.for_each_from(index, |t, _| reach(core_of[(target.0 + t) as usize]));
                    }
                }
            }
        }
    }
    Sent { slots, axons }
}

/// Whether every core's output axons fit when cores are placed chip by chip.
fn sends_little_enough(network: &Quantised, members: &Members, target: &Target) -> bool {
    let limits = target.limits();
    let sent = sent(network, members, &row_of_chips(members.len(), target), limits);
    members.iter().all(|held| slots_of(held, &sent) <= u64::from(limits.axons_out))
}

fn slots_of(held: &[CompartmentId], sent: &Sent) -> u64 {
    held.iter().map(|id| u64::from(sent.slots[id.index()])).sum()
}

/// The needs beyond a limit, the greatest for each population and resource.
#[derive(Default)]
struct Misfits(BTreeMap<(PopulationId, Resource), (u64, u64)>);

impl Misfits {
    fn note(&mut self, population: PopulationId, (resource, need, limit): (Resource, u64, u64)) {
        let known = self.0.entry((population, resource)).or_insert((need, limit));
        known.0 = known.0.max(need);
    }

    fn none(&self) -> bool {
        self.0.is_empty()
    }

    fn reasons(self, network: &Quantised) -> Failure {
        let reason = |((population, resource), (need, limit)): ((PopulationId, Resource), (u64, u64))| {
            Reason::of_population(&network.populations()[population].name, resource, need, limit)
        };
        Failure::DoesNotFit(self.0.into_iter().map(reason).collect())
    }
}

/// The strategy of this name on one network.
struct Sequential<'a> {
    network: &'a Quantised,
    target: &'a Target,
    fan_in: FanIn,
}

impl<'a> Sequential<'a> {
    fn new(network: &'a Quantised, target: &'a Target) -> Self {
        Sequential { network, target, fan_in: FanIn::new(network) }
    }

    /// The better of keeping populations whole and filling every core up.
    fn fewest_cores(&self, chips: Chips) -> Result<Members, Failure> {
        let whole = self.settled(chips, true)?;
        let populations = self.network.populations().iter().filter(|p| p.first_compartment().is_some()).count();
        if populations < 2 || whole.len() < 2 {
            return Ok(whole);
        }
        match self.settled(chips, false) {
            Ok(full) if full.len() < whole.len() => Ok(full),
            _ => Ok(whole),
        }
    }

    /// Fills until output axons fit too.
    fn settled(&self, chips: Chips, keep_whole: bool) -> Result<Members, Failure> {
        let limits = self.target.limits();
        let mut filling = Filling::new(self.network, &self.fan_in, limits);
        let mut estimate = vec![0u32; self.network.compartments() as usize];
        for round in 0.. {
            let members = self.fill(&mut filling, &estimate, keep_whole)?;
            let chips = match chips {
                Chips::Row => row_of_chips(members.len(), self.target),
                Chips::Apart => (0..members.len() as u32).collect(),
            };
            let sent = sent(self.network, &members, &chips, limits);
            let mut misfits = Misfits::default();
            for (id, population) in self.network.populations().enumerate() {
                let Some(first) = population.first_compartment() else { continue };
                let of_population = &sent.axons[first.index()..first.index() + population.shape.len() as usize];
                let (need, limit) = (of_population.iter().max(), limits.axons_out_per_compartment);
                if let Some(&need) = need.filter(|&&need| need > limit) {
                    misfits.note(id, (Resource::AxonsOutPerCompartment, need.into(), limit.into()));
                }
            }
            let mut again = false;
            for held in &members {
                let (need, limit) = (slots_of(held, &sent), u64::from(limits.axons_out));
                if need > limit && (held.len() == 1 || round == ROUNDS) {
                    let (population, _) = self.network.population_of(held[0]);
                    misfits.note(population, (Resource::AxonsOut, need, limit));
                }
                again |= need > limit && held.len() > 1;
            }
            if !misfits.none() {
                return Err(misfits.reasons(self.network));
            }
            if !again {
                return Ok(members);
            }
            self.raise(&mut estimate, &sent.slots, round);
        }
        unreachable!("the last round gives reasons or members")
    }

    /// Raises each estimate to what was sent and a margin, though never above what every synapse on a core of its own sends.
    fn raise(&self, estimate: &mut [u32], slots: &[u32], round: u32) {
        let limits = self.target.limits();
        let dearest = u64::from(limits.axon_out_slots.max(limits.axon_out_slots_off_chip));
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
    fn fill(&self, filling: &mut Filling, estimate: &[u32], keep_whole: bool) -> Result<Members, Failure> {
        filling.next_core();
        let mut members = Members::new();
        let mut misfits = Misfits::default();
        for (population, description) in self.network.populations().enumerate() {
            let Units::Loihi { first, neurons, .. } = &description.units else { continue };
            let newcomer = |index: u32| {
                let id = CompartmentId(first.0 + index);
                Newcomer { id, population, index, neuron: neurons.get(index), slots_out: estimate[id.index()] }
            };
            let size = description.shape.len();
            let before = filling.len();
            let mut may_move = keep_whole && before > 0 && size <= self.target.limits().compartments;
            let mut next = 0;
            while next < size {
                let Err(used) = filling.add(&newcomer(next)) else {
                    next += 1;
                    continue;
                };
                let mut held = filling.next_core();
                if held.is_empty() {
                    used.excesses(self.target.limits()).for_each(|excess| misfits.note(population, excess));
                    next += 1;
                } else if std::mem::take(&mut may_move) {
                    if (0..size).all(|index| filling.add(&newcomer(index)).is_ok()) {
                        held.truncate(before);
                        next = size;
                    } else {
                        filling.next_core();
                    }
                    members.push(held);
                } else {
                    members.push(held);
                }
            }
        }
        if !filling.is_empty() {
            members.push(filling.next_core());
        }
        if misfits.none() { Ok(members) } else { Err(misfits.reasons(self.network)) }
    }
}
