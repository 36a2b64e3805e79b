//! A model with what its rules have learned.
//!
//! Input: a model, and the state of each rule by row. Output: the model with these weights, delays
//! and tags, and with every array next to it, so that it can be written anywhere. Synapses whose
//! delays differ, and random ones, become arrays. Errors: `model.learned` for weights that nsim
//! scales by itself.

use std::collections::BTreeMap;

use super::learning::PerSynapse;
use super::{Network, NetworkFile, Parameter, ProjectionDesc, ProjectionKind, Weights, tensor};
use crate::synapses::{SynapseArrays, SynapsePlace};
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::fixed::SignMode;
use nsim_ir::base::rng;
use nsim_ir::locate::items;
use nsim_ir::tensor::{ArrayRef, Tensor};

/// The state of a rule's synapses, by row; columns of unchanged values may be empty.
#[derive(Debug, Clone, Copy)]
pub struct LearnedState<'a> {
    /// The name of its projection.
    pub name: &'a str,
    /// Weight mantissas.
    pub weights: &'a [i32],
    /// Delays.
    pub delays: &'a [i32],
    /// Tags.
    pub tags: &'a [i32],
    /// Whether delays are those of the synapses.
    pub delays_act: bool,
    /// The sign of the weights.
    pub sign: SignMode,
}

/// A model that is being written, and the arrays of its synapses.
struct Writer<'a> {
    network: &'a Network,
    /// The name of the file for arrays.
    file: &'a str,
    arrays: BTreeMap<String, Tensor>,
}

impl Network {
    /// The model with what was learned, and the tensors that it names in `file`. Without rules if
    /// `freeze`.
    ///
    /// # Errors
    /// `model.learned`.
    pub fn learned(
        &self,
        states: &[LearnedState<'_>],
        freeze: bool,
        file: &str,
    ) -> Result<(NetworkFile, BTreeMap<String, Tensor>)> {
        let mut model = self.file().clone();
        for parameter in model.populations.iter_mut().flat_map(|population| population.loihi.iter_mut().flatten()) {
            if let Parameter::From(source) = &parameter.1
                && let Some(array) = source.array()
            {
                parameter.1 = Parameter::Each(self.array(&array).reals().collect());
            }
        }
        let mut writer = Writer { network: self, file, arrays: BTreeMap::new() };
        let mut projections = std::mem::take(&mut model.projections);
        for (index, projection) in projections.iter_mut().enumerate() {
            let name = projection.name_or_ends();
            match states.iter().find(|state| projection.learning.is_some() && state.name == name) {
                Some(state) => writer.learn(&model, index, projection, state)?,
                None => writer.keep(index, projection),
            }
            if freeze {
                projection.learning = None;
            }
        }
        Ok((NetworkFile { projections, ..model }, writer.arrays))
    }
}

impl Writer<'_> {
    /// Stores an array.
    fn stored(&mut self, index: usize, field: &str, array: Tensor) -> ArrayRef {
        let key = format!("{index}.{field}");
        self.arrays.insert(key.clone(), array);
        ArrayRef::Safetensors(self.file.to_string(), key)
    }

    /// The weights of a file, in place.
    fn in_place(&self, weights: &mut Weights) {
        if let Some(found) = self.network.tensor(weights) {
            *weights = tensor(found.shape().to_vec(), found.reals().collect());
        }
    }

    /// A projection without rule, with its arrays.
    fn keep(&mut self, index: usize, projection: &mut ProjectionDesc) {
        match &mut projection.kind {
            ProjectionKind::Dense(weights) | ProjectionKind::Conv2d { weights, .. } => self.in_place(weights),
            ProjectionKind::Arrays(arrays) => {
                let named: Vec<(&str, Tensor)> =
                    arrays.references().map(|(name, array)| (name, self.network.array(array).clone())).collect();
                let mut of = BTreeMap::new();
                for (name, array) in named {
                    of.insert(name, self.stored(index, name, array));
                }
                if let (Some(target), Some(weight)) = (of.remove("target"), of.remove("weight")) {
                    let [source, first, delay] = ["source", "first", "delay"].map(|name| of.remove(name));
                    *arrays = SynapseArrays { source, first, target, weight, delay };
                }
            }
            _ => {}
        }
    }

    /// A projection with the state of its rule.
    fn learn(
        &mut self,
        model: &NetworkFile,
        index: usize,
        projection: &mut ProjectionDesc,
        state: &LearnedState<'_>,
    ) -> Result<()> {
        let scaled = model.population(&projection.to).is_some_and(|target| target.parameter("vth").is_some());
        if scaled && projection.weight_scale.is_none() {
            let message = format!("projection '{}': weights into a real threshold are scaled by nsim", state.name);
            let help = "give the projection a weight_scale, or its target a vth_mant, before it learns";
            return Err(Diagnostic::new("model.learned", message).help(help));
        }
        let ends = self.ends(model, index, projection)?;
        let scale = projection.weight_scale.unwrap_or(1.0);
        projection.sign = Some(state.sign);
        let weights: Vec<f64> = state.weights.iter().map(|&weight| f64::from(weight) / scale).collect();
        if weights.len() != ends.len() {
            self.keep(index, projection);
            return Ok(());
        }
        if let Some(rule) = &mut projection.learning {
            let shape = match &projection.kind {
                ProjectionKind::Dense(_) => {
                    vec![units(model, &projection.to), ends.len() / units(model, &projection.to)]
                }
                _ => vec![ends.len()],
            };
            let values = |numbers: &[i32]| match numbers.iter().any(|&number| number != 0) {
                true => Some(PerSynapse::Each(tensor(shape.clone(), numbers.iter().copied().map(f64::from).collect()))),
                false => None,
            };
            rule.tags = values(state.tags);
            rule.delays = values(state.delays).filter(|_| !state.delays_act);
        }
        let delays = if state.delays_act { state.delays } else { &[] };
        let differ = delays.windows(2).any(|pair| pair[0] != pair[1]);
        match &mut projection.kind {
            ProjectionKind::Dense(own) if !differ => {
                let targets = units(model, &projection.to);
                *own = tensor(vec![targets, ends.len() / targets], weights);
            }
            ProjectionKind::Sparse(synapses) if !differ => {
                synapses.iter_mut().zip(weights).for_each(|(synapse, weight)| synapse.2 = weight);
            }
            _ => {
                self.listed(index, projection, &ends, weights, delays);
                return Ok(());
            }
        }
        projection.delay = delays.first().map_or(projection.delay, |&delay| delay as u32);
        Ok(())
    }

    /// Makes a projection's synapses arrays, with a delay for each.
    fn listed(
        &mut self,
        index: usize,
        projection: &mut ProjectionDesc,
        ends: &[(u32, u32)],
        weights: Vec<f64>,
        delays: &[i32],
    ) {
        let source = self.stored(index, "source", column(ends.iter().map(|end| end.0.into()).collect()));
        let target = self.stored(index, "target", column(ends.iter().map(|end| end.1.into()).collect()));
        let weight = self.stored(index, "weight", column(weights));
        let each = column(delays.iter().copied().map(f64::from).collect());
        let delay = if delays.is_empty() { None } else { Some(self.stored(index, "delay", each)) };
        if delay.is_some() {
            projection.delay = 0;
        }
        projection.kind =
            ProjectionKind::Arrays(SynapseArrays { source: Some(source), first: None, target, weight, delay });
    }

    /// Source and target of each synapse, by row.
    fn ends(&self, model: &NetworkFile, index: usize, projection: &ProjectionDesc) -> Result<Vec<(u32, u32)>> {
        let sources: usize = projection.from.iter().map(|name| units(model, name)).sum();
        let (sources, targets) = (sources as u32, units(model, &projection.to) as u32);
        Ok(match &projection.kind {
            ProjectionKind::Sparse(synapses) => synapses.iter().map(|&(s, t, _)| (s as u32, t as u32)).collect(),
            ProjectionKind::Arrays(arrays) => {
                let declared = items(self.network.source().text(), "projections").get(index).copied();
                let place = SynapsePlace {
                    text: self.network.source(),
                    declared: declared.unwrap_or_default(),
                    sources: sources.into(),
                    targets: targets.into(),
                };
                let by_delay = arrays.read(|array| self.network.array(array), &place)?;
                let mut listed: Vec<_> = by_delay.into_values().flatten().collect();
                listed.sort_unstable_by_key(|synapse| synapse.3);
                listed.into_iter().map(|(source, target, ..)| (source, target)).collect()
            }
            ProjectionKind::Random { fan_out, seed, .. } => {
                let target = |s: u32, k: u64| rng::below(targets.into(), *seed, s.into(), 2 * k) as u32;
                (0..sources).flat_map(|s| (0..*fan_out).map(move |k| (s, target(s, k)))).collect()
            }
            _ => (0..targets).flat_map(|target| (0..sources).map(move |source| (source, target))).collect(),
        })
    }
}

/// Numbers as an array.
fn column(numbers: Vec<f64>) -> Tensor {
    tensor(vec![numbers.len()], numbers).tensor().clone()
}

/// Units of a population.
fn units(model: &NetworkFile, name: &str) -> usize {
    model.population(name).map_or(0, |population| population.units() as usize)
}
