//! Lower bounds on the resource use of random connectivity, before any synapse is sampled.
//!
//! Input: a network and a target. Output: the reasons for which random connectivity
//! ([`Connectivity::Random`]) cannot fit, if there are any. Each of S sources samples `F` of `m`
//! targets, so it reaches one of k given targets with a probability of
//!
//! ```text
//! q(k) = 1 - (1 - k / m)^F.
//! ```
//!
//! The number of sources that reach k targets is a sum of independent samples with mean M = S q(k).
//! It is below M - d with a probability under exp(-d^2 / 2 M) (Chernoff), and there are fewer than
//! m^k such sets of targets. Where none fits the input axons of a core, it holds fewer than k
//! targets. So each source reaches more cores, and takes more output axons. The bounds hold except
//! with a probability of e^-45, less likely than a memory error.
//!
//! The slots that full cores are expected to use also start the filling of cores of a large network
//! ([`expected_slots`]).
//!
//! Ignored: other kinds of projections, and sources that share input axons because they are sources
//! of windows too.

use std::ops::Range;

use crate::reason::Reason;
use crate::resources::axon_sharing::Places;
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::id::{PopulationId, ProjectionId};
use nsim_ir::hardware::Target;
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::quantised::{Population, Projection, Quantised};
use nsim_ir::resource::Resource;

/// Negative natural logarithm of the probability that a bound is wrong.
const LOG_INVERSE_ERROR: f64 = 45.0;

/// Most rounds of an estimate.
const ROUNDS: usize = 32;

/// Sizes of one projection with random connectivity.
struct RandomProjection {
    sources: f64,
    fan_out: f64,
    targets: f64,
}

impl RandomProjection {
    /// Probability that a source reaches any of `together` targets.
    fn reaches(&self, together: f64) -> f64 {
        -(self.fan_out * (-together / self.targets).ln_1p()).exp_m1()
    }

    /// Lower bound on the pairs of a source and a target that it reaches (McDiarmid: a sample
    /// changes their number by one at most).
    fn min_pairs(&self) -> f64 {
        let mean = self.sources * self.targets * self.reaches(1.0);
        (mean - (self.sources * self.fan_out * LOG_INVERSE_ERROR / 2.0).sqrt()).max(0.0)
    }
}

fn random_projection(connectivity: &Connectivity, source: &Population) -> Option<RandomProjection> {
    let &Connectivity::Random { targets, fan_out, .. } = connectivity else { return None };
    let sources = f64::from(source.shape.len());
    Some(RandomProjection { sources, fan_out: fan_out.into(), targets: targets.into() })
}

/// Random projections into a population that are independent of each other, from sources that take
/// an input axon each.
fn independent(network: &Quantised, id: PopulationId, places: &Places) -> Vec<RandomProjection> {
    let mut accepted: Vec<(PopulationId, u64, Range<u64>)> = Vec::new();
    let mut projections = Vec::new();
    for projection in network.incoming(id).map(|(_, p)| p).filter(|p| !places.contain(network, p.source)) {
        let source = &network.populations()[projection.source];
        let &Connectivity::Random { seed, first_source, .. } = &projection.connectivity else { continue };
        let range = u64::from(first_source)..u64::from(first_source) + u64::from(source.shape.len());
        let depends = |(of, other_seed, other): &(PopulationId, u64, Range<u64>)| {
            *of == projection.source || *other_seed == seed && other.start < range.end && range.start < other.end
        };
        if !accepted.iter().any(depends) {
            projections.extend(random_projection(&projection.connectivity, source));
            accepted.push((projection.source, seed, range));
        }
    }
    projections
}

/// Most compartments of a population that a core can hold, and a lower bound on the sources of one.
fn most_together(network: &Quantised, id: PopulationId, places: &Places, target: &Target) -> (u32, f64) {
    let (limits, size) = (target.limits(), network.populations()[id].shape.len());
    let most = limits[Resource::Compartments].min(size);
    let into = independent(network, id, places);
    let least_sources = |together: u32| {
        let k = f64::from(together);
        let mean: f64 = into.iter().map(|random| random.sources * random.reaches(k)).sum();
        mean - (2.0 * mean * (k * f64::from(size.max(1)).ln() + LOG_INVERSE_ERROR)).sqrt()
    };
    let too_many = |&k: &u32| least_sources(k) > f64::from(limits[Resource::AxonsIn]);
    ((1..=most).find(too_many).map_or(most, |k| k - 1), least_sources(1))
}

/// Returns the reasons for which random connectivity cannot fit; empty where it may. With `relays`
/// a source may have as many relays as its targets need.
pub fn reasons(network: &Quantised, target: &Target, copies: u32, relays: bool) -> Vec<Reason> {
    let (limits, places) = (target.limits(), Places::for_network(network, target.limits()));
    let mut reasons = Vec::new();
    let (mut by_targets, mut slots, mut why) = (0u64, 0.0, Vec::new());
    for (id, population) in network.populations().enumerate() {
        let is_random = |(_, p): (_, &Projection)| matches!(p.connectivity, Connectivity::Random { .. });
        if population.first_compartment().is_none() || !network.incoming(id).any(is_random) {
            continue;
        }
        let (per_core, sources) = most_together(network, id, &places, target);
        if per_core == 0 {
            let need = sources.ceil() as u64;
            let limit = limits[Resource::AxonsIn].into();
            reasons.push(Reason::of_population(network, id, Resource::AxonsIn.into(), need, limit));
            continue;
        }
        let size = population.shape.len();
        by_targets = by_targets.max(u64::from(size.div_ceil(per_core)));
        if per_core < limits[Resource::Compartments].min(size) {
            why.push(format!(
                "{} compartments of {} together have more sources than the {} input axons of a core",
                per_core + 1,
                population.name,
                limits[Resource::AxonsIn]
            ));
        }
    }
    for (id, population) in network.populations().enumerate() {
        if population.first_compartment().is_none() || places.contain(network, id) {
            continue;
        }
        // Targets of several projections may share cores, so the projection that reaches most
        // counts.
        let reached = |&p: &ProjectionId| {
            let projection = &network.projections()[p];
            let random = random_projection(&projection.connectivity, population)?;
            let (per_core, _) = most_together(network, projection.target, &places, target);
            (per_core > 0).then(|| random.min_pairs() / f64::from(per_core))
        };
        let Some(pairs) = network.outgoing(id).iter().filter_map(reached).reduce(f64::max) else { continue };
        let size = f64::from(population.shape.len().max(1));
        let (each, most) = ((pairs / size).ceil(), f64::from(limits[Resource::AxonsOutPerCompartment]));
        if each > most && !relays {
            let (capacity, limit) = (Resource::AxonsOutPerCompartment.into(), most as u64);
            reasons.push(Reason::of_population(network, id, capacity, each as u64, limit));
        }
        // A compartment, or a relay, has no more targets on its own chip than the chip has cores.
        let synapses: u64 =
            network.outgoing(id).iter().map(|&p| network.projections()[p].connectivity.count_from(0)).sum();
        let of_source = if relays { 2.0 * (synapses as f64 / (most - 1.0).max(1.0)).ceil() } else { 0.0 };
        let near = (size * (1.0 + of_source) * f64::from(target.chip().cores)).min(pairs);
        let (on_chip, off_chip) = (f64::from(limits.axon_out_slots), f64::from(limits.axon_out_slots_off_chip));
        slots += near * on_chip.min(off_chip) + (pairs - near) * off_chip;
        why.push(format!("compartments of {} reach {each} cores each", population.name));
    }
    let by_outputs = (slots / f64::from(limits[Resource::AxonsOut].max(1))).ceil() as u64;
    let cores = by_targets.max(by_outputs).saturating_mul(copies.into());
    if cores > u64::from(target.cores()) {
        if by_outputs >= by_targets {
            why.push(format!("that takes {slots:.0} slots of output axons, {} a core", limits[Resource::AxonsOut]));
        }
        let reason = Reason::of_cores(target, copies, cores);
        reasons.push(Reason { help: format!("{}; {}", why.join(", "), reason.help), ..reason });
    }
    reasons
}

/// Expected output axon slots of a compartment of a population for its randomly sampled targets, in
/// a partition whose cores are full of such compartments.
pub fn expected_slots(network: &Quantised, id: PopulationId, target: &Target) -> u32 {
    let limits = target.limits();
    let population = &network.populations()[id];
    let into = network.outgoing(id).iter().map(|&p| &network.projections()[p].connectivity);
    let all: Vec<RandomProjection> = into.filter_map(|into| random_projection(into, population)).collect();
    let (on_chip, off_chip) = (f64::from(limits.axon_out_slots), f64::from(limits.axon_out_slots_off_chip));
    let slots = |per_core: f64| -> f64 {
        let of_projection = |random: &RandomProjection| {
            let cores = (random.targets / per_core).max(1.0);
            let near = (f64::from(target.chip().cores) / cores).min(1.0);
            cores * random.reaches(per_core.min(random.targets)) * (near * on_chip + (1.0 - near) * off_chip)
        };
        all.iter().map(of_projection).sum()
    };
    // Fewer compartments on a core mean more cores to reach, so `held` descends.
    let mut per_core = f64::from(limits[Resource::Compartments]);
    for _ in 0..ROUNDS {
        let fewer = (f64::from(limits[Resource::AxonsOut]) / slots(per_core)).floor().clamp(1.0, per_core);
        if fewer == per_core {
            break;
        }
        per_core = fewer;
    }
    slots(per_core).ceil() as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::resource::Capacity;
    use nsim_testing::{Builder, limits, target};

    fn recurrent(size: u32, fan_out: u32) -> Quantised {
        let mut builder = Builder::new();
        let (input, all) = (builder.input("in", 4), builder.loihi("all", size));
        builder.random(input, all, 10, 1);
        builder.random(all, all, fan_out, 2);
        builder.build()
    }

    /// The need of a resource, if it is a reason.
    fn need(reasons: &[Reason], resource: impl Into<Capacity>) -> Option<u64> {
        let resource = resource.into();
        reasons.iter().find(|reason| reason.resource == resource).map(|reason| reason.need)
    }

    #[test]
    fn a_network_of_the_size_of_the_cortical_microcircuit_is_refused_with_the_counting_argument() {
        let network = recurrent(77_169, 3_873);
        let board = target(32, 24, limits());
        let found = reasons(&network, &board, 1, false);
        let each = need(&found, Resource::AxonsOutPerCompartment).unwrap();
        assert!((3_700..=3_777).contains(&each), "{each}");
        // 2 * 77,169 * 3,777 slots, except for targets on the source's own chip.
        let cores = need(&found, Capacity::Cores).unwrap();
        assert!((130_000..142_400).contains(&cores), "{cores}");
        let text = found.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n");
        assert!(text.contains("2 compartments of all together have more sources than the 4096 input axons"), "{text}");
        let relayed = reasons(&network, &board, 1, true);
        assert_eq!(need(&relayed, Resource::AxonsOutPerCompartment), None);
        assert!(need(&relayed, Capacity::Cores).unwrap() > 98_304);
        let wide = limits().with(Resource::AxonsIn, 65_536).with(Resource::AxonsOut, 65_536);
        assert!(reasons(&network, &target(32, 24, wide), 1, true).is_empty());
    }
}
