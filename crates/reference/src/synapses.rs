//! Real synapses, enumerated from their source.

use nsim_dynamics::synapses::{for_each_of_kernel, for_each_of_pool};
use nsim_ir::base::rng;
use nsim_ir::graph::{Projection, ProjectionKind, Window};

use super::real::Real;

/// Synapses from the sources of a projection to its targets. Indices are within the populations.
#[derive(Debug, Clone)]
pub enum Synapses<F> {
    /// All to all.
    Dense {
        /// Number of targets.
        targets: u32,
        /// `[source][target]`.
        weights: Vec<F>,
    },
    /// Listed synapses; source s has `first[s]..first[s + 1]`.
    List {
        /// One more than sources.
        first: Vec<usize>,
        /// (target, weight) of each synapse.
        synapses: Vec<(u32, F)>,
    },
    /// Cross-correlation.
    Conv {
        /// Geometry.
        window: Window,
        /// `[C'][C / groups][kh][kw]`.
        kernel: Vec<F>,
    },
    /// One weight for every position of a window.
    Pool {
        /// Geometry.
        window: Window,
        /// The weight.
        weight: F,
    },
}

impl<F: Real> Synapses<F> {
    /// The synapses of a projection, each weight times `factor`.
    pub fn new(projection: &Projection, sources: u32, targets: u32, factor: f64) -> Self {
        match &projection.kind {
            ProjectionKind::Dense { weights, .. } => {
                let columns = weights.shape().get(1).copied().unwrap_or(1);
                let first = projection.first_source as usize;
                let weight = |source: usize, target: usize| weights.real(target * columns + first + source) * factor;
                let all = (0..sources as usize).flat_map(|s| (0..targets as usize).map(move |t| (s, t)));
                Synapses::Dense { targets, weights: all.map(|(s, t)| F::from_f64(weight(s, t))).collect() }
            }
            ProjectionKind::Sparse { synapses } => {
                let each = synapses.iter().map(|&(source, target, weight, _)| (source, target, weight * factor));
                Self::list(sources, each.collect())
            }
            ProjectionKind::Conv2d { window, weights, .. } => {
                let kernel = (0..weights.len()).map(|i| F::from_f64(weights.real(i) * factor)).collect();
                Synapses::Conv { window: *window, kernel }
            }
            ProjectionKind::SumPool2d { window, weight } => {
                Synapses::Pool { window: *window, weight: F::from_f64(weight.value * factor) }
            }
            ProjectionKind::Random { fan_out, low, high, seed } => {
                // `docs/semantics.md`, projections; weights are multiples of the format's least
                // step.
                let bits = nsim_ir::base::fixed::WeightBits::new(projection.weight_bits.value);
                let step = bits.map_or(1, |bits| i64::from(projection.sign.step(bits)));
                let levels = ((high.value - low.value) / step + 1).max(1) as u64;
                let draw = |source: u32, k: u64| {
                    let entity = u64::from(projection.first_source) + u64::from(source);
                    let target = rng::below(u64::from(targets), *seed, entity, 2 * k) as u32;
                    let level = rng::below(levels, *seed, entity, 2 * k + 1) as i64;
                    (source, target, (low.value + step * level) as f64 * factor)
                };
                let all = (0..sources).flat_map(|s| (0..u64::from(*fan_out)).map(move |k| (s, k)));
                Self::list(sources, all.map(|(s, k)| draw(s, k)).collect())
            }
        }
    }

    /// A list of synapses from (source, target, weight), in any order.
    pub fn list(sources: u32, mut synapses: Vec<(u32, u32, f64)>) -> Self {
        synapses.sort_by_key(|&(source, target, _)| (source, target));
        let first = (0..=sources).map(|s| synapses.partition_point(|&(source, ..)| source < s)).collect();
        Synapses::List { first, synapses: synapses.into_iter().map(|(_, t, w)| (t, F::from_f64(w))).collect() }
    }

    /// Adds a source's spike to the sums of its targets; returns the number of its synapses.
    pub fn deliver(&self, source: u32, sums: &mut [F]) -> u64 {
        let mut count = 0;
        let mut add = |target: u32, weight: F| {
            sums[target as usize] += weight;
            count += 1;
        };
        match self {
            Synapses::Dense { targets, weights } => {
                let row = source as usize * *targets as usize;
                for (sum, &weight) in sums.iter_mut().zip(&weights[row..row + *targets as usize]) {
                    *sum += weight;
                }
                return u64::from(*targets);
            }
            Synapses::List { first, synapses } => {
                let own = &synapses[first[source as usize]..first[source as usize + 1]];
                own.iter().for_each(|&(target, weight)| add(target, weight));
            }
            Synapses::Conv { window, kernel } => {
                for_each_of_kernel(window, source, |target, place| add(target, kernel[place]));
            }
            Synapses::Pool { window, weight } => for_each_of_pool(window, source, |target| add(target, *weight)),
        }
        count
    }
}
