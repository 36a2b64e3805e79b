//! Settings of the stored results of a sample, and its outcome.
//!
//! Input: an output population, probes, optionally the rule of an early exit ([`SampleSettings`]).
//! Output: an [`Outcome`] with spikes or scores of the outputs, the class, counts and recorded
//! numbers.

use serde::{Deserialize, Serialize};

use crate::decision::EarlyExit;
use nsim_ir::activity::{Overflow, Totals};
use nsim_ir::base::id::{CompartmentId, RuleId};
use nsim_ir::learning::Column;
use nsim_ir::learning::draws::Draws;
use nsim_ir::neurons::NeuronKind;
use nsim_ir::potentials::Potentials;
use nsim_ir::quantised::{Output, Population};

/// A quantity that a probe records.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Quantity {
    /// 0 or 1.
    Spikes,
    /// The current register.
    U,
    /// The potential: v, or the first word of state of a kind without one.
    Potential,
    /// Value of the chip's voltage register.
    VRegister,
    /// Payload of the message; 0 where none is sent.
    Message,
    /// A word of state, by its index in the table of the kind.
    State(usize),
    /// A column of a rule's state after the learning of each step; with `last`, of the last step.
    Learned {
        /// The rule.
        rule: RuleId,
        /// The column.
        column: Column,
        /// Whether only the value after the last step is recorded.
        last: bool,
        /// Steps by which an engine shows it late.
        lag: u32,
    },
}

impl Quantity {
    /// Every quantity of compartments with registers, with the name that arguments and files use.
    pub const ALL: [(Quantity, &'static str); 5] = [
        (Quantity::Spikes, "spikes"),
        (Quantity::U, "u"),
        (Quantity::Potential, "v"),
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
    /// The recorded quantity.
    pub quantity: Quantity,
}

impl Probe {
    /// Whether one value is recorded, not one for each step.
    pub fn is_last(&self) -> bool {
        matches!(self.quantity, Quantity::Learned { last: true, .. })
    }

    /// Whether a column of a rule is recorded in each step.
    pub(crate) fn follows_learning(&self) -> bool {
        matches!(self.quantity, Quantity::Learned { last: false, .. })
    }

    /// Returns the probe of a population's compartments for this name of a quantity or word of
    /// state; `None` where they have none of this name.
    pub fn named(population: &Population, what: &str) -> Option<Probe> {
        let (first, count) = (population.first_compartment()?, population.shape.len());
        Some(Probe { first, count, quantity: Quantity::of_kind(population.neuron_kind()?, what)? })
    }

    /// Returns the probe of the potentials of a population's compartments; `None` where they have
    /// none.
    pub fn of_potential(population: &Population) -> Option<Probe> {
        let (first, count) = (population.first_compartment()?, population.shape.len());
        population.neuron_kind()?.potential()?;
        Some(Probe { first, count, quantity: Quantity::Potential })
    }
}

/// Settings of learning over the samples of a run.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LearningSettings {
    /// Random numbers.
    pub draws: Draws,
    /// Whether each sample starts from the weights of the model.
    pub fresh: bool,
    /// The number of samples after which a run starts from the weights of the model; 0 for never.
    pub period: usize,
    /// Number of the first sample in its input, which selects the random numbers of fresh samples.
    pub first: usize,
    /// Number of rules whose state after the last sample is stored.
    pub rules: usize,
}

impl LearningSettings {
    /// Settings with seeded random numbers.
    pub fn seeded(seed: u64) -> Self {
        LearningSettings { draws: Draws::seeded(seed), ..LearningSettings::default() }
    }

    /// Settings of `samples` samples, the same ones `repeat` times, from number `first` of their
    /// input on.
    pub fn of_samples(samples: usize, repeat: u32, first: usize) -> Self {
        LearningSettings { period: samples / repeat.max(1) as usize, first, ..LearningSettings::default() }
    }

    /// The number of the run that starts anew before the sample at this place of the run, if any.
    pub(crate) fn restart(&self, place: usize) -> Option<u32> {
        if self.fresh {
            return Some((self.first + place) as u32);
        }
        (place > 0 && self.period > 0 && place.is_multiple_of(self.period)).then(|| (place / self.period) as u32)
    }
}

/// Results to store of each sample, and the rule by which it ends.
#[derive(Debug, Clone)]
pub struct SampleSettings {
    /// The output compartments, which decide the class.
    pub output: Output,
    /// Probes; steps skipped by an early exit are zero in them.
    pub probes: Vec<Probe>,
    /// Rule that decides a sample before its last step, and whether the sample then ends; its
    /// outputs are `output`.
    pub early_exit: Option<EarlyExit>,
    /// Learning over the samples.
    pub learning: LearningSettings,
}

impl SampleSettings {
    /// Returns settings that store only the spikes and decision of these compartments.
    pub fn new(output: Output) -> Self {
        SampleSettings { output, probes: Vec::new(), early_exit: None, learning: LearningSettings::default() }
    }
}

/// Results of one sample.
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
    /// The step after which the sample was decided; `None` for its last step or if undecided.
    pub decided_at: Option<u32>,
    /// The class after that step; `None` also for a sample that was decided without output spikes.
    pub decided_class: Option<u32>,
    /// Timesteps after that step: skipped when a decision ends the sample.
    pub steps_saved: u32,
    /// Counts that every engine has.
    pub totals: Totals,
    /// Counts of overflows, by field.
    pub overflow: Overflow,
    /// Synapses whose rule was evaluated.
    #[serde(default)]
    pub synaptic_updates: u64,
    /// For each probe `[compartments][steps]`.
    pub probes: Vec<Vec<i32>>,
    /// Timesteps that were not computed because nothing could happen in them.
    pub skipped_steps: u64,
}

impl Outcome {
    /// Returns the class by potentials, where they decide; else the output with most spikes, the
    /// lowest on a tie, `None` when all are silent.
    pub fn class(&self) -> Option<u32> {
        if let Some(potentials) = &self.potentials {
            return potentials.class();
        }
        let most = self.counts.iter().copied().max().filter(|&most| most > 0)?;
        self.counts.iter().position(|&count| count == most).map(|class| class as u32)
    }

    /// Returns the class when the sample was decided; of an undecided sample, the class at its end.
    pub fn class_when_decided(&self) -> Option<u32> {
        if self.decided_at.is_some() { self.decided_class } else { self.class() }
    }

    pub(crate) fn decide(&mut self, step: u32) {
        (self.decided_at, self.decided_class) = (Some(step), self.class());
    }
}
