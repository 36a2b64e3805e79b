//! Current-based neurons with exponential current and voltage and a reset to zero or by
//! subtraction: the Loihi neuron without its integers.
//!
//! Input: the weighted spikes that arrive in each step. Output: the neurons that spike.
//! `u(t) = (1 - du) u(t - 1) + x(t)`, `v(t) = (1 - dv) v(t - 1) + u(t) + b`, and a spike above the
//! threshold. Then v = 0, held until `refractory` steps after the spike, or v less the threshold
//! (`docs/semantics.md`, equations 2 to 7, without rounding, wrapping or bits).

use super::real::Real;
use nsim_dynamics::RealForm;
use nsim_ir::arithmetic::ThresholdTest;

#[derive(Debug, Clone, Copy)]
struct Neuron<F> {
    keep_u: F,
    keep_v: F,
    threshold: F,
    bias: F,
    low: F,
    high: F,
    refractory: u32,
    subtracts: bool,
}

/// A population of current-based neurons.
#[derive(Debug, Clone)]
pub struct Cuba<F> {
    neurons: Vec<Neuron<F>>,
    test: ThresholdTest,
    current: Vec<F>,
    voltage: Vec<F>,
    /// Steps for which v is still held.
    held: Vec<u32>,
}

impl<F: Real> Cuba<F> {
    /// Neurons in their resting state.
    pub fn new(parameters: &[RealForm], test: ThresholdTest) -> Self {
        let neuron = |p: &RealForm| Neuron {
            keep_u: F::from_f64(p.keep_u),
            keep_v: F::from_f64(p.keep_v),
            threshold: F::from_f64(p.threshold),
            bias: F::from_f64(p.bias),
            low: F::from_f64(p.clip.0),
            high: F::from_f64(p.clip.1),
            refractory: p.refractory.max(1),
            subtracts: p.subtracts,
        };
        let count = parameters.len();
        Cuba {
            neurons: parameters.iter().map(neuron).collect(),
            test,
            current: vec![F::default(); count],
            voltage: vec![F::default(); count],
            held: vec![0; count],
        }
    }

    /// Returns all neurons to their resting state.
    pub fn clear(&mut self) {
        self.current.fill(F::default());
        self.voltage.fill(F::default());
        self.held.fill(0);
    }

    /// Runs one timestep; `arrivals` is one sum of weighted spikes a neuron. Calls `spike` with
    /// each neuron that spikes, ascending.
    pub fn step(&mut self, arrivals: &[F], mut spike: impl FnMut(u32)) {
        for (i, (neuron, &x)) in self.neurons.iter().zip(arrivals).enumerate() {
            let u = neuron.keep_u * self.current[i] + x;
            self.current[i] = u;
            let free = neuron.keep_v * self.voltage[i] + (u + neuron.bias);
            let v = if free < neuron.low {
                neuron.low
            } else if free > neuron.high {
                neuron.high
            } else {
                free
            };
            if self.held[i] > 0 {
                self.held[i] -= 1;
                self.voltage[i] = F::default();
                continue;
            }
            let fires = match self.test {
                ThresholdTest::Strict => v > neuron.threshold,
                ThresholdTest::Inclusive => v >= neuron.threshold,
            };
            self.voltage[i] = match (fires, neuron.subtracts) {
                (false, _) => v,
                (true, false) => F::default(),
                (true, true) => v - neuron.threshold,
            };
            if fires {
                self.held[i] = neuron.refractory - 1;
                spike(i as u32);
            }
        }
    }

    /// u after the last step.
    pub fn current(&self) -> &[F] {
        &self.current
    }

    /// v after the last step: 0 at a spike and while it is held.
    pub fn voltage(&self) -> &[F] {
        &self.voltage
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::base::rng;

    /// v by its definition: the double sum over all arrivals since the last reset of v, and over
    /// earlier ones through u.
    fn direct(p: &RealForm, arrivals: &[f64]) -> (Vec<f64>, Vec<usize>) {
        let (mut out, mut spikes) = (Vec::new(), Vec::new());
        let mut free_from = 0; // the first step that counts in v
        for t in 0..arrivals.len() {
            let current =
                |t: usize| -> f64 { (0..=t).map(|s| arrivals[s] * libm::pow(p.keep_u, (t - s) as f64)).sum() };
            let v: f64 = (free_from..=t).map(|s| (current(s) + p.bias) * libm::pow(p.keep_v, (t - s) as f64)).sum();
            let fires = t >= free_from && v > p.threshold;
            out.push(if fires || t < free_from { 0.0 } else { v });
            if fires {
                spikes.push(t);
                free_from = t + p.refractory as usize;
            }
        }
        (out, spikes)
    }

    #[test]
    fn the_recursion_is_the_convolution() {
        let parameters = |keep_u, keep_v, refractory, bias| RealForm {
            keep_u,
            keep_v,
            threshold: 8.0,
            bias,
            refractory,
            subtracts: false,
            clip: (f64::MIN, f64::MAX),
        };
        let cases = [
            parameters(0.75, 0.97, 1, 0.0),
            parameters(0.904_837, 0.904_837, 3, 0.1),
            parameters(0.0, 1.0, 5, -0.05),
            parameters(1.0, 0.0, 2, 0.0),
        ];
        for (seed, p) in cases.into_iter().enumerate() {
            let arrivals: Vec<f64> = (0..200).map(|t| 4.0 * rng::unit(seed as u64, 0, t) - 1.5).collect();
            let mut population = Cuba::<f64>::new(&[p], ThresholdTest::Strict);
            let (mut v, mut spikes) = (Vec::new(), Vec::new());
            for (t, &x) in arrivals.iter().enumerate() {
                population.step(&[x], |_| spikes.push(t));
                v.push(population.voltage()[0]);
            }
            let (expected, theirs) = direct(&p, &arrivals);
            assert_eq!(spikes, theirs, "case {seed}");
            assert!(spikes.len() > 3, "case {seed}: {}", spikes.len());
            assert!(v.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-12 * (1.0 + b.abs())), "case {seed}");
        }
    }
}
