//! Resonate-and-fire neurons: a state in the complex plane that decays and rotates.
//!
//! Equations (25) to (27), (33) and (34) of `docs/loihi2.md`. Source: lava-nc b6822fb,
//! `proc/rf/models.py`, `proc/rf_iz/models.py` and `proc/resfire/models.py`. lava-dl d825ac5
//! computes identical results, and has adaptive thresholds (`slayer/neuron/dynamics/resonator.py`,
//! `adaptive_phase_th.py`, `adaptive_resonator.py`).

use nsim_ir::base::fixed::UV_BITS;
use nsim_ir::neurons::ParameterRow;

use super::adaptive::Adaptation;
use super::neuron::{Arrived, Emission, Neuron, OverflowFlags, choice, columns, mask};

/// A resonator; with `IZ` it spikes where the imaginary part reaches the threshold.
#[derive(Debug)]
pub(super) struct Resonator<const IZ: bool>;

columns!(
    /// Real and imaginary part.
    State { re = 0, im = 1 }
);
columns!(
    /// Parameters of a [`Resonator`]; `unit` has the bits of 2^-decay_bits as a float.
    Parameters { sin = 0, cos = 1, threshold = 2, state_exp = 3, unit = 4 }
);

impl<const IZ: bool> Neuron for Resonator<IZ> {
    type State = State;
    type Parameters = Parameters;
    const VALUES: bool = false;

    fn prepare(&ParameterRow([sin, cos, threshold, state_exp, decay_bits, ..]): &ParameterRow) -> Parameters {
        let unit = (1.0 / f32::from(1u16 << decay_bits)).to_bits() as i32;
        Parameters { sin, cos, threshold, state_exp, unit }
    }

    #[inline(always)]
    fn update(p: &Parameters, s: &mut State, [real, imag]: Arrived, overflows: &mut OverflowFlags) -> Emission {
        // A float of 53 bits holds every product (16 and 24 bits) and every sum exactly.
        let unit = f64::from(f32::from_bits(p.unit as u32));
        let (re, im) = (f64::from(s.re), f64::from(s.im));
        let (sin, cos) = (f64::from(p.sin) * unit, f64::from(p.cos) * unit);
        let arrived = |x: i32| f64::from(x) * f64::from(1 << p.state_exp);
        let whole = [
            (cos * re).trunc() - (sin * im).trunc() + arrived(real),
            (sin * re).trunc() + (cos * im).trunc() + arrived(imag),
        ];
        const MOST: f64 = ((1 << UV_BITS) - 1) as f64;
        let clamped = whole.map(|x| x.clamp(-MOST, MOST));
        overflows.note_clip((clamped[0] != whole[0]) | (clamped[1] != whole[1]));
        let [re, im] = clamped.map(|x| x as i32);
        let spikes = match IZ {
            true => im >= p.threshold,
            false => (re >= p.threshold) & (im >= 0) & (s.im < 0),
        };
        let resets = if IZ { mask(spikes) } else { 0 };
        *s = State { re: re & !resets, im: choice(resets, p.threshold - 1, im) };
        Emission::spike(spikes)
    }
}

/// A resonator with an adaptive threshold; with `IZ` it tests the imaginary part.
#[derive(Debug)]
pub(super) struct Adaptive<const IZ: bool>;

columns!(
    /// Real and imaginary part, threshold and refractory state.
    AdaptiveState { re = 0, im = 1, theta = 2, r = 3 }
);
columns!(
    /// Parameters of an [`Adaptive`] resonator.
    AdaptiveParameters { sin = 0, cos = 1, keep_theta = 2, keep_r = 3, threshold = 4, step = 5, state_exp = 6 }
);

/// Returns a word times a factor in 4096ths, of at most 1, rounded toward zero.
#[inline(always)]
fn share(factor: i32, x: i32) -> i64 {
    let size = ((u64::from(x.unsigned_abs()) * u64::from(factor.unsigned_abs())) >> 12) as i64;
    if (x ^ factor) < 0 { -size } else { size }
}

impl<const IZ: bool> Neuron for Adaptive<IZ> {
    type State = AdaptiveState;
    type Parameters = AdaptiveParameters;
    const VALUES: bool = false;

    fn prepare(
        &ParameterRow([sin, cos, dtheta, dr, threshold, step, state_exp, _]): &ParameterRow,
    ) -> AdaptiveParameters {
        AdaptiveParameters { sin, cos, keep_theta: 4096 - dtheta, keep_r: 4096 - dr, threshold, step, state_exp }
    }

    #[inline(always)]
    fn first(p: &AdaptiveParameters) -> AdaptiveState {
        AdaptiveState { theta: p.threshold, ..AdaptiveState::default() }
    }

    #[inline(always)]
    fn update(
        p: &AdaptiveParameters,
        s: &mut AdaptiveState,
        [real, imag]: Arrived,
        overflows: &mut OverflowFlags,
    ) -> Emission {
        let arrived = |x: i32| i64::from(x) << p.state_exp;
        let re = overflows.word(share(p.cos, s.re) - share(p.sin, s.im) + arrived(real));
        let im = overflows.word(share(p.sin, s.re) + share(p.cos, s.im) + arrived(imag));
        let &AdaptiveParameters { keep_theta, keep_r, threshold, step, .. } = p;
        let adaptation = Adaptation { keep_theta, keep_r, threshold, step };
        let passes = IZ | (im >= 0) & (s.im < 0);
        let tested = if IZ { im } else { re };
        let ([theta, r], spikes) = adaptation.adapt([s.theta, s.r], tested, passes, overflows);
        *s = AdaptiveState { re, im, theta, r };
        Emission::spike(spikes)
    }
}

/// A resonator that sends its real part as it passes the real axis.
#[derive(Debug)]
pub(super) struct RfZero;

columns!(
    /// Real and imaginary part.
    Parts { u = 0, v = 1 }
);
columns!(
    /// Parameters of an [`RfZero`].
    ZeroParameters { sin = 0, cos = 1, threshold = 2 }
);

impl Neuron for RfZero {
    type State = Parts;
    type Parameters = ZeroParameters;

    fn prepare(&ParameterRow([sin, cos, threshold, ..]): &ParameterRow) -> ZeroParameters {
        ZeroParameters { sin, cos, threshold }
    }

    #[inline(always)]
    fn update(p: &ZeroParameters, s: &mut Parts, [real, imag]: Arrived, overflows: &mut OverflowFlags) -> Emission {
        fn floor(factor: i32, x: i32) -> i64 {
            (i64::from(factor) * i64::from(x)) >> 15
        }
        let u = overflows.word(floor(p.cos, s.u) - floor(p.sin, s.v) + i64::from(real));
        let v = overflows.word(floor(p.cos, s.v) + floor(p.sin, s.u) + i64::from(imag));
        let sends = (u > p.threshold) & (v >= 0) & (s.v < 0);
        *s = Parts { u, v };
        Emission::value(u & mask(sends))
    }
}
