//! Networks in the neuromorphic intermediate representation (`.nir`, HDF5).
//!
//! Input: the tree of a file. Output: a model with one population for each node that has a state.
//! The nodes between two populations (`Linear`, `Affine`, `Scale`, `Conv1d`, `Conv2d`, `SumPool2d`,
//! `AvgPool2d`, `Flatten`, `Delay`) become one projection. Nested graphs are inlined; edges may
//! form cycles.
//!
//! - `graph`: inlining of nested graphs, and the paths between populations; `depth`: layers.
//! - `timestep`: the timestep; `neuron`: a node with a state; `filter`: potentials that are sent;
//!   `connection` and `linear`: the nodes of a path; `assumptions`: what the file does not state.
//! - `projections`: the projections of a path.
//! - `node_types`: types of nodes and their fields; `state`: the model so far, limits and errors.
//! - `export`: a model as a NIR file.
//!
//! The equations are in continuous time (NIR 7232ada, `docs/source/primitives.md`). They are
//! discretised like in their exporters, by Euler's rule with the new current: `I <- (1 - dt /
//! tau_syn) I + (dt / tau_syn) w_in x`, `v <- (1 - dt / tau_mem) v + (dt / tau_mem) (R I +
//! v_leak)`. So the effective decays are `4096 dt / tau`: exact in the model, as a time constant of
//! `-dt / ln(1 - dt / tau)`, and rounded on the chip. A weight of 1 is `(dt / tau_syn) w_in (dt /
//! tau_mem) R` in units of the threshold. A tool's conventions replace these rules
//! (`foreign::conventions`). A bias is added to v where the current has no memory; otherwise a
//! compartment that spikes in every step delivers it, from step 1 on. A model that nsim exported is
//! recognised and restored ([`export`]).
//!
//! snnTorch subtracts in the step after the spike: `v <- b v + I - theta`, where b is the share that
//! a step keeps. SoftReset subtracts at the spike: `v <- b (v - theta) + I`. A synapse of `-(1 - b)
//! theta` from each neuron to itself makes the two equal, one of `b theta` cancels the reset. If a
//! step keeps the share a of the current, a second synapse of -a times its weight, a step later,
//! cancels the remainder of the first.
//!
//! Not imported: resets to values other than zero and the rest potential, for which a core has no
//! circuit.

mod assumptions;
mod connection;
mod depth;
pub mod export;
mod filter;
mod graph;
mod linear;
mod neuron;
mod node_types;
mod projections;
mod state;
mod timestep;

use std::collections::{BTreeMap, BTreeSet};

use super::conventions::ResetMode;
use super::imported::{Imported, MAX_THRESHOLD, Options, wrong_option};
use crate::hdf5::Group;
use graph::unfold;
use neuron::{Discrete, Reset};
use node_types::{Flat, WITHOUT_MEANING, fields, is_population};
use nsim_files::network::{NetworkFile, Parameter, PopulationDesc};
use nsim_ir::base::diagnostic::Result;
use nsim_ir::neurons::NeuronKind;
use state::{Reader, axes, unsupported, wrong};

/// Reads the tree of a file.
pub fn read(root: &Group, name: &str, options: &Options) -> Result<Imported> {
    let graph = root.group("node").ok_or_else(|| wrong("there is no group 'node'"))?;
    let mut notes = Vec::new();
    let written = export::restore(root, "node/metadata", ["node/nodes", "node/edges"], "nodes", export::export);
    if let Some(imported) = unmodified_model("NIR", written, options, &mut notes)? {
        let subtracts = imported.model.populations.iter().any(|population| population.kind == NeuronKind::SoftReset);
        let reset = if subtracts { options.reading.reset.unwrap_or(ResetMode::Subtract) } else { ResetMode::Zero };
        return Ok(Imported { reset: Some(reset), ..imported });
    }
    if graph.text("type") != Some("NIRGraph") {
        return Err(wrong("its root is not a NIRGraph"));
    }
    let mut flat = Flat::default();
    unfold(graph, "", 0, &mut flat)?;
    let mut model = NetworkFile::new(name, 1.0);
    model.threshold = options.threshold();
    let mut reader = Reader {
        flat,
        options,
        model,
        notes,
        warnings: Vec::new(),
        names: BTreeMap::new(),
        shapes: BTreeMap::new(),
        depths: BTreeMap::new(),
        loops: BTreeSet::new(),
        dt: 0.0,
        dt_in_file_units: 0.0,
        listed: 0,
    };
    reader.network()?;
    let Reader { model, notes, warnings, .. } = reader;
    let resets = model.populations.iter().any(|population| population.loihi.is_some());
    let reset = resets.then_some(options.reset_of("LIF"));
    let imported = Imported::new("NIR", model, notes).with_warnings(warnings).with_decision(options.decision);
    Ok(Imported { reset, ..imported.with_provenance("a NIR file") })
}

/// The model that nsim wrote into a file, which no option may contradict. `None` if nsim did not
/// write the file, or, with a note, if it was changed.
pub(super) fn unmodified_model(
    kind: &'static str,
    written: Option<Result<NetworkFile, String>>,
    options: &Options,
    notes: &mut Vec<String>,
) -> Result<Option<Imported>> {
    let mut model = match written {
        Some(Ok(model)) => model,
        Some(Err(why)) => {
            notes.push(format!("written by nsim, but {why}: read like a file of another tool"));
            return Ok(None);
        }
        None => return Ok(None),
    };
    let mut neurons = model.populations.iter().filter(|population| population.loihi.is_some());
    let subtracts = neurons.any(|population| population.kind == NeuronKind::SoftReset);
    let contradicted = match options.reading.reset {
        None => None,
        Some(ResetMode::Zero) => subtracts.then_some("--reset zero"),
        Some(_) => (!subtracts).then_some("--reset by subtraction"),
    };
    let other_test = options.threshold.is_some_and(|threshold| threshold != model.threshold).then_some("--threshold");
    let other_step = options.reading.dt_ms.is_some_and(|dt| (dt / model.timestep_ms - 1.0).abs() > 1e-9);
    let decay = options.decay.map(|_| "--decay");
    let tool = options.reading.tool.map(|_| "--from");
    if let Some(option) = contradicted.or(other_test).or(decay).or(tool).or(other_step.then_some("--dt")) {
        let dt = model.timestep_ms;
        let message = format!("the file holds a model of nsim with a timestep of {dt} ms, which {option} contradicts");
        return Err(wrong_option(message).help("remove the option: the model is restored unchanged"));
    }
    model.decision = options.decision.unwrap_or(model.decision);
    let notes = vec!["written by nsim and not modified since: restored unchanged".to_string()];
    Ok(Some(Imported::new(kind, model, notes)))
}

impl Reader<'_> {
    fn network(&mut self) -> Result<()> {
        self.check_kinds()?;
        self.find_timestep()?;
        self.find_filters()?;
        let populations: Vec<String> = self
            .flat
            .nodes
            .iter()
            .filter(|(_, node)| is_population(&node.kind))
            .map(|(name, _)| name.clone())
            .collect();
        self.name_populations(&populations)?;
        self.find_shapes(&populations)?;
        let order = self.order(&populations);
        self.find_depths(&order)?;
        let mut discrete = BTreeMap::new();
        for name in &order {
            let neuron = self.discretise(name)?;
            discrete.insert(name.clone(), neuron);
        }
        self.note_rounded_delays()?;
        self.wait_for_biases(&order, &discrete)?;
        for name in &order {
            let population = self.population(name, discrete[name].as_ref());
            self.model.populations.push(population);
        }
        for name in &order {
            if let Some(neuron) = &discrete[name] {
                self.incoming(name, neuron)?;
            }
        }
        self.output(&order)?;
        self.warn_of_assumptions(&discrete);
        self.warn_of_unused_edges();
        self.model.timestep_ms = self.dt * 1e3;
        Ok(())
    }

    /// A node as a population, without its projections and bias.
    fn population(&self, name: &str, neuron: Option<&Discrete>) -> PopulationDesc {
        let (start_step, input) =
            (self.depths[name], PopulationDesc::input(&self.names[name], axes(&self.shapes[name])));
        let Some(neuron) = neuron else { return PopulationDesc { start_step, ..input } };
        let [tau_u, tau_v] = neuron.taus.clone();
        let threshold = match &neuron.threshold {
            Some(Parameter::Same(0.0)) => ("vth_mant", Parameter::Same(0.0)),
            Some(threshold) => ("vth", threshold.clone()),
            None => ("vth_mant", Parameter::Same(MAX_THRESHOLD)),
        };
        let parameters = vec![
            tau_u.map_or(("du", neuron.du.clone()), |tau| ("tau_u_ms", tau)),
            tau_v.map_or(("dv", neuron.dv.clone()), |tau| ("tau_v_ms", tau)),
            threshold,
        ];
        let kind = match neuron.reset {
            Reset::Mode(ResetMode::Zero) => NeuronKind::Loihi,
            _ => NeuronKind::SoftReset,
        };
        PopulationDesc { loihi: Some(parameters), kind, start_step, ..input }
    }

    fn check_kinds(&self) -> Result<()> {
        for (name, node) in &self.flat.nodes {
            let known = fields(&node.kind);
            let mut keys = node.group.items.keys().map(String::as_str);
            let unknown = keys.find(|key| !known.contains(key) && !WITHOUT_MEANING.contains(key));
            if let (false, Some(key)) = (known.is_empty(), unknown) {
                return Err(unsupported(
                    format!("node '{name}' has field '{key}', which nodes of type '{}' do not support", node.kind),
                    "remove it if the network does not depend on it",
                ));
            }
            if known.is_empty() {
                return Err(unsupported(
                    format!("node '{name}' has type '{}', which is not supported", node.kind),
                    "supported types: Input, Output, Linear, Affine, Scale, CubaLIF, LIF, IF, CubaLI, LI, I, \
                     Threshold, Conv1d, Conv2d, SumPool2d, AvgPool2d, Flatten, Delay and graphs of them",
                ));
            }
        }
        Ok(())
    }
}
