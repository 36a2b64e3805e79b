//! Real synapses, enumerated from their source.
//!
//! A spike over a convolution reaches all channels of some positions. Sums of such a target are
//! therefore ordered by position ([`SumOrder`]), so that a spike adds rows of adjacent weights to
//! rows of adjacent sums. Each sum has the same terms in the same order as in the plain loop.

use nsim_dynamics::synapses::{for_each_of_pool, for_each_position};
use nsim_ir::base::rng;
use nsim_ir::graph::{Projection, ProjectionKind, Window};

use super::real::Real;

/// The order of the sums of a population: channels within positions. Units are positions within
/// channels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SumOrder {
    channels: u32,
    positions: u32,
}

/// Fewest channels of a convolution's group that are worth sums in another order.
const WORTH_ORDERING: u32 = 4;

impl SumOrder {
    /// The order of the units.
    pub fn of_units(count: u32) -> Self {
        SumOrder { channels: 1, positions: count }
    }

    /// The order for `count` units and the projections to them.
    pub fn for_projections<'p>(count: u32, mut projections: impl Iterator<Item = &'p Projection>) -> Self {
        let channels = projections.find_map(|projection| match &projection.kind {
            ProjectionKind::Conv2d { window, .. } if window.target.0 / window.groups >= WORTH_ORDERING => {
                Some(window.target.0)
            }
            _ => None,
        });
        channels.map_or(Self::of_units(count), |channels| SumOrder { channels, positions: count / channels })
    }

    /// Number of units.
    pub fn count(self) -> u32 {
        self.channels * self.positions
    }

    /// Place of a unit's sum.
    pub fn place(self, unit: u32) -> u32 {
        if self.channels == 1 { unit } else { unit % self.positions * self.channels + unit / self.positions }
    }

    /// The sums in the order of the units. `buffer` holds them where these orders differ.
    pub fn by_unit<'s, F: Copy>(self, sums: &'s [F], buffer: &'s mut Vec<F>) -> &'s [F] {
        if self.channels == 1 {
            return sums;
        }
        let channels = self.channels as usize;
        buffer.clear();
        (0..channels).for_each(|channel| buffer.extend(sums[channel..].iter().step_by(channels)));
        buffer
    }
}

/// Synapses from the sources of a projection to its targets. Sources are units, targets are places
/// of sums in a [`SumOrder`].
#[derive(Debug, Clone)]
pub enum Synapses<F> {
    /// All to all.
    Dense {
        /// Number of targets.
        targets: u32,
        /// `[source][place of the target]`.
        weights: Vec<F>,
    },
    /// Listed synapses; source s has `first[s]..first[s + 1]`.
    List {
        /// One more than sources.
        first: Vec<usize>,
        /// (place of the target, weight) of each synapse.
        synapses: Vec<(u32, F)>,
    },
    /// Cross-correlation.
    Conv {
        /// Geometry.
        window: Window,
        /// `[C][kh][kw][C' / groups]`.
        kernel: Vec<F>,
        /// Targets of each source position.
        reach: Reach,
        /// Order of the sums.
        order: SumOrder,
    },
    /// One weight for every position of a window.
    Pool {
        /// Geometry.
        window: Window,
        /// The weight.
        weight: F,
        /// Order of the sums.
        order: SumOrder,
    },
}

impl<F: Real> Synapses<F> {
    /// The synapses of a projection onto sums in this order, each weight times `factor`.
    pub fn new(projection: &Projection, sources: u32, order: SumOrder, factor: f64) -> Self {
        let targets = order.count();
        match &projection.kind {
            ProjectionKind::Dense { weights, .. } => {
                let columns = weights.shape().get(1).copied().unwrap_or(1);
                let first = projection.first_source as usize;
                let weight = |source: usize, target: usize| weights.real(target * columns + first + source) * factor;
                Self::dense(sources, order, |source, target| weight(source as usize, target as usize))
            }
            ProjectionKind::Sparse { synapses } => {
                let each = synapses.iter().map(|&(source, target, weight, _)| (source, target, weight * factor));
                Self::list(sources, order, each.collect())
            }
            ProjectionKind::Conv2d { window, weights, .. } => {
                Self::convolution(*window, order, |place| weights.real(place) * factor)
            }
            ProjectionKind::SumPool2d { window, weight } => {
                Synapses::Pool { window: *window, weight: F::from_f64(weight.value * factor), order }
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
                Self::list(sources, order, all.map(|(s, k)| draw(s, k)).collect())
            }
        }
    }

    /// All to all; `weight` returns the weight from a source to a target.
    pub fn dense(sources: u32, order: SumOrder, weight: impl Fn(u32, u32) -> f64) -> Self {
        let targets = order.count();
        let mut weights = vec![F::default(); sources as usize * targets as usize];
        for (source, row) in (0..).zip(weights.chunks_mut((targets as usize).max(1))) {
            (0..targets).for_each(|target| row[order.place(target) as usize] = F::from_f64(weight(source, target)));
        }
        Synapses::Dense { targets, weights }
    }

    /// A list of synapses from (source, target, weight), in any order.
    pub fn list(sources: u32, order: SumOrder, mut synapses: Vec<(u32, u32, f64)>) -> Self {
        synapses.sort_by_key(|&(source, target, _)| (source, target));
        let first = (0..=sources).map(|s| synapses.partition_point(|&(source, ..)| source < s)).collect();
        let places = synapses.into_iter().map(|(_, target, weight)| (order.place(target), F::from_f64(weight)));
        Synapses::List { first, synapses: places.collect() }
    }

    /// A convolution; `weight` returns the weight at a place of `[C'][C / groups][kh][kw]`.
    pub fn convolution(window: Window, order: SumOrder, weight: impl Fn(usize) -> f64) -> Self {
        let taps = (window.kernel.0 * window.kernel.1) as usize;
        let sources_of_group = (window.source.0 / window.groups) as usize;
        let targets_of_group = (window.target.0 / window.groups) as usize;
        let mut kernel = Vec::with_capacity(window.source.0 as usize * taps * targets_of_group);
        for source in 0..window.source.0 as usize {
            let first_target = source / sources_of_group * targets_of_group;
            for tap in 0..taps {
                for target in first_target..first_target + targets_of_group {
                    let place = (target * sources_of_group + source % sources_of_group) * taps + tap;
                    kernel.push(F::from_f64(weight(place)));
                }
            }
        }
        Synapses::Conv { window, kernel, reach: Reach::new(&window), order }
    }

    /// Adds a source's spike to the sums of its targets; returns the number of its synapses.
    pub fn deliver(&self, source: u32, sums: &mut [F]) -> u64 {
        match self {
            Synapses::Dense { targets, weights } => {
                let row = source as usize * *targets as usize;
                add_all(sums, &weights[row..row + *targets as usize]);
                u64::from(*targets)
            }
            Synapses::List { first, synapses } => {
                let own = &synapses[first[source as usize]..first[source as usize + 1]];
                own.iter().for_each(|&(place, weight)| sums[place as usize] += weight);
                own.len() as u64
            }
            Synapses::Conv { window, kernel, reach, order } => {
                let channel = source / (window.source.1 * window.source.2);
                let width = (window.target.0 / window.groups) as usize;
                let first_target = (channel / (window.source.0 / window.groups)) as usize * width;
                let of_channel = (window.kernel.0 * window.kernel.1) as usize * width;
                let rows = &kernel[channel as usize * of_channel..][..of_channel];
                let plane = (window.target.1 * window.target.2) as usize;
                let reached = reach.targets_from(source % (window.source.1 * window.source.2));
                for &(tap, position) in reached {
                    let (row, position) = (&rows[tap as usize * width..][..width], position as usize);
                    if order.channels == 1 {
                        let sums = sums[first_target * plane + position..].iter_mut().step_by(plane);
                        sums.zip(row).for_each(|(sum, &weight)| *sum += weight);
                    } else {
                        add_all(&mut sums[position * order.channels as usize + first_target..], row);
                    }
                }
                (reached.len() * width) as u64
            }
            Synapses::Pool { window, weight, order } => {
                let mut count = 0;
                for_each_of_pool(window, source, |target| {
                    sums[order.place(target) as usize] += *weight;
                    count += 1;
                });
                count
            }
        }
    }
}

/// Target positions of a window, by source position.
#[derive(Debug, Clone)]
pub struct Reach {
    first: Vec<u32>,
    /// Place in the kernel, and target position.
    targets: Vec<(u32, u32)>,
}

impl Reach {
    fn new(window: &Window) -> Self {
        let (mut first, mut targets) = (vec![0], Vec::new());
        for source in 0..window.source.1 * window.source.2 {
            for_each_position(window, source, |y, x, ky, kx| {
                targets.push((ky * window.kernel.1 + kx, y * window.target.2 + x));
            });
            first.push(targets.len() as u32);
        }
        Reach { first, targets }
    }

    fn targets_from(&self, source_position: u32) -> &[(u32, u32)] {
        let at = source_position as usize;
        &self.targets[self.first[at] as usize..self.first[at + 1] as usize]
    }
}

/// Adds weights to as many sums.
fn add_all<F: Real>(sums: &mut [F], weights: &[F]) {
    sums.iter_mut().zip(weights).for_each(|(sum, &weight)| *sum += weight);
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_dynamics::synapses::for_each_of_kernel;
    use nsim_ir::base::rng;

    /// A window, and the size of its source and target.
    fn window(seed: u64) -> Window {
        let draw = |k: u64, from: u32, to: u32| from + rng::below(u64::from(to - from + 1), seed, 0, k) as u32;
        let groups = draw(0, 1, 3);
        let (kernel, stride) = ((draw(1, 1, 3), draw(2, 1, 5)), (draw(3, 1, 3), draw(4, 1, 2)));
        let (padding, dilation) = ((draw(5, 0, 2), draw(6, 0, 1)), (draw(7, 1, 2), draw(8, 1, 2)));
        let source = (groups * draw(9, 1, 3), draw(10, 7, 9), draw(11, 9, 12));
        let along = |size: u32, kernel: u32, stride: u32, padding: u32, dilation: u32| {
            (size + 2 * padding - dilation * (kernel - 1) - 1) / stride + 1
        };
        let target = (
            groups * draw(12, 1, 7),
            along(source.1, kernel.0, stride.0, padding.0, dilation.0),
            along(source.2, kernel.1, stride.1, padding.1, dilation.1),
        );
        Window { source, target, kernel, stride, padding, dilation, groups }
    }

    #[test]
    fn convolutions_add_what_the_plain_loop_adds_in_every_order_of_sums() {
        let mut by_position = 0;
        for seed in 0..200 {
            let window = window(seed);
            let weight = |place: usize| rng::unit(seed, 1, place as u64) - 0.5;
            let (sources, count) = (
                window.source.0 * window.source.1 * window.source.2,
                window.target.0 * window.target.1 * window.target.2,
            );
            let positions = window.target.1 * window.target.2;
            let units = SumOrder::of_units(count);
            let ordered = SumOrder { channels: window.target.0, positions };
            by_position += u32::from(window.target.0 > 1);
            let mut expected = vec![0.0; count as usize];
            let mut sums = [vec![0.0; count as usize], vec![0.0; count as usize]];
            let synapses = [units, ordered].map(|order| Synapses::<f64>::convolution(window, order, weight));
            for source in (0..sources).filter(|source| rng::below(3, seed, 2, u64::from(*source)) == 0) {
                let mut events = 0;
                for_each_of_kernel(&window, source, |target, place| {
                    expected[target as usize] += weight(place);
                    events += 1;
                });
                for (synapses, sums) in synapses.iter().zip(&mut sums) {
                    assert_eq!(synapses.deliver(source, sums), events, "seed {seed}");
                }
            }
            for (order, sums) in [units, ordered].into_iter().zip(&sums) {
                assert_eq!(order.by_unit(sums, &mut Vec::new()), expected, "seed {seed}, {order:?}");
                assert!((0..count).all(|unit| sums[order.place(unit) as usize] == expected[unit as usize]));
            }
        }
        assert!(by_position > 100);
    }
}
