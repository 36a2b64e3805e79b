//! Why a network does not fit its target, in words that say what to change.
//!
//! In comes what a population, a core or the whole network needs of a resource and what there is; out goes a [`Reason`].

use std::fmt;

use crate::base::id::CoreId;
use crate::desc::target::{Limits, Target};
use crate::ir::partition::Resource;

/// Boards that this project ships, ascending, with their cores of 128 a chip (Davies et al. 2018; Davies et al. 2021 for the boards).
const BOARDS: [(&str, u64); 4] =
    [("loihi1-chip", 128), ("kapoho-bay", 256), ("nahuku-32", 4_096), ("pohoiki-springs", 98_304)];

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

/// What to do about a compartment that no core can hold.
fn advice(resource: Resource) -> &'static str {
    match resource {
        Resource::AxonsIn => {
            "every input channel that reaches a core takes one input axon there: merge polarities (halves the channels; \
             the VT-SNN paper did so for Loihi), prune inputs that the scene never fires, pool more before this \
             population, or split the fan-in over intermediate populations"
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
    /// A compartment of a population needs more than any core has.
    #[must_use]
    pub fn of_population(population: &str, resource: Resource, need: u64, limit: u64) -> Self {
        let help = advice(resource).to_string();
        Reason {
            code: code(resource),
            population: Some(population.to_string()),
            core: None,
            resource,
            need,
            limit,
            help,
        }
    }

    /// A core of a given membership needs more than it has.
    #[must_use]
    pub fn of_core(core: CoreId, resource: Resource, need: u64, limit: u64) -> Self {
        let help = format!("{}; or let nsim make a new mapping", advice(Resource::Compartments));
        Reason { code: code(resource), population: None, core: Some(core), resource, need, limit, help }
    }

    /// More cores are needed than the target has.
    #[must_use]
    pub fn of_cores(target: &Target, copies: u32, need: u64) -> Self {
        let limit = u64::from(target.cores());
        Reason {
            code: code(Resource::Cores),
            population: None,
            core: None,
            resource: Resource::Cores,
            need,
            limit,
            help: larger(copies, need, limit),
        }
    }

    /// More compartments are needed than the whole target has.
    #[must_use]
    pub fn of_compartments(target: &Target, limits: &Limits, copies: u32, need: u64) -> Self {
        let limit = u64::from(target.cores()) * u64::from(limits.compartments);
        let cores = need.div_ceil(u64::from(limits.compartments));
        Reason {
            code: code(Resource::Compartments),
            population: None,
            core: None,
            resource: Resource::Compartments,
            need,
            limit,
            help: larger(copies, cores, u64::from(target.cores())),
        }
    }
}

fn larger(copies: u32, need: u64, limit: u64) -> String {
    let board = match BOARDS.iter().find(|(_, cores)| *cores >= need && *cores > limit) {
        Some((name, cores)) => format!("choose a larger target, for example {name} ({cores} cores of a Loihi chip)"),
        None => "no shipped target is large enough".to_string(),
    };
    if copies > 1 {
        format!("{board}, or map fewer than {copies} copies")
    } else {
        format!("{board}, or a smaller network")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_boards_that_are_recommended_are_shipped_with_so_many_cores() {
        for (name, cores) in BOARDS {
            assert_eq!(u64::from(crate::io::target::load_target(name).unwrap().cores()), cores, "{name}");
        }
    }
}
