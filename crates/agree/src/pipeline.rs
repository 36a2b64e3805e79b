//! Missing steps of a network, compared with a tool whose layers all answer in one step.
//!
//! Input: a network. Output: the depth of each population, the waits of spikes that skip layers,
//! and the steps that a sample needs after its input. A population of depth k computes in step t +
//! k the result of the tool's step t (`docs/import.md`, Time). A sample that ends with its input
//! cuts off the last answers of the output, which may give another class.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use nsim_ir::base::depths::depths;
use nsim_ir::base::fixed::Delay;
use nsim_ir::graph::{Graph, PopulationKind};

/// The delays of a network's layers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pipeline {
    /// Depth of each population, in the order of the file.
    depths: Vec<u32>,
    inputs: Vec<bool>,
    /// Whether each population is an input or reached by one.
    layers: Vec<bool>,
    loops: BTreeSet<(usize, usize)>,
    /// Whether spikes that skip layers still need a delay.
    waits: bool,
    /// The longest wait.
    pub longest_wait: u32,
    /// Steps that each sample has after its input.
    drained: u32,
    /// Steps that each sample needs after its input.
    pub drain: u32,
}

impl Pipeline {
    /// Missing steps of a network. `None` where its samples have a step for each layer after the
    /// first, or it has one layer. Also `None` where training includes a layer's step (spike
    /// response neurons; integers that a tool of the chip wrote).
    pub fn missing(graph: &Graph) -> Option<Pipeline> {
        let kinds: Vec<&PopulationKind> = graph.populations().map(|(_, population)| &population.kind).collect();
        let inputs: Vec<bool> = kinds.iter().map(|kind| matches!(kind, PopulationKind::Input)).collect();
        let real = kinds.iter().any(|kind| matches!(kind, PopulationKind::Neurons(p) if p.real("vth").is_some()));
        if graph.has_srm() || !real && graph.facts().provenance.is_some() {
            return None;
        }
        let ways: BTreeSet<(usize, usize)> =
            graph.projections().map(|(_, from, to, _)| (from.index(), to.index())).collect();
        let order = reached(&inputs, &ways);
        let mut place = vec![0; order.len()];
        order.iter().enumerate().for_each(|(at, &population)| place[population] = at);
        // A population without a path from an input is no layer, such as a compartment for a bias.
        let layers = driven(&inputs, &ways);
        let mut sources = vec![Vec::new(); order.len()];
        let between = ways.iter().filter(|(from, _)| layers[*from]);
        between.for_each(|&(from, to)| sources[place[to]].push(place[from]));
        let (by_place, loops) = depths(&sources, |at| inputs[order[at]]);
        let depths: Vec<u32> = place.iter().map(|&at| by_place[at]).collect();
        let (drain, drained) = (depths[graph.output().index()], graph.facts().drain);
        let started = kinds.iter().any(|kind| matches!(kind, PopulationKind::Neurons(p) if p.start_step > 0));
        let loops = loops.into_iter().map(|(from, to)| (order[from], order[to])).collect();
        let pipeline = Pipeline { depths, inputs, layers, loops, waits: !started, longest_wait: 0, drained, drain };
        let longest_wait = ways.iter().map(|&(from, to)| pipeline.wait(from, to)).max().unwrap_or(0);
        (drain > drained).then_some(Pipeline { longest_wait, ..pipeline })
    }

    /// The first step of a population.
    pub fn start_step(&self, population: usize) -> u32 {
        self.depths[population]
    }

    /// Steps that a spike waits for spikes on longer paths.
    pub fn wait(&self, from: usize, to: usize) -> u32 {
        let arrives = match self.inputs[from] {
            true => 0,
            false => self.depths[from] + u32::from(!self.loops.contains(&(from, to))),
        };
        if self.waits && self.layers[from] { self.depths[to].saturating_sub(arrives) } else { 0 }
    }

    /// Steps to add to a sample.
    pub fn more_steps(&self) -> u32 {
        self.drain - self.drained
    }

    /// End of the steps in which the tool's population runs too, for a sample of `steps`.
    pub fn window(&self, population: usize, steps: u32) -> u32 {
        steps - self.drained.min(steps) + self.depths[population]
    }

    /// Arguments of `--set` that add the missing steps and delays. `None` where spikes of one
    /// declared projection would need several delays, or a delay is out of range.
    pub fn changes(&self, graph: &Graph) -> Option<Vec<String>> {
        let mut changes = vec![format!("drain={}", self.drain)];
        for (node, population) in graph.populations() {
            let PopulationKind::Neurons(parameters) = &population.kind else { continue };
            let depth = self.depths[node.index()];
            if depth > parameters.start_step {
                changes.push(format!("populations.{}.start_step={depth}", population.name));
            }
        }
        let mut waits: BTreeMap<usize, (u32, u32)> = BTreeMap::new();
        for ((_, from, to, projection), place) in graph.projections().zip(graph.declared_places()) {
            let (delay, wait) = (u32::from(projection.delay.get()), self.wait(from.index(), to.index()));
            (waits.entry(place).or_insert((delay, wait)).1 == wait).then_some(())?;
        }
        for (place, (delay, wait)) in waits.into_iter().filter(|(_, (_, wait))| *wait > 0) {
            Delay::new(i64::from(delay + wait)).ok()?;
            changes.push(format!("projections.{place}.delay={}", delay + wait));
        }
        Some(changes)
    }
}

/// Whether each population is an input or reached by one.
fn driven(inputs: &[bool], ways: &BTreeSet<(usize, usize)>) -> Vec<bool> {
    let mut driven = inputs.to_vec();
    let mut next: Vec<usize> = (0..inputs.len()).filter(|&node| inputs[node]).collect();
    while let Some(from) = next.pop() {
        for &(_, to) in ways.range((from, 0)..=(from, usize::MAX)) {
            if !std::mem::replace(&mut driven[to], true) {
                next.push(to);
            }
        }
    }
    driven
}

/// Populations in the order in which spikes reach them; inputs and sourceless ones come first.
fn reached(inputs: &[bool], ways: &BTreeSet<(usize, usize)>) -> Vec<usize> {
    let fed: BTreeSet<usize> = ways.iter().filter(|(from, to)| from != to).map(|&(_, to)| to).collect();
    let mut order: Vec<usize> = (0..inputs.len()).filter(|&node| inputs[node]).collect();
    order.extend((0..inputs.len()).filter(|&node| !inputs[node] && !fed.contains(&node)));
    let mut seen = vec![false; inputs.len()];
    order.iter().for_each(|&node| seen[node] = true);
    let mut next: VecDeque<usize> = order.iter().copied().collect();
    let mut rest = 0..inputs.len();
    loop {
        // Loops that no input reaches follow in the order of the file.
        let Some(from) = next.pop_front().or_else(|| rest.find(|&node| !seen[node])) else { return order };
        if !std::mem::replace(&mut seen[from], true) {
            order.push(from);
        }
        for &(_, to) in ways.range((from, 0)..=(from, usize::MAX)) {
            if !std::mem::replace(&mut seen[to], true) {
                order.push(to);
                next.push_back(to);
            }
        }
    }
}
