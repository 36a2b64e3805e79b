//! Contents of a training file (`nsim train`; `docs/training.md` describes each field).
//!
//! `train::plan`, which has the whole file, checks the ranges of single numbers.

use serde::{Deserialize, Serialize};

use nsim_ir::arithmetic::ReadOut;
use nsim_ir::base::diagnostic::{Result, SourceText};
use nsim_ir::spanned::{Spanned, parse};

/// An input population.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InputDesc {
    /// Its name in the model.
    pub name: String,
    /// Its shape; the product is its number of channels.
    pub shape: Vec<u64>,
}

/// A dense layer.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LayerDesc {
    /// Its name in the model.
    pub name: String,
    /// Input populations and earlier layers, concatenated.
    pub from: Vec<String>,
    /// Number of neurons.
    pub size: u32,
    /// Its neurons, when they differ from the network's.
    pub neuron: Option<NeuronDesc>,
    /// Factor on the learning rate of its weights.
    #[serde(default = "one")]
    pub rate: f64,
    /// Range of the uniform initial weights, in units of `1 / sqrt(fan-in)` (slayerPytorch: 10).
    #[serde(default = "ten")]
    pub initial: f64,
}

fn one() -> f64 {
    1.0
}

fn ten() -> f64 {
    10.0
}

/// Time constants of a layer's neurons in ms.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum TimesDesc {
    /// One time constant for all neurons.
    Same(f64),
    /// First value, last value and number of values of a geometric series, cyclically over the
    /// neurons.
    Spread(f64, f64, u32),
}

/// The neurons of a layer.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum NeuronDesc {
    /// Spike-response neurons.
    Srm {
        /// Time constant of the response, in ms.
        tau_sr_ms: TimesDesc,
        /// Time constant of the refractory response, in ms.
        tau_ref_ms: f64,
        /// Size of the refractory response, in thresholds.
        scale_ref: f64,
        /// Threshold.
        theta: f64,
        /// Whether kernels are truncated as in SLAYER, instead of exact recursions.
        #[serde(default)]
        truncated: bool,
    },
    /// Compartments of a Loihi core.
    Loihi {
        /// Time constant of the current, in ms.
        tau_u_ms: TimesDesc,
        /// Time constant of the voltage, in ms.
        tau_v_ms: TimesDesc,
        /// A trained weight of 1 in mantissa units, from which the threshold mantissa follows.
        weight_scale: f64,
        /// The projection's weight exponent.
        #[serde(default)]
        weight_exp: i64,
        /// Refractory period in timesteps.
        #[serde(default = "one_step")]
        refractory: i64,
        /// Threshold in the units of the trained weights, scaled so that the response to a weight
        /// of 1 peaks at 1. `inf` is for outputs that are read out by their potential.
        theta: f64,
        /// Rule of credit assignment.
        #[serde(default)]
        credit: CreditDesc,
    },
    /// Resonate-and-fire neurons of Loihi 2, with real inputs.
    Rf {
        /// Period of the resonance, in ms.
        period_ms: TimesDesc,
        /// Time constant of its decay, in ms.
        tau_ms: TimesDesc,
        /// A trained weight of 1 in mantissa units.
        weight_scale: f64,
        /// Threshold of the real part in the units of the trained weights.
        theta: f64,
    },
    /// Neurons of Loihi 2 that send changes of their rectified sum.
    SigmaDelta {
        /// A trained weight of 1 in mantissa units.
        weight_scale: f64,
        /// The least change that is sent, in the units of the trained weights.
        theta: f64,
    },
    /// Neurons of Loihi 2 whose sum is read out.
    Sigma {
        /// A trained weight of 1 in mantissa units.
        weight_scale: f64,
    },
}

fn one_step() -> i64 {
    1
}

/// Propagation of errors through a neuron's own spikes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
pub enum CreditDesc {
    /// SLAYER's rule: the error at a step is correlated with the response kernel, regardless of
    /// spikes in between.
    #[default]
    Slayer,
    /// The correlation ends at the neuron's own spikes, which erase the voltage.
    UpToReset,
}

/// The loss.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum LossDesc {
    /// The spike-count loss.
    SpikeCount {
        /// Desired spikes of the right class.
        right: f64,
        /// Desired spikes of every other class.
        wrong: f64,
    },
    /// The weighted spike-count loss, omega(t) = beta t^2 + gamma with t from 0 to 1 over the
    /// sample.
    Weighted {
        /// Desired spikes of the right class.
        right: f64,
        /// Desired spikes of every other class.
        wrong: f64,
        /// Coefficient of t^2.
        beta: f64,
        /// Constant term.
        gamma: f64,
    },
    /// The loss `numSpikes` of slayerPytorch.
    NumSpikes {
        /// Desired spikes of the right class.
        right: f64,
        /// Desired spikes of every other class.
        wrong: f64,
    },
    /// Cross-entropy of the softmax of spike counts.
    CrossEntropy {
        /// A spike's contribution to the logit of its class.
        scale: f64,
    },
    /// Cross-entropy of the softmax of potentials; the model has this `decision`.
    Potential {
        /// The score of an output's potential.
        decision: ReadOut,
        /// The score of a logit of 1, in the units of the trained weights.
        temperature: f64,
    },
}

/// The optimiser.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum OptimiserDesc {
    /// Adam.
    Adam {
        /// Learning rate.
        rate: f64,
    },
    /// RMSprop.
    RmsProp {
        /// Learning rate.
        rate: f64,
    },
}

/// Augmentation of the training samples.
#[derive(Debug, Clone, Copy, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct AugmentDesc {
    /// Greatest shift of a whole sample, in steps in either direction.
    pub shift: u32,
    /// Greatest shift of a single spike, in steps in either direction.
    pub jitter: u32,
    /// Greatest share by which a sample is stretched or compressed in time.
    pub stretch: f64,
    /// Share of channels that are silenced.
    pub drop_channel: f64,
    /// Share of spikes that are dropped.
    pub drop_spike: f64,
    /// Probability of an additional spike for each channel and step.
    pub noise: f64,
}

/// Content of a training file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename = "Training")]
pub struct TrainingFile {
    /// The model's name.
    pub name: String,
    /// Length of a timestep in ms.
    pub timestep_ms: Spanned<f64>,
    /// Input populations.
    pub inputs: Vec<Spanned<InputDesc>>,
    /// Dense layers; the last is the output.
    pub layers: Vec<Spanned<LayerDesc>>,
    /// The neurons of layers without their own.
    pub neuron: Spanned<NeuronDesc>,
    /// Loss on the spikes of the output layer.
    pub loss: Spanned<LossDesc>,
    /// Optimiser of the weights, with its rate.
    pub optimiser: Spanned<OptimiserDesc>,
    /// Multiple of the weights that is added to the gradient (l2), or subtracted from the weights
    /// when `decoupled`.
    #[serde(default)]
    pub weight_decay: f64,
    /// Number that is added to the gradient with the sign of each weight (l1).
    #[serde(default)]
    pub l1: f64,
    /// Probability that a unit of a hidden layer is dropped from a sample; the others are scaled
    /// up.
    #[serde(default)]
    pub dropout: f64,
    /// Whether weight decay is subtracted from the weights directly.
    #[serde(default)]
    pub decoupled: bool,
    /// Final learning rate, as a share of the initial one.
    #[serde(default = "one")]
    pub last_rate: f64,
    /// Width and height of the surrogate (slayerPytorch: tauRho 1, scaleRho 1).
    #[serde(default = "ones")]
    pub surrogate: (f64, f64),
    /// Samples per optimiser step.
    pub batch: u32,
    /// Passes over the samples.
    pub epochs: u32,
    /// The seed of initial weights, sample order and augmentation.
    pub seed: u64,
    /// Decay of the running mean of the weights at each step, 0..1; the mean is deployed. At 0 the
    /// weights are deployed.
    #[serde(default)]
    pub averaging: f64,
    /// Augmentation of the training samples.
    #[serde(default)]
    pub augment: AugmentDesc,
    /// Sources of training samples, as `nsim run --input` takes them.
    #[serde(default)]
    pub train: Vec<String>,
    /// Sources of test samples.
    #[serde(default)]
    pub test: Vec<String>,
    /// Names of the classes.
    #[serde(default)]
    pub classes: Vec<String>,
    /// The model's default stimulus.
    pub scene: Option<String>,
}

fn ones() -> (f64, f64) {
    (1.0, 1.0)
}

impl TrainingFile {
    /// Parses a training file.
    ///
    /// # Errors
    /// `train.syntax` with the position.
    pub fn parse(source: &SourceText) -> Result<Self> {
        parse(source, "train.syntax")
    }
}
