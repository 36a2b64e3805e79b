//! Neurons that send changes. They sum arrivals, apply an activation, and send its change once the
//! change reaches a threshold.
//!
//! Equations (20) to (24) of `docs/loihi2.md`. Source: lava-nc b6822fb, `proc/sdn/models.py`. The
//! form in lava's releases loses the low bits of its messages; the later form, `corrected`, keeps
//! them.

use nsim_ir::neurons::ParameterRow;

use super::neuron::{Arrived, Emission, Neuron, OverflowFlags, choice, columns, mask};

/// Sigma, activation and Delta in one.
#[derive(Debug)]
pub(super) struct SigmaDelta;

/// Sends the changes of its arrivals.
#[derive(Debug)]
pub(super) struct Delta;

/// Sends the sum of all arrivals so far.
#[derive(Debug)]
pub(super) struct Sigma;

columns!(
    /// A sum, and the state of its change encoder.
    Summed { sigma = 0, act = 1, residue = 2, error = 3 }
);
columns!(
    /// State of a change encoder.
    Changes { act = 0, residue = 1, error = 2 }
);
columns!(
    /// A sum.
    Sum { sigma = 0 }
);
columns!(
    /// Parameters of a [`SigmaDelta`], in the units of the state. `least` is the lower bound of the
    /// activation; `cum_error` and `corrected` are all ones or 0.
    Parameters { bias = 0, least = 1, threshold = 2, state_exp = 3, cum_error = 4, corrected = 5 }
);
columns!(
    /// Parameters of a [`Delta`].
    Encoding { shift = 0, threshold = 1, state_exp = 2, cum_error = 3 }
);

/// Parameters of a change encoder.
#[derive(Debug, Clone, Copy)]
struct Sending {
    /// It fits 31 bits, since an exponent is at most 7 and the mantissa has 17 bits.
    threshold: i32,
    state_exp: i32,
    cum_error: i32,
    corrected: i32,
}

impl Sending {
    /// All ones where a change is large enough to be sent.
    #[inline(always)]
    fn reaches(&self, change: i32) -> i32 {
        mask(change >= self.threshold) | mask(change <= -self.threshold)
    }

    /// Sends the change to `x`.
    #[inline(always)]
    fn send(&self, changes: &mut Changes, x: i32, overflows: &mut OverflowFlags) -> Emission {
        // In the corrected form `residue` and `error` are 0.
        let change = overflows.subtract(x, changes.act);
        let change = overflows.add(change, changes.residue);
        let cumulated = overflows.add(changes.error, change & self.cum_error);
        let sent = change & self.reaches(choice(self.cum_error, cumulated, change));
        let message = sent >> self.state_exp;
        let corrected = changes.act.wrapping_add(message << self.state_exp);
        changes.error = cumulated & mask(sent == 0) & !self.corrected;
        changes.residue = change.wrapping_sub(sent) & !self.corrected;
        changes.act = choice(self.corrected, corrected, x);
        Emission::value(message)
    }

    /// Whether it would change, send and report nothing for an equal `x` without arrivals.
    #[inline(always)]
    fn is_idle(&self, changes: &Changes, x: i32) -> bool {
        let mut overflows = OverflowFlags::default();
        let change = overflows.subtract(x, changes.act);
        let corrected = mask((change & self.reaches(change)) >> self.state_exp == 0) & mask(!overflows.any());
        let small = mask(changes.residue == 0) | !self.cum_error & !self.reaches(changes.residue);
        choice(self.corrected, corrected, mask(changes.act == x) & small) != 0
    }
}

impl Parameters {
    #[inline(always)]
    fn sending(&self) -> Sending {
        let &Parameters { threshold, state_exp, cum_error, corrected, .. } = self;
        Sending { threshold, state_exp, cum_error, corrected }
    }
}

impl Neuron for SigmaDelta {
    type State = Summed;
    type Parameters = Parameters;

    fn prepare(
        &ParameterRow([vth, bias, spike_exp, state_exp, relu, cum_error, corrected, _]): &ParameterRow,
    ) -> Parameters {
        let shift = spike_exp + state_exp;
        Parameters {
            bias: bias << shift,
            least: if relu == 0 { i32::MIN } else { 0 },
            threshold: vth << shift,
            state_exp,
            // The corrected form has no error.
            cum_error: mask(cum_error != 0 && corrected == 0),
            corrected: mask(corrected != 0),
        }
    }

    #[inline(always)]
    fn update(p: &Parameters, s: &mut Summed, [arrived, _]: Arrived, overflows: &mut OverflowFlags) -> Emission {
        s.sigma = overflows.add(s.sigma, arrived);
        let x = overflows.add(s.sigma, p.bias).max(p.least);
        let mut changes = Changes { act: s.act, residue: s.residue, error: s.error };
        let emission = p.sending().send(&mut changes, x, overflows);
        (s.act, s.residue, s.error) = (changes.act, changes.residue, changes.error);
        emission
    }

    #[inline(always)]
    fn idle(p: &Parameters, s: &Summed) -> bool {
        let mut overflows = OverflowFlags::default();
        let x = overflows.add(s.sigma, p.bias).max(p.least);
        let changes = Changes { act: s.act, residue: s.residue, error: s.error };
        !overflows.any() & p.sending().is_idle(&changes, x)
    }
}

impl Neuron for Delta {
    type State = Changes;
    type Parameters = Encoding;

    fn prepare(&ParameterRow([vth, spike_exp, state_exp, cum_error, ..]): &ParameterRow) -> Encoding {
        let shift = spike_exp + state_exp;
        Encoding { shift, threshold: vth << shift, state_exp, cum_error: mask(cum_error != 0) }
    }

    #[inline(always)]
    fn update(p: &Encoding, s: &mut Changes, [arrived, _]: Arrived, overflows: &mut OverflowFlags) -> Emission {
        let &Encoding { shift, threshold, state_exp, cum_error } = p;
        let x = arrived << shift;
        overflows.note_wrap(x >> shift != arrived);
        Sending { threshold, state_exp, cum_error, corrected: 0 }.send(s, x, overflows)
    }
}

impl Neuron for Sigma {
    type State = Sum;
    type Parameters = ();

    fn prepare(_: &ParameterRow) {}

    #[inline(always)]
    fn update((): &(), s: &mut Sum, [arrived, _]: Arrived, overflows: &mut OverflowFlags) -> Emission {
        s.sigma = overflows.add(s.sigma, arrived);
        Emission::value(s.sigma)
    }

    #[inline(always)]
    fn idle((): &(), s: &Sum) -> bool {
        s.sigma == 0
    }
}
