//! Delivery over plastic synapses, synapse by synapse, with the current weights.

use crate::deliver::accumulate::Accumulate;
use crate::deliver::delay_ring::{DelayRing, Now};
use crate::lanes::kernel::Sum;
use crate::layout::plastic::PlasticSynapses;
use nsim_ir::spikes::Spike;

impl<S: Sum> DelayRing<S> {
    /// Delivers spikes over synapses of these weights, and marks the skip blocks of their targets.
    /// Sources are numbered from `first` on. Returns the synaptic events within the sample. The
    /// function is separate, so that a step without plastic synapses has none of its code.
    #[cold]
    #[inline(never)]
    pub fn deliver_plastic<P: Spike>(
        &mut self,
        (plastic, weights): (&PlasticSynapses, &[i16]),
        (first, spikes): (u32, &[P]),
        now: Now,
    ) -> u64
    where
        S: Accumulate<P::Payload>,
    {
        self.note_spikes(spikes);
        let mut events = 0;
        for spike in spikes {
            let synapses = plastic.synapses(first as usize + spike.source());
            for (place, synapse) in synapses.filter(|(_, synapse)| u32::from(synapse.delay) < now.left) {
                let (slot, lane) = (self.slot(now, synapse.delay), synapse.lane as usize);
                let sum = &mut self.sums[slot + lane];
                *sum = sum.accumulate(synapse.units(weights[place]), spike.payload());
                self.mark(slot, lane..lane + 1);
                events += 1;
            }
        }
        events
    }
}
