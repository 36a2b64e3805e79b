//! An engine that runs step by step; every run of a network uses it.
//!
//! Input: an engine over some copies of a network, and samples, or the spiking channels of each
//! step, from a robot, an environment, a notebook. Output: the outcome of a sample; the spikes of a
//! step, and registers. Stepping needs no sample length, and gives exactly the results of running
//! the sample. A session is a value: a clone continues independently from the same step, and serves
//! as a snapshot. A metered session counts what the energy of its steps needs.
//!
//! What rules change is read between steps, and weights are written. A reset keeps them,
//! [`Session::reset_all`] does not. Each clone of the session has its own.
//!
//! Integers may be added to compartments in a step: noise, for example.
//!
//! Errors: `session.channel` for channels that the network lacks, `session.added` for integers that
//! cannot be added, `session.weights.*` for weights
//! that cannot be written, `run.draws` for random numbers that do not fit the next step.

use std::sync::Arc;

use nsim_cost::MeterSettings;
use nsim_ir::activity::Overflow;
use nsim_ir::arithmetic::Semantics;
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::id::{ChannelId, CompartmentId, Id, IdVec, PopulationId, RuleId};
use nsim_ir::learning::Column;
use nsim_ir::learning::draws::{Draws, Recorded, Use};
use nsim_ir::neurons::NeuronKind;
use nsim_ir::quantised::{Quantised, Units};
use nsim_ir::spikes::{Added, Engine, Sample, Spikes};
use nsim_machine::{Image, Machine, Settings};

use crate::learning::SteppedRule;
use crate::metering::{MeteredSteps, SessionMeter};
use crate::observers::{Observer, Outputs, Recording, StepRange, integer};
use crate::outcome::{Outcome, Probe, Quantity, SampleSettings};

/// Channels that spike in a step, and the value of each.
type Input = (Vec<ChannelId>, Vec<i32>);

/// An engine between two steps.
#[derive(Debug, Clone)]
pub struct Session<E: ?Sized = Machine> {
    /// Number of copies of the network in the engine; each receives equal input on its own
    /// channels.
    copies: u32,
    rules: Arc<IdVec<RuleId, SteppedRule>>,
    /// Random numbers of learning; those that are given are of the next step.
    draws: Draws,
    /// Messages that are set for the next step.
    next: Vec<(ChannelId, i32)>,
    /// Integers that the next step adds, in all copies.
    added: Vec<Added>,
    /// Counts of the steps; `None` where they are not metered.
    meter: Option<Box<SessionMeter>>,
    steps: u32,
    /// Whether the engine has begun the sample that is stepped.
    is_begun: bool,
    /// The last step's input, of one copy.
    last_input: Input,
    /// Scratch memory: the next step's input as it is given.
    step_input: Vec<(ChannelId, i32)>,
    /// Scratch memory: the input of all copies.
    all: Input,
    engine: E,
}

impl<E: Engine> Session<E> {
    /// Returns a session before its first step, over `copies` copies of a network with equal input.
    pub fn new(engine: E, copies: u32) -> Self {
        Session {
            copies,
            rules: Arc::default(),
            draws: Draws::default(),
            next: Vec::new(),
            added: Vec::new(),
            meter: None,
            steps: 0,
            is_begun: false,
            last_input: Input::default(),
            step_input: Vec::new(),
            all: Input::default(),
            engine,
        }
    }

    /// The engine.
    pub fn into_engine(self) -> E {
        self.engine
    }
}

impl<E: Engine + ?Sized> Session<E> {
    /// Runs one sample from its first step; an observer sees the engine after each step, or after
    /// steps in which nothing happened. A later [`Self::step`] is a first step again.
    pub fn run(
        &mut self,
        sample: &Sample,
        sample_settings: &SampleSettings,
        mut observer: impl Observer<E>,
    ) -> Outcome {
        let steps = sample.steps();
        let mut probes = Recording::new(&sample_settings.probes, steps, integer::<E>);
        let mut outputs = Outputs::new(sample_settings, steps);
        let each_step = sample_settings.probes.iter().any(Probe::follows_learning);
        if self.is_begun && self.steps > 0 {
            self.engine.settle();
        }
        self.clear_input();
        self.engine.begin(steps);
        let mut step = 0;
        while step < steps && !outputs.is_over() {
            let silent = sample.at(step).is_empty() && !each_step;
            let skipped =
                if silent { outputs.skippable_steps(&mut self.engine, step, sample.next_spike(step)) } else { 0 };
            let idle = skipped > 0 && self.engine.skip_idle(skipped);
            if !idle {
                advance(&mut self.engine, sample.input(step), self.copies, &mut self.all);
            }
            let steps = if idle { skipped } else { 1 };
            let range = StepRange { first: step, steps, idle, decided: outputs.is_decided() };
            outputs.observe(&self.engine, range);
            probes.observe(&self.engine, range);
            observer.observe(&self.engine, range);
            step += steps;
        }
        self.engine.settle();
        probes.finish(&self.engine, step);
        let (totals, overflow) = (self.engine.totals(), self.engine.overflow());
        let synaptic_updates = self.engine.synaptic_updates();
        Outcome { probes: probes.values, totals, overflow, synaptic_updates, ..outputs.outcome(step) }
    }

    /// Resets the session to before the first step, as [`Self::reset`], and its plastic synapses to
    /// those of the model.
    pub fn reset_all(&mut self) {
        self.engine.forget(0);
        self.begin_anew();
    }

    /// Resets the session to before the first step, once the last one has been learned. Weights
    /// that were learned or written stay.
    ///
    /// # Errors
    /// `run.draws` without the random numbers of the last step.
    pub fn reset(&mut self) -> Result<()> {
        if self.is_begun && self.steps > 0 {
            self.check_draws()?;
            self.engine.settle();
        }
        self.begin_anew();
        Ok(())
    }

    fn begin_anew(&mut self) {
        self.clear_input();
        self.forget_draws();
        self.next.clear();
        self.added.clear();
        // The sample has no end, so every delivery is counted.
        self.engine.begin(u32::MAX);
        self.is_begun = true;
        if let Some(meter) = &mut self.meter {
            meter.clear();
            self.engine.drop_counts();
        }
    }

    /// Sets the seed of random numbers, from now on.
    pub fn set_seed(&mut self, seed: u64) {
        self.draws.seed = seed;
        self.engine.set_draws(&self.draws);
    }

    /// Sets messages of the next step, in addition to its own: the value of a signal, for example.
    ///
    /// # Errors
    /// `session.channel`.
    pub fn set_next(&mut self, input: impl IntoIterator<Item = (ChannelId, i32)>) -> Result<()> {
        self.begin();
        for (channel, value) in input {
            self.check_channel(channel)?;
            self.next.retain(|(known, _)| *known != channel);
            self.next.push((channel, value));
        }
        Ok(())
    }

    /// Messages that are set for the next step.
    pub fn next(&self) -> &[(ChannelId, i32)] {
        &self.next
    }

    fn check_channel(&self, channel: ChannelId) -> Result<()> {
        let channels = self.engine.channels() / self.copies.max(1);
        if channel.0 < channels {
            return Ok(());
        }
        let message = format!("channel {} is not one of the network's {channels}", channel.0);
        Err(Diagnostic::new("session.channel", message).help("channels are counted from 0"))
    }

    /// The number of random numbers that a rule takes in the next step, by use.
    ///
    /// # Errors
    /// `run.draws` for a rule that draws for each synapse.
    pub fn draws_needed(&self, rule: RuleId) -> Result<Vec<(Use, u64)>> {
        self.rules[rule].numbers_of_step(if self.is_begun { self.steps } else { 0 })
    }

    /// Sets the random numbers that a rule takes in the next step. From then on it takes only
    /// numbers that are set.
    ///
    /// # Errors
    /// `run.draws` for other numbers than it takes.
    pub fn set_draws(&mut self, rule: RuleId, numbers: Recorded) -> Result<()> {
        self.begin();
        self.rules[rule].check_numbers(&numbers, self.steps)?;
        let mut recorded = self.draws.recorded.as_slice().to_vec();
        recorded.resize(self.rules.len(), None);
        recorded[rule.index()] = Some(numbers);
        self.draws = Draws { recorded: Arc::new(recorded.into()), of_step: true, ..self.draws };
        self.engine.set_draws(&self.draws);
        Ok(())
    }

    /// Checks that each rule whose numbers are set has those of the next step.
    fn check_draws(&self) -> Result<()> {
        let recorded = self.draws.recorded.iter().zip(self.rules.iter());
        recorded
            .filter_map(|(numbers, rule)| Some((numbers.as_ref()?, rule)))
            .try_for_each(|(numbers, rule)| rule.check_numbers(numbers, self.steps))
    }

    /// Removes the random numbers of the last step.
    fn forget_draws(&mut self) {
        if self.draws.of_step {
            let emptied = self.draws.recorded.iter().map(|numbers| numbers.as_ref().map(|_| Recorded::new()));
            self.draws.recorded = Arc::new(emptied.collect());
            self.engine.set_draws(&self.draws);
        }
    }

    /// Forgets the input so far.
    fn clear_input(&mut self) {
        self.last_input.0.clear();
        self.last_input.1.clear();
        (self.steps, self.is_begun) = (0, false);
    }

    /// Resets the session, unless the engine has begun the sample that is stepped.
    fn begin(&mut self) {
        if !self.is_begun {
            self.begin_anew();
        }
    }

    /// Number of steps so far.
    pub fn steps(&self) -> u32 {
        self.steps
    }

    /// Runs one timestep in which these channels of each copy spike, in any order. Each has the
    /// value of its message, 1 for a plain spike. Of a channel given twice the first value counts,
    /// before one of [`Self::set_next`]; a value of 0 is no message.
    ///
    /// # Errors
    /// `session.channel`, `run.draws`; the session stays as it was.
    pub fn step(&mut self, input: impl IntoIterator<Item = (ChannelId, i32)>) -> Result<()> {
        let step_input = &mut self.step_input;
        step_input.clear();
        step_input.extend(input.into_iter().chain(self.next.iter().copied()));
        if !step_input.is_sorted_by(|a, b| a.0 < b.0) {
            step_input.sort_by_key(|(channel, _)| *channel);
            step_input.dedup_by_key(|(channel, _)| *channel);
        }
        step_input.retain(|(_, value)| *value != 0);
        if let Some(&(last, _)) = step_input.last() {
            self.check_channel(last)?;
        }
        self.check_draws()?;
        self.next.clear();
        self.begin();
        if !self.added.is_empty() {
            self.engine.add(&self.added);
            self.added.clear();
        }
        let step_input = &self.step_input;
        let (ids, values) = &mut self.last_input;
        ids.clear();
        values.clear();
        ids.extend(step_input.iter().map(|(channel, _)| channel));
        values.extend(step_input.iter().map(|(_, value)| value));
        let (ids, values) = &self.last_input;
        advance(&mut self.engine, Spikes { ids, values }, self.copies, &mut self.all);
        self.forget_draws();
        self.meter_steps(1, false);
        self.steps = self.steps.saturating_add(1);
        Ok(())
    }

    /// Runs the steps of a sample after those so far; `see` sees the session after each.
    ///
    /// # Errors
    /// As [`Self::step`]; the steps before stay.
    pub fn run_on(&mut self, sample: &Sample, mut see: impl FnMut(&Self)) -> Result<()> {
        (0..sample.steps()).try_for_each(|step| {
            let Spikes { ids, values } = sample.input(step);
            let values = values.iter().copied().chain(std::iter::repeat(1));
            self.step(ids.iter().copied().zip(values))?;
            see(self);
            Ok(())
        })
    }

    /// Counts of overflows in all copies since the last reset.
    pub fn overflow(&self) -> Overflow {
        self.engine.overflow()
    }

    /// Skips steps without input, if the engine would be idle in them, and returns true; otherwise
    /// does nothing and returns false.
    pub fn skip(&mut self, steps: u32) -> bool {
        self.begin();
        let skipped =
            self.next.is_empty() && self.added.is_empty() && !self.draws.of_step && self.engine.skip_idle(steps);
        if skipped && steps > 0 {
            self.last_input.0.clear();
            self.last_input.1.clear();
            self.meter_steps(steps, true);
            self.steps = self.steps.saturating_add(steps);
        }
        skipped
    }

    fn meter_steps(&mut self, steps: u32, idle: bool) {
        if let Some(meter) = &mut self.meter {
            meter.observe(&self.engine, StepRange { first: self.steps, steps, idle, decided: false });
        }
    }

    /// Returns the channels of one copy that spiked in the last step, ascending, with their values.
    pub fn last_input(&self) -> impl Iterator<Item = (ChannelId, i32)> {
        self.last_input.0.iter().copied().zip(self.last_input.1.iter().copied())
    }

    /// Returns the compartments that spiked in the last step, of `count` from `first` on, with
    /// their payloads. Compartments are counted from `first`, ascending.
    pub fn spikes(&self, first: CompartmentId, count: u32) -> Vec<(u32, i32)> {
        let payloads = self.engine.payloads().iter().copied().chain(std::iter::repeat(1));
        let spikes = self.engine.spikes().iter().zip(payloads);
        let mut own: Vec<(u32, i32)> = spikes
            .filter_map(|(spike, payload)| Some((spike.0.checked_sub(first.0).filter(|&i| i < count)?, payload)))
            .collect();
        own.sort_unstable();
        own
    }

    /// The engine, for its registers.
    pub fn engine(&self) -> &E {
        &self.engine
    }

    /// The engine, for its counts.
    pub fn engine_mut(&mut self) -> &mut E {
        &mut self.engine
    }
}

/// Appends an integer for each compartment of a population in the order before pruning, from those
/// of its compartments; others have 0.
pub fn append_before_pruning(
    one: &Quantised,
    id: PopulationId,
    of_compartments: impl Iterator<Item = (u32, i32)>,
    values: &mut Vec<i32>,
) {
    let start = values.len();
    values.resize(start + one.units_before_pruning(id) as usize, 0);
    for (i, value) in of_compartments {
        values[start + one.index_before_pruning(id, i) as usize] = value;
    }
}

/// Steps all copies, each with the input of one.
fn advance<E: Engine + ?Sized>(engine: &mut E, one: Spikes<'_>, copies: u32, (ids, values): &mut Input) {
    if copies == 1 {
        return engine.step(one);
    }
    ids.clear();
    values.clear();
    let channels = engine.channels() / copies.max(1);
    for first in (0..copies).map(|copy| copy * channels) {
        ids.extend(one.ids.iter().map(|channel| ChannelId(channel.0 + first)));
        values.extend(one.values);
    }
    engine.step(Spikes { ids, values });
}

impl Session {
    /// Returns a session before its first step, over `copies` copies of a network, with access to
    /// what its rules change.
    pub fn open(image: &Arc<Image>, one: &Quantised, copies: u32) -> Session {
        Session::open_metered(image, one, copies, None)
    }

    /// As [`Self::open`]; steps are metered under these settings, if any.
    pub fn open_metered(image: &Arc<Image>, one: &Quantised, copies: u32, metered: Option<MeterSettings>) -> Session {
        let rules = Arc::new(SteppedRule::all(one));
        let machine = Machine::new(image, Settings { per_step: metered.is_some(), ..Settings::default() });
        let meter = metered.map(|settings| {
            let reach = image.longest_delay() + 1;
            Box::new(SessionMeter::new(settings, image.program().output(), reach))
        });
        let mut session = Session { rules, meter, ..Session::new(machine, copies) };
        session.begin_anew();
        session
    }

    /// The steps since the last reset as a metered sample; `None` where they are not metered.
    pub fn metered(&self) -> Option<MeteredSteps> {
        Some(self.meter.as_ref()?.sample(&self.engine, self.steps))
    }

    /// Appends a probe's value of each compartment after the last step, in the order before
    /// pruning; pruned ones have 0.
    pub fn append_probe(&self, one: &Quantised, probe: &Probe, values: &mut Vec<i32>) {
        let population = one.populations().enumerate().find(|(_, population)| {
            population.first_compartment() == Some(probe.first) && population.shape.len() == probe.count
        });
        let Some((id, _)) = population else { return };
        let &Probe { quantity, first, count, .. } = probe;
        if matches!(quantity, Quantity::Spikes | Quantity::Message) {
            let spikes = self.spikes(first, count).into_iter();
            let integers = spikes.map(|(i, payload)| (i, if quantity == Quantity::Spikes { 1 } else { payload }));
            append_before_pruning(one, id, integers, values);
        } else {
            let value = |i| (i, integer(&self.engine, quantity, CompartmentId(first.0 + i)));
            append_before_pruning(one, id, (0..count).map(value), values);
        }
    }

    /// Integers that the next step adds, by name as for [`Self::add_next`], one a compartment.
    ///
    /// # Errors
    /// `session.added`.
    pub fn added_to(&self, one: &Quantised, name: &str) -> Result<Vec<i32>> {
        let (id, first, to_q) = added_place(one, name)?;
        let mut values = vec![0; one.units_before_pruning(id) as usize];
        for added in &self.added {
            let i = added.compartment.0.checked_sub(first.0).filter(|&i| i < one.populations()[id].shape.len());
            if let Some(i) = i {
                values[one.index_before_pruning(id, i) as usize] += if to_q { added.to_q } else { added.to_bias };
            }
        }
        Ok(values)
    }

    /// Adds integers to each compartment of a population of `one` in the next step, in every copy:
    /// before (2) narrows its arrivals for the name `POPULATION.q`, to u + b of (6) for
    /// `POPULATION.bias`. The values replace those set before.
    ///
    /// # Errors
    /// `session.added` for other names, kinds and arithmetics, for another number of values, and
    /// beyond 2^30.
    pub fn add_next(&mut self, one: &Quantised, name: &str, values: &[i32]) -> Result<()> {
        let (id, first, is_q) = added_place(one, name)?;
        let wrong = |message: String, help: &str| Err(Diagnostic::new("session.added", message).help(help));
        let units = one.units_before_pruning(id) as usize;
        if values.len() != units {
            let message = format!("'{name}' has {} integers for {units} compartments", values.len());
            return wrong(message, "give one for each");
        }
        if let Some(at) = values.iter().position(|value| value.unsigned_abs() > 1 << 30) {
            return wrong(format!("'{name}' adds {} to compartment {at}", values[at]), "give at most 2^30");
        }
        self.begin();
        let members = one.populations()[id].shape.len();
        let is_own = |added: &Added| {
            let place = (added.compartment.0 % one.compartments()).checked_sub(first.0);
            place.is_some_and(|place| place < members) && (added.to_q != 0) == is_q
        };
        self.added.retain(|added| !is_own(added));
        for copy in 0..self.copies {
            for i in 0..members {
                let value = values[one.index_before_pruning(id, i) as usize];
                let compartment = CompartmentId(copy * one.compartments() + first.0 + i);
                let (to_q, to_bias) = if is_q { (value, 0) } else { (0, value) };
                self.added.extend((value != 0).then_some(Added { compartment, to_q, to_bias }));
            }
        }
        Ok(())
    }

    /// The rule of this name.
    ///
    /// # Errors
    /// `session.rule`.
    pub fn rule_named(&self, name: &str) -> Result<RuleId> {
        let known = || self.rules.iter().map(|rule| rule.learning.name.as_str());
        known().position(|known| known == name).map(RuleId::new).ok_or_else(|| {
            let (message, names) = (format!("no projection '{name}' learns"), known().collect::<Vec<_>>());
            let help = match names.is_empty() {
                true => "give a projection of the model a rule: learning: Rule(..)".to_string(),
                false => format!("projections that learn are: {}", names.join(", ")),
            };
            Diagnostic::new("session.rule", message).help(help)
        })
    }

    /// Returns a column of a rule, by row: variables with which the next step delivers, and traces
    /// after the learning of the step before the last, of PES after the last one's.
    pub fn learned(&self, rule: RuleId, column: Column) -> Vec<i32> {
        self.engine.learned(rule, column)
    }

    /// Sets the weights of a rule, by row, in every copy of the network. They apply from the next
    /// step on, also to compartment spikes of the last step. Arrivals in flight over a delay keep
    /// the old weights.
    ///
    /// # Errors
    /// `session.weights.size`, `session.weights.range`; all weights stay as they were.
    pub fn write_weights(&mut self, rule: RuleId, weights: &[i32]) -> Result<()> {
        let SteppedRule { learning, synapses, weights: (low, high, step), .. } = &self.rules[rule];
        let name = &learning.name;
        if weights.len() != *synapses {
            let message = format!("{} weights for '{name}', which has {synapses} synapses", weights.len());
            return Err(Diagnostic::new("session.weights.size", message).help("give one weight for each synapse"));
        }
        if let Some(at) = weights.iter().position(|w| !(low..=high).contains(&w) || w % step != 0) {
            let message = format!("weight {} of synapse {at} of '{name}' is not in its format", weights[at]);
            let help = format!("give multiples of {step} from {low} to {high}");
            return Err(Diagnostic::new("session.weights.range", message).help(help));
        }
        self.begin();
        self.engine.write_weights(rule, weights);
        Ok(())
    }
}

/// The population and first compartment of a name POPULATION.q or POPULATION.bias, and whether it
/// is q.
fn added_place(one: &Quantised, name: &str) -> Result<(PopulationId, CompartmentId, bool)> {
    let wrong = |help: &str| Diagnostic::new("session.added", format!("'{name}' takes no integers")).help(help);
    let known = name.rsplit_once('.').filter(|(_, to)| matches!(*to, "q" | "bias"));
    let known = known.and_then(|(population, to)| Some((one.population_named(population)?, to == "q")));
    let (id, is_q) = known.ok_or_else(|| wrong("give POPULATION.q or POPULATION.bias"))?;
    let population = &one.populations()[id];
    let Units::Compartments { first, neurons, .. } = &population.units else {
        return Err(wrong("an input has no compartments"));
    };
    let takes = one.parts().semantics == Semantics::Hardware
        && !population.shape.is_empty()
        && matches!(neurons.get(0).kind, NeuronKind::Loihi | NeuronKind::If);
    if takes { Ok((id, *first, is_q)) } else { Err(wrong("Loihi and If neurons in the chip's arithmetic do")) }
}
