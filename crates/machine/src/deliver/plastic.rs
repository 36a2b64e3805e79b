//! Delivery over plastic synapses, synapse by synapse, with the current weights and delays.

use crate::deliver::accumulate::Accumulate;
use crate::deliver::delay_ring::{DelayRing, Now};
use crate::lanes::kernel::Sum;
use crate::layout::plastic::{Columns, Plan, PlasticSynapses};
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
        for spike in spikes {
            let source = first as usize + spike.source();
            for &number in plan.of_source.get(source) {
                let projection = &plan.projections[number as usize];
                let index = source - projection.of.sources.start as usize;
                let (format, delay) = (projection.of.format, projection.of.delay.get());
                for place in synapses.projections[number as usize].of_source(index) {
                    let delay = if projection.moves { state.delays[place] as u8 } else { delay };
                    if u32::from(delay) >= now.left {
                        continue;
                    }
                    let (slot, lane) = (self.slot(now, delay), synapses.lanes[place] as usize);
                    let units = (scaled(format, state.weights[place]) >> WEIGHT_SHIFT) as i16;
                    let sum = &mut self.sums[slot + lane];
                    *sum = sum.accumulate(units, spike.payload());
                    self.mark(slot, lane..lane + 1);
                    events += 1;
                }
            }
        }
        events
    }
}
