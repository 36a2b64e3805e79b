//! Options of a mapping: copies, strategy, objective, seed, effort.

use std::time::{Duration, Instant};

use nsim_ir::base::names::named_variants;
use nsim_ir::ranks::RankShare;

/// Default firing rate of a source, in spikes a step: one spike in 100 steps.
pub const DEFAULT_RATE: f64 = 0.01;
/// Default effort of a mapping, in seconds of a reference machine.
pub const DEFAULT_EFFORT_S: u32 = 2;

/// Objective of a mapping.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Objective {
    /// Number of cores.
    #[default]
    Cores,
    /// Energy, host included, as `nsim energy` reports it.
    Energy,
    /// Energy of neuron cores and mesh alone.
    EnergyChip,
    /// Length of a timestep.
    Latency,
}

named_variants!(Objective { Cores = "cores", Energy = "energy", EnergyChip = "energy:chip", Latency = "latency" });

/// Strategy that groups compartments into cores.
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

/// Placement of the copies of a network.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum CopyPlacement {
    /// Each copy takes separate chips while there are any; then chips are filled evenly.
    #[default]
    Spread,
    /// All copies take as few cores as they fit.
    Packed,
}

named_variants!(CopyPlacement { Spread = "spread", Packed = "packed" });

/// Effort of the search for a better partition and placement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Effort {
    /// Work of a reference machine in this number of seconds. It is counted in units of work, so
    /// the result is the same on every machine.
    Work(u32),
    /// Work of this machine until a point in time.
    Within {
        /// The time that was given for the whole mapping, in milliseconds.
        budget_ms: u32,
        /// End of that time.
        end: Instant,
    },
}

impl Effort {
    /// An effort that ends `budget_ms` milliseconds from now.
    pub fn within_ms(budget_ms: u32) -> Self {
        Effort::Within { budget_ms, end: Instant::now() + Duration::from_millis(budget_ms.into()) }
    }

    /// Units of work that remain, where a reference machine does `per_second` of them in a second.
    pub fn work(self, per_second: u64) -> u64 {
        match self {
            Effort::Work(seconds) => u64::from(seconds).saturating_mul(per_second),
            Effort::Within { end, .. } => {
                let left = end.saturating_duration_since(Instant::now());
                (left.as_secs_f64() * per_second as f64) as u64
            }
        }
    }

    /// The time of its end; `None` where it is counted in work.
    pub fn end(self) -> Option<Instant> {
        if let Effort::Within { end, .. } = self { Some(end) } else { None }
    }

    /// The effort of one of `parts` equal parts; one that ends by the clock is unchanged.
    #[must_use]
    pub fn shared_by(self, parts: usize) -> Self {
        match self {
            Effort::Work(seconds) => Effort::Work(seconds.div_ceil(parts.max(1) as u32)),
            within => within,
        }
    }
}

/// Whether the time `end` is reached; never without one.
pub fn is_over(end: Option<Instant>) -> bool {
    end.is_some_and(|end| Instant::now() >= end)
}

/// Options of a compilation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Options {
    /// Copies of the network, at least 1.
    pub copies: u32,
    /// Placement of the copies.
    pub placement: CopyPlacement,
    /// Strategy that groups compartments into cores.
    pub strategy: Strategy,
    /// Objective of the mapping.
    pub objective: Objective,
    /// Seed of the strategies that use random numbers; recorded for every strategy.
    pub seed: u64,
    /// Whether cores are placed near the cores that they exchange messages with. Otherwise they are
    /// placed in the order of the partition.
    pub place: bool,
    /// Effort of the search for a better partition and placement.
    pub effort: Effort,
    /// Most synapses of a core, respected by tiles and boxes; `None` for no bound but the limits. A
    /// kernel is stored once, so limits of memory alone do not bound a core's work.
    pub most_synapses: Option<u64>,
    /// Share of the process, of several that run the program together, for which it is written.
    pub share: RankShare,
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
            share: RankShare::ALL,
        }
    }
}
