//! Relays: compartments that forward spikes, for compartments with more targets than output axons.
//!
//! Input: a network and the most targets of one compartment. Output: the network, in which every
//! compartment with more targets sends to relays. Relays are separate populations after the others,
//! so all numbers of the original stay. `nsim_check::relays` proves the properties that relays do
//! not change, and shares no code with this. Errors: delays that leave no time for relays; graded
//! spikes, which a relay does not carry; plastic projections, whose synapses stay together.
//!
//! A relay is a compartment without memory that spikes in the step in which its only synapse
//! delivers a spike, regardless of earlier ones. So it adds one step: over a relay a synapse of
//! delay d keeps d - 1. A projection of delay 0 keeps its synapses at their compartment while
//! output axons remain besides the relays. Otherwise delays are *padded*: with L(p) the steps by
//! which spikes of population p are later (0 for inputs), a projection from p to q has the delay
//! ```text
//! d' = d + L(q) - L(p),   with d' >= 1 where relays need it, and d' >= 0.
//! ```
//!
//! All spikes of q are then L(q) steps later and otherwise unchanged; the start and the resets of q
//! move with them. The least L are longest paths. Around a cycle the sum of delays is unchanged, so
//! a cycle with too little delay is refused.
//!
//! A compartment of n targets and a limit of m keeps m - r of them, and has r = (n - m) / (m - 1)
//! relays, rounded up. Relays with too many targets are treated likewise: trees grow level by
//! level. Targets are assigned to relays in the order of compartments, so the targets of a relay
//! are neighbours in the order of the file.

use std::ops::Range;

use rayon::prelude::*;

use nsim_dynamics::synapses::Enumerate;
use nsim_ir::arithmetic::Semantics;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::fixed::{Delay, SignMode, ThresholdMantissa, WeightBits, WeightExponent};
use nsim_ir::base::id::{CompartmentId, IdVec, PopulationId, ProjectionId};
use nsim_ir::graph::{PerCompartment, Shape};
use nsim_ir::neurons::Port;
use nsim_ir::quantised::connectivity::{Connectivity, SynapseFormat};
use nsim_ir::quantised::{Neuron, Note, Parts, Population, Projection, Quantised, Units};
use nsim_ir::spikes::Message;

/// Weight of the synapse of a relay: twice its threshold of 1 mantissa unit.
const WEIGHT: i16 = 2;
/// Number of compartments whose synapses one task divides.
const PIECE: u32 = 1 << 10;
/// Most levels of a tree: each takes a step of delay, of which a synapse has 62.
const MOST_LEVELS: usize = 62;

/// A network with relays.
#[derive(Debug, Clone)]
pub struct Relayed {
    /// The network: the populations of the original, then relays.
    pub network: Quantised,
    /// By population of the original, the steps by which its spikes are later.
    pub later: IdVec<PopulationId, u32>,
    /// Relay compartments that were added.
    pub relays: u32,
    /// Levels of the deepest tree.
    pub levels: u32,
}

/// Returns the network with relays for every compartment with more than `most` synapses.
///
/// # Errors
/// `map.relays`.
pub fn relayed(network: &Quantised, most: u32) -> Result<Relayed, Diagnostic> {
    let later = network.populations().iter().map(|_| 0).collect();
    let mut relayed = Relayed { network: network.clone(), later, relays: 0, levels: 0 };
    for _ in 0..MOST_LEVELS {
        let Some(next) = level(&relayed.network, most)? else { return Ok(relayed) };
        for (later, more) in relayed.later.iter_mut().zip(&next.later) {
            *later += more;
        }
        let (relays, levels) = (relayed.relays + next.relays, relayed.levels + 1);
        relayed = Relayed { network: next.network, later: relayed.later, relays, levels };
    }
    Err(refused(format!("a tree of {MOST_LEVELS} levels of relays with {most} output axons each is not enough")))
}

fn refused(message: String) -> Diagnostic {
    Diagnostic::new("map.relays", message)
}

/// Relays that the compartments of a population need.
struct RelayNeed {
    /// The population.
    of: PopulationId,
    /// Relays of each of its compartments.
    relays: Vec<u32>,
    /// Whether synapses of delay 0 go over relays too.
    tight: bool,
}

/// Number of synapses of a compartment, and number of its synapses of delay 0.
fn count(network: &Quantised, of: PopulationId, index: u32) -> (u64, u64) {
    let (mut all, mut without_delay) = (0, 0);
    for &id in network.outgoing(of) {
        let projection = &network.projections()[id];
        let synapses = projection.connectivity.count_from(index);
        all += synapses;
        without_delay += if projection.delay == Delay::MIN { synapses } else { 0 };
    }
    (all, without_delay)
}

/// The needs of all populations that need relays.
fn needs(network: &Quantised, most: u32) -> Result<Vec<RelayNeed>, Diagnostic> {
    let most = u64::from(most.max(2));
    let mut needs = Vec::new();
    for (of, population) in network.populations().enumerate().filter(|(_, p)| p.first_compartment().is_some()) {
        let (mut relays, mut tight) = (vec![0; population.shape.len() as usize], false);
        for (index, relays) in (0..).zip(&mut relays) {
            let (all, without_delay) = count(network, of, index);
            if all > most {
                let wanted = (all - most).div_ceil(most - 1).min(most);
                *relays = wanted as u32;
                // Synapses without delay have to fit next to the relays.
                tight |= without_delay > most - wanted.min(most);
            }
        }
        if relays.iter().any(|&relays| relays > 0) {
            if population.message != Message::Spike {
                let name = &population.name;
                return Err(refused(format!("population {name} sends graded spikes, which relays do not support")));
            }
            needs.push(RelayNeed { of, relays, tight });
        }
    }
    Ok(needs)
}

/// Steps by which each population is later, so that relays have the delay that they need.
fn padded(network: &Quantised, needs: &[RelayNeed]) -> Result<IdVec<PopulationId, u32>, Diagnostic> {
    let least = |projection: &Projection| {
        let goes_over = |one: &RelayNeed| one.of == projection.source && (one.tight || projection.delay > Delay::MIN);
        i64::from(needs.iter().any(goes_over))
    };
    let mut later: IdVec<PopulationId, i64> = network.populations().iter().map(|_| 0).collect();
    for _ in 0..=network.populations().len() {
        let mut settled = true;
        for projection in network.projections() {
            let wanted = later[projection.source] + least(projection) - i64::from(projection.delay.get());
            if wanted > later[projection.target] {
                (later[projection.target], settled) = (wanted, false);
            }
        }
        if settled {
            return Ok(later.iter().map(|&later| later as u32).collect());
        }
    }
    // Populations that never settle lie on cycles or after them.
    let short: Vec<String> = network
        .projections()
        .iter()
        .filter(|p| i64::from(p.delay.get()) < least(p))
        .map(|p| format!("{} (delay {}) needs a delay of {}", p.name, p.delay.get(), least(p)))
        .collect();
    let message =
        format!("a relay takes one step, but the delays of a recurrent part are too short: {}", short.join("; "));
    Err(refused(message)
        .help("give these projections that delay; nsim can pad paths only where there is no recurrence"))
}

/// Lists of synapses, written source by source.
#[derive(Default)]
struct Lists {
    first: Vec<u64>,
    targets: Vec<u32>,
    weights: Vec<i16>,
}

impl Lists {
    fn new() -> Self {
        Lists { first: vec![0], ..Lists::default() }
    }

    fn end(&mut self) {
        self.first.push(self.targets.len() as u64);
    }

    fn push(&mut self, target: u32, weight: i16) {
        self.targets.push(target);
        self.weights.push(weight);
    }

    /// Concatenates the lists, and leaves empty ones.
    fn together<'l>(all: impl Iterator<Item = &'l mut Lists>) -> Self {
        let all: Vec<Lists> = all.map(std::mem::take).collect();
        let sum = |of: fn(&Lists) -> usize| all.iter().map(of).sum::<usize>();
        let (lists, synapses) = (sum(|lists| lists.first.len()), sum(|lists| lists.targets.len()));
        let mut together = Lists::new();
        together.first.reserve_exact(lists);
        together.targets.reserve_exact(synapses);
        together.weights.reserve_exact(synapses);
        for Lists { first, targets, weights } in all {
            let before = together.targets.len() as u64;
            together.first.extend(first.iter().skip(1).map(|end| before + end));
            together.targets.extend(targets);
            together.weights.extend(weights);
        }
        together
    }

    fn into_connectivity(self) -> Connectivity {
        let Lists { first, targets, weights } = self;
        Connectivity::Sparse { first: first.into(), targets: targets.into(), weights: weights.into() }
    }
}

/// A synapse of a compartment.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Synapse {
    target: CompartmentId,
    /// Index among the outgoing projections.
    projection: usize,
    index: u32,
    weight: i16,
}

/// Adds one level of relays; `None` where no compartment has too many targets.
fn level(network: &Quantised, most: u32) -> Result<Option<Relayed>, Diagnostic> {
    let needs = needs(network, most)?;
    if needs.is_empty() {
        return Ok(None);
    }
    if let Some((_, Projection { name, .. })) = network.plastic().next() {
        let message =
            format!("projection {name} is plastic, and relays would split its synapses over several projections");
        return Err(refused(message).help("give no compartment more targets than it has output axons"));
    }
    let semantics = network.parts().semantics;
    if semantics != Semantics::Hardware {
        return Err(refused(format!("relays are supported in the chip's semantics only, not in {semantics:?}")));
    }
    if !network.parts().children.is_empty() {
        return Err(refused("compartments of one neuron would not start in the same step".to_string()));
    }
    let later = padded(network, &needs)?;
    let mut parts = network.parts().clone();
    for (population, &later) in parts.populations.iter_mut().zip(&later) {
        if let Units::Compartments { start_step, .. } = &mut population.units {
            *start_step += later;
        }
    }
    for projection in parts.projections.iter_mut() {
        let (from, to) = (i64::from(later[projection.source]), i64::from(later[projection.target]));
        projection.delay = Delay::new(i64::from(projection.delay.get()) + to - from)
            .map_err(|error| refused(format!("the delays are too long for relays: {error}")))?;
    }
    let (mut next, mut relays) = (network.compartments(), 0);
    for need in &needs {
        let size: u32 = need.relays.iter().sum();
        let name = relay_name(&parts, &network.populations()[need.of].name);
        let id = parts.populations.push(relay_population(&name, next, size, later[need.of]));
        (next, relays) = (next + size, relays + size);
        let over = split(network, &mut parts, need, most, id);
        let of = &network.populations()[need.of].name;
        parts.projections.push(to_relays(format!("{of} -> {name}"), need.of, id, over));
        let message =
            format!("{size} relays forward its spikes, because a compartment has at most {most} output axons");
        parts.notes.push(Note { entity: of.clone(), message, rounded: None });
    }
    for (population, &later) in network.populations().iter().zip(&later).filter(|(_, later)| **later > 0) {
        let message = format!("its spikes come {later} steps later, because relays take time");
        parts.notes.push(Note { entity: population.name.clone(), message, rounded: None });
    }
    Ok(Some(Relayed { network: made(parts)?, later, relays, levels: 1 }))
}

fn made(parts: Parts) -> Result<Quantised, Diagnostic> {
    Quantised::new(parts).map_err(|error| refused(format!("the network with relays is inconsistent: {error}")))
}

/// A name for relays that no population has.
fn relay_name(parts: &Parts, of: &str) -> String {
    let mut name = format!("{of}.relays");
    while parts.populations.iter().any(|population| population.name == name) {
        name.push_str(".relays");
    }
    name
}

/// A compartment without memory that spikes in the step in which its synapse brings a spike.
pub const RELAY: Neuron = Neuron { vth: ThresholdMantissa::ONE, ..Neuron::PLAIN };
/// The format of its synapse.
const RELAY_FORMAT: SynapseFormat = SynapseFormat {
    exponent: WeightExponent::ZERO,
    sign: SignMode::Mixed,
    bits: WeightBits::MAX,
    port: Port::First,
    apart: None,
    rule: None,
};

/// One synapse from each unit to the unit with its number, whose spike makes a relay spike.
pub fn one_to_one(units: u32) -> Connectivity {
    let first: Vec<u64> = (0..=u64::from(units)).collect();
    let (targets, weights): (Vec<u32>, Vec<i16>) = ((0..units).collect(), vec![WEIGHT; units as usize]);
    Connectivity::Sparse { first: first.into(), targets: targets.into(), weights: weights.into() }
}

/// Returns the network with a relay for each input channel, whose spikes are then a step later.
///
/// # Errors
/// `map.relays` where the network would contradict itself.
pub fn with_input_relays(network: &Quantised) -> Result<Quantised, Diagnostic> {
    let mut parts = network.parts().clone();
    let mut next = network.compartments();
    for (input, population) in network.inputs() {
        let (name, size) = (relay_name(&parts, &population.name), population.shape.len());
        let shaped = Population { shape: population.shape, ..relay_population(&name, next, size, 0) };
        let target = parts.populations.push(shaped);
        next += size;
        for projection in parts.projections.iter_mut().filter(|projection| projection.source == input) {
            projection.source = target;
        }
        let name = format!("{} -> {name}", population.name);
        parts.projections.push(to_relays(name, input, target, one_to_one(size)));
    }
    made(parts)
}

fn relay_population(name: &str, first: u32, size: u32, start_step: u32) -> Population {
    let neurons = PerCompartment::Same(RELAY);
    let units = Units::Compartments { first: CompartmentId(first), neurons, start_step };
    Population { name: name.to_string(), shape: Shape::Line(size), units, message: Message::Spike }
}

fn to_relays(name: String, source: PopulationId, target: PopulationId, connectivity: Connectivity) -> Projection {
    Projection { name, source, target, format: RELAY_FORMAT, delay: Delay::MIN, connectivity, plastic: None }
}

/// The synapses of some consecutive compartments, divided among them and their relays.
struct Divided {
    /// By outgoing projection: synapses of the compartments, and of their relays.
    direct: Vec<Lists>,
    carried: Vec<Lists>,
    /// Synapses from the compartments to their relays.
    over: Lists,
}

/// Input of the division of synapses.
struct Division<'a> {
    network: &'a Quantised,
    outgoing: &'a [ProjectionId],
    /// The first compartment of the target of each outgoing projection.
    first: Vec<CompartmentId>,
    /// Whether each outgoing projection has delay to spare.
    can_wait: Vec<bool>,
    need: &'a RelayNeed,
    most: u32,
}

impl Division<'_> {
    /// Divides the synapses of these compartments, whose relays are numbered from `relay`.
    fn divided(&self, compartments: Range<u32>, mut relay: u32) -> Divided {
        let Division { network, outgoing, .. } = self;
        let lists = || outgoing.iter().map(|_| Lists::new()).collect();
        let mut divided = Divided { direct: lists(), carried: lists(), over: Lists::new() };
        let (mut synapses, mut waiting): (Vec<Synapse>, Vec<Synapse>) = (Vec::new(), Vec::new());
        for index in compartments {
            let relays = self.need.relays[index as usize];
            synapses.clear();
            for (projection, &id) in outgoing.iter().enumerate() {
                network.projections()[id].connectivity.for_each_from(index, |target, weight| {
                    let target_id = CompartmentId(self.first[projection].0 + target);
                    synapses.push(Synapse { target: target_id, projection, index: target, weight });
                });
            }
            waiting.clear();
            if relays > 0 {
                // Synapses without spare delay stay; of the others, as many as output axons remain.
                let can_wait = |synapse: &Synapse| self.can_wait[synapse.projection];
                synapses.sort_unstable_by_key(|synapse| (can_wait(synapse), *synapse));
                let all = synapses.iter().filter(|synapse| can_wait(synapse)).count();
                let room = (self.most.saturating_sub(relays) as usize).saturating_sub(synapses.len() - all);
                let keep = synapses.len() - all + room.min(all);
                waiting.extend(synapses.drain(keep..));
            }
            synapses.sort_unstable_by_key(|synapse| (synapse.projection, synapse.index));
            for synapse in &synapses {
                divided.direct[synapse.projection].push(synapse.index, synapse.weight);
            }
            divided.direct.iter_mut().for_each(Lists::end);
            for part in 0..relays as usize {
                let all = waiting.len();
                let range = all * part / relays as usize..all * (part + 1) / relays as usize;
                for synapse in &waiting[range] {
                    divided.carried[synapse.projection].push(synapse.index, synapse.weight);
                }
                divided.carried.iter_mut().for_each(Lists::end);
                divided.over.push(relay, WEIGHT);
                relay += 1;
            }
            divided.over.end();
        }
        divided
    }
}

/// Divides the synapses of a population among its compartments and their relays; returns the
/// synapses of the relays.
fn split(network: &Quantised, parts: &mut Parts, need: &RelayNeed, most: u32, relays: PopulationId) -> Connectivity {
    let outgoing: Vec<ProjectionId> = network.outgoing(need.of).to_vec();
    let division = Division {
        network,
        outgoing: &outgoing,
        first: network.targets_of(need.of).map(|(_, _, first)| first).collect(),
        can_wait: outgoing.iter().map(|&id| parts.projections[id].delay > Delay::MIN).collect(),
        need,
        most,
    };
    let size = need.relays.len() as u32;
    let mut relay = 0;
    let pieces: Vec<(Range<u32>, u32)> = (0..size)
        .step_by(PIECE as usize)
        .map(|from| {
            let piece = from..(from + PIECE).min(size);
            let of_piece: u32 = need.relays[piece.start as usize..piece.end as usize].iter().sum();
            relay += of_piece;
            (piece, relay - of_piece)
        })
        .collect();
    let mut divided: Vec<_> = pieces.into_par_iter().map(|(piece, relay)| division.divided(piece, relay)).collect();
    let over = Lists::together(divided.iter_mut().map(|of| &mut of.over));
    let name = parts.populations[relays].name.clone();
    for (at, &id) in outgoing.iter().enumerate() {
        let direct = Lists::together(divided.iter_mut().map(|of| &mut of.direct[at]));
        let carried = Lists::together(divided.iter_mut().map(|of| &mut of.carried[at]));
        let projection = &mut parts.projections[id];
        projection.connectivity = direct.into_connectivity();
        if carried.targets.is_empty() {
            continue;
        }
        let target = &parts.populations[projection.target].name;
        let delay = Delay::new(i64::from(projection.delay.get()) - 1).unwrap_or(Delay::MIN);
        let (name, connectivity) = (format!("{name} -> {target}"), carried.into_connectivity());
        let carried = Projection { name, source: relays, delay, connectivity, ..projection.clone() };
        parts.projections.push(carried);
    }
    over.into_connectivity()
}
