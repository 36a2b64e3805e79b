//! The program of a network of layers, written pattern by pattern.
//!
//! Input: a network that is mapped by its kernels, its partition and placement. Output: a
//! [`Program`], and the tables of one core of each class, for the checker. Boxes of a layer that
//! hold the same channels, and whose rows and columns are reached in the same pattern, are of one
//! class. Its tables are written once; the other boxes differ in the sources of their input axons,
//! which are the same ones some rows and columns further on. So a program of thousands of millions
//! of synapses takes the memory of its messages, not of its synapses.
//!
//! Why it is right: a window reaches rows and columns independently of each other, and what a
//! source reaches of a box depends on its field in both, which [`WindowAxis::pattern`] lists in
//! order. A test holds programs made so against those that [`route`](crate::emit::route) writes
//! synapse by synapse.

use rayon::prelude::*;

use crate::emit::classes::Classes;
use crate::emit::route::{assemble, parameters};
use crate::emit::sample::sample;
use nsim_check::sampled::SampledCore;
use nsim_ir::base::id::{CompartmentId, CoreId, Id, IdVec, PopulationId};
use nsim_ir::dealt::Dealt;
use nsim_ir::partition::Partition;
use nsim_ir::placement::Placement;
use nsim_ir::program::{Compartment, CoreClass, Program};
use nsim_ir::quantised::Quantised;
use nsim_ir::resource::Limits;
use nsim_partition::resources::closed_form::Layer;
use nsim_partition::resources::fan_in::first_source;
use nsim_partition::resources::receptive_field::{ReceptiveField, WindowAxis};
use nsim_partition::strategy::lattice;

/// The program, and the tables of one core of each class.
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
    let parameters = |core: CoreId| parameters(network, &partition.members()[core]);
    let patterns = Classes::by_key(all.iter().zip(&boxes).map(|(core, found)| match found {
        Some(BoxOfLayer { pattern, .. }) => Ok(pattern),
        None => Err(core),
    }));
    let of_patterns: Vec<Vec<Compartment>> =
        patterns.firsts.as_slice().par_iter().map(|&core| parameters(core)).collect();
    // A box with other parameters than the first of its pattern is a class by itself.
    let differs = |&core: &CoreId| parameters(core) != of_patterns[patterns.of[core].index()];
    let differs: Vec<bool> = all.par_iter().map(differs).collect();
    drop(of_patterns);
    let key = |(&core, differs): (&CoreId, bool)| (holds(core), patterns.of[core], differs.then_some(core));
    let classes = Classes::by_key(all.iter().zip(differs).map(key));
    let firsts: Vec<CoreId> = classes.firsts.iter().copied().filter(|core| holds(*core)).collect();
    let written = sample(network, partition, &firsts, limits)?;
    let sources = |&core: &CoreId| {
        let Ok(first) = firsts.binary_search(&classes.first(core)) else { return Vec::new() };
        let SampledCore { core: of_first, sources, .. } = &written[first];
        match (&boxes[of_first.index()], &boxes[core.index()]) {
            (Some(from), Some(to)) => shifted(sources, &from.shifts_to(to)),
            _ => sources.clone(),
        }
    };
    let sources = all.par_iter().map(sources).collect();
    let class = |&core: &CoreId| match firsts.binary_search(&core) {
        Ok(first) => written[first].class.clone(),
        Err(_) => CoreClass::without_tables(parameters(core)),
    };
    let stored = classes.firsts.iter().map(class).collect();
    Ok((assemble(network, partition, (placement, dealt), (stored, classes, sources))?, written))
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
