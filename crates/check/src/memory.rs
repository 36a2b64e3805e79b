//! Words of a core's memory as Intel's compiler for Loihi 2 counts them, counted again from the
//! network's sources.
//!
//! Input: a program and its network, which [`crate::equivalence`] compares, and a target. Output:
//! the usage of each core, or the first [`Violation`]. The rules are in the chip file and in
//! `docs/loihi2.md`. The compiler adds the compartments of a core one after another and enumerates
//! their sources. Here each source is followed to the cores that it reaches, with the targets'
//! seats from the program. The two share no code but the enumeration of synapses.

use std::collections::{BTreeMap, BTreeSet};

use nsim_dynamics::synapses::{Enumerate, for_each_position};
use nsim_ir::base::fixed::SignMode;
use nsim_ir::base::id::{CompartmentId, CoreId, IdVec, PopulationId};
use nsim_ir::hardware::Target;
use nsim_ir::partition::CoreUsage;
use nsim_ir::program::Program;
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::quantised::{Projection, Quantised};
use nsim_ir::resource::{Packing, Resource};

use crate::verify::{self, Violation};
use crate::words::bits_of_tag;

/// Checks every rule of [`verify`], and the words of each core; returns the usage of each core.
///
/// # Errors
/// The first [`Violation`], by core.
pub fn used(program: &Program, network: &Quantised, target: &Target) -> Result<IdVec<CoreId, CoreUsage>, Violation> {
    let (mut used, limits) = (verify::used(program, target)?, target.limits());
    let kernels = limits.counts_kernels();
    let counted = [Resource::NeuronWords, Resource::AxonMapWords, Resource::Groups];
    if !kernels && counted.into_iter().all(|resource| !limits.is_limited(resource)) {
        return Ok(used);
    }
    let mut count = Count { program, network, held: IdVec::new(), used: &mut used };
    count.held = network.populations().ids().map(|id| count.held_of(id)).collect();
    for (id, population) in network.populations().enumerate() {
        let each = population.neuron_kind().map_or(0, |kind| limits.neuron_sizes.words_of(kind));
        count.neurons(id, each.into());
    }
    if let Packing::Kernels { synapse_bits, list_bits } = limits.packing {
        for projection in network.projections() {
            count.synapses(projection, synapse_bits, list_bits);
        }
        network.populations().ids().for_each(|id| count.axons(id));
    }
    let excess = used.enumerate().find_map(|(core, usage)| Some((core, usage.excesses(limits).next()?)));
    match excess {
        Some((core, (capacity, need, limit))) => Err(Violation::Excess { core, capacity, need, limit }),
        None => Ok(used),
    }
}

/// The cores of a population, and by core the indices of its compartments there.
type Held = BTreeMap<CoreId, Vec<u32>>;

struct Count<'a> {
    program: &'a Program,
    network: &'a Quantised,
    held: IdVec<PopulationId, Held>,
    used: &'a mut IdVec<CoreId, CoreUsage>,
}

/// Words of this number of bits.
fn words(bits: u64) -> u64 {
    bits / 64 + u64::from(!bits.is_multiple_of(64))
}

/// Bits of a stored weight with its tag: those of its format, or as few as hold all weights of the
/// projection.
fn bits_of_weights(network: &Quantised, projection: &Projection) -> u64 {
    let format = projection.format;
    let weights: Vec<i16> = match &projection.connectivity {
        Connectivity::Dense { weights, .. } | Connectivity::Sparse { weights, .. } => weights.to_vec(),
        Connectivity::Conv2d { kernel, .. } => kernel.to_vec(),
        Connectivity::SumPool2d { weight, .. } => vec![*weight],
        Connectivity::Random { low, high, .. } => vec![*low, *high],
    };
    let holds = |bits: &u64| {
        weights.iter().all(|&weight| match format.sign {
            SignMode::Mixed => (-(1 << bits)..1 << bits).contains(&i32::from(weight)),
            SignMode::Excitatory | SignMode::Inhibitory => i32::from(weight).abs() < 1 << bits,
        })
    };
    let widest = u64::from(format.bits.get());
    let tag = u64::from(bits_of_tag(&network.parts().rules, format));
    if format.is_plastic() { widest + tag } else { (1..widest).find(holds).unwrap_or(widest) }
}

impl Count<'_> {
    fn held_of(&self, id: PopulationId) -> Held {
        let population = &self.network.populations()[id];
        let mut lists = Held::new();
        if let Some(first) = population.first_compartment() {
            for index in 0..population.shape.len() {
                let core = self.program.seats()[CompartmentId(first.0 + index)].core;
                lists.entry(core).or_default().push(index);
            }
        }
        lists
    }

    fn add(&mut self, core: CoreId, resource: Resource, more: u64) {
        self.used[core][resource] += more;
    }

    /// Neurons, entries of the axon map and groups of a population.
    fn neurons(&mut self, id: PopulationId, each: u64) {
        let positions = self.network.populations()[id].shape.positions().max(1);
        let shares = self.network.incoming(id).any(|(_, p)| p.connectivity.window().is_some());
        for (core, indices) in self.held[id].clone() {
            let entries = match shares {
                true => indices.iter().map(|index| index % positions).collect::<BTreeSet<u32>>().len(),
                false => indices.len(),
            };
            self.add(core, Resource::Groups, 1);
            self.add(core, Resource::NeuronWords, each * indices.len() as u64);
            self.add(core, Resource::AxonMapWords, entries as u64);
        }
    }

    /// Words of the synapses of a projection.
    fn synapses(&mut self, projection: &Projection, synapse_bits: u32, list_bits: u32) {
        let (weight, list) = (bits_of_weights(self.network, projection), u64::from(list_bits));
        let of_list = |targets: u64| words(targets * (weight + u64::from(synapse_bits)) + list);
        let sources = self.network.populations()[projection.source].shape.len();
        if let Some(window) = projection.connectivity.window() {
            let positions = window.target.1 * window.target.2;
            let of_group = window.target.0 / window.groups;
            for (core, indices) in self.held[projection.target].clone() {
                let channels: BTreeSet<u32> = indices.iter().map(|index| index / positions).collect();
                let mut groups: BTreeMap<u32, u64> = BTreeMap::new();
                channels.iter().for_each(|channel| *groups.entry(channel / of_group).or_default() += 1);
                let of_row = |mut left: u64| {
                    let mut row = 0;
                    while left > 0 {
                        let block = 1 << left.ilog2();
                        row += words(block * weight + list);
                        left -= block;
                    }
                    row
                };
                let rows = window.source.0 / window.groups * window.kernel.0 * window.kernel.1;
                let row = groups.into_values().map(of_row).sum::<u64>();
                self.add(core, Resource::SynapseWords, u64::from(rows) * row);
            }
        } else if matches!(projection.connectivity, Connectivity::Dense { .. }) {
            for (core, indices) in self.held[projection.target].clone() {
                self.add(core, Resource::SynapseWords, u64::from(sources) * of_list(indices.len() as u64));
            }
        } else {
            for source in 0..sources {
                for (core, targets) in self.reached(projection, source) {
                    self.add(core, Resource::SynapseWords, of_list(targets));
                }
            }
        }
    }

    /// Cores that a source reaches, with its number of targets there.
    fn reached(&self, projection: &Projection, source: u32) -> BTreeMap<CoreId, u64> {
        let mut reached = BTreeMap::new();
        let Some(first) = self.network.populations()[projection.target].first_compartment() else { return reached };
        projection.connectivity.for_each_target(source, |target| {
            let core = self.program.seats()[CompartmentId(first.0 + target)].core;
            *reached.entry(core).or_default() += 1;
        });
        reached
    }

    /// Input axons of a population's sources: one of each source, and of each position that a
    /// kernel reads.
    fn axons(&mut self, id: PopulationId) {
        let outgoing: Vec<_> = self.network.outgoing(id).iter().map(|&id| &self.network.projections()[id]).collect();
        let population = &self.network.populations()[id];
        let is_dense = |p: &&&Projection| matches!(p.connectivity, Connectivity::Dense { .. });
        let whole: BTreeSet<CoreId> =
            outgoing.iter().filter(is_dense).flat_map(|p| self.held[p.target].keys().copied()).collect();
        let mut axons: BTreeMap<CoreId, u64> = BTreeMap::new();
        whole.iter().for_each(|&core| *axons.entry(core).or_default() += u64::from(population.shape.len()));
        let listed: Vec<&Projection> =
            outgoing.iter().copied().filter(|p| !is_dense(&p) && p.connectivity.window().is_none()).collect();
        for source in 0..if listed.is_empty() { 0 } else { population.shape.len() } {
            let cores: BTreeSet<CoreId> = listed.iter().flat_map(|p| self.reached(p, source).into_keys()).collect();
            cores.difference(&whole).for_each(|&core| *axons.entry(core).or_default() += 1);
        }
        let mut read: BTreeSet<(CoreId, u32)> = BTreeSet::new();
        for projection in &outgoing {
            let Some(window) = projection.connectivity.window() else { continue };
            let positions = window.target.1 * window.target.2;
            let mut there: Vec<BTreeSet<CoreId>> = vec![BTreeSet::new(); positions as usize];
            for (&core, indices) in &self.held[projection.target] {
                for index in indices {
                    there[(index % positions) as usize].insert(core);
                }
            }
            for source in 0..window.source.1 * window.source.2 {
                for_each_position(&window, source, |y, x, _, _| {
                    let cores = &there[(y * window.target.2 + x) as usize];
                    read.extend(cores.iter().map(|&core| (core, source)));
                });
            }
        }
        read.iter().for_each(|&(core, _)| *axons.entry(core).or_default() += 1);
        axons.into_iter().for_each(|(core, more)| self.add(core, Resource::AxonsIn, more));
    }
}
