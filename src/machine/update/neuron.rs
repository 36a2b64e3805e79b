//! One compartment, one timestep, in the three named semantics: the plain form that the vector kernels are held against.
//!
//! Comes in: registers, the sum of what arrived, the compartment's fields. Goes out: the new registers, whether it spiked,
//! and which values left their field. Equation numbers refer to `docs/semantics.md`.
//!
//! Arrivals are summed in units of 64: every scaled weight is a multiple of 64 (equation 1), so the sum of a step fits 32
//! bits for any fan-in that a core can hold, and the accumulator's wrap to 22 bits is the truncation of that sum to 16.

use crate::base::fixed::{Q_BITS, THRESHOLD_SHIFT, UV_BITS, WEIGHT_SHIFT, clip, decay, wrap};
use crate::desc::network::{Semantics, ThresholdTest};
use crate::ir::quantised::Neuron;

/// A compartment's fields in the form that the update uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fields {
    /// As the network has them.
    pub neuron: Neuron,
    /// Bias in register units.
    pub bias: i32,
    /// The least v that spikes.
    pub fires_from: i32,
    /// Lower clip of v.
    pub vmin: i32,
    /// Upper clip of v.
    pub vmax: i32,
    /// Steps from one spike to the next possible one; 0 only in SLAYER's semantics, where it means never.
    pub refractory: u8,
    /// The step before which the compartment is held at zero.
    pub start_step: u32,
    /// The step that periodic resets are counted from.
    pub resets_from: u32,
}

impl Fields {
    /// The fields of a compartment under a semantics.
    #[must_use]
    pub fn new(neuron: Neuron, start_step: u32, semantics: Semantics, test: ThresholdTest) -> Self {
        let threshold = (neuron.vth.get() as i32) << THRESHOLD_SHIFT;
        let bias = i32::from(neuron.bias_mant.get()) << neuron.bias_exp.get();
        Fields {
            neuron,
            bias: if semantics == Semantics::Slayer { 0 } else { bias },
            fires_from: match test {
                ThresholdTest::Strict => threshold + 1,
                ThresholdTest::Inclusive => threshold,
            },
            vmin: 1 - (1 << neuron.vmin.get()),
            vmax: (1 << (9 + 2 * u32::from(neuron.vmax.get()))) - 1,
            refractory: match semantics {
                Semantics::Hardware | Semantics::Lava => neuron.refractory.get().max(1),
                Semantics::Slayer => neuron.refractory.get(),
            },
            // SLAYER's loop starts at step 1; what enters step 0 is lost.
            start_step: if semantics == Semantics::Slayer { start_step.max(1) } else { start_step },
            resets_from: start_step,
        }
    }

    /// Whether v is held in the coming step.
    #[inline]
    #[must_use]
    pub fn holds(&self, r: &Registers) -> bool {
        self.remaining(r.hold) > 0
    }

    /// What is left of a refractory period in the coming step.
    #[inline]
    fn remaining(&self, hold: u8) -> u8 {
        if self.refractory == 0 { hold } else { hold.saturating_sub(1) }
    }
}

/// The registers of a compartment.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Registers {
    /// Current.
    pub u: i32,
    /// Voltage; 0 at a spike and while v is held.
    pub v: i32,
    /// Steps until v is free again; set to the refractory period by a spike.
    pub hold: u8,
}

/// What an update did.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Effect {
    /// It spiked.
    pub spiked: bool,
    /// The accumulator wrapped.
    pub q_wrapped: bool,
    /// The current, or current and bias, wrapped.
    pub u_wrapped: bool,
    /// The voltage was clipped.
    pub v_clipped: bool,
}

/// Equations (2) to (7): one update with `arrived` units of 64.
#[inline]
#[must_use]
pub fn update(r: Registers, arrived: i32, f: &Fields, semantics: Semantics) -> (Registers, Effect) {
    match semantics {
        Semantics::Hardware => hardware(r, arrived, f),
        Semantics::Lava => lava(r, arrived, f),
        Semantics::Slayer => slayer(r, arrived, f),
    }
}

fn hardware(r: Registers, arrived: i32, f: &Fields) -> (Registers, Effect) {
    let whole = i64::from(arrived) << WEIGHT_SHIFT;
    let q = wrap(whole, Q_BITS);
    let sum = decay(i64::from(r.u), f.neuron.du) + q;
    let u = wrap(sum, UV_BITS);
    let with_bias = u + i64::from(f.bias);
    let input = wrap(with_bias, UV_BITS);
    let free = decay(i64::from(r.v), f.neuron.dv) + input;
    let v = clip(free, i64::from(f.vmin), i64::from(f.vmax));
    let hold = r.hold.saturating_sub(1);
    let spiked = hold == 0 && v >= i64::from(f.fires_from);
    let effect = Effect {
        spiked,
        q_wrapped: q != whole,
        u_wrapped: u != sum || input != with_bias,
        v_clipped: hold == 0 && v != free,
    };
    let v = if hold > 0 || spiked { 0 } else { v as i32 };
    (Registers { u: u as i32, v, hold: if spiked { f.refractory } else { hold } }, effect)
}

/// lava's fixed-point LIF (`proc/lif/models.py`): no wrap of the accumulator, u wrapped once into (-2^23, 2^23], no wrap of
/// u + bias, v clipped to the whole field, no refractory period.
fn lava(r: Registers, arrived: i32, f: &Fields) -> (Registers, Effect) {
    let limit = 1i64 << UV_BITS;
    let activation = (i64::from(arrived) << WEIGHT_SHIFT) as i32;
    let sum = (decay(i64::from(r.u), f.neuron.du) + i64::from(activation)) as i32;
    let mut u = i64::from(sum);
    if u > limit {
        u -= 2 * limit;
    }
    if u <= -limit {
        u = i64::from(sum) + 2 * limit;
    }
    let free = decay(i64::from(r.v), f.neuron.dv) + u + i64::from(f.bias); // below 2^25, far within lava's 32 bits
    let v = clip(free, 1 - limit, limit - 1);
    let spiked = v >= i64::from(f.fires_from);
    let effect = Effect { spiked, q_wrapped: false, u_wrapped: u != i64::from(sum), v_clipped: v != free };
    (Registers { u: u as i32, v: if spiked { 0 } else { v as i32 }, hold: 0 }, effect)
}

/// SLAYER's Loihi kernel: the magnitude of a product keeps its low 32 bits, sums are of 32 bits.
fn slayer(r: Registers, arrived: i32, f: &Fields) -> (Registers, Effect) {
    let product = |x: i32, d: u16| {
        let kept = (x.unsigned_abs().wrapping_mul(4096 - u32::from(d)) >> 12) as i32;
        if x < 0 { -kept } else { kept }
    };
    let u = product(r.u, f.neuron.du.get()).wrapping_add(arrived << WEIGHT_SHIFT);
    let v = product(r.v, f.neuron.dv.get()).wrapping_add(u);
    let hold = f.remaining(r.hold);
    let spiked = hold == 0 && v >= f.fires_from;
    let v = if hold > 0 || spiked { 0 } else { v };
    // A period of 0 is never counted down: the compartment is silent after its first spike.
    let hold = if spiked { f.refractory.max(1) } else { hold };
    (Registers { u, v, hold }, Effect { spiked, ..Effect::default() })
}
