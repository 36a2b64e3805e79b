//! How the numbers of a foreign file are stored: kind and bytes, little-endian.

use half::{bf16, f16};

/// A kind of number and its bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Element {
    /// Signed integers of 1, 2, 4 or 8 bytes.
    I(u8),
    /// Unsigned integers of 1, 2, 4 or 8 bytes.
    U(u8),
    /// IEEE 754 reals of 2, 4 or 8 bytes.
    F(u8),
    /// bfloat16.
    Bf16,
}

impl Element {
    /// Bytes of a number.
    pub(super) fn bytes(self) -> usize {
        match self {
            Element::I(size) | Element::U(size) | Element::F(size) => size.into(),
            Element::Bf16 => 2,
        }
    }

    /// The type as NumPy writes it, or `bf16`.
    pub(super) fn dtype(self) -> String {
        match self {
            Element::I(size) => format!("i{size}"),
            Element::U(size) => format!("u{size}"),
            Element::F(size) => format!("f{size}"),
            Element::Bf16 => "bf16".to_string(),
        }
    }

    /// The number in these bytes. Integers beyond 2^53 are rounded.
    pub(super) fn real(self, bytes: &[u8]) -> f64 {
        let mut wide = [0; 8];
        wide[..bytes.len()].copy_from_slice(bytes);
        let bits = u64::from_le_bytes(wide);
        match self {
            Element::U(_) => bits as f64,
            Element::I(size) => {
                let unused = 64 - 8 * u32::from(size);
                ((bits << unused) as i64 >> unused) as f64
            }
            Element::F(2) => f16::from_bits(bits as u16).to_f64(),
            Element::F(4) => f64::from(f32::from_bits(bits as u32)),
            Element::F(_) => f64::from_bits(bits),
            Element::Bf16 => bf16::from_bits(bits as u16).to_f64(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_of_number_is_widened_exactly() {
        for x in [0i64, 1, -1, 127, -128, 32_767, -32_768, i64::from(i32::MAX), i64::from(i32::MIN), 1 << 53] {
            for size in [1u8, 2, 4, 8] {
                let bytes = &x.to_le_bytes()[..size.into()];
                let unused = 64 - 8 * u32::from(size);
                assert_eq!(Element::I(size).real(bytes), (x << unused >> unused) as f64, "{x} in {size}");
                assert_eq!(Element::U(size).real(bytes), ((x as u64) << unused >> unused) as f64, "{x} in {size}");
            }
        }
        assert_eq!(Element::F(2).real(&0xc000u16.to_le_bytes()), -2.0);
        assert_eq!(Element::F(4).real(&0.1f32.to_le_bytes()), f64::from(0.1f32));
        assert_eq!(Element::F(8).real(&(-1e-300f64).to_le_bytes()), -1e-300);
        assert_eq!(Element::Bf16.real(&0xc040u16.to_le_bytes()), -3.0);
    }
}
