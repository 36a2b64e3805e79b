//! The training loop. Minibatches run on threads; their gradients are summed in the order of
//! samples, for one step each.
//!
//! A [`Forward`] runs the samples: the trained neurons themselves, or their deployed form. The
//! gradient is taken at its potentials and spikes, through the trained neurons' responses.
//!
//! Everything random is a function of (seed, entity, epoch), sums have a fixed order, and
//! [`TrainingState`] is all that one epoch passes to the next. So results depend neither on threads
//! nor on interruptions.

use std::convert::Infallible;

use rayon::prelude::*;

use super::augment::vary;
use super::cells::Spiking;
use super::loss::Loss;
use super::network::{Deployed, Topology, Weights, Workspace};
use super::optimiser::{Moments, Optimiser};
use super::raster::Raster;
use nsim_files::training::AugmentDesc;
use nsim_ir::base::folds::permutation;
use nsim_ir::base::rng;
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::Sample;

/// A labelled sample.
#[derive(Debug, Clone, PartialEq)]
pub struct Example {
    /// Spikes of each input population.
    pub inputs: Vec<Raster>,
    /// Its class.
    pub label: u32,
}

impl Example {
    /// A sample as the inputs of a network; none without a label.
    pub fn from_sample(network: &Quantised, sample: &Sample) -> Option<Example> {
        let inputs = network.inputs().map(|(_, population)| {
            let units = population.shape.len();
            let first = population.first_channel().map_or(0, |channel| channel.0);
            let within = |step| {
                let units = sample.at(step).iter().filter_map(move |channel| channel.0.checked_sub(first));
                units.filter(move |&unit| unit < population.shape.len()).map(move |unit| (step, unit))
            };
            let events = (0..sample.steps()).flat_map(within).collect();
            Raster::from_events(units as usize, sample.steps() as usize, events)
        });
        Some(Example { inputs: inputs.collect(), label: sample.label()? })
    }
}

/// The forward pass while a network is trained.
pub trait Forward: Sync {
    /// The network that runs, with the weights of a minibatch.
    type Network: Sync;
    /// The reason for which weights have no network.
    type Error;

    /// The network with these weights.
    ///
    /// # Errors
    /// Where the weights have no such network.
    fn network(&self, weights: &Weights) -> Result<Self::Network, Self::Error>;

    /// Runs a sample and fills [`Workspace::traces`] of all layers, in the trained network's time.
    fn run(&self, network: &Self::Network, deployed: &Deployed, inputs: &[Raster], work: &mut Workspace);
}

/// The trained neurons, run without another form.
impl Forward for Topology {
    type Network = ();
    type Error = Infallible;

    fn network(&self, _: &Weights) -> Result<(), Infallible> {
        Ok(())
    }

    fn run(&self, (): &(), deployed: &Deployed, inputs: &[Raster], work: &mut Workspace) {
        self.forward(deployed, inputs, Spiking::Hard, work);
    }
}

/// Settings of a training.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Sizes and neurons.
    pub topology: Topology,
    /// The objective.
    pub loss: Loss,
    /// Rule by which gradients change the weights.
    pub optimiser: Optimiser,
    /// Learning rate of each layer at the first step.
    pub rates: Vec<f32>,
    /// Fraction of the learning rate kept at the last step; it falls as half a cosine.
    pub last_rate: f32,
    /// Samples in a minibatch.
    pub batch: usize,
    /// Passes over the examples.
    pub epochs: u32,
    /// Data augmentation.
    pub augment: AugmentDesc,
    /// Probability with which a unit of a hidden layer is dropped from a sample, 0..=0.99.
    pub dropout: f32,
    /// Decay of the deployed moving average of the weights; 0 deploys the weights themselves.
    pub averaging: f32,
    /// Half the range of the uniform initial weights of each layer, in units of `1 / sqrt(fan-in)`.
    pub initial: Vec<f32>,
    /// The seed.
    pub seed: u64,
}

/// The state of a training after an epoch.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainingState {
    /// Epochs done.
    pub epoch: u32,
    /// Trained weights.
    pub weights: Weights,
    /// Their running mean.
    pub average: Weights,
    /// The optimiser's moments.
    pub moments: Moments,
    /// One row an epoch.
    pub history: Vec<EpochRow>,
}

/// Measures of an epoch.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct EpochRow {
    /// The epoch, from 1.
    pub epoch: u32,
    /// Mean loss over its (varied) samples while it ran.
    pub loss: f64,
    /// Fraction of these samples with the right class while it ran, 0..=1.
    pub accuracy: f64,
}

/// Streams of the plan's seed.
const INITIAL: u64 = 1 << 32;
const ORDER: u64 = 2 << 32;
const VARY: u64 = 3;
const DROPOUT: u64 = 4;

impl Plan {
    /// The state before the first epoch, with initial weights.
    pub fn start(&self) -> TrainingState {
        let mut weights = self.topology.zeros();
        for (index, (layer, weights)) in self.topology.layers.iter().zip(&mut weights).enumerate() {
            let bound = f64::from(self.initial[index]) / (layer.fan_in as f64).sqrt();
            for (i, w) in weights.iter_mut().enumerate() {
                *w = (bound * (2.0 * rng::unit(self.seed, INITIAL + index as u64, i as u64) - 1.0)) as f32;
            }
        }
        self.start_from(weights)
    }

    /// The state before the first epoch, with given weights.
    pub fn start_from(&self, weights: Weights) -> TrainingState {
        let zeros = self.topology.zeros();
        let moments = Moments { first: zeros.clone(), second: zeros, steps: 0 };
        TrainingState { epoch: 0, average: weights.clone(), weights, moments, history: Vec::new() }
    }

    /// Runs one epoch over the examples, with the trained network or its deployed form.
    ///
    /// # Errors
    /// Where the weights have no such network; the epoch is then unfinished.
    pub fn epoch<F: Forward>(
        &self,
        forward: &F,
        state: &mut TrainingState,
        examples: &[Example],
        workers: &mut Vec<Workspace>,
    ) -> Result<(), F::Error> {
        let epoch = u64::from(state.epoch);
        let order = permutation(examples.len(), self.seed, ORDER + epoch);
        workers.resize_with(self.batch.min(examples.len()), || Workspace::new(&self.topology));
        let batches = examples.len().div_ceil(self.batch);
        let whole = f64::from(self.epochs) * batches as f64;
        let mut sum = self.topology.zeros();
        let (mut loss, mut right) = (0.0, 0usize);
        for batch in order.chunks(self.batch) {
            let deployed = self.topology.deploy(&state.weights, Spiking::Hard);
            let network = forward.network(&state.weights)?;
            let results: Vec<(f64, bool)> = batch
                .par_iter()
                .zip(&mut *workers)
                .map(|(&index, work)| {
                    self.sample((forward, &network, &deployed), &examples[index], index as u64, epoch, work)
                })
                .collect();
            for gradient in &mut sum {
                gradient.fill(0.0);
            }
            for ((sample_loss, sample_right), work) in results.iter().zip(&*workers) {
                loss += sample_loss;
                right += usize::from(*sample_right);
                for (sum, gradient) in sum.iter_mut().zip(&work.gradient) {
                    sum.iter_mut().zip(gradient).for_each(|(sum, g)| *sum += g);
                }
            }
            let share = 1.0 / batch.len() as f32;
            sum.iter_mut().flatten().for_each(|g| *g *= share);
            let done = state.moments.steps as f64 / whole.max(1.0);
            let cosine = 0.5 * (1.0 + libm::cos(std::f64::consts::PI * done.min(1.0))) as f32;
            let factor = self.last_rate + (1.0 - self.last_rate) * cosine;
            let rates: Vec<f32> = self.rates.iter().map(|rate| rate * factor).collect();
            self.optimiser.step(&rates, &mut state.weights, &sum, &mut state.moments);
            self.keep_in_range(&mut state.weights);
            // In the first steps the mean is over the steps taken so far.
            let keep = self.averaging.min(1.0 - 1.0 / (state.moments.steps as f32));
            for (average, weights) in state.average.iter_mut().zip(&state.weights) {
                average.iter_mut().zip(weights).for_each(|(a, w)| *a += (1.0 - keep) * (w - *a));
            }
        }
        state.epoch += 1;
        let samples = examples.len().max(1) as f64;
        state.history.push(EpochRow { epoch: state.epoch, loss: loss / samples, accuracy: right as f64 / samples });
        Ok(())
    }

    /// Clamps weights to the range of the mantissa, where the gradient can still move them.
    fn keep_in_range(&self, weights: &mut Weights) {
        for (layer, weights) in self.topology.layers.iter().zip(weights) {
            if let Some(m) = &layer.mantissas {
                let (low, high) = (-256.0 / m.scale, 254.0 / m.scale);
                weights.iter_mut().for_each(|w| *w = w.clamp(low, high));
            }
        }
    }

    /// Picks the dropped units of a sample; factors keep the mean (Srivastava et al.: JMLR 2014).
    fn drop_units(&self, index: u64, epoch: u64, work: &mut Workspace) {
        work.factors.clear();
        if self.dropout == 0.0 {
            return;
        }
        let (seed, scale) = (rng::bits(self.seed, DROPOUT, epoch), 1.0 / (1.0 - self.dropout));
        let hidden = &self.topology.layers[..self.topology.layers.len() - 1];
        work.factors.extend(hidden.iter().zip(0u64..).map(|(layer, number)| {
            let drawn = |unit: u64| rng::unit(seed, index, number << 32 | unit) < f64::from(self.dropout);
            (0..layer.cells.count() as u64).map(|unit| if drawn(unit) { 0.0 } else { scale }).collect()
        }));
    }

    fn sample<F: Forward>(
        &self,
        (forward, network, deployed): (&F, &F::Network, &Deployed),
        example: &Example,
        index: u64,
        epoch: u64,
        work: &mut Workspace,
    ) -> (f64, bool) {
        let varied;
        let inputs = match self.augment == AugmentDesc::default() {
            true => &example.inputs,
            false => {
                varied = vary(&self.augment, &example.inputs, rng::bits(self.seed, VARY, 0), index, epoch);
                &varied
            }
        };
        self.drop_units(index, epoch, work);
        forward.run(network, deployed, inputs, work);
        let loss = work.evaluate(&self.loss, example.label);
        let right = self.loss.class(work.output()) == Some(example.label);
        self.topology.backward(deployed, inputs, work);
        (loss, right)
    }

    /// The deployed weights.
    pub fn result<'a>(&self, state: &'a TrainingState) -> &'a Weights {
        if self.averaging > 0.0 { &state.average } else { &state.weights }
    }

    /// The output spikes and the class of each example.
    pub fn outputs(&self, weights: &Weights, examples: &[Example]) -> Vec<(Raster, Option<u32>)> {
        let deployed = self.topology.deploy(weights, Spiking::Hard);
        let run = |work: &mut Workspace, example: &Example| {
            self.topology.forward(&deployed, &example.inputs, Spiking::Hard, work);
            (work.output().spikes.clone(), self.loss.class(work.output()))
        };
        examples.par_iter().map_init(|| Workspace::new(&self.topology), run).collect()
    }

    /// The fraction of the examples with the right class, 0..=1.
    pub fn accuracy(&self, weights: &Weights, examples: &[Example]) -> f64 {
        let outputs = self.outputs(weights, examples);
        let right = outputs.iter().zip(examples).filter(|((_, class), example)| *class == Some(example.label)).count();
        right as f64 / examples.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::planned;

    #[test]
    fn dropout_keeps_the_mean_and_is_drawn_by_sample_and_epoch() {
        let text = "Training(name: \"x\", timestep_ms: 1, inputs: [(name: \"a\", shape: [5])],
            layers: [(name: \"h\", from: [\"a\"], size: 500), (name: \"o\", from: [\"h\"], size: 3)],
            neuron: Loihi(tau_u_ms: Same(3), tau_v_ms: Same(5), weight_scale: 16, theta: 10),
            loss: SpikeCount(right: 6, wrong: 1), optimiser: Adam(rate: 1), dropout: 0.4, batch: 1, epochs: 1, seed: 7)";
        let plan = planned(text);
        let mut work = Workspace::new(&plan.topology);
        let mut drawn = |sample, epoch| {
            plan.drop_units(sample, epoch, &mut work);
            work.factors.clone()
        };
        let first = drawn(1, 2);
        assert_eq!((first.len(), first[0].len()), (1, 500), "outputs are never left out");
        let dropped = first[0].iter().filter(|factor| **factor == 0.0).count();
        assert!((150..250).contains(&dropped), "{dropped}");
        assert!((first[0].iter().sum::<f32>() / 500.0 - 1.0).abs() < 0.15);
        assert_eq!(drawn(1, 2), first);
        assert!(drawn(2, 2) != first && drawn(1, 3) != first);
        let none = Plan { dropout: 0.0, ..plan.clone() };
        none.drop_units(1, 2, &mut work);
        assert!(work.factors.is_empty());
    }
}
