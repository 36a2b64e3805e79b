//! `Network` -> [`Graph`]: names become nodes, arrays are checked against their shapes.
//!
//! Input: a parsed model with its arrays. Output: a graph whose endpoints exist, whose array sizes
//! agree with its populations and whose delays are in range. Errors have their place in the model
//! file. `quantise` converts the numbers to fields of the hardware.
//!
//! - `learning`: rules of projections.

mod learning;

use std::collections::HashMap;
use std::fmt::Display;
use std::sync::Arc;

use petgraph::graph::{DiGraph, NodeIndex};

use crate::network::{Network, Parameter, PopulationDesc, ProjectionDesc, ProjectionKind as Kind, Source, Weights};
use crate::synapses::{SynapseArrays, SynapsePlace};
use nsim_ir::arithmetic::ReadOut;
use nsim_ir::base::diagnostic::{Diagnostic, Span, collect_all};
use nsim_ir::base::fixed::{Delay, MessageBits, Payload, SignMode, ThresholdMantissa, WeightBits};
use nsim_ir::base::id::{IdVec, RuleId};
use nsim_ir::base::names::{did_you_mean, is_unprintable};
use nsim_ir::base::rng;
use nsim_ir::graph::{
    DeclaredRule, Graph, MOST_CHANNELS, MOST_SYNAPSES, MOST_UNITS, NetworkFacts, NeuronParameters, PerCompartment,
    Population, PopulationKind, Projection, ProjectionKind, Shape, SrmParameters, Values, Window,
};
use nsim_ir::locate::{items, locate};
use nsim_ir::neurons::{Emits, ParameterField};
use nsim_ir::spanned::Spanned;
use nsim_ir::spikes::Message;
use nsim_ir::tensor::{Numbers, Tensor};

/// The most numbers that a `Uniform` source may represent: 2^28, half a gigabyte once quantised.
const MOST_UNIFORM: u64 = 1 << 28;

/// The most steps that a sample may have after its last input step.
const MOST_DRAIN: u32 = 65_535;
/// Bits of the integers of a `Signal` population.
const SIGNAL_BITS: i64 = 16;
/// Populations that an error lists at most.
const MOST_NAMED: usize = 20;

/// Whether a text has characters that separate names in arguments.
fn is_no_name(name: &str) -> bool {
    name.is_empty() || name.contains(|c: char| c.is_whitespace() || is_unprintable(c) || "@#=./\\:".contains(c))
}

/// Turns a model into a graph.
///
/// # Errors
/// Diagnostics at the names, shapes, sizes and delays that do not fit.
pub fn lower(network: &Network) -> Result<Graph, Diagnostic> {
    let file = network.file();
    let text = network.source().text();
    let lowering = Lowering { network, whole: Span { start: 0, end: text.len() } };
    let timestep = file.timestep_ms;
    if !(timestep > 0.0 && timestep <= 1e6) {
        let message = format!("timestep_ms {timestep} is not above 0 and at most 1e6");
        return Err(lowering.problem("model.timestep", message, "timestep_ms"));
    }
    let mut graph = DiGraph::new();
    let nodes = lowering.populations(&mut graph)?;
    let output = lowering.find(&nodes, &file.output, "output", || lowering.at(lowering.whole, "output"));
    let spans = items(text, "projections");
    let mut rules = IdVec::new();
    let joined = file.projections.iter().enumerate().map(|(index, desc)| {
        let span = spans.get(index).copied().unwrap_or_default();
        lowering.projection(desc, span, &nodes, &mut graph, &mut rules)
    });
    collect_all(joined.chain([output.clone().map(drop)]))?;
    lowering.check_names(&spans)?;
    let output = output?;
    lowering.check_output(&graph[output])?;
    lowering.check_facts()?;
    let facts = NetworkFacts {
        name: file.name.clone(),
        source: network.source().clone(),
        timestep_ms: file.timestep_ms,
        decision: file.decision,
        drain: file.drain,
        classes: file.classes.clone(),
        reset: file.reset,
        threshold: file.threshold,
        semantics: file.semantics,
        weight_rounding: file.weight_rounding,
        scene: file.scene.clone(),
        provenance: file.provenance.clone(),
        warnings: network.conventions().warnings.clone(),
        rules,
    };
    Ok(Graph::new(facts, graph, output))
}

struct Lowering<'a> {
    network: &'a Network,
    whole: Span,
}

type Nodes<'a> = HashMap<&'a str, NodeIndex>;

impl<'a> Lowering<'a> {
    fn populations(&self, graph: &mut DiGraph<Population, Projection>) -> Result<Nodes<'a>, Diagnostic> {
        let spans = items(self.network.source().text(), "populations");
        let mut nodes = Nodes::new();
        let mut units = 0u64;
        let mut problems = Vec::new();
        for (index, desc) in self.network.file().populations.iter().enumerate() {
            let span = spans.get(index).copied().unwrap_or_default();
            let population = match self.population(desc, span) {
                Ok(population) => population,
                Err(problem) => {
                    problems.push(Err(problem));
                    continue;
                }
            };
            let own = u64::from(population.shape.len());
            units += own;
            if matches!(population.kind, PopulationKind::Input) && own > MOST_CHANNELS {
                let message = format!("{own} input channels are more than {MOST_CHANNELS}");
                return Err(self.error("model.too-large", message, self.at(span, "shape")));
            }
            if units > MOST_UNITS {
                let message = format!(
                    "the populations up to here have {units} channels and compartments, the limit is {MOST_UNITS}"
                );
                return Err(self.error("model.too-large", message, self.at(span, "shape")));
            }
            if nodes.insert(&desc.name, graph.add_node(population)).is_some() {
                let message = format!("population '{}' is declared twice", desc.name);
                return Err(self
                    .error("model.name-twice", message, self.at(span, "name"))
                    .help("give each population its own name"));
            }
        }
        // Projections of a refused population would only repeat its error.
        collect_all::<()>(problems)?;
        Ok(nodes)
    }

    fn check_output(&self, output: &Population) -> Result<(), Diagnostic> {
        let file = self.network.file();
        match &output.kind {
            PopulationKind::Input => {
                let message = format!("output '{}' is an input population", file.output);
                Err(self.problem("model.output", message, "output").help("name a population of compartments"))
            }
            PopulationKind::Neurons(neurons)
                if file.decision != ReadOut::Spikes && neurons.kind.potential().is_none() =>
            {
                let message = format!(
                    "output '{}' has neurons of kind {}, which have no potential to decide by",
                    file.output,
                    neurons.kind.name()
                );
                Err(self.problem("model.decision", message, "decision").help("give decision: Spikes"))
            }
            _ if !file.classes.is_empty() && file.classes.len() != output.shape.len() as usize => {
                let (names, size) = (file.classes.len(), output.shape.len());
                let message = format!("{names} class names for {size} output compartments");
                Err(self.problem("model.classes", message, "classes"))
            }
            _ => Ok(()),
        }
    }

    /// Checks the network's reset, drain and names.
    fn check_facts(&self) -> Result<(), Diagnostic> {
        let file = self.network.file();
        if let Some(reset) = &file.reset
            && (reset.interval == 0 || reset.interval > u64::from(u32::MAX) || reset.offset > u64::from(u32::MAX))
        {
            let (interval, offset) = (reset.interval, reset.offset);
            let message = format!("reset interval {interval} with offset {offset}: the interval is 1 to 2^32 - 1");
            return Err(self.problem("model.reset", message, "reset"));
        }
        if file.drain > MOST_DRAIN {
            let message = format!("drain {} is outside 0..={MOST_DRAIN}", file.drain);
            return Err(self
                .problem("model.drain", message, "drain")
                .help("give one step for each layer after the first"));
        }
        let mut names = std::iter::once(&file.name).chain(&file.classes);
        if let Some(name) = names.find(|name| name.contains(is_unprintable)) {
            let message = format!("the name {name:?} has a character that controls a terminal or ends a line");
            let help = "use printable characters in the names of the network and its classes";
            return Err(Diagnostic::new("model.name", message).help(help).in_file(self.network.source().path()));
        }
        Ok(())
    }

    fn error(&self, code: &'static str, message: impl Into<String>, span: Span) -> Diagnostic {
        Diagnostic::new(code, message).at(self.network.source(), span)
    }

    /// An error at a field of the network.
    fn problem(&self, code: &'static str, message: impl Into<String>, path: &str) -> Diagnostic {
        self.error(code, message, self.at(self.whole, path))
    }

    /// The place of a path within a declaration; the declaration's place where the path is absent.
    fn at(&self, declaration: Span, path: &str) -> Span {
        locate(self.network.source().text(), declaration, path).unwrap_or(declaration)
    }

    fn find(&self, nodes: &Nodes, name: &str, role: &str, place: impl Fn() -> Span) -> Result<NodeIndex, Diagnostic> {
        nodes.get(name).copied().ok_or_else(|| {
            let mut known: Vec<&str> = nodes.keys().copied().collect();
            known.sort_unstable();
            self.error("model.unknown-population", format!("{role} names '{name}', which is not a population"), place())
                .help(format!(
                    "{}populations are: {}{}",
                    did_you_mean(name, known.iter().copied()),
                    known[..known.len().min(MOST_NAMED)].join(", "),
                    if known.len() > MOST_NAMED { ", .." } else { "" }
                ))
        })
    }

    fn population(&self, desc: &PopulationDesc, span: Span) -> Result<Population, Diagnostic> {
        let name = &desc.name;
        // '@' and '#' separate copies and indices in reports; '=' and '.' are separators in
        // arguments that name populations.
        if is_no_name(name) {
            let message = format!("'{name}' cannot be a population's name");
            return Err(self.error("model.name", message, self.at(span, "name")).help(
                "use letters, digits, '_' and '-', because names are part of arguments such as name=file.npy and \
                name.spikes",
            ));
        }
        let shape = self.shape(&desc.shape, span)?;
        let kind = match (&desc.loihi, desc.srm) {
            (Some(parameters), _) => PopulationKind::Neurons(self.neurons(desc, parameters, span, shape.len())?),
            (None, Some(srm)) => PopulationKind::Srm(self.srm(name, srm, span)?),
            (None, None) => PopulationKind::Input,
        };
        let message = self.message(desc, &kind, span)?;
        Ok(Population { name: name.clone(), span, shape, kind, message })
    }

    /// The content of the messages of a population.
    fn message(&self, desc: &PopulationDesc, kind: &PopulationKind, span: Span) -> Result<Message, Diagnostic> {
        let wrong = |path: &str, what: &dyn Display| {
            self.error("model.payload", format!("population '{}': {what}", desc.name), self.at(span, path))
        };
        let computes = matches!(kind, PopulationKind::Neurons(p) if p.kind.table().emits == Emits::Values);
        let message_bits = desc.message_bits.or(desc.signal.then_some(SIGNAL_BITS));
        match (desc.payload, message_bits) {
            (Some(_), _) if computes => Err(wrong("payload", &"its neurons compute the values of their messages")
                .help("remove payload; message_bits sets the width of their integers")),
            (Some(_), Some(_)) => Err(wrong("message_bits", &"a payload is the value of every message")
                .help("give payload or message_bits, not both")),
            (Some(payload), None) => Payload::new(payload).map(Message::Payload).map_err(|e| wrong("payload", &e)),
            (None, Some(_)) if !computes && !matches!(kind, PopulationKind::Input) => {
                Err(wrong("message_bits", &"its neurons send spikes, which carry no integer")
                    .help("remove message_bits, or give a payload"))
            }
            // Every message counts as 1.
            (None, Some(0)) => Ok(Message::Spike),
            (None, Some(bits)) => MessageBits::new(bits).map(Message::Value).map_err(|e| wrong("message_bits", &e)),
            (None, None) if computes => Ok(Message::Value(MessageBits::MAX)),
            (None, None) => Ok(Message::Spike),
        }
    }

    fn shape(&self, shape: &[u64], span: Span) -> Result<Shape, Diagnostic> {
        let units = shape.iter().try_fold(1u64, |product, &axis| product.checked_mul(axis));
        if !units.is_some_and(|units| (1..=MOST_UNITS).contains(&units)) {
            let message = format!("shape {shape:?} does not hold 1 to {MOST_UNITS} units");
            return Err(self.error("model.shape", message, self.at(span, "shape")));
        }
        match *shape {
            [n] => Ok(Shape::Line(n as u32)),
            [c, h, w] => Ok(Shape::Volume(c as u32, h as u32, w as u32)),
            _ => Err(self
                .error("model.shape", format!("shape {shape:?} has {} axes", shape.len()), self.at(span, "shape"))
                .help("a shape is [n] or [channels, height, width]")),
        }
    }

    fn neurons(
        &self,
        desc: &PopulationDesc,
        parameters: &[(&'static str, Parameter)],
        span: Span,
        units: u32,
    ) -> Result<NeuronParameters, Diagnostic> {
        let name = &desc.name;
        for ParameterField { name: integer, default, real, help, .. } in desc.kind.parameters() {
            let other = real.and_then(|(real, _)| desc.parameter(real).map(|_| real));
            match (desc.parameter(integer), other) {
                (Some(_), Some(real)) => {
                    let message = format!("population '{name}' has both {integer} and {real}");
                    return Err(self
                        .error("model.parameter-twice", message, self.at(span, real))
                        .help("keep one of them"));
                }
                (None, None) if default.is_none() => {
                    let message = format!("population '{name}': field {integer} is missing");
                    return Err(self.error("model.parameter-missing", message, span).help(*help));
                }
                _ => {}
            }
        }
        let real = desc.kind.parameters().iter().any(|field| field.real.is_some_and(|(real, _)| real == "bias"));
        if real && desc.parameter("bias").is_some() && desc.parameter("vth").is_none() {
            let message = format!("population '{name}' has a real bias but an integer threshold");
            return Err(self
                .error("model.parameter", message, self.at(span, "bias"))
                .help("give bias_mant and bias_exp, or a real vth"));
        }
        let mut given = Vec::new();
        for (what, value) in parameters {
            given.push((*what, self.values(name, what, value, units, self.at(span, what))?));
        }
        Ok(NeuronParameters { kind: desc.kind, given, start_step: desc.start_step, greatest_input: None })
    }

    fn srm(&self, name: &str, srm: [(&'static str, f64); 4], span: Span) -> Result<SrmParameters, Diagnostic> {
        let positive = |index: usize, least: f64| {
            let (what, value) = srm[index];
            if value.is_finite() && value >= least && value <= 1e9 {
                return Ok(value);
            }
            let message = format!("population '{name}': {what} {value} is not within {least}..=1e9");
            Err(self.error("model.srm", message, self.at(span, what)))
        };
        const LEAST: f64 = 1e-9;
        Ok(SrmParameters {
            tau_sr_ms: positive(0, LEAST)?,
            tau_ref_ms: positive(1, LEAST)?,
            scale_ref: positive(2, 0.0)?,
            theta: positive(3, LEAST)?,
        })
    }

    fn values(
        &self,
        population: &str,
        what: &str,
        parameter: &Parameter,
        units: u32,
        span: Span,
    ) -> Result<Values, Diagnostic> {
        let each = match parameter {
            Parameter::Same(value) => PerCompartment::Same(*value),
            Parameter::Each(values) => PerCompartment::Each(values.clone()),
            Parameter::From(source) => {
                PerCompartment::Each(self.source_tensor(source, &[u64::from(units)], span)?.reals().collect())
            }
        };
        if let PerCompartment::Each(values) = &each
            && values.len() != units as usize
        {
            let message =
                format!("population '{population}': {what} has {} values for {units} compartments", values.len());
            return Err(self.error("model.parameter-size", message, span));
        }
        if each.any(|value| !value.is_finite()) {
            let message = format!("population '{population}': {what} is not a finite number");
            return Err(self.error("model.not-finite", message, span));
        }
        Ok(Values { each, span })
    }

    /// The numbers of a source; `shape` is the shape of a seeded one.
    fn source_tensor(&self, source: &Source, shape: &[u64], span: Span) -> Result<Arc<Tensor>, Diagnostic> {
        let Source::Uniform { low, high, step, seed } = source else {
            let array = source.array().expect("it is the array of a file");
            return Ok(Arc::new(self.network.array(&array).clone()));
        };
        let length = shape.iter().try_fold(1u64, |product, &axis| product.checked_mul(axis));
        let length = length.filter(|&n| n <= MOST_UNIFORM).ok_or_else(|| {
            self.error("model.too-large", format!("Uniform would make more than {MOST_UNIFORM} numbers"), span)
                .help("use a Random projection, which does not store its synapses")
        })?;
        let levels = step.map_or(1.0, |step| ((high - low) / step).floor() + 1.0);
        if !(low.is_finite() && high.is_finite() && low <= high && (1.0..1e15).contains(&levels)) {
            let steps = step.map_or(String::new(), |step| format!(" in steps of {step}"));
            let message = format!("Uniform from {low} to {high}{steps} is not a range");
            return Err(self.error("model.uniform", message, span));
        }
        let numbers = (0..length).map(|i| match step {
            Some(step) => low + step * rng::below(levels as u64, *seed, i, 0) as f64,
            None => low + (high - low) * rng::unit(*seed, i, 0),
        });
        let numbers = Numbers::Reals(numbers.collect());
        let tensor = Tensor::new(shape.iter().map(|&axis| axis as usize).collect(), numbers);
        Ok(Arc::new(tensor.expect("a number for each element of the shape")))
    }

    fn projection(
        &self,
        desc: &ProjectionDesc,
        span: Span,
        nodes: &Nodes,
        graph: &mut DiGraph<Population, Projection>,
        rules: &mut IdVec<RuleId, DeclaredRule>,
    ) -> Result<(), Diagnostic> {
        let target = self.find(nodes, &desc.to, "'to'", || self.at(span, "to"))?;
        if matches!(graph[target].kind, PopulationKind::Input) {
            let message = format!("a projection ends at '{}', which is an input", desc.to);
            return Err(self.error("model.target", message, self.at(span, "to")));
        }
        if desc.from.is_empty() {
            let message = format!("the projection to '{}' has no source", desc.to);
            return Err(self.error("model.source", message, span));
        }
        let mut sources = Vec::new();
        for (index, name) in desc.from.iter().enumerate() {
            sources.push(self.find(nodes, name, "'from'", || self.at(span, &format!("from.[{index}]")))?);
        }
        for (index, &node) in sources.iter().enumerate() {
            if self.network.file().population(&desc.from[index]).is_some_and(|source| source.signal) {
                let message = format!("'{}' is a Signal, which sends no spikes to '{}'", desc.from[index], desc.to);
                let help = "name it in a rule, such as y2: Signal(\"..\"), or declare it as Input";
                return Err(self.error("model.source", message, self.at(span, &format!("from.[{index}]"))).help(help));
            }
            self.check_sends(&graph[node], &desc.to, || self.at(span, &format!("from.[{index}]")))?;
        }
        let declared = ProjectionLowering {
            lowering: self,
            span,
            desc,
            source_units: sources.iter().map(|&node| u64::from(graph[node].shape.len())).sum(),
            source_shape: graph[sources[0]].shape,
            target_shape: graph[target].shape,
        };
        let delay = declared.delay(desc.delay, "delay")?;
        let rule = declared.rule(&sources, target, nodes, graph)?.map(|rule| rules.push(rule));
        for Part { own_delay, synapses } in declared.parts()? {
            let delay = own_delay.map_or(Ok(delay), |own| declared.delay(own, "arrays.delay"))?;
            declared.add(delay, rule, synapses, &sources, target, graph);
        }
        Ok(())
    }

    /// Refuses a source that only integrates: its thresholds are the greatest, so it never spikes,
    /// and a core sends nothing but spikes.
    fn check_sends(&self, source: &Population, target: &str, place: impl Fn() -> Span) -> Result<(), Diagnostic> {
        let PopulationKind::Neurons(parameters) = &source.kind else { return Ok(()) };
        let greatest = f64::from(ThresholdMantissa::MAX.get());
        let never = |values: &Values| values.each.values().iter().all(|&threshold| threshold == greatest);
        if !parameters.kind.table().registers || !parameters.get("vth_mant").is_some_and(never) {
            return Ok(());
        }
        let message = format!(
            "'{}' never spikes, as its vth_mant is {greatest}, and its potential cannot be sent to '{target}'",
            source.name
        );
        Err(self
            .error("model.cannot-send", message, place())
            .help("remove the projection, or give the target a current of its own (du) in place of the integrator"))
    }
}

/// Synapses of a projection, and their own delay where they have one.
struct Part {
    own_delay: Option<u32>,
    synapses: ProjectionKind,
}

/// Channels, height, width.
type Volume = (u32, u32, u32);

/// A projection's declaration with the sizes of its ends.
struct ProjectionLowering<'a> {
    lowering: &'a Lowering<'a>,
    span: Span,
    desc: &'a ProjectionDesc,
    source_units: u64,
    source_shape: Shape,
    target_shape: Shape,
}

impl ProjectionLowering<'_> {
    fn parts(&self) -> Result<Vec<Part>, Diagnostic> {
        let whole = match &self.desc.kind {
            Kind::Dense(weights) => {
                let shape = [u64::from(self.target_shape.len()), self.source_units];
                ProjectionKind::Dense { weights: self.weights(weights, &shape)? }
            }
            Kind::Sparse(synapses) => self.sparse(synapses)?,
            Kind::Arrays(arrays) => return self.arrays(arrays),
            Kind::Conv2d { weights, stride, padding, padding_after, dilation, groups } => {
                self.conv(weights, [*stride, *padding, *padding_after, *dilation], *groups)?
            }
            &Kind::SumPool2d { kernel, stride, padding, padding_after, weight } => {
                self.pool([kernel, stride, padding, padding_after], weight)?
            }
            &Kind::Random { fan_out, low, high, seed } => self.random(fan_out, low, high, seed)?,
        };
        Ok(vec![Part { own_delay: None, synapses: whole }])
    }

    /// Adds a part of a projection, from each of its source populations.
    fn add(
        &self,
        delay: Delay,
        rule: Option<RuleId>,
        whole: ProjectionKind,
        sources: &[NodeIndex],
        target: NodeIndex,
        graph: &mut DiGraph<Population, Projection>,
    ) {
        let &ProjectionLowering { desc, span, .. } = self;
        let sizes = sources.iter().map(|&node| graph[node].shape.len());
        let firsts: Vec<u32> = sizes.scan(0, |next, size| Some(std::mem::replace(next, *next + size))).collect();
        // The quantiser refuses other widths. Weights that PES changes are of both signs.
        let is_pes = desc.learning.as_ref().is_some_and(|rule| rule.is_pes);
        let bits = WeightBits::new(desc.weight_bits).ok().filter(|_| !is_pes);
        let sign = desc.sign.unwrap_or_else(|| bits.map_or(SignMode::Mixed, |bits| whole.sign_of_weights(bits)));
        let kinds = match whole {
            ProjectionKind::Sparse { synapses } if sources.len() > 1 => {
                let mut by_source = vec![Vec::new(); sources.len()];
                for (from, to, weight, entry) in synapses {
                    // Of populations that begin at one source, all but the last are empty.
                    let place = firsts.partition_point(|&first| first <= from) - 1;
                    by_source[place].push((from - firsts[place], to, weight, entry));
                }
                by_source.into_iter().map(|synapses| ProjectionKind::Sparse { synapses }).collect()
            }
            whole => vec![whole; sources.len()],
        };
        let weights_span = match &desc.kind {
            Kind::Dense(_) | Kind::Conv2d { .. } => self.at("weights"),
            Kind::Arrays(_) => self.at("arrays.weight"),
            _ => span,
        };
        // A default value has no place in the file.
        let weight_exp = desc.weight_exp.map_or(0.into(), |value| self.located(value, "weight_exp"));
        let weight_bits = match desc.weight_bits {
            8 => 8.into(),
            bits => self.located(bits, "weight_bits"),
        };
        let weight_scale = desc.weight_scale.map(|value| self.located(value, "weight_scale"));
        for ((&source, first_source), kind) in sources.iter().zip(firsts).zip(kinds) {
            let projection = Projection {
                name: format!("{} -> {}", graph[source].name, graph[target].name),
                span,
                first_source,
                weight_exp: weight_exp.clone(),
                sign,
                weight_bits: weight_bits.clone(),
                port: desc.port,
                delay,
                weight_scale: weight_scale.clone(),
                weights_span,
                kind,
                rule,
            };
            graph.add_edge(source, target, projection);
        }
    }

    fn delay(&self, delay: u32, path: &str) -> Result<Delay, Diagnostic> {
        Delay::new(delay.into()).map_err(|e| {
            self.wrong("model.delay-range", e, path).help("longer delays need a relay population in between")
        })
    }

    /// The place of a path within the declaration.
    fn at(&self, path: &str) -> Span {
        self.lowering.at(self.span, path)
    }

    fn located<T>(&self, value: T, path: &str) -> Spanned<T> {
        Spanned { value, span: self.at(path) }
    }

    /// An error at a path within the declaration.
    fn error(&self, code: &'static str, message: impl Into<String>, path: &str) -> Diagnostic {
        self.lowering.error(code, message, self.at(path))
    }

    /// An error of the projection, which begins with its target.
    fn wrong(&self, code: &'static str, what: impl Display, path: &str) -> Diagnostic {
        self.error(code, format!("projection to '{}': {what}", self.desc.to), path)
    }

    /// The weights with exactly this shape; trailing axes of length 1 are allowed and dropped.
    fn weights(&self, weights: &Weights, shape: &[u64]) -> Result<Arc<Tensor>, Diagnostic> {
        let tensor = match weights {
            Weights::InPlace(tensor) => Arc::new(tensor.clone()),
            Weights::From(source) => self.lowering.source_tensor(source, shape, self.at("weights"))?,
        };
        let mut found: Vec<u64> = tensor.shape().iter().map(|&axis| axis as u64).collect();
        while found.len() > shape.len() && found.last() == Some(&1) {
            found.pop();
        }
        if found != shape {
            let what = format!("weights are {:?}, its populations need {shape:?}", tensor.shape());
            return Err(self.wrong("model.weights-shape", what, "weights").help(
                "weights are [target][source], kernels are [out channel][in channel / groups][height][width]; to \
                 change the size of a layer, train again with nsim train",
            ));
        }
        Ok(tensor)
    }

    /// The synapses of arrays by their own delay, where they have one.
    fn arrays(&self, arrays: &SynapseArrays) -> Result<Vec<Part>, Diagnostic> {
        if arrays.delay.is_some() && self.desc.delay != 0 {
            let what = "both its synapses and the projection have a delay";
            return Err(self.wrong("model.synapse-arrays", what, "arrays.delay"));
        }
        let network = self.lowering.network;
        let place = SynapsePlace {
            text: network.source(),
            declared: self.span,
            sources: self.source_units,
            targets: self.target_shape.len().into(),
        };
        let mut by_delay = arrays.read(|array| network.array(array), &place)?;
        if by_delay.is_empty() {
            by_delay.insert(None, Vec::new());
        }
        let parts = by_delay.into_iter();
        Ok(parts
            .map(|(own_delay, synapses)| Part { own_delay, synapses: ProjectionKind::Sparse { synapses } })
            .collect())
    }

    fn sparse(&self, listed: &[(u64, u64, f64)]) -> Result<ProjectionKind, Diagnostic> {
        let targets = u64::from(self.target_shape.len());
        let mut synapses = Vec::with_capacity(listed.len());
        for (&(source, target, weight), entry) in listed.iter().zip(0..) {
            for (what, index, size) in [("source", source, self.source_units), ("target", target, targets)] {
                if index >= size {
                    let what = format!("{what} {index} is outside 0..{size}");
                    return Err(self.wrong("model.synapse-index", what, &format!("synapses.[{entry}]")));
                }
            }
            synapses.push((source as u32, target as u32, weight, entry));
        }
        Ok(ProjectionKind::Sparse { synapses })
    }

    fn volumes(&self, what: &str) -> Result<(Volume, Volume), Diagnostic> {
        if self.desc.from.len() != 1 {
            let message = format!("{what} to '{}' has {} sources", self.desc.to, self.desc.from.len());
            return Err(self.error("model.window", message, "").help("declare one projection for each source"));
        }
        match (self.source_shape.volume(), self.target_shape.volume()) {
            (Some(source), Some(target)) => Ok((source, target)),
            _ => {
                let ProjectionLowering { source_shape, target_shape, desc, .. } = self;
                let message = format!("{what} to '{}' connects shape {source_shape} to {target_shape}", desc.to);
                Err(self.error("model.window", message, "").help("both shapes must be [channels, height, width]"))
            }
        }
    }

    /// Numbers of a window, each from `least` to 65,535.
    fn pair(&self, pair: (u64, u64), what: &str, least: u64) -> Result<(u32, u32), Diagnostic> {
        let range = least..=65_535;
        if !range.contains(&pair.0) || !range.contains(&pair.1) {
            return Err(self.wrong("model.window", format!("{what} {pair:?} is outside {range:?}"), what));
        }
        Ok((pair.0 as u32, pair.1 as u32))
    }

    /// Checks that the window gives exactly the target's size, with `after` silent rows and columns
    /// appended to the source.
    fn check_window(&self, window: &Window, after: (u64, u64)) -> Result<(), Diagnostic> {
        let after = self.pair(after, "padding_after", 0)?;
        fn size(source: u32, kernel: u32, stride: u32, padding: (u32, u32), dilation: u32) -> Option<u64> {
            let reach = u64::from(dilation) * u64::from(kernel - 1) + 1;
            let room = u64::from(source) + u64::from(padding.0) + u64::from(padding.1);
            room.checked_sub(reach).map(|slack| slack / u64::from(stride) + 1)
        }
        let Window { source: (_, from_height, from_width), target: (_, height, width), .. } = *window;
        let Window { kernel, stride, padding, dilation, .. } = *window;
        let sides = [
            size(from_height, kernel.0, stride.0, (padding.0, after.0), dilation.0),
            size(from_width, kernel.1, stride.1, (padding.1, after.1), dilation.1),
        ];
        if sides != [height, width].map(|side| Some(u64::from(side))) {
            let [high, wide] = sides.map(|side| side.map_or("nothing".to_string(), |side| side.to_string()));
            let what = format!(
                "the window makes {high} x {wide} from {from_height} x {from_width}, the population is {height} x \
                {width}"
            );
            return Err(self.wrong("model.window", what, "").help(
                "size = (source + padding + padding_after - dilation (kernel - 1) - 1) / stride + 1, rounded down",
            ));
        }
        Ok(())
    }

    fn conv(
        &self,
        weights: &Weights,
        [stride, padding, padding_after, dilation]: [(u64, u64); 4],
        groups: u64,
    ) -> Result<ProjectionKind, Diagnostic> {
        let (source, target) = self.volumes("Conv2d")?;
        if groups == 0 || u64::from(source.0) % groups != 0 || u64::from(target.0) % groups != 0 {
            let what =
                format!("the number of groups, {groups}, does not divide {} and {} channels", source.0, target.0);
            return Err(self.wrong("model.window", what, "groups"));
        }
        // The weights give the kernel's size, so they are read first.
        let Some(kernel) = self.lowering.network.tensor(weights).map(|kernel| kernel.shape().to_vec()) else {
            return Err(self
                .error("model.window", "the size of the convolution's kernel is missing", "weights")
                .help("give the kernel in the model or as a file"));
        };
        let (Some(&kh), Some(&kw)) = (kernel.get(2), kernel.get(3)) else {
            return Err(self
                .wrong("model.weights-shape", format!("the kernel is {kernel:?}"), "weights")
                .help("kernels are [out channel][in channel / groups][height][width]"));
        };
        let shape = [u64::from(target.0), u64::from(source.0) / groups, kh as u64, kw as u64];
        let weights = self.weights(weights, &shape)?;
        if kh == 0 || kw == 0 || kh > 65_535 || kw > 65_535 {
            return Err(self.error("model.window", format!("a kernel of {kh} x {kw}"), "weights"));
        }
        let window = Window {
            source,
            target,
            kernel: (kh as u32, kw as u32),
            stride: self.pair(stride, "stride", 1)?,
            padding: self.pair(padding, "padding", 0)?,
            dilation: self.pair(dilation, "dilation", 1)?,
            groups: groups as u32,
        };
        self.check_window(&window, padding_after)?;
        Ok(ProjectionKind::Conv2d { window, weights })
    }

    fn pool(
        &self,
        [kernel, stride, padding, padding_after]: [(u64, u64); 4],
        weight: f64,
    ) -> Result<ProjectionKind, Diagnostic> {
        let (source, target) = self.volumes("SumPool2d")?;
        let window = Window {
            source,
            target,
            kernel: self.pair(kernel, "kernel", 1)?,
            stride: self.pair(stride, "stride", 1)?,
            padding: self.pair(padding, "padding", 0)?,
            dilation: (1, 1),
            groups: source.0,
        };
        if source.0 != target.0 {
            let message = format!("SumPool2d to '{}' goes from {} to {} channels", self.desc.to, source.0, target.0);
            return Err(self.error("model.window", message, ""));
        }
        self.check_window(&window, padding_after)?;
        Ok(ProjectionKind::SumPool2d { window, weight: self.located(weight, "weight") })
    }

    fn random(&self, fan_out: u64, low: i64, high: i64, seed: u64) -> Result<ProjectionKind, Diagnostic> {
        let synapses = self.source_units.checked_mul(fan_out);
        if synapses.is_none_or(|n| n > MOST_SYNAPSES) || u32::try_from(fan_out).is_err() {
            let what = format!("{} sources times {fan_out} synapses is more than {MOST_SYNAPSES}", self.source_units);
            return Err(self.wrong("model.too-large", what, "fan_out"));
        }
        if self.desc.weight_scale.is_some() {
            let message = "a Random projection has integer weights and does not support weight_scale";
            return Err(self.error("model.random", message, "weight_scale"));
        }
        let (low, high) = (self.located(low, "low"), self.located(high, "high"));
        Ok(ProjectionKind::Random { fan_out: fan_out as u32, low, high, seed })
    }
}
