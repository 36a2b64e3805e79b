//! Input spikes of a sample, spikes with payloads, and the interface of an engine.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::activity::{MovingEvent, Overflow, StepActivity, Totals};
use crate::base::fixed::{MessageBits, Payload};
use crate::base::id::{ChannelId, CompartmentId, Id, RuleId};
use crate::base::warning::Warning;
use crate::learning::Column;
use crate::learning::draws::Draws;

/// Content of a population's messages, in addition to their source.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
pub enum Message {
    /// Nothing: a binary spike.
    #[default]
    Spike,
    /// One integer, the same in every message.
    Payload(Payload),
    /// An integer that the neuron computes or the input gives, of at most this number of bits. A
    /// wider one is sent unchanged and reported.
    Value(MessageBits),
}

impl Message {
    /// Factor by which every message multiplies weights, 1 for a spike; `None` where messages
    /// differ.
    pub fn factor(self) -> Option<i32> {
        match self {
            Message::Spike => Some(1),
            Message::Payload(payload) => Some(payload.get()),
            Message::Value(_) => None,
        }
    }

    /// Bits of the integer in a message, its sign included; 0 for a spike.
    pub fn bits(self) -> u32 {
        match self {
            Message::Spike => 0,
            Message::Payload(payload) => 33 - (payload.get() ^ payload.get() >> 31).leading_zeros(),
            Message::Value(bits) => bits.get().into(),
        }
    }

    /// The greatest magnitude of a factor by which a message multiplies weights.
    pub fn greatest(self) -> u64 {
        match self {
            Message::Value(bits) => 1 << (bits.get() - 1),
            message => message.factor().map_or(1, |factor| factor.unsigned_abs().into()),
        }
    }
}

/// Messages of one step: their channels, ascending, each once, and their values.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Spikes<'a> {
    /// The channels.
    pub ids: &'a [ChannelId],
    /// The value of each message, 1 for populations without values; empty where every one is 1.
    pub values: &'a [i32],
}

impl<'a, T: AsRef<[ChannelId]> + ?Sized> From<&'a T> for Spikes<'a> {
    fn from(ids: &'a T) -> Self {
        Spikes { ids: ids.as_ref(), values: &[] }
    }
}

/// Spikes of one sample on the channels of a network, grouped by step.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sample {
    label: Option<u32>,
    /// Offsets, one more than steps; spikes of step t are `first[t]..first[t + 1]`.
    first: Vec<u32>,
    channels: Vec<ChannelId>,
    /// The value of each spike; empty where every one is 1.
    values: Vec<i32>,
}

/// Reason why events do not make a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum SampleError {
    /// An event lies at or after the end.
    #[error("a spike at step {step} is outside the sample's {steps} steps")]
    Step {
        /// The event's step.
        step: u32,
        /// The sample's steps.
        steps: u32,
    },
    /// More events than can be counted.
    #[error("the sample has more than 2^32 - 1 spikes")]
    TooMany,
}

impl Sample {
    /// A sample without spikes.
    pub fn silent(steps: u32) -> Self {
        Sample { label: None, first: vec![0; steps as usize + 1], channels: Vec::new(), values: Vec::new() }
    }

    /// A sample of `steps` timesteps from (step, channel) events in any order; an event given twice
    /// is one spike.
    ///
    /// # Errors
    /// [`SampleError`] for an event outside the sample.
    pub fn new(steps: u32, events: &[(u32, ChannelId)], label: Option<u32>) -> Result<Self, SampleError> {
        if u32::try_from(events.len()).is_err() {
            return Err(SampleError::TooMany);
        }
        // Recordings are ordered by channel or by step. In both cases a stable counting sort by
        // step leaves each step's channels ascending, and little is left to sort.
        let mut next = vec![0u32; steps as usize + 1];
        for &(step, _) in events {
            *next.get_mut(step as usize + 1).ok_or(SampleError::Step { step, steps })? += 1;
        }
        for t in 0..steps as usize {
            next[t + 1] += next[t];
        }
        let mut channels = vec![ChannelId(0); events.len()];
        for &(step, channel) in events {
            let place = &mut next[step as usize];
            channels[*place as usize] = channel;
            *place += 1;
        }
        // Each entry has advanced to the end of its step, where the next step begins.
        let mut first = Vec::with_capacity(steps as usize + 1);
        first.push(0);
        let (mut begin, mut kept) = (0, 0);
        for &end in &next[..steps as usize] {
            let end = end as usize;
            let spiking = &mut channels[begin..end];
            if spiking.windows(2).any(|pair| pair[0] > pair[1]) {
                spiking.sort_unstable();
            }
            let start = kept;
            for at in begin..end {
                let channel = channels[at];
                if kept == start || channels[kept - 1] != channel {
                    channels[kept] = channel;
                    kept += 1;
                }
            }
            begin = end;
            first.push(kept as u32);
        }
        channels.truncate(kept);
        Ok(Sample { label, first, channels, values: Vec::new() })
    }

    /// A sample from (step, channel, value) events in any order. Of repeated events the last one
    /// counts; an event of value 0 is none.
    ///
    /// # Errors
    /// [`SampleError`] for an event outside the sample.
    pub fn with_values(steps: u32, events: &[(u32, ChannelId, i32)], label: Option<u32>) -> Result<Self, SampleError> {
        let by_place: BTreeMap<(u32, ChannelId), i32> = events.iter().map(|&(t, id, value)| ((t, id), value)).collect();
        let sent = by_place.into_iter().filter(|(_, value)| *value != 0);
        let (places, values): (Vec<_>, Vec<_>) = sent.unzip();
        let values = if values.iter().all(|&value| value == 1) { Vec::new() } else { values };
        Ok(Sample { values, ..Sample::new(steps, &places, label)? })
    }

    /// Returns this sample with another label.
    #[must_use]
    pub fn with_label(self, label: Option<u32>) -> Self {
        Sample { label, ..self }
    }

    /// Repeats this sample on the channels of `copies` copies of a network of `channels` channels.
    pub fn copies(&self, copies: u32, channels: u32) -> Sample {
        let spikes =
            |step| (0..copies).flat_map(move |k| self.at(step).iter().map(move |c| ChannelId(c.0 + k * channels)));
        Sample {
            label: self.label,
            first: self.first.iter().map(|&first| first * copies).collect(),
            channels: (0..self.steps()).flat_map(spikes).collect(),
            values: (0..self.steps()).flat_map(|step| self.input(step).values.repeat(copies as usize)).collect(),
        }
    }

    /// Returns this sample followed by `steps` steps without spikes.
    #[must_use]
    pub fn followed_by(mut self, steps: u32) -> Self {
        let end = self.first.last().copied().unwrap_or(0);
        self.first.extend(std::iter::repeat_n(end, steps as usize));
        self
    }

    /// The first `steps` steps, or all of a shorter sample.
    pub fn beginning(&self, steps: u32) -> Sample {
        let first = self.first[..=steps.min(self.steps()) as usize].to_vec();
        let spikes = first.last().map_or(0, |&end| end as usize);
        let values = self.values.iter().copied().take(spikes).collect();
        Sample { label: self.label, first, channels: self.channels[..spikes].to_vec(), values }
    }

    /// Number of timesteps.
    pub fn steps(&self) -> u32 {
        (self.first.len() - 1) as u32
    }

    /// The label of its class, when known.
    pub fn label(&self) -> Option<u32> {
        self.label
    }

    /// The channels that spike in a step, ascending, each once.
    #[inline]
    pub fn at(&self, step: u32) -> &[ChannelId] {
        &self.channels[self.first[step as usize] as usize..self.first[step as usize + 1] as usize]
    }

    /// The channels that spike in a step, with their values.
    #[inline]
    pub fn input(&self, step: u32) -> Spikes<'_> {
        let range = self.first[step as usize] as usize..self.first[step as usize + 1] as usize;
        Spikes { values: self.values.get(range.clone()).unwrap_or(&[]), ids: &self.channels[range] }
    }

    /// The first step from `step` on that has a spike; the number of steps if there is none.
    pub fn next_spike(&self, step: u32) -> u32 {
        let passed = self.first[step as usize];
        self.first.partition_point(|&first| first <= passed).saturating_sub(1).max(step as usize) as u32
    }

    /// Number of spikes.
    pub fn spikes(&self) -> usize {
        self.channels.len()
    }
}

/// The samples of a run, all for the channels of one network.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Stimulus {
    /// The samples, in run order.
    pub samples: Vec<Sample>,
    /// Descriptions of their origin, which results record.
    pub origin: Vec<String>,
    /// The seed, when one was used.
    pub seed: Option<u64>,
    /// Changes of recordings.
    pub warnings: Vec<Warning>,
}

/// A spike to deliver to its synapses.
pub trait Spike: Copy {
    /// The type of its payload: `()` or an integer.
    type Payload: Copy;
    /// Whether it has no payload.
    const BINARY: bool;
    /// The index of its source.
    fn source(self) -> usize;
    /// Its payload.
    fn payload(self) -> Self::Payload;
}

/// A binary spike is the id of its source.
impl<I: Id> Spike for I {
    type Payload = ();
    const BINARY: bool = true;

    #[inline(always)]
    fn source(self) -> usize {
        self.index()
    }

    #[inline(always)]
    fn payload(self) {}
}

/// A spike with an integer payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GradedSpike<I> {
    /// Its source.
    pub id: I,
    /// Its payload.
    pub payload: i32,
}

impl<I: Id> Spike for GradedSpike<I> {
    type Payload = i32;
    const BINARY: bool = false;

    #[inline(always)]
    fn source(self) -> usize {
        self.id.index()
    }

    #[inline(always)]
    fn payload(self) -> i32 {
        self.payload
    }
}

/// Integers that a step adds to a `Loihi` compartment in the chip's arithmetic: noise, for example.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Added {
    /// The compartment.
    pub compartment: CompartmentId,
    /// Added to its arrivals before equation (2) narrows them, in units of 1.
    pub to_q: i32,
    /// Added to u + b before equation (6) narrows them.
    pub to_bias: i32,
}

/// Interface of an engine, by which probes, digests and comparisons read its state after a step.
/// The engine is chosen at run time.
pub trait Engine {
    /// Number of input channels of its network.
    fn channels(&self) -> u32;
    /// Clears state, traces, spikes in flight and all counts before a sample of `steps` steps. What
    /// was learned stays.
    fn begin(&mut self, steps: u32);
    /// Runs one timestep with these input channels spiking (ascending, each once). Spikes of a
    /// population with a payload carry that payload.
    fn step(&mut self, input: Spikes<'_>);
    /// Skips `steps` steps without input and returns true, if the network is idle in them.
    /// Registers then stay as they are, and counts are as if the steps were computed. Otherwise
    /// does nothing and returns false. With 0 it only returns whether the network is idle.
    fn skip_idle(&mut self, steps: u32) -> bool {
        let _ = steps;
        false
    }
    /// Restores the weights, delays and tags that the network had before it learned, for run
    /// number `run`, which has random numbers of its own. A later [`Engine::begin`] starts it.
    fn forget(&mut self, run: u32) {
        let _ = run;
    }
    /// Sets the random numbers of learning, before [`Engine::begin`].
    fn set_draws(&mut self, draws: &Draws) {
        let _ = draws;
    }
    /// Adds integers in the next step, in addition to those given before. Engines of real numbers
    /// ignore them.
    fn add(&mut self, added: &[Added]) {
        let _ = added;
    }
    /// A column of a rule's state in the first copy of the network: by row of the rule for a
    /// variable, by source or target of the rule for a trace. The delivery that follows a step
    /// notes its spikes, so the values are those after the learning of the step before the last;
    /// after [`Engine::settle`], of the last. Empty in engines that do not learn.
    fn learned(&self, rule: RuleId, column: Column) -> Vec<i32> {
        let _ = (rule, column);
        Vec::new()
    }
    /// Number of synaptic updates of the sample so far: synapses whose rule was evaluated.
    fn synaptic_updates(&self) -> u64 {
        0
    }
    /// Compartments that spiked in the last step, each once, in any order, because most callers
    /// need no sorted list.
    fn spikes(&self) -> &[CompartmentId];
    /// Payload of each of [`Engine::spikes`], in that order, 1 for a binary spike. Empty if all
    /// messages of the network are binary spikes, and in engines of real numbers.
    fn payloads(&self) -> &[i32] {
        &[]
    }
    /// Compartments that spiked in the last step, ascending.
    fn ascending_spikes(&self) -> Vec<CompartmentId> {
        let mut spikes = self.spikes().to_vec();
        spikes.sort_unstable();
        spikes
    }
    /// A word of state after the last step, by its place in the table of the compartment's kind.
    fn state(&self, compartment: CompartmentId, column: usize) -> i32 {
        if column == 0 { self.u(compartment) } else { self.v(compartment) }
    }
    /// The current register after the last step; 0 for a kind without one.
    fn u(&self, compartment: CompartmentId) -> i32;
    /// The membrane after the last step: 0 at a spike and while refractory.
    fn v(&self, compartment: CompartmentId) -> i32;
    /// The potential ([`crate::neurons::NeuronKind::potential`]) after the last step, unrounded in
    /// engines of reals; 0 for a kind without one.
    fn potential(&self, compartment: CompartmentId) -> f64 {
        self.v(compartment).into()
    }
    /// Value of the chip's voltage register: the refractory counter while it is running
    /// (`docs/semantics.md`, probes), the membrane otherwise.
    fn v_register(&self, compartment: CompartmentId) -> i32;
    /// Waits for the messages of other processes for the last step, before counts are read.
    fn settle(&mut self) {}
    /// Counts of the last step and its events of learned delays, where steps are counted by core.
    fn last_activity(&self) -> Option<(&StepActivity, &[MovingEvent])> {
        None
    }
    /// Drops the counts by core and source of the steps so far.
    fn drop_counts(&mut self) {}
    /// Counts since `begin`.
    fn totals(&self) -> Totals;
    /// Counts of overflows since `begin`.
    fn overflow(&self) -> Overflow;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_are_grouped_sorted_and_counted_once() {
        let events = vec![(2, ChannelId(1)), (0, ChannelId(5)), (2, ChannelId(0)), (2, ChannelId(1))];
        let sample = Sample::new(4, &events, None).unwrap();
        assert_eq!(sample.at(0), [ChannelId(5)]);
        assert_eq!(sample.at(2), [ChannelId(0), ChannelId(1)]);
        assert_eq!((sample.at(3).len(), sample.steps(), sample.spikes()), (0, 4, 3));
        let next: Vec<u32> = (0..4).map(|step| sample.next_spike(step)).collect();
        assert_eq!(next, [0, 2, 2, 4]);
        // Compared with a full sort, for random events with repeats.
        for seed in 0..50 {
            let draw = |k, entity, n| crate::base::rng::below(n, seed, entity, k) as u32;
            let events: Vec<(u32, ChannelId)> =
                (0..seed * 4).map(|k| (draw(k, 0, 7), ChannelId(draw(k, 1, 5)))).collect();
            let sample = Sample::new(7, &events.clone(), None).unwrap();
            let mut sorted = events;
            sorted.sort_unstable();
            sorted.dedup();
            let listed: Vec<_> = (0..7).flat_map(|t| sample.at(t).iter().map(move |&c| (t, c))).collect();
            assert_eq!(listed, sorted);
        }
        let late = Sample::new(4, &[(4, ChannelId(0))], None);
        assert_eq!(late, Err(SampleError::Step { step: 4, steps: 4 }));
    }
}
