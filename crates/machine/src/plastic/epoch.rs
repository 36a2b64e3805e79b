//! The end of an epoch: the synapses of a projection whose products count are changed (L6).
//!
//! Input: notes and histories of both sides. Output: new variables in the state of a shard.
//! Synapses are collected by their true dependencies, so that a rule is interpreted once for many
//! of them.

use crate::layout::plastic::{Columns, Incoming, PlasticSynapses, ProjectionPlan, Rows};
use crate::layout::shard::Shard;
use crate::plastic::signals::Signals;
use crate::plastic::traces::{Source, Traces};
use crate::prefetch::{prefetch, prefetch_range};
use crate::update::state::ShardState;
use nsim_dynamics::learning::{BATCH, Compiled, REWARD, Synapses, When};
use nsim_ir::base::id::{CoreId, Id};
use nsim_ir::learning::{Dependency, Variable};

/// The learning of a projection at the end of an epoch.
pub(crate) struct Epoch<'a> {
    pub projection: &'a ProjectionPlan,
    pub compiled: &'a Compiled,
    pub pre: &'a Traces,
    pub post: &'a Traces,
    /// Of one unit, or of none.
    pub reward: &'a Traces,
    pub source: Source<'a>,
    /// The random number by which all synapses round, where they share it.
    pub round: Option<f64>,
    pub signals: &'a Signals,
}

/// Rows or columns between the prefetch of one and its use.
const AHEAD: usize = 2;

impl Epoch<'_> {
    /// Changes the synapses of a shard that belong to the plastic projection of this index; returns
    /// how many were evaluated.
    pub fn learn(&self, index: usize, state: &mut ShardState, shard: &Shard) -> u64 {
        let mut shard = OfShard {
            synapses: &shard.plastic,
            rows: &shard.plastic.projections[index],
            state: &mut state.state.plastic,
            by_core: &mut state.state.updates,
            batches: Default::default(),
            updates: 0,
        };
        self.raise_least_tags(&mut shard);
        match self.projection.sees_late {
            true => self.visit_late(&mut shard),
            false => self.visit(&mut shard),
        }
        for when in When::all() {
            self.evaluate_batch(when, &mut shard);
        }
        shard.updates
    }

    /// lava clips the accumulator of a tag of -257 although no product counts, which mostly makes
    /// it -256 (L6). These synapses are not counted as evaluated.
    fn raise_least_tags(&self, shard: &mut OfShard<'_>) {
        let rule = self.compiled.rule();
        let least = rule.semantics().tags().0;
        if !rule.changes(Variable::Tag) || self.compiled.unchanged(least) == least << 7 {
            return;
        }
        let epoch = self.is_slow();
        for source in 0..shard.rows.firsts.len() - 1 {
            for place in shard.rows.of_source(source) {
                let target = shard.synapses.targets[place] as usize;
                let when = When { pre: self.pre.note_of(source) > 0, post: self.post.note_of(target) > 0, epoch };
                if i32::from(shard.state.tags[place]) == least && !self.compiled.is_evaluated(when) {
                    let listed = Listed {
                        synapse: Incoming {
                            place: place as u32,
                            source: source as u32,
                            row: shard.synapses.row_of[place],
                        },
                        target: target as u32,
                    };
                    let (batch, mut values) = (Batch { listed: vec![listed], late: Vec::new() }, [0; BATCH]);
                    self.round(Variable::Tag, &[self.compiled.unchanged(least)], &batch, &mut values);
                    shard.state.tags[place] = values[0];
                }
            }
        }
    }

    /// Whether u is true in this epoch.
    fn is_slow(&self) -> bool {
        let rule = self.compiled.rule();
        let number = (self.source.step + 1) / rule.epoch();
        rule.waits_for(Dependency::Epoch) && number.is_multiple_of(1 << rule.slow())
    }

    /// Visits each synapse that may be evaluated. Each is visited once, so order does not matter.
    fn visit(&self, shard: &mut OfShard<'_>) {
        let (rule, rows) = (self.compiled.rule(), shard.rows);
        if self.is_slow() {
            (0..rows.firsts.len() - 1).for_each(|source| self.visit_row(source, true, shard));
            return;
        }
        let sources = if rule.waits_for(Dependency::Pre) { self.pre.noted() } else { &[] };
        for (place, &source) in sources.iter().enumerate() {
            if let Some(&ahead) = sources.get(place + AHEAD) {
                let places = rows.of_source(ahead as usize);
                prefetch_range(&shard.synapses.targets, places.clone());
                prefetch_range(&shard.synapses.row_of, places.clone());
                prefetch_range(&shard.state.weights, places);
            }
            self.visit_row(source as usize, false, shard);
        }
        let targets = if rule.waits_for(Dependency::Post) { self.post.noted() } else { &[] };
        for (place, &target) in targets.iter().enumerate() {
            if let Some(&ahead) = targets.get(place + AHEAD) {
                let column = rows.by_target.get(ahead as usize);
                prefetch_range(column, 0..column.len());
            }
            self.visit_column(target, shard);
        }
    }

    /// Evaluates the synapses of a source, of which a product counts.
    fn visit_row(&self, source: usize, slow: bool, shard: &mut OfShard<'_>) {
        let synapses = shard.synapses;
        let pre = self.pre.note_of(source) > 0;
        let (quiet, spiked) = [false, true].map(|post| When { pre, post, epoch: slow }).into();
        let places = shard.rows.of_source(source);
        for first in places.clone().step_by(BATCH) {
            let places = first..places.end.min(first + BATCH);
            let (targets, rows) = (&synapses.targets[places.clone()], &synapses.row_of[places]);
            let mut changes = [false; BATCH];
            for (index, (&target, changes)) in targets.iter().zip(&mut changes).enumerate() {
                *changes = self.post.note_of(target as usize) == 0;
                if !*changes {
                    let synapse = Incoming { place: (first + index) as u32, source: source as u32, row: rows[index] };
                    self.add(spiked, Listed { synapse, target }, shard);
                }
            }
            self.evaluate(quiet, &Row { source, first, targets, rows, changes: &changes[..rows.len()] }, shard);
        }
    }

    /// Evaluates the synapses of a target that spiked, but those whose rows were visited.
    fn visit_column(&self, target: u32, shard: &mut OfShard<'_>) {
        let by_rows = self.compiled.rule().waits_for(Dependency::Pre);
        let (quiet, spiked) = [false, true].map(|pre| When { pre, post: true, epoch: false }).into();
        for incoming in shard.rows.by_target.get(target as usize).chunks(BATCH) {
            let mut changes = [false; BATCH];
            for (synapse, changes) in incoming.iter().zip(&mut changes) {
                prefetch(&shard.state.weights, synapse.place as usize);
                *changes = self.pre.note_of(synapse.source as usize) == 0;
                if !*changes && !by_rows {
                    self.add(spiked, Listed { synapse: *synapse, target }, shard);
                }
            }
            let changes = &changes[..incoming.len()];
            self.evaluate(quiet, &Column { target: target as usize, incoming, changes }, shard);
        }
    }

    /// [`Self::visit`], where a rule sees spikes late: of earlier epochs, and each synapse others.
    fn visit_late(&self, shard: &mut OfShard<'_>) {
        let (rule, rows, slow) = (self.compiled.rule(), shard.rows, self.is_slow());
        let by_rows = rule.waits_for(Dependency::Pre);
        let all: Vec<u32> = if slow { (0..rows.firsts.len() as u32 - 1).collect() } else { Vec::new() };
        let live = if by_rows { self.pre.live() } else { &[] };
        for &source in if slow { &all } else { live } {
            for place in rows.of_source(source as usize) {
                let (target, row) = (shard.synapses.targets[place], shard.synapses.row_of[place]);
                self.add_late(Incoming { place: place as u32, source, row }, target, slow, shard);
            }
        }
        if slow || !rule.waits_for(Dependency::Post) {
            return;
        }
        for &target in self.post.noted() {
            for synapse in rows.by_target.get(target as usize) {
                // Synapses of the rows above have learned.
                if !(by_rows && self.pre.is_live(synapse.source as usize)) {
                    self.add_late(*synapse, target, slow, shard);
                }
            }
        }
    }

    /// Adds a synapse to those that are evaluated, if the dependency of a product is true.
    fn add_late(&self, synapse: Incoming, target: u32, slow: bool, shard: &mut OfShard<'_>) {
        let delay = match self.projection.moves {
            true => shard.state.delays[synapse.place as usize] as u8,
            false => self.projection.of.delay.get(),
        };
        let (end, epoch) = (i64::from(self.source.step) - i64::from(delay), i64::from(self.compiled.rule().epoch()));
        let spiked = self.pre.late_spike(synapse.source as usize, end);
        let tx = spiked.map_or(0, |step| step + epoch - end) as u8;
        let when = When { pre: tx > 0, post: self.post.note_of(target as usize) > 0, epoch: slow };
        if self.compiled.is_evaluated(when) {
            shard.batches[when.index()].late.push(SeenLate { tx, delay });
            self.add(when, Listed { synapse, target }, shard);
        }
    }

    /// Adds a synapse to the batch of its dependencies.
    fn add(&self, when: When, listed: Listed, shard: &mut OfShard<'_>) {
        let batch = &mut shard.batches[when.index()];
        batch.listed.push(listed);
        if batch.listed.len() == BATCH {
            self.evaluate_batch(when, shard);
        }
    }

    /// Evaluates the synapses of a batch, and empties it.
    fn evaluate_batch(&self, when: When, shard: &mut OfShard<'_>) {
        let mut batch = std::mem::take(&mut shard.batches[when.index()]);
        self.evaluate(when, &batch, shard);
        batch.listed.clear();
        batch.late.clear();
        shard.batches[when.index()] = batch;
    }

    /// Evaluates synapses of which these dependencies are true.
    fn evaluate(&self, when: When, of: &impl Visit, shard: &mut OfShard<'_>) {
        if of.len() == 0 || !self.compiled.is_evaluated(when) {
            return;
        }
        let mut new = [None; 3];
        let seen = Seen { epoch: self, of, state: shard.state };
        self.compiled.accumulate(when, &seen, |variable, sums| {
            let values = new[variable as usize].insert([0; BATCH]);
            match self.compiled.without_draw(self.projection.of.format) {
                None => self.round(variable, sums, of, values),
                Some(rounded) => {
                    for (index, (value, &mut sum)) in values.iter_mut().zip(sums).enumerate() {
                        *value = rounded(shard.state.weights[of.place(index)].into(), sum);
                    }
                }
            }
        });
        for (variable, values) in Variable::ALL.into_iter().zip(new) {
            let Some(values) = values else { continue };
            let column = shard.state.column_mut(variable);
            for (index, &value) in values[..of.len()].iter().enumerate() {
                if of.changes(index) {
                    column[of.place(index)] = value;
                }
            }
        }
        shard.updates += of.count(&shard.rows.core_of, shard.by_core);
    }

    /// (L6), (L7): from accumulators of synapses to the values of their variable.
    fn round(&self, variable: Variable, sums: &[i32], of: &impl Visit, values: &mut [i16; BATCH]) {
        let rounding = self.compiled.rounding(variable, self.projection.of.format);
        let Some(shared) = self.round else {
            let numbers = self.source.round(variable);
            for (index, (value, &sum)) in values.iter_mut().zip(sums).enumerate() {
                *value = rounding.rounded(sum, rounding.share_of_bits(numbers.bits(of.row(index))));
            }
            return;
        };
        let share = rounding.share(shared);
        values.iter_mut().zip(sums).for_each(|(value, &sum)| *value = rounding.rounded(sum, share));
    }
}

/// Synapses that are evaluated together: the same dependencies are true for all that change.
trait Visit {
    fn len(&self) -> usize;
    /// The place of the synapse of this index.
    fn place(&self, index: usize) -> usize;
    fn source(&self, index: usize) -> usize;
    fn target(&self, index: usize) -> usize;
    /// Its row among those of the rule.
    fn row(&self, index: usize) -> u32;
    /// Whether it changes; the others are evaluated with other dependencies.
    fn changes(&self, index: usize) -> bool;
    /// How the synapse sees its source, where it sees it late.
    fn late(&self, _index: usize) -> Option<SeenLate> {
        None
    }
    /// Adds the updates of each core; returns their number.
    fn count(&self, core_of: &[CoreId], by_core: &mut [u64]) -> u64 {
        let mut updates = 0;
        for index in 0..self.len() {
            let is_update = u64::from(self.changes(index));
            by_core[core_of[self.target(index)].index()] += is_update;
            updates += is_update;
        }
        updates
    }
}

/// The synapses of a source at consecutive places.
struct Row<'a> {
    source: usize,
    first: usize,
    targets: &'a [u32],
    rows: &'a [u32],
    changes: &'a [bool],
}

impl Visit for Row<'_> {
    #[inline]
    fn len(&self) -> usize {
        self.targets.len()
    }

    #[inline]
    fn place(&self, index: usize) -> usize {
        self.first + index
    }

    #[inline]
    fn source(&self, _: usize) -> usize {
        self.source
    }

    #[inline]
    fn target(&self, index: usize) -> usize {
        self.targets[index] as usize
    }

    #[inline]
    fn row(&self, index: usize) -> u32 {
        self.rows[index]
    }

    #[inline]
    fn changes(&self, index: usize) -> bool {
        self.changes[index]
    }
}

/// Synapses of a target.
struct Column<'a> {
    target: usize,
    incoming: &'a [Incoming],
    changes: &'a [bool],
}

impl Visit for Column<'_> {
    #[inline]
    fn len(&self) -> usize {
        self.incoming.len()
    }

    #[inline]
    fn place(&self, index: usize) -> usize {
        self.incoming[index].place as usize
    }

    #[inline]
    fn source(&self, index: usize) -> usize {
        self.incoming[index].source as usize
    }

    #[inline]
    fn target(&self, _: usize) -> usize {
        self.target
    }

    #[inline]
    fn row(&self, index: usize) -> u32 {
        self.incoming[index].row
    }

    #[inline]
    fn changes(&self, index: usize) -> bool {
        self.changes[index]
    }

    fn count(&self, core_of: &[CoreId], by_core: &mut [u64]) -> u64 {
        let updates = self.changes.iter().map(|&changes| u64::from(changes)).sum();
        by_core[core_of[self.target].index()] += updates;
        updates
    }
}

/// A synapse that is evaluated with others of other sources and targets.
#[derive(Debug, Clone, Copy)]
struct Listed {
    synapse: Incoming,
    target: u32,
}

/// The step in the epoch of the last spike that a synapse saw through its delay; 0 for none.
#[derive(Debug, Clone, Copy)]
struct SeenLate {
    tx: u8,
    delay: u8,
}

/// Synapses of any sources and targets.
#[derive(Debug, Default)]
struct Batch {
    listed: Vec<Listed>,
    /// One each where a rule sees spikes late.
    late: Vec<SeenLate>,
}

impl Visit for Batch {
    #[inline]
    fn len(&self) -> usize {
        self.listed.len()
    }

    #[inline]
    fn place(&self, index: usize) -> usize {
        self.listed[index].synapse.place as usize
    }

    #[inline]
    fn source(&self, index: usize) -> usize {
        self.listed[index].synapse.source as usize
    }

    #[inline]
    fn target(&self, index: usize) -> usize {
        self.listed[index].target as usize
    }

    #[inline]
    fn row(&self, index: usize) -> u32 {
        self.listed[index].synapse.row
    }

    #[inline]
    fn changes(&self, _: usize) -> bool {
        true
    }

    #[inline]
    fn late(&self, index: usize) -> Option<SeenLate> {
        self.late.get(index).copied()
    }
}

/// What the products of a rule read of synapses.
struct Seen<'a, V> {
    epoch: &'a Epoch<'a>,
    of: &'a V,
    state: &'a Columns,
}

impl<V: Visit> Seen<'_, V> {
    /// The step within the epoch at which traces are read.
    #[inline]
    fn time(&self, at: Dependency, index: usize) -> u8 {
        match (at, self.of.late(index)) {
            (Dependency::Pre, Some(late)) => late.tx,
            (Dependency::Pre, None) => self.epoch.pre.note_of(self.of.source(index)),
            (Dependency::Post, _) => self.epoch.post.note_of(self.of.target(index)),
            (Dependency::Epoch, _) => self.epoch.compiled.rule().epoch() as u8,
        }
    }
}

impl<V: Visit> Synapses for Seen<'_, V> {
    fn number(&self) -> usize {
        self.of.len()
    }

    fn x(&self, trace: usize, at: Dependency, values: &mut [i32]) {
        let Epoch { pre, source, compiled, .. } = self.epoch;
        let begin = i64::from(source.step) - i64::from(compiled.rule().epoch());
        for (index, value) in values.iter_mut().enumerate() {
            let (unit, k) = (self.of.source(index), self.time(at, index));
            *value = match self.of.late(index) {
                None => pre.at(unit, trace, k),
                Some(late) => pre.late_at(unit, begin + i64::from(k) - i64::from(late.delay), trace),
            };
        }
    }

    fn y(&self, trace: usize, at: Dependency, values: &mut [i32]) {
        let Epoch { post, reward, signals, .. } = self.epoch;
        let is_reward = trace == REWARD;
        let is_signal = !is_reward && signals.gives(trace);
        for (index, value) in values.iter_mut().enumerate() {
            let (target, k) = (self.of.target(index), self.time(at, index));
            *value = match (is_reward, is_signal) {
                (true, _) => reward.first_at(k),
                (_, true) => signals.at(trace, target, k).unwrap_or_default(),
                _ => post.at(target, trace, k),
            };
        }
    }

    fn variable(&self, variable: Variable, values: &mut [i32]) {
        let column = self.state.column(variable);
        if column.is_empty() {
            values.fill(self.epoch.projection.of.delay.get().into());
            return;
        }
        for (index, value) in values.iter_mut().enumerate() {
            *value = column[self.of.place(index)].into();
        }
    }
}

/// The synapses of a projection in a shard, while they learn.
struct OfShard<'a> {
    synapses: &'a PlasticSynapses,
    rows: &'a Rows,
    state: &'a mut Columns,
    /// Updates of each core.
    by_core: &'a mut [u64],
    /// By [`When::index`].
    batches: [Batch; When::COUNT],
    updates: u64,
}
