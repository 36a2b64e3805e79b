//! The parts that pruning removed from a network, and why.

use serde::{Deserialize, Serialize};

use crate::base::id::{IdVec, PopulationId};
use crate::base::names::named_variants;

named_variants! {
    /// The reason why a part was pruned.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
    pub enum Kind {
        /// An input channel that the stimulus never fires.
        DeadInput = "dead_input",
        /// A synapse whose scaled weight is 0.
        ZeroSynapse = "zero_synapse",
        /// A compartment that can never spike.
        SilentCompartment = "silent_compartment",
        /// A compartment whose spikes reach no output and no probed population.
        UnreachableCompartment = "unreachable_compartment",
        /// A synapse from a source that never spikes, or to a pruned compartment.
        LooseSynapse = "loose_synapse",
    }
}

/// Pruned parts of one kind: their number and their places.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
pub struct Row {
    /// The kind of the parts.
    pub kind: Kind,
    /// Number of parts.
    pub count: u64,
    /// Reason why their removal changes no output.
    pub reason: String,
    /// Number of parts of each population or projection, in the order of the file.
    pub of: Vec<(String, u64)>,
}

/// Sizes of a network.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
pub struct Sizes {
    /// Number of units of each population.
    pub units: IdVec<PopulationId, u32>,
    /// Sizes of its projections, in the order of the file.
    pub projections: Vec<ProjectionSize>,
}

/// Size of a projection.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
pub struct ProjectionSize {
    /// Source population.
    pub source: PopulationId,
    /// Target population.
    pub target: PopulationId,
    /// Number of synapses.
    pub synapses: u64,
    /// Whether it connects every source to every target.
    pub dense: bool,
}
