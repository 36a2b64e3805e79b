//! Intervals of the values of expressions.
//!
//! Input: an operation and the intervals of its operands. Output: the interval of its result in 64
//! bits, or an error. It contains every value of the result, and maybe more values, because
//! operands are treated as independent.

use super::tree::{Interval, Operation, bits};

/// The greatest amount of a shift, in bits.
const MOST_SHIFT: i64 = 62;

/// The interval of an operation's result.
///
/// # Errors
/// A sentence with the bits that the result or a shift would need, and the remedy.
pub(super) fn result(operation: Operation, operands: &[Interval]) -> Result<Interval, String> {
    // Each of these is monotone in either operand, so that its extremes are at the corners.
    let corners = |f: fn(i128, i128) -> i128| {
        let ends = |place: usize| [i128::from(operands[place].low), i128::from(operands[place].high)];
        let values = ends(0).map(|a| ends(1).map(|b| f(a, b)));
        let [[a, b], [c, d]] = values;
        (a.min(b).min(c).min(d), a.max(b).max(c).max(d))
    };
    let narrowed =
        |to: Interval| (operands[0].low.clamp(to.low, to.high).into(), operands[0].high.clamp(to.low, to.high).into());
    let (low, high): (i128, i128) = match operation {
        Operation::ShiftLeft | Operation::ShiftRight | Operation::TowardZero
            if operands[1].low < 0 || operands[1].high > MOST_SHIFT =>
        {
            let Interval { low, high } = operands[1];
            return Err(format!("a shift by {low} to {high} bits is outside 0..={MOST_SHIFT}: limit it"));
        }
        Operation::Add => corners(|a, b| a + b),
        Operation::Subtract => corners(|a, b| a - b),
        Operation::Multiply => corners(|a, b| a * b),
        Operation::ShiftLeft => corners(|a, k| a << k),
        Operation::ShiftRight => corners(|a, k| a >> k),
        Operation::TowardZero => corners(|a, k| a / (1 << k)),
        Operation::Minimum => corners(Ord::min),
        Operation::Maximum => corners(Ord::max),
        Operation::Absolute => {
            let (low, high) = (i128::from(operands[0].low), i128::from(operands[0].high));
            (low.max(-high).max(0), high.max(-low))
        }
        Operation::Select => {
            (operands[1].low.min(operands[2].low).into(), operands[1].high.max(operands[2].high).into())
        }
        Operation::Clip(bits) => narrowed(Interval::symmetric(bits)),
        Operation::Wrap(bits) if Interval::of_bits(bits).contains(operands[0]) => {
            (operands[0].low.into(), operands[0].high.into())
        }
        Operation::Wrap(bits) => {
            let Interval { low, high } = Interval::of_bits(bits);
            (low.into(), high.into())
        }
        Operation::Less
        | Operation::LessOrEqual
        | Operation::Equal
        | Operation::NotEqual
        | Operation::And
        | Operation::Or
        | Operation::Not => (0, 1),
    };
    match (i64::try_from(low), i64::try_from(high)) {
        (Ok(low), Ok(high)) => Ok(Interval { low, high }),
        _ => Err(format!(
            "the result can need {} bits of 64: clip(.., bits) or wrap(.., bits) its operands",
            bits(low, high)
        )),
    }
}
