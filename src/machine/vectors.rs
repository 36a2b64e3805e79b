//! A chunk of sixteen compartments in the instructions of AVX-512, named one by one.
//!
//! Comes in and goes out: as for [`Portable`], which says the same as loops that the compiler turns into vectors. It does so
//! well but for what is said of lanes, bits and flags: AVX-512 has registers of one bit a lane for them, which the loops'
//! booleans do not become. The test of the kernel runs both against the update of a single compartment.

use pulp::cast;
use pulp::x86::V4;

use crate::base::fixed::{UV_BITS, WEIGHT_SHIFT};
use crate::machine::kernel::{Chunk, Effect, HELD, LANES, Shared, Sum, Vectors};

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::{__m512i, __mmask16};

/// A number in every lane.
#[inline(always)]
fn all(simd: V4, x: i32) -> __m512i {
    simd.avx512f._mm512_set1_epi32(x)
}

/// Equation (3), as `kernel::kept`, with a factor below 1 in units of 2^-32: lanes of even and of odd number are multiplied
/// apart, and what is kept is the upper half of each product.
#[inline(always)]
fn kept(simd: V4, x: __m512i, factor: i32) -> __m512i {
    const UPPER_DOWN: i32 = 0b11_11_01_01;
    const EVEN: __mmask16 = 0x5555;
    let f = simd.avx512f;
    let (magnitude, factor) = (f._mm512_abs_epi32(x), all(simd, factor));
    let even = f._mm512_mul_epu32(magnitude, factor);
    let odd = f._mm512_mul_epu32(f._mm512_srli_epi64::<32>(magnitude), factor);
    let kept = f._mm512_mask_shuffle_epi32::<UPPER_DOWN>(odd, EVEN, even);
    let negative = simd.avx512dq._mm512_movepi32_mask(x);
    f._mm512_mask_sub_epi32(kept, negative, f._mm512_setzero_si512(), kept)
}

/// Lanes whose value does not fit 23 bits and a sign.
#[inline(always)]
fn outside(simd: V4, x: __m512i) -> __mmask16 {
    let f = simd.avx512f;
    f._mm512_test_epi32_mask(f._mm512_add_epi32(x, all(simd, 1 << UV_BITS)), all(simd, -1 << (UV_BITS + 1)))
}

impl Vectors for V4 {
    #[inline(always)]
    fn update<S: Sum, const PLAIN: bool>(self, chunk: Chunk<'_, S>, shared: &Shared) -> Option<Effect> {
        let f = self.avx512f;
        let arrived: [i32; LANES] = std::array::from_fn(|lane| chunk.sums[lane].value());
        let (sum, old_u, stored): (__m512i, __m512i, __m512i) = (cast(arrived), cast(*chunk.u), cast(*chunk.v));
        let old_v = f._mm512_maskz_mov_epi32(f._mm512_cmplt_epi32_mask(stored, all(self, HELD)), stored);
        let is_free = f._mm512_cmplt_epi32_mask(stored, all(self, HELD + 2));
        let q = match S::WIDE {
            true => f._mm512_srai_epi32::<10>(f._mm512_slli_epi32::<16>(sum)),
            false => f._mm512_slli_epi32::<WEIGHT_SHIFT>(sum),
        };
        let (mut kept_u, mut kept_v) = (kept(self, old_u, shared.factor_u), kept(self, old_v, shared.factor_v));
        if !PLAIN {
            kept_u = f._mm512_mask_mov_epi32(kept_u, shared.whole_u, old_u);
            kept_v = f._mm512_mask_mov_epi32(kept_v, shared.whole_v, old_v);
        }
        let next_u = f._mm512_add_epi32(kept_u, q);
        let (mut input, mut overflowed) = (next_u, outside(self, next_u));
        if !PLAIN {
            input = f._mm512_add_epi32(next_u, all(self, shared.bias));
            overflowed |= outside(self, input);
        }
        let free = f._mm512_add_epi32(kept_v, input);
        let above_vmin = f._mm512_sub_epi32(free, all(self, shared.vmin));
        overflowed |= f._mm512_mask_cmpgt_epu32_mask(is_free, above_vmin, all(self, shared.span));
        if S::WIDE {
            overflowed |= f._mm512_cmpneq_epi32_mask(f._mm512_srai_epi32::<WEIGHT_SHIFT>(q), sum);
        }
        if overflowed != 0 {
            return None;
        }
        let spiked = f._mm512_mask_cmpge_epi32_mask(is_free, free, all(self, shared.fires_from));
        let unheld = f._mm512_mask_mov_epi32(free, spiked, all(self, HELD + shared.refractory));
        let next_v = f._mm512_mask_mov_epi32(f._mm512_add_epi32(stored, all(self, -1)), is_free, unheld);
        // The truth table of a | b | c.
        const ANY: i32 = 0xfe;
        let moved = f._mm512_ternarylogic_epi32::<ANY>(old_u, old_v, sum);
        let biased = if PLAIN || shared.bias == 0 { 0 } else { __mmask16::MAX };
        let moved = f._mm512_test_epi32_mask(moved, moved) | !is_free | biased;
        let left = f._mm512_or_si512(next_u, next_v);
        (*chunk.u, *chunk.v, *chunk.sums) = (cast(next_u), cast(next_v), [S::default(); LANES]);
        Some(Effect { spiked, moved, busy: f._mm512_test_epi32_mask(left, left) != 0 })
    }
}
