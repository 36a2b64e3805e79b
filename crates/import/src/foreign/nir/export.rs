//! A model as a NIR file, and back without loss.
//!
//! Input: a model. Output: the tree of a `.nir` file that any tool of NIR reads: `CubaLIF` neurons
//! with time constants `4096 dt / du` in seconds. Weights, thresholds and biases are in units of
//! the register divided by 64 for integer models, in their own units for real-valued models. `w_in`
//! and `r` cancel the time constants. The graph's metadata has the text of the model and its
//! arrays, since NIR lacks weight exponents, refractory periods, clips, resets and semantics.
//! `restore` reads the model from there, provided that exporting it gives the file. A changed file
//! is read like any other.

use std::collections::{BTreeMap, BTreeSet};

use super::state::MOST_NODES;
use crate::foreign::imported::{MAX_THRESHOLD, always_spiking};
use crate::foreign::window::Step;
use crate::hdf5::{Group, Item, Numbers};
use nsim_files::network::{ArrayRef, Network, NetworkFile, Parameter, PopulationDesc, ProjectionDesc, ProjectionKind};
use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText};
use nsim_ir::neurons::NeuronKind;
use nsim_ir::tensor;
use nsim_ir::tensor::Tensor;

/// The version of NIR of the written layout.
const VERSION: &str = "1.0.8";
/// The key of the model's text in the metadata.
const MODEL_TEXT_KEY: &str = "nsim_model";
/// The file name of the arrays in the text.
const ARRAYS_FILE: &str = "arrays";
/// Time constant, in steps, that represents a decay of zero: `4096 dt / tau` rounds to 0, but `dt /
/// tau` is not 0.
const NO_DECAY_TAU: f64 = 4_503_599_627_370_496.0;
/// The most elements of a matrix that is written for a list of synapses.
pub(in crate::foreign) const MOST_MATRIX: u64 = 1 << 24;

fn unsupported(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("export.unsupported", message)
}

/// Refuses a model with spike response neurons or learning rules, which no format of other tools
/// holds.
///
/// # Errors
/// `export.unsupported`.
pub(in crate::foreign) fn check_neurons(model: &NetworkFile) -> Result<()> {
    if let Some(projection) = model.projections.iter().find(|projection| projection.learning.is_some()) {
        let name = projection.name_or_ends();
        let message = format!("projection '{name}' has a learning rule, which other tools do not support");
        return Err(unsupported(message)
            .help("remove the field learning, or learn first: nsim run MODEL --learned OUT.ron --freeze"));
    }
    let Some(population) = model.populations.iter().find(|population| population.srm.is_some()) else { return Ok(()) };
    let message = format!("'{}' has spike response neurons, which other tools do not support", population.name);
    Err(unsupported(message).help("convert them to Loihi neurons: nsim convert MODEL --input INPUT -o FILE.ron"))
}

/// The tree of a file, and notes on properties of the model that NIR lacks.
///
/// # Errors
/// `export.unsupported` for a model without a form in NIR: spike response neurons, neuron kinds of
/// Loihi 2, messages that carry integers, lists of synapses beyond 2^24 places.
pub fn export(model: &NetworkFile) -> Result<(Group, Vec<String>)> {
    check_neurons(model)?;
    let mut populations = model.populations.iter();
    if let Some(PopulationDesc { name, .. }) = populations.find(|p| p.payload.is_some() || p.message_bits.is_some()) {
        return Err(unsupported(format!("population '{name}' cannot be exported: its messages carry integers")));
    }
    let dt = model.timestep_ms / 1e3;
    let mut graph = Graph { dt, ..Graph::default() };
    let wires = Connectivity::new(model);
    let biases = model.populations.iter().filter(|population| graph.absorb_bias_source(&wires, population));
    let biases: BTreeSet<&String> = biases.map(|population| &population.name).collect();
    for population in model.populations.iter().filter(|population| !biases.contains(&population.name)) {
        graph.population(population)?;
        if population.loihi.is_some() && wires.entering(&population.name).is_empty() {
            graph.notes.push(format!(
                "'{}' has no input: Python's nir.read adds one, and nir.write then writes it to the file",
                population.name
            ));
        }
    }
    for (index, projection) in model.projections.iter().enumerate() {
        if !projection.from.iter().any(|from| biases.contains(from)) {
            graph.projection(&wires, projection, index)?;
        }
    }
    let output = wires.population(&model.output).ok_or_else(|| unsupported("the model has no output"))?;
    let name = graph.unused_name("output");
    graph.nodes.insert(&name, node("Output").with("shape", shape(&output.shape)));
    graph.edges.push((model.output.clone(), name));
    let (nodes, edges) = (graph.nodes.items.len(), graph.edges.len());
    if nodes.max(edges) > MOST_NODES {
        graph.notes.push(format!(
            "the graph has {nodes} nodes and {edges} edges: nsim restores the file, but reads a changed one only up to \
             {MOST_NODES} of both"
        ));
    }
    let metadata = model_metadata(model)?;
    let root = nir_graph(graph.nodes, graph.edges).with("metadata", metadata);
    Ok((Group::default().with("version", VERSION).with("node", root), graph.notes))
}

/// The text of a model and its arrays.
pub(in crate::foreign) fn model_metadata(model: &NetworkFile) -> Result<Group> {
    let (text, arrays) = model.ron(ARRAYS_FILE)?;
    let mut stored = Group::default();
    for (index, (key, tensor)) in arrays.iter().enumerate() {
        let entry = Group::default().with("key", key.as_str()).with("numbers", array(tensor));
        stored.insert(&index.to_string(), entry);
    }
    Ok(Group::default().with(MODEL_TEXT_KEY, text.as_str()).with("nsim_arrays", stored))
}

/// The model in the group `metadata` of a file that nsim wrote; `None` for other files. An error
/// when it is not valid, or when `parts` of the file (in messages: `what`) differ from its export.
pub(in crate::foreign) fn restore(
    root: &Group,
    metadata: &str,
    parts: [&str; 2],
    what: &str,
    export: impl Fn(&NetworkFile) -> Result<(Group, Vec<String>)>,
) -> Option<Result<NetworkFile, String>> {
    let metadata = root.group(metadata)?;
    Some(parse_metadata(metadata, metadata.text(MODEL_TEXT_KEY)?).and_then(|model| match export(&model) {
        // Another version of nsim may write this model differently.
        Ok((again, _)) if parts.iter().all(|part| again.get(part) == root.get(part)) => Ok(model),
        Ok(_) => Err(format!("its {what} differ from the model in its metadata")),
        Err(problem) => Err(problem.to_string()),
    }))
}

fn parse_metadata(metadata: &Group, text: &str) -> Result<NetworkFile, String> {
    let source = SourceText::new("metadata", text);
    let file = NetworkFile::parse(&source).map_err(|problem| problem.to_string())?;
    let mut arrays = BTreeMap::new();
    for item in metadata.group("nsim_arrays").into_iter().flat_map(|group| group.items.values()) {
        let entry = match item {
            Item::Group(entry) => entry.text("key").zip(entry.numbers("numbers")),
            _ => None,
        };
        let (key, numbers) = entry.ok_or("an entry of its metadata is not an array")?;
        let reals: Vec<f64> = numbers.reals().collect();
        let numbers_of = if numbers.is_integer() {
            let whole: Option<Vec<i32>> =
                reals.iter().map(|&x| (f64::from(x as i32) == x).then_some(x as i32)).collect();
            tensor::Numbers::Integers(whole.ok_or("an array of its metadata has numbers beyond 32 bits")?)
        } else {
            tensor::Numbers::Reals(reals)
        };
        let tensor =
            Tensor::new(numbers.shape().to_vec(), numbers_of).ok_or("an entry of its metadata is not an array")?;
        arrays.insert(ArrayRef::Safetensors(ARRAYS_FILE.to_string(), key.to_string()), tensor);
    }
    let network = Network::new(file, source, arrays).map_err(|problem| problem.to_string())?;
    network.resolved().map_err(|problem| problem.to_string())
}

fn node(kind: &str) -> Group {
    Group::default().with("type", kind)
}

/// A graph of nodes and the edges between them.
pub(in crate::foreign) fn nir_graph(nodes: Group, edges: Vec<(String, String)>) -> Group {
    let count = edges.len();
    let ends = edges.into_iter().flat_map(|(from, to)| [from, to]).collect();
    node("NIRGraph").with("nodes", nodes).with("edges", Item::Texts(vec![count, 2], ends))
}

fn shape(axes: &[u64]) -> Numbers {
    let axes: Vec<i64> = axes.iter().map(|&axis| axis as i64).collect();
    Numbers::i64(&[axes.len()], &axes)
}

/// A shape with the integer type of arrays.
fn sides(shape: &[u64]) -> Vec<usize> {
    shape.iter().map(|&axis| axis as usize).collect()
}

/// A tensor as 64-bit integers or reals.
fn array(tensor: &Tensor) -> Numbers {
    match tensor.numbers() {
        tensor::Numbers::Integers(x) => {
            Numbers::i64(tensor.shape(), &x.iter().map(|&x| i64::from(x)).collect::<Vec<_>>())
        }
        tensor::Numbers::Reals(x) => Numbers::f64(tensor.shape(), x),
    }
}

/// The populations of a model by name, and the projections that enter and leave each.
#[derive(Default)]
struct Connectivity<'a> {
    output: &'a str,
    populations: BTreeMap<&'a str, &'a PopulationDesc>,
    entering: BTreeMap<&'a str, Vec<&'a ProjectionDesc>>,
    leaving: BTreeMap<&'a str, Vec<&'a ProjectionDesc>>,
}

impl<'a> Connectivity<'a> {
    fn new(model: &'a NetworkFile) -> Self {
        let populations = model.populations.iter().map(|population| (population.name.as_str(), population)).collect();
        let mut wires = Connectivity { output: &model.output, populations, ..Connectivity::default() };
        for projection in &model.projections {
            wires.entering.entry(&projection.to).or_default().push(projection);
            for from in projection.from.iter().collect::<BTreeSet<_>>() {
                wires.leaving.entry(from).or_default().push(projection);
            }
        }
        wires
    }

    fn population(&self, name: &str) -> Option<&'a PopulationDesc> {
        self.populations.get(name).copied()
    }

    /// A population that has to exist.
    fn find(&self, name: &str) -> Result<&'a PopulationDesc> {
        self.population(name).ok_or_else(|| unsupported(format!("'{name}' is not a population of the model")))
    }

    /// Whether a projection is written without a delay from all of its sources.
    fn is_undelayed(&self, projection: &ProjectionDesc) -> bool {
        let mut sources = projection.from.iter().filter_map(|from| self.population(from));
        let target = self.population(&projection.to);
        target.is_some_and(|target| sources.all(|source| written_delay(projection, source, target) == 0))
    }

    fn entering(&self, name: &str) -> &[&'a ProjectionDesc] {
        self.entering.get(name).map_or(&[], |all| all)
    }

    fn leaving(&self, name: &str) -> &[&'a ProjectionDesc] {
        self.leaving.get(name).map_or(&[], |all| all)
    }
}

#[derive(Default)]
struct Graph {
    nodes: Group,
    edges: Vec<(String, String)>,
    notes: Vec<String>,
    dt: f64,
    /// Biases of currents with memory, by target, until a node takes them. In the model, a
    /// compartment that spikes in every step adds them.
    biases: BTreeMap<String, Vec<f64>>,
}

impl Graph {
    /// Whether a population is the compartment that an import makes for biases of a current, which
    /// spikes in every step. If so, stores these biases, which become biases of nodes again.
    fn absorb_bias_source(&mut self, wires: &Connectivity<'_>, population: &PopulationDesc) -> bool {
        let is_made = population.units() == 1
            && population.loihi == Some(always_spiking())
            && population.name != wires.output
            && wires.entering(&population.name).is_empty();
        if !is_made {
            return false;
        }
        let mut sums: BTreeMap<String, Vec<f64>> = BTreeMap::new();
        for projection in wires.leaving(&population.name) {
            let mut others = wires.entering(&projection.to).iter();
            let other = others.find(|other| !other.from.contains(&population.name) && wires.is_undelayed(other));
            let (ProjectionKind::Dense(weights), 1, 0, Some(other)) =
                (&projection.kind, projection.from.len(), projection.delay, other)
            else {
                return false;
            };
            let unit = weight_unit(wires, projection);
            let weights: Vec<f64> = weights.tensor().reals().map(|w| w * unit).collect();
            let by_channel = matches!(other.kind, ProjectionKind::Conv2d { .. })
                && by_channel(&weights, wires.population(&projection.to).map_or(&[][..], |p| &p.shape)).is_some();
            let holds = by_channel || matches!(other.kind, ProjectionKind::Dense(_) | ProjectionKind::Sparse(_));
            let taken = self.biases.contains_key(&projection.to) || sums.contains_key(&projection.to);
            if !holds || taken {
                return false;
            }
            sums.insert(projection.to.clone(), weights);
        }
        let any = !sums.is_empty();
        self.biases.extend(sums);
        any
    }

    fn unused_name(&self, name: &str) -> String {
        let mut free = name.to_string();
        let mut count = 1;
        while self.nodes.items.contains_key(&free) {
            count += 1;
            free = format!("{name}_{count}");
        }
        free
    }

    fn population(&mut self, population: &PopulationDesc) -> Result<()> {
        let (name, units) = (&population.name, population.units());
        if units > MOST_MATRIX {
            return Err(unsupported(format!(
                "'{name}' has {units} units: a parameter in NIR has one value for each unit"
            )));
        }
        let Some(parameters) = &population.loihi else {
            self.nodes.insert(name, node("Input").with("shape", shape(&population.shape)));
            return Ok(());
        };
        let fields = NeuronFields { population, dt: self.dt };
        let (synapse, membrane) = match population.kind {
            NeuronKind::Loihi | NeuronKind::SoftReset => {
                (fields.fraction("du", "tau_u_ms"), fields.fraction("dv", "tau_v_ms"))
            }
            NeuronKind::If => (Parameter::Same(1.0), Parameter::Same(0.0)),
            kind => {
                let kind = kind.name();
                return Err(unsupported(format!("'{name}' has {kind} neurons, which NIR does not support")));
            }
        };
        let mantissa = population.parameter("vth_mant");
        // Import gives an integrator the greatest threshold, which is never reached.
        let integrates = mantissa == Some(&Parameter::Same(MAX_THRESHOLD));
        let neuron = node(if integrates { "CubaLI" } else { "CubaLIF" })
            .with("tau_syn", fields.array(|unit| fields.tau(&synapse, unit)))
            .with("tau_mem", fields.array(|unit| fields.tau(&membrane, unit)))
            .with("w_in", fields.array(|unit| fields.tau(&synapse, unit) / self.dt))
            .with("r", fields.array(|unit| fields.tau(&membrane, unit) / self.dt))
            .with("v_leak", fields.array(|unit| fields.bias(unit) * (fields.tau(&membrane, unit) / self.dt)));
        let threshold = mantissa.or(population.parameter("vth"));
        let neuron = match integrates {
            true => neuron,
            false => neuron.with("v_reset", fields.array(|_| 0.0)).with(
                "v_threshold",
                fields.array(|unit| threshold.map_or(ABSENT_THRESHOLD, |threshold| threshold.get(unit))),
            ),
        };
        self.nodes.insert(name, neuron);
        if population.kind == NeuronKind::SoftReset {
            self.notes.push(format!(
                "NIR has no reset by subtraction: other tools will reset '{name}' to zero, and only nsim will subtract"
            ));
        }
        let usual = [("refractory", 1.0), ("vmin_exp", 23.0), ("vmax_exp", 7.0)];
        let lost: Vec<&str> = parameters
            .iter()
            .filter(|(key, value)| usual.iter().any(|(name, usual)| name == key && *value != Parameter::Same(*usual)))
            .map(|(key, _)| *key)
            .chain((population.start_step > 0).then_some("start_step"))
            .collect();
        if !lost.is_empty() {
            self.notes.push(format!("NIR has no {}: only nsim reads this part of '{name}'", lost.join(", ")));
        }
        Ok(())
    }

    fn projection(&mut self, wires: &Connectivity<'_>, projection: &ProjectionDesc, index: usize) -> Result<()> {
        let target = wires.find(&projection.to)?;
        let unit = weight_unit(wires, projection);
        if is_matrix(projection) && target.shape.len() > 1 {
            self.notes.push(format!(
                "weights from {} flatten '{}' of shape {:?}: Python's nir.read will refuse the file, nsim reads it",
                projection.from.join(" and "),
                target.name,
                target.shape
            ));
        }
        let sources = projection.from.iter().map(|name| wires.find(name)).collect::<Result<Vec<_>, _>>()?;
        let together: u64 = sources.iter().map(|source| source.units()).sum();
        let mut first = 0;
        for (part, source) in sources.into_iter().enumerate() {
            let name = self.unused_name(&format!("w{index}_{part}"));
            let link = Link { projection, source, target, first, together, unit };
            let bias = if link.delay() == 0 { self.bias_for(projection, target) } else { None };
            let chain = self.chain(&link, bias)?;
            first += source.units();
            let mut last = source.name.clone();
            for (step, node) in chain.into_iter().enumerate() {
                let name = if step == 0 { name.clone() } else { self.unused_name(&format!("{name}_{step}")) };
                self.nodes.insert(&name, node);
                self.edges.push((last, name.clone()));
                last = name;
            }
            self.edges.push((last, target.name.clone()));
        }
        Ok(())
    }

    /// Removes and returns the bias of a target, if the node of this projection can have it.
    fn bias_for(&mut self, projection: &ProjectionDesc, target: &PopulationDesc) -> Option<Vec<f64>> {
        let bias = self.biases.get(&target.name)?;
        let of_node = match projection.kind {
            ProjectionKind::Dense(_) | ProjectionKind::Sparse(_) => Some(bias.clone()),
            ProjectionKind::Conv2d { .. } => by_channel(bias, &target.shape),
            _ => None,
        }?;
        self.biases.remove(&target.name);
        Some(of_node)
    }

    /// The nodes from a source to a target, in order.
    fn chain(&mut self, link: &Link<'_>, bias: Option<Vec<f64>>) -> Result<Vec<Group>> {
        let &Link { projection, source, target, unit, .. } = link;
        let mut chain = Vec::new();
        if is_matrix(projection) && source.shape.len() > 1 {
            chain.push(
                node("Flatten")
                    .with("start_dim", Numbers::i64(&[], &[0]))
                    .with("end_dim", Numbers::i64(&[], &[-1]))
                    .with("input_type", shape(&source.shape)),
            );
        }
        match &projection.kind {
            ProjectionKind::Dense(weights) => chain.push(link.matrix(&link.columns(weights.tensor()), bias)),
            ProjectionKind::Sparse(synapses) => chain.push(link.matrix(&link.listed(synapses)?, bias)),
            ProjectionKind::Conv2d { weights, stride, padding, dilation, groups, .. } => {
                let weights = weights.tensor();
                let scaled: Vec<f64> = weights.reals().map(|weight| weight * unit).collect();
                let step = [*stride, *padding, *dilation];
                let kernel = Kernel { axes: weights.shape(), weights: &scaled, step, groups: *groups };
                chain.push(self.convolution(link, &kernel, bias)?);
            }
            ProjectionKind::SumPool2d { kernel, stride, padding, padding_after, weight }
                if padding != padding_after =>
            {
                // NIR's pools have one padding per axis, but a kernel can have zeros.
                let groups = source.shape.first().copied().unwrap_or(1);
                let axes = [groups, 1, kernel.0, kernel.1].map(|axis| axis as usize);
                let weights = vec![weight * unit; axes.iter().product()];
                let step = [*stride, *padding, (1, 1)];
                chain.push(self.convolution(link, &Kernel { axes: &axes, weights: &weights, step, groups }, None)?);
            }
            ProjectionKind::SumPool2d { kernel, stride, padding, weight, .. } => {
                chain.push(
                    node("SumPool2d")
                        .with("kernel_size", shape(&[kernel.0, kernel.1]))
                        .with("stride", shape(&[stride.0, stride.1]))
                        .with("padding", shape(&[padding.0, padding.1])),
                );
                let scale = vec![weight * unit; target.units() as usize];
                chain.push(node("Scale").with("scale", Numbers::f64(&sides(&target.shape), &scale)));
            }
            ProjectionKind::Arrays(_) | ProjectionKind::Random { .. } => {
                return Err(unsupported(format!("synapses to '{}' that are not in place", target.name)));
            }
        }
        // The shape after the weights, which flatten it where they are a matrix.
        if link.delay() > 0 {
            let rows = target.units() as usize;
            let seconds = vec![f64::from(link.delay()) * self.dt; rows];
            let axes = if is_matrix(projection) { vec![rows] } else { sides(&target.shape) };
            chain.push(node("Delay").with("delay", Numbers::f64(&axes, &seconds)));
        }
        Ok(chain)
    }

    /// A convolution in NIR's form: one padding for both ends of an axis, and a square kernel,
    /// since `nir.read` of Python uses the height of a kernel as its width. Rows and columns of
    /// zeros around the kernel achieve both. With F before and B after it, at dilation d, a padding
    /// of `before + F d` on both sides acts like `before + d (F - B)` at the end of the axis.
    fn convolution(&mut self, link: &Link<'_>, kernel: &Kernel<'_>, bias: Option<Vec<f64>>) -> Result<Group> {
        let Link { source, target, .. } = link;
        let &Kernel { axes, weights, step: [stride, before, dilation], groups } = kernel;
        let (&[out, inner, kh, kw], &[_, from_h, from_w], &[_, to_h, to_w]) =
            (axes, source.shape.as_slice(), target.shape.as_slice())
        else {
            return Err(unsupported(format!("the convolution to '{}' does not connect volumes", target.name)));
        };
        let rows = Axis {
            from: from_h,
            to: to_h,
            kernel: kh as u64,
            stride: stride.0,
            before: before.0,
            dilation: dilation.0,
        };
        let columns = Axis {
            from: from_w,
            to: to_w,
            kernel: kw as u64,
            stride: stride.1,
            before: before.1,
            dilation: dilation.1,
        };
        let least = rows.kernel.max(columns.kernel);
        let most = 2 * least + rows.before + columns.before + 2;
        let square =
            (least..=most).find_map(|size| Some((rows.with_kernel_size(size)?, columns.with_kernel_size(size)?)));
        let (rows, columns) = match square {
            Some(both) => both,
            None => {
                self.notes.push(format!(
                    "the kernel to '{}' is {kh} x {kw} and cannot be made square: Python's nir.read may refuse the \
                     file, nsim reads it",
                    target.name
                ));
                rows.padded(most).zip(columns.padded(most)).ok_or_else(|| {
                    unsupported(format!("NIR does not support the paddings of the convolution to '{}'", target.name))
                })?
            }
        };
        let (height, width) = (rows.size as usize, columns.size as usize);
        // `nir.read` uses a kernel's channels as its input's, so groups become zeros too where the
        // kernel stays small.
        let all = inner * groups as usize;
        let in_one = groups > 1 && (out * all * height * width) as u64 <= MOST_MATRIX;
        if groups > 1 && !in_one {
            self.notes.push(format!(
                "the convolution to '{}' has {groups} groups: Python's nir.read will refuse the file, nsim reads it",
                target.name
            ));
        }
        let (groups, planes) = if in_one { (1, all) } else { (groups, inner) };
        let mut wide = vec![0.0; out * planes * height * width];
        for (index, weight) in weights.iter().enumerate() {
            let (plane, y, x) =
                (index / (kh * kw), index / kw % kh + rows.first as usize, index % kw + columns.first as usize);
            let (channel, within) = (plane / inner, plane % inner);
            let group = if in_one { channel / (out / (all / inner)) } else { 0 };
            wide[((channel * planes + group * inner + within) * height + y) * width + x] = *weight;
        }
        Ok(node("Conv2d")
            .with("weight", Numbers::f64(&[out, planes, height, width], &wide))
            .with("bias", Numbers::f64(&[out], &bias.unwrap_or_else(|| vec![0.0; out])))
            .with("stride", shape(&[rows.stride, columns.stride]))
            .with("padding", shape(&[rows.padding, columns.padding]))
            .with("dilation", shape(&[dilation.0, dilation.1]))
            .with("groups", Numbers::i64(&[], &[groups as i64]))
            .with("input_shape", shape(&source.shape[1..])))
    }
}

/// A population's parameters as the fields of a node.
struct NeuronFields<'a> {
    population: &'a PopulationDesc,
    /// Seconds of a timestep.
    dt: f64,
}

impl NeuronFields<'_> {
    /// dt / tau of each compartment.
    fn fraction(&self, decay: &str, tau: &str) -> Parameter {
        match (self.population.parameter(decay), self.population.parameter(tau)) {
            (Some(decay), _) => decay.map(|d| d / 4096.0),
            (None, Some(tau)) => tau.map(|tau| -(-self.dt * 1e3 / tau).exp_m1()),
            (None, None) => Parameter::Same(1.0),
        }
    }

    /// The time constant of a fraction.
    fn tau(&self, fraction: &Parameter, unit: usize) -> f64 {
        let fraction = fraction.get(unit);
        if fraction > 0.0 { self.dt / fraction } else { self.dt * NO_DECAY_TAU }
    }

    fn bias(&self, unit: usize) -> f64 {
        let number = |key: &str| self.population.parameter(key).map(|parameter| parameter.get(unit));
        match number("bias_mant") {
            Some(mantissa) => mantissa * number("bias_exp").unwrap_or(0.0).exp2() / 64.0,
            None => number("bias").unwrap_or(0.0),
        }
    }

    /// The array of a number of each compartment.
    fn array(&self, number: impl Fn(usize) -> f64) -> Numbers {
        let numbers: Vec<f64> = (0..self.population.units() as usize).map(number).collect();
        Numbers::f64(&sides(&self.population.shape), &numbers)
    }
}

/// A projection from one of its sources.
struct Link<'a> {
    projection: &'a ProjectionDesc,
    source: &'a PopulationDesc,
    target: &'a PopulationDesc,
    /// Units of the sources before this one, and of all.
    first: u64,
    together: u64,
    /// A weight of 1 in the file ([`weight_unit`]).
    unit: f64,
}

impl Link<'_> {
    fn delay(&self) -> u32 {
        written_delay(self.projection, self.source, self.target)
    }

    /// The weights of this source in a matrix of all sources.
    fn columns(&self, weights: &Tensor) -> Vec<f64> {
        let places = (0..self.target.units()).flat_map(|row| {
            (0..self.source.units()).map(move |column| (row * self.together + self.first + column) as usize)
        });
        places.map(|at| weights.real(at)).collect()
    }

    /// The synapses of this source as a matrix.
    fn listed(&self, synapses: &[(u64, u64, f64)]) -> Result<Vec<f64>> {
        let (rows, columns) = (self.target.units(), self.source.units());
        if rows.checked_mul(columns).is_none_or(|all| all > MOST_MATRIX) {
            return Err(unsupported(format!(
                "the listed synapses to '{}' become a matrix of {rows} x {columns} in NIR, more than {MOST_MATRIX} \
                 numbers",
                self.target.name
            )));
        }
        let mut weights = vec![0.0; (rows * columns) as usize];
        for (from, to, weight) in synapses {
            if let Some(column) = from.checked_sub(self.first).filter(|&column| column < columns && *to < rows) {
                weights[(to * columns + column) as usize] += weight;
            }
        }
        Ok(weights)
    }

    /// The node of a matrix of weights.
    fn matrix(&self, weights: &[f64], bias: Option<Vec<f64>>) -> Group {
        let (rows, columns) = (self.target.units() as usize, self.source.units() as usize);
        let weights: Vec<f64> = weights.iter().map(|w| w * self.unit).collect();
        let weights = Numbers::f64(&[rows, columns], &weights);
        match bias {
            Some(bias) => node("Affine").with("weight", weights).with("bias", Numbers::f64(&[rows], &bias)),
            None => node("Linear").with("weight", weights),
        }
    }
}

/// Whether a projection is written as a matrix.
fn is_matrix(projection: &ProjectionDesc) -> bool {
    matches!(projection.kind, ProjectionKind::Dense(_) | ProjectionKind::Sparse(_))
}

/// A kernel `[out][in / groups][height][width]`.
struct Kernel<'a> {
    axes: &'a [usize],
    weights: &'a [f64],
    step: Step,
    groups: u64,
}

/// A window along one axis.
#[derive(Clone, Copy)]
struct Axis {
    from: u64,
    to: u64,
    kernel: u64,
    stride: u64,
    before: u64,
    dilation: u64,
}

/// A window with zeros around its kernel and one padding for both ends.
struct PaddedWindow {
    size: u64,
    /// Zeros before the kernel.
    first: u64,
    stride: u64,
    padding: u64,
}

impl Axis {
    /// The window with the least kernel, of at most `most` places.
    fn padded(&self, most: u64) -> Option<PaddedWindow> {
        (self.kernel..=most).find_map(|size| self.with_kernel_size(size))
    }

    /// The window with a kernel of `size` places, if its number of outputs is unchanged.
    fn with_kernel_size(&self, size: u64) -> Option<PaddedWindow> {
        let zeros = size.checked_sub(self.kernel)?;
        let reach = self.dilation * (size - 1) + 1;
        // One output needs no stride, and a large stride prevents a second output.
        let stride = if self.to == 1 && zeros > 0 { self.from + reach + self.before } else { self.stride };
        (0..=zeros).find_map(|first| {
            let padding = self.before + first * self.dilation;
            let outputs = (self.from + 2 * padding).checked_sub(reach)? / stride + 1;
            (outputs == self.to).then_some(PaddedWindow { size, first, stride, padding })
        })
    }
}

/// A projection's weight of 1 in units of the threshold mantissa, the register divided by 64, or of
/// a real threshold.
fn weight_unit(wires: &Connectivity<'_>, projection: &ProjectionDesc) -> f64 {
    let real = wires.population(&projection.to).is_some_and(|target| target.parameter("vth").is_some());
    match (real, projection.weight_scale) {
        (true, _) => 1.0,
        (false, scale) => scale.unwrap_or(1.0) * (projection.weight_exp.unwrap_or(0) as f64).exp2(),
    }
}

/// The delay of a projection, without the steps that import adds for a target that starts later.
fn written_delay(projection: &ProjectionDesc, source: &PopulationDesc, target: &PopulationDesc) -> u32 {
    let wait = match &source.loihi {
        None => target.start_step,
        Some(_) => target.start_step.saturating_sub(source.start_step).saturating_sub(1),
    };
    projection.delay.saturating_sub(wait)
}

/// One bias per channel, if all units of each channel have equal biases.
pub(in crate::foreign) fn by_channel(biases: &[f64], shape: &[u64]) -> Option<Vec<f64>> {
    let &[channels, height, width] = shape else { return None };
    let plane = (height * width) as usize;
    let equal = plane > 0 && biases.len() as u64 == channels * height * width;
    if !equal {
        return None;
    }
    biases.chunks(plane).map(|chunk| chunk.iter().all(|bias| *bias == chunk[0]).then(|| chunk[0])).collect()
}

/// The threshold that is written for neurons without one.
const ABSENT_THRESHOLD: f64 = 1.0;
