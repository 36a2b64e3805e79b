//! Reset by subtraction: a spike takes the threshold from the voltage, and nothing is held
//! afterwards.
//!
//! State: current u and voltage v, both of 24 bits. Each step is that of the Loihi compartment in
//! the chip's arithmetic, the only one in which the kind is defined, but for what follows a spike:
//! `v = v - 64 vth`, in the step of the spike, and no refractory period. At a spike v is at least
//! 64 vth, so that what is left is not negative. A spike carries the payload of its population, or
//! nothing. Loihi 1 has no such compartment; a chip says that it has one (`neuron_kinds`).
//!
//! *Bounds.* What is left after a spike lies between 0 and the voltage before it. So a bound X >= 0
//! on v with `decay(X) + drive <= X` holds as it does for a hard reset, and the bounds are those of
//! the Loihi compartment. The next spike may come in the next step.

use super::kind::{Effect, Fields, Kind, RealForm, Registers};
use super::loihi;
use nsim_ir::arithmetic::Semantics;
use nsim_ir::base::fixed::THRESHOLD_SHIFT;
use nsim_ir::neurons::NeuronKind;
use nsim_ir::quantised::Neuron;

/// The description.
pub(super) const KIND: Kind = Kind {
    semantics: &[Semantics::Hardware],
    neuron: |values| {
        // All but the refractory period, which is one step.
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

/// One update with `arrived` units of 64.
#[inline]
pub(super) fn update(r: Registers, arrived: i32, f: &Fields) -> (Registers, Effect) {
    let (free, effect) = loihi::update(r, arrived, &Fields { fires_from: i32::MAX, ..*f });
    let spiked = free.v >= f.fires_from;
    let taken = if spiked { (f.neuron.vth.get() as i32) << THRESHOLD_SHIFT } else { 0 };
    (Registers { v: free.v - taken, ..free }, Effect { spiked, ..effect })
}
