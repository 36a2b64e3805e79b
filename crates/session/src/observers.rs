//! Observers of a running sample: its outputs and their decision, and probes.
//!
//! Input: an engine after each step, or after steps in which nothing happened. Output: spikes,
//! scores and the class of the outputs, the step after which a sample is decided, recorded numbers.

use nsim_ir::base::id::CompartmentId;
use nsim_ir::potentials::Potentials;
use nsim_ir::quantised::Output;
use nsim_ir::spikes::Engine;

use crate::decision::{Decision, Rule};
use crate::outcome::{Outcome, Probe, Quantity, SampleSettings};

/// Consecutive steps with equal counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StepRange {
    /// The first of them.
    pub first: u32,
    /// Length of the range in steps.
    pub steps: u32,
    /// Whether nothing happened in them.
    pub idle: bool,
    /// Whether the sample was decided before the first of them.
    pub decided: bool,
}

/// An observer of an engine after its steps.
pub trait Observer<E: ?Sized> {
    /// Sees the engine after consecutive steps.
    fn observe(&mut self, engine: &E, range: StepRange);
}

impl<E: ?Sized, F: FnMut(&E, StepRange)> Observer<E> for F {
    fn observe(&mut self, engine: &E, range: StepRange) {
        self(engine, range);
    }
}

impl<E: ?Sized> Observer<E> for () {
    fn observe(&mut self, _: &E, _: StepRange) {}
}

/// The outputs of a sample and, by the rule of an early exit, its decision.
#[derive(Debug, Clone)]
pub(crate) struct Outputs<'k> {
    output: Output,
    outcome: Outcome,
    /// Decision by spikes, until it is made; potentials are certain only after the last step.
    decision: Option<Decision<'k>>,
    /// The lead by which potentials decide.
    margin: Option<f64>,
    /// Whether a decision ends the sample.
    ends: bool,
    /// The step of the skipped silence after which spikes are decided.
    decides_at: Option<u32>,
    steps: u32,
}

impl Outputs<'static> {
    /// Returns the state before the first step of a session, which has no end and decides nothing.
    pub(crate) fn undecided(output: Output) -> Self {
        let Outputs { outcome, decides_at, .. } = Outputs::new(&SampleSettings::new(output), u32::MAX);
        Outputs { output, outcome, decision: None, margin: None, ends: false, decides_at, steps: u32::MAX }
    }

    /// Drops the stored spikes, not their counts.
    pub(crate) fn forget_spikes(&mut self) {
        self.outcome.spikes.clear();
    }
}

impl<'k> Outputs<'k> {
    /// Returns the state before the first of `steps` steps.
    pub(crate) fn new(sample_settings: &'k SampleSettings, steps: u32) -> Self {
        let Output { count, decision: read_out, .. } = sample_settings.output;
        let potentials = Potentials::new(read_out, count);
        let exit = sample_settings.early_exit.as_ref();
        let margin = exit.and_then(|exit| match exit.rule {
            Rule::Margin(margin) => Some(f64::from(margin.get())),
            Rule::Certain => None,
        });
        Outputs {
            output: sample_settings.output,
            decision: exit.filter(|_| potentials.is_none()).map(|exit| Decision::new(exit, steps)),
            margin: margin.filter(|_| potentials.is_some()),
            ends: exit.is_some_and(|exit| exit.ends),
            decides_at: None,
            steps,
            outcome: Outcome { counts: vec![0; count as usize], potentials, ..Outcome::default() },
        }
    }

    pub(crate) fn is_decided(&self) -> bool {
        self.outcome.decided_at.is_some()
    }

    /// Whether the later steps are skipped.
    pub(crate) fn is_over(&self) -> bool {
        self.ends && self.is_decided()
    }

    /// Returns the number of steps without input, of `step..next`, that may be skipped together.
    pub(crate) fn skippable_steps<E: Engine + ?Sized>(&mut self, engine: &mut E, step: u32, next: u32) -> u32 {
        self.decides_at = None;
        match &self.decision {
            _ if self.margin.is_some() && !self.is_decided() => 0,
            // A decision in silence is expensive, and useless where the engine is not idle.
            Some(_) if !engine.skip_idle(0) => 0,
            Some(decision) => {
                self.decides_at = decision.decided_in_silence(step, next);
                self.decides_at.map_or(next, |decided| decided + 1) - step
            }
            None => next - step,
        }
    }

    /// Returns the outcome of the sample, which ended before step `end`.
    pub(crate) fn outcome(self, end: u32) -> Outcome {
        let Outputs { mut outcome, steps, .. } = self;
        outcome.steps = end;
        // A decision after the last step is not early.
        outcome.decided_at = outcome.decided_at.filter(|decided| decided + 1 < steps);
        outcome.decided_class = outcome.decided_class.filter(|_| outcome.decided_at.is_some());
        outcome.steps_saved = outcome.decided_at.map_or(0, |decided| steps - decided - 1);
        outcome
    }
}

impl<E: Engine + ?Sized> Observer<E> for Outputs<'_> {
    fn observe(&mut self, engine: &E, StepRange { first: step, steps, idle, .. }: StepRange) {
        let Outputs { output, outcome, decision, margin, decides_at, .. } = self;
        let (first, potential) = (output.first.0, |output| engine.potential(CompartmentId(output)));
        if idle {
            outcome.skipped_steps += u64::from(steps);
        } else {
            let before = outcome.spikes.len();
            for compartment in engine.spikes() {
                if let Some(output) = compartment.0.checked_sub(first).filter(|&number| number < output.count) {
                    outcome.counts[output as usize] += 1;
                    outcome.spikes.push((step, output));
                    if let Some(decision) = decision {
                        decision.spike(step, output);
                    }
                }
            }
            outcome.spikes[before..].sort_unstable();
            *decides_at = decision.as_mut().and_then(|decision| decision.decided_after(step).then_some(step));
        }
        if let Some(step) = decides_at.take() {
            outcome.decide(step);
            *decision = None;
        }
        if let Some(potentials) = &mut outcome.potentials {
            potentials
                .add_constant((step + steps).saturating_sub(output.start_step.max(step)), |o| potential(first + o));
            let decides = margin.is_some_and(|margin| step >= output.start_step && potentials.lead() >= margin);
            if decides && outcome.decided_at.is_none() {
                outcome.decide(step);
            }
        }
    }
}

/// Values recorded by probes, `[compartments][steps]` for each. State is constant in idle steps. An
/// engine mostly learns a step while it runs the next one, so a column of a rule lags by a step.
pub(crate) struct Recording<'k, T, R> {
    probes: &'k [Probe],
    steps: usize,
    /// Reads a quantity of a compartment.
    read: R,
    pub(crate) values: Vec<Vec<T>>,
}

impl<'k, T: Copy + From<i32>, R> Recording<'k, T, R> {
    /// Returns the state before the first of `steps` steps.
    pub(crate) fn new(probes: &'k [Probe], steps: u32, read: R) -> Self {
        let steps = steps as usize;
        let zeros = |probe: &Probe| vec![T::from(0); probe.count as usize * if probe.is_last() { 1 } else { steps }];
        Recording { probes, steps, read, values: probes.iter().map(zeros).collect() }
    }

    /// Records the columns of rules of a settled engine, which ran `steps` steps.
    pub(crate) fn finish<E: Engine + ?Sized>(&mut self, engine: &E, steps: u32) {
        for (probe, values) in self.probes.iter().zip(&mut self.values) {
            let Quantity::Learned { rule, column, last, .. } = probe.quantity else { continue };
            let (width, step) = if last { (1, 0) } else { (self.steps, steps.saturating_sub(1) as usize) };
            values.iter_mut().skip(step).step_by(width.max(1)).zip(engine.learned(rule, column)).for_each(set);
        }
    }
}

impl<E, T, R> Observer<E> for Recording<'_, T, R>
where
    E: Engine + ?Sized,
    T: Copy + From<i32>,
    R: Fn(&E, Quantity, CompartmentId) -> T,
{
    fn observe(&mut self, engine: &E, range: StepRange) {
        for (probe, values) in self.probes.iter().zip(&mut self.values) {
            let place = |i: u32| i as usize * self.steps + range.first as usize;
            if let Quantity::Learned { rule, column, last, lag } = probe.quantity {
                if let Some(step) = range.first.checked_sub(lag).filter(|_| !last) {
                    let places = values.iter_mut().skip(step as usize).step_by(self.steps.max(1));
                    places.zip(engine.learned(rule, column)).for_each(set);
                }
                continue;
            }
            if !matches!(probe.quantity, Quantity::Spikes | Quantity::Message) {
                for i in 0..probe.count {
                    let value = (self.read)(engine, probe.quantity, CompartmentId(probe.first.0 + i));
                    values[place(i)..][..range.steps as usize].fill(value);
                }
                continue;
            }
            if range.idle {
                continue;
            }
            let payloads = engine.payloads().iter().copied().chain(std::iter::repeat(1));
            for (spike, payload) in engine.spikes().iter().zip(payloads) {
                if let Some(i) = spike.0.checked_sub(probe.first.0).filter(|&i| i < probe.count) {
                    values[place(i)] = T::from(if probe.quantity == Quantity::Spikes { 1 } else { payload });
                }
            }
        }
    }
}

fn set<T: From<i32>>((place, value): (&mut T, i32)) {
    *place = value.into();
}

/// Returns a quantity of a compartment of an engine in integers.
pub(crate) fn integer<E: Engine + ?Sized>(engine: &E, quantity: Quantity, compartment: CompartmentId) -> i32 {
    match quantity {
        Quantity::U => engine.u(compartment),
        Quantity::VRegister => engine.v_register(compartment),
        Quantity::State(column) => engine.state(compartment, column),
        _ => engine.potential(compartment) as i32,
    }
}
