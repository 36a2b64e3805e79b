//! Whether the synapses of a network have a structure that grouping compartments could follow.
//!
//! Input: a network. Output: whether the targets of a compartment's targets coincide no more often
//! than if sampled evenly. They coincide more often in neighbourhoods (small worlds, maps) and
//! where some compartments have many sources (hubs). In random networks they do not; there groups
//! save a few percent of the cores and cost most of the time of mapping. A sample of compartments
//! decides, so that the answer takes milliseconds for any network.

use std::collections::HashSet;

use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::id::{CompartmentId, Id};
use nsim_ir::base::rng;
use nsim_ir::quantised::Quantised;

/// Number of compartments whose targets' targets are counted.
const SAMPLE: u64 = 256;
/// Most targets of each, and most targets of each of these, that are counted.
const TARGETS: usize = 16;
const THEIR_TARGETS: usize = 256;
/// Ratio to the coincidences by chance above which there is structure, and standard deviations of
/// chance that are added. Hubs that are reached with a probability of 1 / sqrt(j) coincide ln(n) /
/// 4 times as often: 2.3 times among 10,000.
const FACTOR: f64 = 1.25;
const DEVIATIONS: f64 = 6.0;
const SEED: u64 = 0x57ac;

/// Whether targets of targets coincide no more often than if sampled evenly; `false` when
/// compartments have too few targets to decide.
pub fn is_uniform(network: &Quantised) -> bool {
    let n = u64::from(network.compartments());
    let (mut seen, mut pairs, mut coincide, mut by_chance) = (HashSet::new(), 0u64, 0u64, 0.0);
    for draw in 0..SAMPLE.min(n) {
        let first = rng::below(n, SEED, draw, 0) as u32;
        let (mut all, mut reachable) = (0u64, 0u64);
        seen.clear();
        for target in targets(network, first, TARGETS).0 {
            let (theirs, size) = targets(network, target, THEIR_TARGETS);
            reachable = reachable.max(size);
            all += theirs.len() as u64;
            seen.extend(theirs);
        }
        pairs += all;
        coincide += all - seen.len() as u64;
        let (sampled, from) = (all as f64, reachable.max(1) as f64);
        by_chance += sampled - from * (1.0 - (-sampled / from).exp());
    }
    let chance = FACTOR * by_chance + DEVIATIONS * by_chance.sqrt();
    pairs >= SAMPLE.min(n) * TARGETS as u64 && (coincide as f64) < chance
}

/// Targets of a compartment, each once, evenly spaced where there are more than `most`; and the
/// number of compartments of its target populations.
fn targets(network: &Quantised, id: u32, most: usize) -> (Vec<u32>, u64) {
    let (population, index) = network.population_of(CompartmentId::new(id as usize));
    let (mut reached, mut size) = (Vec::new(), 0);
    for (_, projection, first) in network.targets_of(population) {
        size += u64::from(network.populations()[projection.target].shape.len());
        projection.connectivity.for_each_target(index, |target| reached.push(first.0 + target));
    }
    reached.sort_unstable();
    reached.dedup();
    let step = reached.len().div_ceil(most).max(1);
    (reached.into_iter().step_by(step).collect(), size)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::quantised::connectivity::Connectivity;
    use nsim_testing::{Builder, plain_format};

    /// A network in which each of `n` compartments reaches the compartments
    /// `target(source, synapse)`.
    fn network(n: u32, target: impl Fn(u32, u64) -> u32) -> Quantised {
        let mut builder = Builder::new();
        let layer = builder.loihi("n", n);
        let targets: Vec<u32> = (0..n)
            .flat_map(|source| {
                let mut reached: Vec<u32> = (0..32).map(|synapse| target(source, synapse)).collect();
                reached.sort_unstable();
                reached
            })
            .collect();
        let (first, weights) = ((0..=u64::from(n)).map(|source| 32 * source).collect(), vec![2; targets.len()].into());
        let synapses = Connectivity::Sparse { first, targets: targets.into(), weights };
        builder.connect(layer, layer, plain_format(), 0, synapses);
        builder.build()
    }

    #[test]
    fn random_networks_are_uniform_and_neighbourhoods_and_hubs_are_not() {
        for n in [10_000, 60_000] {
            let even = |source: u32, k: u64| rng::below(n.into(), 1, source.into(), k) as u32;
            assert!(is_uniform(&network(n, even)), "{n}, drawn evenly");
            let near = |source: u32, k: u64| if k == 0 { even(source, k) } else { (source + k as u32) % n };
            assert!(!is_uniform(&network(n, near)), "{n}, neighbours");
            // To compartment j with a probability that falls as 1 / sqrt(j).
            let hub = |source: u32, k: u64| (f64::from(n) * rng::unit(2, source.into(), k).powi(2)) as u32;
            assert!(!is_uniform(&network(n, hub)), "{n}, hubs");
            let blocks = |source: u32, k: u64| source / 500 * 500 + even(source, k) % 500;
            assert!(!is_uniform(&network(n, blocks)), "{n}, blocks");
        }
        assert!(!is_uniform(&nsim_testing::slip(100)));
    }
}
