//! How a population's spikes reach another: which synapses a source has, and their integer weights.
//!
//! Input: the index of a source within its population. Output: its synapses, one after the other, as (target within its
//! population, weight mantissa). Kernels and drawn synapses stay described and are enumerated here for the compiler and the checker; the
//! golden interpreter, which is compared with them, has its own enumeration. Populations and delay are left to
//! [`Projection`](super::Projection).

use std::sync::Arc;

use crate::base::fixed::{SignMode, WeightBits, WeightExponent, scaled_weight};
use crate::base::rng;
use crate::graph::{Shape, Window};

/// The format that the synapses of a projection are stored in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SynapseFormat {
    /// Weight exponent.
    pub exponent: WeightExponent,
    /// Sign mode.
    pub sign: SignMode,
    /// Bits of a weight.
    pub bits: WeightBits,
}

impl SynapseFormat {
    /// Equation (1): what a spike over a weight of this format adds to the accumulator.
    #[inline]
    #[must_use]
    pub fn scaled(self, weight: i16) -> i32 {
        scaled_weight(weight, self.exponent)
    }
}

/// How the sources of a projection reach its targets, with integer weights.
#[derive(Debug, Clone, PartialEq)]
pub enum Connectivity {
    /// All to all; row-major `[source][target]`, so that a spike walks one row.
    Dense {
        /// Number of targets.
        targets: u32,
        /// The weights.
        weights: Arc<[i16]>,
    },
    /// Listed synapses: those of source s are `first[s]..first[s + 1]`.
    Sparse {
        /// One more than sources.
        first: Arc<[u64]>,
        /// Target of each synapse; ascending within a source.
        targets: Arc<[u32]>,
        /// Weight of each synapse.
        weights: Arc<[i16]>,
    },
    /// Cross-correlation; kernel `[C'][C / groups][kh][kw]`.
    Conv2d {
        /// Geometry.
        window: Window,
        /// The kernel.
        kernel: Arc<[i16]>,
    },
    /// The same weight from each position of a window, channel by channel.
    SumPool2d {
        /// Geometry.
        window: Window,
        /// The weight.
        weight: i16,
    },
    /// Seeded random synapses: synapse k of source s has target `below(targets, seed, first_source + s, 2 k)` and weight
    /// `low + step * below(1 + (high - low) / step, seed, first_source + s, 2 k + 1)`.
    Random {
        /// Number of targets.
        targets: u32,
        /// Synapses of each source.
        fan_out: u32,
        /// The least weight.
        low: i16,
        /// The greatest weight.
        high: i16,
        /// Distance of neighbouring weights.
        step: i16,
        /// The seed.
        seed: u64,
        /// Index of the first source among the concatenated sources of its declaration.
        first_source: u32,
    },
}

impl Connectivity {
    /// Whether every weight is a multiple of this.
    #[must_use]
    pub fn all_multiples_of(&self, unit: i16) -> bool {
        let all = |weights: &[i16]| weights.iter().all(|weight| weight % unit == 0);
        match self {
            Connectivity::Dense { weights, .. } | Connectivity::Sparse { weights, .. } => all(weights),
            Connectivity::Conv2d { kernel, .. } => all(kernel),
            Connectivity::SumPool2d { weight, .. } => all(&[*weight]),
            Connectivity::Random { low, high, step, .. } => all(&[*low, if low < high { *step } else { 0 }]),
        }
    }

    /// Calls `f(target, weight)` for every synapse of a source, in ascending order of targets except for `Random`.
    /// Indices are within the populations.
    #[inline]
    pub fn for_each_from(&self, source: u32, mut f: impl FnMut(u32, i16)) {
        match self {
            Connectivity::Dense { targets, weights } => {
                let row = source as usize * *targets as usize;
                for (target, &weight) in weights[row..row + *targets as usize].iter().enumerate() {
                    f(target as u32, weight);
                }
            }
            Connectivity::Sparse { first, targets, weights } => {
                let range = first[source as usize] as usize..first[source as usize + 1] as usize;
                for (&target, &weight) in targets[range.clone()].iter().zip(&weights[range]) {
                    f(target, weight);
                }
            }
            Connectivity::Conv2d { window, kernel } => {
                let (kh, kw) = window.kernel;
                let per_group_in = window.source.0 / window.groups;
                let per_group_out = window.target.0 / window.groups;
                let channel = source / (window.source.1 * window.source.2);
                let group = channel / per_group_in;
                for out in group * per_group_out..(group + 1) * per_group_out {
                    let base = (out * per_group_in + channel % per_group_in) * kh * kw;
                    window.for_each_position(source, |y, x, ky, kx| {
                        let target = (out * window.target.1 + y) * window.target.2 + x;
                        f(target, kernel[(base + ky * kw + kx) as usize]);
                    });
                }
            }
            Connectivity::SumPool2d { window, weight } => {
                let channel = source / (window.source.1 * window.source.2);
                window.for_each_position(source, |y, x, _, _| {
                    f((channel * window.target.1 + y) * window.target.2 + x, *weight);
                });
            }
            Connectivity::Random { targets, fan_out, low, high, step, seed, first_source } => {
                let entity = u64::from(*first_source) + u64::from(source);
                for k in 0..u64::from(*fan_out) {
                    let target = drawn_target(*targets, *seed, entity, k);
                    f(target, drawn_weight((*low, *high, *step), *seed, entity, k));
                }
            }
        }
    }

    /// Calls `f(target, weight)` for every synapse of a source whose target is wanted, in the order of
    /// [`Connectivity::for_each_from`].
    #[inline]
    pub fn for_each_wanted(&self, source: u32, wanted: impl Fn(u32) -> bool, mut f: impl FnMut(u32, i16)) {
        match self {
            Connectivity::Random { targets, fan_out, low, high, step, seed, first_source } => {
                // Weights of the others, half of their work, are not drawn.
                let entity = u64::from(*first_source) + u64::from(source);
                for k in 0..u64::from(*fan_out) {
                    let target = drawn_target(*targets, *seed, entity, k);
                    if wanted(target) {
                        f(target, drawn_weight((*low, *high, *step), *seed, entity, k));
                    }
                }
            }
            connectivity => connectivity.for_each_from(source, |target, weight| {
                if wanted(target) {
                    f(target, weight);
                }
            }),
        }
    }

    /// Calls `f(target)` for every synapse of a source, in the order of [`Connectivity::for_each_from`].
    #[inline]
    pub fn for_each_target(&self, source: u32, mut f: impl FnMut(u32)) {
        match self {
            Connectivity::Random { targets, fan_out, seed, first_source, .. } => {
                // The weights, half of the work, are not drawn.
                let entity = u64::from(*first_source) + u64::from(source);
                for k in 0..u64::from(*fan_out) {
                    f(drawn_target(*targets, *seed, entity, k));
                }
            }
            connectivity => connectivity.for_each_from(source, |target, _| f(target)),
        }
    }

    /// Number of synapses of a source.
    #[must_use]
    pub fn count_from(&self, source: u32) -> u64 {
        match self {
            Connectivity::Dense { targets, .. } => u64::from(*targets),
            Connectivity::Sparse { first, .. } => first[source as usize + 1] - first[source as usize],
            Connectivity::Random { fan_out, .. } => u64::from(*fan_out),
            Connectivity::Conv2d { .. } | Connectivity::SumPool2d { .. } => {
                let mut count = 0;
                self.for_each_from(source, |_, _| count += 1);
                count
            }
        }
    }

    /// Number of synapses of so many sources together.
    #[must_use]
    pub fn count(&self, sources: u64) -> u64 {
        match self {
            // What is the same for every source, or listed, need not be counted one by one.
            Connectivity::Dense { targets: each, .. } | Connectivity::Random { fan_out: each, .. } => {
                u64::from(*each) * sources
            }
            Connectivity::Sparse { targets, .. } => targets.len() as u64,
            Connectivity::Conv2d { window, .. } => {
                window.positions() * u64::from(window.target.0) * u64::from(window.source.0 / window.groups)
            }
            Connectivity::SumPool2d { window, .. } => window.positions() * u64::from(window.source.0),
        }
    }

    /// Checks that these are synapses from a population of one shape to one of another, with weights of a format.
    ///
    /// # Errors
    /// What does not hold, as a sentence.
    pub(super) fn check(&self, format: SynapseFormat, source: Shape, target: Shape) -> Result<(), &'static str> {
        if format.bits.get() == 7 {
            return Err("weights of 7 bits cannot be stored");
        }
        let (sources, targets) = (source.len() as usize, target.len());
        let (low, high) = format.sign.range(format.bits);
        let step = format.sign.step(format.bits);
        let fits = |w: i16| (low..=high).contains(&w) && w % step == 0;
        match self {
            Connectivity::Dense { targets: n, weights } => {
                if *n != targets || weights.len() != sources * targets as usize {
                    return Err("the weights do not fill sources x targets");
                }
                if !weights.iter().all(|&w| fits(w)) {
                    return Err("a weight is not in its format");
                }
            }
            Connectivity::Sparse { first, targets: to, weights } => {
                let ordered =
                    first.len() == sources + 1 && first.windows(2).all(|w| w[0] <= w[1]) && first.first() == Some(&0);
                if !ordered || first.last() != Some(&(to.len() as u64)) || to.len() != weights.len() {
                    return Err("the synapse list is not closed");
                }
                if to.iter().any(|&t| t >= targets) || !weights.iter().all(|&w| fits(w)) {
                    return Err("a synapse leaves its population or its format");
                }
            }
            Connectivity::Conv2d { window, kernel } => {
                let per_group = window.source.0 / window.groups.max(1);
                let size = (window.target.0 * per_group * window.kernel.0 * window.kernel.1) as usize;
                if !window_fits(window, source, target) || kernel.len() != size {
                    return Err("the window does not fit its populations");
                }
                if !kernel.iter().all(|&w| fits(w)) {
                    return Err("a weight is not in its format");
                }
            }
            Connectivity::SumPool2d { window, weight } => {
                if !window_fits(window, source, target) || window.source.0 != window.target.0 || !fits(*weight) {
                    return Err("the window does not fit its populations");
                }
            }
            Connectivity::Random { targets: n, low: l, high: h, step: s, .. } => {
                if *n != targets || !fits(*l) || !fits(*h) || l > h || *s != step {
                    return Err("the range of weights is not in its format");
                }
            }
        }
        Ok(())
    }
}

impl Window {
    /// Pairs of a source position and an output position whose window covers it: the synapses of one pair of channels.
    #[must_use]
    pub fn positions(&self) -> u64 {
        let of_axis = |axis: fn((u32, u32)) -> u32, source: u32, target: u32| -> u64 {
            let (stride, padding, dilation) = (axis(self.stride), axis(self.padding), axis(self.dilation));
            let covered = |at: u32, k: u32| {
                let s = (u64::from(at) * u64::from(stride) + u64::from(k) * u64::from(dilation))
                    .checked_sub(u64::from(padding));
                s.is_some_and(|s| s < u64::from(source))
            };
            (0..target).map(|at| (0..axis(self.kernel)).filter(|&k| covered(at, k)).count() as u64).sum()
        };
        of_axis(|p| p.0, self.source.1, self.target.1) * of_axis(|p| p.1, self.source.2, self.target.2)
    }

    /// Calls `f(y, x, ky, kx)` for every output position whose window covers this source, and its place in the window.
    pub fn for_each_position(&self, source: u32, mut f: impl FnMut(u32, u32, u32, u32)) {
        let within = source % (self.source.1 * self.source.2);
        let (sy, sx) = (within / self.source.2, within % self.source.2);
        let reach = |s: u32, axis: fn((u32, u32)) -> u32, size: u32| {
            let (stride, padding, dilation) = (axis(self.stride), axis(self.padding), axis(self.dilation));
            // Output o covers s at k when o * stride - padding + k * dilation = s.
            let kernel = axis(self.kernel);
            (0..kernel).rev().filter_map(move |k| {
                let at = (s + padding).checked_sub(k * dilation)?;
                (at % stride == 0 && at / stride < size).then_some((at / stride, k))
            })
        };
        for (y, ky) in reach(sy, |p| p.0, self.target.1) {
            for (x, kx) in reach(sx, |p| p.1, self.target.2) {
                f(y, x, ky, kx);
            }
        }
    }
}

/// The target of synapse k of a source whose synapses are drawn.
#[inline]
fn drawn_target(targets: u32, seed: u64, source: u64, k: u64) -> u32 {
    rng::below(u64::from(targets), seed, source, 2 * k) as u32
}

/// Its weight, one of low, low + step, .. up to high.
#[inline]
fn drawn_weight((low, high, step): (i16, i16, i16), seed: u64, source: u64, k: u64) -> i16 {
    let levels = ((i32::from(high) - i32::from(low)) / i32::from(step) + 1) as u64;
    low + step * rng::below(levels, seed, source, 2 * k + 1) as i16
}

fn window_fits(window: &Window, source: Shape, target: Shape) -> bool {
    source.volume() == Some(window.source)
        && target.volume() == Some(window.target)
        && window.groups > 0
        && window.stride.0 > 0
        && window.stride.1 > 0
        && window.dilation.0 > 0
        && window.dilation.1 > 0
        && window.source.0.is_multiple_of(window.groups)
        && window.target.0.is_multiple_of(window.groups)
}
