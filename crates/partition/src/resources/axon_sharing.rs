//! Grouping of a core's input axons into population axons, so that a kernel is stored once.
//!
//! Input: the lists of a core. Output: classes of places with equal lists, and the number of places
//! of each class that share one stored table. A *place* is one position of a population over space
//! that is the source of a window (convolution or pooling); its channels are its *atoms*. From one
//! place, a convolution sends to a core a list for each atom; from the next place, the same lists a
//! few slots further on. A population axon represents a place: it has a table and a base that is
//! added to all slots. The table has a list for each atom, and several population axons may share
//! it. The message of a spike carries the atom.
//!
//! Limits of the hardware (nengo-loihi `hardware/builder.py`, `block.py`, `builder/split_blocks.py`
//! and `builder/validate.py`), by the target's rule for output axons ([`OutputAxons`]):
//!
//! | | pop16 | pop32 |
//! |---|---|---|
//! | numbers of axons on a core | 10 bits | 12 bits |
//! | atoms | 32 | 512 (inferred) |
//! | base | multiples of 4 below 256 | below 256 |
//! | slots of an output axon | as a discrete one | one more |
//!
//! - Counted for each position, a population axon is pop16 where its atoms and its base allow it,
//!   pop32 otherwise ([`is_long`]).
//! - Counted for each compartment, all are pop16 in the widest form of nengo-loihi's emulator. An
//!   atom has up to 9 bits; bits beyond five are taken from the ten of the axon's number
//!   ([`most_axons`]).
//! - Where a place begins beyond the range of a base, its lists keep the multiple of 256 in their
//!   slots. It shares only with places of the same multiple, as in nengo-loihi (`conv.py`,
//!   `conv2d_loihi_weights`).
//! - A compartment belongs to one population, so its atom is the same on every core: it is the
//!   channel.
//!
//! A target of dense projections may have more sources than a core has input axons. Such sources
//! are grouped too: up to 512 of them are the atoms of one population axon. Each keeps its own
//! list, so input axons are saved and no words. Only networks with `Parts::gathers`
//! (`nsim map --relays`) are mapped so.
//!
//! A table stores the lists of its atoms at equal distances. NxTF (`nxsdk_modules_ncl/dnn`) pads
//! lists to the longest. Here places whose lists differ in words do not share, so only atoms that
//! send nothing are padded. The entry of a population axon has a single base, so the first slot of
//! a dense group is in the table ([`packing::words_as`]).
//!
//! A class shares when that takes no more words than separate lists, and fewer words or fewer input
//! axons. Classes that save most come first, while there are numbers for population axons.
//! [`crate::resources::exact`] counts by this rule, and `nsim_compile::emit::tables` writes by it.
//! [`crate::resources::incremental`] applies it to whole tiles, and
//! [`crate::resources::closed_form`] to classes from geometry.
//!
//! [`packing::words_as`]: crate::resources::packing::words_as

use std::collections::{BTreeMap, BTreeSet};

use foldhash::HashMap;

use crate::resources::sorted_synapses::{self, Key};
use nsim_ir::base::id::PopulationId;
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::quantised::{Projection, Quantised};
use nsim_ir::resource::{Limits, OutputAxons, Resource};

/// Most bits of an atom.
const MOST_ATOM_BITS: u32 = 9;
/// Bits of an atom that take none from the number of the axon.
const FREE_ATOM_BITS: u32 = 5;
/// Bits of the number of a population axon whose atoms need no more than [`FREE_ATOM_BITS`].
const AXON_BITS: u32 = 10;
/// Bits of the number of a pop32 axon.
const LONG_AXON_BITS: u32 = 12;
/// Bases of pop16 axons are multiples of this.
pub const BASE_STEP: u16 = 4;
/// Bases are below this.
pub const BASE_END: u16 = 256;
/// Most members of population axons and discrete axons of a core of a program.
pub const MOST_NUMBERED: u64 = 1 << 16;
/// Most atoms of a population axon.
pub const MOST_ATOMS: u16 = 1 << MOST_ATOM_BITS;

/// Most pop16 axons of a core whose tables have `atoms` atoms, at most [`MOST_ATOMS`].
pub fn most_axons(atoms: u16) -> u32 {
    let bits = u16::BITS - atoms.saturating_sub(1).leading_zeros();
    1 << (AXON_BITS - bits.clamp(FREE_ATOM_BITS, MOST_ATOM_BITS) + FREE_ATOM_BITS)
}

/// Most population axons of a core: short ones (pop16), and all together.
pub fn numbers(most_atoms: u16, limits: &Limits) -> (u32, u32) {
    match limits.output_axons {
        OutputAxons::PerCompartment => (most_axons(most_atoms), most_axons(most_atoms)),
        OutputAxons::PerPosition { .. } => (1 << AXON_BITS, 1 << LONG_AXON_BITS),
    }
}

/// Whether a population axon is a pop32 axon.
#[inline]
pub fn is_long(atoms: u16, base: u16, limits: &Limits) -> bool {
    match limits.output_axons {
        OutputAxons::PerCompartment => false,
        OutputAxons::PerPosition { atoms: of_short, .. } => atoms > of_short || !base.is_multiple_of(BASE_STEP),
    }
}

/// The base of a place whose lists begin at `first_slot`.
#[inline]
pub fn base_of(first_slot: u16, limits: &Limits) -> u16 {
    let base = first_slot % BASE_END;
    match limits.output_axons {
        OutputAxons::PerCompartment => base / BASE_STEP * BASE_STEP,
        OutputAxons::PerPosition { .. } => base,
    }
}

/// A population whose sources have places.
#[derive(Debug, Clone, Copy)]
struct Spatial {
    /// Its first source; `end` is one past the last.
    first: u32,
    end: u32,
    /// Number of positions of a channel.
    positions: u32,
    /// The number of its first place.
    place: u32,
}

/// The places of a network's sources.
#[derive(Debug, Clone, Default)]
pub struct Places {
    populations: Vec<Spatial>,
    /// Whether compartments have places, and not only input channels.
    of_compartments: bool,
    /// Whether any place exists because there are too few input axons.
    required: bool,
}

fn is_dense(projection: &Projection) -> bool {
    matches!(projection.connectivity, Connectivity::Dense { .. })
}

/// Populations whose dense projections have more sources than a core has input axons, where such
/// sources are grouped into population axons. Each source keeps its own list, so only input axons
/// are saved.
fn crowded_targets(network: &Quantised, limits: Option<&Limits>) -> BTreeSet<PopulationId> {
    let per_position = |limits: &&Limits| matches!(limits.output_axons, OutputAxons::PerPosition { .. });
    let Some(limits) = limits.filter(per_position).filter(|_| network.parts().gathers) else { return BTreeSet::new() };
    let mut sources: BTreeMap<PopulationId, u64> = BTreeMap::new();
    for projection in network.projections().iter().filter(|projection| is_dense(projection)) {
        *sources.entry(projection.target).or_default() +=
            u64::from(network.populations()[projection.source].shape.len());
    }
    let too_many = u64::from(limits[Resource::AxonsIn]) + 1..=MOST_NUMBERED;
    sources.into_iter().filter(|(_, sources)| too_many.contains(sources)).map(|(target, _)| target).collect()
}

impl Places {
    /// Returns the places of all populations over space that are sources of windows. Where the
    /// network and the limits allow it, sources of a dense projection have places too if its target
    /// has more sources than a core has input axons.
    pub fn for_network(network: &Quantised, limits: &Limits) -> Self {
        Places::with_limits(network, Some(limits))
    }

    /// Returns the places of all populations over space that are sources of windows.
    pub fn of_windows(network: &Quantised) -> Self {
        Places::with_limits(network, None)
    }

    fn with_limits(network: &Quantised, limits: Option<&Limits>) -> Self {
        let mut places = Places::default();
        let mut next = 0;
        let crowded = crowded_targets(network, limits);
        for (id, population) in network.populations().enumerate() {
            let mut outgoing = network.outgoing(id).iter().map(|&p| &network.projections()[p]);
            let sends = outgoing.clone().any(|p| p.connectivity.window().is_some());
            let is_grouped = !crowded.is_empty()
                && outgoing.clone().all(is_dense)
                && outgoing.any(|projection| crowded.contains(&projection.target));
            if network.outgoing(id).iter().any(|&p| network.projections()[p].format.is_plastic()) {
                // Each source's synapses change on their own.
                continue;
            }
            let positions = match population.shape.volume() {
                Some((channels, height, width)) if sends && channels <= MOST_ATOMS.into() => height * width,
                _ if is_grouped => {
                    places.required = true;
                    population.shape.len().div_ceil(MOST_ATOMS.into())
                }
                _ => continue,
            };
            let first = network.first_source(population);
            places.populations.push(Spatial { first, end: first + population.shape.len(), positions, place: next });
            next += positions;
            places.of_compartments |= population.first_compartment().is_some();
        }
        places.populations.sort_unstable_by_key(|population| population.first);
        places
    }

    /// Whether any place exists because a compartment has more sources than a core has input axons.
    pub fn are_required(&self) -> bool {
        self.required
    }

    /// Number of places of a population's sources, if any.
    pub fn positions(&self, network: &Quantised, population: PopulationId) -> Option<u32> {
        let first = network.first_source(&network.populations()[population]);
        self.populations.iter().find(|population| population.first == first).map(|population| population.positions)
    }

    /// Whether no source has a place.
    pub fn is_empty(&self) -> bool {
        self.populations.is_empty()
    }

    /// Whether compartments have places, and not only input channels.
    pub fn are_of_compartments(&self) -> bool {
        self.of_compartments
    }

    /// Whether the sources of a population have places.
    pub fn contain(&self, network: &Quantised, population: PopulationId) -> bool {
        self.of_source(network.first_source(&network.populations()[population])).is_some()
    }

    /// The place and the atom of a source.
    #[inline]
    pub fn of_source(&self, source: u32) -> Option<(u32, u16)> {
        let at = self.populations.partition_point(|population| population.end <= source);
        let population = self.populations.get(at).filter(|population| population.first <= source)?;
        let index = source - population.first;
        Some((population.place + index % population.positions, (index / population.positions) as u16))
    }
}

/// Places whose lists are equal relative to their bases, and the words of one of them. A core has
/// such classes for lists without runs, and for lists with runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct PlaceClass {
    /// Number of places.
    pub places: u32,
    /// Lists of a place: one for each source there that reaches the core.
    pub lists: u32,
    /// The highest atom + 1.
    pub atoms: u16,
    /// Words of a place's lists as lists of discrete axons.
    pub words: u32,
    /// The fewest and the most words that one of its lists takes in a table.
    pub list_words: (u32, u32),
}

impl PlaceClass {
    /// Words of its table.
    pub fn table(&self) -> u64 {
        u64::from(self.atoms) * u64::from(self.list_words.1)
    }

    /// Words that `places` places save by sharing; negative where the table takes more.
    pub fn saving(&self, places: u32) -> i64 {
        (u64::from(places) * u64::from(self.words)) as i64 - self.table() as i64
    }

    fn pays(&self, places: u32, limits: &Limits) -> bool {
        let saving = self.saving(places);
        places > 0
            && self.list_words.0 == self.list_words.1
            && self.list_words.1 <= limits[Resource::SynapseWordsPerAxon]
            && (saving > 0 || saving == 0 && self.lists > 1)
    }
}

/// Number of places of each class that share its table.
pub fn sharing(classes: &[PlaceClass], limits: &Limits) -> Vec<u32> {
    let most_atoms = classes.iter().map(|class| class.atoms).max().unwrap_or(1);
    let (mut short, mut left) = numbers(most_atoms, limits);
    // A class whose axons may be short counts as short, regardless of its bases.
    let may_be_short = |class: &PlaceClass| !is_long(class.atoms, 0, limits);
    let mut order: Vec<usize> = (0..classes.len()).collect();
    // Classes with equal fields are interchangeable, so counts do not depend on the input order.
    order.sort_by_key(|&at| std::cmp::Reverse((classes[at].saving(classes[at].places), classes[at])));
    let mut sharing = vec![0; classes.len()];
    for at in order {
        let places = classes[at].places.min(if may_be_short(&classes[at]) { left.min(short) } else { left });
        if classes[at].pays(places, limits) {
            sharing[at] = places;
            left -= places;
            if may_be_short(&classes[at]) {
                short -= places;
            }
        }
    }
    sharing
}

/// A place on a core.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EqualPlace {
    /// Number of the place.
    pub place: u32,
    /// Base of the place, below [`BASE_END`].
    pub base: u16,
    /// Atom and number of each of its lists, by atom.
    pub lists: Vec<(u16, u32)>,
}

/// Places of a core whose lists are equal relative to their bases; ascending, at least one.
pub type EqualPlaces = Vec<EqualPlace>;

impl EqualPlace {
    /// The highest atom + 1.
    pub fn atoms(&self) -> u16 {
        self.lists.last().map_or(0, |&(atom, _)| atom + 1)
    }
}

/// Classes of the places of a core, from its synapses, in the order of their first places.
pub fn equal_places(keys: &[Key], places: &Places, limits: &Limits) -> Vec<EqualPlaces> {
    let lists: Vec<&[Key]> = sorted_synapses::lists(keys).collect();
    let placed = lists.iter().zip(0u32..).filter_map(|(list, number)| {
        let (place, atom) = places.of_source(list[0].source())?;
        Some((place, atom, number))
    });
    let mut placed: Vec<(u32, u16, u32)> = placed.collect();
    placed.sort_unstable();
    let (mut classes, mut known): (Vec<EqualPlaces>, HashMap<Vec<u64>, usize>) = (Vec::new(), HashMap::default());
    for of_place in placed.chunk_by(|a, b| a.0 == b.0) {
        let of = |&(_, _, number): &(u32, u16, u32)| lists[number as usize];
        let first_slot = of_place.iter().flat_map(of).map(|key| key.slot()).min();
        let base = base_of(first_slot.unwrap_or(0), limits);
        // Two lists are distinguished by their atoms, so concatenations of different lists differ.
        let key = of_place.iter().flat_map(|placed| of(placed).iter().map(|k| k.relative_to(placed.1, base))).collect();
        let class = *known.entry(key).or_insert_with(|| {
            classes.push(Vec::new());
            classes.len() - 1
        });
        let lists = of_place.iter().map(|&(_, atom, number)| (atom, number)).collect();
        classes[class].push(EqualPlace { place: of_place[0].0, base, lists });
    }
    classes
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::graph::{Shape, Window};
    use nsim_ir::quantised::Parts;
    use nsim_testing::{Builder, limits, plain_format};

    const CLASS: PlaceClass = PlaceClass { places: 9, lists: 16, atoms: 16, words: 32, list_words: (2, 2) };

    #[test]
    fn numbers_and_bases_are_those_of_pop16_axons() {
        // nengo-loihi: ten bits for up to 32 atoms, then one fewer for each bit of the atom, nine
        // at most.
        assert_eq!(
            [1, 2, 32, 33, 64, 65, 256, 257, 512].map(most_axons),
            [1024, 1024, 1024, 512, 512, 256, 128, 64, 64]
        );
        let by_compartment = Limits { output_axons: OutputAxons::PerCompartment, ..limits() };
        let bases = |limits: &Limits| [0, 3, 4, 7, 252, 255, 256, 1023].map(|slot| base_of(slot, limits));
        assert_eq!(bases(&by_compartment), [0, 0, 4, 4, 252, 252, 0, 252]);
        assert_eq!(bases(&limits()), [0, 3, 4, 7, 252, 255, 0, 255]);
        assert_eq!([(32, 4), (33, 4), (32, 5)].map(|(a, b)| is_long(a, b, &limits())), [false, true, true]);
        assert!(!is_long(512, 3, &by_compartment));
        assert_eq!((numbers(512, &limits()), numbers(512, &by_compartment)), ((1024, 4096), (64, 64)));
    }

    #[test]
    fn what_saves_most_shares_while_there_are_numbers() {
        let limits = limits();
        assert_eq!(sharing(&[CLASS], &limits), [9]);
        assert_eq!(sharing(&[CLASS], &limits.clone().with(Resource::SynapseWordsPerAxon, 1)), [0]);
        assert_eq!(sharing(&[PlaceClass { list_words: (1, 2), ..CLASS }], &limits), [0]);
        // A class of one place pays by fewer axons, unless a table takes more words.
        assert_eq!(sharing(&[PlaceClass { places: 1, ..CLASS }], &limits), [1]);
        assert_eq!(sharing(&[PlaceClass { places: 1, words: 31, ..CLASS }], &limits), [0]);
        assert_eq!(
            sharing(&[PlaceClass { places: 1, lists: 1, atoms: 1, words: 2, list_words: (2, 2) }], &limits),
            [0]
        );
        // 512 atoms leave 64 numbers: the class that saves more takes 60 of them.
        let wide = PlaceClass { places: 60, lists: 512, atoms: 512, words: 1024, list_words: (2, 2) };
        assert_eq!(sharing(&[PlaceClass { places: 10, ..wide }, wide], &limits), [10, 60]);
        let by_compartment = Limits { output_axons: OutputAxons::PerCompartment, ..limits.clone() };
        assert_eq!(sharing(&[PlaceClass { places: 10, ..wide }, wide], &by_compartment), [4, 60]);
        // 1,024 numbers of short axons, 4,096 of all.
        let many = [
            PlaceClass { places: 1020, ..CLASS },
            PlaceClass { places: 5, ..CLASS },
            PlaceClass { places: 4000, ..wide },
        ];
        assert_eq!(sharing(&many, &limits), [96, 0, 4000]);
        assert_eq!(sharing(&[many[0], many[1], wide], &limits), [1020, 4, 60]);
    }

    #[test]
    fn sources_are_gathered_only_where_input_axons_are_too_few() {
        let mut net = Builder::new();
        let (wide, out) = (net.input("wide", 2_000), net.loihi("out", 4));
        net.dense(wide, out, |s, t| ((s + t) % 60) as i16 * 2);
        let network = net.build();
        assert!(Places::for_network(&network, &limits().with(Resource::AxonsIn, 9)).is_empty(), "unless it is allowed");
        let network = Quantised::new(Parts { gathers: true, ..network.parts().clone() }).unwrap();
        let places = |axons| Places::for_network(&network, &limits().with(Resource::AxonsIn, axons));
        assert!(places(2_000).is_empty());
        let required = places(1_999);
        assert!(required.are_required() && !required.are_of_compartments());
        assert_eq!(required.positions(&network, PopulationId(0)), Some(4));
        assert_eq!(required.of_source(1_999), Some((3, 499)));
        let by_compartment = Limits { output_axons: OutputAxons::PerCompartment, ..limits() };
        assert!(Places::for_network(&network, &by_compartment.with(Resource::AxonsIn, 9)).is_empty());
    }

    #[test]
    fn places_are_positions_and_atoms_channels() {
        let mut net = Builder::new();
        let flat = net.input("flat", 7);
        let image = net.input_shape("image", Shape::Volume(3, 4, 5));
        let to = net.loihi_with("to", Shape::Volume(1, 4, 5), nsim_testing::neurons());
        net.dense(flat, to, |_, _| 2);
        let (source, target) = ((3, 4, 5), (1, 4, 5));
        let once = (1, 1);
        let window = Window { source, target, kernel: once, stride: once, padding: (0, 0), dilation: once, groups: 1 };
        net.connect(image, to, plain_format(), 0, Connectivity::Conv2d { window, kernel: vec![2, 4, 6].into() });
        let places = Places::for_network(&net.build(), &limits());
        assert_eq!(places.of_source(6), None);
        assert_eq!(places.of_source(7), Some((0, 0)));
        assert_eq!(places.of_source(7 + 20 + 3), Some((3, 1)));
        assert_eq!(places.of_source(7 + 59), Some((19, 2)));
        // The compartments send nothing over a window.
        assert_eq!(places.of_source(7 + 60), None);
    }
}
