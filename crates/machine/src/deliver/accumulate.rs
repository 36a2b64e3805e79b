//! Contribution of a spike to a sum of arrivals: the weight, or weight times payload.
//!
//! Binary spikes are summed in 16 or 32 bits. Graded spikes are summed in 32 bits while payloads
//! are small enough, and in 64 afterwards: weight times payload has up to 47 bits. The payload is a
//! type, so that delivery of binary spikes has no multiplication and no look-up.

use crate::lanes::kernel::{LANES, Sum};

/// A sum to which spikes with this payload can add.
pub(crate) trait Accumulate<P>: Sum {
    /// Adds the contribution of a spike over a synapse of this weight.
    #[must_use]
    fn accumulate(self, weight: i16, payload: P) -> Self;
}

impl<S: Sum> Accumulate<()> for S {
    #[inline(always)]
    fn accumulate(self, weight: i16, (): ()) -> Self {
        self.plus(weight)
    }
}

/// For payloads with which no sum of a compartment leaves 32 bits.
impl Accumulate<i32> for i32 {
    #[inline(always)]
    fn accumulate(self, weight: i16, payload: i32) -> Self {
        self + i32::from(weight) * payload
    }
}

impl Accumulate<i32> for i64 {
    #[inline(always)]
    fn accumulate(self, weight: i16, payload: i32) -> Self {
        self + i64::from(weight) * i64::from(payload)
    }
}

/// Low bits of a sum, in units of 64, that reach the update: registers have at most 32.
const SEEN_BITS: u32 = 26;

/// For graded spikes whose payloads are large.
impl Sum for i64 {
    const WIDE: bool = true;

    #[inline(always)]
    fn plus(self, weight: i16) -> Self {
        self + i64::from(weight)
    }

    /// Replaces a sum that does not fit by one that fits and has an equal effect. Its low bits are
    /// equal, hence the registers. It is too large for any accumulator that wraps, hence the
    /// overflow is equal too.
    #[inline(always)]
    fn value(self) -> i32 {
        let low = self & ((1 << SEEN_BITS) - 1);
        i32::try_from(self).unwrap_or((low | 1 << 30) as i32)
    }

    #[inline(always)]
    fn shifted(self, bits: u8) -> (i32, bool) {
        let whole = self >> bits;
        (whole as i32, i64::from(whole as i32) != whole)
    }

    #[inline(always)]
    fn whole(self) -> i64 {
        self
    }
}

/// Adds N chunks of weights to N chunks of sums.
#[inline(always)]
pub(crate) fn add_weights<S: Accumulate<Y>, Y: Copy, const N: usize>(
    sums: &mut [[S; LANES]; N],
    weights: &[[i16; LANES]; N],
    payload: Y,
) {
    for chunk in 0..N {
        for lane in 0..LANES {
            sums[chunk][lane] = sums[chunk][lane].accumulate(weights[chunk][lane], payload);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_of_the_largest_weight_and_payload_are_exact() {
        let sum = (0..1_000).fold(0i64, |sum, _| sum.accumulate(i16::MIN, -(1 << 23)));
        assert_eq!(sum, 1_000 << 38);
    }

    #[test]
    fn sums_beyond_32_bits_keep_what_the_update_sees() {
        for sum in [0, 1, -1, i64::from(i32::MAX), i64::from(i32::MIN)] {
            assert_eq!(i64::from(sum.value()), sum);
        }
        for sum in [1 << 31, -(1 << 31) - 1, 0x1234_5678_9abc, -0x1234_5678_9abc, i64::MAX, i64::MIN] {
            let value = i64::from(sum.value());
            assert_eq!((value << 6) as i32, (sum << 6) as i32, "{sum}");
            // It leaves the 16 bits of the accumulator, as the sum does.
            assert_ne!(value, i64::from(value as i16), "{sum}");
        }
    }
}
