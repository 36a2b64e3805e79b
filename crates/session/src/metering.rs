//! Counts of the steps of a session, from which their energy follows.
//!
//! Input: an engine after each step, which counts by core. Output: the run of a sample with as many
//! steps, as [`MeteredMapping`](crate::priced::MeteredMapping) has it. A session has no end, so
//! spikes of its last steps may arrive after it: those steps are stored, and metered once they
//! cannot. So memory does not grow with the steps.

use std::collections::VecDeque;

use nsim_cost::{MeterSettings, StepMeter};
use nsim_ir::activity::{Activity, CoreCounts, MovingEvent, StepActivity};
use nsim_ir::quantised::Output;
use nsim_ir::source_counts::SourceCounts;
use nsim_ir::spikes::Engine;
use nsim_machine::Machine;

use crate::observers::{Observer, Outputs, StepRange};
use crate::outcome::Outcome;

/// The steps of a session as one sample.
#[derive(Debug)]
pub struct MeteredSteps {
    /// Outcome of the sample, whose spikes are not stored.
    pub outcome: Outcome,
    /// Counts by core.
    pub activity: Activity,
    /// Counts by source.
    pub counts: SourceCounts,
    /// Energy and time.
    pub meter: StepMeter,
    /// Compartment updates that were skipped.
    pub skipped_updates: u64,
}

/// Steps with equal counts, and their events of learned delays.
#[derive(Debug, Clone)]
struct Recent {
    activity: StepActivity,
    moving: Vec<MovingEvent>,
    steps: u32,
}

/// The counts of a session.
#[derive(Debug, Clone)]
pub(crate) struct SessionMeter {
    meter: StepMeter,
    output: Output,
    outputs: Outputs<'static>,
    recent: VecDeque<Recent>,
    /// Number of steps in which a spike may arrive.
    reach: u32,
}

impl SessionMeter {
    /// A meter before the first step of a session; spikes arrive within `reach` steps.
    pub fn new(settings: MeterSettings, output: Output, reach: u32) -> Self {
        let (meter, recent) = (StepMeter::new(settings), VecDeque::new());
        SessionMeter { meter, output, outputs: Outputs::undecided(output), recent, reach }
    }

    /// Forgets all steps.
    pub fn clear(&mut self) {
        self.meter = self.meter.fresh();
        self.outputs = Outputs::undecided(self.output);
        self.recent.clear();
    }

    /// Counts the last steps of an engine.
    pub fn observe<E: Engine + ?Sized>(&mut self, engine: &E, range: StepRange) {
        self.outputs.observe(engine, range);
        self.outputs.forget_spikes();
        let Some((activity, moving)) = engine.last_activity() else { return };
        self.recent.push_back(Recent { activity: activity.clone(), moving: moving.to_vec(), steps: range.steps });
        let mut stored: u32 = self.recent.iter().map(|recent| recent.steps).fold(0, u32::saturating_add);
        while let Some(Recent { activity, steps, .. }) = self.recent.front()
            && stored - steps >= self.reach
        {
            self.meter.add(activity, *steps, false);
            stored -= steps;
            self.recent.pop_front();
        }
    }

    /// The sample that ends after the last of `steps` steps, by the engine of the session.
    pub fn sample(&self, engine: &Machine, steps: u32) -> MeteredSteps {
        let (mut meter, mut left) = (self.meter.clone(), self.recent.iter().map(|recent| recent.steps).sum());
        let mut lost = vec![CoreCounts::default(); engine.last_step().cores.len()];
        for Recent { activity, moving, steps } in &self.recent {
            let mut cut = activity.clone();
            engine.cut((&mut cut, moving), left);
            for (lost, (all, within)) in lost.iter_mut().zip(activity.cores.iter().zip(&cut.cores)) {
                lost.events_dense += all.events_dense - within.events_dense;
                lost.events_sparse += all.events_sparse - within.events_sparse;
            }
            meter.add(&cut, *steps, false);
            left -= steps;
        }
        let mut ended = engine.clone();
        ended.settle();
        let (overflow, synaptic_updates) = (ended.overflow(), ended.synaptic_updates());
        let skipped_updates = ended.skipped_updates();
        let (all, counts) = ended.take_counts();
        let cores = all.cores().iter().zip(lost).map(|(all, lost)| CoreCounts {
            events_dense: all.events_dense - lost.events_dense,
            events_sparse: all.events_sparse - lost.events_sparse,
            ..*all
        });
        let activity = all.on_cores(cores.collect(), all.hops(), all.spikes_in());
        let totals = activity.totals();
        let outcome = Outcome { totals, overflow, synaptic_updates, ..self.outputs.clone().outcome(steps) };
        MeteredSteps { outcome, activity, counts, meter, skipped_updates }
    }
}
