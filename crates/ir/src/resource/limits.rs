//! The limits of a core, and the pools that its resources share.
//!
//! Input: the `limits` of a chip file. Output: [`Limits`]: a limit for each [`Resource`], the
//! shared pools, and the rules by which axons and synapses use them. Invariants: every resource has
//! its own limit, or one from its pools, or is listed as unlimited. Errors: a resource with none of
//! these; a pool that no resource uses.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::ops::{Index, IndexMut};
use std::sync::Arc;

use serde::de::{Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::table::{PerResource, Resource, resources};
use crate::neurons::{Family, NeuronKind};

/// How synapse words are counted (`docs/formats.md`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
pub enum Packing {
    /// nengo-loihi `builder/validate.py`.
    Nengo,
    /// Intel NxTF.
    Nxtf,
    /// Intel's compiler for Loihi 2: a list for each input axon, kernels once a core.
    Kernels {
        /// Bits of a synapse besides its weight.
        synapse_bits: u32,
        /// Bits of a list besides its synapses.
        list_bits: u32,
    },
}

/// Words of a neuron, by its kind.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct NeuronSizes {
    /// Kinds of which a neuron takes one word.
    pub one_word: Vec<Family>,
    /// Words of a neuron of any other kind, besides its state.
    pub program: u32,
    /// Words for each word of its state.
    pub state_word: u32,
}

impl NeuronSizes {
    /// Words of a neuron of this kind, at least 1.
    pub fn words_of(&self, kind: NeuronKind) -> u32 {
        match self.one_word.contains(&kind.family()) {
            true => 1,
            false => (self.program + self.state_word * kind.table().state.len() as u32).max(1),
        }
    }
}

/// Rule that counts output axons. A population axon of a core serves the sources at one position
/// (its atoms).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
pub enum OutputAxons {
    /// One output axon for each compartment and destination core.
    #[default]
    PerCompartment,
    /// One output axon for each destination core and position, if the position's compartments on
    /// the core send to the same population axons only. Otherwise as
    /// [`OutputAxons::PerCompartment`].
    PerPosition {
        /// The most atoms of a population axon that takes the slots of a discrete axon (pop16); its
        /// base is a multiple of 4.
        atoms: u16,
        /// Additional slots of an output axon to any other population axon (pop32).
        more_slots: u32,
    },
}

macro_rules! define_limits {
    ($($(#[$doc:meta])* $resource:ident, $name:ident: $code:literal, $heading:expr, $noun:literal, $advice:expr;)*) => {
        impl Limits {
            /// The names of all limits, as files write them.
            pub const NAMES: [&str; Resource::COUNT + 6] = [
                $(stringify!($name),)*
                "axon_out_slots",
                "axon_out_slots_off_chip",
                "output_axons",
                "synapses_per_entry",
                "packing",
                "neuron_sizes",
            ];
        }

        /// Serialised form of [`Limits`].
        #[derive(Deserialize, Serialize)]
        #[serde(deny_unknown_fields, rename = "Limits")]
        struct LimitsInFile {
            $(#[serde(default = "not_given", skip_serializing_if = "is_not_given")] $name: u32,)*
            axon_out_slots: Option<u32>,
            axon_out_slots_off_chip: Option<u32>,
            #[serde(default)]
            output_axons: OutputAxons,
            synapses_per_entry: Option<u32>,
            packing: Option<Packing>,
            #[serde(default, skip_serializing_if = "is_default")]
            neuron_sizes: NeuronSizes,
            #[serde(default, skip_serializing_if = "Vec::is_empty")]
            unlimited: Vec<Resource>,
            #[serde(default, skip_serializing_if = "Vec::is_empty")]
            pools: Vec<Pool>,
        }

        /// Changes of limits; `None` leaves a limit unchanged.
        #[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
        #[serde(deny_unknown_fields, rename = "Limits")]
        pub struct LimitChanges {
            $($(#[$doc])* pub $name: Option<u32>,)*
            /// Slots that an output axon takes when its target is on the same chip.
            pub axon_out_slots: Option<u32>,
            /// Slots that an output axon takes when its target is on another chip.
            pub axon_out_slots_off_chip: Option<u32>,
            /// Rule that counts output axons.
            pub output_axons: Option<OutputAxons>,
            /// Synapses of one entry of a list, 1 to 64.
            pub synapses_per_entry: Option<u32>,
            /// Rule that counts synapse words.
            pub packing: Option<Packing>,
            /// Words of a neuron by its kind.
            pub neuron_sizes: Option<NeuronSizes>,
            /// Limits of pools by their names.
            #[serde(default, deserialize_with = "by_name")]
            pub pools: BTreeMap<String, u64>,
        }

        impl LimitChanges {
            /// Returns the limits with these changes. A resource whose limit came from a pool
            /// follows the pool.
            pub fn applied(&self, mut limits: Limits) -> Limits {
                let before = limits.pools.clone();
                for pool in &mut limits.pools {
                    if let Some(&limit) = self.pools.get(&pool.name) {
                        *pool = Arc::new(Pool { limit, ..Pool::clone(pool) });
                    }
                }
                for resource in Resource::ALL {
                    let old = most_by_pools(before.iter().map(Arc::as_ref), resource);
                    let most = &mut limits.most[resource];
                    let own = if *most == old { UNLIMITED } else { *most };
                    *most = most_by_pools(limits.pools.iter().map(Arc::as_ref), resource).min(own);
                }
                $(if let Some(most) = self.$name {
                    limits.most[Resource::$resource] = most;
                })*
                limits.axon_out_slots = self.axon_out_slots.unwrap_or(limits.axon_out_slots);
                limits.axon_out_slots_off_chip =
                    self.axon_out_slots_off_chip.unwrap_or(limits.axon_out_slots_off_chip);
                limits.output_axons = self.output_axons.unwrap_or(limits.output_axons);
                limits.synapses_per_entry = self.synapses_per_entry.unwrap_or(limits.synapses_per_entry);
                limits.packing = self.packing.unwrap_or(limits.packing);
                limits.neuron_sizes = self.neuron_sizes.clone().unwrap_or(limits.neuron_sizes);
                limits
            }

            /// Whether the limit of this name is changed.
            pub fn changes(&self, name: &str) -> bool {
                let changed = [
                    $((stringify!($name), self.$name.is_some()),)*
                    ("axon_out_slots", self.axon_out_slots.is_some()),
                    ("axon_out_slots_off_chip", self.axon_out_slots_off_chip.is_some()),
                    ("output_axons", self.output_axons.is_some()),
                    ("synapses_per_entry", self.synapses_per_entry.is_some()),
                    ("packing", self.packing.is_some()),
                    ("neuron_sizes", self.neuron_sizes.is_some()),
                ];
                changed.contains(&(name, true)) || self.pools.contains_key(name)
            }
        }

        impl LimitsInFile {
            fn own(&self) -> PerResource<u32> {
                PerResource([$(self.$name,)*])
            }
        }

        impl From<Limits> for LimitsInFile {
            fn from(limits: Limits) -> Self {
                LimitsInFile {
                    $($name: limits.most[Resource::$resource],)*
                    axon_out_slots: Some(limits.axon_out_slots),
                    axon_out_slots_off_chip: Some(limits.axon_out_slots_off_chip),
                    output_axons: limits.output_axons,
                    synapses_per_entry: Some(limits.synapses_per_entry),
                    packing: Some(limits.packing),
                    neuron_sizes: limits.neuron_sizes,
                    unlimited: Resource::ALL
                        .into_iter()
                        .filter(|&resource| limits.most[resource] == UNLIMITED)
                        .filter(|one| match one {
                            Resource::StoredSynapses => limits.most[Resource::SynapseWords] == UNLIMITED,
                            one => !OPTIONAL.contains(one),
                        })
                        .collect(),
                    pools: limits.pools.into_iter().map(Arc::unwrap_or_clone).collect(),
                }
            }
        }
    };
}

resources!(define_limits);

/// Resources that need no limit, because few chips have them.
const OPTIONAL: [Resource; 6] = [
    Resource::StoredSynapses,
    Resource::NeuronWords,
    Resource::AxonMapWords,
    Resource::Groups,
    Resource::RuleWords,
    Resource::TraceConfigurations,
];

/// A capacity that several resources of a core share freely, such as a memory.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Pool {
    /// Its name.
    pub name: String,
    /// Its unit, in the plural.
    pub unit: String,
    /// Amount that a core has, in `unit`.
    pub limit: u64,
    /// Cost of one of each resource in `unit`, above 0.
    #[serde(deserialize_with = "each_once")]
    pub costs: BTreeMap<Resource, u32>,
}

/// The most of a resource that its pools allow when nothing else uses them; [`UNLIMITED`] without a
/// pool.
fn most_by_pools<'p>(pools: impl IntoIterator<Item = &'p Pool>, resource: Resource) -> u32 {
    let of = |pool: &Pool| Some(pool.limit / u64::from(*pool.costs.get(&resource)?));
    let least = pools.into_iter().filter_map(of).min();
    least.map_or(UNLIMITED, |most| u32::try_from(most).unwrap_or(UNLIMITED))
}

/// Reads numbers by name, from a map or from the fields of a struct.
fn by_name<'de, D: Deserializer<'de>>(deserializer: D) -> Result<BTreeMap<String, u64>, D::Error> {
    struct ByName;
    impl<'de> Visitor<'de> for ByName {
        type Value = BTreeMap<String, u64>;

        fn expecting(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            formatter.write_str("the limit of each pool by its name")
        }

        fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
            let mut limits = BTreeMap::new();
            while let Some((name, limit)) = map.next_entry()? {
                limits.insert(name, limit);
            }
            Ok(limits)
        }
    }
    deserializer.deserialize_any(ByName)
}

/// Reads a map and refuses duplicate keys.
fn each_once<'de, D: Deserializer<'de>>(deserializer: D) -> Result<BTreeMap<Resource, u32>, D::Error> {
    struct EachOnce;
    impl<'de> Visitor<'de> for EachOnce {
        type Value = BTreeMap<Resource, u32>;

        fn expecting(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            formatter.write_str("the cost of each resource")
        }

        fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
            let mut costs = BTreeMap::new();
            while let Some((resource, cost)) = map.next_entry::<Resource, u32>()? {
                if costs.insert(resource, cost).is_some() {
                    return Err(A::Error::custom(format_args!("`{}` has two costs", resource.name())));
                }
            }
            Ok(costs)
        }
    }
    deserializer.deserialize_map(EachOnce)
}

impl Pool {
    /// Whether its unit is a multiple of bytes or bits, such as KB.
    fn is_in_multiples(&self) -> bool {
        const MULTIPLES: [&str; 9] = ["k", "m", "g", "ki", "mi", "gi", "kilo", "mega", "giga"];
        let unit = self.unit.to_lowercase();
        let multiple = ["bytes", "byte", "bits", "bit", "b"].iter().find_map(|one| unit.strip_suffix(one));
        multiple.is_some_and(|multiple| MULTIPLES.contains(&multiple.trim()))
    }

    /// Amount in `unit` that these uses take, at most `u64::MAX`.
    pub fn need(&self, used: &PerResource<u64>) -> u64 {
        self.costs
            .iter()
            .map(|(&resource, &cost)| used[resource].saturating_mul(cost.into()))
            .fold(0, u64::saturating_add)
    }
}

/// A limited capacity: a resource of a core, a pool, or the cores of the target.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Capacity {
    /// A resource of a core.
    Resource(Resource),
    /// A pool that resources of a core share.
    Pool(Arc<Pool>),
    /// The cores of the target.
    Cores,
}

impl Capacity {
    /// The name in JSON and in messages.
    pub fn name(&self) -> &str {
        match self {
            Capacity::Resource(resource) => resource.name(),
            Capacity::Pool(pool) => &pool.name,
            Capacity::Cores => "cores",
        }
    }

    /// Diagnostic code where it is exceeded.
    pub fn code(&self) -> &'static str {
        match self {
            Capacity::Resource(resource) => resource.description().code,
            Capacity::Pool(_) => "map.pool",
            Capacity::Cores => "map.cores",
        }
    }

    /// The heading of its column in a table of cores, if it has one.
    pub fn heading(&self) -> Option<&str> {
        match self {
            Capacity::Resource(resource) => resource.description().heading,
            Capacity::Pool(pool) => Some(&pool.name),
            Capacity::Cores => None,
        }
    }

    /// Its name in a sentence, in the plural.
    pub fn noun(&self) -> Cow<'static, str> {
        match self {
            Capacity::Resource(resource) => resource.description().noun.into(),
            Capacity::Pool(pool) => format!("{} of the {} of its core", pool.unit, pool.name).into(),
            Capacity::Cores => "cores".into(),
        }
    }

    /// Advice where it is exceeded.
    pub fn advice(&self) -> Cow<'static, str> {
        match self {
            Capacity::Resource(resource) => resource.description().advice.into(),
            Capacity::Pool(pool) => {
                let names: Vec<&str> = pool.costs.keys().map(|resource| resource.name()).collect();
                format!("use less of the resources that draw on it ({})", names.join(", ")).into()
            }
            Capacity::Cores => "choose a larger target".into(),
        }
    }
}

impl From<Resource> for Capacity {
    fn from(resource: Resource) -> Self {
        Capacity::Resource(resource)
    }
}

impl PartialEq<Resource> for Capacity {
    fn eq(&self, other: &Resource) -> bool {
        matches!(self, Capacity::Resource(resource) if resource == other)
    }
}

/// The limits of a core (chip files name the source of each), a table by [`Resource`].
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
#[serde(try_from = "LimitsInFile", into = "LimitsInFile")]
pub struct Limits {
    /// The most of each resource, by its own limit or by its pools; `u32::MAX` where unlimited.
    pub most: PerResource<u32>,
    /// Pools that resources share.
    pub pools: Vec<Arc<Pool>>,
    /// Slots that an output axon takes when its target is on the same chip.
    pub axon_out_slots: u32,
    /// Slots that an output axon takes when its target is on another chip.
    pub axon_out_slots_off_chip: u32,
    /// Rule that counts output axons.
    pub output_axons: OutputAxons,
    /// Synapses of one entry of a list, 1 to 64.
    pub synapses_per_entry: u32,
    /// Rule that counts synapse words.
    pub packing: Packing,
    /// Words of a neuron by its kind.
    pub neuron_sizes: NeuronSizes,
}

impl Limits {
    /// Whether words are counted as Intel's compiler for Loihi 2 does.
    pub fn counts_kernels(&self) -> bool {
        matches!(self.packing, Packing::Kernels { .. })
    }

    /// Returns these limits with another limit of one resource.
    #[must_use]
    pub fn with(mut self, resource: Resource, limit: u32) -> Self {
        self.most[resource] = limit;
        self
    }

    /// Whether a resource has a limit, of its own or by a pool.
    pub fn is_limited(&self, resource: Resource) -> bool {
        self.most[resource] != UNLIMITED
    }

    /// Need and limit of every limited resource, then of every pool, in a fixed order.
    pub fn against(&self, used: PerResource<u64>) -> impl Iterator<Item = (Capacity, u64, u64)> {
        let limited = Resource::ALL.into_iter().filter(|&resource| self.is_limited(resource));
        let resources = limited.map(move |r| (Capacity::Resource(r), used[r], u64::from(self.most[r])));
        resources.chain(self.pools.iter().map(move |pool| (Capacity::Pool(pool.clone()), pool.need(&used), pool.limit)))
    }

    /// Whether every use is within its limit.
    pub fn admit(&self, used: &PerResource<u64>) -> bool {
        Resource::ALL.into_iter().all(|r| used[r] <= u64::from(self.most[r]) || !self.is_limited(r))
            && self.pools.iter().all(|pool| pool.need(used) <= pool.limit)
    }
}

impl Index<Resource> for Limits {
    type Output = u32;
    #[inline]
    fn index(&self, resource: Resource) -> &u32 {
        &self.most[resource]
    }
}

impl IndexMut<Resource> for Limits {
    fn index_mut(&mut self, resource: Resource) -> &mut u32 {
        &mut self.most[resource]
    }
}

const UNLIMITED: u32 = u32::MAX;

fn is_default(sizes: &NeuronSizes) -> bool {
    *sizes == NeuronSizes::default()
}

fn not_given() -> u32 {
    UNLIMITED
}

#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_not_given(most: &u32) -> bool {
    *most == UNLIMITED
}

impl TryFrom<LimitsInFile> for Limits {
    type Error = String;

    fn try_from(file: LimitsInFile) -> Result<Self, String> {
        let mut most = file.own();
        for (place, pool) in file.pools.iter().enumerate() {
            let is_named = |other: &Pool| other.name == pool.name;
            if file.pools[..place].iter().any(is_named) || Limits::NAMES.contains(&pool.name.as_str()) {
                return Err(format!("pool {}: another limit has this name", pool.name));
            }
            if pool.is_in_multiples() {
                let help = "its limit and its costs count in it: write both in bytes or in bits";
                return Err(format!("the pool {} is in {}; {help}", pool.name, pool.unit));
            }
            if pool.costs.is_empty() || pool.costs.values().any(|&cost| cost == 0) {
                return Err(format!(
                    "the pool {} needs resources that draw on it, and of each a cost above 0",
                    pool.name
                ));
            }
            for &resource in pool.costs.keys() {
                most[resource] = most[resource].min(most_by_pools([pool], resource));
            }
        }
        let lacks = |&resource: &Resource| most[resource] == UNLIMITED;
        if let Some(resource) = file.unlimited.iter().find(|resource| !lacks(resource)) {
            return Err(format!("`{}` is in `unlimited` and has a limit; remove one of them", resource.name()));
        }
        let is_missing = |one: &Resource| lacks(one) && !OPTIONAL.contains(one) && !file.unlimited.contains(one);
        let mut missing: Vec<&str> = Resource::ALL.into_iter().filter(is_missing).map(Resource::name).collect();
        let help = match missing.is_empty() {
            true => "",
            false => ": give each resource a limit, a pool that it draws on, or name it in `unlimited`",
        };
        let LimitsInFile { axon_out_slots, axon_out_slots_off_chip, synapses_per_entry, packing, .. } = &file;
        let others = [
            ("axon_out_slots", axon_out_slots.is_none()),
            ("axon_out_slots_off_chip", axon_out_slots_off_chip.is_none()),
            ("synapses_per_entry", synapses_per_entry.is_none()),
            ("packing", packing.is_none()),
        ];
        missing.extend(others.into_iter().filter(|(_, is_missing)| *is_missing).map(|(name, _)| name));
        let (Some(axon_out_slots), Some(axon_out_slots_off_chip), Some(synapses_per_entry), Some(packing), []) =
            (*axon_out_slots, *axon_out_slots_off_chip, *synapses_per_entry, *packing, missing.as_slice())
        else {
            let s = if missing.len() > 1 { "s" } else { "" };
            return Err(format!("missing field{s} `{}`{help}", missing.join("`, `")));
        };
        let synapses = [Resource::SynapseWords, Resource::StoredSynapses];
        if synapses.iter().all(lacks) && !file.unlimited.contains(&Resource::StoredSynapses) {
            let help = "synapses have no limit; give one, a pool that they draw on, or name it in `unlimited`";
            return Err(format!("missing field `stored_synapses`: {help}"));
        }
        let LimitsInFile { output_axons, pools, neuron_sizes, .. } = file;
        let pools = pools.into_iter().map(Arc::new).collect();
        Ok(Limits {
            most,
            pools,
            axon_out_slots,
            axon_out_slots_off_chip,
            output_axons,
            synapses_per_entry,
            packing,
            neuron_sizes,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spanned::options;

    const OWN: &str = "(compartments: 16, axons_in: 64, axons_out: 64, axon_out_slots: 1, axon_out_slots_off_chip: 2, \
        axons_out_per_compartment: 8, synapse_words: 256, synapse_words_per_axon: 8, synapses_per_entry: 64, \
        synapse_formats: 3, compartment_profiles: 4, threshold_profiles: 4, accumulators: 128, stored_synapses: 99, \
        neuron_words: 16, axon_map_words: 16, groups: 4, rule_words: 16, trace_configurations: 3, \
        neuron_sizes: (one_word: [Loihi], program: 1, state_word: 1), \
        packing: Nengo)";

    fn limits(text: &str) -> Result<Limits, String> {
        options().from_str(text).map_err(|error| error.to_string())
    }

    #[test]
    fn names_are_those_of_files_and_messages() {
        for resource in Resource::ALL {
            assert_eq!(serde_json::to_value(resource).unwrap(), resource.name());
            assert_eq!(Capacity::from(resource).code(), format!("map.{}", resource.name().replace('_', "-")));
        }
        let written = serde_json::to_value(limits(OWN).unwrap()).unwrap();
        assert_eq!(written.as_object().unwrap().keys().collect::<Vec<_>>(), Limits::NAMES);
        assert_eq!((&written["axons_in"], &written["packing"]), (&64.into(), &"Nengo".into()));
    }

    #[test]
    fn a_pool_limits_what_draws_on_it_alone_and_together() {
        let pooled = OWN.replace("synapse_words: 256,", "").replace("axons_in: 64", "axons_in: 60").replace(
            "Nengo)",
            "Nengo, pools: [(name: \"memory\", unit: \"bytes\", limit: 1000, costs: {axons_in: 4, synapse_words: 8})])",
        );
        let limits = limits(&pooled).unwrap();
        assert_eq!((limits[Resource::AxonsIn], limits[Resource::SynapseWords]), (60, 125));
        let used = |axons_in, words| {
            let mut used = PerResource::default();
            (used[Resource::AxonsIn], used[Resource::SynapseWords]) = (axons_in, words);
            used
        };
        assert!(limits.admit(&used(50, 100)) && !limits.admit(&used(51, 100)) && !limits.admit(&used(0, 126)));
        let over = limits.against(used(51, 100)).find(|(_, need, limit)| need > limit);
        let (memory, need, limit) = over.unwrap();
        assert_eq!((memory.name(), memory.code(), need, limit), ("memory", "map.pool", 1004, 1000));
        assert_eq!(memory.noun(), "bytes of the memory of its core");
        assert_eq!(memory.advice(), "use less of the resources that draw on it (axons_in, synapse_words)");
    }

    #[test]
    fn kinds_without_a_word_of_their_own_take_words_by_their_state() {
        let sizes = limits(OWN).unwrap().neuron_sizes;
        let kinds = [NeuronKind::Loihi, NeuronKind::Rf, NeuronKind::Alif, NeuronKind::GradedVec];
        assert_eq!(kinds.map(|kind| sizes.words_of(kind)), [1, 3, 5, 1]);
        assert_eq!(kinds.map(|kind| NeuronSizes::default().words_of(kind)), [1; 4]);
    }

    #[test]
    fn a_resource_without_any_limit_and_a_pool_without_costs_are_refused() {
        let refused = |text: String| limits(&text).unwrap_err();
        assert!(refused(OWN.replace("axons_out: 64, ", "")).contains("missing field `axons_out`"));
        assert!(refused(OWN.replace("axons_out: 64", "axon_outs: 64")).contains("axon_outs"));
        let unlimited = |own: &str| own.replace("Nengo)", "Nengo, unlimited: [axons_out])");
        assert!(refused(unlimited(OWN)).contains("`axons_out` is in `unlimited` and has a limit"));
        let without = limits(&unlimited(&OWN.replace("axons_out: 64, ", ""))).unwrap();
        assert!({
            let mut used = PerResource::default();
            used[Resource::AxonsOut] = 1 << 40;
            without.admit(&used)
        });
        assert_eq!(limits(&ron::to_string(&without).unwrap()).unwrap(), without);
        let pool =
            |costs: &str| {
                refused(OWN.replace(
                    "Nengo)",
                    &format!("Nengo, pools: [(name: \"m\", unit: \"b\", limit: 9, costs: {costs})])"),
                ))
            };
        assert!(pool("{}").contains("the pool m needs resources"));
        assert!(pool("{axons_in: 0}").contains("a cost above 0"));
        assert!(pool("{axons_in: 1, axons_in: 1}").contains("`axons_in` has two costs"));
    }

    #[test]
    fn a_pool_is_changed_by_its_name_and_what_draws_on_it_follows() {
        let pools = "pools: [(name: \"memory\", unit: \"bytes\", limit: 1000, costs: {axons_in: 4, synapse_words: 8})]";
        let own = OWN.replace("synapse_words: 256,", "").replace("axons_in: 64", "axons_in: 60");
        let limits = limits(&own.replace("Nengo)", &format!("Nengo, {pools})"))).unwrap();
        for text in ["(pools: (memory: 2000))", "(pools: {\"memory\": 2000})"] {
            let changes: LimitChanges = options().from_str(text).unwrap();
            let changed = changes.applied(limits.clone());
            assert_eq!(changed.pools[0].limit, 2000, "{text}");
            assert_eq!((changed[Resource::AxonsIn], changed[Resource::SynapseWords]), (60, 250), "{text}");
            assert!(changes.changes("memory") && !changes.changes("axons_in"));
        }
        let fewer = LimitChanges { pools: [("memory".to_string(), 80)].into(), ..LimitChanges::default() };
        let fewer = fewer.applied(limits);
        assert_eq!((fewer[Resource::AxonsIn], fewer[Resource::SynapseWords]), (20, 10));
    }

    #[test]
    fn synapses_without_a_limit_pools_of_one_name_and_multiples_of_bytes_are_refused() {
        let pools = |own: &str, pools: &str| limits(&own.replace("Nengo)", &format!("Nengo, {pools})")));
        let pool =
            |name: &str, unit: &str| format!("(name: \"{name}\", unit: \"{unit}\", limit: 64, costs: {{axons_in: 1}})");
        let one = |name: &str, unit: &str| pools(OWN, &format!("pools: [{}]", pool(name, unit)));
        for unit in ["bytes", "bits", "words", "kernels", "B"] {
            one("m", unit).unwrap_or_else(|error| panic!("{unit}: {error}"));
        }
        for unit in ["KB", "KiB", "kB", "kbit", "MB", "kilobytes"] {
            assert!(one("m", unit).unwrap_err().contains("write both in bytes or in bits"), "{unit}");
        }
        let twice = format!("pools: [{}, {}]", pool("m", "bytes"), pool("m", "bits"));
        assert!(pools(OWN, &twice).unwrap_err().contains("pool m: another limit has this name"));
        assert!(one("axons_out", "bytes").unwrap_err().contains("another limit has this name"));
        let none = OWN.replace("synapse_words: 256, ", "").replace("stored_synapses: 99, ", "");
        let refused = pools(&none, "unlimited: [synapse_words]").unwrap_err();
        assert!(refused.contains("missing field `stored_synapses`: synapses have no limit"), "{refused}");
        let free = pools(&none, "unlimited: [synapse_words, stored_synapses]").unwrap();
        assert_eq!(limits(&ron::to_string(&free).unwrap()).unwrap(), free);
        let several = OWN.replace("axons_out: 64, ", "").replace("accumulators: 128, ", "");
        let several = several.replace("synapses_per_entry: 64,", "").replace(", packing: Nengo", "");
        let refused = limits(&several).unwrap_err();
        assert!(
            refused.contains("missing fields `axons_out`, `accumulators`, `synapses_per_entry`, `packing`"),
            "{refused}"
        );
    }
}
