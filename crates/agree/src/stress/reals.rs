//! Cases in real numbers: the recursions against compensated sums of the definition.
//!
//! The bound: after k steps the contribution of an input has passed at most 4 k + 4 roundings (of
//! the decay, of two products and two sums a step). Each has relative size u, half of the distance
//! from 1 to the next number. So the error of a kernel a over inputs x is at most
//! `u sum_k abs(x) a(k) (4 k + 4)`. It does not grow with the number of steps.

use super::outcome::Outcome;
use nsim_dynamics::RealForm;
use nsim_ir::arithmetic::ThresholdTest;
use nsim_ir::base::rng;
use nsim_reference::Real;
use nsim_reference::cuba::Cuba;
use nsim_reference::kernel::{Alpha, Kernel};
use nsim_reference::srm::{self, Filter, Srm};

const STEPS: u64 = 1_000_000;
/// Steps between two comparisons: coprime to every period of the inputs.
const EVERY: u64 = 97;
/// Kernels are below 1e-40 of their peak after this many time constants.
const TAILS: f64 = 100.0;

/// A sum whose rounding errors are carried along (Neumaier's variant of Kahan's).
#[derive(Default)]
struct Compensated {
    sum: f64,
    lost: f64,
}

impl Compensated {
    fn add(&mut self, x: f64) {
        let sum = self.sum + x;
        self.lost += if self.sum.abs() >= x.abs() { (self.sum - sum) + x } else { (x - sum) + self.sum };
        self.sum = sum;
    }

    fn get(&self) -> f64 {
        self.sum + self.lost
    }
}

/// The input of a step: exact in single precision, of both signs, a third of the steps silent.
fn input(step: u64) -> f64 {
    let number = rng::below(192, 11, 0, step) as f64;
    if number < 64.0 { 0.0 } else { (number - 112.0) / 64.0 }
}

/// Runs a recursion and compares it with the kernel `(k, weight)` over its inputs. Reports the
/// greatest error over the first and the last tenth, and the bound.
fn growth(what: &str, unit: f64, kernel: &[f64], mut next: impl FnMut(f64) -> f64) -> Outcome {
    let (mut early, mut late) = (0.0f64, 0.0f64);
    let bound = unit * 1.25 * kernel.iter().enumerate().map(|(k, a)| a.abs() * (4.0 * k as f64 + 4.0)).sum::<f64>();
    for step in 0..STEPS {
        let value = next(input(step));
        if !step.is_multiple_of(EVERY) {
            continue;
        }
        let mut exact = Compensated::default();
        let reach = (step as usize + 1).min(kernel.len());
        kernel[..reach].iter().enumerate().for_each(|(k, a)| exact.add(a * input(step - k as u64)));
        let error = (value - exact.get()).abs();
        if step < STEPS / 10 {
            early = early.max(error);
        } else if step >= STEPS - STEPS / 10 {
            late = late.max(error);
        }
    }
    let detail =
        format!("{what}: greatest error {early:.2e} in the first tenth, {late:.2e} in the last; bound {bound:.2e}");
    match early.max(late) <= bound && late > 0.0 {
        true => Ok((STEPS, detail)),
        false => Err((STEPS, detail)),
    }
}

/// An alpha kernel from one step after the input on.
fn taps(alpha: &Alpha) -> Vec<f64> {
    (1..(alpha.tau * TAILS) as u32 + 10).map(|k| alpha.at(k)).collect()
}

pub(super) const RESPONSE: Alpha = Alpha { peak: 1.0, tau: 10.0 };
pub(super) const REFRACTORY: Alpha = Alpha { peak: -20.0, tau: 1.0 };

pub(super) fn filter<F: Real>(alpha: Alpha, epsilon: f64, what: &str) -> Outcome {
    let mut filter = Filter::<F>::new(&alpha, Kernel::Exact, 1);
    growth(what, epsilon / 2.0, &taps(&alpha), |x| {
        let mut out = [F::default()];
        filter.step(&[F::from_f64(x)], &mut out);
        out[0].into()
    })
}

pub(super) fn cuba_f64() -> Outcome {
    let p = RealForm {
        keep_u: 0.75,
        keep_v: 0.96875,
        threshold: f64::MAX,
        bias: 0.0,
        refractory: 1,
        subtracts: false,
        clip: (f64::MIN, f64::MAX),
    };
    let mut population = Cuba::<f64>::new(&[p], ThresholdTest::Strict);
    // v(k) = sum_j keep_v^(k - j) keep_u^j, both decays exact.
    let kernel: Vec<f64> = (0..2000)
        .map(|k| {
            (libm::pow(p.keep_v, f64::from(k + 1)) - libm::pow(p.keep_u, f64::from(k + 1))) / (p.keep_v - p.keep_u)
        })
        .collect();
    growth("current and voltage, du 1024, dv 128, f64", f64::EPSILON / 2.0, &kernel, |x| {
        population.step(&[x], |_| ());
        population.voltage()[0]
    })
}

/// One arrival, then silence: states sink through denormal numbers to zero, harmlessly.
pub(super) fn denormals<F: Real>(smallest_normal: f64, what: &str) -> Outcome {
    let parameters = srm::Parameters { tau_sr: 10.0, tau_ref: 1.0, scale_ref: 2.0, theta: 10.0 };
    let mut population = Srm::<F>::new(&parameters, Kernel::Exact, 2);
    let (mut spikes, mut denormal, mut last) = (0u64, 0u64, f64::MAX);
    for step in 0..STEPS {
        let arrivals = if step == 0 { [F::from_f64(200.0), F::from_f64(-200.0)] } else { [F::default(); 2] };
        population.step(&arrivals, |neuron| spikes += 1 + 1000 * u64::from(neuron));
        for (neuron, u) in population.potential().iter().map(|&u| Into::<f64>::into(u)).enumerate() {
            if !u.is_finite() {
                return Err((step, format!("{what}: neuron {neuron} is {u} in step {step}")));
            }
            denormal += u64::from(u != 0.0 && u.abs() < smallest_normal);
            // The neuron that cannot spike sinks without a turn once its kernel is past the peak.
            if neuron == 1 && step > 10 {
                if u.abs() > last {
                    return Err((step, format!("{what}: rises from {last:e} to {:e} in step {step}", u.abs())));
                }
                last = u.abs();
            }
        }
    }
    let detail = format!("{what}: {denormal} denormal potentials, {spikes} spikes before them, ends at {last:.1e}");
    match denormal > 0 && last < smallest_normal && spikes > 0 && spikes < 1000 {
        true => Ok((STEPS, detail)),
        false => Err((STEPS, detail)),
    }
}
