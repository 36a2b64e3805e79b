//! The planner: divides the synapses between dense blocks and lists.
//!
//! Input: the lanes that each source reaches over one delay, by source. Output: the dense blocks to
//! make ([`PlannedBlock`]). The choice minimises an estimate of the time and memory of delivery. A
//! chunk of sixteen lanes is added in less time than one listed synapse, so blocks pay even with
//! many zeros. But a chunk takes the memory of eight listed synapses or more. So blocks with many
//! zeros do not pay in networks that fit no cache.

use crate::lanes::kernel::LANES;
use crate::layout::delivery_cost::DELIVERY_COST as COST;
use crate::layout::padded_runs::{Packing, RunForm};

/// Bytes of a synapse in a list.
const LISTED: usize = Packing::SYNAPSE;
/// Bytes of a chunk.
const CHUNK_BYTES: usize = 2 * LANES;
/// Least number of synapses of a chunk that is worth its memory in a network beyond the cache: 6.4
/// bytes a synapse.
const DENSE: u32 = 5;
/// Bytes of weights that may be mostly zeros: half of a second-level cache.
const CACHED: usize = 1 << 20;
/// Number of steps in which each source spikes about once. Sources of a block that spike in one
/// step share its look-up.
const STEPS: usize = 20;
/// Chunks of zeros a source that may be added to join two blocks, by round: similar blocks join
/// first. The last costs as much as a block.
const ZEROS: [usize; 5] = [1, 3, 6, 12, (COST.block + COST.range) / COST.chunk];

/// Consecutive sources that become a dense block.
#[derive(Debug)]
pub(crate) struct PlannedBlock {
    pub first: u32,
    /// The first source after it.
    pub end: u32,
    /// Its chunks, ascending.
    pub chunks: Vec<u32>,
    /// Number of its sources' chunks that hold not only zeros.
    own: usize,
    /// Number of synapses in them.
    synapses: usize,
}

impl PlannedBlock {
    /// Number of sources.
    pub fn sources(&self) -> usize {
        (self.end - self.first) as usize
    }

    /// Number of chunks of all sources.
    pub fn size(&self) -> usize {
        self.sources() * self.chunks.len()
    }

    /// Cost when each source spikes once.
    fn cost(&self) -> usize {
        let ranges = self.chunks.chunk_by(|a, b| a + 1 == *b).count();
        self.size() * COST.chunk + self.sources().min(STEPS) * (COST.block + ranges * COST.range)
    }

    /// Joins the next block if that adds few zeros; returns the chunks of zeros added, or the next
    /// block. At most half of all chunks may be zeros, unless the join adds at most `spare`.
    fn join(&mut self, next: PlannedBlock, zeros: usize, spare: usize) -> Result<usize, PlannedBlock> {
        let sources = (next.end - self.first) as usize;
        let others = || next.chunks.iter().filter(|chunk| self.chunks.binary_search(chunk).is_err());
        let size = (self.chunks.len() + others().count()) * sources;
        let (own, more) = (self.own + next.own, size - self.size() - next.size());
        if more > zeros * self.sources().min(next.sources()).min(STEPS) || (size > 2 * own && more > spare) {
            return Err(next);
        }
        let others: Vec<u32> = others().copied().collect();
        self.chunks.extend(others);
        self.chunks.sort_unstable();
        (self.end, self.own, self.synapses) = (next.end, own, self.synapses + next.synapses);
        Ok(more)
    }
}

/// One division of the synapses between blocks and lists.
#[derive(Debug)]
struct Candidate {
    /// Least number of synapses of a chunk in a block.
    least: u32,
    blocks: Vec<PlannedBlock>,
    /// Number of chunks of all dense blocks.
    size: usize,
    /// Number of synapses in lists.
    listed: usize,
    /// Chunks of the current source.
    chunks: Vec<u32>,
}

impl Candidate {
    fn new(least: u32) -> Self {
        Candidate { least, blocks: Vec::new(), size: 0, listed: 0, chunks: Vec::new() }
    }

    fn take(&mut self, source: u32, touched: &[u32], counts: &[u32]) {
        let mut synapses = 0;
        self.chunks.clear();
        for &chunk in touched {
            let count = counts[chunk as usize];
            if count >= self.least {
                self.chunks.push(chunk);
                synapses += count as usize;
            } else {
                self.listed += count as usize;
            }
        }
        if self.chunks.is_empty() {
            return;
        }
        self.chunks.sort_unstable();
        self.size += self.chunks.len();
        if let Some(last) = self.blocks.last_mut()
            && last.end == source
            && last.chunks == self.chunks
        {
            (last.end, last.own) = (source + 1, last.own + self.chunks.len());
            last.synapses += synapses;
            return;
        }
        let (chunks, own) = (self.chunks.clone(), self.chunks.len());
        self.blocks.push(PlannedBlock { first: source, end: source + 1, chunks, own, synapses });
    }

    /// Joins neighbours where zeros cost less than another block.
    fn join(&mut self) {
        for zeros in ZEROS {
            let mut joined: Vec<PlannedBlock> = Vec::with_capacity(self.blocks.len());
            for mut next in self.blocks.drain(..) {
                if let Some(last) = joined.last_mut() {
                    let spare = (CACHED / CHUNK_BYTES).saturating_sub(self.size);
                    match last.join(next, zeros, spare) {
                        Ok(more) => {
                            self.size += more;
                            continue;
                        }
                        Err(back) => next = back,
                    }
                }
                joined.push(next);
            }
            self.blocks = joined;
        }
    }

    /// Bytes of the weights of all blocks.
    fn bytes(&self) -> usize {
        CHUNK_BYTES * self.size
    }

    /// Drops the blocks that cost more than lists would.
    fn drop_losses(&mut self) {
        let (listed, size) = (&mut self.listed, &mut self.size);
        self.blocks.retain(|block| {
            let keep = block.cost() <= block.synapses * COST.synapse + block.sources() * COST.list;
            *listed += if keep { 0 } else { block.synapses };
            *size -= if keep { 0 } else { block.size() };
            keep
        });
    }

    /// Cost when each source spikes once.
    fn cost(&self, sources: usize) -> usize {
        let lists = if self.listed > 0 { self.listed * COST.synapse + sources * COST.list } else { 0 };
        // Chunks that fit no second-level cache take twice as long.
        let waits = if self.bytes() > CACHED { self.size * COST.chunk } else { 0 };
        self.blocks.iter().map(PlannedBlock::cost).sum::<usize>() + waits + lists
    }
}

/// Divides the synapses of the sources of one kind and one delay.
#[derive(Debug)]
pub(crate) struct Planner {
    /// Synapses of the current source by chunk; zeros between sources.
    counts: Vec<u32>,
    /// Chunks with a synapse of the current source.
    touched: Vec<u32>,
    synapses: usize,
    sources: usize,
    /// All synapses in blocks, while these are not too large.
    dense_only: Option<Candidate>,
    /// Blocks where chunks are dense, lists elsewhere.
    mixed: Candidate,
}

impl Planner {
    /// A planner for a shard with `lanes` lanes.
    pub fn new(lanes: usize) -> Self {
        Planner {
            counts: vec![0; lanes.div_ceil(LANES)],
            touched: Vec::new(),
            synapses: 0,
            sources: 0,
            dense_only: Some(Candidate::new(1)),
            mixed: Candidate::new(DENSE),
        }
    }

    /// Adds a source and the lane of each of its synapses; sources come in ascending order.
    pub fn take(&mut self, source: u32, synapses: &[u32]) {
        for &lane in synapses {
            let chunk = lane / LANES as u32;
            let count = &mut self.counts[chunk as usize];
            if *count == 0 {
                self.touched.push(chunk);
            }
            *count += 1;
        }
        self.synapses += synapses.len();
        self.sources += usize::from(!synapses.is_empty());
        self.mixed.take(source, &self.touched, &self.counts);
        let most = self.most();
        if let Some(candidate) = &mut self.dense_only {
            candidate.take(source, &self.touched, &self.counts);
            // It is too large by far.
            if candidate.bytes() > 4 * most {
                self.dense_only = None;
            }
        }
        for chunk in self.touched.drain(..) {
            self.counts[chunk as usize] = 0;
        }
    }

    /// Maximum number of bytes of blocks without lists: a third-level cache, or four times the
    /// bytes of lists. Weights of 8 bits take half.
    fn most(&self) -> usize {
        (16 * CACHED).max(4 * LISTED * self.synapses)
    }

    /// The blocks of the cheapest candidate, ascending.
    pub fn choose(mut self) -> Vec<PlannedBlock> {
        self.mixed.join();
        self.mixed.drop_losses();
        let (most, cost) = (self.most(), self.mixed.cost(self.sources));
        let dense_only = self.dense_only.take().filter(|candidate| candidate.bytes() <= most).map(|mut candidate| {
            candidate.join();
            candidate
        });
        let cheaper = |candidate: &Candidate| candidate.bytes() <= most && candidate.cost(self.sources) <= cost;
        let chosen = dense_only.filter(cheaper).unwrap_or(self.mixed);
        tracing::debug!(
            "{} synapses: {} listed, {} dense blocks of {} bytes",
            self.synapses,
            chosen.listed,
            chosen.blocks.len(),
            chosen.bytes()
        );
        chosen.blocks
    }
}
