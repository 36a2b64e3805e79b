//! Integrate-and-fire: no memory in the current, no leak of the voltage.
//!
//! State: u, which holds the arrivals of this step alone, the voltage v, both of 24 bits, and the refractory counter. Each
//! step, with q the sum of the arrivals: `u = q`, `v = v + u + bias`; threshold, hold, clips and wraps are those of the Loihi
//! compartment in the chip's arithmetic, the only one in which the kind is defined. A spike carries the payload of its
//! population, or nothing. On the chip it is a compartment with du = 4096 and dv = 0, and its registers say so.
//!
//! *Bounds.* What enters v in a step is at most B = H + bias, with H the sum of the positive weights. Nothing is ever taken
//! away: with B <= 0 v never exceeds B (it returns to 0 at resets), otherwise only the clip bounds it. No claim when the
//! arrivals leave the 22 bits of the accumulator, or arrivals and bias the 24 bits of u.

use super::kind::{Arrivals, Effect, Fields, Kind, RealForm, Registers, StateField};
use super::loihi;
use crate::base::fixed::{
    BiasExponent, BiasMantissa, Decay, OutOfRange, Payload, Q_BITS, Refractory, ThresholdMantissa, UV_BITS,
    VmaxExponent, VminExponent, WEIGHT_SHIFT, clip, wrap,
};
use crate::desc::network::{Semantics, ThresholdTest};
use crate::desc::neurons::NeuronKind;
use crate::ir::quantised::Neuron;

/// The description.
pub(super) const KIND: Kind = Kind {
    summary: "integrate-and-fire: no memory in the current, no leak of the voltage",
    state: &[
        StateField { name: "u", bits: UV_BITS + 1 },
        StateField { name: "v", bits: UV_BITS + 1 },
        StateField { name: "refractory counter", bits: 6 },
    ],
    emits: Some(Payload::FIELD),
    semantics: &[Semantics::Hardware],
    neuron,
    fields,
    greatest_voltage,
    shortest_interval: loihi::KIND.shortest_interval,
    voltage_register: loihi::KIND.voltage_register,
    model: |p, index, _| RealForm { keep_v: 1.0, ..loihi::threshold_and_reset(p, index) },
};

fn neuron(values: &[i64]) -> Result<Neuron, OutOfRange> {
    let &[vth, bias_mant, bias_exp, refractory, vmin, vmax] = values else {
        unreachable!("one value for each parameter of the kind")
    };
    Ok(Neuron {
        kind: NeuronKind::If,
        du: Decay::MAX,
        dv: Decay::MIN,
        vth: ThresholdMantissa::new(vth)?,
        bias_mant: BiasMantissa::new(bias_mant)?,
        bias_exp: BiasExponent::new(bias_exp)?,
        refractory: Refractory::new(refractory)?,
        vmin: VminExponent::new(vmin)?,
        vmax: VmaxExponent::new(vmax)?,
    })
}

fn fields(neuron: &Neuron, start_step: u32, _: Semantics, test: ThresholdTest) -> Fields {
    Fields::from_registers(neuron, start_step, test)
}

pub(super) fn update(r: Registers, arrived: i32, f: &Fields) -> (Registers, Effect) {
    let whole = i64::from(arrived) << WEIGHT_SHIFT;
    let u = wrap(whole, Q_BITS);
    let with_bias = u + i64::from(f.bias);
    let input = wrap(with_bias, UV_BITS);
    let free = i64::from(r.v) + input;
    let v = clip(free, i64::from(f.vmin), i64::from(f.vmax));
    let hold = r.hold.saturating_sub(1);
    let spiked = hold == 0 && v >= i64::from(f.fires_from);
    let effect =
        Effect { spiked, q_wrapped: u != whole, u_wrapped: input != with_bias, v_clipped: hold == 0 && v != free };
    let v = if hold > 0 || spiked { 0 } else { v as i32 };
    (Registers { u: u as i32, v, hold: if spiked { f.refractory } else { hold } }, effect)
}

fn greatest_voltage(neuron: &Neuron, _: Semantics, arrivals: Arrivals) -> Option<i64> {
    let f = Fields::from_registers(neuron, 0, ThresholdTest::Strict);
    let bias = i64::from(f.bias);
    let input = Arrivals { low: arrivals.low + bias, high: arrivals.high + bias };
    let bounded = arrivals.fit(Q_BITS) && input.fit(UV_BITS) && input.high <= 0;
    Some(if bounded { input.high.max(f.vmin.into()) } else { f.vmax.into() })
}
