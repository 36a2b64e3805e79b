//! The slow, obvious interpreter of a [`Quantised`] network, with which tests compare the fast
//! machine.
//!
//! Input: a network in integers and the input spikes of each step. Output, through [`Engine`]: the
//! spikes, the registers and the counts of each step, for all three named semantics. It is written
//! from `docs/semantics.md`, `docs/loihi2.md` and `docs/learning.md` alone. It imports the plain
//! data of a network and its rules, `base::rng`, which defines random synapses, and
//! `learning::draws`; it uses no crate of the workspace but `ir`. It enumerates synapses from their
//! targets. It looks up past spikes instead of filling a delay ring. It compares the
//! steps since the last spike instead of counting refractory steps. It divides and takes remainders
//! where the machine shifts and masks.
//!
//! There are no cores, threads or skipped work. A step visits every synapse.

mod graded;
mod learning;
mod lif;
mod microcode;
mod outcome;
mod plastic;
mod resonator;
mod sigma_delta;
mod synapses;

use std::collections::{BTreeMap, VecDeque};
use std::ops::RangeInclusive;

use crate::learning::{Delivery, Learner, Numbers};
use crate::outcome::{Outcome, decay, wrap};
use crate::plastic::{Columns, Plastic};
use crate::synapses::{DelayedSum, Synapse, exponents, scaled, synapses};
use nsim_ir::activity::{Overflow, Totals};
use nsim_ir::arithmetic::{Semantics, ThresholdTest};
use nsim_ir::base::fixed::Decay;
use nsim_ir::base::id::{CompartmentId, Id, IdVec, PopulationId, ProjectionId, RuleId};
use nsim_ir::learning::draws::Draws;
use nsim_ir::learning::{Column, Variable};
use nsim_ir::microcode::MOST_WORDS;
use nsim_ir::neurons::{NeuronKind, Port, Role};
use nsim_ir::quantised::{Neuron, Quantised, Reset, SpikeSource, Units};
use nsim_ir::source_counts::OverflowCounts;
use nsim_ir::spikes::{Added, Engine, Message, Spikes};

/// Greatest delay field.
const LONGEST_DELAY: u32 = 62;
/// Greatest latency from a spike to the update that it enters, in steps: a delay, and one step
/// between compartments.
const LONGEST_LATENCY: usize = LONGEST_DELAY as usize + 1;

/// Arrivals of a compartment in a step.
#[derive(Debug, Clone, Default)]
struct Arrivals {
    /// Plain sums, by port.
    plain: [i64; 2],
    /// Separate sums, with their ports.
    separate: Vec<(Port, DelayedSum, i64)>,
    /// Number of synapses with an arriving spike.
    events: u64,
}

impl Arrivals {
    fn are_zero(&self) -> bool {
        self.plain == [0; 2] && self.separate.iter().all(|sum| sum.2 == 0)
    }

    /// Rules (19), (39) and (40): by port, the sums of weights times messages, and whether one
    /// wrapped. Each sum is shifted toward minus infinity before the addition; a separate sum may
    /// also wrap.
    fn by_port(&self, neuron: &Neuron) -> ([i64; 2], bool) {
        let mut ports = self.plain.map(|sum| (sum / 64).div_euclid(1 << neuron.shift));
        let mut wrapped = false;
        for (port, DelayedSum { separate, shift, .. }, sum) in &self.separate {
            let shifted = (sum / 64).div_euclid(1 << shift);
            let narrowed = if separate.wraps { wrap(shifted, 23) } else { shifted };
            ports[port.index()] += narrowed;
            wrapped |= narrowed != shifted;
        }
        (ports, wrapped)
    }
}

/// State of a compartment between steps.
#[derive(Debug, Clone, Copy, Default)]
struct State {
    u: i64,
    v: i64,
    /// The step of its last spike.
    spiked_at: Option<u32>,
    /// Equation (6a): the value that it pushed in its last step.
    pushed: i64,
    /// The words of a kind without u and v.
    words: [i64; 4],
    /// The words of a kind that a model file states.
    stated: [i64; MOST_WORDS],
}

#[derive(Debug, Clone)]
struct Compartment {
    neuron: Neuron,
    start_step: u32,
    /// Content of its messages.
    message: Message,
    /// Value of its last message.
    sent: i64,
    incoming: Vec<Synapse>,
    child: Option<CompartmentId>,
    state: State,
}

/// The interpreter. [`Engine::begin`] comes before the first step.
#[derive(Debug, Clone)]
pub struct Golden {
    semantics: Semantics,
    threshold: ThresholdTest,
    reset: Option<Reset>,
    compartments: IdVec<CompartmentId, Compartment>,
    /// Integers added to q and to u + b in the next step.
    added: BTreeMap<CompartmentId, (i64, i64)>,
    /// Number of steps done, which is the number of the next step.
    done: u32,
    /// Number of steps of the sample.
    steps: u32,
    /// Content of the messages of each channel.
    channel_messages: Vec<Message>,
    /// Value of each channel's spike, if it spiked; the latest step first.
    channel_history: VecDeque<Vec<Option<i64>>>,
    /// Value of each compartment's spike, if it spiked; the latest step first.
    compartment_history: VecDeque<Vec<Option<i64>>>,
    spikes: Vec<CompartmentId>,
    /// Values of these spikes, if the network has graded spikes.
    payloads: Vec<i32>,
    graded: bool,
    totals: Totals,
    overflow: Overflow,
    /// Overflows of each compartment, over all samples.
    overflows: IdVec<CompartmentId, OverflowCounts>,
    plastic: BTreeMap<ProjectionId, Plastic>,
    /// Rules by the target population of their projections, which is another one in each copy.
    learners: BTreeMap<(RuleId, PopulationId), Learner>,
    draws: Draws,
    /// Number of step 0 among the steps since learning began, the run's number in the high half.
    base: u64,
    /// Number of steps whose spikes were noted.
    noted: u32,
    synaptic_updates: u64,
}

impl Golden {
    /// An interpreter of this network, with nothing in flight.
    pub fn new(network: &Quantised) -> Golden {
        let (mut compartments, mut channel_messages) = (IdVec::new(), Vec::new());
        for population in network.populations() {
            let message = population.message;
            if let Units::Compartments { neurons, start_step, .. } = &population.units {
                for index in 0..population.shape.len() {
                    compartments.push(Compartment {
                        neuron: neurons.get(index),
                        start_step: *start_step,
                        message,
                        sent: 0,
                        incoming: Vec::new(),
                        child: None,
                        state: State::default(),
                    });
                }
            } else {
                channel_messages.extend((0..population.shape.len()).map(|_| message));
            }
        }
        for (target, synapse) in synapses(network) {
            compartments[target].incoming.push(synapse);
        }
        for (child, parent, Role::Add) in network.children() {
            compartments[parent].child = Some(child);
        }
        let parts = network.parts();
        let overflows = compartments.ids().map(|_| OverflowCounts::default()).collect();
        let (mut plastic, mut learners) = (BTreeMap::new(), BTreeMap::new());
        for (id, projection) in network.plastic() {
            let state = Plastic::new(network, projection);
            learners
                .entry(state.learner)
                .or_insert_with(|| Learner::new(network, projection))
                .join(network, projection);
            plastic.insert(id, state);
        }
        Golden {
            semantics: parts.semantics,
            threshold: parts.threshold,
            reset: parts.reset,
            compartments,
            added: BTreeMap::new(),
            done: 0,
            steps: 0,
            channel_messages,
            channel_history: VecDeque::new(),
            compartment_history: VecDeque::new(),
            spikes: Vec::new(),
            payloads: Vec::new(),
            graded: network.populations().iter().any(|population| population.message != Message::Spike),
            totals: Totals::default(),
            overflow: Overflow::default(),
            overflows,
            plastic,
            learners,
            draws: Draws::default(),
            base: 0,
            noted: 0,
            synaptic_updates: 0,
        }
    }

    /// The weights of a plastic projection, source by source.
    pub fn weights(&self, projection: ProjectionId) -> &[i16] {
        self.plastic[&projection].latest().column(Variable::Weight)
    }

    /// Sets the weights of a plastic projection, which fit its format, from the next step's
    /// deliveries on. These are inputs of that step, and spikes of compartments in the last one.
    pub fn write_weights(&mut self, projection: ProjectionId, weights: &[i16]) {
        let plastic = self.plastic.get_mut(&projection).expect("the projection is plastic");
        let Columns([_, delays, tags]) = plastic.latest().clone();
        plastic.write(self.done, Columns([weights.to_vec(), delays, tags]));
    }

    /// Contribution of a binary spike of a delivery, whose weight counts.
    fn adds(&self, synapse: &Synapse, delivery: u32) -> i64 {
        let Some((projection, number)) = synapse.plastic else { return synapse.adds };
        let plastic = &self.plastic[&projection];
        scaled(plastic.at(delivery).column(Variable::Weight)[number].into(), exponents(plastic.format).0)
    }

    /// Whether the rule of a synapse changes its delay.
    fn moves(&self, synapse: &Synapse) -> bool {
        synapse.plastic.is_some_and(|(projection, _)| self.plastic[&projection].moves)
    }

    /// The delays that a synapse may have.
    fn delays(&self, synapse: &Synapse) -> RangeInclusive<u32> {
        let own = synapse.latency - synapse.between();
        if self.moves(synapse) { 0..=LONGEST_DELAY } else { own..=own }
    }

    /// (L8): the delay of a spike of a delivery.
    fn delay(&self, synapse: &Synapse, delivery: u32) -> u32 {
        match synapse.plastic {
            Some((projection, number)) if self.moves(synapse) => {
                self.plastic[&projection].at(delivery).column(Variable::Delay)[number] as u32
            }
            _ => synapse.latency - synapse.between(),
        }
    }

    /// Number of overflows of each compartment, over all samples so far.
    pub fn overflows(&self) -> &IdVec<CompartmentId, OverflowCounts> {
        &self.overflows
    }

    /// Value of the source's spike `ago` steps before the step that is being computed, if it spiked
    /// then.
    fn carried(&self, source: SpikeSource, ago: u32) -> Option<i64> {
        let (history, index) = match source {
            SpikeSource::Channel(channel) => (&self.channel_history, channel.index()),
            SpikeSource::Compartment(compartment) => (&self.compartment_history, compartment.index()),
        };
        history.get(ago as usize)?[index]
    }

    /// Number of events of spikes in flight that arrive before the sample's end; 0 once it is over.
    fn events_in_flight(&self) -> u64 {
        if self.done >= self.steps {
            return 0;
        }
        let mut events = 0;
        for synapse in self.compartments.iter().flat_map(|compartment| &compartment.incoming) {
            // The spikes of the last step are the first row of the histories, and those of
            // compartments are delivered in the next step.
            for back in 1 - synapse.between()..=self.done.min(*self.delays(synapse).end()) {
                let arrival = self.done - back + self.delay(synapse, self.done - back);
                let arrives = self.done <= arrival && arrival < self.steps;
                let spiked = self.carried(synapse.source, back + synapse.between() - 1).is_some();
                events += u64::from(arrives && spiked);
            }
        }
        events
    }

    /// All arrivals of a compartment in this step.
    fn arrivals(&self, compartment: CompartmentId) -> Arrivals {
        let mut arrivals = Arrivals::default();
        for synapse in &self.compartments[compartment].incoming {
            for delay in self.delays(synapse) {
                let Some(payload) = self.carried(synapse.source, delay + synapse.between()) else { continue };
                let delivery = self.done - delay;
                if self.delay(synapse, delivery) != delay {
                    continue;
                }
                let adds = self.adds(synapse, delivery) * payload;
                arrivals.events += 1;
                let Some(own) = synapse.separate.map(|own| DelayedSum { delay, ..own }) else {
                    arrivals.plain[synapse.port.index()] += adds;
                    continue;
                };
                match arrivals.separate.iter_mut().find(|sum| (sum.0, sum.1) == (synapse.port, own)) {
                    Some((_, _, sum)) => *sum += adds,
                    None => arrivals.separate.push((synapse.port, own, adds)),
                }
            }
        }
        arrivals
    }

    /// What is delivered after the last step, with these inputs of the next one.
    fn delivery(&self, channels: Vec<Option<i64>>) -> Delivery {
        let compartments = self.compartment_history.front().cloned();
        let inputs = self.channel_history.front().cloned().unwrap_or_default();
        Delivery { channels, compartments: compartments.unwrap_or(vec![None; self.compartments.len()]), inputs }
    }

    /// (L12) and (L13): PES learns from the arrivals of a step, by the inputs of that step.
    fn learn_errors(&mut self, step: u32, delivery: &Delivery) {
        let numbers = Numbers { draws: &self.draws, base: self.base };
        for (key, learner) in self.learners.iter_mut().filter(|(_, learner)| learner.is_pes()) {
            learner.trace_arrivals(numbers, step, delivery);
            if learner.learns_after(step) {
                for plastic in self.plastic.values_mut().filter(|plastic| plastic.learner == *key) {
                    self.synaptic_updates += learner.learn_error(numbers, step, delivery, plastic);
                }
            }
        }
    }

    /// (L1) and (L2): notes the spikes that are delivered after the last step that was not noted,
    /// and learns.
    fn note(&mut self, delivery: &Delivery) {
        let step = self.noted;
        self.noted += 1;
        let numbers = Numbers { draws: &self.draws, base: self.base };
        for (key, learner) in self.learners.iter_mut().filter(|(_, learner)| !learner.is_pes()) {
            learner.note(numbers, step, delivery);
            if !learner.learns_after(step) {
                continue;
            }
            learner.remember(numbers, step);
            for plastic in self.plastic.values_mut().filter(|plastic| plastic.learner == *key) {
                self.synaptic_updates += learner.learn(numbers, step, plastic);
            }
            learner.clear_notes();
        }
    }

    /// Computes and counts one step of one compartment; returns whether it spikes.
    fn update(&mut self, id: CompartmentId, step: u32) -> bool {
        let arrivals = self.arrivals(id);
        let (to_q, to_bias) = self.added.remove(&id).unwrap_or_default();
        let sum = arrivals.plain[0] + to_q;
        // Compartments of lower numbers, children among them, have been updated in this step.
        let popped = self.compartments[id].child.map_or(0, |child| self.compartments[child].state.pushed) + to_bias;
        // Rule (12): arrivals after the sample's end are never looked up.
        self.totals.synaptic_events += arrivals.events;
        self.totals.compartment_updates += 1;

        let (semantics, threshold) = (self.semantics, self.threshold);
        let Compartment { neuron, start_step, state, message, sent, .. } = &mut self.compartments[id];
        // Rule (9), and in SLAYER rule (11): arrivals at a held population are lost.
        let start = if semantics == Semantics::Slayer { (*start_step).max(1) } else { *start_step };
        if step < start {
            *state = first(neuron);
            return false;
        }
        // Rule (10).
        if self.reset.is_some_and(|reset| resets(reset, *start_step, step)) {
            *state = first(neuron);
        }
        // Rule (13), on the state before the neuron's own reset (30).
        let at_rest = match neuron.kind.table().registers {
            true => {
                state.u == 0
                    && state.v == 0
                    && !is_refractory(semantics, neuron, state, step)
                    && bias(semantics, neuron) == 0
                    && sum == 0
                    && popped == 0
            }
            false => arrivals.are_zero() && is_idle(neuron, state),
        };
        self.totals.active_updates += u64::from(!at_rest);

        // Equation (30).
        if neuron.kind == NeuronKind::LifReset && lif::resets(&neuron.row, step) {
            state.words = [0; 4];
        }
        let mut outcome = match (neuron.kind, semantics) {
            (NeuronKind::SoftReset, _) => soft_reset(neuron, threshold, state, sum),
            (NeuronKind::If, _) => integrate_and_fire(neuron, threshold, state, (sum, popped), step),
            (NeuronKind::Loihi, Semantics::Hardware) => hardware(neuron, threshold, state, (sum, popped), step),
            (NeuronKind::Loihi, Semantics::Lava) => lava(neuron, threshold, state, sum, step),
            (NeuronKind::Loihi, Semantics::Slayer) => slayer(neuron, threshold, state, sum, step),
            _ => in_words(neuron, state, arrivals.by_port(neuron)),
        };
        // A value that exceeds the bits of its population's messages is sent, and reported.
        if let (Some(value), Message::Value(bits)) = (outcome.value, *message) {
            outcome.u_wrapped |= wrap(value, u32::from(bits.get()) - 1) != value;
        }
        *sent = match *message {
            Message::Spike => 1,
            Message::Payload(payload) => payload.get().into(),
            Message::Value(_) => outcome.value.unwrap_or(0),
        };
        // Rule (14).
        self.overflow.q_wrapped += u64::from(outcome.q_wrapped);
        self.overflow.u_wrapped += u64::from(outcome.u_wrapped);
        self.overflow.v_clipped += u64::from(outcome.v_clipped);
        if outcome.q_wrapped || outcome.u_wrapped || outcome.v_clipped {
            // Steps and compartments ascend, so the first one found is the earliest.
            self.overflow.first.get_or_insert((step, id));
        }
        self.overflows[id].wrapped += u64::from(outcome.q_wrapped) + u64::from(outcome.u_wrapped);
        self.overflows[id].clipped += u64::from(outcome.v_clipped);
        self.overflows[id].cut += u64::from(outcome.v_clipped && self.compartments[id].state.v > 0);
        outcome.spiked
    }
}

impl Engine for Golden {
    fn channels(&self) -> u32 {
        self.channel_messages.len() as u32
    }

    fn begin(&mut self, steps: u32) {
        self.base += u64::from(self.done);
        self.steps = steps;
        for compartment in self.compartments.iter_mut() {
            compartment.state = first(&compartment.neuron);
        }
        self.done = 0;
        self.added.clear();
        self.channel_history.clear();
        self.compartment_history.clear();
        self.spikes.clear();
        self.payloads.clear();
        self.totals = Totals::default();
        self.overflow = Overflow::default();
        self.plastic.values_mut().for_each(Plastic::begin);
        self.learners.values_mut().for_each(Learner::begin);
        self.noted = 0;
        self.synaptic_updates = 0;
    }

    fn forget(&mut self, run: u32) {
        self.plastic.values_mut().for_each(Plastic::forget);
        self.base = u64::from(run) << 32;
        self.done = 0;
    }

    fn set_draws(&mut self, draws: &Draws) {
        self.draws = draws.clone();
    }

    fn learned(&self, rule: RuleId, column: Column) -> Vec<i32> {
        // The first copy has the least target population.
        let Some((key, learner)) = self.learners.iter().find(|((id, _), _)| *id == rule) else { return Vec::new() };
        let variable = match column {
            Column::Trace(trace) => return learner.traces(trace),
            Column::Variable(variable) => variable,
        };
        let mut by_row = BTreeMap::new();
        for plastic in self.plastic.values().filter(|plastic| plastic.learner == *key) {
            let values = plastic.latest().column(variable).iter().map(|&value| i32::from(value));
            by_row.extend(plastic.rows.iter().copied().zip(values));
        }
        by_row.into_values().collect()
    }

    fn synaptic_updates(&self) -> u64 {
        self.synaptic_updates
    }

    fn settle(&mut self) {
        if self.noted < self.done {
            let none = vec![None; self.channel_messages.len()];
            let delivery = self.delivery(none);
            self.note(&delivery);
        }
    }

    fn add(&mut self, added: &[Added]) {
        for &Added { compartment, to_q, to_bias } in added {
            let sums = self.added.entry(compartment).or_default();
            *sums = (sums.0 + i64::from(to_q), sums.1 + i64::from(to_bias));
        }
    }

    fn step(&mut self, input: Spikes<'_>) {
        let step = self.done;
        self.totals.spikes_in += input.ids.len() as u64;
        let mut inputs = vec![None; self.channel_messages.len()];
        for (place, &channel) in input.ids.iter().enumerate() {
            inputs[channel.index()] = Some(match self.channel_messages[channel.index()] {
                Message::Spike => 1,
                Message::Payload(payload) => payload.get().into(),
                Message::Value(_) => input.values.get(place).map_or(1, |&value| value.into()),
            });
        }
        let delivery = self.delivery(inputs.clone());
        self.channel_history.push_front(inputs);
        // This step's own row is not read: a compartment's spike arrives a step later at the
        // earliest.
        self.compartment_history.push_front(vec![None; self.compartments.len()]);
        self.channel_history.truncate(LONGEST_LATENCY + 1);
        self.compartment_history.truncate(LONGEST_LATENCY + 1);

        let spikes: Vec<CompartmentId> = self.compartments.ids().filter(|&id| self.update(id, step)).collect();
        for &id in &spikes {
            self.compartment_history[0][id.index()] = Some(self.compartments[id].sent);
        }
        self.totals.spikes += spikes.len() as u64;
        let carried = spikes.iter().filter(|_| self.graded).map(|&id| narrow(self.compartments[id].sent));
        self.payloads = carried.collect();
        self.spikes = spikes;
        self.done += 1;
        // Its weights are those of the arrivals that were just added.
        if self.noted < step {
            self.note(&delivery);
        }
        self.learn_errors(step, &delivery);
    }

    fn spikes(&self) -> &[CompartmentId] {
        &self.spikes
    }

    fn payloads(&self) -> &[i32] {
        &self.payloads
    }

    fn state(&self, compartment: CompartmentId, column: usize) -> i32 {
        let Compartment { neuron, state, .. } = &self.compartments[compartment];
        narrow(match (neuron.kind.table().registers, column) {
            (true, 0) => state.u,
            (true, _) => state.v,
            (false, _) if matches!(neuron.kind, NeuronKind::Microcode(_)) => state.stated[column],
            (false, _) => state.words[column],
        })
    }

    fn u(&self, compartment: CompartmentId) -> i32 {
        narrow(self.compartments[compartment].state.u)
    }

    fn v(&self, compartment: CompartmentId) -> i32 {
        narrow(self.compartments[compartment].state.v)
    }

    fn potential(&self, compartment: CompartmentId) -> f64 {
        let word = self.compartments[compartment].neuron.kind.potential();
        word.map_or(0.0, |word| self.state(compartment, word).into())
    }

    fn v_register(&self, compartment: CompartmentId) -> i32 {
        // Equation (8).
        let Compartment { neuron, state, .. } = &self.compartments[compartment];
        let Some(age) = state.spiked_at.map(|at| self.done - 1 - at) else {
            return narrow(state.v);
        };
        match self.semantics {
            _ if neuron.kind == NeuronKind::SoftReset => narrow(state.v),
            Semantics::Hardware if age < period(neuron) => narrow(i64::from(period(neuron)) * 128 + i64::from(age)),
            Semantics::Slayer if age == 0 => i32::from(neuron.dv.get()),
            _ => narrow(state.v),
        }
    }

    fn totals(&self) -> Totals {
        // Rule (12): an event counts with the spike that causes it, if the sample is long enough
        // for it to arrive.
        let synaptic_events = self.totals.synaptic_events + self.events_in_flight();
        Totals { synaptic_events, ..self.totals }
    }

    fn overflow(&self) -> Overflow {
        self.overflow
    }
}

/// A register in 32 bits, which it fits.
fn narrow(x: i64) -> i32 {
    i32::try_from(x).expect("every semantics keeps its registers within 32 bits")
}

// Equations (2) to (7), each as `docs/semantics.md` writes it.

/// Equation (5). SLAYER's compartments have no bias.
fn bias(semantics: Semantics, neuron: &Neuron) -> i64 {
    match semantics {
        Semantics::Hardware | Semantics::Lava => i64::from(neuron.bias_mant.get()) * (1 << neuron.bias_exp.get()),
        Semantics::Slayer => 0,
    }
}

/// Rule (10): whether a population with this start step returns to zero before the update of
/// `step`.
fn resets(reset: Reset, start_step: u32, step: u32) -> bool {
    let since = i64::from(step) - i64::from(start_step) - i64::from(reset.offset);
    since >= 0 && since % i64::from(reset.interval) == 0
}

/// The comparison of equation (7).
fn above(threshold: ThresholdTest, v: i64, neuron: &Neuron) -> bool {
    let limit = 64 * i64::from(neuron.vth.get());
    match threshold {
        ThresholdTest::Strict => v > limit,
        ThresholdTest::Inclusive => v >= limit,
    }
}

/// Effective refractory period in hardware: 0 behaves as 1.
fn period(neuron: &Neuron) -> u32 {
    u32::from(neuron.refractory.get()).max(1)
}

/// Equation (7): whether v is held in this step.
fn is_refractory(semantics: Semantics, neuron: &Neuron, state: &State, step: u32) -> bool {
    let Some(spiked_at) = state.spiked_at else { return false };
    match semantics {
        Semantics::Hardware => step - spiked_at < period(neuron),
        Semantics::Lava => false,
        // A period of 0 silences the compartment after its first spike.
        Semantics::Slayer => neuron.refractory.get() == 0 || step - spiked_at < u32::from(neuron.refractory.get()),
    }
}

/// Equation (7): the membrane after the step, from the voltage of (6); whether it spiked.
fn fire(
    semantics: Semantics,
    neuron: &Neuron,
    threshold: ThresholdTest,
    state: &mut State,
    voltage: i64,
    step: u32,
) -> bool {
    let refractory = is_refractory(semantics, neuron, state, step);
    let spiked = !refractory && above(threshold, voltage, neuron);
    if spiked {
        state.spiked_at = Some(step);
    }
    state.v = if spiked || refractory { 0 } else { voltage };
    spiked
}

/// Equations (2) to (6) in the chip's arithmetic, with the value of a child: the voltage before the
/// threshold test, and the overflows.
fn integrate(neuron: &Neuron, state: &mut State, sum: i64, popped: i64) -> (i64, Outcome) {
    // Equation (2).
    let q = wrap(sum, 21);
    // Equation (4).
    let current = decay(state.u, neuron.du.get()) + q;
    state.u = wrap(current, 23);
    // Equations (5), (6) and (6a).
    let biased = state.u + popped + bias(Semantics::Hardware, neuron);
    let voltage = decay(state.v, neuron.dv.get()) + wrap(biased, 23);
    let vmin = 1 - (1i64 << neuron.vmin.get());
    let vmax = (1i64 << (9 + 2 * neuron.vmax.get())) - 1;
    let clipped = voltage.clamp(vmin, vmax);
    let outcome = Outcome {
        q_wrapped: q != sum,
        u_wrapped: state.u != current || wrap(biased, 23) != biased,
        v_clipped: clipped != voltage,
        ..Outcome::default()
    };
    (clipped, outcome)
}

/// A step in the chip's arithmetic; `input` is the sum of arrivals and the value of a child.
fn hardware(neuron: &Neuron, threshold: ThresholdTest, state: &mut State, input: (i64, i64), step: u32) -> Outcome {
    let (voltage, outcome) = integrate(neuron, state, input.0, input.1);
    state.pushed = voltage;
    // A held voltage is not clipped.
    let v_clipped = outcome.v_clipped && !is_refractory(Semantics::Hardware, neuron, state, step);
    Outcome { spiked: fire(Semantics::Hardware, neuron, threshold, state, voltage, step), v_clipped, ..outcome }
}

/// A step of an integrate-and-fire compartment: equations (2) to (7) with du = 4096 and dv = 0.
fn integrate_and_fire(
    neuron: &Neuron,
    threshold: ThresholdTest,
    state: &mut State,
    input: (i64, i64),
    step: u32,
) -> Outcome {
    hardware(&Neuron { du: Decay::MAX, dv: Decay::MIN, ..*neuron }, threshold, state, input, step)
}

/// A step of a compartment with reset by subtraction: equations (2) to (6), and (7a) in place of
/// (7).
fn soft_reset(neuron: &Neuron, threshold: ThresholdTest, state: &mut State, sum: i64) -> Outcome {
    let (voltage, outcome) = integrate(neuron, state, sum, 0);
    let spiked = above(threshold, voltage, neuron);
    state.v = if spiked { voltage - 64 * i64::from(neuron.vth.get()) } else { voltage };
    Outcome { spiked, ..outcome }
}

/// A step of lava's fixed-point LIF process (lava-nc b6822fb, `proc/lif/models.py`).
fn lava(neuron: &Neuron, threshold: ThresholdTest, state: &mut State, sum: i64, step: u32) -> Outcome {
    const HALF: i64 = 1 << 23;
    // Rule (11): a negative exponent shifts the sum of a step, not each weight.
    let arrived = 64 * (sum / 64).div_euclid(1 << neuron.shift);
    // The process computes in arrays of 32 bits.
    let current = wrap(decay(state.u, neuron.du.get()) + wrap(arrived, 31), 31);
    state.u = if current > HALF {
        current - 2 * HALF
    } else if current <= -HALF {
        current + 2 * HALF
    } else {
        current
    };
    let voltage = wrap(decay(state.v, neuron.dv.get()) + state.u + bias(Semantics::Lava, neuron), 31);
    let clipped = voltage.clamp(1 - HALF, HALF - 1);
    Outcome {
        spiked: fire(Semantics::Lava, neuron, threshold, state, clipped, step),
        u_wrapped: state.u != current,
        v_clipped: clipped != voltage,
        ..Outcome::default()
    }
}

/// A step of SLAYER's Loihi kernel (slayerPytorch 01beeeb, `src/cuda/spikeLoihiKernels.h`).
fn slayer(neuron: &Neuron, threshold: ThresholdTest, state: &mut State, sum: i64, step: u32) -> Outcome {
    // Rule (11): the product keeps its low 32 bits.
    fn decay(x: i64, d: Decay) -> i64 {
        let decayed = (x.abs() * (4096 - i64::from(d.get()))) % (1 << 32) / 4096;
        if x < 0 { -decayed } else { decayed }
    }
    state.u = wrap(decay(state.u, neuron.du) + sum, 31);
    let voltage = wrap(decay(state.v, neuron.dv) + state.u, 31);
    Outcome { spiked: fire(Semantics::Slayer, neuron, threshold, state, voltage, step), ..Outcome::default() }
}

/// A step of a kind without u and v.
fn in_words(neuron: &Neuron, State { words, stated, .. }: &mut State, (sums, wrapped): ([i64; 2], bool)) -> Outcome {
    // Rule (19): sums have 32 bits.
    let arrived = sums.map(|sum| wrap(sum, 31));
    let outcome = match neuron.kind {
        NeuronKind::SigmaDelta => sigma_delta::sigma_delta(&neuron.row, words, arrived[0]),
        NeuronKind::Delta => sigma_delta::delta(&neuron.row, words, arrived[0]),
        NeuronKind::Sigma => sigma_delta::sigma(words, arrived[0]),
        NeuronKind::Rf => resonator::step(&neuron.row, words, arrived, false),
        NeuronKind::RfIz => resonator::step(&neuron.row, words, arrived, true),
        NeuronKind::TernaryLif => lif::ternary(&neuron.row, words, arrived[0]),
        NeuronKind::LifReset => lif::resetting(&neuron.row, words, arrived[0]),
        NeuronKind::GradedLif => lif::graded(&neuron.row, words, arrived[0]),
        NeuronKind::AtrLif => lif::adaptive_lava(&neuron.row, words, arrived[0]),
        NeuronKind::Alif => lif::adaptive_lava_dl(&neuron.row, words, arrived[0]),
        NeuronKind::Adrf => resonator::adaptive(&neuron.row, words, arrived, false),
        NeuronKind::AdrfIz => resonator::adaptive(&neuron.row, words, arrived, true),
        NeuronKind::RfZero => resonator::zero(&neuron.row, words, arrived),
        NeuronKind::GradedVec => graded::vector(&neuron.row, arrived[0], false),
        NeuronKind::GradedReluVec => graded::vector(&neuron.row, arrived[0], true),
        NeuronKind::ProdNeuron => graded::product(&neuron.row, arrived),
        NeuronKind::NormVecDelay => graded::delayed_product(&neuron.row, words, arrived),
        NeuronKind::NormSquare => graded::square(arrived[0]),
        NeuronKind::InvSqrt => graded::inverse_root(arrived[0]),
        NeuronKind::Microcode(kind) => microcode::step(kind.code(), &neuron.row, stated, arrived),
        NeuronKind::Loihi | NeuronKind::If | NeuronKind::SoftReset => unreachable!("they have u and v"),
    };
    Outcome { q_wrapped: wrapped || arrived != sums, ..outcome }
}

/// The state of a compartment before its first step.
fn first(neuron: &Neuron) -> State {
    let words = match neuron.kind {
        // Equation (32).
        NeuronKind::AtrLif | NeuronKind::Alif | NeuronKind::Adrf | NeuronKind::AdrfIz => {
            [0, 0, neuron.parameter("threshold"), 0]
        }
        _ => [0; 4],
    };
    State { words, ..State::default() }
}

/// Rule (13) for a kind without u and v. A step without arrivals would change nothing, send nothing
/// and report nothing, also after the neuron's own reset.
fn is_idle(neuron: &Neuron, state: &State) -> bool {
    let idle_after = |mut after: State| {
        let Outcome { spiked, u_wrapped, v_clipped, .. } = in_words(neuron, &mut after, ([0; 2], false));
        !spiked && (after.words, after.stated) == (state.words, state.stated) && !u_wrapped && !v_clipped
    };
    idle_after(*state) && (neuron.kind != NeuronKind::LifReset || idle_after(State { words: [0; 4], ..*state }))
}
