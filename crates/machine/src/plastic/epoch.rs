//! The end of an epoch: the synapses of a projection whose products count are changed (L6).
//!
//! Input: notes and histories of both sides. Output: new variables in the state of a shard.
//! Synapses are collected by their true dependencies, so that a rule is interpreted once for many
//! of them.

use crate::layout::plastic::{Columns, PlasticSynapses, ProjectionPlan, Rows};
use crate::layout::shard::Shard;
use crate::plastic::signals::Signals;
use crate::plastic::traces::{Source, Traces};
use crate::prefetch::{prefetch, prefetch_range};
use crate::update::state::ShardState;
use nsim_dynamics::learning::{BATCH, Compiled, REWARD, Scratch, Synapses, When};
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
            scratch: Scratch::default(),
            updates: 0,
            arch: pulp::Arch::new(),
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
        let unchanged = self.compiled.unchanged(least);
        if !rule.changes(Variable::Tag) || unchanged == least << 7 {
            return;
        }
        let rounding = self.compiled.rounding(Variable::Tag, self.projection.of.format);
        let raised = rounding.rounded(unchanged, rounding.share(self.round.unwrap_or_default()));
        let epoch = self.is_slow();
        for source in 0..shard.rows.firsts.len() - 1 {
            for place in shard.rows.of_source(source) {
                let target = shard.synapses.targets[place] as usize;
                let when = When { pre: self.pre.note_of(source) > 0, post: self.post.note_of(target) > 0, epoch };
                if i32::from(shard.state.tags[place]) == least && !self.compiled.is_evaluated(when) {
                    shard.state.tags[place] = raised;
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
            (0..rows.firsts.len() as u32 - 1).for_each(|source| self.visit_row(source, true, shard));
            return;
        }
        let sources = if rule.waits_for(Dependency::Pre) { self.pre.noted() } else { &[] };
        for (place, &source) in sources.iter().enumerate() {
            if let Some(&ahead) = sources.get(place + AHEAD) {
                let places = rows.of_source(ahead as usize);
                prefetch_range(&shard.synapses.targets, places.clone());
                prefetch_range(&shard.state.weights, places);
            }
            self.visit_row(source, false, shard);
        }
        let targets = if rule.waits_for(Dependency::Post) { self.post.noted() } else { &[] };
        for (number, &target) in targets.iter().enumerate() {
            if let Some(&ahead) = targets.get(number + AHEAD) {
                let (places, sources) = rows.of_target(ahead);
                prefetch_range(places, 0..places.len());
                prefetch_range(sources, 0..sources.len());
            }
            if let Some(&next) = targets.get(number + 1) {
                rows.of_target(next).0.iter().for_each(|&place| prefetch(&shard.state.weights, place as usize));
            }
            self.visit_column(target, shard);
        }
    }

    /// Evaluates the synapses of a source, of which a product counts.
    fn visit_row(&self, source: u32, slow: bool, shard: &mut OfShard<'_>) {
        let targets = shard.synapses.targets.as_slice();
        let pre = self.pre.note_of(source as usize) > 0;
        let [quiet, spiked] = [false, true].map(|post| When { pre, post, epoch: slow });
        let (places, notes) = (shard.rows.of_source(source as usize), self.post.notes());
        for first in places.clone().step_by(BATCH) {
            let targets = &targets[first..places.end.min(first + BATCH)];
            let mut changes = [false; BATCH];
            for (index, (&target, changes)) in targets.iter().zip(&mut changes).enumerate() {
                *changes = notes[target as usize] == 0;
                if !*changes {
                    self.add(spiked, Listed { place: (first + index) as u32, source, target }, shard);
                }
            }
            let changes = &changes[..targets.len()];
            let (places, sources, targets) = (Places::From(first), Units::One(source), Units::Each(targets));
            self.evaluate(quiet, Group { places, sources, targets, changes, late: &[] }, shard);
        }
    }

    /// Evaluates the synapses of a target that spiked, but those whose rows were visited.
    fn visit_column(&self, target: u32, shard: &mut OfShard<'_>) {
        let by_rows = self.compiled.rule().waits_for(Dependency::Pre);
        let [quiet, spiked] = [false, true].map(|pre| When { pre, post: true, epoch: false });
        let ((places, sources), notes) = (shard.rows.of_target(target), self.pre.notes());
        for (places, sources) in places.chunks(BATCH).zip(sources.chunks(BATCH)) {
            let mut changes = [false; BATCH];
            for ((&place, &source), changes) in places.iter().zip(sources).zip(&mut changes) {
                *changes = notes[source as usize] == 0;
                if !*changes && !by_rows {
                    self.add(spiked, Listed { place, source, target }, shard);
                }
            }
            let changes = &changes[..places.len()];
            let (places, sources, targets) = (Places::Each(places), Units::Each(sources), Units::One(target));
            self.evaluate(quiet, Group { places, sources, targets, changes, late: &[] }, shard);
        }
    }

    /// [`Self::visit`], where a rule sees spikes late: of earlier epochs, and each synapse others.
    fn visit_late(&self, shard: &mut OfShard<'_>) {
        let (rule, rows, slow) = (self.compiled.rule(), shard.rows, self.is_slow());
        let by_rows = rule.waits_for(Dependency::Pre);
        let live = if by_rows { self.pre.live() } else { &[] };
        let visit_row = |source: u32, shard: &mut OfShard<'_>| {
            for place in rows.of_source(source as usize) {
                let target = shard.synapses.targets[place];
                self.add_late(Listed { place: place as u32, source, target }, slow, shard);
            }
        };
        if slow {
            (0..rows.firsts.len() as u32 - 1).for_each(|source| visit_row(source, shard));
            return;
        }
        live.iter().for_each(|&source| visit_row(source, shard));
        let targets = if rule.waits_for(Dependency::Post) { self.post.noted() } else { &[] };
        for &target in targets {
            let (places, sources) = rows.of_target(target);
            for (&place, &source) in places.iter().zip(sources) {
                // Synapses of the rows above have learned.
                if !(by_rows && self.pre.is_live(source as usize)) {
                    self.add_late(Listed { place, source, target }, slow, shard);
                }
            }
        }
    }

    /// Adds a synapse to those that are evaluated, if the dependency of a product is true.
    fn add_late(&self, listed: Listed, slow: bool, shard: &mut OfShard<'_>) {
        let delay = match self.projection.moves {
            true => shard.state.delays[listed.place as usize] as u8,
            false => self.projection.of.delay.get(),
        };
        let (end, epoch) = (i64::from(self.source.step) - i64::from(delay), i64::from(self.compiled.rule().epoch()));
        let spiked = self.pre.late_spike(listed.source as usize, end);
        let tx = spiked.map_or(0, |step| step + epoch - end) as u8;
        let when = When { pre: tx > 0, post: self.post.note_of(listed.target as usize) > 0, epoch: slow };
        if self.compiled.is_evaluated(when) {
            shard.batches[when.index()].late.push(SeenLate { tx, delay });
            self.add(when, listed, shard);
        }
    }

    /// Adds a synapse to the batch of its dependencies.
    fn add(&self, when: When, listed: Listed, shard: &mut OfShard<'_>) {
        let batch = &mut shard.batches[when.index()];
        batch.places.push(listed.place);
        batch.sources.push(listed.source);
        batch.targets.push(listed.target);
        if batch.places.len() == BATCH {
            self.evaluate_batch(when, shard);
        }
    }

    /// Evaluates the synapses of a batch, and empties it.
    fn evaluate_batch(&self, when: When, shard: &mut OfShard<'_>) {
        let mut batch = std::mem::take(&mut shard.batches[when.index()]);
        let group = Group {
            places: Places::Each(&batch.places),
            sources: Units::Each(&batch.sources),
            targets: Units::Each(&batch.targets),
            changes: &[true; BATCH][..batch.places.len()],
            late: &batch.late,
        };
        self.evaluate(when, group, shard);
        batch.clear();
        shard.batches[when.index()] = batch;
    }

    /// Evaluates synapses of which these dependencies are true.
    fn evaluate(&self, when: When, group: Group<'_>, shard: &mut OfShard<'_>) {
        if !group.changes.is_empty() && self.compiled.is_evaluated(when) {
            shard.arch.dispatch(Evaluation { epoch: self, when, group, shard });
        }
    }
}

/// The evaluation of a group, in the form that `pulp` runs with the processor's vectors.
struct Evaluation<'e, 's, 'o> {
    epoch: &'e Epoch<'e>,
    when: When,
    group: Group<'e>,
    shard: &'s mut OfShard<'o>,
}

impl pulp::NullaryFnOnce for Evaluation<'_, '_, '_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Evaluation { epoch, when, group, shard } = self;
        // All variables are read before one is changed.
        let mut values = [[0; BATCH]; 3];
        let changes = epoch.compiled.changes(when);
        for (change, values) in changes.iter().zip(&mut values) {
            let seen = Seen { epoch, group, state: shard.state };
            let sums = epoch.compiled.accumulate(change, when, &seen, &mut shard.scratch);
            epoch.round(change.variable, sums, group, shard.state, values);
        }
        for (change, values) in changes.iter().zip(&values) {
            group.write(values, shard.state.column_mut(change.variable));
        }
        shard.updates += group.count(&shard.rows.core_of, shard.by_core);
    }
}

impl Epoch<'_> {
    /// (L6), (L7), (L16): from accumulators of synapses to the values of their variable.
    #[inline(always)]
    fn round(&self, variable: Variable, sums: &[i32], group: Group<'_>, state: &Columns, values: &mut [i16; BATCH]) {
        let all = values.iter_mut().zip(sums);
        if let Some(rounded) = self.compiled.without_draw(self.projection.of.format) {
            let weight = |index| i32::from(state.weights[group.places.get(index)]);
            all.enumerate().for_each(|(index, (value, &sum))| *value = rounded(weight(index), sum));
            return;
        }
        let rounding = self.compiled.rounding(variable, self.projection.of.format);
        if let Some(shared) = self.round {
            let share = rounding.share(shared);
            all.for_each(|(value, &sum)| *value = rounding.rounded(sum, share));
            return;
        }
        let (numbers, first) = (self.source.round(variable), self.projection.of.plastic.first_source);
        let mut bits = [0; BATCH];
        group.sources.map(&mut bits, |_, source| numbers.of_source(first + source));
        group.targets.map(&mut bits, |of_source, target| numbers.of_synapse(of_source, target));
        all.zip(bits).for_each(|((value, &sum), bits)| *value = rounding.rounded(sum, rounding.share_of_bits(bits)));
    }
}

/// Where synapses are in the columns of a shard.
#[derive(Debug, Clone, Copy)]
enum Places<'a> {
    /// From this place on.
    From(usize),
    Each(&'a [u32]),
}

impl Places<'_> {
    #[inline(always)]
    fn get(self, index: usize) -> usize {
        match self {
            Places::From(first) => first + index,
            Places::Each(places) => places[index] as usize,
        }
    }
}

/// The sources or the targets of synapses.
#[derive(Debug, Clone, Copy)]
enum Units<'a> {
    One(u32),
    Each(&'a [u32]),
}

impl Units<'_> {
    #[inline(always)]
    fn get(self, index: usize) -> usize {
        match self {
            Units::One(unit) => unit as usize,
            Units::Each(units) => units[index] as usize,
        }
    }

    /// Replaces a value of each synapse by a function of it and the unit.
    #[inline(always)]
    fn map<T: Copy>(self, values: &mut [T], of: impl Fn(T, u32) -> T) {
        match self {
            Units::One(unit) => values.iter_mut().for_each(|value| *value = of(*value, unit)),
            Units::Each(units) => {
                values.iter_mut().zip(units).for_each(|(value, &unit)| *value = of(*value, unit));
            }
        }
    }
}

/// Synapses that are evaluated together: the same dependencies are true for all that change.
#[derive(Debug, Clone, Copy)]
struct Group<'a> {
    places: Places<'a>,
    sources: Units<'a>,
    targets: Units<'a>,
    /// Whether each changes; the others are evaluated with other dependencies.
    changes: &'a [bool],
    /// How each sees its source, where a rule sees spikes late.
    late: &'a [SeenLate],
}

impl Group<'_> {
    /// Writes the values of the synapses that change.
    #[inline(always)]
    fn write(&self, values: &[i16], column: &mut [i16]) {
        let values = values.iter().zip(self.changes);
        match self.places {
            Places::From(first) => {
                let column = &mut column[first..first + self.changes.len()];
                column.iter_mut().zip(values).for_each(|(old, (&new, &is))| *old = if is { new } else { *old });
            }
            Places::Each(places) => {
                for (&place, (&new, &changes)) in places.iter().zip(values) {
                    if changes {
                        column[place as usize] = new;
                    }
                }
            }
        }
    }

    /// Adds the updates of each core; returns their number.
    #[inline(always)]
    fn count(&self, core_of: &[CoreId], by_core: &mut [u64]) -> u64 {
        let updates = self.changes.iter().map(|&changes| u64::from(changes)).sum();
        match self.targets {
            Units::One(target) => by_core[core_of[target as usize].index()] += updates,
            Units::Each(targets) => {
                for (&target, &changes) in targets.iter().zip(self.changes) {
                    by_core[core_of[target as usize].index()] += u64::from(changes);
                }
            }
        }
        updates
    }
}

/// A synapse that is evaluated with others of other sources and targets.
#[derive(Debug, Clone, Copy)]
struct Listed {
    place: u32,
    source: u32,
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
    places: Vec<u32>,
    sources: Vec<u32>,
    targets: Vec<u32>,
    /// One each where a rule sees spikes late.
    late: Vec<SeenLate>,
}

impl Batch {
    fn clear(&mut self) {
        [&mut self.places, &mut self.sources, &mut self.targets].into_iter().for_each(Vec::clear);
        self.late.clear();
    }
}

/// What the products of a rule read of synapses.
struct Seen<'a> {
    epoch: &'a Epoch<'a>,
    group: Group<'a>,
    state: &'a Columns,
}

impl Seen<'_> {
    /// The step within the epoch at which all read traces; `None` where it differs.
    #[inline(always)]
    fn common_time(&self, at: Dependency) -> Option<u8> {
        let Group { sources, targets, late, .. } = self.group;
        match (at, sources, targets) {
            (Dependency::Epoch, ..) => Some(self.epoch.compiled.rule().epoch() as u8),
            (Dependency::Pre, Units::One(source), _) if late.is_empty() => {
                Some(self.epoch.pre.note_of(source as usize))
            }
            (Dependency::Post, _, Units::One(target)) => Some(self.epoch.post.note_of(target as usize)),
            (Dependency::Pre | Dependency::Post, ..) => None,
        }
    }

    /// The step within the epoch at which a synapse reads traces.
    #[inline(always)]
    fn time(&self, at: Dependency, index: usize) -> u8 {
        match (at, self.group.late.get(index)) {
            (Dependency::Pre, Some(late)) => late.tx,
            (Dependency::Pre, None) => self.epoch.pre.note_of(self.group.sources.get(index)),
            (Dependency::Post, _) => self.epoch.post.note_of(self.group.targets.get(index)),
            (Dependency::Epoch, _) => self.epoch.compiled.rule().epoch() as u8,
        }
    }

    /// A trace of the units at the time of a dependency.
    #[inline(always)]
    fn trace(&self, traces: &Traces, units: Units<'_>, (trace, at): (usize, Dependency), values: &mut [i32]) {
        match self.common_time(at).map(|k| traces.all_at(trace, k)) {
            Some([]) => values.fill(0),
            Some(all) => units.map(values, |_, unit| all[unit as usize].into()),
            None => {
                let value = |index| traces.at(units.get(index), trace, self.time(at, index));
                values.iter_mut().enumerate().for_each(|(index, of)| *of = value(index));
            }
        }
    }
}

impl Synapses for Seen<'_> {
    #[inline(always)]
    fn number(&self) -> usize {
        self.group.changes.len()
    }

    #[inline(always)]
    fn x(&self, trace: usize, at: Dependency, values: &mut [i32]) {
        let Epoch { pre, source, compiled, .. } = self.epoch;
        let Group { sources, late, .. } = self.group;
        if late.is_empty() {
            return self.trace(pre, sources, (trace, at), values);
        }
        let begin = i64::from(source.step) - i64::from(compiled.rule().epoch());
        for (index, (value, late)) in values.iter_mut().zip(late).enumerate() {
            let step = begin + i64::from(self.time(at, index)) - i64::from(late.delay);
            *value = pre.late_at(sources.get(index), step, trace);
        }
    }

    #[inline(always)]
    fn y(&self, trace: usize, at: Dependency, values: &mut [i32]) {
        let Epoch { post, reward, signals, .. } = self.epoch;
        let targets = self.group.targets;
        if trace != REWARD && !signals.gives(trace) {
            return self.trace(post, targets, (trace, at), values);
        }
        for (index, value) in values.iter_mut().enumerate() {
            let k = self.time(at, index);
            *value = match trace {
                REWARD => reward.first_at(k),
                _ => signals.at(trace, targets.get(index), k).unwrap_or_default(),
            };
        }
    }

    #[inline(always)]
    fn variable(&self, variable: Variable, values: &mut [i32]) {
        let column = self.state.column(variable);
        match self.group.places {
            _ if column.is_empty() => values.fill(self.epoch.projection.of.delay.get().into()),
            Places::From(first) => {
                let column = &column[first..first + values.len()];
                values.iter_mut().zip(column).for_each(|(value, &of)| *value = of.into());
            }
            Places::Each(places) => {
                values.iter_mut().zip(places).for_each(|(value, &place)| *value = column[place as usize].into());
            }
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
    scratch: Scratch,
    updates: u64,
    arch: pulp::Arch,
}
