//! Synapses of the sources of one kind into a shard, in the forms in which they are delivered.
//!
//! Input: rows and synapses by source ([`Flattened`]), by delay. Output: rows and dense blocks by
//! delay, and for each source one list of its other synapses, of any delay. Errors: more synapses
//! than a list position can index.

use std::sync::Arc;

use rayon::prelude::*;

use crate::layout::delivery_cost::DeliveryParts;
use crate::layout::dense_blocks::{BlockWriter, DenseBlock, DenseBlocks};
use crate::layout::flatten::Flattened;
use crate::layout::lists::{ListBuilder, ListTable};
use crate::layout::planner::Planner;
use crate::layout::weight_rows::{RowTable, WeightRows};
use nsim_ir::base::id::{ChannelId, Id};

/// Synapses of the channels or the compartments into one shard.
#[derive(Debug, Default)]
pub(crate) struct FanOuts {
    /// Synapses in rows and dense blocks, by ascending delay.
    pub by_delay: Vec<FanOut>,
    /// All other synapses.
    pub lists: Option<ListTable>,
}

impl FanOuts {
    /// The synapses of each of these delays, ascending, into a shard with this many lanes.
    ///
    /// # Errors
    /// The number of synapses or rows, when positions do not fit.
    pub fn new(delays: Vec<(u8, Flattened)>, weights: &Arc<WeightRows>, lanes: usize) -> Result<Self, usize> {
        let made = delays.into_par_iter().map(|(delay, flattened)| FanOut::new(delay, flattened, weights, lanes));
        let (by_delay, lists): (Vec<_>, Vec<_>) = made.collect::<Result<Vec<_>, usize>>()?.into_iter().unzip();
        Ok(FanOuts { by_delay: by_delay.into_iter().flatten().collect(), lists: ListTable::new(lists, lanes)? })
    }

    /// Whether adjacent narrow dense blocks of one delay cover all sources, and there is nothing
    /// else.
    pub fn is_narrow(&self, sources: u32) -> bool {
        self.lists.is_none() && matches!(self.by_delay.as_slice(), [one] if one.is_narrow(sources))
    }

    /// Adds the parts of the delivery of these spikes, which are ascending.
    pub fn add_parts(&self, spikes: &[ChannelId], parts: &mut DeliveryParts) {
        self.by_delay.iter().for_each(|fan_out| fan_out.add_parts(spikes, parts));
        for place in self.lists.iter().flat_map(|table| spikes.iter().map(|spike| table.places[spike.index()])) {
            parts.list += usize::from(place.len() > 0);
            parts.synapse += place.len();
        }
    }

    /// Bytes of memory that they hold.
    pub fn bytes(&self) -> usize {
        self.by_delay.iter().map(FanOut::bytes).sum::<usize>() + self.lists.as_ref().map_or(0, ListTable::bytes)
    }
}

/// Synapses of one delay in rows and dense blocks.
#[derive(Debug)]
pub(crate) struct FanOut {
    /// Delay field.
    pub delay: u8,
    /// Synapses in rows of weights.
    pub rows: Option<RowTable>,
    /// Synapses in dense blocks.
    pub dense: DenseBlocks,
}

impl FanOut {
    /// Chooses the synapses that become dense, in a shard with `lanes` lanes; lists take the
    /// others.
    fn new(
        delay: u8,
        Flattened { lists: mut builder, rows }: Flattened,
        weights: &Arc<WeightRows>,
        lanes: usize,
    ) -> Result<(Option<Self>, (u8, ListBuilder)), usize> {
        let mut planner = Planner::new(lanes);
        builder.each(|source, synapses| planner.take(source, synapses));
        let mut blocks = BlockWriter::new(planner.choose(), lanes);
        if !blocks.is_empty() {
            builder.retain(|source, lane, weight| !blocks.put(source, lane, weight));
        }
        let (rows, dense) = (rows.finish(weights)?, blocks.finish());
        let any = rows.is_some() || !dense.blocks.is_empty();
        Ok((any.then_some(FanOut { delay, rows, dense }), (delay, builder)))
    }

    /// [`FanOuts::is_narrow`] of this delay.
    fn is_narrow(&self, sources: u32) -> bool {
        let adjacent =
            |end: u32, block: &DenseBlock| Some(block.end).filter(|_| block.first == end && block.narrow().is_some());
        self.rows.is_none() && self.dense.blocks.iter().try_fold(0, adjacent) == Some(sources)
    }

    /// [`FanOuts::add_parts`] of this delay.
    fn add_parts(&self, spikes: &[ChannelId], parts: &mut DeliveryParts) {
        if let Some(table) = &self.rows {
            for spike in spikes {
                let (_, places, rows) = table.stencil(table.origins[spike.index()]);
                parts.row += rows;
                parts.row_chunk += places[..rows].iter().map(|place| place.row().range().len()).sum::<usize>();
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
    fn bytes(&self) -> usize {
        self.rows.as_ref().map_or(0, RowTable::bytes) + self.dense.bytes()
    }
}
