//! The operations by which the hardware scales and narrows integers.
//!
//! Each is named after its effect at the edge: [`wrap`] (two's complement), [`clip`] (saturate),
//! [`decay`] (multiply and round toward zero). Equation numbers refer to `docs/semantics.md`.

use crate::learning::GREATEST_WEIGHT;
use nsim_ir::base::fixed::{DECAY_ONE, Decay, WEIGHT_SHIFT, WeightExponent};
use nsim_ir::program::{CoreFormat, Synapse};
use nsim_ir::quantised::Reset;
use nsim_ir::quantised::connectivity::SynapseFormat;

/// Two's complement wrap of `x` to `bits` bits and a sign: the result is in `-2^bits..2^bits`.
#[inline]
pub const fn wrap(x: i64, bits: u32) -> i64 {
    let shift = 63 - bits;
    (x << shift) >> shift
}

/// `x` clipped to `low..=high`.
#[inline]
pub const fn clip(x: i64, low: i64, high: i64) -> i64 {
    if x < low {
        low
    } else if x > high {
        high
    } else {
        x
    }
}

/// Equation (3): `sign(x) * ((|x| * (4096 - d)) >> 12)`, which rounds toward zero. Exact for any
/// 32-bit `x`. Source: recorded chip voltages (slayerPytorch `test/test_files/Loihi`), 0
/// differences over four traces.
#[inline]
pub const fn decay(x: i64, d: Decay) -> i64 {
    let decayed = (x.abs() * (DECAY_ONE - d.get() as i64)) >> 12;
    if x < 0 { -decayed } else { decayed }
}

/// Equation (1): the contribution of one spike over a synapse of weight `w` to the accumulator,
/// `w * 2^(6 + exponent)`. For a negative exponent each weight is rounded toward zero to a multiple
/// of 64 (nengo-loihi `discretize.py`).
#[inline]
pub const fn scaled_weight(w: i16, exponent: WeightExponent) -> i32 {
    let e = exponent.get();
    let w = w as i32;
    if e >= 0 {
        w << (WEIGHT_SHIFT + e as u32)
    } else {
        // |w| <= 256, so |w| * 64 fits. Shift and mask act on the magnitude, hence toward zero.
        let magnitude = ((w.abs() << WEIGHT_SHIFT) >> (-e) as u32) & !63;
        if w < 0 { -magnitude } else { magnitude }
    }
}

/// Equation (1): the contribution of a spike over a weight of this format to the accumulator. A
/// negative exponent of a separate sum shifts the sum ([`sum_shift`]).
#[inline]
pub fn scaled(format: SynapseFormat, weight: i16) -> i32 {
    let exponent = if format.apart.is_some() { format.exponent.max(WeightExponent::ZERO) } else { format.exponent };
    scaled_weight(weight, exponent)
}

/// Rule (39) of `docs/loihi2.md`: the shift of the sum of a format's synapses, in bits.
#[inline]
pub fn sum_shift(format: SynapseFormat) -> u8 {
    format.apart.map_or(0, |_| format.exponent.min(WeightExponent::ZERO).get().unsigned_abs())
}

/// The contribution of a binary spike over a synapse, in units of 64, on a core with these formats.
/// It fits 16 bits: |w| <= 256 and the exponent is at most 7.
#[inline]
pub fn units(synapse: &Synapse, formats: &[CoreFormat]) -> i32 {
    scaled(formats[usize::from(synapse.format)].synapse, synapse.weight) >> WEIGHT_SHIFT
}

/// The greatest magnitude of a binary spike's contribution over a synapse, in units of 64. A
/// plastic synapse may hold any weight that its rule reaches.
#[inline]
pub fn greatest_units(synapse: &Synapse, formats: &[CoreFormat]) -> u32 {
    let format = formats[usize::from(synapse.format)].synapse;
    if !format.is_plastic() {
        return units(synapse, formats).unsigned_abs();
    }
    // A rule may leave the format's width: (L6).
    (scaled(format, -GREATEST_WEIGHT) >> WEIGHT_SHIFT).unsigned_abs()
}

/// Whether a population with this start step returns to zero before the update of `step`.
#[inline]
pub fn falls_on(reset: Reset, step: u32, start_step: u32) -> bool {
    match step.checked_sub(start_step.saturating_add(reset.offset)) {
        Some(since) => since % reset.interval == 0,
        None => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrap_is_two_s_complement() {
        assert_eq!(wrap(1 << 21, 21), -(1 << 21));
        assert_eq!(wrap((1 << 21) - 1, 21), (1 << 21) - 1);
        assert_eq!(wrap(-(1 << 21) - 1, 21), (1 << 21) - 1);
        for x in -70_000i64..70_000 {
            assert_eq!(wrap(x, 15), (x + 32_768).rem_euclid(65_536) - 32_768);
        }
    }

    #[test]
    fn decay_rounds_toward_zero_for_every_decay() {
        for d in 0..=4096 {
            let field = Decay::new(d).unwrap();
            for x in [0i64, 1, 2, 63, 64, 4095, 4096, 4097, 8_388_607, 8_388_608] {
                let exact = (i128::from(x) * i128::from(4096 - d)) / 4096;
                assert_eq!(i128::from(decay(x, field)), exact);
                assert_eq!(i128::from(decay(-x, field)), -exact);
            }
        }
    }

    #[test]
    fn scaled_weights_of_negative_exponents_lose_their_low_bits_toward_zero() {
        for w in -256i16..=255 {
            for e in -8..=7 {
                let real = f64::from(w) * 2f64.powi(6 + e);
                let expected = if e < 0 { (real / 64.0).trunc() * 64.0 } else { real };
                assert_eq!(f64::from(scaled_weight(w, WeightExponent::new(e.into()).unwrap())), expected, "{w} {e}");
            }
        }
    }
}
