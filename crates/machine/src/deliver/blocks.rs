//! Delivery by dense blocks: the weights of a source are added to lanes, range by range.

use crate::deliver::accumulate::{Accumulate, add_weights};
use crate::deliver::delay_ring::DelayRing;
use crate::lanes::kernel::{LANES, Sum};
use crate::layout::dense_blocks::{DenseBlock, DenseBlocks, LaneRange};
use nsim_ir::spikes::Spike;

/// Spikes that delivery counts.
pub(crate) struct Counted<'a, P> {
    pub spikes: &'a [P],
    /// Counts by source of the spikes that reach narrow dense blocks; empty where none are counted.
    pub counts: &'a mut [u32],
}

impl<'a, P> Counted<'a, P> {
    /// Spikes that are not counted.
    pub fn not(spikes: &'a [P]) -> Self {
        Counted { spikes, counts: &mut [] }
    }
}

impl<S: Sum> DelayRing<S> {
    /// Delivers spikes, ascending, by the blocks of one delay into the slot of their arrival;
    /// returns the number of synaptic events.
    #[inline(always)]
    pub(super) fn deliver_dense<const MARK: bool, P: Spike>(
        &mut self,
        dense: &DenseBlocks,
        Counted { spikes, counts }: Counted<'_, P>,
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
                let of_block = Counted { spikes: rest, counts };
                let delivered = match range.chunks {
                    1 => self.deliver_narrow::<P, 1>(block, range, weights, of_block, slot),
                    2 => self.deliver_narrow::<P, 2>(block, range, weights, of_block, slot),
                    3 => self.deliver_narrow::<P, 3>(block, range, weights, of_block, slot),
                    _ => self.deliver_narrow::<P, 4>(block, range, weights, of_block, slot),
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

    /// Delivers spikes of a dense block's sources, four at a time. Their weights come from memory
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

    /// Delivers spikes of the sources of a dense block with one range of N chunks, up to the first
    /// spike of another source; returns the number of delivered spikes. The look-up of each
    /// source's weights finds the end, so that no search is needed.
    #[inline(always)]
    fn deliver_narrow<P: Spike, const N: usize>(
        &mut self,
        block: &DenseBlock,
        range: &LaneRange,
        weights: &[[i16; LANES]],
        Counted { spikes, counts }: Counted<'_, P>,
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
        // Two loops, so that neither tests in each iteration whether it counts. Slices of equal
        // length need one bound check.
        let delivered = match counts.get_mut(..weights.len()) {
            Some(counts) => add_sources::<true, _, _, N>(&mut kept, weights, counts, spikes, block.first as usize),
            None => add_sources::<false, _, _, N>(&mut kept, weights, &mut [], spikes, block.first as usize),
        };
        *sums = kept;
        delivered
    }
}

/// Number of spikes up to which counting is faster than a binary search.
const COUNTED: usize = 64;

/// Number of these spikes, ascending, that come before a source; often none or all.
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

/// Number of items before the first that `holds`; the first four are tested separately.
#[inline(always)]
fn first_at_least<T>(items: &[T], holds: impl Fn(&T) -> bool) -> usize {
    match items.iter().take(4).position(&holds) {
        Some(near) => near,
        None => items.partition_point(|item| !holds(item)),
    }
}

/// Adds the weights of each source to N chunks of sums, up to the first spike of a source without
/// weights; returns the number of spikes before it. Two spikes an iteration: with one, a third of
/// the instructions would be the loop's own.
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
