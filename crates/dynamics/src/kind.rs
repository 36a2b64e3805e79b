//! Descriptions of neuron kinds with the registers of Loihi 1.
//!
//! A [`Kind`] is data and functions over a compartment's parameters. The updates of all these kinds
//! read and write one form ([`Fields`], [`Registers`], [`Effect`]): two words and a counter. The
//! machine updates this form as vectors.

use std::num::NonZeroU32;

use nsim_ir::arithmetic::{Semantics, ThresholdTest};
use nsim_ir::base::fixed::{DECAY_ONE, OutOfRange, THRESHOLD_SHIFT, UV_BITS};
use nsim_ir::graph::NeuronParameters;
use nsim_ir::neurons::NeuronKind;
use nsim_ir::quantised::Neuron;

/// A neuron kind with the registers of Loihi 1.
#[derive(Debug)]
pub struct Kind {
    /// Arithmetics in which the kind is defined.
    pub semantics: &'static [Semantics],
    /// Makes a compartment from the integers of `NeuronKind::parameters`, in that order, each
    /// within its range.
    pub neuron: fn(&[i64]) -> Result<Neuron, OutOfRange>,
    /// Inputs of the updates; the compartment is held at zero before `start_step`.
    pub fields: fn(neuron: &Neuron, start_step: u32, Semantics, ThresholdTest) -> Fields,
    /// Upper bound on v in all steps; `None` when there is none.
    pub greatest_voltage: fn(&Neuron, Semantics, Arrivals) -> Option<i64>,
    /// Least number of steps between two spikes without a reset between them; `None` when there is
    /// no second spike.
    pub shortest_interval: fn(&Neuron, Semantics) -> Option<NonZeroU32>,
    /// Equation (8): the chip's voltage register after an update; the last argument says whether
    /// the update spiked.
    pub voltage_register: fn(&Neuron, Semantics, &Registers, bool) -> i32,
    /// The dynamics in real numbers from a model's parameters, a compartment's index and the
    /// timestep in ms.
    pub model: fn(&NeuronParameters, u32, f64) -> RealForm,
}

/// A compartment's parameters in the form that updates use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fields {
    /// Parameters of the network.
    pub neuron: Neuron,
    /// Arithmetic of the updates.
    pub semantics: Semantics,
    /// Bias in register units.
    pub bias: i32,
    /// Least v that spikes.
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
    /// The step from which periodic resets are counted.
    pub resets_from: u32,
    /// Whether the machine's vector form (`machine::lanes::kernel`) computes the same updates.
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

    /// Remaining steps of a refractory period in the coming step.
    #[inline]
    pub(super) fn remaining(&self, hold: u8) -> u8 {
        if self.refractory == 0 { hold } else { hold.saturating_sub(1) }
    }

    /// Rule (13): whether the compartment is idle, with or without arrivals. Unless `fires_from` <=
    /// 0, the update then changes nothing and sends no spike.
    #[inline]
    pub fn at_rest(&self, r: &Registers, reached: bool) -> bool {
        r.u == 0 && r.v == 0 && !self.holds(r) && !reached && self.bias == 0
    }

    /// Whether integers may be added to a step ([`nsim_ir::spikes::Added`]).
    #[inline]
    pub fn takes_added(&self) -> bool {
        self.semantics == Semantics::Hardware && self.neuron.kind != NeuronKind::SoftReset
    }

    /// Whether the compartment changes or spikes without input, so that it is never idle.
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

/// Spike and overflows of an update.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Effect {
    /// The compartment spiked.
    pub spiked: bool,
    /// The accumulator wrapped.
    pub q_wrapped: bool,
    /// The current, or current and bias, wrapped.
    pub u_wrapped: bool,
    /// The voltage was clipped.
    pub v_clipped: bool,
}

/// Bounds on the sum of a compartment's arrivals in one step.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Arrivals {
    /// The sum of all negative scaled weights.
    pub low: i64,
    /// The sum of all positive scaled weights.
    pub high: i64,
}

impl Arrivals {
    /// Adds a synapse over which a spike contributes `added`.
    pub fn add(&mut self, added: i64) {
        *if added < 0 { &mut self.low } else { &mut self.high } += added;
    }

    /// Whether both fit `bits` bits and a sign.
    pub fn fit(self, bits: u32) -> bool {
        -(1i64 << bits) <= self.low && self.high < 1i64 << bits
    }
}

/// Current-based dynamics in real numbers: `u(t) = keep_u u(t - 1) + x(t)`,
/// `v(t) = keep_v v(t - 1) + u(t) + bias`. Above the threshold it spikes. Then v is 0 for
/// `refractory` steps, or decreases by the threshold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RealForm {
    /// Fraction of the current kept by one step of decay, 0..=1.
    pub keep_u: f64,
    /// Fraction of the voltage kept by one step of decay, 0..=1.
    pub keep_v: f64,
    /// Threshold, in the units of weights.
    pub threshold: f64,
    /// Bias, added to the voltage in each step.
    pub bias: f64,
    /// Least number of steps from a spike to the next; at least 1.
    pub refractory: u32,
    /// Whether a spike subtracts the threshold from v instead of setting it to 0.
    pub subtracts: bool,
    /// Limits of the voltage.
    pub clip: (f64, f64),
}

/// An endless refractory period.
const SILENT: u32 = u32::MAX;

impl RealForm {
    /// The compartment in register units, its integers taken as real numbers.
    pub fn of_neuron(neuron: &Neuron, semantics: Semantics) -> Self {
        let fields = Fields::from_registers(neuron, 0, ThresholdTest::Inclusive);
        fn keep(decay: u16) -> f64 {
            1.0 - f64::from(decay) / DECAY_ONE as f64
        }
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

    /// Applies the rows of equation (11) to a compartment in real numbers; `endless` where its
    /// refractory period is 0.
    pub(crate) fn under(self, semantics: Semantics, endless: bool) -> Self {
        // With a real threshold v has no register to clip in.
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
