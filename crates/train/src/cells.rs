//! The neurons of a layer: the forward pass to potentials and spikes, and the backward pass from
//! errors at the spikes to errors at the inputs.
//!
//! SRM and Loihi neurons are a linear filter of their input followed by a threshold. Arrays are
//! `[step][neuron]`, so that the inner loop runs over contiguous memory. Potentials and thresholds
//! are in the units of the trained weights.

use super::loihi2::Loihi2;
use super::surrogate::Surrogate;
use super::trace::{FREE, HELD, SPIKED, Trace};
use nsim_dynamics::{Fields, Registers, update};
use nsim_files::training::CreditDesc;
use nsim_quantise::analytic::{early_peak, keep};
use nsim_reference::kernel::{Alpha, EPSILON, Kernel};

/// The longest kernel in timesteps.
const LONGEST: u32 = 100_000;

/// Form of the spike function.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Spiking {
    /// Spikes, resets and refractory responses, as deployed.
    Hard,
    /// The integral of the surrogate, without refractory response or reset, to check gradients.
    Smooth,
}

/// Spike-response neurons: `u = sum_i w_i (eps * s_i) + nu * o`, a spike when `u >= theta`.
#[derive(Debug, Clone, PartialEq)]
pub struct Srm {
    /// Threshold.
    pub theta: f32,
    /// Decay and gain of each neuron's response.
    pub response: Vec<(f32, f32)>,
    /// Decay and gain of the refractory response, which is negative.
    pub refractory: (f32, f32),
    /// Kernels by step in place of the recursions: response and refractory, truncated as by SLAYER.
    pub truncated: Option<(Vec<f32>, Vec<f32>)>,
}

/// Compartments of a Loihi core, in the machine's own integers.
#[derive(Debug, Clone, PartialEq)]
pub struct Loihi {
    /// Each compartment's fields.
    pub fields: Vec<Fields>,
    /// Fractions of u and of v kept by a step, and one over the response's peak; by compartment.
    pub leaves: Vec<(f32, f32, f32)>,
    /// Threshold in the units of the trained weights; infinite where the potential is read out.
    pub theta: f32,
    /// Contribution of a trained weight of 1, in the units of [`update`].
    pub weight_unit: f32,
    /// Rule of the credit assignment.
    pub credit: CreditDesc,
}

/// The neurons of one layer.
#[derive(Debug, Clone, PartialEq)]
pub enum Cells {
    /// Real numbers.
    Srm(Srm),
    /// Integers, with the registers of Loihi 1.
    Loihi(Loihi),
    /// Integers, of a kind of Loihi 2.
    Loihi2(Loihi2),
}

impl Srm {
    /// Neurons with one response each and one refractory response for all. `kernel` selects
    /// recursions or truncated kernels; truncated kernels give all neurons the first response.
    pub fn new(theta: f64, responses: &[Alpha], refractory: Alpha, kernel: Kernel) -> Self {
        let taps = |alpha: &Alpha| alpha.truncated(EPSILON, LONGEST).into_iter().map(|tap| tap as f32).collect();
        let cut = |first| (taps(first), taps(&refractory));
        Srm {
            theta: theta as f32,
            response: responses.iter().map(|alpha| (alpha.decay() as f32, alpha.gain() as f32)).collect(),
            refractory: (refractory.decay() as f32, refractory.gain() as f32),
            truncated: responses.first().filter(|_| kernel == Kernel::Truncated).map(cut),
        }
    }
}

impl Loihi {
    /// Compartments with these fields; a trained weight of 1 contributes `weight_unit` units of 64.
    pub fn new(fields: Vec<Fields>, theta: f32, weight_unit: f32, credit: CreditDesc) -> Self {
        fn leaves(f: &Fields) -> (f32, f32, f32) {
            let (keep_u, keep_v) = (keep(f.neuron.du), keep(f.neuron.dv));
            (keep_u as f32, keep_v as f32, (1.0 / early_peak(keep_u, keep_v).0) as f32)
        }
        let mut leaves: Vec<_> = fields.iter().map(leaves).collect();
        if theta.is_infinite() {
            // The outputs' registers are compared, so they need one unit.
            let unit = leaves.first().map_or(1.0, |first| first.2);
            leaves.iter_mut().for_each(|leaves| leaves.2 = unit);
        }
        Loihi { leaves, fields, theta, weight_unit, credit }
    }

    /// The register v of the first compartment at a potential of 1 in trained-weight units.
    pub fn unit(&self) -> f32 {
        64.0 * self.weight_unit / self.leaves.first().map_or(1.0, |leaves| leaves.2)
    }
}

impl Cells {
    /// Number of neurons.
    pub fn count(&self) -> usize {
        match self {
            Cells::Srm(srm) => srm.response.len(),
            Cells::Loihi(loihi) => loihi.fields.len(),
            Cells::Loihi2(loihi2) => loihi2.rows.len(),
        }
    }

    /// The threshold in the units of the trained weights.
    pub fn theta(&self) -> f32 {
        match self {
            Cells::Srm(srm) => srm.theta,
            Cells::Loihi(loihi) => loihi.theta,
            Cells::Loihi2(loihi2) => loihi2.theta,
        }
    }

    /// The register value of a potential of 1 in the units of the trained weights.
    pub fn unit(&self) -> f32 {
        match self {
            Cells::Srm(_) => 1.0,
            Cells::Loihi(loihi) => loihi.unit(),
            Cells::Loihi2(loihi2) => loihi2.unit,
        }
    }

    /// The first neuron's response to a weight of 1, by steps.
    pub fn kernel(&self, steps: usize) -> Vec<f32> {
        let mut one = self.clone();
        match &mut one {
            Cells::Srm(srm) => srm.response.truncate(1),
            Cells::Loihi(loihi) => {
                loihi.fields.truncate(1);
                loihi.leaves.truncate(1);
            }
            Cells::Loihi2(loihi2) => loihi2.rows.truncate(1),
        }
        let mut impulse = vec![0.0; steps];
        if let Some(last) = impulse.last_mut() {
            *last = 1.0;
        }
        match &one {
            Cells::Srm(srm) => srm.correlate(&mut impulse),
            Cells::Loihi(loihi) => loihi.correlate(&vec![FREE; steps], &mut impulse),
            Cells::Loihi2(loihi2) => loihi2.correlate(&mut impulse, &[]),
        }
        impulse.reverse();
        impulse
    }

    /// Steps from a spike of another layer to the update that it enters. A Loihi compartment's
    /// spike takes one step; an SRM layer responds in the step of the spike (its kernel is 0 at 0).
    pub fn lag(&self) -> usize {
        match self {
            Cells::Srm(_) => 0,
            Cells::Loihi(_) | Cells::Loihi2(_) => 1,
        }
    }

    /// Potentials and spikes of a layer with input `drive` in each step, `[step][neuron]`; for
    /// Loihi cells in the units of [`update`], whole numbers below 2^24.
    pub fn forward(&self, drive: &[f32], surrogate: &Surrogate, spiking: Spiking, trace: &mut Trace) {
        let n = self.count();
        trace.potential.clear();
        trace.potential.resize(drive.len(), 0.0);
        trace.state.clear();
        trace.state.resize(drive.len(), FREE);
        trace.spikes.clear(n);
        match (self, spiking) {
            (Cells::Srm(srm), _) => srm.forward(drive, surrogate, spiking, trace),
            (Cells::Loihi(loihi), Spiking::Hard) => loihi.forward(drive, trace),
            (Cells::Loihi(loihi), Spiking::Smooth) => loihi.forward_smooth(drive, surrogate, trace),
            (Cells::Loihi2(loihi2), Spiking::Hard) => loihi2.forward(drive, trace),
            (Cells::Loihi2(loihi2), Spiking::Smooth) => loihi2.forward_smooth(drive, surrogate, trace),
        }
    }

    /// Converts `error`, `[step][neuron]`, in place: from the derivative of the loss by each spike
    /// to the derivative by each step's input, in the units of the trained weights. For neurons
    /// that never spike it starts as the derivative by each potential.
    pub fn backward(&self, trace: &Trace, surrogate: &Surrogate, error: &mut [f32]) {
        if self.theta().is_finite() && !matches!(self, Cells::Loihi2(_)) {
            error.iter_mut().zip(&trace.potential).for_each(|(e, &u)| *e *= surrogate.slope(u));
        }
        match self {
            Cells::Srm(srm) => srm.correlate(error),
            Cells::Loihi(loihi) => loihi.correlate(&trace.state, error),
            Cells::Loihi2(loihi2) => loihi2.backward(trace, surrogate, error),
        }
    }
}

impl Srm {
    fn forward(&self, drive: &[f32], surrogate: &Surrogate, spiking: Spiking, trace: &mut Trace) {
        let n = self.response.len();
        self.respond(drive, &mut trace.potential);
        if spiking == Spiking::Smooth {
            for potentials in trace.potential.chunks_exact(n) {
                for (j, &u) in potentials.iter().enumerate() {
                    trace.spikes.push(j as u32, surrogate.smooth(u));
                }
                trace.spikes.end_step();
            }
            return;
        }
        let (decay, gain) = self.refractory;
        let (mut first, mut second) = (vec![0.0f32; n], vec![0.0f32; n]);
        for t in 0..drive.len() / n.max(1) {
            let now = &mut trace.potential[t * n..][..n];
            match &self.truncated {
                None => {
                    for ((u, q), r) in now.iter_mut().zip(&mut first).zip(&mut second) {
                        *r = decay * (*r + *q);
                        *q *= decay;
                        *u += gain * *r;
                    }
                }
                Some((_, kernel)) => {
                    for (k, &nu) in kernel.iter().enumerate().skip(1).take_while(|&(k, _)| k <= t) {
                        // The state marks spikes; earlier potentials include their refractory part.
                        for (u, &state) in now.iter_mut().zip(&trace.state[(t - k) * n..]) {
                            if state == SPIKED {
                                *u += nu;
                            }
                        }
                    }
                }
            }
            for (j, u) in now.iter().enumerate() {
                if *u >= self.theta {
                    first[j] += 1.0;
                    trace.state[t * n + j] = SPIKED;
                    trace.spikes.push(j as u32, 1.0);
                }
            }
            trace.spikes.end_step();
        }
    }

    /// `eps * drive`.
    fn respond(&self, drive: &[f32], out: &mut [f32]) {
        let n = self.response.len();
        if let Some((kernel, _)) = &self.truncated {
            let steps = drive.len() / n.max(1);
            for t in 0..steps {
                for (k, &eps) in kernel.iter().enumerate().take_while(|&(k, _)| k <= t) {
                    let past = &drive[(t - k) * n..][..n];
                    for (u, z) in out[t * n..][..n].iter_mut().zip(past) {
                        *u += eps * z;
                    }
                }
            }
            return;
        }
        out.copy_from_slice(drive);
        self.filter(out.chunks_exact_mut(n));
    }

    /// `eps` by its recursions, step by step in place.
    fn filter<'a>(&self, steps: impl Iterator<Item = &'a mut [f32]>) {
        let n = self.response.len();
        let (mut first, mut second) = (vec![0.0f32; n], vec![0.0f32; n]);
        for values in steps {
            for j in 0..n {
                let (decay, gain) = self.response[j];
                second[j] = decay * (second[j] + first[j]);
                first[j] = decay * first[j] + values[j];
                values[j] = gain * second[j];
            }
        }
    }

    /// The correlation with `eps`: this filter, run backward in time.
    fn correlate(&self, error: &mut [f32]) {
        let n = self.response.len();
        if let Some((kernel, _)) = &self.truncated {
            let steps = error.len() / n.max(1);
            for t in 0..steps {
                let (now, later) = error[t * n..].split_at_mut(n);
                let was: Vec<f32> = now.to_vec();
                now.fill(0.0);
                for (k, &eps) in kernel.iter().enumerate().take_while(|&(k, _)| t + k < steps) {
                    let at = if k == 0 { &was[..] } else { &later[(k - 1) * n..][..n] };
                    for (c, e) in now.iter_mut().zip(at) {
                        *c += eps * e;
                    }
                }
            }
            return;
        }
        self.filter(error.rchunks_exact_mut(n));
    }
}

impl Loihi {
    fn forward(&self, drive: &[f32], trace: &mut Trace) {
        let n = self.fields.len();
        let mut registers = vec![Registers::default(); n];
        let reads_register = self.theta.is_infinite();
        let unit = |leaves: &(f32, f32, f32)| if reads_register { 1.0 } else { leaves.2 / (64.0 * self.weight_unit) };
        let unit: Vec<f32> = self.leaves.iter().map(unit).collect();
        for (t, z) in drive.chunks_exact(n).enumerate() {
            for j in 0..n {
                let f = &self.fields[j];
                let was = registers[j];
                let is_held = f.holds(&was);
                let (now, effect) = update(was, z[j] as i32, f);
                registers[j] = now;
                // The register reads 0 at a spike; u plus the rest of v crossed the threshold.
                let v = if effect.spiked && !reads_register {
                    nsim_dynamics::arithmetic::decay(i64::from(was.v), f.neuron.dv) as i32 + now.u + f.bias
                } else {
                    now.v
                };
                trace.potential[t * n + j] = v as f32 * unit[j];
                if effect.spiked {
                    trace.state[t * n + j] = SPIKED;
                    trace.spikes.push(j as u32, 1.0);
                } else if is_held {
                    trace.state[t * n + j] = HELD;
                }
            }
            trace.spikes.end_step();
        }
    }

    fn forward_smooth(&self, drive: &[f32], surrogate: &Surrogate, trace: &mut Trace) {
        let n = self.fields.len();
        let (mut current, mut voltage) = (vec![0.0f32; n], vec![0.0f32; n]);
        for (t, z) in drive.chunks_exact(n).enumerate() {
            for j in 0..n {
                let (a, b, gain) = self.leaves[j];
                current[j] = a * current[j] + z[j] / self.weight_unit;
                voltage[j] = b * voltage[j] + current[j];
                trace.potential[t * n + j] = gain * voltage[j];
                if self.theta.is_infinite() {
                    trace.potential[t * n + j] *= self.unit();
                } else {
                    trace.spikes.push(j as u32, surrogate.smooth(gain * voltage[j]));
                }
            }
            trace.spikes.end_step();
        }
    }

    fn correlate(&self, state: &[u8], error: &mut [f32]) {
        let n = self.fields.len();
        let (mut current, mut voltage) = (vec![0.0f32; n], vec![0.0f32; n]);
        for (e, s) in error.rchunks_exact_mut(n).zip(state.rchunks_exact(n)) {
            for j in 0..n {
                let (a, b, gain) = self.leaves[j];
                // A spike erases the earlier voltage; a held voltage receives nothing.
                let (keeps, enters) = match self.credit {
                    CreditDesc::Slayer => (1.0, 1.0),
                    CreditDesc::UpToReset => (f32::from(u8::from(s[j] == FREE)), f32::from(u8::from(s[j] != HELD))),
                };
                voltage[j] = enters * (e[j] + keeps * b * voltage[j]);
                current[j] = voltage[j] + a * current[j];
                e[j] = gain * current[j];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::planned;
    use nsim_ir::base::rng;

    fn cells(neuron: &str, size: usize) -> Cells {
        let text = format!(
            "Training(name: \"x\", timestep_ms: 1, inputs: [(name: \"i\", shape: [1])],
            layers: [(name: \"l\", from: [\"i\"], size: {size})], neuron: {neuron},
            loss: SpikeCount(right: 1, wrong: 0), optimiser: Adam(rate: 1), batch: 1, epochs: 1, seed: 1)"
        );
        planned(&text).topology.layers.remove(0).cells
    }

    fn random(seed: u64, n: usize) -> Vec<f32> {
        (0..n).map(|i| (2.0 * rng::unit(seed, 0, i as u64) - 1.0) as f32).collect()
    }

    fn dot(a: &[f32], b: &[f32]) -> f64 {
        a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
    }

    const SRM: &str = "Srm(tau_sr_ms: Spread(3, 9, 3), tau_ref_ms: 1, scale_ref: 2, theta: 10)";
    const CUT_OFF: &str = "Srm(tau_sr_ms: Same(5), tau_ref_ms: 1, scale_ref: 2, theta: 10, truncated: true)";

    #[test]
    fn correlating_is_the_transpose_of_responding() {
        for neuron in [SRM, CUT_OFF] {
            let Cells::Srm(srm) = cells(neuron, 3) else { panic!() };
            let (z, e) = (random(1, 60 * 3), random(2, 60 * 3));
            let mut responded = vec![0.0; z.len()];
            srm.respond(&z, &mut responded);
            let mut correlated = e.clone();
            srm.correlate(&mut correlated);
            let (forward, backward) = (dot(&e, &responded), dot(&correlated, &z));
            assert!((forward - backward).abs() < 1e-4 * forward.abs().max(1.0), "{forward} {backward}");
        }
    }

    #[test]
    fn the_response_is_the_convolution_with_the_kernel() {
        let z = random(3, 50);
        let alpha = |t: usize, tau: f64| t as f64 / tau * (1.0 - t as f64 / tau).exp();
        for (neuron, error) in [(SRM, 1e-5), (CUT_OFF, 0.1)] {
            let Cells::Srm(srm) = cells(neuron, 1) else { panic!() };
            let tau = if neuron == SRM { 3.0 } else { 5.0 };
            let mut responded = vec![0.0; z.len()];
            srm.respond(&z, &mut responded);
            for t in 0..z.len() {
                let direct: f64 = (0..=t).map(|k| alpha(k, tau) * f64::from(z[t - k])).sum();
                assert!((f64::from(responded[t]) - direct).abs() < error, "{neuron} {t}");
            }
        }
    }

    #[test]
    fn credit_is_the_transpose_of_integrating_between_resets() {
        for (credit, resets) in [("Slayer", false), ("UpToReset", true)] {
            let neuron = format!(
                "Loihi(tau_u_ms: Same(3), tau_v_ms: Spread(4, 20, 2), weight_scale: 16, refractory: 3, theta: 10, \
                 credit: {credit})"
            );
            let Cells::Loihi(loihi) = cells(&neuron, 2) else { panic!() };
            let (steps, n) = (80, 2);
            let (z, e) = (random(4, steps * n), random(5, steps * n));
            // Neuron 0 spikes at step 10 and is held in 11 and 12; neuron 1 spikes at 30.
            let mut state = vec![FREE; steps * n];
            (state[20], state[22], state[24], state[61]) = (SPIKED, HELD, HELD, SPIKED);
            let mut integrated = vec![0.0; steps * n];
            for j in 0..n {
                let (a, b, gain) = loihi.leaves[j];
                let (mut u, mut v) = (0.0, 0.0);
                for t in 0..steps {
                    u = a * u + z[t * n + j];
                    v = b * v + u;
                    if resets && state[t * n + j] == HELD {
                        v = 0.0;
                    }
                    integrated[t * n + j] = gain * v;
                    if resets && state[t * n + j] == SPIKED {
                        v = 0.0;
                    }
                }
            }
            let mut correlated = e.clone();
            loihi.correlate(&state, &mut correlated);
            let (forward, backward) = (dot(&e, &integrated), dot(&correlated, &z));
            assert!((forward - backward).abs() < 1e-4 * forward.abs().max(1.0), "{credit}: {forward} {backward}");
        }
    }

    #[test]
    fn a_response_peaks_at_the_weight() {
        let neuron = "Loihi(tau_u_ms: Same(5), tau_v_ms: Same(5), weight_scale: 32, theta: 10)";
        for neuron in [neuron, "Srm(tau_sr_ms: Same(10), tau_ref_ms: 1, scale_ref: 2, theta: 10)"] {
            let kernel = cells(neuron, 1).kernel(100);
            let peak = kernel.iter().copied().fold(0.0, f32::max);
            assert!((peak - 1.0).abs() < 1e-3, "{neuron}: {peak}");
        }
    }

    #[test]
    fn an_srm_neuron_rests_behind_a_spike() {
        for neuron in [SRM, CUT_OFF] {
            let cells = cells(neuron, 1);
            let mut drive = vec![0.0; 30];
            drive[0] = 25.0;
            let mut trace = Trace::default();
            cells.forward(&drive, &Surrogate::new(10.0, 1.0, 1.0), Spiking::Hard, &mut trace);
            let first = trace.spikes.events().next().unwrap().0 as usize;
            // nu peaks one step after the spike at -scale_ref * theta.
            let mut without = vec![0.0; 30];
            let Cells::Srm(srm) = &cells else { panic!() };
            srm.respond(&drive, &mut without);
            assert!((trace.potential[first] - without[first]).abs() < 1e-4);
            assert!((trace.potential[first + 1] - without[first + 1] + 20.0).abs() < 1e-3);
        }
    }
}
