//! State dicts of SLAYER and lava-dl, recognised by the names and shapes of their tensors.
//!
//! Input: a checkpoint, and the description of its neurons (`--neuron`). Output: a model whose
//! layers follow each other in the order of the file ([`super::slayer`]). A checkpoint may hold the
//! state dict in a dictionary within it. A state dict has no `forward()`, so one of another tool is
//! no network: it is refused with the Python that reads the network itself. Blocks of lava-dl other
//! than dense layers of CUBA neurons are refused with lava-dl's export: the activation of a
//! sigma-delta neuron and the stride of a convolution are in no tensor.
//!
//! Errors: `import.state-dict` for the content of the file, `import.option` for missing or
//! contradictory descriptions of the neurons.

use std::collections::BTreeMap;
use std::path::Path;

use super::imported::{Format, Imported, Options, population_name, wrong_option};
use super::neuron_config::{self, LAVA_SCALE, NeuronKind};
use super::slayer::{self, Matrix};
use super::stored::{self, Array, wrong};
use super::torch;
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::warning::{Warning, WarningCode};

/// The role of a tensor in its layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Role {
    /// `[target][source..]`.
    Weight,
    /// `[target][target]`, from the layer to itself.
    Recurrent,
    /// In 4096ths.
    CurrentDecay,
    VoltageDecay,
}

/// Roles by the end of a tensor's name; the first match counts, and the rest of the name is the
/// layer.
const ROLES: [(&str, Role); 5] = [
    ("recurrent_synapse.weight", Role::Recurrent),
    ("synapse.weight", Role::Weight),
    ("weight", Role::Weight),
    ("neuron.current_decay", Role::CurrentDecay),
    ("neuron.voltage_decay", Role::VoltageDecay),
];

/// Buffers of SLAYER's networks.
const SLAYER_KERNELS: [&str; 2] = ["srmKernel", "refKernel"];
/// State of lava-dl's neurons after the last sample.
const LAVA_STATES: [&str; 2] = ["current_state", "voltage_state"];
/// Axes of a weight of SLAYER and lava-dl, whose layers are convolutions in space and time.
const WEIGHT_AXES: usize = 5;

/// Keys under which trainers store the network (Lightning; the tutorials of PyTorch).
const NETWORK_KEYS: [&str; 2] = ["state_dict", "model_state_dict"];
/// Keys under which trainers store their own state.
const TRAINING_KEYS: [&str; 8] = [
    "callbacks",
    "loops",
    "lr_schedulers",
    "optim",
    "optimizer",
    "optimizer_state_dict",
    "optimizer_states",
    "scheduler",
];

struct Layer {
    name: String,
    weight: Array,
    others: BTreeMap<Role, Array>,
}

impl Layer {
    /// Axes of the weight without the last ones of length 1, which are time or a kernel of one
    /// unit.
    fn axes(&self) -> &[usize] {
        let shape = &self.weight.shape[..];
        let used = shape.iter().rposition(|&axis| axis != 1).map_or(0, |last| last + 1);
        &shape[..used.max(2).min(shape.len())]
    }
}

/// Reads a checkpoint; the path is for messages.
pub fn read(bytes: Vec<u8>, path: &Path, name: &str, options: &Options) -> Result<Imported> {
    let mut checkpoint = torch::open(bytes)?;
    let key = network_key(&checkpoint, path)?;
    let within = key.as_ref().map_or_else(String::new, |key| format!("{key}."));
    let mut ignored: Vec<String> =
        checkpoint.entries().filter(|(name, _)| !name.starts_with(&within)).map(|(name, _)| name.to_string()).collect();
    let arrays = stored::arrays(&mut checkpoint, &within)?;
    let lava = arrays.iter().any(is_of_lava);
    refuse_others(&arrays, lava, path, key.as_deref())?;
    let (used, unused): (Vec<Array>, Vec<Array>) = arrays.into_iter().partition(|array| role(&array.key).is_some());
    ignored.extend(unused.into_iter().map(|array| array.key));
    options.check(Format::Layers)?;
    let (mut neuron, mut notes) = neuron_config::read_neuron(options)?;
    if !ignored.is_empty() {
        notes.insert(0, format!("not used: {}", ignored[..ignored.len().min(12)].join(", ")));
    }
    let layers = layers(used)?;
    let matrices = (0..layers.len()).map(|place| matrix(&layers, place, options)).collect::<Result<Vec<Matrix>>>()?;
    if let (true, NeuronKind::Loihi { scale, du, dv, .. }) = (lava, &mut neuron.kind) {
        *scale = LAVA_SCALE;
        if matrices.iter().filter_map(|matrix| matrix.decays.as_ref()).any(|decays| differ(decays, *du, *dv)) {
            notes.push("the decays come from the weights' file, not from --neuron".to_string());
        }
    }
    let order: Vec<&str> = matrices.iter().map(|matrix| matrix.name.as_str()).collect();
    let assumed = format!(
        "layers in the order of definition: {}; a state dict lacks the sums and functions of forward()",
        order.join(" -> ")
    );
    let kind = if lava { "PyTorch state dict of lava-dl" } else { "PyTorch state dict of SLAYER" };
    let mut imported = slayer::build(kind, name, matrices, &neuron, notes, options)?;
    imported.warn(Warning::of_network(WarningCode::LayerOrder, assumed));
    Ok(imported)
}

/// The key of the dictionary that holds the network; none where the checkpoint itself does.
fn network_key(checkpoint: &torch::Checkpoint, path: &Path) -> Result<Option<String>> {
    let keys = checkpoint.dictionaries();
    if let Some(&key) = NETWORK_KEYS.iter().find(|&&key| keys.iter().any(|other| other == key)) {
        return Ok(Some(key.to_string()));
    }
    match keys.iter().filter(|key| !TRAINING_KEYS.contains(&key.as_str())).collect::<Vec<_>>()[..] {
        [] => Ok(None),
        [key] => Ok(Some(key.clone())),
        [first, ..] => Err(wrong(format!("the tensors are in several dictionaries: {}", keys.join(", ")))
            .help(format!("save the network's own, such as torch.save({}, \"weights.pt\")", load(path, Some(first))))),
    }
}

/// A text as a literal of Python.
fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}

/// The Python expression of a state dict.
fn load(path: &Path, key: Option<&str>) -> String {
    let key = key.map_or_else(String::new, |key| format!("[{}]", quoted(key)));
    format!("torch.load({}, map_location=\"cpu\"){key}", quoted(&path.display().to_string()))
}

/// The last part of a dotted name.
fn last_part(key: &str) -> &str {
    key.rsplit('.').next().unwrap_or_default()
}

/// The layer of a tensor, and its role there.
fn role(key: &str) -> Option<(&str, Role)> {
    ROLES.iter().find_map(|&(end, role)| {
        let layer = key.strip_suffix(end).filter(|layer| layer.is_empty() || layer.ends_with('.'))?;
        Some((layer.trim_end_matches('.'), role))
    })
}

fn is_of_lava(array: &Array) -> bool {
    match role(&array.key) {
        Some((_, Role::CurrentDecay | Role::VoltageDecay)) => true,
        _ => array.key.contains("synapse.") && array.shape.len() == WEIGHT_AXES,
    }
}

fn is_of_slayer(array: &Array) -> bool {
    SLAYER_KERNELS.contains(&last_part(&array.key)) || array.key.ends_with("weight") && array.shape.len() == WEIGHT_AXES
}

/// Whether the network depends on a tensor that is not read. Layers without delays may store delays
/// of 0.
fn is_unread(array: &Array) -> bool {
    match (role(&array.key), last_part(&array.key)) {
        // Normalisations have weights of one axis.
        (Some((_, Role::Weight)), _) => array.shape.len() < 2 || array.numbers.is_empty(),
        (Some(_), _) => false,
        (None, "bias") => !array.is_zero(),
        (None, "delay") => array.numbers.iter().any(|&delay| delay >= 1.0),
        (None, last) => !SLAYER_KERNELS.contains(&last) && !LAVA_STATES.contains(&last),
    }
}

/// Refuses a state dict that is neither SLAYER's nor lava-dl's, and tensors of theirs that are not
/// read.
fn refuse_others(arrays: &[Array], lava: bool, path: &Path, key: Option<&str>) -> Result<()> {
    // Many tools have biases, so another tensor says more.
    let unread = arrays.iter().filter(|array| is_unread(array)).min_by_key(|array| last_part(&array.key) == "bias");
    let unread = match unread {
        None if lava || arrays.iter().any(is_of_slayer) => return Ok(()),
        None => arrays.first(),
        found => found,
    };
    let Some(Array { key: tensor, shape, .. }) = unread else { return Err(wrong("the state dict has no tensors")) };
    if lava {
        let of = match last_part(tensor) {
            _ if tensor.contains(".delta.") => "a sigma-delta neuron, whose activation is in no tensor",
            "delay" => "learned delays",
            _ => "a block of lava-dl other than a dense layer of CUBA neurons",
        };
        return Err(wrong(format!("tensor '{tensor}' of shape {shape:?} is of {of}")).help(
            "write the network in Python, net.export_hdf5(\"net.net\"), and give that file: nsim import net.net",
        ));
    }
    if last_part(tensor) == "delay" && arrays.iter().any(is_of_slayer) {
        return Err(wrong(format!("'{tensor}' holds learned delays, but not of which layer"))
            .help("write the network as a model, whose projections have delays (docs/formats.md)"));
    }
    let axes = if role(tensor).is_some() { ", whose weights have 5 axes" } else { "" };
    Err(wrong(format!(
        "tensor '{tensor}' of shape {shape:?} is of no layer of SLAYER or lava-dl{axes}; a state dict of another tool \
         is no network, as it has no forward()"
    ))
    .help(format!(
        "read the network itself in Python, where net is the module that was saved and sample an input \
         of one timestep:\n    \
         import nsim, torch\n    \
         net.load_state_dict({})\n    \
         nsim.from_torch(net, sample).save(\"net.ron\")",
        load(path, key)
    )))
}

/// The layers in the order of the file.
fn layers(arrays: Vec<Array>) -> Result<Vec<Layer>> {
    let mut names: Vec<String> = Vec::new();
    let mut layers_by_name: BTreeMap<String, BTreeMap<Role, Array>> = BTreeMap::new();
    for array in arrays {
        let Some((layer, role)) = role(&array.key) else { continue };
        let layer = layer.to_string();
        if !layers_by_name.contains_key(&layer) {
            names.push(layer.clone());
        }
        if let Some(other) = layers_by_name.entry(layer).or_default().insert(role, array) {
            return Err(wrong(format!("'{}' is given twice, as it is and in two parts", other.key)));
        }
    }
    let mut layers = Vec::new();
    for name in names {
        let mut others = layers_by_name.remove(&name).unwrap_or_default();
        let Some(weight) = others.remove(&Role::Weight) else {
            let keys: Vec<&str> = others.values().map(|array| array.key.as_str()).collect();
            return Err(wrong(format!("'{name}' has no weights, only {}", keys.join(", "))));
        };
        layers.push(Layer { name, weight, others });
    }
    Ok(layers)
}

/// The weights of a layer as a matrix `[target][source]`, with its recurrent weights and decays.
fn matrix(layers: &[Layer], place: usize, options: &Options) -> Result<Matrix> {
    let layer = &layers[place];
    let (targets, numbers) = (layer.axes()[0], &layer.weight.numbers);
    check_dense(layers, place, options)?;
    let recurrent = match layer.others.get(&Role::Recurrent) {
        Some(array) if array.numbers.len() != targets * targets => {
            return Err(wrong(format!(
                "'{}' has shape {:?}, but its layer has {targets} units, so a square matrix is expected",
                array.key, array.shape
            )));
        }
        found => found.map(|array| array.numbers.clone()),
    };
    let decays = match (decay(layer, Role::CurrentDecay, targets)?, decay(layer, Role::VoltageDecay, targets)?) {
        (Some(du), Some(dv)) => Some((du, dv)),
        (None, None) => None,
        _ => return Err(wrong(format!("'{}' has only one of current_decay and voltage_decay", layer.name))),
    };
    let (name, sources, weights) = (population_name(&layer.name), numbers.len() / targets, numbers.clone());
    Ok(Matrix { name, targets, sources, weights, recurrent, decays })
}

/// Decays of a layer in 4096ths, as a core has them.
fn decay(layer: &Layer, role: Role, targets: usize) -> Result<Option<Vec<f64>>> {
    match layer.others.get(&role).map(|array| &array.numbers) {
        None => Ok(None),
        Some(numbers) if numbers.len() == 1 || numbers.len() == targets => {
            Ok(Some(numbers.iter().map(|x| x.round_ties_even().clamp(0.0, 4096.0)).collect()))
        }
        Some(numbers) => Err(wrong(format!("'{}' has {} decays for {targets} units", layer.name, numbers.len()))),
    }
}

/// Whether decays of the file differ from those of `--neuron`.
fn differ((du, dv): &(Vec<f64>, Vec<f64>), given_du: Option<f64>, given_dv: Option<f64>) -> bool {
    let mut pairs = [(du, given_du), (dv, given_dv)].into_iter();
    pairs.any(|(decays, given)| given.is_some_and(|given| decays.iter().any(|&d| d != given)))
}

/// Refuses the kernel of a convolution. A kernel that covers all of its input is a dense layer;
/// each kernel is then one unit of the next layer's input.
fn check_dense(layers: &[Layer], place: usize, options: &Options) -> Result<()> {
    let (layer, axes) = (&layers[place], layers[place].axes());
    let (key, shape, kernel) = (&layer.weight.key, &layer.weight.shape, &axes[1..]);
    let kernel_shape = kernel.iter().map(usize::to_string).collect::<Vec<_>>().join(",");
    let covers = match (place.checked_sub(1), layers.get(place + 1), &options.input_shape) {
        _ if axes.len() == 2 => true,
        (Some(before), _, _) => layers[before].axes()[0] * axes[0] == layer.weight.numbers.len(),
        (None, _, Some(input)) => input.iter().map(|&axis| axis as usize).eq(kernel.iter().copied()),
        (None, Some(next), None) => next.axes().len() == 2 && next.axes()[1] == axes[0],
        (None, None, None) => {
            let message =
                format!("'{key}' has shape {shape:?}: it is a convolution, or a dense layer on an image {kernel:?}");
            return Err(
                wrong_option(message).help(format!("if it is a dense layer, give --input-shape {kernel_shape}"))
            );
        }
    };
    if covers {
        return Ok(());
    }
    Err(Diagnostic::new(
        "import.unsupported",
        format!("'{key}' has shape {shape:?}: it is the kernel of a convolution"),
    )
    .help(format!(
        "a state dict does not contain the stride and padding of a convolution: export it with lava-dl as .net; a \
         dense layer on an image {kernel:?} is read with --input-shape {kernel_shape}"
    )))
}
