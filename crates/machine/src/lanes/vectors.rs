//! Chunks of sixteen compartments in explicit AVX-512 instructions.
//!
//! Input and output: as for `kernel::Portable`, whose loops the compiler vectorises. It does so
//! well except for masks of lanes. AVX-512 has registers of one bit a lane for them, which the
//! compiler does not use for the loops' booleans. The test of the kernel compares both with the
//! update of a single compartment.

use pulp::cast;
use pulp::x86::V4;

use crate::lanes::kernel::{BlockParameters, Chunks, Effect, HOLD_BASE, LANES, Sum, Vectors};
use nsim_ir::base::fixed::{UV_BITS, WEIGHT_SHIFT};

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::{__m512, __m512i, _MM_FROUND_NO_EXC, _MM_FROUND_TO_ZERO};

/// A number in every lane.
#[inline(always)]
fn broadcast(simd: V4, x: i32) -> __m512i {
    simd.avx512f._mm512_set1_epi32(x)
}

/// Equation (3), as `kernel::kept`, of integers as floats. Floats represent the integers exactly,
/// as |x| <= 2^23. The product, rounded toward zero to 24 bits, keeps its integer part exactly, as
/// it is no greater than x.
#[inline(always)]
fn decayed(simd: V4, x: __m512, fraction: __m512) -> __m512i {
    let f = simd.avx512f;
    f._mm512_cvttps_epi32(f._mm512_mul_round_ps::<{ _MM_FROUND_TO_ZERO | _MM_FROUND_NO_EXC }>(x, fraction))
}

/// The truth table of a | b | c.
const ANY: i32 = 0xfe;

impl Vectors for V4 {
    #[inline(always)]
    fn update<S: Sum, const PLAIN: bool>(self, chunk: Chunks<'_, S, 1>, shared: &BlockParameters) -> Option<Effect> {
        self.update_n::<S, PLAIN, 1>(chunk, shared)
    }

    /// The loop over chunks is unrolled, so that no chunk waits for the previous one.
    #[inline(always)]
    fn update_n<S: Sum, const PLAIN: bool, const N: usize>(
        self,
        chunks: Chunks<'_, S, N>,
        shared: &BlockParameters,
    ) -> Option<Effect> {
        let Chunks { u: currents, v: voltages, sums, biases } = chunks;
        let f = self.avx512f;
        let zero = f._mm512_setzero_si512();
        let (fraction_u, fraction_v) = (f._mm512_set1_ps(shared.fraction_u), f._mm512_set1_ps(shared.fraction_v));
        let (mut next_u, mut next_v) = ([zero; N], [zero; N]);
        let (mut spiked, mut moved, mut clipped, mut remaining_state) = (0u64, 0u64, 0u64, zero);
        // Bits that no value within its field has, distances from vmin, lanes whose sum is too
        // wide.
        let (mut outside, mut highest, mut wrapped) = (zero, zero, 0);
        for i in 0..N {
            let arrived: [i32; LANES] = std::array::from_fn(|lane| sums[i][lane].value());
            let (sum, old_u, stored): (__m512i, __m512i, __m512i) =
                (cast(arrived), cast(currents[i]), cast(voltages[i]));
            let unheld = f._mm512_cmplt_epi32_mask(stored, broadcast(self, HOLD_BASE));
            let is_free = f._mm512_cmplt_epi32_mask(stored, broadcast(self, HOLD_BASE + 2));
            let q = match S::WIDE {
                true => f._mm512_srai_epi32::<10>(f._mm512_slli_epi32::<16>(sum)),
                false => f._mm512_slli_epi32::<WEIGHT_SHIFT>(sum),
            };
            // A float whose bits are all 0 is 0.
            let old_v = f._mm512_maskz_cvtepi32_ps(unheld, stored);
            let decayed_u = decayed(self, f._mm512_cvtepi32_ps(old_u), fraction_u);
            let decayed_v = decayed(self, old_v, fraction_v);
            let u = f._mm512_add_epi32(decayed_u, q);
            let mut input = u;
            outside = f._mm512_or_si512(outside, f._mm512_add_epi32(u, broadcast(self, 1 << UV_BITS)));
            let bias: __m512i = cast(biases[i]);
            if !PLAIN {
                input = f._mm512_add_epi32(u, bias);
                outside = f._mm512_or_si512(outside, f._mm512_add_epi32(input, broadcast(self, 1 << UV_BITS)));
            }
            let mut free = f._mm512_add_epi32(decayed_v, input);
            if !PLAIN {
                let vmin = broadcast(self, shared.vmin);
                clipped |= u64::from(f._mm512_mask_cmplt_epi32_mask(is_free, free, vmin)) << (LANES * i);
                free = f._mm512_max_epi32(free, vmin);
            }
            highest =
                f._mm512_max_epu32(highest, f._mm512_maskz_sub_epi32(is_free, free, broadcast(self, shared.vmin)));
            if S::WIDE {
                wrapped |= f._mm512_cmpneq_epi32_mask(f._mm512_srai_epi32::<WEIGHT_SHIFT>(q), sum);
            }
            let fires = f._mm512_mask_cmpge_epi32_mask(is_free, free, broadcast(self, shared.fires_from));
            let v = f._mm512_mask_mov_epi32(f._mm512_add_epi32(stored, broadcast(self, -1)), is_free, free);
            let v = f._mm512_mask_mov_epi32(v, fires, broadcast(self, HOLD_BASE + shared.refractory));
            let any = f._mm512_ternarylogic_epi32::<ANY>(old_u, cast(old_v), sum);
            let mut moves = f._mm512_test_epi32_mask(any, any) | !is_free;
            if !PLAIN {
                moves |= f._mm512_test_epi32_mask(bias, bias);
            }
            spiked |= u64::from(fires) << (LANES * i);
            moved |= u64::from(moves) << (LANES * i);
            remaining_state = f._mm512_ternarylogic_epi32::<ANY>(remaining_state, u, v);
            (next_u[i], next_v[i]) = (u, v);
        }
        wrapped |= f._mm512_test_epi32_mask(outside, broadcast(self, -1 << (UV_BITS + 1)));
        wrapped |= f._mm512_cmpgt_epu32_mask(highest, broadcast(self, shared.span));
        if wrapped != 0 {
            return None;
        }
        for i in 0..N {
            (currents[i], voltages[i], sums[i]) = (cast(next_u[i]), cast(next_v[i]), [S::default(); LANES]);
        }
        Some(Effect { spiked, moved, clipped, busy: f._mm512_test_epi32_mask(remaining_state, remaining_state) != 0 })
    }
}
