//! Neurons without a voltage: they send their arrivals, or a function of them.
//!
//! Equations (35) to (38) of `docs/loihi2.md`. Source: lava-nc b6822fb, `proc/graded/models.py` and
//! `proc/prodneuron/models.py`.

use nsim_ir::neurons::ParameterRow;

use super::neuron::{Arrived, Emission, Neuron, OverflowFlags, choice, columns, mask};

/// Sends its arrivals above a threshold: by their value with `RELU`, else by their magnitude.
#[derive(Debug)]
pub(super) struct GradedVec<const RELU: bool>;

/// Sends the product of both sums.
#[derive(Debug)]
pub(super) struct ProdNeuron;

/// Sends the product of the second sum and the first sum of the previous step.
#[derive(Debug)]
pub(super) struct NormVecDelay;

/// Sends the square of its sum.
#[derive(Debug)]
pub(super) struct NormSquare;

/// Sends the inverse of its sum's square root, as a fraction of 12 bits.
#[derive(Debug)]
pub(super) struct InvSqrt;

columns!(
    /// Threshold that a message exceeds.
    Threshold { threshold = 0 }
);
columns!(
    /// Parameters of a [`ProdNeuron`].
    Product { threshold = 0, exp = 1 }
);
columns!(
    /// First sum of this step and of the previous step.
    Delayed { v = 0, v2 = 1 }
);

/// Returns a message where the magnitude of the value exceeds the threshold.
#[inline(always)]
fn above(value: i32, threshold: i32) -> Emission {
    Emission::value(value & mask((value > threshold) | (value < -threshold)))
}

impl<const RELU: bool> Neuron for GradedVec<RELU> {
    type State = ();
    type Parameters = Threshold;

    fn prepare(&ParameterRow([threshold, ..]): &ParameterRow) -> Threshold {
        Threshold { threshold }
    }

    #[inline(always)]
    fn update(p: &Threshold, (): &mut (), [arrived, _]: Arrived, _: &mut OverflowFlags) -> Emission {
        if RELU { Emission::value(arrived & mask(arrived > p.threshold)) } else { above(arrived, p.threshold) }
    }
}

impl Neuron for ProdNeuron {
    type State = ();
    type Parameters = Product;

    fn prepare(&ParameterRow([threshold, exp, ..]): &ParameterRow) -> Product {
        Product { threshold, exp }
    }

    #[inline(always)]
    fn update(p: &Product, (): &mut (), [a, b]: Arrived, overflows: &mut OverflowFlags) -> Emission {
        above(overflows.word((i64::from(a) * i64::from(b)) >> p.exp), p.threshold)
    }
}

impl Neuron for NormVecDelay {
    type State = Delayed;
    type Parameters = Threshold;

    fn prepare(&ParameterRow([threshold, ..]): &ParameterRow) -> Threshold {
        Threshold { threshold }
    }

    #[inline(always)]
    fn update(p: &Threshold, s: &mut Delayed, [a, b]: Arrived, overflows: &mut OverflowFlags) -> Emission {
        *s = Delayed { v: a, v2: s.v };
        above(overflows.word(i64::from(s.v2) * i64::from(b)), p.threshold)
    }
}

impl Neuron for NormSquare {
    type State = ();
    type Parameters = ();

    fn prepare(_: &ParameterRow) {}

    #[inline(always)]
    fn update((): &(), (): &mut (), [a, _]: Arrived, overflows: &mut OverflowFlags) -> Emission {
        Emission::value(overflows.word(i64::from(a) * i64::from(a)))
    }
}

/// Initial values of an inverse square root, by the leading zeros of a number of 24 bits:
/// `2 trunc(4096 / (2^((m - 12) / 2) 1.238982962))` for m = 23 to 0.
const FIRST_VALUES: [i32; 24] = [
    146, 206, 292, 412, 584, 826, 1168, 1652, 2336, 3304, 4674, 6610, 9350, 13_222, 18_700, 26_446, 37_402, 52_894,
    74_804, 105_788, 149_608, 211_578, 299_218, 423_158,
];

impl Neuron for InvSqrt {
    type State = ();
    type Parameters = ();

    fn prepare(_: &ParameterRow) {}

    #[inline(always)]
    fn update((): &(), (): &mut (), [a, _]: Arrived, overflows: &mut OverflowFlags) -> Emission {
        const MOST: i32 = (1 << 24) - 1;
        let clipped = a.clamp(0, MOST);
        overflows.note_clip(clipped != a);
        let first = FIRST_VALUES[(clipped | 1).leading_zeros() as usize - 8];
        let (mut factor, mut root, mut b) = (i64::from(first), i64::from(first / 2), i64::from(clipped));
        for _ in 0..5 {
            b = (((b * factor) >> 13) * factor) >> 13;
            factor = 3 * 4096 - b;
            root = (root * factor) >> 13;
        }
        Emission::value(choice(mask(clipped == 0), 0, root as i32))
    }
}
