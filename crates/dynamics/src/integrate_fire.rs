//! Integrate-and-fire: the current has no memory, the voltage no leak.
//!
//! State: the current u (the arrivals of this step alone) and the voltage v, both of 24 bits, and
//! the refractory counter. Each step, with q the sum of the arrivals: `u = q`, `v = v + u + bias`.
//! Threshold, hold, clips and wraps act as in the Loihi compartment in the chip's arithmetic. The
//! kind is defined in no other arithmetic. A spike carries the payload of its population, or
//! nothing. The chip runs it as a compartment with du = 4096 and dv = 0, with equal registers,
//! update and bounds.
//!
//! *Bounds.* The input of v in a step is at most B = H + bias, with H the sum of the positive
//! weights. v never leaks: with B <= 0 it never exceeds B (it returns to 0 at resets), otherwise
//! only the clip bounds it. There is no bound when the arrivals leave the 22 bits of the
//! accumulator, or arrivals and bias the 24 bits of u.

use super::kind::{Kind, RealForm};
use super::loihi;
use nsim_ir::arithmetic::Semantics;
use nsim_ir::base::fixed::Decay;
use nsim_ir::neurons::NeuronKind;
use nsim_ir::quantised::Neuron;

pub(super) const KIND: Kind = Kind {
    semantics: &[Semantics::Hardware],
    neuron: |values| {
        let decays = [Decay::MAX.get().into(), Decay::MIN.get().into()];
        Ok(Neuron { kind: NeuronKind::If, ..(loihi::KIND.neuron)(&[&decays, values].concat())? })
    },
    model: |p, index, _| RealForm { keep_v: 1.0, ..loihi::threshold_and_reset(p, index) },
    ..loihi::KIND
};
