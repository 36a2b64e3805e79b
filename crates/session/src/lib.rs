//! Runs samples through an engine and keeps what was asked for.
//!
//! Input: an engine, samples, the output population, probes, perhaps a rule by which a sample ends
//! before its last step. Output: an [`Outcome`] for each sample, in run order. Samples share
//! nothing: each begins from rest, nothing drains at its end. A sample that is decided early did
//! what the first steps of the whole sample do, count by count.

pub mod cores;
pub mod decision;
pub mod detail;
pub mod error;
pub mod front;
pub mod inputs;
pub mod neurobench;
pub mod observers;
pub mod obtain;
pub mod populations;
pub mod priced;
pub mod ranks;
pub mod samples;
pub mod session;
pub mod shapes;
pub mod steps;
pub mod timeline;
pub mod warnings;

use decision::EarlyExit;
use observers::{Observer, Outputs, Passed, Recording, integer};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use nsim_ir::activity::{Overflow, Totals};
use nsim_ir::base::id::CompartmentId;
use nsim_ir::neurons::NeuronKind;
use nsim_ir::potentials::Potentials;
use nsim_ir::quantised::{Output, Population};
use nsim_ir::spikes::{Copies, Engine, Sample};

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

    fn decide(&mut self, step: u32) {
        (self.decided_at, self.decided_class) = (Some(step), self.class());
    }
}

/// Runs one sample; an observer sees the engine after each step, or after steps in which nothing
/// happened.
pub fn run_sample<E: Engine + ?Sized>(
    engine: &mut E,
    sample: &Sample,
    keep: &Keep,
    observer: impl Observer<E>,
) -> Outcome {
    run_copies(engine, sample, Copies::ONE, keep, observer)
}

/// Runs one sample on this many copies of its network; an observer sees the engine as in
/// [`run_sample`].
pub fn run_copies<E: Engine + ?Sized>(
    engine: &mut E,
    sample: &Sample,
    copies: Copies,
    keep: &Keep,
    mut observer: impl Observer<E>,
) -> Outcome {
    let steps = sample.steps();
    let mut probes = Recording::new(&keep.probes, steps, integer::<E>);
    let mut outputs = Outputs::new(keep, steps);
    let (mut shown, mut step) = ((Vec::new(), Vec::new()), 0);
    engine.begin(steps);
    while step < steps && !outputs.is_over() {
        let silent = sample.at(step).is_empty();
        let rests = if silent { outputs.may_rest(engine, step, sample.next_spike(step)) } else { 0 };
        let at_rest = rests > 0 && engine.rest(rests);
        if !at_rest {
            engine.step(copies.input(sample.input(step), &mut shown));
        }
        let steps = if at_rest { rests } else { 1 };
        let passed = Passed { first: step, steps, at_rest, decided: outputs.is_decided() };
        outputs.see(engine, passed);
        probes.see(engine, passed);
        observer.see(engine, passed);
        step += steps;
    }
    engine.settle();
    let (totals, overflow) = (engine.totals(), engine.overflow());
    Outcome { probes: probes.kept, totals, overflow, ..outputs.outcome(step) }
}

/// The share of samples whose class is their label; `None` unless all have one.
pub fn accuracy(outcomes: &[Outcome], labels: impl IntoIterator<Item = Option<u32>>) -> Option<f64> {
    share_right(outcomes, labels, Outcome::class)
}

/// The share of samples whose class, by this function, is their label; `None` unless all have one.
pub fn share_right(
    outcomes: &[Outcome],
    labels: impl IntoIterator<Item = Option<u32>>,
    class: impl Fn(&Outcome) -> Option<u32>,
) -> Option<f64> {
    let labels = labels.into_iter().collect::<Option<Vec<u32>>>().filter(|labels| !labels.is_empty())?;
    let right = outcomes.iter().zip(&labels).filter(|(outcome, label)| class(outcome) == Some(**label));
    Some(right.count() as f64 / labels.len() as f64)
}

/// The least step by which half of the samples that were decided early were decided; `None` where
/// none was.
pub fn median_decision(outcomes: &[Outcome]) -> Option<u32> {
    let mut steps: Vec<u32> = outcomes.iter().filter_map(|outcome| outcome.decided_at).collect();
    steps.sort_unstable();
    steps.get(steps.len().saturating_sub(1) / 2).copied()
}

/// SHA-256 over little-endian u32 triples (sample in run order, step, output) of all output spikes,
/// ascending.
pub fn digest(outcomes: &[Outcome]) -> String {
    let mut hash = Sha256::new();
    for (sample, outcome) in outcomes.iter().enumerate() {
        for &(step, output) in &outcome.spikes {
            for word in [sample as u32, step, output] {
                hash.update(word.to_le_bytes());
            }
        }
    }
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_class_is_the_first_with_most_spikes() {
        let class = |counts: &[u32]| Outcome { counts: counts.to_vec(), ..Outcome::default() }.class();
        assert_eq!(class(&[1, 3, 3]), Some(1));
        assert_eq!(class(&[0, 0]), None);
    }

    #[test]
    fn the_digest_of_nothing_is_that_of_the_empty_string() {
        assert_eq!(digest(&[]), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
        let one = Outcome { spikes: vec![(2, 1)], ..Outcome::default() };
        assert_eq!(
            digest(&[Outcome::default(), one]),
            "d04468d46671f8bb09408f2dc16a4a4c0f9562beebf8835d408317adcf3a7528"
        );
    }
}
