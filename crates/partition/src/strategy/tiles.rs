//! Populations over space, cut into tiles.
//!
//! Input: a population of `[channels, height, width]` that convolutions or poolings reach. Output:
//! segments, each a rectangle of positions with all or an equal share of the channels. A core with
//! a rectangle needs the sources under the rectangle and its rim. A core with as many compartments
//! in the order of the file, channel by channel, needs nearly all sources of the layer before. NxTF
//! (Intel, `nxsdk_modules_ncl/dnn`) cuts layers by grids too, and looks for the fewest cores by
//! beam search. Here every grid is counted in closed form, and the first that fits is taken, in the
//! order of cores and then of messages. Cores are tiles, plus cores that the layer before needs
//! more because its output axons reach many tiles. Grids whose sources or weights alone exceed a
//! core are not tried. For these bounds, lists are separate or shared
//! ([`crate::resources::axon_sharing`]), the fewer of both.
//!
//! Slots of a tile are ordered position by position, channels together, so that the targets of a
//! spike are consecutive. They are ordered channel by channel where each channel receives only from
//! its own (pooling, depthwise convolution). Where a base may be any slot
//! ([`OutputAxons::PerPosition`]), both orders are counted and the order of fewer words is taken.
//! Channel by channel, a neighbour's lists are one slot further on. So all positions of a tile are
//! within the reach of a base and share one table, whose lists have runs. Position by position,
//! lists are dense, but a table is stored once for every 256 slots.

use std::collections::BTreeSet;

use crate::resources::axon_sharing::Places;
use crate::resources::closed_form::{Incoming, Layer, middle, middle_of, part};
use crate::resources::formats::{Formats, Lists, rows};
use crate::resources::incremental::{Filling, Newcomer};
use crate::resources::packing::MOST_SLOTS;
use crate::resources::receptive_field::{ReceptiveField, WindowAxis, relative};
use crate::strategy::order::{Indices, Segment};
use nsim_ir::base::id::{CompartmentId, IdVec, PopulationId};
use nsim_ir::graph::Window;
use nsim_ir::quantised::Quantised;
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::resource::{Limits, OutputAxons, Resource};

/// Most grids that are tried on a core.
const TRIALS: usize = 60;
/// Most grids with an equal number of cores that are tried consecutively.
const OF_AS_MANY: usize = 3;

/// Divisor of a core's words: the least saving of tiles with fewer words.
const LEAST_SAVED: u64 = 8;
/// Most grids with equal cores whose words are counted, and most of them that are tried.
const OF_FEWER_WORDS: usize = 64;
const TRIALS_OF_FEWER_WORDS: usize = 4;

/// Whether a population is cut into tiles.
pub fn is_spatial(network: &Quantised, population: PopulationId) -> bool {
    let mut into = network.incoming(population).map(|(_, p)| p).peekable();
    network.populations()[population].shape.volume().is_some()
        && into.peek().is_some()
        && into.all(|p| p.connectivity.window().is_some())
}

/// Most compartments of a core, by population: the limit, or fewer where their synapses may be no
/// more than `most_synapses`.
pub fn most_compartments(network: &Quantised, limits: &Limits, most_synapses: Option<u64>) -> IdVec<PopulationId, u32> {
    let held = limits[Resource::Compartments].min(MOST_SLOTS);
    // Synapses of a compartment whose windows are whole.
    let mut each: IdVec<PopulationId, u64> = vec![0; network.populations().len()].into();
    for (id, projection) in network.projections().enumerate() {
        each[projection.target] += match &projection.connectivity {
            Connectivity::Conv2d { window, .. } | Connectivity::SumPool2d { window, .. } => {
                let channels = u64::from(window.source.0 / window.groups.max(1));
                channels * u64::from(window.kernel.0) * u64::from(window.kernel.1)
            }
            _ => {
                let compartments = network.populations()[projection.target].shape.len();
                network.synapses_of(id).div_ceil(u64::from(compartments).max(1))
            }
        };
    }
    let fitting = |each: &u64| most_synapses.map_or(held, |most| (most / (*each).max(1)).clamp(1, held.into()) as u32);
    each.iter().map(fitting).collect()
}

/// Numbers of parts into which a length is cut, each with the size of a part; parts that are no
/// smaller are omitted.
fn cuts(length: u32) -> Vec<(u32, u32)> {
    let mut cuts: Vec<(u32, u32)> = (1..=length).map(|n| length.div_ceil(n)).map(|s| (length.div_ceil(s), s)).collect();
    cuts.dedup();
    cuts
}

/// Number of source positions under a part of a target axis.
fn under(size: u32, kernel: u32, stride: u32, dilation: u32, source: u32) -> u64 {
    let reach = u64::from(size - 1) * u64::from(stride) + u64::from(kernel - 1) * u64::from(dilation) + 1;
    // Where strides skip sources, only the sources under a kernel are reached.
    let seen = u64::from(size) * u64::from(kernel);
    reach.min(seen).min(u64::from(source))
}

/// Numbers of targets within the part in the middle of an axis: over all sources, and over the
/// distinct fields of sources up to a shift.
fn reached(axis: WindowAxis, length: u32, size: u32) -> (u64, u64) {
    let fields = axis.fields(&part(length, size, middle_of(length, size)));
    let all = fields.iter().map(|(field, sources)| field.len() as u64 * sources).sum();
    let distinct: BTreeSet<ReceptiveField> = fields.iter().map(|(field, _)| relative(field)).collect();
    (all, distinct.iter().map(|field| field.len() as u64).sum())
}

/// Synapse words of `channels` channels of one group, where a core stores kernels once.
fn kernel_words(layer: &Layer, limits: &Limits, channels: u32) -> u64 {
    let lists = Lists::new(limits);
    let of = |Incoming { window, all_to_all, weight_bits, .. }: &Incoming| match all_to_all {
        true => u64::from(window.source.0) * lists.of_axon(channels.into(), *weight_bits),
        false => rows(window) * lists.of_row(channels.min(window.target.0 / window.groups).into(), *weight_bits),
    };
    layer.incoming.iter().map(of).sum()
}

/// A grid of tiles: its cores, the messages of one spike of every source, and the size of a tile.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Grid {
    /// Number of tiles, plus the further cores that sources take because of their output axons to
    /// the tiles.
    cores: u64,
    messages: u64,
    /// Channels, height and width of a tile; tiles at the end may be smaller.
    pub size: (u32, u32, u32),
}

/// A cut of an axis: number of parts, size of one, and targets within it ([`reached`]) by
/// projection.
type Along = (u32, u32, Vec<(u64, u64)>);

/// Grids that may fit a core of at most `most` compartments, the best first.
pub fn grids(layer: &Layer, formats: &Formats, limits: &Limits, most: u32) -> Vec<Grid> {
    let (c, h, w) = layer.shape;
    let along = |length: u32, axis: fn(&Window) -> WindowAxis| -> Vec<Along> {
        let cuts = cuts(length).into_iter().filter(|&(_, size)| size <= most);
        let reached =
            |size| layer.incoming.iter().map(|i| reached(axis(&i.window).uniform(i.uniform), length, size)).collect();
        cuts.map(|(parts, size)| (parts, size, reached(size))).collect()
    };
    let (rows, columns) = (along(h, WindowAxis::rows), along(w, WindowAxis::columns));
    let neuron_words = layer.kind.map_or(0, |kind| u64::from(limits.neuron_sizes.words_of(kind)));
    let mut grids = Vec::new();
    for (nc, tc) in cuts(c) {
        for &(nh, th, ref of_rows) in &rows {
            for &(nw, tw, ref of_columns) in &columns {
                let size = u64::from(tc) * u64::from(th) * u64::from(tw);
                if size > u64::from(most) {
                    continue;
                }
                let tiles = u64::from(nc) * u64::from(nh) * u64::from(nw);
                // Number of sources, and lower bounds on input axons and on bits of weights.
                let (mut sources, mut axons, mut bits, mut cores) = (0, 0, 0, tiles);
                for (&Incoming { window, format, from, placed, .. }, (rows, columns)) in
                    layer.incoming.iter().zip(of_rows.iter().zip(of_columns))
                {
                    let weight_bits = formats.get(format).bits.get();
                    let out_of_group = (window.target.0 / window.groups).max(1);
                    let groups = tc.div_ceil(out_of_group).min(window.groups);
                    let channels = u64::from(groups) * u64::from(window.source.0 / window.groups);
                    let places = under(th, window.kernel.0, window.stride.0, window.dilation.0, window.source.1)
                        * under(tw, window.kernel.1, window.stride.1, window.dilation.1, window.source.2);
                    let (all, distinct) = ((rows.0, columns.0), (rows.1, columns.1));
                    sources += channels * places;
                    // Assumes half of the targets on another chip, and all channels of a position
                    // on one core.
                    let slots = u64::from(limits.axon_out_slots) + u64::from(limits.axon_out_slots_off_chip);
                    let slots = match limits.output_axons {
                        OutputAxons::PerPosition { atoms, more_slots } if placed.is_some() => {
                            slots + if channels > atoms.into() { 2 * u64::from(more_slots) } else { 0 }
                        }
                        _ => channels * slots,
                    };
                    let senders = (tiles * places * slots).div_ceil(2 * u64::from(limits[Resource::AxonsOut].max(1)));
                    let anyway = from.map(|from| u64::from(from.div_ceil(limits[Resource::Compartments].max(1))));
                    cores += anyway.map_or(0, |anyway| senders.saturating_sub(anyway));
                    axons += places;
                    // The sources of a group reach its channels only, and the channels of all
                    // groups are the tile's.
                    let pairs = u64::from(window.source.0 / window.groups) * u64::from(tc);
                    bits += pairs * (all.0 * all.1).min(distinct.0 * distinct.1) * u64::from(weight_bits);
                }
                let synapses = if limits.counts_kernels() { 64 * kernel_words(layer, limits, tc) } else { bits };
                if axons <= u64::from(limits[Resource::AxonsIn])
                    && synapses <= 64 * u64::from(limits[Resource::SynapseWords])
                    && size * neuron_words <= u64::from(limits[Resource::NeuronWords])
                {
                    grids.push(Grid { cores, messages: tiles * sources, size: (tc, th, tw) });
                }
            }
        }
    }
    grids.sort_unstable();
    grids
}

/// Objective among grids with an equal number of cores.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rank {
    /// Messages.
    Messages,
    /// Words, where that frees enough memory; messages may then be more.
    Words,
}

/// The tiles of a population as segments, each fit for a core with at most `most` compartments;
/// `None` when no such grid was found.
pub fn tiles(
    network: &Quantised,
    population: PopulationId,
    filling: &mut Filling,
    limits: &Limits,
    most: u32,
    rank: Rank,
) -> Option<Vec<Segment>> {
    let formats = Formats::for_network(network);
    let layer = Layer::for_population(network, population, &formats, &Places::for_network(network, limits))?;
    let shape = layer.shape;
    let mut orders = vec![layer];
    if !orders[0].by_channel && matches!(limits.output_axons, OutputAxons::PerPosition { .. }) {
        orders.push(Layer { by_channel: true, ..orders[0].clone() });
    }
    let first = network.populations()[population].first_compartment()?;
    let mut fits = |indices: &[u32]| {
        filling.next_core();
        let newcomers: Option<Vec<Newcomer>> =
            indices.iter().map(|&index| Newcomer::new(network, CompartmentId(first.0 + index))).collect();
        let fits = newcomers.is_some_and(|newcomers| filling.add_whole(newcomers.into_iter()).is_ok());
        filling.next_core();
        fits
    };
    let all = grids(&orders[0], &formats, limits, most.min(limits[Resource::Compartments]).min(MOST_SLOTS));
    // Geometry reveals most grids that do not fit; profiles are counted when a core is filled.
    let cells_of = |grid: &Grid| {
        let words = |layer: &Layer| {
            let middle = layer.middle(grid.size, &formats, limits);
            (layer.joined || !middle.exceeds(limits)).then_some(middle.usage[Resource::SynapseWords])
        };
        let mut cells: Vec<(u64, bool)> = orders.iter().filter_map(|one| Some((words(one)?, one.by_channel))).collect();
        cells.sort_unstable();
        cells
    };
    let mut fitting_cell = |grid: &Grid| {
        let tile = |by_channel| cell(shape, grid.size, middle(shape, grid.size), by_channel);
        cells_of(grid).into_iter().find(|&(_, by_channel)| fits(&tile(by_channel)))
    };
    let mut cell = None;
    let found = first_that_fits(&all, TRIALS, |grid| {
        cell = fitting_cell(grid);
        cell.is_some()
    });
    let (grid, (words, by_channel)) = found.zip(cell)?;
    if rank == Rank::Messages {
        return Some(segments(population, shape, grid.size, by_channel));
    }
    let tiles = |grid: &Grid| {
        let along = |length: u32, size: u32| u64::from(length.div_ceil(size));
        along(shape.0, grid.size.0) * along(shape.1, grid.size.1) * along(shape.2, grid.size.2)
    };
    let most = (words * tiles(&grid)).saturating_sub(u64::from(limits[Resource::SynapseWords]) / LEAST_SAVED);
    let as_many = all.iter().filter(|other| other.cores == grid.cores).take(OF_FEWER_WORDS);
    let words_of = |other: &Grid| cells_of(other).first().map(|(words, _)| words * tiles(other));
    let mut others: Vec<(u64, Grid)> = as_many.filter_map(|other| Some((words_of(other)?, *other))).collect();
    others.retain(|&(words, _)| words <= most);
    others.sort_unstable();
    let mut fitting = others.iter().take(TRIALS_OF_FEWER_WORDS).filter_map(|(_, other)| {
        let (_, by_channel) = fitting_cell(other)?;
        Some(segments(population, shape, other.size, by_channel))
    });
    fitting.next()
}

/// The first of the tried grids that fits.
pub fn first_that_fits(all: &[Grid], trials: usize, mut fits: impl FnMut(&Grid) -> bool) -> Option<Grid> {
    // Several grids with an equal number of cores are tried, because they differ in their shared
    // lists. After a failure, grids with a few more cores are likely to fail too, so trials thin
    // out.
    let (mut tried, mut of_as_many, mut at) = (0, 0, 0);
    while at < all.len() && tried < trials {
        let grid = all[at];
        if fits(&grid) {
            return Some(grid);
        }
        tried += 1;
        of_as_many += 1;
        at += 1;
        if of_as_many < OF_AS_MANY && at < all.len() && all[at].cores == grid.cores {
            continue;
        }
        of_as_many = 0;
        // Skip ahead to grids with more cores, the faster the more have failed.
        let wanted = grid.cores + 1 + grid.cores * tried as u64 / 64;
        while at < all.len() && all[at].cores < wanted {
            at += 1;
        }
    }
    None
}

/// Indices of one tile, in slot order.
pub fn cell(shape: (u32, u32, u32), size: (u32, u32, u32), at: (u32, u32, u32), by_channel: bool) -> Vec<u32> {
    let (c, y, x) = (part(shape.0, size.0, at.0), part(shape.1, size.1, at.1), part(shape.2, size.2, at.2));
    let index = |c: u32, y: u32, x: u32| (c * shape.1 + y) * shape.2 + x;
    if by_channel {
        return c
            .flat_map(|c| y.clone().flat_map(move |y| (0..shape.2).map(move |x| (c, y, x))))
            .filter(|(_, _, column)| x.contains(column))
            .map(|(c, y, x)| index(c, y, x))
            .collect();
    }
    let mut indices = Vec::new();
    for y in y {
        for x in x.clone() {
            indices.extend(c.clone().map(|c| index(c, y, x)));
        }
    }
    indices
}

/// The tiles (channels, row, column) of a grid; rows of them run to and fro, so that neighbours in
/// the order are neighbours in space.
pub fn to_and_fro(channels: u32, rows: u32, columns: u32) -> impl Iterator<Item = (u32, u32, u32)> {
    (0..rows).flat_map(move |y| {
        let column = move |x: u32| if y.is_multiple_of(2) { x } else { columns - 1 - x };
        (0..columns).flat_map(move |x| (0..channels).map(move |c| (c, y, column(x))))
    })
}

/// All tiles, in the order of [`to_and_fro`].
fn segments(population: PopulationId, shape: (u32, u32, u32), size: (u32, u32, u32), by_channel: bool) -> Vec<Segment> {
    to_and_fro(shape.0.div_ceil(size.0), shape.1.div_ceil(size.1), shape.2.div_ceil(size.2))
        .map(|at| Segment { population, indices: Indices::Tile(cell(shape, size, at, by_channel)) })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_of_an_axis_sees_what_its_windows_cover() {
        assert_eq!(under(4, 3, 1, 1, 100), 6);
        assert_eq!(under(4, 5, 2, 1, 100), 11);
        assert_eq!(under(4, 5, 2, 1, 9), 9);
        // A stride beyond the kernel skips sources.
        assert_eq!(under(3, 1, 4, 1, 100), 3);
        assert_eq!(cuts(10), [(1, 10), (2, 5), (3, 4), (4, 3), (5, 2), (10, 1)]);
    }

    #[test]
    fn compartments_are_as_many_as_their_synapses_allow() {
        use nsim_ir::graph::Shape;
        use nsim_testing::{Builder, limits, neurons, plain_format};
        let mut net = Builder::new();
        let image = net.input_shape("image", Shape::Volume(2, 5, 5));
        let layer = net.loihi_with("layer", Shape::Volume(4, 5, 5), neurons());
        let out = net.loihi("out", 3);
        let once = (1, 1);
        let (source, target) = ((2, 5, 5), (4, 5, 5));
        let window = Window { source, target, kernel: (3, 3), stride: once, padding: once, dilation: once, groups: 1 };
        let kernel = vec![2; 72].into();
        net.connect(image, layer, plain_format(), 0, Connectivity::Conv2d { window, kernel });
        net.dense(layer, out, |_, _| 2);
        let network = net.build();
        let most = |synapses| most_compartments(&network, &limits(), synapses).iter().copied().collect::<Vec<u32>>();
        let all = limits()[Resource::Compartments];
        assert_eq!(most(None), [all, all, all]);
        // 18 synapses of a middle position, though rim positions have fewer; 100 of each output
        // compartment.
        assert_eq!(most(Some(180)), [180.min(all), 10, 1]);
        assert_eq!(most(Some(5)), [5, 1, 1]);
    }
}
