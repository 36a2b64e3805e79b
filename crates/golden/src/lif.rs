//! Equations (28) to (32) of `docs/loihi2.md`.

use nsim_ir::neurons::ParameterRow;

use crate::outcome::{Outcome, decay, sent, word};

/// Equation (28): current and voltage of lava's processes before a test, in `words[0]` and
/// `words[1]`. Returns whether the current wrapped and the voltage was clipped.
fn integrate(words: &mut [i64; 4], [du, dv]: [i32; 2], [mantissa, exponent]: [i32; 2], arrived: i64) -> [bool; 2] {
    const HALF: i64 = 1 << 23;
    let mut wrapped = false;
    let bias = match exponent {
        0.. => i64::from(mantissa) * (1 << exponent),
        _ => i64::from(mantissa).div_euclid(1 << -exponent),
    };
    let current = word(decay(words[0], du) + 64 * arrived, &mut wrapped);
    words[0] = match current {
        u if u > HALF => u - 2 * HALF,
        u if u <= -HALF => u + 2 * HALF,
        u => u,
    };
    wrapped |= words[0] != current;
    let voltage = word(decay(words[1], dv) + words[0] + bias, &mut wrapped);
    words[1] = voltage.clamp(1 - HALF, HALF - 1);
    [wrapped, words[1] != voltage]
}

/// A step of a LIF neuron with two thresholds: equation (29).
pub(crate) fn ternary(row: &ParameterRow, words: &mut [i64; 4], arrived: i64) -> Outcome {
    let ParameterRow([du, dv, high, low, mantissa, exponent, ..]) = *row;
    let [u_wrapped, v_clipped] = integrate(words, [du, dv], [mantissa, exponent], arrived);
    let sign = i64::from(words[1] > 64 * i64::from(high)) - i64::from(words[1] < 64 * i64::from(low));
    if sign != 0 {
        words[1] = 0;
    }
    Outcome { v_clipped, ..sent(sign, u_wrapped) }
}

/// Equation (30): whether this step of a LIF neuron with a reset begins at zero. lava counts steps
/// from 1.
pub(crate) fn resets(row: &ParameterRow, step: u32) -> bool {
    let ParameterRow([.., interval, offset, _]) = *row;
    (i64::from(step) + 1 - i64::from(offset)) % i64::from(interval) == 0
}

/// A step of a LIF neuron, after its reset.
pub(crate) fn resetting(row: &ParameterRow, words: &mut [i64; 4], arrived: i64) -> Outcome {
    let ParameterRow([du, dv, vth, mantissa, exponent, ..]) = *row;
    let [u_wrapped, v_clipped] = integrate(words, [du, dv], [mantissa, exponent], arrived);
    let spiked = words[1] > 64 * i64::from(vth);
    if spiked {
        words[1] = 0;
    }
    Outcome { spiked, u_wrapped, v_clipped, ..Outcome::default() }
}

/// Current and voltage of lava-dl's neurons before a test. Returns whether a word wrapped.
fn integrate_wide(words: &mut [i64; 4], [du, dv]: [i32; 2], arrived: i64) -> bool {
    let mut wrapped = false;
    words[0] = word(decay(words[0], du) + 64 * arrived, &mut wrapped);
    words[1] = word(decay(words[1], dv) + words[0], &mut wrapped);
    wrapped
}

/// A step of a LIF neuron that sends its voltage: equation (31).
pub(crate) fn graded(row: &ParameterRow, words: &mut [i64; 4], arrived: i64) -> Outcome {
    let ParameterRow([du, dv, vth, ..]) = *row;
    let wrapped = integrate_wide(words, [du, dv], arrived);
    if words[1] <= 64 * i64::from(vth) {
        return sent(0, wrapped);
    }
    sent(std::mem::take(&mut words[1]), wrapped)
}

/// Equation (32): the adaptive threshold, in `words[2]` and `words[3]`. Returns whether `tested`
/// reaches it.
pub(crate) fn adapt(
    [dtheta, dr, rest, step]: [i32; 4],
    words: &mut [i64; 4],
    tested: Option<i64>,
    wrapped: &mut bool,
) -> bool {
    let rest = i64::from(rest);
    words[2] = word(decay(word(words[2] - rest, wrapped), dtheta) + rest, wrapped);
    words[3] = decay(words[3], dr);
    let spiked = tested.is_some_and(|tested| tested - words[3] >= words[2]);
    if spiked {
        words[3] = word(words[3] + word(2 * words[2], wrapped), wrapped);
        words[2] = word(words[2] + i64::from(step), wrapped);
    }
    spiked
}

/// A step of a LIF neuron with an adaptive threshold in lava's integers.
pub(crate) fn adaptive_lava(row: &ParameterRow, words: &mut [i64; 4], arrived: i64) -> Outcome {
    let ParameterRow([du, dv, dtheta, dr, rest, step, mantissa, exponent]) = *row;
    let [mut u_wrapped, v_clipped] = integrate(words, [du, dv], [mantissa, exponent], arrived);
    let voltage = words[1];
    let spiked = adapt([dtheta, dr, rest, step], words, Some(voltage), &mut u_wrapped);
    Outcome { spiked, u_wrapped, v_clipped, ..Outcome::default() }
}

/// A step of a LIF neuron with an adaptive threshold in lava-dl's integers.
pub(crate) fn adaptive_lava_dl(row: &ParameterRow, words: &mut [i64; 4], arrived: i64) -> Outcome {
    let ParameterRow([du, dv, dtheta, dr, rest, step, ..]) = *row;
    let mut u_wrapped = integrate_wide(words, [du, dv], arrived);
    let voltage = words[1];
    let spiked = adapt([dtheta, dr, rest, step], words, Some(voltage), &mut u_wrapped);
    Outcome { spiked, u_wrapped, ..Outcome::default() }
}
