//! Networks that lava-dl exports for its netx (`.net`, HDF5).
//!
//! Comes in: the tree of a file. Goes out: a draft with one population a layer. Layers are taken in the order of their
//! numbers. `iDecay` is the effective decay of the current, the threshold is `vThMant` times 64, a bias is a mantissa
//! with exponent 6 (lava-dl d825ac5, `netx/hdf5.py`, `netx/blocks/models.py`). Kernels are cross-correlated as stored;
//! what is flattened is flattened in the order C, H, W. A network of chip time has one step between layers; one with the
//! older neuron type `LOIHI` has SLAYER's time, in which layer k starts at step k + 1.
//!
//! Left out on purpose: neurons with another dynamics (ALIF, RF, SDNN, complex weights), graded spikes, concatenation.

use std::cell::Cell;

use super::hdf5::{Group, Numbers};
use super::{Imported, Options, encode, listed};
use crate::base::diagnostic::Diagnostic;
use crate::desc::network::{ResetDesc, ThresholdTest};
use crate::desc::tensor::Tensor;
use crate::io::draft::{Draft, DraftKind, DraftPopulation, DraftProjection, Value, tensor};
use crate::io::npy;

/// Parameters that are given for each channel are expanded to at most so many numbers, all layers together.
const MOST_EXPANDED: u64 = 1 << 22;
/// The most synapses that are listed one by one (transposed convolutions, delays that differ).
const MOST_LISTED: u64 = 1 << 20;
/// The greatest delay field.
const LONGEST_DELAY: f64 = 62.0;
/// The greatest threshold mantissa: what an integrator that should not spike gets.
const NEVER: f64 = 131_071.0;
/// The exponent of a bias (netx, `bias_exp`).
const BIAS_EXP: f64 = 6.0;

/// Reads the tree of a file.
///
/// # Errors
/// `import.netx` for what is malformed, `import.unsupported` for what is known and has no counterpart, `import.option`
/// for what the file does not say.
pub fn read(root: &Group, name: &str, options: &Options) -> Result<Imported, Diagnostic> {
    let layers = layers(root)?;
    let dt_ms = options.dt_ms.or_else(|| root.number("simulation/Ts")).unwrap_or(1.0);
    let mut reader = Reader {
        options,
        draft: Draft::new(name, dt_ms),
        notes: Vec::new(),
        last: None,
        expanded: Cell::new(0),
        slayer_time: false,
        depth: 0,
    };
    for (number, layer) in &layers {
        reader.layer(*number, layer)?;
    }
    reader.finish()
}

/// The layers in the order of their numbers.
fn layers(root: &Group) -> Result<Vec<(u32, &Group)>, Diagnostic> {
    let group = root.group("layer").ok_or_else(|| wrong("there is no group 'layer'"))?;
    let mut layers = Vec::new();
    for name in group.items.keys() {
        let number = name.parse::<u32>().ok().filter(|number| number.to_string() == *name);
        match (number, group.group(name)) {
            (Some(number), Some(layer)) => layers.push((number, layer)),
            _ => return Err(wrong(format!("'layer/{name}' is not the group of a numbered layer"))),
        }
    }
    layers.sort_by_key(|(number, _)| *number);
    match layers.iter().enumerate().find(|(index, (number, _))| *index as u32 != *number) {
        _ if layers.is_empty() => Err(wrong("it has no layers")),
        Some((index, _)) => Err(wrong(format!(
            "layer {index} is missing: there are {} up to {}",
            layers.len(),
            layers[layers.len() - 1].0
        ))),
        None => Ok(layers),
    }
}

fn wrong(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("import.netx", message)
}

/// What spikes reach the next layer.
#[derive(Debug, Clone)]
struct Last {
    /// The population.
    name: String,
    shape: Vec<u64>,
    /// Delay field of each of its units; empty for none.
    delays: Vec<u32>,
}

impl Last {
    fn units(&self) -> u64 {
        units(&self.shape).unwrap_or(u64::MAX)
    }
}

fn units(shape: &[u64]) -> Option<u64> {
    shape.iter().try_fold(1u64, |product, &axis| product.checked_mul(axis))
}

struct Reader<'a> {
    options: &'a Options,
    draft: Draft,
    notes: Vec<String>,
    last: Option<Last>,
    expanded: Cell<u64>,
    slayer_time: bool,
    /// Populations of compartments so far, which decides when the next one starts.
    depth: u32,
}

/// A layer while it is being read.
struct Layer<'a> {
    number: u32,
    kind: String,
    group: &'a Group,
}

impl Layer<'_> {
    fn wrong(&self, message: impl std::fmt::Display) -> Diagnostic {
        wrong(format!("layer {} ({}): {message}", self.number, self.kind))
    }

    fn unsupported(&self, message: impl std::fmt::Display, help: &str) -> Diagnostic {
        Diagnostic::new("import.unsupported", format!("layer {} ({}): {message}", self.number, self.kind)).help(help)
    }

    fn numbers(&self, key: &str) -> Result<&Numbers, Diagnostic> {
        self.group.numbers(key).ok_or_else(|| self.wrong(format!("it has no array '{key}'")))
    }

    /// Finite numbers.
    fn reals(&self, key: &str) -> Result<Vec<f64>, Diagnostic> {
        let reals: Vec<f64> = self.numbers(key)?.reals().collect();
        match reals.iter().find(|x| !x.is_finite()) {
            Some(x) => Err(self.wrong(format!("'{key}' has a number that is {x}"))),
            None => Ok(reals),
        }
    }

    /// A pair (y, x): two numbers, or one for both.
    fn pair(&self, key: &str, default: (u64, u64), least: u64) -> Result<(u64, u64), Diagnostic> {
        if self.group.get(key).is_none() {
            return Ok(default);
        }
        let numbers = self.reals(key)?;
        let whole = |x: f64| (x.fract() == 0.0 && (least as f64..=65_535.0).contains(&x)).then_some(x as u64);
        let pair = match numbers.as_slice() {
            [both] => whole(*both).map(|both| (both, both)),
            [y, x] => whole(*y).zip(whole(*x)),
            _ => None,
        };
        pair.ok_or_else(|| self.wrong(format!("'{key}' is {numbers:?}, not two whole numbers from {least}")))
    }

    /// The shape of the layer's units: `[n]` or `[channels, height, width]`.
    fn shape(&self) -> Result<Vec<u64>, Diagnostic> {
        let mut shape = Vec::new();
        for x in self.reals("shape")? {
            if !(x.fract() == 0.0 && (1.0..=134_217_728.0).contains(&x)) {
                return Err(self.wrong(format!("a shape with {x}")));
            }
            shape.push(x as u64);
        }
        match shape.len() {
            1 | 3 => Ok(shape),
            // A line of channels.
            2 => Ok(vec![shape[0], 1, shape[1]]),
            axes => Err(self.wrong(format!("its shape {shape:?} has {axes} axes"))),
        }
    }

    /// The axes of an array without trailing ones of length 1, down to `axes`.
    fn axes(&self, key: &str, axes: usize) -> Result<Vec<u64>, Diagnostic> {
        let mut shape: Vec<u64> = self.numbers(key)?.shape().iter().map(|&axis| axis as u64).collect();
        while shape.len() > axes && shape.last() == Some(&1) {
            shape.pop();
        }
        Ok(shape)
    }
}

/// The geometry of a window.
#[derive(Debug, Clone, Copy)]
struct Geometry {
    stride: (u64, u64),
    padding: (u64, u64),
    dilation: (u64, u64),
}

impl Reader<'_> {
    fn layer(&mut self, number: u32, group: &Group) -> Result<(), Diagnostic> {
        let Some(kind) = group.text("type") else {
            let members: Vec<&str> = group.items.keys().take(8).map(String::as_str).collect();
            return Err(wrong(format!("layer {number} does not say its type; it holds {}", listed(&members))));
        };
        let layer = Layer { number, kind: kind.to_string(), group };
        if layer.group.group("weight").is_some() {
            return Err(layer.unsupported(
                "its weights are complex",
                "resonate-and-fire layers have no counterpart on a Loihi 1 core",
            ));
        }
        match kind {
            "input" => self.input(&layer),
            "flatten" => self.flatten(&layer),
            "dense" | "dense_rec" => self.dense(&layer),
            "conv" => self.conv(&layer),
            "pool" => self.pool(&layer),
            "convT" | "unpool" => self.transposed(&layer),
            "average" => self.average(&layer),
            other => Err(layer.unsupported(
                format!("layers of the type '{other}' are not imported"),
                "imported are input, flatten, dense, dense_rec, conv, pool, convT, unpool and average",
            )),
        }
    }

    fn input(&mut self, layer: &Layer<'_>) -> Result<(), Diagnostic> {
        if self.last.is_some() {
            return Err(layer.wrong("an input layer is not the first"));
        }
        let shape = layer.shape()?;
        let parameters = match layer.group.group("neuron") {
            Some(_) => Some(self.neuron(layer, &shape)?),
            None => None,
        };
        let scalar = |key: &str, default: f64| match layer.group.get(key) {
            None => Ok(default),
            Some(_) => layer.group.number(key).ok_or_else(|| layer.wrong(format!("'{key}' is not one number"))),
        };
        match (parameters, &self.options.image) {
            (Some(mut parameters), Some(path)) => {
                let (weight, bias) = (scalar("weight", 64.0)?.trunc(), scalar("bias", 0.0)?.trunc());
                let drive = image(path, &shape)?;
                // netx, `create_input`: an image of 0 to 1 becomes -weight to weight, rounded toward zero.
                let biases = drive.iter().map(|x| (2.0 * weight * x - weight + bias).trunc()).collect();
                set_bias(&mut parameters, biases);
                self.notes.push(format!(
                    "layer {}: the image {} drives the bias of the input layer as 2 * {weight} * x - {weight} + {bias}",
                    layer.number,
                    path.display()
                ));
                self.push("input", shape, Some(parameters));
            }
            (None, Some(_)) => {
                return Err(Diagnostic::new(
                    "import.option",
                    "the input layer has no neuron that an image could drive",
                ));
            }
            (parameters, None) => {
                if parameters.is_some() {
                    self.notes.push(format!(
                        "layer {}: an input layer with neurons, imported as spikes of those neurons; to drive them with \
                         an image give --image FILE.npy",
                        layer.number
                    ));
                    // Its spikes are given, as recorded; the layers behind it start as if it were there.
                }
                self.push("input", shape, None);
            }
        }
        Ok(())
    }

    /// Adds a population and makes it the last.
    fn push(&mut self, name: &str, shape: Vec<u64>, loihi: Option<Vec<(&'static str, Value)>>) {
        let start_step = match &loihi {
            Some(_) => {
                self.depth += 1;
                self.depth - 1
            }
            None => 0,
        };
        self.draft.populations.push(DraftPopulation {
            name: name.to_string(),
            shape: shape.clone(),
            loihi,
            srm: None,
            start_step,
        });
        self.last = Some(Last { name: name.to_string(), shape, delays: Vec::new() });
    }

    fn flatten(&mut self, layer: &Layer<'_>) -> Result<(), Diagnostic> {
        // Populations are flattened in the order C, H, W by whatever dense layer follows.
        match &self.last {
            Some(_) => Ok(()),
            None => Err(layer.wrong("there is nothing before it")),
        }
    }

    /// The layer before, or an input of this shape when there is none.
    fn source(&mut self, shape: impl FnOnce() -> Result<Vec<u64>, Diagnostic>) -> Result<Last, Diagnostic> {
        if self.last.is_none() {
            let shape = shape()?;
            self.push("input", shape, None);
        }
        self.last.clone().ok_or_else(|| wrong("no layer"))
    }

    fn dense(&mut self, layer: &Layer<'_>) -> Result<(), Diagnostic> {
        let shape = vec![units(&layer.shape()?).ok_or_else(|| layer.wrong("a shape beyond all memory"))?];
        let axes = layer.axes("weight", 2)?;
        let given = layer.group.number("inFeatures").filter(|x| x.fract() == 0.0 && (1.0..1e9).contains(x));
        let count = layer.numbers("weight")?.len() as u64;
        let inputs = given.map_or(count / shape[0].max(1), |x| x as u64);
        let source = self.source(|| Ok(vec![inputs]))?;
        let fills = shape[0].checked_mul(source.units()) == Some(count);
        if !fills || !(axes.len() <= 1 || axes == [shape[0], source.units()]) {
            return Err(layer.wrong(format!(
                "weights {:?} do not lead from the {} units of '{}' to {}",
                layer.numbers("weight")?.shape(),
                source.units(),
                source.name,
                shape[0]
            )));
        }
        let name = format!("layer{}", layer.number);
        let parameters = self.parameters(layer, &shape)?;
        self.push(&name, shape.clone(), Some(parameters));
        let matrix = vec![shape[0] as usize, source.units() as usize];
        self.project(layer, &source, &name, "weight", |weights| Ok(DraftKind::Dense(tensor(matrix, weights))))?;
        if layer.kind == "dense_rec" {
            let recurrent = self.last.clone().ok_or_else(|| layer.wrong("no layer"))?;
            let square = vec![shape[0] as usize; 2];
            if layer.numbers("weight_rec")?.len() as u64 != shape[0].saturating_mul(shape[0]) {
                return Err(layer.wrong("'weight_rec' is not square"));
            }
            // What SLAYER feeds back are the spikes of the step before, which is what a delay field of 0 means here. The
            // layer's own delay is for what follows it.
            let undelayed = Last { delays: Vec::new(), ..recurrent };
            self.project(layer, &undelayed, &name, "weight_rec", |weights| {
                Ok(DraftKind::Dense(tensor(square, weights)))
            })?;
        }
        self.delays(layer)
    }

    fn conv(&mut self, layer: &Layer<'_>) -> Result<(), Diagnostic> {
        let shape = volume(layer)?;
        let kernel = layer.axes("weight", 4)?;
        let &[out, per_group, kh, kw] = kernel.as_slice() else {
            return Err(layer.wrong(format!("a kernel {:?}", layer.numbers("weight")?.shape())));
        };
        let groups = layer.pair("groups", (1, 1), 1)?.0;
        let geometry = geometry(layer)?;
        let channels = per_group.saturating_mul(groups);
        let given = self.options.input_shape.clone();
        let source = self.source(|| input_of_window(layer, given, channels, &shape, (kh, kw), geometry))?;
        if out != shape[0] || source.shape.len() != 3 || source.shape[0] != channels {
            return Err(layer.wrong(format!(
                "a kernel {kernel:?} in {groups} groups does not lead from {:?} to {shape:?}",
                source.shape
            )));
        }
        let name = format!("layer{}", layer.number);
        let parameters = self.parameters(layer, &shape)?;
        self.push(&name, shape.clone(), Some(parameters));
        let axes: Vec<usize> = kernel.iter().map(|&axis| axis as usize).collect();
        let Geometry { stride, padding, dilation } = geometry;
        self.project(layer, &source, &name, "weight", |weights| {
            Ok(DraftKind::Conv2d { weights: tensor(axes, weights), stride, padding, dilation, groups })
        })?;
        self.delays(layer)
    }

    fn pool(&mut self, layer: &Layer<'_>) -> Result<(), Diagnostic> {
        let shape = volume(layer)?;
        let kernel = layer.pair("kernelSize", (1, 1), 1)?;
        let mut geometry = geometry(layer)?;
        if layer.group.get("stride").is_none() {
            geometry.stride = kernel;
        }
        let given = self.options.input_shape.clone();
        let source = self.source(|| input_of_window(layer, given, shape[0], &shape, kernel, geometry))?;
        if source.shape.len() != 3 || source.shape[0] != shape[0] {
            return Err(layer.wrong(format!("a pool from {:?} to {shape:?} changes the channels", source.shape)));
        }
        let name = format!("layer{}", layer.number);
        let parameters = self.parameters(layer, &shape)?;
        self.push(&name, shape.clone(), Some(parameters));
        let Geometry { stride, padding, dilation } = geometry;
        let (count, channels) = (layer.numbers("weight")?.len() as u64, shape[0]);
        let places = kernel.0 * kernel.1;
        self.project(layer, &source, &name, "weight", |weights| {
            let first = weights.first().copied().unwrap_or(0.0);
            if weights.iter().all(|&weight| weight == first) && !weights.is_empty() && dilation == (1, 1) {
                return Ok(DraftKind::SumPool2d { kernel, stride, padding, weight: first });
            }
            if count != places && Some(count) != places.checked_mul(channels) {
                return Err(layer.wrong(format!("{count} weights for a window of {places}")));
            }
            let expanded: Vec<f64> = weights.iter().copied().cycle().take((places * channels) as usize).collect();
            let axes = [channels, 1, kernel.0, kernel.1].map(|axis| axis as usize).to_vec();
            Ok(DraftKind::Conv2d { weights: tensor(axes, expanded), stride, padding, dilation, groups: channels })
        })?;
        self.delays(layer)
    }

    /// A transposed convolution, synapse by synapse: output `i * stride - padding + k * dilation` hears input `i` over
    /// the kernel's place `k` (torch, ConvTranspose; the kernel is `[in][out / groups][kh][kw]`).
    fn transposed(&mut self, layer: &Layer<'_>) -> Result<(), Diagnostic> {
        let shape = volume(layer)?;
        let geometry = geometry(layer)?;
        let source = self.source(|| {
            Err(Diagnostic::new("import.unsupported", "a network that begins with a transposed convolution"))
        })?;
        let &[channels, height, width] = source.shape.as_slice() else {
            return Err(layer.wrong(format!("the layer before it has the shape {:?}", source.shape)));
        };
        let pooled = layer.kind == "unpool";
        let (groups, per_group, kh, kw) = if pooled {
            let kernel = layer.pair("kernelSize", (1, 1), 1)?;
            (channels, 1, kernel.0, kernel.1)
        } else {
            let kernel = layer.axes("weight", 4)?;
            let &[from, per_group, kh, kw] = kernel.as_slice() else {
                return Err(layer.wrong(format!("a kernel {kernel:?}")));
            };
            if from != channels {
                return Err(layer.wrong(format!("a kernel {kernel:?} for {channels} channels")));
            }
            (layer.pair("groups", (1, 1), 1)?.0, per_group, kh, kw)
        };
        let mut geometry = geometry;
        if pooled && layer.group.get("stride").is_none() {
            geometry.stride = (kh, kw);
        }
        if channels % groups != 0 || per_group.checked_mul(groups) != Some(shape[0]) {
            return Err(layer.wrong(format!("{groups} groups do not lead from {channels} channels to {}", shape[0])));
        }
        let many = [channels, height, width, per_group, kh, kw].iter().try_fold(1u64, |n, &axis| n.checked_mul(axis));
        if many.is_none_or(|many| many > MOST_LISTED) {
            return Err(layer.unsupported(
                format!("it would have more than {MOST_LISTED} synapses, which are listed one by one"),
                "a transposed convolution has no compact form here",
            ));
        }
        let name = format!("layer{}", layer.number);
        let parameters = self.parameters(layer, &shape)?;
        self.push(&name, shape.clone(), Some(parameters));
        let weights_there = layer.numbers("weight")?.len() as u64;
        let kernel_size = if pooled { kh * kw } else { channels * per_group * kh * kw };
        if weights_there != kernel_size && !(pooled && weights_there == kernel_size * channels) {
            return Err(layer.wrong(format!("{weights_there} weights for a kernel of {kernel_size}")));
        }
        self.project(layer, &source, &name, "weight", |weights| {
            let mut synapses = Vec::new();
            let place = |i: u64, stride: u64, k: u64, dilation: u64, padding: u64, size: u64| {
                (i * stride + k * dilation).checked_sub(padding).filter(|&o| o < size)
            };
            for c in 0..channels {
                let group = c / (channels / groups);
                for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
                    for (o, ky, kx) in
                        (0..per_group).flat_map(|o| (0..kh).flat_map(move |ky| (0..kw).map(move |kx| (o, ky, kx))))
                    {
                        let to_y = place(y, geometry.stride.0, ky, geometry.dilation.0, geometry.padding.0, shape[1]);
                        let to_x = place(x, geometry.stride.1, kx, geometry.dilation.1, geometry.padding.1, shape[2]);
                        let (Some(to_y), Some(to_x)) = (to_y, to_x) else { continue };
                        let at = ((c * per_group + o) * kh + ky) * kw + kx;
                        let weight = weights[(at % weights_there) as usize];
                        let from = (c * height + y) * width + x;
                        let to = ((group * per_group + o) * shape[1] + to_y) * shape[2] + to_x;
                        synapses.push((from, to, weight));
                    }
                }
            }
            Ok(DraftKind::Sparse(synapses))
        })?;
        self.delays(layer)
    }

    /// The mean over groups of equal size is a read-out: integrators whose voltage counts what its group spiked.
    fn average(&mut self, layer: &Layer<'_>) -> Result<(), Diagnostic> {
        let source = self.last.clone().ok_or_else(|| layer.wrong("there is nothing before it"))?;
        let outputs = units(&layer.shape()?).unwrap_or(0);
        if outputs == 0 || source.units() % outputs != 0 || source.units() > MOST_LISTED {
            return Err(layer.wrong(format!("{outputs} means of {} units", source.units())));
        }
        let name = format!("layer{}", layer.number);
        self.notes.push(format!(
            "layer {}: means become integrators that never spike; v / 128 is the number of spikes of a group of {}",
            layer.number,
            source.units() / outputs
        ));
        self.push(&name, vec![outputs], Some(integrator(4096.0, 0.0)));
        let size = source.units() / outputs;
        let synapses = (0..source.units()).map(|unit| (unit, unit / size, 2.0)).collect();
        self.connect(layer, &source, &name, DraftKind::Sparse(synapses), 0, crate::base::fixed::SignMode::Mixed)
    }

    /// Neuron parameters of a layer of compartments, its bias included.
    fn parameters(&mut self, layer: &Layer<'_>, shape: &[u64]) -> Result<Vec<(&'static str, Value)>, Diagnostic> {
        let mut parameters = match layer.group.group("neuron") {
            Some(_) => self.neuron(layer, shape)?,
            None => {
                self.notes.push(format!(
                    "layer {}: no neuron, so an integrator without leak (u keeps all, v shows u) that never spikes",
                    layer.number
                ));
                integrator(0.0, 4096.0)
            }
        };
        if layer.group.get("bias").is_some() {
            let given = layer.reals("bias")?;
            let whole: Vec<f64> = given.iter().map(|x| x.trunc()).collect();
            let cut = given.iter().zip(&whole).filter(|(a, b)| a != b).count();
            if cut > 0 {
                self.notes.push(format!("layer {}: {cut} biases are not whole and lose their fraction", layer.number));
            }
            let biases = self.each(layer, "bias", whole, shape)?;
            match biases {
                Value::Same(0.0) => {}
                Value::Same(bias) => set_bias(&mut parameters, vec![bias]),
                Value::Each(biases) => set_bias(&mut parameters, biases),
            }
        }
        Ok(parameters)
    }

    /// One number for all, one a channel or one a unit.
    fn each(&self, layer: &Layer<'_>, key: &str, numbers: Vec<f64>, shape: &[u64]) -> Result<Value, Diagnostic> {
        let count = numbers.len() as u64;
        let all = units(shape).unwrap_or(u64::MAX);
        let value = Value::of(numbers);
        match value {
            Value::Same(_) if count >= 1 && (count == 1 || count == shape[0] || count == all) => Ok(value),
            Value::Each(numbers) if count == all => Ok(Value::Each(numbers)),
            Value::Each(numbers) if count == shape[0] => {
                let expanded = self.expanded.get().saturating_add(all);
                self.expanded.set(expanded);
                if expanded > MOST_EXPANDED {
                    return Err(layer.unsupported(
                        format!("'{key}' of each channel becomes {all} numbers"),
                        "at most 4,194,304 numbers are made of those that a file gives by channel",
                    ));
                }
                let per_channel = (all / shape[0]) as usize;
                Ok(Value::Each(numbers.into_iter().flat_map(|x| std::iter::repeat_n(x, per_channel)).collect()))
            }
            _ => Err(layer.wrong(format!("'{key}' has {count} numbers for the shape {shape:?}"))),
        }
    }

    fn neuron(&mut self, layer: &Layer<'_>, shape: &[u64]) -> Result<Vec<(&'static str, Value)>, Diagnostic> {
        let Some(kind) = layer.group.text("neuron/type") else {
            return Err(layer.wrong("its neuron does not say its type"));
        };
        let missing = match kind {
            "CUBA" => None,
            "LOIHI" => {
                self.slayer_time = true;
                None
            }
            "ALIF" => Some("an adaptive threshold and a refractory state (thDecay, refDecay, vThStep)"),
            "SDNN" => Some("sigma-delta neurons with graded spikes"),
            other if other.starts_with("RF") || other.starts_with("ADRF") => {
                Some("resonate-and-fire neurons with a complex state (sinDecay, cosDecay)")
            }
            _ => Some("this neuron"),
        };
        if let Some(missing) = missing {
            return Err(layer.unsupported(
                format!("its neuron is '{kind}'; a Loihi 1 compartment does not have {missing}"),
                "networks of CUBA and LOIHI neurons are imported",
            ));
        }
        if layer.group.number("neuron/gradedSpike").is_some_and(|graded| graded != 0.0) {
            return Err(layer.unsupported("its spikes are graded", "spikes of a Loihi 1 core carry no value"));
        }
        let mut parameters = Vec::new();
        for (ours, theirs, range) in [
            ("du", "iDecay", 0.0..=4096.0),
            ("dv", "vDecay", 0.0..=4096.0),
            ("vth_mant", "vThMant", 0.0..=NEVER),
            ("refractory", "refDelay", 0.0..=63.0),
        ] {
            let key = format!("neuron/{theirs}");
            if ours == "refractory" && layer.group.get(&key).is_none() {
                continue;
            }
            let numbers = layer.reals(&key)?;
            if let Some(x) = numbers.iter().find(|x| x.fract() != 0.0 || !range.contains(*x)) {
                return Err(layer.wrong(format!("{theirs} is {x}, outside {} to {}", range.start(), range.end())));
            }
            let value = self.each(layer, theirs, numbers, shape)?;
            if ours != "refractory" || value != Value::Same(1.0) {
                parameters.push((ours, value));
            }
        }
        Ok(parameters)
    }

    /// The projection from the layer before, with its weights in a format that holds them.
    fn project(
        &mut self,
        layer: &Layer<'_>,
        source: &Last,
        to: &str,
        key: &str,
        kind: impl FnOnce(Vec<f64>) -> Result<DraftKind, Diagnostic>,
    ) -> Result<(), Diagnostic> {
        // netx reads weights as integers, toward zero.
        let given = layer.reals(key)?;
        let whole: Vec<f64> = given.iter().map(|x| x.trunc() + 0.0).collect();
        let cut = given.iter().zip(&whole).filter(|(a, b)| a != b).count();
        if cut > 0 {
            self.notes.push(format!(
                "layer {}: {cut} numbers of '{key}' are not whole and lose their fraction",
                layer.number
            ));
        }
        let exponent =
            ["neuron/wgtExp", "neuron/weight_exp"].iter().find_map(|key| layer.group.number(key)).unwrap_or(0.0);
        if exponent.fract() != 0.0 || !(-8.0..=7.0).contains(&exponent) {
            return Err(layer.wrong(format!("a weight exponent of {exponent}, outside -8 to 7")));
        }
        let encoded = encode::encode(whole, exponent as i64);
        if encoded.changed > 0 {
            self.notes.push(format!(
                "layer {}: {} of {} numbers of '{key}' fit no synapse format; they are rounded to even steps and clipped",
                layer.number,
                encoded.changed,
                given.len()
            ));
        }
        let kind = kind(encoded.weights)?;
        self.connect(layer, source, to, kind, encoded.exponent, encoded.sign)
    }

    /// Adds a projection, or one for each delay that its sources or synapses have.
    fn connect(
        &mut self,
        layer: &Layer<'_>,
        source: &Last,
        to: &str,
        kind: DraftKind,
        weight_exp: i64,
        sign: crate::base::fixed::SignMode,
    ) -> Result<(), Diagnostic> {
        let add = |draft: &mut Draft, kind, delay| {
            let projection =
                DraftProjection { delay, weight_exp, sign, ..DraftProjection::new(&source.name, to, kind) };
            draft.projections.push(projection);
        };
        let first = source.delays.first().copied().unwrap_or(0);
        let synaptic = self.synaptic_delays(layer, source)?;
        if synaptic.is_none() && source.delays.iter().all(|&delay| delay == first) {
            add(&mut self.draft, kind, first);
            return Ok(());
        }
        let synapses =
            list(&kind, source, self.draft.population(to).map_or(&[][..], |p| &p.shape)).ok_or_else(|| {
                layer.unsupported(
                    format!(
                        "its delays differ, so its synapses are listed one by one, and it has more than {MOST_LISTED}"
                    ),
                    "give all units of the layer before it one delay",
                )
            })?;
        let delay_of = |from: u64, target: u64| {
            let axonal = source.delays.get(from as usize).copied().unwrap_or(0);
            let own = synaptic.as_ref().map_or(0, |delays| delays[(target * source.units() + from) as usize]);
            axonal + own
        };
        let mut by_delay: std::collections::BTreeMap<u32, Vec<(u64, u64, f64)>> = std::collections::BTreeMap::new();
        for synapse in synapses {
            by_delay.entry(delay_of(synapse.0, synapse.1)).or_default().push(synapse);
        }
        if let Some((&longest, _)) = by_delay.last_key_value().filter(|&(&delay, _)| f64::from(delay) > LONGEST_DELAY) {
            return Err(layer.unsupported(format!("a delay of {longest} steps"), "the delay field holds 0 to 62"));
        }
        for (delay, synapses) in by_delay {
            add(&mut self.draft, DraftKind::Sparse(synapses), delay);
        }
        Ok(())
    }

    /// Whole delays of the file, each at most 62.
    fn delay_numbers(&self, layer: &Layer<'_>) -> Result<Option<Vec<u32>>, Diagnostic> {
        if layer.group.get("delay").is_none() {
            return Ok(None);
        }
        let floors: Vec<f64> = layer.reals("delay")?.iter().map(|x| x.floor()).collect();
        match floors.iter().find(|delay| !(0.0..=LONGEST_DELAY).contains(*delay)) {
            Some(delay) => Err(layer.unsupported(
                format!("a delay of {delay} steps"),
                "the delay field holds 0 to 62; train with max_delay=62",
            )),
            None => Ok(Some(floors.iter().map(|&delay| delay as u32).collect())),
        }
    }

    /// Delays of the layer's own synapses: `[target][source]`, or of its inputs.
    fn synaptic_delays(&self, layer: &Layer<'_>, source: &Last) -> Result<Option<Vec<u32>>, Diagnostic> {
        let Some(delays) = self.delay_numbers(layer)? else { return Ok(None) };
        let (targets, sources) = (self.last.as_ref().map_or(0, Last::units), source.units());
        let count = delays.len() as u64;
        if layer.kind == "average" || count <= 1 || self.is_axonal(count) {
            return Ok(None);
        }
        if targets.checked_mul(sources) == Some(count) {
            return Ok(Some(delays));
        }
        if count == sources && targets.checked_mul(sources).is_some_and(|all| all <= MOST_LISTED) {
            return Ok(Some((0..targets).flat_map(|_| delays.iter().copied()).collect()));
        }
        Err(layer.wrong(format!("{count} delays for {sources} sources and {targets} targets")))
    }

    /// Whether so many delays are those of the layer's own spikes: one a channel or a unit.
    fn is_axonal(&self, count: u64) -> bool {
        self.last.as_ref().is_some_and(|last| count == last.shape[0] || count == last.units())
    }

    /// Keeps the delays of the layer's spikes for the layer that follows.
    fn delays(&mut self, layer: &Layer<'_>) -> Result<(), Diagnostic> {
        let Some(delays) = self.delay_numbers(layer)? else { return Ok(()) };
        let count = delays.len() as u64;
        if count != 1 && !self.is_axonal(count) {
            return Ok(());
        }
        let expanded =
            match self.each(layer, "delay", delays.iter().map(|&d| f64::from(d)).collect(), &self.last_shape())? {
                Value::Same(delay) => vec![delay as u32],
                Value::Each(delays) => delays.into_iter().map(|delay| delay as u32).collect(),
            };
        if let Some(last) = &mut self.last {
            last.delays = expanded;
        }
        Ok(())
    }

    fn last_shape(&self) -> Vec<u64> {
        self.last.as_ref().map_or_else(Vec::new, |last| last.shape.clone())
    }

    fn finish(mut self) -> Result<Imported, Diagnostic> {
        let Some(last) = self.last.take().filter(|_| self.depth > 0) else {
            return Err(wrong("it has no layer of neurons"));
        };
        self.draft.output = last.name;
        if !last.delays.is_empty() && last.delays.iter().any(|&delay| delay != 0) {
            self.notes.push("the delay of the last layer's spikes has no reader and is left out".to_string());
        }
        self.draft.threshold = self.options.threshold.unwrap_or_default();
        if self.draft.threshold == ThresholdTest::Inclusive {
            self.notes.push("a neuron spikes at v >= threshold, as in SLAYER 2; the chip compares with >".to_string());
        }
        // Layer k hears layer k - 1 a step later; in SLAYER's time all begin together at step 1.
        let first = self.options.first_step.or_else(|| {
            let staggered = self.slayer_time || self.options.reset_interval.is_some() || self.options.image.is_some();
            staggered.then_some(u32::from(self.slayer_time || self.options.image.is_some()))
        });
        match first {
            Some(first) => {
                for population in self.draft.populations.iter_mut().filter(|p| p.loihi.is_some()) {
                    population.start_step += first;
                }
                self.notes
                    .push(format!("layer k of compartments starts at step k + {first}, its bias and resets with it"));
            }
            None => {
                self.draft.populations.iter_mut().for_each(|population| population.start_step = 0);
                self.notes
                    .push("chip time: every layer runs from step 0, one step of delay between layers".to_string());
            }
        }
        if let Some(interval) = self.options.reset_interval {
            self.draft.reset = Some(ResetDesc { interval: interval.into(), offset: self.options.reset_offset.into() });
        }
        self.draft.provenance = Some(format!("imported from a lava-dl netx file; {}", self.notes.join("; ")));
        Ok(Imported { kind: "lava-dl netx", draft: self.draft, notes: self.notes })
    }
}

/// Compartments that sum and never spike.
fn integrator(du: f64, dv: f64) -> Vec<(&'static str, Value)> {
    vec![("du", Value::Same(du)), ("dv", Value::Same(dv)), ("vth_mant", Value::Same(NEVER))]
}

fn set_bias(parameters: &mut Vec<(&'static str, Value)>, biases: Vec<f64>) {
    parameters.push(("bias_mant", Value::of(biases)));
    parameters.push(("bias_exp", Value::Same(BIAS_EXP)));
}

/// The layer's shape as channels, height, width.
fn volume(layer: &Layer<'_>) -> Result<Vec<u64>, Diagnostic> {
    let shape = layer.shape()?;
    if shape.len() == 3 { Ok(shape) } else { Err(layer.wrong(format!("a shape {shape:?} without height and width"))) }
}

fn geometry(layer: &Layer<'_>) -> Result<Geometry, Diagnostic> {
    Ok(Geometry {
        stride: layer.pair("stride", (1, 1), 1)?,
        padding: layer.pair("padding", (0, 0), 0)?,
        dilation: layer.pair("dilation", (1, 1), 1)?,
    })
}

/// The input that a first layer with a window must have: given, or told by the window when its step is 1.
fn input_of_window(
    layer: &Layer<'_>,
    given: Option<Vec<u64>>,
    channels: u64,
    shape: &[u64],
    kernel: (u64, u64),
    geometry: Geometry,
) -> Result<Vec<u64>, Diagnostic> {
    if let Some(given) = given {
        return Ok(given);
    }
    let side = |out: u64, kernel: u64, padding: u64, dilation: u64| {
        (out + dilation * (kernel - 1)).checked_sub(2 * padding).filter(|&side| side > 0)
    };
    let height = side(shape[1], kernel.0.max(1), geometry.padding.0, geometry.dilation.0);
    let width = side(shape[2], kernel.1.max(1), geometry.padding.1, geometry.dilation.1);
    match (geometry.stride, height, width) {
        ((1, 1), Some(height), Some(width)) => Ok(vec![channels, height, width]),
        _ => Err(Diagnostic::new(
            "import.option",
            format!(
                "layer {} ({}) is the first, and the file does not say how large its input is",
                layer.number, layer.kind
            ),
        )
        .help("add --input-shape CHANNELS,HEIGHT,WIDTH")),
    }
}

/// The synapses of a projection one by one, unless there are too many.
fn list(kind: &DraftKind, source: &Last, target: &[u64]) -> Option<Vec<(u64, u64, f64)>> {
    let within = |many: Option<u64>| many.is_some_and(|many| many <= MOST_LISTED);
    match kind {
        DraftKind::Sparse(synapses) => Some(synapses.clone()),
        DraftKind::Dense(weights) => {
            let sources = source.units();
            let all = weights.len() as u64;
            within(Some(all))
                .then(|| (0..all).map(|at| (at % sources, at / sources, weights.real(at as usize))).collect())
        }
        DraftKind::Conv2d { weights, stride, padding, dilation, groups } => {
            let geometry = Geometry { stride: *stride, padding: *padding, dilation: *dilation };
            windowed(weights, geometry, *groups, &source.shape, target)
        }
        DraftKind::SumPool2d { kernel, stride, padding, weight } => {
            let geometry = Geometry { stride: *stride, padding: *padding, dilation: (1, 1) };
            let channels = *source.shape.first()?;
            let places = channels.checked_mul(kernel.0)?.checked_mul(kernel.1)?;
            if !within(Some(places)) {
                return None;
            }
            let axes = [channels, 1, kernel.0, kernel.1].map(|axis| axis as usize).to_vec();
            let weights = tensor(axes, vec![*weight; places as usize]);
            windowed(&weights, geometry, channels, &source.shape, target)
        }
    }
}

/// The synapses of a convolution one by one.
fn windowed(
    weights: &Tensor,
    geometry: Geometry,
    groups: u64,
    source: &[u64],
    target: &[u64],
) -> Option<Vec<(u64, u64, f64)>> {
    let (&[channels, height, width], &[_, out_h, out_w]) = (source, target) else { return None };
    let all = (weights.len() as u64).checked_mul(out_h)?.checked_mul(out_w)?;
    if all > MOST_LISTED || groups == 0 {
        return None;
    }
    let &[out, per_group, kh, kw] = weights.shape() else { return None };
    let (per_group_out, per_group_in) = ((out as u64 / groups).max(1), channels / groups);
    let mut synapses = Vec::new();
    for (at, weight) in (0..weights.len()).map(|at| (at, weights.real(at))) {
        let (kx, ky) = ((at % kw) as u64, (at / kw % kh) as u64);
        let (within, o) = ((at / (kw * kh) % per_group) as u64, (at / (kw * kh * per_group)) as u64);
        let channel = o / per_group_out * per_group_in + within;
        for (oy, ox) in (0..out_h).flat_map(|oy| (0..out_w).map(move |ox| (oy, ox))) {
            let y = (oy * geometry.stride.0 + ky * geometry.dilation.0).checked_sub(geometry.padding.0);
            let x = (ox * geometry.stride.1 + kx * geometry.dilation.1).checked_sub(geometry.padding.1);
            if let (Some(y), Some(x)) = (y.filter(|&y| y < height), x.filter(|&x| x < width)) {
                synapses.push(((channel * height + y) * width + x, (o * out_h + oy) * out_w + ox, weight));
            }
        }
    }
    Some(synapses)
}

/// An image as one number from 0 to 1 for each unit of `[channels, height, width]`: an array `[height, width]`,
/// `[height, width, channels]` or `[channels, height, width]`; 8-bit integers count 255ths.
fn image(path: &std::path::Path, shape: &[u64]) -> Result<Vec<f64>, Diagnostic> {
    let array = npy::open(path)?;
    let scale = if array.dtype().ends_with("u1") { 255.0 } else { 1.0 };
    let tensor = array.tensor()?;
    let axes: Vec<u64> = tensor.shape().iter().map(|&axis| axis as u64).collect();
    let (channels, height, width) = match *shape {
        [channels, height, width] => (channels, height, width),
        _ => (1, 1, shape.iter().product()),
    };
    let real = |index: u64| tensor.real(index as usize) / scale;
    let channels_last = axes == [height, width, channels];
    if channels_last || axes == [channels, height, width] || (channels == 1 && axes == [height, width]) || axes == shape
    {
        let place = |c: u64, p: u64| if channels_last { p * channels + c } else { c * height * width + p };
        return Ok((0..channels)
            .flat_map(|c| (0..height * width).map(move |p| (c, p)))
            .map(|(c, p)| real(place(c, p)))
            .collect());
    }
    Err(Diagnostic::new("import.image", format!("the image is {axes:?}, the input layer is {shape:?}"))
        .help("an image is [height, width, channels] or [channels, height, width]")
        .in_file(path))
}
