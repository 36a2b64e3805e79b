//! The weights of a rule over the steps of a sample, for pictures.
//!
//! Input: an engine that learns, a rule, a sample. Output: [`WeightHistory`]: the number of
//! synapses with each weight at up to a hundred times, and each weight at both ends. So its size
//! does not grow with the steps of the sample.

use std::collections::BTreeMap;

use nsim_ir::base::id::RuleId;
use nsim_ir::learning::{Column, Variable};
use nsim_ir::spikes::{Engine, Sample};

/// The most times at which weights are counted within a sample.
const MOST_TIMES: u32 = 100;

/// The weights of a rule over a sample.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WeightHistory {
    /// The number of synapses with each weight after a number of steps, ascending: before the
    /// first, at regular times, and after the last.
    pub counts: Vec<(u32, BTreeMap<i32, u32>)>,
    /// Weights before the first step, by row.
    pub first: Vec<i32>,
    /// Weights after the last step, by row.
    pub last: Vec<i32>,
}

impl WeightHistory {
    /// Runs a sample. What the engine has learned before is kept.
    pub fn new<E: Engine + ?Sized>(engine: &mut E, rule: RuleId, sample: &Sample) -> Self {
        let steps = sample.steps();
        let every = steps.div_ceil(MOST_TIMES).max(1);
        let column = Column::Variable(Variable::Weight);
        let first = engine.learned(rule, column);
        let mut counts = vec![(0, counted(&first))];
        engine.begin(steps);
        for step in 0..steps {
            engine.step(sample.input(step));
            // The call of a step shows what was learned after the one before.
            if step > 0 && step.is_multiple_of(every) {
                counts.push((step, counted(&engine.learned(rule, column))));
            }
        }
        engine.settle();
        let last = engine.learned(rule, column);
        counts.push((steps, counted(&last)));
        WeightHistory { counts, first, last }
    }
}

fn counted(weights: &[i32]) -> BTreeMap<i32, u32> {
    let mut counts = BTreeMap::new();
    weights.iter().for_each(|&weight| *counts.entry(weight).or_default() += 1);
    counts
}
