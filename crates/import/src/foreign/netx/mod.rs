//! Networks that lava-dl exports for its netx (`.net`, HDF5).
//!
//! Input: the tree of a file. Output: a model with one population per layer, in the order of the
//! layers' numbers. `iDecay` is the effective decay of the current, the threshold is `vThMant`
//! times 64, a bias is a mantissa with exponent 6 (lava-dl d825ac5, `netx/hdf5.py`,
//! `netx/blocks/models.py`). Kernels are cross-correlated as stored; volumes are flattened in the
//! order C, H, W. A network in chip time has one step between layers. A network with the older
//! neuron type `LOIHI` is in SLAYER's time, in which layer k starts at step k + 1.
//!
//! Not imported: neurons with other dynamics, graded spikes before the last layer, concatenation.

pub mod export;
mod kinds;
mod layer;
mod neuron;
mod projection;
mod reader;

use std::cell::Cell;

use super::imported::{Format, Imported, Options, name_list, wrong_option};
use super::nir::unmodified_model;
use crate::foreign::nir::export::restore;
use crate::hdf5::{Group, Numbers};
use layer::Layer;
use neuron::set_bias;
use nsim_files::network::{NetworkFile, ProjectionDesc, ProjectionKind};
use nsim_files::npy;
use nsim_ir::arithmetic::{ResetDesc, ThresholdTest};
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::fixed::SignMode;
use nsim_ir::base::warning::{Warning, WarningCode};
use nsim_ir::neurons::NeuronKind;
use reader::{DEFAULT_BITS, Neurons, Reader, units, wrong};

/// Reads the tree of a file.
pub fn read(root: &Group, name: &str, options: &Options) -> Result<Imported> {
    let mut notes = Vec::new();
    let written = restore(root, export::GROUP, ["layer", "simulation"], "layers", export::export);
    if let Some(Ok(_)) = &written {
        options.check(Format::Nsim)?;
    }
    if let Some(imported) = unmodified_model("lava-dl netx", written, options, &mut notes)? {
        return Ok(imported);
    }
    let layers = layers(root)?;
    let dt_ms = options.reading.dt_ms.or_else(|| root.number("simulation/Ts")).unwrap_or(1.0);
    let mut reader = Reader {
        options,
        model: NetworkFile::new(name, dt_ms),
        notes,
        warnings: Vec::new(),
        layers: Vec::new(),
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
fn layers(root: &Group) -> Result<Vec<(u32, &Group)>> {
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

/// The fields of a layer type (`docs/import.md` describes each); empty for a type that is not
/// imported.
fn fields(kind: &str) -> Vec<&'static str> {
    let own = match kind {
        "flatten" | "average" => "",
        "input" => "neuron weight bias messageBits",
        "dense" => "neuron weight bias delay inFeatures outFeatures messageBits",
        "dense_rec" | "recurrent" => "neuron weight weight_rec recWeight bias delay inFeatures outFeatures messageBits",
        "pool" | "unpool" => "neuron weight bias delay kernelSize stride padding dilation",
        "conv" | "convT" => {
            "neuron weight bias delay kernelSize stride padding dilation groups inChannels outChannels messageBits"
        }
        _ => return Vec::new(),
    };
    ["type", "shape"].into_iter().chain(own.split_whitespace()).collect()
}

impl Reader<'_> {
    fn layer(&mut self, number: u32, group: &Group) -> Result<()> {
        let Some(kind) = group.text("type") else {
            let members: Vec<&str> = group.items.keys().take(8).map(String::as_str).collect();
            return Err(wrong(format!(
                "field 'type' of layer {number} is missing; the layer holds {}",
                name_list(&members)
            )));
        };
        let layer = Layer { number, kind: kind.to_string(), group };
        if layer.is_complex() != layer.group.text("neuron/type").is_some_and(|kind| kind.contains("RF_"))
            || layer.is_complex() && kind != "dense"
        {
            return Err(layer.unsupported(
                "complex weights require resonate-and-fire neurons, which in turn require complex weights",
                "supported are dense layers with weight/real and weight/imag and neurons RF_* or ADRF_*",
            ));
        }
        let known = fields(kind);
        if let (false, Some(key)) = (known.is_empty(), group.items.keys().find(|key| !known.contains(&key.as_str()))) {
            return Err(layer.unsupported(
                format!("layers of type '{kind}' do not support field '{key}'"),
                "remove it if the network does not depend on it",
            ));
        }
        self.check_sizes(&layer)?;
        match kind {
            "input" => self.input(&layer),
            "flatten" => self.flatten(&layer),
            "dense" | "dense_rec" | "recurrent" => self.dense(&layer),
            "conv" => self.conv(&layer),
            "pool" => self.pool(&layer),
            "convT" | "unpool" => self.transposed(&layer),
            "average" => self.average(&layer),
            other => Err(layer.unsupported(
                format!("layers of type '{other}' are not supported"),
                "supported types: input, flatten, dense, dense_rec, recurrent, conv, pool, convT, unpool and average",
            )),
        }
    }

    fn input(&mut self, layer: &Layer<'_>) -> Result<()> {
        if self.last.is_some() {
            return Err(layer.wrong("an input layer comes after another layer"));
        }
        let shape = layer.shape()?;
        let parameters = match layer.group.group("neuron") {
            Some(_) => Some(self.neuron(layer, &shape)?),
            None => None,
        };
        match (parameters, &self.options.image) {
            (Some(neurons), image) if neurons.kind != NeuronKind::Loihi => {
                if image.is_some() {
                    return Err(wrong_option("the input layer takes its image as --input of a run"));
                }
                self.encoder(shape, neurons);
            }
            (Some(Neurons { mut parameters, .. }), Some(path)) => {
                let (weight, bias) = (layer.scalar("weight", 64.0)?.trunc(), layer.scalar("bias", 0.0)?.trunc());
                let drive = image(path, &shape)?;
                // netx, `create_input`: an image of 0 to 1 becomes -weight to weight, rounded
                // toward zero.
                let biases = drive.iter().map(|x| (2.0 * weight * x - weight + bias).trunc()).collect();
                set_bias(&mut parameters, biases);
                self.notes.push(format!(
                    "layer {}: the image {} drives the bias of the input layer as 2 * {weight} * x - {weight} + {bias}",
                    layer.number,
                    path.display()
                ));
                self.push("input", shape, Some(parameters.into()));
            }
            (None, Some(_)) => {
                return Err(wrong_option("the input layer has no neurons, so an image cannot drive it"));
            }
            (parameters, None) => {
                if parameters.is_some() {
                    self.notes.push(format!(
                        "layer {}: an input layer with neurons, imported as spikes of those neurons; to drive them \
                         with an image give --image FILE.npy",
                        layer.number
                    ));
                    // Its recorded spikes are the input, and the layer after it is layer 0.
                }
                self.push("input", shape, None);
            }
        }
        Ok(())
    }

    /// Adds an input whose channels carry numbers, and the neurons that send their changes.
    fn encoder(&mut self, shape: Vec<u64>, neurons: Neurons) {
        self.push("input", shape.clone(), None);
        if let Some(input) = self.model.populations.last_mut() {
            // `message_bits` of 0 counts the encoder's messages as 1, not the numbers of the input.
            input.message_bits = neurons.message_bits.map(|bits| if bits == 0 { DEFAULT_BITS } else { bits });
        }
        let (one, none) = ((1, 1), (0, 0));
        let kind = match shape.len() {
            1 => ProjectionKind::Sparse((0..shape[0]).map(|unit| (unit, unit, 1.0)).collect()),
            _ => {
                ProjectionKind::SumPool2d { kernel: one, stride: one, padding: none, padding_after: none, weight: 1.0 }
            }
        };
        self.push("layer0", shape, Some(neurons));
        let own = ProjectionDesc { sign: Some(SignMode::Excitatory), ..ProjectionDesc::new("input", "layer0", kind) };
        self.model.projections.push(own);
    }

    /// Warns where a size that the file repeats differs from its arrays, the only sizes that netx
    /// reads. (Of a pool, the weights do not have the size of the window, so it is used.)
    fn check_sizes(&mut self, layer: &Layer<'_>) -> Result<()> {
        let all: f64 = layer.reals("shape").unwrap_or_default().iter().product();
        let last = self.last.as_ref();
        let kernel: Vec<f64> = match layer.kind.as_str() {
            "conv" | "convT" => layer.axes("weight", 4)?.iter().map(|&side| side as f64).collect(),
            _ => Vec::new(),
        };
        let weights = layer.group.numbers("weight").or(layer.group.numbers("weight/real"));
        let matrix = weights.map(|weights| weights.len() as f64 / all);
        for (key, right) in [
            ("outFeatures", vec![all]),
            ("inFeatures", last.map(|last| last.units() as f64).or(matrix).into_iter().collect()),
            ("outChannels", layer.reals("shape").unwrap_or_default().into_iter().take(1).collect()),
            ("inChannels", last.map(|last| last.shape[0] as f64).into_iter().collect()),
            ("kernelSize", kernel.into_iter().skip(2).collect()),
        ] {
            self.check_size(layer, key, &right);
        }
        Ok(())
    }

    pub(super) fn warn(&mut self, layer: &Layer<'_>, code: WarningCode, message: impl std::fmt::Display) {
        let message = format!("layer {} ({}): {message}", layer.number, layer.kind);
        self.warnings.push(Warning::of_network(code, message));
    }

    fn check_size(&mut self, layer: &Layer<'_>, key: &str, right: &[f64]) {
        let numbers: Vec<f64> = layer.group.numbers(key).into_iter().flat_map(Numbers::reals).collect();
        // One number is the height and the width of a kernel.
        if right.is_empty() || numbers.iter().zip(right).all(|(a, b)| a == b) {
            return;
        }
        let message = format!("{key} is {numbers:?}, the arrays have {right:?}: only the arrays count, as in netx");
        self.warn(layer, WarningCode::SizeIgnored, message);
    }

    fn flatten(&mut self, layer: &Layer<'_>) -> Result<()> {
        // Populations are flattened in the order C, H, W by the dense layer that follows.
        let Some(last) = &self.last else { return Err(layer.wrong("there is nothing before it")) };
        if layer.group.get("shape").is_some() && units(&layer.shape()?) != Some(last.units()) {
            let (shape, units) = (layer.shape()?, last.units());
            let message = format!("its shape is {shape:?}, but its input has {units} units, which count, as in netx");
            self.warn(layer, WarningCode::SizeIgnored, message);
        }
        Ok(())
    }

    fn finish(mut self) -> Result<Imported> {
        let Some(last) = self.last.take().filter(|_| self.depth > 0) else {
            return Err(wrong("it has no layer of neurons"));
        };
        self.model.output = last.name;
        if !last.delays.is_empty() && last.delays.iter().any(|&delay| delay != 0) {
            self.notes.push("nothing receives the last layer's spikes, so their delay is dropped".to_string());
        }
        self.model.threshold = self.options.threshold();
        if self.model.threshold == ThresholdTest::Inclusive {
            self.notes.push("a neuron spikes at v >= threshold, as in SLAYER 2; the chip compares with >".to_string());
        }
        // Layer k receives the spikes of layer k - 1 a step later; in SLAYER's time all layers
        // begin at step 1.
        let first = self.options.first_step.or_else(|| {
            let staggered = self.slayer_time || self.options.reset_interval.is_some() || self.options.image.is_some();
            staggered.then_some(u32::from(self.slayer_time || self.options.image.is_some()))
        });
        match first {
            Some(first) => {
                // In SLAYER all layers respond in one step; here each takes a step.
                self.model.drain = self.depth - 1;
                for population in self.model.populations.iter_mut().filter(|p| p.loihi.is_some()) {
                    population.start_step += first;
                }
                self.notes.push(format!(
                    "layer k of compartments starts at step k + {first}, and so do its bias and its resets"
                ));
            }
            None => {
                self.model.populations.iter_mut().for_each(|population| population.start_step = 0);
                self.notes
                    .push("chip time: every layer runs from step 0, one step of delay between layers".to_string());
            }
        }
        let exponents = [("--spike-exp", self.options.spike_exp), ("--state-exp", self.options.state_exp)];
        if let Some((name, _)) = exponents.iter().find(|(_, given)| given.is_some())
            && !self.model.populations.iter().any(|p| [NeuronKind::SigmaDelta, NeuronKind::Delta].contains(&p.kind))
        {
            let message = format!("{name} applies only to networks with SDNN neurons");
            return Err(wrong_option(message).help("leave it out"));
        }
        if let Some(interval) = self.options.reset_interval {
            self.model.reset = Some(ResetDesc { interval: interval.into(), offset: self.options.reset_offset.into() });
        }
        if self.model.populations.iter().any(|population| !population.kind.table().registers) {
            self.model.target = Some("oheo-gulch".to_string());
        }
        let imported = Imported::new("lava-dl netx", self.model, self.notes).with_warnings(self.warnings);
        let imported = imported.with_decision(self.options.decision).with_provenance("a lava-dl netx file");
        Ok(Imported { layers: self.layers, ..imported })
    }
}

/// An image as a number from 0 to 1 for each unit of `[channels, height, width]`. The file is an
/// array `[height, width]`, `[height, width, channels]` or `[channels, height, width]`. 8-bit
/// unsigned integers are 255ths, other numbers are from 0 to 1.
fn image(path: &std::path::Path, shape: &[u64]) -> Result<Vec<f64>> {
    let array = npy::open(path)?;
    let scale = if array.dtype().ends_with("u1") { 255.0 } else { 1.0 };
    let tensor = array.tensor()?;
    if let Some(outside) = tensor.reals().find(|real| !(0.0..=scale).contains(real)) {
        let message =
            format!("{outside} is not a brightness: an image has 8-bit unsigned integers, or numbers from 0 to 1");
        return Err(Diagnostic::new("import.image", message)
            .help("divide the image by its greatest possible value, or store it as uint8")
            .in_file(path));
    }
    let axes: Vec<u64> = tensor.shape().iter().map(|&axis| axis as u64).collect();
    let (channels, height, width) = match *shape {
        [channels, height, width] => (channels, height, width),
        _ => (1, 1, shape.iter().product()),
    };
    let channels_last = axes == [height, width, channels];
    if channels_last || axes == [channels, height, width] || (channels == 1 && axes == [height, width]) || axes == shape
    {
        let pixels = (0..channels).flat_map(|c| (0..height * width).map(move |p| (c, p)));
        let places = pixels.map(|(c, p)| if channels_last { p * channels + c } else { c * height * width + p });
        return Ok(places.map(|place| tensor.real(place as usize) / scale).collect());
    }
    Err(Diagnostic::new("import.image", format!("the image is {axes:?}, the input layer is {shape:?}"))
        .help("an image is [height, width, channels] or [channels, height, width]")
        .in_file(path))
}
