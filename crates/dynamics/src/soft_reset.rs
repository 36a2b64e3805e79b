//! Reset by subtraction: a spike subtracts the threshold from the voltage, and no refractory period
//! follows.
//!
//! State: current u and voltage v, both of 24 bits. Except after a spike, each step acts as in the
//! Loihi compartment in the chip's arithmetic. The kind is defined in no other arithmetic. In the
//! step of a spike `v = v - 64 vth`, and no refractory period follows. At a spike v is at least 64
//! vth, so the remainder is not negative. A spike carries the payload of its population, or
//! nothing. Loihi 1 has no such compartment; a chip declares it (`neuron_kinds`).
//!
//! *Bounds.* The remainder after a spike lies between 0 and the voltage before it. A bound X >= 0
//! on v with `decay(X) + drive <= X` therefore holds as for a hard reset. The bounds of the Loihi
//! compartment apply. The next spike may come in the next step.

use super::kind::{Effect, Fields, Kind, RealForm, Registers};
use super::loihi;
use nsim_ir::arithmetic::Semantics;
use nsim_ir::base::fixed::THRESHOLD_SHIFT;
use nsim_ir::neurons::NeuronKind;
use nsim_ir::quantised::Neuron;

pub(super) const KIND: Kind = Kind {
    semantics: &[Semantics::Hardware],
    neuron: |values| {
        // All parameters but the refractory period, which is one step.
        let (before, limits) = values.split_at(5);
        Ok(Neuron { kind: NeuronKind::SoftReset, ..(loihi::KIND.neuron)(&[before, &[1], limits].concat())? })
    },
    fields: |neuron, start_step, semantics, test| Fields {
        vectors: false,
        ..(loihi::KIND.fields)(neuron, start_step, semantics, test)
    },
    voltage_register: |_, _, r, _| r.v,
    model: |p, index, timestep_ms| RealForm { subtracts: true, ..(loihi::KIND.model)(p, index, timestep_ms) },
    ..loihi::KIND
};

/// Computes one update with `arrived` units of 64.
#[inline]
pub(super) fn update(r: Registers, arrived: i32, f: &Fields) -> (Registers, Effect) {
    let (free, effect) = loihi::update(r, arrived, &Fields { fires_from: i32::MAX, ..*f });
    let spiked = free.v >= f.fires_from;
    let taken = if spiked { (f.neuron.vth.get() as i32) << THRESHOLD_SHIFT } else { 0 };
    (Registers { v: free.v - taken, ..free }, Effect { spiked, ..effect })
}
