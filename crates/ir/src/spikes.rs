//! Input spikes of a sample, spikes with what they carry, and the interface of an engine.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::activity::{Overflow, Totals};
use crate::base::fixed::{MessageBits, Payload};
use crate::base::id::{ChannelId, CompartmentId, Id};

/// What the messages of a population carry besides their source.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
pub enum Message {
    /// Nothing: a binary spike.
    #[default]
    Spike,
    /// The same integer each.
    Payload(Payload),
    /// An integer that the neuron computes or the input gives, of at most this many bits. A greater
    /// one is sent whole and reported.
    Value(MessageBits),
}

impl Message {
    /// What every message multiplies the weights of its synapses by, 1 for a spike; `None` where
    /// that differs from message to message.
    pub fn factor(self) -> Option<i32> {
        match self {
            Message::Spike => Some(1),
            Message::Payload(payload) => Some(payload.get()),
            Message::Value(_) => None,
        }
    }

    /// The bits of an integer that a message carries, its sign included.
    pub fn bits(self) -> u32 {
        match self {
            Message::Spike => 0,
            Message::Payload(payload) => 33 - (payload.get() ^ payload.get() >> 31).leading_zeros(),
            Message::Value(bits) => bits.get().into(),
        }
    }

    /// The greatest magnitude that a message multiplies weights by.
    pub fn greatest(self) -> u64 {
        match self {
            Message::Value(bits) => 1 << (bits.get() - 1),
            message => message.factor().map_or(1, |factor| factor.unsigned_abs().into()),
        }
    }
}

/// Messages of one step: their sources, ascending, each once, and what they carry.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Spikes<'a> {
    /// The channels.
    pub ids: &'a [ChannelId],
    /// The values of the channels of populations whose messages have values, 1 for others; empty
    /// where every one is 1.
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
    /// One more than steps; spikes of step t are `first[t]..first[t + 1]`.
    first: Vec<u32>,
    channels: Vec<ChannelId>,
    /// What each carries; empty where every one is 1.
    values: Vec<i32>,
}

/// Copies of a network that all see the same sample, each on channels of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Copies {
    /// Number of copies.
    pub copies: u32,
    /// Input channels of one.
    pub channels: u32,
}

impl Copies {
    /// The network itself.
    pub const ONE: Copies = Copies { copies: 1, channels: 0 };

    /// The input of all copies, from that of one.
    pub fn input<'s>(self, one: Spikes<'s>, (shown, values): &'s mut (Vec<ChannelId>, Vec<i32>)) -> Spikes<'s> {
        if self.copies == 1 {
            return one;
        }
        shown.clear();
        values.clear();
        for first in (0..self.copies).map(|copy| copy * self.channels) {
            shown.extend(one.ids.iter().map(|channel| ChannelId(channel.0 + first)));
            values.extend(one.values);
        }
        Spikes { ids: shown, values }
    }
}

/// Why spikes do not make a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum SampleError {
    /// An event lies at or after the end.
    #[error("a spike at step {step} lies outside the sample's {steps} steps")]
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
        // Recordings come channel by channel or step by step; either way a stable count over steps
        // leaves each step's channels ascending, and little is left to sort.
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
        // Each step's entry has moved to its end, which is where the next one begins.
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

    /// A sample from (step, channel, value) events in any order; of events given twice the last
    /// counts, and a value of 0 is none.
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

    /// The same spikes with another class.
    #[must_use]
    pub fn with_label(self, label: Option<u32>) -> Self {
        Sample { label, ..self }
    }

    /// The same spikes on the channels of this many copies of a network, one after the other.
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

    /// The same spikes followed by `steps` steps without any.
    #[must_use]
    pub fn followed_by(mut self, steps: u32) -> Self {
        let end = self.first.last().copied().unwrap_or(0);
        self.first.extend(std::iter::repeat_n(end, steps as usize));
        self
    }

    /// The first this many steps, or all of a shorter sample.
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

    /// The class that it shows, when known.
    pub fn label(&self) -> Option<u32> {
        self.label
    }

    /// The channels that spike in a step, ascending, each once.
    #[inline]
    pub fn at(&self, step: u32) -> &[ChannelId] {
        &self.channels[self.first[step as usize] as usize..self.first[step as usize + 1] as usize]
    }

    /// The same channels with what they carry.
    #[inline]
    pub fn input(&self, step: u32) -> Spikes<'_> {
        let range = self.first[step as usize] as usize..self.first[step as usize + 1] as usize;
        Spikes { values: self.values.get(range.clone()).unwrap_or(&[]), ids: &self.channels[range] }
    }

    /// The first step from this one on that has a spike, or the end.
    pub fn next_spike(&self, step: u32) -> u32 {
        let passed = self.first[step as usize];
        self.first.partition_point(|&first| first <= passed).saturating_sub(1).max(step as usize) as u32
    }

    /// All spikes.
    pub fn spikes(&self) -> usize {
        self.channels.len()
    }
}

/// The samples of a run, all for the channels of the same network.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Stimulus {
    /// In run order.
    pub samples: Vec<Sample>,
    /// How they were made, for the record; ends up in results.
    pub origin: Vec<String>,
    /// The seed, when one was used.
    pub seed: Option<u64>,
}

/// A spike on its way to its synapses.
pub trait Spike: Copy {
    /// What it carries: nothing, or an integer.
    type Payload: Copy;
    /// Whether it carries nothing.
    const BINARY: bool;
    /// The index of its source.
    fn source(self) -> usize;
    /// What it carries.
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

/// A spike that carries an integer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GradedSpike<I> {
    /// Its source.
    pub id: I,
    /// What it carries.
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

/// An engine after a step: what probes, digests and comparisons read. `fast` and `golden` are
/// chosen at run time.
pub trait Engine {
    /// Clears state, spikes in flight and everything counted; the coming sample has this many
    /// steps.
    fn begin(&mut self, steps: u32);
    /// One timestep with these input channels spiking (ascending, each once). The spikes of a
    /// population with a payload carry that.
    fn step(&mut self, input: Spikes<'_>);
    /// Passes over this many steps without input, if nothing at all would happen in them: then
    /// every register stays as it is, and counts are as if they had been computed. Otherwise
    /// does nothing and returns false. With 0 it only says whether that is so.
    fn rest(&mut self, steps: u32) -> bool {
        let _ = steps;
        false
    }
    /// Compartments that spiked in the last step, each once, in any order: putting them into one
    /// costs time that most who ask need not spend.
    fn spikes(&self) -> &[CompartmentId];
    /// What each of [`Engine::spikes`] carries, in that order, 1 for a binary spike. Empty if all
    /// messages of the network are binary spikes, and in engines of real numbers.
    fn payloads(&self) -> &[i32] {
        &[]
    }
    /// The spikes, ascending.
    fn ascending_spikes(&self) -> Vec<CompartmentId> {
        let mut spikes = self.spikes().to_vec();
        spikes.sort_unstable();
        spikes
    }
    /// A word of state after the last step, by its place in the table of the compartment's kind.
    fn state(&self, compartment: CompartmentId, column: usize) -> i32 {
        if column == 0 { self.u(compartment) } else { self.v(compartment) }
    }
    /// The current register after the last step; 0 of a kind that has none.
    fn u(&self, compartment: CompartmentId) -> i32;
    /// The membrane after the last step: 0 at a spike and while refractory.
    fn v(&self, compartment: CompartmentId) -> i32;
    /// The membrane as a number of the engine's own: not rounded where it computes in real numbers.
    fn potential(&self, compartment: CompartmentId) -> f64 {
        self.v(compartment).into()
    }
    /// What a probe of the chip's voltage register reads: the refractory counter while it is
    /// running (`docs/semantics.md`, probes), the membrane otherwise.
    fn v_register(&self, compartment: CompartmentId) -> i32;
    /// Waits for what other processes have to say of the last step, before it is counted.
    fn settle(&mut self) {}
    /// What was counted since `begin`.
    fn totals(&self) -> Totals;
    /// What left its field since `begin`.
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
        // Against sorting everything, in random order with repeats.
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
