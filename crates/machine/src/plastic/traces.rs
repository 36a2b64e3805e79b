//! Notes and traces of the sources or targets of a plastic projection: (L3), (L4), (L8).
//!
//! Input: the spikes of each step. Output: at the end of an epoch the history of each trace in it.
//! Only units whose traces or notes are not 0 are visited.

use nsim_dynamics::learning::{Compiled, add};
use nsim_ir::base::id::RuleId;
use nsim_ir::learning::draws::{Draws, Place, Use};
use nsim_ir::learning::{Graded, LONGEST_EPOCH, LearningSemantics, Trace};

/// Traces of one side: two presynaptic or three postsynaptic ones, the first of five each.
const MOST: usize = 3;
/// Steps of which late spikes and traces are kept: a delay of 62, an epoch of 63.
const KEPT: usize = 128;
/// The history of a unit whose traces are 0.
static SILENT: [[i16; MOST]; LONGEST_EPOCH as usize + 1] = [[0; MOST]; LONGEST_EPOCH as usize + 1];
/// A unit without history: its traces are 0 in the whole epoch.
const NO_SLOT: u32 = u32::MAX;

/// Where random numbers of a projection come from.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Source<'a> {
    pub draws: &'a Draws,
    pub rule: RuleId,
    pub compiled: &'a Compiled,
    /// The step within the sample, and its number since learning began.
    pub step: u32,
    pub since: u64,
}

impl Source<'_> {
    fn is_shared(&self) -> bool {
        self.compiled.rule().semantics() == LearningSemantics::Lava
    }

    /// Number of the epoch that ends.
    fn epoch(&self) -> u32 {
        (self.step + 1) / self.compiled.rule().epoch() - 1
    }

    /// The number that decides about the rounding of a variable of a synapse.
    pub fn round(&self, part: u8, entity: u32) -> f64 {
        if self.is_shared() {
            return self.draws.shared(self.rule, Use::Round, self.epoch(), self.since);
        }
        self.draws.unit(Place { rule: self.rule, of: Use::Round, part, entity, step: self.since })
    }

    /// A step of this number in the epoch that ends, since learning began.
    fn since_at(&self, k: u32) -> u64 {
        self.since - u64::from(self.compiled.rule().epoch() - k)
    }
}

/// Whether units are sources or targets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Side {
    Pre,
    Post,
}

impl Side {
    const fn traces(self) -> &'static [Trace] {
        match self {
            Side::Pre => &[Trace::X1, Trace::X2],
            Side::Post => &[Trace::Y1, Trace::Y2, Trace::Y3],
        }
    }

    const fn uses(self) -> (Use, Use, Use) {
        match self {
            Side::Pre => (Use::Pre, Use::PreDecay, Use::PreImpulse),
            Side::Post => (Use::Post, Use::PostDecay, Use::PostImpulse),
        }
    }
}

/// What is kept of units that a rule sees later, through delays.
#[derive(Debug, Clone)]
struct Late {
    /// Noted steps of each unit, one bit each, by the step modulo [`KEPT`].
    spikes: Vec<u128>,
    /// Traces of each unit, by the step modulo [`KEPT`].
    past: Vec<[i16; MOST]>,
}

/// Traces and notes of the units of one side.
#[derive(Debug, Clone)]
pub(crate) struct Traces {
    side: Side,
    /// Index of the first unit among those of the rule.
    first: u32,
    /// Traces at the epoch's start, with the additions of the epoch.
    values: Vec<[i16; MOST]>,
    /// The step of the last spike in this epoch, from 1; 0 for none.
    notes: Vec<u8>,
    /// Units with a note in this epoch.
    noted: Vec<u32>,
    /// Units with a note or a trace above 0, or kept spikes; each once.
    live: Vec<u32>,
    is_live: Vec<bool>,
    /// The slot of each unit among the histories of the epoch that ends.
    slots: Vec<u32>,
    /// Traces by slot, then by step of the epoch from 0 on.
    histories: Vec<[i16; MOST]>,
    /// Units whose x1 exceeds 7 bits: lava adds without saturation in each step.
    over: Vec<u32>,
    late: Option<Late>,
}

impl Traces {
    /// Empty traces of `units` units.
    pub fn new(side: Side, first: u32, units: usize, is_late: bool) -> Self {
        let late = is_late.then(|| Late { spikes: vec![0; units], past: vec![[0; MOST]; units * KEPT] });
        Traces {
            side,
            first,
            values: vec![[0; MOST]; units],
            notes: vec![0; units],
            noted: Vec::new(),
            live: Vec::new(),
            is_live: vec![false; units],
            slots: vec![NO_SLOT; units],
            histories: Vec::new(),
            over: Vec::new(),
            late,
        }
    }

    /// Empties all traces.
    pub fn clear(&mut self) {
        *self = Traces::new(self.side, self.first, self.values.len(), self.late.is_some());
    }

    /// The value of a trace by unit.
    pub fn column(&self, trace: usize) -> impl Iterator<Item = i32> {
        self.values.iter().map(move |values| values[trace].into())
    }

    /// Units with a note in this epoch.
    pub fn noted(&self) -> &[u32] {
        &self.noted
    }

    /// Units that may have seen a late spike in this epoch.
    pub fn live(&self) -> &[u32] {
        &self.live
    }

    /// Whether a unit is one of [`Self::live`].
    #[inline]
    pub fn is_live(&self, unit: usize) -> bool {
        self.is_live[unit]
    }

    /// Number of units.
    pub fn units(&self) -> usize {
        self.notes.len()
    }

    /// The note of a unit.
    #[inline]
    pub fn note_of(&self, unit: usize) -> u32 {
        self.notes[unit].into()
    }

    /// (L3): notes the spike of a unit, whose message carries this value.
    pub fn note(&mut self, unit: u32, value: i32, source: &Source<'_>) {
        let graded = if self.side == Side::Pre { source.compiled.rule().graded() } else { Graded::Regular };
        let x1 = self.values[unit as usize][0];
        let after = |sum: i16| (sum % 256).min(GREATEST);
        match graded {
            Graded::Regular => {}
            Graded::Overwrite => self.values[unit as usize][0] = half(value),
            Graded::AddSaturating => self.values[unit as usize][0] = after(x1 + half(value)),
            Graded::AddWithoutSaturation => {
                self.enliven(unit);
                if !self.add_without_saturation(unit, half(value)) {
                    return;
                }
            }
        }
        self.note_spike(unit, source);
    }

    /// lava's addition, which starts again above 127; returns whether it did.
    fn add_without_saturation(&mut self, unit: u32, half: i16) -> bool {
        let x1 = &mut self.values[unit as usize][0];
        let sum = (*x1 + half) % 256;
        let starts_again = sum > GREATEST;
        *x1 = if starts_again { sum - GREATEST } else { sum };
        if *x1 > GREATEST {
            self.over.push(unit);
        }
        starts_again
    }

    /// Adds 0 to the traces that exceed 7 bits and received nothing in this step.
    pub fn end_step(&mut self, received: impl Fn(u32) -> bool) {
        let mut over = std::mem::take(&mut self.over);
        over.retain(|&unit| received(unit) || !self.add_without_saturation(unit, 0));
        over.retain(|&unit| self.values[unit as usize][0] > GREATEST);
        self.over.append(&mut over);
        self.over.sort_unstable();
        self.over.dedup();
    }

    /// Whether a trace exceeds 7 bits.
    pub fn is_over(&self) -> bool {
        !self.over.is_empty()
    }

    fn note_spike(&mut self, unit: u32, source: &Source<'_>) {
        let rule = source.compiled.rule();
        let k = source.step % rule.epoch() + 1;
        let index = unit as usize;
        if self.notes[index] > 0 {
            let use_of = self.side.uses().0;
            for (place, &trace) in self.side.traces().iter().enumerate() {
                let value = &mut self.values[index][place];
                if place == 0 && self.side == Side::Pre && rule.graded() != Graded::Regular {
                    continue;
                }
                *value = add(*value, source.compiled.impulse(trace), || match (source.is_shared(), self.side) {
                    (true, Side::Pre) => 0,
                    (true, Side::Post) => source.draws.shared(source.rule, use_of, source.step, source.since) as u16,
                    (false, _) => {
                        let (part, entity) = (trace.index() as u8, self.first + unit);
                        let place = Place { rule: source.rule, of: use_of, part, entity, step: source.since };
                        (source.draws.bits(place) >> 56) as u16
                    }
                });
            }
        } else {
            self.noted.push(unit);
        }
        self.notes[index] = k as u8;
        if let Some(late) = &mut self.late {
            late.spikes[index] |= 1 << (source.step as usize % KEPT);
        }
        self.enliven(unit);
    }

    fn enliven(&mut self, unit: u32) {
        if !std::mem::replace(&mut self.is_live[unit as usize], true) {
            self.live.push(unit);
        }
    }

    /// (L4): the histories of the epoch that ends with the step of the source.
    pub fn make_histories(&mut self, source: &Source<'_>) {
        let epoch = source.compiled.rule().epoch();
        self.histories.clear();
        for (slot, &unit) in (0..).zip(&self.live) {
            self.slots[unit as usize] = slot;
            let begin = self.histories.len();
            self.histories.extend(std::iter::repeat_n([0; MOST], epoch as usize + 1));
            for (place, &trace) in self.side.traces().iter().enumerate() {
                let history = History { traces: self, trace, unit, source };
                let (value, note) = (self.values[unit as usize][place], self.notes[unit as usize].into());
                let column = history.values(value, note);
                let of_unit = &mut self.histories[begin..];
                of_unit.iter_mut().zip(column).for_each(|(values, value)| values[place] = value);
            }
        }
        let Some(late) = &mut self.late else { return };
        for (slot, &unit) in self.live.iter().enumerate() {
            for k in 1..=epoch {
                let step = (source.step + k - epoch) as usize % KEPT;
                late.past[unit as usize * KEPT + step] = self.histories[slot * (epoch as usize + 1) + k as usize];
            }
        }
    }

    /// The traces of a unit by step of the epoch that ends, once histories are made.
    #[inline]
    pub fn history(&self, unit: usize, epoch: u32) -> &[[i16; MOST]] {
        let steps = epoch as usize + 1;
        match self.slots[unit] {
            NO_SLOT => &SILENT[..steps],
            slot => &self.histories[slot as usize * steps..][..steps],
        }
    }

    /// (L8): the last of the `epoch` steps up to `last` in which a spike of a unit was noted.
    #[inline]
    pub fn late_spike(&self, unit: usize, last: i64, epoch: u32) -> Option<i64> {
        let first = last + 1 - i64::from(epoch);
        let bits = self.late.as_ref()?.spikes[unit].rotate_right(first.rem_euclid(KEPT as i64) as u32);
        let within = bits & ((1 << epoch) - 1);
        (within > 0).then(|| first + i64::from(within.ilog2()))
    }

    /// (L8): a trace of a unit at a step of the sample; 0 before the first.
    #[inline]
    pub fn late_at(&self, unit: usize, step: i64, trace: usize) -> i32 {
        let of = |late: &Late| late.past[unit * KEPT + step.rem_euclid(KEPT as i64) as usize][trace].into();
        self.late.as_ref().map_or(0, of)
    }

    /// Begins the next epoch, after the one that ends with `step`.
    pub fn end_epoch(&mut self, step: u32, epoch: u32) {
        let end = epoch as usize;
        for (slot, &unit) in self.live.iter().enumerate() {
            self.values[unit as usize] = self.histories[slot * (end + 1) + end];
            self.slots[unit as usize] = NO_SLOT;
        }
        self.noted.drain(..).for_each(|unit| self.notes[unit as usize] = 0);
        // Bits of the steps to come are left from the steps before the kept ones.
        let next = ((1u128 << epoch) - 1).rotate_left((step + 1) % KEPT as u32);
        if let Some(late) = &mut self.late {
            self.live.iter().for_each(|&unit| late.spikes[unit as usize] &= !next);
        }
        let (values, is_live, late) = (&self.values, &mut self.is_live, &self.late);
        self.live.retain(|&unit| {
            let index = unit as usize;
            let stays = values[index] != [0; MOST]
                || late.as_ref().is_some_and(|late| {
                    let mut past = late.past[index * KEPT..(index + 1) * KEPT].iter();
                    late.spikes[index] != 0 || past.any(|values| *values != [0; MOST])
                });
            is_live[index] = stays;
            stays
        });
    }
}

/// Greatest value of a trace.
const GREATEST: i16 = nsim_ir::learning::GREATEST_TRACE as i16;

/// Half a payload, ties to even, modulo 256: (L11).
fn half(value: i32) -> i16 {
    let floor = value >> 1;
    let up = i32::from(value & 1 == 1 && floor & 1 == 1);
    (floor + up).rem_euclid(256) as i16
}

/// The history of one trace of one unit in the epoch that ends.
struct History<'a> {
    traces: &'a Traces,
    trace: Trace,
    unit: u32,
    source: &'a Source<'a>,
}

impl History<'_> {
    /// The values from step 0 to the epoch's end; the spike is at step `note`, if that is above 0.
    fn values(&self, start: i16, note: u32) -> Vec<i16> {
        let compiled = self.source.compiled;
        let epoch = compiled.rule().epoch();
        let mut values = vec![start; epoch as usize + 1];
        let Some(decay) = compiled.decay(self.trace) else { return values };
        let mut value = start;
        for k in 1..=epoch {
            if value > 0 {
                value = decay.after(value, || self.decay_draw(k));
            }
            if k == note {
                value = add(value, compiled.impulse(self.trace), || self.impulse_draw());
            }
            values[k as usize] = value;
        }
        values
    }

    fn decay_draw(&self, k: u32) -> f64 {
        let (_, of, _) = self.traces.side.uses();
        let Source { draws, rule, .. } = *self.source;
        if self.source.is_shared() {
            return draws.shared(rule, of, self.source.epoch(), self.source.since);
        }
        draws.unit(self.place(of, self.source.since_at(k)))
    }

    fn impulse_draw(&self) -> u16 {
        let (_, _, of) = self.traces.side.uses();
        let Source { draws, rule, since, .. } = *self.source;
        if self.source.is_shared() {
            return draws.shared(rule, of, self.source.epoch(), since) as u16;
        }
        (draws.bits(self.place(of, since)) >> 56) as u16
    }

    fn place(&self, of: Use, step: u64) -> Place {
        let entity = self.traces.first + self.unit;
        Place { rule: self.source.rule, of, part: self.trace.index() as u8, entity, step }
    }
}
