//! Resonate-and-fire neurons: a state in the complex plane that decays and turns.
//!
//! Equations (25) to (27) of `docs/loihi2.md`. Source: lava-nc b6822fb, `proc/rf/models.py` and
//! `proc/rf_iz/models.py`; lava-dl d825ac5 computes the same
//! (`slayer/neuron/dynamics/resonator.py`).

use nsim_ir::base::fixed::UV_BITS;
use nsim_ir::neurons::Row;

use super::neuron::{Arrived, Emission, Left, Neuron, choice, columns, mask};

/// A resonator; with `IZ` it spikes above a threshold of the imaginary part.
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

    fn prepare(&Row([sin, cos, threshold, state_exp, decay_bits, ..]): &Row) -> Parameters {
        let unit = (1.0 / f32::from(1u16 << decay_bits)).to_bits() as i32;
        Parameters { sin, cos, threshold, state_exp, unit }
    }

    #[inline(always)]
    fn update(p: &Parameters, s: &mut State, [real, imag]: Arrived, left: &mut Left) -> Emission {
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
        let kept = whole.map(|x| x.clamp(-MOST, MOST));
        left.note_clip((kept[0] != whole[0]) | (kept[1] != whole[1]));
        let [re, im] = kept.map(|x| x as i32);
        let spikes = match IZ {
            true => im >= p.threshold,
            false => (re >= p.threshold) & (im >= 0) & (s.im < 0),
        };
        let resets = if IZ { mask(spikes) } else { 0 };
        *s = State { re: re & !resets, im: choice(resets, p.threshold - 1, im) };
        Emission::spike(spikes)
    }
}
