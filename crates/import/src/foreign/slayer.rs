//! Networks of dense layers that SLAYER or lava-dl trained.
//!
//! Input: matrices by name, from a state dict (`state_dict`) or from the `.npy` files of VT_SNN,
//! and the description of the neurons (`neuron_config`). Output: a model of dense layers in the
//! order of the file, or three layers, of which the last receives both others. A weight becomes `2
//! round(w / 2)`, ties to even (slayerPytorch 01beeeb, `src/quantizeParams.py`). There is one step
//! between layers, as on the chip and as `delayShift` does in training. Only training uses the
//! kernels `srmKernel` and `refKernel` of checkpoints.

use std::path::Path;

use super::encode;
use super::imported::{Format, Imported, LayerWeights, Options, wrong_option};
use super::neuron_config::{self, Neuron, NeuronKind};
use nsim_files::network::{NetworkFile, Parameter, PopulationDesc, ProjectionDesc, ProjectionKind, tensor};
use nsim_files::text::unreadable;
use nsim_files::{disk, npy};
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::warning::{Warning, WarningCode};

/// A layer's weights.
#[derive(Debug, Clone, Default)]
pub(super) struct Matrix {
    pub(super) name: String,
    pub(super) targets: usize,
    pub(super) sources: usize,
    /// `[target][source]`.
    pub(super) weights: Vec<f64>,
    /// `[target][source]` from the layer to itself.
    pub(super) recurrent: Option<Vec<f64>>,
    /// Decays of current and voltage from the file, in 4096ths.
    pub(super) decays: Option<(Vec<f64>, Vec<f64>)>,
}

/// VT_SNN's names of the files of one network, in order.
const SETS: [&[&str]; 2] = [&["tact", "vis", "combi"], &["fc1", "fc2", "fc3", "fc4", "fc5"]];

/// Reads the set of a file: `NNN-tact.npy`, `NNN-vis.npy`, `NNN-combi.npy` or `NNN-fc1.npy`,
/// `NNN-fc2.npy`, .. in its folder.
pub fn read_set(path: &Path, options: &Options) -> Result<Imported> {
    let stem = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
    let (prefix, part) = stem.rsplit_once('-').map_or((None, stem.as_str()), |(prefix, part)| (Some(prefix), part));
    let Some(set) = SETS.iter().find(|set| set.contains(&part)) else {
        let message = format!("'{stem}.npy' is not a file of a VT_SNN network");
        return Err(slayer(message)
            .help("VT_SNN names its files NNN-tact.npy, NNN-vis.npy, NNN-combi.npy, or NNN-fc1.npy, NNN-fc2.npy")
            .in_file(path));
    };
    let mut matrices = Vec::new();
    for part in *set {
        let name = prefix.map_or_else(|| format!("{part}.npy"), |prefix| format!("{prefix}-{part}.npy"));
        let path = path.with_file_name(name);
        let may_be_absent = part.starts_with("fc") && *part != "fc1";
        if may_be_absent && !disk::exists(&path).map_err(|error| unreadable(&path, &error))? {
            break;
        }
        let tensor = npy::read(&path)?;
        let &[targets, sources] = tensor.shape() else {
            let message = format!("the array has shape {:?}, expected a matrix [target, source]", tensor.shape());
            return Err(slayer(message).in_file(path));
        };
        let weights = tensor.reals().collect();
        matrices.push(Matrix { name: (*part).to_string(), targets, sources, weights, ..Matrix::default() });
    }
    options.check(Format::VtSnn)?;
    let (neuron, notes) = neuron_config::read_neuron(options)?;
    build("weights of VT_SNN", prefix.unwrap_or("vtsnn"), matrices, &neuron, notes, options)
}

fn slayer(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("import.slayer", message)
}

/// Builds an integer network, or one of spike response neurons, from matrices.
pub(super) fn build(
    kind: &'static str,
    name: &str,
    matrices: Vec<Matrix>,
    neuron: &Neuron,
    mut notes: Vec<String>,
    options: &Options,
) -> Result<Imported> {
    if matrices.is_empty() {
        return Err(slayer("no tensor is the '.weight' of a dense layer"));
    }
    let mut model = NetworkFile::new(name, options.reading.dt_ms.or(neuron.dt_ms).unwrap_or(1.0));
    model.threshold = options.threshold();
    notes.push(rule(&neuron.kind));
    let (inputs, sources) = inputs(&matrices, options)?;
    if let ([first, second, last], 2) = (matrices.as_slice(), inputs.len()) {
        notes.push(format!("'{}' receives from '{}' and '{}', in this order", last.name, first.name, second.name));
    }
    model.populations = inputs;
    let (mut layers, mut warnings) = (Vec::new(), Vec::new());
    for (matrix, from) in matrices.into_iter().zip(sources) {
        model.populations.push(population(&matrix, &neuron.kind)?);
        let own = matrix.recurrent.map(|weights| (vec![matrix.name.clone()], weights, matrix.targets));
        for (from, weights, sources) in [Some((from, matrix.weights, matrix.sources)), own].into_iter().flatten() {
            let shape = [matrix.targets, sources];
            let (projection, line) = projection(&matrix.name, shape, weights, &neuron.kind, &mut warnings)?;
            model.projections.push(ProjectionDesc { from, ..projection });
            layers.push(line);
        }
        model.output = matrix.name;
    }
    let imported = Imported::new(kind, model, notes).with_provenance(kind).with_warnings(warnings);
    Ok(Imported { layers, ..imported.with_decision(options.decision) })
}

/// The note about weights and steps.
fn rule(kind: &NeuronKind) -> String {
    match kind {
        NeuronKind::SrmAlpha { .. } => {
            "spike response neurons in real numbers, which cores do not support: they run with --engine reference"
                .to_string()
        }
        NeuronKind::Loihi { scale: 1.0, .. } => {
            "weights are round(w / 2) * 2, ties to even; one step of delay between layers".to_string()
        }
        NeuronKind::Loihi { scale, .. } => format!(
            "weights are round({scale} w / 2) * 2, ties to even, from -256 to 254, as lava-dl quantises them; one step \
             of delay between layers"
        ),
    }
}

/// Input populations, and the sources of each layer.
fn inputs(matrices: &[Matrix], options: &Options) -> Result<(Vec<PopulationDesc>, Vec<Vec<String>>)> {
    if (1..matrices.len()).all(|k| matrices[k].sources == matrices[k - 1].targets) {
        let shape = input_shape(options, matrices[0].sources)?;
        let sources = std::iter::once("input").chain(matrices.iter().map(|matrix| matrix.name.as_str()));
        let sources = sources.take(matrices.len()).map(|name| vec![name.to_string()]).collect();
        return Ok((vec![PopulationDesc::input("input", shape)], sources));
    }
    if let [first, second, last] = matrices
        && last.sources == first.targets + second.targets
    {
        let inputs: Vec<PopulationDesc> = [first, second]
            .map(|layer| PopulationDesc::input(&format!("{}_input", layer.name), vec![layer.sources as u64]))
            .into();
        let mut sources: Vec<Vec<String>> = inputs.iter().map(|input| vec![input.name.clone()]).collect();
        sources.push(vec![first.name.clone(), second.name.clone()]);
        return Ok((inputs, sources));
    }
    let shapes: Vec<String> = matrices.iter().map(|m| format!("{} {} -> {}", m.name, m.sources, m.targets)).collect();
    Err(slayer(format!("the layers do not follow each other: {}", shapes.join(", "))))
}

fn population(matrix: &Matrix, kind: &NeuronKind) -> Result<PopulationDesc> {
    let (name, shape) = (&matrix.name, vec![matrix.targets as u64]);
    match *kind {
        NeuronKind::SrmAlpha { theta, tau_sr_ms, tau_ref_ms, scale_ref } => {
            let parameters =
                [("tau_sr_ms", tau_sr_ms), ("tau_ref_ms", tau_ref_ms), ("scale_ref", scale_ref), ("theta", theta)];
            Ok(PopulationDesc { srm: Some(parameters), ..PopulationDesc::input(name, shape) })
        }
        NeuronKind::Loihi { vth_mant, dv, du, refractory, .. } => {
            let (du, dv) = match (&matrix.decays, du, dv) {
                (Some((du, dv)), _, _) => (Parameter::from_values(du.clone()), Parameter::from_values(dv.clone())),
                (None, Some(du), Some(dv)) => (Parameter::Same(du), Parameter::Same(dv)),
                (None, _, _) => {
                    return Err(wrong_option(format!("the decays of '{name}' are missing"))
                        .help("add current_decay and voltage_decay, each from 0 to 1, to the neuron of --neuron"));
                }
            };
            let parameters = vec![
                ("du", du),
                ("dv", dv),
                ("vth_mant", Parameter::Same(vth_mant)),
                ("refractory", Parameter::Same(refractory)),
            ];
            Ok(PopulationDesc::loihi(name, shape, parameters))
        }
    }
}

/// The synapses of weights `[target][source]` to a layer, and what rounding did to them.
fn projection(
    layer: &str,
    shape: [usize; 2],
    given: Vec<f64>,
    kind: &NeuronKind,
    warnings: &mut Vec<Warning>,
) -> Result<(ProjectionDesc, LayerWeights)> {
    let NeuronKind::Loihi { weight_exp, scale, .. } = *kind else {
        let line = LayerWeights::new(layer, &shape, 1.0, &given, &given);
        let weights = ProjectionKind::Dense(tensor(shape.to_vec(), given));
        return Ok((ProjectionDesc::new("", layer, weights), line));
    };
    let mut rounded: Vec<f64> = given.iter().map(|w| (scale * w / 2.0).round_ties_even() * 2.0 + 0.0).collect();
    // lava-dl clips, SLAYER does not.
    if scale != 1.0 {
        rounded.iter_mut().for_each(|w| *w = w.clamp(-256.0, 254.0));
    }
    let encoded = encode::encode(rounded, weight_exp);
    if encoded.changed > 0 {
        let message = format!(
            "{} of {} weights do not fit into one synapse format with the others; they are rounded and clipped",
            encoded.changed,
            given.len()
        );
        warnings.push(Warning::of_population(WarningCode::WeightsRounded, layer, message));
    }
    let line = LayerWeights::new(layer, &shape, scale, &given, &encoded.in_units(weight_exp));
    if line.is_lost() {
        return Err(slayer(format!("the weights are too small for a core: {line}")).help(format!(
            "weights of these neurons are multiples of {}; neurons of lava-dl have the type CUBA in --neuron, and a \
             network of another tool is read in Python: nsim.from_torch(net, sample)",
            2.0 / scale
        )));
    }
    let (weight_exp, sign) = (encoded.exponent(), encoded.sign.stated());
    let weights = ProjectionKind::Dense(tensor(shape.to_vec(), encoded.weights));
    Ok((ProjectionDesc { weight_exp, sign, ..ProjectionDesc::new("", layer, weights) }, line))
}

/// The shape of an input of `units` channels: `--input-shape`, or `[units]`.
fn input_shape(options: &Options, units: usize) -> Result<Vec<u64>> {
    let Some(given) = &options.input_shape else { return Ok(vec![units as u64]) };
    let product = given.iter().try_fold(1u64, |product, &axis| product.checked_mul(axis));
    if product == Some(units as u64) {
        return Ok(given.clone());
    }
    let message =
        format!("--input-shape {given:?} has {} channels, the first layer has {units} inputs", product.unwrap_or(0));
    Err(wrong_option(message).help("write CHANNELS,HEIGHT,WIDTH of the first layer's input"))
}
