//! Sources of each compartment: the network transposed.
//!
//! Input: a network, whose synapses are enumerated by source. Output: for each compartment, the
//! sources of its synapses. Listed and random synapses are sorted by target once, at four bytes a
//! synapse; dense layers and windows are computed. Copies of a network share their index.
//!
//! Where all projections from a population are convolutions with groups of one size, all channels
//! of a group reach the same compartments from a position. Such channels are a *bundle*, which is
//! reported once.

use std::collections::HashMap;
use std::sync::{Arc, OnceLock};

use rayon::prelude::*;

use crate::resources::formats::{NetworkWords, StoredSynapses};
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::id::{IdVec, PopulationId, ProjectionId};
use nsim_ir::firing_rates::Rates;
use nsim_ir::graph::Window;
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::quantised::{Population, Quantised};
use nsim_ir::resource::{Limits, Resource};

/// Most sources, and most targets, of one task. The number of one within its piece fits 16 bits.
const PIECE: u32 = 1 << 14;

/// Sources by target.
#[derive(Debug)]
struct Transposed {
    /// Index of each target's first source, and the end.
    first: Vec<u64>,
    /// Sources, ascending within a target.
    sources: Vec<u32>,
}

impl Transposed {
    /// Pieces of sources sort their synapses into ranges of targets, then ranges read the pieces in
    /// order. So sources ascend, and the result does not depend on threads.
    fn new(connectivity: &Connectivity, sources: u32, targets: u32) -> Self {
        let ranges = targets.div_ceil(PIECE) as usize;
        let pieces: Vec<Vec<Vec<u32>>> = (0..sources.div_ceil(PIECE))
            .into_par_iter()
            .map(|piece| {
                let mut by_range = vec![Vec::new(); ranges];
                for source in piece * PIECE..((piece + 1) * PIECE).min(sources) {
                    connectivity.for_each_target(source, |target| {
                        by_range[(target / PIECE) as usize].push(((target % PIECE) << 16) | (source % PIECE));
                    });
                }
                by_range
            })
            .collect();
        let parts: Vec<(Vec<u32>, Vec<u32>)> = (0..ranges)
            .into_par_iter()
            .map(|range| {
                let size = PIECE.min(targets - range as u32 * PIECE) as usize;
                let mut counts = vec![0u32; size];
                let of_range = || pieces.iter().map(|by_range| &by_range[range]);
                of_range().flatten().for_each(|both| counts[(both >> 16) as usize] += 1);
                let mut at = Vec::with_capacity(size);
                let mut sum = 0usize;
                for &count in &counts {
                    at.push(sum);
                    sum += count as usize;
                }
                let mut list = vec![0u32; sum];
                for (first, piece) in (0..).step_by(PIECE as usize).zip(of_range()) {
                    for both in piece {
                        let place = &mut at[(both >> 16) as usize];
                        list[*place] = first + (both & 0xffff);
                        *place += 1;
                    }
                }
                (counts, list)
            })
            .collect();
        drop(pieces);
        let mut transposed = Transposed { first: vec![0], sources: Vec::new() };
        transposed.sources.reserve_exact(parts.iter().map(|(_, list)| list.len()).sum());
        let mut sum = 0u64;
        for (counts, list) in parts {
            for count in counts {
                sum += u64::from(count);
                transposed.first.push(sum);
            }
            transposed.sources.extend(list);
        }
        transposed
    }
}

/// Synapses into a population from projections that reach few of its compartments, by target. They
/// have one index, because one for each projection would grow with projections times compartments.
#[derive(Debug)]
struct Gathered {
    /// Index of each target's first synapse, and the end.
    first: Vec<u64>,
    /// Place of the projection among those into the population, and source; ascending.
    synapses: Vec<(u32, u32)>,
}

impl Gathered {
    /// The index of these projections, which stand at these places.
    fn new(network: &Quantised, projections: &[(u32, ProjectionId)], targets: u32) -> Self {
        let mut by_target: Vec<(u32, u32, u32)> = Vec::new();
        for &(place, id) in projections {
            let projection = &network.projections()[id];
            for source in 0..network.populations()[projection.source].shape.len() {
                projection.connectivity.for_each_target(source, |target| by_target.push((target, place, source)));
            }
        }
        by_target.sort_unstable();
        let first = (0..=targets).map(|to| by_target.partition_point(|synapse| synapse.0 < to) as u64).collect();
        Gathered { first, synapses: by_target.into_iter().map(|(_, place, source)| (place, source)).collect() }
    }

    fn links_to(&self, target: u32) -> &[(u32, u32)] {
        &self.synapses[self.first[target as usize] as usize..self.first[target as usize + 1] as usize]
    }
}

/// The projections into a population.
#[derive(Debug)]
struct Incoming {
    /// All, in the order of the file.
    all: Vec<ProjectionId>,
    /// Places of those that have an index of their own.
    whole: Vec<u32>,
    /// The index of the others.
    gathered: Option<Arc<Gathered>>,
}

/// Key of projections that share an index.
#[derive(Clone, PartialEq, Eq, Hash)]
enum Key {
    Listed { list: ProjectionId, sources: u32, targets: u32 },
    Random { targets: u32, fan_out: u32, seed: u64, first_source: u32, sources: u32 },
}

/// Offsets and targets of listed synapses.
type List<'n> = (&'n Arc<[u64]>, &'n Arc<[u32]>);

/// The length of a list and some of its targets.
type Sample = (usize, Vec<u32>);

/// The first projection with each list.
#[derive(Default)]
struct FirstLists<'n>(HashMap<Sample, Vec<(ProjectionId, List<'n>)>>);

impl<'n> FirstLists<'n> {
    /// The first projection with these offsets and targets; `id` itself where none came before.
    fn identify(&mut self, id: ProjectionId, list: List<'n>) -> ProjectionId {
        let (first, targets) = list;
        // Few lists that differ have these targets in common, so few are compared as a whole.
        let sample = targets.iter().copied().step_by(targets.len() / 4 + 1).collect();
        let similar = self.0.entry((targets.len(), sample)).or_default();
        if let Some(&(equal, _)) = similar.iter().find(|(_, (f, t))| are_equal(f, first) && are_equal(t, targets)) {
            return equal;
        }
        similar.push((id, list));
        id
    }
}

/// Whether two tables are equal; copies of a network share theirs, which are not read.
fn are_equal<T: PartialEq>(a: &Arc<[T]>, b: &Arc<[T]>) -> bool {
    Arc::ptr_eq(a, b) || a == b
}

/// One projection, transposed.
#[derive(Debug)]
enum Backwards {
    Dense {
        sources: u32,
    },
    /// A bundle has the channels of a group, or one channel.
    Conv {
        window: Window,
        bundle: u32,
    },
    Pool(Window),
    Listed(Arc<Transposed>),
    /// Its synapses are in the population's common index.
    Gathered,
}

/// A network, transposed.
#[derive(Debug)]
pub struct FanIn {
    incoming: IdVec<PopulationId, Incoming>,
    projections: IdVec<ProjectionId, (u32, Backwards)>,
    stored: OnceLock<StoredSynapses>,
    words: OnceLock<Option<NetworkWords>>,
}

impl FanIn {
    /// Returns the index of a network.
    pub fn new(network: &Quantised) -> Self {
        let mut known: HashMap<Key, Arc<Transposed>> = HashMap::new();
        let (mut lists, mut projections) = (FirstLists::default(), IdVec::new());
        // Projections into each population that share an index.
        let mut gathered: HashMap<PopulationId, Vec<(ProjectionId, Key)>> = HashMap::new();
        for (id, projection) in network.projections().enumerate() {
            let source = &network.populations()[projection.source];
            let (sources, targets) = (source.shape.len(), network.populations()[projection.target].shape.len());
            let few = network.synapses_of(id) < u64::from(targets);
            let mut listed = |key: Key| {
                if few {
                    gathered.entry(projection.target).or_default().push((id, key));
                    return Backwards::Gathered;
                }
                let index = || Arc::new(Transposed::new(&projection.connectivity, sources, targets));
                Backwards::Listed(known.entry(key).or_insert_with(index).clone())
            };
            let backwards = match &projection.connectivity {
                Connectivity::Dense { .. } => Backwards::Dense { sources },
                Connectivity::Conv2d { window, .. } => {
                    Backwards::Conv { window: *window, bundle: bundle(network, projection.source) }
                }
                Connectivity::SumPool2d { window, .. } => Backwards::Pool(*window),
                Connectivity::Sparse { first, targets: list, .. } => {
                    listed(Key::Listed { list: lists.identify(id, (first, list)), sources, targets })
                }
                &Connectivity::Random { fan_out, seed, first_source, .. } => {
                    listed(Key::Random { targets, fan_out, seed, first_source, sources })
                }
            };
            projections.push((network.first_source(source), backwards));
        }
        let mut known: HashMap<Vec<(u32, Key)>, Arc<Gathered>> = HashMap::new();
        let mut incoming = |(population, of): (PopulationId, &Population)| {
            let all: Vec<ProjectionId> = network.incoming(population).map(|(id, _)| id).collect();
            let mut keys = gathered.remove(&population).unwrap_or_default().into_iter().peekable();
            let (mut whole, mut few, mut of_few) = (Vec::new(), Vec::new(), Vec::new());
            for (&id, place) in all.iter().zip(0..) {
                match keys.next_if(|(of, _)| *of == id) {
                    Some((_, key)) => {
                        few.push((place, id));
                        of_few.push((place, key));
                    }
                    None => whole.push(place),
                }
            }
            let index = || Arc::new(Gathered::new(network, &few, of.shape.len()));
            let gathered = (!few.is_empty()).then(|| known.entry(of_few).or_insert_with(index).clone());
            Incoming { all, whole, gathered }
        };
        let incoming = network.populations().enumerate().map(&mut incoming).collect();
        FanIn { incoming, projections, stored: OnceLock::new(), words: OnceLock::new() }
    }

    /// The stored synapses of this index's network, counted once; `None` where they are unlimited.
    pub fn stored(&self, network: &Quantised, limits: &Limits) -> Option<&StoredSynapses> {
        let limited = limits.is_limited(Resource::StoredSynapses);
        limited.then(|| self.stored.get_or_init(|| StoredSynapses::for_network(network)))
    }

    /// This index's network in words, made once; `None` where the limits count none.
    pub fn words(&self, network: &Quantised, limits: &Limits) -> Option<&NetworkWords> {
        self.words.get_or_init(|| NetworkWords::new(network, limits)).as_ref()
    }

    /// Calls `f(source, projection, part, bundle)` for every synapse into a compartment of a
    /// population, by projection, then source. The synapses of a bundle of `bundle` channels are
    /// one call, with the first of their sources. Synapses of a projection with equal parts of a
    /// kernel, from sources of the same atom, have the same weight.
    #[inline]
    pub fn for_each_into(&self, population: PopulationId, index: u32, mut f: impl FnMut(u32, ProjectionId, u64, u32)) {
        // Without a kernel, each synapse is a part of its own.
        let own = |source: u32| u64::from(source) << 32 | u64::from(index);
        let Incoming { all, whole, gathered } = &self.incoming[population];
        let mut rest = gathered.as_ref().map_or(&[][..], |gathered| gathered.links_to(index));
        for &place in whole {
            while let Some((&(before, source), after)) = rest.split_first().filter(|((before, _), _)| *before < place) {
                let id = all[before as usize];
                f(self.projections[id].0 + source, id, own(source), 1);
                rest = after;
            }
            let id = all[place as usize];
            let (first, backwards) = &self.projections[id];
            match backwards {
                Backwards::Gathered => {}
                Backwards::Dense { sources } => (0..*sources).for_each(|source| f(first + source, id, own(source), 1)),
                Backwards::Listed(index_of) => {
                    let range = index_of.first[index as usize] as usize..index_of.first[index as usize + 1] as usize;
                    for &source in &index_of.sources[range] {
                        f(first + source, id, own(source), 1);
                    }
                }
                &Backwards::Conv { ref window, bundle } => {
                    let per_group_in = window.source.0 / window.groups;
                    let per_group_out = window.target.0 / window.groups;
                    let out = u64::from(index / (window.target.1 * window.target.2));
                    let group = out as u32 / per_group_out;
                    let of_channel = u64::from(window.kernel.0) * u64::from(window.kernel.1);
                    for within in (0..per_group_in).step_by(bundle as usize) {
                        let part = (out * u64::from(per_group_in) + u64::from(within)) * of_channel;
                        let channel = group * per_group_in + within;
                        for_each_covered(window, index, channel, |source, at| f(first + source, id, part + at, bundle));
                    }
                }
                Backwards::Pool(window) => {
                    let channel = index / (window.target.1 * window.target.2);
                    for_each_covered(window, index, channel, |source, _| f(first + source, id, 0, 1));
                }
            }
        }
        for &(place, source) in rest {
            let id = all[place as usize];
            f(self.projections[id].0 + source, id, own(source), 1);
        }
    }

    /// Synaptic events of each compartment in the steps that `rates` counts. All sources of a
    /// bundle are assumed to spike as its first does.
    pub fn events_into(&self, network: &Quantised, rates: &Rates) -> Vec<u64> {
        let of_population = |(id, population): (PopulationId, &Population)| {
            let size = if population.first_compartment().is_some() { population.shape.len() } else { 0 };
            (0..size).into_par_iter().map(move |index| {
                let mut events = 0;
                self.for_each_into(id, index, |source, _, _, bundle| {
                    events += u64::from(bundle) * rates.rate_of(source);
                });
                events
            })
        };
        network.populations().enumerate().flat_map(|one| of_population(one).collect::<Vec<u64>>()).collect()
    }
}

/// Number of channels of a bundle of a population: the channels of a group where all its
/// projections are convolutions with groups of one size, 1 otherwise.
pub fn bundle(network: &Quantised, population: PopulationId) -> u32 {
    let mut bundle = None;
    for &id in network.outgoing(population) {
        let Connectivity::Conv2d { window, .. } = &network.projections()[id].connectivity else { return 1 };
        let of_group = window.source.0 / window.groups;
        if bundle.replace(of_group).is_some_and(|other| other != of_group) {
            return 1;
        }
    }
    bundle.unwrap_or(1)
}

/// Calls `f` with the sources of a channel that a target's window covers, and their place in it.
fn for_each_covered(window: &Window, target: u32, channel: u32, mut f: impl FnMut(u32, u64)) {
    let within = target % (window.target.1 * window.target.2);
    let (y, x) = (within / window.target.2, within % window.target.2);
    let covered = |at: u32, stride: u32, padding: u32, dilation: u32, kernel: u32, size: u32| {
        (0..kernel).filter_map(move |k| {
            // Wide, because a stride and a position may each be large; see
            // `Window::for_each_position` for the relation.
            let s = (u64::from(at) * u64::from(stride) + u64::from(k) * u64::from(dilation))
                .checked_sub(u64::from(padding))?;
            (s < u64::from(size)).then_some((s as u32, u64::from(k)))
        })
    };
    let (stride, padding, dilation) = (window.stride, window.padding, window.dilation);
    for (sy, ky) in covered(y, stride.0, padding.0, dilation.0, window.kernel.0, window.source.1) {
        for (sx, kx) in covered(x, stride.1, padding.1, dilation.1, window.kernel.1, window.source.2) {
            f((channel * window.source.1 + sy) * window.source.2 + sx, ky * u64::from(window.kernel.1) + kx);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_testing::random_network;

    #[test]
    fn sources_of_each_target_ascend_whatever_the_pieces() {
        let random =
            |targets| Connectivity::Random { targets, fan_out: 3, low: -8, high: 8, step: 2, seed: 5, first_source: 7 };
        for (sources, targets) in [(40_000, 50), (20, 40_000), (17_000, 33_000)] {
            let mut meant = vec![Vec::new(); targets as usize];
            for source in 0..sources {
                random(targets).for_each_target(source, |target| meant[target as usize].push(source));
            }
            let found = Transposed::new(&random(targets), sources, targets);
            let list = |target| &found.sources[found.first[target] as usize..found.first[target + 1] as usize];
            assert!((0..targets as usize).all(|target| list(target) == meant[target]), "{sources} to {targets}");
        }
    }

    #[test]
    fn backwards_and_forwards_are_the_same_synapses() {
        let mut bundled = false;
        for seed in 0..60 {
            let network = random_network(seed);
            let mut forwards = Vec::new();
            for (id, projection) in network.projections().enumerate() {
                let source = &network.populations()[projection.source];
                for s in 0..source.shape.len() {
                    let from = network.first_source(source) + s;
                    projection.connectivity.for_each_from(s, |t, _| forwards.push((projection.target, t, id, from)));
                }
            }
            let (fan_in, mut backwards) = (FanIn::new(&network), Vec::new());
            for (id, population) in network.populations().enumerate() {
                for t in 0..population.shape.len() {
                    fan_in.for_each_into(id, t, |source, projection, _, bundle| {
                        let positions = match &network.projections()[projection].connectivity {
                            Connectivity::Conv2d { window, .. } => window.source.1 * window.source.2,
                            _ => 0,
                        };
                        bundled |= bundle > 1;
                        backwards.extend((0..bundle).map(|k| (id, t, projection, source + k * positions)));
                    });
                }
            }
            forwards.sort_unstable();
            backwards.sort_unstable();
            assert_eq!(forwards, backwards, "seed {seed}");
            assert!(!forwards.is_empty());
        }
        assert!(bundled);
    }
}
