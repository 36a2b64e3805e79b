//! Reasons for which a network does not fit its target, with advice.
//!
//! Input: a resource's need of a population, a core or the whole network, and its limit. Output: a
//! [`Reason`].

use std::borrow::Borrow;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use nsim_ir::base::id::{CompartmentId, CoreId, PopulationId};
use nsim_ir::hardware::constants::Status;
use nsim_ir::hardware::{LimitSource, Target};
use nsim_ir::partition::CoreUsage;
use nsim_ir::quantised::Quantised;
use nsim_ir::resource::{Capacity, Limits, Resource};

/// One reason for which a network does not fit.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Reason {
    /// A stable name for scripts: `map.RESOURCE`.
    pub code: &'static str,
    /// The population that needs too much, where one alone does.
    pub population: Option<String>,
    /// The core that would need too much, where the compartments of each core were given.
    pub core: Option<CoreId>,
    /// The resource.
    #[serde(serialize_with = "by_name")]
    pub resource: Capacity,
    /// The need, in units of the resource.
    pub need: u64,
    /// The limit, in units of the resource.
    pub limit: u64,
    /// Use of the cores that one mapping takes; `None` where `need` is a bound for every mapping.
    #[serde(skip)]
    pub taken: Option<MappingUse>,
    /// Advice to the user.
    pub help: String,
}

fn by_name<S: serde::Serializer>(resource: &Capacity, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(resource.name())
}

/// Use of the cores that a mapping takes; another mapping may need fewer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum MappingUse {
    /// The use of each core was not counted.
    Uncounted,
    /// The population with the most cores.
    Tightest(Box<Tightest>),
}

/// Number of cores of a population in a mapping, and the resource that fills them most.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tightest {
    /// Name of the population.
    pub population: String,
    /// Number of cores that hold some of it.
    pub cores: u64,
    /// The resource of which its fullest core uses the greatest fraction.
    pub resource: Capacity,
    /// Use of that core, in units of the resource.
    pub need: u64,
    /// Limit of a core, in units of the resource.
    pub limit: u64,
    /// Whether the limit is an assumption without a source.
    pub assumed: bool,
}

impl Tightest {
    /// Returns the value of each population with compartments, from the use and members of cores.
    pub fn of_each<'a, M: Borrow<Vec<CompartmentId>> + 'a>(
        network: &Quantised,
        target: &Target,
        cores: impl Iterator<Item = (&'a CoreUsage, &'a M)>,
    ) -> BTreeMap<PopulationId, Self> {
        let sources = &target.chip().limit_sources;
        let mut all: BTreeMap<PopulationId, Self> = BTreeMap::new();
        for (used, members) in cores {
            let named = target.limits().against(used.of).filter(|(capacity, ..)| capacity.heading().is_some());
            let Some(here) = named.reduce(tighter) else { continue };
            let of = |id: &CompartmentId| network.population_of(CompartmentId(id.0 % network.compartments())).0;
            for id in members.borrow().iter().map(of).collect::<BTreeSet<_>>() {
                let before = all.remove(&id).map(|one| (one.cores, (one.resource, one.need, one.limit)));
                let (cores, most) = before.unwrap_or_else(|| (0, here.clone()));
                let (resource, need, limit) = tighter(most, here.clone());
                let is_assumed = |of: &LimitSource| of.limit.value == resource.name() && of.status == Status::Assumed;
                let (assumed, population) = (sources.iter().any(is_assumed), network.populations()[id].name.clone());
                all.insert(id, Tightest { population, cores: cores + 1, resource, need, limit, assumed });
            }
        }
        all
    }
}

/// The use with the greater fraction of its limit; the first of equals.
fn tighter(a: (Capacity, u64, u64), b: (Capacity, u64, u64)) -> (Capacity, u64, u64) {
    let times = |need: u64, limit: u64| u128::from(need) * u128::from(limit.max(1));
    if times(b.1, a.2) > times(a.1, b.2) { b } else { a }
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
            (Capacity::Cores, _) => {
                let takes = if self.taken.is_some() { "this mapping takes" } else { "any mapping takes at least" };
                write!(f, "{takes} {need} cores, the target has {limit}")?;
                if let Some(MappingUse::Tightest(most)) = &self.taken {
                    let Tightest { population, cores, resource, need, limit, assumed } = &**most;
                    let note = if *assumed { " (assumed: no source gives it)" } else { "" };
                    let what = resource.heading().unwrap_or_default();
                    write!(f, "; {population} is on {cores} of them, the fullest with {need} of {limit} {what}{note}")?;
                }
            }
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

/// Advice where a population with input channels as sources needs too many input axons.
const MERGE_INPUTS: &str = "every input channel that sends to a core takes one input axon there: merge polarities \
                            (halves the channels), prune inputs that never fire (--prune INPUT), pool more before this \
                            population, or split the fan-in over intermediate populations";

/// Resources of which plastic synapses take more than others.
const TAKEN_BY_RULES: [Resource; 7] = [
    Resource::AxonsIn,
    Resource::SynapseWords,
    Resource::SynapseWordsPerAxon,
    Resource::SynapseFormats,
    Resource::Accumulators,
    Resource::RuleWords,
    Resource::TraceConfigurations,
];

impl Reason {
    fn new(resource: Capacity, need: u64, limit: u64, help: String) -> Self {
        Reason { code: resource.code(), population: None, core: None, resource, need, limit, taken: None, help }
    }

    /// A compartment of a population needs more than any core has.
    pub fn of_population(network: &Quantised, id: PopulationId, resource: Capacity, need: u64, limit: u64) -> Self {
        let is_input = |source: PopulationId| network.populations()[source].first_channel().is_some();
        let from_inputs = network.incoming(id).any(|(_, p)| is_input(p.source));
        let population = Some(network.populations()[id].name.clone());
        let merge = resource == Resource::AxonsIn && from_inputs;
        let mut help = if merge { MERGE_INPUTS.into() } else { resource.advice() }.into_owned();
        let rules = network.incoming(id).filter_map(|(_, projection)| projection.format.rule);
        let learn: Vec<String> = rules.map(|rule| format!("'{}'", network.parts().rules[rule].name)).collect();
        if !learn.is_empty() && TAKEN_BY_RULES.iter().any(|one| resource == *one) {
            let plastic = "whose synapses take more of them than others";
            help += &format!("; or remove `learning` from {}, {plastic}", learn.join(", "));
        }
        Reason { population, ..Reason::new(resource, need, limit, help) }
    }

    /// A compartment of a population of this name needs more than any core has.
    pub fn of_named(population: &str, resource: Resource, need: u64, limit: u64) -> Self {
        let resource = Capacity::from(resource);
        let help = resource.advice().into_owned();
        Reason { population: Some(population.to_string()), ..Reason::new(resource, need, limit, help) }
    }

    /// A core of a given membership needs more than it has.
    pub fn of_core(core: CoreId, resource: Capacity, need: u64, limit: u64) -> Self {
        let help = format!("{}, or let nsim make a new mapping", Capacity::from(Resource::Compartments).advice());
        Reason { core: Some(core), ..Reason::new(resource, need, limit, help) }
    }

    /// A mapping takes more cores than the target has; another may take fewer. `of_each` is empty
    /// where the use of the cores was not counted.
    pub fn of_mapping(target: &Target, copies: u32, cores: u64, of_each: BTreeMap<PopulationId, Tightest>) -> Self {
        let most = of_each.into_values().max_by_key(|one| one.cores);
        let taken = Some(most.map_or(MappingUse::Uncounted, |most| MappingUse::Tightest(Box::new(most))));
        let help = larger(copies, &format!("a target of {cores} cores"));
        Reason { taken, help, ..Reason::of_cores(target, copies, cores) }
    }

    /// Any mapping needs more cores than the target has.
    pub fn of_cores(target: &Target, copies: u32, need: u64) -> Self {
        Reason::new(Capacity::Cores, need, u64::from(target.cores()), larger(copies, MORE_CORES))
    }

    /// More compartments are needed than the whole target has.
    pub fn of_compartments(target: &Target, limits: &Limits, copies: u32, need: u64) -> Self {
        let limit = u64::from(target.cores()) * u64::from(limits[Resource::Compartments]);
        Reason::new(Resource::Compartments.into(), need, limit, larger(copies, MORE_CORES))
    }
}

/// The target to choose where only a bound on the number of cores is known: a target of that size
/// may be too small.
const MORE_CORES: &str = "a target with more cores";

fn larger(copies: u32, target: &str) -> String {
    let other = if copies > 1 { "map fewer copies" } else { "use a smaller network" };
    format!("choose {target}, or {other}")
}
