//! The surrogate gradient of a spike (Shrestha, Orchard: "SLAYER", NeurIPS 2018, eq. 15; parameters
//! as in slayerPytorch `spikeLayer.py`, `tauRho` and `scaleRho`).

/// `rho(u) = scale / (tau * theta) * exp(-|u - theta| / (tau * theta))`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surrogate {
    theta: f32,
    /// `1 / (tau * theta)`.
    steepness: f32,
    scale: f32,
}

impl Surrogate {
    /// Threshold, steepness and scale.
    #[must_use]
    pub fn numbers(&self) -> [f32; 3] {
        [self.theta, self.steepness, self.scale]
    }

    /// For a threshold; `tau_rho` is the width in thresholds.
    pub fn new(theta: f32, tau_rho: f32, scale_rho: f32) -> Self {
        Surrogate { theta, steepness: 1.0 / (tau_rho * theta), scale: scale_rho }
    }

    /// The surrogate derivative at a potential.
    #[inline]
    pub fn slope(&self, u: f32) -> f32 {
        self.scale * self.steepness * exp_minus(((u - self.theta) * self.steepness).abs())
    }

    /// The integral of [`Surrogate::slope`], which the smoothed network uses as its spike.
    pub fn smooth(&self, u: f32) -> f32 {
        let x = (u - self.theta) * self.steepness;
        self.scale * if x < 0.0 { exp_minus(-x) } else { 2.0 - exp_minus(x) }
    }

    /// A pulse at 0 of area 1, as wide as the slope; a zero crossing has it in place of a step.
    #[inline]
    pub fn pulse(&self, x: f32) -> f32 {
        0.5 * self.steepness * exp_minus((x * self.steepness).abs())
    }

    /// The derivative of [`Surrogate::pulse`].
    #[inline]
    pub fn pulse_slope(&self, x: f32) -> f32 {
        -self.steepness * x.signum() * self.pulse(x)
    }
}

/// `exp(-x)` for x >= 0 within 3e-7, in operations that round identically everywhere: a power of
/// two times a polynomial (Taylor's, of 2^f around f = -1/2) that compilers can run over vectors.
#[inline]
fn exp_minus(x: f32) -> f32 {
    let y = (x * std::f32::consts::LOG2_E).min(125.0);
    let whole = y as i32;
    let f = (whole as f32 - y + 0.5) * std::f32::consts::LN_2;
    let series =
        1.0 + f * (1.0 + f * (0.5 + f * (1.0 / 6.0 + f * (1.0 / 24.0 + f * (1.0 / 120.0 + f * (1.0 / 720.0))))));
    series * std::f32::consts::FRAC_1_SQRT_2 * f32::from_bits(((127 - whole) as u32) << 23)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponential_is_one() {
        for i in 0..80_000 {
            let x = i as f32 * 1e-3;
            let exact = f64::from(-x).exp();
            let error = (f64::from(exp_minus(x)) - exact).abs();
            assert!(error <= 3e-7 && error <= 2e-5 * exact, "{x}");
        }
    }

    #[test]
    fn the_slope_is_that_of_the_smooth_spike() {
        let surrogate = Surrogate::new(10.0, 1.5, 0.8);
        for u in [-20.0f32, 3.0, 9.0, 11.0, 40.0] {
            let difference = (surrogate.smooth(u + 0.05) - surrogate.smooth(u - 0.05)) / 0.1;
            assert!((difference - surrogate.slope(u)).abs() < 1e-4, "{u}");
        }
    }
}
