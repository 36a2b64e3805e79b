//! Trained weights as a model.
//!
//! A Loihi weight is stored as half its (even) mantissa, which fits a byte, an SRM weight as
//! trained. The model decides as it did in training.

use super::cells::Cells;
use super::network::{Layer, Topology, Weights};
use nsim_files::network::{NetworkFile, Parameter, PopulationDesc, ProjectionDesc, ProjectionKind, tensor};
use nsim_files::training::{LayerDesc, LossDesc, NeuronDesc, TimesDesc, TrainingFile};
use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// The model of trained weights.
///
/// # Errors
/// `train.export` for neurons that a model file cannot describe.
pub fn model(file: &TrainingFile, topology: &Topology, weights: &Weights, provenance: &str) -> Result<NetworkFile> {
    let mut model = NetworkFile::new(&file.name, *file.timestep_ms);
    for input in &file.inputs {
        model.populations.push(PopulationDesc::input(&input.name, input.shape.clone()));
    }
    for ((desc, layer), weights) in file.layers.iter().zip(&topology.layers).zip(weights) {
        model.populations.push(population(file, desc, layer)?);
        let numbers = by_target(layer, weights).map(|w| match &layer.mantissas {
            Some(mantissas) => f64::from(mantissas.mantissa(w) / 2),
            None => w.into(),
        });
        let kind = ProjectionKind::Dense(tensor(vec![layer.cells.count(), layer.fan_in], numbers.collect()));
        model.projections.push(ProjectionDesc {
            from: desc.from.clone(),
            weight_exp: layer.mantissas.as_ref().map(|mantissas| mantissas.exponent.get().into()),
            weight_scale: layer.mantissas.as_ref().map(|_| 2.0),
            ..ProjectionDesc::new("", &desc.name, kind)
        });
    }
    // This target has the kinds of Loihi 2.
    let loihi2 = |layer: &Layer| matches!(layer.cells, Cells::Loihi2(_));
    model.target = topology.layers.iter().any(loihi2).then(|| "oheo-gulch".to_string());
    model.output = file.layers.last().map_or_else(String::new, |layer| layer.name.clone());
    if let LossDesc::Potential { decision, .. } = file.loss.value {
        model.decision = decision;
    }
    model.classes = file.classes.clone();
    model.scene = file.scene.clone();
    model.provenance = Some(provenance.to_string());
    Ok(model)
}

/// Weights in the order of model files, `[target][source]`.
fn by_target<'a>(layer: &'a Layer, weights: &'a [f32]) -> impl Iterator<Item = f32> + 'a {
    let n = layer.cells.count();
    (0..n).flat_map(move |target| (0..layer.fan_in).map(move |source| weights[source * n + target]))
}

fn population(file: &TrainingFile, desc: &LayerDesc, layer: &Layer) -> Result<PopulationDesc> {
    let shape = vec![desc.size.into()];
    match (&layer.cells, desc.neuron.as_ref().unwrap_or(&file.neuron)) {
        (Cells::Loihi(loihi), _) => {
            let of = |name: &str| -> Vec<f64> {
                loihi.fields.iter().map(|fields| fields.neuron.parameter(name) as f64).collect()
            };
            let parameters =
                ["du", "dv", "vth_mant", "refractory"].map(|name| (name, Parameter::from_values(of(name))));
            Ok(PopulationDesc::loihi(&desc.name, shape, parameters.to_vec()))
        }
        (Cells::Loihi2(loihi2), _) => {
            let of = |place: usize| Parameter::from_values(loihi2.rows.iter().map(|row| row.0[place].into()).collect());
            let names = loihi2.kind.parameters().iter().map(|parameter| parameter.name);
            let parameters = names.enumerate().map(|(place, name)| (name, of(place))).collect();
            Ok(PopulationDesc { kind: loihi2.kind, ..PopulationDesc::loihi(&desc.name, shape, parameters) })
        }
        (Cells::Srm(_), NeuronDesc::Srm { tau_sr_ms: TimesDesc::Same(tau), tau_ref_ms, scale_ref, theta, .. }) => {
            let srm = [("tau_sr_ms", *tau), ("tau_ref_ms", *tau_ref_ms), ("scale_ref", *scale_ref), ("theta", *theta)];
            Ok(PopulationDesc { srm: Some(srm), ..PopulationDesc::input(&desc.name, shape) })
        }
        (Cells::Srm(_), _) => Err(Diagnostic::new(
            "train.export",
            format!("layer '{}': SRM populations of a model file have one time constant", desc.name),
        )
        .help("declare one layer for each time constant, and let the next layer read all of them")),
    }
}
