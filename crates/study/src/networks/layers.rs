//! Builds layered networks for the benches.
//!
//! Input: the size of an input, then the layers in order. Output: a [`Builder`] with a population
//! for each. Weights are random (`base::rng`); more of them are positive than negative, so that
//! every layer keeps firing.

use crate::networks::builder::Builder;
use nsim_ir::base::fixed::OutOfRange;
use nsim_ir::base::id::PopulationId;
use nsim_ir::base::rng;
use nsim_ir::graph::Window;
use nsim_ir::quantised::connectivity::Connectivity;

/// A network that is built layer by layer.
pub(crate) struct Layers {
    /// The network so far.
    pub net: Builder,
    last: PopulationId,
    size: (u32, u32, u32),
    seed: u64,
    /// Threshold mantissa of the next layers.
    pub threshold: i64,
}

impl Layers {
    /// An input of `size`: channels, rows, columns.
    pub fn new(name: &str, size: (u32, u32, u32)) -> Self {
        let mut net = Builder::new(name);
        let last = net.input("input", size.0 * size.1 * size.2);
        net.over_space(size.0, size.1, size.2);
        Layers { net, last, size, seed: 10, threshold: 60 }
    }

    /// Adds a layer of this size; returns the previous layer and the new one.
    fn next(&mut self, size: (u32, u32, u32)) -> Result<(PopulationId, PopulationId), OutOfRange> {
        self.seed += 1;
        let name = format!("layer{}", self.seed - 10);
        let id = self.net.loihi(&name, size.0 * size.1 * size.2, self.threshold, 1)?;
        if size.1 * size.2 > 1 {
            self.net.over_space(size.0, size.1, size.2);
        }
        self.size = size;
        Ok((std::mem::replace(&mut self.last, id), id))
    }

    fn window(&self, to: u32, kernel: u32, stride: u32, padding: u32, groups: u32) -> Window {
        let reach = |source: u32| (source + 2 * padding - kernel) / stride + 1;
        let (_, h, w) = self.size;
        Window {
            source: self.size,
            target: (to, reach(h), reach(w)),
            kernel: (kernel, kernel),
            stride: (stride, stride),
            padding: (padding, padding),
            dilation: (1, 1),
            groups,
        }
    }

    /// Adds convolutions with random weights: (channels, kernel, stride, padding) of each.
    pub fn convolve(&mut self, layers: &[(u32, u32, u32, u32)]) -> Result<(), OutOfRange> {
        layers.iter().try_for_each(|&(channels, kernel, stride, padding)| {
            self.convolve_window(self.window(channels, kernel, stride, padding, 1))
        })
    }

    /// Adds a depthwise convolution.
    pub fn convolve_each(&mut self, kernel: u32, padding: u32) -> Result<(), OutOfRange> {
        self.convolve_window(self.window(self.size.0, kernel, 1, padding, self.size.0))
    }

    fn convolve_window(&mut self, window: Window) -> Result<(), OutOfRange> {
        let ends = self.next(window.target)?;
        let weights =
            u64::from(window.target.0 * (window.source.0 / window.groups) * window.kernel.0 * window.kernel.1);
        // 20 positive and 12 negative levels, so that layers keep firing.
        let weight = |index| -24 + 2 * rng::below(33, self.seed, index, 0) as i16;
        let kernel = (0..weights).map(weight).collect();
        self.net.connect(ends.0, ends.1, 0, Connectivity::Conv2d { window, kernel })
    }

    /// Adds a layer of sums of windows without overlap.
    pub fn pool(&mut self, side: u32) -> Result<(), OutOfRange> {
        let window = self.window(self.size.0, side, side, 0, self.size.0);
        let ends = self.next(window.target)?;
        self.net.connect(ends.0, ends.1, 0, Connectivity::SumPool2d { window, weight: 80 })
    }

    /// Adds layers of these sizes, each dense from the previous one.
    pub fn dense(&mut self, sizes: &[u32]) -> Result<(), OutOfRange> {
        sizes.iter().try_for_each(|&units| {
            let ends = self.next((units, 1, 1))?;
            self.net.dense(ends, -24, 40, self.seed)
        })
    }
}
