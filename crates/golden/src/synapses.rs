//! The synapses of a network, enumerated by target.
//!
//! The enumeration follows `docs/semantics.md`, projections. The machine enumerates synapses by
//! source.

use nsim_ir::base::id::{ChannelId, CompartmentId, ProjectionId};
use nsim_ir::base::rng;
use nsim_ir::graph::Window;
use nsim_ir::neurons::Port;
use nsim_ir::quantised::connectivity::{Connectivity, SeparateSum, SynapseFormat};
use nsim_ir::quantised::{Projection, Quantised, SpikeSource, Units};

/// An incoming synapse of a compartment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Synapse {
    /// Source of its spikes.
    pub source: SpikeSource,
    /// Latency from a spike to the update that it enters, in steps: equation (2); at first where
    /// its rule changes delays.
    pub latency: u32,
    /// Contribution of a binary spike: equation (1).
    pub adds: i64,
    /// Port whose sum it adds to.
    pub port: Port,
    /// Separate sum, which is added to the port's.
    pub separate: Option<DelayedSum>,
    /// Its plastic projection, and the index of its weight there.
    pub plastic: Option<(ProjectionId, usize)>,
}

impl Synapse {
    /// Steps from a spike to the update that it enters without a delay.
    pub fn between(&self) -> u32 {
        u32::from(matches!(self.source, SpikeSource::Compartment(_)))
    }
}

/// A sum that is narrowed separately: rules (39) and (40).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct DelayedSum {
    pub separate: SeparateSum,
    pub delay: u32,
    /// Shift toward minus infinity, in bits.
    pub shift: u32,
}

/// Equation (1): the contribution of a spike over a synapse.
pub fn scaled(weight: i64, exponent: i8) -> i64 {
    let power = 1i64 << exponent.unsigned_abs();
    if exponent >= 0 {
        64 * weight * power
    } else {
        // Division rounds toward zero: first the scaling, then the loss of the low six bits.
        64 * weight / power / 64 * 64
    }
}

/// Returns every synapse of the network with its target.
pub fn synapses(network: &Quantised) -> Vec<(CompartmentId, Synapse)> {
    let mut all = Vec::new();
    for (id, projection) in network.projections().enumerate() {
        let source = &network.populations()[projection.source];
        let target = &network.populations()[projection.target];
        let first_target = target.first_compartment().expect("a target has compartments").0;
        let delay = u32::from(projection.delay.get());
        for (number, (from, to, weight)) in connections_by_source(network, projection).into_iter().enumerate() {
            let (source, latency) = match source.units {
                Units::Input(first) => (SpikeSource::Channel(ChannelId(first.0 + from)), delay),
                Units::Compartments { first, .. } => {
                    (SpikeSource::Compartment(CompartmentId(first.0 + from)), 1 + delay)
                }
            };
            let SynapseFormat { port, apart, rule, .. } = projection.format;
            let (exponent, sum_exponent) = exponents(projection.format);
            let adds = scaled(weight, exponent);
            let separate =
                apart.map(|separate| DelayedSum { separate, delay, shift: sum_exponent.unsigned_abs().into() });
            let plastic = rule.map(|_| (id, number));
            all.push((CompartmentId(first_target + to), Synapse { source, latency, adds, port, separate, plastic }));
        }
    }
    all
}

/// Returns the exponents of a projection's weights and of their sum. Rule (39): a negative exponent
/// belongs to the separate sum, if there is one.
pub fn exponents(SynapseFormat { apart, exponent, .. }: SynapseFormat) -> (i8, i8) {
    let of_sum = if apart.is_some() { exponent.get().min(0) } else { 0 };
    (exponent.get() - of_sum, of_sum)
}

/// Returns a projection's connections, source by source (its weights' order) if it is plastic.
pub fn connections_by_source(network: &Quantised, projection: &Projection) -> Vec<(u32, u32, i64)> {
    let mut all = connections(&projection.connectivity, network.populations()[projection.source].shape.len());
    if projection.format.is_plastic() {
        all.sort_by_key(|&(from, ..)| from);
    }
    all
}

/// (source, target, weight) of every synapse of a connectivity, with indices within the
/// populations, as defined in `docs/semantics.md`, projections.
fn connections(connectivity: &Connectivity, sources: u32) -> Vec<(u32, u32, i64)> {
    let mut all = Vec::new();
    match connectivity {
        Connectivity::Dense { targets, weights } => {
            for to in 0..*targets {
                for from in 0..sources {
                    all.push((from, to, i64::from(weights[from as usize * *targets as usize + to as usize])));
                }
            }
        }
        Connectivity::Sparse { first, targets, weights } => {
            for from in 0..sources {
                for at in first[from as usize]..first[from as usize + 1] {
                    all.push((from, targets[at as usize], i64::from(weights[at as usize])));
                }
            }
        }
        Connectivity::Conv2d { window, kernel } => {
            let channels_in = window.source.0 / window.groups;
            let channels_out = window.target.0 / window.groups;
            over_outputs(window, |(channel, y, x), to| {
                for c in 0..channels_in {
                    over_window(window, y, x, |(ky, kx), (sy, sx)| {
                        let from_channel = channel / channels_out * channels_in + c;
                        let from = (from_channel * window.source.1 + sy) * window.source.2 + sx;
                        let at = ((channel * channels_in + c) * window.kernel.0 + ky) * window.kernel.1 + kx;
                        all.push((from, to, i64::from(kernel[at as usize])));
                    });
                }
            });
        }
        Connectivity::SumPool2d { window, weight } => over_outputs(window, |(channel, y, x), to| {
            over_window(window, y, x, |_, (sy, sx)| {
                all.push(((channel * window.source.1 + sy) * window.source.2 + sx, to, i64::from(*weight)));
            });
        }),
        Connectivity::Random { targets, fan_out, low, high, step, seed, first_source } => {
            let (low, high, step) = (i64::from(*low), i64::from(*high), i64::from(*step));
            let levels = 1 + (high - low) / step;
            for from in 0..sources {
                let entity = u64::from(*first_source) + u64::from(from);
                for k in 0..u64::from(*fan_out) {
                    let to = rng::below(u64::from(*targets), *seed, entity, 2 * k);
                    let level = rng::below(levels as u64, *seed, entity, 2 * k + 1);
                    all.push((from, to as u32, low + step * level as i64));
                }
            }
        }
    }
    all
}

/// Calls `f((channel, y, x), target)` for every target of a window.
fn over_outputs(window: &Window, mut f: impl FnMut((u32, u32, u32), u32)) {
    let mut target = 0;
    for channel in 0..window.target.0 {
        for y in 0..window.target.1 {
            for x in 0..window.target.2 {
                f((channel, y, x), target);
                target += 1;
            }
        }
    }
}

/// Calls `f((ky, kx), (sy, sx))` for every place of the window at an output position that lies on
/// the source.
fn over_window(window: &Window, y: u32, x: u32, mut f: impl FnMut((u32, u32), (u32, u32))) {
    let place = |out: u32, stride: u32, k: u32, dilation: u32, padding: u32, size: u32| {
        let at = i64::from(out) * i64::from(stride) + i64::from(k) * i64::from(dilation) - i64::from(padding);
        (0 <= at && at < i64::from(size)).then_some(at as u32)
    };
    for ky in 0..window.kernel.0 {
        for kx in 0..window.kernel.1 {
            let sy = place(y, window.stride.0, ky, window.dilation.0, window.padding.0, window.source.1);
            let sx = place(x, window.stride.1, kx, window.dilation.1, window.padding.1, window.source.2);
            if let (Some(sy), Some(sx)) = (sy, sx) {
                f((ky, kx), (sy, sx));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_dynamics::arithmetic::scaled_weight;
    use nsim_dynamics::synapses::Enumerate;
    use nsim_ir::base::fixed::WeightExponent;

    /// Compares the enumeration by targets with the machine's enumeration by sources.
    fn agrees(connectivity: &Connectivity, sources: u32) {
        let mut by_source = Vec::new();
        for from in 0..sources {
            let before = by_source.len();
            connectivity.for_each_from(from, |to, weight| by_source.push((from, to, i64::from(weight))));
            assert_eq!(connectivity.count_from(from), (by_source.len() - before) as u64);
        }
        let mut by_target = connections(connectivity, sources);
        by_source.sort_unstable();
        by_target.sort_unstable();
        assert_eq!(by_target, by_source, "{connectivity:?}");
    }

    #[test]
    fn synapses_seen_from_targets_are_those_seen_from_sources() {
        let weights: Vec<i16> = (0..12).map(|i| 2 * i).collect();
        agrees(&Connectivity::Dense { targets: 3, weights: weights.into() }, 4);
        let sparse = Connectivity::Sparse {
            first: [0, 2, 2, 5].into(),
            targets: [0, 4, 1, 1, 3].into(),
            weights: [2, -2, 4, 6, -8].into(),
        };
        agrees(&sparse, 3);
        for (targets, fan_out, low, high, step, first_source) in [(7, 5, -256, 254, 2, 0), (1, 3, 4, 4, 2, 100)] {
            agrees(&Connectivity::Random { targets, fan_out, low, high, step, seed: 5, first_source }, 9);
        }
    }

    #[test]
    fn windows_seen_from_targets_are_those_seen_from_sources() {
        let mut windows = 0;
        for case in 0..2_000 {
            let draw =
                |what: u64, low: u32, high: u32| low + rng::below(u64::from(high - low) + 1, 1, case, what) as u32;
            let groups = draw(0, 1, 2);
            let (kernel, stride, padding, dilation) = (
                (draw(1, 1, 3), draw(2, 1, 3)),
                (draw(3, 1, 3), draw(4, 1, 3)),
                (draw(5, 0, 2), draw(6, 0, 2)),
                (draw(7, 1, 2), draw(8, 1, 2)),
            );
            let source = (groups * draw(9, 1, 2), draw(10, 1, 6), draw(11, 1, 6));
            // Output size of a convolution, as in every framework; `None` when the window is larger
            // than the source.
            let after = (draw(13, 0, 2), draw(14, 0, 2));
            let size = |n: u32, kernel: u32, stride: u32, padding: u32, dilation: u32| {
                Some((n + padding).checked_sub(dilation * (kernel - 1) + 1)? / stride + 1)
            };
            let (Some(height), Some(width)) = (
                size(source.1, kernel.0, stride.0, padding.0 + after.0, dilation.0),
                size(source.2, kernel.1, stride.1, padding.1 + after.1, dilation.1),
            ) else {
                continue;
            };
            windows += 1;
            let sources = source.0 * source.1 * source.2;
            let target = (groups * draw(12, 1, 3), height, width);
            let window = Window { source, target, kernel, stride, padding, dilation, groups };
            let size = target.0 * (source.0 / groups) * kernel.0 * kernel.1;
            let weights: Vec<i16> = (0..size as i16).map(|i| 2 * i).collect();
            agrees(&Connectivity::Conv2d { window, kernel: weights.into() }, sources);
            let pool = Window { target: (source.0, height, width), groups: source.0, ..window };
            agrees(&Connectivity::SumPool2d { window: pool, weight: 6 }, sources);
        }
        assert!(windows > 1_000, "{windows}");
    }

    #[test]
    fn scaling_by_division_is_scaling_by_shifts() {
        for exponent in -8..=7 {
            let field = WeightExponent::new(i64::from(exponent)).unwrap();
            for weight in -256..=255i16 {
                assert_eq!(scaled(i64::from(weight), exponent), i64::from(scaled_weight(weight, field)));
            }
        }
    }
}
