//! Warnings: what a user should check about a result that is given all the same.
//!
//! A warning is one record that text, JSON, Python and the page show: a change of the model, an
//! assumption of a reader, or a finding about a run. What is only of interest is a note. Codes are
//! a closed list, so that a test can go over all of them.

use serde::{Deserialize, Serialize};

crate::named_variants! {
/// The kind of a warning; `docs/results.md` has a row for each.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Deserialize, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum WarningCode {
    /// A population of compartments never spikes.
    SilentPopulation = "silent-population",
    /// The output, or one of its classes, never spikes.
    SilentOutput = "silent-output",
    /// Voltages met the end of their range.
    Clipped = "clipped",
    /// Accumulators or currents wrapped around.
    Wrapped = "wrapped",
    /// Weights were changed to multiples of a step.
    WeightsRounded = "weights-rounded",
    /// The arithmetic of the model lacks a parameter that the model states.
    ParameterIgnored = "parameter-ignored",
    /// Spike response neurons became compartments.
    Converted = "converted",
    /// A recording lost or moved events.
    EventsChanged = "events-changed",
    /// A file does not state the reset.
    ResetAssumed = "reset-assumed",
    /// A file does not state whether a neuron spikes at its threshold.
    ThresholdAssumed = "threshold-assumed",
    /// A file does not state the lower bound of v.
    LowerBoundAssumed = "lower-bound-assumed",
    /// A weight of a file does not count 1.
    Gain = "gain",
    /// Neurons of the tool may do what its file does not state.
    ToolBeyond = "tool-beyond",
    /// v is counted from a rest potential.
    RestPotential = "rest-potential",
    /// Delays were rounded to whole steps.
    DelaysRounded = "delays-rounded",
    /// Delays were clipped to the longest of a core.
    DelayClipped = "delay-clipped",
    /// A loop takes more steps than in the tool.
    LoopSlower = "loop-slower",
    /// The output was chosen by the reader.
    OutputAssumed = "output-assumed",
    /// A file has an edge more than once.
    EdgeDoubled = "edge-doubled",
    /// No path uses an edge of a file.
    EdgeDropped = "edge-dropped",
    /// A file's theta contradicts its threshold mantissa, which is used.
    ThetaIgnored = "theta-ignored",
    /// A threshold was clipped to the greatest.
    ThresholdClipped = "threshold-clipped",
    /// A file's sizes contradict its arrays, which are used.
    SizeIgnored = "size-ignored",
    /// A file does not state the order of its layers.
    LayerOrder = "layer-order",
    /// Fractions of numbers of a file were cut.
    FractionLost = "fraction-lost",
    /// A time constant is shorter than the timestep.
    LongTimestep = "long-timestep",
    /// The potential of an output that spikes decides.
    DecisionByPotential = "decision-by-potential",
    /// Pruning made a list of the synapses of a convolution.
    ConvolutionListed = "convolution-listed",
    /// Other hardware has no row for this network.
    BaselineMissing = "baseline-missing",
    /// A run has no dynamic power, or no energy.
    CostUnknown = "cost-unknown",
    /// Steps take longer than their timestep in real time.
    RealtimeMissed = "realtime-missed",
}
}

/// A finding that a user should check.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
pub struct Warning {
    /// Its kind.
    pub code: WarningCode,
    /// The population that it is about; none for the whole network.
    pub population: Option<String>,
    /// The observation, and the advised change.
    pub message: String,
}

impl Warning {
    /// A warning about a whole network.
    pub fn of_network(code: WarningCode, message: impl Into<String>) -> Self {
        Warning { code, population: None, message: message.into() }
    }

    /// A warning about a population.
    pub fn of_population(code: WarningCode, population: &str, message: impl Into<String>) -> Self {
        Warning { code, population: Some(population.to_string()), message: message.into() }
    }
}

impl std::fmt::Display for Warning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.population {
            Some(population) => write!(f, "'{population}': {}", self.message),
            None => f.write_str(&self.message),
        }
    }
}
