//! A published workload as a network that fires at its rates.
//!
//! Input: a workload file, and the choice of a number from each rate's range. Output: a network in
//! integers and its input. A random bias makes each compartment fire, not its input. The bias is
//! 0.5 to 1.5 times the need of its rate, so that compartments do not fire together. Weights of +2
//! and -2 are too small to change the times. Synapses, axons and messages equal the workload's,
//! hence also all counts.

use crate::networks::BuildError;
use crate::networks::builder::Builder;
use nsim_energy::published::workload::{Between, WorkloadFile, WorkloadPopulation, WorkloadProjection};
use nsim_ir::base::fixed::{BiasExponent, BiasMantissa, Decay, ThresholdMantissa};
use nsim_ir::base::id::ChannelId;
use nsim_ir::base::rng;
use nsim_ir::graph::{PerCompartment, Shape, Window};
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::quantised::{Neuron, Quantised};
use nsim_ir::spikes::Sample;
use nsim_quantise::relays::{RELAY, one_to_one};

/// Steps that are counted.
pub const COUNTED: u32 = 128;
/// Greatest number of steps before counting.
const MOST_WARM_UP: u32 = 4_096;

/// Choice of a number from the range of a rate: the rate itself, or an end.
pub type RateChoice = fn(Between) -> f64;

/// Steps before counting: twice the wait of the slowest compartment for its first spike.
pub fn warm_up(file: &WorkloadFile, choice: RateChoice) -> u32 {
    let layers = file.populations.iter().filter(|population| matches!(population, WorkloadPopulation::Layer { .. }));
    let rates = layers.filter_map(|layer| layer.parts().2.map(choice)).filter(|&rate| rate > 0.0);
    rates.map(|rate| (2.0 / rate).ceil() as u32).max().unwrap_or(0).clamp(COUNTED, MOST_WARM_UP)
}

/// Threshold mantissa of every compartment: 1,280,000, far above any sum of weights of 2.
const THRESHOLD: i64 = 20_000;

/// A bias that makes a compartment fire once in `1 / rate` steps, in mantissa and exponent.
fn bias(rate: f64) -> Result<(BiasMantissa, BiasExponent), BuildError> {
    let wanted = rate * (THRESHOLD << 6) as f64;
    let exponent = (0..7).find(|exponent| wanted / f64::from(1u32 << exponent) <= 4_095.0).unwrap_or(7);
    let mantissa = (wanted / f64::from(1u32 << exponent)).round().min(4_095.0);
    Ok((BiasMantissa::new(mantissa as i64)?, BiasExponent::new(exponent)?))
}

fn neurons(units: u32, rate: f64, seed: u64) -> Result<PerCompartment<Neuron>, BuildError> {
    let neuron = |unit: u32| {
        let (bias_mant, bias_exp) = bias(rate * (0.5 + rng::unit(11, seed, u64::from(unit))))?;
        let (dv, vth) = (Decay::new(0)?, ThresholdMantissa::new(THRESHOLD)?);
        Ok(Neuron { dv, vth, bias_mant, bias_exp, ..Neuron::PLAIN })
    };
    Ok(PerCompartment::Each((0..units).map(neuron).collect::<Result<Vec<_>, BuildError>>()?))
}

/// Random weights of 2 and -2: the least that a format of both signs has.
fn signs(count: u64, seed: u64) -> impl Iterator<Item = i16> {
    (0..count).map(move |index| if rng::below(2, 12, seed, index) == 0 { 2 } else { -2 })
}

/// Synapses spread evenly over `reach` targets around the place of their source.
fn local(sources: u32, targets: u32, fan_out: u32, reach: u32, seed: u64) -> Connectivity {
    let reach = reach.min(targets);
    let fan_out = fan_out.min(reach);
    let mut first = vec![0u64];
    let mut all: Vec<u32> = Vec::with_capacity((sources * fan_out) as usize);
    for source in 0..u64::from(sources) {
        let place = source * u64::from(targets) / u64::from(sources);
        let begin = place.saturating_sub(u64::from(reach / 2)).min(u64::from(targets - reach)) as u32;
        all.extend((0..fan_out).map(|k| begin + (u64::from(k) * u64::from(reach) / u64::from(fan_out)) as u32));
        first.push(all.len() as u64);
    }
    let weights = signs(all.len() as u64, seed).collect();
    Connectivity::Sparse { first: first.into(), targets: all.into(), weights }
}

/// The network of a workload and its input.
///
/// # Errors
/// [`BuildError`] where the shapes of a convolution do not fit each other.
pub fn build(file: &WorkloadFile, choice: RateChoice) -> Result<(Quantised, Sample), BuildError> {
    let all_steps = warm_up(file, choice) + COUNTED;
    let (mut net, mut channels, mut input, mut ids) = (Builder::new(&file.name), 0u32, Vec::new(), Vec::new());
    for (index, population) in file.populations.iter().enumerate() {
        let (name, sides, rate) = population.parts();
        let (units, own_rate) = (sides.iter().product::<u32>(), rate.map_or(0.0, choice));
        ids.push(match population {
            WorkloadPopulation::Input { .. } => {
                let first = channels;
                channels += units;
                let spikes = |channel: u32, step: u32| rng::unit(13, u64::from(channel), u64::from(step)) < own_rate;
                for channel in first..channels {
                    let steps = (0..all_steps).filter(|&step| spikes(channel, step));
                    input.extend(steps.map(|step| (step, ChannelId(channel))));
                }
                net.input(name, units)
            }
            WorkloadPopulation::Layer { .. } => net.compartments(name, units, neurons(units, own_rate, index as u64)?),
            // A relay has no rate: its input makes it spike.
            WorkloadPopulation::Relay { .. } => net.compartments(name, units, PerCompartment::Same(RELAY)),
        });
        if let [c, h, w] = *sides {
            net.over_space(c, h, w);
        }
    }
    let place = |name: &str| {
        let place = file.populations.iter().position(|population| population.parts().0 == name);
        ids[place.unwrap_or_default()]
    };
    for (index, projection) in file.projections.iter().enumerate() {
        let [source, target] = projection.ends().map(place);
        let size = |id| net.parts.populations[id].shape.len();
        let (sources, targets, seed) = (size(source), size(target), index as u64);
        let connectivity = match *projection {
            WorkloadProjection::Dense { .. } => {
                let weights = signs(u64::from(sources) * u64::from(targets), seed).collect();
                Connectivity::Dense { targets, weights }
            }
            WorkloadProjection::Conv { kernel, stride, .. } => {
                let volume = |id| match net.parts.populations[id].shape {
                    Shape::Volume(c, h, w) => (c, h, w),
                    ref other => (other.len(), 1, 1),
                };
                let window = Window {
                    source: volume(source),
                    target: volume(target),
                    kernel: (kernel, kernel),
                    stride: (stride, stride),
                    padding: (0, 0),
                    dilation: (1, 1),
                    groups: 1,
                };
                let weights = u64::from(window.source.0 * window.target.0 * kernel * kernel);
                Connectivity::Conv2d { window, kernel: signs(weights, seed).collect() }
            }
            WorkloadProjection::Local { fan_out, reach, .. } => local(sources, targets, fan_out, reach, seed),
            WorkloadProjection::Random { fan_out, .. } => {
                Connectivity::Random { targets, fan_out, low: 2, high: 2, step: 2, seed, first_source: 0 }
            }
        };
        net.connect(source, target, 0, connectivity)?;
    }
    for population in &file.populations {
        if let WorkloadPopulation::Relay { name, of, shape } = population {
            let connectivity = one_to_one(shape.iter().product());
            net.connect(place(of), place(name), 0, connectivity)?;
        }
    }
    Ok((net.build()?, Sample::new(all_steps, &input, None)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_energy::published::workload;
    use nsim_golden::Golden;
    use nsim_ir::spikes::Engine;

    #[test]
    fn populations_fire_at_their_rates() {
        for file in
            workload::shipped().unwrap().iter().filter(|file| ["braille", "nxtf-mnist"].contains(&file.name.as_str()))
        {
            let choice = |rate: Between| rate.value;
            let (network, sample) = build(file, choice).unwrap();
            let mut engine = Golden::new(&network);
            let before_steps = warm_up(file, choice);
            engine.begin(before_steps + COUNTED);
            let mut run = |from: u32, to: u32| {
                (from..to).for_each(|step| engine.step(sample.input(step)));
                engine.totals().spikes
            };
            let before = run(0, before_steps);
            let spikes = (run(before_steps, before_steps + COUNTED) - before) as f64;
            let layers = file.populations.iter().filter(|p| matches!(p, WorkloadPopulation::Layer { .. }));
            let expected: f64 = layers
                .map(|p| f64::from(p.parts().1.iter().product::<u32>()) * p.parts().2.unwrap().value)
                .sum::<f64>()
                * f64::from(COUNTED);
            assert!((spikes / expected - 1.0).abs() < 0.1, "{}: {spikes} spikes, {expected} expected", file.name);
        }
    }
}
