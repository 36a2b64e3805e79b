//! Integrate-and-fire: no memory in the current, no leak of the voltage.
//!
//! State: u, which holds the arrivals of this step alone, the voltage v, both of 24 bits, and the
//! refractory counter. Each step, with q the sum of the arrivals: `u = q`, `v = v + u + bias`;
//! threshold, hold, clips and wraps are those of the Loihi compartment in the chip's arithmetic,
//! the only one in which the kind is defined. A spike carries the payload of its population, or
//! nothing. On the chip it is a compartment with du = 4096 and dv = 0: its registers, its update
//! and the bounds on its state are those of the Loihi compartment with these two decays.
//!
//! *Bounds.* What enters v in a step is at most B = H + bias, with H the sum of the positive
//! weights. Nothing is ever taken away: with B <= 0 v never exceeds B (it returns to 0 at resets),
//! otherwise only the clip bounds it. No claim when the arrivals leave the 22 bits of the
//! accumulator, or arrivals and bias the 24 bits of u.

use super::kind::{Kind, RealForm};
use super::loihi;
use nsim_ir::arithmetic::Semantics;
use nsim_ir::base::fixed::Decay;
use nsim_ir::neurons::NeuronKind;
use nsim_ir::quantised::Neuron;

/// The description.
pub(super) const KIND: Kind = Kind {
    semantics: &[Semantics::Hardware],
    neuron: |values| {
        let decays = [Decay::MAX.get().into(), Decay::MIN.get().into()];
        Ok(Neuron { kind: NeuronKind::If, ..(loihi::KIND.neuron)(&[&decays, values].concat())? })
    },
    model: |p, index, _| RealForm { keep_v: 1.0, ..loihi::threshold_and_reset(p, index) },
    ..loihi::KIND
};
