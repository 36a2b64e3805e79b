//! Layout of the compartments of a shard, and their incoming synapses.
//!
//! A *core block* is consecutive compartments of one core. It starts at a multiple of sixteen
//! lanes, unless it is updated as vectors together with the block before it, of another core. A
//! *vector run* is core blocks that are updated together. A *skip block* is 64 lanes: it is updated
//! only if one of its compartments is not idle. Lanes without a compartment are padding. Weights of
//! dense blocks are padded with zeros to whole chunks, so that they change neither padding nor
//! neighbours.

use std::sync::Arc;

use crate::lanes::sums::Sum;
use crate::layout::fan_out::FanOuts;
use crate::layout::plastic::PlasticSynapses;
use nsim_dynamics::kinds::{CHUNK, Updater};
use nsim_ir::base::id::{CompartmentId, CoreId};

/// Number of lanes of a skip block.
pub const SKIP_BLOCK: usize = 64;

/// Compartments of a kind whose state is words.
#[derive(Debug)]
pub(crate) struct WordBlock {
    pub start: u32,
    /// Index of its first word among the words of the shard, in chunks.
    pub first: usize,
    pub updater: Arc<dyn Updater>,
    /// Number of bits of the values in its messages; 0 where all messages carry one payload.
    pub bits: u32,
    /// Shift of a step's arrivals toward minus infinity, in bits.
    pub shift: u8,
    /// The step from which periodic resets are counted.
    pub resets_from: u32,
    /// The sums of each compartment.
    pub sums: Vec<Sum>,
}

impl WordBlock {
    /// Number of chunks of its compartments.
    pub fn chunks(&self) -> usize {
        self.updater.lanes().div_ceil(CHUNK)
    }

    /// Range of its words among the words of the shard, in chunks.
    pub fn columns(&self) -> std::ops::Range<usize> {
        self.first..self.first + self.chunks() * self.updater.words()
    }
}

/// The parameters of a core block.
#[derive(Debug, Clone, Copy)]
pub(crate) enum BlockFields {
    /// One for all: an index into the image's `fields`.
    Same(u32),
    /// One index a lane, in `field_of` from this position on.
    Each(u32),
}

/// Consecutive compartments of one core within a skip block.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CoreBlock {
    pub start: u32,
    /// Number of compartments.
    pub length: u32,
    pub core: CoreId,
    pub fields: BlockFields,
    /// The parameters that all share but for the bias, if they can be updated as vectors.
    pub vector: Option<u32>,
    /// The earliest step from which one of its compartments is not held at zero.
    pub starts: u32,
    /// Index of the list of sums of compartments whose state is words.
    pub sums: u32,
    /// Whether the model states the price of an update of its kind.
    pub stated: bool,
}

/// Adjacent core blocks of a skip block that are updated together.
#[derive(Debug, Clone, Copy)]
pub(crate) struct VectorRun {
    /// Index of its first block.
    pub first: u32,
    /// Index of the first block after it.
    pub end: u32,
    /// Its first lane, a multiple of sixteen.
    pub start: u32,
    /// Number of its lanes, with padding up to the next multiple of sixteen.
    pub lanes: u32,
    /// The earliest step from which one of its compartments is not held at zero; all its blocks
    /// have the same fields.
    pub starts: u32,
    /// The parameters that all share but for the bias, if they can be updated as vectors; otherwise
    /// the run is one block.
    pub vector: Option<u32>,
    /// Whether all biases are 0, and v has the whole of its field.
    pub plain: bool,
    /// Its index among the blocks of words, if its state is words.
    pub words: Option<u32>,
    /// Its lanes without padding, one bit each.
    pub mask: u64,
}

/// The lanes that one thread updates, and their incoming synapses. Lanes are counted within the
/// shard.
#[derive(Debug, Default)]
pub(crate) struct Shard {
    /// Number of lanes, padding included.
    pub lanes: usize,
    /// The compartment in each lane; arbitrary in padding.
    pub compartments: Vec<CompartmentId>,
    /// Core blocks in order.
    pub blocks: Vec<CoreBlock>,
    /// Vector runs in order.
    pub vector_runs: Vec<VectorRun>,
    /// First vector run of each skip block, and the number of vector runs.
    pub skip_blocks: Vec<u32>,
    /// The bias of each lane, 0 in padding; empty if all vector runs are plain.
    pub biases: Vec<i32>,
    /// Skip blocks that are never idle, one bit each.
    pub driven: Vec<u64>,
    /// Skip blocks that are not idle before the first step, one bit each.
    pub wakes: Vec<u64>,
    /// Compartments whose state is words, by lane.
    pub words: Vec<WordBlock>,
    /// Synapses of channels.
    pub from_channels: FanOuts,
    /// Synapses of compartments.
    pub from_compartments: FanOuts,
    /// Synapses of both whose weights a run may change.
    pub plastic: PlasticSynapses,
}

impl Shard {
    /// Whether a list of synapses addresses lanes by 16 bits.
    pub fn has_compact_lists(&self) -> bool {
        let lists = [&self.from_channels, &self.from_compartments].map(|fan_outs| &fan_outs.lists);
        lists.into_iter().flatten().any(|table| table.synapses.is_compact())
    }

    /// Bytes of memory that it holds.
    pub fn bytes(&self) -> usize {
        size_of::<CoreBlock>() * self.blocks.len()
            + size_of_val(self.vector_runs.as_slice())
            + 4 * (self.skip_blocks.len() + self.compartments.len() + self.biases.len())
            + 16 * self.driven.len()
            + size_of_val(self.words.as_slice())
            + self.from_channels.bytes()
            + self.from_compartments.bytes()
            + self.plastic.bytes()
    }
}
