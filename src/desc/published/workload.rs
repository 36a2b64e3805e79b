//! The mirror of published workloads (`mapping/workloads`): a network that somebody measured on the chip, as closely as its
//! source lets it be rebuilt, and the figures that were printed.
//!
//! A rate that no source prints is given as a range and marked assumed: the range enters the interval of every figure that
//! follows from it. Weights are not part of a workload: they decide which compartments fire, and the rates say how many.

use serde::{Deserialize, Serialize};

use crate::base::names::named_variants;
use crate::desc::spanned::Spanned;
use crate::desc::target::constants::Status;

/// What a measurement attributes to the chip.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all(serialize = "lowercase"))]
pub enum Accounting {
    /// What NxSDK's profiler attributes to neuron cores and x86 cores.
    Profiler,
    /// What a board's rails draw above idle.
    Board,
}

named_variants!(Accounting { Profiler = "profiler", Board = "board" });

/// What a figure is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all(serialize = "lowercase"))]
pub enum FigureKind {
    /// Energy, of a step or of an inference.
    Energy,
    /// Power.
    Power,
    /// Time, of a step or of an inference.
    Time,
}

named_variants!(FigureKind { Energy = "energy", Power = "power", Time = "time" });

/// A figure that a model of cost can predict.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
pub enum Quantity {
    /// Static power of the powered neuron cores, mW.
    CoreStaticPower,
    /// Dynamic power of the neuron cores and their mesh, mW.
    CoreDynamicPower,
    /// Static power of the x86 cores in use, mW.
    X86StaticPower,
    /// Power of the x86 cores in use on top, mW.
    X86DynamicPower,
    /// Dynamic power of neuron and x86 cores, mW.
    DynamicPower,
    /// Time of a step, us.
    StepTime,
    /// Time of a step without what the host does, us.
    SpikingTime,
    /// Energy of neuron cores and mesh in a step, nJ.
    CoreStepEnergy,
    /// Dynamic energy of an inference, neuron and x86 cores, uJ.
    InferenceDynamicEnergy,
}

named_variants!(Quantity {
    CoreStaticPower = "core static power",
    CoreDynamicPower = "core dynamic power",
    X86StaticPower = "x86 static power",
    X86DynamicPower = "x86 dynamic power",
    DynamicPower = "dynamic power",
    StepTime = "step time",
    SpikingTime = "spiking time of a step",
    CoreStepEnergy = "core energy of a step",
    InferenceDynamicEnergy = "dynamic energy of an inference",
});

impl Quantity {
    /// What it is.
    #[must_use]
    pub fn kind(self) -> FigureKind {
        match self {
            Quantity::CoreStaticPower
            | Quantity::CoreDynamicPower
            | Quantity::X86StaticPower
            | Quantity::X86DynamicPower
            | Quantity::DynamicPower => FigureKind::Power,
            Quantity::StepTime | Quantity::SpikingTime => FigureKind::Time,
            Quantity::CoreStepEnergy | Quantity::InferenceDynamicEnergy => FigureKind::Energy,
        }
    }

    /// The unit of its figures.
    #[must_use]
    pub fn unit(self) -> &'static str {
        match self.kind() {
            FigureKind::Power => "mW",
            FigureKind::Time => "us",
            FigureKind::Energy if self == Quantity::CoreStepEnergy => "nJ",
            FigureKind::Energy => "uJ",
        }
    }
}

/// A number that a source prints, or a range for one that none prints.
#[derive(Debug, Clone, Copy, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Between {
    /// What is taken.
    pub value: f64,
    /// The least that it may have been; equal to the value where it is published.
    pub low: f64,
    /// The greatest.
    pub high: f64,
}

/// A population of a workload.
#[derive(Debug, Clone, Deserialize)]
pub enum WorkloadPopulation {
    /// Input channels.
    Input {
        /// Its name.
        name: String,
        /// Channels, height, width; or one number.
        shape: Vec<u32>,
        /// How often a channel spikes: spikes a channel and step, the mean over channels and steps.
        rate: Between,
    },
    /// Compartments.
    Layer {
        /// Its name.
        name: String,
        /// Channels, height, width; or one number.
        shape: Vec<u32>,
        /// How often a compartment spikes: spikes a compartment and step, the mean over compartments and steps.
        rate: Between,
    },
    /// A compartment for each unit of an input population, which spikes one step after it: what hands inputs on to other cores.
    Relay {
        /// Its name.
        name: String,
        /// The input population.
        of: String,
        /// Its shape, as that of the input.
        shape: Vec<u32>,
    },
}

/// Synapses of a workload.
#[derive(Debug, Clone, Deserialize)]
pub enum WorkloadProjection {
    /// All to all.
    Dense {
        /// Source.
        from: String,
        /// Target.
        to: String,
    },
    /// A convolution without padding.
    Conv {
        /// Source.
        from: String,
        /// Target.
        to: String,
        /// Side of the kernel.
        kernel: u32,
        /// Stride.
        stride: u32,
    },
    /// So many synapses of each source, spread evenly over as many units of the target around the source's own place.
    Local {
        /// Source.
        from: String,
        /// Target.
        to: String,
        /// Synapses of a source.
        fan_out: u32,
        /// Units that they are spread over.
        reach: u32,
    },
    /// So many synapses of each source to random targets.
    Random {
        /// Source.
        from: String,
        /// Target.
        to: String,
        /// Synapses of a source.
        fan_out: u32,
    },
}

/// How many cores may have been powered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CoreRange {
    /// The least.
    pub low: u64,
    /// The most.
    pub high: u64,
}

/// What was in use, for all copies together.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorkloadDeployment {
    /// Copies of the network.
    pub copies: u32,
    /// Copies on the chip that holds most that are injected one after the other, chips side by side; 1 where one stream of inputs
    /// feeds all copies of a chip.
    pub copies_per_chip: u32,
    /// Neuron cores that draw static power.
    pub cores_powered: u64,
    /// The least and the most that may have been, where no source says.
    #[serde(default)]
    pub cores_powered_between: Option<CoreRange>,
    /// Chips in use.
    pub chips_used: u64,
    /// x86 cores in use.
    pub x86_cores: u64,
    /// Chips whose x86 cores are in use, where these are fewer: most of the power of a chip's x86 cores is that of one clock.
    #[serde(default)]
    pub x86_chips: Option<u64>,
    /// x86 cores that share the injection of a chip's copies.
    pub x86_cores_per_chip: u32,
}

/// What the host does besides injecting spikes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HostWork {
    /// Whether an embedded process takes its turn in every step.
    #[serde(default)]
    pub embedded_process: bool,
    /// 32-bit words of state registers that the x86 core that takes longest sets to zero for each inference.
    #[serde(default)]
    pub reset_words_per_inference: Between,
}

/// A printed figure.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedFigure {
    /// What it is.
    pub quantity: Quantity,
    /// Its value in the quantity's unit, for one copy if `per_copy`.
    pub published: Spanned<f64>,
    /// Whether it is of one copy, not of all.
    #[serde(default)]
    pub per_copy: bool,
    /// Whether it is of one x86 core, not of all.
    #[serde(default)]
    pub per_x86_core: bool,
    /// What it attributes to the chip.
    pub accounting: Accounting,
    /// Whether it is above the idle of a board on which no program was loaded, so that x86 cores count for being on.
    #[serde(default)]
    pub above_boot: bool,
    /// Whether it is printed, computed from printed figures, or inferred.
    pub status: Status,
    /// Where it is printed, or how it follows from what is.
    pub source: String,
    /// Why a prediction misses it by far, where that was found out.
    #[serde(default)]
    pub cause: Option<String>,
}

/// A workload file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename = "Workload")]
pub struct WorkloadFile {
    /// Its name.
    pub name: String,
    /// The work that it is of: figures of one work are left out of a fit together.
    pub work: String,
    /// Paper and section, or repository and file.
    pub source: String,
    /// Whether the figures were read where they were first printed; others do not count.
    pub first_hand: bool,
    /// Whether the firing rates are published or follow the rule for those that are not.
    pub activity: Status,
    /// What had to be assumed.
    pub assumed: Vec<String>,
    /// The target.
    pub target: Spanned<String>,
    /// The populations.
    pub populations: Vec<WorkloadPopulation>,
    /// The projections.
    pub projections: Vec<WorkloadProjection>,
    /// The share of steps in which a compartment is not at rest; in all of them where it is not given.
    #[serde(default = "always")]
    pub active_share: Between,
    /// The most compartments of a core, where the source put fewer on one than fit.
    #[serde(default)]
    pub compartments_per_core: Option<u32>,
    /// What was in use.
    pub deployment: WorkloadDeployment,
    /// What the host does.
    #[serde(default)]
    pub host: HostWork,
    /// Steps of an inference.
    pub steps: u32,
    /// Time of a step where the source says that it was held to one, us.
    #[serde(default)]
    pub paced_us: Option<f64>,
    /// The figures.
    pub figures: Vec<PublishedFigure>,
}

/// The share of what is so in every step.
fn always() -> Between {
    Between { value: 1.0, low: 1.0, high: 1.0 }
}

impl WorkloadPopulation {
    /// Name, shape and rate; a relay has no rate of its own.
    #[must_use]
    pub fn parts(&self) -> (&str, &[u32], Option<Between>) {
        match self {
            WorkloadPopulation::Input { name, shape, rate } | WorkloadPopulation::Layer { name, shape, rate } => {
                (name, shape, Some(*rate))
            }
            WorkloadPopulation::Relay { name, shape, .. } => (name, shape, None),
        }
    }
}

impl WorkloadProjection {
    /// Source and target.
    #[must_use]
    pub fn ends(&self) -> [&str; 2] {
        match self {
            WorkloadProjection::Dense { from, to }
            | WorkloadProjection::Conv { from, to, .. }
            | WorkloadProjection::Local { from, to, .. }
            | WorkloadProjection::Random { from, to, .. } => [from, to],
        }
    }
}
