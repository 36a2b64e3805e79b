//! What one spike reaches, core by core: the groups that become an input axon's list.
//!
//! In come a network and the seats of its compartments; out go, source by source, the synapses sorted by core, group, slot
//! (and then delay and weight, so that the order is total). [`crate::compile::usage`] counts them and
//! [`crate::compile::route`] writes them down; both therefore mean the same list.

use crate::base::id::{ChannelId, CompartmentId, CoreId, IdVec, PopulationId};
use crate::ir::partition::Seat;
use crate::ir::quantised::{Quantised, SpikeSource, SynapseFormat};

/// A synapse of a source, at its place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Reach {
    /// The target's core.
    pub core: CoreId,
    /// Index of the format among [`Formats`].
    pub format: u16,
    /// The target's slot.
    pub slot: u16,
    /// Delay field.
    pub delay: u8,
    /// Weight mantissa.
    pub weight: i16,
}

/// The distinct synapse formats of a network, ascending.
#[derive(Debug, Clone)]
pub struct Formats {
    distinct: Vec<SynapseFormat>,
    of_projection: Vec<u16>,
}

impl Formats {
    /// The formats of a network.
    #[must_use]
    pub fn of(network: &Quantised) -> Self {
        let mut distinct: Vec<SynapseFormat> = network.projections().iter().map(|p| p.format).collect();
        distinct.sort_unstable();
        distinct.dedup();
        let find = |format: &SynapseFormat| distinct.partition_point(|f| f < format) as u16;
        let of_projection = network.projections().iter().map(|p| find(&p.format)).collect();
        Formats { distinct, of_projection }
    }

    /// A format by its index.
    #[inline]
    #[must_use]
    pub fn get(&self, index: u16) -> SynapseFormat {
        self.distinct[usize::from(index)]
    }

    /// The index of each projection's format.
    #[must_use]
    pub fn by_projection(&self) -> &[u16] {
        &self.of_projection
    }

    /// How many there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.distinct.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.distinct.is_empty()
    }
}

/// Puts all synapses of a source into `reaches`, sorted.
pub fn collect(
    network: &Quantised,
    formats: &Formats,
    seats: &IdVec<CompartmentId, Seat>,
    (population, index): (PopulationId, u32),
    reaches: &mut Vec<Reach>,
) {
    reaches.clear();
    for &id in network.outgoing(population) {
        let projection = &network.projections()[id];
        let format = formats.by_projection()[id.0 as usize];
        let Some(first) = network.populations()[projection.target].first_compartment() else { continue };
        let delay = projection.delay.get();
        projection.connectivity.for_each_from(index, |target, weight| {
            let seat = seats[CompartmentId(first.0 + target)];
            reaches.push(Reach { core: seat.core, format, slot: seat.slot, delay, weight });
        });
    }
    reaches.sort_unstable();
}

/// Every source with its population and its index in it: channels in order, then compartments in order.
pub fn sources(network: &Quantised) -> impl Iterator<Item = (SpikeSource, (PopulationId, u32))> + use<'_> {
    let of = |inputs: bool| {
        network.populations().enumerate().filter(move |(_, p)| p.first_channel().is_some() == inputs).flat_map(
            |(id, population)| {
                (0..population.shape.len()).map(move |index| {
                    let source = match (population.first_channel(), population.first_compartment()) {
                        (Some(first), _) => SpikeSource::Channel(ChannelId(first.0 + index)),
                        (None, first) => {
                            SpikeSource::Compartment(CompartmentId(first.map_or(0, |first| first.0) + index))
                        }
                    };
                    (source, (id, index))
                })
            },
        )
    };
    of(true).chain(of(false))
}

/// Whether the slots of a sorted group follow each other without gap or repetition.
#[must_use]
pub fn is_dense(group: &[Reach]) -> bool {
    group.windows(2).all(|pair| pair[1].slot == pair[0].slot + 1)
}

/// The groups of one axon (all of one core), in order of formats.
pub fn groups(axon: &[Reach]) -> impl Iterator<Item = &[Reach]> {
    axon.chunk_by(|a, b| a.format == b.format)
}
