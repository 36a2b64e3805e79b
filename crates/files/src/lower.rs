//! `Network` -> [`Graph`]: names become nodes, arrays are checked against their shapes.
//!
//! Input: a parsed model with its arrays. Output: a graph whose endpoints exist, whose array sizes
//! agree with its populations and whose delays are in range; or the first thing that is not so,
//! with its place in the model file. What a number means to the hardware is left to `quantise`.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use petgraph::graph::{DiGraph, NodeIndex};

use crate::network::{
    Conv2dDesc, DenseDesc, Network, NeuronsDesc, Parameter, ParameterValue, PopulationDesc, ProjectionDesc, RandomDesc,
    Source, SparseDesc, SrmDesc, SumPool2dDesc, SynapseDesc, Weights,
};
use crate::synapses::Synapse;
use nsim_ir::base::diagnostic::{Diagnostic, Span, gathered};
use nsim_ir::base::fixed::{Delay, Payload, SignMode};
use nsim_ir::base::names::{did_you_mean, is_unprintable};
use nsim_ir::base::rng;
use nsim_ir::graph::{
    Graph, MOST_CHANNELS, MOST_SYNAPSES, MOST_UNITS, NetworkFacts, NeuronParameters, PerCompartment, Population,
    PopulationKind, Projection, ProjectionKind, Shape, SrmParameters, Values, Window,
};
use nsim_ir::locate::locate;
use nsim_ir::neurons::ParameterField;
use nsim_ir::spanned::Spanned;
use nsim_ir::tensor::{ArrayRef, Numbers, Tensor};

/// The most numbers that a `Uniform` source may stand for: 2^28, half a gigabyte once quantised.
const MOST_UNIFORM: u64 = 1 << 28;

/// The most steps that a sample may have after its last input step.
const MOST_DRAIN: u32 = 65_535;
/// Populations that an error lists at most.
const MOST_NAMED: usize = 20;

/// Turns a model into a graph.
///
/// # Errors
/// A diagnostic at the first name, shape, size or delay that does not fit.
pub fn lower(network: &Network) -> Result<Graph, Diagnostic> {
    let lowering = Lowering { network };
    let file = network.file();
    if !(file.timestep_ms.value > 0.0 && file.timestep_ms.value <= 1e6) {
        let message = format!("timestep_ms {} is not above 0 and at most 1e6", file.timestep_ms.value);
        return Err(lowering.error("model.timestep", message, file.timestep_ms.span));
    }
    let mut graph = DiGraph::new();
    let mut nodes: HashMap<&str, NodeIndex> = HashMap::new();
    let mut units = 0u64;
    let mut problems = Vec::new();
    for desc in &file.populations {
        let population = match lowering.population(desc) {
            Ok(population) => population,
            Err(problem) => {
                problems.push(Err(problem));
                continue;
            }
        };
        units += u64::from(population.shape.len());
        if matches!(population.kind, PopulationKind::Input) && u64::from(population.shape.len()) > MOST_CHANNELS {
            let message = format!("{} input channels are more than {MOST_CHANNELS}", population.shape.len());
            return Err(lowering.error("model.too-large", message, desc.value.shape().span));
        }
        if units > MOST_UNITS {
            let message =
                format!("the populations up to here have {units} channels and compartments, the limit is {MOST_UNITS}");
            return Err(lowering.error("model.too-large", message, desc.value.shape().span));
        }
        let name = desc.value.name();
        if nodes.insert(name, graph.add_node(population)).is_some() {
            let message = format!("population '{}' is declared twice", name.value);
            return Err(lowering
                .error("model.name-twice", message, name.span)
                .help("give each population its own name"));
        }
    }
    // What names a population that has a problem would have one too.
    gathered::<()>(problems)?;
    let output = lowering.find(&nodes, &file.output, "output");
    let joined = file.projections.iter().map(|desc| lowering.projection(desc, &nodes, &mut graph));
    gathered(joined.chain([output.clone().map(drop)]))?;
    let output = output?;
    let size = graph[output].shape.len();
    if matches!(graph[output].kind, PopulationKind::Input) {
        let message = format!("output '{}' is an input population", file.output.value);
        return Err(lowering
            .error("model.output", message, file.output.span)
            .help("name a population of compartments"));
    }
    let classes = match &file.classes {
        Some(classes) if classes.len() != size as usize => {
            let message = format!("{} class names for {size} output compartments", classes.len());
            return Err(lowering.error("model.classes", message, classes.span));
        }
        Some(classes) => classes.value.clone(),
        None => Vec::new(),
    };
    if let Some(reset) = &file.reset
        && (reset.interval == 0 || reset.interval > u64::from(u32::MAX) || reset.offset > u64::from(u32::MAX))
    {
        let message =
            format!("reset interval {} with offset {}: the interval is 1 to 2^32 - 1", reset.interval, reset.offset);
        return Err(lowering.error("model.reset", message, reset.span));
    }
    let drain = file.drain.as_ref().map_or(0, |drain| drain.value);
    if let Some(drain) = file.drain.as_ref().filter(|drain| drain.value > MOST_DRAIN) {
        let message = format!("drain {} is outside 0..={MOST_DRAIN}", drain.value);
        return Err(lowering
            .error("model.drain", message, drain.span)
            .help("it is a step for each layer behind the first"));
    }
    if let Some(name) = std::iter::once(&file.name).chain(&classes).find(|name| name.contains(is_unprintable)) {
        let message = format!("the name {name:?} has a character that controls a terminal or ends a line");
        let help = "name the network and its classes with characters that are printed";
        return Err(Diagnostic::new("model.name", message).help(help).in_file(network.source().path()));
    }
    let facts = NetworkFacts {
        name: file.name.clone(),
        source: network.source().clone(),
        timestep_ms: file.timestep_ms.value,
        decision: file.decision,
        drain,
        classes,
        reset: file.reset.as_ref().map(|reset| reset.value),
        threshold: file.threshold,
        semantics: file.semantics,
        weight_rounding: file.weight_rounding,
        scene: file.scene.clone(),
        provenance: file.provenance.clone(),
    };
    Ok(Graph::new(facts, graph, output))
}

struct Lowering<'a> {
    network: &'a Network,
}

type Nodes<'a> = HashMap<&'a str, NodeIndex>;

impl Lowering<'_> {
    fn error(&self, code: &'static str, message: impl Into<String>, span: Span) -> Diagnostic {
        Diagnostic::new(code, message).at(self.network.source(), span)
    }

    fn find(&self, nodes: &Nodes, name: &Spanned<String>, role: &str) -> Result<NodeIndex, Diagnostic> {
        nodes.get(name.as_str()).copied().ok_or_else(|| {
            let mut known: Vec<&str> = nodes.keys().copied().collect();
            known.sort_unstable();
            self.error(
                "model.unknown-population",
                format!("{role} names '{}', which is not a population", name.value),
                name.span,
            )
            .help(format!(
                "{}populations are: {}{}",
                did_you_mean(name, known.iter().copied()),
                known[..known.len().min(MOST_NAMED)].join(", "),
                if known.len() > MOST_NAMED { ", .." } else { "" }
            ))
        })
    }

    fn population(&self, desc: &Spanned<PopulationDesc>) -> Result<Population, Diagnostic> {
        let name = desc.value.name();
        // '@' and '#' separate copies and indices in reports, '=' and '.' stand in arguments that
        // name populations.
        if name.is_empty() || name.contains(|c: char| c.is_whitespace() || is_unprintable(c) || "@#=./\\:".contains(c))
        {
            let message = format!("'{}' cannot be a population's name", name.value);
            return Err(self.error("model.name", message, name.span).help(
                "use letters, digits, '_' and '-': names stand in arguments such as name=file.npy and name.spikes",
            ));
        }
        let shape = self.shape(desc.value.shape())?;
        let kind = match &desc.value {
            PopulationDesc::Input(_) => PopulationKind::Input,
            PopulationDesc::Neurons(neurons) => {
                PopulationKind::Neurons(self.neurons(neurons, desc.span, shape.len())?)
            }
            PopulationDesc::Srm(srm) => PopulationKind::Srm(self.srm(srm)?),
        };
        let payload = desc.value.payload().map(|payload| {
            Payload::new(payload.value)
                .map_err(|e| self.error("model.payload", format!("population '{}': {e}", name.value), payload.span))
        });
        Ok(Population { name: name.value.clone(), span: desc.span, shape, kind, payload: payload.transpose()? })
    }

    fn shape(&self, shape: &Spanned<Vec<u64>>) -> Result<Shape, Diagnostic> {
        let product = shape.iter().try_fold(1u64, |product, &axis| product.checked_mul(axis));
        match product {
            Some(units) if (1..=MOST_UNITS).contains(&units) => {}
            _ => {
                let message = format!("shape {:?} does not hold 1 to {MOST_UNITS} units", shape.value);
                return Err(self.error("model.shape", message, shape.span));
            }
        }
        match *shape.value.as_slice() {
            [n] => Ok(Shape::Line(n as u32)),
            [c, h, w] => Ok(Shape::Volume(c as u32, h as u32, w as u32)),
            _ => Err(self
                .error("model.shape", format!("shape {:?} has {} axes", shape.value, shape.len()), shape.span)
                .help("a shape is [n] or [channels, height, width]")),
        }
    }

    fn neurons(&self, desc: &NeuronsDesc, span: Span, units: u32) -> Result<NeuronParameters, Diagnostic> {
        let name = &desc.name.value;
        for ParameterField { name: integer, default, real, help, .. } in desc.kind.parameters() {
            let other = real.and_then(|(real, _)| Some((real, desc.get(real)?)));
            match (desc.get(integer), other) {
                (Some(_), Some((real, second))) => {
                    let message = format!("population '{name}' gives both {integer} and {real}");
                    return Err(self.error("model.parameter-twice", message, second.span).help("keep one of them"));
                }
                (None, None) if default.is_none() => {
                    let message = format!("population '{name}' has no {integer}");
                    return Err(self.error("model.parameter-missing", message, span).help(*help));
                }
                _ => {}
            }
        }
        if let (Some(real), None) = (desc.get("bias"), desc.get("vth")) {
            let message = format!("population '{name}' has a real bias beside an integer threshold");
            return Err(self
                .error("model.parameter", message, real.span)
                .help("give bias_mant and bias_exp, or a real vth"));
        }
        let start_step = match &desc.start_step {
            Some(step) => u32::try_from(step.value).map_err(|_| {
                let message = format!("population '{name}': start_step {} is outside 0..=2^32 - 1", step.value);
                self.error("model.start-step", message, step.span)
            })?,
            None => 0,
        };
        let values = |(what, value): &(&'static str, Parameter)| Ok((*what, self.values(name, what, value, units)?));
        let given = desc.parameters.iter().map(values).collect::<Result<_, Diagnostic>>()?;
        Ok(NeuronParameters { kind: desc.kind, given, start_step, greatest_input: None })
    }

    fn srm(&self, desc: &SrmDesc) -> Result<SrmParameters, Diagnostic> {
        let positive = |what: &str, field: &Spanned<f64>, least: f64| {
            if field.value.is_finite() && field.value >= least && field.value <= 1e9 {
                return Ok(field.value);
            }
            let message =
                format!("population '{}': {what} {} is not within {least}..=1e9", desc.name.value, field.value);
            Err(self.error("model.srm", message, field.span))
        };
        const LEAST: f64 = 1e-9;
        Ok(SrmParameters {
            tau_sr_ms: positive("tau_sr_ms", &desc.tau_sr_ms, LEAST)?,
            tau_ref_ms: positive("tau_ref_ms", &desc.tau_ref_ms, LEAST)?,
            scale_ref: positive("scale_ref", &desc.scale_ref, 0.0)?,
            theta: positive("theta", &desc.theta, LEAST)?,
        })
    }

    fn values(&self, population: &str, what: &str, parameter: &Parameter, units: u32) -> Result<Values, Diagnostic> {
        let each = match &parameter.value {
            ParameterValue::Same(value) => PerCompartment::Same(*value),
            ParameterValue::Each(source) => {
                let tensor = self.tensor(source, &[u64::from(units)], parameter.span)?;
                if tensor.len() != units as usize {
                    let message = format!(
                        "population '{population}': {what} has {} entries for {units} compartments",
                        tensor.len()
                    );
                    return Err(self.error("model.parameter-size", message, parameter.span));
                }
                PerCompartment::Each((0..tensor.len()).map(|i| tensor.real(i)).collect())
            }
        };
        let finite = match &each {
            PerCompartment::Same(value) => value.is_finite(),
            PerCompartment::Each(values) => values.iter().all(|value| value.is_finite()),
        };
        if !finite {
            let message = format!("population '{population}': {what} is not a finite number");
            return Err(self.error("model.not-finite", message, parameter.span));
        }
        Ok(Values { each, span: parameter.span })
    }

    /// The numbers of a source; `shape` is what a seeded source should fill.
    fn tensor(&self, source: &Source, shape: &[u64], span: Span) -> Result<Arc<Tensor>, Diagnostic> {
        match source {
            Source::InPlace(tensor) => Ok(Arc::new(tensor.clone())),
            Source::File(reference) => Ok(Arc::new(self.network.array(reference).clone())),
            Source::Uniform { low, high, step, seed } => {
                let length = shape.iter().try_fold(1u64, |product, &axis| product.checked_mul(axis));
                let length = length.filter(|&n| n <= MOST_UNIFORM).ok_or_else(|| {
                    self.error("model.too-large", format!("Uniform would make more than {MOST_UNIFORM} numbers"), span)
                        .help("use a Random projection, whose synapses are never expanded")
                })?;
                let levels = step.map_or(1.0, |step| ((high - low) / step).floor() + 1.0);
                if !(low.is_finite() && high.is_finite() && low <= high && (1.0..1e15).contains(&levels)) {
                    let steps = step.map_or(String::new(), |step| format!(" in steps of {step}"));
                    let message = format!("Uniform from {low} to {high}{steps} is no range");
                    return Err(self.error("model.uniform", message, span));
                }
                let draw = |i: u64| match step {
                    Some(step) => low + step * rng::below(levels as u64, *seed, i, 0) as f64,
                    None => low + (high - low) * rng::unit(*seed, i, 0),
                };
                let numbers = Numbers::Reals((0..length).map(draw).collect());
                let tensor = Tensor::new(shape.iter().map(|&axis| axis as usize).collect(), numbers);
                Ok(Arc::new(tensor.expect("as many numbers as the shape holds")))
            }
        }
    }

    fn projection(
        &self,
        desc: &Spanned<ProjectionDesc>,
        nodes: &Nodes,
        graph: &mut DiGraph<Population, Projection>,
    ) -> Result<(), Diagnostic> {
        let synapse = desc.value.synapse();
        let target = self.find(nodes, synapse.to, "'to'")?;
        if matches!(graph[target].kind, PopulationKind::Input) {
            let message = format!("a projection ends at '{}', which is an input", synapse.to.value);
            return Err(self.error("model.target", message, synapse.to.span));
        }
        if synapse.from.is_empty() {
            return Err(self.error(
                "model.source",
                format!("the projection to '{}' comes from nowhere", synapse.to.value),
                desc.span,
            ));
        }
        let sources: Vec<NodeIndex> =
            synapse.from.iter().map(|name| self.find(nodes, name, "'from'")).collect::<Result<_, _>>()?;
        let sizes: Vec<u32> = sources.iter().map(|&node| graph[node].shape.len()).collect();
        let declared = Declared {
            lowering: self,
            span: desc.span,
            synapse,
            sources: sizes.iter().map(|&size| u64::from(size)).sum(),
            source_shape: graph[sources[0]].shape,
            target_shape: graph[target].shape,
        };
        let to_delay = |delay: i64, span: Span| {
            Delay::new(delay).map_err(|e| {
                self.error("model.delay-range", format!("projection to '{}': {e}", synapse.to.value), span)
                    .help("a longer delay needs a relay population")
            })
        };
        let delay = synapse.delay.map_or(Ok(Delay::MIN), |delay| to_delay(delay.value, delay.span))?;
        let parts = match &desc.value {
            ProjectionDesc::Sparse(sparse) => declared.sparse(sparse)?,
            other => vec![(None, declared.kind(other)?)],
        };
        for (own_delay, whole) in parts {
            let delay = own_delay.map_or(Ok(delay), |own: Spanned<i64>| to_delay(own.value, own.span))?;
            self.part(desc, delay, whole, (&sources, target), graph);
        }
        Ok(())
    }

    /// Adds a part of a projection, from each of its source populations.
    fn part(
        &self,
        desc: &Spanned<ProjectionDesc>,
        delay: Delay,
        whole: ProjectionKind,
        (sources, target): (&[NodeIndex], NodeIndex),
        graph: &mut DiGraph<Population, Projection>,
    ) {
        let synapse = desc.value.synapse();
        let sizes: Vec<u32> = sources.iter().map(|&node| graph[node].shape.len()).collect();
        let firsts = sizes.iter().scan(0, |next, &size| Some(std::mem::replace(next, *next + size)));
        let firsts: Vec<u32> = firsts.collect();
        let of_source = |(&first, &size): (&u32, &u32)| match &whole {
            ProjectionKind::Sparse { synapses } => ProjectionKind::Sparse {
                synapses: synapses
                    .iter()
                    .filter(|s| (first..first + size).contains(&s.0))
                    .map(|&(from, to, weight, entry)| (from - first, to, weight, entry))
                    .collect(),
            },
            other => other.clone(),
        };
        let kinds = match sources.len() {
            1 => vec![whole],
            _ => firsts.iter().zip(&sizes).map(of_source).collect(),
        };
        for ((&source, first_source), kind) in sources.iter().zip(firsts).zip(kinds) {
            let projection = Projection {
                name: format!("{} -> {}", graph[source].name, graph[target].name),
                span: desc.span,
                first_source,
                weight_exp: synapse.weight_exp.cloned().unwrap_or_else(|| 0.into()),
                sign: synapse.sign.map_or(SignMode::Mixed, |sign| sign.value),
                weight_bits: synapse.weight_bits.cloned().unwrap_or_else(|| 8.into()),
                delay,
                weight_scale: synapse.weight_scale.cloned(),
                weights_span: desc.value.weights_span().unwrap_or(desc.span),
                kind,
            };
            graph.add_edge(source, target, projection);
        }
    }
}

/// Synapses of a projection, and their own delay where they have one.
type Part = (Option<Spanned<i64>>, ProjectionKind);
/// (source, target, weight, entry of the list) each.
type Listed = Vec<(u32, u32, f64, u32)>;
/// Channels, height, width.
type Volume = (u32, u32, u32);

/// A projection's declaration with the sizes of its ends.
struct Declared<'a> {
    lowering: &'a Lowering<'a>,
    span: Span,
    synapse: SynapseDesc<'a>,
    sources: u64,
    source_shape: Shape,
    target_shape: Shape,
}

impl Declared<'_> {
    fn kind(&self, desc: &ProjectionDesc) -> Result<ProjectionKind, Diagnostic> {
        match desc {
            ProjectionDesc::Dense(dense) => self.dense(dense),
            ProjectionDesc::Sparse(_) => Ok(ProjectionKind::Sparse { synapses: Vec::new() }),
            ProjectionDesc::Conv2d(conv) => self.conv(conv),
            ProjectionDesc::SumPool2d(pool) => self.pool(pool),
            ProjectionDesc::Random(random) => self.random(random),
        }
    }

    fn error(&self, code: &'static str, message: impl Into<String>, span: Span) -> Diagnostic {
        self.lowering.error(code, message, span)
    }

    fn to(&self) -> &str {
        self.synapse.to
    }

    /// The weights with exactly this shape; trailing axes of length 1 are allowed and dropped.
    fn weights(&self, weights: &Weights, shape: &[u64]) -> Result<Arc<Tensor>, Diagnostic> {
        let tensor = self.lowering.tensor(&weights.source, shape, weights.span)?;
        let mut found: Vec<u64> = tensor.shape().iter().map(|&axis| axis as u64).collect();
        while found.len() > shape.len() && found.last() == Some(&1) {
            found.pop();
        }
        if found != shape {
            let message = format!(
                "projection to '{}': weights are {:?}, its populations need {shape:?}",
                self.to(),
                tensor.shape()
            );
            return Err(self
                .error("model.weights-shape", message, weights.span)
                .help("weights are [target][source], kernels [out channel][in channel / groups][height][width]"));
        }
        Ok(tensor)
    }

    fn dense(&self, dense: &DenseDesc) -> Result<ProjectionKind, Diagnostic> {
        let shape = [u64::from(self.target_shape.len()), self.sources];
        Ok(ProjectionKind::Dense { weights: self.weights(&dense.weights, &shape)? })
    }

    /// The synapses by their own delay, where they have one.
    fn sparse(&self, sparse: &SparseDesc) -> Result<Vec<Part>, Diagnostic> {
        let targets = u64::from(self.target_shape.len());
        if let Some(arrays) = &sparse.arrays {
            if !sparse.synapses.is_empty() {
                let message = format!("projection to '{}': both synapses and arrays are given", self.to());
                return Err(self.error("model.synapse-arrays", message, arrays.span));
            }
            if let (Some(own), Some(_)) = (&arrays.delay, &sparse.delay) {
                let message = format!("projection to '{}': synapses and the projection have a delay", self.to());
                return Err(self.error("model.synapse-arrays", message, own.span));
            }
            let delay_span = arrays.delay.as_ref().map_or(arrays.span, |delay| delay.span);
            let mut by_delay: BTreeMap<Option<i64>, Listed> = BTreeMap::new();
            let network = self.lowering.network;
            let array = |reference: &ArrayRef| network.array(reference);
            for synapse in arrays.read(array, network.source(), (self.sources, targets))? {
                let Synapse { source, target, weight, delay } = synapse?;
                by_delay.entry(delay).or_default().push((source, target, weight, 0));
            }
            let part = |(delay, synapses): (Option<i64>, Listed)| {
                let delay = delay.map(|value| Spanned { value, span: delay_span });
                (delay, ProjectionKind::Sparse { synapses })
            };
            return Ok(match by_delay.is_empty() {
                true => vec![(None, ProjectionKind::Sparse { synapses: Vec::new() })],
                false => by_delay.into_iter().map(part).collect(),
            });
        }
        let synapses = sparse
            .synapses
            .iter()
            .zip(0u32..)
            .map(|(&(source, target, weight), entry)| {
                for (what, index, size) in [("source", source, self.sources), ("target", target, targets)] {
                    if index >= size {
                        let message = format!("projection to '{}': {what} {index} is outside 0..{size}", self.to());
                        let text = self.lowering.network.source().text();
                        let place = locate(text, self.span, &format!("synapses.{entry}")).unwrap_or(self.span);
                        return Err(self.error("model.synapse-index", message, place));
                    }
                }
                Ok((source as u32, target as u32, weight, entry))
            })
            .collect::<Result<_, _>>()?;
        Ok(vec![(None, ProjectionKind::Sparse { synapses })])
    }

    fn volumes(&self, what: &str) -> Result<(Volume, Volume), Diagnostic> {
        if self.synapse.from.len() != 1 {
            let message = format!("{what} to '{}' has {} sources", self.to(), self.synapse.from.len());
            return Err(self.error("model.window", message, self.span).help("declare one projection for each source"));
        }
        match (self.source_shape.volume(), self.target_shape.volume()) {
            (Some(source), Some(target)) => Ok((source, target)),
            _ => {
                let message =
                    format!("{what} to '{}' goes from shape {} to {}", self.to(), self.source_shape, self.target_shape);
                Err(self
                    .error("model.window", message, self.span)
                    .help("both shapes must be [channels, height, width]"))
            }
        }
    }

    /// Numbers of a window, each from `least` to 65,535.
    fn pair(
        &self,
        pair: Option<&Spanned<(u64, u64)>>,
        what: &str,
        default: (u32, u32),
        least: u64,
    ) -> Result<(u32, u32), Diagnostic> {
        let Some(pair) = pair else { return Ok(default) };
        let range = least..=65_535;
        if !range.contains(&pair.value.0) || !range.contains(&pair.value.1) {
            let message = format!("projection to '{}': {what} {:?} is outside {range:?}", self.to(), pair.value);
            return Err(self.error("model.window", message, pair.span));
        }
        Ok((pair.value.0 as u32, pair.value.1 as u32))
    }

    /// Checks that the target is exactly what the window makes of the source, with `after` silent
    /// rows and columns appended to it.
    fn check_window(&self, window: &Window, after: Option<&Spanned<(u64, u64)>>) -> Result<(), Diagnostic> {
        let after = self.pair(after, "padding_after", window.padding, 0)?;
        let size = |source: u32, kernel: u32, stride: u32, padding: (u32, u32), dilation: u32| {
            let reach = u64::from(dilation) * u64::from(kernel - 1) + 1;
            let room = u64::from(source) + u64::from(padding.0) + u64::from(padding.1);
            room.checked_sub(reach).map(|slack| slack / u64::from(stride) + 1)
        };
        let w = window;
        let expected = (
            size(w.source.1, w.kernel.0, w.stride.0, (w.padding.0, after.0), w.dilation.0),
            size(w.source.2, w.kernel.1, w.stride.1, (w.padding.1, after.1), w.dilation.1),
        );
        if expected != (Some(u64::from(w.target.1)), Some(u64::from(w.target.2))) {
            let show = |side: Option<u64>| side.map_or("nothing".to_string(), |n| n.to_string());
            let message = format!(
                "projection to '{}': the window makes {} x {} of {} x {}, the population is {} x {}",
                self.to(),
                show(expected.0),
                show(expected.1),
                w.source.1,
                w.source.2,
                w.target.1,
                w.target.2
            );
            return Err(self.error("model.window", message, self.span).help(
                "size = (source + padding + padding_after - dilation (kernel - 1) - 1) / stride + 1, rounded down",
            ));
        }
        Ok(())
    }

    fn conv(&self, conv: &Conv2dDesc) -> Result<ProjectionKind, Diagnostic> {
        let (source, target) = self.volumes("Conv2d")?;
        let groups = conv.groups.as_ref().map_or(1, |groups| groups.value);
        if groups == 0 || u64::from(source.0) % groups != 0 || u64::from(target.0) % groups != 0 {
            let message = format!(
                "projection to '{}': {groups} groups do not divide {} and {} channels",
                self.to(),
                source.0,
                target.0
            );
            return Err(self.error("model.window", message, conv.groups.as_ref().map_or(self.span, |g| g.span)));
        }
        // The kernel's size is read off the weights, so those are read first.
        let kernel = match &conv.weights.source {
            Source::InPlace(tensor) => tensor.shape().to_vec(),
            Source::File(reference) => self.lowering.network.array(reference).shape().to_vec(),
            Source::Uniform { .. } => {
                return Err(self
                    .error("model.window", "a convolution's kernel needs its size", conv.weights.span)
                    .help("give the kernel in place or as a file"));
            }
        };
        let (Some(&kh), Some(&kw)) = (kernel.get(2), kernel.get(3)) else {
            return Err(self
                .error(
                    "model.weights-shape",
                    format!("projection to '{}': the kernel is {kernel:?}", self.to()),
                    conv.weights.span,
                )
                .help("kernels are [out channel][in channel / groups][height][width]"));
        };
        let shape = [u64::from(target.0), u64::from(source.0) / groups, kh as u64, kw as u64];
        let weights = self.weights(&conv.weights, &shape)?;
        if kh == 0 || kw == 0 || kh > 65_535 || kw > 65_535 {
            return Err(self.error("model.window", format!("a kernel of {kh} x {kw}"), conv.weights.span));
        }
        let window = Window {
            source,
            target,
            kernel: (kh as u32, kw as u32),
            stride: self.pair(conv.stride.as_ref(), "stride", (1, 1), 1)?,
            padding: self.pair(conv.padding.as_ref(), "padding", (0, 0), 0)?,
            dilation: self.pair(conv.dilation.as_ref(), "dilation", (1, 1), 1)?,
            groups: groups as u32,
        };
        self.check_window(&window, conv.padding_after.as_ref())?;
        Ok(ProjectionKind::Conv2d { window, weights })
    }

    fn pool(&self, pool: &SumPool2dDesc) -> Result<ProjectionKind, Diagnostic> {
        let (source, target) = self.volumes("SumPool2d")?;
        let kernel = self.pair(Some(&pool.kernel), "kernel", (1, 1), 1)?;
        let window = Window {
            source,
            target,
            kernel,
            stride: self.pair(pool.stride.as_ref(), "stride", kernel, 1)?,
            padding: self.pair(pool.padding.as_ref(), "padding", (0, 0), 0)?,
            dilation: (1, 1),
            groups: source.0,
        };
        if source.0 != target.0 {
            let message = format!("SumPool2d to '{}' goes from {} to {} channels", self.to(), source.0, target.0);
            return Err(self.error("model.window", message, self.span));
        }
        self.check_window(&window, pool.padding_after.as_ref())?;
        Ok(ProjectionKind::SumPool2d { window, weight: pool.weight.clone() })
    }

    fn random(&self, random: &RandomDesc) -> Result<ProjectionKind, Diagnostic> {
        let synapses = self.sources.checked_mul(random.fan_out.value);
        if synapses.is_none_or(|n| n > MOST_SYNAPSES) || u32::try_from(random.fan_out.value).is_err() {
            let message = format!(
                "projection to '{}': {} sources times {} synapses is more than {MOST_SYNAPSES}",
                self.to(),
                self.sources,
                random.fan_out.value
            );
            return Err(self.error("model.too-large", message, random.fan_out.span));
        }
        if let Some(scale) = self.synapse.weight_scale {
            return Err(self.error(
                "model.random",
                "a Random projection has integer weights and takes no weight_scale",
                scale.span,
            ));
        }
        Ok(ProjectionKind::Random {
            fan_out: random.fan_out.value as u32,
            low: random.low.clone(),
            high: random.high.clone(),
            seed: random.seed.value,
        })
    }
}
