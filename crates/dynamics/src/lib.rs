//! One description of each neuron kind, which everything but the golden interpreter takes it from.
//!
//! A kind's file states its state fields and their widths, its scalar update, when it is at rest,
//! the bounds on its state that pruning and early exit need, what it emits, and the same dynamics
//! in real numbers. The names and ranges of its parameters are in [`nsim_ir::neurons`], where the
//! reader of model files finds them. `golden` computes each kind again from `docs/semantics.md`,
//! and the machine's vector form is held against the scalar update here.
//!
//! To add a kind: its file, [`kind`] and [`update`] here, its table in `desc::neurons`, its
//! arithmetic in `golden`.

pub mod arithmetic;
mod integrate_fire;
mod kind;
mod loihi;
mod soft_reset;
pub mod synapses;

pub use kind::{Arrivals, Effect, Fields, Kind, RealForm, Registers, StateField};

use std::num::NonZeroU32;

use nsim_ir::arithmetic::{Semantics, ThresholdTest};
use nsim_ir::graph::{Graph, NeuronParameters, PopulationKind};
use nsim_ir::neurons::NeuronKind;
use nsim_ir::quantised::{Neuron, Quantised, Units};

/// The description of a kind.
#[must_use]
pub fn kind(kind: NeuronKind) -> &'static Kind {
    match kind {
        NeuronKind::Loihi => &loihi::KIND,
        NeuronKind::If => &integrate_fire::KIND,
        NeuronKind::SoftReset => &soft_reset::KIND,
    }
}

/// One update with `arrived` units of 64.
#[inline]
#[must_use]
pub fn update(r: Registers, arrived: i32, f: &Fields) -> (Registers, Effect) {
    match f.neuron.kind {
        NeuronKind::Loihi | NeuronKind::If => loihi::update(r, arrived, f),
        NeuronKind::SoftReset => soft_reset::update(r, arrived, f),
    }
}

/// What the updates of a compartment read.
#[must_use]
pub fn fields(neuron: &Neuron, start_step: u32, semantics: Semantics, test: ThresholdTest) -> Fields {
    (kind(neuron.kind).fields)(neuron, start_step, semantics, test)
}

/// Equation (8): what the chip's voltage register reads after an update.
#[must_use]
pub fn voltage_register(neuron: &Neuron, semantics: Semantics, r: &Registers, spiked: bool) -> i32 {
    (kind(neuron.kind).voltage_register)(neuron, semantics, r, spiked)
}

/// Whether a compartment may ever spike; false only with a proof.
#[must_use]
pub fn may_spike(neuron: &Neuron, semantics: Semantics, test: ThresholdTest, arrivals: Arrivals) -> bool {
    let fires_from = i64::from(fields(neuron, 0, semantics, test).fires_from);
    (kind(neuron.kind).greatest_voltage)(neuron, semantics, arrivals).is_none_or(|v| v >= fires_from)
}

/// The least number of steps from a spike to the next when no reset falls between them; `None` when
/// there is no next.
#[must_use]
pub fn shortest_interval(neuron: &Neuron, semantics: Semantics) -> Option<NonZeroU32> {
    (kind(neuron.kind).shortest_interval)(neuron, semantics)
}

/// A compartment of a model in real numbers, at so many ms a timestep.
#[must_use]
pub fn model(parameters: &NeuronParameters, index: u32, timestep_ms: f64, semantics: Semantics) -> RealForm {
    let endless = parameters.value("refractory", index) < 1.0;
    (kind(parameters.kind).model)(parameters, index, timestep_ms).under(semantics, endless)
}

/// The threshold of every compartment in register units, at least one mantissa unit.
#[must_use]
pub fn thresholds(network: &Quantised) -> Vec<f64> {
    let of_population = |population: &nsim_ir::quantised::Population| match &population.units {
        Units::Compartments { neurons, .. } => (0..population.shape.len())
            .map(|index| RealForm::of_neuron(&neurons.get(index), network.parts().semantics).threshold.max(64.0))
            .collect(),
        Units::Input(_) => Vec::new(),
    };
    network.populations().iter().flat_map(of_population).collect()
}

/// The threshold of every neuron of a model in its own units.
#[must_use]
pub fn model_thresholds(graph: &Graph) -> Vec<f64> {
    let facts = graph.facts();
    let of_population = |population: &nsim_ir::graph::Population| -> Vec<f64> {
        let count = population.shape.len();
        match &population.kind {
            PopulationKind::Input => Vec::new(),
            PopulationKind::Srm(srm) => vec![srm.theta; count as usize],
            PopulationKind::Neurons(p) => {
                let least = if p.get("vth").is_some() { f64::MIN } else { 64.0 };
                (0..count)
                    .map(|index| model(p, index, facts.timestep_ms, facts.semantics).threshold.max(least))
                    .collect()
            }
        }
    };
    graph.populations().flat_map(|(_, population)| of_population(population)).collect()
}
