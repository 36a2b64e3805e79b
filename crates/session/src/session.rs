//! An engine that runs step by step; every run of a network uses it.
//!
//! Input: an engine over some copies of a network, and samples, or the spiking channels of each
//! step, from a robot, an environment, a notebook. Output: the outcome of a sample; the spikes of a
//! step, and registers. Stepping needs no sample length, and gives exactly the results of running
//! the sample. A session is a value: a clone continues independently from the same step, and serves
//! as a snapshot. The input of steps is stored, so that the steps so far can be priced as a sample.
//!
//! Weights of plastic projections are read and written between steps, or a rule changes them. Each
//! clone of the session has its own weights.
//!
//! Errors: `session.channel` for channels that the network lacks, `session.too-long` for more input
//! than is stored, `session.weights.*` for weights that cannot be written or would be lost,
//! `session.rule.*` for rules that cannot act.

use std::sync::Arc;

use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::id::{ChannelId, CompartmentId, ProjectionId};
use nsim_ir::learning::{LONGEST_EPOCH, LearningRule};
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::{Copies, Engine, Sample, Spikes};
use nsim_machine::plastic::places::PlasticProjection;
use nsim_machine::{Image, Machine, Settings};

/// Input spikes that are stored, 12 bytes each; later ones are counted only.
const MOST_KEPT: usize = 1 << 26;

/// The remedy where a network has no plastic projection.
const MAKE_PLASTIC: &str = "set `format.plastic` of a projection before the network is mapped";

/// An engine after some step.
#[derive(Debug, Clone)]
pub struct Session {
    machine: Machine,
    copies: Copies,
    plastic: Arc<[PlasticProjection]>,
    /// Whether weights were written.
    is_written: bool,
    /// Input spikes of one copy: (step, channel, value).
    kept: Vec<(u32, ChannelId, i32)>,
    steps: u32,
    /// Whether an input spike was not stored.
    is_cut: bool,
    /// The last step's input, of one copy.
    shown: Vec<(ChannelId, i32)>,
    /// Scratch memory: the next step's input, until it is the last's.
    given: Vec<(ChannelId, i32)>,
    /// Scratch memory: the input of all copies.
    all: (Vec<ChannelId>, Vec<i32>),
}

impl Session {
    /// A session before its first step, over `copies` of a network with the same input.
    pub fn open(image: &Arc<Image>, one: &Quantised, copies: u32) -> Session {
        let mut session = Session {
            machine: Machine::new(image, Settings::default()),
            copies: Copies { copies, channels: one.channels() },
            plastic: PlasticProjection::all(image, one, copies).into(),
            is_written: false,
            kept: Vec::new(),
            steps: 0,
            is_cut: false,
            shown: Vec::new(),
            given: Vec::new(),
            all: (Vec::new(), Vec::new()),
        };
        session.reset();
        session
    }

    /// Goes back to before the first step, as a sample's end does; weights too.
    pub fn reset(&mut self) {
        // A sample without end: every delivery is counted.
        self.machine.begin(u32::MAX);
        self.kept.clear();
        self.shown.clear();
        (self.steps, self.is_cut, self.is_written) = (0, false, self.machine.learns());
    }

    /// Steps so far.
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
        let given = &mut self.given;
        given.clear();
        given.extend(input.into_iter().filter(|(_, value)| *value != 0));
        if !given.is_sorted_by(|a, b| a.0 < b.0) {
            given.sort_by_key(|(channel, _)| *channel);
            given.dedup_by_key(|(channel, _)| *channel);
        }
        let Copies { copies, channels } = self.copies;
        if let Some((last, _)) = given.last().filter(|(last, _)| last.0 >= channels) {
            let message = format!("channel {} is not one of the network's {channels}", last.0);
            return Err(Diagnostic::new("session.channel", message).help("channels are counted from 0"));
        }
        std::mem::swap(&mut self.shown, given);
        self.is_cut |= self.kept.len() + self.shown.len() > MOST_KEPT || self.steps == u32::MAX - 1;
        if !self.is_cut {
            self.kept.extend(self.shown.iter().map(|&(channel, value)| (self.steps, channel, value)));
        }
        let (ids, values) = &mut self.all;
        ids.clear();
        values.clear();
        for first in (0..copies).map(|copy| copy * channels) {
            ids.extend(self.shown.iter().map(|(channel, _)| ChannelId(channel.0 + first)));
            values.extend(self.shown.iter().map(|(_, value)| value));
        }
        self.machine.step(Spikes { ids, values });
        self.steps = self.steps.saturating_add(1);
        Ok(())
    }

    /// Skips steps without input, if the engine would be idle in them, and returns true; otherwise
    /// does nothing and returns false.
    pub fn skip(&mut self, steps: u32) -> bool {
        let rests = self.machine.rest(steps);
        if rests && steps > 0 {
            self.shown.clear();
            self.steps = self.steps.saturating_add(steps);
        }
        rests
    }

    /// The channels of one copy that spiked in the last step, ascending, with what they carried.
    pub fn shown(&self) -> &[(ChannelId, i32)] {
        &self.shown
    }

    /// Returns the compartments that spiked in the last step, of `count` from `first` on, with
    /// their payloads. Compartments are counted from `first`, ascending.
    pub fn spikes(&self, first: CompartmentId, count: u32) -> Vec<(u32, i32)> {
        let payloads = self.machine.payloads().iter().copied().chain(std::iter::repeat(1));
        let spikes = self.machine.spikes().iter().zip(payloads);
        let mut own: Vec<(u32, i32)> = spikes
            .filter_map(|(spike, payload)| Some((spike.0.checked_sub(first.0).filter(|&i| i < count)?, payload)))
            .collect();
        own.sort_unstable();
        own
    }

    /// The engine, for its registers.
    pub fn engine(&self) -> &impl Engine {
        &self.machine
    }

    /// Changes the weights of all plastic projections by this rule, and goes back to before the
    /// first step.
    ///
    /// # Errors
    /// `session.rule.epoch`, `session.rule.not-plastic`; the session stays as it was.
    pub fn set_rule(&mut self, rule: Arc<dyn LearningRule>) -> Result<()> {
        if !(1..=LONGEST_EPOCH).contains(&rule.epoch()) {
            let message = format!("a rule has epochs of {} steps", rule.epoch());
            let help = format!("give epochs of 1 to {LONGEST_EPOCH} steps");
            return Err(Diagnostic::new("session.rule.epoch", message).help(help));
        }
        if self.plastic.is_empty() {
            let message = "a rule has no weights to change, as the network has no plastic projection".to_string();
            return Err(Diagnostic::new("session.rule.not-plastic", message).help(MAKE_PLASTIC));
        }
        self.machine.set_rule(rule);
        self.reset();
        Ok(())
    }

    /// Returns the weights of a plastic projection, source by source, in the order of its synapses.
    /// After the last step of a learning epoch, they include the changes of that epoch.
    ///
    /// # Errors
    /// `session.weights.not-plastic`.
    pub fn weights(&self, projection: ProjectionId) -> Result<Vec<i16>> {
        Ok(self.plastic(projection)?.places[0].iter().map(|&place| self.machine.weight(place)).collect())
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
        let (plastic, machine) = (Arc::clone(&self.plastic), &mut self.machine);
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
            let message = "weights were written or learned, which a run of what was shown would not have".to_string();
            let help = "call reset() and step without writing weights, in a session without rule";
            return Err(Diagnostic::new("session.weights.written", message).help(help));
        }
        let too_long = || {
            let message = format!("a session stores at most {MOST_KEPT} input spikes, but more were given");
            Diagnostic::new("session.too-long", message).help("call reset() at the end of each trial")
        };
        if self.is_cut {
            return Err(too_long());
        }
        Sample::with_values(self.steps, &self.kept, None).map_err(|_| too_long())
    }
}
