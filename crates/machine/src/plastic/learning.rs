//! The phase Learn: synapses change at the end of each epoch of their rule (`docs/learning.md`).
//!
//! Input: the spikes that a step delivered. Output: new variables in the state of each shard. A
//! synapse is visited only where the dependency of one of its products may be true: by the row of
//! its source, by the column of its target, or in an epoch of u.

use std::ops::Range;

use rayon::prelude::*;

use crate::layout::image::Image;
use crate::layout::plastic::{Columns, PlasticSynapses, ProjectionPlan, Rows};
use crate::plastic::traces::{Side, Source, Traces};
use crate::update::state::ShardState;
use nsim_dynamics::learning::{Compiled, Read, When, decayed_signal};
use nsim_ir::activity::StepActivity;
use nsim_ir::base::id::{ChannelId, CompartmentId, CoreId, Id, RuleId};
use nsim_ir::learning::draws::{Draws, Use};
use nsim_ir::learning::{Dependency, GREATEST_TRACE, LearningSemantics, Trace, Variable};
use nsim_ir::spikes::Spikes;

/// Learning of a run: random numbers, traces and notes.
#[derive(Debug, Clone, Default)]
pub(crate) struct Learning {
    draws: Draws,
    /// Steps since learning began, before this sample.
    base: u64,
    /// By plastic projection.
    projections: Vec<State>,
    /// Value of each channel that is a signal, in the step that learns next; channels in order.
    signals: Vec<i32>,
    /// The value of each channel that always sends the same one.
    constants: Vec<Option<i32>>,
    /// Channels of signals.
    of_signals: Range<u32>,
    /// Synapses whose rule was evaluated in this sample.
    pub updates: u64,
}

/// State of a plastic projection.
#[derive(Debug, Clone)]
struct State {
    pre: Traces,
    post: Traces,
    signals: Signals,
}

/// A change of a step's counts that the tables of cores do not show.
#[derive(Debug, Clone, Copy)]
pub(crate) enum StepChange {
    /// A lost event on this core, of a list without indices or of another.
    Lost { core: CoreId, dense: bool },
    /// Synaptic updates on this core.
    Updates { core: CoreId, updates: u64 },
}

impl StepChange {
    /// Applies the changes of a step to its counts.
    pub fn apply_all(changes: &mut Vec<StepChange>, step: &mut StepActivity) {
        for change in changes.drain(..) {
            match change {
                StepChange::Lost { core, dense: true } => step.cores[core].events_dense -= 1,
                StepChange::Lost { core, dense: false } => step.cores[core].events_sparse -= 1,
                StepChange::Updates { core, updates } => step.cores[core].synaptic_updates += updates,
            }
        }
    }
}

/// Spikes that a step has delivered.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Delivered<'a> {
    pub channels: Spikes<'a>,
    pub compartments: &'a [CompartmentId],
    /// Values of these, empty where every one is 1.
    pub values: &'a [i32],
}

impl Learning {
    /// Learning before the first step of an image.
    pub fn new(image: &Image) -> Self {
        let plan = &image.plastic;
        let state = |projection: &ProjectionPlan| {
            let (of, units) = (&projection.of, projection.of.sources.len());
            State {
                pre: Traces::new(Side::Pre, of.plastic.first_source, units, projection.sees_late),
                post: Traces::new(Side::Post, 0, of.targets.len(), false),
                signals: Signals::new(projection, plan.rules[of.plastic.rule].rule().epoch()),
            }
        };
        let signals = || plan.projections.iter().flat_map(|projection| projection.of.signals.iter().flatten());
        let first = signals().map(|signal| signal.start).min().unwrap_or(0);
        let end = signals().map(|signal| signal.end).max().unwrap_or(first);
        Learning {
            projections: plan.projections.iter().map(state).collect(),
            signals: vec![0; (end - first) as usize],
            constants: (first..end).map(|channel| factor(image, channel)).collect(),
            of_signals: first..end,
            ..Learning::default()
        }
    }

    /// Sets the random numbers.
    pub fn set_draws(&mut self, draws: &Draws) {
        self.draws = draws.clone();
    }

    /// Begins run number `run`, in which nothing has been learned.
    pub fn forget(&mut self, run: u32) {
        self.base = u64::from(run) << 32;
    }

    /// Begins a sample, after one of `steps` steps.
    pub fn begin(&mut self, steps: u32) {
        self.base += u64::from(steps);
        self.signals.fill(0);
        self.updates = 0;
        for state in &mut self.projections {
            state.pre.clear();
            state.post.clear();
            state.signals.clear();
        }
    }

    /// Whether a step without spikes may update a synapse.
    pub fn may_update(&self, image: &Image) -> bool {
        let plan = &image.plastic;
        plan.projections.iter().zip(&self.projections).any(|(projection, State { pre, post, .. })| {
            let rule = plan.rules[projection.of.plastic.rule].rule();
            let noted = !pre.noted().is_empty() || !post.noted().is_empty();
            rule.learns() && (noted || rule.waits_for(Dependency::Epoch) || projection.sees_late)
        })
    }

    /// Notes the spikes of `step`, which are delivered, and learns if it ends an epoch; adds the
    /// updates of each core to `changes`.
    pub fn advance(
        &mut self,
        step: u32,
        delivered: Delivered<'_>,
        image: &Image,
        shards: &mut [ShardState],
        mut changes: Option<&mut Vec<StepChange>>,
    ) {
        self.note(step, delivered, image);
        let plan = &image.plastic;
        for (index, projection) in plan.projections.iter().enumerate() {
            let compiled = &plan.rules[projection.of.plastic.rule];
            let rule = compiled.rule();
            if !rule.learns() || !rule.learns_after(step) {
                continue;
            }
            let State { pre, post, signals } = &mut self.projections[index];
            let source = source(&self.draws, self.base, step, projection, compiled);
            pre.make_histories(&source);
            post.make_histories(&source);
            signals.make_histories(post, &source);
            let epoch = Epoch { projection, compiled, pre, post, source, signals };
            let before: Option<Vec<u64>> = changes.is_some().then(|| updates_by_core(shards));
            let learned = shards.par_iter_mut().zip(&image.shards).map(|(state, shard)| {
                let ShardState { state, .. } = state;
                epoch.learn(&shard.plastic, &shard.plastic.projections[index], &mut state.plastic, &mut state.updates)
            });
            self.updates += learned.sum::<u64>();
            if let (Some(changes), Some(before)) = (&mut changes, before) {
                let by_core = updates_by_core(shards).into_iter().zip(before).enumerate();
                changes.extend(by_core.filter(|(_, (now, before))| now > before).map(|(core, (now, before))| {
                    StepChange::Updates { core: CoreId::new(core), updates: now - before }
                }));
            }
            pre.end_epoch(step, rule.epoch());
            post.end_epoch(step, rule.epoch());
        }
    }

    /// Sets the values of signals in a step.
    pub fn set_signals(&mut self, input: Spikes<'_>) {
        if self.signals.is_empty() {
            return;
        }
        self.signals.fill(0);
        for (place, channel) in input.ids.iter().enumerate() {
            if self.of_signals.contains(&channel.0) {
                let at = (channel.0 - self.of_signals.start) as usize;
                let given = input.values.get(place).copied().unwrap_or(1);
                self.signals[at] = self.constants[at].unwrap_or(given);
            }
        }
    }

    /// (L3) for all spikes of a step.
    fn note(&mut self, step: u32, delivered: Delivered<'_>, image: &Image) {
        let plan = &image.plastic;
        let Learning { draws, base, projections, .. } = self;
        let Delivered { channels, compartments, values } = delivered;
        let mut each =
            |units: &[u32], unit: u32, see: &mut dyn FnMut(&mut State, u32, &ProjectionPlan, &Source<'_>)| {
                for &number in units {
                    let projection = &plan.projections[number as usize];
                    let compiled = &plan.rules[projection.of.plastic.rule];
                    if compiled.rule().learns() && compiled.rule().notes(step) {
                        let source = source(draws, *base, step, projection, compiled);
                        see(&mut projections[number as usize], unit, projection, &source);
                    }
                }
            };
        let pre = |state: &mut State, unit: u32, projection: &ProjectionPlan, source: &Source<'_>, value: i32| {
            state.pre.note(unit - projection.of.sources.start, value, source);
        };
        for (place, channel) in channels.ids.iter().enumerate() {
            let value = image.value_of(channel.index(), channels.values.get(place).copied());
            each(plan.of_source.get(channel.index()), channel.0, &mut |state, unit, projection, source| {
                pre(state, unit, projection, source, value);
            });
        }
        for (place, compartment) in compartments.iter().enumerate() {
            let unit = image.channels + compartment.0;
            let value = image.value_of(unit as usize, values.get(place).copied());
            each(plan.of_source.get(unit as usize), unit, &mut |state, unit, projection, source| {
                pre(state, unit, projection, source, value);
            });
            each(plan.of_target.get(compartment.index()), compartment.0, &mut |state, unit, projection, source| {
                state.post.note(unit - projection.of.targets.start, 1, source);
            });
        }
        self.note_overflows(step, delivered, image);
        for (projection, state) in plan.projections.iter().zip(&mut self.projections) {
            let rule = plan.rules[projection.of.plastic.rule].rule();
            if rule.learns() && rule.notes(step) {
                let k = step % rule.epoch() + 1;
                state.signals.store(k, projection, self.of_signals.start, &self.signals);
            }
        }
    }

    /// Adds nothing to the traces that exceed 7 bits, as lava does in each step (L11).
    fn note_overflows(&mut self, step: u32, delivered: Delivered<'_>, image: &Image) {
        for (projection, state) in image.plastic.projections.iter().zip(&mut self.projections) {
            if !state.pre.is_over() {
                continue;
            }
            let compiled = &image.plastic.rules[projection.of.plastic.rule];
            let received = |unit: u32| {
                let unit = projection.of.sources.start + unit;
                match unit.checked_sub(image.channels) {
                    None => delivered.channels.ids.contains(&ChannelId(unit)),
                    Some(compartment) => delivered.compartments.contains(&CompartmentId(compartment)),
                }
            };
            if compiled.rule().notes(step) {
                state.pre.end_step(received);
            }
        }
    }

    /// A trace of the first copy of a rule's units, by unit of the rule.
    pub fn traces(&self, image: &Image, rule: RuleId, trace: Trace) -> Vec<i32> {
        let mut column = Vec::new();
        let mut targets = None;
        for (projection, state) in image.plastic.projections.iter().zip(&self.projections) {
            let of = &projection.of;
            if of.plastic.rule != rule || *targets.get_or_insert(of.targets.clone()) != of.targets {
                continue;
            }
            let values: Vec<i32> = match trace.index().checked_sub(2) {
                None => state.pre.column(trace.index()).collect(),
                Some(place) => {
                    let signal = state.signals.column(place, of.targets.len());
                    signal.unwrap_or_else(|| state.post.column(place).collect())
                }
            };
            let first = if trace.is_presynaptic() { of.plastic.first_source as usize } else { 0 };
            column.resize(column.len().max(first + values.len()), 0);
            column[first..first + values.len()].copy_from_slice(&values);
        }
        column
    }
}

/// Synaptic updates since they were last taken, by core.
fn updates_by_core(shards: &[ShardState]) -> Vec<u64> {
    let cores = shards.iter().map(|state| state.updates.len()).max().unwrap_or(0);
    (0..cores).map(|core| shards.iter().filter_map(|state| state.updates.get(core)).sum()).collect()
}

/// The integer in the messages of a source; `None` where it differs from message to message.
fn factor(image: &Image, source: u32) -> Option<i32> {
    let graded = &image.program().parts().graded;
    graded.iter().find(|graded| graded.sources.contains(&source)).map_or(Some(1), |graded| graded.message.factor())
}

/// Random numbers of a projection in a step.
fn source<'a>(
    draws: &'a Draws,
    base: u64,
    step: u32,
    projection: &ProjectionPlan,
    compiled: &'a Compiled,
) -> Source<'a> {
    Source { draws, rule: projection.of.plastic.rule, compiled, step, since: base + u64::from(step) }
}

/// Values of the signals of a projection, which replace postsynaptic traces: (L10).
#[derive(Debug, Clone, Default)]
struct Signals {
    /// Values of each trace's channels by step of the epoch from 1 on; none where there is no
    /// signal.
    given: [Option<Vec<Vec<i32>>>; 3],
    /// In lava's semantics, each trace's history in the epoch that ends: by target, then step.
    histories: [Vec<i32>; 3],
}

impl Signals {
    fn new(projection: &ProjectionPlan, epoch: u32) -> Self {
        let given = projection.of.signals.clone().map(|channels| {
            let channels = channels?.len();
            Some(vec![vec![0; channels]; epoch as usize + 1])
        });
        Signals { given, histories: Default::default() }
    }

    fn clear(&mut self) {
        self.given.iter_mut().flatten().flatten().for_each(|values| values.fill(0));
    }

    /// Stores the values of step k; `all` has those of the channels from `first` on.
    fn store(&mut self, k: u32, projection: &ProjectionPlan, first: u32, all: &[i32]) {
        for (given, channels) in self.given.iter_mut().zip(&projection.of.signals) {
            if let (Some(given), Some(channels)) = (given, channels) {
                let values = &all[(channels.start - first) as usize..(channels.end - first) as usize];
                given[k as usize].copy_from_slice(values);
                // The last value is kept beyond the epoch, for probes.
                given[0].copy_from_slice(values);
            }
        }
    }

    /// The last value of a trace by target.
    fn column(&self, trace: usize, targets: usize) -> Option<Vec<i32>> {
        let last = &self.given[trace].as_ref()?[0];
        Some((0..targets).map(|target| last[target.min(last.len() - 1)]).collect())
    }

    /// In lava a trace decays from its last value, over the whole epoch, and a spike cuts it.
    fn make_histories(&mut self, post: &Traces, source: &Source<'_>) {
        let rule = source.compiled.rule();
        if rule.semantics() != LearningSemantics::Lava {
            return;
        }
        let epoch = rule.epoch();
        let draw = || source.draws.shared(source.rule, Use::PostDecay, (source.step + 1) / epoch - 1, source.since);
        for trace in 0..3 {
            let Some(values) = self.column(trace, post.units()) else { continue };
            let (history, draw) = (&mut self.histories[trace], draw());
            history.clear();
            for (target, mut value) in values.into_iter().enumerate() {
                history.push(value);
                for k in 1..=epoch {
                    value = decayed_signal(value, draw);
                    if k == post.note_of(target) {
                        value = value.clamp(0, GREATEST_TRACE);
                    }
                    history.push(value);
                }
            }
        }
    }

    /// The value of a trace at step k of the epoch, where a signal gives it.
    #[inline]
    fn at(&self, trace: usize, target: usize, k: u32) -> Option<i32> {
        let given = self.given[trace].as_ref()?;
        if let Some(&value) = self.histories[trace].get(target * given.len() + k as usize) {
            return Some(value);
        }
        let values = &given[k as usize];
        Some(values[target.min(values.len() - 1)])
    }
}

/// The learning of a projection at the end of an epoch.
struct Epoch<'a> {
    projection: &'a ProjectionPlan,
    compiled: &'a Compiled,
    pre: &'a Traces,
    post: &'a Traces,
    source: Source<'a>,
    signals: &'a Signals,
}

/// What the synapses of one source read.
#[derive(Clone, Copy)]
struct OfSource<'a> {
    source: usize,
    /// Step of the source's last spike in the epoch; 0 for none.
    tx: u32,
    history: &'a [[i16; 3]],
}

/// Visits to a synapse by its target's column for which all synapses can be looked through.
const COLUMN_VISIT: usize = 16;

impl Epoch<'_> {
    /// Changes the synapses of a shard; returns how many were evaluated.
    fn learn(&self, synapses: &PlasticSynapses, rows: &Rows, state: &mut Columns, by_core: &mut [u64]) -> u64 {
        let mut shard = OfShard { synapses, rows, state, by_core, updates: 0 };
        self.raise_least_tags(&mut shard);
        match self.projection.sees_late {
            true => self.visit::<true>(&mut shard),
            false => self.visit::<false>(&mut shard),
        }
        shard.updates
    }

    /// lava clips the accumulator of a tag of -257 although no product counts, which mostly makes it
    /// -256 (L6). These synapses are not counted as evaluated.
    fn raise_least_tags(&self, shard: &mut OfShard<'_>) {
        let rule = self.compiled.rule();
        let least = rule.semantics().tags().0;
        if !rule.changes(Variable::Tag) || self.compiled.unchanged(least) == least << 7 {
            return;
        }
        let slow = self.is_slow();
        for source in 0..shard.rows.firsts.len() - 1 {
            for place in shard.rows.of_source(source) {
                let target = shard.synapses.targets[place] as usize;
                let (pre, post) = (self.pre.note_of(source) > 0, self.post.note_of(target) > 0);
                let is_least = i32::from(shard.state.tags[place]) == least;
                if is_least && !self.compiled.is_evaluated(When { pre, post, epoch: slow }) {
                    let round = || self.source.round(Variable::Tag as u8, shard.synapses.row_of[place]);
                    let (sum, format) = (self.compiled.unchanged(least), self.projection.of.format);
                    shard.state.tags[place] = self.compiled.rounded(Variable::Tag, format, sum, round);
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
    fn visit<const LATE: bool>(&self, shard: &mut OfShard<'_>) {
        let (rule, rows) = (self.compiled.rule(), shard.rows);
        let slow = self.is_slow();
        let (by_rows, by_columns) = (rule.waits_for(Dependency::Pre), rule.waits_for(Dependency::Post));
        let all = rows.firsts.len() - 1;
        let places = (rows.firsts[all] - rows.firsts[0]) as usize;
        let of_columns = |&target: &u32| rows.by_target.get(target as usize).len();
        let columns: usize = self.post.noted().iter().filter(|_| by_columns).map(of_columns).sum();
        if slow || (columns > 0 && COLUMN_VISIT * columns >= places) {
            for source in 0..all {
                let of_source = self.of_source(source);
                let whole = slow || by_rows && self.may_have_spiked::<LATE>(source);
                for place in rows.of_source(source) {
                    let target = shard.synapses.targets[place] as usize;
                    if whole || by_columns && self.post.note_of(target) > 0 {
                        self.change::<LATE>(of_source, target, place, slow, shard);
                    }
                }
            }
            return;
        }
        // A source's spikes of earlier epochs may be seen in this one.
        let sources = if LATE { self.pre.live() } else { self.pre.noted() };
        for &source in sources.iter().filter(|_| by_rows) {
            let of_source = self.of_source(source as usize);
            for place in rows.of_source(source as usize) {
                let target = shard.synapses.targets[place] as usize;
                self.change::<LATE>(of_source, target, place, false, shard);
            }
        }
        for &target in self.post.noted().iter().filter(|_| by_columns) {
            for &place in rows.by_target.get(target as usize) {
                let source = shard.synapses.sources[place as usize] as usize;
                // Synapses of the rows above have learned.
                if !(by_rows && self.may_have_spiked::<LATE>(source)) {
                    self.change::<LATE>(self.of_source(source), target as usize, place as usize, false, shard);
                }
            }
        }
    }

    /// Whether a spike of a source may be seen in this epoch.
    #[inline]
    fn may_have_spiked<const LATE: bool>(&self, source: usize) -> bool {
        if LATE { self.pre.is_live(source) } else { self.pre.note_of(source) > 0 }
    }

    #[inline]
    fn of_source(&self, source: usize) -> OfSource<'_> {
        let history = self.pre.history(source, self.compiled.rule().epoch());
        OfSource { source, tx: self.pre.note_of(source), history }
    }

    /// Evaluates a synapse, if the dependency of a product is true.
    #[inline]
    fn change<const LATE: bool>(
        &self,
        OfSource { source, mut tx, history }: OfSource<'_>,
        target: usize,
        place: usize,
        slow: bool,
        shard: &mut OfShard<'_>,
    ) {
        let of = &self.projection.of;
        let delay = match self.projection.moves {
            true => shard.state.delays[place].into(),
            false => i64::from(of.delay.get()),
        };
        let (epoch, end) = (self.compiled.rule().epoch(), i64::from(self.source.step));
        let begin = end - i64::from(epoch);
        if LATE {
            let spiked = self.pre.late_spike(source, end - delay, epoch);
            tx = spiked.map_or(0, |step| step + delay - begin) as u32;
        }
        let ty = self.post.note_of(target);
        let when = When { pre: tx > 0, post: ty > 0, epoch: slow };
        if !self.compiled.is_evaluated(when) {
            return;
        }
        let of_target = self.post.history(target, epoch);
        let read = |dependency: Dependency, read: Read| {
            let k = match dependency {
                Dependency::Pre => tx,
                Dependency::Post => ty,
                Dependency::Epoch => epoch,
            };
            match read {
                Read::X(trace) if LATE => self.pre.late_at(source, begin + i64::from(k) - delay, trace),
                Read::X(trace) => history[k as usize][trace].into(),
                Read::Y(trace) => {
                    self.signals.at(trace, target, k).unwrap_or_else(|| of_target[k as usize][trace].into())
                }
                _ => 0,
            }
        };
        let columns = &mut *shard.state;
        let old = |variable: Variable| match columns.column(variable).get(place) {
            Some(&value) => value.into(),
            None => delay as i32,
        };
        let mut new = [None; 3];
        self.compiled.accumulate(when, old, read, |variable, sum| {
            let round = || self.source.round(variable as u8, shard.synapses.row_of[place]);
            new[variable as usize] = Some(self.compiled.rounded(variable, of.format, sum, round));
        });
        for variable in Variable::ALL {
            if let Some(value) = new[variable as usize] {
                columns.column_mut(variable)[place] = value;
            }
        }
        shard.updates += 1;
        shard.by_core[shard.rows.core_of[target].index()] += 1;
    }
}

/// The synapses of a projection in a shard, while they learn.
struct OfShard<'a> {
    synapses: &'a PlasticSynapses,
    rows: &'a Rows,
    state: &'a mut Columns,
    /// Updates of each core.
    by_core: &'a mut [u64],
    updates: u64,
}
