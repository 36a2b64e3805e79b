//! What pruning left out of a network, and why.

use serde::{Deserialize, Serialize};

use crate::base::names::named_variants;

named_variants! {
    /// Why something was left out.
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
        /// A synapse from what never spikes, or to what was left out.
        LooseSynapse = "loose_synapse",
    }
}

/// How many of a kind were left out, and where.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
pub struct Row {
    /// The kind.
    pub kind: Kind,
    /// How many.
    pub count: u64,
    /// Why that changes no output.
    pub reason: String,
    /// How many of which population or projection, in the order of the file.
    pub of: Vec<(String, u64)>,
}
