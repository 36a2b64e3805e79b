//! Equations (35) to (38) of `docs/loihi2.md`.

use nsim_ir::neurons::ParameterRow;

use crate::outcome::{Outcome, sent, word};

/// Equation (35): a step of a neuron that sends its arrivals; `rectified` if their sign counts.
pub(crate) fn vector(row: &ParameterRow, arrived: i64, rectified: bool) -> Outcome {
    let size = if rectified { arrived } else { arrived.abs() };
    sent(if size > i64::from(row.0[0]) { arrived } else { 0 }, false)
}

/// Equation (36): a step of a neuron that sends a product.
pub(crate) fn product(row: &ParameterRow, [a, b]: [i64; 2]) -> Outcome {
    let ParameterRow([threshold, exp, ..]) = *row;
    let mut wrapped = false;
    let product = word((a * b).div_euclid(1 << exp), &mut wrapped);
    sent(if product.abs() > i64::from(threshold) { product } else { 0 }, wrapped)
}

/// Equation (37): a step of a neuron that sends a product with the previous step's arrivals.
pub(crate) fn delayed_product(row: &ParameterRow, words: &mut [i64; 4], [a, b]: [i64; 2]) -> Outcome {
    (words[0], words[1]) = (a, words[0]);
    let mut wrapped = false;
    let product = word(words[1] * b, &mut wrapped);
    sent(if product.abs() > i64::from(row.0[0]) { product } else { 0 }, wrapped)
}

/// Equation (37): a step of a neuron that sends a square.
pub(crate) fn square(arrived: i64) -> Outcome {
    let mut wrapped = false;
    sent(word(arrived * arrived, &mut wrapped), wrapped)
}

/// Equation (38): a step of a neuron that sends an inverse square root.
pub(crate) fn inverse_root(arrived: i64) -> Outcome {
    let x = arrived.clamp(0, (1 << 24) - 1);
    let v_clipped = x != arrived;
    if x == 0 {
        return Outcome { v_clipped, ..sent(0, false) };
    }
    let magnitude = f64::from(x.ilog2());
    let mut factor = 2 * (4096.0 / (((magnitude - 12.0) / 2.0).exp2() * 1.238_982_962)).trunc() as i64;
    let (mut root, mut error) = (factor / 2, x);
    for _ in 0..5 {
        error = error * factor / 8192 * factor / 8192;
        factor = 3 * 4096 - error;
        root = root * factor / 8192;
    }
    Outcome { v_clipped, ..sent(root, false) }
}
