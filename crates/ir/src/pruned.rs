//! The parts that pruning removed from a network, and why.

use serde::{Deserialize, Serialize};

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
        /// A compartment that reaches no output and nothing probed.
        UnreachableCompartment = "unreachable_compartment",
        /// A synapse from a source that never spikes, or to a pruned compartment.
        LooseSynapse = "loose_synapse",
    }
}

/// Number of pruned parts of a kind, and their places.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
pub struct Row {
    /// The kind.
    pub kind: Kind,
    /// Number of parts.
    pub count: u64,
    /// Why that changes no output.
    pub reason: String,
    /// Number of parts of each population or projection, in the order of the file.
    pub of: Vec<(String, u64)>,
}
