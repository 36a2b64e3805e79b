//! What pruning left out of a network, and why.

/// Why something was left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
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

impl Kind {
    /// Every kind, in the order of results.
    pub const ALL: [Kind; 5] =
        [Kind::DeadInput, Kind::ZeroSynapse, Kind::SilentCompartment, Kind::UnreachableCompartment, Kind::LooseSynapse];

    /// Its name in results.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Kind::DeadInput => "dead_input",
            Kind::ZeroSynapse => "zero_synapse",
            Kind::SilentCompartment => "silent_compartment",
            Kind::UnreachableCompartment => "unreachable_compartment",
            Kind::LooseSynapse => "loose_synapse",
        }
    }
}

/// How many of a kind were left out, and where.
#[derive(Debug, Clone, PartialEq, Eq)]
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
