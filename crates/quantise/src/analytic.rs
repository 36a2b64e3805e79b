//! Analytic fit of Loihi compartments to spike response neurons: the start of the search by
//! `agree`.
//!
//! Input: a graph with spike response populations. Output: the graph with current-based populations
//! in their place, which `quantise` turns into integers. Networks without spike response neurons
//! pass through unchanged.
//!
//! With equal decays du = dv and r = 1 - du / 4096, a compartment's response to a spike is
//! `v(k) = (k + 1) r^k`. The alpha kernel is `eps(k) = (e / tau) k r^k` with r = exp(-dt / tau): an
//! equal shape, one step later. So du = dv = `4096 (1 - exp(-dt / tau))` matches the time to peak,
//! and a threshold of theta times the quotient of the two peaks matches the height. A converted
//! population therefore responds one step earlier than its spike response layer, in every layer.
//! The refractory kernel has no counterpart: the hard reset takes its place, and the period is 1.
//!
//! The scale is free: weights and threshold are real here, and `quantise` takes the largest scale
//! at which they fit.

use nsim_ir::base::fixed::{DECAY_ONE, Decay, Delay, Refractory, SignMode};
use nsim_ir::graph::{Graph, NeuronParameters, PopulationKind, Projection, ProjectionKind, SrmParameters, Values};
use nsim_ir::neurons::{NeuronKind, Port};
use nsim_ir::spanned::Spanned;

/// The counterpart of a population of spike response neurons.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// Decay of the current.
    pub du: Decay,
    /// Decay of the voltage.
    pub dv: Decay,
    /// Refractory period.
    pub refractory: Refractory,
    /// Threshold in the units of the weights.
    pub threshold: f64,
    /// Copies of every incoming projection: delay of each in steps, and factor of its weights.
    pub taps: Vec<(u32, f64)>,
    /// Weights of each compartment's synapses onto itself, by delay 0, 1, ..: for each delay one
    /// weight for all compartments, or one each.
    pub own: Vec<Vec<f64>>,
    /// Greatest expected input of a step, in the units of the weights; `None` for the sum of all
    /// weights.
    pub greatest_input: Option<f64>,
}

/// Peak of a compartment's response to one spike of weight 1. A step keeps the fraction `keep_u` of
/// the current and `keep_v` of the voltage.
pub fn peak(keep_u: f64, keep_v: f64) -> f64 {
    let (peak, is_reached) = early_peak(keep_u, keep_v);
    if is_reached { peak } else { late_peak(keep_u, keep_v) }
}

/// Peak of the first 100,000 steps, and whether the response falls after it.
pub fn early_peak(keep_u: f64, keep_v: f64) -> (f64, bool) {
    let (mut u, mut v) = (1.0, 1.0);
    // The response rises once and falls for ever.
    for _ in 0..ITERATED {
        u *= keep_u;
        let next = keep_v * v + u;
        if next <= v {
            return (v, true);
        }
        v = next;
    }
    (v, false)
}

/// Most steps of a response that are computed step by step.
const ITERATED: u32 = 100_000;
/// Step at which a response that never falls is read.
const LATEST: f64 = 1e7;

/// Peak of a response that rises for longer: `(a^x - b^x) / (a - b)`, or `x a^(x - 1)` where a = b,
/// at the x where its derivative is 0.
fn late_peak(a: f64, b: f64) -> f64 {
    let endless = a >= 1.0 || b >= 1.0;
    if (a - b).abs() < 1e-12 {
        let x = if endless { LATEST } else { (-1.0 / libm::log(a)).clamp(1.0, LATEST) };
        return x * libm::pow(a, x - 1.0);
    }
    let x = if endless { LATEST } else { libm::log(libm::log(b) / libm::log(a)) / libm::log(a / b) };
    let x = x.clamp(1.0, LATEST);
    (libm::pow(a, x) - libm::pow(b, x)) / (a - b)
}

/// Fraction of a current or voltage kept by one step with this decay, 0..=1.
pub fn keep(decay: Decay) -> f64 {
    1.0 - f64::from(decay.get()) / DECAY_ONE as f64
}

/// Fraction of both kept by one step before decays become integers: `exp(-dt / tau)`.
pub fn real_keep(srm: &SrmParameters, timestep_ms: f64) -> f64 {
    libm::exp(-timestep_ms / srm.tau_sr_ms)
}

/// The threshold at which the peak of a response equals the alpha kernel's peak, relative to the
/// threshold.
pub fn matched_threshold(srm: &SrmParameters, timestep_ms: f64, keep_u: f64, keep_v: f64) -> f64 {
    // eps(k + 1) = (e r / tau) (k + 1) r^k.
    let (tau, r) = (srm.tau_sr_ms / timestep_ms, real_keep(srm, timestep_ms));
    srm.theta * peak(keep_u, keep_v) / (std::f64::consts::E * r / tau * peak(r, r))
}

/// The matched threshold of a fit, all taps together.
pub fn matched_threshold_of(srm: &SrmParameters, timestep_ms: f64, fit: &Fit) -> f64 {
    let (keep_u, keep_v) = (keep(fit.du), keep(fit.dv));
    let one = matched_threshold(srm, timestep_ms, keep_u, keep_v);
    let [first, rest @ ..] = fit.taps.as_slice() else { return one };
    if rest.is_empty() {
        return one * first.1;
    }
    let last = fit.taps.iter().map(|&(delay, _)| delay).max().unwrap_or(0);
    let (mut u, mut v, mut most) = (0.0, 0.0, 0.0);
    for step in 0..ITERATED {
        let arrived: f64 = fit.taps.iter().filter(|&&(delay, _)| delay == step).map(|&(_, factor)| factor).sum();
        u = keep_u * u + arrived;
        let next = keep_v * v + u;
        if step > last && next <= v {
            break;
        }
        v = next;
        most = f64::max(most, v);
    }
    one * most / peak(keep_u, keep_v)
}

/// Weights of a compartment's synapses onto itself, by delay 0, 1, ... They restore the voltage
/// that a spike's hard reset removes, and add the refractory response.
///
/// A spike at step t leaves v(t) = 0, where the spike response neuron keeps its potential and adds
/// nu(k), k steps later, nu(k) = -scale (k / tau_ref) exp(1 - k / tau_ref). With thresholds of 1
/// and g the voltage at a spike, the synapses have to add the response `c(k) = g keep_v^k + nu(k)`.
/// Arrivals pass current and voltage, so their weights are
/// `w(z) = (1 - keep_u z) (1 - keep_v z) c(z)`, cut off after `count`. The voltage at a spike is
/// above the threshold by up to the last step's input: `mean_excess` is its mean, which calibration
/// finds. `refractory` scales nu.
pub fn own_synapses(srm: (&SrmParameters, f64), keep: (f64, f64), scales: (f64, f64), count: usize) -> Vec<f64> {
    let ((srm, timestep_ms), (keep_u, keep_v), (mean_excess, refractory)) = (srm, keep, scales);
    let tau = srm.tau_ref_ms / timestep_ms;
    let nu = |k: usize| match k {
        0 => 0.0,
        _ => -refractory * srm.scale_ref * (k as f64 / tau) * libm::exp(1.0 - k as f64 / tau),
    };
    let before = |k: usize, by: usize| k.checked_sub(by).map_or(0.0, nu);
    let weight = |k: usize| {
        let reset_correction = match k {
            1 => mean_excess * keep_v,
            2 => -mean_excess * keep_v * keep_u,
            _ => 0.0,
        };
        reset_correction + nu(k) - (keep_u + keep_v) * before(k, 1) + keep_u * keep_v * before(k, 2)
    };
    (1..=count).map(weight).collect()
}

/// The analytic start of a population at this timestep.
pub fn start(srm: &SrmParameters, timestep_ms: f64) -> Fit {
    let real = DECAY_ONE as f64 * (1.0 - real_keep(srm, timestep_ms));
    // A decay of 0 would never forget.
    let decay = Decay::new(libm::rint(real).clamp(1.0, DECAY_ONE as f64) as i64).unwrap_or(Decay::MAX);
    Fit {
        du: decay,
        dv: decay,
        refractory: Refractory::ONE,
        threshold: matched_threshold(srm, timestep_ms, keep(decay), keep(decay)),
        taps: vec![(0, 1.0)],
        own: Vec::new(),
        greatest_input: None,
    }
}

/// Analytic start of every spike response population, in the order of the file; else `None`.
pub fn starts(graph: &Graph) -> Vec<Option<Fit>> {
    let fit = |kind: &PopulationKind| match kind {
        PopulationKind::Srm(srm) => Some(start(srm, graph.facts().timestep_ms)),
        PopulationKind::Input | PopulationKind::Neurons(_) => None,
    };
    graph.populations().map(|(_, population)| fit(&population.kind)).collect()
}

fn parameters(fit: &Fit) -> NeuronParameters {
    NeuronParameters {
        kind: NeuronKind::Loihi,
        given: vec![
            ("du", Values::constant(fit.du.get().into())),
            ("dv", Values::constant(fit.dv.get().into())),
            ("vth", Values::constant(fit.threshold)),
            ("bias", Values::constant(0.0)),
            ("refractory", Values::constant(fit.refractory.get().into())),
        ],
        start_step: 0,
        greatest_input: fit.greatest_input,
    }
}

/// Mark in the name of a projection from a population onto itself that represents a reset.
const ITSELF: &str = " -> itself";

/// Whether a projection of this name is one of [`Fit::own`].
pub fn is_reset_name(name: &str) -> bool {
    name.contains(ITSELF)
}

/// Returns the network with `fits` (in the order of the file) in place of spike response neurons.
pub fn with_fits(graph: &Graph, fits: &[Option<Fit>]) -> Graph {
    let kinds = graph.with_kinds(|node, population| match (&population.kind, &fits[node.index()]) {
        (PopulationKind::Srm(_), Some(fit)) => PopulationKind::Neurons(parameters(fit)),
        (other, _) => other.clone(),
    });
    fn copy(projection: &Projection, delay: u32, factor: f64) -> Projection {
        let late = i64::from(projection.delay.get()) + i64::from(delay);
        let kind = match &projection.kind {
            kind if factor == 1.0 => kind.clone(),
            ProjectionKind::SumPool2d { window, weight } => {
                let weight = Spanned { value: weight.value * factor, ..weight.clone() };
                ProjectionKind::SumPool2d { window: *window, weight }
            }
            kind => kind.map_weights(|_, weight| weight * factor),
        };
        Projection { kind, delay: Delay::new(late).unwrap_or(Delay::MAX), ..projection.clone() }
    }
    let mut added = Vec::new();
    for (_, source, target, projection) in graph.projections() {
        let Some(fit) = &fits[target.index()] else { continue };
        for &(delay, factor) in fit.taps.iter().skip(1) {
            let name = format!("{} ({delay} steps later)", projection.name);
            added.push((source, target, Projection { name, ..copy(projection, delay, factor) }));
        }
    }
    let changed = kinds.with_projections(|target, projection| match &fits[target.index()] {
        Some(fit) => {
            let (delay, factor) = fit.taps.first().copied().unwrap_or((0, 1.0));
            copy(projection, delay, factor)
        }
        None => projection.clone(),
    });
    for (node, population) in graph.populations() {
        let own = fits[node.index()].as_ref().map_or(&[][..], |fit| &fit.own);
        for (delay, weights) in own.iter().enumerate() {
            let weight = |i: u32| weights.get(i as usize).or(weights.first()).copied().unwrap_or(0.0);
            let all = (0..population.shape.len()).map(|i| (i, i, weight(i), i));
            let projection = Projection {
                name: format!("{}{ITSELF}", population.name),
                span: population.span,
                first_source: 0,
                weight_exp: 0.into(),
                sign: SignMode::Mixed,
                weight_bits: 8.into(),
                port: Port::First,
                delay: Delay::new(delay as i64).unwrap_or(Delay::MAX),
                weight_scale: None,
                weights_span: population.span,
                kind: ProjectionKind::Sparse { synapses: all.collect() },
                rule: None,
            };
            added.push((node, node, projection));
        }
    }
    changed.and_projections(added)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAPER: SrmParameters = SrmParameters { tau_sr_ms: 10.0, tau_ref_ms: 1.0, scale_ref: 2.0, theta: 10.0 };

    #[test]
    fn peak_and_time_to_peak_are_those_of_the_alpha_kernel() {
        for tau in [0.4, 1.0, 2.5, 10.0, 37.0, 400.0] {
            let srm = SrmParameters { tau_sr_ms: tau, ..PAPER };
            let r = real_keep(&srm, 1.0);
            let threshold = matched_threshold(&srm, 1.0, r, r);
            let alpha = |k: u32| f64::from(k) / tau * (1.0 - f64::from(k) / tau).exp();
            // A unit weight's response relative to the threshold, one step earlier.
            for k in 0..2000u32 {
                let v = f64::from(k + 1) * r.powi(k as i32) / threshold;
                assert!((v - alpha(k + 1) / PAPER.theta).abs() < 1e-12, "tau {tau}, k {k}");
            }
            let fit = start(&srm, 1.0);
            let height = (0..5000).map(|k| f64::from(k + 1) * keep(fit.du).powi(k)).fold(0.0, f64::max) / fit.threshold;
            let wanted = (0..5000).map(alpha).fold(0.0, f64::max) / PAPER.theta;
            assert!((height / wanted - 1.0).abs() < 1e-12, "tau {tau}: {height} {wanted}");
        }
    }

    #[test]
    fn a_late_peak_continues_the_early_ones() {
        for (a, b) in [(0.999, 0.999), (0.9995, 0.998), (0.99, 0.9999)] {
            assert!((late_peak(a, b) / peak(a, b) - 1.0).abs() < 1e-6, "{a}, {b}");
        }
    }

    #[test]
    fn own_synapses_give_back_what_a_reset_takes() {
        let (keep_u, keep_v, given) = (0.93, 0.7, 1.25);
        let own = own_synapses((&PAPER, 1.0), (keep_u, keep_v), (given, 1.0), 40);
        let (mut u, mut v) = (0.0, 0.0);
        for (k, weight) in (1..).zip(&own) {
            u = keep_u * u + weight;
            v = keep_v * v + u;
            let wanted = given * f64::powi(keep_v, k) - 2.0 * f64::from(k) * f64::exp(1.0 - f64::from(k));
            assert!((v - wanted).abs() < 1e-12, "step {k}: {v} {wanted}");
        }
    }

    #[test]
    fn the_paper_s_neuron_becomes_this() {
        let fit = start(&PAPER, 1.0);
        assert_eq!((fit.du.get(), fit.dv.get()), (390, 390), "4096 (1 - exp(-1/10)) = 389.8");
        assert!((fit.threshold - 40.65).abs() < 0.05, "{}", fit.threshold);
    }
}
