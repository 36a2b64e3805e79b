//! What a pruned network was before, and what was left out of it.
//!
//! A pruned [`Quantised`] network is a network like any other, smaller and renumbered, so every stage after it takes it as
//! it is. This record goes with it: by it, people go on seeing the populations, shapes and numbers of their model file.
//! Input populations always keep their channels; a population of compartments that lost some keeps its name and place,
//! even when nothing is left of it.

use crate::base::id::{ChannelId, IdVec, PopulationId};
use crate::ir::quantised::Quantised;

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
    /// Every kind, in the order in which they are told.
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

/// What a pruned network was before, and what was left out.
#[derive(Debug, Clone)]
pub struct Pruned {
    /// The network before; of several copies, one.
    pub original: Quantised,
    /// For each population that lost compartments, the indices of those it kept, ascending.
    pub kept: IdVec<PopulationId, Option<Vec<u32>>>,
    /// Populations that were to stay whole because they are probed.
    pub probed: Vec<PopulationId>,
    /// Where the stimulus that it was pruned for came from; `None` when it was pruned for every stimulus.
    pub stimulus: Option<Vec<String>>,
    /// Channels that the stimulus never fires, ascending.
    pub dead: Vec<ChannelId>,
    /// What was left out, a row for each kind that was looked for.
    pub rows: Vec<Row>,
}

impl Pruned {
    /// How many of a kind were left out.
    #[must_use]
    pub fn count(&self, kind: Kind) -> u64 {
        self.rows.iter().filter(|row| row.kind == kind).map(|row| row.count).sum()
    }
}
