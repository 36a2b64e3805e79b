//! The two 16-bit floating-point formats that array files use, widened to `f64` exactly.

/// IEEE 754 binary16: 1 sign, 5 exponent, 10 fraction bits.
#[must_use]
pub fn binary16(bits: u16) -> f64 {
    let sign = if bits >> 15 == 1 { -1.0 } else { 1.0 };
    let exponent = i32::from(bits >> 10 & 0x1f);
    let fraction = f64::from(bits & 0x3ff);
    sign * match exponent {
        0 => fraction * 2f64.powi(-24),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        _ => (1024.0 + fraction) * 2f64.powi(exponent - 25),
    }
}

/// bfloat16: the upper half of a binary32.
#[must_use]
pub fn bfloat16(bits: u16) -> f64 {
    f64::from(f32::from_bits(u32::from(bits) << 16))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_values() {
        // IEEE 754-2019 table 3.5 parameters: least subnormal 2^-24, least normal 2^-14, greatest 65504.
        let pairs = [(0x3c00, 1.0), (0xc000, -2.0), (0x7bff, 65504.0), (0x0400, 2f64.powi(-14)), (1, 2f64.powi(-24))];
        for (bits, value) in pairs {
            assert_eq!(binary16(bits), value, "{bits:04x}");
        }
        assert!(binary16(0x7e00).is_nan() && binary16(0xfc00) == f64::NEG_INFINITY);
        assert!(binary16(0x8000).is_sign_negative());
        assert_eq!((bfloat16(0x3f80), bfloat16(0xc040)), (1.0, -3.0));
    }
}
