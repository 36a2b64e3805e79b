//! Proof that relays deliver every spike to its targets in the intended step.
//!
//! The rule, for a network N, a network M and the steps L(p) by which the spikes of each population
//! p of N are later in M:
//!
//! 1. *Frame.* M begins with the populations of N: names, shapes, units and payloads are equal,
//!    except for start steps, which are L(p) later; L is 0 for inputs. Output, semantics (the
//!    chip's), threshold test and reset agree.
//! 2. *Relays.* All further compartments of M decay fully in a step, have no bias and no payload,
//!    and start no later than their source. Exactly one synapse leads to each. Its scaled weight is
//!    above the relay's threshold and below the 2^21 at which an accumulator wraps. Its source
//!    sends no graded spikes. So a relay spikes in the step in which its synapse brings a spike,
//!    and in no other.
//! 3. *Synapses.* For a source s of a population p of N let R(s) be the multiset of (target in q,
//!    format, weight, d + L(q) - L(p)) over its synapses in N, and D(s) the multiset of (target,
//!    format, weight, d + e) over all synapses of M to compartments of N that begin at s or at a
//!    relay that s reaches, where e is the sum, over the relays on the path, of 1 and the delay of
//!    the synapse to the relay. Then R(s) = D(s).
//! 4. *Nothing else.* Every relay is reached by a source of N.
//!
//! With 1 to 4 the spikes of p in M are its spikes in N, L(p) steps later, by induction over steps.
//! The checker enumerates the synapses of both networks and calls no code that made M.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use nsim_dynamics::arithmetic::scaled;
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::arithmetic::{Semantics, ThresholdTest};
use nsim_ir::base::id::{CompartmentId, IdVec, PopulationId};
use nsim_ir::quantised::connectivity::SynapseFormat;
use nsim_ir::quantised::{Neuron, Population, Quantised, Units};
use nsim_ir::spikes::Message;

/// Number of sources of one task.
const PIECE: u32 = 1 << 10;
/// Value at which an accumulator wraps.
const WRAPS_AT: i64 = 1 << 21;

/// A difference that relays make.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Unfaithful {
    /// A property of the network itself.
    #[error("relays change {0}")]
    Frame(String),
    /// A relay that does not forward each spike once and in time.
    #[error("compartment {0} is not a relay: its spikes may differ from the spikes of its source")]
    Relay(CompartmentId),
    /// A source that reaches other synapses, or in other steps.
    #[error("relays change the synapses of {population} {index}, or their steps")]
    Synapses {
        /// The population of the source.
        population: String,
        /// Its index there.
        index: u32,
    },
    /// A relay that nothing reaches.
    #[error("relay {0} has no source")]
    Unreached(CompartmentId),
}

/// A synapse as required by its source: target, format, weight, and the steps from its spike to its
/// arrival, less one.
type ArrivingSynapse = (u32, SynapseFormat, i16, i64);

/// Steps by which the spikes of each population are later.
type Later = IdVec<PopulationId, u32>;

/// Checks the rule.
///
/// # Errors
/// The first difference: the frame, then synapses by source, then relays that nothing reaches.
pub fn check(original: &Quantised, relayed: &Quantised, later: &Later) -> Result<(), Unfaithful> {
    check_frame(original, relayed, later)?;
    let relays = original.compartments()..relayed.compartments();
    let reached: Vec<AtomicBool> = relays.clone().map(|_| AtomicBool::new(false)).collect();
    let walk = Walk { original, relayed, reached: &reached };
    for (id, population) in original.populations().enumerate() {
        let size = population.shape.len();
        let failed = (0..size.div_ceil(PIECE))
            .into_par_iter()
            .map(|piece| walk.compare(id, piece * PIECE..((piece + 1) * PIECE).min(size), later))
            .find_map_first(Result::err);
        if let Some(difference) = failed {
            return Err(difference);
        }
    }
    let unreached = relays.zip(&reached).find(|(_, reached)| !reached.load(Ordering::Relaxed));
    unreached.map_or(Ok(()), |(relay, _)| Err(Unfaithful::Unreached(CompartmentId(relay))))
}

fn check_frame(original: &Quantised, relayed: &Quantised, later: &Later) -> Result<(), Unfaithful> {
    let (expected, actual) = (original.parts(), relayed.parts());
    let rules = [
        (later.len() == expected.populations.len(), "the list of populations"),
        (expected.populations.len() <= actual.populations.len(), "the list of populations"),
        (original.channels() == relayed.channels(), "the number of input channels"),
        (actual.output == expected.output, "the output population"),
        (actual.decision == expected.decision, "the decision"),
        (actual.semantics == expected.semantics && actual.semantics == Semantics::Hardware, "the semantics"),
        (actual.threshold == expected.threshold, "the threshold test"),
        (actual.reset == expected.reset, "the reset"),
    ];
    if let Some((_, what)) = rules.into_iter().find(|(holds, _)| !holds) {
        return Err(Unfaithful::Frame(what.to_string()));
    }
    for ((id, a), b) in expected.populations.enumerate().zip(actual.populations.iter()) {
        if !same_population(a, b, later[id]) {
            return Err(Unfaithful::Frame(format!("population {}", a.name)));
        }
    }
    Ok(())
}

fn same_population(expected: &Population, actual: &Population, later: u32) -> bool {
    let same_units = match (&expected.units, &actual.units) {
        (Units::Input(a), Units::Input(b)) => a == b && later == 0,
        (
            Units::Compartments { first: a, neurons: of_a, start_step: from_a },
            Units::Compartments { first: b, neurons: of_b, start_step: from_b },
        ) => {
            let same = |index| of_a.get(index) == of_b.get(index);
            a == b && from_a.checked_add(later) == Some(*from_b) && (0..expected.shape.len()).all(same)
        }
        _ => false,
    };
    expected.name == actual.name && expected.shape == actual.shape && expected.message == actual.message && same_units
}

/// Follows spikes through relays.
struct Walk<'a> {
    original: &'a Quantised,
    relayed: &'a Quantised,
    reached: &'a [AtomicBool],
}

impl Walk<'_> {
    fn compare(&self, population: PopulationId, sources: Range<u32>, later: &Later) -> Result<(), Unfaithful> {
        let (mut expected, mut reached): (Vec<ArrivingSynapse>, Vec<ArrivingSynapse>) = (Vec::new(), Vec::new());
        for index in sources {
            expected.clear();
            for (_, projection, first) in self.original.targets_of(population) {
                let shift = i64::from(later[projection.target]) - i64::from(later[population]);
                let arrives = i64::from(projection.delay.get()) + shift;
                projection.connectivity.for_each_from(index, |target, weight| {
                    expected.push((first.0 + target, projection.format, weight, arrives));
                });
            }
            reached.clear();
            self.follow(population, index, 0, &mut reached)?;
            expected.sort_unstable();
            reached.sort_unstable();
            if expected != reached {
                let population = self.original.populations()[population].name.clone();
                return Err(Unfaithful::Synapses { population, index });
            }
        }
        Ok(())
    }

    /// Collects the synapses that a source reaches, `after` steps after the spike of the first
    /// source.
    fn follow(
        &self,
        population: PopulationId,
        index: u32,
        after: i64,
        reached: &mut Vec<ArrivingSynapse>,
    ) -> Result<(), Unfaithful> {
        let own = self.original.compartments();
        let from = &self.relayed.populations()[population];
        let mut relays = Vec::new();
        for (_, projection, first) in self.relayed.targets_of(population) {
            let arrives = after + i64::from(projection.delay.get());
            projection.connectivity.for_each_from(index, |target, weight| {
                let target = first.0 + target;
                if target < own {
                    reached.push((target, projection.format, weight, arrives));
                } else {
                    relays.push((target, scaled(projection.format, weight), arrives + 1));
                }
            });
        }
        for (relay, weight, after) in relays {
            let id = CompartmentId(relay);
            let again = self.reached[(relay - own) as usize].swap(true, Ordering::Relaxed);
            let (population, index) = self.relayed.population_of(id);
            if again || !self.relays_every_spike(from, &self.relayed.populations()[population], index, weight) {
                return Err(Unfaithful::Relay(id));
            }
            self.follow(population, index, after, reached)?;
        }
        Ok(())
    }

    /// Whether a compartment spikes exactly if a spike of this population arrives over this weight.
    fn relays_every_spike(&self, from: &Population, relays: &Population, index: u32, weight: i32) -> bool {
        let Units::Compartments { neurons, start_step, .. } = &relays.units else { return false };
        let neuron = neurons.get(index);
        let starts = if let Units::Compartments { start_step, .. } = from.units { start_step } else { 0 };
        let (weight, threshold) = (i64::from(weight), i64::from(neuron.vth.get()) * 64);
        let fires = match self.relayed.parts().threshold {
            ThresholdTest::Strict => weight > threshold,
            // An idle relay must not reach a threshold of zero.
            ThresholdTest::Inclusive => weight >= threshold && threshold > 0,
        };
        neuron == (Neuron { vth: neuron.vth, ..Neuron::PLAIN })
            && fires
            && weight < WRAPS_AT
            && from.message == Message::Spike
            && relays.message == Message::Spike
            && *start_step <= starts
    }
}
