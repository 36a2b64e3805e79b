//! Equations (25) to (27) of `docs/loihi2.md`.

use nsim_ir::neurons::Row;

use crate::outcome::Outcome;

/// A step of a resonate-and-fire neuron, of the kind with reset if `izhikevich`.
pub(crate) fn step(row: &Row, words: &mut [i64; 4], [real, imag]: [i64; 2], izhikevich: bool) -> Outcome {
    let Row([sin, cos, threshold, state_exp, decay_bits, ..]) = *row;
    let (sin, cos, threshold) = (i64::from(sin), i64::from(cos), i64::from(threshold));
    let (re, im) = (words[0], words[1]);
    // Each product is rounded by itself, toward zero, as division does.
    let of = |factor: i64, x: i64| factor * x / (1 << decay_bits);
    let turned =
        [of(cos, re) - of(sin, im) + real * (1 << state_exp), of(sin, re) + of(cos, im) + imag * (1 << state_exp)];
    const MOST: i64 = (1 << 23) - 1;
    let [new_re, new_im] = turned.map(|x| x.clamp(-MOST, MOST));
    let spiked = if izhikevich { new_im >= threshold } else { new_re >= threshold && new_im >= 0 && im < 0 };
    (words[0], words[1]) = if izhikevich && spiked { (0, threshold - 1) } else { (new_re, new_im) };
    Outcome { spiked, v_clipped: [new_re, new_im] != turned, ..Outcome::default() }
}
