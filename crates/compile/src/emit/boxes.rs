//! The program of a network of layers, written pattern by pattern.
//!
//! Input: a network that is mapped by its kernels, its partition and placement. Output: a
//! [`Program`], and the tables of one core of each pattern, for the checker. Boxes of a layer that
//! hold the same channels, and whose rows and columns are reached in the same pattern, store the
//! same tables. These are written once; the other boxes differ in the sources of their input axons,
//! which are the same ones some rows and columns further on. So a program of thousands of millions
//! of synapses takes the memory of its messages, not of its synapses.
//!
//! Why it is right: a window reaches rows and columns independently of each other, and what a
//! source reaches of a box depends on its field in both, which [`WindowAxis::pattern`] lists in
//! order. A test holds programs made so against those that [`route`](crate::emit::route) writes
//! synapse by synapse.

use std::collections::HashMap;

use rayon::prelude::*;

use crate::emit::route::{assemble, compartments};
use crate::emit::sample::sample;
use nsim_check::sampled::SampledCore;
use nsim_ir::base::csr::Csr;
use nsim_ir::base::id::{CompartmentId, CoreId, Id, IdVec, PopulationId};
use nsim_ir::base::shared::Shared;
use nsim_ir::dealt::Dealt;
use nsim_ir::partition::Partition;
use nsim_ir::placement::Placement;
use nsim_ir::program::{CoreImage, Program, Stored};
use nsim_ir::quantised::Quantised;
use nsim_ir::resource::Limits;
use nsim_partition::resources::closed_form::Layer;
use nsim_partition::resources::fan_in::first_source;
use nsim_partition::resources::receptive_field::{ReceptiveField, WindowAxis};
use nsim_partition::strategy::lattice;

/// The program, and the tables of one core of each pattern.
///
/// # Errors
/// A sentence when the network does not consist of layers, and as [`crate::emit::route::route`].
pub fn route_boxes(
    network: &Quantised,
    partition: &Partition,
    (placement, dealt): (&Placement, Option<Dealt>),
    limits: &Limits,
) -> Result<(Program, Vec<SampledCore>), String> {
    if partition.cores() != placement.len() {
        return Err("the partition and the placement have different numbers of cores".to_string());
    }
    let layers = lattice::layers(network).ok_or("the network does not consist of layers")?;
    let all: Vec<CoreId> = partition.members().ids().collect();
    let boxes: Vec<Option<BoxOfLayer>> =
        all.par_iter().map(|&core| BoxOfLayer::holding(network, &layers, &partition.members()[core])).collect();
    let holds = |core: CoreId| dealt.as_ref().is_none_or(|dealt| dealt.holds(core));
    // The first core of each pattern, by core; those that another process holds have none.
    let mut known: HashMap<&Pattern, usize> = HashMap::new();
    let mut firsts: Vec<CoreId> = Vec::new();
    let first_of: Vec<usize> = all
        .iter()
        .zip(&boxes)
        .map(|(&core, found)| {
            if !holds(core) {
                return usize::MAX;
            }
            let mut push = || {
                firsts.push(core);
                firsts.len() - 1
            };
            match found {
                Some(BoxOfLayer { pattern, .. }) => *known.entry(pattern).or_insert_with(push),
                None => push(),
            }
        })
        .collect();
    let written = sample(network, partition, placement, &firsts, limits)?;
    let nothing = Shared::from(Stored::default());
    let write = |(&core, &first): (&CoreId, &usize)| {
        if first == usize::MAX {
            let ids = partition.members()[core].clone();
            let compartments = compartments(network, &ids).into();
            let (site, formats, axons_out) = (placement.site(core), Vec::new(), Csr::default());
            return (CoreImage { site, compartments, ids, formats, inputs: nothing.clone(), axons_out }, Vec::new());
        }
        let SampledCore { core: of_first, image, sources } = &written[first];
        if *of_first == core {
            return (image.clone(), sources.clone());
        }
        let held = &partition.members()[core];
        let own = compartments(network, held);
        let alike = own == **image.compartments;
        let image = CoreImage {
            site: placement.site(core),
            ids: held.clone(),
            compartments: if alike { image.compartments.clone() } else { own.into() },
            formats: image.formats.clone(),
            inputs: image.inputs.clone(),
            axons_out: Csr::default(),
        };
        let shifts = match (&boxes[of_first.index()], &boxes[core.index()]) {
            (Some(from), Some(to)) => from.shifts_to(to),
            _ => Vec::new(),
        };
        (image, shifted(sources, &shifts))
    };
    let (cores, sources) = all.par_iter().zip(&first_of).map(write).unzip();
    Ok((assemble(network, partition, (placement, dealt), (cores, sources))?, written))
}

/// What of a box decides what its core stores.
#[derive(Debug, PartialEq, Eq, Hash)]
struct Pattern {
    layer: PopulationId,
    /// Compartments in slot order, counted from the first row and column of the box.
    held: Vec<u32>,
    /// By projection into the layer: which rows and columns reach which of the box's, counted from
    /// the first that does.
    reached: Vec<[Vec<(u32, ReceptiveField)>; 2]>,
}

/// A core's compartments, which are a box of a layer.
#[derive(Debug)]
struct BoxOfLayer {
    pattern: Pattern,
    /// By projection into the layer: the sources' numbers, and the one at the first row and column
    /// that reach the box.
    origins: Vec<(u32, u32, i64)>,
}

impl BoxOfLayer {
    /// The box that these compartments are; `None` where they are of several layers.
    fn holding(network: &Quantised, layers: &IdVec<PopulationId, Layer>, held: &[CompartmentId]) -> Option<Self> {
        let (id, _) = network.population_of(*held.first()?);
        let (population, layer) = (&network.populations()[id], &layers[id]);
        let (first, (_, height, width)) = (population.first_compartment()?, layer.shape);
        let index = |id: &CompartmentId| id.0.checked_sub(first.0).filter(|index| *index < population.shape.len());
        let indices: Vec<u32> = held.iter().map(index).collect::<Option<_>>()?;
        let rows = || indices.iter().map(|index| index / width % height);
        let columns = || indices.iter().map(|index| index % width);
        let (top, left) = (rows().min()?, columns().min()?);
        let (rows, columns) = (top..rows().max()? + 1, left..columns().max()? + 1);
        let (mut reached, mut origins) = (Vec::new(), Vec::new());
        for incoming in &layer.incoming {
            let window = &incoming.window;
            let (row, of_rows) = WindowAxis::rows(window).pattern(&rows);
            let (column, of_columns) = WindowAxis::columns(window).pattern(&columns);
            reached.push([of_rows, of_columns]);
            let source = &network.populations()[incoming.source];
            let from = first_source(network, source);
            let origin = i64::from(row) * i64::from(window.source.2) + i64::from(column);
            origins.push((from, from + source.shape.len(), origin));
        }
        let corner = top * width + left;
        let held = indices.into_iter().map(|index| index - corner).collect();
        Some(BoxOfLayer { pattern: Pattern { layer: id, held, reached }, origins })
    }

    /// How far the sources of a box of the same pattern lie from this one's: the sources of each
    /// projection, and the distance.
    fn shifts_to(&self, other: &BoxOfLayer) -> Vec<(u32, u32, i64)> {
        let mut shifts: Vec<_> =
            self.origins.iter().zip(&other.origins).map(|(&(from, to, at), other)| (from, to, other.2 - at)).collect();
        shifts.sort_unstable();
        shifts
    }
}

/// Ascending sources, each shifted as those of its projection.
fn shifted(sources: &[u32], shifts: &[(u32, u32, i64)]) -> Vec<u32> {
    let mut shifts = shifts.iter().peekable();
    let shifted = |&source: &u32| {
        while shifts.next_if(|(_, end, _)| *end <= source).is_some() {}
        shifts.peek().map_or(source, |(_, _, by)| (i64::from(source) + by) as u32)
    };
    sources.iter().map(shifted).collect()
}
