//! The tables of some cores, of a network too large to write all.
//!
//! Input: a network, its partition, and the cores wanted. Output: what each core stores, as
//! [`route`] would write it.
//!
//! [`route`]: crate::emit::route::route()

use rayon::prelude::*;

use crate::emit::route::Tables;
use nsim_check::sampled::SampledCore;
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::fixed::Delay;
use nsim_ir::base::id::{CompartmentId, CoreId, Id, ProjectionId};
use nsim_ir::partition::Partition;
use nsim_ir::quantised::Quantised;
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::resource::Limits;
use nsim_partition::resources::by_core::Key;
use nsim_partition::resources::fan_in::{FanIn, first_source};

/// The tables of these cores.
///
/// # Errors
/// As [`crate::emit::route::route`].
pub fn sample(
    network: &Quantised,
    partition: &Partition,
    cores: &[CoreId],
    limits: &Limits,
) -> Result<Vec<SampledCore>, String> {
    let (tables, fan_in) = (Tables::new(network, partition, limits), FanIn::new(network));
    let one = |&core: &CoreId| {
        let held = &partition.members()[core];
        // Most targets of a source are outside the core's range, which spares a load of their seat.
        let range = held.iter().min()..=held.iter().max();
        let mut keys = Vec::new();
        let mut longest = Delay::MIN;
        for (projection, index) in sources_of(network, &fan_in, held) {
            let of = &network.projections()[projection];
            let Some(first) = network.populations()[of.target].first_compartment() else { continue };
            let source = first_source(network, &network.populations()[of.source]) + index;
            let format = tables.formats.by_projection()[projection.index()];
            of.connectivity.for_each_from(index, |target, weight| {
                let target = CompartmentId(first.0 + target);
                if !range.contains(&Some(&target)) {
                    return;
                }
                let seat = partition.seats()[target];
                if seat.core == core {
                    longest = longest.max(of.delay);
                    keys.push(Key::new(source, format, seat.slot, of.delay.get(), weight));
                }
            });
        }
        keys.sort_unstable();
        let (class, sources) = tables.class(core, &keys, longest)?;
        Ok(SampledCore { core, class, sources })
    };
    cores.par_iter().map(one).collect()
}

/// The sources of compartments, each by a projection and its index in its population.
fn sources_of(network: &Quantised, fan_in: &FanIn, held: &[CompartmentId]) -> Vec<(ProjectionId, u32)> {
    let mut sources = Vec::new();
    for &id in held {
        let (population, index) = network.population_of(id);
        fan_in.for_each_into(population, index, |source, projection, _, bundle| {
            let of = &network.projections()[projection];
            let positions = match &of.connectivity {
                Connectivity::Conv2d { window, .. } => window.source.1 * window.source.2,
                _ => 0,
            };
            let first = source - first_source(network, &network.populations()[of.source]);
            sources.extend((0..bundle).map(|k| (projection, first + k * positions)));
        });
        // Neighbours share most of their sources.
        if sources.len() > 1 << 20 {
            sources.sort_unstable();
            sources.dedup();
        }
    }
    sources.sort_unstable();
    sources.dedup();
    sources
}
