//! What reaches one compartment: the network read backwards.
//!
//! In comes a network, whose synapses are enumerated source by source; out goes, compartment by compartment, the sources of
//! its synapses. Listed and random synapses are sorted by target once, at four bytes a synapse; dense layers and windows
//! are computed. Copies of a network share their index.

use std::collections::HashMap;
use std::sync::Arc;

use crate::base::id::{IdVec, PopulationId, ProjectionId};
use crate::ir::graph::Window;
use crate::ir::quantised::{Connectivity, Population, Quantised};

/// Sources of spikes under one number: channels first, then compartments.
#[must_use]
pub fn first_source(network: &Quantised, population: &Population) -> u32 {
    match (population.first_channel(), population.first_compartment()) {
        (Some(first), _) => first.0,
        (None, Some(first)) => network.channels() + first.0,
        (None, None) => 0,
    }
}

/// Sources by target.
#[derive(Debug)]
struct Transposed {
    /// One more than targets.
    first: Vec<u64>,
    /// Ascending within a target.
    sources: Vec<u32>,
}

impl Transposed {
    fn of(connectivity: &Connectivity, sources: u32, targets: u32) -> Self {
        let mut first = vec![0u64; targets as usize + 1];
        for source in 0..sources {
            connectivity.for_each_from(source, |target, _| first[target as usize + 1] += 1);
        }
        for target in 0..targets as usize {
            first[target + 1] += first[target];
        }
        let mut at = first.clone();
        let mut list = vec![0u32; first[targets as usize] as usize];
        for source in 0..sources {
            connectivity.for_each_from(source, |target, _| {
                let place = &mut at[target as usize];
                list[*place as usize] = source;
                *place += 1;
            });
        }
        Transposed { first, sources: list }
    }
}

/// What makes two projections' indices equal.
#[derive(PartialEq, Eq, Hash)]
enum Key {
    Listed { list: (usize, usize), sources: u32, targets: u32 },
    Random { targets: u32, fan_out: u32, seed: u64, first_source: u32, sources: u32 },
}

/// How one projection is read backwards.
#[derive(Debug)]
enum Backwards {
    Dense { sources: u32 },
    Conv(Window),
    Pool(Window),
    Listed(Arc<Transposed>),
}

/// A network read backwards.
#[derive(Debug)]
pub struct FanIn {
    incoming: IdVec<PopulationId, Vec<ProjectionId>>,
    projections: IdVec<ProjectionId, (u32, Backwards)>,
}

impl FanIn {
    /// The index of a network.
    #[must_use]
    pub fn new(network: &Quantised) -> Self {
        let mut incoming: IdVec<PopulationId, Vec<ProjectionId>> =
            network.populations().iter().map(|_| Vec::new()).collect();
        let mut known: HashMap<Key, Arc<Transposed>> = HashMap::new();
        let mut projections = IdVec::new();
        for (id, projection) in network.projections().enumerate() {
            incoming[projection.target].push(id);
            let source = &network.populations()[projection.source];
            let (sources, targets) = (source.shape.len(), network.populations()[projection.target].shape.len());
            let mut listed = |key| {
                let index = || Arc::new(Transposed::of(&projection.connectivity, sources, targets));
                Backwards::Listed(known.entry(key).or_insert_with(index).clone())
            };
            let backwards = match &projection.connectivity {
                Connectivity::Dense { .. } => Backwards::Dense { sources },
                Connectivity::Conv2d { window, .. } => Backwards::Conv(*window),
                Connectivity::SumPool2d { window, .. } => Backwards::Pool(*window),
                Connectivity::Sparse { first, targets: list, .. } => {
                    let list = (first.as_ptr() as usize, list.as_ptr() as usize);
                    listed(Key::Listed { list, sources, targets })
                }
                &Connectivity::Random { fan_out, seed, first_source, .. } => {
                    listed(Key::Random { targets, fan_out, seed, first_source, sources })
                }
            };
            projections.push((first_source(network, source), backwards));
        }
        FanIn { incoming, projections }
    }

    /// Calls `f(source, projection)` for every synapse into a compartment of a population, by projection, then source.
    #[inline]
    pub fn for_each_into(&self, population: PopulationId, index: u32, mut f: impl FnMut(u32, ProjectionId)) {
        for &id in &self.incoming[population] {
            let (first, backwards) = &self.projections[id];
            match backwards {
                Backwards::Dense { sources } => (0..*sources).for_each(|source| f(first + source, id)),
                Backwards::Listed(index_of) => {
                    let range = index_of.first[index as usize] as usize..index_of.first[index as usize + 1] as usize;
                    for &source in &index_of.sources[range] {
                        f(first + source, id);
                    }
                }
                Backwards::Conv(window) => {
                    let per_group_in = window.source.0 / window.groups;
                    let per_group_out = window.target.0 / window.groups;
                    let group = index / (window.target.1 * window.target.2) / per_group_out;
                    for channel in group * per_group_in..(group + 1) * per_group_in {
                        for_each_covered(window, index, channel, |source| f(first + source, id));
                    }
                }
                Backwards::Pool(window) => {
                    let channel = index / (window.target.1 * window.target.2);
                    for_each_covered(window, index, channel, |source| f(first + source, id));
                }
            }
        }
    }
}

/// The sources of one channel that the window of a target covers.
fn for_each_covered(window: &Window, target: u32, channel: u32, mut f: impl FnMut(u32)) {
    let within = target % (window.target.1 * window.target.2);
    let (y, x) = (within / window.target.2, within % window.target.2);
    let covered = |at: u32, stride: u32, padding: u32, dilation: u32, kernel: u32, size: u32| {
        (0..kernel).filter_map(move |k| {
            // Wide, because a stride and a position may each be large; see `Window::for_each_position` for the relation.
            let s = (u64::from(at) * u64::from(stride) + u64::from(k) * u64::from(dilation))
                .checked_sub(u64::from(padding))?;
            (s < u64::from(size)).then_some(s as u32)
        })
    };
    let (stride, padding, dilation) = (window.stride, window.padding, window.dilation);
    for sy in covered(y, stride.0, padding.0, dilation.0, window.kernel.0, window.source.1) {
        for sx in covered(x, stride.1, padding.1, dilation.1, window.kernel.1, window.source.2) {
            f((channel * window.source.1 + sy) * window.source.2 + sx);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compile::testing::random_network;

    #[test]
    fn backwards_and_forwards_are_the_same_synapses() {
        for seed in 0..60 {
            let network = random_network(seed);
            let mut forwards = Vec::new();
            for (id, projection) in network.projections().enumerate() {
                let source = &network.populations()[projection.source];
                for s in 0..source.shape.len() {
                    let from = first_source(&network, source) + s;
                    projection.connectivity.for_each_from(s, |t, _| forwards.push((projection.target, t, id, from)));
                }
            }
            let (fan_in, mut backwards) = (FanIn::new(&network), Vec::new());
            for (id, population) in network.populations().enumerate() {
                for t in 0..population.shape.len() {
                    fan_in.for_each_into(id, t, |source, projection| backwards.push((id, t, projection, source)));
                }
            }
            forwards.sort_unstable();
            backwards.sort_unstable();
            assert_eq!(forwards, backwards, "seed {seed}");
            assert!(!forwards.is_empty());
        }
    }
}
