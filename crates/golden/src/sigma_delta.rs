//! Equations (20) to (24) of `docs/loihi2.md`.

use nsim_ir::neurons::ParameterRow;

use crate::outcome::{Outcome, sent, word};

/// The words of a compartment that sends changes.
struct Changes<'a> {
    act: &'a mut i64,
    residue: &'a mut i64,
    error: &'a mut i64,
}

/// Equations (21) and (22): the outcome of a change to `x`.
fn change(x: i64, words: Changes<'_>, threshold: i64, state_exp: i32, cum_error: bool, mut wrapped: bool) -> Outcome {
    let Changes { act, residue, error } = words;
    let change = word(word(x - *act, &mut wrapped) + *residue, &mut wrapped);
    let compared = if cum_error { word(*error + change, &mut wrapped) } else { change };
    let sends = compared.abs() >= threshold && change != 0;
    *error = if cum_error && !sends { compared } else { 0 };
    *residue = if sends { 0 } else { change };
    *act = x;
    sent(if sends { change.div_euclid(1 << state_exp) } else { 0 }, wrapped)
}

/// A step of a SigmaDelta neuron.
pub(crate) fn sigma_delta(row: &ParameterRow, words: &mut [i64; 4], arrived: i64) -> Outcome {
    let ParameterRow([threshold, bias, spike_exp, state_exp, relu, cum_error, corrected, _]) = *row;
    let one = 1i64 << (spike_exp + state_exp);
    let [sigma, act, residue, error] = words;
    let mut wrapped = false;
    // Equation (20).
    *sigma = word(*sigma + arrived, &mut wrapped);
    let sum = word(*sigma + i64::from(bias) * one, &mut wrapped);
    let x = if relu == 1 { sum.max(0) } else { sum };
    let threshold = i64::from(threshold) * one;
    if corrected == 0 {
        return change(x, Changes { act, residue, error }, threshold, state_exp, cum_error == 1, wrapped);
    }
    // Equation (23).
    let change = word(x - *act, &mut wrapped);
    let message = if change.abs() >= threshold { change.div_euclid(1 << state_exp) } else { 0 };
    *act = word(*act + message * (1 << state_exp), &mut wrapped);
    sent(message, wrapped)
}

/// A step of a Delta neuron.
pub(crate) fn delta(row: &ParameterRow, words: &mut [i64; 4], arrived: i64) -> Outcome {
    let ParameterRow([threshold, spike_exp, state_exp, cum_error, ..]) = *row;
    let one = 1i64 << (spike_exp + state_exp);
    let [act, residue, error, _] = words;
    let mut wrapped = false;
    let x = word(arrived * one, &mut wrapped);
    change(x, Changes { act, residue, error }, i64::from(threshold) * one, state_exp, cum_error == 1, wrapped)
}

/// A step of a Sigma neuron: equation (24).
pub(crate) fn sigma(words: &mut [i64; 4], arrived: i64) -> Outcome {
    let mut wrapped = false;
    words[0] = word(words[0] + arrived, &mut wrapped);
    sent(words[0], wrapped)
}
