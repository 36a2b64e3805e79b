//! The mapping of a network as that of another one, which differs in the parameters of its neurons
//! alone.
//!
//! Input: a compiled network, another network. Output: what compiling that afresh would give, at a
//! fraction of the time. The compiler sees of neurons only their kinds and which of them share a
//! profile on a core; where these and everything else are equal it makes the same cores, and the
//! tables of synapses can be taken over. Limits are verified again, and parameters compared with
//! the network's; synapses were, when they were written.

use std::collections::HashMap;
use std::hash::Hash;

use crate::emit::route::parameters;
use crate::mapping::Compiled;
use nsim_check::{equivalence, verify};
use nsim_ir::base::fixed::{Decay, Refractory, ThresholdMantissa};
use nsim_ir::hardware::Target;
use nsim_ir::neurons::Row;
use nsim_ir::program::Program;
use nsim_ir::quantised::{Neuron, Parts, Population, Quantised, Units};
use nsim_partition::error::{CompileError, Result};
use nsim_quantise::copies::copies;

/// Numbers for values, in the order in which they are first seen.
#[derive(Debug)]
struct Classes<T>(HashMap<T, usize>);

impl<T: Hash + Eq> Classes<T> {
    fn number(&mut self, value: T) -> usize {
        let next = self.0.len();
        *self.0.entry(value).or_insert(next)
    }
}

/// What the compiler sees of neurons, one after the other.
struct Seen {
    profiles: Classes<(Decay, Decay, Refractory, Row)>,
    thresholds: Classes<(ThresholdMantissa, Row)>,
}

impl Seen {
    fn new() -> Self {
        Seen { profiles: Classes(HashMap::new()), thresholds: Classes(HashMap::new()) }
    }

    fn see(&mut self, neuron: &Neuron) -> (usize, usize) {
        (self.profiles.number(neuron.profile()), self.thresholds.number(neuron.threshold()))
    }
}

/// Whether two networks are mapped onto the same cores with the same tables, whatever the target.
#[must_use]
pub fn is_mapped_alike(a: &Quantised, b: &Quantised) -> bool {
    let (one, other) = (a.parts(), b.parts());
    let frame =
        |parts: &Parts| (parts.output, parts.decision, parts.semantics, parts.threshold, parts.reset, parts.gathers);
    if a.pruned().is_some() || b.pruned().is_some() || one.name != other.name || frame(one) != frame(other) {
        return false;
    }
    let described = |a: &Population, b: &Population| (&a.name, a.shape, a.message) == (&b.name, b.shape, b.message);
    let (mut in_one, mut in_other) = (Seen::new(), Seen::new());
    let mut alike = |a: &Population, b: &Population| match (&a.units, &b.units) {
        (Units::Input(a), Units::Input(b)) => a == b,
        (
            Units::Compartments { first, neurons: of_a, .. },
            Units::Compartments { first: other_first, neurons: of_b, .. },
        ) => {
            first == other_first
                && (0..a.shape.len()).all(|index| {
                    let (one, other) = (of_a.get(index), of_b.get(index));
                    one.kind == other.kind && in_one.see(&one) == in_other.see(&other)
                })
        }
        _ => false,
    };
    one.populations.len() == other.populations.len()
        && one.populations.iter().zip(&other.populations).all(|(a, b)| described(a, b) && alike(a, b))
        && one.projections == other.projections
}

/// A network on the cores of one that [`is_mapped_alike`], on the same target.
///
/// # Errors
/// [`CompileError::Fault`] when a check fails.
pub fn with_neurons_of(compiled: &Compiled, one: Quantised, target: &Target) -> Result<Compiled> {
    let Compiled { options, partition, placement, program, checked, placed, rates, .. } = compiled;
    let quantised = copies(&one, options.copies).map_err(CompileError::fault)?;
    let mut parts = program.parts().clone();
    for (class, &first) in program.first_cores().enumerate() {
        parts.classes[class].compartments = parameters(&quantised, &parts.cores[first].ids);
    }
    // Neurons of one class may differ now.
    for core in parts.cores.ids() {
        let own = parameters(&quantised, &parts.cores[core].ids);
        if parts.class_of(core).compartments != own {
            parts.class_mut(core).compartments = own;
        }
    }
    let program = Program::new(parts).map_err(CompileError::fault)?;
    verify::verify(&program, target).map_err(CompileError::fault)?;
    equivalence::check_neurons(&quantised, &program).map_err(CompileError::fault)?;
    Ok(Compiled {
        one,
        quantised,
        partition: partition.clone(),
        placement: placement.clone(),
        program: program.into(),
        checked: *checked,
        seconds: Vec::new(),
        target: target.name().to_string(),
        options: *options,
        placed,
        rates: rates.clone(),
    })
}
