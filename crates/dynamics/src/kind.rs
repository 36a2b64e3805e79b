//! The terms in which a neuron kind with the registers of Loihi 1 is described.
//!
//! A [`Kind`] is data and functions over a compartment's parameters. What an update reads and
//! writes has one form for all of them ([`Fields`], [`Registers`], [`Effect`]): two words and a
//! counter, which the machine updates as vectors.

use std::num::NonZeroU32;

use nsim_ir::arithmetic::{Semantics, ThresholdTest};
use nsim_ir::base::fixed::{DECAY_ONE, OutOfRange, THRESHOLD_SHIFT, UV_BITS};
use nsim_ir::graph::NeuronParameters;
use nsim_ir::neurons::NeuronKind;
use nsim_ir::quantised::Neuron;

/// A neuron kind with the registers of Loihi 1.
#[derive(Debug)]
pub struct Kind {
    /// The arithmetics that it is defined in.
    pub semantics: &'static [Semantics],
    /// A compartment from the integers of `NeuronKind::parameters`, in that order, each within its
    /// range.
    pub neuron: fn(&[i64]) -> Result<Neuron, OutOfRange>,
    /// What its updates read; `start_step` is the step before which it is held at zero.
    pub fields: fn(neuron: &Neuron, start_step: u32, Semantics, ThresholdTest) -> Fields,
    /// An upper bound on v for ever; `None` when there is none.
    pub greatest_voltage: fn(&Neuron, Semantics, Arrivals) -> Option<i64>,
    /// The least number of steps from a spike to the next when no reset falls between them; `None`
    /// when there is no next.
    pub shortest_interval: fn(&Neuron, Semantics) -> Option<NonZeroU32>,
    /// Equation (8): what the chip's voltage register reads after an update; the last argument says
    /// whether it spiked.
    pub voltage_register: fn(&Neuron, Semantics, &Registers, bool) -> i32,
    /// The dynamics in real numbers, from a model's parameters: of this compartment, at this many
    /// ms a timestep.
    pub model: fn(&NeuronParameters, u32, f64) -> RealForm,
}

/// A compartment's parameters in the form that updates use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fields {
    /// As the network has them.
    pub neuron: Neuron,
    /// Which arithmetic.
    pub semantics: Semantics,
    /// Bias in register units.
    pub bias: i32,
    /// The least v that spikes.
    pub fires_from: i32,
    /// Lower clip of v.
    pub vmin: i32,
    /// Upper clip of v.
    pub vmax: i32,
    /// Steps from one spike to the next possible one; 0 only in SLAYER's semantics, where it means
    /// never.
    pub refractory: u8,
    /// The step before which the compartment is held at zero.
    pub start_step: u32,
    /// The step that periodic resets are counted from.
    pub resets_from: u32,
    /// Whether the machine's vector form (`machine::update::kernel`) computes the same updates.
    pub vectors: bool,
}

impl Fields {
    /// The fields in the chip's semantics.
    pub fn from_registers(neuron: &Neuron, start_step: u32, test: ThresholdTest) -> Self {
        let threshold = (neuron.vth.get() as i32) << THRESHOLD_SHIFT;
        Fields {
            neuron: *neuron,
            semantics: Semantics::Hardware,
            bias: i32::from(neuron.bias_mant.get()) << neuron.bias_exp.get(),
            fires_from: match test {
                ThresholdTest::Strict => threshold + 1,
                ThresholdTest::Inclusive => threshold,
            },
            vmin: 1 - (1 << neuron.vmin.get()),
            vmax: (1 << (9 + 2 * u32::from(neuron.vmax.get()))) - 1,
            // A period of 0 behaves as 1.
            refractory: neuron.refractory.get().max(1),
            start_step,
            resets_from: start_step,
            vectors: true,
        }
    }

    /// Whether v is held in the coming step.
    #[inline]
    pub fn holds(&self, r: &Registers) -> bool {
        self.remaining(r.hold) > 0
    }

    /// What is left of a refractory period in the coming step.
    #[inline]
    pub(super) fn remaining(&self, hold: u8) -> u8 {
        if self.refractory == 0 { hold } else { hold.saturating_sub(1) }
    }

    /// Rule (13): whether an update with these arrivals would leave the compartment as it is, and
    /// silent.
    #[inline]
    pub fn at_rest(&self, r: &Registers, arrived: i32) -> bool {
        r.u == 0 && r.v == 0 && !self.holds(r) && arrived == 0 && self.bias == 0
    }

    /// Whether the compartment moves or spikes without input, so that it never rests.
    pub fn drives_itself(&self) -> bool {
        self.bias != 0 || self.fires_from <= 0
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

/// The least and the greatest that can arrive at a compartment in one step.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Arrivals {
    /// The sum of all negative scaled weights.
    pub low: i64,
    /// The sum of all positive ones.
    pub high: i64,
}

impl Arrivals {
    /// Counts a synapse over which a spike adds so much.
    pub fn add(&mut self, added: i64) {
        *if added < 0 { &mut self.low } else { &mut self.high } += added;
    }

    /// Whether both fit this many bits and a sign.
    pub fn fit(self, bits: u32) -> bool {
        -(1i64 << bits) <= self.low && self.high < 1i64 << bits
    }
}

/// Current-based dynamics in real numbers: `u(t) = keep_u u(t - 1) + x(t)`,
/// `v(t) = keep_v v(t - 1) + u(t) + bias`, a spike above the threshold, then v = 0 until
/// `refractory` steps after it, or v less the threshold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RealForm {
    /// What remains of the current after a step, 0..=1.
    pub keep_u: f64,
    /// What remains of the voltage after a step, 0..=1.
    pub keep_v: f64,
    /// Threshold, in the units of weights.
    pub threshold: f64,
    /// Added to the voltage in each step.
    pub bias: f64,
    /// The next spike comes at least this many steps after one; at least 1.
    pub refractory: u32,
    /// A spike subtracts the threshold from v instead of setting it to 0.
    pub subtracts: bool,
    /// Limits of the voltage.
    pub clip: (f64, f64),
}

/// A refractory period without end.
const SILENT: u32 = u32::MAX;

impl RealForm {
    /// The compartment in register units, its integers taken as real numbers.
    pub fn of_neuron(neuron: &Neuron, semantics: Semantics) -> Self {
        let fields = Fields::from_registers(neuron, 0, ThresholdTest::Inclusive);
        let keep = |decay: u16| 1.0 - f64::from(decay) / DECAY_ONE as f64;
        RealForm {
            keep_u: keep(neuron.du.get()),
            keep_v: keep(neuron.dv.get()),
            threshold: fields.fires_from.into(),
            bias: fields.bias.into(),
            refractory: fields.refractory.into(),
            subtracts: neuron.kind == NeuronKind::SoftReset,
            clip: (fields.vmin.into(), fields.vmax.into()),
        }
        .under(semantics, neuron.refractory.get() == 0)
    }

    /// What the rows of equation (11) say of a compartment in real numbers; `endless` where its
    /// refractory period is 0.
    pub(crate) fn under(self, semantics: Semantics, endless: bool) -> Self {
        // A real threshold has no register to clip in.
        let clip = |limits| if self.clip.1 < f64::MAX { limits } else { self.clip };
        match semantics {
            Semantics::Hardware => self,
            Semantics::Lava => {
                let most = f64::from((1 << UV_BITS) - 1);
                RealForm { refractory: 1, clip: clip((-most, most)), ..self }
            }
            Semantics::Slayer => RealForm {
                bias: 0.0,
                refractory: if endless { SILENT } else { self.refractory },
                clip: (f64::MIN, f64::MAX),
                ..self
            },
        }
    }
}
