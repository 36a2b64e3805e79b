//! Connectivity of projections: the synapses of each source, with integer weights.
//!
//! Kernels and random synapses are stored by their parameters. `nsim_dynamics::synapses` enumerates
//! them for the compiler and the checker; the golden interpreter has its own enumeration.
//! [`Projection`](super::Projection) has the populations and the delay.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::base::fixed::{SignMode, WeightBits, WeightExponent};
use crate::base::id::RuleId;
use crate::graph::{Shape, Window};
use crate::neurons::Port;

/// The format in which the synapses of a projection are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct SynapseFormat {
    /// Weight exponent.
    pub exponent: WeightExponent,
    /// Sign mode.
    pub sign: SignMode,
    /// Bits of a weight.
    pub bits: WeightBits,
    /// The port of its target that it adds to, below the ports of the target's kind.
    #[serde(default)]
    pub port: Port,
    /// The separate sum that it adds to first; `None` where arrivals are added to the port
    /// directly.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub apart: Option<SeparateSum>,
    /// The rule that changes its synapses one by one while a network runs; `None` for constants.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rule: Option<RuleId>,
}

impl SynapseFormat {
    /// Whether a run may change its synapses.
    pub const fn is_plastic(self) -> bool {
        self.rule.is_some()
    }
}

/// A separate sum, which is narrowed before it is added to its port. It sums the arrivals of a
/// compartment in a step over synapses of one number, port and delay. A negative exponent shifts
/// it, and `wraps` wraps it: (39) and (40) of `docs/loihi2.md`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct SeparateSum {
    /// Number of the sum at its target, below [`SeparateSum::MOST`].
    pub number: u8,
    /// Whether it wraps to 24 bits.
    pub wraps: bool,
}

impl SeparateSum {
    /// The most sums of a compartment, its ports included.
    pub const MOST: usize = 64;
}

/// Synapses of a projection, with integer weights.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub enum Connectivity {
    /// All to all; row-major `[source][target]`, so that a spike reads one row.
    Dense {
        /// Number of targets.
        targets: u32,
        /// The weights.
        weights: Arc<[i16]>,
    },
    /// Listed synapses: source s has `first[s]..first[s + 1]`.
    Sparse {
        /// Offsets of the sources, one more than sources.
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
    /// One weight from each position of a window, channel by channel.
    SumPool2d {
        /// Geometry.
        window: Window,
        /// The weight.
        weight: i16,
    },
    /// Seeded random synapses: synapse k of source s has target
    /// `below(targets, seed, first_source + s, 2 k)` and weight
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
    /// Whether every weight is a multiple of `unit`.
    pub fn all_multiples_of(&self, unit: i16) -> bool {
        let all = |weights: &[i16]| weights.iter().all(|weight| weight % unit == 0);
        match self {
            Connectivity::Dense { weights, .. } | Connectivity::Sparse { weights, .. } => all(weights),
            Connectivity::Conv2d { kernel, .. } => all(kernel),
            Connectivity::SumPool2d { weight, .. } => all(&[*weight]),
            Connectivity::Random { low, high, step, .. } => all(&[*low, if low < high { *step } else { 0 }]),
        }
    }

    /// The window of a convolution or pool; each channel of a pool is a group of its own.
    pub fn window(&self) -> Option<Window> {
        match self {
            Connectivity::Conv2d { window, .. } => Some(*window),
            Connectivity::SumPool2d { window, .. } => Some(Window { groups: window.source.0, ..*window }),
            _ => None,
        }
    }

    /// Number of synapses of `sources` sources together.
    pub fn count(&self, sources: u64) -> u64 {
        match self {
            // No synapse is enumerated.
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

    /// Checks that the synapses fit the shapes of source and target, and the weights their format.
    ///
    /// # Errors
    /// A sentence that names the violated condition.
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
                let axes = [window.target.0, per_group, window.kernel.0, window.kernel.1];
                if !window_fits(window, source, target)
                    || kernel.len() as u128 != axes.iter().map(|&axis| u128::from(axis)).product()
                {
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
            Connectivity::Random { targets: n, fan_out, low: l, high: h, step: s, .. } => {
                if *n != targets || (targets == 0 && *fan_out > 0) || !fits(*l) || !fits(*h) || l > h || *s != step {
                    return Err("the range of weights is not in its format");
                }
            }
        }
        Ok(())
    }
}

impl Window {
    /// Pairs of a source position and an output position whose window covers it: the synapses of
    /// one pair of channels.
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
}

fn window_fits(window: &Window, source: Shape, target: Shape) -> bool {
    fn within(pair: (u32, u32), least: u32) -> bool {
        [pair.0, pair.1].iter().all(|n| (least..=65_535).contains(n))
    }
    source.volume() == Some(window.source)
        && target.volume() == Some(window.target)
        && window.groups > 0
        && [window.kernel, window.stride, window.dilation].into_iter().all(|pair| within(pair, 1))
        && within(window.padding, 0)
        && window.source.0.is_multiple_of(window.groups)
        && window.target.0.is_multiple_of(window.groups)
}
