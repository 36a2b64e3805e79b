//! Networks in the neuromorphic intermediate representation (`.nir`, HDF5).
//!
//! Comes in: the tree of a file. Goes out: a draft with one population for each node that keeps a state. What stands
//! between two populations (`Linear`, `Affine`, `Scale`, `Conv1d`, `Conv2d`, `SumPool2d`, `AvgPool2d`, `Flatten`,
//! `Delay`) becomes one projection; graphs within graphs are unfolded; edges may form cycles.
//!
//! The equations are of continuous time (NIR 7232ada, `docs/source/primitives.md`); they are discretised as their
//! exporters do, by Euler's rule with the new current: `I <- (1 - dt / tau_syn) I + (dt / tau_syn) w_in x`,
//! `v <- (1 - dt / tau_mem) v + (dt / tau_mem) (R I + v_leak)`. So the effective decays are `4096 dt / tau`, rounded to even, and
//! a weight counts `(dt / tau_syn) w_in (dt / tau_mem) R` in the units of the threshold. The timestep is not in a file:
//! it is `tau_mem / R` where that agrees with `tau_syn / w_in` in every node, or it has to be said. A bias goes to v where
//! the current has no memory; where it has one, a compartment that spikes in every step brings it, from step 1 on. A
//! model that nsim exported is recognised and restored as it was ([`super::nir_export`]).
//!
//! Left out on purpose: reset by subtraction and resets to other values than zero, for which a core has no circuit.

mod emit;
mod graph;
mod linear;
mod neuron;
mod ways;

use std::collections::BTreeMap;

use super::hdf5::Group;
use super::{Imported, NEVER, Options, ResetMode, nir_export};
use crate::base::diagnostic::Diagnostic;
use crate::io::draft::{Draft, DraftPopulation, Value};
use graph::{Flat, unfold};

/// Graphs within graphs.
const DEEPEST: usize = 8;
/// Nodes and edges of a file.
const MOST_NODES: usize = 1 << 14;
/// Ways from one population to another.
const MOST_WAYS: usize = 1 << 12;
/// The greatest units of a population.
const MOST_UNITS: usize = 1 << 22;

fn wrong(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("import.nir", message)
}

fn unsupported(message: impl Into<String>, help: &str) -> Diagnostic {
    Diagnostic::new("import.unsupported", message).help(help)
}

/// Reads the tree of a file.
///
/// # Errors
/// `import.nir` for what is malformed, `import.unsupported` for what a core cannot do, `import.option` for what the file
/// does not say.
pub fn read(root: &Group, name: &str, options: &Options) -> Result<Imported, Diagnostic> {
    let graph = root.group("node").ok_or_else(|| wrong("there is no group 'node'"))?;
    let mut notes = Vec::new();
    match nir_export::restore(root) {
        Some(Ok(draft)) => {
            notes.push("written by nsim and unchanged since: restored as it was".to_string());
            return Ok(Imported { kind: "NIR", draft, notes });
        }
        Some(Err(why)) => notes.push(format!("written by nsim, but {why}: read as any other file")),
        None => {}
    }
    if graph.text("type") != Some("NIRGraph") {
        return Err(wrong("its root is no NIRGraph"));
    }
    let mut flat = Flat::default();
    unfold(graph, "", 0, &mut flat)?;
    let mut reader = Reader {
        flat,
        options,
        draft: Draft::new(name, 1.0),
        notes,
        names: BTreeMap::new(),
        shapes: BTreeMap::new(),
        dt: 0.0,
        listed: 0,
    };
    reader.network()?;
    let Reader { mut draft, notes, .. } = reader;
    draft.provenance = Some(format!("imported from a NIR file; {}", notes.join("; ")));
    Ok(Imported { kind: "NIR", draft, notes })
}

fn product(shape: &[usize]) -> Option<usize> {
    shape.iter().try_fold(1usize, |product, &axis| product.checked_mul(axis)).filter(|&units| units <= MOST_UNITS)
}

struct Reader<'a> {
    flat: Flat<'a>,
    options: &'a Options,
    draft: Draft,
    notes: Vec<String>,
    /// Populations' names by node.
    names: BTreeMap<String, String>,
    /// Populations' shapes by node.
    shapes: BTreeMap<String, Vec<usize>>,
    /// Seconds of a timestep.
    dt: f64,
    listed: usize,
}

/// Whether a node keeps a state, or is an input.
fn is_population(kind: &str) -> bool {
    matches!(kind, "Input" | "CubaLIF" | "LIF" | "IF" | "CubaLI" | "LI" | "I" | "Threshold")
}

impl Reader<'_> {
    fn network(&mut self) -> Result<(), Diagnostic> {
        self.check_kinds()?;
        self.dt = self.timestep()?;
        let populations: Vec<String> = self
            .flat
            .nodes
            .iter()
            .filter(|(_, node)| is_population(&node.kind))
            .map(|(name, _)| name.clone())
            .collect();
        self.name_populations(&populations)?;
        self.find_shapes(&populations)?;
        // Inputs first, then the others in the order in which spikes reach them.
        let order = self.order(&populations);
        let mut discrete = BTreeMap::new();
        for name in &order {
            let neuron = self.discretise(name)?;
            discrete.insert(name.clone(), neuron);
        }
        let mut resets = false;
        for name in &order {
            let shape: Vec<u64> = self.shapes[name].iter().map(|&axis| axis as u64).collect();
            let loihi = discrete[name].as_ref().map(|neuron| {
                resets |= neuron.threshold.is_some();
                let mut parameters = vec![("du", neuron.du.clone()), ("dv", neuron.dv.clone())];
                match &neuron.threshold {
                    Some(threshold) => parameters.push(("vth", threshold.clone())),
                    None => parameters.push(("vth_mant", Value::Same(NEVER))),
                }
                parameters
            });
            let name = self.names[name].clone();
            self.draft.populations.push(DraftPopulation { name, shape, loihi, srm: None, start_step: 0 });
        }
        for name in &order {
            if let Some(neuron) = discrete.remove(name).flatten() {
                self.incoming(name, &neuron)?;
            }
        }
        self.output(&order)?;
        if resets && self.options.reset.is_none() {
            self.notes.push(
                "the file does not say how neurons reset; as on the chip v returns to zero (--reset zero says so; \
                 a network trained with reset by subtraction will differ)"
                    .to_string(),
            );
        }
        self.draft.timestep_ms = self.dt * 1e3;
        Ok(())
    }

    fn check_kinds(&self) -> Result<(), Diagnostic> {
        const LINEAR: [&str; 11] = [
            "Linear",
            "Affine",
            "Scale",
            "Conv1d",
            "Conv2d",
            "SumPool2d",
            "AvgPool2d",
            "Flatten",
            "Delay",
            "Pass",
            "Output",
        ];
        for (name, node) in &self.flat.nodes {
            if !is_population(&node.kind) && !LINEAR.contains(&node.kind.as_str()) {
                return Err(unsupported(
                    format!("node '{name}' is of the type '{}'", node.kind),
                    "imported are Input, Output, Linear, Affine, Scale, CubaLIF, LIF, IF, CubaLI, LI, I, Threshold, Conv1d, \
                     Conv2d, SumPool2d, AvgPool2d, Flatten, Delay and graphs of them",
                ));
            }
        }
        if self.options.reset == Some(ResetMode::Subtract) {
            return Err(unsupported(
                "neurons that subtract their threshold when they spike",
                "a compartment of Loihi returns to zero; train with a hard reset, or import with --reset zero and compare",
            ));
        }
        Ok(())
    }
}
