//! The semantics of a network: the update of each neuron kind, the scaling of weights, the
//! enumeration of synapses. All crates but the golden interpreter take them from here.
//!
//! The names and ranges of a kind's parameters and its words of state are in [`nsim_ir::neurons`].
//! Kinds with the registers of Loihi 1 share one form ([`Kind`], [`Fields`]), which the machine
//! also updates as vectors. Each has its scalar update, its idle test, its bounds on the state for
//! pruning and early exit, and its dynamics in real numbers. Other kinds are in [`kinds`]. `golden`
//! computes each again from the equations in `docs`.

pub mod arithmetic;
mod integrate_fire;
mod kind;
pub mod kinds;
pub mod learning;
mod loihi;
pub mod pes;
mod soft_reset;
pub mod synapses;

pub use kind::{Arrivals, Effect, Fields, Kind, RealForm, Registers};

use std::num::NonZeroU32;

use nsim_ir::arithmetic::{Semantics, ThresholdTest};
use nsim_ir::base::fixed::{OutOfRange, Refractory, WEIGHT_SHIFT};
use nsim_ir::graph::{Graph, NeuronParameters, PopulationKind};
use nsim_ir::neurons::{NeuronKind, ParameterRow, Role};
use nsim_ir::quantised::{Neuron, Neurons, Population, Quantised};

/// The description of a kind with the registers of Loihi 1.
fn kind(kind: NeuronKind) -> &'static Kind {
    match kind {
        NeuronKind::If => &integrate_fire::KIND,
        NeuronKind::SoftReset => &soft_reset::KIND,
        _ => &loihi::KIND,
    }
}

/// Arithmetics in which a kind is defined.
pub fn semantics(of: NeuronKind) -> &'static [Semantics] {
    if of.table().registers { kind(of).semantics } else { &[Semantics::Hardware] }
}

/// Parameters that an arithmetic lacks (`docs/semantics.md`, 11), and why.
const LACKING: [(Semantics, &str, &str); 6] = [
    (Semantics::Lava, "refractory", "lava's LIF has no refractory period (its LIFRefractory is another process)"),
    (Semantics::Lava, "vmin_exp", "lava's LIF clips v to 24 bits"),
    (Semantics::Lava, "vmax_exp", "lava's LIF clips v to 24 bits"),
    (Semantics::Slayer, "bias_mant", "SLAYER's kernel has no bias"),
    (Semantics::Slayer, "vmin_exp", "SLAYER's kernel does not clip v"),
    (Semantics::Slayer, "vmax_exp", "SLAYER's kernel does not clip v"),
];

/// Parameters of a population that have an effect on the chip and none in this arithmetic, with the
/// reason.
pub fn ignored_parameters(neurons: &Neurons, semantics: Semantics) -> Vec<(&'static str, &'static str)> {
    fn differs(name: &str, neuron: &Neuron) -> bool {
        match name {
            // A refractory period of 0 behaves as 1.
            "refractory" => neuron.refractory > Refractory::ONE,
            _ => neuron.parameter(name) != Neuron::PLAIN.parameter(name),
        }
    }
    let lacking = LACKING.into_iter().filter(|(of, name, _)| *of == semantics && neurons.any(|n| differs(name, n)));
    lacking.map(|(_, name, why)| (name, why)).collect()
}

/// Makes a compartment from the integers of its parameters, in the order of the table.
///
/// # Errors
/// [`OutOfRange`] for a parameter outside its range.
pub fn neuron(of: NeuronKind, values: &[i64]) -> Result<Neuron, OutOfRange> {
    if of.table().registers {
        return (kind(of).neuron)(values);
    }
    let mut row = ParameterRow::EMPTY;
    for ((place, parameter), &value) in row.0.iter_mut().zip(of.parameters()).zip(values) {
        *place = parameter.field.check(value)? as i32;
    }
    Ok(Neuron { kind: of, row, ..Neuron::PLAIN })
}

/// Computes one update with `arrived` units of 64.
#[inline]
pub fn update(r: Registers, arrived: i32, f: &Fields) -> (Registers, Effect) {
    match f.neuron.kind {
        NeuronKind::SoftReset => soft_reset::update(r, arrived, f),
        _ => loihi::update(r, arrived, f),
    }
}

/// Computes one update of a compartment of a neuron with several, or of one to whose arrivals and
/// to whose u + b integers are added; [`Fields::takes_added`]. `stack` is the value that its child
/// pushed, then its own; 0 where nothing is pushed.
#[inline]
pub fn update_added(
    r: Registers,
    arrived: i32,
    f: &Fields,
    stack: &mut i32,
    (to_q, to_bias): (i32, i32),
) -> (Registers, Effect) {
    let (Some(Role::Add) | None) = f.neuron.stack.pops;
    let whole = (i64::from(arrived) << WEIGHT_SHIFT) + i64::from(to_q);
    let (new, effect, pushed) = loihi::hardware(r, whole, f, stack.wrapping_add(to_bias));
    *stack = if f.neuron.stack.pushes { pushed } else { 0 };
    (new, effect)
}

/// Returns the inputs of the updates of a compartment with registers. For other kinds only the
/// start step has a meaning.
pub fn fields(neuron: &Neuron, start_step: u32, semantics: Semantics, test: ThresholdTest) -> Fields {
    let fields = (kind(neuron.kind).fields)(neuron, start_step, semantics, test);
    Fields { vectors: fields.vectors && neuron.kind.table().registers && neuron.stack.is_unused(), ..fields }
}

/// Equation (8): the chip's voltage register after an update.
pub fn voltage_register(neuron: &Neuron, semantics: Semantics, r: &Registers, spiked: bool) -> i32 {
    (kind(neuron.kind).voltage_register)(neuron, semantics, r, spiked)
}

/// Whether a compartment may ever spike; false only with a proof.
pub fn may_spike(neuron: &Neuron, semantics: Semantics, test: ThresholdTest, arrivals: Arrivals) -> bool {
    // Arrivals do not bound the value that a child pushes.
    if !neuron.kind.table().registers || neuron.stack.pops.is_some() {
        return true;
    }
    let fires_from = i64::from(fields(neuron, 0, semantics, test).fires_from);
    (kind(neuron.kind).greatest_voltage)(neuron, semantics, arrivals).is_none_or(|v| v >= fires_from)
}

/// Least number of steps between two spikes without a reset between them; `None` when there is no
/// second spike.
pub fn shortest_interval(neuron: &Neuron, semantics: Semantics) -> Option<NonZeroU32> {
    match neuron.kind.table().registers {
        true => (kind(neuron.kind).shortest_interval)(neuron, semantics),
        false => Some(NonZeroU32::MIN),
    }
}

/// A compartment of a model in real numbers, with the timestep in ms. [`Graph::has_real_form`] says
/// whether all compartments have such a form.
pub fn model(parameters: &NeuronParameters, index: u32, timestep_ms: f64, semantics: Semantics) -> RealForm {
    let endless = parameters.value("refractory", index) < 1.0;
    (kind(parameters.kind).model)(parameters, index, timestep_ms).under(semantics, endless)
}

/// The threshold of every compartment in register units, at least one mantissa unit.
pub fn thresholds(network: &Quantised) -> Vec<f64> {
    let threshold = |neuron: Neuron| RealForm::of_neuron(&neuron, network.parts().semantics).threshold.max(64.0);
    network.populations().iter().flat_map(Population::each_neuron).map(threshold).collect()
}

/// The threshold of every neuron of a model in its own units.
pub fn model_thresholds(graph: &Graph) -> Vec<f64> {
    let facts = graph.facts();
    let of_population = |population: &nsim_ir::graph::Population| -> Vec<f64> {
        let count = population.shape.len();
        match &population.kind {
            PopulationKind::Input => Vec::new(),
            PopulationKind::Srm(srm) => vec![srm.theta; count as usize],
            PopulationKind::Neurons(p) => {
                let least = if p.real("vth").is_some() { f64::MIN } else { 64.0 };
                (0..count)
                    .map(|index| model(p, index, facts.timestep_ms, facts.semantics).threshold.max(least))
                    .collect()
            }
        }
    };
    graph.populations().flat_map(|(_, population)| of_population(population)).collect()
}
