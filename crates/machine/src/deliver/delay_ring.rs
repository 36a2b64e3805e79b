//! The delay ring: sums of arrivals by step and lane, and the delivery of spikes into them.
//!
//! Input: spikes, and the dense blocks and lists of their synapses. Output: sums of weights in
//! units of 64, the skip blocks that they lie in, and the number of synaptic events.

use crate::bits::ones;
use crate::deliver::accumulate::{Accumulate, add_weights};
use crate::deliver::rows::RowDelivery;
use std::ops::Range;

use crate::layout::dense_blocks::{DenseBlock, DenseBlocks, LaneRange};
use crate::layout::fan_out::FanOuts;
use crate::layout::lists::{ADDRESSED, ListForm, ListTable};
use crate::layout::shard::SKIP_BLOCK;
use crate::layout::store::Aligned;
use crate::layout::weight_rows::RowPlace;
use crate::update::kernel::{LANES, Sum};
use nsim_ir::spikes::Spike;

/// Arrivals of the coming steps, a slot each.
#[derive(Debug)]
pub(crate) struct DelayRing<S> {
    /// Lanes of the shard, whole skip blocks.
    lanes: usize,
    /// Sums in units of 64, slot by slot.
    sums: Aligned<S>,
    /// Skip blocks with arrivals, slot by slot: 1, else 0. Bytes, since marks within a word would
    /// wait for each other.
    marks: Vec<u8>,
    /// Slots of which every skip block may have arrivals.
    marked: Vec<bool>,
    /// Scratch memory.
    queue: Vec<u32>,
    rows: Vec<RowPlace>,
}

impl<S: Sum> Clone for DelayRing<S> {
    fn clone(&self) -> Self {
        self.in_type()
    }
}

/// The skip blocks of a slot with arrivals.
pub(crate) struct Arrivals<'a> {
    marks: &'a mut [u8],
    all: bool,
}

impl Arrivals<'_> {
    /// A word of them, a bit each, which are forgotten.
    #[inline(always)]
    pub fn take(&mut self, word: usize) -> u64 {
        let end = self.marks.len().min(64 * word + 64);
        let marks = &mut self.marks[64 * word..end];
        if self.all {
            return ones(marks.len());
        }
        if marks.iter().fold(0, |any, mark| any | mark) == 0 {
            return 0;
        }
        let set = marks.iter().rev().fold(0, |set, &mark| set << 1 | u64::from(mark));
        marks.fill(0);
        set
    }
}

impl<S: Sum> DelayRing<S> {
    /// The same with sums of this type.
    pub fn in_type<T: Sum + From<S>>(&self) -> DelayRing<T> {
        // Untouched pages stay untouched.
        let mut sums = Aligned::new(self.sums.len());
        let all = self.lanes * self.slots();
        sums[..all].iter_mut().zip(&self.sums[..all]).for_each(|(to, &sum)| *to = sum.into());
        let (marks, marked) = (self.marks.clone(), self.marked.clone());
        DelayRing { lanes: self.lanes, sums, marks, marked, queue: Vec::new(), rows: Vec::new() }
    }

    /// An empty ring of this many lanes and slots; `compact` if a list of the shard is.
    pub fn new(lanes: usize, compact: bool, slots: usize) -> Self {
        // What lies beyond the slots is untouched pages, which the OS never commits.
        // The last chunk of a row may reach beyond the lanes too, where it adds zeros.
        let spare = if compact { ADDRESSED } else { LANES };
        DelayRing {
            lanes,
            sums: Aligned::new(lanes * slots + spare),
            marks: vec![0; lanes / SKIP_BLOCK * slots],
            marked: vec![false; slots],
            queue: Vec::new(),
            rows: Vec::new(),
        }
    }

    /// Slots.
    #[inline(always)]
    pub fn slots(&self) -> usize {
        self.marked.len()
    }

    /// Bytes of memory that it holds.
    pub fn bytes(&self) -> usize {
        size_of::<S>() * self.lanes * self.slots()
            + self.marks.len()
            + 4 * self.queue.capacity()
            + size_of::<RowPlace>() * self.rows.capacity()
    }

    /// Empties the ring.
    pub fn clear(&mut self) {
        let end = self.lanes * self.slots();
        self.sums[..end].fill(S::default());
        self.marks.fill(0);
        self.marked.fill(false);
    }

    /// Whether nothing is in flight.
    pub fn is_empty(&self) -> bool {
        !self.marked.contains(&true) && self.marks.iter().all(|&mark| mark == 0)
    }

    /// Marks all skip blocks as having arrivals, in every slot.
    #[inline(always)]
    pub fn mark_all(&mut self) {
        self.marked.fill(true);
    }

    /// The sums and the arrivals of a slot, which are taken from it.
    #[inline(always)]
    pub fn take(&mut self, slot: usize) -> (&mut [S], Arrivals<'_>) {
        let blocks = self.lanes / SKIP_BLOCK;
        let marks = &mut self.marks[slot * blocks..(slot + 1) * blocks];
        let all = std::mem::take(&mut self.marked[slot]);
        if all {
            marks.fill(0);
        }
        (&mut self.sums[slot * self.lanes..(slot + 1) * self.lanes], Arrivals { marks, all })
    }

    /// The first lane of the slot of a delay.
    #[inline(always)]
    fn slot(&self, cursor: usize, delay: u8) -> usize {
        let slot = cursor + usize::from(delay);
        self.lanes * if slot >= self.slots() { slot - self.slots() } else { slot }
    }

    /// Marks the skip blocks of these lanes of a slot.
    #[inline(always)]
    fn mark(&mut self, slot: usize, lanes: Range<usize>) {
        self.marks[(slot + lanes.start) / SKIP_BLOCK..(slot + lanes.end).div_ceil(SKIP_BLOCK)].fill(1);
    }

    /// Delivers spikes of channels or of compartments, ascending if there are dense blocks, and
    /// with `MARK` marks where they arrive. Returns the synaptic events that fall within `left`
    /// steps. Spikes that reach narrow dense blocks are counted in `counts` by source, unless it
    /// is empty.
    #[inline(always)]
    pub fn deliver<const MARK: bool, P: Spike>(
        &mut self,
        fan_outs: &FanOuts,
        (spikes, counts): (&[P], &mut [u32]),
        (cursor, left): (usize, u32),
        arch: pulp::Arch,
    ) -> u64
    where
        S: Accumulate<P::Payload>,
    {
        let mut events = 0;
        for fan_out in &fan_outs.by_delay {
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
            if let Some(table) = &fan_out.rows {
                let DelayRing { lanes, sums, marks, rows: queue, .. } = self;
                let (sums, marks) = (&mut sums[slot..], if MARK { &mut marks[slot / SKIP_BLOCK..] } else { &mut [] });
                synapses += RowDelivery { lanes: *lanes, sums, marks, table, spikes, queue }.run(arch);
            }
            events += if arrives { synapses } else { 0 };
        }
        if let Some(lists) = fan_outs.lists.as_ref().filter(|lists| u32::from(lists.shortest) < left) {
            let some = lists.few.as_ref().map(|few| with_list(few, spikes));
            let spikes = some.as_deref().unwrap_or(spikes);
            events += match size_of::<P::Payload>() {
                0 => self.deliver_lists::<MARK, P>(lists, spikes, cursor, left),
                _ => self.deliver_graded_lists::<MARK, P>(lists, spikes, cursor, left),
            };
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
                    self.mark(slot, range.lanes());
                }
                events += block.synapses(spiking);
                continue;
            }
            let (spiking, after) = rest.split_at(before(rest, block.end));
            rest = after;
            if !spiking.is_empty() {
                events += match block.bytes {
                    true => self.deliver_wide::<MARK, _, P>(block, dense.bytes_of_weights(), spiking, slot),
                    false => self.deliver_wide::<MARK, _, P>(block, weights, spiking, slot),
                };
            }
        }
        events
    }

    /// Delivers spikes of a dense block's sources, four at a time: their weights come from memory
    /// in order, and sums are loaded and stored once for all four.
    #[inline(always)]
    fn deliver_wide<const MARK: bool, W: Copy + Into<i16>, P: Spike>(
        &mut self,
        block: &DenseBlock,
        weights: &[[W; LANES]],
        spikes: &[P],
        slot: usize,
    ) -> u64
    where
        S: Accumulate<P::Payload>,
    {
        if MARK {
            block.ranges.iter().for_each(|range| self.mark(slot, range.lanes()));
        }
        let (fours, rest) = spikes.as_chunks::<4>();
        // Closures would not be compiled for the processor's vectors.
        for four in fours {
            self.add_together(block, weights, four, slot);
        }
        for one in rest {
            self.add_together(block, weights, std::array::from_ref(one), slot);
        }
        block.synapses(spikes)
    }

    /// Adds the weights of these sources of a dense block.
    #[inline(always)]
    fn add_together<W: Copy + Into<i16>, P: Spike, const N: usize>(
        &mut self,
        block: &DenseBlock,
        weights: &[[W; LANES]],
        spikes: &[P; N],
        slot: usize,
    ) where
        S: Accumulate<P::Payload>,
    {
        let first = |spike: &P| block.weights + (spike.source() - block.first as usize) * block.stride;
        let sources: [&[[W; LANES]]; N] = spikes.each_ref().map(|spike| &weights[first(spike)..][..block.stride]);
        let mut done = 0;
        for range in &block.ranges {
            let lanes = range.lanes();
            let (sums, _) = self.sums[slot + lanes.start..slot + lanes.end].as_chunks_mut::<LANES>();
            let sources = sources.map(|source| &source[done..done + sums.len()]);
            for (chunk, sums) in sums.iter_mut().enumerate() {
                let mut kept = *sums;
                for (source, spike) in sources.iter().zip(spikes) {
                    let (weights, payload) = (&source[chunk], spike.payload());
                    for lane in 0..LANES {
                        kept[lane] = kept[lane].accumulate(weights[lane].into(), payload);
                    }
                }
                *sums = kept;
            }
            done += sums.len();
        }
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
        let (sums, _) = self.sums[slot + range.target as usize..].as_chunks_mut::<LANES>();
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

    /// As [`DelayRing::deliver_lists`], not compiled again for each processor's vectors: it is a
    /// third of the code of a step.
    #[inline(never)]
    fn deliver_graded_lists<const MARK: bool, P: Spike>(
        &mut self,
        table: &ListTable,
        spikes: &[P],
        cursor: usize,
        left: u32,
    ) -> u64
    where
        S: Accumulate<P::Payload>,
    {
        self.deliver_lists::<MARK, P>(table, spikes, cursor, left)
    }

    #[inline(always)]
    fn deliver_lists<const MARK: bool, P: Spike>(
        &mut self,
        table: &ListTable,
        spikes: &[P],
        cursor: usize,
        left: u32,
    ) -> u64
    where
        S: Accumulate<P::Payload>,
    {
        let (slot, end) = (self.slot(cursor, table.shortest), self.lanes * self.slots());
        // Synapses that arrive after the end come last.
        let late = u32::from(table.longest) >= left;
        let below = if late { (left - u32::from(table.shortest)) as usize * self.lanes } else { usize::MAX };
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

/// Adds to the sum of a target, and marks its skip block; targets are counted from `slot` on, around
/// the ring's end.
#[inline(always)]
fn add_to<const MARK: bool, S: Accumulate<Y>, Y>(
    sums: &mut [S],
    marks: &mut [u8],
    (slot, end): (usize, usize),
) -> impl FnMut(usize, i16, Y) {
    move |target, weight, payload| {
        // The smaller one, as no target is negative.
        let at = (target + slot).min((target + slot).wrapping_sub(end));
        sums[at] = sums[at].accumulate(weight, payload);
        if MARK {
            marks[at / SKIP_BLOCK] = 1;
        }
    }
}

/// The same for lanes of 16 bits: there is a sum for each, so that no bound is checked.
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

/// The spikes of sources that have a bit.
#[inline(never)]
fn with_list<P: Spike>(few: &[u64], spikes: &[P]) -> Vec<P> {
    let has_list = |spike: &&P| few[spike.source() / 64] >> (spike.source() % 64) & 1 == 1;
    spikes.iter().filter(has_list).copied().collect()
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::flatten::Flattened;
    use crate::layout::lists::LaneWeight;
    use nsim_ir::base::id::{ChannelId, Id};
    use nsim_ir::base::rng;

    /// Sums, marked skip blocks and numbers of synapses are those of adding one synapse after the
    /// other.
    fn compare<S: Sum>(lanes: usize, synapses: u64, width: u64) -> FanOuts {
        let of = |source: u64, index| {
            let lane = (source * 17 + rng::below(width, 1, source, index)) % lanes as u64;
            (lane as u32, rng::below(255, 2, source, index) as i16 - 127)
        };
        let sources: Vec<Vec<LaneWeight>> =
            (0..300).map(|source| (0..synapses).map(|index| of(source, index)).collect()).collect();
        let flattened = vec![(1, Flattened::lists(&sources, lanes))];
        let fan_outs = FanOuts::new(flattened, &std::sync::Arc::default(), lanes).unwrap();
        let lanes = lanes.next_multiple_of(SKIP_BLOCK);
        let compact = fan_outs.lists.as_ref().is_some_and(|table| table.synapses.is_compact());
        let arch = pulp::Arch::new();
        for every in [1, 3, 50] {
            let ids: Vec<ChannelId> = (0..300).step_by(every).map(ChannelId::new).collect();
            let (mut sums, mut marked) = (vec![0; lanes], vec![0; lanes / SKIP_BLOCK]);
            for &(lane, weight) in ids.iter().flat_map(|id| &sources[id.index()]) {
                sums[lane as usize] += i32::from(weight);
                marked[lane as usize / SKIP_BLOCK] = 1;
            }
            let mut rings = [(); 2].map(|()| DelayRing::<S>::new(lanes, compact, 2));
            let [quiet, marking] = &mut rings;
            let events = ids.len() as u64 * synapses;
            let mut counts = vec![0; 300];
            assert_eq!(quiet.deliver::<false, _>(&fan_outs, (&ids, &mut counts), (1, 2), arch), events);
            let is_counted = |source: usize| {
                let holds = |block: &DenseBlock| block.first as usize <= source && source < block.end as usize;
                let mut blocks = fan_outs.by_delay.iter().flat_map(|fan_out| &fan_out.dense.blocks);
                source.is_multiple_of(every) && blocks.any(|block| holds(block) && block.narrow().is_some())
            };
            assert!(counts.iter().enumerate().all(|(source, &count)| count == u32::from(is_counted(source))));
            assert_eq!(marking.deliver::<true, _>(&fan_outs, (&ids, &mut []), (1, 2), arch), events);
            // What would arrive after the last step is no event and is not delivered.
            let mut ended = DelayRing::<S>::new(lanes, compact, 2);
            assert_eq!(ended.deliver::<true, _>(&fan_outs, (&ids, &mut []), (1, 1), arch), 0);
            assert!(ended.is_empty() && ended.sums.iter().all(|sum| sum.value() == 0));
            for ring in &rings {
                assert!(ring.sums[..lanes].iter().map(|sum| sum.value()).eq(sums.iter().copied()));
                assert!(ring.sums[lanes..].iter().all(|sum| sum.value() == 0));
            }
            // A dense block marks all of its lanes.
            let missed = marked.iter().zip(&rings[1].marks).any(|(&expected, &marked)| expected > marked);
            assert!(!missed && (rings[1].marks[..marked.len()] == marked || fan_outs.lists.is_none()));
        }
        fan_outs
    }

    /// Lists of several delays, from any step of the ring, until the end of a sample and before.
    #[test]
    fn delays_lead_around_the_ring_and_not_beyond_the_end() {
        const SLOTS: usize = 8;
        let (lanes, delays, arch) = (20_032, [2u8, 3, 7], pulp::Arch::new());
        for heaviest in [100, 30_000] {
            let of = |delay: u8, source: u64, index| {
                let weight = (rng::below(2 * heaviest, 2, source, index) as i64 - heaviest as i64) as i16;
                (rng::below(lanes as u64, u64::from(delay), source, index) as u32, weight)
            };
            let lists: Vec<(u8, Vec<Vec<LaneWeight>>)> = delays
                .map(|delay| {
                    let of =
                        |source| (0..source % 9 + u64::from(delay)).map(|index| of(delay, source, index)).collect();
                    (delay, (0..90).map(of).collect())
                })
                .into();
            let flattened = lists.iter().map(|(delay, lists)| (*delay, Flattened::lists(lists, lanes)));
            let fan_outs = FanOuts::new(flattened.collect(), &std::sync::Arc::default(), lanes).unwrap();
            assert!(fan_outs.by_delay.is_empty());
            let split = matches!(fan_outs.lists.as_ref().unwrap().synapses, ListForm::Split(_));
            assert_eq!(split, heaviest > 16_384);
            let ids: Vec<ChannelId> = (0..90).step_by(3).map(ChannelId::new).collect();
            for (cursor, left) in (0..SLOTS).flat_map(|cursor| (0..10).map(move |left| (cursor, left))) {
                let mut ring = DelayRing::<i32>::new(lanes, false, SLOTS);
                let (mut sums, mut events) = (vec![0; lanes * SLOTS], 0);
                for (delay, lists) in lists.iter().filter(|(delay, _)| u32::from(*delay) < left) {
                    let first = (cursor + usize::from(*delay)) % SLOTS * lanes;
                    for &(lane, weight) in ids.iter().flat_map(|id| &lists[id.index()]) {
                        sums[first + lane as usize] += i32::from(weight);
                        events += 1;
                    }
                }
                assert_eq!(ring.deliver::<true, _>(&fan_outs, (&ids, &mut []), (cursor, left), arch), events);
                assert_eq!(&ring.sums[..lanes * SLOTS], &sums);
                let reached = |block: &[i32]| u8::from(block.iter().any(|&sum| sum != 0));
                assert!(sums.chunks(SKIP_BLOCK).map(reached).zip(&ring.marks).all(|(sum, &mark)| sum <= mark));
                assert_eq!(ring.is_empty(), events == 0);
            }
        }
    }

    #[test]
    fn all_forms_deliver_the_same() {
        let blocks = compare::<i32>(1_024, 64, 100);
        assert!(blocks.lists.is_none() && !blocks.by_delay[0].dense.blocks.is_empty());
        let whole = compare::<i16>(8_192, 70, 8_192);
        assert!(whole.by_delay.is_empty() && whole.lists.is_some());
        for wide in [compare::<i32>(16_384, 70, 16_384), compare::<i32>(70_016, 70, 70_000)] {
            assert!(wide.lists.is_some());
        }
        // Blocks of one chunk to four, and one that is no longer narrow.
        for chunks in 1..=5 {
            let lanes = chunks * LANES as u32;
            let blocks = compare::<i16>(lanes as usize, 30, lanes.into());
            assert!(blocks.lists.is_none());
            assert!(
                blocks.by_delay[0].dense.blocks.iter().all(|block| block.ranges == [LaneRange { target: 0, chunks }])
            );
        }
    }
}
