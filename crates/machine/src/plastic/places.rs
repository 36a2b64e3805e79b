//! Places of the plastic synapses of a network's projections in the state of a run.
//!
//! Input: an [`Image`] and its network, or one of several copies in it. Output: for each plastic
//! projection of the network the place of each synapse, by copy and by number.

use std::collections::HashMap;

use crate::layout::image::Image;
use nsim_ir::base::id::ProjectionId;
use nsim_ir::quantised::Quantised;
use nsim_ir::quantised::connectivity::SynapseFormat;

/// Place of a synapse's weight: its shard, and the index among the shard's weights; `None` where
/// another rank has it.
pub type PlasticPlace = Option<(u32, u32)>;

/// A plastic projection in the state of a run.
#[derive(Debug, Clone)]
pub struct PlasticProjection {
    /// Its id in the network.
    pub id: ProjectionId,
    /// `source -> target`.
    pub name: String,
    /// The format of its weights.
    pub format: SynapseFormat,
    /// Place of each synapse, by copy of the network.
    pub places: Vec<Vec<PlasticPlace>>,
}

impl PlasticProjection {
    /// The plastic projections of a network, of which an image has `copies` copies, ascending.
    pub fn all(image: &Image, one: &Quantised, copies: u32) -> Vec<Self> {
        let each = one.plastic().count();
        let found = one.plastic().enumerate().map(|(index, (id, projection))| {
            let rows = projection.plastic.as_ref().map_or(&[][..], |plastic| &plastic.rows);
            let of_copy = |copy: u32| places(image, copy as usize * each + index, rows);
            let places = (0..copies).map(of_copy).collect();
            PlasticProjection { id, name: projection.name.clone(), format: projection.format, places }
        });
        found.collect()
    }
}

/// The places of the synapses of the image's plastic projection of this index, which have these
/// rows.
fn places(image: &Image, index: usize, rows: &[u32]) -> Vec<PlasticPlace> {
    let mut by_row = HashMap::new();
    for (shard, of_shard) in (0..).zip(&image.shards) {
        let firsts = &of_shard.plastic.projections[index].firsts;
        for place in firsts[0]..firsts[firsts.len() - 1] {
            by_row.insert(of_shard.plastic.row_of[place as usize], (shard, place));
        }
    }
    rows.iter().map(|row| by_row.get(row).copied()).collect()
}
