//! Values of input populations that replace postsynaptic traces: (L10).
//!
//! Input: the values that a step has for the channels of signals. Output: the trace of a target at
//! a step of the epoch.

use crate::layout::plastic::ProjectionPlan;
use crate::plastic::traces::{Source, Traces};
use nsim_dynamics::learning::decayed_signal;
use nsim_ir::learning::draws::Use;
use nsim_ir::learning::{GREATEST_TRACE, LearningSemantics};

/// Values of the signals of a projection, which replace postsynaptic traces: (L10).
#[derive(Debug, Clone, Default)]
pub(crate) struct Signals {
    /// Values of each trace's channels by step of the epoch from 1 on; none where there is no
    /// signal.
    given: [Option<Vec<Vec<i32>>>; 3],
    /// In lava's semantics, each trace's history in the epoch that ends: by target, then step.
    histories: [Vec<i32>; 3],
}

impl Signals {
    pub fn new(projection: &ProjectionPlan, epoch: u32) -> Self {
        let given = projection.of.signals.clone().map(|channels| {
            let channels = channels?.len();
            Some(vec![vec![0; channels]; epoch as usize + 1])
        });
        Signals { given, histories: Default::default() }
    }

    pub fn clear(&mut self) {
        self.given.iter_mut().flatten().flatten().for_each(|values| values.fill(0));
    }

    /// Stores the values of step k; `all` has those of the channels from `first` on.
    pub fn store(&mut self, k: u32, projection: &ProjectionPlan, first: u32, all: &[i32]) {
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
    pub fn column(&self, trace: usize, targets: usize) -> Option<Vec<i32>> {
        let last = &self.given[trace].as_ref()?[0];
        Some((0..targets).map(|target| last[target.min(last.len() - 1)]).collect())
    }

    /// In lava a trace decays from its last value, over the whole epoch, and a spike cuts it.
    pub fn make_histories(&mut self, post: &Traces, source: &Source<'_>) {
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
                    if k == u32::from(post.note_of(target)) {
                        value = value.clamp(0, GREATEST_TRACE);
                    }
                    history.push(value);
                }
            }
        }
    }

    /// Whether a signal gives a trace.
    pub fn gives(&self, trace: usize) -> bool {
        self.given[trace].is_some()
    }

    /// The value of a trace at step k of the epoch, where a signal gives it.
    #[inline]
    pub fn at(&self, trace: usize, target: usize, k: u8) -> Option<i32> {
        let given = self.given[trace].as_ref()?;
        let k = usize::from(k);
        if let Some(&value) = self.histories[trace].get(target * given.len() + k) {
            return Some(value);
        }
        Some(given[k][target.min(given[k].len() - 1)])
    }
}
