//! Classes of equal cores.
//!
//! Input: a network of equal copies that share nothing, and its partition. Output: the class of
//! each core, and the distances of its sources from the sources of the first core of its class.
//! Cores of a class store equal tables. They hold equal compartments of different copies, or
//! compartments of one population that only windows reach, shifted by some rows and columns
//! ([`crate::emit::windows`]), or both. Classes are numbered by their first cores.

use std::hash::Hash;

use foldhash::HashMap;
use rayon::prelude::*;

use crate::emit::windows::{Origin, Pattern, Windows};
use nsim_ir::base::fixed::Delay;
use nsim_ir::base::id::{ClassId, CompartmentId, CoreId, IdVec};
use nsim_ir::partition::Partition;
use nsim_ir::quantised::Quantised;
use nsim_partition::resources::formats::Formats;
use nsim_partition::resources::sorted_synapses::Key;

/// Cores whose keys are found in parallel: all keys take the memory of all compartments.
const CHUNK: usize = 1 << 10;

/// The classes of cores.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Classes {
    /// The class of each core.
    pub of: IdVec<CoreId, ClassId>,
    /// The first core of each class.
    pub firsts: IdVec<ClassId, CoreId>,
}

impl Classes {
    /// The classes of cores with these keys, in order of cores.
    pub fn by_key<K: Hash + Eq>(keys: impl Iterator<Item = K>) -> Self {
        let (mut known, mut classes) = (HashMap::default(), Classes::default());
        for (core, key) in (0..).map(CoreId).zip(keys) {
            let class = *known.entry(key).or_insert_with(|| classes.firsts.push(core));
            classes.of.push(class);
        }
        classes
    }

    /// The first core of the class of a core.
    pub fn first(&self, core: CoreId) -> CoreId {
        self.firsts[self.of[core]]
    }
}

/// Content that cores of a class have in common.
#[derive(PartialEq, Eq, Hash)]
enum Common {
    /// Compartments in slot order, relative to the first compartment of their first copy.
    Members(Vec<u32>),
    /// Compartments of one population that only windows reach.
    Pattern(Pattern),
}

/// Position of a core: its first copy, and the origins of the windows into it.
#[derive(Debug, Clone)]
struct Place {
    copy: u32,
    origins: Option<Box<[Origin]>>,
}

/// Range of sources (first, end), and their distance from the sources of another core.
pub type Shift = (u32, u32, i64);

/// The cores of a network in classes.
#[derive(Debug)]
pub struct CoreClasses<'n> {
    /// The class of each core.
    pub classes: Classes,
    windows: Windows<'n>,
    places: IdVec<CoreId, Place>,
    /// Number of all input channels; `of_copy`: channels of one copy, and its compartments.
    channels: u32,
    of_copy: [u32; 2],
}

impl<'n> CoreClasses<'n> {
    /// Returns the classes of the cores of `copies` copies. Cores with `holds`, which are written,
    /// are in other classes than the rest.
    pub fn new(network: &'n Quantised, partition: &Partition, copies: u32, holds: impl Fn(CoreId) -> bool) -> Self {
        let of_copy = [network.channels(), network.compartments()].map(|units| units / copies.max(1));
        let windows = Windows::new(network, copies);
        let key_and_place = |&core: &CoreId| {
            let held = &partition.members()[core];
            let copy = copy_of(held, of_copy[1]);
            match windows.pattern(held, copy * of_copy[1]) {
                Some((pattern, origins)) => (Common::Pattern(pattern), Place { copy, origins: Some(origins) }),
                None => {
                    let first = copy * of_copy[1];
                    (Common::Members(held.iter().map(|id| id.0 - first).collect()), Place { copy, origins: None })
                }
            }
        };
        let all: Vec<CoreId> = partition.members().ids().collect();
        let mut places = IdVec::new();
        let keyed = all.chunks(CHUNK).flat_map(|chunk| chunk.par_iter().map(key_and_place).collect::<Vec<_>>());
        let classes = Classes::by_key(all.iter().zip(keyed).map(|(&core, (key, place))| {
            places.push(place);
            (holds(core), key)
        }));
        CoreClasses { classes, windows, places, channels: network.channels(), of_copy }
    }

    /// Each core as a separate class.
    #[cfg(test)]
    pub fn apart(network: &'n Quantised, partition: &Partition) -> Self {
        CoreClasses {
            classes: Classes::by_key(0..partition.cores()),
            windows: Windows::new(network, 1),
            places: partition.members().ids().map(|_| Place { copy: 0, origins: None }).collect(),
            channels: network.channels(),
            of_copy: [network.channels(), network.compartments()],
        }
    }

    /// Synapses of a core with these compartments in the order of its lists, and their longest
    /// delay; `None` where other projections than windows reach it.
    pub fn keys(&self, core: CoreId, held: &[CompartmentId], formats: &Formats) -> Option<(Vec<Key>, Delay)> {
        let Place { copy, origins } = &self.places[core];
        origins.as_ref().and_then(|_| self.windows.keys(held, self.of_copy.map(|units| copy * units), formats))
    }

    /// Distances of a core's sources from the sources of the first core of its class, ascending.
    pub fn shifts(&self, core: CoreId) -> Vec<Shift> {
        let [from, to] = [self.classes.first(core), core].map(|core| &self.places[core]);
        let later = i64::from(to.copy) - i64::from(from.copy);
        let all = u32::MAX;
        let [of_channels, of_compartments] = self.of_copy.map(|units| later * i64::from(units));
        let (Some(begin), Some(end)) = (&from.origins, &to.origins) else {
            return vec![(0, self.channels, of_channels), (self.channels, all, of_compartments)];
        };
        let shift = |(begin, end): (&Origin, &Origin)| {
            let (of_copy, more) = match begin.first < self.channels {
                true => (self.of_copy[0], of_channels),
                false => (self.of_copy[1], of_compartments),
            };
            let first = begin.first + from.copy * of_copy;
            (first, first + begin.sources, end.at - begin.at + more)
        };
        let mut shifts: Vec<Shift> = begin.iter().zip(end).map(shift).collect();
        shifts.sort_unstable();
        shifts
    }
}

/// The first copy, of `compartments` compartments each, with any of these compartments.
fn copy_of(held: &[CompartmentId], compartments: u32) -> u32 {
    held.iter().map(|id| id.0 / compartments.max(1)).min().unwrap_or(0)
}
