//! The synapses that the sources of one kind reach over one delay, in the form in which they are
//! delivered.
//!
//! Input: rows and synapses source after source ([`Flattened`]). Output: the rows, dense blocks,
//! and lists of the rest. Errors: more synapses than a list position can index.

use std::sync::Arc;

use crate::layout::delivery_cost::DeliveryParts;
use crate::layout::dense_blocks::{BlockWriter, DenseBlock, DenseBlocks};
use crate::layout::flatten::Flattened;
use crate::layout::lists::ListTable;
use crate::layout::planner::Planner;
use crate::layout::weight_rows::{RowTable, WeightRows};
use nsim_ir::base::id::{ChannelId, Id};

/// Synapses of one delay, from the channels or the compartments, into one shard.
#[derive(Debug)]
pub(crate) struct FanOut {
    /// Delay field.
    pub delay: u8,
    /// Synapses in rows of weights.
    pub rows: Option<RowTable>,
    /// Synapses in dense blocks.
    pub dense: DenseBlocks,
    /// The others.
    pub lists: Option<ListTable>,
}

impl FanOut {
    /// Chooses which of these synapses become dense; `None` when there are none. The shard has so
    /// many lanes.
    ///
    /// # Errors
    /// The number of synapses or rows, when positions do not fit.
    pub fn new(
        delay: u8,
        Flattened { lists: mut builder, rows }: Flattened,
        weights: &Arc<WeightRows>,
        lanes: usize,
    ) -> Result<Option<Self>, usize> {
        let mut planner = Planner::new(lanes);
        builder.each(|source, synapses| planner.take(source, synapses));
        let mut blocks = BlockWriter::new(planner.choose(), lanes);
        if !blocks.is_empty() {
            builder.retain(|source, lane, weight| !blocks.put(source, lane, weight));
        }
        let (rows, dense, lists) = (rows.finish(weights)?, blocks.finish(), builder.finish()?);
        let any = rows.is_some() || lists.is_some() || !dense.blocks.is_empty();
        Ok(any.then_some(FanOut { delay, rows, dense, lists }))
    }

    /// Whether one narrow dense block follows the other, from the first source to the last, and
    /// there is nothing else.
    pub fn is_narrow(&self, sources: u32) -> bool {
        let adjacent =
            |end: u32, block: &DenseBlock| Some(block.end).filter(|_| block.first == end && block.narrow().is_some());
        self.rows.is_none() && self.lists.is_none() && self.dense.blocks.iter().try_fold(0, adjacent) == Some(sources)
    }

    /// Adds what delivering these spikes, in ascending order, consists of.
    pub fn add_parts(&self, spikes: &[ChannelId], parts: &mut DeliveryParts) {
        for spike in spikes {
            if let Some(table) = &self.rows {
                let (_, places, rows) = table.stencil(table.origins[spike.index()]);
                parts.row += rows;
                parts.row_chunk += places[..rows].iter().map(|place| place.row().chunks()).sum::<usize>();
            }
            if let Some(table) = &self.lists {
                let synapses = table.places[spike.index()].len();
                parts.list += usize::from(synapses > 0);
                parts.synapse += synapses;
            }
        }
        for block in &self.dense.blocks {
            let first = spikes.partition_point(|spike| spike.0 < block.first);
            let sources = spikes[first..].partition_point(|spike| spike.0 < block.end);
            if sources > 0 {
                parts.block += 1;
                parts.range += block.ranges.len();
                parts.chunk += sources * block.stride;
            }
        }
    }

    /// Bytes of memory that it holds.
    pub fn bytes(&self) -> usize {
        let rows = self.rows.as_ref().map_or(0, RowTable::bytes);
        rows + self.dense.bytes() + self.lists.as_ref().map_or(0, ListTable::bytes)
    }
}
