//! Delivery over plastic synapses: one after the other, at the weights of the moment.

use crate::deliver::accumulate::Accumulate;
use crate::deliver::delay_ring::DelayRing;
use crate::plastic::synapses::PlasticSynapses;
use crate::update::kernel::Sum;
use nsim_ir::spikes::Spike;

impl<S: Sum> DelayRing<S> {
    /// Delivers spikes of sources that are numbered from `first` on over synapses of these weights,
    /// and marks where they arrive. Returns the synaptic events that fall within `left` steps.
    /// It is a separate function, so that a step without plastic synapses has nothing of it.
    #[cold]
    #[inline(never)]
    pub fn deliver_plastic<P: Spike>(
        &mut self,
        (plastic, weights): (&PlasticSynapses, &[i16]),
        (first, spikes): (u32, &[P]),
        (cursor, left): (usize, u32),
    ) -> u64
    where
        S: Accumulate<P::Payload>,
    {
        let mut events = 0;
        for spike in spikes {
            let synapses = plastic.synapses(first as usize + spike.source());
            for (place, synapse) in synapses.filter(|(_, synapse)| u32::from(synapse.delay) < left) {
                let (slot, lane) = (self.slot(cursor, synapse.delay), synapse.lane as usize);
                let sum = &mut self.sums[slot + lane];
                *sum = sum.accumulate(synapse.units(weights[place]), spike.payload());
                self.mark(slot, lane..lane + 1);
                events += 1;
            }
        }
        events
    }
}
