//! Networks without spikes, trained on the same samples: what Taunyazov et al. 2020 compare spiking
//! networks with.
//!
//! Input: labelled samples, a kind of network, settings. Output: its accuracy on samples that it
//! was not trained on, its parameters, operations and time a sample. The same seed gives the same
//! network on the same machine: initial weights and the order of samples are functions of it; sums
//! are floating-point numbers, whose last digits another processor may round otherwise.
//!
//! The paper names MLP-GRU (Cho et al. 2014) and CNN-3D (Gandarias et al. 2019), trained with
//! cross-entropy, and prints neither their sizes nor their kernels; those are chosen here: each
//! sense has an encoder of [`HIDDEN`] units as the spiking networks have. Adam takes the place of
//! RMSProp. Errors: those of the deep-learning crate (`candle`), such as a tensor that memory does
//! not hold.

pub mod layers;
pub mod networks;

use std::time::Instant;

use candle_core::{D, DType, Device, Result, Tensor};
use candle_nn::{AdamW, Optimizer, ParamsAdamW};

pub use self::networks::{AnnKind, HIDDEN, Senses};

use self::networks::Ann;
use nsim_ir::base::rng;
use nsim_train::fit::Example;

/// Samples that are classified in one batch when nothing is timed.
const AT_ONCE: usize = 32;

/// How a network is trained.
#[derive(Debug, Clone, Copy)]
pub struct AnnSettings {
    /// Passes over the samples.
    pub epochs: u32,
    /// Samples of a step.
    pub batch: usize,
    /// Learning rate.
    pub rate: f64,
    /// Of initial weights and of the order of samples.
    pub seed: u64,
}

/// A trained network, as its results say.
#[derive(Debug, Clone, PartialEq)]
pub struct AnnResult {
    /// Share of the tested samples that it classifies as they are labelled.
    pub accuracy: f64,
    /// Trained numbers.
    pub parameters: u64,
    /// Multiplications of weights for a sample.
    pub operations: u64,
    /// Microseconds for one sample after the other: the median.
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
/// Those of the crate.
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
