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

/// The logarithm of the chance that is left for a bound to be wrong.
const DOUBT: f64 = 45.0;

/// Most rounds of an estimate.
const ROUNDS: usize = 32;

/// Draws of one projection.
struct Draws {
    sources: f64,
    fan_out: f64,
    targets: f64,
}

impl Draws {
    /// The chance that a source reaches one of this many targets.
    fn reaches(&self, together: f64) -> f64 {
        -(self.fan_out * (-together / self.targets).ln_1p()).exp_m1()
    }

    /// Pairs of a source and a target that it reaches, at least (McDiarmid: a draw changes them by
    /// one at most).
    fn least_pairs(&self) -> f64 {
        let mean = self.sources * self.targets * self.reaches(1.0);
        (mean - (self.sources * self.fan_out * DOUBT / 2.0).sqrt()).max(0.0)
    }
}

fn draws(connectivity: &Connectivity, source: &Population) -> Option<Draws> {
    let &Connectivity::Random { targets, fan_out, .. } = connectivity else { return None };
    let sources = f64::from(source.shape.len());
    Some(Draws { sources, fan_out: fan_out.into(), targets: targets.into() })
}

/// Draws into a population that are independent of each other, of sources that take an input axon
/// each.
fn independent(network: &Quantised, id: PopulationId, places: &Places) -> Vec<Draws> {
    let mut kept: Vec<(PopulationId, u64, Range<u64>)> = Vec::new();
    let mut draws_into = Vec::new();
    for projection in network.incoming(id).map(|(_, p)| p).filter(|p| !places.holds(network, p.source)) {
        let source = &network.populations()[projection.source];
        let &Connectivity::Random { seed, first_source, .. } = &projection.connectivity else { continue };
        let range = u64::from(first_source)..u64::from(first_source) + u64::from(source.shape.len());
        let depends = |(of, other_seed, other): &(PopulationId, u64, Range<u64>)| {
            *of == projection.source || *other_seed == seed && other.start < range.end && range.start < other.end
        };
        if !kept.iter().any(depends) {
            draws_into.extend(draws(&projection.connectivity, source));
            kept.push((projection.source, seed, range));
        }
    }
    draws_into
}

/// Most compartments of a population that a core can hold, and a lower bound on the sources of one.
fn most_together(network: &Quantised, id: PopulationId, places: &Places, target: &Target) -> (u32, f64) {
    let (limits, size) = (target.limits(), network.populations()[id].shape.len());
    let most = limits[Resource::Compartments].min(size);
    let into = independent(network, id, places);
    let least_sources = |together: u32| {
        let k = f64::from(together);
        let mean: f64 = into.iter().map(|draws| draws.sources * draws.reaches(k)).sum();
        mean - (2.0 * mean * (k * f64::from(size.max(1)).ln() + DOUBT)).sqrt()
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
        let drawn = |(_, p): (_, &Projection)| matches!(p.connectivity, Connectivity::Random { .. });
        if population.first_compartment().is_none() || !network.incoming(id).any(drawn) {
            continue;
        }
        let (held, sources) = most_together(network, id, &places, target);
        if held == 0 {
            let need = sources.ceil() as u64;
            let limit = limits[Resource::AxonsIn].into();
            reasons.push(Reason::of_population(network, id, Resource::AxonsIn.into(), need, limit));
            continue;
        }
        let size = population.shape.len();
        by_targets = by_targets.max(u64::from(size.div_ceil(held)));
        if held < limits[Resource::Compartments].min(size) {
            why.push(format!(
                "{} compartments of {} together have more sources than the {} input axons of a core",
                held + 1,
                population.name,
                limits[Resource::AxonsIn]
            ));
        }
    }
    for (id, population) in network.populations().enumerate() {
        if population.first_compartment().is_none() || places.holds(network, id) {
            continue;
        }
        // Targets of several projections may share cores, so the projection that reaches most
        // counts.
        let reached = |&p: &ProjectionId| {
            let projection = &network.projections()[p];
            let draws = draws(&projection.connectivity, population)?;
            let (held, _) = most_together(network, projection.target, &places, target);
            (held > 0).then(|| draws.least_pairs() / f64::from(held))
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
    let all: Vec<Draws> = into.filter_map(|connectivity| draws(connectivity, population)).collect();
    let (on_chip, off_chip) = (f64::from(limits.axon_out_slots), f64::from(limits.axon_out_slots_off_chip));
    let slots = |held: f64| -> f64 {
        let of_projection = |draws: &Draws| {
            let cores = (draws.targets / held).max(1.0);
            let near = (f64::from(target.chip().cores) / cores).min(1.0);
            cores * draws.reaches(held.min(draws.targets)) * (near * on_chip + (1.0 - near) * off_chip)
        };
        all.iter().map(of_projection).sum()
    };
    // Fewer compartments on a core are more cores to reach; so this descends.
    let mut held = f64::from(limits[Resource::Compartments]);
    for _ in 0..ROUNDS {
        let fewer = (f64::from(limits[Resource::AxonsOut]) / slots(held)).floor().clamp(1.0, held);
        if fewer == held {
            break;
        }
        held = fewer;
    }
    slots(held).ceil() as u32
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
        let said = found.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n");
        assert!(said.contains("2 compartments of all together have more sources than the 4096 input axons"), "{said}");
        let relayed = reasons(&network, &board, 1, true);
        assert_eq!(need(&relayed, Resource::AxonsOutPerCompartment), None);
        assert!(need(&relayed, Capacity::Cores).unwrap() > 98_304);
        let wide = limits().with(Resource::AxonsIn, 65_536).with(Resource::AxonsOut, 65_536);
        assert!(reasons(&network, &target(32, 24, wide), 1, true).is_empty());
    }
}
