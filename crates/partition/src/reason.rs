//! Why a network does not fit its target, and what to change.
//!
//! Input: what a population, a core or the whole network needs of a resource, and the limit.
//! Output: a [`Reason`].

use std::fmt;

use nsim_ir::base::id::{CoreId, PopulationId};
use nsim_ir::hardware::Target;
use nsim_ir::quantised::Quantised;
use nsim_ir::resource::{Capacity, Limits, Resource};

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
    pub resource: Capacity,
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
        match (&self.resource, self.population.is_some()) {
            (Capacity::Cores, _) => write!(f, "at least {need} cores are needed, the target has {limit}")?,
            (Capacity::Resource(Resource::Compartments), false) if self.core.is_none() => {
                write!(f, "{need} compartments are needed, the whole target has {limit}")?;
            }
            (resource, true) => {
                write!(f, "one of its compartments alone needs {need} {}, the limit is {limit}", resource.noun())?;
            }
            (resource, false) => write!(f, "{need} {} are needed, the limit is {limit}", resource.noun())?,
        }
        write!(f, "; {}", self.help)
    }
}

/// What to do where the input axons of a population that channels reach are too many.
const MERGE_INPUTS: &str = "every input channel that reaches a core takes one input axon there: merge polarities \
                            (halves the channels), prune inputs that never fire (--prune INPUT), pool more before \
                            this population, or split the fan-in over intermediate populations";

impl Reason {
    fn new(resource: Capacity, need: u64, limit: u64, help: String) -> Self {
        Reason { code: resource.code(), population: None, core: None, resource, need, limit, help }
    }

    /// A compartment of a population needs more than any core has.
    #[must_use]
    pub fn of_population(network: &Quantised, id: PopulationId, resource: Capacity, need: u64, limit: u64) -> Self {
        let is_input = |source: PopulationId| network.populations()[source].first_channel().is_some();
        let from_inputs = network.incoming(id).any(|(_, p)| is_input(p.source));
        let population = Some(network.populations()[id].name.clone());
        let merge = resource == Resource::AxonsIn && from_inputs;
        let help = if merge { MERGE_INPUTS.into() } else { resource.advice() };
        Reason { population, ..Reason::new(resource, need, limit, help.into_owned()) }
    }

    /// A compartment of a population of this name needs more than any core has.
    #[must_use]
    pub fn of_named(population: &str, resource: Resource, need: u64, limit: u64) -> Self {
        let resource = Capacity::from(resource);
        let help = resource.advice().into_owned();
        Reason { population: Some(population.to_string()), ..Reason::new(resource, need, limit, help) }
    }

    /// A core of a given membership needs more than it has.
    #[must_use]
    pub fn of_core(core: CoreId, resource: Capacity, need: u64, limit: u64) -> Self {
        let help = format!("{}; or let nsim make a new mapping", Capacity::from(Resource::Compartments).advice());
        Reason { core: Some(core), ..Reason::new(resource, need, limit, help) }
    }

    /// More cores are needed than the target has.
    #[must_use]
    pub fn of_cores(target: &Target, copies: u32, need: u64) -> Self {
        Reason::new(Capacity::Cores, need, u64::from(target.cores()), larger(copies, need))
    }

    /// More compartments are needed than the whole target has.
    #[must_use]
    pub fn of_compartments(target: &Target, limits: &Limits, copies: u32, need: u64) -> Self {
        let limit = u64::from(target.cores()) * u64::from(limits[Resource::Compartments]);
        let cores = need.div_ceil(u64::from(limits[Resource::Compartments]));
        Reason::new(Resource::Compartments.into(), need, limit, larger(copies, cores))
    }
}

fn larger(copies: u32, cores: u64) -> String {
    let other = if copies > 1 { format!("map fewer than {copies} copies") } else { "a smaller network".to_string() };
    format!("choose a target with at least {cores} cores, or {other}")
}
