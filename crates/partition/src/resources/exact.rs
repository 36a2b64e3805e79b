//! Resource use of each core of a given membership, counted from its synapses.
//!
//! Input: a network, the compartments of each core in slot order and the chip of each core. Output:
//! a [`CoreUsage`] for each core, by the rules of [`counter`](crate::resources::counter). It is the
//! use of the tables that `nsim_compile::emit::tables` writes. Limits are not checked.

use crate::resources::axon_sharing::{self, EqualPlace, EqualPlaces, PlaceClass, Places};
use crate::resources::counter::{CoreTotals, ListCounter, ListTotals, Profiles, Words, skip_bits_for};
use crate::resources::fan_in::FanIn;
use crate::resources::fan_out::{self, ChipOf, FanOut, Members, MembersOfCores, SharedPlaces};
use crate::resources::formats::{CoreWords, Formats, HeldWords, NetworkWords, StoredSynapses, stored_delay};
use crate::resources::packing::{Group, LISTS, Widths};
use crate::resources::sorted_synapses::{self, Key, Seats};
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::fixed::Delay;
use nsim_ir::base::id::{CompartmentId, CoreId, Id, IdVec, PopulationId};
use nsim_ir::partition::CoreUsage;
use nsim_ir::quantised::{Quantised, Units};
use nsim_ir::resource::{Limits, Resource};

/// Resource use of each core.
pub type Usages = IdVec<CoreId, CoreUsage>;

/// Longest delay of a synapse into each core, over the source populations with `counts`.
pub fn longest_delays(
    network: &Quantised,
    seats: &Seats,
    cores: usize,
    counts: impl Fn(PopulationId) -> bool,
) -> IdVec<CoreId, Delay> {
    let mut longest: IdVec<CoreId, Delay> = vec![Delay::MIN; cores].into();
    for projection in network.projections().iter().filter(|p| counts(p.source)) {
        let delay = stored_delay(network, projection);
        if delay == Delay::MIN {
            continue;
        }
        let Some(first) = network.populations()[projection.target].first_compartment() else { continue };
        for source in 0..network.populations()[projection.source].shape.len() {
            projection.connectivity.for_each_target(source, |target| {
                let core = seats[CompartmentId(first.0 + target)].core;
                longest[core] = longest[core].max(delay);
            });
        }
    }
    longest
}

/// Resource use of each core.
///
/// # Panics
/// When `seats` and `members` differ or `chips` is shorter than `members`: a mistake of the caller.
pub fn usage(network: &Quantised, members: &Members, seats: &Seats, chips: &ChipOf, limits: &Limits) -> Usages {
    let places = Places::for_network(network, limits);
    let (used, shared) = unzipped(uses(network, members, seats, limits, &places, |_| true));
    let shared = SharedPlaces { places: &places, members: &shared };
    let shared = fan_out::by_position(&places, limits).then_some(&shared);
    let core_of = seats.iter().map(|seat| seat.core).collect();
    with_fan_out(used, members, &fan_out::network_fan_out(network, &core_of, chips, limits, shared))
}

/// Resource use of each core, from its use without output axons and the fan-out.
pub fn with_fan_out(usage: impl IntoIterator<Item = CoreUsage>, members: &Members, fan_out: &FanOut) -> Usages {
    let of_core = |(used, held): (CoreUsage, &Vec<CompartmentId>)| {
        let most = held.iter().map(|id| fan_out.axons[id.index()]).max().unwrap_or(0);
        let slots = fan_out::slots_of_core(held, fan_out);
        used.with(Resource::AxonsOut, slots).with(Resource::AxonsOutPerCompartment, most.into())
    };
    usage.into_iter().zip(members).map(of_core).collect()
}

/// Use of a core without its output axons, and the places that are members of its population axons.
/// Both depend only on the compartments of the core and their order.
#[derive(Debug, Clone, Default)]
pub struct CoreUse {
    /// The use.
    pub usage: CoreUsage,
    /// The places, ascending, and whether the population axon of each is a pop32 axon.
    pub shared: Vec<(u32, bool)>,
}

/// Splits the results into uses and places.
pub fn unzipped(uses: Vec<CoreUse>) -> (Vec<CoreUsage>, MembersOfCores) {
    let (usage, shared): (_, Vec<_>) = uses.into_iter().map(|core| (core.usage, core.shared)).unzip();
    (usage, shared.into())
}

/// Use of each wanted core; the default for all others.
///
/// # Panics
/// As [`usage`].
pub fn uses(
    network: &Quantised,
    members: &Members,
    seats: &Seats,
    limits: &Limits,
    places: &Places,
    wanted: impl Fn(CoreId) -> bool + Sync,
) -> Vec<CoreUse> {
    let longest = longest_delays(network, seats, members.len(), |_| true);
    let profiles = profiles(network, seats, members.len());
    let formats = Formats::for_network(network);
    let stored = limits.is_limited(Resource::StoredSynapses).then(|| StoredSynapses::for_network(network));
    let words = NetworkWords::new(network, limits);
    let listed = words.as_ref().filter(|words| words.any_listed()).map(|_| FanIn::new(network));
    let every = |_| true;
    sorted_synapses::by_core(network, &formats, seats, members.len(), every, &wanted, |core, keys| {
        if !wanted(core) {
            return CoreUse::default();
        }
        let held = &members[core];
        let mut totals = CoreTotals::new(held.len() as u32, longest[core]);
        let widths = Widths::for_core(totals.compartments, longest[core], limits.packing);
        let lists = StoredLists::new(keys, &formats, widths, limits, places);
        totals.lists = lists.totals;
        totals.synapses = keys.len() as u64;
        (totals.compartment_profiles, totals.threshold_profiles) = profiles[core].counts();
        totals.stored = stored.as_ref().map_or(0, |stored| stored.of_core(network, held));
        totals.words = words.as_ref().map_or_else(Default::default, |of| words_of(of, network, listed.as_ref(), held));
        CoreUse { usage: totals.usage(limits), shared: lists.members(limits) }
    })
}

/// Words of a core of these compartments; listed synapses are counted by the index of the network.
fn words_of(words: &NetworkWords, network: &Quantised, listed: Option<&FanIn>, held: &[CompartmentId]) -> CoreWords {
    let mut core = HeldWords::default();
    for &id in held {
        let (population, index) = network.population_of(id);
        core.add(words, population, index);
        if let Some(listed) = listed {
            listed.for_each_into(population, index, |source, projection, _, _| {
                core.add_listed(words, (population, projection), source);
            });
        }
    }
    core.words
}

/// The profiles of each core.
fn profiles(network: &Quantised, seats: &Seats, cores: usize) -> IdVec<CoreId, Profiles> {
    let mut profiles: IdVec<CoreId, Profiles> = vec![Profiles::default(); cores].into();
    for population in network.populations() {
        let Units::Compartments { first, neurons, .. } = &population.units else { continue };
        for index in 0..population.shape.len() {
            profiles[seats[CompartmentId(first.0 + index)].core].insert(&neurons.get(index));
        }
    }
    profiles
}

/// The lists of a core, stored without and with runs.
#[derive(Debug, Clone, Default)]
pub struct StoredLists {
    /// Their totals.
    pub totals: [ListTotals; LISTS],
    /// Classes of places with equal lists.
    equal: Vec<EqualPlaces>,
    /// Number of places of each class that share its table.
    sharing: [Vec<u32>; LISTS],
}

impl StoredLists {
    /// Counts the lists of a core from its synapses.
    pub fn new(keys: &[Key], formats: &Formats, widths: Widths, limits: &Limits, places: &Places) -> Self {
        let mut counter = ListCounter::new(formats, widths, limits);
        // Consecutive groups mostly have the same make-up.
        let mut last: Option<((u16, Group), [Words; LISTS])> = None;
        let mut of_lists: Vec<[Words; LISTS]> = Vec::new();
        for list in sorted_synapses::lists(keys) {
            let mut of_list = [Words::default(); LISTS];
            for group in sorted_synapses::groups(list) {
                let (format, group) = group_of(group, formats);
                let words = match last {
                    Some((last, words)) if last == (format, group) => words,
                    _ => last.insert(((format, group), counter.group(format, group))).1,
                };
                for (of_list, words) in of_list.iter_mut().zip(words) {
                    of_list.discrete += words.discrete;
                    of_list.in_table += words.in_table;
                }
            }
            counter.lists(1, of_list);
            if list.iter().any(|key| formats.get(key.format()).is_plastic()) {
                counter.learning(1);
            }
            if !places.is_empty() {
                of_lists.push(of_list);
            }
        }
        let mut lists = StoredLists { totals: counter.totals(), ..Self::default() };
        if !places.is_empty() {
            lists.equal = axon_sharing::equal_places(keys, places, limits);
            for (form, totals) in lists.totals.iter_mut().enumerate() {
                let class = |equal: &EqualPlaces| {
                    let lists = &equal[0].lists;
                    let words = || lists.iter().map(|&(_, number)| of_lists[number as usize][form]);
                    PlaceClass {
                        places: equal.len() as u32,
                        lists: lists.len() as u32,
                        atoms: equal[0].atoms(),
                        words: words().map(|words| words.discrete).sum(),
                        list_words: words()
                            .map(|words| words.in_table)
                            .fold((u32::MAX, 0), |(least, most), words| (least.min(words), most.max(words))),
                    }
                };
                let classes: Vec<PlaceClass> = lists.equal.iter().map(class).collect();
                lists.sharing[form] = totals.share(&classes, limits);
            }
        }
        lists
    }

    /// Whether the core stores runs.
    pub fn stores_runs(&self, limits: &Limits) -> bool {
        CoreTotals { lists: self.totals, ..CoreTotals::new(0, Delay::MIN) }.stores_runs(limits)
    }

    /// Member places of population axons, ascending, and whether each axon is a pop32 axon.
    fn members(&self, limits: &Limits) -> Vec<(u32, bool)> {
        let of_class = |(equal, sharing): (&EqualPlaces, u32)| {
            let atoms = equal[0].atoms();
            let long = |place: &EqualPlace| (place.place, axon_sharing::is_long(atoms, place.base, limits));
            equal[..sharing as usize].iter().map(long).collect::<Vec<_>>()
        };
        let mut members: Vec<(u32, bool)> = self.shared(limits).flat_map(of_class).collect();
        members.sort_unstable();
        members
    }

    /// Classes of places, with the number of places that share a table, as the core stores them.
    pub fn shared(&self, limits: &Limits) -> impl Iterator<Item = (&EqualPlaces, u32)> {
        self.equal.iter().zip(self.sharing[usize::from(self.stores_runs(limits))].iter().copied())
    }
}

/// Format of a group, and its make-up.
pub fn group_of(group: &[Key], formats: &Formats) -> (u16, Group) {
    let format = group[0].format();
    let made = Group {
        weight_bits: formats.get(format).bits,
        tag_bits: formats.tag_bits(format),
        synapses: group.len() as u32,
        delayed: formats.moves_delays(format) || group.iter().any(|key| key.delay() > 0),
        dense: group.windows(2).all(|pair| pair[1].slot() == pair[0].slot() + 1),
        skip: skip_bits_for(group.windows(2).map(|pair| pair[1].slot() - pair[0].slot())),
    };
    (format, made)
}
