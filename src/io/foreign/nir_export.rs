//! A model as a NIR file, and back without loss.
//!
//! Input: a model. Output: the tree of a `.nir` file that any tool of NIR reads: `CubaLIF` neurons with time
//! constants `4096 dt / du` in seconds, weights, thresholds and biases in units of the register divided by 64 for models in
//! integers and in their own units for models in real numbers, `w_in` and `r` such that a weight counts 1. What NIR has no
//! word for (weight exponents, refractory periods, clips, resets, semantics) stands in the graph's metadata, as the whole
//! text of the model and its arrays. [`restore`] takes the model from there, provided that exporting it again gives the
//! file that it was found in: a file that somebody changed is read like any other.

use super::hdf5::{Group, Item, Numbers};
use crate::base::diagnostic::{Diagnostic, Result, SourceText};
use crate::desc::network::{ArrayRef, Network, NetworkFile};
use crate::desc::neurons::NeuronKind;
use crate::desc::tensor::{self, Tensor};
use crate::io::model_builder::{ModelBuilder, Parameter, PopulationBuilder, ProjectionBuilder, ProjectionKind};

/// The version of NIR whose layout is written.
const VERSION: &str = "1.0.8";
/// The key of the model's text in the metadata.
const TEXT: &str = "nsim_model";
/// What the text calls the file of its arrays.
const ARRAYS: &str = "arrays";
/// What a decay of zero is written as: a time constant at which `4096 dt / tau` is 0 though `dt / tau` is not.
const ENDLESS: f64 = 4_503_599_627_370_496.0;
/// The most numbers that a list of synapses may take as a matrix.
const MOST_MATRIX: u64 = 1 << 24;

fn unsupported(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("export.unsupported", message)
}

/// The tree of a file, and what other tools will not see of the model.
///
/// # Errors
/// `export.unsupported` for what has no form in NIR: spike response neurons, lists of synapses beyond 2^24 places.
pub fn export(model: &ModelBuilder) -> Result<(Group, Vec<String>)> {
    let mut graph =
        Graph { nodes: Group::default(), edges: Vec::new(), notes: Vec::new(), dt: model.timestep_ms / 1e3 };
    for population in &model.populations {
        graph.population(population)?;
    }
    for (index, projection) in model.projections.iter().enumerate() {
        graph.projection(model, projection, index)?;
    }
    let output = model.population(&model.output).ok_or_else(|| unsupported("the model has no output"))?;
    let name = graph.free("output");
    graph.nodes = graph.nodes.with(&name, node("Output").with("shape", shape(&output.shape)));
    graph.edges.push((model.output.clone(), name));
    let (text, arrays) = model.ron(ARRAYS);
    let mut stored = Group::default();
    for (index, (key, tensor)) in arrays.iter().enumerate() {
        let entry = Group::default().with("key", key.as_str()).with("numbers", array(tensor));
        stored = stored.with(&index.to_string(), entry);
    }
    let metadata = Group::default().with(TEXT, text.as_str()).with("nsim_arrays", stored);
    let edges = graph.edges.iter().flat_map(|(from, to)| [from.clone(), to.clone()]).collect();
    let root = node("NIRGraph")
        .with("nodes", graph.nodes)
        .with("edges", Item::Texts(vec![graph.edges.len(), 2], edges))
        .with("metadata", metadata);
    Ok((Group::default().with("version", VERSION).with("node", root), graph.notes))
}

/// The model that nsim wrote into a file, or why it is not to be trusted; nothing when nsim did not write it.
#[must_use]
pub fn restore(root: &Group) -> Option<Result<ModelBuilder, String>> {
    let metadata = root.group("node/metadata")?;
    let text = metadata.text(TEXT)?;
    Some(restored(metadata, text).and_then(|model| match export(&model) {
        Ok((again, _)) if again.group("node") == root.group("node") => Ok(model),
        Ok(_) => Err("its nodes are not those that it was written with".to_string()),
        Err(problem) => Err(problem.to_string()),
    }))
}

fn restored(metadata: &Group, text: &str) -> Result<ModelBuilder, String> {
    let source = SourceText::new("metadata", text);
    let file = NetworkFile::parse(&source).map_err(|problem| problem.to_string())?;
    let mut arrays = std::collections::BTreeMap::new();
    for item in metadata.group("nsim_arrays").into_iter().flat_map(|group| group.items.values()) {
        let Item::Group(entry) = item else { return Err("an array of its metadata is none".to_string()) };
        let (Some(key), Some(numbers)) = (entry.text("key"), entry.numbers("numbers")) else {
            return Err("an array of its metadata is none".to_string());
        };
        let reals: Vec<f64> = numbers.reals().collect();
        let numbers_of = if numbers.is_integer() {
            let whole: Option<Vec<i32>> =
                reals.iter().map(|&x| (f64::from(x as i32) == x).then_some(x as i32)).collect();
            tensor::Numbers::Integers(whole.ok_or("an array of its metadata is beyond 32 bits")?)
        } else {
            tensor::Numbers::Reals(reals)
        };
        let tensor = Tensor::new(numbers.shape().to_vec(), numbers_of).ok_or("an array of its metadata is none")?;
        arrays.insert(ArrayRef::Safetensors(ARRAYS.to_string(), key.to_string()), tensor);
    }
    let network = Network::new(file, source, arrays).map_err(|problem| problem.to_string())?;
    ModelBuilder::from_network(&network).map_err(|problem| problem.to_string())
}

/// A node of a type.
fn node(kind: &str) -> Group {
    Group::default().with("type", kind)
}

fn shape(axes: &[u64]) -> Numbers {
    let axes: Vec<i64> = axes.iter().map(|&axis| axis as i64).collect();
    Numbers::i64(&[axes.len()], &axes)
}

/// A tensor in a type that holds its numbers.
fn array(tensor: &Tensor) -> Numbers {
    match tensor.numbers() {
        tensor::Numbers::Integers(x) => {
            Numbers::i64(tensor.shape(), &x.iter().map(|&x| i64::from(x)).collect::<Vec<_>>())
        }
        tensor::Numbers::Reals(x) => Numbers::f64(tensor.shape(), x),
    }
}

struct Graph {
    nodes: Group,
    edges: Vec<(String, String)>,
    notes: Vec<String>,
    dt: f64,
}

impl Graph {
    /// A name that no node has.
    fn free(&self, name: &str) -> String {
        let mut free = name.to_string();
        let mut count = 1;
        while self.nodes.items.contains_key(&free) {
            count += 1;
            free = format!("{name}_{count}");
        }
        free
    }

    fn population(&mut self, population: &PopulationBuilder) -> Result<()> {
        let axes: Vec<usize> = population.shape.iter().map(|&axis| axis as usize).collect();
        let units = population.units() as usize;
        let name = &population.name;
        if population.units() > MOST_MATRIX {
            return Err(unsupported(format!(
                "'{name}' has {} units: parameters of NIR are one for each",
                population.units()
            )));
        }
        let Some(parameters) = &population.loihi else {
            self.nodes =
                std::mem::take(&mut self.nodes).with(name, node("Input").with("shape", shape(&population.shape)));
            return Ok(());
        };
        let dt = self.dt;
        let get = |key: &str| population.parameter(key);
        // dt / tau of each compartment.
        let fraction = |decay: &str, tau: &str| -> Parameter {
            match (get(decay), get(tau)) {
                (Some(decay), _) => decay.map(|d| d / 4096.0),
                (None, Some(tau)) => tau.map(|tau| -(-dt * 1e3 / tau).exp_m1()),
                (None, None) => Parameter::Same(1.0),
            }
        };
        let (synapse, membrane) = match population.kind {
            NeuronKind::Loihi | NeuronKind::SoftReset => (fraction("du", "tau_u_ms"), fraction("dv", "tau_v_ms")),
            NeuronKind::If => (Parameter::Same(1.0), Parameter::Same(0.0)),
        };
        let threshold = match (get("vth_mant"), get("vth")) {
            (Some(mantissa), _) => mantissa.clone(),
            (None, Some(real)) => real.clone(),
            (None, None) => Parameter::Same(NOTHING),
        };
        let bias = |unit: usize| match (get("bias_mant"), get("bias")) {
            (Some(mantissa), _) => mantissa.get(unit) * get("bias_exp").map_or(0.0, |e| e.get(unit)).exp2() / 64.0,
            (None, Some(real)) => real.get(unit),
            (None, None) => 0.0,
        };
        let each = |f: &dyn Fn(usize) -> f64| Numbers::f64(&axes, &(0..units).map(f).collect::<Vec<_>>());
        let tau = |fraction: &Parameter, unit: usize| {
            let fraction = fraction.get(unit);
            if fraction > 0.0 { dt / fraction } else { dt * ENDLESS }
        };
        let neuron = node("CubaLIF")
            .with("tau_syn", each(&|unit| tau(&synapse, unit)))
            .with("tau_mem", each(&|unit| tau(&membrane, unit)))
            .with("w_in", each(&|unit| tau(&synapse, unit) / dt))
            .with("r", each(&|unit| tau(&membrane, unit) / dt))
            .with("v_leak", each(&|unit| bias(unit) * (tau(&membrane, unit) / dt)))
            .with("v_reset", each(&|_| 0.0))
            .with("v_threshold", each(&|unit| threshold.get(unit)));
        self.nodes = std::mem::take(&mut self.nodes).with(name, neuron);
        if population.kind == NeuronKind::SoftReset {
            self.notes.push(format!(
                "NIR does not say how neurons reset: '{name}' subtracts its threshold (nsim import --reset subtract)"
            ));
        }
        let lost: Vec<&str> = parameters
            .iter()
            .filter(|(key, value)| match *key {
                "refractory" => *value != Parameter::Same(1.0),
                "vmin_exp" => *value != Parameter::Same(23.0),
                "vmax_exp" => *value != Parameter::Same(7.0),
                _ => false,
            })
            .map(|(key, _)| *key)
            .chain((population.start_step > 0).then_some("start_step"))
            .collect();
        if !lost.is_empty() {
            self.notes.push(format!("NIR has no {}: only nsim will see that of '{name}'", lost.join(", ")));
        }
        Ok(())
    }

    fn projection(&mut self, model: &ModelBuilder, projection: &ProjectionBuilder, index: usize) -> Result<()> {
        let find = |name: &str| {
            model.population(name).ok_or_else(|| unsupported(format!("'{name}' is not a population of the model")))
        };
        let target = find(&projection.to)?;
        let real = target.parameter("vth").is_some();
        // In units of the register divided by 64, as the threshold mantissa is.
        let unit = match (real, projection.weight_scale) {
            (true, _) => 1.0,
            (false, scale) => scale.unwrap_or(1.0) * (projection.weight_exp as f64).exp2(),
        };
        let sources = projection.from.iter().map(|name| find(name)).collect::<Result<Vec<_>, _>>()?;
        let together: u64 = sources.iter().map(|source| source.units()).sum();
        let mut first = 0;
        for (part, source) in sources.iter().enumerate() {
            let name = self.free(&format!("w{index}_{part}"));
            let chain = self.weights(projection, (source, target), (first, together), unit)?;
            first += source.units();
            let mut last = source.name.clone();
            for (step, node) in chain.into_iter().enumerate() {
                let name = if step == 0 { name.clone() } else { self.free(&format!("{name}_{step}")) };
                self.nodes = std::mem::take(&mut self.nodes).with(&name, node);
                self.edges.push((last, name.clone()));
                last = name;
            }
            self.edges.push((last, target.name.clone()));
        }
        Ok(())
    }

    /// The nodes from a source to a target, in order.
    fn weights(
        &self,
        projection: &ProjectionBuilder,
        (source, target): (&PopulationBuilder, &PopulationBuilder),
        (first, together): (u64, u64),
        unit: f64,
    ) -> Result<Vec<Group>> {
        let (rows, columns) = (target.units(), source.units());
        let mut chain = Vec::new();
        let flatten = || {
            node("Flatten")
                .with("start_dim", Numbers::i64(&[], &[0]))
                .with("end_dim", Numbers::i64(&[], &[-1]))
                .with("input_type", shape(&source.shape))
        };
        let pair = |(y, x): (u64, u64)| Numbers::i64(&[2], &[y as i64, x as i64]);
        let matrix = |weights: Vec<f64>| {
            let weights: Vec<f64> = weights.iter().map(|w| w * unit).collect();
            node("Linear").with("weight", Numbers::f64(&[rows as usize, columns as usize], &weights))
        };
        match &projection.kind {
            ProjectionKind::Dense(weights) => {
                if source.shape.len() > 1 {
                    chain.push(flatten());
                }
                let slice = (0..rows).flat_map(|row| (0..columns).map(move |c| (row * together + first + c) as usize));
                chain.push(matrix(slice.map(|at| weights.real(at)).collect()));
            }
            ProjectionKind::Sparse(synapses) => {
                if rows.checked_mul(columns).is_none_or(|all| all > MOST_MATRIX) {
                    return Err(unsupported(format!(
                        "the listed synapses to '{}' are a matrix of {rows} x {columns} in NIR, more than {MOST_MATRIX} numbers",
                        target.name
                    )));
                }
                if source.shape.len() > 1 {
                    chain.push(flatten());
                }
                let mut weights = vec![0.0; (rows * columns) as usize];
                for (from, to, weight) in synapses {
                    if let Some(column) = from.checked_sub(first).filter(|&column| column < columns && *to < rows) {
                        weights[(to * columns + column) as usize] += weight;
                    }
                }
                chain.push(matrix(weights));
            }
            ProjectionKind::Conv2d { weights, stride, padding, dilation, groups, .. } => {
                let scaled: Vec<f64> = weights.reals().map(|weight| weight * unit).collect();
                let channels = weights.shape().first().copied().unwrap_or(0);
                let plane = source.shape.get(1..).unwrap_or_default();
                chain.push(
                    node("Conv2d")
                        .with("weight", Numbers::f64(weights.shape(), &scaled))
                        .with("bias", Numbers::f64(&[channels], &vec![0.0; channels]))
                        .with("stride", pair(*stride))
                        .with("padding", pair(*padding))
                        .with("dilation", pair(*dilation))
                        .with("groups", Numbers::i64(&[], &[*groups as i64]))
                        .with("input_shape", shape(plane)),
                );
            }
            ProjectionKind::SumPool2d { kernel, stride, padding, weight, .. } => {
                chain.push(
                    node("SumPool2d")
                        .with("kernel_size", pair(*kernel))
                        .with("stride", pair(*stride))
                        .with("padding", pair(*padding)),
                );
                let axes: Vec<usize> = target.shape.iter().map(|&axis| axis as usize).collect();
                let scale = vec![weight * unit; rows as usize];
                chain.push(node("Scale").with("scale", Numbers::f64(&axes, &scale)));
            }
        }
        // The target's own shape, where weights make a line of it.
        if projection.delay > 0 {
            let seconds = vec![f64::from(projection.delay) * self.dt; rows as usize];
            chain.push(node("Delay").with("delay", Numbers::f64(&[rows as usize], &seconds)));
        }
        Ok(chain)
    }
}

/// A threshold that nothing has.
const NOTHING: f64 = 1.0;
