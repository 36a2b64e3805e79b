//! Spike response neurons: `u(t) = sum_i w_i (eps * s_i)(t) + (nu * o)(t)`, a spike where
//! `u(t) >= theta`.
//!
//! Input: in each step, the weighted spikes of the previous step, summed for each neuron. Output:
//! the neurons that spike. Kernels are 0 at t = 0, so a spike of step t first counts in step t + 1,
//! with eps(1) or nu(1).
//!
//! SLAYER compares with `>=` (slayerPytorch `src/cuda/spikeKernels.h`); in the paper u has to
//! exceed the threshold. The two differ only where u equals theta to the last bit.

use std::collections::VecDeque;

use super::kernel::{Alpha, EPSILON, Kernel};
use super::real::Real;

/// Longest truncated kernel in timesteps; longer ones are cut here.
const LONGEST: u32 = 100_000;

/// The parameters of a spike response neuron, in timesteps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameters {
    /// Time constant of the response.
    pub tau_sr: f64,
    /// Time constant of the refractory response.
    pub tau_ref: f64,
    /// Peak of the refractory response in thresholds.
    pub scale_ref: f64,
    /// Threshold, in the units of weights times the response's peak of 1.
    pub theta: f64,
}

impl Parameters {
    /// The response kernel eps.
    pub fn response(&self) -> Alpha {
        Alpha { peak: 1.0, tau: self.tau_sr }
    }

    /// The refractory kernel nu.
    pub fn refractory(&self) -> Alpha {
        Alpha { peak: -self.scale_ref * self.theta, tau: self.tau_ref }
    }
}

/// An alpha kernel applied to an equal number of inputs in each step.
#[derive(Debug, Clone)]
pub enum Filter<F> {
    /// Recursion by two coupled decays.
    Exact {
        /// Fraction of a state kept by one step, 0..=1.
        decay: F,
        /// The kernel's factor.
        gain: F,
        /// State of the first decay: `sum_k x(t - k) r^k`.
        first: Vec<F>,
        /// State of the second decay in the next step: `sum_k x(t - k) k r^k`.
        second: Vec<F>,
    },
    /// Convolution of the past inputs with the kernel.
    Truncated {
        /// The kernel from 1 step after the input on.
        taps: Vec<F>,
        /// The inputs so far, the newest first, at most one for each tap. Steps before the first
        /// input cost nothing.
        past: VecDeque<Vec<F>>,
        /// Number of inputs in a step.
        inputs: usize,
    },
}

impl<F: Real> Filter<F> {
    /// Filters in their resting state.
    pub fn new(alpha: &Alpha, kernel: Kernel, inputs: usize) -> Self {
        match kernel {
            Kernel::Exact => Filter::Exact {
                decay: F::from_f64(alpha.decay()),
                gain: F::from_f64(alpha.gain()),
                first: vec![F::default(); inputs],
                second: vec![F::default(); inputs],
            },
            Kernel::Truncated => {
                let taps: Vec<F> = alpha.truncated(EPSILON, LONGEST).into_iter().skip(1).map(F::from_f64).collect();
                Filter::Truncated { taps, past: VecDeque::new(), inputs }
            }
        }
    }

    /// Returns all filters to their resting state.
    pub fn clear(&mut self) {
        match self {
            Filter::Exact { first, second, .. } => {
                first.fill(F::default());
                second.fill(F::default());
            }
            Filter::Truncated { past, .. } => past.clear(),
        }
    }

    /// Takes the inputs of one step. Adds to `to` the response, one step later, to these and all
    /// earlier inputs.
    pub fn step(&mut self, inputs: &[F], to: &mut [F]) {
        match self {
            Filter::Exact { decay, gain, first, second } => {
                for (((first, second), &x), to) in first.iter_mut().zip(second).zip(inputs).zip(to) {
                    // k + 1 steps after it, an input contributes (k + 1) r^(k + 1).
                    *first = *decay * *first + x;
                    *second = *decay * *second + *decay * *first;
                    *to += *gain * *second;
                }
            }
            Filter::Truncated { taps, past, inputs: count } => {
                let mut row = if past.len() < taps.len().max(1) { None } else { past.pop_back() }.unwrap_or_default();
                row.clear();
                row.extend_from_slice(&inputs[..*count]);
                past.push_front(row);
                for (&tap, row) in taps.iter().zip(past.iter()) {
                    for (to, &x) in to.iter_mut().zip(row) {
                        *to += tap * x;
                    }
                }
            }
        }
    }
}

/// A population of spike response neurons with equal parameters.
#[derive(Debug, Clone)]
pub struct Srm<F> {
    theta: F,
    response: Filter<F>,
    refractory: Filter<F>,
    /// 1 for neurons that spiked in the last step, else 0.
    spiked: Vec<F>,
    potential: Vec<F>,
}

impl<F: Real> Srm<F> {
    /// Neurons in their resting state.
    pub fn new(parameters: &Parameters, kernel: Kernel, neurons: usize) -> Self {
        Srm {
            theta: F::from_f64(parameters.theta),
            response: Filter::new(&parameters.response(), kernel, neurons),
            refractory: Filter::new(&parameters.refractory(), kernel, neurons),
            spiked: vec![F::default(); neurons],
            potential: vec![F::default(); neurons],
        }
    }

    /// Returns all neurons to their resting state.
    pub fn clear(&mut self) {
        self.response.clear();
        self.refractory.clear();
        self.spiked.fill(F::default());
        self.potential.fill(F::default());
    }

    /// Runs one timestep; `arrivals` is the weighted spikes of the previous step, one sum a neuron.
    /// Calls `spike` with each neuron that spikes, ascending.
    pub fn step(&mut self, arrivals: &[F], mut spike: impl FnMut(u32)) {
        self.potential.fill(F::default());
        self.response.step(arrivals, &mut self.potential);
        self.refractory.step(&self.spiked, &mut self.potential);
        for (neuron, (&u, spiked)) in self.potential.iter().zip(&mut self.spiked).enumerate() {
            let fires = u >= self.theta;
            *spiked = F::from_f64(f64::from(u8::from(fires)));
            if fires {
                spike(neuron as u32);
            }
        }
    }

    /// u after the last step, the refractory response included.
    pub fn potential(&self) -> &[F] {
        &self.potential
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::base::rng;

    const PAPER: Parameters = Parameters { tau_sr: 10.0, tau_ref: 1.0, scale_ref: 2.0, theta: 10.0 };

    /// u by its definition: every past input and every own spike through its kernel `eps` or `nu`,
    /// in each step anew. Arrivals of step t are spikes of step t - 1.
    fn direct(
        arrivals: &[f64],
        theta: f64,
        eps: impl Fn(usize) -> f64,
        nu: impl Fn(usize) -> f64,
    ) -> (Vec<f64>, Vec<usize>) {
        let (mut u, mut spikes) = (Vec::new(), Vec::new());
        for t in 0..arrivals.len() {
            let response: f64 = (0..=t).map(|s| arrivals[s] * eps(t - s + 1)).sum();
            let refractory: f64 = spikes.iter().map(|&s: &usize| nu(t - s)).sum();
            u.push(response + refractory);
            if u[t] >= theta {
                spikes.push(t);
            }
        }
        (u, spikes)
    }

    fn run<F: Real>(parameters: &Parameters, kernel: Kernel, arrivals: &[f64]) -> (Vec<f64>, Vec<usize>) {
        let mut population = Srm::<F>::new(parameters, kernel, 1);
        let (mut u, mut spikes) = (Vec::new(), Vec::new());
        for (t, &x) in arrivals.iter().enumerate() {
            population.step(&[F::from_f64(x)], |_| spikes.push(t));
            u.push(population.potential()[0].into());
        }
        (u, spikes)
    }

    fn drive(seed: u64, steps: usize) -> Vec<f64> {
        let spikes = |t: u64| rng::unit(seed, 0, t) < 0.4;
        (0..steps as u64).map(|t| if spikes(t) { 6.0 * rng::unit(seed, 1, t) - 1.5 } else { 0.0 }).collect()
    }

    #[test]
    fn the_recursion_is_the_convolution_with_the_endless_kernel() {
        let others = [
            PAPER,
            Parameters { tau_sr: 2.5, tau_ref: 3.0, scale_ref: 1.0, theta: 4.0 },
            Parameters { tau_sr: 1.0, tau_ref: 0.5, scale_ref: 5.0, theta: 0.5 },
        ];
        for (seed, parameters) in others.into_iter().enumerate() {
            let arrivals = drive(seed as u64, 400);
            let (u, spikes) = run::<f64>(&parameters, Kernel::Exact, &arrivals);
            let (eps, nu) = (parameters.response(), parameters.refractory());
            let (expected, theirs) = direct(&arrivals, parameters.theta, |k| eps.at(k as u32), |k| nu.at(k as u32));
            assert_eq!(spikes, theirs);
            assert!(spikes.len() > 10, "{}", spikes.len());
            for (t, (a, b)) in u.iter().zip(&expected).enumerate() {
                assert!((a - b).abs() <= 1e-12 * parameters.theta.max(a.abs()), "step {t}: {a} {b}");
            }
        }
    }

    #[test]
    fn the_truncated_kernel_is_the_convolution_with_what_slayer_keeps() {
        let arrivals = drive(9, 400);
        let (u, spikes) = run::<f64>(&PAPER, Kernel::Truncated, &arrivals);
        let eps = PAPER.response().truncated(EPSILON, 1000);
        let nu = PAPER.refractory().truncated(EPSILON, 1000);
        let of = |kernel: &[f64], k: usize| kernel.get(k).copied().unwrap_or(0.0);
        let (expected, theirs) = direct(&arrivals, PAPER.theta, |k| of(&eps, k), |k| of(&nu, k));
        assert_eq!(spikes, theirs);
        assert!(u.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-12 * 100.0));
        // Truncation matters: 1 % of a peak for each arrival, but not more than the kernel's tail.
        let (exact, _) = run::<f64>(&PAPER, Kernel::Exact, &arrivals);
        let most = u.iter().zip(&exact).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(most > 1e-3, "{most}");
    }

    #[test]
    fn single_precision_stays_near() {
        let arrivals = drive(4, 300);
        let below: Vec<f64> = arrivals.iter().map(|x| x * 0.1).collect();
        let (u, _) = run::<f64>(&PAPER, Kernel::Exact, &below);
        let (single, _) = run::<f32>(&PAPER, Kernel::Exact, &below);
        assert!(u.iter().zip(&single).all(|(a, b)| (a - b).abs() < 1e-4));
    }

    #[test]
    fn clearing_returns_to_rest() {
        for kernel in [Kernel::Exact, Kernel::Truncated] {
            let mut population = Srm::<f64>::new(&PAPER, kernel, 2);
            let mut spikes = 0;
            (0..50).for_each(|_| population.step(&[9.0, 3.0], |_| spikes += 1));
            assert!(spikes > 0);
            population.clear();
            population.step(&[0.0, 0.0], |_| panic!("a spike at rest"));
            assert_eq!(population.potential(), [0.0, 0.0]);
        }
    }
}
