//! Weights of any range as integers of a synapse format.
//!
//! Input: weights in units of the mantissa, as other tools write them. Output: the weights divided
//! by a power of two, with an exponent and sign mode that represent them exactly, if any do.
//! Otherwise weights are rounded to even steps, clipped and counted. lava-dl's own encoder
//! (`netx/utils.py`, `optimize_weight_bits`) shifts a matrix with 255 and -256 by a negative number
//! of bits and leaves zeros (issue 170 of lava-dl).

use nsim_ir::base::fixed::{SignMode, WeightBits};

/// Weights in a format.
#[derive(Debug, Clone, PartialEq)]
pub struct Encoded {
    /// Mantissas.
    pub weights: Vec<f64>,
    /// Weight exponent.
    pub exponent: i64,
    /// Sign mode.
    pub sign: SignMode,
    /// Number of weights that rounding or clipping changed.
    pub changed: usize,
}

impl Encoded {
    /// The projection's weight exponent; `None` for 0.
    pub fn exponent(&self) -> Option<i64> {
        (self.exponent != 0).then_some(self.exponent)
    }

    /// The weights in units of the exponent `given`.
    pub fn in_units(&self, given: i64) -> Vec<f64> {
        let power = ((self.exponent - given) as f64).exp2();
        self.weights.iter().map(|weight| weight * power).collect()
    }
}

/// The greatest weight exponent (`docs/semantics.md`).
const GREATEST: i64 = 7;

/// Encodes weights at the exponent `given` in a format of 8 bits.
pub fn encode(weights: Vec<f64>, given: i64) -> Encoded {
    let bits = WeightBits::MAX;
    for shift in 0..=(GREATEST - given).max(0) {
        let power = (shift as f64).exp2();
        for sign in [SignMode::Mixed, SignMode::Excitatory, SignMode::Inhibitory] {
            let (low, high) = sign.range(bits);
            let mut mantissas = weights.iter().map(|&weight| weight / power);
            if mantissas.all(|x| x >= f64::from(low) && x <= f64::from(high) && x % f64::from(sign.step(bits)) == 0.0) {
                let weights = if shift == 0 { weights } else { weights.iter().map(|&w| w / power).collect() };
                return Encoded { weights, exponent: given + shift, sign, changed: 0 };
            }
        }
    }
    // The least exponent that clips only mantissas from 255 to 256, up to a step above the range.
    let (low, high) = SignMode::Mixed.range(bits);
    let within = f64::from(low) - 1.0..=f64::from(high) + 2.0;
    let shift = (0..=(GREATEST - given).max(0))
        .find(|&shift| weights.iter().all(|&w| within.contains(&(w / (shift as f64).exp2()))))
        .unwrap_or((GREATEST - given).max(0));
    let power = (shift as f64).exp2();
    let mut changed = 0;
    let rounded = weights
        .iter()
        .map(|&weight| {
            let mantissa = ((weight / power / 2.0).round_ties_even() * 2.0).clamp(f64::from(low), f64::from(high));
            changed += usize::from(mantissa * power != weight);
            mantissa
        })
        .collect();
    Encoded { weights: rounded, exponent: given + shift, sign: SignMode::Mixed, changed }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn weights_take_the_format_that_holds_most_of_them() {
        for (given, weights, exponent, sign, changed) in [
            // lava-dl makes zeros of this.
            (vec![255.0, -256.0, 0.0, 128.0], vec![254.0, -256.0, 0.0, 128.0], 0, SignMode::Mixed, 1),
            // Odd weights of one sign fit.
            (vec![255.0, 1.0], vec![255.0, 1.0], 0, SignMode::Excitatory, 0),
            (vec![-255.0, -1.0], vec![-255.0, -1.0], 0, SignMode::Inhibitory, 0),
            // Large weights need an exponent.
            (vec![508.0, -512.0, 4.0], vec![254.0, -256.0, 2.0], 1, SignMode::Mixed, 0),
            (vec![0.0; 3], vec![0.0; 3], 0, SignMode::Mixed, 0),
        ] {
            assert_eq!(encode(given, 0), Encoded { weights, exponent, sign, changed });
        }
    }

    proptest! {
        #[test]
        fn what_fits_a_format_is_not_changed(
            mantissas in prop::collection::vec(-128i32..=127, 1..40),
            exponent in 0i64..=7,
        ) {
            let weights: Vec<f64> = mantissas.iter().map(|&m| f64::from(2 * m) * (exponent as f64).exp2()).collect();
            let encoded = encode(weights.clone(), 0);
            prop_assert_eq!(encoded.changed, 0);
            let power = (encoded.exponent as f64).exp2();
            let back: Vec<f64> = encoded.weights.iter().map(|w| w * power).collect();
            prop_assert_eq!(back, weights);
        }
    }
}
