//! A chunk of sixteen compartments in the instructions of AVX-512, named one by one.
//!
//! Comes in and goes out: as for [`Portable`], which says the same as loops that the compiler turns into vectors. It does so
//! well but for what is said of lanes, bits and flags: AVX-512 has registers of one bit a lane for them, which the loops'
//! booleans do not become. The test of the kernel runs both against the update of a single compartment.

use pulp::cast;
use pulp::x86::V4;

use crate::base::fixed::WEIGHT_SHIFT;
use crate::machine::kernel::{Chunk, Effect, HELD, LANES, Shared, Sum, Vectors};

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::__m512i;

/// A number in every lane.
#[inline(always)]
fn all(simd: V4, x: i32) -> __m512i {
    simd.avx512f._mm512_set1_epi32(x)
}

/// Equation (3), as `kernel::kept`: both factors fit 16 bits, and the multiplication of pairs of these is the cheapest.
#[inline(always)]
fn kept(simd: V4, x: __m512i, keep: __m512i) -> __m512i {
    let (f, bw) = (simd.avx512f, simd.avx512bw);
    let magnitude = f._mm512_abs_epi32(x);
    let high = bw._mm512_madd_epi16(f._mm512_srli_epi32::<12>(magnitude), keep);
    let low = bw._mm512_madd_epi16(f._mm512_and_si512(magnitude, all(simd, 0xfff)), keep);
    let kept = f._mm512_add_epi32(high, f._mm512_srli_epi32::<12>(low));
    let negative = simd.avx512dq._mm512_movepi32_mask(x);
    f._mm512_mask_sub_epi32(kept, negative, f._mm512_setzero_si512(), kept)
}

/// Two's complement of 23 bits and a sign.
#[inline(always)]
fn wrap24(simd: V4, x: __m512i) -> __m512i {
    simd.avx512f._mm512_srai_epi32::<8>(simd.avx512f._mm512_slli_epi32::<8>(x))
}

impl Vectors for V4 {
    #[inline(always)]
    fn update<S: Sum>(self, chunk: Chunk<'_, S>, shared: &Shared) -> Option<Effect> {
        let f = self.avx512f;
        let arrived: [i32; LANES] = std::array::from_fn(|lane| chunk.sums[lane].value());
        let (sum, old_u, stored): (__m512i, __m512i, __m512i) = (cast(arrived), cast(*chunk.u), cast(*chunk.v));
        let old_v = f._mm512_maskz_mov_epi32(f._mm512_cmplt_epi32_mask(stored, all(self, HELD)), stored);
        let is_free = f._mm512_cmplt_epi32_mask(stored, all(self, HELD + 2));
        let q = match S::WIDE {
            true => f._mm512_srai_epi32::<10>(f._mm512_slli_epi32::<16>(sum)),
            false => f._mm512_slli_epi32::<WEIGHT_SHIFT>(sum),
        };
        let current = f._mm512_add_epi32(kept(self, old_u, all(self, shared.keep_u)), q);
        let next_u = wrap24(self, current);
        let with_bias = f._mm512_add_epi32(next_u, all(self, shared.bias));
        let input = wrap24(self, with_bias);
        let free = f._mm512_add_epi32(kept(self, old_v, all(self, shared.keep_v)), input);
        let clipped = f._mm512_min_epi32(f._mm512_max_epi32(free, all(self, shared.vmin)), all(self, shared.vmax));
        let wrapped = match S::WIDE {
            true => f._mm512_cmpneq_epi32_mask(f._mm512_srai_epi32::<WEIGHT_SHIFT>(q), sum),
            false => 0,
        };
        let overflowed = wrapped
            | f._mm512_cmpneq_epi32_mask(next_u, current)
            | f._mm512_cmpneq_epi32_mask(input, with_bias)
            | f._mm512_mask_cmpneq_epi32_mask(is_free, clipped, free);
        if overflowed != 0 {
            return None;
        }
        let spiked = f._mm512_mask_cmpge_epi32_mask(is_free, clipped, all(self, shared.fires_from));
        let unheld = f._mm512_mask_mov_epi32(clipped, spiked, all(self, HELD + shared.refractory));
        let next_v = f._mm512_mask_mov_epi32(f._mm512_add_epi32(stored, all(self, -1)), is_free, unheld);
        let moved = f._mm512_or_si512(f._mm512_or_si512(old_u, old_v), f._mm512_or_si512(sum, all(self, shared.bias)));
        let moved = f._mm512_test_epi32_mask(moved, moved) | !is_free;
        let left = f._mm512_or_si512(next_u, next_v);
        (*chunk.u, *chunk.v, *chunk.sums) = (cast(next_u), cast(next_v), [S::default(); LANES]);
        Some(Effect { spiked, active: moved.count_ones(), busy: f._mm512_test_epi32_mask(left, left) != 0 })
    }
}
