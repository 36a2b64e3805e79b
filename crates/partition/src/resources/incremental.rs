//! One core while it is being filled, with the present use of every resource by its compartments.
//!
//! Input: compartments one by one. Output: whether the core is still within its limits. The counts
//! equal the counts by [`crate::resources::exact`], except for output axons, which depend on the
//! final cores of targets. For these the caller gives an estimate for each compartment. Adding
//! never lowers a need, so a core that is too full stays too full, and the caller then begins
//! another. (Formats are an exception, and the longest list when a core starts or ends storing
//! runs.)
//!
//! Lists that sources share through population axons ([`crate::resources::axon_sharing`]) are
//! counted only where a core exceeds a limit without them. While a tile is added row by row its
//! lists differ, and only the lists of a whole tile are equal. So compartments that came one by one
//! are counted with separate lists, which is never too little.

use foldhash::{HashMap, HashSet};

use crate::resources::axon_sharing::{self, PlaceClass, Places};
use crate::resources::counter::{CoreTotals, FormatCounts, Profiles};
use crate::resources::fan_in::FanIn;
use crate::resources::fan_out::ALONE;
use crate::resources::formats::{Formats, HeldWords, Kernels, NetworkWords, StoredSynapses, stored_delay};
use crate::resources::packing::{self, Compression, Group, LISTS, MOST_SLOTS, Widths, stored};
use nsim_ir::base::fixed::Delay;
use nsim_ir::base::id::{CompartmentId, PopulationId};
use nsim_ir::base::rng;
use nsim_ir::partition::CoreUsage;
use nsim_ir::quantised::{Neuron, Quantised, Units};
use nsim_ir::resource::{Limits, Resource};

/// A compartment to be added to a core.
#[derive(Debug, Clone, Copy)]
pub struct Newcomer {
    /// Its number in the network.
    pub id: CompartmentId,
    /// Its population.
    pub population: PopulationId,
    /// Its index in its population.
    pub index: u32,
    /// Its parameters.
    pub neuron: Neuron,
    /// Compartments of its neuron.
    pub neuron_size: usize,
    /// Estimate of its output axon slots.
    pub slots_out: u32,
    /// Its group of compartments that share output axons on a core ([`FanOut::together`]).
    ///
    /// [`FanOut::together`]: crate::resources::fan_out::FanOut::together
    pub together: u64,
}

impl Newcomer {
    /// Returns a compartment with no output axons known; `None` where its population has none.
    pub fn new(network: &Quantised, id: CompartmentId) -> Option<Self> {
        let (population, index) = network.population_of(id);
        let Units::Compartments { neurons, .. } = &network.populations()[population].units else { return None };
        let neuron = neurons.get(index);
        Some(Newcomer { id, population, index, neuron, neuron_size: 1, slots_out: 0, together: ALONE })
    }
}

/// Identical input axons of a bundle of sources ([`crate::resources::fan_in`]) so far.
#[derive(Debug, Clone, Copy)]
struct Axon {
    /// Number of these axons.
    bundle: u32,
    /// Its last entry, the head of the linked list of its entries.
    last: Option<u32>,
    /// Words without and with runs.
    words: [u32; 2],
    /// Place of the first of its sources, if it has one.
    placed: Option<PlacedAxon>,
    /// Whether any of its synapses is plastic.
    learns: bool,
}

/// The list of a source that has a place, in a form to compare with others.
#[derive(Debug, Clone, Copy)]
struct PlacedAxon {
    place: u32,
    atom: u16,
    /// Base of the place.
    base: u16,
    /// Digest of its synapses: slots relative to the base, and parts of kernels. Different lists
    /// with equal digests would be detected when the cores are counted exactly.
    digest: u64,
}

impl PlacedAxon {
    fn hash_synapse(&mut self, slot: u16, format: u16, projection: usize, part: u64) {
        let from_base = u64::from(slot - self.base);
        let which = from_base << 48 | u64::from(format) << 32 | projection as u64;
        self.digest = rng::digest(rng::digest(self.digest, which), part);
    }
}

/// The synapses of one format of one axon so far.
#[derive(Debug, Clone, Copy)]
struct Entry {
    axon: u32,
    previous: Option<u32>,
    format: u16,
    last_slot: u16,
    synapses: u32,
    /// Words without and with runs.
    words: [u32; 2],
    delayed: bool,
    dense: bool,
    /// Widest gap between its slots; `None` once a slot repeats.
    gap: Option<u16>,
    /// Compression with runs.
    compression: Compression,
}

impl Entry {
    fn group(&self, formats: &Formats) -> Group {
        let (weight_bits, tag_bits) = (formats.get(self.format).bits, formats.tag_bits(self.format));
        let skip = self.gap.and_then(packing::skip_bits);
        Group { weight_bits, tag_bits, synapses: self.synapses, delayed: self.delayed, dense: self.dense, skip }
    }

    /// Compression without and with runs.
    fn compressions(&self) -> [Compression; LISTS] {
        [if self.dense { Compression::Dense } else { Compression::Sparse }, self.compression]
    }
}

/// Widths and make-up of a group, with its compression and words without and with runs.
type Packed = ((Widths, Group), [(Compression, u32); LISTS]);

/// Input axons by source: a hash table with open addressing. It is small enough to stay in a cache,
/// unlike an array of all sources.
#[derive(Debug)]
struct AxonTable {
    /// Source, its input axon, and the core (by count) for which the slot is valid. Their number is
    /// a power of two, and at most half of them are in use.
    slots: Vec<(u32, u32, u32)>,
    held: usize,
    /// Count of the present core.
    core: u32,
}

impl AxonTable {
    fn new() -> Self {
        AxonTable { slots: vec![(0, 0, 0); 1 << 10], held: 0, core: 1 }
    }

    fn clear(&mut self) {
        (self.core, self.held) = (self.core.wrapping_add(1), 0);
        if self.core == 0 {
            *self = AxonTable::new();
        }
    }

    /// Returns the axon of a source; assigns `next` and returns it if the source had none.
    #[inline]
    fn get_or_insert(&mut self, source: u32, next: u32) -> u32 {
        let mask = self.slots.len() - 1;
        // The upper bits of the product depend on all bits of the source.
        let mut at = (source.wrapping_mul(0x9e37_79b1) >> (u32::BITS - self.slots.len().ilog2())) as usize;
        loop {
            let slot = &mut self.slots[at];
            if slot.2 != self.core {
                *slot = (source, next, self.core);
                self.held += 1;
                if self.held * 2 > self.slots.len() {
                    self.grow();
                }
                return next;
            }
            if slot.0 == source {
                return slot.1;
            }
            at = (at + 1) & mask;
        }
    }

    #[cold]
    fn grow(&mut self) {
        let (more, core) = (2 * self.slots.len(), self.core);
        let before = std::mem::replace(&mut self.slots, vec![(0, 0, 0); more]);
        (self.core, self.held) = (1, 0);
        for (source, axon, _) in before.into_iter().filter(|slot| slot.2 == core) {
            self.get_or_insert(source, axon);
        }
    }
}

/// A core that is being filled.
#[derive(Debug)]
pub struct Filling<'a> {
    fan_in: &'a FanIn,
    limits: &'a Limits,
    formats: Formats,
    delays: Vec<Delay>,
    /// The input axon of each source that has one.
    axon_of: AxonTable,
    members: Vec<CompartmentId>,
    axons: Vec<Axon>,
    entries: Vec<Entry>,
    /// Formats in use without and with runs.
    format_counts: [FormatCounts; LISTS],
    profiles: Profiles,
    widths: Widths,
    /// Synapses, lists and the longest delay so far.
    totals: CoreTotals,
    /// Estimate of output axon slots.
    slots_out: u64,
    /// Groups of compartments that share output axons and are counted already.
    together: HashSet<u64>,
    places: Places,
    /// Stored synapses of compartments, if that resource is limited.
    stored: Option<&'a StoredSynapses>,
    kernels: Kernels,
    /// The network in words, if the limits count them, and the words so far.
    words: Option<&'a NetworkWords>,
    held_words: HeldWords,
    /// The first slot that each place reaches.
    begins: HashMap<u32, u16>,
    /// Whether shared lists are counted where the core exceeds a limit without them.
    shares: bool,
    /// Last group by format, as a cache: consecutive groups mostly have the same make-up.
    last: Vec<Option<Packed>>,
    /// Whether a list became shorter, so that the longest may be too long.
    shortened: bool,
    /// Use of the members, where it is exact.
    used: Option<CoreUsage>,
}

impl<'a> Filling<'a> {
    /// An empty core.
    pub fn new(network: &Quantised, fan_in: &'a FanIn, limits: &'a Limits) -> Self {
        let formats = Formats::for_network(network);
        let places = Places::for_network(network, limits);
        Filling {
            fan_in,
            limits,
            delays: network.projections().iter().map(|p| stored_delay(network, p)).collect(),
            axon_of: AxonTable::new(),
            members: Vec::new(),
            axons: Vec::new(),
            entries: Vec::new(),
            format_counts: std::array::from_fn(|_| FormatCounts::new(formats.len())),
            last: vec![None; formats.len()],
            formats,
            profiles: Profiles::default(),
            widths: Widths::for_core(0, Delay::MIN, limits.packing),
            totals: CoreTotals::new(0, Delay::MIN),
            slots_out: 0,
            together: HashSet::default(),
            stored: fan_in.stored(network, limits),
            kernels: Kernels::new(),
            words: fan_in.words(network, limits),
            held_words: HeldWords::default(),
            begins: HashMap::default(),
            shares: places.are_required(),
            places,
            shortened: false,
            used: None,
        }
    }

    /// Begins another core and returns the compartments of this one.
    pub fn next_core(&mut self) -> Vec<CompartmentId> {
        self.axon_of.clear();
        self.axons.clear();
        self.entries.clear();
        self.format_counts.iter_mut().for_each(FormatCounts::clear);
        self.profiles = Profiles::default();
        self.widths = Widths::for_core(0, Delay::MIN, self.limits.packing);
        (self.totals, self.slots_out) = (CoreTotals::new(0, Delay::MIN), 0);
        self.begins.clear();
        self.together.clear();
        self.kernels.clear();
        self.held_words = HeldWords::default();
        self.shares = self.places.are_required();
        (self.shortened, self.used) = (false, None);
        std::mem::take(&mut self.members)
    }

    /// Number of compartments so far.
    pub fn len(&self) -> usize {
        self.members.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.members.is_empty()
    }

    /// Adds a compartment.
    ///
    /// # Errors
    /// The use of the core with the compartment, when it exceeds a limit. The compartment is no
    /// member then, but the running counts are invalid: begin another core.
    pub fn add(&mut self, newcomer: &Newcomer) -> Result<(), CoreUsage> {
        self.put(newcomer)?;
        match self.holds(newcomer.neuron_size) {
            Ok(used) => {
                self.used = (self.places.is_empty() && !self.shortened).then_some(used);
                Ok(())
            }
            Err(used) => {
                self.members.pop();
                Err(used)
            }
        }
    }

    /// Exact use of the compartments added one by one, without output axons. `None` where lists may
    /// be shared, or have become shorter, because only a new count is exact then.
    pub fn used(&self) -> Option<CoreUsage> {
        self.used
    }

    /// Adds compartments as one unit, such as a tile, whose lists may be shared.
    ///
    /// # Errors
    /// As [`Filling::add`]; begin another core then.
    pub fn add_whole(&mut self, newcomers: impl ExactSizeIterator<Item = Newcomer>) -> Result<(), CoreUsage> {
        let compartments = (self.members.len() + newcomers.len()) as u32;
        if compartments > self.limits[Resource::Compartments].min(MOST_SLOTS) {
            return Err(self.usage().with(Resource::Compartments, compartments.into()));
        }
        self.used = None;
        for newcomer in newcomers {
            self.put(&newcomer)?;
        }
        if self.holds(1).is_err() {
            self.shares = !self.places.is_empty();
        }
        self.holds(1).map(|_| ())
    }

    fn put(&mut self, newcomer: &Newcomer) -> Result<(), CoreUsage> {
        if self.members.len() as u32 >= self.limits[Resource::Compartments].min(MOST_SLOTS) {
            return Err(self.usage().with(Resource::Compartments, self.members.len() as u64 + 1));
        }
        let slot = self.members.len() as u16;
        self.members.push(newcomer.id);
        let fan_in = self.fan_in;
        fan_in.for_each_into(newcomer.population, newcomer.index, |source, projection, part, bundle| {
            if let Some(words) = self.words {
                self.held_words.add_listed(words, (newcomer.population, projection), source);
            }
            let projection = projection.0 as usize;
            self.totals.longest_delay = self.totals.longest_delay.max(self.delays[projection]);
            self.synapse(source, bundle, projection, part, slot);
        });
        let widths = Widths::for_core(self.members.len() as u32, self.totals.longest_delay, self.limits.packing);
        if widths != self.widths {
            self.widths = widths;
            self.recount();
        }
        self.profiles.insert(&newcomer.neuron);
        if let Some(stored) = self.stored {
            self.totals.stored += stored.added(newcomer.population, newcomer.index, &mut self.kernels);
        }
        if let Some(words) = self.words {
            self.held_words.add(words, newcomer.population, newcomer.index);
            self.totals.words = self.held_words.words;
        }
        if newcomer.together == ALONE || self.together.insert(newcomer.together) {
            self.slots_out += u64::from(newcomer.slots_out);
        }
        Ok(())
    }

    /// Use of the members: `Ok` within the limits. The last neuron has `neuron_size` compartments.
    fn holds(&self, neuron_size: usize) -> Result<CoreUsage, CoreUsage> {
        // One neuron alone cannot be split any further; its output axons are checked when its
        // targets have their cores.
        let mut used = self.usage();
        if self.shares && !self.limits.admit(&used.of) {
            used = self.usage_shared();
        }
        let fits = self.limits.admit(&used.of)
            && (self.members.len() <= neuron_size || self.slots_out <= u64::from(self.limits[Resource::AxonsOut]));
        if fits { Ok(used) } else { Err(used) }
    }

    /// Adds a synapse of each source of a bundle.
    fn synapse(&mut self, source: u32, bundle: u32, projection: usize, part: u64, slot: u16) {
        let format = self.formats.by_projection()[projection];
        let next = self.axons.len() as u32;
        let axon_index = self.axon_of.get_or_insert(source, next);
        if axon_index == next {
            let placed = self.places.of_source(source).map(|(place, atom)| {
                let first_slot = *self.begins.entry(place).or_insert(slot);
                PlacedAxon { place, atom, base: axon_sharing::base_of(first_slot, self.limits), digest: 0 }
            });
            self.axons.push(Axon { bundle, last: None, words: [0; 2], placed, learns: false });
            self.totals.lists.iter_mut().for_each(|lists| lists.axons += u64::from(bundle));
        }
        let axon = &mut self.axons[axon_index as usize];
        if self.formats.get(format).is_plastic() && !std::mem::replace(&mut axon.learns, true) {
            self.totals.lists.iter_mut().for_each(|lists| lists.axons += u64::from(bundle));
        }
        if let Some(placed) = &mut axon.placed {
            placed.hash_synapse(slot, format, projection, part);
        }
        let mut of_axon = std::iter::successors(axon.last, |&index| self.entries[index as usize].previous);
        let known = of_axon.find(|&index| self.entries[index as usize].format == format);
        let index = known.unwrap_or_else(|| {
            let index = self.entries.len() as u32;
            let (previous, last_slot) = (axon.last.replace(index), slot);
            let empty = Entry {
                axon: axon_index,
                previous,
                format,
                last_slot,
                synapses: 0,
                words: [0; 2],
                delayed: false,
                dense: true,
                gap: Some(0),
                compression: Compression::Dense,
            };
            self.entries.push(empty);
            index
        });
        let entry = &mut self.entries[index as usize];
        if entry.synapses > 0 {
            for (counts, compression) in self.format_counts.iter_mut().zip(entry.compressions()) {
                counts.remove(format, entry.delayed, compression);
            }
            entry.dense &= slot == entry.last_slot + 1;
            entry.gap = entry.gap.and_then(|gap| Some(gap.max((slot - entry.last_slot).checked_sub(1)?)));
        }
        entry.delayed |= self.delays[projection] > Delay::MIN;
        entry.synapses += 1;
        entry.last_slot = slot;
        let group = entry.group(&self.formats);
        let made = (self.widths, group);
        let last = &mut self.last[usize::from(format)];
        let forms = match *last {
            Some((same, ways)) if same == made => ways,
            _ => last.insert((made, stored(group, self.widths, self.limits))).1,
        };
        entry.compression = forms[1].0;
        for (counts, (compression, _)) in self.format_counts.iter_mut().zip(forms) {
            counts.add(format, entry.delayed, compression);
        }
        let words = forms.map(|(_, words)| words);
        let before = std::mem::replace(&mut entry.words, words);
        for (form, before) in before.into_iter().enumerate() {
            // A change of compression can make a list longer or shorter.
            axon.words[form] = axon.words[form] + entry.words[form] - before;
            self.shortened |= entry.words[form] < before;
            let lists = &mut self.totals.lists[form];
            lists.longest = lists.longest.max(axon.words[form]);
            let [now, before] = [entry.words[form], before].map(|words| u64::from(words) * u64::from(bundle));
            lists.words = lists.words + now - before;
        }
        self.totals.synapses += u64::from(bundle);
    }

    /// Counts all words again, with the changed widths.
    fn recount(&mut self) {
        self.totals.lists.iter_mut().for_each(|lists| (lists.words, lists.longest) = (0, 0));
        self.axons.iter_mut().for_each(|axon| axon.words = [0; LISTS]);
        for entry in &mut self.entries {
            let forms = stored(entry.group(&self.formats), self.widths, self.limits);
            let with_runs = &mut self.format_counts[1];
            with_runs.remove(entry.format, entry.delayed, entry.compression);
            entry.compression = forms[1].0;
            with_runs.add(entry.format, entry.delayed, entry.compression);
            entry.words = forms.map(|(_, words)| words);
            let axon = &mut self.axons[entry.axon as usize];
            for form in 0..LISTS {
                axon.words[form] += entry.words[form];
                self.totals.lists[form].words += u64::from(entry.words[form]) * u64::from(axon.bundle);
            }
        }
        self.shortened = false;
        for (form, lists) in self.totals.lists.iter_mut().enumerate() {
            lists.longest = self.axons.iter().map(|axon| axon.words[form]).max().unwrap_or(0);
        }
    }

    /// Classes of places with equal lists, without and with runs.
    fn classes(&self) -> [Vec<PlaceClass>; LISTS] {
        let mut in_table = vec![[0u32; 2]; self.axons.len()];
        for entry in &self.entries {
            let group = entry.group(&self.formats);
            for (form, compression) in entry.compressions().into_iter().enumerate() {
                in_table[entry.axon as usize][form] +=
                    packing::words_as(group, compression, true, self.widths, self.limits);
            }
        }
        let placed = self.axons.iter().zip(0usize..).filter_map(|(axon, at)| Some((axon.placed?, at)));
        let mut placed: Vec<(PlacedAxon, usize)> = placed.collect();
        placed.sort_unstable_by_key(|(placed, _)| (placed.place, placed.atom));
        let mut classes: [Vec<PlaceClass>; LISTS] = Default::default();
        let mut known: HashMap<Vec<(u16, u64)>, usize> = HashMap::default();
        for of_place in placed.chunk_by(|a, b| a.0.place == b.0.place) {
            let digests = of_place.iter().map(|(placed, _)| (placed.atom, placed.digest)).collect();
            let next = classes[0].len();
            let class = *known.entry(digests).or_insert(next);
            for (form, classes) in classes.iter_mut().enumerate() {
                if class == next {
                    let words = || of_place.iter().map(|&(_, at)| in_table[at][form]);
                    classes.push(PlaceClass {
                        places: 0,
                        lists: of_place.iter().map(|&(_, at)| self.axons[at].bundle).sum(),
                        atoms: of_place.last().map_or(0, |&(placed, at)| placed.atom + self.axons[at].bundle as u16),
                        words: of_place.iter().map(|&(_, at)| self.axons[at].words[form] * self.axons[at].bundle).sum(),
                        list_words: (words().min().unwrap_or(0), words().max().unwrap_or(0)),
                    });
                }
                classes[class].places += 1;
            }
        }
        classes
    }

    fn totals(&self) -> CoreTotals {
        let mut totals = CoreTotals { compartments: self.members.len() as u32, ..self.totals };
        (totals.compartment_profiles, totals.threshold_profiles) = self.profiles.counts();
        for (lists, counts) in totals.lists.iter_mut().zip(&self.format_counts) {
            counts.write(&self.formats, lists);
        }
        totals
    }

    /// Use of the compartments so far with separate lists, without output axons.
    pub fn usage(&self) -> CoreUsage {
        self.totals().usage(self.limits)
    }

    /// Use of the compartments so far with shared lists, without output axons.
    fn usage_shared(&self) -> CoreUsage {
        let mut totals = self.totals();
        for (lists, classes) in totals.lists.iter_mut().zip(self.classes()) {
            lists.share(&classes, self.limits);
        }
        totals.usage(self.limits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::resources::exact::usage;
    use nsim_ir::base::id::IdVec;
    use nsim_ir::partition::seats;
    use nsim_ir::resource::Packing;
    use nsim_testing::{limits, random_network, with_rules};

    /// Use of a core that holds the first `held` of these compartments, counted from its synapses.
    fn exact(network: &Quantised, order: &[CompartmentId], held: usize, limits: &Limits) -> CoreUsage {
        let (held, rest) = order.split_at(held);
        let members: IdVec<_, _> = vec![held.to_vec(), rest.to_vec()].into();
        let seats = seats(network.compartments(), &members).unwrap();
        let used = usage(network, &members, &seats, &vec![0, 0].into(), limits).as_slice()[0];
        used.with(Resource::AxonsOut, 0).with(Resource::AxonsOutPerCompartment, 0)
    }

    #[test]
    fn a_table_of_axons_knows_each_source_once_for_each_core() {
        let mut table = AxonTable::new();
        for core in 0..3 {
            // Distant sources and neighbours, more than there are slots at first.
            let sources: Vec<u32> = (0..3_000).map(|k| if k % 2 == 0 { k } else { k * 65_536 + core }).collect();
            for (next, &source) in (0..).zip(&sources) {
                assert_eq!(table.get_or_insert(source, next), next);
            }
            for (axon, &source) in (0..).zip(&sources) {
                assert_eq!(table.get_or_insert(source, 9_999), axon);
            }
            table.clear();
        }
    }

    #[test]
    fn running_counts_equal_exact_ones_after_any_additions() {
        let (mut compared, mut one_by_one) = (0, 0);
        for seed in 0..80 {
            let static_network = random_network(seed);
            let network = if seed % 4 < 2 { static_network } else { with_rules(static_network, seed) };
            let packing = if seed % 2 == 0 { Packing::Nengo } else { Packing::Nxtf };
            let limits = Limits { packing, ..limits() };
            let mut order: Vec<CompartmentId> = (0..network.compartments()).map(CompartmentId).collect();
            // Filling distinguishes parts of a kernel that happen to have equal weights. So shared
            // lists are compared only for the whole network, in the order of the file.
            let shared = !Places::for_network(&network, &limits).is_empty();
            if !shared {
                order.sort_by_key(|id| rng::digest(seed, u64::from(id.0)));
            }
            let fan_in = FanIn::new(&network);
            let mut filling = Filling::new(&network, &fan_in, &limits);
            for (held, &id) in (1..).zip(&order) {
                filling.add(&Newcomer::new(&network, id).unwrap()).unwrap();
                if let Some(used) = filling.used().filter(|_| held % 5 == 0) {
                    assert_eq!(used, exact(&network, &order, held, &limits), "seed {seed}: {held}, added one by one");
                    one_by_one += 1;
                }
                if held == order.len() || !shared && held % 13 == 0 {
                    assert_eq!(filling.usage_shared(), exact(&network, &order, held, &limits), "seed {seed}: {held}");
                    compared += 1;
                }
            }
        }
        assert!(compared > 100 && one_by_one > 100, "{compared} and {one_by_one} comparisons");
    }
}
