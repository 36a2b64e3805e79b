//! Places of the plastic synapses of a network's projections in the state of a run.
//!
//! Input: an [`Image`] and its network, or one of several copies in it. Output: for each plastic
//! projection the place of each synapse, by source, in the order of [`Enumerate::for_each_from`].
//! The tables of cores name no projections. A synapse is identified by source, target, delay and
//! format, which two plastic projections never share. Several synapses with these in common are
//! identified by their weight before the first step. Synapses of equal weight are interchangeable.

use crate::layout::image::Image;
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::id::{CompartmentId, ProjectionId};
use nsim_ir::quantised::connectivity::SynapseFormat;
use nsim_ir::quantised::{Projection, Quantised, Units};

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
        let found = one.plastic().map(|(id, projection)| {
            let places = (0..copies).map(|copy| places(image, one, projection, copy)).collect();
            PlasticProjection { id, name: projection.name.clone(), format: projection.format, places }
        });
        found.collect()
    }
}

/// The places of a projection's synapses in a copy.
fn places(image: &Image, one: &Quantised, projection: &Projection, copy: u32) -> Vec<PlasticPlace> {
    let (source, target) = (&one.populations()[projection.source], &one.populations()[projection.target]);
    let later = copy * one.compartments();
    let first_source = match source.units {
        Units::Input(first) => first.0 + copy * one.channels(),
        Units::Compartments { first, .. } => image.channels + first.0 + later,
    };
    let targets = target.first_compartment().map_or(0, |first| first.0) + later;
    let targets = targets..targets + target.shape.len();
    let mut all = Vec::new();
    for index in 0..source.shape.len() {
        let (mut own, mut stored) = (Vec::new(), Vec::new());
        projection.connectivity.for_each_from(index, |target, weight| {
            own.push((CompartmentId(targets.start + target), weight, all.len()));
            all.push(None);
        });
        own.retain(|(target, ..)| image.is_local(*target));
        own.sort_unstable();
        for (shard, of_shard) in (0..).zip(&image.shards) {
            for (place, synapse) in of_shard.plastic.synapses((first_source + index) as usize) {
                let ends = synapse.delay == projection.delay.get() && targets.contains(&synapse.target.0);
                if ends && synapse.format == projection.format {
                    stored.push((synapse.target, of_shard.plastic.weights[place], (shard, place as u32)));
                }
            }
        }
        stored.sort_unstable();
        debug_assert!(own.iter().map(|own| (own.0, own.1)).eq(stored.iter().map(|stored| (stored.0, stored.1))));
        own.iter().zip(stored).for_each(|(own, stored)| all[own.2] = Some(stored.2));
    }
    all
}
