//! Dense blocks: consecutive sources with synapses to the same lanes, one weight a lane, zeros
//! where there is no synapse.
//!
//! Input: the sources that become blocks (`planner`), and their synapses. Output: [`DenseBlocks`];
//! lists take the synapses outside blocks. Invariant: padding zeros are not counted as synapses;
//! the number of synapses is stored next to the weights.

use std::ops::Range;

use crate::lanes::kernel::LANES;
use crate::layout::planner::PlannedBlock;
use crate::store::Aligned;
use nsim_ir::spikes::Spike;

/// Consecutive lanes for which each source of a dense block has weights.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct LaneRange {
    /// The first lane, a multiple of sixteen.
    pub target: u32,
    /// Chunks of sixteen lanes.
    pub chunks: u32,
}

impl LaneRange {
    #[inline(always)]
    pub fn lanes(self) -> Range<usize> {
        self.target as usize..self.target as usize + self.chunks as usize * LANES
    }
}

/// Consecutive sources with weights for the same lanes. An all-to-all projection makes one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct DenseBlock {
    pub first: u32,
    /// The first source after it.
    pub end: u32,
    pub ranges: Vec<LaneRange>,
    /// Index of its first chunk of weights, which are ordered by source, then by range.
    pub weights: usize,
    /// Whether its weights have 8 bits, in an array of their own.
    pub bytes: bool,
    /// Number of chunks of each source.
    pub stride: usize,
    /// Synapses of each source, without padding.
    pub synapses: SynapseCounts,
}

/// Number of chunks whose sums fit the vector registers.
const NARROW: u32 = 4;

impl DenseBlock {
    /// Its only range, if its sums fit the vector registers.
    #[inline(always)]
    pub fn narrow(&self) -> Option<&LaneRange> {
        match self.ranges.as_slice() {
            [range @ LaneRange { chunks: 1..=NARROW, .. }] => Some(range),
            _ => None,
        }
    }

    /// Number of synapses of these sources of the block.
    #[inline(always)]
    pub fn synapses(&self, spikes: &[impl Spike]) -> u64 {
        match &self.synapses {
            SynapseCounts::Same(count) => u64::from(*count) * spikes.len() as u64,
            SynapseCounts::Each(counts) => {
                spikes.iter().map(|spike| u64::from(counts[spike.source() - self.first as usize])).sum()
            }
        }
    }

    /// Whether its sources have different numbers of synapses.
    pub fn is_uneven(&self) -> bool {
        matches!(self.synapses, SynapseCounts::Each(_))
    }

    /// Replaces the number of synapses of each source by their mean; adds each difference to
    /// `residual`, by source.
    pub fn use_mean(&mut self, residual: &mut [i32]) {
        let SynapseCounts::Each(counts) = &self.synapses else { return };
        let sum: u64 = counts.iter().map(|&count| u64::from(count)).sum();
        let mean = (sum / counts.len().max(1) as u64) as u32;
        for (&count, residual) in counts.iter().zip(&mut residual[self.first as usize..]) {
            *residual += count as i32 - mean as i32;
        }
        self.synapses = SynapseCounts::Same(mean);
    }
}

/// Numbers of synapses of a block's sources.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum SynapseCounts {
    /// One number for all.
    Same(u32),
    /// One number for each source, in order.
    Each(Vec<u32>),
}

/// The dense blocks of a fan-out; their sources do not overlap.
#[derive(Debug)]
pub(crate) struct DenseBlocks {
    /// In ascending order.
    pub blocks: Vec<DenseBlock>,
    weights: Aligned<i16>,
    bytes: Aligned<i8>,
}

/// Number of a block's weights from which on 8 bits are used if all weights fit, since a step then
/// waits for memory. A quarter of a second-level cache.
const BYTES_FROM: usize = 1 << 16;

impl DenseBlocks {
    /// The weights of blocks, in units of 64.
    #[inline(always)]
    pub fn weights(&self) -> &[[i16; LANES]] {
        self.weights.as_chunks().0
    }

    /// The weights of the blocks whose weights have 8 bits.
    #[inline(always)]
    pub fn bytes_of_weights(&self) -> &[[i8; LANES]] {
        self.bytes.as_chunks().0
    }

    /// Moves the weights of large blocks into 8 bits where they fit.
    fn narrowed(blocks: Vec<DenseBlock>, weights: Aligned<i16>) -> Self {
        let range = |block: &DenseBlock| {
            let chunks = block.stride * (block.end - block.first) as usize;
            LANES * block.weights..LANES * (block.weights + chunks)
        };
        let fits = |block: &DenseBlock| {
            let own = &weights[range(block)];
            block.narrow().is_none()
                && own.len() >= BYTES_FROM
                && own.iter().all(|&weight| i8::try_from(weight).is_ok())
        };
        let bytes: Vec<bool> = blocks.iter().map(fits).collect();
        let mut all = DenseBlocks { blocks, weights: Aligned::new(0), bytes: Aligned::new(0) };
        if !bytes.contains(&true) {
            all.weights = weights;
            return all;
        }
        let mut sizes = [0; 2];
        let ranges: Vec<Range<usize>> = all.blocks.iter().map(range).collect();
        for ((block, range), &bytes) in all.blocks.iter_mut().zip(&ranges).zip(&bytes) {
            let size = &mut sizes[usize::from(bytes)];
            (block.weights, block.bytes) = (*size / LANES, bytes);
            *size += range.len();
        }
        (all.weights, all.bytes) = (Aligned::new(sizes[0]), Aligned::new(sizes[1]));
        for (block, range) in all.blocks.iter().zip(ranges) {
            let (first, own) = (LANES * block.weights, &weights[range]);
            match block.bytes {
                true => all.bytes[first..].iter_mut().zip(own).for_each(|(byte, &weight)| *byte = weight as i8),
                false => all.weights[first..first + own.len()].copy_from_slice(own),
            }
        }
        all
    }

    /// A chunk of a source's weights.
    #[cfg(test)]
    fn chunk(&self, block: &DenseBlock, source: usize, chunk: usize) -> [i16; LANES] {
        let at = block.weights + source * block.stride + chunk;
        if block.bytes { self.bytes_of_weights()[at].map(i16::from) } else { self.weights()[at] }
    }

    /// Bytes of memory that they hold.
    pub fn bytes(&self) -> usize {
        let of = |block: &DenseBlock| {
            let counts =
                if let SynapseCounts::Each(counts) = &block.synapses { size_of_val(counts.as_slice()) } else { 0 };
            size_of::<DenseBlock>() + size_of_val(block.ranges.as_slice()) + counts
        };
        self.blocks.iter().map(of).sum::<usize>() + size_of_val(&*self.weights) + size_of_val(&*self.bytes)
    }
}

/// Writes the weights of planned blocks.
#[derive(Debug)]
pub(crate) struct BlockWriter {
    /// Blocks to write, the current one first.
    planned: std::iter::Peekable<std::vec::IntoIter<PlannedBlock>>,
    /// One more than the position of each chunk in a source's weights of the current block; 0 for
    /// chunks outside it.
    places: Vec<u32>,
    blocks: Vec<DenseBlock>,
    weights: Aligned<i16>,
    /// Chunks of weights up to the end of the current block.
    end: usize,
    /// Synapses of each source of the current block.
    counts: Vec<u32>,
}

impl BlockWriter {
    /// A writer of these blocks, ascending, for a shard with this many lanes.
    pub fn new(planned: Vec<PlannedBlock>, lanes: usize) -> Self {
        let size: usize = planned.iter().map(PlannedBlock::size).sum();
        BlockWriter {
            planned: planned.into_iter().peekable(),
            places: vec![0; lanes.div_ceil(LANES)],
            blocks: Vec::new(),
            weights: Aligned::new(size * LANES),
            end: 0,
            counts: Vec::new(),
        }
    }

    /// Whether no block is left to write.
    pub fn is_empty(&mut self) -> bool {
        self.planned.peek().is_none()
    }

    /// Writes a synapse; false if no block has a place for it. Sources come in ascending order.
    #[inline]
    pub fn put(&mut self, source: u32, lane: u32, weight: i16) -> bool {
        while self.planned.peek().is_some_and(|block| block.end <= source) {
            self.close();
        }
        let Some(block) = self.planned.peek().filter(|block| block.first <= source) else { return false };
        if self.counts.is_empty() {
            self.counts = vec![0; block.sources()];
            for (chunk, place) in block.chunks.iter().zip(1..) {
                self.places[*chunk as usize] = place;
            }
            self.end += block.size();
        }
        let (chunk, offset) = (lane as usize / LANES, lane as usize % LANES);
        let Some(place) = (self.places[chunk] as usize).checked_sub(1) else { return false };
        let at = (source - block.first) as usize;
        let begin = self.end - block.size() + at * block.chunks.len();
        let weight_of_lane = &mut self.weights[(begin + place) * LANES + offset];
        // Several synapses to one lane add up, as long as 16 bits hold the sum.
        let Some(sum) = weight_of_lane.checked_add(weight) else { return false };
        *weight_of_lane = sum;
        self.counts[at] += 1;
        true
    }

    /// Ends the current block.
    fn close(&mut self) {
        let Some(PlannedBlock { first, end, chunks, .. }) = self.planned.next() else { return };
        let mut ranges: Vec<LaneRange> = Vec::new();
        for &chunk in &chunks {
            self.places[chunk as usize] = 0;
            match ranges.last_mut() {
                Some(range) if range.target / LANES as u32 + range.chunks == chunk => range.chunks += 1,
                _ => ranges.push(LaneRange { target: chunk * LANES as u32, chunks: 1 }),
            }
        }
        let counts = std::mem::take(&mut self.counts);
        let stride = chunks.len();
        let weights = self.end - stride * (end - first) as usize;
        let synapses = match counts.first() {
            Some(&first) if counts.iter().all(|&count| count == first) => SynapseCounts::Same(first),
            _ => SynapseCounts::Each(counts),
        };
        self.blocks.push(DenseBlock { first, end, ranges, weights, bytes: false, stride, synapses });
    }

    pub fn finish(mut self) -> DenseBlocks {
        while self.planned.peek().is_some() {
            self.close();
        }
        self.blocks.shrink_to_fit();
        DenseBlocks::narrowed(self.blocks, self.weights)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::fan_out::FanOuts;
    use crate::layout::flatten::Flattened;
    use crate::layout::lists::LaneWeight;
    use nsim_ir::base::rng;
    use std::collections::BTreeMap;
    use std::sync::Arc;

    /// Checks that blocks and lists together hold each source's weights by lane and its number of
    /// synapses. Returns the dense blocks and the number of synapses in lists.
    fn laid_out(sources: &[Vec<LaneWeight>], lanes: usize) -> (DenseBlocks, usize) {
        let FanOuts { mut by_delay, lists: table } =
            FanOuts::new(vec![(0, Flattened::lists(sources, lanes))], &Arc::default(), lanes).unwrap();
        let blocks = by_delay.pop().map_or_else(|| BlockWriter::new(Vec::new(), lanes).finish(), |one| one.dense);
        assert!(blocks.blocks.is_sorted_by(|a, b| a.end <= b.first));
        let mut all_listed = 0;
        for (source, synapses) in (0u32..).zip(sources) {
            let (mut expected, mut held) = (BTreeMap::new(), BTreeMap::new());
            for &(lane, weight) in synapses {
                *expected.entry(lane).or_insert(0) += i32::from(weight);
            }
            let mut count = 0;
            let mut hold = |lane: usize, weight: i16| *held.entry(lane as u32).or_insert(0) += i32::from(weight);
            if let Some(table) = &table {
                let place = table.places[source as usize];
                count += place.len();
                all_listed += place.len();
                table.list(source as usize).into_iter().for_each(|(lane, weight)| hold(lane as usize, weight));
            }
            if let Some(block) = blocks.blocks.iter().find(|block| (block.first..block.end).contains(&source)) {
                let at = (source - block.first) as usize;
                count += match &block.synapses {
                    SynapseCounts::Same(count) => *count as usize,
                    SynapseCounts::Each(counts) => counts[at] as usize,
                };
                let mut chunks = (0..block.stride).map(|chunk| blocks.chunk(block, at, chunk));
                for range in &block.ranges {
                    for lane in (range.target as usize..).take(range.chunks as usize * LANES).step_by(LANES) {
                        let weights = chunks.next().unwrap().into_iter().zip(lane..);
                        weights.filter(|(weight, _)| *weight != 0).for_each(|(weight, lane)| hold(lane, weight));
                    }
                }
            }
            assert_eq!(count, synapses.len(), "source {source}");
            // In blocks a weight or sum of 0 is no different from padding.
            held.retain(|_, sum| *sum != 0);
            expected.retain(|_, sum| *sum != 0);
            assert_eq!(held, expected, "source {source}");
        }
        (blocks, all_listed)
    }

    /// Sources with a synapse to each of these lanes with probability `per_mille` / 1,000.
    fn some(sources: u64, lanes: Range<u32>, per_mille: u64) -> Vec<Vec<LaneWeight>> {
        let of = |source: u64, lane: u32| {
            let weight = rng::below(511, 2, source, lane.into()) as i16 - 255;
            (rng::below(1_000, 1, source, lane.into()) < per_mille).then_some((lane, weight))
        };
        (0..sources).map(|source| lanes.clone().filter_map(|lane| of(source, lane)).collect()).collect()
    }

    #[test]
    fn missing_synapses_break_no_block() {
        for per_mille in [1_000, 900, 600] {
            let mut sources = some(2_000, 0..62, per_mille);
            // Pruned channels have no synapses.
            for source in (100..1_900).filter(|k| per_mille < 1_000 && rng::below(4, 7, *k as u64, 0) == 0) {
                sources[source].clear();
            }
            let (blocks, listed) = laid_out(&sources, 64);
            assert_eq!((blocks.blocks.len(), listed), (1, 0), "{per_mille}");
            assert_eq!(blocks.blocks[0].ranges, [LaneRange { target: 0, chunks: 4 }]);
            assert_eq!(matches!(blocks.blocks[0].synapses, SynapseCounts::Same(62)), per_mille == 1_000);
            assert_eq!(blocks.weights().len(), 4 * blocks.blocks[0].end as usize);
        }
    }

    /// Large blocks have weights of 8 bits where all fit, others of 16.
    #[test]
    fn large_blocks_take_a_byte_a_weight() {
        let mut sources = some(600, 0..200, 1_000);
        sources.iter_mut().flatten().for_each(|(_, weight)| *weight >>= 1);
        sources.extend(vec![Vec::new(); 5_000]);
        sources.extend(some(600, 1_000..1_200, 1_000));
        sources.extend(some(300, 2_000..2_200, 1_000));
        let (blocks, listed) = laid_out(&sources, 3_000);
        let bytes: Vec<_> = blocks.blocks.iter().map(|block| (block.first, block.bytes)).collect();
        assert_eq!((bytes, listed), (vec![(0, true), (5_600, false), (6_200, false)], 0));
        assert_eq!((blocks.bytes.len(), blocks.weights.len()), (600 * 13 * LANES, 900 * 13 * LANES));
    }

    #[test]
    fn few_synapses_over_many_lanes_are_listed() {
        for (lanes, synapses) in [(20_000, 5), (20_000, 64), (2_000, 5), (2_000, 64)] {
            let lane = |source, index| rng::below(lanes, 1, source, index) as u32;
            let of = |source| (0..synapses).map(|index| (lane(source, index), 1)).collect();
            let (blocks, listed) = laid_out(&(0..10_000).map(of).collect::<Vec<_>>(), lanes as usize);
            assert_eq!((blocks.blocks.len(), listed), (0, 10_000 * synapses as usize), "{synapses} of {lanes}");
        }
    }

    /// In a network that fits the cache, chunks of zeros cost less than lists.
    #[test]
    fn few_synapses_over_few_lanes_are_dense() {
        let (blocks, listed) = laid_out(&some(500, 0..500, 100), 512);
        assert_eq!((blocks.blocks.len(), listed), (1, 0));
    }

    #[test]
    fn dense_targets_make_a_block_and_the_others_lists() {
        let far = |source| (0..50).map(|index| (1_000 + rng::below(49_000, 3, source, index) as u32, 1)).collect();
        let (near, far) = (some(3_000, 100..300, 950), (0..3_000).map(far).collect::<Vec<Vec<LaneWeight>>>());
        let sources: Vec<Vec<LaneWeight>> = near.into_iter().zip(far).map(|(near, far)| [near, far].concat()).collect();
        let (blocks, listed) = laid_out(&sources, 50_000);
        assert_eq!(blocks.blocks.len(), 1);
        assert_eq!(blocks.blocks[0].ranges, [LaneRange { target: 96, chunks: 13 }]);
        assert_eq!(listed, 50 * 3_000);
    }

    /// Blocks of different lanes stay separate, also with missing synapses.
    #[test]
    fn a_narrow_block_is_not_padded_to_a_wide_one() {
        for per_mille in [1_000, 800] {
            let wide = some(78, 0..50, per_mille);
            let sources: Vec<_> = wide.into_iter().chain(some(3_000, 64..74, per_mille)).collect();
            let (blocks, listed) = laid_out(&sources, 128);
            let shapes: Vec<_> = blocks.blocks.iter().map(|block| (block.first, block.end, block.stride)).collect();
            assert_eq!((shapes, listed), (vec![(0, 78, 4), (78, 3_078, 1)], 0));
        }
    }

    /// Sources with other targets, and distant sources, make blocks of their own.
    #[test]
    fn unlike_sources_share_no_block() {
        let mut sources = some(400, 0..200, 1_000);
        sources.extend(some(400, 1_000..1_200, 1_000));
        sources.extend(vec![Vec::new(); 5_000]);
        sources.extend(some(400, 1_000..1_200, 1_000));
        let (blocks, listed) = laid_out(&sources, 2_000);
        let ranges: Vec<_> = blocks.blocks.iter().map(|block| (block.first, block.end)).collect();
        assert_eq!((ranges, listed), (vec![(0, 400), (400, 800), (5_800, 6_200)], 0));
        assert_eq!(blocks.weights().len(), 1_200 * 13);
    }

    /// Targets that move from source to source, several synapses to one lane, and weights whose sum
    /// exceeds 16 bits.
    #[test]
    fn whatever_the_form_nothing_is_lost() {
        for seed in 0..40 {
            let draw = |below, source, index| rng::below(below, 10 + seed, source, index);
            let lanes = [64, 300, 5_000, 70_000][seed as usize % 4];
            let width = [lanes, 40, 200, 3][seed as usize / 4 % 4].min(lanes);
            let many = [3, 30, 300][seed as usize / 16 % 3];
            let of = |source, index| {
                let lane = (source * [0, 1, 7][seed as usize % 3] + draw(width, source, index)) % lanes;
                let weight = draw(1 << 16, source, index + 1_000) as i16 >> [0, 4, 8][seed as usize % 3];
                (lane as u32, weight)
            };
            let sources: Vec<Vec<LaneWeight>> = (0..300)
                .map(|source| (0..draw(many, source, 5_000)).map(|index| of(source, index)).collect())
                .collect();
            laid_out(&sources, lanes as usize);
        }
    }
}
