//! Arithmetic of PES: `docs/learning.md`, equations (L12) and (L13).
//!
//! Input: a trace or weight, with its random number. Output: its next value.

use nsim_ir::learning::{GREATEST_ERROR, GREATEST_TRACE, PES_TRACE_EPOCH, Rule, Trace};
use nsim_ir::quantised::connectivity::SynapseFormat;

/// Bits of a weight's fraction while it learns.
const FRACTION: u32 = 7;
/// Bits that a product of trace and error loses.
const LOST: u32 = 2;

/// PES in a format of synapses.
#[derive(Debug, Clone, Copy)]
pub struct Pes {
    /// Factor of the decay between two changes of a trace.
    decay: f64,
    impulse: f64,
    /// Step of weights, a power of 2, and the least and greatest weight.
    step: i32,
    range: (i32, i32),
}

impl Pes {
    /// A rule in a format.
    pub fn new(rule: &Rule, format: SynapseFormat) -> Self {
        let settings = rule.trace(Trace::X1);
        let (step, (low, high)) = (format.sign.step(format.bits), format.sign.range(format.bits));
        Pes {
            decay: libm::exp(-f64::from(PES_TRACE_EPOCH) / settings.tau.get()),
            impulse: settings.impulse.into(),
            step: step.into(),
            range: (low.max(step - 256).into(), high.into()),
        }
    }

    /// (L12): a trace after two steps; `draw` is from 0 to below 1.
    #[inline]
    pub fn trace(&self, trace: i16, spiked: bool, draw: impl FnOnce() -> f64) -> i16 {
        let z = self.decay * f64::from(trace) + if spiked { self.impulse } else { 0.0 };
        let up = z.fract() > 0.0 && z.fract() > draw();
        (z as i16 + i16::from(up)).min(GREATEST_TRACE as i16)
    }

    /// An error within its bounds.
    pub fn error(value: i32) -> i32 {
        value.clamp(-GREATEST_ERROR, GREATEST_ERROR)
    }

    /// (L13): a weight after learning from a trace and an error; `draw` is from 0 to below 1.
    #[inline]
    pub fn weight(&self, weight: i16, trace: i16, error: i32, draw: impl FnOnce() -> f64) -> i16 {
        let unit = self.step << FRACTION;
        let z = (i32::from(weight) << FRACTION) + ((i32::from(trace) * error) >> LOST);
        let rest = z.abs() & (unit - 1);
        let up = rest > 0 && f64::from(rest) / f64::from(unit) > draw();
        let magnitude = self.step * ((z.abs() >> unit.trailing_zeros()) + i32::from(up));
        (z.signum() * magnitude).clamp(self.range.0, self.range.1) as i16
    }
}
