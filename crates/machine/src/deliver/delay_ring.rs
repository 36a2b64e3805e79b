//! The delay ring: sums of arrivals by step and lane, and the delivery of spikes into them.
//!
//! Input: spikes, and the dense blocks and lists of their synapses. Output: sums of weights in
//! units of 64, the skip blocks that they lie in, and the number of synaptic events.

use crate::bits::ones;
use crate::deliver::accumulate::Accumulate;
use crate::deliver::prefetch::prefetch;
use crate::layout::dense_blocks::{DenseBlock, DenseBlocks, LaneRange};
use crate::layout::fan_out::FanOut;
use crate::layout::lists::{ADDRESSED, ListForm, ListTable};
use crate::layout::shard::SKIP_BLOCK;
use crate::layout::store::Aligned;
use crate::layout::weight_rows::{RowPlace, RowTable, UNCHECKED};
use crate::update::kernel::{LANES, Sum};
use nsim_ir::spikes::Spike;

/// Arrivals of the coming steps, a slot each.
#[derive(Debug)]
pub(crate) struct DelayRing<S> {
    /// Lanes of the shard.
    lanes: usize,
    /// Sums in units of 64, by lane.
    pub sums: Vec<Aligned<S>>,
    /// Skip blocks with arrivals, a bit each.
    pub arrivals: Vec<Vec<u64>>,
    /// Scratch memory.
    queue: Vec<u32>,
    row_queue: Vec<RowPlace>,
}

impl<S: Sum> Clone for DelayRing<S> {
    fn clone(&self) -> Self {
        let copy = |sums: &Aligned<S>| {
            // Untouched pages stay untouched.
            let mut copy = Aligned::new(sums.len());
            copy[..self.lanes].copy_from_slice(&sums[..self.lanes]);
            copy
        };
        let (lanes, arrivals) = (self.lanes, self.arrivals.clone());
        let sums = self.sums.iter().map(copy).collect();
        DelayRing { lanes, sums, arrivals, queue: Vec::new(), row_queue: Vec::new() }
    }
}

impl<S: Sum> DelayRing<S> {
    /// An empty ring of this many lanes, slots, and words of skip blocks; `compact` if a list of
    /// the shard is.
    pub fn new(lanes: usize, compact: bool, words: usize, slots: usize) -> Self {
        // What lies beyond the lanes is untouched pages, which the OS never commits.
        // The last chunk of a row may reach beyond them too, where it adds zeros.
        let sums = if compact { (lanes + LANES).max(ADDRESSED) } else { lanes + LANES };
        let sums = (0..slots).map(|_| Aligned::new(sums)).collect();
        DelayRing { lanes, sums, arrivals: vec![vec![0; words]; slots], queue: Vec::new(), row_queue: Vec::new() }
    }

    /// Bytes of memory that it holds.
    pub fn bytes(&self) -> usize {
        let slot_bytes = |words: &Vec<u64>| size_of::<S>() * self.lanes + size_of_val(words.as_slice());
        self.arrivals.iter().map(slot_bytes).sum::<usize>()
            + 4 * self.queue.capacity()
            + size_of::<RowPlace>() * self.row_queue.capacity()
    }

    /// Empties the ring.
    pub fn clear(&mut self) {
        for (sums, arrivals) in self.sums.iter_mut().zip(&mut self.arrivals) {
            sums[..self.lanes].fill(S::default());
            arrivals.fill(0);
        }
    }

    /// Marks the first skip blocks as having arrivals, in every slot.
    pub fn mark_all(&mut self, skip_blocks: usize) {
        for words in &mut self.arrivals {
            for (index, word) in words.iter_mut().enumerate() {
                *word = ones(skip_blocks.saturating_sub(index * 64));
            }
        }
    }

    /// The slot of a delay.
    #[inline(always)]
    fn slot(&self, cursor: usize, delay: u8) -> usize {
        let slot = cursor + usize::from(delay);
        if slot >= self.sums.len() { slot - self.sums.len() } else { slot }
    }

    /// Marks the skip blocks of a range of lanes.
    #[inline(always)]
    fn mark(&mut self, slot: usize, range: &LaneRange) {
        let target = range.target as usize;
        let last = target + range.chunks as usize * LANES - 1;
        for skip_block in target / SKIP_BLOCK..=last / SKIP_BLOCK {
            self.arrivals[slot][skip_block / 64] |= 1 << (skip_block % 64);
        }
    }

    /// Delivers spikes of channels or of compartments, ascending if there are dense blocks, and
    /// with `MARK` marks where they arrive. Returns the synaptic events that fall within `left`
    /// steps. Spikes that fan_out narrow dense blocks are counted in `counts` by source, unless it
    /// is empty.
    #[inline(always)]
    pub fn deliver<const MARK: bool, P: Spike>(
        &mut self,
        fan_outs: &[FanOut],
        (spikes, counts): (&[P], &mut [u32]),
        cursor: usize,
        left: u32,
    ) -> u64
    where
        S: Accumulate<P::Payload>,
    {
        let mut events = 0;
        for fan_out in fan_outs {
            let arrives = u32::from(fan_out.delay) < left;
            // What would arrive after the end has no effect. Delivery may count channels, though.
            if !arrives && counts.is_empty() {
                continue;
            }
            let slot = self.slot(cursor, fan_out.delay);
            let mut synapses = 0;
            if !fan_out.dense.blocks.is_empty() {
                synapses += self.deliver_dense::<MARK, P>(&fan_out.dense, (spikes, &mut *counts), slot);
            }
            if let Some(rows) = &fan_out.rows {
                synapses += self.deliver_rows::<MARK, P>(rows, spikes, slot);
            }
            if let Some(lists) = &fan_out.lists {
                synapses += self.deliver_lists::<MARK, P>(lists, spikes, slot);
            }
            events += if arrives { synapses } else { 0 };
        }
        events
    }

    #[inline(always)]
    fn deliver_dense<const MARK: bool, P: Spike>(
        &mut self,
        dense: &DenseBlocks,
        (spikes, counts): (&[P], &mut [u32]),
        slot: usize,
    ) -> u64
    where
        S: Accumulate<P::Payload>,
    {
        let weights = dense.weights();
        let (mut events, mut blocks, mut rest) = (0, dense.blocks.as_slice(), spikes);
        while let Some(next) = rest.first() {
            let passed = first_at_least(blocks, |block| block.end as usize > next.source());
            blocks = &blocks[passed..];
            let Some(block) = blocks.first() else { break };
            rest = &rest[before(rest, block.first)..];
            if let Some(range) = block.narrow() {
                let counts = counts.get_mut(block.first as usize..block.end as usize).unwrap_or_default();
                let delivered = match range.chunks {
                    1 => self.deliver_narrow::<P, 1>(block, range, weights, (rest, counts), slot),
                    2 => self.deliver_narrow::<P, 2>(block, range, weights, (rest, counts), slot),
                    3 => self.deliver_narrow::<P, 3>(block, range, weights, (rest, counts), slot),
                    _ => self.deliver_narrow::<P, 4>(block, range, weights, (rest, counts), slot),
                };
                let (spiking, after) = rest.split_at(delivered);
                rest = after;
                if MARK && !spiking.is_empty() {
                    self.mark(slot, range);
                }
                events += block.synapses(spiking);
                continue;
            }
            let (spiking, after) = rest.split_at(before(rest, block.end));
            rest = after;
            if !spiking.is_empty() {
                events += self.deliver_wide::<MARK, P>(block, weights, spiking, slot);
            }
        }
        events
    }

    /// Delivers spikes of a dense block's sources, a few chunks of lanes at a time: their sums stay
    /// in registers, where going through memory would make each source wait for the store before
    /// it.
    #[inline(always)]
    fn deliver_wide<const MARK: bool, P: Spike>(
        &mut self,
        block: &DenseBlock,
        weights: &[[i16; LANES]],
        spikes: &[P],
        slot: usize,
    ) -> u64
    where
        S: Accumulate<P::Payload>,
    {
        let mut chunk = block.weights;
        for range in &block.ranges {
            if MARK {
                self.mark(slot, range);
            }
            let count = range.chunks as usize;
            let target = range.target as usize;
            let (sums, _) = self.sums[slot][target..target + count * LANES].as_chunks_mut::<LANES>();
            let weights = &weights[chunk..];
            let (fours, ones) = sums.as_chunks_mut::<4>();
            for (index, sums) in fours.iter_mut().enumerate() {
                add_spikes(sums, weights, spikes, |source| (source - block.first as usize) * block.stride + 4 * index);
            }
            let rest = 4 * fours.len();
            for (index, sums) in ones.iter_mut().enumerate() {
                let place = |source| (source - block.first as usize) * block.stride + rest + index;
                add_spikes(std::array::from_mut(sums), weights, spikes, place);
            }
            chunk += count;
        }
        block.synapses(spikes)
    }

    /// Delivers spikes of the sources of a dense block with one range of this many chunks, up to
    /// the first spike of another source; returns how many. Looking up each source's weights finds
    /// the end without a search beforehand.
    #[inline(always)]
    fn deliver_narrow<P: Spike, const N: usize>(
        &mut self,
        block: &DenseBlock,
        range: &LaneRange,
        weights: &[[i16; LANES]],
        (spikes, counts): (&[P], &mut [u32]),
        slot: usize,
    ) -> usize
    where
        S: Accumulate<P::Payload>,
    {
        let sources = (block.end - block.first) as usize;
        let weights = weights[block.weights..block.weights + sources * N].as_chunks::<N>().0;
        let (sums, _) = self.sums[slot][range.target as usize..].as_chunks_mut::<LANES>();
        let Some(sums) = sums.first_chunk_mut::<N>() else { return 0 };
        let mut kept = *sums;
        // Two loops, so that neither decides in each turn whether it counts; as many counts as
        // weights need one check.
        let delivered = match counts.get_mut(..weights.len()) {
            Some(counts) => add_sources::<true, _, _, N>(&mut kept, weights, counts, spikes, block.first as usize),
            None => add_sources::<false, _, _, N>(&mut kept, weights, &mut [], spikes, block.first as usize),
        };
        *sums = kept;
        delivered
    }

    /// Adds the rows of weights of each spike.
    #[inline(always)]
    fn deliver_rows<const MARK: bool, P: Spike>(&mut self, table: &RowTable, spikes: &[P], slot: usize) -> u64
    where
        S: Accumulate<P::Payload>,
    {
        let mut queue = std::mem::take(&mut self.row_queue);
        let mut events = 0;
        // A loop over the few rows of each spike would end in a mispredicted branch, so rows of
        // many spikes are queued; graded spikes come one by one, as queued rows do not know theirs.
        for spikes in spikes.chunks(if P::BINARY { QUEUED_SPIKES } else { 1 }) {
            let (rows, synapses) = enqueue_rows(table, spikes, &mut queue);
            events += synapses;
            for place in &queue[..rows] {
                self.add_row::<MARK, P>(table, *place, spikes[0].payload(), slot);
            }
        }
        self.row_queue = queue;
        events
    }

    #[inline(always)]
    fn add_row<const MARK: bool, P: Spike>(
        &mut self,
        table: &RowTable,
        place: RowPlace,
        payload: P::Payload,
        slot: usize,
    ) where
        S: Accumulate<P::Payload>,
    {
        let (lane, weights) = (place.lane(), table.rows.weights(place.row()));
        let end = lane + weights.len() * LANES;
        let (sums, _) = self.sums[slot][lane..end].as_chunks_mut::<LANES>();
        for (sums, weights) in sums.iter_mut().zip(weights) {
            add_weights(std::array::from_mut(sums), std::array::from_ref(weights), payload);
        }
        if MARK {
            // Zeros beyond the last lane may lie in a skip block that does not exist.
            let last = (end - 1).min(self.lanes - 1);
            for skip_block in lane / SKIP_BLOCK..=last / SKIP_BLOCK {
                self.arrivals[slot][skip_block / 64] |= 1 << (skip_block % 64);
            }
        }
    }

    #[inline(always)]
    fn deliver_lists<const MARK: bool, P: Spike>(&mut self, table: &ListTable, spikes: &[P], slot: usize) -> u64
    where
        S: Accumulate<P::Payload>,
    {
        let DelayRing { sums, arrivals, queue, .. } = self;
        let (sums, arrivals) = (&mut *sums[slot], arrivals[slot].as_mut_slice());
        let places = &table.places;
        match &table.synapses {
            ListForm::Fours(runs) => runs.deliver(places, spikes, queue, add_compact::<MARK, S, _>(sums, arrivals)),
            ListForm::Eights(runs) => runs.deliver(places, spikes, queue, add_compact::<MARK, S, _>(sums, arrivals)),
            ListForm::Sixteens(runs) => runs.deliver(places, spikes, queue, add_compact::<MARK, S, _>(sums, arrivals)),
            ListForm::Packed(runs) => runs.deliver(places, spikes, queue, add_to::<MARK, S, _>(sums, arrivals)),
            ListForm::Split(lists) => lists.deliver(places, spikes, add_to::<MARK, S, _>(sums, arrivals)),
        }
    }
}

/// Spikes whose rows are queued at a time.
const QUEUED_SPIKES: usize = 512;

/// Spikes between the prefetch of a source's origin and its use.
const PREFETCH_SPIKES: usize = 16;

/// Queues the rows of these spikes; returns their number and that of the synapses in them.
#[inline(always)]
fn enqueue_rows(table: &RowTable, spikes: &[impl Spike], queue: &mut Vec<RowPlace>) -> (usize, u64) {
    let (mut end, mut events) = (0, 0);
    for (index, spike) in spikes.iter().enumerate() {
        if let Some(far) = spikes.get(index + PREFETCH_SPIKES) {
            prefetch(&table.origins, far.source());
        }
        let origin = table.origins[spike.source()];
        let (stencil, places, rows) = table.stencil(origin);
        events += u64::from(stencil.synapses);
        if queue.len() < end + places.len() {
            queue.resize(2 * (end + places.len()), places[0]);
        }
        if let (Some(queued), Some(unchecked)) =
            (queue[end..].first_chunk_mut::<UNCHECKED>(), places.first_chunk::<UNCHECKED>())
        {
            *queued = unchecked.map(|place| place.after(origin.lane));
        }
        if rows > UNCHECKED {
            let others = queue[end + UNCHECKED..end + rows].iter_mut().zip(&places[UNCHECKED..]);
            others.for_each(|(queued, place)| *queued = place.after(origin.lane));
        }
        end += rows;
    }
    (end, events)
}

/// Adds to a sum, and marks its skip block.
#[inline(always)]
fn add_to<const MARK: bool, S: Accumulate<Y>, Y>(sums: &mut [S], arrivals: &mut [u64]) -> impl FnMut(usize, i16, Y) {
    |target, weight, payload| {
        sums[target] = sums[target].accumulate(weight, payload);
        mark::<MARK>(arrivals, target);
    }
}

/// The same for lanes of 16 bits: there is a sum for each, so that no bound is checked.
#[inline(always)]
fn add_compact<const MARK: bool, S: Accumulate<Y>, Y>(
    sums: &mut [S],
    arrivals: &mut [u64],
) -> impl FnMut(usize, i16, Y) {
    let sums: &mut [S; ADDRESSED] = sums.first_chunk_mut().expect("compact lists have all sums that they can address");
    move |target, weight, payload| {
        sums[target] = sums[target].accumulate(weight, payload);
        mark::<MARK>(arrivals, target);
    }
}

/// Marks the skip block of a lane, if that is wanted.
#[inline(always)]
fn mark<const MARK: bool>(arrivals: &mut [u64], target: usize) {
    if MARK {
        let skip_block = target / SKIP_BLOCK;
        arrivals[skip_block / 64] |= 1 << (skip_block % 64);
    }
}

/// Up to this many spikes are counted faster than searched.
const COUNTED: usize = 64;

/// How many of these spikes, ascending, come before a source; often none or all.
#[inline(always)]
fn before<P: Spike>(spikes: &[P], source: u32) -> usize {
    let is = |spike: &P| (spike.source() as u32) < source;
    match (spikes.first().is_some_and(is), spikes.last().is_some_and(is)) {
        (false, _) => 0,
        (true, true) => spikes.len(),
        // Counting has no branches.
        (true, false) if spikes.len() <= COUNTED => spikes.iter().map(|spike| usize::from(is(spike))).sum(),
        (true, false) => spikes.partition_point(is),
    }
}

/// How many items come before those that hold; near ones are looked at first.
#[inline(always)]
fn first_at_least<T>(items: &[T], holds: impl Fn(&T) -> bool) -> usize {
    match items.iter().take(4).position(&holds) {
        Some(near) => near,
        None => items.partition_point(|item| !holds(item)),
    }
}

/// Adds chunks of weights, which begin at a place for each source, to as many chunks of sums.
#[inline(always)]
fn add_spikes<S: Accumulate<P::Payload>, P: Spike, const N: usize>(
    sums: &mut [[S; LANES]; N],
    weights: &[[i16; LANES]],
    spikes: &[P],
    place: impl Fn(usize) -> usize,
) {
    let mut kept = *sums;
    for spike in spikes {
        if let Some(weights) = weights[place(spike.source())..].first_chunk() {
            add_weights(&mut kept, weights, spike.payload());
        }
    }
    *sums = kept;
}

/// Adds the weights of each source to as many chunks of sums, up to the first spike of a source
/// without weights; returns how many spikes that were. Two spikes a turn: the loop's own
/// instructions are a third of those of one.
#[inline(always)]
fn add_sources<const COUNT: bool, S: Accumulate<P::Payload>, P: Spike, const N: usize>(
    sums: &mut [[S; LANES]; N],
    weights: &[[[i16; LANES]; N]],
    counts: &mut [u32],
    spikes: &[P],
    first: usize,
) -> usize {
    let (pairs, rest) = spikes.as_chunks::<2>();
    let mut delivered = 0;
    for [one, other] in pairs {
        if !add_source::<COUNT, _, _, N>(sums, weights, counts, one, first) {
            return delivered;
        }
        if !add_source::<COUNT, _, _, N>(sums, weights, counts, other, first) {
            return delivered + 1;
        }
        delivered += 2;
    }
    for spike in rest {
        delivered += usize::from(add_source::<COUNT, _, _, N>(sums, weights, counts, spike, first));
    }
    delivered
}

/// Adds the weights of a spike's source, if there are any; returns whether there are. `counts` is
/// as long as `weights`.
#[inline(always)]
fn add_source<const COUNT: bool, S: Accumulate<P::Payload>, P: Spike, const N: usize>(
    sums: &mut [[S; LANES]; N],
    weights: &[[[i16; LANES]; N]],
    counts: &mut [u32],
    spike: &P,
    first: usize,
) -> bool {
    let source = spike.source() - first;
    let Some(weights) = weights.get(source) else { return false };
    add_weights(sums, weights, spike.payload());
    if COUNT {
        counts[source] += 1;
    }
    true
}

/// Adds chunks of weights to as many chunks of sums.
#[inline(always)]
fn add_weights<S: Accumulate<Y>, Y: Copy, const N: usize>(
    sums: &mut [[S; LANES]; N],
    weights: &[[i16; LANES]; N],
    payload: Y,
) {
    for chunk in 0..N {
        for lane in 0..LANES {
            sums[chunk][lane] = sums[chunk][lane].accumulate(weights[chunk][lane], payload);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::flatten::Flattened;
    use crate::layout::lists::{LaneWeight, ListBuilder};
    use nsim_ir::base::id::{ChannelId, Id};
    use nsim_ir::base::rng;

    fn flattened(sources: &[Vec<LaneWeight>], lanes: usize) -> FanOut {
        let mut builder = ListBuilder::new(lanes);
        sources.iter().for_each(|synapses| builder.append(&[synapses.len() as u32], synapses));
        FanOut::new(1, Flattened::lists(builder), &std::sync::Arc::default(), lanes).unwrap().unwrap()
    }

    /// Sums, marked skip blocks and numbers of synapses are those of adding one synapse after the
    /// other.
    fn compare<S: Sum>(lanes: usize, synapses: u64, width: u64) -> FanOut {
        let of = |source: u64, index| {
            let lane = (source * 17 + rng::below(width, 1, source, index)) % lanes as u64;
            (lane as u32, rng::below(255, 2, source, index) as i16 - 127)
        };
        let sources: Vec<Vec<LaneWeight>> =
            (0..300).map(|source| (0..synapses).map(|index| of(source, index)).collect()).collect();
        let fan_out = flattened(&sources, lanes);
        let compact = fan_out.lists.as_ref().is_some_and(|table| table.synapses.is_compact());
        for every in [1, 3, 50] {
            let ids: Vec<ChannelId> = (0..300).step_by(every).map(ChannelId::new).collect();
            let (mut sums, mut marked) = (vec![0; lanes], vec![0u64; lanes.div_ceil(64 * SKIP_BLOCK)]);
            for &(lane, weight) in ids.iter().flat_map(|id| &sources[id.index()]) {
                sums[lane as usize] += i32::from(weight);
                marked[lane as usize / SKIP_BLOCK / 64] |= 1 << (lane as usize / SKIP_BLOCK % 64);
            }
            let mut rings = [(); 2].map(|()| DelayRing::<S>::new(lanes, compact, marked.len(), 2));
            let [quiet, marking] = &mut rings;
            let fan_out = std::slice::from_ref(&fan_out);
            let events = ids.len() as u64 * synapses;
            let mut counts = vec![0; 300];
            assert_eq!(quiet.deliver::<false, _>(fan_out, (&ids, &mut counts), 1, 2), events);
            let is_counted = |source: usize| {
                let holds = |block: &DenseBlock| block.first as usize <= source && source < block.end as usize;
                source.is_multiple_of(every)
                    && fan_out[0].dense.blocks.iter().any(|block| holds(block) && block.narrow().is_some())
            };
            assert!(counts.iter().enumerate().all(|(source, &count)| count == u32::from(is_counted(source))));
            assert_eq!(marking.deliver::<true, _>(fan_out, (&ids, &mut []), 1, 2), events);
            // What would arrive after the last step is no event and is not delivered.
            let mut ended = DelayRing::<S>::new(lanes, compact, marked.len(), 2);
            assert_eq!(ended.deliver::<true, _>(fan_out, (&ids, &mut []), 1, 1), 0);
            assert!(ended.sums.iter().all(|sums| sums.iter().all(|sum| sum.value() == 0)));
            for ring in &rings {
                assert!(ring.sums[0][..lanes].iter().map(|sum| sum.value()).eq(sums.iter().copied()));
                assert!(ring.sums[1].iter().all(|sum| sum.value() == 0));
            }
            // A dense block marks all of its lanes.
            let missed = marked.iter().zip(&rings[1].arrivals[0]).any(|(&expected, &marked)| expected & !marked != 0);
            assert!(!missed && (rings[1].arrivals[0] == marked || fan_out[0].lists.is_none()));
        }
        fan_out
    }

    #[test]
    fn all_forms_deliver_the_same() {
        let blocks = compare::<i32>(1_024, 64, 100);
        assert!(blocks.lists.is_none() && !blocks.dense.blocks.is_empty());
        let whole = compare::<i16>(8_192, 70, 8_192);
        assert!(whole.dense.blocks.is_empty() && whole.lists.is_some());
        for wide in [compare::<i32>(16_384, 70, 16_384), compare::<i32>(70_016, 70, 70_000)] {
            assert!(wide.lists.is_some());
        }
        // Blocks of one chunk to four, and one that is no longer narrow.
        for chunks in 1..=5 {
            let lanes = chunks * LANES as u32;
            let blocks = compare::<i16>(lanes as usize, 30, lanes.into());
            assert!(blocks.lists.is_none());
            assert!(blocks.dense.blocks.iter().all(|block| block.ranges == [LaneRange { target: 0, chunks }]));
        }
    }
}
