//! Builds a model and writes it as a model file.
//!
//! Input: populations and projections with their arrays, from a reader of foreign files or any
//! other maker of models. Output: the text of a RON model with one safetensors file beside it, or
//! the [`Network`] that reading the two would give. A network is always built through the text, so
//! that one that was imported on the fly equals one that was written and read again. Whether it
//! makes sense is for `compile::frontend::lower`.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use safetensors::Dtype;
use safetensors::tensor::TensorView;

use super::write;
use crate::network::{
    ArrayRef, Network, NetworkFile, ParameterValue, PopulationDesc, ProjectionDesc, Source, SparseDesc,
};
use nsim_ir::arithmetic::{ReadOut, ResetDesc, Semantics, ThresholdTest, WeightRounding};
use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText};
use nsim_ir::base::fixed::SignMode;
use nsim_ir::neurons::NeuronKind;
use nsim_ir::spanned::Spanned;
use nsim_ir::tensor::{Numbers, Tensor};

/// Lists of at most so many numbers are written into the text, longer ones beside it.
const IN_PLACE: usize = 16;

/// A parameter's value: one for all, or one for each compartment.
#[derive(Debug, Clone, PartialEq)]
pub enum Parameter {
    /// The same for all.
    Same(f64),
    /// One each.
    Each(Vec<f64>),
}

impl Parameter {
    /// One for all when all are equal.
    #[must_use]
    pub fn from_values(values: Vec<f64>) -> Parameter {
        match values.first() {
            Some(&first) if values.iter().all(|value| value.to_bits() == first.to_bits()) => Parameter::Same(first),
            _ => Parameter::Each(values),
        }
    }

    /// The value of one compartment.
    ///
    /// # Panics
    /// When there is one for each and `index` is not one of them.
    #[must_use]
    pub fn get(&self, index: usize) -> f64 {
        match self {
            Parameter::Same(value) => *value,
            Parameter::Each(values) => values[index],
        }
    }

    /// Changes every value.
    #[must_use]
    pub fn map(&self, f: impl Fn(f64) -> f64) -> Parameter {
        match self {
            Parameter::Same(value) => Parameter::Same(f(*value)),
            Parameter::Each(values) => Parameter::from_values(values.iter().map(|&value| f(value)).collect()),
        }
    }
}

/// A population that is being built.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PopulationBuilder {
    /// Its name.
    pub name: String,
    /// `[n]` or `[channels, height, width]`.
    pub shape: Vec<u64>,
    /// The kind of its compartments.
    pub kind: NeuronKind,
    /// Parameters of compartments by the names that model files use, in order.
    pub loihi: Option<Vec<(&'static str, Parameter)>>,
    /// Parameters of spike response neurons by the names that model files use; without either, it
    /// is an input.
    pub srm: Option<[(&'static str, f64); 4]>,
    /// The step before which it is held at zero.
    pub start_step: u32,
}

impl PopulationBuilder {
    /// Channels that a stimulus drives.
    #[must_use]
    pub fn input(name: &str, shape: Vec<u64>) -> Self {
        PopulationBuilder { name: name.to_string(), shape, ..PopulationBuilder::default() }
    }

    /// Compartments with these parameters.
    #[must_use]
    pub fn loihi(name: &str, shape: Vec<u64>, parameters: Vec<(&'static str, Parameter)>) -> Self {
        PopulationBuilder { loihi: Some(parameters), ..PopulationBuilder::input(name, shape) }
    }

    /// Channels or compartments.
    #[must_use]
    pub fn units(&self) -> u64 {
        self.shape.iter().fold(1, |product: u64, &axis| product.saturating_mul(axis))
    }

    /// A parameter by name.
    #[must_use]
    pub fn parameter(&self, name: &str) -> Option<&Parameter> {
        self.loihi.as_ref()?.iter().find(|(key, _)| *key == name).map(|(_, value)| value)
    }
}

/// How a projection reaches its targets.
#[derive(Debug, Clone, PartialEq)]
pub enum ProjectionKind {
    /// `[target][source]`.
    Dense(Tensor),
    /// (source, target, weight) each.
    Sparse(Vec<(u64, u64, f64)>),
    /// `[C'][C / groups][kh][kw]`; pairs are (y, x).
    Conv2d {
        /// The kernel.
        weights: Tensor,
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
    /// Sum pooling with one weight.
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
}

/// A projection that is being built.
#[derive(Debug, Clone, PartialEq)]
pub struct ProjectionBuilder {
    /// Source populations, concatenated.
    pub from: Vec<String>,
    /// Target population.
    pub to: String,
    /// How it reaches its targets.
    pub kind: ProjectionKind,
    /// Delay field.
    pub delay: u32,
    /// Weight exponent.
    pub weight_exp: i64,
    /// Sign mode.
    pub sign: SignMode,
    /// Bits of a weight.
    pub weight_bits: i64,
    /// What a real weight of 1 counts.
    pub weight_scale: Option<f64>,
}

impl ProjectionBuilder {
    /// A projection with the default format of synapses.
    #[must_use]
    pub fn new(from: &str, to: &str, kind: ProjectionKind) -> Self {
        ProjectionBuilder {
            from: vec![from.to_string()],
            to: to.to_string(),
            kind,
            delay: 0,
            weight_exp: 0,
            sign: SignMode::Mixed,
            weight_bits: 8,
            weight_scale: None,
        }
    }
}

/// A model that is being built.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ModelBuilder {
    /// The network's name.
    pub name: String,
    /// Milliseconds that a timestep stands for.
    pub timestep_ms: f64,
    /// Populations in order.
    pub populations: Vec<PopulationBuilder>,
    /// Projections in order.
    pub projections: Vec<ProjectionBuilder>,
    /// The population that decides.
    pub output: String,
    /// What of it decides.
    pub decision: ReadOut,
    /// Steps that a sample has after its last input step.
    pub drain: u32,
    /// Names of the classes.
    pub classes: Vec<String>,
    /// Periodic reset.
    pub reset: Option<ResetDesc>,
    /// When a compartment spikes.
    pub threshold: ThresholdTest,
    /// Which arithmetic.
    pub semantics: Semantics,
    /// How weights are rounded.
    pub weight_rounding: WeightRounding,
    /// The stimulus to use when none is given.
    pub scene: Option<String>,
    /// Where the network comes from.
    pub provenance: Option<String>,
}

/// The synapses of a listed projection, by their own delay where they have one.
fn listed(network: &Network, sparse: &SparseDesc) -> Result<Vec<(Option<i64>, ProjectionKind)>> {
    let in_place = || sparse.synapses.clone();
    let Some(arrays) = &sparse.arrays else { return Ok(vec![(None, ProjectionKind::Sparse(in_place()))]) };
    let populations = &network.file().populations;
    let size_of = |name: &str| {
        let found = populations.iter().find(|population| population.value.name().value == name);
        found.map_or(0, |population| population.value.shape().value.iter().product())
    };
    let sources = sparse.from.iter().map(|name| size_of(name)).sum();
    let mut by_delay: BTreeMap<Option<i64>, Vec<(u64, u64, f64)>> = BTreeMap::new();
    let array = |reference: &ArrayRef| network.array(reference);
    for synapse in arrays.read(array, network.source(), (sources, size_of(&sparse.to)))? {
        let synapse = synapse?;
        let listed = by_delay.entry(synapse.delay).or_default();
        listed.push((synapse.source.into(), synapse.target.into(), synapse.weight));
    }
    Ok(by_delay.into_iter().map(|(delay, listed)| (delay, ProjectionKind::Sparse(listed))).collect())
}

impl ModelBuilder {
    /// A network without populations.
    #[must_use]
    pub fn new(name: &str, timestep_ms: f64) -> Self {
        ModelBuilder { name: name.to_string(), timestep_ms, ..ModelBuilder::default() }
    }

    /// A model that was read, with its arrays in full.
    ///
    /// # Errors
    /// `export.unsupported` for arrays that a seed stands for, and for spikes with a payload.
    pub fn from_network(network: &Network) -> Result<ModelBuilder> {
        let file = network.file();
        let mut model = ModelBuilder::new(&file.name, file.timestep_ms.value);
        for population in &file.populations {
            let desc = &population.value;
            let (name, shape) = (&desc.name().value, desc.shape().value.clone());
            if desc.payload().is_some() {
                let message = format!("population '{name}' has spikes with a payload, which cannot be exported");
                return Err(Diagnostic::new("export.unsupported", message));
            }
            model.populations.push(match desc {
                PopulationDesc::Input(_) => PopulationBuilder::input(name, shape),
                PopulationDesc::Srm(srm) => {
                    let parameters = [
                        ("tau_sr_ms", srm.tau_sr_ms.value),
                        ("tau_ref_ms", srm.tau_ref_ms.value),
                        ("scale_ref", srm.scale_ref.value),
                        ("theta", srm.theta.value),
                    ];
                    PopulationBuilder { srm: Some(parameters), ..PopulationBuilder::input(name, shape) }
                }
                PopulationDesc::Neurons(neurons) => {
                    let given = neurons.parameters.iter();
                    let parameters = given.map(|(key, given)| Ok((*key, value_of(network, &given.value)?)));
                    let parameters = parameters.collect::<Result<_, Diagnostic>>()?;
                    let start = neurons.start_step.as_ref().map_or(0, |step| step.value);
                    let start_step = u32::try_from(start).map_err(|_| seeded(&format!("start_step {start}")))?;
                    let kind = neurons.kind;
                    PopulationBuilder { kind, start_step, ..PopulationBuilder::loihi(name, shape, parameters) }
                }
            });
        }
        for projection in &file.projections {
            let synapse = projection.value.synapse();
            let pair = |pair: &Option<Spanned<(u64, u64)>>, default| pair.as_ref().map_or(default, |pair| pair.value);
            let kind = match &projection.value {
                ProjectionDesc::Dense(dense) => ProjectionKind::Dense(array_of(network, &dense.weights.source)?),
                ProjectionDesc::Sparse(_) => ProjectionKind::Sparse(Vec::new()),
                ProjectionDesc::Conv2d(conv) => ProjectionKind::Conv2d {
                    weights: array_of(network, &conv.weights.source)?,
                    stride: pair(&conv.stride, (1, 1)),
                    padding: pair(&conv.padding, (0, 0)),
                    padding_after: pair(&conv.padding_after, pair(&conv.padding, (0, 0))),
                    dilation: pair(&conv.dilation, (1, 1)),
                    groups: conv.groups.as_ref().map_or(1, |groups| groups.value),
                },
                ProjectionDesc::SumPool2d(pool) => ProjectionKind::SumPool2d {
                    kernel: pool.kernel.value,
                    stride: pair(&pool.stride, pool.kernel.value),
                    padding: pair(&pool.padding, (0, 0)),
                    padding_after: pair(&pool.padding_after, pair(&pool.padding, (0, 0))),
                    weight: pool.weight.value,
                },
                ProjectionDesc::Random(_) => return Err(seeded("a Random projection")),
            };
            let kinds = match &projection.value {
                ProjectionDesc::Sparse(sparse) => listed(network, sparse)?,
                _ => vec![(None, kind)],
            };
            for (own_delay, kind) in kinds {
                let delay = own_delay.or(synapse.delay.map(|delay| delay.value)).unwrap_or(0);
                model.projections.push(ProjectionBuilder {
                    from: synapse.from.iter().map(|name| name.value.clone()).collect(),
                    delay: u32::try_from(delay).map_err(|_| seeded(&format!("a delay of {delay}")))?,
                    weight_exp: synapse.weight_exp.map_or(0, |exponent| exponent.value),
                    sign: synapse.sign.map_or(SignMode::Mixed, |sign| sign.value),
                    weight_bits: synapse.weight_bits.map_or(8, |bits| bits.value),
                    weight_scale: synapse.weight_scale.map(|scale| scale.value),
                    ..ProjectionBuilder::new("", &synapse.to.value, kind)
                });
            }
        }
        model.output = file.output.value.clone();
        model.decision = file.decision;
        model.drain = file.drain.as_ref().map_or(0, |drain| drain.value);
        model.classes = file.classes.as_ref().map_or_else(Vec::new, |classes| classes.value.clone());
        model.reset = file.reset.as_ref().map(|reset| reset.value);
        model.threshold = file.threshold;
        model.semantics = file.semantics;
        model.weight_rounding = file.weight_rounding;
        model.scene = file.scene.clone();
        model.provenance = file.provenance.clone();
        Ok(model)
    }

    /// A population by name.
    #[must_use]
    pub fn population(&self, name: &str) -> Option<&PopulationBuilder> {
        self.populations.iter().find(|population| population.name == name)
    }

    /// The text of the model, and the arrays that it refers to as tensors of `file`.
    #[must_use]
    pub fn ron(&self, file: &str) -> (String, BTreeMap<String, Tensor>) {
        let mut writer = Writer { file, arrays: BTreeMap::new() };
        let mut out = String::from("Network(\n");
        let _ = writeln!(out, "    name: {},", quoted(&self.name));
        let _ = writeln!(out, "    timestep_ms: {},", number(self.timestep_ms));
        out.push_str("    populations: [\n");
        for population in &self.populations {
            writer.population(population, &mut out);
        }
        out.push_str("    ],\n    projections: [\n");
        for projection in &self.projections {
            writer.projection(projection, &mut out);
        }
        let _ = writeln!(out, "    ],\n    output: {},", quoted(&self.output));
        if !self.classes.is_empty() {
            let names: Vec<String> = self.classes.iter().map(|class| quoted(class)).collect();
            let _ = writeln!(out, "    classes: [{}],", names.join(", "));
        }
        if let Some(reset) = self.reset {
            let _ = writeln!(out, "    reset: (interval: {}, offset: {}),", reset.interval, reset.offset);
        }
        let settings = [
            ("decision", unless_default(&self.decision)),
            ("drain", unless_default(&self.drain)),
            ("threshold", unless_default(&self.threshold)),
            ("semantics", unless_default(&self.semantics)),
            ("weight_rounding", unless_default(&self.weight_rounding)),
            ("scene", self.scene.as_deref().map(quoted)),
            ("provenance", self.provenance.as_deref().map(quoted)),
        ];
        for (key, value) in settings.into_iter().filter_map(|(key, value)| Some((key, value?))) {
            let _ = writeln!(out, "    {key}: {value},");
        }
        out.push_str(")\n");
        (out, writer.arrays)
    }

    /// The network that the written files would give; `path` is what messages call the model.
    ///
    /// # Errors
    /// `model.*` for a name or number that a model file cannot hold.
    pub fn build(&self, path: &Path) -> Result<Network> {
        self.build_changed(path, Ok)
    }

    /// The same, with what `change` makes of its text.
    ///
    /// # Errors
    /// As [`Self::build`], and those of `change`.
    pub fn build_changed(&self, path: &Path, change: impl FnOnce(SourceText) -> Result<SourceText>) -> Result<Network> {
        let file = "arrays";
        let (text, tensors) = self.ron(file);
        let source = change(SourceText::new(path, text))?;
        let parsed = NetworkFile::parse(&source)?;
        let arrays =
            tensors.into_iter().map(|(key, tensor)| (ArrayRef::Safetensors(file.to_string(), key), tensor)).collect();
        Network::new(parsed, source, arrays)
    }

    /// Writes the model, and its arrays beside it as `STEM.safetensors`; `-` writes the text alone.
    ///
    /// # Errors
    /// `write.*`; `write.arrays` when stdout would have to take more than text.
    pub fn write(&self, path: &Path, force: bool) -> Result<Vec<String>> {
        let stem = path.file_stem().map_or_else(|| "model".into(), |stem| stem.to_string_lossy().into_owned());
        let beside = path.with_file_name(format!("{stem}.safetensors"));
        let name = beside.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let (text, tensors) = self.ron(&name);
        let mut files = vec![path.display().to_string()];
        write::check_free(path, force)?;
        if tensors.is_empty() {
            write::text(path, force, &text)?;
        } else {
            if super::text::is_standard_stream(path) {
                return Err(Diagnostic::new("write.arrays", "the model has arrays, which need a file beside it")
                    .help("give -o MODEL.ron"));
            }
            let bytes = serialise(&tensors).map_err(|error| {
                Diagnostic::new("write.failed", format!("cannot be written: {error}")).in_file(&beside)
            })?;
            let mut batch = write::Batch::new(force);
            batch.add(&beside, |out| out.write_all(&bytes))?;
            batch.add(path, |out| out.write_all(text.as_bytes()))?;
            batch.commit()?;
            files.push(beside.display().to_string());
        }
        Ok(files)
    }
}

fn seeded(what: &str) -> Diagnostic {
    Diagnostic::new("export.unsupported", format!("{what} cannot be exported"))
        .help("numbers that a seed stands for have no form in other tools: give them as an array")
}

fn array_of(network: &Network, source: &Source) -> Result<Tensor> {
    let tensor = match source {
        Source::InPlace(tensor) => tensor,
        Source::File(reference) => network.array(reference),
        Source::Uniform { .. } => return Err(seeded("a Uniform array")),
    };
    Ok(self::tensor(tensor.shape().to_vec(), tensor.reals().collect()))
}

fn value_of(network: &Network, value: &ParameterValue) -> Result<Parameter> {
    match value {
        ParameterValue::Same(value) => Ok(Parameter::Same(*value)),
        ParameterValue::Each(source) => Ok(Parameter::Each(array_of(network, source)?.reals().collect())),
    }
}

/// Tensors as the bytes of a safetensors file, each in the least type that holds its numbers
/// exactly.
fn serialise(tensors: &BTreeMap<String, Tensor>) -> Result<Vec<u8>, safetensors::SafeTensorError> {
    let mut stored: Vec<(&String, Dtype, Vec<u8>)> = Vec::new();
    for (key, tensor) in tensors {
        let (dtype, bytes) = match tensor.numbers() {
            Numbers::Integers(x) if x.iter().all(|&x| i16::try_from(x).is_ok()) => {
                (Dtype::I16, x.iter().flat_map(|&x| (x as i16).to_le_bytes()).collect())
            }
            Numbers::Integers(x) => (Dtype::I32, x.iter().flat_map(|x| x.to_le_bytes()).collect()),
            Numbers::Reals(x) if x.iter().all(|&x| f64::from(x as f32).to_bits() == x.to_bits()) => {
                (Dtype::F32, x.iter().flat_map(|&x| (x as f32).to_le_bytes()).collect())
            }
            Numbers::Reals(x) => (Dtype::F64, x.iter().flat_map(|x| x.to_le_bytes()).collect()),
        };
        stored.push((key, dtype, bytes));
    }
    let views = stored
        .iter()
        .map(|(key, dtype, bytes)| Ok((*key, TensorView::new(*dtype, tensors[*key].shape().to_vec(), bytes)?)))
        .collect::<Result<Vec<_>, safetensors::SafeTensorError>>()?;
    safetensors::serialize(views, None)
}

/// A RON string.
fn quoted(text: &str) -> String {
    let mut out = String::from("\"");
    for c in text.chars() {
        match c {
            '"' => out.push_str("\\\""),
            '\\' => out.push_str("\\\\"),
            '\n' => out.push_str("\\n"),
            c if c.is_control() => {
                let _ = write!(out, "\\u{{{:x}}}", u32::from(c));
            }
            c => out.push(c),
        }
    }
    out.push('"');
    out
}

/// A number that reads back as the same bits.
fn number(x: f64) -> String {
    if x.fract() == 0.0 && x.abs() < 9e15 && x.to_bits() != (-0.0f64).to_bits() {
        format!("{}", x as i64)
    } else {
        format!("{x:?}")
    }
}

/// A setting as it is written, unless it is what a file without it means.
fn unless_default<T: Default + PartialEq + std::fmt::Debug>(value: &T) -> Option<String> {
    (*value != T::default()).then(|| format!("{value:?}"))
}

fn list(values: &[f64]) -> String {
    format!("[{}]", values.iter().map(|&value| number(value)).collect::<Vec<_>>().join(", "))
}

struct Writer<'a> {
    file: &'a str,
    arrays: BTreeMap<String, Tensor>,
}

impl Writer<'_> {
    /// A reference to a tensor, under a key that no other has.
    fn array(&mut self, key: &str, tensor: Tensor) -> String {
        let mut unique = key.to_string();
        let mut count = 1;
        while self.arrays.contains_key(&unique) {
            count += 1;
            unique = format!("{key}.{count}");
        }
        let text = format!("Safetensors({}, {})", quoted(self.file), quoted(&unique));
        self.arrays.insert(unique, tensor);
        text
    }

    fn population(&mut self, population: &PopulationBuilder, out: &mut String) {
        let kind = match (population.srm, &population.loihi) {
            (Some(_), _) => "Srm",
            (None, Some(_)) => population.kind.name(),
            (None, None) => "Input",
        };
        let _ = write!(out, "        {kind}(name: {}, shape: {:?}", quoted(&population.name), population.shape);
        for (key, value) in population.srm.into_iter().flatten() {
            let _ = write!(out, ", {key}: {}", number(value));
        }
        for (key, value) in population.loihi.iter().flatten() {
            let value = match value {
                Parameter::Same(value) => number(*value),
                Parameter::Each(values) if values.len() <= IN_PLACE => list(values),
                Parameter::Each(values) => {
                    let tensor = tensor(vec![values.len()], values.clone());
                    self.array(&format!("{}.{key}", population.name), tensor)
                }
            };
            let _ = write!(out, ", {key}: {value}");
        }
        if population.start_step != 0 {
            let _ = write!(out, ", start_step: {}", population.start_step);
        }
        out.push_str("),\n");
    }

    fn projection(&mut self, projection: &ProjectionBuilder, out: &mut String) {
        let kind = match &projection.kind {
            ProjectionKind::Dense(_) => "Dense",
            ProjectionKind::Sparse(_) => "Sparse",
            ProjectionKind::Conv2d { .. } => "Conv2d",
            ProjectionKind::SumPool2d { .. } => "SumPool2d",
        };
        let from: Vec<String> = projection.from.iter().map(|name| quoted(name)).collect();
        let _ = write!(out, "        {kind}(from: [{}], to: {}", from.join(", "), quoted(&projection.to));
        let key = format!("{}->{}", projection.from.join("+"), projection.to);
        match &projection.kind {
            ProjectionKind::Dense(weights) => {
                let weights = self.array(&key, weights.clone());
                let _ = write!(out, ", weights: {weights}");
            }
            ProjectionKind::Sparse(synapses) => {
                out.push_str(", synapses: [");
                for (index, &(source, target, weight)) in synapses.iter().enumerate() {
                    let comma = if index == 0 { "" } else { ", " };
                    let _ = write!(out, "{comma}({source}, {target}, {})", number(weight));
                }
                out.push(']');
            }
            ProjectionKind::Conv2d { weights, stride, padding, padding_after, dilation, groups } => {
                let weights = self.array(&key, weights.clone());
                let _ = write!(
                    out,
                    ", weights: {weights}, stride: {stride:?}, padding: {padding:?}, dilation: {dilation:?}, groups: \
                     {groups}"
                );
                if padding_after != padding {
                    let _ = write!(out, ", padding_after: {padding_after:?}");
                }
            }
            ProjectionKind::SumPool2d { kernel, stride, padding, padding_after, weight } => {
                let weight = number(*weight);
                let _ = write!(out, ", kernel: {kernel:?}, stride: {stride:?}, padding: {padding:?}, weight: {weight}");
                if padding_after != padding {
                    let _ = write!(out, ", padding_after: {padding_after:?}");
                }
            }
        }
        let ProjectionBuilder { delay, weight_exp, sign, weight_bits, weight_scale, .. } = projection;
        let settings = [
            ("weight_exp", unless_default(weight_exp)),
            ("sign", (*sign != SignMode::Mixed).then(|| format!("{sign:?}"))),
            ("weight_bits", (*weight_bits != 8).then(|| weight_bits.to_string())),
            ("delay", unless_default(delay)),
            ("weight_scale", weight_scale.map(number)),
        ];
        for (key, value) in settings.into_iter().filter_map(|(key, value)| Some((key, value?))) {
            let _ = write!(out, ", {key}: {value}");
        }
        out.push_str("),\n");
    }
}

/// A tensor of these numbers: integers when all are.
///
/// # Panics
/// When the numbers do not fill the shape, a mistake of the caller.
#[must_use]
pub fn tensor(shape: Vec<usize>, numbers: Vec<f64>) -> Tensor {
    let whole = numbers.iter().all(|&x| f64::from(x as i32).to_bits() == x.to_bits());
    let numbers = match whole {
        true => Numbers::Integers(numbers.iter().map(|&x| x as i32).collect()),
        false => Numbers::Reals(numbers),
    };
    Tensor::new(shape, numbers).expect("the numbers fill the shape")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn strings_are_written_as_ron_reads_them() {
        for text in ["plain", "a \"quoted\" \\ one\n\ttwo \u{1}", "µ-in"] {
            assert_eq!(ron::from_str::<String>(&quoted(text)).unwrap(), text);
        }
    }

    proptest! {
        #[test]
        fn numbers_read_back_as_the_same_bits(x in any::<f64>().prop_filter("finite", |x| x.is_finite())) {
            let ron::Value::Number(back) = ron::from_str(&number(x)).unwrap() else { panic!() };
            prop_assert_eq!(back.into_f64().to_bits(), x.to_bits());
        }
    }
}
