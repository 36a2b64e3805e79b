//! Random numbers for scenes: each is a function of (seed, sample, purpose, index, step).
//!
//! Transcendental functions come from `libm`, whose code is the same on every machine, unlike the
//! platform's.

use nsim_ir::base::rng;

/// Purpose of a random number; different purposes never share one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Purpose {
    /// Label of a sample.
    Label,
    /// Parameters of the grasp, by index.
    Grasp,
    /// Pressure noise of a taxel in a step.
    Taxel,
    /// Properties of a taxel.
    TaxelGain,
    /// The relief of the object's surface.
    Relief,
    /// Vibration of the sliding contact.
    Sliding,
    /// Vibration of the arm.
    Arm,
    /// Noise events of the camera.
    PixelNoise,
    /// Number of noise events of a step.
    PixelNoiseCount,
    /// Properties of a pixel.
    PixelGain,
    /// The object's look.
    Look,
    /// Pulses and noise of the taxels' common wire.
    Wire,
    /// Polarity of the camera's noise events.
    PixelNoisePolarity,
    /// Noise and phase of tracked markers.
    Marker,
}

/// Random numbers of one sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Draws {
    seed: u64,
    sample: u32,
}

impl Draws {
    /// Random numbers of fingers, camera and wire, which do not depend on the scene's seed.
    pub const DEVICE: Draws = Draws { seed: 0, sample: 0 };

    /// The random numbers of a sample under a seed.
    pub fn new(seed: u64, sample: u32) -> Self {
        Draws { seed, sample }
    }

    /// 64 uniform bits; `index` is below 2^24.
    #[inline]
    pub fn bits(self, purpose: Purpose, index: u32, step: u32) -> u64 {
        let entity = u64::from(self.sample) << 32 | u64::from(purpose as u8) << 24 | u64::from(index & 0xff_ffff);
        rng::bits(self.seed, entity, u64::from(step))
    }

    /// A uniform real in [0, 1).
    #[inline]
    pub fn unit(self, purpose: Purpose, index: u32, step: u32) -> f64 {
        (self.bits(purpose, index, step) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A uniform real in [low, high).
    pub fn between(self, purpose: Purpose, index: u32, range: (f64, f64)) -> f64 {
        range.0 + (range.1 - range.0) * self.unit(purpose, index, 0)
    }

    /// A parameter of the grasp.
    pub(crate) fn grasp(self, index: u32, range: (f64, f64)) -> f64 {
        self.between(Purpose::Grasp, index, range)
    }

    /// Nearly normal with mean 0 and standard deviation 1: the sum of four uniform numbers of 16
    /// bits, which stays within 3.47 standard deviations.
    #[inline]
    pub fn normal(self, purpose: Purpose, index: u32, step: u32) -> f64 {
        let bits = self.bits(purpose, index, step);
        let sum = (bits & 0xffff) + (bits >> 16 & 0xffff) + (bits >> 32 & 0xffff) + (bits >> 48);
        // Four uniform numbers over 0..65536 have mean 4 x 32767.5 and variance 4 x 65536^2 / 12.
        (sum as f64 - 131_070.0) / (65_536.0 * 0.577_350_269_189_625_8)
    }

    /// A Poisson number by inversion: for small means.
    pub fn poisson(self, purpose: Purpose, index: u32, step: u32, mean: f64) -> u32 {
        let drawn = self.unit(purpose, index, step);
        let mut term = libm::exp(-mean);
        let (mut sum, mut count) = (term, 0);
        while drawn >= sum && count < 10_000 {
            count += 1;
            term *= mean / f64::from(count);
            sum += term;
        }
        count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_and_poisson_draws_have_their_moments() {
        let draws = Draws::new(3, 1);
        let moments = |f: &dyn Fn(u32) -> f64| {
            let n = 100_000;
            let (sum, squares) = (0..n).map(f).fold((0.0, 0.0), |(s, q), x| (s + x, q + x * x));
            let mean = sum / f64::from(n);
            (mean, squares / f64::from(n) - mean * mean)
        };
        // Standard errors over 100,000 draws are 0.003 (mean), 0.0045 (variance); bounds are five.
        let (mean, variance) = moments(&|i| draws.normal(Purpose::Taxel, 0, i));
        assert!(mean.abs() < 0.016 && (variance - 1.0).abs() < 0.023, "{mean} {variance}");
        let (mean, variance) = moments(&|i| f64::from(draws.poisson(Purpose::Taxel, 1, i, 2.5)));
        assert!((mean - 2.5).abs() < 0.025 && (variance - 2.5).abs() < 0.07, "{mean} {variance}");
    }

    #[test]
    fn purposes_samples_and_indices_do_not_share_numbers() {
        let draws = Draws::new(3, 1);
        let one = draws.bits(Purpose::Taxel, 1, 0);
        assert_ne!(one, draws.bits(Purpose::Arm, 1, 0));
        assert_ne!(one, draws.bits(Purpose::Taxel, 2, 0));
        assert_ne!(one, Draws::new(3, 2).bits(Purpose::Taxel, 1, 0));
    }
}
