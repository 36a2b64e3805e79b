//! Leaky integrate-and-fire neurons that differ from Loihi 1's: two thresholds, a periodic reset,
//! or spikes that carry the voltage.
//!
//! Equations (28) to (31) of `docs/loihi2.md`. Source: lava-nc b6822fb, `proc/lif/models.py`;
//! lava-dl d825ac5, `slayer/neuron/dynamics/leaky_integrator.py` and `slayer/neuron/cuba.py`.

use nsim_ir::base::fixed::{THRESHOLD_SHIFT, UV_BITS, WEIGHT_SHIFT};
use nsim_ir::neurons::ParameterRow;

use super::neuron::{Arrived, Emission, Neuron, OverflowFlags, columns, decay, mask};

/// Sends 1 above the upper threshold and -1 below the lower.
#[derive(Debug)]
pub(super) struct TernaryLif;

/// Returns to zero in every `interval`th step.
#[derive(Debug)]
pub(super) struct LifReset;

/// Sends its voltage when it spikes.
#[derive(Debug)]
pub(super) struct GradedLif;

columns!(
    /// Current and voltage.
    State { u = 0, v = 1 }
);
columns!(
    /// Parameters of a [`TernaryLif`] in units of the state; `keep_*` are fractions in 4096ths.
    Ternary { keep_u = 0, keep_v = 1, high = 2, low = 3, bias = 4 }
);
columns!(
    /// Parameters of a [`LifReset`].
    Resetting { keep_u = 0, keep_v = 1, threshold = 2, bias = 3, interval = 4, remainder = 5 }
);
columns!(
    /// Parameters of a [`GradedLif`].
    Graded { keep_u = 0, keep_v = 1, threshold = 2 }
);

/// The greatest magnitude of a word of 24 bits, and the number of its values.
const MOST: i32 = (1 << UV_BITS) - 1;
const FULL: i32 = 2 << UV_BITS;

/// A bias; a negative exponent rounds it down.
pub(super) fn bias(mantissa: i32, exponent: i32) -> i32 {
    if exponent < 0 { mantissa >> -exponent } else { mantissa << exponent }
}

/// The current after a step, in lava's 24 bits: 2^24 is subtracted or added once.
#[inline(always)]
pub(super) fn current(u: i32, keep: i32, arrived: i32, overflows: &mut OverflowFlags) -> i32 {
    let sum = overflows.word(decay(u, keep) + (i64::from(arrived) << WEIGHT_SHIFT));
    let (above, below) = (mask(sum > MOST + 1), mask(sum < -MOST));
    overflows.note_wrap(above | below != 0);
    sum.wrapping_add((below & FULL) - (above & FULL))
}

/// The voltage after a step before any reset, clipped to 24 bits.
#[inline(always)]
pub(super) fn voltage(v: i32, keep: i32, u: i32, bias: i32, overflows: &mut OverflowFlags) -> i32 {
    let sum = overflows.word(decay(v, keep) + i64::from(u) + i64::from(bias));
    let clipped = sum.clamp(-MOST, MOST);
    overflows.note_clip(clipped != sum);
    clipped
}

impl Neuron for TernaryLif {
    type State = State;
    type Parameters = Ternary;

    fn prepare(&ParameterRow([du, dv, high, low, mantissa, exponent, ..]): &ParameterRow) -> Ternary {
        let [high, low] = [high, low].map(|mantissa| mantissa << THRESHOLD_SHIFT);
        Ternary { keep_u: 4096 - du, keep_v: 4096 - dv, high, low, bias: bias(mantissa, exponent) }
    }

    #[inline(always)]
    fn update(p: &Ternary, s: &mut State, [arrived, _]: Arrived, overflows: &mut OverflowFlags) -> Emission {
        s.u = current(s.u, p.keep_u, arrived, overflows);
        let v = voltage(s.v, p.keep_v, s.u, p.bias, overflows);
        let sign = i32::from(v > p.high) - i32::from(v < p.low);
        s.v = v & mask(sign == 0);
        Emission::value(sign)
    }
}

impl Neuron for LifReset {
    type State = State;
    type Parameters = Resetting;
    const VALUES: bool = false;
    const RESTARTS: bool = true;

    fn prepare(&ParameterRow([du, dv, vth, mantissa, exponent, interval, offset, _]): &ParameterRow) -> Resetting {
        Resetting {
            keep_u: 4096 - du,
            keep_v: 4096 - dv,
            threshold: vth << THRESHOLD_SHIFT,
            bias: bias(mantissa, exponent),
            interval,
            remainder: offset % interval,
        }
    }

    #[inline(always)]
    fn restart(p: &Resetting, s: &mut State, step: u32) {
        // lava counts steps from 1. The padding of a chunk has no interval.
        let resets = (step + 1) % (p.interval as u32).max(1) == p.remainder as u32;
        *s = State { u: s.u & !mask(resets), v: s.v & !mask(resets) };
    }

    #[inline(always)]
    fn update(p: &Resetting, s: &mut State, [arrived, _]: Arrived, overflows: &mut OverflowFlags) -> Emission {
        s.u = current(s.u, p.keep_u, arrived, overflows);
        let v = voltage(s.v, p.keep_v, s.u, p.bias, overflows);
        let spikes = v > p.threshold;
        s.v = v & !mask(spikes);
        Emission::spike(spikes)
    }

    /// Whether an update changes nothing, both with and without a reset before it.
    #[inline(always)]
    fn idle(p: &Resetting, s: &State) -> bool {
        let after = |mut state: State| {
            let mut overflows = OverflowFlags::default();
            let Emission { sends, .. } = Self::update(p, &mut state, [0; 2], &mut overflows);
            (sends == 0) & (state == *s) & !overflows.any()
        };
        after(*s) & after(State::default())
    }
}

impl Neuron for GradedLif {
    type State = State;
    type Parameters = Graded;

    fn prepare(&ParameterRow([du, dv, vth, ..]): &ParameterRow) -> Graded {
        Graded { keep_u: 4096 - du, keep_v: 4096 - dv, threshold: vth << THRESHOLD_SHIFT }
    }

    #[inline(always)]
    fn update(p: &Graded, s: &mut State, [arrived, _]: Arrived, overflows: &mut OverflowFlags) -> Emission {
        s.u = overflows.word(decay(s.u, p.keep_u) + (i64::from(arrived) << WEIGHT_SHIFT));
        let v = overflows.word(decay(s.v, p.keep_v) + i64::from(s.u));
        let spikes = mask(v > p.threshold);
        s.v = v & !spikes;
        Emission::value(v & spikes)
    }
}
