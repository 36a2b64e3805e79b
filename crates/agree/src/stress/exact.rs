//! One compartment in integers without limits: equations 2 to 7 of `docs/semantics.md` by quotient
//! and remainder.
//!
//! 128 bits hold every product and sum of the fields' ranges and of 2^60 arrivals, so nothing here
//! can overflow. Nothing is shared with the machine or the golden interpreter: no shift, no mask,
//! no field type's operation.

/// The parameters, as plain numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Parameters {
    /// Effective decay of the current, 0..=4096.
    pub du: i128,
    /// Effective decay of the voltage, 0..=4096.
    pub dv: i128,
    /// Threshold mantissa.
    pub vth: i128,
    /// Bias mantissa.
    pub bias_mant: i128,
    /// Bias exponent.
    pub bias_exp: u32,
    /// Refractory period.
    pub refractory: u64,
    /// Exponent of the lower clip.
    pub vmin: u32,
    /// Exponent of the upper clip.
    pub vmax: u32,
}

/// The state.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Compartment {
    /// Current.
    pub u: i128,
    /// Voltage; 0 at a spike and while it is held.
    pub v: i128,
    /// The step of the last spike.
    last: Option<u64>,
}

/// Events of one step.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Step {
    /// It spiked.
    pub spiked: bool,
    /// The accumulator wrapped.
    pub q_wrapped: bool,
    /// The current, or the current and the bias, wrapped.
    pub u_wrapped: bool,
    /// The voltage was clipped.
    pub v_clipped: bool,
}

/// The number congruent to `x` in -2^bits..2^bits.
fn wrapped(x: i128, bits: u32) -> i128 {
    let half = 2i128.pow(bits);
    (x + half).rem_euclid(2 * half) - half
}

/// Equation (3): the quotient rounds toward zero.
pub fn decayed(x: i128, d: i128) -> i128 {
    x * (4096 - d) / 4096
}

/// Equation (1): the accumulator's increment by a spike over a weight.
pub fn scaled(weight: i128, exponent: i32) -> i128 {
    match u32::try_from(exponent) {
        Ok(up) => weight * 64 * 2i128.pow(up),
        Err(_) => weight * 64 / 2i128.pow(exponent.unsigned_abs()) / 64 * 64,
    }
}

impl Compartment {
    /// Runs one update with the sum of the arrivals in register units.
    pub fn step(&mut self, now: u64, arrived: i128, p: &Parameters) -> Step {
        let q = wrapped(arrived, 21);
        let sum = decayed(self.u, p.du) + q;
        self.u = wrapped(sum, 23);
        let with_bias = self.u + p.bias_mant * 2i128.pow(p.bias_exp);
        let input = wrapped(with_bias, 23);
        let free = decayed(self.v, p.dv) + input;
        let (low, high) = (1 - 2i128.pow(p.vmin), 2i128.pow(9 + 2 * p.vmax) - 1);
        let v = free.clamp(low, high);
        let held = self.last.is_some_and(|last| now - last < p.refractory.max(1));
        let spiked = !held && v > 64 * p.vth;
        self.v = if held || spiked { 0 } else { v };
        if spiked {
            self.last = Some(now);
        }
        Step {
            spiked,
            q_wrapped: q != arrived,
            u_wrapped: self.u != sum || input != with_bias,
            v_clipped: !held && v != free,
        }
    }

    /// State that decides later steps, with the inputs: u, v, and the steps for which v is held.
    pub fn fingerprint(&self, now: u64, p: &Parameters) -> (i128, i128, u64) {
        let held = self.last.map_or(0, |last| (last + p.refractory.max(1)).saturating_sub(now + 1));
        (self.u, self.v, held)
    }
}
