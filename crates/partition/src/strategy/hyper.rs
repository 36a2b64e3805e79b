//! A network as a hypergraph, and the cost of its partitions.
//!
//! Input: a network. Output: a [`Hypergraph`]: one hyperedge (*net*) for each source of spikes, or
//! for all sources of a population with equal targets (dense layers). Its pins are the compartments
//! that it reaches. A net replaces one edge per pair, because a spike is sent once to each core,
//! for any number of targets there (Ronzani & Silvano, arXiv 2601.16118). The cost of a partition
//! is the number of messages of a step: over all nets, the rate of each source times the number of
//! cores that hold a pin, the source's own core not counted.
//!
//! A [`State`] keeps that cost and each core's use of compartments, input axons, output axons and
//! synapse words up to date while groups of compartments move. Compartments and messages are exact.
//! Input axons assume separate lists, and output axons the slots of another chip where there is
//! more than one: both are never too few. Words assume the simple formats, the index width of the
//! largest core and the longest delay there is. They are never too few for sources with one sparse
//! projection, an estimate for others. So a refined partition is counted exactly afterwards
//! ([`crate::resources::exact`]).

use std::collections::HashMap;

use crate::resources::fan_out::Members;
use crate::resources::formats::{stored_delay, tag_bits};
use crate::resources::packing::{self, Group, Widths};
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::csr::Csr;
use nsim_ir::base::fixed::{Delay, WeightBits};
use nsim_ir::base::id::{CompartmentId, Id};
use nsim_ir::firing_rates::Rates;
use nsim_ir::hardware::Target;
use nsim_ir::quantised::Quantised;
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::resource::{PerResource, Resource};

/// Transposed lists: for each key below `keys`, the lists that contain it, ascending. `turn` maps a
/// list's number and an item to the item's key and its entry in the key's list.
pub fn transposed<T: Copy, U: Copy + Default>(rows: &Csr<T>, keys: usize, turn: impl Fn(u32, T) -> (u32, U)) -> Csr<U> {
    Csr::by_row(keys, |put| {
        for (number, list) in (0..).zip(rows.iter()) {
            for &item in list {
                let (key, turned) = turn(number, item);
                put(key as usize, turned);
            }
        }
    })
}

/// Widest weight of some synapses, whether any of them is delayed, and their widest tag.
type Bits = (WeightBits, bool, u8);

/// One or several sources with equal targets.
#[derive(Debug, Clone, Copy)]
pub struct Net {
    /// Messages of a step to each core that holds a pin, of all its sources together.
    pub weight: u64,
    /// Number of sources.
    pub sources: u32,
    /// Input axons of a core that they reach: two for each source that learns.
    pub axons: u32,
    /// Whether all pins belong to dense layers, whose lists need no indices.
    pub dense: bool,
    /// What a synapse of it takes at most.
    pub bits: Bits,
}

/// A network as nets and pins.
#[derive(Debug)]
pub struct Hypergraph {
    /// The nets.
    pub nets: Vec<Net>,
    /// (net, synapses of one source) of the nets that reach each compartment.
    pub into: Csr<(u32, u32)>,
    /// The net of each compartment's own spikes, and their rate; `None` for a compartment without
    /// targets.
    pub own: Vec<Option<(u32, u64)>>,
}

impl Hypergraph {
    /// The hypergraph of a network, without the pins of compartments that are `fixed`: they do not
    /// move.
    pub fn new(network: &Quantised, rates: &Rates, fixed: &[bool]) -> Self {
        let mut nets = Vec::new();
        let mut pins: Csr<(u32, u32)> = Csr::default();
        let mut own: Vec<Option<(u32, u64)>> = vec![None; network.compartments() as usize];
        let mut reached: Vec<u32> = Vec::new();
        for (id, population) in network.populations().enumerate() {
            let outgoing: Vec<_> = network.targets_of(id).map(|(_, projection, first)| (projection, first)).collect();
            if outgoing.is_empty() {
                continue;
            }
            let dense = outgoing.iter().all(|(p, _)| matches!(p.connectivity, Connectivity::Dense { .. }));
            let bits = outgoing
                .iter()
                .map(|(p, _)| (p.format.bits, stored_delay(network, p) > Delay::MIN, tag_bits(network, p.format)));
            let bits = bits.fold((WeightBits::MIN, false, 0), |(bits, delayed, tag), (b, d, t)| {
                (bits.max(b), delayed | d, tag.max(t))
            });
            let (from, size) = (network.first_source(population), population.shape.len());
            let learns = outgoing.iter().any(|(p, _)| p.format.is_plastic());
            let at_once = if dense { size } else { 1 };
            for index in (0..size).step_by(at_once.max(1) as usize) {
                reached.clear();
                for (projection, first) in &outgoing {
                    projection.connectivity.for_each_target(index, |t| reached.push(first.0 + t));
                }
                reached.retain(|&t| !fixed[t as usize]);
                reached.sort_unstable();
                let net = nets.len() as u32;
                let weight = (index..index + at_once).map(|i| rates.rate_of(from + i)).sum();
                nets.push(Net { weight, sources: at_once, axons: at_once << u32::from(learns), dense, bits });
                pins.push(reached.chunk_by(|a, b| a == b).map(|same| (same[0], same.len() as u32)));
                if let Some(first) = population.first_compartment() {
                    for i in index..index + at_once {
                        own[(first.0 + i) as usize] = Some((net, rates.rate_of(from + i)));
                    }
                }
            }
        }
        let into = transposed(&pins, own.len(), |net, (pin, synapses)| (pin, (net, synapses)));
        Hypergraph { nets, into, own }
    }
}

/// Compartments that move together.
#[derive(Debug)]
pub struct Groups {
    /// Compartments of each group.
    pub members: Csr<u32>,
    /// (net, synapses of one source) of the nets that reach each group.
    pub into: Csr<(u32, u32)>,
    /// (net, sources, messages of a step) of a group's own spikes.
    pub own: Csr<(u32, u32, u64)>,
}

impl Groups {
    /// Groups by label, none for compartments that do not move; labels are from 0 on without gaps.
    pub fn new(graph: &Hypergraph, of: &[Option<u32>]) -> Self {
        let count = of.iter().flatten().max().map_or(0, |&label| label as usize + 1);
        let mut labelled: Vec<(u32, u32)> =
            of.iter().enumerate().filter_map(|(id, label)| Some(((*label)?, id as u32))).collect();
        labelled.sort_unstable();
        let (mut members, mut into, mut own) = (Csr::default(), Csr::default(), Csr::default());
        let mut pins: Vec<(u32, u32)> = Vec::new();
        let mut sends: Vec<(u32, u64)> = Vec::new();
        for group in labelled.chunk_by(|a, b| a.0 == b.0) {
            members.push(group.iter().map(|&(_, id)| id));
            pins.clear();
            sends.clear();
            for &(_, id) in group {
                pins.extend(graph.into.get(id as usize));
                sends.extend(graph.own[id as usize]);
            }
            if group.len() > 1 {
                pins.sort_unstable();
                sends.sort_unstable();
            }
            into.push(pins.chunk_by(|a, b| a.0 == b.0).map(|of| (of[0].0, of.iter().map(|&(_, n)| n).sum::<u32>())));
            own.push(
                sends
                    .chunk_by(|a, b| a.0 == b.0)
                    .map(|same| (same[0].0, same.len() as u32, same.iter().map(|&(_, rate)| rate).sum::<u64>())),
            );
        }
        debug_assert_eq!(members.len(), count);
        Groups { members, into, own }
    }

    /// Number of groups.
    pub fn len(&self) -> usize {
        self.members.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Resource use of a core while compartments move, for the tracked resources.
pub type Load = PerResource<i64>;

/// The tracked resources.
const TRACKED: [Resource; 4] = [Resource::Compartments, Resource::AxonsIn, Resource::AxonsOut, Resource::SynapseWords];

/// Whether a core is within the limit of every resource of which it uses more than before.
fn fits(now: &Load, before: &Load, limit: &Load) -> bool {
    TRACKED.into_iter().all(|resource| now[resource] <= limit[resource] || now[resource] <= before[resource])
}

/// A partition that is being changed.
#[derive(Debug)]
pub struct State<'a> {
    graph: &'a Hypergraph,
    /// The core of each compartment.
    pub core_of: Vec<u32>,
    /// (core, synapses of one source) of each net, in no order.
    held: Vec<Vec<(u32, u32)>>,
    /// (core, sources, their messages of a step) of each net whose sources are compartments.
    owners: Vec<Vec<(u32, u32, u64)>>,
    loads: Vec<Load>,
    limit: Load,
    out_slots: i64,
    /// Words of a list of n synapses by (dense, bits).
    words: HashMap<(bool, Bits), Vec<u32>>,
    /// Most output axons of a compartment.
    most_out: usize,
}

/// Synapses of a list below which words are looked up; longer lists are extrapolated.
const TABLE: usize = 4097;

impl<'a> State<'a> {
    /// Returns the state of a membership. Synapse words are limited to `percent_of_words` % of a
    /// core's limit.
    pub fn new(graph: &'a Hypergraph, members: &Members, target: &Target, percent_of_words: i64) -> Self {
        let limits = target.limits();
        let mut core_of = vec![0; graph.own.len()];
        let mut loads = vec![Load::default(); members.len()];
        let mut owners: Vec<Vec<(u32, u32, u64)>> = vec![Vec::new(); graph.nets.len()];
        let mut held: Vec<Vec<(u32, u32)>> = vec![Vec::new(); graph.nets.len()];
        for (core, of_core) in members.enumerate() {
            loads[core.index()][Resource::Compartments] = of_core.len() as i64;
            for id in of_core {
                core_of[id.index()] = core.0;
                for &(net, synapses) in graph.into.get(id.index()) {
                    add(&mut held[net as usize], core.0, synapses);
                }
                if let Some((net, rate)) = graph.own[id.index()] {
                    own(&mut owners[net as usize], core.0, 1, rate);
                }
            }
        }
        let largest = members.iter().map(Vec::len).max().unwrap_or(0) as u32;
        let widths = Widths::for_core(largest, Delay::MAX, limits.packing);
        let mut words = HashMap::new();
        for net in &graph.nets {
            words.entry((net.dense, net.bits)).or_insert_with(|| {
                let (weight_bits, delayed, tag_bits) = net.bits;
                let group = |synapses| Group { weight_bits, tag_bits, synapses, delayed, dense: net.dense, skip: None };
                (0..TABLE as u32).map(|synapses| packing::words(group(synapses), widths, limits)).collect()
            });
        }
        let several = members.len() as u64 > u64::from(target.chip().cores);
        let out_slots = if several { limits.axon_out_slots_off_chip } else { limits.axon_out_slots };
        let mut limit = Load::from_fn(|resource| limits[resource].into());
        limit[Resource::SynapseWords] = limit[Resource::SynapseWords] * percent_of_words / 100;
        let mut state = State {
            graph,
            core_of,
            held,
            owners,
            loads,
            limit,
            out_slots: out_slots.into(),
            words,
            most_out: limits[Resource::AxonsOutPerCompartment] as usize,
        };
        for net in 0..graph.nets.len() {
            let Net { sources, axons, .. } = graph.nets[net];
            for at in 0..state.held[net].len() {
                let (core, synapses) = state.held[net][at];
                let words = state.list_words(net, synapses);
                state.loads[core as usize][Resource::AxonsIn] += i64::from(axons);
                state.loads[core as usize][Resource::SynapseWords] += i64::from(sources) * words;
            }
            let reached = state.held[net].len() as i64;
            for &(core, sources, _) in &state.owners[net] {
                state.loads[core as usize][Resource::AxonsOut] += reached * i64::from(sources) * state.out_slots;
            }
        }
        state
    }

    /// Messages of a step between cores, inputs' included.
    pub fn cost(&self) -> u64 {
        let nets = self.graph.nets.iter().zip(&self.held);
        let cost: u64 = nets.map(|(net, cores)| net.weight * cores.len() as u64).sum();
        let own = self.graph.own.iter().zip(&self.core_of);
        let inside = own.filter_map(|(own, &core)| {
            let (net, rate) = (*own)?;
            (count(&self.held[net as usize], core) > 0).then_some(rate)
        });
        cost - inside.sum::<u64>()
    }

    fn list_words(&self, net: usize, synapses: u32) -> i64 {
        let Net { dense, bits, .. } = self.graph.nets[net];
        let table = &self.words[&(dense, bits)];
        let whole = synapses as usize / (TABLE - 1);
        i64::from(table[synapses as usize % (TABLE - 1)]) + whole as i64 * i64::from(table[TABLE - 1])
    }

    /// Calls `f(core, messages)` for each net of a group and each core that holds a pin of it.
    #[inline]
    pub fn for_each_shared(&self, groups: &Groups, group: u32, mut f: impl FnMut(u32, u64)) {
        for &(net, _) in groups.into.get(group as usize) {
            let weight = self.graph.nets[net as usize].weight;
            self.held[net as usize].iter().for_each(|&(core, _)| f(core, weight));
        }
        for &(net, _, rate) in groups.own.get(group as usize) {
            self.held[net as usize].iter().for_each(|&(core, _)| f(core, rate));
        }
    }

    /// Messages of a step that are saved when a group moves from one core to another; negative when
    /// there are more.
    pub fn gain(&self, groups: &Groups, group: u32, from: u32, to: u32) -> i64 {
        let (into, own) = (groups.into.get(group as usize), groups.own.get(group as usize));
        let mut gain = 0i64;
        for &(net, synapses) in into {
            let cores = &self.held[net as usize];
            let (leaves, arrives) = (count(cores, from) == synapses, count(cores, to) == 0);
            if !leaves && !arrives {
                continue;
            }
            let weight = self.graph.nets[net as usize].weight as i64;
            gain += weight * (i64::from(leaves) - i64::from(arrives));
            // Sources that stay on either core neither save nor cost a message: their own core
            // takes none.
            let moving = own.binary_search_by_key(&net, |own| own.0).map_or(0, |at| own[at].2);
            for &(core, _, rate) in &self.owners[net as usize] {
                if core == from && leaves {
                    gain -= (rate - moving) as i64;
                } else if core == to && arrives {
                    gain += rate as i64;
                }
            }
        }
        for &(net, _, rate) in own {
            let cores = &self.held[net as usize];
            let comes_along = into.binary_search_by_key(&net, |into| into.0).is_ok();
            let (before, after) = (count(cores, from) > 0, comes_along || count(cores, to) > 0);
            gain += rate as i64 * (i64::from(after) - i64::from(before));
        }
        gain
    }

    /// Whether a group may move: every core stays within its limits, or exceeds them by no more
    /// than before.
    pub fn may_move(&self, groups: &Groups, group: u32, from: u32, to: u32) -> bool {
        let (before_from, before_to) = (self.loads[from as usize], self.loads[to as usize]);
        let (after_from, after_to) = self.after(groups, group, from, to);
        fits(&after_to, &before_to, &self.limit)
            && fits(&after_from, &before_from, &self.limit)
            && groups.own.get(group as usize).iter().all(|&(net, _, _)| self.held[net as usize].len() <= self.most_out)
            && self.senders_may(groups, group, from, to)
    }

    /// The loads of the two cores after a move.
    pub fn after(&self, groups: &Groups, group: u32, from: u32, to: u32) -> (Load, Load) {
        let (mut a, mut b) = (self.loads[from as usize], self.loads[to as usize]);
        let size = groups.members.get(group as usize).len() as i64;
        a[Resource::Compartments] -= size;
        b[Resource::Compartments] += size;
        for &(net, synapses) in groups.into.get(group as usize) {
            let net = net as usize;
            let [sources, axons] = [self.graph.nets[net].sources, self.graph.nets[net].axons].map(i64::from);
            let (at_from, at_to) = (count(&self.held[net], from), count(&self.held[net], to));
            a[Resource::AxonsIn] -= if at_from == synapses { axons } else { 0 };
            b[Resource::AxonsIn] += if at_to == 0 { axons } else { 0 };
            a[Resource::SynapseWords] -=
                sources * (self.list_words(net, at_from) - self.list_words(net, at_from - synapses));
            b[Resource::SynapseWords] +=
                sources * (self.list_words(net, at_to + synapses) - self.list_words(net, at_to));
        }
        for &(net, sources, _) in groups.own.get(group as usize) {
            let slots = self.held[net as usize].len() as i64 * i64::from(sources) * self.out_slots;
            a[Resource::AxonsOut] -= slots;
            b[Resource::AxonsOut] += slots;
        }
        (a, b)
    }

    /// Whether the cores of sources that would reach one more core have the output axons for it.
    fn senders_may(&self, groups: &Groups, group: u32, from: u32, to: u32) -> bool {
        groups.into.get(group as usize).iter().all(|&(net, synapses)| {
            let cores = &self.held[net as usize];
            if count(cores, to) > 0 || count(cores, from) == synapses {
                return true;
            }
            self.owners[net as usize].iter().all(|&(core, sources, _)| {
                let more = i64::from(sources) * self.out_slots;
                self.loads[core as usize][Resource::AxonsOut] + more <= self.limit[Resource::AxonsOut]
                    && cores.len() < self.most_out
            })
        })
    }

    /// Moves a group.
    pub fn apply(&mut self, groups: &Groups, group: u32, from: u32, to: u32) {
        let (a, b) = self.after(groups, group, from, to);
        (self.loads[from as usize], self.loads[to as usize]) = (a, b);
        for &(net, sources, rate) in groups.own.get(group as usize) {
            disown(&mut self.owners[net as usize], from, sources, rate);
            own(&mut self.owners[net as usize], to, sources, rate);
        }
        for &(net, synapses) in groups.into.get(group as usize) {
            let cores = &mut self.held[net as usize];
            let before = cores.len() as i64;
            remove(cores, from, synapses);
            add(cores, to, synapses);
            let more = cores.len() as i64 - before;
            if more != 0 {
                for &(core, sources, _) in &self.owners[net as usize] {
                    self.loads[core as usize][Resource::AxonsOut] += more * i64::from(sources) * self.out_slots;
                }
            }
        }
        for &id in groups.members.get(group as usize) {
            self.core_of[id as usize] = to;
        }
    }

    /// Whether a core is within its limits.
    pub fn within(&self, core: u32) -> bool {
        fits(&self.loads[core as usize], &Load::default(), &self.limit)
    }

    /// Whether every core that sends to one of two groups is within its limit of output axons.
    pub fn senders_within(&self, groups: &Groups, a: u32, b: u32) -> bool {
        let nets = groups.into.get(a as usize).iter().chain(groups.into.get(b as usize));
        nets.into_iter().all(|&(net, _)| {
            let owners = &self.owners[net as usize];
            owners.is_empty()
                || self.held[net as usize].len() <= self.most_out
                    && owners.iter().all(|&(core, _, _)| {
                        self.loads[core as usize][Resource::AxonsOut] <= self.limit[Resource::AxonsOut]
                    })
        })
    }

    /// Number of cores.
    pub fn cores(&self) -> usize {
        self.loads.len()
    }

    /// Compartments of each core: the remaining ones of `before` in their order, then newcomers,
    /// ascending. Empty cores are removed.
    pub fn members(&self, before: &Members) -> Members {
        let mut members: Vec<Vec<CompartmentId>> = vec![Vec::new(); self.loads.len()];
        for (core, held) in before.enumerate() {
            members[core.index()].extend(held.iter().filter(|id| self.core_of[id.index()] == core.0));
        }
        let mut stayed = vec![false; self.core_of.len()];
        members.iter().flatten().for_each(|id| stayed[id.index()] = true);
        for (id, &core) in self.core_of.iter().enumerate() {
            if !stayed[id] {
                members[core as usize].push(CompartmentId::new(id));
            }
        }
        members.retain(|held| !held.is_empty());
        members.into()
    }
}

/// Synapses (or sources) in the entry of a core; 0 without an entry.
#[inline]
fn count(cores: &[(u32, u32)], core: u32) -> u32 {
    cores.iter().find(|entry| entry.0 == core).map_or(0, |entry| entry.1)
}

fn add(cores: &mut Vec<(u32, u32)>, core: u32, more: u32) {
    match cores.iter_mut().find(|entry| entry.0 == core) {
        Some(entry) => entry.1 += more,
        None => cores.push((core, more)),
    }
}

fn remove(cores: &mut Vec<(u32, u32)>, core: u32, less: u32) {
    if let Some(at) = cores.iter().position(|entry| entry.0 == core) {
        cores[at].1 -= less;
        if cores[at].1 == 0 {
            cores.swap_remove(at);
        }
    }
}

fn own(owners: &mut Vec<(u32, u32, u64)>, core: u32, sources: u32, rate: u64) {
    match owners.iter_mut().find(|entry| entry.0 == core) {
        Some(entry) => (entry.1, entry.2) = (entry.1 + sources, entry.2 + rate),
        None => owners.push((core, sources, rate)),
    }
}

fn disown(owners: &mut Vec<(u32, u32, u64)>, core: u32, sources: u32, rate: u64) {
    if let Some(at) = owners.iter().position(|entry| entry.0 == core) {
        (owners[at].1, owners[at].2) = (owners[at].1 - sources, owners[at].2 - rate);
        if owners[at].1 == 0 {
            owners.swap_remove(at);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::resources::exact::usage;
    use nsim_ir::partition::seats;
    use nsim_ir::resource::{Limits, OutputAxons};
    use nsim_testing::{Builder, limits, random_network, target};

    /// Compares the loads of a network on three cores with exact counts; words only where they are
    /// a bound.
    fn compare(network: &Quantised, words: bool, what: &str) {
        let mut members: Vec<Vec<CompartmentId>> = vec![Vec::new(); 3];
        (0..network.compartments()).for_each(|id| members[id as usize * 7 % 3].push(CompartmentId(id)));
        members.retain(|held| !held.is_empty());
        // Populations over space do not move, so their output axons are counted one by one.
        let limits = Limits { output_axons: OutputAxons::PerCompartment, ..limits() };
        let (members, board): (Members, _) = (members.into(), target(1, 1, limits));
        let graph = Hypergraph::new(network, &Rates::assumed(0.1), &vec![false; network.compartments() as usize]);
        let state = State::new(&graph, &members, &board, 100);
        let seats = seats(network.compartments(), &members).unwrap();
        let exact = usage(network, &members, &seats, &vec![0; members.len()].into(), board.limits());
        for (load, used) in state.loads.iter().zip(&exact) {
            assert_eq!(load[Resource::Compartments] as u64, used[Resource::Compartments], "{what}");
            assert!(load[Resource::AxonsIn] as u64 >= used[Resource::AxonsIn], "{what}: {load:?} {used:?}");
            assert!(load[Resource::AxonsOut] as u64 >= used[Resource::AxonsOut], "{what}: {load:?} {used:?}");
            assert!(
                !words || load[Resource::SynapseWords] as u64 >= used[Resource::SynapseWords],
                "{what}: {load:?} {used:?}"
            );
        }
    }

    #[test]
    fn loads_are_exact_or_never_too_little() {
        for seed in 0..40 {
            compare(&random_network(seed), false, &format!("seed {seed}"));
            let mut net = Builder::new();
            let (a, b) = (net.input("a", 40), net.loihi("b", 30));
            net.random(a, b, 1 + seed as u32 % 20, seed);
            net.random(b, b, 7, seed + 1);
            compare(&net.build(), true, &format!("sparse {seed}"));
        }
    }
}
