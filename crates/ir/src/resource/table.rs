//! The resources of a core, and tables indexed by them.
//!
//! A resource is described once, in the table of [`Resource`]: files, messages, reports and counts
//! take their names, their order and their number from it. To add a resource, add a row here, count
//! it in each counter of usage, and give it a limit in the chip files.

use std::collections::BTreeMap;
use std::ops::{Index, IndexMut};

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Texts about a resource in messages and reports.
pub(super) struct Description {
    name: &'static str,
    /// Diagnostic code where a network exceeds the resource.
    pub(super) code: &'static str,
    /// Heading in the table of cores; `None` where the amount is a maximum, not a sum.
    pub(super) heading: Option<&'static str>,
    /// Name in a sentence, in the plural.
    pub(super) noun: &'static str,
    /// Advice where the resource is exceeded.
    pub(super) advice: &'static str,
}

const FAN_IN_ADVICE: &str = "every compartment that sends to a core takes one input axon there: pool more before this \
                             population, or split the fan-in over intermediate populations";
const DELAY_ADVICE: &str = "shorten the longest delay into this population: a compartment takes one accumulator for \
                            each step of it, rounded up to a power of two";
const FAN_OUT_ADVICE: &str = "a spike takes one output axon for each destination core (more slots when that core is on \
                              another chip): reduce the fan-out, or let `--relays` add compartments, and cores, that \
                              forward spikes";
const WORDS_ADVICE: &str = "use fewer synapses, or split the fan-in over intermediate populations; if a source has \
                            several synapses there, fewer weight bits or no delays take fewer words";
const LIST_ADVICE: &str = "these are the words of one source: use fewer of its synapses, fewer weight bits, or no \
                           delays";
/// Advice where each compartment needs one: a single compartment exceeds only a limit of 0.
const ONE_ADVICE: &str = "every compartment has one: choose a target that has some";

/// Calls a macro with a row for each resource: its variant and its name in files, then its
/// [`Description`].
macro_rules! resources {
    ($with:ident) => {
        $with! {
            /// Number of compartments.
            Compartments, compartments: "map.compartments", Some("compartments"), "compartments",
                "move compartments of this core to another core";
            /// Number of input axons.
            AxonsIn, axons_in: "map.axons-in", Some("axons in"), "input axons of its core", FAN_IN_ADVICE;
            /// Number of output axon slots.
            AxonsOut, axons_out: "map.axons-out", Some("axons out"), "output axon slots of its core", FAN_OUT_ADVICE;
            /// The most output axons of one compartment.
            AxonsOutPerCompartment, axons_out_per_compartment: "map.axons-out-per-compartment", None,
                "output axons of one compartment", FAN_OUT_ADVICE;
            /// Number of 64-bit words of synapse memory.
            SynapseWords, synapse_words: "map.synapse-words", Some("words"), "synapse words of its core", WORDS_ADVICE;
            /// The most words of one input axon's list.
            SynapseWordsPerAxon, synapse_words_per_axon: "map.synapse-words-per-axon", None,
                "synapse words of one input axon", LIST_ADVICE;
            /// Number of distinct synapse formats.
            SynapseFormats, synapse_formats: "map.synapse-formats", Some("formats"), "synapse formats of its core",
                "let projections into this population share weight exponent, sign mode and weight bits";
            /// Number of distinct compartment profiles (du, dv, refractory period).
            CompartmentProfiles, compartment_profiles: "map.compartment-profiles", Some("profiles"),
                "compartment profiles of its core", ONE_ADVICE;
            /// Number of distinct threshold mantissas.
            ThresholdProfiles, threshold_profiles: "map.threshold-profiles", Some("thresholds"),
                "threshold profiles of its core", ONE_ADVICE;
            /// Number of dendritic accumulators: compartments times delay slots, a power of two
            /// above the longest delay.
            Accumulators, accumulators: "map.accumulators", Some("accumulators"), "dendritic accumulators of its core",
                DELAY_ADVICE;
            /// Number of synapses stored by a core that shares kernels, without weights of 0. A
            /// convolution or pool stores its kernel once for each target channel. Counted only
            /// where it is limited.
            StoredSynapses, stored_synapses: "map.stored-synapses", Some("stored synapses"),
                "stored synapses of its core",
                "use fewer synapses, or prune weights to 0, as zeros take no memory";
            /// Number of words of neuron memory, by [`NeuronSizes`](super::NeuronSizes).
            NeuronWords, neuron_words: "map.neuron-words", Some("neuron words"), "neuron words of its core",
                "use a kind of neuron with fewer words of state, or fewer neurons";
            /// Number of entries of the axon map: one for each position of a convolution, whose
            /// channels share it, and one for each compartment of any other population.
            AxonMapWords, axon_map_words: "map.axon-map-words", Some("axon map"), "axon map words of its core",
                "use fewer neurons, or a convolution, whose channels share a word";
            /// Number of groups: the populations that have compartments on the core.
            Groups, groups: "map.groups", Some("groups"), "neuron groups of its core",
                "join small populations into one";
            /// Number of words of microcode of distinct rules: half a word for a product of at most
            /// one factor, one for any other.
            RuleWords, rule_words: "map.rule-words", Some("rule words"), "words of learning rules of its core",
                "give projections into this population equal rules, or rules of fewer products";
            /// Number of distinct (impulse, tau) of presynaptic traces that rules read.
            TraceConfigurations, trace_configurations: "map.trace-configurations", Some("traces"),
                "presynaptic trace configurations of its core",
                "give x1 and x2 of projections into this population equal impulse and tau";
        }
    };
}

pub(super) use resources;

macro_rules! define_resource {
    ($($(#[$doc:meta])* $resource:ident, $name:ident: $code:literal, $heading:expr, $noun:literal, $advice:expr;)*) => {
        /// A resource of a core.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
        #[serde(rename_all = "snake_case")]
        pub enum Resource {
            $($(#[$doc])* $resource,)*
        }

        impl Resource {
            /// All resources, in the order of counts and reports.
            pub const ALL: [Resource; Resource::COUNT] = [$(Resource::$resource,)*];
            /// Number of resources.
            pub const COUNT: usize = [$(stringify!($name),)*].len();

            pub(super) fn description(self) -> Description {
                let (name, code, heading, noun, advice) = match self {
                    $(Resource::$resource => (stringify!($name), $code, $heading, $noun, $advice),)*
                };
                Description { name, code, heading, noun, advice }
            }
        }
    };
}

resources!(define_resource);

impl Resource {
    /// The name in files and in JSON.
    pub fn name(self) -> &'static str {
        self.description().name
    }
}

/// A value for each resource.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PerResource<T>(pub(super) [T; Resource::COUNT]);

impl<T> PerResource<T> {
    /// Builds a table from the value of each resource.
    #[inline]
    pub fn from_fn(f: impl FnMut(Resource) -> T) -> Self {
        PerResource(Resource::ALL.map(f))
    }
}

/// Serialised as a map by resource name, in which every resource is required.
impl<T: Serialize> Serialize for PerResource<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(Resource::ALL.iter().zip(&self.0))
    }
}

impl<'de, T: Deserialize<'de> + Copy> Deserialize<'de> for PerResource<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let given = BTreeMap::<Resource, T>::deserialize(deserializer)?;
        if let Some(missing) = Resource::ALL.into_iter().find(|resource| !given.contains_key(resource)) {
            return Err(D::Error::custom(format_args!("missing field `{}`", missing.name())));
        }
        Ok(PerResource::from_fn(|resource| given[&resource]))
    }
}

impl<T> Index<Resource> for PerResource<T> {
    type Output = T;
    #[inline]
    fn index(&self, resource: Resource) -> &T {
        &self.0[resource as usize]
    }
}

impl<T> IndexMut<Resource> for PerResource<T> {
    #[inline]
    fn index_mut(&mut self, resource: Resource) -> &mut T {
        &mut self.0[resource as usize]
    }
}
