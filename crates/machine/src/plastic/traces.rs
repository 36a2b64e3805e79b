//! Notes and traces of the sources or targets of a plastic projection: (L3), (L4), (L8).
//!
//! Input: the spikes of each step. Output: at the end of an epoch the history of each trace in it.
//! Only units whose traces or notes are not 0 are visited.

use nsim_dynamics::learning::{Compiled, Decay, add};
use nsim_ir::base::id::RuleId;
use nsim_ir::learning::draws::{Draws, Numbers, Place, Use};
use nsim_ir::learning::{Graded, LearningSemantics, Trace, Variable};

/// Traces of one side: two presynaptic or three postsynaptic ones, the first of five each.
const MOST: usize = 3;
/// Steps of which late spikes and traces are kept: a delay of 62, an epoch of 63.
const KEPT: usize = 128;

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

    /// The numbers that units draw for a trace at a step, counted since learning began.
    fn of_trace(&self, of: Use, trace: Trace, step: u64) -> Numbers {
        self.draws.at(Place { rule: self.rule, of, part: trace.index() as u8, step })
    }

    /// The number that decides about the rounding of all synapses, where they share it.
    pub fn shared_round(&self) -> Option<f64> {
        self.is_shared().then(|| self.draws.shared(self.rule, Use::Round, self.epoch(), self.since))
    }

    /// The numbers that decide about the rounding of a variable, by row.
    pub fn round(&self, variable: Variable) -> Numbers {
        self.draws.at(Place { rule: self.rule, of: Use::Round, part: variable as u8, step: self.since })
    }

    /// A step of this number in the epoch that ends, since learning began.
    fn since_at(&self, k: u32) -> u64 {
        self.since - u64::from(self.compiled.rule().epoch() - k)
    }
}

/// Whether units are sources, targets or the reward.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Side {
    Pre,
    Post,
    Reward,
}

impl Side {
    const fn traces(self) -> &'static [Trace] {
        match self {
            Side::Pre => &[Trace::X1, Trace::X2],
            Side::Post => &[Trace::Y1, Trace::Y2, Trace::Y3],
            Side::Reward => &[Trace::R1],
        }
    }

    const fn uses(self) -> (Use, Use, Use) {
        match self {
            Side::Pre => (Use::Pre, Use::PreDecay, Use::PreImpulse),
            Side::Post | Side::Reward => (Use::Post, Use::PostDecay, Use::PostImpulse),
        }
    }
}

/// What is kept of units that a rule sees later, through delays.
#[derive(Debug, Clone)]
struct Late {
    /// Noted steps of each unit, one bit each, by the step modulo [`KEPT`].
    spikes: Vec<u128>,
    /// Traces of each unit, by the step modulo [`KEPT`].
    past: Vec<[u8; MOST]>,
}

/// Traces and notes of the units of one side.
#[derive(Debug, Clone)]
pub(crate) struct Traces {
    side: Side,
    /// Index of the first unit among those of the rule.
    first: u32,
    /// Steps of an epoch.
    epoch: usize,
    /// The step of each unit's last spike in this epoch, from 1; 0 for none.
    notes: Vec<u8>,
    /// By trace and step 0 to E of the epoch: the value of each unit. None where the trace is
    /// always 0. Those of step 0 have the additions of the epoch; the others are made at its end.
    histories: [Vec<Vec<u8>>; MOST],
    /// Units with a note in this epoch.
    noted: Vec<u32>,
    /// Units with a note or a trace above 0, or kept spikes; each once.
    live: Vec<u32>,
    is_live: Vec<bool>,
    /// Units whose x1 exceeds 7 bits: lava adds without saturation in each step.
    over: Vec<u32>,
    late: Option<Late>,
    /// Traces before the spikes of the last step; empty but in Brian's semantics.
    before: Vec<[u8; MOST]>,
}

impl Traces {
    /// Empty traces of `units` units.
    pub fn new(side: Side, first: u32, units: usize, is_late: bool, compiled: &Compiled) -> Self {
        let late = is_late.then(|| Late { spikes: vec![0; units], past: vec![[0; MOST]; units * KEPT] });
        let epoch = compiled.rule().epoch() as usize;
        let is_brian = compiled.rule().semantics() == LearningSemantics::Brian;
        let mut histories = [const { Vec::new() }; MOST];
        for (history, &trace) in histories.iter_mut().zip(side.traces()) {
            if compiled.decay(trace).is_some() {
                *history = vec![vec![0; units]; epoch + 1];
            }
        }
        Traces {
            side,
            first,
            epoch,
            notes: vec![0; units],
            histories,
            noted: Vec::new(),
            live: Vec::new(),
            is_live: vec![false; units],
            over: Vec::new(),
            late,
            before: if is_brian { vec![[0; MOST]; units] } else { Vec::new() },
        }
    }

    /// Empties all traces.
    pub fn clear(&mut self) {
        self.notes.fill(0);
        self.histories.iter_mut().flatten().for_each(|values| values.fill(0));
        self.is_live.fill(false);
        self.noted.clear();
        self.live.clear();
        self.over.clear();
        self.before.fill([0; MOST]);
        if let Some(late) = &mut self.late {
            late.spikes.fill(0);
            late.past.fill([0; MOST]);
        }
    }

    /// The value of a trace by unit.
    pub fn column(&self, trace: usize) -> impl Iterator<Item = i32> {
        (0..self.units()).map(move |unit| self.at(unit, trace, 0))
    }

    /// The note of a unit.
    #[inline]
    pub fn note_of(&self, unit: usize) -> u8 {
        self.notes[unit]
    }

    /// A trace of a unit at step k of the epoch, once histories are made.
    #[inline]
    pub fn at(&self, unit: usize, trace: usize, k: u8) -> i32 {
        self.histories[trace].get(usize::from(k)).map_or(0, |values| values[unit].into())
    }

    /// A trace of all units at step k; none where it is always 0.
    #[inline]
    pub fn all_at(&self, trace: usize, k: u8) -> &[u8] {
        self.histories[trace].get(usize::from(k)).map_or(&[], Vec::as_slice)
    }

    /// The notes of all units.
    #[inline]
    pub fn notes(&self) -> &[u8] {
        &self.notes
    }

    /// The first trace of the first unit at step k; 0 where there is none.
    #[inline]
    pub fn first_at(&self, k: u8) -> i32 {
        if self.is_live.is_empty() { 0 } else { self.at(0, 0, k) }
    }

    /// The value of x1 or y1 at the epoch's start.
    fn first_trace(&mut self, unit: u32) -> Option<&mut u8> {
        self.histories[0].first_mut().map(|values| &mut values[unit as usize])
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
        self.is_live.len()
    }

    /// (L3): notes the spike of a unit, whose message carries this value.
    pub fn note(&mut self, unit: u32, value: i32, source: &Source<'_>) {
        let graded = if self.side == Side::Pre { source.compiled.rule().graded() } else { Graded::Regular };
        if graded == Graded::AddWithoutSaturation {
            self.enliven(unit);
            if !self.add_without_saturation(unit, half(value)) {
                return;
            }
        } else if let (true, Some(x1)) = (graded != Graded::Regular, self.first_trace(unit)) {
            let before = if graded == Graded::Overwrite { 0 } else { i16::from(*x1) };
            let sum = (before + half(value)) % 256;
            *x1 = if graded == Graded::Overwrite { sum } else { sum.min(GREATEST) } as u8;
        }
        self.note_spike(unit, source);
    }

    /// lava's addition, which starts again above 127; returns whether it did.
    fn add_without_saturation(&mut self, unit: u32, half: i16) -> bool {
        let Some(x1) = self.first_trace(unit) else { return false };
        let sum = (i16::from(*x1) + half) % 256;
        let starts_again = sum > GREATEST;
        let after = if starts_again { sum - GREATEST } else { sum };
        *x1 = after as u8;
        if after > GREATEST {
            self.over.push(unit);
        }
        starts_again
    }

    /// Adds 0 to the traces that exceed 7 bits and received nothing in this step.
    pub fn end_step(&mut self, received: impl Fn(u32) -> bool) {
        let mut over = std::mem::take(&mut self.over);
        over.retain(|&unit| received(unit) || !self.add_without_saturation(unit, 0));
        over.retain(|&unit| self.at(unit as usize, 0, 0) > i32::from(GREATEST));
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
        if self.notes[unit as usize] > 0 {
            for (number, &trace) in self.side.traces().iter().enumerate() {
                let graded = trace == Trace::X1 && rule.graded() != Graded::Regular;
                if !graded && !self.histories[number].is_empty() {
                    let draw = || self.further_draw(trace, unit, source);
                    let before = self.at(unit as usize, number, 0) as i16;
                    let value = add(before, source.compiled.impulse(trace), draw);
                    self.histories[number][0][unit as usize] = value as u8;
                }
            }
        } else {
            self.noted.push(unit);
        }
        self.notes[unit as usize] = (source.step % rule.epoch() + 1) as u8;
        if let Some(late) = &mut self.late {
            late.spikes[unit as usize] |= 1 << (source.step as usize % KEPT);
        }
        self.enliven(unit);
    }

    /// The draw of a further spike in an epoch.
    fn further_draw(&self, trace: Trace, unit: u32, source: &Source<'_>) -> u16 {
        let of = self.side.uses().0;
        match (source.is_shared(), self.side) {
            (true, Side::Pre) => 0,
            (true, _) => source.draws.shared(source.rule, of, source.step, source.since) as u16,
            (false, _) => (source.of_trace(of, trace, source.since).bits(self.first + unit) >> 56) as u16,
        }
    }

    fn enliven(&mut self, unit: u32) {
        if !std::mem::replace(&mut self.is_live[unit as usize], true) {
            self.live.push(unit);
        }
    }

    /// (L4): the histories of the epoch that ends with the step of the source.
    pub fn make_histories(&mut self, source: &Source<'_>) {
        let Traces { side, first, epoch, notes, histories, noted, live, before, .. } = self;
        for (number, &trace) in side.traces().iter().enumerate() {
            let Some(decay) = source.compiled.decay(trace) else { continue };
            let numbers = OfHistory::new(source, *side, trace);
            let impulse = source.compiled.impulse(trace);
            for k in 1..=*epoch {
                let (past, next) = histories[number].split_at_mut(k);
                let (past, next) = (past[k - 1].as_mut_slice(), next[0].as_mut_slice());
                numbers.decay(k, decay, *first, (live, past, next), |unit, value| {
                    before.get(unit).map_or(value, |before| before[number])
                });
                if !before.is_empty() {
                    // In these epochs of one step, the first value is the one before the spike.
                    live.iter().for_each(|&unit| past[unit as usize] = next[unit as usize]);
                }
                for &unit in noted.iter().filter(|unit| usize::from(notes[**unit as usize]) == k) {
                    let value = &mut next[unit as usize];
                    *value = add((*value).into(), impulse, || numbers.impulse(*first + unit)) as u8;
                }
            }
        }
        let Some(late) = &mut self.late else { return };
        for &unit in &self.live {
            for k in 1..=self.epoch {
                let step = (source.step as usize + k - self.epoch) % KEPT;
                let values =
                    self.histories.each_ref().map(|history| history.get(k).map_or(0, |all| all[unit as usize]));
                late.past[unit as usize * KEPT + step] = values;
            }
        }
    }

    /// (L8): the last of an epoch's steps up to `last` in which a spike of a unit was noted.
    #[inline]
    pub fn late_spike(&self, unit: usize, last: i64) -> Option<i64> {
        let first = last + 1 - self.epoch as i64;
        let bits = self.late.as_ref()?.spikes[unit].rotate_right(first.rem_euclid(KEPT as i64) as u32);
        let within = bits & ((1 << self.epoch) - 1);
        (within > 0).then(|| first + i64::from(within.ilog2()))
    }

    /// (L8): a trace of a unit at a step of the sample; 0 before the first.
    #[inline]
    pub fn late_at(&self, unit: usize, step: i64, trace: usize) -> i32 {
        let of = |late: &Late| late.past[unit * KEPT + step.rem_euclid(KEPT as i64) as usize][trace].into();
        self.late.as_ref().map_or(0, of)
    }

    /// Begins the next epoch, after the one that ends with `step`.
    pub fn end_epoch(&mut self, step: u32) {
        self.noted.clear();
        // Bits of the steps to come are left from the steps before the kept ones.
        let next = ((1u128 << self.epoch) - 1).rotate_left((step + 1) % KEPT as u32);
        let Traces { epoch, notes, histories, live, is_live, late, before, .. } = self;
        // The last value is the first of the next epoch.
        histories.iter_mut().filter(|history| !history.is_empty()).for_each(|history| history.swap(0, *epoch));
        live.retain(|&unit| {
            let index = unit as usize;
            notes[index] = 0;
            if let Some(before) = before.get_mut(index) {
                *before = histories.each_ref().map(|history| history.get(*epoch).map_or(0, |values| values[index]));
            }
            let mut stays = histories.iter().any(|history| history.first().is_some_and(|values| values[index] > 0));
            if !stays {
                histories.iter_mut().flatten().for_each(|values| values[index] = 0);
            }
            if let Some(late) = late {
                late.spikes[index] &= !next;
                let mut past = late.past[index * KEPT..(index + 1) * KEPT].iter();
                stays |= late.spikes[index] != 0 || past.any(|values| *values != [0; MOST]);
            }
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

/// Random numbers of the histories of a trace in an epoch.
enum OfHistory {
    /// One for all units and steps.
    Shared { decay: f64, impulse: u16 },
    /// One for each; those of decay by step of the epoch from 1 on.
    Each { decay: Vec<Numbers>, impulse: Numbers },
}

impl OfHistory {
    fn new(source: &Source<'_>, side: Side, trace: Trace) -> Self {
        let (_, decay, impulse) = side.uses();
        if source.is_shared() {
            let shared = |of| source.draws.shared(source.rule, of, source.epoch(), source.since);
            return OfHistory::Shared { decay: shared(decay), impulse: shared(impulse) as u16 };
        }
        let steps = (1..=source.compiled.rule().epoch()).map(|k| source.since_at(k));
        OfHistory::Each {
            decay: steps.map(|step| source.of_trace(decay, trace, step)).collect(),
            impulse: source.of_trace(impulse, trace, source.since),
        }
    }

    /// (L4), (L15): the value of each live unit at step k from that of the step before. `before`
    /// is the value that decides about the fraction; units are entities from `first` on.
    fn decay(
        &self,
        k: usize,
        decay: &Decay,
        first: u32,
        (live, past, next): (&[u32], &[u8], &mut [u8]),
        before: impl Fn(usize, u8) -> u8,
    ) {
        match self {
            OfHistory::Shared { decay: draw, .. } => {
                let after = decay.after_all(*draw);
                live.iter().for_each(|&unit| next[unit as usize] = after[usize::from(past[unit as usize])]);
            }
            OfHistory::Each { decay: numbers, .. } => {
                let numbers = numbers[k - 1];
                for &unit in live {
                    let value = past[unit as usize];
                    let bits = (numbers.bits(first + unit) >> 32) as u32;
                    next[unit as usize] = decay.after(value, before(unit as usize, value), bits);
                }
            }
        }
    }

    #[inline]
    fn impulse(&self, entity: u32) -> u16 {
        match self {
            OfHistory::Shared { impulse, .. } => *impulse,
            OfHistory::Each { impulse, .. } => (impulse.bits(entity) >> 56) as u16,
        }
    }
}
