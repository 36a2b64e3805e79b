//! Element types of the arrays in files: kind of number and bytes.
//!
//! Input: bytes, in either order. Output: a [`Number`], or the [`Numbers`] of a whole array. A
//! model holds integers of the hardware's width and finite reals; others are refused with their
//! index.

use std::fmt::Display;

use half::{bf16, f16};

use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::tensor::Numbers;

/// An element type: kind of number and bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Element {
    /// Signed integers of 1, 2, 4 or 8 bytes.
    I(u8),
    /// Unsigned integers of 1, 2, 4 or 8 bytes.
    U(u8),
    /// IEEE 754 reals of 2, 4 or 8 bytes.
    F(u8),
    /// bfloat16.
    Bf16,
}

/// A number as it is stored.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Number {
    /// A whole number.
    Integer(i128),
    /// A real.
    Real(f64),
}

impl Element {
    /// Bytes of a number.
    pub fn bytes(self) -> usize {
        match self {
            Element::I(size) | Element::U(size) | Element::F(size) => size.into(),
            Element::Bf16 => 2,
        }
    }

    /// Whether its numbers are reals.
    pub fn is_real(self) -> bool {
        matches!(self, Element::F(_) | Element::Bf16)
    }

    /// The type as NumPy writes it, or `bf16`.
    pub fn dtype(self) -> String {
        match self {
            Element::I(size) => format!("i{size}"),
            Element::U(size) => format!("u{size}"),
            Element::F(size) => format!("f{size}"),
            Element::Bf16 => "bf16".to_string(),
        }
    }

    /// The number in these bytes, big-endian or little-endian.
    #[inline]
    pub fn number(self, bytes: &[u8], big: bool) -> Number {
        fn append(bits: u64, &byte: &u8) -> u64 {
            bits << 8 | u64::from(byte)
        }
        let bits = if big { bytes.iter().fold(0, append) } else { bytes.iter().rev().fold(0, append) };
        match self {
            Element::U(_) => Number::Integer(bits.into()),
            Element::I(size) => {
                let unused = 64 - 8 * u32::from(size);
                Number::Integer(((bits << unused) as i64 >> unused).into())
            }
            Element::F(2) => Number::Real(f16::from_bits(bits as u16).to_f64()),
            Element::F(4) => Number::Real(f32::from_bits(bits as u32).into()),
            Element::F(_) => Number::Real(f64::from_bits(bits)),
            Element::Bf16 => Number::Real(bf16::from_bits(bits as u16).to_f64()),
        }
    }

    /// All numbers of an array, in the order of the bytes.
    ///
    /// # Errors
    /// As [`Number::check`]; `wrong` is also given the index.
    pub(super) fn numbers(
        self,
        data: &[u8],
        big: bool,
        wrong: impl Fn(usize, &dyn Display, &str) -> Diagnostic,
    ) -> Result<Numbers> {
        let stored = data.chunks_exact(self.bytes()).map(|bytes| self.number(bytes, big));
        let checked = stored.enumerate().map(|(index, x)| x.check(|value, why| wrong(index, value, why)));
        Ok(match self.is_real() {
            true => Numbers::Reals(checked.map(|x| Ok(x?.real())).collect::<Result<_>>()?),
            false => Numbers::Integers(checked.map(|x| Ok(x?.integer())).collect::<Result<_>>()?),
        })
    }
}

impl Number {
    /// The number as a real. Integers beyond 2^53 are rounded.
    pub fn real(self) -> f64 {
        match self {
            Number::Integer(x) => x as f64,
            Number::Real(x) => x,
        }
    }

    /// The number as an integer of 32 bits, a range that [`Number::check`] ensures.
    fn integer(self) -> i32 {
        match self {
            Number::Integer(x) => x as i32,
            Number::Real(x) => x as i32,
        }
    }

    /// The number, if it is an integer of 32 bits or a finite real.
    ///
    /// # Errors
    /// The diagnostic that `wrong` makes of the number and the reason.
    #[inline]
    pub(super) fn check(self, wrong: impl FnOnce(&dyn Display, &str) -> Diagnostic) -> Result<Number> {
        match self {
            Number::Integer(x) if i32::try_from(x).is_err() => Err(wrong(&x, "outside the 32-bit integers")),
            Number::Real(x) if !x.is_finite() => Err(wrong(&x, "not a finite number")),
            number => Ok(number),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_of_number_is_widened_exactly() {
        let read = |element: Element, bytes: &[u8]| element.number(bytes, false).real();
        for x in [0i64, 1, -1, 127, -128, 32_767, -32_768, i64::from(i32::MAX), i64::from(i32::MIN), 1 << 53] {
            for size in [1u8, 2, 4, 8] {
                let bytes = &x.to_le_bytes()[..size.into()];
                let unused = 64 - 8 * u32::from(size);
                assert_eq!(read(Element::I(size), bytes), (x << unused >> unused) as f64, "{x} in {size}");
                assert_eq!(read(Element::U(size), bytes), ((x as u64) << unused >> unused) as f64, "{x} in {size}");
            }
        }
        assert_eq!(read(Element::F(2), &0xc000u16.to_le_bytes()), -2.0);
        assert_eq!(read(Element::F(4), &0.1f32.to_le_bytes()), f64::from(0.1f32));
        assert_eq!(read(Element::F(8), &(-1e-300f64).to_le_bytes()), -1e-300);
        for size in [1u8, 2, 4, 8] {
            let (one, bits) = ([1, 0, 0, 0, 0, 0, 0, 0], 8 * (u32::from(size) - 1));
            assert_eq!(Element::U(size).number(&one[..size.into()], true), Number::Integer(1 << bits), "big-endian");
        }
        assert_eq!(read(Element::Bf16, &0xc040u16.to_le_bytes()), -3.0);
    }
}
