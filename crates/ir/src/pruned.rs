//! What pruning left out of a network, and why.

use serde::{Deserialize, Serialize};

use crate::base::names::named_variants;

/// Why something was left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
pub enum Kind {
    /// An input channel that the stimulus never fires.
    DeadInput,
    /// A synapse whose scaled weight is 0.
    ZeroSynapse,
    /// A compartment that can never spike.
    SilentCompartment,
    /// A compartment that reaches no output and nothing probed.
    UnreachableCompartment,
    /// A synapse from what never spikes, or to what was left out.
    LooseSynapse,
}

named_variants!(Kind {
    DeadInput = "dead_input",
    ZeroSynapse = "zero_synapse",
    SilentCompartment = "silent_compartment",
    UnreachableCompartment = "unreachable_compartment",
    LooseSynapse = "loose_synapse",
});

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
