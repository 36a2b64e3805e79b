//! Populations and projections with real parameters: the model before quantisation.
//!
//! `nsim_files::lower` makes a [`Graph`]. Invariants: names are unique, endpoints exist, shapes and
//! array sizes agree, delays are in range, and there is one output population of compartments.
//! `nsim_quantise::quantise` checks that numbers fit their hardware fields.

use std::fmt;
use std::sync::Arc;

use petgraph::Direction;
use petgraph::graph::{DiGraph, EdgeIndex, NodeIndex};
use petgraph::visit::EdgeRef;
use serde::{Deserialize, Serialize};

use crate::arithmetic::{ReadOut, ResetDesc, Semantics, ThresholdTest, WeightRounding};
use crate::base::diagnostic::{Diagnostic, SourceText, Span};
use crate::base::fixed::{Delay, SignMode, WeightBits};
use crate::base::id::{IdVec, RuleId};
use crate::base::warning::Warning;
use crate::learning::Learning;
use crate::locate::locate;
use crate::neurons::{NeuronKind, Port};
use crate::spanned::Spanned;
use crate::spikes::Message;
use crate::tensor::{Numbers, Tensor};

/// The most channels or compartments of a network. No target could hold more: 768 chips of 131,072
/// compartments have 100,663,296.
pub const MOST_UNITS: u64 = 1 << 27;
/// The most channels of an input population: four times the channels of the largest event cameras,
/// with both polarities. Each channel has its own lists, used or not.
pub const MOST_CHANNELS: u64 = 1 << 24;
/// The most synapses of a projection.
pub const MOST_SYNAPSES: u64 = 1 << 32;

/// The shape of a population, flattened in C order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
pub enum Shape {
    /// `[n]`
    Line(u32),
    /// `[channels, height, width]`
    Volume(u32, u32, u32),
}

impl Shape {
    /// Number of channels or compartments.
    pub fn len(self) -> u32 {
        match self {
            Shape::Line(n) => n,
            Shape::Volume(c, h, w) => c * h * w,
        }
    }

    /// [`Shape::len`]; `None` where it is 2^32 or more.
    pub fn checked_len(self) -> Option<u32> {
        match self {
            Shape::Line(n) => Some(n),
            Shape::Volume(c, h, w) => c.checked_mul(h)?.checked_mul(w),
        }
    }

    /// Positions of each channel: height times width, 1 on a line.
    pub fn positions(self) -> u32 {
        match self {
            Shape::Line(_) => 1,
            Shape::Volume(_, h, w) => h * w,
        }
    }

    /// Whether there is no unit; a lowered population always has one.
    pub fn is_empty(self) -> bool {
        self.len() == 0
    }

    /// Channels, height and width, for projections over space; `None` on a line.
    pub fn volume(self) -> Option<(u32, u32, u32)> {
        match self {
            Shape::Line(_) => None,
            Shape::Volume(c, h, w) => Some((c, h, w)),
        }
    }

    /// The lengths of its axes, outermost first.
    pub fn axes(self) -> Vec<u32> {
        match self {
            Shape::Line(n) => vec![n],
            Shape::Volume(c, h, w) => vec![c, h, w],
        }
    }
}

impl fmt::Display for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.axes())
    }
}

/// One value for all compartments of a population, or one for each.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
pub enum PerCompartment<T> {
    /// One value for all compartments.
    Same(T),
    /// One value for each compartment, in order.
    Each(Vec<T>),
}

impl<T: Copy> PerCompartment<T> {
    /// The value of one compartment.
    #[inline]
    pub fn get(&self, index: u32) -> T {
        match self {
            PerCompartment::Same(value) => *value,
            PerCompartment::Each(values) => values[index as usize],
        }
    }

    /// All values: the common one, or one for each compartment.
    pub fn values(&self) -> &[T] {
        match self {
            PerCompartment::Same(value) => std::slice::from_ref(value),
            PerCompartment::Each(values) => values,
        }
    }

    /// Whether `f` is true of any value.
    pub fn any(&self, f: impl Fn(&T) -> bool) -> bool {
        self.values().iter().any(f)
    }

    /// The values of the compartments at these indices.
    pub fn pick(&self, indices: &[u32]) -> PerCompartment<T> {
        match self {
            PerCompartment::Same(value) => PerCompartment::Same(*value),
            PerCompartment::Each(_) => PerCompartment::Each(indices.iter().map(|&index| self.get(index)).collect()),
        }
    }

    /// Maps every value by `f`, which gets the compartment's index, or `None` for a common value.
    ///
    /// # Errors
    /// The first error of `f`.
    pub fn try_map<U, E>(&self, mut f: impl FnMut(Option<u32>, T) -> Result<U, E>) -> Result<PerCompartment<U>, E> {
        Ok(match self {
            PerCompartment::Same(value) => PerCompartment::Same(f(None, *value)?),
            PerCompartment::Each(values) => PerCompartment::Each(
                values.iter().enumerate().map(|(i, &value)| f(Some(i as u32), value)).collect::<Result<_, _>>()?,
            ),
        })
    }
}

/// A parameter's values, and their place in the model file.
#[derive(Debug, Clone)]
pub struct Values {
    /// The values.
    pub each: PerCompartment<f64>,
    /// Their place in the model file.
    pub span: Span,
}

impl Values {
    /// A common value that no file gave.
    pub fn constant(value: f64) -> Self {
        Values { each: PerCompartment::Same(value), span: Span::default() }
    }
}

/// The parameters of a population of compartments.
#[derive(Debug, Clone)]
pub struct NeuronParameters {
    /// The kind of its neurons.
    pub kind: NeuronKind,
    /// The parameters that the file gives, by name.
    pub given: Vec<(&'static str, Values)>,
    /// The step before which the population is held at zero.
    pub start_step: u32,
    /// Upper bound of the input of a step, in the units of the weights; `None`: the sum of all
    /// weights.
    pub greatest_input: Option<f64>,
}

impl NeuronParameters {
    /// The values of a parameter that the file gives.
    pub fn get(&self, name: &str) -> Option<&Values> {
        self.given.iter().find(|(given, _)| *given == name).map(|(_, values)| values)
    }

    /// The values of a parameter in real units that the file gives, if the kind has such a
    /// parameter. A kind from the model file may use the name for an integer.
    pub fn real(&self, name: &str) -> Option<&Values> {
        let forms = self.kind.parameters().iter().filter_map(|field| field.real);
        forms.map(|(real, _)| real).find(|real| *real == name).and_then(|real| self.get(real))
    }

    /// A parameter of one compartment: from the file, else its default, else 0.
    pub fn value(&self, name: &str, index: u32) -> f64 {
        match self.get(name) {
            Some(values) => values.each.get(index),
            None => {
                let field = self.kind.parameters().iter().find(|field| field.name == name);
                field.and_then(|field| field.default).unwrap_or(0) as f64
            }
        }
    }
}

/// The units of a population.
#[derive(Debug, Clone)]
pub enum PopulationKind {
    /// Channels that a stimulus drives.
    Input,
    /// Compartments.
    Neurons(NeuronParameters),
    /// Spike response neurons.
    Srm(SrmParameters),
}

/// The parameters of a population of spike response neurons; times are above 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SrmParameters {
    /// Time constant of the response in ms.
    pub tau_sr_ms: f64,
    /// Time constant of the refractory response in ms.
    pub tau_ref_ms: f64,
    /// Peak of the refractory response in thresholds, at least 0.
    pub scale_ref: f64,
    /// Threshold, above 0, in the units of the weights.
    pub theta: f64,
}

/// A node of the graph.
#[derive(Debug, Clone)]
pub struct Population {
    /// Its name, unique in the network.
    pub name: String,
    /// Its declaration in the file.
    pub span: Span,
    /// Its shape.
    pub shape: Shape,
    /// Its units.
    pub kind: PopulationKind,
    /// The content of its messages.
    pub message: Message,
}

/// A window sliding over a `[C, H, W]` population; pairs are (y, x).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Window {
    /// Source channels, height, width.
    pub source: (u32, u32, u32),
    /// Target channels, height, width.
    pub target: (u32, u32, u32),
    /// Size of the window.
    pub kernel: (u32, u32),
    /// Step of the window.
    pub stride: (u32, u32),
    /// Rows and columns of padding around the source.
    pub padding: (u32, u32),
    /// Distance of neighbours within the window.
    pub dilation: (u32, u32),
    /// Channel groups.
    pub groups: u32,
}

/// Synapses of a projection, with real weights.
#[derive(Debug, Clone)]
pub enum ProjectionKind {
    /// All to all: `[target][column]`; the projection's sources are the columns from
    /// `first_source`.
    Dense {
        /// Weights of all columns of the declaration.
        weights: Arc<Tensor>,
    },
    /// Listed: (source within this population, target, weight, entry of the declared list).
    Sparse {
        /// The synapses.
        synapses: Vec<(u32, u32, f64, u32)>,
    },
    /// Cross-correlation with `[C'][C / groups][kh][kw]`.
    Conv2d {
        /// Geometry.
        window: Window,
        /// Kernel.
        weights: Arc<Tensor>,
    },
    /// One weight, from each position of a window.
    SumPool2d {
        /// Geometry; the groups are the channels.
        window: Window,
        /// The weight and its place.
        weight: Spanned<f64>,
    },
    /// Seeded random synapses.
    Random {
        /// Synapses of each source.
        fan_out: u32,
        /// The least weight.
        low: Spanned<i64>,
        /// The greatest weight.
        high: Spanned<i64>,
        /// The seed.
        seed: u64,
    },
}

impl ProjectionKind {
    /// Calls `f` for every given weight, or for the bounds of random ones.
    pub fn each_weight(&self, mut f: impl FnMut(f64)) {
        match self {
            ProjectionKind::Dense { weights } | ProjectionKind::Conv2d { weights, .. } => weights.reals().for_each(f),
            ProjectionKind::Sparse { synapses } => synapses.iter().for_each(|synapse| f(synapse.2)),
            ProjectionKind::SumPool2d { weight, .. } => f(weight.value),
            ProjectionKind::Random { low, high, .. } => [low, high].into_iter().for_each(|bound| f(bound.value as f64)),
        }
    }

    /// The sign mode of weights of this many bits where none is stated: mixed if it changes no
    /// weight, else that of the only sign, whose steps are half as wide; mixed for both signs.
    pub fn sign_of_weights(&self, bits: WeightBits) -> SignMode {
        let step = f64::from(SignMode::Mixed.step(bits));
        let (mut exact, mut negative, mut positive) = (true, false, false);
        self.each_weight(|weight| {
            exact &= weight % step == 0.0;
            negative |= weight < 0.0;
            positive |= weight > 0.0;
        });
        match (negative, positive) {
            _ if exact => SignMode::Mixed,
            (false, true) => SignMode::Excitatory,
            (true, false) => SignMode::Inhibitory,
            _ => SignMode::Mixed,
        }
    }

    /// Whether no two synapses share a weight.
    pub fn has_own_weights(&self) -> bool {
        matches!(self, ProjectionKind::Dense { .. } | ProjectionKind::Sparse { .. })
    }

    /// Returns this kind with weights mapped by `f`, which gets each with its target, or with its
    /// output channel where a kernel is shared. The weights of a pool and of random synapses stay.
    pub fn map_weights(&self, f: impl Fn(usize, f64) -> f64) -> ProjectionKind {
        let tensor = |weights: &Arc<Tensor>| {
            let per_row = (weights.len() / weights.shape().first().copied().unwrap_or(1).max(1)).max(1);
            let numbers = (0..weights.len()).map(|i| f(i / per_row, weights.real(i))).collect();
            let mapped = Tensor::new(weights.shape().to_vec(), Numbers::Reals(numbers));
            mapped.map_or_else(|| weights.clone(), Arc::new)
        };
        match self {
            ProjectionKind::Dense { weights } => ProjectionKind::Dense { weights: tensor(weights) },
            ProjectionKind::Conv2d { window, weights } => {
                ProjectionKind::Conv2d { window: *window, weights: tensor(weights) }
            }
            ProjectionKind::Sparse { synapses } => {
                let each =
                    synapses.iter().map(|&(source, target, w, entry)| (source, target, f(target as usize, w), entry));
                ProjectionKind::Sparse { synapses: each.collect() }
            }
            ProjectionKind::SumPool2d { .. } | ProjectionKind::Random { .. } => self.clone(),
        }
    }
}

/// An edge of the graph, from one population to one population.
#[derive(Debug, Clone)]
pub struct Projection {
    /// `source -> target`, for messages.
    pub name: String,
    /// Its declaration in the file.
    pub span: Span,
    /// The index of this population's first unit among the concatenated sources of the declaration.
    pub first_source: u32,
    /// Weight exponent.
    pub weight_exp: Spanned<i64>,
    /// Sign mode.
    pub sign: SignMode,
    /// Bits of a weight.
    pub weight_bits: Spanned<i64>,
    /// The sum of arrivals of its target that it adds to.
    pub port: Port,
    /// Delay field.
    pub delay: Delay,
    /// Mantissa units for a real weight of 1.
    pub weight_scale: Option<Spanned<f64>>,
    /// Place of the weights.
    pub weights_span: Span,
    /// Its synapses.
    pub kind: ProjectionKind,
    /// The rule of its declaration, one of [`NetworkFacts::rules`].
    pub rule: Option<RuleId>,
}

/// The learning rule of a declaration, and the first state of its synapses, by row.
///
/// Rows number the synapses of the declaration: target by target for `Dense`, as listed for
/// `Sparse`, source by source for `Random`.
#[derive(Debug, Clone)]
pub struct DeclaredRule {
    /// The rule.
    pub learning: Learning,
    /// Its place in the model file.
    pub span: Span,
    /// Units of all sources.
    pub sources: u32,
    /// First tags.
    pub tags: PerCompartment<i16>,
    /// First delays where delays do not act.
    pub delays: PerCompartment<i16>,
    /// The populations whose values replace y1, y2 and y3.
    pub signals: [Option<NodeIndex>; 3],
    /// The population whose spikes are rewards.
    pub reward: Option<NodeIndex>,
}

impl Projection {
    /// The place of a row of weights, or of a listed synapse; else the place of all weights.
    pub fn place_of(&self, source: &SourceText, entry: u32) -> Span {
        let in_place = ["weights", "synapses"].map(|list| format!("{list}.{entry}"));
        let span = in_place.iter().find_map(|path| locate(source.text(), self.span, path));
        span.unwrap_or(self.weights_span)
    }
}

/// Facts about a network as a whole.
#[derive(Debug, Clone)]
pub struct NetworkFacts {
    /// The network's name.
    pub name: String,
    /// Its file, for messages.
    pub source: SourceText,
    /// Milliseconds that a timestep represents.
    pub timestep_ms: f64,
    /// The score by which the output population decides.
    pub decision: ReadOut,
    /// Steps of a sample after its last input step.
    pub drain: u32,
    /// Names of classes, one for each output compartment, or none.
    pub classes: Vec<String>,
    /// Periodic reset.
    pub reset: Option<ResetDesc>,
    /// The threshold test.
    pub threshold: ThresholdTest,
    /// The arithmetic.
    pub semantics: Semantics,
    /// The rounding of weights.
    pub weight_rounding: WeightRounding,
    /// The stimulus used when none is given.
    pub scene: Option<String>,
    /// The origin of the network.
    pub provenance: Option<String>,
    /// Assumptions and losses of the reader of another tool's file.
    pub warnings: Vec<Warning>,
    /// Learning rules.
    pub rules: IdVec<RuleId, DeclaredRule>,
}

/// The network with real parameters.
#[derive(Debug, Clone)]
pub struct Graph {
    facts: NetworkFacts,
    graph: DiGraph<Population, Projection>,
    output: NodeIndex,
}

impl Graph {
    /// A graph from checked parts; `nsim_files::lower` makes one from a file.
    ///
    /// # Panics
    /// When `output` is not one of the nodes.
    pub fn new(facts: NetworkFacts, graph: DiGraph<Population, Projection>, output: NodeIndex) -> Self {
        assert!(graph.node_weight(output).is_some(), "the output population is a node");
        Graph { facts, graph, output }
    }

    /// Refuses neurons and rules that have no form in real numbers.
    ///
    /// # Errors
    /// `model.no-real-form`, `model.learning`.
    pub fn has_real_form(&self) -> Result<(), Diagnostic> {
        self.refuse_rules("cannot be run in real numbers")?;
        let lacking = self.populations().find_map(|(_, population)| match &population.kind {
            PopulationKind::Neurons(p) if !p.kind.table().registers => Some((population, p.kind.name())),
            _ => None,
        });
        let Some((Population { name, span, .. }, kind)) = lacking else { return Ok(()) };
        let message = format!("population '{name}' has {kind} neurons, which cannot be run in real numbers");
        Err(Diagnostic::new("model.no-real-form", message)
            .at(&self.facts.source, *span)
            .help("use nsim run or nsim energy; --engine golden checks the fast engine"))
    }

    /// Refuses learning rules: a rule, followed by `why`.
    ///
    /// # Errors
    /// `model.learning`.
    pub fn refuse_rules(&self, why: &str) -> Result<(), Diagnostic> {
        let Some(DeclaredRule { learning, span, .. }) = self.facts.rules.iter().next() else { return Ok(()) };
        let message = format!("the learning rule of projection '{}' {why}", learning.name);
        let help = "remove the field learning, or learn first: nsim run MODEL --learned OUT.ron --freeze";
        Err(Diagnostic::new("model.learning", message).at(&self.facts.source, *span).help(help))
    }

    /// Facts about the network as a whole.
    pub fn facts(&self) -> &NetworkFacts {
        &self.facts
    }

    /// Populations in the order of the file.
    pub fn populations(&self) -> impl Iterator<Item = (NodeIndex, &Population)> {
        self.graph.node_indices().map(|node| (node, &self.graph[node]))
    }

    /// Projections in the order of the file, with source and target.
    pub fn projections(&self) -> impl Iterator<Item = (EdgeIndex, NodeIndex, NodeIndex, &Projection)> {
        self.graph.edge_indices().filter_map(|edge| {
            let (source, target) = self.graph.edge_endpoints(edge)?;
            Some((edge, source, target, &self.graph[edge]))
        })
    }

    /// Projections into a population in the order of the file, with their sources.
    pub fn incoming(&self, node: NodeIndex) -> impl Iterator<Item = (NodeIndex, &Projection)> {
        // petgraph lists the last first.
        let mut into: Vec<_> = self.graph.edges_directed(node, Direction::Incoming).collect();
        into.sort_unstable_by_key(EdgeRef::id);
        into.into_iter().map(|edge| (edge.source(), edge.weight()))
    }

    /// The index of each projection's declaration in the file, in the order of the projections. A
    /// declaration makes one projection for each population of its `from`.
    pub fn declared_places(&self) -> Vec<usize> {
        let spans: Vec<Span> = self.projections().map(|(.., projection)| projection.span).collect();
        let mut place = 0;
        let each = spans.iter().enumerate().map(|(index, span)| {
            place += usize::from(index > 0 && spans[index - 1] != *span);
            place
        });
        each.collect()
    }

    /// A population.
    pub fn population(&self, node: NodeIndex) -> &Population {
        &self.graph[node]
    }

    /// The output population.
    pub fn output(&self) -> NodeIndex {
        self.output
    }

    /// Whether a population has spike response neurons.
    pub fn has_srm(&self) -> bool {
        self.populations().any(|(_, population)| matches!(population.kind, PopulationKind::Srm(_)))
    }

    /// Returns this network with the units of each population replaced by `f`.
    pub fn with_kinds(&self, mut f: impl FnMut(NodeIndex, &Population) -> PopulationKind) -> Graph {
        let mut graph = self.clone();
        for node in self.graph.node_indices() {
            graph.graph[node].kind = f(node, &self.graph[node]);
        }
        graph
    }

    /// Returns this network with each projection replaced by `f`, which also gets its target.
    pub fn with_projections(&self, mut f: impl FnMut(NodeIndex, &Projection) -> Projection) -> Graph {
        let mut graph = self.clone();
        for (edge, _, target, projection) in self.projections() {
            graph.graph[edge] = f(target, projection);
        }
        graph
    }

    /// Returns this network with more projections at the end, each with source and target.
    #[must_use]
    pub fn and_projections(mut self, added: Vec<(NodeIndex, NodeIndex, Projection)>) -> Graph {
        for (source, target, projection) in added {
            self.graph.add_edge(source, target, projection);
        }
        self
    }

    /// The petgraph, for algorithms over it.
    pub fn petgraph(&self) -> &DiGraph<Population, Projection> {
        &self.graph
    }
}
