//! Whether a mapping that was counted from geometry is right, judged by some of its cores.
//!
//! No program is written of such a network, only the tables of one core of each kind of box. The
//! rule:
//!
//! 1. every compartment is on exactly one core (the constructor of [`Partition`]);
//! 2. the synapses counted for all cores add up to the network's;
//! 3. the tables of a sampled core keep the rules of [`verify`](crate::verify);
//! 4. its compartments have the network's parameters, and its input axons lead to exactly the
//!    synapses that the network's sources have on it, enumerated source by source;
//! 5. its tables use what was counted, and so do the output axons of its compartments, followed
//!    synapse by synapse to the cores of their targets.
//!
//! Boxes of one kind have the same patterns of rows, columns and channels, hence the same tables
//! but for weights; output axons also depend on where a box is, and are compared for the sampled
//! cores only. Where they are counted by position they depend on the tables of the cores that are
//! reached, too: those of a core that reaches sampled cores only are found from their tables, and
//! are no more than was counted; of others it is known that they are no more than one for each
//! compartment.

use std::collections::{BTreeSet, HashMap};
use std::ops::RangeInclusive;

use rayon::prelude::*;

use crate::equivalence::SynapseCode;
use crate::verify::{is_long, verify_tables};
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::id::{CompartmentId, CoreId, IdVec, PopulationId};
use nsim_ir::graph::Window;
use nsim_ir::partition::Partition;
use nsim_ir::program::{Compartment, CoreClass, InputAxon};
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::quantised::{Quantised, Units};
use nsim_ir::resource::{Limits, OutputAxons, Resource};

/// The tables of one core.
#[derive(Debug, Clone)]
pub struct SampledCore {
    /// The core.
    pub core: CoreId,
    /// What it stores.
    pub class: CoreClass,
    /// The source of each input axon: channels first, then compartments.
    pub sources: Vec<u32>,
}

/// Compares counts and tables with synapses.
///
/// # Errors
/// A sentence about the first core that is wrong.
pub fn check(
    network: &Quantised,
    partition: &Partition,
    chips: &IdVec<CoreId, u32>,
    sample: &[SampledCore],
    limits: &Limits,
) -> Result<(), String> {
    let (counted, meant): (u64, u64) = (partition.usage().iter().map(|used| used.synapses).sum(), network.synapses());
    if counted != meant {
        return Err(format!("the cores have {counted} synapses and the network {meant}"));
    }
    let tables: HashMap<CoreId, &SampledCore> = sample.iter().map(|sampled| (sampled.core, sampled)).collect();
    let wrong = sample.par_iter().map(|sampled| {
        let SampledCore { core, class, .. } = sampled;
        let mut found = verify_tables(*core, class, limits).map_err(|violation| violation.to_string())?;
        check_parameters(network, partition, sampled)?;
        check_synapses(network, partition, sampled)?;
        let outputs = outputs(network, partition, chips, (*core, &tables), limits);
        let counted = partition.usage()[*core];
        found[Resource::AxonsOutPerCompartment] = outputs.most.into();
        let slots = counted[Resource::AxonsOut];
        let as_counted = match limits.output_axons {
            OutputAxons::PerCompartment => slots == outputs.each,
            OutputAxons::PerPosition { .. } => {
                slots <= outputs.each && outputs.by_position.is_none_or(|found| found <= slots)
            }
        };
        found[Resource::AxonsOut] = if as_counted { slots } else { outputs.by_position.unwrap_or(outputs.each) };
        match counted == found {
            true => Ok(()),
            false => Err(format!("{core} was counted to use {counted:?} and uses {found:?}")),
        }
    });
    wrong.find_map_first(Result::err).map_or(Ok(()), Err)
}

fn check_parameters(network: &Quantised, partition: &Partition, sampled: &SampledCore) -> Result<(), String> {
    let held = &partition.members()[sampled.core];
    let meant = held.iter().filter_map(|&id| {
        let (population, index) = network.population_of(id);
        let Units::Compartments { neurons, start_step, .. } = &network.populations()[population].units else {
            return None;
        };
        Some(Compartment { neuron: neurons.get(index), start_step: *start_step })
    });
    match meant.eq(sampled.class.compartments.iter().copied()) {
        true => Ok(()),
        false => Err(format!("{} has other compartments than its partition says", sampled.core)),
    }
}

/// Compares the list of every input axon with the network's synapses on the core, of every source
/// that may have any.
fn check_synapses(network: &Quantised, partition: &Partition, sampled: &SampledCore) -> Result<(), String> {
    let SampledCore { core, class, sources } = sampled;
    if class.inputs.len() != sources.len() {
        return Err(format!("{core} has {} input axons of {} sources", class.inputs.len(), sources.len()));
    }
    let mut axons: HashMap<u32, usize> = sources.iter().zip(0..).map(|(&source, axon)| (source, axon)).collect();
    let held = &partition.members()[*core];
    let range = held.iter().min()..=held.iter().max();
    let mut on_core: HashMap<PopulationId, Vec<u32>> = HashMap::new();
    for &id in held {
        let (population, index) = network.population_of(id);
        on_core.entry(population).or_default().push(index);
    }
    let (mut decoded, mut meant) = (Vec::new(), Vec::new());
    for (source, population) in network.populations().enumerate() {
        let into = network.outgoing(source).iter().map(|&p| &network.projections()[p]);
        let into: Vec<_> = into.filter_map(|p| Some((p, on_core.get(&p.target)?))).collect();
        let first_source = match &population.units {
            Units::Input(first) => first.0,
            Units::Compartments { first, .. } => network.channels() + first.0,
        };
        let mut candidates: Vec<u32> = into
            .iter()
            .flat_map(|(p, held)| sources_that_may_reach(&p.connectivity, held, population.shape.len()))
            .collect();
        candidates.sort_unstable();
        candidates.dedup();
        for index in candidates {
            meant.clear();
            for (projection, _) in &into {
                let Some(first) = network.populations()[projection.target].first_compartment() else { continue };
                projection.connectivity.for_each_from(index, |target, weight| {
                    let target = CompartmentId(first.0 + target);
                    // Most targets are outside the range, which spares a load of their seat.
                    if range.contains(&Some(&target)) && partition.seats()[target].core == *core {
                        meant.push(SynapseCode::new(target, projection.format, weight, projection.delay));
                    }
                });
            }
            decoded.clear();
            if let Some(axon) = axons.remove(&(first_source + index)) {
                decoded.extend(class.inputs.get(axon).synapses().filter_map(|synapse| {
                    let format = class.formats.get(usize::from(synapse.format))?.synapse;
                    let target = *held.get(usize::from(synapse.slot))?;
                    Some(SynapseCode::new(target, format, synapse.weight, synapse.delay))
                }));
            }
            meant.sort_unstable();
            decoded.sort_unstable();
            if meant != decoded {
                let (decoded, meant, name) = (decoded.len(), meant.len(), &population.name);
                return Err(format!(
                    "source {index} of {name} has {meant} synapses on {core} and {decoded} in its tables, or other ones"
                ));
            }
        }
    }
    match axons.is_empty() {
        true => Ok(()),
        false => Err(format!("{core} has input axons of sources that have no synapse on it")),
    }
}

/// The sources that may reach any of these targets: of a window, all channels at the positions
/// under and between the targets; otherwise all.
fn sources_that_may_reach(connectivity: &Connectivity, targets: &[u32], sources: u32) -> Vec<u32> {
    let (Connectivity::Conv2d { window, .. } | Connectivity::SumPool2d { window, .. }) = connectivity else {
        return (0..sources).collect();
    };
    let Window { source: (channels, height, width), target, kernel, stride, padding, dilation, .. } = *window;
    let span = |at: &dyn Fn(u32) -> u32, stride: u32, padding: u32, reach: u32, length: u32| -> RangeInclusive<u32> {
        let wide = |t: &u32| u64::from(at(*t)) * u64::from(stride);
        let (least, most) = (targets.iter().map(wide).min(), targets.iter().map(wide).max());
        let end = (most.unwrap_or(0) + u64::from(reach)).saturating_sub(padding.into());
        let start = least.unwrap_or(0).saturating_sub(padding.into());
        start.min(length.into()) as u32..=end.min(u64::from(length) - 1) as u32
    };
    let (row, column) = (|t: u32| t / target.2 % target.1, |t: u32| t % target.2);
    let rows = span(&row, stride.0, padding.0, (kernel.0 - 1) * dilation.0, height);
    let columns = span(&column, stride.1, padding.1, (kernel.1 - 1) * dilation.1, width);
    let position = |y: u32| columns.clone().map(move |x| y * width + x);
    let positions: Vec<u32> = rows.flat_map(position).collect();
    (0..channels).flat_map(|channel| positions.iter().map(move |at| channel * height * width + at)).collect()
}

/// What a core's compartments send.
struct Outputs {
    /// Output axon slots together, with one output axon for each compartment and core reached, the
    /// longest that there may be.
    each: u64,
    /// With the same one for compartments that send to the same population axons only; none where a
    /// core is reached whose tables are not known.
    by_position: Option<u64>,
    /// The most output axons of a compartment.
    most: u32,
}

fn outputs(
    network: &Quantised,
    partition: &Partition,
    chips: &IdVec<CoreId, u32>,
    (core, tables): (CoreId, &HashMap<CoreId, &SampledCore>),
    limits: &Limits,
) -> Outputs {
    let more = match limits.output_axons {
        OutputAxons::PerPosition { more_slots, .. } => more_slots,
        OutputAxons::PerCompartment => 0,
    };
    let (mut each, mut by_position, mut most) = (0, Some(0), 0);
    let (mut reached, mut lists) = (Vec::new(), BTreeSet::new());
    for &id in &partition.members()[core] {
        let (population, index) = network.population_of(id);
        reached.clear();
        for (_, projection, first) in network.targets_of(population) {
            projection.connectivity.for_each_target(index, |target| {
                let to = partition.seats()[CompartmentId(first.0 + target)].core;
                if reached.last() != Some(&to) {
                    reached.push(to);
                }
            });
        }
        reached.sort_unstable();
        reached.dedup();
        most = most.max(reached.len() as u32);
        let plain = |to: CoreId| match chips[to] == chips[core] {
            true => limits.axon_out_slots,
            false => limits.axon_out_slots_off_chip,
        };
        each += reached.iter().map(|&to| u64::from(plain(to) + more)).sum::<u64>();
        if !reached.iter().all(|to| tables.contains_key(to)) {
            by_position = None;
        }
        let Some(sum) = &mut by_position else { continue };
        // The population axon on each core, if it is one.
        let of_core = |to: &CoreId| {
            let SampledCore { class, sources, .. } = tables[to];
            let axon = sources.binary_search(&(network.channels() + id.0)).ok()?;
            match class.inputs.axon(axon) {
                InputAxon::Member { axon, .. } => Some(axon),
                InputAxon::Discrete { .. } => None,
            }
        };
        let axons: Vec<Option<u16>> = reached.iter().map(of_core).collect();
        let together: Option<Vec<(CoreId, u16)>> =
            reached.iter().zip(&axons).map(|(&to, axon)| Some((to, (*axon)?))).collect();
        if together.is_none_or(|together| lists.insert(together)) {
            let slots = |(&to, axon): (&CoreId, &Option<u16>)| {
                let long =
                    axon.is_some_and(|axon| is_long(&tables[&to].class.inputs.populations[usize::from(axon)], limits));
                u64::from(plain(to) + if long { more } else { 0 })
            };
            *sum += reached.iter().zip(&axons).map(slots).sum::<u64>();
        }
    }
    Outputs { each, by_position, most }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_testing::random_network;

    #[test]
    fn no_source_that_reaches_a_target_is_left_out() {
        let mut windows = 0;
        for seed in 0..60 {
            let network = random_network(seed);
            for projection in network.projections() {
                let sources = network.populations()[projection.source].shape.len();
                let targets = network.populations()[projection.target].shape.len();
                let mut reaching: Vec<Vec<u32>> = vec![Vec::new(); targets as usize];
                for source in 0..sources {
                    projection.connectivity.for_each_target(source, |target| reaching[target as usize].push(source));
                }
                for target in 0..targets {
                    let may = sources_that_may_reach(&projection.connectivity, &[target], sources);
                    windows += usize::from(may.len() < sources as usize);
                    assert!(reaching[target as usize].iter().all(|source| may.contains(source)), "seed {seed}");
                }
            }
        }
        assert!(windows > 100, "{windows} targets are seen by some of the sources only");
    }
}
