//! Trained weights as a model file: RON beside a safetensors file with one tensor a projection.
//!
//! Loihi weights are stored as half their (even) mantissa in one byte each, SRM weights as f32;
//! both are what the network was trained with, so that the model decides as it did in training.

use std::fmt::Write;

use safetensors::tensor::{Dtype, TensorView};

use super::cells::Cells;
use super::network::{Layer, Topology, Weights};
use nsim_files::training::{LayerDesc, LossDesc, NeuronDesc, TimesDesc, TrainingFile};
use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// A model, ready to be written.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// The model file.
    pub ron: String,
    /// Weights, for the file that the model file names.
    pub weights: Vec<u8>,
}

/// A model file whose weights are in `weights_file` beside it; `comment` is put before it, line by
/// line.
///
/// # Errors
/// `train.export` for neurons that a model file cannot describe.
pub fn model(
    file: &TrainingFile,
    topology: &Topology,
    weights: &Weights,
    weights_file: &str,
    comment: &str,
    provenance: &str,
) -> Result<Model> {
    let mut out = String::new();
    let mut tensors: Vec<(&Layer, Dtype, Vec<u8>)> = Vec::new();
    for line in comment.lines() {
        let _ = writeln!(out, "{}", format!("// {line}").trim_end());
    }
    let _ = writeln!(
        out,
        "Network(\n    name: {:?},\n    timestep_ms: {:?},\n    populations: [",
        file.name, *file.timestep_ms
    );
    for input in &file.inputs {
        let _ = writeln!(out, "        Input(name: {:?}, shape: {:?}),", input.name, input.shape);
    }
    for (desc, layer) in file.layers.iter().zip(&topology.layers) {
        let _ = writeln!(out, "        {},", population(file, desc, layer)?);
    }
    out += "    ],\n    projections: [\n";
    for ((desc, layer), weights) in file.layers.iter().zip(&topology.layers).zip(weights) {
        let format = match &layer.mantissas {
            Some(m) => {
                let stored = by_target(layer, weights).map(|w| (m.mantissa(w) / 2) as i8 as u8).collect();
                tensors.push((layer, Dtype::I8, stored));
                format!(", weight_exp: {}, weight_scale: 2.0", m.exponent)
            }
            None => {
                tensors.push((layer, Dtype::F32, by_target(layer, weights).flat_map(f32::to_le_bytes).collect()));
                String::new()
            }
        };
        let _ = writeln!(
            out,
            "        Dense(from: {:?}, to: {:?}, weights: Safetensors({weights_file:?}, {:?}){format}),",
            desc.from, desc.name, desc.name
        );
    }
    let output = file.layers.last().map_or("", |layer| &layer.name);
    let _ = writeln!(out, "    ],\n    output: {output:?},");
    if let LossDesc::Potential { decision, .. } = file.loss.value {
        let _ = writeln!(out, "    decision: {decision:?},");
    }
    if !file.classes.is_empty() {
        let _ = writeln!(out, "    classes: {:?},", file.classes);
    }
    if let Some(scene) = &file.scene {
        let _ = writeln!(out, "    scene: {scene:?},");
    }
    let _ = writeln!(out, "    provenance: {provenance:?},\n)");
    let fault = |error: safetensors::SafeTensorError| Diagnostic::new("train.export", error.to_string());
    let mut views = Vec::new();
    for (layer, dtype, bytes) in &tensors {
        let shape = vec![layer.cells.len(), layer.fan_in];
        views.push((layer.name.as_str(), TensorView::new(*dtype, shape, bytes).map_err(fault)?));
    }
    Ok(Model { ron: out, weights: safetensors::serialize(views, None).map_err(fault)? })
}

/// Weights in the order of model files, `[target][source]`.
fn by_target<'a>(layer: &'a Layer, weights: &'a [f32]) -> impl Iterator<Item = f32> + 'a {
    let n = layer.cells.len();
    (0..n).flat_map(move |target| (0..layer.fan_in).map(move |source| weights[source * n + target]))
}

/// A list whose entries are equal is written as one number.
fn parameter<T: PartialEq + std::fmt::Debug>(values: &[T]) -> String {
    match values {
        [first, rest @ ..] if rest.iter().all(|value| value == first) => format!("{first:?}"),
        _ => format!("{values:?}"),
    }
}

fn population(file: &TrainingFile, desc: &LayerDesc, layer: &Layer) -> Result<String> {
    let head = format!("name: {:?}, shape: [{}]", desc.name, desc.size);
    match (&layer.cells, desc.neuron.as_ref().unwrap_or(&file.neuron)) {
        (Cells::Loihi(loihi), _) => {
            let of = |field: fn(&nsim_ir::quantised::Neuron) -> i64| {
                parameter(&loihi.fields.iter().map(|f| field(&f.neuron)).collect::<Vec<_>>())
            };
            Ok(format!(
                "Loihi({head}, du: {}, dv: {}, vth_mant: {}, refractory: {})",
                of(|n| n.du.get().into()),
                of(|n| n.dv.get().into()),
                of(|n| n.vth.get().into()),
                of(|n| n.refractory.get().into()),
            ))
        }
        (Cells::Srm(_), NeuronDesc::Srm { tau_sr_ms: TimesDesc::Same(tau), tau_ref_ms, scale_ref, theta, .. }) => {
            Ok(format!(
                "Srm({head}, tau_sr_ms: {tau:?}, tau_ref_ms: {tau_ref_ms:?}, scale_ref: {scale_ref:?}, theta: \
                 {theta:?})"
            ))
        }
        (Cells::Srm(_), _) => Err(Diagnostic::new(
            "train.export",
            format!("layer '{}': SRM populations of a model file have one time constant", desc.name),
        )
        .help("declare one layer for each time constant, and let the next layer read all of them")),
    }
}
