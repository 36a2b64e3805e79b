//! The causes by which the machine differs from a trained network, and the sets of them that are
//! switched on.

use nsim_ir::base::names::named_variants;

named_variants! {
    /// A difference of the machine from the trained network.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
    pub enum Cause {
        /// Each layer answers a step later, in samples that end with their input.
        Pipeline = "pipeline-delay",
        /// Infinite response and refractory kernels instead of truncated ones.
        Untruncated = "exact-kernel",
        /// Decaying current and voltage instead of the alpha kernel: a step earlier, a step longer.
        Kernel = "cuba-kernel",
        /// A hard reset and a refractory period instead of the refractory kernel or a subtraction.
        HardReset = "hard-reset",
        /// Decays in 4096ths.
        Decays = "quantised-decays",
        /// Thresholds and self-synapses from a search instead of the analysis.
        Calibration = "calibration",
        /// Integer weights, thresholds and biases.
        Weights = "quantised-weights",
        /// Integer state: rounding toward zero, wrapping, clipping.
        State = "integer-state",
    }
}

impl Cause {
    /// The cause in words, as the loss of a layer.
    pub fn loss_text(self) -> &'static str {
        match self {
            Cause::Pipeline => {
                "pipeline delay: each layer answers one step later, and a sample can end before the last layer answers"
            }
            Cause::Untruncated => "kernels truncated in training",
            Cause::Kernel => "exponential decays instead of its kernel",
            Cause::HardReset => "the reset to zero",
            Cause::Decays => "decays in 4096ths",
            Cause::Calibration => "thresholds and synapses onto itself that the search chose",
            Cause::Weights => "rounded weights, thresholds and biases",
            Cause::State => "integer currents and voltages",
        }
    }

    /// Advice that lowers its cost, where one holds for every network.
    pub fn remedy(self) -> Option<&'static str> {
        (self == Cause::Weights).then_some(
            "weights of a layer that are similar in size (decay or clip large ones in training), since the bits of a \
             weight divide the range of the largest; docs/tutorials/rounded-weights.md regains the loss in PyTorch",
        )
    }
}

/// Set of the causes that are switched on: a comparison stage.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ComparisonStage([bool; 8]);

impl ComparisonStage {
    /// The trained network.
    pub const TRAINED: ComparisonStage = ComparisonStage([false; 8]);
    /// The machine.
    pub const MACHINE: ComparisonStage = ComparisonStage([true; 8]);

    /// Whether a cause is on.
    pub fn has(self, cause: Cause) -> bool {
        self.0[cause as usize]
    }

    /// The stage with one cause less.
    #[must_use]
    pub fn without(mut self, cause: Cause) -> ComparisonStage {
        self.0[cause as usize] = false;
        self
    }

    /// The stage with one cause more.
    #[must_use]
    pub fn with(mut self, cause: Cause) -> ComparisonStage {
        self.0[cause as usize] = true;
        self
    }
}
