//! Equations (25) to (27), (33) and (34) of `docs/loihi2.md`.

use nsim_ir::neurons::ParameterRow;

use crate::lif::adapt;
use crate::outcome::{Outcome, sent, word};

/// A step of a resonate-and-fire neuron, of the kind with reset if `izhikevich`.
pub(crate) fn step(row: &ParameterRow, words: &mut [i64; 4], [real, imag]: [i64; 2], izhikevich: bool) -> Outcome {
    let ParameterRow([sin, cos, threshold, state_exp, decay_bits, ..]) = *row;
    let (sin, cos, threshold) = (i64::from(sin), i64::from(cos), i64::from(threshold));
    let (re, im) = (words[0], words[1]);
    // Each product is rounded separately, toward zero, by the division.
    let of = |factor: i64, x: i64| factor * x / (1 << decay_bits);
    let turned =
        [of(cos, re) - of(sin, im) + real * (1 << state_exp), of(sin, re) + of(cos, im) + imag * (1 << state_exp)];
    const MOST: i64 = (1 << 23) - 1;
    let [new_re, new_im] = turned.map(|x| x.clamp(-MOST, MOST));
    let spiked = if izhikevich { new_im >= threshold } else { new_re >= threshold && new_im >= 0 && im < 0 };
    (words[0], words[1]) = if izhikevich && spiked { (0, threshold - 1) } else { (new_re, new_im) };
    Outcome { spiked, v_clipped: [new_re, new_im] != turned, ..Outcome::default() }
}

/// A step of a resonator with an adaptive threshold: equation (33).
pub(crate) fn adaptive(row: &ParameterRow, words: &mut [i64; 4], [real, imag]: [i64; 2], izhikevich: bool) -> Outcome {
    let ParameterRow([sin, cos, dtheta, dr, threshold, step, state_exp, _]) = *row;
    let (re, im) = (words[0], words[1]);
    let of = |factor: i32, x: i64| i64::from(factor) * x / 4096;
    let mut u_wrapped = false;
    words[0] = word(of(cos, re) - of(sin, im) + real * (1 << state_exp), &mut u_wrapped);
    words[1] = word(of(sin, re) + of(cos, im) + imag * (1 << state_exp), &mut u_wrapped);
    let tested = match izhikevich {
        true => Some(words[1]),
        false => (words[1] >= 0 && im < 0).then_some(words[0]),
    };
    let spiked = adapt([dtheta, dr, threshold, step], words, tested, &mut u_wrapped);
    Outcome { spiked, u_wrapped, ..Outcome::default() }
}

/// A step of a resonator that sends its real part: equation (34).
pub(crate) fn zero(row: &ParameterRow, words: &mut [i64; 4], [real, imag]: [i64; 2]) -> Outcome {
    let ParameterRow([sin, cos, threshold, ..]) = *row;
    let (u, v) = (words[0], words[1]);
    let of = |factor: i32, x: i64| (i64::from(factor) * x).div_euclid(1 << 15);
    let mut wrapped = false;
    words[0] = word(of(cos, u) - of(sin, v) + real, &mut wrapped);
    words[1] = word(of(cos, v) + of(sin, u) + imag, &mut wrapped);
    let passes = words[0] > i64::from(threshold) && words[1] >= 0 && v < 0;
    sent(if passes { words[0] } else { 0 }, wrapped)
}
