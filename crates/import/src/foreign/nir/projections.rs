//! Paths and neurons as projections and populations of a model.
//!
//! Input: paths that end at a population. Output: its projections and biases, and the output
//! population.

use std::collections::{BTreeMap, BTreeSet};

use super::linear::{Connection, Linear, Window, all_equal, delay_at, scaled};
use super::neuron::{Discrete, Reset};
use super::state::{Reader, all, axes, product, unsupported, wrong};
use crate::foreign::imported::{LONGEST_DELAY, always_spiking, integrator};
use crate::foreign::window::{MOST_LISTED, by_delay, synapse_list};
use nsim_files::network::{Parameter, PopulationDesc, ProjectionDesc, ProjectionKind, tensor};
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::warning::{Warning, WarningCode};

/// The diagnostic for too many listed synapses.
fn too_many_listed() -> Diagnostic {
    unsupported(
        format!("more than {MOST_LISTED} synapses would be listed individually"),
        "projections are listed by synapse unless they are a matrix or a window",
    )
}

impl Reader<'_> {
    /// Makes all layers start a step later if a bias of a current enters the first layer. The
    /// compartment that delivers biases first spikes in step 0, so they arrive from step 1 on.
    pub(super) fn wait_for_biases(
        &mut self,
        order: &[String],
        discrete: &BTreeMap<String, Option<Discrete>>,
    ) -> Result<()> {
        let mut waits = false;
        for name in order.iter().filter(|name| self.depths[*name] == 0) {
            let Some(neuron) = &discrete[name] else { continue };
            if all(&neuron.du, |du| du == 4096.0) {
                continue;
            }
            for path in self.paths(name)? {
                let arriving = self.linear_map(&self.shapes[&path[0]], &path[1..])?;
                waits |= arriving.bias.is_some() && arriving.filter.is_none();
            }
        }
        if waits {
            self.notes
                .push("layers start one step after their depth, when a bias first reaches the current".to_string());
        }
        let started = self.depths.iter_mut().filter(|(name, _)| self.flat.nodes[*name].kind != "Input");
        started.for_each(|(_, depth)| *depth += u32::from(waits));
        Ok(())
    }

    /// Adds all input of a population: projections, and its bias.
    pub(super) fn incoming(&mut self, name: &str, neuron: &Discrete) -> Result<()> {
        let shape = self.shapes[name].clone();
        let units = product(&shape).unwrap_or(0);
        let mut bias: Vec<f64> = (0..units).map(|unit| neuron.bias.get(unit)).collect();
        let mut current = Vec::new();
        let memory = !all(&neuron.du, |du| du == 4096.0);
        let mut projections = Vec::new();
        let mut added_biases = BTreeSet::new();
        for path in self.paths(name)? {
            let arrived = self.linear_map(&self.shapes[&path[0]], &path[1..])?;
            if product(&arrived.shape) != Some(units) {
                return Err(wrong(format!(
                    "'{name}' receives shape {:?}, but its parameters have shape {shape:?}",
                    arrived.shape
                )));
            }
            // The bias of a node on several paths counts once.
            let mut biased = (0..path.len()).rev().filter(|&at| self.flat.nodes[&path[at]].group.get("bias").is_some());
            let new = added_biases.insert(path[biased.next().unwrap_or(0)..].to_vec());
            let earlier = biased.filter(|&at| added_biases.insert(path[at..].to_vec())).count();
            if !new && earlier > 0 {
                return Err(unsupported(
                    format!("'{name}' receives a sum of layers with biases through another layer with a bias"),
                    "fold the biases of the summed layers into the bias of the layer after the sum",
                ));
            }
            if let Some(added) = arrived.bias.as_ref().filter(|_| new) {
                if arrived.filter.is_some() {
                    // Added to a potential, not to the current that it becomes.
                    self.check_bias_after_filter(name, neuron)?;
                    add(&mut bias, added, &neuron.voltage_gain);
                } else if memory {
                    current.resize(units, 0.0);
                    add(&mut current, added, &Parameter::Same(1.0));
                } else {
                    add(&mut bias, added, &neuron.gain);
                }
            }
            projections.extend(self.projections(&path[0], name, arrived, &neuron.gain)?);
        }
        if current.iter().any(|&b| b != 0.0) {
            let weights: Vec<f64> = current.iter().enumerate().map(|(i, b)| b * neuron.gain.get(i)).collect();
            let source = self.bias_source();
            let kind = ProjectionKind::Dense(tensor(vec![units, 1], weights));
            projections.push(ProjectionDesc::new(&source, &self.names[name], kind));
            self.notes.push(format!(
                "'{name}': its current needs a bias, so '{source}', a compartment that spikes in every step, was added"
            ));
        }
        let to = self.names[name].clone();
        projections.extend(self.own_reset(&to, neuron, units)?);
        let parameters = if matches!(neuron.threshold, None | Some(Parameter::Same(0.0))) {
            self.scale_freely(name, neuron.threshold.is_some(), &bias, &mut projections)?
        } else if bias.iter().any(|&b| b != 0.0) {
            vec![("bias", Parameter::from_values(bias))]
        } else {
            Vec::new()
        };
        let population = self.model.populations.iter_mut().find(|population| population.name == to);
        if let Some(loihi) = population.and_then(|population| population.loihi.as_mut()) {
            loihi.extend(parameters);
        }
        self.model.projections.extend(projections);
        Ok(())
    }

    /// Scales the input of a population without a threshold above 0, whose scale is free: the
    /// largest weight becomes 254, unless all are mantissas already. Returns the bias.
    fn scale_freely(
        &mut self,
        name: &str,
        spikes: bool,
        bias: &[f64],
        projections: &mut [ProjectionDesc],
    ) -> Result<Vec<(&'static str, Parameter)>> {
        let every: Vec<f64> = projections.iter().flat_map(|projection| weights(&projection.kind)).collect();
        let most = every.iter().fold(0.0, |most: f64, weight| most.max(weight.abs()));
        let mantissas = spikes && most <= 254.0 && every.iter().all(|weight| weight % 2.0 == 0.0);
        let scale = if most > 0.0 && !mantissas { 254.0 / most } else { 1.0 };
        for projection in projections {
            projection.weight_scale = Some(scale);
        }
        let mut parameters = Vec::new();
        if bias.iter().any(|&b| b != 0.0) {
            let register: Vec<f64> = bias.iter().map(|b| b * scale * 64.0).collect();
            let exponent = (0..=7)
                .find(|&e| register.iter().all(|b| (b / f64::from(1 << e)).abs() <= 4095.0))
                .ok_or_else(|| {
                    unsupported(format!("the bias of '{name}' is outside the range of its weights"), "scale it down")
                })?;
            let mantissas = register.iter().map(|b| (b / f64::from(1 << exponent)).round_ties_even()).collect();
            parameters.push(("bias_mant", Parameter::from_values(mantissas)));
            parameters.push(("bias_exp", Parameter::Same(f64::from(exponent))));
        }
        let rule = if spikes { "spikes above 0" } else { "never spikes" };
        self.notes.push(format!("'{name}' {rule}: a potential of 1 in the file is v = {}", scale * 64.0));
        Ok(parameters)
    }

    /// Refuses a bias between the potential of a filter and a threshold, which is no part of v.
    fn check_bias_after_filter(&self, name: &str, neuron: &Discrete) -> Result<()> {
        if neuron.reset != Reset::Never {
            return Ok(());
        }
        Err(unsupported(
            format!("a bias is added to the potential that '{name}' compares with its threshold"),
            "subtract it from the threshold",
        ))
    }

    /// Synapses from each neuron to itself that move the subtraction of the threshold to the step
    /// after the spike, or cancel it. SoftReset keeps the share b of v and subtracts the threshold
    /// theta at the spike: `-(1 - b) theta` a step later adds up to theta, `b theta` to 0.
    fn own_reset(&mut self, name: &str, neuron: &Discrete, units: usize) -> Result<Vec<ProjectionDesc>> {
        let Some(threshold) = &neuron.threshold else { return Ok(Vec::new()) };
        let first: Vec<f64> = (0..units).map(|unit| neuron.own_weight(unit) * threshold.get(unit)).collect();
        let kept_current = |unit: usize| 1.0 - neuron.du.get(unit) / 4096.0;
        let second = first.iter().enumerate().map(|(unit, weight)| -kept_current(unit) * weight).collect();
        let mut synapses = Vec::new();
        for (delay, weights) in [(0, first), (1, second)] {
            if weights.iter().any(|&weight| weight != 0.0) {
                self.count(units)?;
                let own = weights.iter().enumerate().map(|(i, &weight)| (i as u64, i as u64, weight)).collect();
                let kind = ProjectionKind::Sparse(own);
                synapses.push(ProjectionDesc { delay, ..ProjectionDesc::new(name, name, kind) });
            }
        }
        Ok(synapses)
    }

    /// An unused name: `wanted`, followed by underscores if it is taken.
    fn unused_name(&self, wanted: &str) -> String {
        let mut name = wanted.to_string();
        while self.names.values().any(|taken| *taken == name) {
            name.push('_');
        }
        name
    }

    /// The name of the compartment that spikes in every step, which is added if absent.
    pub(super) fn bias_source(&mut self) -> String {
        let name = self.unused_name("always");
        if self.model.population(&name).is_none() {
            self.model.populations.push(PopulationDesc::loihi(&name, vec![1], always_spiking()));
        }
        name
    }

    /// A connection as one projection, or one for each delay.
    pub(super) fn projections(
        &mut self,
        from: &str,
        to: &str,
        connection: Connection,
        gain: &Parameter,
    ) -> Result<Vec<ProjectionDesc>> {
        let target = self.shapes[to].clone();
        let source_units = product(&self.shapes[from]).unwrap_or(0);
        let units = product(&target).unwrap_or(0);
        let linear = scaled(connection.linear, gain.values(), &connection.shape).ok_or_else(|| self.too_many(to))?;
        let (before, behind) = (connection.source_delay, connection.delay);
        let own_delays = !all_equal(&before) || !all_equal(&behind);
        let kind = match linear {
            Linear::Dense(mut weights, sources) => {
                // The product may lack columns for the last sources.
                if sources < source_units {
                    let mut wide = vec![0.0; units * source_units];
                    for (row, old) in wide.chunks_exact_mut(source_units).zip(weights.chunks_exact(sources)) {
                        row[..sources].copy_from_slice(old);
                    }
                    weights = wide;
                }
                ProjectionKind::Dense(tensor(vec![units, source_units], weights))
            }
            Linear::Window(Window { sliding, kernel })
                if target == sliding.target && self.shapes[from] == sliding.source =>
            {
                let [size, stride, padding, dilation] =
                    [sliding.size, sliding.stride, sliding.padding, sliding.dilation]
                        .map(|(y, x)| (y as u64, x as u64));
                let padding_after = sliding.padding_after();
                match kernel {
                    Ok(kernel) => {
                        let axes = vec![sliding.target[0], sliding.per_group(), sliding.size.0, sliding.size.1];
                        let (weights, groups) = (tensor(axes, kernel), sliding.groups as u64);
                        ProjectionKind::Conv2d { weights, stride, padding, padding_after, dilation, groups }
                    }
                    Err(weight) => ProjectionKind::SumPool2d { kernel: size, stride, padding, padding_after, weight },
                }
            }
            other => ProjectionKind::Sparse(self.synapse_list(other, units, to)?),
        };
        let kind = if own_delays {
            let synapses = synapse_list(kind, &axes(&self.shapes[from]), &axes(&target));
            ProjectionKind::Sparse(synapses.ok_or_else(too_many_listed)?)
        } else {
            kind
        };
        if let ProjectionKind::Sparse(synapses) = &kind {
            self.count(synapses.len())?;
        }
        let waits = self.alignment_delay(from, to);
        let delay_of =
            |source: u64, target: u64| waits + delay_at(&before, source as usize) + delay_at(&behind, target as usize);
        let longest = waits + before.iter().max().unwrap_or(&0) + behind.iter().max().unwrap_or(&0);
        if f64::from(longest) > LONGEST_DELAY {
            return Err(unsupported(
                format!("delays from '{from}' to '{to}', padded to the longest path, are {longest} steps"),
                "the delay field holds 0 to 62 steps: shorten the skip connection",
            ));
        }
        let like = ProjectionDesc::new(&self.names[from], &self.names[to], ProjectionKind::Sparse(Vec::new()));
        Ok(match kind {
            ProjectionKind::Sparse(synapses) if own_delays => by_delay(&like, synapses, delay_of).collect(),
            kind => vec![ProjectionDesc { delay: delay_of(0, 0), kind, ..like }],
        })
    }

    /// Adds to the number of listed synapses, which is limited.
    pub(super) fn count(&mut self, synapses: usize) -> Result<()> {
        self.listed += synapses;
        if self.listed > MOST_LISTED { Err(too_many_listed()) } else { Ok(()) }
    }

    /// Sets the output population: the one before the output node, or, after weights, integrators.
    pub(super) fn output(&mut self, order: &[String]) -> Result<()> {
        let outputs: Vec<String> =
            self.flat.nodes.iter().filter(|(_, node)| node.kind == "Output").map(|(name, _)| name.clone()).collect();
        let mut leading: Vec<(Vec<String>, String)> = Vec::new();
        for output in &outputs {
            leading.extend(self.paths(output)?.into_iter().map(|path| (path, output.clone())));
        }
        let neurons = |name: &String| self.flat.nodes[name].kind != "Input";
        let Some((path, output)) = leading.iter().find(|(path, _)| neurons(&path[0])).or(leading.first()) else {
            let last = order.iter().rev().find(|name| neurons(name)).ok_or_else(|| wrong("it has no neurons"))?;
            self.model.output = self.names[last].clone();
            self.drain(&last.clone());
            let message = format!("no path leads to an output node; '{}' is used as the output", self.model.output);
            self.warnings.push(Warning::of_network(WarningCode::OutputAssumed, message));
            return Ok(());
        };
        if outputs.len() > 1 {
            let message = format!("there are {} outputs; '{output}' is used", outputs.len());
            self.warnings.push(Warning::of_network(WarningCode::OutputAssumed, message));
        }
        let arrived = self.linear_map(&self.shapes[&path[0]], &path[1..])?;
        self.check_shape(output, product(&arrived.shape).unwrap_or(0))?;
        let plain = path[1..].iter().all(|name| matches!(self.flat.nodes[name].kind.as_str(), "Pass" | "Flatten"));
        let alone = leading.iter().filter(|(_, end)| end == output).count() == 1;
        if plain && alone && neurons(&path[0]) {
            self.model.output = self.names[&path[0]].clone();
            self.drain(&path[0].clone());
            return Ok(());
        }
        // Weights without a neuron after them: v is their sum in each step.
        let output = output.clone();
        let name = self.unused_name("output");
        self.names.insert(output.clone(), name.clone());
        self.shapes.insert(output.clone(), arrived.shape.clone());
        let shape = axes(&arrived.shape);
        let start_step = if neurons(&path[0]) { self.depths[&path[0]] + 1 } else { 0 };
        self.depths.insert(output.clone(), start_step);
        let population = PopulationDesc::loihi(&name, shape, integrator(4096.0, 4096.0));
        self.model.populations.push(PopulationDesc { start_step, ..population });
        self.notes
            .push(format!("weights lead to '{output}' without a neuron: the v of '{name}' is their sum in each step"));
        self.incoming(&output, &Discrete::memoryless(None))?;
        self.model.output = name;
        self.drain(&output);
        Ok(())
    }

    /// Sets the drain to the output's depth, by which it responds later.
    fn drain(&mut self, output: &str) {
        let depth = self.depths[output];
        self.model.drain = depth;
        if depth > 0 {
            self.notes.push(format!(
                "layer k starts at step k, as a spike takes one step from layer to layer. In training tools a spike \
                 passes all layers in one step, so more steps follow the last step of the input (drain {depth})"
            ));
        }
    }
}

/// Adds numbers times the gain of each unit.
fn add(sums: &mut [f64], numbers: &[f64], gain: &Parameter) {
    for (unit, (sum, number)) in sums.iter_mut().zip(numbers).enumerate() {
        *sum += number * gain.get(unit);
    }
}

pub(super) fn weights(kind: &ProjectionKind) -> Vec<f64> {
    match kind {
        ProjectionKind::Dense(weights) | ProjectionKind::Conv2d { weights, .. } => weights.tensor().reals().collect(),
        ProjectionKind::Sparse(synapses) => synapses.iter().map(|synapse| synapse.2).collect(),
        ProjectionKind::SumPool2d { weight, .. } => vec![*weight],
        ProjectionKind::Arrays(_) | ProjectionKind::Random { .. } => Vec::new(),
    }
}
