//! An engine that runs step by step; every run of a network uses it.
//!
//! Input: an engine over some copies of a network, and samples, or the spiking channels of each
//! step, from a robot, an environment, a notebook. Output: the outcome of a sample; the spikes of a
//! step, and registers. Stepping needs no sample length, and gives exactly the results of running
//! the sample. A session is a value: a clone continues independently from the same step, and serves
//! as a snapshot. The input of steps is stored, so that the steps so far can be priced as a sample.
//!
//! Weights of plastic projections are read and written between steps, or a rule changes them. A
//! reset keeps them, [`Session::reset_all`] does not. Each clone of the session has its own weights.
//!
//! Errors: `session.channel` for channels that the network lacks, `session.too-long` for more input
//! than is stored, `session.weights.*` for weights that cannot be written or would be lost,
//! `session.rule.*` for rules that cannot act.

use std::sync::Arc;

use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::id::{ChannelId, CompartmentId, ProjectionId};
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::{Engine, Sample, Spikes};
use nsim_machine::plastic::places::PlasticProjection;
use nsim_machine::{Image, Machine, Settings};

use crate::learning;
use crate::observers::{Observer, Outputs, Recording, StepRange, integer};
use crate::outcome::{Outcome, Probe, SampleSettings};

/// Maximum number of stored input spikes, 12 bytes each; later ones only reach the engine.
const MOST_STORED: usize = 1 << 26;

/// The remedy where a network has no plastic projection.
const MAKE_PLASTIC: &str = "give a projection of the model a rule: learning: Rule(..)";

/// Channels that spike in a step, and the value of each.
type Input = (Vec<ChannelId>, Vec<i32>);

/// An engine between two steps, with its stored input.
#[derive(Debug, Clone)]
pub struct Session<E: ?Sized = Machine> {
    /// Number of copies of the network in the engine; each receives equal input on its own
    /// channels.
    copies: u32,
    plastic: Arc<[PlasticProjection]>,
    /// Whether the network has rules.
    learns: bool,
    /// Whether weights were written, or learned before the last reset.
    is_written: bool,
    /// Input spikes of one copy: (step, channel, value).
    stored_input: Vec<(u32, ChannelId, i32)>,
    steps: u32,
    /// Whether the engine has begun the sample that is stepped.
    is_begun: bool,
    /// Whether an input spike was not stored.
    is_truncated: bool,
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
            plastic: Arc::new([]),
            learns: false,
            is_written: false,
            stored_input: Vec::new(),
            steps: 0,
            is_begun: false,
            is_truncated: false,
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
        self.is_written = false;
        self.reset();
    }

    /// Resets the session to before the first step. Weights that were learned or written stay.
    pub fn reset(&mut self) {
        self.is_written |= self.learns && self.steps > 0;
        self.clear_input();
        // The sample has no end, so every delivery is counted.
        self.engine.begin(u32::MAX);
        self.is_begun = true;
    }

    /// Forgets the input so far.
    fn clear_input(&mut self) {
        self.stored_input.clear();
        self.last_input.0.clear();
        self.last_input.1.clear();
        (self.steps, self.is_begun, self.is_truncated) = (0, false, false);
    }

    /// Resets the session, unless the engine has begun the sample that is stepped.
    fn begin(&mut self) {
        if !self.is_begun {
            self.reset();
        }
    }

    /// Number of steps so far.
    pub fn steps(&self) -> u32 {
        self.steps
    }

    /// Runs one timestep in which these channels of each copy spike, in any order. Each has the
    /// value of its message, 1 for a plain spike. Of a channel given twice the first value counts;
    /// a value of 0 is no message.
    ///
    /// # Errors
    /// `session.channel`; the session stays as it was.
    pub fn step(&mut self, input: impl IntoIterator<Item = (ChannelId, i32)>) -> Result<()> {
        let step_input = &mut self.step_input;
        step_input.clear();
        step_input.extend(input.into_iter().filter(|(_, value)| *value != 0));
        if !step_input.is_sorted_by(|a, b| a.0 < b.0) {
            step_input.sort_by_key(|(channel, _)| *channel);
            step_input.dedup_by_key(|(channel, _)| *channel);
        }
        let channels = self.engine.channels() / self.copies.max(1);
        if let Some((last, _)) = step_input.last().filter(|(last, _)| last.0 >= channels) {
            let message = format!("channel {} is not one of the network's {channels}", last.0);
            return Err(Diagnostic::new("session.channel", message).help("channels are counted from 0"));
        }
        self.begin();
        let step_input = &self.step_input;
        self.is_truncated |= self.stored_input.len() + step_input.len() > MOST_STORED || self.steps == u32::MAX - 1;
        if !self.is_truncated {
            self.stored_input.extend(step_input.iter().map(|&(channel, value)| (self.steps, channel, value)));
        }
        let (ids, values) = &mut self.last_input;
        ids.clear();
        values.clear();
        ids.extend(step_input.iter().map(|(channel, _)| channel));
        values.extend(step_input.iter().map(|(_, value)| value));
        let (ids, values) = &self.last_input;
        advance(&mut self.engine, Spikes { ids, values }, self.copies, &mut self.all);
        self.steps = self.steps.saturating_add(1);
        Ok(())
    }

    /// Skips steps without input, if the engine would be idle in them, and returns true; otherwise
    /// does nothing and returns false.
    pub fn skip(&mut self, steps: u32) -> bool {
        self.begin();
        let skipped = self.engine.skip_idle(steps);
        if skipped && steps > 0 {
            self.last_input.0.clear();
            self.last_input.1.clear();
            self.steps = self.steps.saturating_add(steps);
        }
        skipped
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
    /// its plastic weights.
    pub fn open(image: &Arc<Image>, one: &Quantised, copies: u32) -> Session {
        let plastic = PlasticProjection::all(image, one, copies).into();
        let machine = Machine::new(image, Settings::default());
        let learns = learning::learns(&one.parts().rules);
        let mut session = Session { plastic, learns, ..Session::new(machine, copies) };
        session.reset();
        session
    }

    /// Returns the weights of a plastic projection, source by source, in the order of its synapses.
    /// After the last step of a learning epoch, they include the changes of that epoch.
    ///
    /// # Errors
    /// `session.weights.not-plastic`.
    pub fn weights(&self, projection: ProjectionId) -> Result<Vec<i16>> {
        Ok(self.plastic(projection)?.places[0].iter().map(|&place| self.engine.weight(place)).collect())
    }

    /// Sets the weights of a plastic projection, in every copy of the network. They apply from the
    /// next step on, also to compartment spikes of the last step. Arrivals in flight over a delay
    /// keep the old weights.
    ///
    /// # Errors
    /// `session.weights.not-plastic`, `session.weights.size`, `session.weights.range`; all weights
    /// stay as they were.
    pub fn write_weights(&mut self, projection: ProjectionId, weights: &[i16]) -> Result<()> {
        let PlasticProjection { name, format, places, .. } = self.plastic(projection)?;
        if weights.len() != places[0].len() {
            let message = format!("{} weights for {name}, which has {} synapses", weights.len(), places[0].len());
            return Err(Diagnostic::new("session.weights.size", message).help("give one weight for each synapse"));
        }
        let ((low, high), step) = (format.sign.range(format.bits), format.sign.step(format.bits));
        if let Some(at) = weights.iter().position(|w| !(low..=high).contains(w) || w % step != 0) {
            let message = format!("weight {} of synapse {at} of {name} is not in its format", weights[at]);
            let help = format!("give multiples of {step} from {low} to {high}");
            return Err(Diagnostic::new("session.weights.range", message).help(help));
        }
        self.begin();
        let (plastic, machine) = (Arc::clone(&self.plastic), &mut self.engine);
        for copy in plastic.iter().filter(|plastic| plastic.id == projection).flat_map(|plastic| &plastic.places) {
            copy.iter().zip(weights).for_each(|(&place, &weight)| machine.set_weight(place, weight));
        }
        self.is_written = true;
        Ok(())
    }

    fn plastic(&self, projection: ProjectionId) -> Result<&PlasticProjection> {
        self.plastic.iter().find(|plastic| plastic.id == projection).ok_or_else(|| {
            let names: Vec<String> = self.plastic.iter().map(|own| format!("{} ({})", own.id, own.name)).collect();
            let names = if names.is_empty() { "none".to_string() } else { names.join(", ") };
            let message = format!("{projection} is not a plastic projection; plastic projections are: {names}");
            Diagnostic::new("session.weights.not-plastic", message).help(MAKE_PLASTIC)
        })
    }

    /// Returns the input so far, as a sample with as many steps.
    ///
    /// # Errors
    /// `session.too-long`; `session.weights.written` when a run of the sample would not have the
    /// weights that were written.
    pub fn sample(&self) -> Result<Sample> {
        if self.is_written {
            let message =
                "weights were written or learned, so a run of the same input would not reproduce them".to_string();
            let help = "reset the learned weights too, and step without writing weights";
            return Err(Diagnostic::new("session.weights.written", message).help(help));
        }
        let too_long = || {
            let message = format!("a session stores at most {MOST_STORED} input spikes, but more were given");
            Diagnostic::new("session.too-long", message).help("call reset() at the end of each trial")
        };
        if self.is_truncated {
            return Err(too_long());
        }
        Sample::with_values(self.steps, &self.stored_input, None).map_err(|_| too_long())
    }
}
