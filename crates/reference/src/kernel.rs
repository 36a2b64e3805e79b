//! Alpha kernels: `a(t) = m t / tau exp(1 - t / tau)`, with its peak m at t = tau.
//!
//! The spike response model of the paper (`u(t) = sum_i w_i (eps * s_i)(t) + (nu * o)(t)`, section
//! III-B) leaves eps and nu open; the authors' configuration and SLAYER (Shrestha and Orchard,
//! NeurIPS 2018; slayerPytorch `src/slayer.py`) take alpha kernels for both: eps with m = 1 and tau
//! = tauSr, nu with m = -scaleRef theta and tau = tauRef.
//!
//! One timestep takes `k exp(-k dt / tau)` to `(k + 1) exp(-(k + 1) dt / tau)`. So two coupled
//! decays, with [`Alpha::decay`] and [`Alpha::gain`], give the kernel exactly.

use nsim_ir::base::names::named_variants;

/// Method by which a kernel is applied.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Kernel {
    /// Untruncated, by recursion.
    #[default]
    Exact,
    /// Truncated as by SLAYER, by convolution: at the first t beyond tau at which it is below
    /// [`EPSILON`].
    Truncated,
}

named_variants!(Kernel { Exact = "exact", Truncated = "truncated" });

/// Magnitude below which SLAYER cuts a kernel, its factor included (slayerPytorch `src/slayer.py`,
/// `_calculateAlphaKernel`; with `fullRefKernel`, which is off by default, it cuts the refractory
/// kernel at 0.0001).
pub const EPSILON: f64 = 0.01;

/// An alpha kernel sampled at multiples of a timestep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Alpha {
    /// The greatest value, with its sign, at t = tau.
    pub peak: f64,
    /// Time constant in timesteps, above 0.
    pub tau: f64,
}

impl Alpha {
    /// The kernel `k` timesteps after a spike; 0 at the spike itself.
    pub fn at(&self, k: u32) -> f64 {
        let t = f64::from(k) / self.tau;
        self.peak * t * libm::exp(1.0 - t)
    }

    /// Fraction of an exponential with the kernel's time constant kept by one timestep, 0..=1.
    pub fn decay(&self) -> f64 {
        libm::exp(-1.0 / self.tau)
    }

    /// Factor of `k r^k` in the kernel.
    pub fn gain(&self) -> f64 {
        self.peak * std::f64::consts::E / self.tau
    }

    /// The kernel's values from 0 on, cut at the first beyond tau whose magnitude is below
    /// `epsilon`, and after `most`.
    pub fn truncated(&self, epsilon: f64, most: u32) -> Vec<f64> {
        let values = (0..most).map(|k| (k, self.at(k)));
        values.take_while(|&(k, value)| value.abs() >= epsilon || f64::from(k) <= self.tau).map(|(_, v)| v).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_peak_is_at_tau() {
        let alpha = Alpha { peak: -20.0, tau: 10.0 };
        assert_eq!((alpha.at(0), alpha.at(10)), (0.0, -20.0));
        assert!((1..60).all(|k| alpha.at(k) >= -20.0));
    }

    #[test]
    fn decay_and_gain_make_the_kernel() {
        for tau in [0.7, 1.0, 2.5, 10.0, 33.3] {
            let alpha = Alpha { peak: 1.7, tau };
            for k in 0..200 {
                let product = alpha.gain() * f64::from(k) * alpha.decay().powi(k);
                assert!((alpha.at(k as u32) - product).abs() < 1e-13, "tau {tau}, k {k}");
            }
        }
    }

    #[test]
    fn slayer_cuts_the_paper_s_kernels_here() {
        // tauSr 10: 77 values, the last at t = 76 (0.76 e^-6.6 = 0.0103 ..); tauRef 1, scaleRef 2,
        // theta 10.
        let response = Alpha { peak: 1.0, tau: 10.0 }.truncated(EPSILON, 10_000);
        assert!(response.len() > 70 && response.len() < 80, "{}", response.len());
        assert!(response.last().is_some_and(|&last| last >= EPSILON));
        assert!(Alpha { peak: 1.0, tau: 10.0 }.at(response.len() as u32) < EPSILON);
        let refractory = Alpha { peak: -20.0, tau: 1.0 }.truncated(EPSILON, 10_000);
        assert!(refractory.len() > 9 && refractory.len() < 14, "{}", refractory.len());
        // A sample may be shorter than its kernel.
        assert_eq!(Alpha { peak: 1.0, tau: 10.0 }.truncated(EPSILON, 5).len(), 5);
    }
}
