//! Sets of small numbers, a bit each.
//!
//! Comes in: words of bits. Goes out: which are set. Few are, and how many cannot be foretold: deciding bit by bit costs more
//! than the bits do.

/// The lowest `count` bits, all 64 from there on.
#[inline(always)]
pub(crate) fn ones(count: usize) -> u64 {
    if count >= 64 { u64::MAX } else { (1 << count) - 1 }
}

/// Room that [`write_ones`] needs after the last number: the first few are written whether they are or not.
pub(crate) const FORESEEN: usize = 4;

/// Writes `name` of each set bit's number, ascending, to places from `begin` on; returns where the next begins.
#[inline(always)]
pub(crate) fn write_ones<T>(places: &mut [T], begin: usize, mut bits: u64, name: impl Fn(u32) -> T) -> usize {
    let end = begin + bits.count_ones() as usize;
    for place in &mut places[begin..][..FORESEEN] {
        *place = name(bits.trailing_zeros());
        bits &= bits.wrapping_sub(1);
    }
    if bits != 0 {
        for place in &mut places[begin + FORESEEN..end] {
            *place = name(bits.trailing_zeros());
            bits &= bits - 1;
        }
    }
    end
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::rng;

    #[test]
    fn every_set_bit_is_written_once_and_in_order() {
        for seed in 0..200 {
            let words =
                [rng::bits(seed, 0, 0), rng::bits(seed, 1, 0) & rng::bits(seed, 2, 0), u64::MAX << (seed % 64), 0];
            let word = words[seed as usize % 4];
            let expected: Vec<u32> = (0..64).filter(|bit| word >> bit & 1 == 1).map(|bit| 100 + bit).collect();
            let mut places = vec![0; 3 + 64 + FORESEEN];
            let end = write_ones(&mut places, 3, word, |bit| bit.wrapping_add(100));
            assert_eq!((&places[..3], &places[3..end]), (&[0; 3][..], &expected[..]));
        }
    }

    #[test]
    fn the_lowest_bits_are_as_many_as_asked_for() {
        for count in 0..100 {
            assert_eq!(ones(count).trailing_ones() as usize, count.min(64));
            assert_eq!(ones(count).count_ones() as usize, count.min(64));
        }
    }
}
