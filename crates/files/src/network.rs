//! The mirror of a model file (`models/*.ron`; `docs/formats.md` describes each field).
//!
//! [`NetworkFile`] is what the RON says. [`Network`] is the same with every array that it refers to
//! read; `io::model` makes it. Ranges that a single field has are left to
//! `compile::frontend::lower`, which knows the population and can point at the value.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::LazyLock;

use serde::de::{DeserializeSeed, EnumAccess, Error, MapAccess, VariantAccess, Visitor};
use serde::{Deserialize, Deserializer};

use super::numbers;
use super::synapses::SynapseArrays;
use nsim_ir::arithmetic::{ReadOut, ResetDesc, Semantics, ThresholdTest, WeightRounding};
use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText, Span};
use nsim_ir::base::fixed::SignMode;
use nsim_ir::base::shared::Shared;
use nsim_ir::neurons::NeuronKind;
use nsim_ir::spanned::{Spanned, parse, parse_at, raw, refuse};
pub use nsim_ir::tensor::ArrayRef;
use nsim_ir::tensor::Tensor;

/// Where an array of weights or parameters comes from.
#[derive(Debug, Clone)]
pub enum Source {
    /// Numbers in the model file.
    InPlace(Tensor),
    /// An array in another file.
    File(ArrayRef),
    /// Seeded uniform numbers in `low..=high`, for untrained networks and benches: `low`,
    /// `low + step`, .. with a `step`, any real number without.
    Uniform {
        /// The least value.
        low: f64,
        /// The greatest value.
        high: f64,
        /// Distance of neighbouring numbers.
        step: Option<f64>,
        /// The seed.
        seed: u64,
    },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename = "source of numbers")]
enum NamedSource {
    Npy(String),
    Safetensors(String, String),
    Uniform { low: f64, high: f64, step: Option<f64>, seed: u64 },
}

impl From<NamedSource> for Source {
    fn from(named: NamedSource) -> Self {
        match named {
            NamedSource::Npy(file) => Source::File(ArrayRef::Npy(file)),
            NamedSource::Safetensors(file, key) => Source::File(ArrayRef::Safetensors(file, key)),
            NamedSource::Uniform { low, high, step, seed } => Source::Uniform { low, high, step, seed },
        }
    }
}

/// Weights: `[[..], ..]` in place (`[target][source]`), `Npy(..)`, `Safetensors(..)` or
/// `Uniform(..)`.
#[derive(Debug, Clone)]
pub struct Weights {
    /// Where they come from.
    pub source: Source,
    /// Where that is said.
    pub span: Span,
}

/// The synapses of a [`SparseDesc`].
fn synapses<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<(u64, u64, f64)>, D::Error> {
    Vec::deserialize(deserializer).map_err(|error| {
        Error::custom(format!("{error}; a synapse is (source, target, weight), the first two whole numbers from 0"))
    })
}

impl<'de> Deserialize<'de> for Weights {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (text, span) = raw(deserializer)?;
        let source = match text.as_bytes().first() {
            Some(b'[') => Source::InPlace(numbers::list_at(text, span)?),
            Some(byte) if byte.is_ascii_alphabetic() => parse_at::<NamedSource, _>(text, span)?.into(),
            _ => return refuse(span, "weights are a list of rows or a source such as Npy(\"file.npy\")"),
        };
        Ok(Weights { source, span })
    }
}

/// A parameter of a population: one number for all, a list with one entry a compartment, or a
/// source of such a list.
#[derive(Debug, Clone)]
pub struct Parameter {
    /// Its value.
    pub value: ParameterValue,
    /// Where that is said.
    pub span: Span,
}

/// See [`Parameter`].
#[derive(Debug, Clone)]
pub enum ParameterValue {
    /// The same for every compartment.
    Same(f64),
    /// One entry a compartment.
    Each(Source),
}

impl<'de> Deserialize<'de> for Parameter {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (text, span) = raw(deserializer)?;
        let value = match text.chars().next() {
            Some('[') => ParameterValue::Each(Source::InPlace(numbers::list_at(text, span)?)),
            Some(c) if c.is_ascii_digit() || matches!(c, '+' | '-' | '.') => {
                ParameterValue::Same(parse_at(text, span)?)
            }
            Some(c) if c.is_ascii_alphabetic() && !text.starts_with("inf") && !text.starts_with("NaN") => {
                ParameterValue::Each(parse_at::<NamedSource, _>(text, span)?.into())
            }
            _ => return refuse(span, "expected a number, a list, or a source such as Npy(\"file.npy\")"),
        };
        Ok(Parameter { value, span })
    }
}

/// A population of the file.
#[derive(Debug, Clone)]
pub enum PopulationDesc {
    /// Channels that spike as a stimulus says.
    Input(InputDesc),
    /// Compartments with integer state.
    Neurons(Box<NeuronsDesc>),
    /// Spike response neurons in real numbers.
    Srm(Box<SrmDesc>),
}

/// Input channels.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename = "Input")]
pub struct InputDesc {
    /// Its name.
    pub name: Spanned<String>,
    /// `[n]` or `[channels, height, width]`.
    pub shape: Spanned<Vec<u64>>,
    /// The integer that each of its spikes carries; none by default, a binary spike.
    pub payload: Option<Spanned<i64>>,
}

/// Spike response neurons with alpha kernels, as SLAYER trains them.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename = "Srm")]
pub struct SrmDesc {
    /// Its name.
    pub name: Spanned<String>,
    /// `[n]` or `[channels, height, width]`.
    pub shape: Spanned<Vec<u64>>,
    /// Time constant of the response in ms.
    pub tau_sr_ms: Spanned<f64>,
    /// Time constant of the refractory response in ms.
    pub tau_ref_ms: Spanned<f64>,
    /// Peak of the refractory response in thresholds.
    pub scale_ref: Spanned<f64>,
    /// Threshold, in the units of the weights.
    pub theta: Spanned<f64>,
}

/// Compartments of one kind: integer fields as the hardware has them, or real ones to be quantised.
#[derive(Debug, Clone)]
pub struct NeuronsDesc {
    /// Which kind.
    pub kind: NeuronKind,
    /// Its name.
    pub name: Spanned<String>,
    /// `[n]` or `[channels, height, width]`.
    pub shape: Spanned<Vec<u64>>,
    /// The parameters that the file gives, in the order of [`NeuronKind::parameter_names`].
    pub parameters: Vec<(&'static str, Parameter)>,
    /// The timestep before which the population is held at zero; default 0.
    pub start_step: Option<Spanned<i64>>,
    /// The integer that each of its spikes carries; none by default, a binary spike.
    pub payload: Option<Spanned<i64>>,
}

impl NeuronsDesc {
    /// A parameter that the file gives.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<&Parameter> {
        self.parameters.iter().find(|(given, _)| *given == name).map(|(_, parameter)| parameter)
    }
}

/// The names of each kind's fields, in the order of [`NeuronKind::ALL`].
static FIELDS: LazyLock<Vec<Vec<&'static str>>> = LazyLock::new(|| {
    let fields = |kind: NeuronKind| {
        ["name", "shape", "start_step", "payload"].into_iter().chain(kind.parameter_names()).collect()
    };
    NeuronKind::ALL.into_iter().map(fields).collect()
});

/// The names of populations.
static POPULATIONS: LazyLock<Vec<&'static str>> =
    LazyLock::new(|| ["Input", "Srm"].into_iter().chain(NeuronKind::ALL.map(NeuronKind::name)).collect());

/// The name of a field or a variant.
struct Identifier(String);

impl<'de> Deserialize<'de> for Identifier {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Read;
        impl Visitor<'_> for Read {
            type Value = Identifier;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a name")
            }
            fn visit_str<E: Error>(self, name: &str) -> Result<Identifier, E> {
                Ok(Identifier(name.to_string()))
            }
        }
        deserializer.deserialize_identifier(Read)
    }
}

impl<'de> Deserialize<'de> for PopulationDesc {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Read;
        impl<'de> Visitor<'de> for Read {
            type Value = PopulationDesc;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("enum Population")
            }
            fn visit_enum<A: EnumAccess<'de>>(self, data: A) -> Result<PopulationDesc, A::Error> {
                let (Identifier(name), variant) = data.variant()?;
                match (name.as_str(), NeuronKind::ALL.into_iter().find(|kind| kind.name() == name)) {
                    ("Input", _) => variant.newtype_variant().map(PopulationDesc::Input),
                    ("Srm", _) => variant.newtype_variant().map(PopulationDesc::Srm),
                    (_, Some(kind)) => variant.newtype_variant_seed(KindFields(kind)).map(PopulationDesc::Neurons),
                    (_, None) => Err(A::Error::unknown_variant(&name, &POPULATIONS)),
                }
            }
        }
        deserializer.deserialize_enum("Population", &POPULATIONS, Read)
    }
}

/// The fields of a population of this kind.
struct KindFields(NeuronKind);

impl<'de> DeserializeSeed<'de> for KindFields {
    type Value = Box<NeuronsDesc>;
    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_struct(self.0.name(), &FIELDS[self.0 as usize], self)
    }
}

impl<'de> Visitor<'de> for KindFields {
    type Value = Box<NeuronsDesc>;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "struct {}", self.0.name())
    }
    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let fields = &FIELDS[self.0 as usize];
        let (mut name, mut shape, mut start_step, mut payload) = (None, None, None, None);
        let mut values: Vec<Option<Option<Parameter>>> = vec![None; fields.len()];
        while let Some(Identifier(key)) = map.next_key()? {
            let Some(place) = fields.iter().position(|field| *field == key) else {
                return Err(A::Error::unknown_field(&key, fields));
            };
            let twice = match place {
                0 => name.replace(map.next_value()?).is_some(),
                1 => shape.replace(map.next_value()?).is_some(),
                2 => start_step.replace(map.next_value()?).is_some(),
                3 => payload.replace(map.next_value()?).is_some(),
                _ => values[place].replace(map.next_value()?).is_some(),
            };
            if twice {
                return Err(A::Error::duplicate_field(fields[place]));
            }
        }
        let given = fields.iter().zip(values).filter_map(|(field, value)| Some((*field, value.flatten()?)));
        Ok(Box::new(NeuronsDesc {
            kind: self.0,
            name: name.ok_or_else(|| A::Error::missing_field("name"))?,
            shape: shape.ok_or_else(|| A::Error::missing_field("shape"))?,
            parameters: given.collect(),
            start_step: start_step.flatten(),
            payload: payload.flatten(),
        }))
    }
}

/// A projection's mirror: the fields that every kind has, and its own. (`serde(flatten)` would
/// buffer the values and lose their places.)
macro_rules! projection_desc {
    ($(#[$doc:meta])* $name:ident, $written:literal { $($own:tt)* }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Deserialize)]
        #[serde(deny_unknown_fields, rename = $written)]
        pub struct $name {
            /// Source populations; several are concatenated.
            pub from: Vec<Spanned<String>>,
            /// Target population.
            pub to: Spanned<String>,
            /// Weight exponent, default 0.
            pub weight_exp: Option<Spanned<i64>>,
            /// Sign mode, default mixed.
            pub sign: Option<Spanned<SignMode>>,
            /// Bits of a weight, default 8.
            pub weight_bits: Option<Spanned<i64>>,
            /// Delay field, default 0.
            pub delay: Option<Spanned<i64>>,
            /// What a real weight of 1 counts in units of the weight mantissa.
            pub weight_scale: Option<Spanned<f64>>,
            $($own)*
        }
        impl $name {
            /// The fields that every kind of projection has.
            #[must_use]
            pub fn synapse(&self) -> SynapseDesc<'_> {
                SynapseDesc {
                    from: &self.from,
                    to: &self.to,
                    weight_exp: self.weight_exp.as_ref(),
                    sign: self.sign.as_ref(),
                    weight_bits: self.weight_bits.as_ref(),
                    delay: self.delay.as_ref(),
                    weight_scale: self.weight_scale.as_ref(),
                }
            }
        }
    };
}

projection_desc!(
    /// Every source reaches every target.
    DenseDesc, "Dense" {
        /// `[target][source]`.
        pub weights: Weights,
    }
);
projection_desc!(
    /// Listed synapses.
    SparseDesc, "Sparse" {
        /// (source, target, weight) each.
        #[serde(default, deserialize_with = "synapses")]
        pub synapses: Vec<(u64, u64, f64)>,
        /// The same as arrays in files, in place of `synapses`.
        pub arrays: Option<Spanned<SynapseArrays>>,
    }
);
projection_desc!(
    /// A two-dimensional convolution (cross-correlation with the kernel as stored) from one
    /// population `[C, H, W]` to one `[C', H', W']`.
    Conv2dDesc, "Conv2d" {
        /// `[C'][C / groups][kh][kw]`.
        pub weights: Weights,
        /// (y, x), default (1, 1).
        pub stride: Option<Spanned<(u64, u64)>>,
        /// Silent rows above and columns left of the source (y, x), default (0, 0).
        pub padding: Option<Spanned<(u64, u64)>>,
        /// Silent rows below and columns right of the source (y, x), default: `padding`.
        pub padding_after: Option<Spanned<(u64, u64)>>,
        /// (y, x), default (1, 1).
        pub dilation: Option<Spanned<(u64, u64)>>,
        /// Channel groups, default 1.
        pub groups: Option<Spanned<u64>>,
    }
);
projection_desc!(
    /// Sum pooling from one population `[C, H, W]` to one `[C, H', W']`: each position of a window
    /// reaches its channel's compartment with the same weight.
    SumPool2dDesc, "SumPool2d" {
        /// Window (y, x).
        pub kernel: Spanned<(u64, u64)>,
        /// (y, x), default: the window.
        pub stride: Option<Spanned<(u64, u64)>>,
        /// Silent rows above and columns left of the source (y, x), default (0, 0).
        pub padding: Option<Spanned<(u64, u64)>>,
        /// Silent rows below and columns right of the source (y, x), default: `padding`.
        pub padding_after: Option<Spanned<(u64, u64)>>,
        /// The weight of each synapse.
        pub weight: Spanned<f64>,
    }
);
projection_desc!(
    /// Random synapses: each source reaches `fan_out` targets, drawn independently (a target may be
    /// drawn twice), with weights drawn from the multiples of the least step in `low..=high`.
    RandomDesc, "Random" {
        /// Synapses of each source.
        pub fan_out: Spanned<u64>,
        /// The least weight.
        pub low: Spanned<i64>,
        /// The greatest weight.
        pub high: Spanned<i64>,
        /// The seed.
        pub seed: Spanned<u64>,
    }
);

/// Silent places behind an axis of `source` places that a window with this reach, stride and
/// padding before the axis needs to give `target` outputs: as many as before where that gives them,
/// else the fewest that do.
#[must_use]
pub fn padding_after(source: u64, target: u64, reach: u64, stride: u64, before: u64) -> u64 {
    let last = target.saturating_sub(1).saturating_mul(stride).saturating_add(reach);
    let fewest = last.saturating_sub(source.saturating_add(before));
    if before >= fewest && before - fewest < stride { before } else { fewest }
}

/// A projection of the file.
#[derive(Debug, Clone, Deserialize)]
#[serde(rename = "Projection")]
pub enum ProjectionDesc {
    /// Every source reaches every target.
    Dense(Box<DenseDesc>),
    /// Listed synapses.
    Sparse(Box<SparseDesc>),
    /// A convolution.
    Conv2d(Box<Conv2dDesc>),
    /// Sum pooling.
    SumPool2d(Box<SumPool2dDesc>),
    /// Seeded random synapses.
    Random(Box<RandomDesc>),
}

/// The fields that every kind of projection has, borrowed from one.
#[derive(Debug, Clone, Copy)]
pub struct SynapseDesc<'a> {
    /// Source populations.
    pub from: &'a [Spanned<String>],
    /// Target population.
    pub to: &'a Spanned<String>,
    /// Weight exponent, default 0.
    pub weight_exp: Option<&'a Spanned<i64>>,
    /// Sign mode, default mixed.
    pub sign: Option<&'a Spanned<SignMode>>,
    /// Bits of a weight, default 8.
    pub weight_bits: Option<&'a Spanned<i64>>,
    /// Delay field, default 0.
    pub delay: Option<&'a Spanned<i64>>,
    /// What a real weight of 1 counts in weight units.
    pub weight_scale: Option<&'a Spanned<f64>>,
}

impl ProjectionDesc {
    /// The fields that every kind has.
    #[must_use]
    pub fn synapse(&self) -> SynapseDesc<'_> {
        match self {
            ProjectionDesc::Dense(d) => d.synapse(),
            ProjectionDesc::Sparse(d) => d.synapse(),
            ProjectionDesc::Conv2d(d) => d.synapse(),
            ProjectionDesc::SumPool2d(d) => d.synapse(),
            ProjectionDesc::Random(d) => d.synapse(),
        }
    }

    /// Where an array of weights is named.
    #[must_use]
    pub fn weights_span(&self) -> Option<Span> {
        match self {
            ProjectionDesc::Sparse(sparse) => Some(sparse.arrays.as_ref()?.weight.span),
            other => other.weights().map(|weights| weights.span),
        }
    }

    /// The weights, for the kinds that have an array of them.
    #[must_use]
    pub fn weights(&self) -> Option<&Weights> {
        match self {
            ProjectionDesc::Dense(d) => Some(&d.weights),
            ProjectionDesc::Conv2d(d) => Some(&d.weights),
            ProjectionDesc::Sparse(_) | ProjectionDesc::SumPool2d(_) | ProjectionDesc::Random(_) => None,
        }
    }
}

/// A model file as it is written.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename = "Network")]
pub struct NetworkFile {
    /// The network's name.
    pub name: String,
    /// Milliseconds that a timestep stands for.
    pub timestep_ms: Spanned<f64>,
    /// Populations in order.
    pub populations: Vec<Spanned<PopulationDesc>>,
    /// Projections in order.
    pub projections: Vec<Spanned<ProjectionDesc>>,
    /// The population that decides.
    pub output: Spanned<String>,
    /// What of it decides.
    #[serde(default)]
    pub decision: ReadOut,
    /// Steps that a sample has after its last input step, default 0.
    pub drain: Option<Spanned<u32>>,
    /// Names of the classes, one for each output compartment.
    pub classes: Option<Spanned<Vec<String>>>,
    /// Periodic reset.
    pub reset: Option<Spanned<ResetDesc>>,
    /// When a compartment spikes.
    #[serde(default)]
    pub threshold: ThresholdTest,
    /// Which arithmetic.
    #[serde(default)]
    pub semantics: Semantics,
    /// How weights are rounded.
    #[serde(default)]
    pub weight_rounding: WeightRounding,
    /// The stimulus to use when none is given.
    pub scene: Option<String>,
    /// Where the network comes from: data, command, accuracy.
    pub provenance: Option<String>,
}

impl NetworkFile {
    /// Parses the text of a model file.
    ///
    /// # Errors
    /// `model.syntax` at the place of what is malformed.
    pub fn parse(source: &SourceText) -> Result<Self> {
        parse(source, "model.syntax")
    }
}

/// A model file with every array that it refers to.
#[derive(Debug, Clone)]
pub struct Network {
    file: NetworkFile,
    source: SourceText,
    arrays: Shared<BTreeMap<ArrayRef, Tensor>>,
}

impl Network {
    /// Pairs a file with its arrays.
    ///
    /// # Errors
    /// A diagnostic when an array that the file refers to is not among them.
    pub fn new(file: NetworkFile, source: SourceText, arrays: BTreeMap<ArrayRef, Tensor>) -> Result<Self> {
        for (reference, span) in array_refs(&file) {
            if !arrays.contains_key(reference) {
                return Err(
                    Diagnostic::new("model.array-missing", format!("{reference:?} was not read")).at(&source, span)
                );
            }
        }
        Ok(Network { file, source, arrays: arrays.into() })
    }

    /// Another file with the same arrays; `None` when it refers to others.
    #[must_use]
    pub fn with_file(&self, file: NetworkFile, source: SourceText) -> Option<Self> {
        let known = array_refs(&file).iter().all(|(reference, _)| self.arrays.contains_key(reference));
        known.then(|| Network { file, source, arrays: self.arrays.clone() })
    }

    /// What the RON says.
    #[must_use]
    pub fn file(&self) -> &NetworkFile {
        &self.file
    }

    /// The text, for messages.
    #[must_use]
    pub fn source(&self) -> &SourceText {
        &self.source
    }

    /// The array of a reference.
    #[must_use]
    pub fn array(&self, reference: &ArrayRef) -> &Tensor {
        &self.arrays[reference]
    }
}

/// Every array that a file refers to, and where.
#[must_use]
pub fn array_refs(file: &NetworkFile) -> Vec<(&ArrayRef, Span)> {
    let mut refs = Vec::new();
    for population in &file.populations {
        if let PopulationDesc::Neurons(desc) = &population.value {
            for (_, parameter) in &desc.parameters {
                if let ParameterValue::Each(Source::File(reference)) = &parameter.value {
                    refs.push((reference, parameter.span));
                }
            }
        }
    }
    for projection in &file.projections {
        if let Some(weights) = projection.weights()
            && let Source::File(reference) = &weights.source
        {
            refs.push((reference, weights.span));
        }
        if let ProjectionDesc::Sparse(sparse) = &projection.value
            && let Some(arrays) = &sparse.arrays
        {
            refs.extend(arrays.references().map(|reference| (&reference.value, reference.span)));
        }
    }
    refs
}

impl PopulationDesc {
    /// The population's name.
    #[must_use]
    pub fn name(&self) -> &Spanned<String> {
        match self {
            PopulationDesc::Input(desc) => &desc.name,
            PopulationDesc::Neurons(desc) => &desc.name,
            PopulationDesc::Srm(desc) => &desc.name,
        }
    }

    /// The integer that each of its spikes carries, if any.
    #[must_use]
    pub fn payload(&self) -> Option<&Spanned<i64>> {
        match self {
            PopulationDesc::Input(desc) => desc.payload.as_ref(),
            PopulationDesc::Neurons(desc) => desc.payload.as_ref(),
            PopulationDesc::Srm(_) => None,
        }
    }

    /// The population's shape.
    #[must_use]
    pub fn shape(&self) -> &Spanned<Vec<u64>> {
        match self {
            PopulationDesc::Input(desc) => &desc.shape,
            PopulationDesc::Neurons(desc) => &desc.shape,
            PopulationDesc::Srm(desc) => &desc.shape,
        }
    }
}
