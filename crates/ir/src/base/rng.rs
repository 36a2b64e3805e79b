//! Random numbers as a function of (seed, entity, step), so that threads share no sequence.
//!
//! The mixer is the finaliser of SplitMix64 (Steele, Lea, Flood: "Fast splittable pseudorandom
//! number generators", OOPSLA 2014), applied once for each argument. It is for stimuli and test
//! networks, not for cryptography.

/// SplitMix64's increment, the odd integer nearest to 2^64 divided by the golden ratio.
const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

#[inline]
const fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A bijection of 32 bits with little bias (Wellons: "Prospecting for hash functions", 2018, the
/// constants of `lowbias32`).
#[inline(always)]
pub const fn mix32(mut z: u32) -> u32 {
    z = (z ^ (z >> 16)).wrapping_mul(0x7feb_352d);
    z = (z ^ (z >> 15)).wrapping_mul(0x846c_a68b);
    z ^ (z >> 16)
}

/// The digest `so_far`, extended by one word.
#[inline]
pub const fn digest(so_far: u64, word: u64) -> u64 {
    mix((so_far ^ word).wrapping_add(GOLDEN))
}

/// 64 uniform bits for this (seed, entity, step).
#[inline]
pub const fn bits(seed: u64, entity: u64, step: u64) -> u64 {
    let z = mix(seed.wrapping_add(GOLDEN));
    digest(digest(z, entity), step)
}

/// A uniform integer in `0..n`, by the high half of a 128-bit product; the bias is below n / 2^64.
///
/// # Panics
/// When `n` is 0.
#[inline]
pub const fn below(n: u64, seed: u64, entity: u64, step: u64) -> u64 {
    assert!(n > 0);
    ((bits(seed, entity, step) as u128 * n as u128) >> 64) as u64
}

/// A uniform real in [0, 1) with 53 bits.
#[inline]
pub fn unit(seed: u64, entity: u64, step: u64) -> f64 {
    (bits(seed, entity, step) >> 11) as f64 / (1u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_function_is_fixed_for_ever() {
        // Stored results carry seeds: a change of these values would change every stored digest.
        assert_eq!([bits(0, 0, 0), bits(1, 2, 3)], [2_558_736_989_570_252_433, 15_020_427_595_393_229_491]);
        assert_ne!(bits(0, 0, 1), bits(0, 1, 0));
    }

    #[test]
    fn draws_are_even_over_entities_and_steps() {
        let mut counts = [0u32; 10];
        for entity in 0..100 {
            for step in 0..1000 {
                counts[below(10, 7, entity, step) as usize] += 1;
            }
        }
        // 100,000 samples in ten bins: sd 95, so 500 is more than five standard deviations.
        assert!(counts.iter().all(|&c| (9_500..10_500).contains(&c)), "{counts:?}");
    }
}
