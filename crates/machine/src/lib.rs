//! The machine: a `Program` run timestep by timestep in the chip's integers.
//!
//! Input: an [`Image`], which is a program laid out for the processor, and input spikes. Output:
//! spikes, registers, and the counts of the mapped program. A [`Machine`] is the state of one run.
//! Energy and time are computed from the counts (`cost`).
//!
//! Folders from the lowest; each uses only those before it:
//!
//! - `store`, `prefetch`, `bits`: memory aligned for the caches, its prefetching, and sets of bits.
//! - `lanes/`: compartments in lanes, sixteen at a time, and their update.
//! - `count/`: counts that a spike causes on the chip.
//! - `layout/`: a program as an image: compartments in lanes, synapses in dense blocks and lists.
//! - `deliver/`: spikes into the delay ring.
//! - `update/`: the compartments of a shard; `exchange`: the spikes of all shards in one list.
//! - `plastic/`: a rule that changes weights; `spike_counts`: the activity of a run.
//! - `ranks/`: one program run by several processes, each with a machine for its part.

mod bits;
pub(crate) mod count;
pub(crate) mod deliver;
mod exchange;
pub mod lanes;
pub mod layout;
pub mod plastic;
mod prefetch;
pub mod ranks;
mod spike_counts;
mod store;
mod update;

use std::sync::Arc;

use rayon::prelude::*;

use crate::count::effects::Events;
use crate::lanes::width;
pub use crate::layout::image::{Image, ImageError};
use crate::layout::plastic::ProjectionPlan;
use crate::plastic::learning::{Delivered, Learning, StepChange};
use crate::ranks::exchange::Exchange;
use crate::ranks::transport::Ranks;
use crate::spike_counts::SpikeCounts;
use crate::update::state::{Phase, ShardState, StepInput};
use crate::update::step::Step;
use nsim_dynamics as neuron;
use nsim_ir::activity::{Activity, MovingEvent, Overflow, StepActivity, Totals};
use nsim_ir::base::fixed::Delay;
use nsim_ir::base::id::{ChannelId, CompartmentId, CoreId, Id, IdVec, RuleId};
use nsim_ir::learning::draws::Draws;
use nsim_ir::learning::{Column, Variable};
use nsim_ir::source_counts::SourceCounts;
use nsim_ir::spikes::{Added, Engine, Spikes};

/// Settings of a run, which change no result.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    /// Whether idle compartments are skipped.
    pub skip: bool,
    /// Whether each step's activity is recorded by core, for [`Machine::last_step`].
    pub per_step: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Settings { skip: true, per_step: false }
    }
}

/// Least number of events a skip block for which a step visits every skip block. Marking an arrival
/// costs about as much as adding it, and a visit to an idle skip block some dozen additions.
const VISIT_ALL_FROM: u64 = 8;

/// The state of a run over an image. A copy continues from the same step, independently.
#[derive(Debug, Clone)]
pub struct Machine {
    image: Arc<Image>,
    shards: Vec<ShardState>,
    settings: Settings,
    arch: pulp::Arch,
    /// Numbers of the next step, and of the steps of the sample.
    step: u32,
    steps: u32,
    /// Spikes of the last step, and their payloads; empty if all spikes are binary.
    spikes: Vec<CompartmentId>,
    payloads: Vec<i32>,
    /// The other ranks of the program, and their spikes of the last step.
    others: Option<Exchange>,
    remote: Vec<CompartmentId>,
    remote_payloads: Vec<i32>,
    /// Spikes of this rank, and the other ranks' spikes that are reported to all.
    shown: Vec<CompartmentId>,
    /// Spikes of the previous step, while they are delivered.
    carried: Vec<CompartmentId>,
    carried_payloads: Vec<i32>,
    /// Scratch memory for sorting.
    marks: Vec<u64>,
    by_id: Vec<i32>,
    /// Synaptic events that the last step counted; the next will have about as many.
    last_events: u64,
    /// Totals of the sample, without events of undelivered spikes and without the residual.
    totals: Totals,
    last: StepActivity,
    counts: SpikeCounts,
    /// Notes and traces of rules; `None` where there is no rule.
    learning: Option<Box<Learning>>,
    /// Whether the last step's spikes have been noted.
    settled: bool,
    /// Events that synapses of learned delays lost at the ends of samples, by core; empty where no
    /// rule changes delays.
    lost: IdVec<CoreId, Events>,
    /// Changes of the counts of this step by learning; only where steps are counted by core.
    step_changes: Vec<StepChange>,
    /// Events of learned delays in the last step of a sample without an end.
    moving: Vec<MovingEvent>,
}

impl Machine {
    /// A machine in its initial state.
    pub fn new(image: &Arc<Image>, settings: Settings) -> Self {
        let slots = image.longest_delay as usize + 1;
        // A rule without products has traces, too.
        let learns = !image.plastic.rules.is_empty();
        Machine {
            image: image.clone(),
            shards: image.shards.iter().map(|shard| ShardState::new(image, shard, slots)).collect(),
            settings,
            arch: width::vectors(),
            step: 0,
            steps: 0,
            spikes: Vec::new(),
            payloads: Vec::new(),
            others: None,
            remote: Vec::new(),
            remote_payloads: Vec::new(),
            shown: Vec::new(),
            carried: Vec::new(),
            carried_payloads: Vec::new(),
            marks: Vec::new(),
            by_id: Vec::new(),
            last_events: 0,
            totals: Totals::default(),
            last: StepActivity::new(if settings.per_step { image.program().cores().len() } else { 0 }),
            counts: SpikeCounts::new(image),
            learning: learns.then(|| Box::new(Learning::new(image))),
            settled: false,
            lost: vec![Events::default(); if image.plastic.moves() { image.program().cores().len() } else { 0 }].into(),
            step_changes: Vec::new(),
            moving: Vec::new(),
        }
    }

    /// A machine for the part of a program on this rank, in its initial state; all ranks make
    /// theirs together. The spikes of the compartments `shown`, if any, are reported to every rank.
    ///
    /// # Panics
    /// When the image is of no part, or the ranks hold parts of different mappings.
    pub fn of_part(image: &Arc<Image>, settings: Settings, ranks: &Ranks, shown: Option<(CompartmentId, u32)>) -> Self {
        let immediately = settings.per_step || shown.is_some();
        let others = Some(Exchange::new(image.program(), ranks, shown, immediately));
        Machine { others, ..Machine::new(image, settings) }
    }

    /// Activity of the last step; empty unless `Settings::per_step` is on.
    pub fn last_step(&self) -> &StepActivity {
        &self.last
    }

    /// Takes the activity of all steps since the last call, over any number of samples.
    pub fn take_activity(&mut self) -> Activity {
        self.take_counts().0
    }

    /// Takes this activity, with the spikes of each source and the overflows of each compartment.
    pub fn take_counts(&mut self) -> (Activity, SourceCounts) {
        self.counts.take(&self.image, &mut self.shards, &mut self.lost, self.arch)
    }

    /// Adds the counts of another machine of this image, without other ranks. Then
    /// [`Machine::take_counts`] returns the counts of both.
    pub fn absorb(&mut self, other: &Machine) {
        self.counts.absorb(&other.counts);
        for (sum, more) in self.lost.iter_mut().zip(other.lost.iter()) {
            *sum = Events { dense: sum.dense + more.dense, sparse: sum.sparse + more.sparse };
        }
        self.shards.iter_mut().zip(&other.shards).for_each(|(sum, more)| sum.absorb(more));
    }

    /// Compartment updates of the sample so far that were skipped because the compartment was idle.
    pub fn skipped_updates(&self) -> u64 {
        let computed: u64 = self.shards.iter().map(|state| state.visited).sum();
        self.totals.compartment_updates - computed
    }

    /// Sets the weights of a rule in every copy of the network, by row, where this rank has the
    /// synapses. They take effect in the next step, also for spikes of compartments in the last.
    /// [`Engine::forget`] restores the first weights.
    ///
    /// # Panics
    /// When there are fewer weights than rows.
    pub fn write_weights(&mut self, rule: RuleId, weights: &[i32]) {
        let plan = self.image.plastic.projections.iter().enumerate();
        for (index, _) in plan.filter(|(_, projection)| projection.of.plastic.rule == rule) {
            for (state, shard) in self.shards.iter_mut().zip(&self.image.shards) {
                for place in shard.plastic.projections[index].places() {
                    state.plastic.weights[place] = weights[shard.plastic.row_of[place] as usize] as i16;
                }
            }
        }
    }

    /// A variable of the synapses of a rule in the first copy of the network, by row.
    fn variable(&self, rule: RuleId, variable: Variable) -> Vec<i32> {
        let (mut column, mut targets) = (Vec::new(), None);
        for (index, ProjectionPlan { of, .. }) in self.image.plastic.projections.iter().enumerate() {
            if of.plastic.rule != rule || *targets.get_or_insert(&of.targets) != &of.targets {
                continue;
            }
            let end = of.plastic.rows.iter().max().map_or(0, |&row| row as usize + 1);
            column.resize(column.len().max(end), 0);
            for (state, shard) in self.shards.iter().zip(&self.image.shards) {
                for place in shard.plastic.projections[index].places() {
                    let row = shard.plastic.row_of[place];
                    let value = state.plastic.column(variable).get(place).copied();
                    let is_delay =
                        variable == Variable::Delay && self.image.plastic.rules[rule].rule().semantics().delays_act();
                    let constant = if is_delay { of.delay.get().into() } else { 0 };
                    column[row as usize] = value.map_or(constant, i32::from);
                }
            }
        }
        column
    }

    /// Calls `see` with the core of each synapse of learned delay that loses a spike of these
    /// sources, whose deliveries reach `left` steps, and with whether its list has no indices.
    fn each_lost(&self, sources: &[u32], left: u32, mut see: impl FnMut(CoreId, bool)) {
        // The tables lose what reaches no step.
        if left > 0 && left <= Delay::MAX.get().into() {
            let is_lost = |core, dense, delay| {
                if delay >= left {
                    see(core, dense);
                }
            };
            self.each_moving(sources, is_lost);
        }
    }

    /// Calls `see` with the core of each synapse of learned delay of these sources, with whether
    /// its list has no indices, and with its delay.
    fn each_moving(&self, sources: &[u32], mut see: impl FnMut(CoreId, bool, u32)) {
        let plan = &self.image.plastic;
        if self.lost.is_empty() {
            return;
        }
        for (state, shard) in self.shards.iter().zip(&self.image.shards) {
            for &source in sources {
                for &number in plan.of_source.get(source as usize) {
                    let ProjectionPlan { of, moves, .. } = &plan.projections[number as usize];
                    let rows = &shard.plastic.projections[number as usize];
                    for place in rows.of_source((source - of.sources.start) as usize) {
                        if *moves {
                            let core = rows.core_of[shard.plastic.targets[place] as usize];
                            see(core, shard.plastic.dense[place], state.plastic.delays[place] as u32);
                        }
                    }
                }
            }
        }
    }

    /// Counts the events that synapses of learned delays lose, which the tables of cores count.
    fn lose(&mut self, sources: &[u32], left: u32) {
        let mut lost = Vec::new();
        self.each_lost(sources, left, |core, dense| lost.push((core, dense)));
        for (core, dense) in lost {
            let of_core = &mut self.lost[core];
            *(if dense { &mut of_core.dense } else { &mut of_core.sparse }) += 1;
            if self.settings.per_step {
                self.step_changes.push(StepChange::Lost { core, dense });
            }
        }
    }

    /// Stores the events of learned delays of these sources, in a sample without an end whose steps
    /// are counted by core.
    fn note_moving(&mut self, sources: impl Iterator<Item = u32>, wait: u32) {
        if self.lost.is_empty() || !self.settings.per_step || self.steps < u32::MAX {
            return;
        }
        let (sources, mut moving): (Vec<u32>, _) = (sources.collect(), std::mem::take(&mut self.moving));
        self.each_moving(&sources, |core, dense, delay| moving.push(MovingEvent { core, dense, delay, wait }));
        self.moving = moving;
    }

    /// Removes from the counts of a step of a sample without an end, with its events of learned
    /// delays, those that would not arrive in the `left` steps from it on.
    pub fn cut(&self, (step, moving): (&mut StepActivity, &[MovingEvent]), left: u32) {
        let [mut all, mut within] = [(); 2].map(|()| StepActivity::new(step.cores.len()));
        for (counts, left) in [(&mut all, u32::MAX), (&mut within, left)] {
            self.image.tally().add_step((&step.channels, &step.fired), left, counts);
        }
        for (core, (all, within)) in step.cores.iter_mut().zip(all.cores.iter().zip(&within.cores)) {
            core.events_dense -= all.events_dense - within.events_dense;
            core.events_sparse -= all.events_sparse - within.events_sparse;
        }
        // The tables lose what reaches no step.
        for event in moving.iter().filter(|event| left > event.wait && event.delay >= left - event.wait) {
            let core = &mut step.cores[event.core];
            *(if event.dense { &mut core.events_dense } else { &mut core.events_sparse }) -= 1;
        }
    }

    /// Learning in steps in which nothing else happens: epochs end in them, too.
    fn skip_learning(&mut self, steps: u32) {
        let Some(learning) = &mut self.learning else { return };
        let delivered = Delivered { channels: Spikes::default(), compartments: &[], values: &[] };
        for step in self.step..self.step + steps {
            if let Some(before) = step.checked_sub(1).filter(|_| !std::mem::take(&mut self.settled)) {
                learning.advance(before, delivered, &self.image, &mut self.shards, None);
            }
            learning.set_signals(Spikes::default());
            learning.learn_errors(step, delivered, &self.image, &mut self.shards, None);
        }
    }

    /// Whether nothing will change until the next input spike, except by a rule.
    pub fn at_rest(&self) -> bool {
        self.spikes.is_empty()
            && self.remote.is_empty()
            && self.shards.iter().zip(&self.image.shards).all(|(state, shard)| state.at_rest(shard))
    }

    /// Bytes of memory that the state holds, without the image.
    pub fn bytes(&self) -> usize {
        self.shards.iter().map(ShardState::bytes).sum::<usize>() + self.counts.bytes()
    }

    /// The state of a compartment's shard and its lane there; `None` where another rank has it.
    fn lane(&self, compartment: CompartmentId) -> Option<(&ShardState, usize)> {
        self.image.is_local(compartment).then(|| {
            let (shard, lane) = self.image.lane(compartment);
            (&self.shards[shard], lane)
        })
    }

    /// The registers of a compartment, zeros where another rank has it.
    fn registers(&self, compartment: CompartmentId) -> neuron::Registers {
        self.lane(compartment).map_or_else(Default::default, |(state, lane)| state.registers(lane))
    }

    /// Deliver and Update of every shard.
    fn deliver_and_update(&mut self, input: Spikes<'_>, left: u32) {
        std::mem::swap(&mut self.spikes, &mut self.carried);
        std::mem::swap(&mut self.payloads, &mut self.carried_payloads);
        match self.others {
            None => self.each_shard(Phase::Whole, input, left),
            Some(_) => self.deliver_and_update_with_others(input, left),
        }
    }

    /// Deliver and Update with other ranks; a separate function, which one process never needs.
    #[cold]
    fn deliver_and_update_with_others(&mut self, input: Spikes<'_>, left: u32) {
        // Spikes of this rank are delivered while the others are in transit.
        self.each_shard(Phase::Deliver, input, left);
        self.take_remote();
        std::mem::swap(&mut self.remote, &mut self.carried);
        std::mem::swap(&mut self.remote_payloads, &mut self.carried_payloads);
        self.each_shard(Phase::Update, Spikes::default(), left);
        self.carried.append(&mut self.remote);
        self.carried_payloads.append(&mut self.remote_payloads);
    }

    /// Waits for the other ranks' spikes of the last step.
    fn take_remote(&mut self) {
        let image = &*self.image;
        let Some(others) = &mut self.others else { return };
        if !others.take(&mut self.remote, &mut self.remote_payloads) {
            return;
        }
        if image.has_blocks {
            let all = CompartmentId(0)..CompartmentId::new(image.compartments());
            let remote = (&mut self.remote, self.remote_payloads.as_mut_slice());
            exchange::sort(remote, all, &mut self.marks, &mut self.by_id);
        }
        if !image.payloads.is_empty() && self.remote_payloads.is_empty() {
            let carried = |spike: &CompartmentId| image.payloads[image.channels as usize + spike.index()].unwrap_or(1);
            self.remote_payloads.extend(self.remote.iter().map(carried));
        }
        self.remote.iter().for_each(|spike| self.counts.remote[spike.index()] += 1);
        // They reach all remaining steps, with this one, which follows their own.
        let left = self.steps.saturating_sub(self.step);
        if left <= image.longest_delay {
            self.counts.note_late(image, self.remote.iter().map(|spike| image.channels + spike.0), left);
        }
        if !self.lost.is_empty() {
            let sources: Vec<u32> = self.remote.iter().map(|spike| image.channels + spike.0).collect();
            self.lose(&sources, left);
        }
    }

    /// A phase of every shard's step.
    #[inline(always)]
    fn each_shard(&mut self, phase: Phase, messages: Spikes<'_>, left: u32) {
        let image = &*self.image;
        let input = &StepInput {
            phase,
            step: self.step,
            remaining: left,
            arch: self.arch,
            channels: messages.ids,
            channel_values: messages.values,
            carried: &self.carried,
            carried_payloads: &self.carried_payloads,
            visit_all: self.last_events >= VISIT_ALL_FROM * image.skip_blocks as u64,
            skip: self.settings.skip,
            list_active: self.settings.per_step,
        };
        let arch = self.arch;
        let channel_counts = if image.delivery_counts_channels { self.counts.channels.as_mut_slice() } else { &mut [] };
        match (self.shards.as_mut_slice(), image.shards.as_slice()) {
            ([state], [shard]) => Step { state, image, shard, input, channel_counts }.run(arch),
            (states, shards) => states
                .par_iter_mut()
                .zip(shards)
                .for_each(|(state, shard)| Step { state, image, shard, input, channel_counts: &mut [] }.run(arch)),
        }
    }

    /// Learn(t), after Deliver(t + 1), the delivery of this step. It is a separate function, so that
    /// a step without a rule has none of its code.
    #[cold]
    fn learn(&mut self, input: Spikes<'_>, left: u32) {
        self.moving.clear();
        self.note_moving(input.ids.iter().map(|channel| channel.0), 0);
        if !self.lost.is_empty() && left <= Delay::MAX.get().into() {
            let sources: Vec<u32> = input.ids.iter().map(|channel| channel.0).collect();
            self.lose(&sources, left);
        }
        let Some(learning) = &mut self.learning else { return };
        let (compartments, values) = (self.carried.as_slice(), self.carried_payloads.as_slice());
        let delivered = Delivered { channels: input, compartments, values };
        let mut changes = self.settings.per_step.then_some(&mut self.step_changes);
        // The spikes of a step are noted once.
        if let Some(before) = self.step.checked_sub(1).filter(|_| !std::mem::take(&mut self.settled)) {
            learning.advance(before, delivered, &self.image, &mut self.shards, changes.as_deref_mut());
        }
        learning.set_signals(input);
        learning.learn_errors(self.step, delivered, &self.image, &mut self.shards, changes);
    }

    /// Exchange: the spikes of all shards in one list.
    fn exchange(&mut self) {
        let image = &*self.image;
        self.spikes.clear();
        self.payloads.clear();
        for state in &mut self.shards {
            match image.shards.len() {
                1 => std::mem::swap(&mut self.spikes, &mut state.spikes),
                _ => self.spikes.extend_from_slice(&state.spikes),
            }
            self.payloads.extend_from_slice(&state.payloads);
        }
        if let Some(from) = image.sorted_from {
            let range = from..CompartmentId::new(image.compartments());
            let spikes = (&mut self.spikes, self.payloads.as_mut_slice());
            exchange::sort(spikes, range, &mut self.marks, &mut self.by_id);
        }
        if let Some(others) = &mut self.others {
            others.post(&self.spikes, &self.payloads);
        }
    }

    /// Counts of the step.
    fn count(&mut self, channels: &[ChannelId], left: u32) {
        let image = &*self.image;
        if !image.delivery_counts_channels {
            let counts = self.counts.channels.as_mut_slice();
            for channel in channels {
                counts[channel.0 as usize] += 1;
            }
        }
        if left <= image.longest_delay {
            self.counts.note_late(image, channels.iter().map(|channel| channel.0), left);
        }
        if left <= image.longest_delay + 1 {
            let sources = self.spikes.iter().map(|spike| image.channels + spike.0);
            self.counts.note_late(image, sources, left.saturating_sub(1));
            if !self.lost.is_empty() {
                let sources: Vec<u32> = self.spikes.iter().map(|spike| image.channels + spike.0).collect();
                self.lose(&sources, left.saturating_sub(1));
            }
        }
        let image = &*self.image;
        self.last_events = 0;
        for state in &self.shards {
            self.totals.active_updates += state.active_now;
            self.last_events += state.events_now;
        }
        self.totals.spikes_in += if image.counts_inputs { channels.len() as u64 } else { 0 };
        self.totals.spikes += self.spikes.len() as u64;
        self.totals.compartment_updates += image.held as u64;
        self.totals.synaptic_events += self.last_events;
        if self.settings.per_step {
            self.last.clear();
            image.tally().add_visits(1, &mut self.last);
            for &(core, count, stated) in self.shards.iter().flat_map(|state| &state.active) {
                self.last.cores[core].add_active(count.into(), stated);
            }
            image.tally().add_step((channels, &self.spikes), left, &mut self.last);
            StepChange::apply_all(&mut self.step_changes, &mut self.last);
            let sources: Vec<u32> = match self.lost.is_empty() {
                true => Vec::new(),
                false => self.spikes.iter().map(|spike| self.image.channels + spike.0).collect(),
            };
            self.note_moving(sources.into_iter(), 1);
        }
        self.counts.steps += 1;
    }

    /// Ends a step, once the other ranks' spikes have been requested.
    fn finish_step(&mut self, left: u32) {
        let ends = left <= 1;
        if !self.others.as_ref().is_some_and(|others| others.immediately || ends) {
            return;
        }
        self.take_remote();
        let Some(others) = &self.others else { return };
        self.shown.clear();
        if let Some((first, size)) = others.observed {
            self.shown.extend_from_slice(&self.spikes);
            self.shown.extend(self.remote.iter().filter(|spike| spike.0.wrapping_sub(first.0) < size));
        }
        if self.settings.per_step {
            self.image.tally().add_remote(&self.remote, left, &mut self.last);
            StepChange::apply_all(&mut self.step_changes, &mut self.last);
            others.merge(&mut self.last);
        }
    }
}

impl Engine for Machine {
    fn channels(&self) -> u32 {
        self.image.channels
    }

    fn begin(&mut self, steps: u32) {
        self.shards.iter_mut().zip(&self.image.shards).for_each(|(state, shard)| state.clear(shard));
        self.learning.iter_mut().for_each(|learning| learning.begin(self.step));
        (self.step, self.steps, self.settled) = (0, steps, false);
        self.spikes.clear();
        self.payloads.clear();
        self.take_remote();
        self.remote.clear();
        self.last_events = 0;
        self.counts.begin(&self.image, &self.shards, self.arch);
        self.totals = Totals::default();
        self.last.clear();
    }

    // Phases of step t, on every shard:
    //
    // - Deliver(t) adds the weights of spikes to the sums of their arrival step, t + delay field.
    //   The spikes are inputs of step t and compartments' spikes of step t - 1.
    // - Update(t) updates the compartments with the sums of step t and collects their spikes.
    // - Exchange(t) puts the spikes of all shards into one list.
    // - Learn(t) records the sources of Deliver(t + 1). Plastic weights change when an epoch ends.
    //
    // Deliver(t) precedes Update(t) on the same shard; Update(t) on every shard precedes
    // Exchange(t): that is the barrier. Exchange(t) precedes Deliver(t + 1). Then follow Learn(t)
    // and Deliver(t + 2). Sums are exact and narrowed once, so neither order nor number of shards
    // and threads can change a result.
    fn step(&mut self, input: Spikes<'_>) {
        let left = self.steps.saturating_sub(self.step);
        self.deliver_and_update(input, left);
        if self.learning.is_some() {
            self.learn(input, left);
        }
        self.exchange();
        self.count(input.ids, left);
        self.step += 1;
        self.finish_step(left);
    }

    fn settle(&mut self) {
        self.take_remote();
        let Some(learning) = self.learning.as_mut().filter(|_| self.step > 0 && !self.settled) else { return };
        self.settled = true;
        let (mut compartments, mut values) = (self.spikes.clone(), self.payloads.clone());
        compartments.extend(&self.remote);
        values.extend(&self.remote_payloads);
        let delivered = Delivered { channels: Spikes::default(), compartments: &compartments, values: &values };
        learning.advance(self.step - 1, delivered, &self.image, &mut self.shards, None);
    }

    fn forget(&mut self, run: u32) {
        for (state, shard) in self.shards.iter_mut().zip(&self.image.shards) {
            state.plastic.clone_from(&shard.plastic.first);
        }
        // The steps so far belong to no sample of this run.
        self.step = 0;
        self.learning.iter_mut().for_each(|learning| learning.forget(run));
    }

    fn set_draws(&mut self, draws: &Draws) {
        self.learning.iter_mut().for_each(|learning| learning.set_draws(draws));
    }

    fn add(&mut self, added: &[Added]) {
        for &Added { compartment, to_q, to_bias } in added.iter().filter(|added| self.image.is_local(added.compartment))
        {
            let (shard, lane) = self.image.lane(compartment);
            let of_shard = &mut self.shards[shard].added;
            of_shard.resize(self.image.shards[shard].lanes, (0, 0));
            let sums = &mut of_shard[lane];
            *sums = (sums.0.wrapping_add(to_q), sums.1.wrapping_add(to_bias));
        }
    }

    fn synaptic_updates(&self) -> u64 {
        self.learning.as_ref().map_or(0, |learning| learning.updates)
    }

    fn learned(&self, rule: RuleId, column: Column) -> Vec<i32> {
        match (column, &self.learning) {
            (Column::Trace(trace), Some(learning)) => learning.traces(&self.image, rule, trace),
            (Column::Trace(_), None) => Vec::new(),
            (Column::Variable(variable), _) => self.variable(rule, variable),
        }
    }

    fn last_activity(&self) -> Option<(&StepActivity, &[MovingEvent])> {
        self.settings.per_step.then_some((&self.last, self.moving.as_slice()))
    }

    fn drop_counts(&mut self) {
        self.take_counts();
    }

    fn skip_idle(&mut self, steps: u32) -> bool {
        if !self.settings.skip {
            return false;
        }
        self.take_remote();
        // Steps that are skipped together have equal counts.
        let counted = self.learning.as_ref().filter(|_| self.settings.per_step);
        let here = self.at_rest() && counted.is_none_or(|learning| !learning.may_update(&self.image));
        if !self.others.as_ref().map_or(here, |others| others.all(here)) {
            return false;
        }
        self.shown.clear();
        self.carried.clear();
        self.skip_learning(steps);
        self.step += steps;
        self.counts.steps += u64::from(steps);
        self.totals.compartment_updates += u64::from(steps) * self.image.held as u64;
        if self.settings.per_step {
            self.last.clear();
            self.moving.clear();
            self.image.tally().add_visits(1, &mut self.last);
            if let Some(others) = &self.others {
                others.merge(&mut self.last);
            }
        }
        true
    }

    fn spikes(&self) -> &[CompartmentId] {
        match &self.others {
            Some(others) if others.observed.is_some() => &self.shown,
            _ => &self.spikes,
        }
    }

    fn payloads(&self) -> &[i32] {
        if self.image.graded { &self.payloads } else { &[] }
    }

    fn state(&self, compartment: CompartmentId, column: usize) -> i32 {
        if !self.image.is_local(compartment) {
            return 0;
        }
        let (shard, lane) = self.image.lane(compartment);
        match (self.image.has_registers(shard, compartment), column) {
            (true, 0) => self.u(compartment),
            (true, _) => self.v(compartment),
            (false, _) => self.shards[shard].word(&self.image.shards[shard], lane, column),
        }
    }

    fn u(&self, compartment: CompartmentId) -> i32 {
        self.registers(compartment).u
    }

    fn v(&self, compartment: CompartmentId) -> i32 {
        self.registers(compartment).v
    }

    fn potential(&self, compartment: CompartmentId) -> f64 {
        if !self.image.is_local(compartment) {
            return 0.0;
        }
        if self.image.has_registers(self.image.lane(compartment).0, compartment) {
            return self.v(compartment).into();
        }
        let word = self.image.neuron(compartment).kind.potential();
        word.map_or(0.0, |word| self.state(compartment, word).into())
    }

    fn v_register(&self, compartment: CompartmentId) -> i32 {
        let Some((state, lane)) = self.lane(compartment) else { return 0 };
        let registers = state.registers(lane);
        let neuron = self.image.neuron(compartment);
        neuron::voltage_register(&neuron, self.image.semantics, &registers, state.has_spiked(lane))
    }

    fn totals(&self) -> Totals {
        // Events belong to the step of their spike, and are counted when they are delivered, a step
        // later.
        let left = self.steps.saturating_sub(self.step);
        let spikes = self.spikes.iter().chain(&self.remote);
        let sources = spikes.map(|spike| self.image.channels + spike.0);
        let mut lost = 0;
        if !self.lost.is_empty() {
            self.each_lost(&sources.clone().collect::<Vec<u32>>(), left, |_, _| lost += 1);
        }
        let pending = self.image.tally().events_within(sources.clone(), left) - lost;
        let undelivered: i64 = sources.map(|source| self.image.residual.get(source)).sum();
        let residual = self.counts.sample_residual(&self.image, &self.shards, self.arch) - undelivered;
        let synaptic_events = (self.totals.synaptic_events + pending).wrapping_add_signed(residual);
        Totals { synaptic_events, ..self.totals }
    }

    fn overflow(&self) -> Overflow {
        let mut sum = Overflow::default();
        for state in &self.shards {
            sum.merge(&state.overflow);
        }
        sum
    }
}
