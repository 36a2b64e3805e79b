//! Layers with random weights from a seed.
//!
//! Input: sizes, a seed, activations. Output: activations. Weights and offsets begin uniformly
//! within 1 / sqrt(fan-in), as PyTorch's layers do.

use candle_core::{DType, Device, Result, Tensor, Var};
use candle_nn::VarMap;

use nsim_ir::base::rng;

/// Steps of a kernel of a convolution in time, and of its sides where there is more than one row or
/// column.
const REACH: usize = 3;

/// Random weights, by the order in which they are asked for.
pub struct Weights {
    /// All of them, by name.
    pub all: VarMap,
    seed: u64,
    drawn: u64,
}

impl Weights {
    /// Without any.
    pub fn new(seed: u64) -> Self {
        Weights { all: VarMap::new(), seed, drawn: 0 }
    }

    /// A tensor of weights with this many inputs.
    ///
    /// # Errors
    /// Those of the crate.
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

/// All to all, with an offset.
pub struct Dense {
    weights: Tensor,
    offset: Tensor,
}

impl Dense {
    /// A layer with random weights.
    ///
    /// # Errors
    /// Those of the crate.
    pub fn new(weights: &mut Weights, name: &str, from: usize, to: usize) -> Result<Self> {
        let offset = weights.draw(&format!("{name}.bias"), &[to], from)?;
        Ok(Dense { weights: weights.draw(&format!("{name}.weight"), &[to, from], from)?, offset })
    }

    /// `[rows, from]` to `[rows, to]`.
    ///
    /// # Errors
    /// Those of the crate.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        x.matmul(&self.weights.t()?)?.broadcast_add(&self.offset)
    }
}

/// A convolution over time, rows and columns, of three in each, which takes every second place.
/// Where there is one row, its kernels have one.
pub struct Convolution {
    /// `[to, 3 x from, rows, columns]`: the steps of a kernel one after the other.
    pub weights: Tensor,
    /// `[to]`.
    pub offset: Tensor,
}

/// What a convolution makes of this many places.
pub fn halved(places: usize) -> usize {
    places.div_ceil(2)
}

/// Rows or columns of a kernel.
pub fn kernel_of(places: usize) -> usize {
    if places == 1 { 1 } else { REACH }
}

impl Convolution {
    /// A layer with random weights, for planes of this many rows and columns.
    ///
    /// # Errors
    /// Those of the crate.
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

    /// `[samples, steps, from, rows, columns]` to
    /// `[samples, steps / 2, to, rows / 2, columns / 2]`, rounded up.
    ///
    /// The crate has convolutions over planes: the steps that a kernel sees are laid side by side
    /// as channels, which is the same sum.
    ///
    /// # Errors
    /// Those of the crate.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let (samples, steps, from, _, _) = x.dims5()?;
        let (to, _, kernel_rows, kernel_columns) = self.weights.dims4()?;
        let half = halved(steps);
        let padded = x.pad_with_zeros(1, 1, 2 * half - steps + 1)?;
        let taps = (0..REACH).map(|tap| {
            // Every second step from this one on: the one after the last is not looked at.
            let places: Vec<u32> = (0..half).map(|step| (2 * step + tap) as u32).collect();
            padded.index_select(&Tensor::from_vec(places, half, x.device())?, 1)
        });
        let taps = Tensor::cat(&taps.collect::<Result<Vec<_>>>()?, 2)?;
        let mut planes = taps.flatten(0, 1)?;
        for (dimension, kernel) in [(2, kernel_rows), (3, kernel_columns)] {
            // No more zeros than the last kernel covers: the crate's gradient has no room for them.
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

/// Numbers in tensors of 32 bits.
///
/// # Errors
/// Those of the crate.
pub fn tensor(values: Vec<f32>, shape: &[usize]) -> Result<Tensor> {
    Tensor::from_vec(values, shape, &Device::Cpu)?.to_dtype(DType::F32)
}
