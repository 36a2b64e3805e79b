//! Integers with the widths of the hardware's fields.
//!
//! Input: any integer. Output: a value that fits its field, or [`OutOfRange`] with the value and
//! the limits. The arithmetic on these values is in `nsim_dynamics`.

use std::fmt;

use serde::{Deserialize, Serialize};

/// A value that does not fit its field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{what} {value} is outside {low}..={high}")]
pub struct OutOfRange {
    /// The field's quantity, for messages ("decay", "threshold mantissa").
    pub what: &'static str,
    /// The value that was given.
    pub value: i64,
    /// The least value that fits.
    pub low: i64,
    /// The greatest value that fits.
    pub high: i64,
}

/// A field: its quantity, and the range of its values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// The quantity, for messages.
    pub what: &'static str,
    /// The least value.
    pub low: i64,
    /// The greatest value.
    pub high: i64,
}

impl Field {
    /// Returns the value, if it fits.
    ///
    /// # Errors
    /// [`OutOfRange`] outside the range.
    pub const fn check(self, value: i64) -> Result<i64, OutOfRange> {
        let Field { what, low, high } = self;
        if value < low || value > high { Err(OutOfRange { what, value, low, high }) } else { Ok(value) }
    }
}

/// Defines a newtype over an integer with a closed range.
macro_rules! ranged {
    ($(#[$doc:meta])* $name:ident($repr:ty) in $low:literal ..= $high:literal, $what:literal) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
        #[serde(try_from = "i64", into = "i64")]
        pub struct $name($repr);
        impl $name {
            /// The least value.
            pub const MIN: $name = $name($low);
            /// The greatest value.
            pub const MAX: $name = $name($high);
            /// The field's quantity and range.
            pub const FIELD: Field = Field { what: $what, low: $low, high: $high };

            /// Returns the value, if it fits.
            ///
            /// # Errors
            /// [`OutOfRange`] outside the field's range.
            pub const fn new(value: i64) -> Result<Self, OutOfRange> {
                match Self::FIELD.check(value) {
                    Ok(value) => Ok($name(value as $repr)),
                    Err(error) => Err(error),
                }
            }

            /// The plain integer.
            #[inline]
            pub const fn get(self) -> $repr {
                self.0
            }
        }
        impl TryFrom<i64> for $name {
            type Error = OutOfRange;
            fn try_from(value: i64) -> Result<Self, OutOfRange> {
                $name::new(value)
            }
        }
        impl From<$name> for i64 {
            fn from(field: $name) -> i64 {
                field.0.into()
            }
        }
        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }
        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }
    };
}

ranged!(
    /// Effective decay: the fraction lost in a step, in 4096ths; 4096 loses everything. The chip's
    /// register for `u` has one less, the one for `v` the value itself. slayerPytorch and lava
    /// agree once that is taken into account.
    Decay(u16) in 0..=4096, "decay"
);
ranged!(
    /// Threshold mantissa; the threshold is 64 times this (nengo-loihi `block.py`: 17 bits).
    ThresholdMantissa(u32) in 0..=131_071, "threshold mantissa"
);
ranged!(
    /// Bias mantissa, 13 bits signed (lava `proc/lif/models.py`).
    BiasMantissa(i16) in -4096..=4095, "bias mantissa"
);
ranged!(
    /// Bias exponent: the bias is `mantissa * 2^exponent`.
    BiasExponent(u8) in 0..=7, "bias exponent"
);
ranged!(
    /// Weight exponent of a synapse format: a weight `w` adds `w * 2^(6 + exponent)`.
    WeightExponent(i8) in -8..=7, "weight exponent"
);
ranged!(
    /// Synaptic delay field d: a spike of step t arrives in step t + 1 + d, an input's in t + d.
    Delay(u8) in 0..=62, "delay"
);
ranged!(
    /// Refractory period: a spike at t allows the next at t + period. 0 behaves as 1 in hardware
    /// semantics. The counter of a chip may be narrower.
    Refractory(u8) in 0..=255, "refractory period"
);
ranged!(
    /// Exponent e of the lower clip of `v`, which is -(2^e - 1); 23 uses the whole field.
    VminExponent(u8) in 0..=23, "vmin exponent"
);
ranged!(
    /// Exponent k of the upper clip of `v`, which is 2^(9 + 2k) - 1; 7 uses the whole field.
    VmaxExponent(u8) in 0..=7, "vmax exponent"
);
ranged!(
    /// Bits of a stored weight. 7 cannot be stored (nengo-loihi: register values mean 0..6 and 8
    /// bits).
    WeightBits(u8) in 1..=8, "weight bits"
);

ranged!(
    /// Payload of a graded spike, 24 bits signed; the spike adds the scaled weight times the
    /// payload.
    Payload(i32) in -8_388_608..=8_388_607, "payload"
);

ranged!(
    /// Bits of the integer in a message, its sign included.
    MessageBits(u8) in 1..=32, "message width in bits"
);

/// Bits of the dendritic accumulator without its sign (nengo-loihi: `Q_BITS`).
pub const Q_BITS: u32 = 21;
/// Bits of the current and voltage registers without their sign.
pub const UV_BITS: u32 = 23;
/// Left shift of a scaled weight whose exponent is 0.
pub const WEIGHT_SHIFT: u32 = 6;
/// Left shift of the threshold mantissa.
pub const THRESHOLD_SHIFT: u32 = 6;
/// One in the fixed-point format of a decay.
pub const DECAY_ONE: i64 = 4096;

/// Sign mode of a synapse format.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
pub enum SignMode {
    /// Weights of both signs; one bit is spent on the sign, so the least step of an 8-bit weight
    /// is 2.
    Mixed,
    /// Weights of 0 and above.
    Excitatory,
    /// Weights of 0 and below.
    Inhibitory,
}

impl WeightExponent {
    /// The exponent 0, which leaves weights unchanged.
    pub const ZERO: WeightExponent = WeightExponent(0);

    /// Divisor of the weights that lose no bits: 1 unless this exponent is negative.
    pub const fn lost(self) -> i16 {
        if self.0 < 0 { 1 << -self.0 } else { 1 }
    }
}

impl ThresholdMantissa {
    /// The least mantissa above zero.
    pub const ONE: ThresholdMantissa = ThresholdMantissa(1);
}

impl BiasMantissa {
    /// No bias.
    pub const ZERO: BiasMantissa = BiasMantissa(0);
}

impl Refractory {
    /// A spike may follow in the next step.
    pub const ONE: Refractory = Refractory(1);
}

impl SignMode {
    /// The mode that a file states; none for the mixed one, which the weights of its format choose.
    pub fn stated(self) -> Option<SignMode> {
        (self != SignMode::Mixed).then_some(self)
    }

    /// The least step between two weights: `2^(8 - (bits - mixed))` (`docs/semantics.md`, weights).
    pub const fn step(self, bits: WeightBits) -> i16 {
        let mixed = if matches!(self, SignMode::Mixed) { 1 } else { 0 };
        1 << (8 - (bits.0 - mixed))
    }

    /// The least and the greatest weight.
    pub const fn range(self, bits: WeightBits) -> (i16, i16) {
        let step = self.step(bits);
        match self {
            SignMode::Mixed => (-256, 256 - step),
            SignMode::Excitatory => (0, 256 - step),
            SignMode::Inhibitory => (step - 256, 0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_of_weights() {
        let bits = |b| WeightBits::new(b).unwrap();
        assert_eq!((SignMode::Mixed.step(bits(8)), SignMode::Mixed.range(bits(8))), (2, (-256, 254)));
        assert_eq!((SignMode::Excitatory.step(bits(8)), SignMode::Excitatory.range(bits(8))), (1, (0, 255)));
        assert_eq!((SignMode::Inhibitory.step(bits(4)), SignMode::Inhibitory.range(bits(4))), (16, (-240, 0)));
    }
}
