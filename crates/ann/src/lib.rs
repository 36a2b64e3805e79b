//! Networks without spikes, trained on equal samples: the baselines of Taunyazov et al. 2020.
//!
//! Input: labelled samples, a kind of network, settings. Output: its accuracy on samples that it
//! was not trained on, its parameters, operations and time a sample. On one machine a seed gives
//! one network: initial weights and the order of samples are functions of it. Sums are
//! floating-point numbers, whose last digits another processor may round otherwise.
//!
//! The paper names MLP-GRU (Cho et al. 2014) and CNN-3D (Gandarias et al. 2019), trained with
//! cross-entropy, and prints neither their sizes nor their kernels. These are chosen here: each
//! sense has an encoder of [`HIDDEN`] units as the spiking networks have. Adam takes the place of
//! RMSProp. Errors: as the deep-learning crate (`candle`), such as a tensor that exceeds memory.

pub mod layers;
pub mod networks;

use std::time::Instant;

use candle_core::{D, DType, Device, Result, Tensor};
use candle_nn::{AdamW, Optimizer, ParamsAdamW};

pub use self::networks::{AnnKind, HIDDEN, Senses};

use self::networks::Ann;
use nsim_ir::base::rng;
use nsim_train::fit::Example;

/// Samples in an untimed batch, and most samples that are timed.
const AT_ONCE: usize = 32;

/// Settings of a training.
#[derive(Debug, Clone, Copy)]
pub struct AnnSettings {
    /// Passes over the samples.
    pub epochs: u32,
    /// Samples in a minibatch.
    pub batch: usize,
    /// Learning rate.
    pub rate: f64,
    /// Seed of initial weights and of the order of samples.
    pub seed: u64,
}

/// Measures of a trained network.
#[derive(Debug, Clone, PartialEq)]
pub struct AnnResult {
    /// Fraction of the test samples with the right class, 0..=1.
    pub accuracy: f64,
    /// Number of trained parameters.
    pub parameters: u64,
    /// Number of multiplications by weights for a sample.
    pub operations: u64,
    /// Median latency of one sample in microseconds, with samples run sequentially.
    pub latency_us: f64,
    /// Mean loss of each epoch.
    pub losses: Vec<f64>,
}

/// Classes of these samples, by the greatest output.
fn classified(network: &Ann, samples: &[&Example]) -> Result<Vec<u32>> {
    network.forward(samples)?.argmax(D::Minus1)?.to_vec1()
}

/// Trains a network and tests it; `after` is called after each epoch.
///
/// # Errors
/// Errors of candle.
pub fn trained(
    (kind, senses): (AnnKind, &Senses),
    (train, test): (&[&Example], &[&Example]),
    settings: AnnSettings,
    mut after: impl FnMut(f64),
) -> Result<AnnResult> {
    let device = Device::Cpu;
    let network = Ann::new(kind, senses, settings.seed)?;
    let params = ParamsAdamW { lr: settings.rate, weight_decay: 0.0, ..ParamsAdamW::default() };
    let mut optimiser = AdamW::new(network.variables(), params)?;
    let mut losses = Vec::new();
    for epoch in 0..settings.epochs {
        let mut order: Vec<usize> = (0..train.len()).collect();
        order.sort_by_key(|&sample| (rng::below(1 << 48, settings.seed, sample as u64, u64::from(epoch)), sample));
        let mut sum = 0.0;
        for chunk in order.chunks(settings.batch.max(1)) {
            let batch: Vec<&Example> = chunk.iter().map(|&sample| train[sample]).collect();
            let labels: Vec<u32> = batch.iter().map(|example| example.label).collect();
            let labels = Tensor::from_vec(labels, batch.len(), &device)?;
            let loss = candle_nn::loss::cross_entropy(&network.forward(&batch)?, &labels)?;
            sum += f64::from(loss.to_dtype(DType::F32)?.to_scalar::<f32>()?) * batch.len() as f64;
            optimiser.backward_step(&loss)?;
        }
        losses.push(sum / train.len().max(1) as f64);
        after(sum / train.len().max(1) as f64);
    }
    let mut right = 0;
    for chunk in test.chunks(AT_ONCE) {
        let classes = classified(&network, chunk)?;
        right += classes.iter().zip(chunk).filter(|(class, example)| **class == example.label).count();
    }
    let mut times = Vec::new();
    for example in test.iter().take(AT_ONCE) {
        let begin = Instant::now();
        classified(&network, &[*example])?;
        times.push(begin.elapsed().as_secs_f64() * 1e6);
    }
    times.sort_unstable_by(f64::total_cmp);
    Ok(AnnResult {
        accuracy: right as f64 / test.len().max(1) as f64,
        parameters: network.parameters(),
        operations: network.operations(),
        latency_us: times.get(times.len() / 2).copied().unwrap_or_default(),
        losses,
    })
}
