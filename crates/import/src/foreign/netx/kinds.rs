//! Layers with weights, by kind, and averages.
//!
//! Input: a layer and the layer before it. Output: a population and the projection to it. Kernels
//! are cross-correlated as stored. Shapes and numbers of weights are checked before their use.

use super::layer::{Layer, geometry, input_of_window, volume};
use super::reader::{LastPopulation, Reader, units};
use crate::foreign::imported::integrator;
use crate::foreign::window::{MOST_LISTED, Sliding};
use nsim_files::network::{ProjectionKind, padding_after, tensor};
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::neurons::Port;

impl Reader<'_> {
    /// Adds the population of a layer; returns its name.
    fn neurons(&mut self, layer: &Layer<'_>, shape: &[u64]) -> Result<String> {
        let name = format!("layer{}", layer.number);
        let parameters = self.parameters(layer, shape)?;
        self.push(&name, shape.to_vec(), Some(parameters));
        Ok(name)
    }

    pub(super) fn dense(&mut self, layer: &Layer<'_>) -> Result<()> {
        let shape = vec![units(&layer.shape()?).ok_or_else(|| layer.wrong("a shape too large for memory"))?];
        let key = if layer.is_complex() { "weight/real" } else { "weight" };
        let axes = layer.axes(key, 2)?;
        let count = layer.numbers(key)?.len() as u64;
        let source = self.source(|| Ok(vec![count / shape[0].max(1)]))?;
        let fills = shape[0].checked_mul(source.units()) == Some(count);
        if !fills || !(axes.len() <= 1 || axes == [shape[0], source.units()]) {
            let (given, from, name) = (layer.numbers(key)?.shape(), source.units(), &source.name);
            let message = format!("weights {given:?} do not connect the {from} units of '{name}' to {}", shape[0]);
            return Err(layer.wrong(message));
        }
        let name = self.neurons(layer, &shape)?;
        let matrix = vec![shape[0] as usize, source.units() as usize];
        let imaginary = layer.is_complex().then_some(("weight/imag", Port::Second));
        for (key, port) in [(key, Port::First)].into_iter().chain(imaginary) {
            if layer.numbers(key)?.len() as u64 != count {
                return Err(layer.wrong(format!("'{key}' does not have {count} numbers")));
            }
            self.project(layer, &source, &name, key, |weights| ProjectionKind::Dense(tensor(matrix.clone(), weights)))?;
            if let Some(projection) = self.model.projections.last_mut() {
                projection.port = port;
            }
        }
        if layer.kind != "dense" {
            let recurrent = self.last.clone().ok_or_else(|| layer.wrong("no layer"))?;
            let (key, units) = (layer.recurrent_key()?, shape[0]);
            let axes = layer.axes(key, 2)?;
            let fills = Some(layer.numbers(key)?.len() as u64) == units.checked_mul(units);
            if !fills || !(axes.len() <= 1 || axes == [units, units]) {
                return Err(layer.wrong(format!("'{key}' {axes:?} does not connect the {units} units to each other")));
            }
            let square = vec![units as usize; 2];
            // SLAYER feeds back the spikes of the previous step, so the delay field is 0. The
            // layer's own delay applies to the next layer only.
            let undelayed = LastPopulation { delays: Vec::new(), ..recurrent };
            self.project(layer, &undelayed, &name, key, |weights| ProjectionKind::Dense(tensor(square, weights)))?;
        }
        self.delays(layer)
    }

    pub(super) fn conv(&mut self, layer: &Layer<'_>) -> Result<()> {
        let shape = volume(layer)?;
        let kernel = layer.axes("weight", 4)?;
        let &[out, per_group, kh, kw] = kernel.as_slice() else {
            return Err(layer.wrong(format!("a kernel {:?}", layer.numbers("weight")?.shape())));
        };
        let groups = layer.pair("groups", (1, 1), 1)?.0;
        let step @ [stride, padding, dilation] = geometry(layer, (1, 1))?;
        let channels = per_group.saturating_mul(groups);
        let input_shape = self.options.input_shape.clone();
        let source = self.source(|| input_of_window(layer, input_shape, channels, &shape, (kh, kw), step))?;
        if out != shape[0] || source.shape.len() != 3 || source.shape[0] != channels {
            return Err(layer.wrong(format!(
                "a kernel {kernel:?} in {groups} groups does not map {:?} to {shape:?}",
                source.shape
            )));
        }
        let name = self.neurons(layer, &shape)?;
        let axes: Vec<usize> = kernel.iter().map(|&axis| axis as usize).collect();
        self.project(layer, &source, &name, "weight", |weights| {
            let weights = tensor(axes, weights);
            ProjectionKind::Conv2d { weights, stride, padding, padding_after: padding, dilation, groups }
        })?;
        self.delays(layer)
    }

    pub(super) fn pool(&mut self, layer: &Layer<'_>) -> Result<()> {
        let shape = volume(layer)?;
        let kernel = layer.pair("kernelSize", (1, 1), 1)?;
        let step @ [stride, padding, dilation] = geometry(layer, kernel)?;
        let input_shape = self.options.input_shape.clone();
        let source = self.source(|| input_of_window(layer, input_shape, shape[0], &shape, kernel, step))?;
        if source.shape.len() != 3 || source.shape[0] != shape[0] {
            return Err(
                layer.wrong(format!("a pool from {:?} to {shape:?} changes the number of channels", source.shape))
            );
        }
        let name = self.neurons(layer, &shape)?;
        // SLAYER's pool appends (size mod window) silent rows and columns to an image that windows
        // do not fill. The layer's shape shows whether the network did so.
        let after = |axis: usize, window: u64, stride: u64, padding: u64, dilation: u64| {
            let size = source.shape[axis];
            let reach = dilation * (window - 1) + 1;
            padding_after(size, shape[axis], reach, stride, padding).min(padding + size % window)
        };
        let padding_after =
            (after(1, kernel.0, stride.0, padding.0, dilation.0), after(2, kernel.1, stride.1, padding.1, dilation.1));
        let (count, channels) = (layer.numbers("weight")?.len() as u64, shape[0]);
        let places = kernel.0 * kernel.1;
        if count != places && Some(count) != places.checked_mul(channels) {
            return Err(layer.wrong(format!("{count} weights for a window of {places}")));
        }
        self.project(layer, &source, &name, "weight", |weights| {
            let first = weights.first().copied().unwrap_or(0.0);
            if weights.iter().all(|&weight| weight == first) && !weights.is_empty() && dilation == (1, 1) {
                return ProjectionKind::SumPool2d { kernel, stride, padding, padding_after, weight: first };
            }
            let expanded: Vec<f64> = weights.iter().copied().cycle().take((places * channels) as usize).collect();
            let axes = [channels, 1, kernel.0, kernel.1].map(|axis| axis as usize).to_vec();
            let (weights, groups) = (tensor(axes, expanded), channels);
            ProjectionKind::Conv2d { weights, stride, padding, padding_after, dilation, groups }
        })?;
        self.delays(layer)
    }

    /// A transposed convolution, synapse by synapse: output `i * stride - padding + k * dilation`
    /// receives input `i` over the kernel's place `k` (torch, ConvTranspose; the kernel is
    /// `[in][out / groups][kh][kw]`).
    pub(super) fn transposed(&mut self, layer: &Layer<'_>) -> Result<()> {
        let shape = volume(layer)?;
        let [mut stride, padding, dilation] = geometry(layer, (1, 1))?;
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
        if pooled && layer.group.get("stride").is_none() {
            stride = (kh, kw);
        }
        if channels % groups != 0 || per_group.checked_mul(groups) != Some(shape[0]) {
            return Err(layer.wrong(format!("{groups} groups do not map {channels} channels to {}", shape[0])));
        }
        let axes = [
            (height, shape[1], kh, stride.0, dilation.0, padding.0),
            (width, shape[2], kw, stride.1, dilation.1, padding.1),
        ];
        for (from, to, size, stride, dilation, padding) in axes {
            // torch's `output_padding` adds less than a step.
            let least = ((from - 1) * stride + dilation * size.saturating_sub(1) + 1).saturating_sub(2 * padding);
            if !(least..least + stride.max(dilation)).contains(&to) {
                return Err(layer.wrong(format!("the window maps {from} to {least}, the shape {shape:?} has {to}")));
            }
        }
        // The window of a convolution from the target to the source (torch, ConvTranspose).
        let window = Sliding::new((&shape, &source.shape), (kh, kw), [stride, padding, dilation], groups);
        let Some(synapses) = window.and_then(Sliding::synapses) else {
            return Err(layer.unsupported(
                format!("it would have more than {MOST_LISTED} synapses, each of which is listed"),
                "a transposed convolution has no compact form here",
            ));
        };
        let name = self.neurons(layer, &shape)?;
        let weights_there = layer.numbers("weight")?.len() as u64;
        let kernel_size = if pooled { kh * kw } else { channels * per_group * kh * kw };
        if weights_there != kernel_size && !(pooled && weights_there == kernel_size * channels) {
            return Err(layer.wrong(format!("{weights_there} weights for a kernel of {kernel_size}")));
        }
        self.project(layer, &source, &name, "weight", |weights| {
            ProjectionKind::Sparse(synapses.map(|(to, from, at)| (from, to, weights[at % weights.len()])).collect())
        })?;
        self.delays(layer)
    }

    /// The mean over groups of equal size is a read-out: integrators whose voltage counts the
    /// spikes of a group.
    pub(super) fn average(&mut self, layer: &Layer<'_>) -> Result<()> {
        let source = self.last.clone().ok_or_else(|| layer.wrong("there is nothing before it"))?;
        let outputs = units(&layer.shape()?).unwrap_or(0);
        if outputs == 0 || source.units() % outputs != 0 || source.units() > MOST_LISTED as u64 {
            return Err(layer.wrong(format!("{outputs} means of {} units", source.units())));
        }
        let (number, size) = (layer.number, source.units() / outputs);
        let name = format!("layer{number}");
        self.notes.push(format!(
            "layer {number}: means become integrators that never spike; v / 128 is the number of spikes of a group of \
             {size} units"
        ));
        self.push(&name, vec![outputs], Some(integrator(4096.0, 0.0).into()));
        let synapses = (0..source.units()).map(|unit| (unit, unit / size, 2.0)).collect();
        self.connect(layer, &source, &name, ProjectionKind::Sparse(synapses), None, None)
    }
}
