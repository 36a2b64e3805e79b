//! Delivery by lists: synapse by synapse, for any delay.

use crate::deliver::accumulate::Accumulate;
use crate::deliver::delay_ring::{DelayRing, Now};
use crate::lanes::kernel::Sum;
use crate::layout::lists::{ADDRESSED, ListForm, ListTable};
use crate::layout::shard::SKIP_BLOCK;
use nsim_ir::spikes::Spike;

impl<S: Sum> DelayRing<S> {
    /// [`DelayRing::deliver_lists`] without a version for each processor's vectors, since it is a
    /// third of the code of a step.
    #[inline(never)]
    pub(super) fn deliver_graded_lists<const MARK: bool, P: Spike>(
        &mut self,
        table: &ListTable,
        spikes: &[P],
        now: Now,
    ) -> u64
    where
        S: Accumulate<P::Payload>,
    {
        self.deliver_lists::<MARK, P>(table, spikes, now)
    }

    /// Delivers spikes by lists of all delays, for arrivals within the sample; returns the number
    /// of synaptic events.
    #[inline(always)]
    pub(super) fn deliver_lists<const MARK: bool, P: Spike>(&mut self, table: &ListTable, spikes: &[P], now: Now) -> u64
    where
        S: Accumulate<P::Payload>,
    {
        let (slot, end) = (self.slot(now, table.shortest), self.lanes * self.slots());
        // Synapses that arrive after the end come last.
        let late = u32::from(table.longest) >= now.left;
        let below = if late { (now.left - u32::from(table.shortest)) as usize * self.lanes } else { usize::MAX };
        let DelayRing { sums, marks, queue, .. } = self;
        let (places, queue) = (&table.places, (below, queue));
        match &table.synapses {
            ListForm::Packed(runs) => {
                runs.deliver(places, spikes, queue, add_to::<MARK, S, _>(sums, marks, (slot, end)))
            }
            ListForm::PackedSixteens(runs) => {
                runs.deliver(places, spikes, queue, add_to::<MARK, S, _>(sums, marks, (slot, end)))
            }
            ListForm::Singles(singles) => {
                singles.deliver(spikes, below, add_to::<MARK, S, _>(sums, marks, (slot, end)))
            }
            ListForm::Split(lists) => {
                lists.deliver(places, spikes, below, add_to::<MARK, S, _>(sums, marks, (slot, end)))
            }
            ListForm::Fours(runs) => runs.deliver(places, spikes, queue, add_compact::<MARK, S, _>(sums, marks, slot)),
            ListForm::Eights(runs) => runs.deliver(places, spikes, queue, add_compact::<MARK, S, _>(sums, marks, slot)),
            ListForm::Sixteens(runs) => {
                runs.deliver(places, spikes, queue, add_compact::<MARK, S, _>(sums, marks, slot))
            }
        }
    }
}

/// Adds to the sum of a target, and marks its skip block. Targets are counted from `slot` on,
/// around the ring's end.
#[inline(always)]
fn add_to<const MARK: bool, S: Accumulate<Y>, Y>(
    sums: &mut [S],
    marks: &mut [u8],
    (slot, end): (usize, usize),
) -> impl FnMut(usize, i16, Y) {
    move |target, weight, payload| {
        // Before the ring's end the difference wraps to a large number; after it, it is smaller.
        let at = (target + slot).min((target + slot).wrapping_sub(end));
        sums[at] = sums[at].accumulate(weight, payload);
        if MARK {
            marks[at / SKIP_BLOCK] = 1;
        }
    }
}

/// [`add_to`] for lanes of 16 bits: every such lane has a sum, so no bound is checked.
#[inline(always)]
fn add_compact<const MARK: bool, S: Accumulate<Y>, Y>(
    sums: &mut [S],
    marks: &mut [u8],
    slot: usize,
) -> impl FnMut(usize, i16, Y) {
    let marks = &mut marks[slot / SKIP_BLOCK..];
    let sums = sums[slot..].first_chunk_mut::<ADDRESSED>();
    let sums = sums.expect("compact lists have all sums that they can address");
    move |target, weight, payload| {
        sums[target] = sums[target].accumulate(weight, payload);
        if MARK {
            marks[target / SKIP_BLOCK] = 1;
        }
    }
}

/// Returns the spikes of sources whose bit in `few` is set.
#[inline(never)]
pub(super) fn with_list<P: Spike>(few: &[u64], spikes: &[P]) -> Vec<P> {
    let has_list = |spike: &&P| few[spike.source() / 64] >> (spike.source() % 64) & 1 == 1;
    spikes.iter().filter(has_list).copied().collect()
}
