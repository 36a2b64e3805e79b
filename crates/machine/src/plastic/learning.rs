//! The phase Learn: synapses change at the end of each epoch of their rule (`docs/learning.md`).
//!
//! Input: the spikes that a step delivered. Output: new variables in the state of each shard. A
//! synapse is visited only where the dependency of one of its products may be true: by the row of
//! its source, by the column of its target, or in an epoch of u.

use std::ops::Range;

use rayon::prelude::*;

use crate::layout::image::Image;
use crate::layout::plastic::{Plan, ProjectionPlan};
use crate::plastic::epoch::Epoch;
use crate::plastic::pes::{self, Arrivals};
use crate::plastic::signals::Signals;
use crate::plastic::traces::{Side, Source, Traces};
use crate::update::state::ShardState;
use nsim_dynamics::learning::Compiled;
use nsim_ir::activity::StepActivity;
use nsim_ir::base::id::{ChannelId, CompartmentId, CoreId, Id, RuleId};
use nsim_ir::learning::draws::Draws;
use nsim_ir::learning::{Dependency, Trace};
use nsim_ir::spikes::Spikes;

/// Learning of a run: random numbers, traces and notes.
#[derive(Debug, Clone, Default)]
pub(crate) struct Learning {
    draws: Draws,
    /// Steps since learning began, before this sample.
    base: u64,
    /// By plastic projection.
    projections: Vec<State>,
    /// The projections that learn by PES.
    pes: Vec<pes::Learner>,
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
    /// Of one unit where the rule has a reward, else of none.
    reward: Traces,
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
    /// Adds the updates of each core since there were `before` ones.
    fn add_updates(changes: &mut Option<&mut Vec<StepChange>>, before: Option<Vec<u64>>, shards: &[ShardState]) {
        if let (Some(changes), Some(before)) = (changes, before) {
            let by_core = updates_by_core(shards).into_iter().zip(before).enumerate();
            changes.extend(
                by_core.filter(|(_, (now, before))| now > before).map(|(core, (now, before))| StepChange::Updates {
                    core: CoreId::new(core),
                    updates: now - before,
                }),
            );
        }
    }

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

impl Delivered<'_> {
    /// Whether one of these sources spiked, channels first.
    fn has_any(&self, units: &Range<u32>, channels: u32) -> bool {
        self.channels.ids.iter().any(|channel| units.contains(&channel.0))
            || self.compartments.iter().any(|compartment| units.contains(&(channels + compartment.0)))
    }
}

impl Learning {
    /// Learning before the first step of an image.
    pub fn new(image: &Image) -> Self {
        let plan = &image.plastic;
        let state = |projection: &ProjectionPlan| {
            let (of, rule) = (&projection.of, &plan.rules[projection.of.plastic.rule]);
            let (first, late) = (of.plastic.first_source, projection.sees_late);
            State {
                pre: Traces::new(Side::Pre, first, of.sources.len(), late, rule),
                post: Traces::new(Side::Post, 0, of.targets.len(), false, rule),
                reward: Traces::new(Side::Reward, 0, of.reward.iter().len(), false, rule),
                signals: Signals::new(projection, rule.rule().epoch()),
            }
        };
        let signals = || plan.projections.iter().flat_map(|projection| projection.of.signals.iter().flatten());
        let first = signals().map(|signal| signal.start).min().unwrap_or(0);
        let end = signals().map(|signal| signal.end).max().unwrap_or(first);
        Learning {
            projections: plan.projections.iter().map(state).collect(),
            pes: pes::Learner::all(image),
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
        self.pes.iter_mut().for_each(pes::Learner::clear);
        for state in &mut self.projections {
            state.pre.clear();
            state.post.clear();
            state.reward.clear();
            state.signals.clear();
        }
    }

    /// Whether a step without spikes may update a synapse.
    pub fn may_update(&self, image: &Image) -> bool {
        if !self.pes.is_empty() {
            return true;
        }
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
            let State { pre, post, reward, signals } = &mut self.projections[index];
            let source = source(&self.draws, self.base, step, projection, compiled);
            pre.make_histories(&source);
            post.make_histories(&source);
            reward.make_histories(&source);
            signals.make_histories(post, &source);
            let round = source.shared_round();
            let epoch = Epoch { projection, compiled, pre, post, reward, source, round, signals };
            let before = changes.is_some().then(|| updates_by_core(shards));
            self.updates += match (&mut *shards, image.shards.as_slice()) {
                ([state], [shard]) => epoch.learn(index, state, shard),
                (states, shards) => {
                    let pairs = states.par_iter_mut().zip(shards);
                    pairs.map(|(state, shard)| epoch.learn(index, state, shard)).sum()
                }
            };
            StepChange::add_updates(&mut changes, before, shards);
            pre.end_epoch(step);
            post.end_epoch(step);
            reward.end_epoch(step);
        }
    }

    /// PES learns from the spikes that arrive in a step, and from its signals; adds the updates of
    /// each core to `changes`.
    pub fn learn_errors(
        &mut self,
        step: u32,
        delivered: Delivered<'_>,
        image: &Image,
        shards: &mut [ShardState],
        mut changes: Option<&mut Vec<StepChange>>,
    ) {
        if self.pes.is_empty() {
            return;
        }
        let compartments = delivered.compartments.iter().map(|compartment| image.channels + compartment.0);
        let units: Vec<u32> = delivered.channels.ids.iter().map(|channel| channel.0).chain(compartments).collect();
        let (since, signals) = (self.base + u64::from(step), (self.of_signals.start, self.signals.as_slice()));
        let arrivals = Arrivals { step, since, draws: &self.draws, units: &units, signals };
        let before = changes.is_some().then(|| updates_by_core(shards));
        self.updates += self.pes.iter_mut().map(|pes| pes.advance(arrivals, image, shards)).sum::<u64>();
        StepChange::add_updates(&mut changes, before, shards);
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
        let Delivered { channels, compartments, values } = delivered;
        for (place, channel) in channels.ids.iter().enumerate() {
            let value = image.value_of(channel.index(), channels.values.get(place).copied());
            self.note_source(step, channel.0, value, plan);
        }
        for (place, compartment) in compartments.iter().enumerate() {
            let unit = image.channels + compartment.0;
            let value = image.value_of(unit as usize, values.get(place).copied());
            self.note_source(step, unit, value, plan);
            for &number in plan.of_target.get(compartment.index()) {
                if let Some((state, projection, source)) = self.noting(step, number, plan) {
                    state.post.note(compartment.0 - projection.of.targets.start, 1, &source);
                }
            }
        }
        self.note_overflows(step, delivered, image);
        for (projection, state) in plan.projections.iter().zip(&mut self.projections) {
            let rule = plan.rules[projection.of.plastic.rule].rule();
            if rule.learns() && rule.notes(step) {
                let k = step % rule.epoch() + 1;
                state.signals.store(k, projection, self.of_signals.start, &self.signals);
                if projection.of.reward.as_ref().is_some_and(|units| delivered.has_any(units, image.channels)) {
                    let compiled = &plan.rules[projection.of.plastic.rule];
                    state.reward.note(0, 1, &source(&self.draws, self.base, step, projection, compiled));
                }
            }
        }
    }

    /// Notes the spike of a source, whose message carries this value.
    fn note_source(&mut self, step: u32, unit: u32, value: i32, plan: &Plan) {
        for &number in plan.of_source.get(unit as usize) {
            if let Some((state, projection, source)) = self.noting(step, number, plan) {
                state.pre.note(unit - projection.of.sources.start, value, &source);
            }
        }
    }

    /// The state of the projection of this number, if it notes the spikes of this step.
    fn noting<'a>(
        &'a mut self,
        step: u32,
        number: u32,
        plan: &'a Plan,
    ) -> Option<(&'a mut State, &'a ProjectionPlan, Source<'a>)> {
        let projection = &plan.projections[number as usize];
        let compiled = &plan.rules[projection.of.plastic.rule];
        let Learning { draws, base, projections, .. } = self;
        (compiled.rule().learns() && compiled.rule().notes(step))
            .then(|| (&mut projections[number as usize], projection, source(draws, *base, step, projection, compiled)))
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
        for (index, (projection, state)) in image.plastic.projections.iter().zip(&self.projections).enumerate() {
            let of = &projection.of;
            if of.plastic.rule != rule || *targets.get_or_insert(of.targets.clone()) != of.targets {
                continue;
            }
            let values: Vec<i32> = match trace.index().checked_sub(2) {
                None => match self.pes.iter().find(|pes| pes.projection == index && trace == Trace::X1) {
                    Some(pes) => pes.traces.iter().map(|&value| value.into()).collect(),
                    None => state.pre.column(trace.index()).collect(),
                },
                Some(3) => state.reward.column(0).collect(),
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
