//! Arithmetic, threshold test, rounding and read-out of a network (`docs/semantics.md`).

use serde::Deserialize;

use crate::base::names::named_variants;

/// Arithmetic of a network (`docs/semantics.md`).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, serde::Serialize)]
pub enum Semantics {
    /// The chip's arithmetic, as recorded traces show it.
    #[default]
    Hardware,
    /// lava's fixed-point LIF process: no refractory period, wider accumulator.
    Lava,
    /// SLAYER's Loihi kernel: step 0 skipped, 32-bit products.
    Slayer,
}

/// Threshold test of a compartment.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, serde::Serialize)]
pub enum ThresholdTest {
    /// v > threshold, as the chip does.
    #[default]
    Strict,
    /// v >= threshold, as SLAYER 2 does.
    Inclusive,
}

named_variants!(ThresholdTest { Strict = "strict", Inclusive = "inclusive" });

/// Rounding of weights to multiples of the least step.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, serde::Serialize)]
pub enum WeightRounding {
    /// To the nearest, ties to even (SLAYER's export).
    #[default]
    Even,
    /// Toward zero (brian2-loihi).
    Truncate,
    /// Downward (lava).
    Floor,
}

named_variants! {
    /// The score of an output, by which a sample is decided.
    #[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, serde::Serialize)]
    pub enum ReadOut {
        /// The output with most spikes.
        #[default]
        Spikes = "spikes",
        /// The output whose potential v is greatest in any step.
        GreatestV = "greatest_v",
        /// The output whose potentials of all steps have the greatest sum.
        SumOfV = "sum_of_v",
        /// The output whose potential is greatest after the last step.
        LastV = "last_v",
    }
}

/// Periodic reset of u, v and the refractory period of each population, before the updates of steps
/// `start_step + offset + k * interval`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields, rename = "Reset")]
pub struct ResetDesc {
    /// Timesteps between two resets.
    pub interval: u64,
    /// Timesteps from the population's own start to the first reset.
    #[serde(default)]
    pub offset: u64,
}
