//! The phase Learn: plastic weights change at the end of each epoch of a rule.
//!
//! Input: the sources whose messages a step delivered. Output: new weights in the state of each
//! shard. Targets are sources too, so that one record serves both ends of a synapse.

use std::sync::Arc;

use rayon::prelude::*;

use crate::layout::image::Image;
use crate::update::state::ShardState;
use nsim_ir::base::id::Id;
use nsim_ir::learning::LearningRule;

/// A rule, and the record of the current epoch.
#[derive(Debug, Clone)]
pub(crate) struct Learning {
    rule: Arc<dyn LearningRule>,
    /// Whether each source sent a delivered message; channels first.
    noted: Vec<bool>,
}

impl Learning {
    /// Learning before the first step of an image.
    pub fn new(rule: Arc<dyn LearningRule>, image: &Image) -> Self {
        Learning { rule, noted: vec![false; image.sources()] }
    }

    /// Clears the record.
    pub fn clear(&mut self) {
        self.noted.fill(false);
    }

    /// Records these sources, whose messages `step` delivered; weights change if an epoch ends.
    pub fn learn(
        &mut self,
        step: u32,
        sources: impl Iterator<Item = u32>,
        (image, shards): (&Image, &mut [ShardState]),
    ) {
        // The first delivery is before all epochs.
        if step == 0 {
            return;
        }
        sources.for_each(|source| self.noted[source as usize] = true);
        if !step.is_multiple_of(self.rule.epoch()) {
            return;
        }
        let Learning { rule, noted } = self;
        let of_targets = &noted[image.channels as usize..];
        shards.par_iter_mut().zip(&image.shards).for_each(|(state, shard)| {
            for (source, &pre) in noted.iter().enumerate() {
                for (place, synapse) in shard.plastic.synapses(source) {
                    let weight = &mut state.plastic[place];
                    let learned = rule.learn(*weight, pre, of_targets[synapse.target.index()]);
                    *weight = synapse.format.toward_zero(learned);
                }
            }
        });
        self.clear();
    }
}
