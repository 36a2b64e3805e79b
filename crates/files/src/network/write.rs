//! A model as the text of a model file, with its arrays in a safetensors file.

use std::collections::BTreeMap;
use std::path::Path;

use safetensors::Dtype;
use safetensors::tensor::TensorView;
use serde::Serialize;
use serde::ser::{Error, SerializeStructVariant, Serializer};

use super::learning::RuleDesc;
use super::values::{Number, Source, Weights, tensor};
use super::{Network, NetworkFile, Parameter, PopulationDesc, ProjectionDesc, ProjectionKind};
use crate::mapping::pretty;
use crate::{text, write};
use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText};
use nsim_ir::tensor::{ArrayRef, Numbers, Tensor};

/// The longest list of numbers in the text; longer lists are written to another file.
const IN_PLACE: usize = 16;

impl Serialize for Parameter {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Parameter::Same(value) => Number(*value).serialize(serializer),
            Parameter::Each(values) => serializer.collect_seq(values.iter().map(|&value| Number(value))),
            Parameter::From(source) => source.serialize(serializer),
        }
    }
}

impl Serialize for Weights {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Weights::From(source) => source.serialize(serializer),
            // `NetworkFile::split` moves them to that file.
            Weights::InPlace(_) => Err(S::Error::custom("weights are written to a separate file")),
        }
    }
}

/// Writes a field when it has a value.
fn given<F: SerializeStructVariant>(
    fields: &mut F,
    name: &'static str,
    value: Option<impl Serialize>,
) -> Result<(), F::Error> {
    value.map_or(Ok(()), |value| fields.serialize_field(name, &value))
}

impl Serialize for PopulationDesc {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut fields = serializer.serialize_struct_variant("Population", 0, self.kind_name(), 0)?;
        fields.serialize_field("name", &self.name)?;
        fields.serialize_field("shape", &self.shape)?;
        for (name, value) in self.srm.into_iter().flatten() {
            fields.serialize_field(name, &Number(value))?;
        }
        for (name, parameter) in self.loihi.iter().flatten() {
            fields.serialize_field(name, parameter)?;
        }
        given(&mut fields, "start_step", (self.start_step != 0).then_some(self.start_step))?;
        given(&mut fields, "payload", self.payload)?;
        given(&mut fields, "message_bits", self.message_bits)?;
        fields.end()
    }
}

impl Serialize for ProjectionDesc {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut fields = serializer.serialize_struct_variant("Projection", 0, self.kind_name(), 0)?;
        given(&mut fields, "name", self.name.as_ref())?;
        fields.serialize_field("from", &self.from)?;
        fields.serialize_field("to", &self.to)?;
        match &self.kind {
            ProjectionKind::Dense(weights) => fields.serialize_field("weights", weights)?,
            ProjectionKind::Sparse(synapses) => {
                let listed: Vec<_> = synapses.iter().map(|&(from, to, weight)| (from, to, Number(weight))).collect();
                fields.serialize_field("synapses", &listed)?;
            }
            ProjectionKind::Arrays(arrays) => fields.serialize_field("arrays", arrays)?,
            ProjectionKind::Conv2d { weights, stride, padding, padding_after, dilation, groups } => {
                fields.serialize_field("weights", weights)?;
                fields.serialize_field("stride", stride)?;
                fields.serialize_field("padding", padding)?;
                fields.serialize_field("padding_after", padding_after)?;
                fields.serialize_field("dilation", dilation)?;
                fields.serialize_field("groups", groups)?;
            }
            ProjectionKind::SumPool2d { kernel, stride, padding, padding_after, weight } => {
                fields.serialize_field("kernel", kernel)?;
                fields.serialize_field("stride", stride)?;
                fields.serialize_field("padding", padding)?;
                fields.serialize_field("padding_after", padding_after)?;
                fields.serialize_field("weight", &Number(*weight))?;
            }
            ProjectionKind::Random { fan_out, low, high, seed } => {
                fields.serialize_field("fan_out", fan_out)?;
                fields.serialize_field("low", low)?;
                fields.serialize_field("high", high)?;
                fields.serialize_field("seed", seed)?;
            }
        }
        given(&mut fields, "weight_exp", self.weight_exp)?;
        given(&mut fields, "sign", self.sign)?;
        given(&mut fields, "weight_bits", (self.weight_bits != 8).then_some(self.weight_bits))?;
        given(&mut fields, "delay", (self.delay != 0).then_some(self.delay))?;
        given(&mut fields, "weight_scale", self.weight_scale)?;
        given(&mut fields, "port", (!self.port.is_first()).then_some(self.port))?;
        given(&mut fields, "learning", self.learning.as_ref().map(RuleDesc::written))?;
        fields.end()
    }
}

impl NetworkFile {
    /// The model with references to tensors of `file` for its long lists, and these tensors.
    pub fn split(mut self, file: &str) -> (NetworkFile, BTreeMap<String, Tensor>) {
        let mut tensors = BTreeMap::new();
        // Each tensor has a unique key.
        let mut stored = |key: String, weights: &mut Weights| {
            let Weights::InPlace(tensor) = weights else { return };
            let numbered = (2..).map(|count| format!("{key}.{count}"));
            let free = std::iter::once(key.clone()).chain(numbered).find(|key| !tensors.contains_key(key));
            let key = free.unwrap_or_default();
            tensors.insert(key.clone(), tensor.clone());
            *weights = Weights::From(Source::Safetensors(file.to_string(), key));
        };
        for population in &mut self.populations {
            for (name, parameter) in population.loihi.iter_mut().flatten() {
                if let Parameter::Each(values) = parameter
                    && values.len() > IN_PLACE
                {
                    let mut values = tensor(vec![values.len()], std::mem::take(values));
                    stored(format!("{}.{name}", population.name), &mut values);
                    if let Weights::From(source) = values {
                        *parameter = Parameter::From(source);
                    }
                }
            }
        }
        for projection in &mut self.projections {
            let key = projection.name_or_ends();
            for (field, values) in projection.learning.iter_mut().flat_map(RuleDesc::arrays_mut) {
                stored(format!("{key}.{field}"), values);
            }
            if let ProjectionKind::Dense(weights) | ProjectionKind::Conv2d { weights, .. } = &mut projection.kind {
                stored(key, weights);
            }
        }
        (self, tensors)
    }

    /// The text of the model, and its long lists, as tensors of `file`.
    ///
    /// # Errors
    /// `write.ron`, which does not happen for models.
    pub fn ron(&self, file: &str) -> Result<(String, BTreeMap<String, Tensor>)> {
        let (model, tensors) = self.clone().split(file);
        Ok((pretty(&model, 2)?, tensors))
    }

    /// The network that reading the written files would give; messages name the model `path`.
    ///
    /// # Errors
    /// `write.ron`.
    pub fn build(&self, path: &Path) -> Result<Network> {
        self.build_changed(path, Ok)
    }

    /// The network after `change` has edited the model's text.
    ///
    /// # Errors
    /// As [`Self::build`]; the errors of `change`, and `model.*` for the text that it returns.
    pub fn build_changed(&self, path: &Path, change: impl FnOnce(SourceText) -> Result<SourceText>) -> Result<Network> {
        let name = "arrays";
        let (model, tensors) = self.clone().split(name);
        let text = pretty(&model, 2)?;
        let source = change(SourceText::new(path, text.as_str()))?;
        let file = if **source.text() == *text { model } else { NetworkFile::parse(&source)? };
        let arrays = tensors.into_iter().map(|(key, tensor)| (ArrayRef::Safetensors(name.to_string(), key), tensor));
        Network::new(file, source, arrays.collect())
    }

    /// Checks that a model is not written under the ending of another format.
    ///
    /// # Errors
    /// `write.ending`.
    pub fn check_name(path: &Path) -> Result<()> {
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
        match ending.filter(|ending| OTHERS.contains(&ending.as_str())) {
            None => Ok(()),
            Some(ending) => Err(Diagnostic::new(
                "write.ending",
                format!(
                    "a model is text, with its arrays in a .safetensors file next to it, so its name cannot end in \
                     .{ending}"
                ),
            )
            .in_file(path)
            .help(format!("name it {}", path.with_extension("ron").display()))),
        }
    }

    /// Writes the model, and its arrays as `STEM.safetensors` next to it; `-` writes the text
    /// alone.
    ///
    /// # Errors
    /// `write.*`; `write.arrays` for arrays to stdout.
    pub fn write(&self, path: &Path, force: bool) -> Result<Vec<String>> {
        self.write_under("", path, force)
    }

    /// Writes the model with the lines of a comment at its head.
    /// Errors are those of [`Self::write`].
    pub fn write_under(&self, comment: &str, path: &Path, force: bool) -> Result<Vec<String>> {
        self.write_with(BTreeMap::new(), comment, path, force)
    }

    /// The name of the file for the arrays of a model.
    pub fn arrays_name(path: &Path) -> String {
        let stem = path.file_stem().map_or_else(|| "model".into(), |stem| stem.to_string_lossy().into_owned());
        format!("{stem}.safetensors")
    }

    /// As [`Self::write_under`], with further tensors of the file for arrays.
    /// Errors are those of [`Self::write`].
    pub fn write_with(
        &self,
        more: BTreeMap<String, Tensor>,
        comment: &str,
        path: &Path,
        force: bool,
    ) -> Result<Vec<String>> {
        Self::check_name(path)?;
        let name = Self::arrays_name(path);
        let arrays = path.with_file_name(&name);
        let (text, mut tensors) = self.ron(&name)?;
        tensors.extend(more);
        let head = comment.lines().map(|line| format!("// {line}").trim_end().to_string() + "\n");
        let text = head.collect::<String>() + &text;
        write::check_free(path, force)?;
        if tensors.is_empty() {
            write::text(path, force, &text)?;
            return Ok(vec![path.display().to_string()]);
        }
        if text::is_standard_stream(path) {
            return Err(Diagnostic::new("write.arrays", "the model has arrays, which need a file next to it")
                .help("give -o MODEL.ron"));
        }
        let bytes = serialise(&tensors)
            .map_err(|error| Diagnostic::new("write.failed", format!("cannot be written: {error}")).in_file(&arrays))?;
        let mut batch = write::Batch::new(force);
        batch.add(&arrays, |out| out.write_all(&bytes))?;
        batch.add(path, |out| out.write_all(text.as_bytes()))?;
        batch.commit()?;
        Ok(vec![path.display().to_string(), arrays.display().to_string()])
    }
}

/// Endings of files of other formats.
const OTHERS: [&str; 16] = [
    "pt",
    "pth",
    "ckpt",
    "pkl",
    "onnx",
    "nir",
    "net",
    "h5",
    "hdf5",
    "npy",
    "npz",
    "csv",
    "safetensors",
    "json",
    "yml",
    "yaml",
];

/// Tensors as the bytes of a safetensors file, each in the smallest type that represents its
/// numbers exactly.
fn serialise(tensors: &BTreeMap<String, Tensor>) -> Result<Vec<u8>, safetensors::SafeTensorError> {
    let mut stored: Vec<(&String, Dtype, Vec<u8>)> = Vec::new();
    for (key, tensor) in tensors {
        let (dtype, bytes) = match tensor.numbers() {
            Numbers::Integers(x) if x.iter().all(|&x| i8::try_from(x).is_ok()) => {
                (Dtype::I8, x.iter().map(|&x| x as i8 as u8).collect())
            }
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn numbers_read_back_as_the_same_bits(x in any::<f64>().prop_filter("finite", |x| x.is_finite())) {
            let written = ron::to_string(&Number(x)).unwrap();
            let back: f64 = ron::from_str(&written).unwrap();
            prop_assert_eq!(back.to_bits(), x.to_bits());
        }
    }
}
