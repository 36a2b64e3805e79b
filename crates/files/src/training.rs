//! The mirror of a training file (`nsim train`; `docs/training.md` describes each field).
//!
//! Ranges of single numbers are checked by `train::plan`, which knows the whole file.

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
    /// Initial weights are uniform within this many times `1 / sqrt(fan-in)` (slayerPytorch: 10).
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
    /// The same time constant for all.
    Same(f64),
    /// This many values from one to another in a geometric series, cyclically over the neurons.
    Spread(f64, f64, u32),
}

/// The neurons of a layer.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum NeuronDesc {
    /// Spike-response neurons.
    Srm {
        /// Time constant of the response.
        tau_sr_ms: TimesDesc,
        /// Time constant of the refractory response.
        tau_ref_ms: f64,
        /// Its size in thresholds.
        scale_ref: f64,
        /// Threshold.
        theta: f64,
        /// Kernels cut off where SLAYER cuts them, instead of exact recursions.
        #[serde(default)]
        truncated: bool,
    },
    /// Compartments of a Loihi core.
    Loihi {
        /// Time constant of the current.
        tau_u_ms: TimesDesc,
        /// Time constant of the voltage.
        tau_v_ms: TimesDesc,
        /// Mantissa units that a trained weight of 1 counts; the threshold mantissa follows from
        /// it.
        weight_scale: f64,
        /// The projection's weight exponent.
        #[serde(default)]
        weight_exp: i64,
        /// Refractory period in timesteps.
        #[serde(default = "one_step")]
        refractory: i64,
        /// Threshold in the units of the trained weights, when a neuron's response to a weight of 1
        /// peaks at 1; `inf` for outputs that are read out by their potential.
        theta: f64,
        /// How credit is assigned.
        #[serde(default)]
        credit: CreditDesc,
    },
    /// Resonate-and-fire neurons of Loihi 2; what arrives is real.
    Rf {
        /// Period of the resonance.
        period_ms: TimesDesc,
        /// Time constant of its decay.
        tau_ms: TimesDesc,
        /// Mantissa units that a trained weight of 1 counts.
        weight_scale: f64,
        /// Threshold of the real part in the units of the trained weights.
        theta: f64,
    },
    /// Neurons of Loihi 2 that send changes of their rectified sum.
    SigmaDelta {
        /// Mantissa units that a trained weight of 1 counts.
        weight_scale: f64,
        /// The least change that is sent, in the units of the trained weights.
        theta: f64,
    },
    /// Neurons of Loihi 2 whose sum is read out.
    Sigma {
        /// Mantissa units that a trained weight of 1 counts.
        weight_scale: f64,
    },
}

fn one_step() -> i64 {
    1
}

/// How far errors reach through a neuron's own spikes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
pub enum CreditDesc {
    /// As SLAYER assigns it: the error at a step is correlated with the response kernel, as if no
    /// spike lay between.
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
    /// What slayerPytorch calls numSpikes.
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
        /// What of the potential is the score.
        decision: ReadOut,
        /// The score, in the units of the trained weights, that is a logit of 1.
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
    /// The whole sample is moved by up to this many steps, either way.
    pub shift: u32,
    /// Each spike is moved by up to this many steps, either way.
    pub jitter: u32,
    /// The sample is stretched or squeezed in time by up to this share.
    pub stretch: f64,
    /// Share of channels that are silenced.
    pub drop_channel: f64,
    /// Share of spikes that are dropped.
    pub drop_spike: f64,
    /// Probability of an additional spike for each channel and step.
    pub noise: f64,
}

/// A training file as it is written.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename = "Training")]
pub struct TrainingFile {
    /// The model's name.
    pub name: String,
    /// Milliseconds that a timestep represents.
    pub timestep_ms: Spanned<f64>,
    /// Input populations.
    pub inputs: Vec<Spanned<InputDesc>>,
    /// Dense layers; the last one decides.
    pub layers: Vec<Spanned<LayerDesc>>,
    /// The neurons of layers that do not name their own.
    pub neuron: Spanned<NeuronDesc>,
    /// The loss.
    pub loss: Spanned<LossDesc>,
    /// The optimiser.
    pub optimiser: Spanned<OptimiserDesc>,
    /// Multiple of the weights added to the gradient (l2), or taken off the weights when
    /// `decoupled`.
    #[serde(default)]
    pub weight_decay: f64,
    /// Added to the gradient with the sign of each weight (l1).
    #[serde(default)]
    pub l1: f64,
    /// Probability with which a unit of a hidden layer is dropped from a sample; the others count
    /// the more.
    #[serde(default)]
    pub dropout: f64,
    /// Whether decay is taken off the weights directly.
    #[serde(default)]
    pub decoupled: bool,
    /// Share of the learning rate that is left at the end.
    #[serde(default = "one")]
    pub last_rate: f64,
    /// Width and height of the surrogate (slayerPytorch: tauRho 1, scaleRho 1).
    #[serde(default = "ones")]
    pub surrogate: (f64, f64),
    /// Samples of a step.
    pub batch: u32,
    /// Passes over the samples.
    pub epochs: u32,
    /// The seed of initial weights, order and variations.
    pub seed: u64,
    /// Share that the running mean of the weights keeps at each step; the mean is deployed. 0: the
    /// weights are.
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
    /// The model's own stimulus.
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
