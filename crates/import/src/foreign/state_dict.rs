//! State dicts of PyTorch: layers and neurons of lava-dl, SLAYER, snnTorch and Norse, identified by
//! the names of their tensors.
//!
//! Input: the tensors of a checkpoint, in the order of the file, and a description of the neurons
//! where the file has none. Output: a model. The table [`ROLES`] has the meaning of each name; an
//! unknown tensor is refused by its name, since the network may depend on it. Weights that are
//! stored as length and direction (weight norm, in both of torch's namings) are multiplied out.
//! Integer networks (lava-dl, SLAYER) are built from matrices ([`super::slayer`]). Real-valued
//! networks (snnTorch, Norse) first become a NIR graph, with the equations of their exporters,
//! which [`super::nir`] reads. So decays, biases and resets have a single reader.
//!
//! Errors: `import.state-dict` for the content of the file, `import.option` for missing or
//! contradictory descriptions of the neurons.

use std::collections::BTreeMap;

use super::conventions::{Reading, ResetMode};
use super::hdf5::{Group, Numbers};
use super::imported::{Imported, LayerWeights, Options, population_name, shortest_decimal, wrong_option};
use super::nir::export::{NO_DECAY_TAU, nir_graph, node};
use super::slayer::{self, LAVA_SCALE, Matrix, NeuronKind};
use super::{nir, torch};
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::warning::Warning;

/// The role of a tensor in its module.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Role {
    /// `[target][source..]`.
    Weight,
    Bias,
    /// `[target][target]`, from the layer to itself.
    Recurrent,
    RecurrentBias,
    /// One weight from each neuron to itself.
    OneToOne,
    /// lava-dl, in 4096ths.
    CurrentDecay,
    VoltageDecay,
    /// snnTorch: share of the current that a step keeps.
    Alpha,
    /// snnTorch: share of the voltage that a step keeps.
    Beta,
    Threshold,
    /// snnTorch: 0 subtracts, 1 clears, 2 does nothing.
    Reset,
    GradedSpikes,
}

/// Roles by the end of a tensor's name; the first match is used, and the rest of the name is the
/// module.
const ROLES: [(&str, Role); 17] = [
    ("recurrent_synapse.weight", Role::Recurrent),
    ("recurrent.weight", Role::Recurrent),
    ("recurrent_weights", Role::Recurrent),
    ("recurrent.bias", Role::RecurrentBias),
    ("recurrent.V", Role::OneToOne),
    ("V", Role::OneToOne),
    ("synapse.weight", Role::Weight),
    ("input_weights", Role::Weight),
    ("weight", Role::Weight),
    ("bias", Role::Bias),
    ("neuron.current_decay", Role::CurrentDecay),
    ("neuron.voltage_decay", Role::VoltageDecay),
    ("alpha", Role::Alpha),
    ("beta", Role::Beta),
    ("threshold", Role::Threshold),
    ("reset_mechanism_val", Role::Reset),
    ("graded_spikes_factor", Role::GradedSpikes),
];

/// Names without effect on inference: kernels of training, states left from the last sample.
const WITHOUT_MEANING: [&str; 8] =
    ["srmKernel", "refKernel", "mem", "syn", "spk", "current_state", "voltage_state", "num_batches_tracked"];
/// Parts of a checkpoint that belong to the training.
const TRAINING_PARTS: [&str; 4] = ["optimizer", "optimizer_state_dict", "optim", "scheduler"];

/// Help: the command that reads a whole network of snnTorch.
const FROM_TORCH: &str = "save a network of snnTorch with nsim.from_torch(net, sample).save(\"net.ron\") in Python";
/// Tensors of snnTorch 1.0.0 neurons that are not read, and the neurons.
const UNSUPPORTED_TENSORS: [(&str, &str); 4] =
    [("time_step", "Lapicque"), ("R", "Lapicque"), ("C", "Lapicque"), ("tau", "StateLeaky or LinearLeaky")];

/// A tensor.
struct Array {
    key: String,
    shape: Vec<usize>,
    numbers: Vec<f64>,
    /// Whether the numbers have single precision.
    single: bool,
}

/// Tensors with one prefix of their names.
#[derive(Default)]
struct Module {
    name: String,
    arrays: BTreeMap<Role, Array>,
}

impl Module {
    fn numbers(&self, role: Role) -> Option<&[f64]> {
        self.arrays.get(&role).map(|array| array.numbers.as_slice())
    }

    fn has(&self, role: Role) -> bool {
        self.arrays.contains_key(&role)
    }
}

fn wrong(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("import.state-dict", message)
}

/// The note about the assumed order of layers, and about facts that a state dict lacks.
fn in_order(layers: &str, lacking: &str) -> String {
    format!(
        "layers in the order of definition: {layers}; a state dict lacks the sums and functions of forward(){lacking}"
    )
}

/// Reads a checkpoint.
pub fn read(bytes: Vec<u8>, name: &str, options: &Options) -> Result<Imported> {
    let mut checkpoint = torch::open(bytes)?;
    let (modules, ignored) = modules(arrays(&mut checkpoint)?)?;
    let mut notes = Vec::new();
    if !ignored.is_empty() {
        notes.push(format!("not used: {}", ignored.iter().take(12).cloned().collect::<Vec<_>>().join(", ")));
    }
    if modules.iter().any(|module| module.has(Role::Beta)) {
        if options.neuron.is_some() {
            let message = "the file has the parameters of its neurons (beta, threshold)";
            return Err(wrong_option(message).help("leave --neuron out"));
        }
        return build_real_network("PyTorch state dict of snnTorch", name, modules, None, notes, options);
    }
    let (neuron, described) = slayer::read_neuron(options)?;
    notes.extend(described);
    match neuron.kind {
        NeuronKind::Leaky { .. } => {
            build_real_network("PyTorch state dict", name, modules, Some(&neuron), notes, options)
        }
        NeuronKind::Lif { .. } => {
            build_real_network("PyTorch state dict of Norse", name, modules, Some(&neuron), notes, options)
        }
        _ => build_integer_network(name, &modules, neuron, notes, options),
    }
}

/// All tensors; weights that are stored as length and direction are multiplied out.
fn arrays(checkpoint: &mut torch::Checkpoint) -> Result<Vec<Array>> {
    // (length, direction) of `torch.nn.utils.weight_norm`, and of its replacement.
    const NORMED: [(&str, &str); 2] =
        [("_g", "_v"), ("parametrizations.weight.original0", "parametrizations.weight.original1")];
    let entries: Vec<(String, Vec<usize>)> =
        checkpoint.entries().map(|(key, shape)| (key.to_string(), shape.to_vec())).collect();
    let shape_of = |key: &str| entries.iter().find(|(other, _)| other == key).map(|(_, shape)| shape.clone());
    let mut arrays = Vec::new();
    for (key, shape) in &entries {
        let part = |end: &str| key.strip_suffix(end).map(str::to_string);
        let lengths = NORMED.iter().find_map(|(length, direction)| {
            let base = part(direction).filter(|base| *direction != "_v" || base.ends_with("weight"))?;
            let whole = if *direction == "_v" { base.clone() } else { format!("{base}weight") };
            Some((format!("{base}{length}"), whole))
        });
        let is_length = NORMED.iter().any(|(length, direction)| {
            part(length).is_some_and(|base| shape_of(&format!("{base}{direction}")).is_some())
        });
        if is_length {
            continue;
        }
        let (numbers, single) =
            (checkpoint.tensor(key)?, checkpoint.dtype(key).is_some_and(|dtype| dtype.ends_with("f4")));
        let Some((length, whole)) = lengths else {
            arrays.push(Array { key: key.clone(), shape: shape.clone(), numbers, single });
            continue;
        };
        let Some(axes) = shape_of(&length) else {
            return Err(wrong(format!("'{key}' is a direction of weights, but its lengths '{length}' are missing")));
        };
        let lengths = checkpoint.tensor(&length)?;
        let numbers = weight_norm(&numbers, shape, &lengths, &axes).ok_or_else(|| {
            wrong(format!(
                "'{length}' has shape {axes:?}, '{key}' has shape {shape:?}: lengths and directions do not match"
            ))
        })?;
        arrays.push(Array { key: whole, shape: shape.clone(), numbers, single: false });
    }
    Ok(arrays)
}

/// `g v / |v|`, where the norm is over all axes that the lengths lack.
fn weight_norm(directions: &[f64], shape: &[usize], lengths: &[f64], axes: &[usize]) -> Option<Vec<f64>> {
    let fits = axes.is_empty() || (axes.len() == shape.len() && axes.iter().zip(shape).all(|(g, v)| *g == 1 || g == v));
    if !fits || lengths.is_empty() {
        return None;
    }
    let group = |mut index: usize| {
        let (mut at, mut step) = (0, 1);
        for (k, &side) in shape.iter().enumerate().rev() {
            let axis = axes.get(k).copied().unwrap_or(1);
            at += if axis == 1 { 0 } else { index % side * step };
            step *= axis;
            index /= side;
        }
        at
    };
    let mut squares = vec![0.0f64; lengths.len()];
    for (index, v) in directions.iter().enumerate() {
        squares[group(index)] += v * v;
    }
    let scaled = |(index, v): (usize, &f64)| {
        let norm = squares[group(index)].sqrt();
        if norm > 0.0 { lengths[group(index)] * v / norm } else { 0.0 }
    };
    Some(directions.iter().enumerate().map(scaled).collect())
}

/// Tensors grouped by module, in the order of the file, and the names of ignored tensors.
fn modules(arrays: Vec<Array>) -> Result<(Vec<Module>, Vec<String>)> {
    let mut modules: Vec<Module> = Vec::new();
    let mut ignored = Vec::new();
    let neurons: Vec<String> =
        arrays.iter().filter_map(|array| Some(array.key.strip_suffix("beta")?.to_string())).collect();
    for array in arrays {
        let last = array.key.rsplit('.').next().unwrap_or_default();
        let of_training = array.key.split('.').any(|part| TRAINING_PARTS.contains(&part));
        // Layers without delays may store delays of 0.
        let undelayed = last == "delay" && array.numbers.iter().all(|&delay| delay < 1.0);
        if of_training || undelayed || WITHOUT_MEANING.contains(&last) {
            ignored.push(array.key);
            continue;
        }
        if last.starts_with("running_") {
            return Err(wrong(format!("'{}' belongs to a batch normalisation", array.key)).help(format!(
                "fold its scale and shift into the weights and biases of the layer before it, or {FROM_TORCH}"
            )));
        }
        if last == "delay" {
            return Err(wrong(format!("'{}' holds learned delays", array.key))
                .help("export the network with lava-dl as .net, which names the delayed layers"));
        }
        let role = ROLES.iter().find_map(|(end, role)| {
            let module = array.key.strip_suffix(end)?;
            (module.is_empty() || module.ends_with('.')).then(|| (module.trim_end_matches('.').to_string(), *role))
        });
        let of_neuron = neurons.iter().any(|module| array.key.strip_prefix(module.as_str()) == Some(last));
        if role.is_none() && of_neuron {
            let kind = UNSUPPORTED_TENSORS.iter().find(|(name, _)| *name == last).map(|(_, kind)| format!(" ({kind})"));
            let (key, kind) = (&array.key, kind.unwrap_or_default());
            let message =
                format!("'{key}' belongs to another neuron{kind}; supported are Leaky, Synaptic, RLeaky and RSynaptic");
            return Err(wrong(message).help(format!(
                "do not delete this tensor, as the neuron would then be read as another kind: {FROM_TORCH}"
            )));
        }
        let Some((name, role)) = role else {
            return Err(wrong(format!("tensor '{}' {:?} is not supported", array.key, array.shape)).help(
                "supported are the layers and neurons of lava-dl, SLAYER, snnTorch and Norse (docs/import.md); if the \
                 network does not depend on the tensor, remove it before saving: del state['NAME']",
            ));
        };
        let index = modules.iter().position(|module| module.name == name).unwrap_or_else(|| {
            modules.push(Module { name, ..Module::default() });
            modules.len() - 1
        });
        let key = array.key.clone();
        if modules[index].arrays.insert(role, array).is_some() {
            return Err(wrong(format!("'{key}' is given twice, as weights and as length and direction")));
        }
    }
    Ok((modules, ignored))
}

/// The weights of each layer as matrices `[target][source]`, in the order of the file.
fn matrices(modules: &[Module], options: &Options) -> Result<Vec<(usize, Matrix)>> {
    let shape_of = |module: &Module| {
        module.arrays.get(&Role::Weight).map(|array| {
            let mut axes = array.shape.clone();
            while axes.len() > 2 && axes.last() == Some(&1) {
                axes.pop();
            }
            axes
        })
    };
    let layers: Vec<(usize, Vec<usize>)> =
        modules.iter().enumerate().filter_map(|(index, module)| Some((index, shape_of(module)?))).collect();
    let mut matrices: Vec<(usize, Matrix)> = Vec::new();
    for (place, (index, axes)) in layers.iter().enumerate() {
        let module = &modules[*index];
        let array = &module.arrays[&Role::Weight];
        let (&[targets, ..], true) = (axes.as_slice(), axes.len() >= 2 && !array.numbers.is_empty()) else {
            return Err(wrong(format!("'{}' of shape {:?} is not the weight of a layer", array.key, array.shape)).help(
                "if it belongs to a normalisation, fold it into the weights before it and save the network without it",
            ));
        };
        let sources = array.numbers.len() / targets;
        // A kernel that covers all of its input is a dense layer; each kernel is then one unit of
        // the next layer's input.
        let kernel = axes.get(1..).unwrap_or_default();
        let before = (place > 0).then(|| layers[place - 1].1[0]);
        let covers = match (before, layers.get(place + 1)) {
            _ if axes.len() == 2 => true,
            (Some(before), _) => before == sources,
            (None, next) => match (&options.input_shape, next) {
                (Some(given), _) => given.iter().map(|&axis| axis as usize).eq(kernel.iter().copied()),
                (None, Some((_, next))) => next.len() == 2 && next[1] == targets,
                (None, None) => {
                    let (key, shape) = (&array.key, &array.shape);
                    let message = format!(
                        "'{key}' has shape {shape:?}: it is a convolution, or a dense layer on an image {kernel:?}"
                    );
                    return Err(wrong_option(message)
                        .help(format!("if it is a dense layer, give --input-shape {}", axes_text(kernel))));
                }
            },
        };
        if !covers {
            let message = format!("'{}' has shape {:?}: it is the kernel of a convolution", array.key, array.shape);
            let advice = "a state dict does not contain the stride and padding of a convolution: ";
            return Err(Diagnostic::new("import.unsupported", message).help(format!(
                "{advice}{FROM_TORCH}, or export it as .nir, or with lava-dl as .net; a dense layer on an image \
                 {kernel:?} is read with --input-shape {}",
                axes_text(kernel)
            )));
        }
        let square = |role: Role| match module.arrays.get(&role) {
            Some(array) if array.numbers.len() != targets * targets => Err(wrong(format!(
                "'{}' has shape {:?}, but its layer has {targets} units, so a square matrix is expected",
                array.key, array.shape
            ))),
            found => Ok(found.map(|array| array.numbers.clone())),
        };
        let decay = |role: Role| match module.numbers(role) {
            None => Ok(None),
            Some(numbers) if numbers.len() == 1 || numbers.len() == targets => {
                Ok(Some(numbers.iter().map(|x| x.round_ties_even().clamp(0.0, 4096.0)).collect::<Vec<_>>()))
            }
            Some(numbers) => Err(wrong(format!("'{}' has {} decays for {targets} units", module.name, numbers.len()))),
        };
        let decays = match (decay(Role::CurrentDecay)?, decay(Role::VoltageDecay)?) {
            (Some(du), Some(dv)) => Some((du, dv)),
            (None, None) => None,
            _ => return Err(wrong(format!("'{}' has only one of current_decay and voltage_decay", module.name))),
        };
        let (weights, recurrent) = (array.numbers.clone(), square(Role::Recurrent)?);
        let name = population_name(&module.name);
        matrices.push((*index, Matrix { name, targets, sources, weights, recurrent, decays }));
    }
    if matrices.is_empty() {
        return Err(wrong("no tensor is the '.weight' of a dense layer"));
    }
    Ok(matrices)
}

fn axes_text(axes: &[usize]) -> String {
    axes.iter().map(usize::to_string).collect::<Vec<_>>().join(",")
}

/// Builds a network of lava-dl or SLAYER.
fn build_integer_network(
    name: &str,
    modules: &[Module],
    mut neuron: slayer::Neuron,
    mut notes: Vec<String>,
    options: &Options,
) -> Result<Imported> {
    options.refuse_unused("layers of SLAYER and lava-dl", &["--neuron", "--input-shape"])?;
    let lava = modules.iter().any(|module| {
        module.has(Role::CurrentDecay) || module.arrays.values().any(|array| array.key.contains("synapse."))
    });
    for module in modules {
        for (role, array) in &module.arrays {
            let unused = match role {
                Role::Bias | Role::RecurrentBias => array.numbers.iter().any(|&b| b != 0.0),
                Role::Weight | Role::Recurrent | Role::CurrentDecay | Role::VoltageDecay => !module.has(Role::Weight),
                _ => true,
            };
            if unused {
                let message = format!("layers of SLAYER and lava-dl do not have '{}'", array.key);
                return Err(wrong(message).help(
                    "biases and neurons of real numbers are read with a neuron of the type Leaky, Synaptic or LIF in \
                     --neuron",
                ));
            }
        }
    }
    let (_, matrices): (Vec<usize>, Vec<Matrix>) = matrices(modules, options)?.into_iter().unzip();
    let kind = if lava { "PyTorch state dict of lava-dl" } else { "PyTorch state dict of SLAYER" };
    if let (true, NeuronKind::Loihi { scale, du, dv, .. }) = (lava, &mut neuron.kind) {
        *scale = LAVA_SCALE;
        let of_file = matrices.iter().filter_map(|matrix| matrix.decays.as_ref());
        let differs =
            |given: Option<f64>, decays: &[f64]| given.is_some_and(|given| decays.iter().any(|&d| d != given));
        if of_file.clone().any(|decays| differs(*du, &decays.0) || differs(*dv, &decays.1)) {
            notes.push("the decays come from the weights' file, not from --neuron".to_string());
        }
    }
    let names: Vec<&str> = matrices.iter().map(|matrix| matrix.name.as_str()).collect();
    let assumed = in_order(&names.join(" -> "), "");
    let mut imported = slayer::build(kind, name, matrices, &neuron, notes, options)?;
    imported.warn(Warning::of_network("layer-order", assumed));
    Ok(imported)
}

/// Discrete parameters of a layer's neurons, one for all or one for each.
#[derive(Default)]
struct RealNeuron {
    name: String,
    /// Share of the current that decays in a step; none for a current without memory.
    synapse: Option<Vec<f64>>,
    /// Share of the voltage that decays in a step.
    membrane: Vec<f64>,
    /// Factor of a step's current in the voltage; none for 1.
    gain: Option<Vec<f64>>,
    leak: f64,
    threshold: Vec<f64>,
}

/// Builds a network of snnTorch or Norse from a NIR graph; `neuron` describes the neurons where the
/// file does not.
fn build_real_network(
    kind: &'static str,
    name: &str,
    mut modules: Vec<Module>,
    neuron: Option<&slayer::Neuron>,
    mut notes: Vec<String>,
    options: &Options,
) -> Result<Imported> {
    options.refuse_unused("a state dict", &["--neuron", "--reset", "--input-shape"])?;
    for array in modules.iter_mut().flat_map(|module| module.arrays.values_mut()).filter(|array| array.single) {
        array.numbers.iter_mut().for_each(|number| *number = shortest_decimal(*number));
    }
    let modules = &modules[..];
    let layers = matrices(modules, options)?;
    let dt_ms = options.reading.dt_ms.or(neuron.and_then(|neuron| neuron.dt_ms)).unwrap_or(1.0);
    let dt = dt_ms / 1e3;
    // Modules of neurons, in the order of the file.
    let neurons: Vec<&Module> = modules.iter().filter(|module| module.has(Role::Beta)).collect();
    if neuron.is_none() && neurons.len() != layers.len() {
        let weights: Vec<&str> = layers.iter().map(|(index, _)| modules[*index].name.as_str()).collect();
        let neurons: Vec<&str> = neurons.iter().map(|module| module.name.as_str()).collect();
        let (weights, neurons) = (weights.join(", "), neurons.join(", "));
        return Err(wrong(format!("the numbers of weight layers ({weights}) and neuron layers ({neurons}) differ"))
            .help(format!(
                "layers may share neurons, or have none: {FROM_TORCH}, which reads the order of the layers"
            )));
    }
    let mut reset: Option<(bool, String)> = None;
    let mut own_reset = |subtracts: bool, whose: &str| match &reset {
        Some((before, first)) if *before != subtracts => {
            Err(wrong(format!("'{first}' and '{whose}' have different resets, one by subtraction and one to zero"))
                .help("train all layers with the same reset_mechanism"))
        }
        _ => {
            reset = Some((subtracts, whose.to_string()));
            Ok(())
        }
    };
    let mut graph = Graph::default();
    let shape: Vec<i64> =
        slayer::input_shape(options, layers[0].1.sources)?.into_iter().map(|axis| axis as i64).collect();
    let flat = shape.len() == 1;
    let mut last = graph.node("input", node("Input").with("shape", Numbers::i64(&[shape.len()], &shape)));
    if !flat {
        last = graph.follow(&last, "flatten", node("Flatten"));
    }
    let mut lines = Vec::new();
    // Names of the layers in order, for the note.
    let mut chain = Vec::new();
    // Layers of snnTorch that stay at zero in the step after a spike.
    let mut held = Vec::new();
    for (place, (index, matrix)) in layers.iter().enumerate() {
        let layer = &modules[*index];
        let described = match neuron.map(|neuron| &neuron.kind) {
            None => {
                let module = neurons[place];
                let (described, subtracts) = snntorch(module)?;
                if let Some(subtracts) = subtracts {
                    own_reset(subtracts, &module.name)?;
                }
                described
            }
            Some(&NeuronKind::Leaky { alpha, beta, threshold, subtracts }) => {
                own_reset(subtracts, &layer.name)?;
                RealNeuron {
                    name: layer.name.clone(),
                    synapse: alpha.map(|alpha| vec![1.0 - alpha]),
                    membrane: vec![1.0 - beta],
                    threshold: vec![threshold],
                    ..RealNeuron::default()
                }
            }
            Some(&NeuronKind::Lif { tau_syn_inv, tau_mem_inv, v_leak, v_th }) => {
                own_reset(false, &layer.name)?;
                RealNeuron {
                    name: layer.name.clone(),
                    synapse: Some(vec![dt * tau_syn_inv]),
                    membrane: vec![dt * tau_mem_inv],
                    gain: Some(vec![dt * tau_mem_inv]),
                    leak: v_leak,
                    threshold: vec![v_th],
                }
            }
            Some(_) => return Err(wrong("neurons of integers")),
        };
        let weights = weights_node(&matrix.weights, (matrix.targets, matrix.sources), layer, Role::Bias)?;
        last = graph.follow(&last, &format!("{}.weight", layer.name), weights);
        let population = graph.node(&described.name.clone(), neuron_node(&described, matrix.targets, dt)?);
        graph.edge(&last, &population);
        // Recurrent weights are in the module of the neurons in snnTorch, of the weights in Norse.
        let owner = if neuron.is_none() { neurons[place] } else { layer };
        let mut own = Vec::new();
        if let Some(array) = owner.arrays.get(&Role::Recurrent) {
            if array.numbers.len() != matrix.targets * matrix.targets {
                return Err(wrong(format!(
                    "'{}' has shape {:?}, but its layer has {} units, so a square matrix is expected",
                    array.key, array.shape, matrix.targets
                )));
            }
            let size = (matrix.targets, matrix.targets);
            own.push(weights_node(&array.numbers, size, owner, Role::RecurrentBias)?);
        }
        if let Some(array) = owner.arrays.get(&Role::OneToOne) {
            let scale = each(&array.key, &array.numbers, matrix.targets)?;
            own.push(node("Scale").with("scale", Numbers::f64(&[matrix.targets], &scale)));
        }
        let recurrent = !own.is_empty();
        for node in own {
            let back = graph.follow(&population, &format!("{}.recurrent", described.name), node);
            graph.edge(&back, &population);
        }
        let norse = matches!(neuron.map(|neuron| &neuron.kind), Some(NeuronKind::Lif { .. }));
        chain.push(layer.name.clone());
        if neuron.is_none() {
            let (back, kind) = (["", "R"][usize::from(recurrent)], described.synapse.as_ref().map(|_| "Synaptic"));
            chain.push(format!("{} ({back}{})", described.name, kind.unwrap_or("Leaky")));
        }
        if !norse && (described.synapse.is_some() || recurrent) {
            held.push(population_name(&population));
        }
        last = population;
        let shape = [matrix.targets, matrix.sources];
        lines.push(LayerWeights::new(&described.name, &shape, 1.0, &matrix.weights, &matrix.weights));
    }
    graph.follow(&last, "output", node("Output"));
    check_used(modules, &layers, &neurons)?;
    let reset = chosen_reset(reset, options)?;
    let lacking = match neuron.map(|neuron| &neuron.kind) {
        None => ", and inhibition, reset_delay and a mechanism set after construction of neurons",
        Some(NeuronKind::Lif { .. }) => ", and the classes of its neurons: all are read as LIFCell",
        Some(_) => "",
    };
    let assumed =
        format!("{}; nsim.from_torch(module, sample) in Python reads them", in_order(&chain.join(" -> "), lacking));
    notes.push(format!("timestep {dt_ms} ms; weights stay real numbers, which mapping rounds"));
    let options =
        Options { reading: Reading { dt_ms: Some(dt_ms), reset, tool: None }, known: true, ..options.clone() };
    let root = Group::default().with("node", nir_graph(graph.nodes, graph.edges));
    held.retain(|_| reset == Some(ResetMode::Zero));
    let Imported { mut model, notes: read, .. } = nir::read(&root, name, &options)?.with_refractory(&held);
    notes.extend(read.into_iter().filter(|note| !note.starts_with("timestep ")));
    model.provenance = Some(format!("imported from a {kind}; {}", notes.join("; ")));
    let mut imported = Imported { kind, model, notes, layers: lines, warnings: Vec::new(), reset };
    imported.warn(Warning::of_network("layer-order", assumed));
    Ok(imported)
}

/// The reset of the file or of an option, which must not contradict each other.
fn chosen_reset(of_file: Option<(bool, String)>, options: &Options) -> Result<Option<ResetMode>> {
    match (of_file, options.reading.reset) {
        (None, given) => Ok(given),
        (Some((true, _)), None) => Ok(Some(ResetMode::SubtractLater)),
        (Some((false, _)), None) => Ok(Some(ResetMode::Zero)),
        (Some((true, name)), Some(ResetMode::Zero)) => {
            let message = format!("'{name}' subtracts its threshold, which --reset zero contradicts");
            Err(wrong_option(message)
                .help("leave --reset out; nsim convert changes such neurons to a reset to zero and measures the loss"))
        }
        (Some((false, name)), Some(ResetMode::Subtract | ResetMode::SubtractLater)) => {
            Err(wrong_option(format!("'{name}' resets to zero, which --reset contradicts")).help("leave --reset out"))
        }
        (Some(_), given) => Ok(given),
    }
}

/// Refuses tensors that no layer uses.
fn check_used(modules: &[Module], layers: &[(usize, Matrix)], neurons: &[&Module]) -> Result<()> {
    for (index, module) in modules.iter().enumerate() {
        let is_layer = layers.iter().any(|(layer, _)| *layer == index);
        let is_neuron = neurons.iter().any(|neuron| neuron.name == module.name);
        for (role, array) in &module.arrays {
            let used = match role {
                Role::Weight => true,
                Role::Bias => is_layer,
                Role::Recurrent | Role::RecurrentBias | Role::OneToOne if neurons.is_empty() => is_layer,
                Role::Recurrent | Role::RecurrentBias | Role::OneToOne => is_neuron,
                Role::CurrentDecay | Role::VoltageDecay => false,
                Role::Alpha | Role::Beta | Role::Threshold | Role::Reset | Role::GradedSpikes => is_neuron,
            };
            if !used {
                return Err(wrong(format!("'{}' belongs to no layer of this network", array.key))
                    .help("if the network does not depend on it, remove it before saving: del state['NAME']"));
            }
        }
    }
    Ok(())
}

/// Expands one number for all units, or one for each, to one for each.
fn each(name: &str, numbers: &[f64], units: usize) -> Result<Vec<f64>> {
    match numbers.len() {
        1 => Ok(vec![numbers[0]; units]),
        n if n == units => Ok(numbers.to_vec()),
        n => Err(wrong(format!("'{name}' has {n} numbers for {units} units"))),
    }
}

/// The neurons of a module of snnTorch, and whether a spike subtracts the threshold, if the file
/// has it.
fn snntorch(module: &Module) -> Result<(RealNeuron, Option<bool>)> {
    let get = |role: Role| module.numbers(role).filter(|numbers| !numbers.is_empty());
    let lost = |what: &str| wrong(format!("'{}': '{what}' is missing", module.name));
    // snnTorch clamps both shares to 0..=1.
    let taken = |shares: &[f64]| shares.iter().map(|x| 1.0 - x.clamp(0.0, 1.0)).collect::<Vec<_>>();
    let membrane = taken(get(Role::Beta).ok_or_else(|| lost("beta"))?);
    let threshold = get(Role::Threshold).ok_or_else(|| lost("threshold"))?.to_vec();
    if get(Role::GradedSpikes).is_some_and(|factor| factor.iter().any(|&factor| factor != 1.0)) {
        return Err(wrong(format!("'{}' sends graded spikes", module.name))
            .help("a Loihi 1 core does not support graded spikes: train with graded_spikes_factor 1"));
    }
    let subtracts = match get(Role::Reset) {
        None => None,
        Some(&[0.0]) => Some(true),
        Some(&[1.0]) => Some(false),
        Some(other) => {
            return Err(wrong(format!("'{}' has reset_mechanism_val {other:?}", module.name))
                .help("0 (subtract) and 1 (zero) are supported; cores do not support a neuron without a reset"));
        }
    };
    let alone = !module.has(Role::Recurrent) && !module.has(Role::OneToOne);
    if let (Some(alpha), Some(beta), true) = (get(Role::Alpha), get(Role::Beta), alone)
        && alpha.iter().cycle().zip(beta.iter().cycle()).take(alpha.len().max(beta.len())).all(|(a, b)| a > b)
    {
        let message = format!(
            "'{}' is a Synaptic or an Alpha of snnTorch: their tensors have the same names, and its alpha is above its \
             beta, as Alpha requires",
            module.name
        );
        return Err(wrong(message).help(format!("{FROM_TORCH}, which reads the classes")));
    }
    let (name, synapse) = (module.name.clone(), get(Role::Alpha).map(taken));
    Ok((RealNeuron { name, synapse, membrane, threshold, ..RealNeuron::default() }, subtracts))
}

/// The node of a layer's neurons: NIR's equations with the shares that decay in a step.
fn neuron_node(neuron: &RealNeuron, units: usize, dt: f64) -> Result<Group> {
    let spread = |numbers: &[f64]| each(&neuron.name, numbers, units);
    let array = |numbers: &[f64]| Numbers::f64(&[units], numbers);
    let steps = |shares: &[f64]| -> Vec<f64> {
        shares.iter().map(|&share| if share > 0.0 { 1.0 / share } else { NO_DECAY_TAU }).collect()
    };
    let seconds = |steps: &[f64]| array(&steps.iter().map(|steps| steps * dt).collect::<Vec<_>>());
    let membrane = steps(&spread(&neuron.membrane)?);
    // In NIR the factor of a current is dt / tau r.
    let r: Vec<f64> = match &neuron.gain {
        None => membrane.clone(),
        Some(gain) => spread(gain)?.iter().zip(&membrane).map(|(gain, steps)| gain * steps).collect(),
    };
    let common = |group: Group| -> Result<Group> {
        Ok(group
            .with("r", array(&r))
            .with("v_leak", array(&vec![neuron.leak; units]))
            .with("v_threshold", array(&spread(&neuron.threshold)?)))
    };
    match &neuron.synapse {
        None => common(node("LIF").with("tau", seconds(&membrane))),
        Some(synapse) => {
            let synapse = steps(&spread(synapse)?);
            let currents = node("CubaLIF").with("tau_syn", seconds(&synapse)).with("w_in", array(&synapse));
            common(currents.with("tau_mem", seconds(&membrane)))
        }
    }
}

/// The node of weights and their bias, if any.
fn weights_node(weights: &[f64], (targets, sources): (usize, usize), module: &Module, bias: Role) -> Result<Group> {
    let weights = Numbers::f64(&[targets, sources], weights);
    let Some(array) = module.arrays.get(&bias) else { return Ok(node("Linear").with("weight", weights)) };
    let bias = Numbers::f64(&[targets], &each(&array.key, &array.numbers, targets)?);
    Ok(node("Affine").with("weight", weights).with("bias", bias))
}

/// A NIR graph under construction.
#[derive(Default)]
struct Graph {
    nodes: Group,
    edges: Vec<(String, String)>,
}

impl Graph {
    /// Adds a node; returns its unique name.
    fn node(&mut self, wanted: &str, node: Group) -> String {
        let mut name = wanted.to_string();
        while self.nodes.items.contains_key(&name) {
            name.push('_');
        }
        self.nodes.insert(&name, node);
        name
    }

    fn edge(&mut self, from: &str, to: &str) {
        self.edges.push((from.to_string(), to.to_string()));
    }

    /// Adds a node and an edge to it; returns its name.
    fn follow(&mut self, after: &str, name: &str, node: Group) -> String {
        let name = self.node(name, node);
        self.edge(after, &name);
        name
    }
}
