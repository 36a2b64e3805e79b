//! What the caller decides about a mapping: copies, strategy, objective, seed, effort.

use std::time::{Duration, Instant};

use nsim_ir::base::names::named_variants;
use nsim_ir::ranks::Share;

/// Spikes of a source in a step, when nothing is known: one in 100 steps.
pub const DEFAULT_RATE: f64 = 0.01;
/// The effort of a mapping unless another is given, in seconds of a reference machine.
pub const DEFAULT_EFFORT_S: u32 = 2;

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

/// Where copies of a network go.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum CopyPlacement {
    /// Each on chips of its own while there are any; then chips are filled evenly.
    #[default]
    Spread,
    /// On as few cores as they fit.
    Packed,
}

named_variants!(CopyPlacement { Spread = "spread", Packed = "packed" });

/// How much may be spent on looking for a better partition and placement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Effort {
    /// What a reference machine does in this many seconds, counted in work, so that the result is
    /// the same on every machine.
    Work(u32),
    /// What this machine does until then.
    Within {
        /// The time that was given for the whole mapping, in milliseconds.
        budget_ms: u32,
        /// When it ends.
        end: Instant,
    },
}

impl Effort {
    /// This many milliseconds from now on.
    pub fn within_ms(budget_ms: u32) -> Self {
        Effort::Within { budget_ms, end: Instant::now() + Duration::from_millis(budget_ms.into()) }
    }

    /// Units of work, of which a reference machine does this many in a second.
    pub fn work(self, per_second: u64) -> u64 {
        match self {
            Effort::Work(seconds) => u64::from(seconds).saturating_mul(per_second),
            Effort::Within { end, .. } => {
                let left = end.saturating_duration_since(Instant::now());
                (left.as_secs_f64() * per_second as f64) as u64
            }
        }
    }

    /// When it ends, if the clock says.
    pub fn end(self) -> Option<Instant> {
        match self {
            Effort::Work(_) => None,
            Effort::Within { end, .. } => Some(end),
        }
    }

    /// An equal part of it for each of this many.
    #[must_use]
    pub fn shared_by(self, parts: usize) -> Self {
        match self {
            Effort::Work(seconds) => Effort::Work(seconds.div_ceil(parts.max(1) as u32)),
            within => within,
        }
    }
}

/// Whether a time has come.
pub fn is_over(end: Option<Instant>) -> bool {
    end.is_some_and(|end| Instant::now() >= end)
}

/// How to compile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Options {
    /// Copies of the network, at least 1.
    pub copies: u32,
    /// Where they go.
    pub placement: CopyPlacement,
    /// How compartments are grouped into cores.
    pub strategy: Strategy,
    /// What for.
    pub objective: Objective,
    /// Seed of strategies that draw; recorded in any case.
    pub seed: u64,
    /// Whether cores are placed near those they exchange messages with; otherwise in the order of
    /// the partition.
    pub place: bool,
    /// What may be spent on looking for a better partition and placement.
    pub effort: Effort,
    /// Synapses of a core at most, as far as tiles and boxes decide: a kernel is stored once, so
    /// limits of memory alone do not bound a core's work. None: as many as its limits allow.
    pub most_synapses: Option<u64>,
    /// For which of the processes that run it together the program is written.
    pub share: Share,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            copies: 1,
            placement: CopyPlacement::default(),
            strategy: Strategy::default(),
            objective: Objective::default(),
            seed: 0,
            place: true,
            effort: Effort::Work(DEFAULT_EFFORT_S),
            most_synapses: None,
            share: Share::ALL,
        }
    }
}
