//! MLP-GRU and CNN-3D.
//!
//! Input: spikes of each sense. Output: a score for each class. MLP-GRU: in each timestep a dense
//! layer encodes each sense; gated recurrent units take both, and their last state is read out.
//! CNN-3D: events are summed in [`BINS`] bins of time. Two convolutions and a dense layer encode
//! each sense; the readout takes both.

use candle_core::{DType, Device, Result, Tensor, Var};
use candle_nn::VarBuilder;
use candle_nn::rnn::{GRU, GRUConfig, RNN, gru};

use super::layers::{Convolution, Dense, Weights, halved, kernel_of, tensor};
use nsim_ir::base::names::named_variants;
use nsim_train::fit::Example;

/// Units of each encoder, and of the recurrent layer.
pub const HIDDEN: usize = 32;
/// Number of time bins of a CNN-3D.
pub const BINS: usize = 32;
/// Channels of the two convolutions.
const CHANNELS: [usize; 2] = [8, 16];

/// A kind of network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AnnKind {
    /// Dense layers and gated recurrent units.
    MlpGru,
    /// Convolutions over time and space.
    Cnn3d,
}

// Names of the paper.
named_variants!(AnnKind { MlpGru = "MLP-GRU", Cnn3d = "CNN-3D" });

/// Input and output sizes of a network.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Senses {
    /// Channels, rows and columns of each sense; a line of channels is one row.
    pub shapes: Vec<(usize, usize, usize)>,
    /// Timesteps of the longest sample.
    pub steps: usize,
    /// Number of classes.
    pub classes: usize,
}

enum Body {
    Recurrent(Vec<Dense>, GRU),
    Convolving(Vec<([Convolution; 2], Dense)>),
}

/// A network.
pub struct Ann {
    senses: Senses,
    body: Body,
    readout: Dense,
    weights: Weights,
}

/// Sizes of a plane over time after each of two convolutions: (steps, rows, columns).
fn sizes((rows, columns): (usize, usize)) -> [(usize, usize, usize); 2] {
    let half = |(t, r, c): (usize, usize, usize)| (halved(t), halved(r), halved(c));
    let first = half((BINS, rows, columns));
    [first, half(first)]
}

impl Ann {
    /// A network with random weights.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn new(kind: AnnKind, senses: &Senses, seed: u64) -> Result<Self> {
        let mut weights = Weights::new(seed);
        let together = HIDDEN * senses.shapes.len();
        let body = match kind {
            AnnKind::MlpGru => {
                let dense = senses.shapes.iter().enumerate().map(|(sense, &(channels, rows, columns))| {
                    Dense::new(&mut weights, &format!("encoder{sense}"), channels * rows * columns, HIDDEN)
                });
                let dense = dense.collect::<Result<Vec<_>>>()?;
                for (name, shape) in [
                    ("gru.weight_ih_l0", vec![3 * HIDDEN, together]),
                    ("gru.weight_hh_l0", vec![3 * HIDDEN, HIDDEN]),
                    ("gru.bias_ih_l0", vec![3 * HIDDEN]),
                    ("gru.bias_hh_l0", vec![3 * HIDDEN]),
                ] {
                    weights.draw(name, &shape, HIDDEN)?;
                }
                let drawn = VarBuilder::from_varmap(&weights.all, DType::F32, &Device::Cpu);
                Body::Recurrent(dense, gru(together, HIDDEN, GRUConfig::default(), drawn.pp("gru"))?)
            }
            AnnKind::Cnn3d => {
                let stacks = senses.shapes.iter().enumerate().map(|(sense, &(channels, rows, columns))| {
                    let [(_, r, c), last] = sizes((rows, columns));
                    let name = |layer| format!("encoder{sense}.{layer}");
                    let first = Convolution::new(&mut weights, &name(0), (channels, CHANNELS[0]), (rows, columns))?;
                    let second = Convolution::new(&mut weights, &name(1), (CHANNELS[0], CHANNELS[1]), (r, c))?;
                    let features = CHANNELS[1] * last.0 * last.1 * last.2;
                    Ok(([first, second], Dense::new(&mut weights, &name(2), features, HIDDEN)?))
                });
                Body::Convolving(stacks.collect::<Result<Vec<_>>>()?)
            }
        };
        let from = if kind == AnnKind::MlpGru { HIDDEN } else { together };
        let readout = Dense::new(&mut weights, "readout", from, senses.classes)?;
        Ok(Ann { senses: senses.clone(), body, readout, weights })
    }

    /// Trained variables, by name.
    pub fn variables(&self) -> Vec<Var> {
        // Sorted by name, as the order of a hash map differs between runs.
        let all = self.weights.all.data().lock();
        let mut named: Vec<(String, Var)> =
            all.map(|all| all.iter().map(|(name, var)| (name.clone(), var.clone())).collect()).unwrap_or_default();
        named.sort_by(|a, b| a.0.cmp(&b.0));
        named.into_iter().map(|(_, var)| var).collect()
    }

    /// Number of trained parameters.
    pub fn parameters(&self) -> u64 {
        self.variables().iter().map(|var| var.elem_count() as u64).sum()
    }

    /// Number of multiplications by weights for a sample.
    pub fn operations(&self) -> u64 {
        let Senses { shapes, steps, classes } = &self.senses;
        let together = HIDDEN * shapes.len();
        let count = match &self.body {
            Body::Recurrent(..) => {
                let encoders: usize = shapes.iter().map(|(c, h, w)| c * h * w * HIDDEN).sum();
                steps * (encoders + 3 * HIDDEN * (together + HIDDEN)) + HIDDEN * classes
            }
            Body::Convolving(_) => {
                let of_sense = |&(channels, rows, columns): &(usize, usize, usize)| {
                    let [first, last] = sizes((rows, columns));
                    let of = |(t, r, c): (usize, usize, usize), from, to, (kr, kc): (usize, usize)| {
                        t * r * c * to * from * 3 * kr * kc
                    };
                    of(first, channels, CHANNELS[0], (kernel_of(rows), kernel_of(columns)))
                        + of(last, CHANNELS[0], CHANNELS[1], (kernel_of(first.1), kernel_of(first.2)))
                        + CHANNELS[1] * last.0 * last.1 * last.2 * HIDDEN
                };
                shapes.iter().map(of_sense).sum::<usize>() + together * classes
            }
        };
        count as u64
    }

    /// Events of one sense, summed in this many bins: `[samples, bins, units]`.
    fn binned(&self, samples: &[&Example], sense: usize, bins: usize) -> Result<Tensor> {
        let (channels, rows, columns) = self.senses.shapes[sense];
        let units = channels * rows * columns;
        let mut values = vec![0f32; samples.len() * bins * units];
        for (index, example) in samples.iter().enumerate() {
            for (step, unit) in example.inputs[sense].events() {
                let bin = (step as usize * bins / self.senses.steps.max(1)).min(bins - 1);
                values[(index * bins + bin) * units + unit as usize] += 1.0;
            }
        }
        tensor(values, &[samples.len(), bins, units])
    }

    /// Scores of the classes, `[samples, classes]`.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn forward(&self, samples: &[&Example]) -> Result<Tensor> {
        match &self.body {
            Body::Recurrent(encoders, cells) => {
                let steps = self.senses.steps;
                let of_sense = |(sense, encoder): (usize, &Dense)| {
                    let x = self.binned(samples, sense, steps)?.flatten(0, 1)?;
                    encoder.forward(&x)?.relu()?.reshape((samples.len(), steps, HIDDEN))
                };
                let seen = encoders.iter().enumerate().map(of_sense).collect::<Result<Vec<_>>>()?;
                let states = cells.seq(&Tensor::cat(&seen, 2)?)?;
                match states.last() {
                    Some(last) => self.readout.forward(last.h()),
                    None => self.readout.forward(&Tensor::zeros((samples.len(), HIDDEN), DType::F32, &Device::Cpu)?),
                }
            }
            Body::Convolving(stacks) => {
                let of_sense = |(sense, (layers, dense)): (usize, &([Convolution; 2], Dense))| {
                    let (channels, rows, columns) = self.senses.shapes[sense];
                    let x = self.binned(samples, sense, BINS)?;
                    let mut x = x.reshape((samples.len(), BINS, channels, rows, columns))?;
                    for layer in layers {
                        x = layer.forward(&x)?.relu()?;
                    }
                    dense.forward(&x.flatten_from(1)?)?.relu()
                };
                let seen = stacks.iter().enumerate().map(of_sense).collect::<Result<Vec<_>>>()?;
                self.readout.forward(&Tensor::cat(&seen, 1)?)
            }
        }
    }
}
