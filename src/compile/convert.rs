//! Spike response neurons -> Loihi compartments, by analysis: the start from which `agree` searches on.
//!
//! Comes in: a graph with spike response populations. Goes out: the same graph with current-based ones in their place,
//! which `quantise` brings into integers. Networks without spike response neurons pass through unchanged.
//!
//! With equal decays du = dv and r = 1 - du / 4096 a compartment answers a spike with `v(k) = (k + 1) r^k`, and the alpha
//! kernel is `eps(k) = (e / tau) k r^k` with r = exp(-dt / tau): the same shape, one step earlier. So du = dv =
//! `4096 (1 - exp(-dt / tau))` matches the time to peak, and a threshold of theta times the quotient of the two peaks
//! matches the height. A converted population therefore answers one step earlier than the one it stands for, in every
//! layer. What has no counterpart is the refractory kernel, whose place the hard reset takes; the period is 1.
//!
//! The scale is free: weights and threshold are real here, and `quantise` takes the largest scale at which they fit.

use crate::base::fixed::{DECAY_ONE, Decay};
use crate::ir::graph::{
    BiasParameter, DecayParameter, Graph, LoihiParameters, PopulationKind, SrmParameters, ThresholdParameter, Values,
};

/// What the analysis says of one population.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Start {
    /// Decay of current and voltage.
    pub decay: Decay,
    /// Threshold in the units of the weights.
    pub threshold: f64,
    /// The decay before it became an integer, in 4096ths.
    pub real_decay: f64,
    /// The threshold that goes with it.
    pub real_threshold: f64,
}

/// The greatest of `(k + 1) r^k` over whole k.
fn peak(r: f64) -> f64 {
    let value = |k: f64| (k + 1.0) * libm::pow(r, k);
    // The derivative is 0 at k + 1 = -1 / ln r.
    let at = if r > 0.0 && r < 1.0 { (-1.0 / libm::log(r) - 1.0).max(0.0) } else { 0.0 };
    value(at.floor()).max(value(at.ceil()))
}

/// The decays and the threshold that stand for a spike response population at this timestep.
#[must_use]
pub fn start(srm: &SrmParameters, timestep_ms: f64) -> Start {
    let tau = srm.tau_sr_ms / timestep_ms;
    let r = libm::exp(-1.0 / tau);
    // eps(k + 1) = (e r / tau) (k + 1) r^k.
    let alpha_peak = std::f64::consts::E * r / tau * peak(r);
    let real_decay = DECAY_ONE as f64 * -libm::expm1(-1.0 / tau);
    // A decay of 0 would never forget.
    let rounded = libm::rint(real_decay).clamp(1.0, DECAY_ONE as f64) as i64;
    let decay = Decay::new(rounded).unwrap_or(Decay::MAX);
    Start {
        decay,
        threshold: srm.theta * peak(1.0 - rounded as f64 / DECAY_ONE as f64) / alpha_peak,
        real_decay,
        real_threshold: srm.theta * peak(r) / alpha_peak,
    }
}

/// The parameters that a population gets by analysis.
#[must_use]
pub fn parameters(start: &Start) -> LoihiParameters {
    let decay = f64::from(start.decay.get());
    LoihiParameters {
        current_decay: DecayParameter::Effective(Values::constant(decay)),
        voltage_decay: DecayParameter::Effective(Values::constant(decay)),
        threshold: ThresholdParameter::Real(Values::constant(start.threshold)),
        bias: BiasParameter::Real(Values::constant(0.0)),
        refractory: Values::constant(1.0),
        vmin_exp: Values::constant(23.0),
        vmax_exp: Values::constant(7.0),
        start_step: 0,
    }
}

/// The network with Loihi compartments only.
#[must_use]
pub fn convert(graph: &Graph) -> Graph {
    let timestep_ms = graph.facts().timestep_ms;
    graph.with_kinds(|_, population| match &population.kind {
        PopulationKind::Srm(srm) => PopulationKind::Loihi(Box::new(parameters(&start(srm, timestep_ms)))),
        other => other.clone(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAPER: SrmParameters = SrmParameters { tau_sr_ms: 10.0, tau_ref_ms: 1.0, scale_ref: 2.0, theta: 10.0 };

    #[test]
    fn peak_and_time_to_peak_are_those_of_the_alpha_kernel() {
        for tau in [0.4, 1.0, 2.5, 10.0, 37.0, 400.0] {
            let start = start(&SrmParameters { tau_sr_ms: tau, ..PAPER }, 1.0);
            let alpha = |k: u32| f64::from(k) / tau * (1.0 - f64::from(k) / tau).exp();
            let r = 1.0 - start.real_decay / 4096.0;
            // A unit weight's response relative to the threshold, one step earlier.
            for k in 0..2000u32 {
                let v = f64::from(k + 1) * r.powi(k as i32) / start.real_threshold;
                assert!((v - alpha(k + 1) / PAPER.theta).abs() < 1e-12, "tau {tau}, k {k}");
            }
            let quantised = |k: i32| f64::from(k + 1) * (1.0 - f64::from(start.decay.get()) / 4096.0).powi(k);
            let height = (0..5000).map(quantised).fold(0.0, f64::max) / start.threshold;
            let wanted = (0..5000).map(alpha).fold(0.0, f64::max) / PAPER.theta;
            assert!((height / wanted - 1.0).abs() < 1e-12, "tau {tau}: {height} {wanted}");
        }
    }

    #[test]
    fn the_paper_s_neuron_becomes_this() {
        let start = start(&PAPER, 1.0);
        assert_eq!(start.decay.get(), 390, "4096 (1 - exp(-1/10)) = 389.8");
        assert!((start.real_threshold - 40.657).abs() < 1e-3, "{}", start.real_threshold);
    }
}
