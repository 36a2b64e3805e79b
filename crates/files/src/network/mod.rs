//! A model file (`models/*.ron`; `docs/formats.md` describes each field).
//!
//! [`NetworkFile`] is the content of a model file, parsed or built by a reader of foreign files;
//! serde makes its text. [`Network`] is a file with its text, for messages, and with every array
//! that it refers to. Values do not store their places; [`nsim_ir::locate`] finds the place that a
//! message needs. Lowering to a graph checks that the values are consistent.

mod kinds;
pub mod learned;
pub mod learning;
mod read;
mod resolve;
pub mod values;
mod write;

use std::collections::{BTreeMap, HashSet};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use self::kinds::with_kinds;
use self::learning::RuleDesc;
use self::values::is_default;
pub use self::values::{Source, Weights, tensor};
use super::synapses::SynapseArrays;
use nsim_ir::arithmetic::{ReadOut, ResetDesc, Semantics, ThresholdTest, WeightRounding};
use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText, Span};
use nsim_ir::base::fixed::SignMode;
use nsim_ir::base::warning::Warning;
use nsim_ir::learning::LearningSemantics;
use nsim_ir::locate::locate;
use nsim_ir::neurons::{MicrocodeKind, NeuronKind, Port};
use nsim_ir::spanned::{parse, parse_part};
pub use nsim_ir::tensor::ArrayRef;
use nsim_ir::tensor::Tensor;

/// A parameter of a population.
#[derive(Debug, Clone, PartialEq)]
pub enum Parameter {
    /// One value for all compartments.
    Same(f64),
    /// One for each compartment.
    Each(Vec<f64>),
    /// One for each compartment, elsewhere.
    From(Source),
}

impl Parameter {
    /// One value for all compartments when all are equal.
    pub fn from_values(values: Vec<f64>) -> Parameter {
        match values.first() {
            Some(&first) if values.iter().all(|value| value.to_bits() == first.to_bits()) => Parameter::Same(first),
            _ => Parameter::Each(values),
        }
    }

    /// The value of one compartment, of a model whose arrays are in place.
    ///
    /// # Panics
    /// When `index` is out of range, or the values are elsewhere.
    pub fn get(&self, index: usize) -> f64 {
        match self {
            Parameter::Same(value) => *value,
            Parameter::Each(values) => values[index],
            Parameter::From(source) => panic!("{source:?} is not loaded"),
        }
    }

    /// The values that are in place: one for all compartments, or one for each.
    pub fn values(&self) -> &[f64] {
        match self {
            Parameter::Same(value) => std::slice::from_ref(value),
            Parameter::Each(values) => values,
            Parameter::From(_) => &[],
        }
    }

    /// The parameter with `f` applied to every value that is in place.
    pub fn map(&self, f: impl Fn(f64) -> f64) -> Parameter {
        match self {
            Parameter::Same(value) => Parameter::Same(f(*value)),
            Parameter::Each(values) => Parameter::from_values(values.iter().map(|&value| f(value)).collect()),
            Parameter::From(_) => self.clone(),
        }
    }
}

/// A population.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PopulationDesc {
    /// Its name.
    pub name: String,
    /// `[n]` or `[channels, height, width]`.
    pub shape: Vec<u64>,
    /// The kind of its compartments.
    pub kind: NeuronKind,
    /// Parameters of compartments that the file gives, in the order of
    /// [`NeuronKind::parameter_names`].
    pub loihi: Option<Vec<(&'static str, Parameter)>>,
    /// Parameters of spike response neurons with alpha kernels, as SLAYER trains them. With neither
    /// `loihi` nor `srm`, it is an input.
    pub srm: Option<[(&'static str, f64); 4]>,
    /// The step before which it is held at zero.
    pub start_step: u32,
    /// The integer that each of its spikes carries; none for binary spikes.
    pub payload: Option<i64>,
    /// Bits of the integers that its messages carry; none for spikes, and for kinds that send
    /// integers of 32 bits.
    pub message_bits: Option<i64>,
    /// Whether it is an input whose values are a trace of learning rules.
    pub signal: bool,
}

impl PopulationDesc {
    /// An input population, whose channels a stimulus drives.
    pub fn input(name: &str, shape: Vec<u64>) -> Self {
        PopulationDesc { name: name.to_string(), shape, ..PopulationDesc::default() }
    }

    /// A population of compartments with these parameters.
    pub fn loihi(name: &str, shape: Vec<u64>, parameters: Vec<(&'static str, Parameter)>) -> Self {
        PopulationDesc { loihi: Some(parameters), ..PopulationDesc::input(name, shape) }
    }

    /// The name of its kind in model files.
    pub fn kind_name(&self) -> &'static str {
        match (self.srm, &self.loihi) {
            (Some(_), _) => "Srm",
            (None, Some(_)) => self.kind.name(),
            (None, None) if self.signal => "Signal",
            (None, None) => "Input",
        }
    }

    /// Number of its channels or compartments.
    pub fn units(&self) -> u64 {
        self.shape.iter().fold(1, |product: u64, &axis| product.saturating_mul(axis))
    }

    /// A parameter by name.
    pub fn parameter(&self, name: &str) -> Option<&Parameter> {
        self.loihi.as_ref()?.iter().find(|(key, _)| *key == name).map(|(_, value)| value)
    }
}

/// Connectivity of a projection. Pairs are (y, x).
#[derive(Debug, Clone, PartialEq)]
pub enum ProjectionKind {
    /// Every source reaches every target: `[target][source]`.
    Dense(Weights),
    /// Listed synapses, (source, target, weight) each.
    Sparse(Vec<(u64, u64, f64)>),
    /// Listed synapses as arrays in files.
    Arrays(SynapseArrays),
    /// A two-dimensional convolution (cross-correlation with the kernel as stored) from one
    /// population `[C, H, W]` to one `[C', H', W']`.
    Conv2d {
        /// `[C'][C / groups][kh][kw]`.
        weights: Weights,
        /// Step.
        stride: (u64, u64),
        /// Silent rows above and columns left of the source.
        padding: (u64, u64),
        /// Silent rows below and columns right of the source.
        padding_after: (u64, u64),
        /// Distance of neighbours.
        dilation: (u64, u64),
        /// Channel groups.
        groups: u64,
    },
    /// Sum pooling from one population `[C, H, W]` to one `[C, H', W']`: each position of a window
    /// reaches its channel's compartment with one weight.
    SumPool2d {
        /// Window.
        kernel: (u64, u64),
        /// Step.
        stride: (u64, u64),
        /// Silent rows above and columns left of the source.
        padding: (u64, u64),
        /// Silent rows below and columns right of the source.
        padding_after: (u64, u64),
        /// The weight of each synapse.
        weight: f64,
    },
    /// Random synapses: each source reaches `fan_out` targets, sampled independently (a target may
    /// be sampled twice), with weights from the multiples of the least step in `low..=high`.
    Random {
        /// Synapses of each source.
        fan_out: u64,
        /// The least weight.
        low: i64,
        /// The greatest weight.
        high: i64,
        /// The seed.
        seed: u64,
    },
}

/// A projection.
#[derive(Debug, Clone, PartialEq)]
pub struct ProjectionDesc {
    /// Its name, by which rules are identified.
    pub name: Option<String>,
    /// Source populations, concatenated.
    pub from: Vec<String>,
    /// Target population.
    pub to: String,
    /// Its connectivity.
    pub kind: ProjectionKind,
    /// Weight exponent; nsim chooses an absent one, 0 with an integer threshold.
    pub weight_exp: Option<i64>,
    /// Sign mode; where it is absent, the weights choose it.
    pub sign: Option<SignMode>,
    /// Bits of a weight.
    pub weight_bits: i64,
    /// Delay field.
    pub delay: u32,
    /// A real weight of 1 in units of the weight mantissa.
    pub weight_scale: Option<f64>,
    /// The sum of its target that it adds to.
    pub port: Port,
    /// The rule by which its synapses change.
    pub learning: Option<RuleDesc>,
}

impl ProjectionDesc {
    /// A projection with the default synapse format.
    pub fn new(from: &str, to: &str, kind: ProjectionKind) -> Self {
        ProjectionDesc {
            name: None,
            from: vec![from.to_string()],
            to: to.to_string(),
            kind,
            weight_exp: None,
            sign: None,
            weight_bits: 8,
            delay: 0,
            weight_scale: None,
            port: Port::First,
            learning: None,
        }
    }

    /// Its name, or `SOURCE->TARGET`.
    pub fn name_or_ends(&self) -> String {
        self.name.clone().unwrap_or_else(|| format!("{}->{}", self.from.join("+"), self.to))
    }

    /// The name of its kind in model files.
    pub fn kind_name(&self) -> &'static str {
        match &self.kind {
            ProjectionKind::Dense(_) => "Dense",
            ProjectionKind::Sparse(_) | ProjectionKind::Arrays(_) => "Sparse",
            ProjectionKind::Conv2d { .. } => "Conv2d",
            ProjectionKind::SumPool2d { .. } => "SumPool2d",
            ProjectionKind::Random { .. } => "Random",
        }
    }

    /// The weights, for the kinds that have an array of them.
    pub fn weights(&self) -> Option<&Weights> {
        match &self.kind {
            ProjectionKind::Dense(weights) | ProjectionKind::Conv2d { weights, .. } => Some(weights),
            _ => None,
        }
    }
}

/// Silent places after an axis of `source` places with which a window makes `target` outputs. The
/// window has this reach, this stride and `before` silent places before the axis. The result is
/// `before` where that number suffices and adds no output, else the fewest places.
pub fn padding_after(source: u64, target: u64, reach: u64, stride: u64, before: u64) -> u64 {
    let last = target.saturating_sub(1).saturating_mul(stride).saturating_add(reach);
    let fewest = last.saturating_sub(source.saturating_add(before));
    if before >= fewest && before - fewest < stride { before } else { fewest }
}

/// The hardware target of models that name none.
pub const USUAL_TARGET: &str = "nahuku-32";

/// Content of a model file.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, rename = "Network")]
pub struct NetworkFile {
    /// The network's name.
    pub name: String,
    /// Length of a timestep in ms.
    pub timestep_ms: f64,
    /// Neuron kinds that it declares.
    #[serde(default, skip_serializing_if = "is_default")]
    pub kinds: Vec<MicrocodeKind>,
    /// Populations in order.
    pub populations: Vec<PopulationDesc>,
    /// Projections in order.
    pub projections: Vec<ProjectionDesc>,
    /// The output population.
    pub output: String,
    /// The score by which it decides.
    #[serde(default, skip_serializing_if = "is_default")]
    pub decision: ReadOut,
    /// Steps of a sample after its last input step.
    #[serde(default, skip_serializing_if = "is_default")]
    pub drain: u32,
    /// Names of the classes, one for each output compartment.
    #[serde(default, skip_serializing_if = "is_default")]
    pub classes: Vec<String>,
    /// Periodic reset.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reset: Option<ResetDesc>,
    /// The threshold test of a compartment.
    #[serde(default, skip_serializing_if = "is_default")]
    pub threshold: ThresholdTest,
    /// The arithmetic.
    #[serde(default, skip_serializing_if = "is_default")]
    pub semantics: Semantics,
    /// Rounding of weights.
    #[serde(default, skip_serializing_if = "is_default")]
    pub weight_rounding: WeightRounding,
    /// The arithmetic of learning; lava's with lava's arithmetic, else the chip's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub learning_semantics: Option<LearningSemantics>,
    /// The stimulus to use when none is given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scene: Option<String>,
    /// The target to map it onto when none is named.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target: Option<String>,
    /// Where the network comes from: data, command, accuracy.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub provenance: Option<String>,
}

impl NetworkFile {
    /// A network without populations.
    pub fn new(name: &str, timestep_ms: f64) -> Self {
        NetworkFile { name: name.to_string(), timestep_ms, ..NetworkFile::default() }
    }

    /// `named`, else the file's own target, else [`USUAL_TARGET`].
    pub fn target_or_usual<'n>(&'n self, named: Option<&'n str>) -> &'n str {
        named.or(self.target.as_deref()).unwrap_or(USUAL_TARGET)
    }

    /// Parses the text of a model file.
    ///
    /// # Errors
    /// `model.syntax` at the malformed value, `model.kind` in a kind that the file declares.
    pub fn parse(source: &SourceText) -> Result<Self> {
        let whole = Span { start: 0, end: source.text().len() };
        let kinds: Vec<MicrocodeKind> = match locate(source.text(), whole, "kinds") {
            Some(part) => parse_part(source, part, "model.kind")?,
            None => Vec::new(),
        };
        let mut names = HashSet::new();
        for (place, kind) in kinds.iter().enumerate() {
            if !names.insert(kind.name()) {
                let message = format!("kind '{}' is declared twice", kind.name());
                let span = self::place(source, &format!("kinds.[{place}].name"));
                return Err(Diagnostic::new("model.kind", message).at(source, span).help("choose another name"));
            }
        }
        with_kinds(&kinds, || parse(source, "model.syntax"))
    }

    /// A population by name.
    pub fn population(&self, name: &str) -> Option<&PopulationDesc> {
        self.populations.iter().find(|population| population.name == name)
    }

    /// Every array that the file refers to, and the path of the reference.
    pub fn arrays(&self) -> Vec<(ArrayRef, String)> {
        let mut arrays = Vec::new();
        for (index, population) in self.populations.iter().enumerate() {
            for (name, parameter) in population.loihi.iter().flatten() {
                if let Parameter::From(source) = parameter {
                    arrays.extend(source.array().map(|array| (array, format!("populations.[{index}].{name}"))));
                }
            }
        }
        for (index, projection) in self.projections.iter().enumerate() {
            if let Some(Weights::From(source)) = projection.weights() {
                arrays.extend(source.array().map(|array| (array, format!("projections.[{index}].weights"))));
            }
            if let ProjectionKind::Arrays(synapses) = &projection.kind {
                for (name, array) in synapses.references() {
                    arrays.push((array.clone(), format!("projections.[{index}].arrays.{name}")));
                }
            }
            for (field, source) in projection.learning.iter().flat_map(RuleDesc::sources) {
                arrays.extend(source.array().map(|array| (array, format!("projections.[{index}].learning.{field}"))));
            }
        }
        arrays
    }
}

/// A model file with every array that it refers to.
#[derive(Debug, Clone)]
pub struct Network {
    file: NetworkFile,
    source: SourceText,
    arrays: Arc<BTreeMap<ArrayRef, Tensor>>,
    conventions: Conventions,
}

/// Conventions by which the file of another tool was read; empty for a model file.
#[derive(Debug, Clone, Default)]
pub struct Conventions {
    /// The conventions, and the changes that the reader made.
    pub notes: Vec<String>,
    /// Assumptions of the reader that the network may contradict, and losses.
    pub warnings: Vec<Warning>,
}

impl Network {
    /// Pairs a file with its arrays.
    ///
    /// # Errors
    /// A diagnostic when an array that the file refers to is not among them.
    pub fn new(file: NetworkFile, source: SourceText, arrays: BTreeMap<ArrayRef, Tensor>) -> Result<Self> {
        for (array, path) in file.arrays() {
            if !arrays.contains_key(&array) {
                let missing = Diagnostic::new("model.array-missing", format!("{array:?} was not read"));
                return Err(missing.at(&source, place(&source, &path)));
            }
        }
        Ok(Network { file, source, arrays: arrays.into(), conventions: Conventions::default() })
    }

    /// Another file with these arrays; `None` when it refers to others.
    pub fn with_file(&self, file: NetworkFile, source: SourceText) -> Option<Self> {
        let known = file.arrays().iter().all(|(array, _)| self.arrays.contains_key(array));
        let Network { arrays, conventions, .. } = self.clone();
        known.then_some(Network { file, source, arrays, conventions })
    }

    /// This network, with the conventions by which it was read.
    #[must_use]
    pub fn read_by(self, conventions: Conventions) -> Self {
        Network { conventions, ..self }
    }

    /// The conventions by which another tool's file was read.
    pub fn conventions(&self) -> &Conventions {
        &self.conventions
    }

    /// The content of the model file.
    pub fn file(&self) -> &NetworkFile {
        &self.file
    }

    /// The text, for messages.
    pub fn source(&self) -> &SourceText {
        &self.source
    }

    /// The array of a reference.
    pub fn array(&self, reference: &ArrayRef) -> &Tensor {
        &self.arrays[reference]
    }

    /// The numbers of weights; none for seeded ones.
    pub fn tensor<'a>(&'a self, weights: &'a Weights) -> Option<&'a Tensor> {
        match weights {
            Weights::InPlace(tensor) => Some(tensor),
            Weights::From(source) => Some(self.array(&source.array()?)),
        }
    }
}

/// The place of a path in the text of a model, or of the nearest value around it.
pub fn place(source: &SourceText, path: &str) -> Span {
    let whole = Span { start: 0, end: source.text().len() };
    let ends = path.rmatch_indices('.').map(|(at, _)| at);
    let place = std::iter::once(path.len()).chain(ends).find_map(|end| locate(source.text(), whole, &path[..end]));
    place.unwrap_or_default()
}
