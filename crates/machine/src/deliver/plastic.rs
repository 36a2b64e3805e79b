//! Delivery over plastic synapses, synapse by synapse, with the current weights and delays.

use std::ops::Range;

use crate::deliver::accumulate::Accumulate;
use crate::deliver::delay_ring::{DelayRing, Now};
use crate::lanes::kernel::Sum;
use crate::layout::plastic::{Columns, Plan, PlasticSynapses, ProjectionPlan};
use crate::layout::shard::SKIP_BLOCK;
use crate::prefetch::prefetch_range;
use nsim_dynamics::arithmetic::scaled;
use nsim_ir::base::fixed::WEIGHT_SHIFT;
use nsim_ir::spikes::Spike;

impl<S: Sum> DelayRing<S> {
    /// Delivers spikes over plastic synapses, and marks the skip blocks of their targets. Sources
    /// are numbered from `first` on. Returns the synaptic events within the sample. The function is
    /// separate, so that a step without plastic synapses has none of its code.
    #[cold]
    #[inline(never)]
    pub fn deliver_plastic<P: Spike>(
        &mut self,
        plan: &Plan,
        synapses: &PlasticSynapses,
        state: &Columns,
        (first, spikes): (u32, &[P]),
        now: Now,
    ) -> u64
    where
        S: Accumulate<P::Payload>,
    {
        self.note_spikes(spikes);
        let mut events = 0;
        for (place, spike) in spikes.iter().enumerate() {
            if let Some(ahead) = spikes.get(place + AHEAD) {
                for (_, places) in rows(plan, synapses, first as usize + ahead.source()) {
                    prefetch_range(&synapses.lanes, places.clone());
                    prefetch_range(&state.weights, places);
                }
            }
            for (projection, places) in rows(plan, synapses, first as usize + spike.source()) {
                let format = projection.of.format;
                let units = |weight: i16| (scaled(format, weight) >> WEIGHT_SHIFT) as i16;
                let synapses = synapses.lanes[places.clone()].iter().zip(&state.weights[places.clone()]);
                if projection.moves {
                    for ((&lane, &weight), &delay) in synapses.zip(&state.delays[places]) {
                        if (delay as u32) < now.left {
                            self.add(self.slot(now, delay as u8), lane, units(weight), spike.payload());
                            events += 1;
                        }
                    }
                } else if u32::from(projection.of.delay.get()) < now.left {
                    events += places.len() as u64;
                    let slot = self.slot(now, projection.of.delay.get());
                    for (&lane, &weight) in synapses {
                        self.add(slot, lane, units(weight), spike.payload());
                    }
                }
            }
        }
        events
    }

    #[inline(always)]
    fn add<P>(&mut self, slot: usize, lane: u32, units: i16, payload: P)
    where
        S: Accumulate<P>,
    {
        let at = slot + lane as usize;
        self.sums[at] = self.sums[at].accumulate(units, payload);
        self.marks[at / SKIP_BLOCK] = 1;
    }
}

/// Spikes between the prefetch of a row and its use.
const AHEAD: usize = 2;

/// The rows of a source: the projection, and the places of its synapses.
fn rows<'a>(
    plan: &'a Plan,
    synapses: &'a PlasticSynapses,
    source: usize,
) -> impl Iterator<Item = (&'a ProjectionPlan, Range<usize>)> {
    plan.of_source.get(source).iter().map(move |&number| {
        let projection = &plan.projections[number as usize];
        let index = source - projection.of.sources.start as usize;
        (projection, synapses.projections[number as usize].of_source(index))
    })
}
