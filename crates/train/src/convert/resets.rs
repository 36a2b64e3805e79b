//! Reset by subtraction -> reset to zero, for targets whose compartments only clear the voltage.
//!
//! Input: a network with `SoftReset` populations. Output: this network with `Loihi` populations of
//! equal parameters, refractory period 1. The stages of the conversion measure the loss.

use nsim_ir::graph::{Graph, NeuronParameters, PopulationKind};
use nsim_ir::neurons::NeuronKind;

/// Whether neurons reset by subtraction.
pub(super) fn subtracts(kind: &PopulationKind) -> bool {
    matches!(kind, PopulationKind::Neurons(parameters) if parameters.kind == NeuronKind::SoftReset)
}

/// Whether a population of the network resets by subtraction.
pub fn has_soft_reset(graph: &Graph) -> bool {
    graph.populations().any(|(_, population)| subtracts(&population.kind))
}

/// The network with resets to zero.
pub fn to_zero(graph: &Graph) -> Graph {
    graph.with_kinds(|_, population| match &population.kind {
        PopulationKind::Neurons(parameters) if subtracts(&population.kind) => {
            PopulationKind::Neurons(NeuronParameters { kind: NeuronKind::Loihi, ..parameters.clone() })
        }
        other => other.clone(),
    })
}
