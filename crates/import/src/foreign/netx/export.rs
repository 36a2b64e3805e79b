//! A model as a netx file of lava-dl, and back without loss.
//!
//! Input: a model with one input whose populations form a chain, like the layers of netx. Output:
//! the tree of a `.net` file, and notes on properties of the model that netx lacks. Weights are
//! mantissas times `2^weight_exp`. As in NIR, a group of nsim's own has the text of the model and
//! its arrays. `restore` reads the model from it, provided that exporting this model gives the
//! layers of the file.
//!
//! Errors: `export.unsupported` for a model without a form in netx.

use crate::foreign::nir::export::{MOST_MATRIX, check_neurons, model_metadata};
use crate::foreign::window::Step;
use crate::hdf5::{Group, Item, Numbers};
use nsim_files::network::{NetworkFile, Parameter, PopulationDesc, ProjectionDesc, ProjectionKind};
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::neurons::{NeuronKind, Port};

/// The group of the model's text.
pub(super) const GROUP: &str = "nsim";

/// The netx form of a neuron kind.
pub(super) struct NetxNeuron {
    /// Its type in netx.
    pub(super) kind: &'static str,
    /// Fields: nsim's parameter, netx's field, and the parameter's value for 1 in netx.
    pub(super) fields: &'static [(&'static str, &'static str, f64)],
    /// Parameters that netx fixes; others without a field are lost unless default or a bias.
    pub(super) fixed: &'static [(&'static str, f64)],
    /// A bias of 1 in units of the mantissa; `None` for kinds without a bias.
    bias: Option<f64>,
}

const LEAKY_FIELDS: &[(&str, &str, f64)] =
    &[("du", "iDecay", 1.0), ("dv", "vDecay", 1.0), ("vth_mant", "vThMant", 1.0), ("refractory", "refDelay", 1.0)];
const SIGMA_DELTA_FIELDS: &[(&str, &str, f64)] = &[("vth_mant", "vThMant", 1.0)];
const RESONATOR_FIELDS: &[(&str, &str, f64)] =
    &[("sin_decay", "sinDecay", 1.0), ("cos_decay", "cosDecay", 1.0), ("threshold", "vThMant", 64.0)];
const ADAPTIVE_FIELDS: &[(&str, &str, f64)] = &[
    ("du", "iDecay", 1.0),
    ("dv", "vDecay", 1.0),
    ("dtheta", "thDecay", 1.0),
    ("dr", "refDecay", 1.0),
    ("threshold", "vThMant", 64.0),
    ("threshold_step", "vThStep", 64.0),
];
const ADAPTIVE_RESONATOR_FIELDS: &[(&str, &str, f64)] = &[
    ("sin_decay", "sinDecay", 1.0),
    ("cos_decay", "cosDecay", 1.0),
    ("dtheta", "thDecay", 1.0),
    ("dr", "refDecay", 1.0),
    ("threshold", "vThMant", 64.0),
    ("threshold_step", "vThStep", 64.0),
];
/// Fractional bits of a resonator's state: lava-dl's weights are in 64ths, its states in 4096ths.
const RESONATOR_CONSTANTS: &[(&str, f64)] = &[("state_exp", 6.0)];
const DELTA_CONSTANTS: &[(&str, f64)] = &[("spike_exp", 6.0), ("state_exp", 6.0)];
const SIGMA_DELTA_CONSTANTS: &[(&str, f64)] = &[("spike_exp", 6.0), ("state_exp", 6.0), ("relu", 1.0)];

pub(super) fn netx_neuron(kind: NeuronKind) -> Option<NetxNeuron> {
    let (kind, fields, fixed, bias): (_, _, &[_], _) = match kind {
        NeuronKind::Loihi => ("CUBA", LEAKY_FIELDS, &[], Some(64.0)),
        NeuronKind::GradedLif => ("CUBA", LEAKY_FIELDS, &[], None),
        NeuronKind::SigmaDelta => ("SDNN", SIGMA_DELTA_FIELDS, SIGMA_DELTA_CONSTANTS, Some(1.0)),
        NeuronKind::Delta => ("SDNN", SIGMA_DELTA_FIELDS, DELTA_CONSTANTS, None),
        NeuronKind::Sigma => ("SDNN", &[][..], &[], None),
        NeuronKind::Rf => ("RF_PHASE", RESONATOR_FIELDS, RESONATOR_CONSTANTS, None),
        NeuronKind::RfIz => ("RF_IZHIKEVICH", RESONATOR_FIELDS, RESONATOR_CONSTANTS, None),
        NeuronKind::Alif => ("ALIF", ADAPTIVE_FIELDS, &[], None),
        NeuronKind::Adrf => ("ADRF_PHASE", ADAPTIVE_RESONATOR_FIELDS, RESONATOR_CONSTANTS, None),
        NeuronKind::AdrfIz => ("ADRF_IZHIKEVICH", ADAPTIVE_RESONATOR_FIELDS, RESONATOR_CONSTANTS, None),
        _ => return None,
    };
    Some(NetxNeuron { kind, fields, fixed, bias })
}

fn unsupported(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("export.unsupported", message)
        .help("netx supports one input and a chain of integer layers; export other networks as .nir")
}

/// The tree of a file, and notes on properties of the model that netx lacks.
///
/// # Errors
/// `export.unsupported` for populations that do not form a chain, real parameters, kinds of neurons
/// or projections that netx lacks, weights that are not whole.
pub fn export(model: &NetworkFile) -> Result<(Group, Vec<String>)> {
    check_neurons(model)?;
    let mut notes = Vec::new();
    let mut layers = Group::default();
    let inputs = model.populations.iter().filter(|population| is_input(population)).count();
    let last = model.populations.last().map(|population| &population.name);
    if inputs != 1 || !model.populations.first().is_some_and(is_input) || last != Some(&model.output) {
        return Err(unsupported("the model does not begin with its only input and end with its output"));
    }
    if let Some(population) = model.populations.iter().find(|population| population.payload.is_some()) {
        return Err(unsupported(format!("the spikes of '{}' have a payload", population.name)));
    }
    let (mut connected, mut number) = (0, 0u32);
    for pair in model.populations.windows(2) {
        let [before, population] = pair else { continue };
        let into: Vec<_> = model.projections.iter().filter(|projection| projection.to == population.name).collect();
        if let Some(other) = into.iter().find(|projection| projection.from != [before.name.as_str()]) {
            return Err(unsupported(format!("'{}' receives spikes of {:?}", population.name, other.from)));
        }
        connected += into.len();
        let delay = model.projections.iter().find(|other| other.from == [population.name.as_str()]).map(|p| p.delay);
        let neuron = neuron(population, &mut notes)?;
        let mut layer = layer(before, population, &into)?.with("neuron", neuron);
        if let Some(delay) = delay.filter(|delay| *delay > 0) {
            layer.insert("delay", int(delay.into()));
        }
        if let Some(bits) = population.message_bits {
            layer.insert("messageBits", int(bits));
        }
        if let Some(bias) = bias(population) {
            layer.insert("bias", numbers(&bias));
        }
        if layer.text("type") == Some("dense") && before.loihi.is_some() && before.shape.len() == 3 {
            layers.insert(&number.to_string(), typed("flatten", &[before.units()]));
            number += 1;
        }
        layers.insert(&number.to_string(), layer);
        number += 1;
    }
    if connected != model.projections.len() {
        return Err(unsupported("a projection does not connect a population to the next one"));
    }
    let simulation = Group::default().with("Ts", Numbers::f64(&[], &[model.timestep_ms]));
    let root = Group::default().with("layer", layers).with("simulation", simulation);
    Ok((root.with(GROUP, model_metadata(model)?), notes))
}

fn is_input(population: &PopulationDesc) -> bool {
    population.loihi.is_none() && population.srm.is_none()
}

fn int(number: i64) -> Numbers {
    Numbers::i64(&[], &[number])
}

fn ints(numbers: &[u64]) -> Numbers {
    Numbers::i64(&[numbers.len()], &numbers.iter().map(|&x| x as i64).collect::<Vec<_>>())
}

/// One number for all units, or one for each.
fn numbers(parameter: &Parameter) -> Numbers {
    match parameter {
        Parameter::Same(number) => Numbers::f64(&[], &[*number]),
        each => Numbers::f64(&[each.values().len()], each.values()),
    }
}

fn neuron(population: &PopulationDesc, notes: &mut Vec<String>) -> Result<Group> {
    let name = &population.name;
    let Some(form) = population.loihi.as_ref().and(netx_neuron(population.kind)) else {
        return Err(unsupported(format!("'{name}' has {} neurons, which netx does not have", population.kind_name())));
    };
    let mut neuron = Group::default().with("type", form.kind);
    for (ours, theirs, unit) in form.fields {
        if let Some(value) = population.parameter(ours) {
            neuron.insert(theirs, numbers(&value.map(|value| value / unit)));
        }
    }
    match population.kind {
        NeuronKind::Sigma => neuron.insert("sigma_output", int(1)),
        NeuronKind::GradedLif => neuron.insert("gradedSpike", int(1)),
        _ => {}
    }
    let mut lost = Vec::new();
    for field in population.kind.parameters() {
        let written = form.fields.iter().any(|(ours, ..)| *ours == field.name);
        if written && population.parameter(field.name).is_none() && field.default.is_none() {
            return Err(unsupported(format!("'{name}' has no {}: netx holds integers", field.name)));
        }
        let is_bias = form.bias.is_some() && ["bias_mant", "bias_exp"].contains(&field.name);
        let fixed = form.fixed.iter().find(|(fixed, _)| *fixed == field.name).map(|(_, value)| *value);
        let default = field.default.unwrap_or(0) as f64;
        let parameter = population.parameter(field.name).cloned().unwrap_or(Parameter::Same(default));
        if !written && !is_bias && parameter != Parameter::Same(fixed.unwrap_or(default)) {
            lost.push(field.name);
        }
    }
    lost.extend((population.start_step > 0).then_some("start_step"));
    if !lost.is_empty() {
        notes.push(format!("netx has no {}: only nsim reads this part of '{name}'", lost.join(", ")));
    }
    Ok(neuron)
}

/// The bias in units of netx, unless it is 0.
fn bias(population: &PopulationDesc) -> Option<Parameter> {
    let (unit, mantissa) = (netx_neuron(population.kind)?.bias?, population.parameter("bias_mant")?);
    let biases = (0..population.units() as usize).map(|at| {
        let exponent = population.parameter("bias_exp").map_or(0.0, |exponent| exponent.get(at));
        mantissa.get(at) * exponent.exp2() / unit
    });
    Some(Parameter::from_values(biases.collect())).filter(|bias| *bias != Parameter::Same(0.0))
}

fn typed(kind: &str, shape: &[u64]) -> Group {
    Group::default().with("type", kind).with("shape", ints(shape))
}

fn pair(pair: (u64, u64)) -> Numbers {
    ints(&[pair.0, pair.1])
}

/// A layer with the fields of its window, whose padding at the end is `after`.
fn with_window(layer: Group, [stride, padding, dilation]: Step, after: (u64, u64), name: &str) -> Result<Group> {
    match after == padding {
        true => Ok(layer.with("stride", pair(stride)).with("padding", pair(padding)).with("dilation", pair(dilation))),
        false => Err(unsupported(format!("the window into '{name}' pads the image differently before and after it"))),
    }
}

/// The weights of a projection as `[target][source]`.
fn matrix(projection: &ProjectionDesc, sources: u64, targets: u64) -> Result<Numbers> {
    let (rows, columns) = (targets as usize, sources as usize);
    let weights = match &projection.kind {
        ProjectionKind::Dense(weights) => weights.tensor().reals().collect(),
        ProjectionKind::Sparse(synapses) if targets.saturating_mul(sources) <= MOST_MATRIX => {
            let mut matrix = vec![0.0; rows * columns];
            synapses.iter().for_each(|&(from, to, w)| matrix[to as usize * columns + from as usize] += w);
            matrix
        }
        _ => {
            let (kind, name) = (projection.kind_name(), &projection.to);
            return Err(unsupported(format!("netx does not support the {kind} projection into '{name}'")));
        }
    };
    Ok(Numbers::f64(&[rows, columns], &integer_weights(projection, weights)?))
}

/// A layer without its neurons: its type, shape and weights.
fn layer(before: &PopulationDesc, population: &PopulationDesc, into: &[&ProjectionDesc]) -> Result<Group> {
    let name = &population.name;
    let is_input = before.loihi.is_none();
    let ports = population.kind.table().ports;
    let first = match into {
        [first] if ports == 1 => first,
        [first, second] if ports == 2 && (first.port, second.port) == (Port::First, Port::Second) => first,
        _ => return Err(unsupported(format!("'{name}' has {} projections into it", into.len()))),
    };
    if is_input && into.iter().any(|projection| projection.delay > 0) {
        return Err(unsupported(format!("'{name}' receives its input after a delay")));
    }
    if into.iter().any(|projection| projection.delay != first.delay || projection.weight_scale.is_some()) {
        return Err(unsupported(format!("'{name}' has projections with a weight_scale or with several delays")));
    }
    let flat = [population.units()];
    if population.kind == NeuronKind::Delta {
        let identity = match &first.kind {
            ProjectionKind::Sparse(all) => {
                all.len() as u64 == flat[0] && (0..).zip(all).all(|(unit, synapse)| *synapse == (unit, unit, 1.0))
            }
            ProjectionKind::SumPool2d { kernel: (1, 1), stride: (1, 1), weight: 1.0, .. } => true,
            _ => false,
        };
        if !identity || !is_input || first.weight_exp.unwrap_or(0) != 0 {
            return Err(unsupported(format!("'{name}' sends changes, but does not receive the input unchanged")));
        }
        return Ok(typed("input", &population.shape));
    }
    match &first.kind {
        ProjectionKind::Conv2d { weights, stride, padding, padding_after, dilation, groups } if into.len() == 1 => {
            let kernel = weights.tensor();
            let weights = integer_weights(first, kernel.reals())?;
            let layer = typed("conv", &population.shape).with("groups", int(*groups as i64));
            let layer = layer.with("weight", Numbers::f64(kernel.shape(), &weights));
            with_window(layer, [*stride, *padding, *dilation], *padding_after, name)
        }
        ProjectionKind::SumPool2d { kernel, stride, padding, padding_after, weight } if into.len() == 1 => {
            let weights = integer_weights(first, vec![*weight; (kernel.0 * kernel.1) as usize])?;
            let weights = Numbers::f64(&[1, 1, kernel.0 as usize, kernel.1 as usize], &weights);
            let layer = typed("pool", &population.shape).with("kernelSize", pair(*kernel)).with("weight", weights);
            with_window(layer, [*stride, *padding, (1, 1)], *padding_after, name)
        }
        _ => {
            let weights = into.iter().map(|projection| matrix(projection, before.units(), flat[0]));
            let weights: Vec<Numbers> = weights.collect::<Result<_>>()?;
            let weights = match weights.as_slice() {
                [real, imag] => Item::from(Group::default().with("real", real.clone()).with("imag", imag.clone())),
                weights => Item::from(weights[0].clone()),
            };
            let (inputs, outputs) = (int(before.units() as i64), int(flat[0] as i64));
            Ok(typed("dense", &flat).with("inFeatures", inputs).with("outFeatures", outputs).with("weight", weights))
        }
    }
}

fn integer_weights(projection: &ProjectionDesc, weights: impl IntoIterator<Item = f64>) -> Result<Vec<f64>> {
    let unit = (projection.weight_exp.unwrap_or(0) as f64).exp2();
    let scaled: Vec<f64> = weights.into_iter().map(|weight| weight * unit).collect();
    match scaled.iter().all(|weight| weight.fract() == 0.0) {
        true => Ok(scaled),
        false => Err(unsupported(format!("the weights into '{}' are not whole, times 2^weight_exp", projection.to))),
    }
}
