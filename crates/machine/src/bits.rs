//! Bit sets.
//!
//! Input: words of bits. Output: the numbers of the set bits. Sets are sparse and the population
//! count is unpredictable, so avoid a branch per bit.

/// A word whose lowest `count` bits are set, all 64 from 64 on.
#[inline(always)]
pub(crate) fn ones(count: usize) -> u64 {
    if count >= 64 { u64::MAX } else { (1 << count) - 1 }
}

/// Numbers that [`write_ones`] writes without testing for set bits. The buffer needs this much room
/// after the last number.
pub(crate) const UNCHECKED_ONES: usize = 4;

/// Writes `name` of each set bit's number, ascending, from `places[begin]` on; returns the index
/// after the last.
#[inline(always)]
pub(crate) fn write_ones<T>(places: &mut [T], begin: usize, mut bits: u64, name: impl Fn(u32) -> T) -> usize {
    let end = begin + bits.count_ones() as usize;
    for place in &mut places[begin..][..UNCHECKED_ONES] {
        *place = name(bits.trailing_zeros());
        bits &= bits.wrapping_sub(1);
    }
    if bits != 0 {
        for place in &mut places[begin + UNCHECKED_ONES..end] {
            *place = name(bits.trailing_zeros());
            bits &= bits - 1;
        }
    }
    end
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::base::rng;

    #[test]
    fn every_set_bit_is_written_once_and_in_order() {
        for seed in 0..200 {
            let words =
                [rng::bits(seed, 0, 0), rng::bits(seed, 1, 0) & rng::bits(seed, 2, 0), u64::MAX << (seed % 64), 0];
            let word = words[seed as usize % 4];
            let expected: Vec<u32> = (0..64).filter(|bit| word >> bit & 1 == 1).map(|bit| 100 + bit).collect();
            let mut places = vec![0; 3 + 64 + UNCHECKED_ONES];
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
