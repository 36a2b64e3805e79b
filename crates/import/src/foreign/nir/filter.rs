//! Potentials that are sent on: an integrator (LI, CubaLI, I) before weights.
//!
//! Input: integrators from which a path leads to a neuron. Output: a [`Filter`] of that neuron, in
//! place of a population. A compartment sends spikes only, so an integrator that sends its
//! potential cannot be one. But weights and a filter that is the same in all units commute, so `LI,
//! Linear, LIF` is a neuron with a current, CubaLIF, and `LI, Threshold` a neuron without a reset.
//!
//! Errors: `import.unsupported` where the filter is not the same for all sources of a sum, where a
//! potential is sent and read, or passes two filters.

use std::collections::BTreeSet;

use super::node_types::{FILTER, is_population};
use super::state::{Reader, all, optional, parameter, unsupported, wrong};
use nsim_files::network::Parameter;
use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// An integrator whose potential is the input of a neuron.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Filter {
    pub(super) name: String,
    /// Time constant in seconds; none for an integrator without decay.
    pub(super) tau: Option<Parameter>,
    /// Factor of its input.
    pub(super) r: Parameter,
    /// Time constant and factor of its own current.
    pub(super) current: Option<(Parameter, Parameter)>,
}

impl Filter {
    /// Whether all units have one filter, so that it commutes with weights.
    pub(super) fn is_uniform(&self) -> bool {
        self.numbers().all(|numbers| numbers.values().len() == 1)
    }

    /// Its parameters, each with one number for all units or one for each.
    fn numbers(&self) -> impl Iterator<Item = &Parameter> {
        self.tau.iter().chain([&self.r]).chain(self.current.iter().flat_map(|(tau, w_in)| [tau, w_in]))
    }

    /// Whether another filter has the same numbers.
    fn equals(&self, other: &Filter) -> bool {
        (&self.tau, &self.r, &self.current) == (&other.tau, &other.r, &other.current)
    }
}

/// The refusal of a potential that cannot become a current.
pub(super) fn cannot_send(name: &str, kind: &str, why: &str) -> Diagnostic {
    unsupported(
        format!("'{name}' ({kind}) sends its potential, {why}"),
        "a core sends spikes: put neurons after it, or give the neurons that receive it a current of their own \
         (CubaLIF)",
    )
}

impl Reader<'_> {
    /// Turns every integrator that sends its potential to a neuron into a filter of that neuron.
    pub(super) fn find_filters(&mut self) -> Result<()> {
        let integrators =
            self.flat.nodes.iter().filter(|(_, node)| matches!(node.kind.as_str(), "LI" | "CubaLI" | "I"));
        let names: Vec<String> = integrators.map(|(name, _)| name.clone()).collect();
        for name in names {
            let (neurons, outputs) = self.receivers(&name);
            if neurons.is_empty() {
                continue;
            }
            let kind = self.flat.nodes[&name].kind.clone();
            if let Some(output) = outputs.first() {
                return Err(cannot_send(&name, &kind, &format!("which is also the output '{output}'")));
            }
            if let Some(node) = self.flat.nodes.get_mut(&name) {
                node.kind = FILTER.to_string();
                node.integrator = kind;
            }
            let receiver = &neurons[0];
            self.notes.push(format!("'{name}' sends its potential, so it becomes the current of '{receiver}'"));
        }
        Ok(())
    }

    /// The populations and outputs that a node's paths lead to.
    fn receivers(&self, from: &str) -> (Vec<String>, Vec<String>) {
        let (mut neurons, mut outputs) = (Vec::new(), Vec::new());
        let (mut open, mut visited) = (vec![from.to_string()], BTreeSet::new());
        while let Some(name) = open.pop() {
            for to in self.successors(&name) {
                let kind = self.flat.nodes[to].kind.as_str();
                if !visited.insert(to.clone()) {
                    continue;
                }
                match kind {
                    "Output" => outputs.push(to.clone()),
                    _ if is_population(kind) => neurons.push(to.clone()),
                    _ => open.push(to.clone()),
                }
            }
        }
        (neurons, outputs)
    }

    /// The nodes at the ends of the edges that leave a node.
    pub(super) fn successors(&self, name: &str) -> impl Iterator<Item = &String> {
        let from = (name.to_string(), String::new());
        let leaving = self.flat.edges.range(from..).take_while(move |(source, _)| source == name);
        leaving.map(|(_, to)| to)
    }

    /// The filter of an integrator that sends its potential, of `units` units.
    pub(super) fn filter(&self, name: &str, units: usize) -> Result<Filter> {
        let node = &self.flat.nodes[name];
        let group = node.group;
        if !all(&optional(group, name, "v_leak", 0.0)?, |leak| leak == 0.0) {
            return Err(cannot_send(name, &node.integrator, "which rests at its v_leak"));
        }
        let (tau, current) = match node.integrator.as_str() {
            "CubaLI" => {
                let tau = parameter(group, name, "tau_mem")?;
                (Some(tau), Some((parameter(group, name, "tau_syn")?, optional(group, name, "w_in", 1.0)?)))
            }
            "LI" => (Some(parameter(group, name, "tau")?), None),
            _ => (None, None),
        };
        let filter = Filter { name: name.to_string(), tau, r: optional(group, name, "r", 1.0)?, current };
        let other_count = filter.numbers().map(|numbers| numbers.values().len()).find(|&n| n != 1 && n != units);
        match other_count {
            None => Ok(filter),
            Some(count) => Err(wrong(format!("node '{name}' has {count} numbers for {units} units"))),
        }
    }

    /// The filter on all paths to a population; none if no path has one.
    pub(super) fn filter_before(&self, name: &str) -> Result<Option<Filter>> {
        let mut filters: Vec<Option<Filter>> = Vec::new();
        for path in self.paths(name)? {
            let filter = self.linear_map(&self.shapes[&path[0]], &path[1..])?.filter;
            filters.push(filter);
        }
        let Some(first) = filters.iter().flatten().next().cloned() else { return Ok(None) };
        let kind = self.flat.nodes[&first.name].integrator.as_str();
        if !filters.iter().all(|filter| filter.as_ref().is_some_and(|filter| filter.equals(&first))) {
            let why = format!("but '{name}' has other inputs that do not pass the same filter");
            return Err(cannot_send(&first.name, kind, &why));
        }
        if first.current.is_some() && self.flat.nodes[name].kind != "Threshold" {
            return Err(cannot_send(&first.name, kind, &format!("of two time constants, to '{name}'")));
        }
        Ok(Some(first))
    }
}
