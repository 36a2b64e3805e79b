//! What the caller decides about a mapping: copies, strategy, objective, seed, effort.

use crate::base::names::named_variants;

/// Spikes of a source in a step, when nothing is known: one in 100 steps.
pub const DEFAULT_RATE: f64 = 0.01;
/// The effort of a mapping unless another is given, in seconds.
pub const DEFAULT_EFFORT_S: u32 = 4;

/// What a mapping is optimised for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Objective {
    /// Few cores.
    #[default]
    Cores,
    /// Little energy, host included: what `nsim energy` reports.
    Energy,
    /// Little energy of neuron cores and mesh alone.
    EnergyChip,
    /// Short timesteps.
    Latency,
}

named_variants!(Objective { Cores = "cores", Energy = "energy", EnergyChip = "energy:chip", Latency = "latency" });

/// How compartments are grouped into cores.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Strategy {
    /// In the order of the model file.
    Sequential,
    /// By tiles and by growth.
    Greedy,
    /// By tiles and by levels of groups, refined.
    #[default]
    Multilevel,
}

named_variants!(Strategy { Sequential = "sequential", Greedy = "greedy", Multilevel = "multilevel" });

/// How to compile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Options {
    /// Copies of the network, at least 1.
    pub copies: u32,
    /// How compartments are grouped into cores.
    pub strategy: Strategy,
    /// What for.
    pub objective: Objective,
    /// Seed of strategies that draw; recorded in any case.
    pub seed: u64,
    /// Whether cores are placed near those they exchange messages with; otherwise in the order of the partition.
    pub place: bool,
    /// Seconds that searching for a better partition and placement may take, counted in work, so that the result is the
    /// same on every machine.
    pub effort_s: u32,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            copies: 1,
            strategy: Strategy::default(),
            objective: Objective::default(),
            seed: 0,
            place: true,
            effort_s: DEFAULT_EFFORT_S,
        }
    }
}
