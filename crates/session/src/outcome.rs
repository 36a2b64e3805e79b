//! What of a sample is kept, and what it did.
//!
//! Input: an output population, probes, perhaps the rule of an early exit ([`Keep`]). Output: an
//! [`Outcome`] with spikes or scores of the outputs, the class, counts and recorded numbers.

use serde::{Deserialize, Serialize};

use crate::decision::EarlyExit;
use nsim_ir::activity::{Overflow, Totals};
use nsim_ir::base::id::CompartmentId;
use nsim_ir::neurons::NeuronKind;
use nsim_ir::potentials::Potentials;
use nsim_ir::quantised::{Output, Population};

/// What a probe records.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Quantity {
    /// 0 or 1.
    Spikes,
    /// The current register.
    U,
    /// The membrane.
    V,
    /// What the chip's voltage register reads.
    VRegister,
    /// What the message carries, 0 where none is sent.
    Message,
    /// A word of state, by its place in the table of the kind.
    State(usize),
}

impl Quantity {
    /// Every quantity of compartments with registers, with the name that arguments and files use.
    pub const ALL: [(Quantity, &'static str); 5] = [
        (Quantity::Spikes, "spikes"),
        (Quantity::U, "u"),
        (Quantity::V, "v"),
        (Quantity::VRegister, "v_register"),
        (Quantity::Message, "message"),
    ];

    /// The quantity of this name that compartments of a kind have.
    pub fn of_kind(kind: NeuronKind, name: &str) -> Option<Quantity> {
        let table = kind.table();
        if table.registers || matches!(name, "spikes" | "message") {
            return Quantity::ALL.into_iter().find(|(_, known)| *known == name).map(|(quantity, _)| quantity);
        }
        table.state.iter().position(|column| column.name == name).map(Quantity::State)
    }
}

/// A quantity of consecutive compartments.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Probe {
    /// The first compartment.
    pub first: CompartmentId,
    /// Number of compartments.
    pub count: u32,
    /// What to record.
    pub quantity: Quantity,
}

impl Probe {
    /// What is called so of a population's compartments: a quantity, or a word of their state;
    /// `None` where they have no such thing.
    pub fn named(population: &Population, what: &str) -> Option<Probe> {
        let (first, count) = (population.first_compartment()?, population.shape.len());
        let kind = population.each_neuron().next().map_or(NeuronKind::Loihi, |neuron| neuron.kind);
        Some(Probe { first, count, quantity: Quantity::of_kind(kind, what)? })
    }
}

/// What to keep of each sample, and when it ends.
#[derive(Debug, Clone)]
pub struct Keep {
    /// The compartments that decide.
    pub output: Output,
    /// Probes; the steps that an early exit leaves off stay zero in them.
    pub probes: Vec<Probe>,
    /// What decides a sample before its last step, and whether it ends then; its outputs are those
    /// of `output`.
    pub early_exit: Option<EarlyExit>,
}

impl Keep {
    /// Nothing but what these compartments decide.
    pub fn new(output: Output) -> Self {
        Keep { output, probes: Vec::new(), early_exit: None }
    }
}

/// What one sample did.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, Serialize)]
pub struct Outcome {
    /// Spikes of each output.
    pub counts: Vec<u32>,
    /// Scores of the outputs, where their potentials decide.
    pub potentials: Option<Potentials>,
    /// (step, output) of each output spike, ascending.
    pub spikes: Vec<(u32, u32)>,
    /// Timesteps that were run.
    pub steps: u32,
    /// The step after whose update the sample was decided; `None` when that was its last or never.
    pub decided_at: Option<u32>,
    /// The class after that step; `None` also for a sample that was decided silent.
    pub decided_class: Option<u32>,
    /// Timesteps after that one: omitted when a decision ends the sample.
    pub steps_saved: u32,
    /// Counts that any engine keeps.
    pub totals: Totals,
    /// What left its field.
    pub overflow: Overflow,
    /// For each probe `[compartments][steps]`.
    pub probes: Vec<Vec<i32>>,
    /// Timesteps that were not computed because nothing could happen in them.
    pub skipped_steps: u64,
}

impl Outcome {
    /// The output that potentials decide for, where they do; else the one with most spikes, the
    /// lowest on a tie, none when all are silent.
    pub fn class(&self) -> Option<u32> {
        if let Some(potentials) = &self.potentials {
            return potentials.class();
        }
        let most = self.counts.iter().copied().max().filter(|&most| most > 0)?;
        self.counts.iter().position(|&count| count == most).map(|class| class as u32)
    }

    /// The class when the sample was decided; of a sample that was not, that of its end.
    pub fn class_when_decided(&self) -> Option<u32> {
        if self.decided_at.is_some() { self.decided_class } else { self.class() }
    }

    pub(crate) fn decide(&mut self, step: u32) {
        (self.decided_at, self.decided_class) = (Some(step), self.class());
    }
}
