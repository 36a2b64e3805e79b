//! Why a network does not fit its target, and what to change.
//!
//! Input: what a population, a core or the whole network needs of a resource, and the limit. Output: a [`Reason`].

use std::fmt;

use crate::base::id::{CoreId, PopulationId};
use crate::desc::target::{Limits, Target};
use crate::ir::partition::Resource;
use crate::ir::quantised::Quantised;

/// One reason why a network does not fit.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reason {
    /// A stable name for scripts: `map.RESOURCE`.
    pub code: &'static str,
    /// The population that needs too much, when it is one.
    pub population: Option<String>,
    /// The core that would need too much, when the membership was given.
    pub core: Option<CoreId>,
    /// Of which resource.
    pub resource: Resource,
    /// What is needed.
    pub need: u64,
    /// What there is.
    pub limit: u64,
    /// What to change.
    pub help: String,
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.population, self.core) {
            (Some(population), _) => write!(f, "population {population}: ")?,
            (None, Some(core)) => write!(f, "{core}: ")?,
            (None, None) => {}
        }
        let Reason { need, limit, .. } = self;
        match (self.resource, self.population.is_some()) {
            (Resource::Cores, _) => write!(f, "at least {need} cores are needed, the target has {limit}")?,
            (Resource::Compartments, false) if self.core.is_none() => {
                write!(f, "{need} compartments are needed, the whole target has {limit}")?;
            }
            (resource, true) => {
                write!(f, "one of its compartments alone needs {need} {}, the limit is {limit}", spoken(resource))?;
            }
            (resource, false) => write!(f, "{need} {} are needed, the limit is {limit}", spoken(resource))?,
        }
        write!(f, "; {}", self.help)
    }
}

fn spoken(resource: Resource) -> &'static str {
    match resource {
        Resource::Compartments => "compartments",
        Resource::AxonsIn => "input axons of its core",
        Resource::AxonsOut => "output axon slots of its core",
        Resource::AxonsOutPerCompartment => "output axons of one compartment",
        Resource::SynapseWords => "synapse words of its core",
        Resource::SynapseWordsPerAxon => "synapse words of one input axon",
        Resource::SynapseFormats => "synapse formats of its core",
        Resource::CompartmentProfiles => "compartment profiles of its core",
        Resource::ThresholdProfiles => "threshold profiles of its core",
        Resource::Accumulators => "dendritic accumulators of its core",
        Resource::Cores => "cores",
    }
}

fn code(resource: Resource) -> &'static str {
    match resource {
        Resource::Compartments => "map.compartments",
        Resource::AxonsIn => "map.axons-in",
        Resource::AxonsOut => "map.axons-out",
        Resource::AxonsOutPerCompartment => "map.axons-out-per-compartment",
        Resource::SynapseWords => "map.synapse-words",
        Resource::SynapseWordsPerAxon => "map.synapse-words-per-axon",
        Resource::SynapseFormats => "map.synapse-formats",
        Resource::CompartmentProfiles => "map.compartment-profiles",
        Resource::ThresholdProfiles => "map.threshold-profiles",
        Resource::Accumulators => "map.accumulators",
        Resource::Cores => "map.cores",
    }
}

/// What to do about a compartment that no core can hold; `from_inputs` when input channels reach it.
fn advice(resource: Resource, from_inputs: bool) -> &'static str {
    match resource {
        Resource::AxonsIn if from_inputs => {
            "every input channel that reaches a core takes one input axon there: merge polarities (halves the channels), \
             prune inputs that never fire, pool more before this population, or split the fan-in over intermediate \
             populations"
        }
        Resource::AxonsIn => {
            "every compartment that reaches a core takes one input axon there: pool more before this population, or \
             split the fan-in over intermediate populations"
        }
        Resource::AxonsOut | Resource::AxonsOutPerCompartment => {
            "a spike takes one output axon for each core that it reaches (more slots when that core is on another chip): \
             reduce the fan-out, or send it through a relay population beside its targets"
        }
        Resource::SynapseWords | Resource::SynapseWordsPerAxon => {
            "use fewer synapses, fewer weight bits, or no delays, or split the fan-in over intermediate populations"
        }
        Resource::SynapseFormats => {
            "let projections into this population share weight exponent, sign mode and weight bits"
        }
        Resource::CompartmentProfiles => "let compartments share du, dv and refractory period",
        Resource::ThresholdProfiles => "let compartments share their threshold",
        Resource::Accumulators => {
            "shorten the longest delay into this population: a compartment takes one accumulator for each step of it, \
             rounded up to a power of two"
        }
        Resource::Compartments => "move compartments of this core to another",
        Resource::Cores => "choose a larger target",
    }
}

impl Reason {
    fn new(resource: Resource, need: u64, limit: u64, help: String) -> Self {
        Reason { code: code(resource), population: None, core: None, resource, need, limit, help }
    }

    /// A compartment of a population needs more than any core has.
    #[must_use]
    pub fn of_population(network: &Quantised, id: PopulationId, resource: Resource, need: u64, limit: u64) -> Self {
        let is_input = |source: PopulationId| network.populations()[source].first_channel().is_some();
        let from_inputs = network.projections().iter().any(|p| p.target == id && is_input(p.source));
        let population = Some(network.populations()[id].name.clone());
        Reason { population, ..Reason::new(resource, need, limit, advice(resource, from_inputs).to_string()) }
    }

    /// A core of a given membership needs more than it has.
    #[must_use]
    pub fn of_core(core: CoreId, resource: Resource, need: u64, limit: u64) -> Self {
        let help = format!("{}; or let nsim make a new mapping", advice(Resource::Compartments, false));
        Reason { core: Some(core), ..Reason::new(resource, need, limit, help) }
    }

    /// More cores are needed than the target has.
    #[must_use]
    pub fn of_cores(target: &Target, copies: u32, need: u64) -> Self {
        Reason::new(Resource::Cores, need, u64::from(target.cores()), larger(copies, need))
    }

    /// More compartments are needed than the whole target has.
    #[must_use]
    pub fn of_compartments(target: &Target, limits: &Limits, copies: u32, need: u64) -> Self {
        let limit = u64::from(target.cores()) * u64::from(limits.compartments);
        let cores = need.div_ceil(u64::from(limits.compartments));
        Reason::new(Resource::Compartments, need, limit, larger(copies, cores))
    }
}

fn larger(copies: u32, cores: u64) -> String {
    let other = if copies > 1 { format!("map fewer than {copies} copies") } else { "a smaller network".to_string() };
    format!("choose a target with at least {cores} cores, or {other}")
}
