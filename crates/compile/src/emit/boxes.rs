//! The program of a network of layers, written pattern by pattern.
//!
//! Input: a network that is mapped by its kernels, its partition and placement. Output: a
//! [`Program`]. Boxes of a layer are of one class if they hold the same channels, and their rows
//! and columns are reached in the same pattern. The tables of a class are written once; its other
//! boxes have the same sources of input axons, some rows and columns further on. So a
//! program of thousands of millions of synapses takes the memory of its messages, not of its
//! synapses.
//!
//! Why it is right: a window reaches rows and columns independently of each other, and what a
//! source reaches of a box depends on its field in both, which [`WindowAxis::pattern`] lists in
//! order. A test holds programs made so against those that [`route`](crate::emit::route) writes
//! synapse by synapse.

use rayon::prelude::*;

use crate::emit::classes::Classes;
use crate::emit::route::{Shift, Tables, assemble, parameters};
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::fixed::Delay;
use nsim_ir::base::id::{CompartmentId, CoreId, Id, IdVec, PopulationId};
use nsim_ir::dealt::Dealt;
use nsim_ir::partition::Partition;
use nsim_ir::placement::Placement;
use nsim_ir::program::{Compartment, CoreClass, Program};
use nsim_ir::quantised::Quantised;
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::resource::Limits;
use nsim_partition::resources::by_core::Key;
use nsim_partition::resources::closed_form::Layer;
use nsim_partition::resources::fan_in::FanIn;
use nsim_partition::resources::receptive_field::{ReceptiveField, WindowAxis};
use nsim_partition::strategy::lattice;

/// Boxes whose patterns are found side by side.
const TOGETHER: usize = 1 << 10;

/// The program, each class written once.
///
/// # Errors
/// A sentence when the network does not consist of layers, and as [`crate::emit::route::route`].
pub fn route_boxes(
    network: &Quantised,
    partition: &Partition,
    (placement, dealt): (&Placement, Option<Dealt>),
    limits: &Limits,
) -> Result<Program, String> {
    let layers = lattice::layers(network).ok_or("the network does not consist of layers")?;
    let all: Vec<CoreId> = partition.members().ids().collect();
    let found = |&core: &CoreId| (core, BoxOfLayer::holding(network, &layers, &partition.members()[core]));
    // Some boxes at a time, since patterns of all take the memory of their compartments.
    let boxes = all.chunks(TOGETHER).flat_map(|some| some.par_iter().map(found).collect::<Vec<_>>());
    let holds = |core: CoreId| dealt.as_ref().is_none_or(|dealt| dealt.holds(core));
    let parameters = |core: CoreId| parameters(network, &partition.members()[core]);
    let mut origins: Vec<Option<Vec<Origin>>> = Vec::with_capacity(all.len());
    let patterns = Classes::by_key(boxes.map(|(core, found)| {
        let (pattern, of_box) = found.map(|found| (found.pattern, found.origins)).unzip();
        origins.push(of_box);
        pattern.ok_or(core)
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
    let mut written = tables_of(network, partition, &firsts, limits)?.into_iter();
    let class = |&core: &CoreId| match holds(core) {
        true => written.next(),
        false => Some((CoreClass::without_tables(parameters(core)), Vec::new())),
    };
    let stored = classes.firsts.iter().filter_map(class).collect();
    let shifts = |first: CoreId, core: CoreId| match (&origins[first.index()], &origins[core.index()]) {
        (Some(from), Some(to)) => shifts_between(from, to),
        _ => Vec::new(),
    };
    assemble(network, partition, (placement, dealt), (stored, &classes, shifts))
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
    /// By projection into the layer.
    origins: Vec<Origin>,
}

/// The sources' numbers of a projection, and the one at the first row and column that reach a box.
type Origin = (u32, u32, i64);

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
            let from = network.first_source(source);
            let origin = i64::from(row) * i64::from(window.source.2) + i64::from(column);
            origins.push((from, from + source.shape.len(), origin));
        }
        let corner = top * width + left;
        let held = indices.into_iter().map(|index| index - corner).collect();
        Some(BoxOfLayer { pattern: Pattern { layer: id, held, reached }, origins })
    }
}

/// How far the sources of a box lie from those of another of the same pattern.
fn shifts_between(from: &[Origin], to: &[Origin]) -> Vec<Shift> {
    let mut shifts: Vec<Shift> = from.iter().zip(to).map(|(&(from, end, at), to)| (from, end, to.2 - at)).collect();
    shifts.sort_unstable();
    shifts
}

/// What these cores store, and the source of each input axon.
fn tables_of(
    network: &Quantised,
    partition: &Partition,
    cores: &[CoreId],
    limits: &Limits,
) -> Result<Vec<(CoreClass, Vec<u32>)>, String> {
    let (tables, fan_in) = (Tables::new(network, partition, limits), FanIn::new(network));
    let one = |&core: &CoreId| {
        let held = &partition.members()[core];
        // Most targets of a source are outside the core's range, which spares a load of their seat.
        let range = held.iter().min()..=held.iter().max();
        let mut keys = Vec::new();
        let mut longest = Delay::MIN;
        for (population, source, index) in sources_of(network, &fan_in, held) {
            let begin = keys.len();
            for (projection, of, first) in network.targets_of(population) {
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
            keys[begin..].sort_unstable();
        }
        tables.class(core, &keys, longest)
    };
    cores.par_iter().map(one).collect()
}

/// The sources of compartments in ascending order: population, number, and index in the population.
fn sources_of(network: &Quantised, fan_in: &FanIn, held: &[CompartmentId]) -> Vec<(PopulationId, u32, u32)> {
    let mut found = vec![0u64; (network.channels() + network.compartments()).div_ceil(64) as usize];
    for &id in held {
        let (population, index) = network.population_of(id);
        fan_in.for_each_into(population, index, |source, projection, _, bundle| {
            let positions = match &network.projections()[projection].connectivity {
                Connectivity::Conv2d { window, .. } => window.source.1 * window.source.2,
                _ => 0,
            };
            for source in (0..bundle).map(|k| source + k * positions) {
                found[source as usize / 64] |= 1 << (source % 64);
            }
        });
    }
    let mut firsts: Vec<(u32, PopulationId)> =
        network.populations().enumerate().map(|(id, population)| (network.first_source(population), id)).collect();
    firsts.sort_unstable();
    let mut sources = Vec::new();
    for (word, mut bits) in (0..).zip(found).filter(|(_, bits)| *bits != 0) {
        while bits != 0 {
            let source = 64 * word + bits.trailing_zeros();
            let (first, population) = firsts[firsts.partition_point(|(first, _)| *first <= source) - 1];
            sources.push((population, source, source - first));
            bits &= bits - 1;
        }
    }
    sources
}
