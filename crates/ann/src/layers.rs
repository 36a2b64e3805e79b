//! Layers with random weights from a seed.
//!
//! Input: sizes, a seed, activations. Output: activations. Initial weights and offsets are uniform
//! within +-1 / sqrt(fan-in), as in PyTorch's layers.

use candle_core::{DType, Device, Result, Tensor, Var};
use candle_nn::VarMap;

use nsim_ir::base::rng;

/// Steps of a convolution's kernel in time, and its rows or columns if the plane has more than one.
const REACH: usize = 3;

/// Random weights; each tensor depends on the number of tensors sampled before it.
pub struct Weights {
    /// All weights, by name.
    pub all: VarMap,
    seed: u64,
    drawn: u64,
}

impl Weights {
    /// An empty collection.
    pub fn new(seed: u64) -> Self {
        Weights { all: VarMap::new(), seed, drawn: 0 }
    }

    /// A tensor of weights with this many inputs.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn draw(&mut self, name: &str, shape: &[usize], fan_in: usize) -> Result<Tensor> {
        let bound = 1.0 / (fan_in.max(1) as f64).sqrt();
        let count: usize = shape.iter().product();
        self.drawn += 1;
        let weight = |k: usize| (bound * (2.0 * rng::unit(self.seed, self.drawn, k as u64) - 1.0)) as f32;
        let var = Var::from_vec((0..count).map(weight).collect(), shape, &Device::Cpu)?;
        let tensor = var.as_tensor().clone();
        if let Ok(mut all) = self.all.data().lock() {
            all.insert(name.to_string(), var);
        }
        Ok(tensor)
    }
}

/// A dense layer with an offset.
pub struct Dense {
    weights: Tensor,
    offset: Tensor,
}

impl Dense {
    /// A layer with random weights.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn new(weights: &mut Weights, name: &str, from: usize, to: usize) -> Result<Self> {
        let offset = weights.draw(&format!("{name}.bias"), &[to], from)?;
        Ok(Dense { weights: weights.draw(&format!("{name}.weight"), &[to, from], from)?, offset })
    }

    /// Maps `[rows, from]` to `[rows, to]`.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        x.matmul(&self.weights.t()?)?.broadcast_add(&self.offset)
    }
}

/// A convolution over time, rows and columns, of kernel size 3 and stride 2. Over a single row its
/// kernels have one row.
pub struct Convolution {
    /// `[to, 3 x from, rows, columns]`: the kernel's steps are concatenated.
    pub weights: Tensor,
    /// `[to]`.
    pub offset: Tensor,
}

/// Output size of a convolution over this number of places.
pub fn halved(places: usize) -> usize {
    places.div_ceil(2)
}

/// Number of rows or columns of a kernel.
pub fn kernel_of(places: usize) -> usize {
    if places == 1 { 1 } else { REACH }
}

impl Convolution {
    /// A layer with random weights, for planes of this many rows and columns.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn new(
        weights: &mut Weights,
        name: &str,
        (from, to): (usize, usize),
        (rows, columns): (usize, usize),
    ) -> Result<Self> {
        let kernel = [to, REACH * from, kernel_of(rows), kernel_of(columns)];
        let fan_in: usize = kernel[1..].iter().product();
        let offset = weights.draw(&format!("{name}.bias"), &[to], fan_in)?;
        Ok(Convolution { weights: weights.draw(&format!("{name}.weight"), &kernel, fan_in)?, offset })
    }

    /// Maps `[samples, steps, from, rows, columns]` to
    /// `[samples, steps / 2, to, rows / 2, columns / 2]`, rounded up.
    ///
    /// candle has convolutions over planes only: the steps that a kernel covers become channels,
    /// with an equal sum.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let (samples, steps, from, _, _) = x.dims5()?;
        let (to, _, kernel_rows, kernel_columns) = self.weights.dims4()?;
        let half = halved(steps);
        let padded = x.pad_with_zeros(1, 1, 2 * half - steps + 1)?;
        let taps = (0..REACH).map(|tap| {
            // Every second step from this one on; the last padding step is not read.
            let places: Vec<u32> = (0..half).map(|step| (2 * step + tap) as u32).collect();
            padded.index_select(&Tensor::from_vec(places, half, x.device())?, 1)
        });
        let taps = Tensor::cat(&taps.collect::<Result<Vec<_>>>()?, 2)?;
        let mut planes = taps.flatten(0, 1)?;
        for (dimension, kernel) in [(2, kernel_rows), (3, kernel_columns)] {
            // No more zeros than the last kernel covers: candle's gradient does not support more.
            let places = planes.dim(dimension)?;
            let behind = 2 * (halved(places) - 1) + kernel - kernel / 2 - places;
            planes = planes.pad_with_zeros(dimension, kernel / 2, behind)?;
        }
        debug_assert_eq!(planes.dim(1)?, REACH * from);
        let out = planes.conv2d(&self.weights, 0, 2, 1, 1)?;
        let out = out.broadcast_add(&self.offset.reshape((1, to, 1, 1))?)?;
        let (_, _, rows, columns) = out.dims4()?;
        out.reshape((samples, half, to, rows, columns))
    }
}

/// A tensor of 32-bit numbers.
///
/// # Errors
/// Errors of candle.
pub fn tensor(values: Vec<f32>, shape: &[usize]) -> Result<Tensor> {
    Tensor::from_vec(values, shape, &Device::Cpu)?.to_dtype(DType::F32)
}
