//! One population over space: what reaches a box of it, from the geometry of its windows alone.
//!
//! In comes a network in which every projection is a window or all to all; out go its [`Layer`]s, the ways of cutting a
//! layer into boxes, and what a core that holds a box uses. A window reaches rows and columns independently of each other,
//! so the lists of a box are the products of patterns of rows, of columns and of channels: sources with the same patterns
//! have lists of the same make-up, which is counted once. The counts are those of [`crate::compile::usage`], output axons
//! excepted; a test holds them to it.

use std::collections::{BTreeMap, HashMap};
use std::ops::Range;
use std::sync::Arc;

use crate::base::fixed::Delay;
use crate::base::id::{Id, IdVec, PopulationId};
use crate::compile::formats::Formats;
use crate::compile::packing::{self, Group, Widths};
use crate::compile::partition::tiles::{self, Grid};
use crate::compile::usage::{Tallies, skip_of};
use crate::desc::target::Limits;
use crate::ir::graph::Window;
use crate::ir::partition::CoreUsage;
use crate::ir::quantised::{Connectivity, Quantised};

/// Grids of a layer that are tried.
const TRIALS: usize = 200;

/// A projection into a layer.
#[derive(Debug, Clone, Copy)]
pub struct Incoming {
    /// Where spikes come from.
    pub source: PopulationId,
    /// Its window; a layer that all sources reach is a window of one position.
    pub window: Window,
    /// Whether every source reaches every target.
    pub all_to_all: bool,
    /// Its format among those of the network.
    format: u16,
    delay: Delay,
}

/// A population and what reaches it.
#[derive(Debug, Clone)]
pub struct Layer {
    /// Channels, height and width.
    pub shape: (u32, u32, u32),
    /// What reaches it, in the order of the file.
    pub incoming: Vec<Incoming>,
    /// Whether each channel sees its own channel only: compartments stand channel by channel then.
    pub own_only: bool,
}

/// The layers of a network, empty for inputs; `None` when a projection is neither a window nor all to all, or two join the
/// same populations.
#[must_use]
pub fn layers(network: &Quantised) -> Option<IdVec<PopulationId, Layer>> {
    let formats = Formats::of(network);
    let shape = |id: PopulationId| {
        let shape = network.populations()[id].shape;
        shape.volume().unwrap_or((shape.len(), 1, 1))
    };
    let empty = |id| Layer { shape: shape(id), incoming: Vec::new(), own_only: false };
    let mut layers: IdVec<PopulationId, Layer> = network.populations().ids().map(empty).collect();
    for (id, projection) in network.projections().enumerate() {
        let layer = &mut layers[projection.target];
        let (window, all_to_all) = match &projection.connectivity {
            Connectivity::Conv2d { window, .. } => (*window, false),
            Connectivity::SumPool2d { window, .. } => (Window { groups: window.source.0, ..*window }, false),
            Connectivity::Dense { targets, .. } if (layer.shape.1, layer.shape.2) == (1, 1) => {
                let source = (network.populations()[projection.source].shape.len(), 1, 1);
                let once = (1, 1);
                let target = (*targets, 1, 1);
                let window =
                    Window { source, target, kernel: once, stride: once, padding: (0, 0), dilation: once, groups: 1 };
                (window, true)
            }
            _ => return None,
        };
        if layer.incoming.iter().any(|other| other.source == projection.source) {
            return None;
        }
        let format = formats.by_projection()[id.index()];
        layer.incoming.push(Incoming {
            source: projection.source,
            window,
            all_to_all,
            format,
            delay: projection.delay,
        });
    }
    for layer in layers.iter_mut() {
        let own =
            |incoming: &Incoming| incoming.window.groups == incoming.window.source.0 && incoming.window.groups > 1;
        layer.own_only = !layer.incoming.is_empty() && layer.incoming.iter().all(own);
    }
    Some(layers)
}

/// One axis of a window.
#[derive(Debug, Clone, Copy)]
pub struct Axis {
    kernel: u64,
    stride: u64,
    padding: u64,
    dilation: u64,
    source: u32,
    target: u32,
}

impl Axis {
    /// From north to south.
    #[must_use]
    pub fn rows(window: &Window) -> Self {
        Axis::of(window, |pair| pair.0, window.source.1, window.target.1)
    }

    /// From west to east.
    #[must_use]
    pub fn columns(window: &Window) -> Self {
        Axis::of(window, |pair| pair.1, window.source.2, window.target.2)
    }

    fn of(window: &Window, side: fn((u32, u32)) -> u32, source: u32, target: u32) -> Self {
        let of = |pair| u64::from(side(pair));
        let (kernel, stride) = (of(window.kernel), of(window.stride));
        Axis { kernel, stride, padding: of(window.padding), dilation: of(window.dilation), source, target }
    }

    /// Target positions, ascending, whose windows cover a source position.
    pub fn reached(self, source: u32) -> impl Iterator<Item = u32> {
        // Output o covers s at k when o stride - padding + k dilation = s.
        (0..self.kernel).rev().filter_map(move |k| {
            let at = (u64::from(source) + self.padding).checked_sub(k * self.dilation)?;
            let inside = at % self.stride == 0 && at / self.stride < u64::from(self.target);
            inside.then_some((at / self.stride) as u32)
        })
    }

    /// Source positions that may reach a part of the targets.
    fn under(self, part: &Range<u32>) -> Range<u32> {
        let first = (u64::from(part.start) * self.stride).saturating_sub(self.padding);
        let last = (u64::from(part.end) - 1) * self.stride + self.kernel.saturating_sub(1) * self.dilation;
        let end = (last + 1).saturating_sub(self.padding).min(u64::from(self.source));
        first.min(end) as u32..end as u32
    }

    /// The positions within a part that sources reach, and how many sources reach the same.
    fn patterns(self, part: &Range<u32>) -> Vec<(Vec<u16>, u64)> {
        let mut patterns: BTreeMap<Vec<u16>, u64> = BTreeMap::new();
        for source in self.under(part) {
            let reached: Vec<u16> =
                self.reached(source).filter(|at| part.contains(at)).map(|at| (at - part.start) as u16).collect();
            if !reached.is_empty() {
                *patterns.entry(reached).or_default() += 1;
            }
        }
        patterns.into_iter().collect()
    }
}

/// A part of an axis, with the patterns of every projection into the layer.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Side {
    size: u32,
    patterns: Vec<Vec<(Vec<u16>, u64)>>,
}

/// A part of the channels: how many of them sources reach, and how many sources reach so many.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Channels {
    size: u32,
    reached: Vec<Vec<(u32, u64)>>,
}

impl Channels {
    fn of(layer: &Layer, part: &Range<u32>) -> Self {
        let of = |incoming: &Incoming| {
            let window = &incoming.window;
            let (of_group, sources) = (window.target.0 / window.groups, window.source.0 / window.groups);
            let mut reached: BTreeMap<u32, u64> = BTreeMap::new();
            for group in part.start / of_group..=(part.end - 1) / of_group {
                let (from, to) = (part.start.max(group * of_group), part.end.min((group + 1) * of_group));
                *reached.entry(to - from).or_default() += u64::from(sources);
            }
            reached.into_iter().collect()
        };
        Channels { size: part.end - part.start, reached: layer.incoming.iter().map(of).collect() }
    }
}

/// Synapses of a box with sources in one population.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Arriving {
    /// The sources' population.
    pub source: PopulationId,
    /// In lists without indices.
    pub dense: u64,
    /// In lists with indices or runs.
    pub sparse: u64,
}

/// What a core that holds a box uses.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BoxUse {
    /// Everything but output axons and profiles.
    pub usage: CoreUsage,
    /// Its synapses, by where they come from.
    pub arriving: Arc<[Arriving]>,
}

fn use_of(layer: &Layer, formats: &Formats, limits: &Limits, parts: (&Channels, &Side, &Side)) -> BoxUse {
    let (channels, rows, columns) = parts;
    let compartments = channels.size * rows.size * columns.size;
    let reaching = |i: usize| !rows.patterns[i].is_empty() && !columns.patterns[i].is_empty();
    let reaching: Vec<usize> = (0..layer.incoming.len()).filter(|&i| reaching(i)).collect();
    let longest = reaching.iter().map(|&i| layer.incoming[i].delay).max().unwrap_or(Delay::MIN);
    let widths = Widths::of(compartments, longest, limits.packing);
    let (mut tallies, mut arriving) = (Tallies::default(), Vec::new());
    let mut slots: Vec<u16> = Vec::new();
    for &i in &reaching {
        let Incoming { source, format, delay, .. } = layer.incoming[i];
        let (mut dense, mut sparse) = (0, 0);
        for (reached_rows, of_rows) in &rows.patterns[i] {
            for (reached_columns, of_columns) in &columns.patterns[i] {
                for &(reached, of_channels) in &channels.reached[i] {
                    slots.clear();
                    if layer.own_only {
                        let height = rows.size;
                        let row = |c: u32, y: u16| (c * height + u32::from(y)) * columns.size;
                        let starts = (0..reached).flat_map(|c| reached_rows.iter().map(move |&y| row(c, y)));
                        slots.extend(starts.flat_map(|start| reached_columns.iter().map(move |&x| start as u16 + x)));
                    } else {
                        for &y in reached_rows {
                            let starts = reached_columns.iter().map(|&x| u32::from(y) * columns.size + u32::from(x));
                            slots.extend(
                                starts.flat_map(|at| (0..reached).map(move |c| (at * channels.size + c) as u16)),
                            );
                        }
                    }
                    let group = Group {
                        weight_bits: formats.get(format).bits,
                        synapses: slots.len() as u32,
                        delayed: delay > Delay::MIN,
                        dense: slots.windows(2).all(|pair| pair[1] == pair[0] + 1),
                        skip: skip_of(slots.windows(2).map(|pair| pair[1] - pair[0])),
                    };
                    let lists = of_rows * of_columns * of_channels;
                    tallies.lists(format, group, lists, widths, limits);
                    *if group.dense { &mut dense } else { &mut sparse } += lists * slots.len() as u64;
                }
            }
        }
        arriving.push(Arriving { source, dense, sparse });
    }
    let stored = tallies.stored(limits);
    let usage = CoreUsage {
        compartments,
        axons_in: tallies.axons,
        synapses: arriving.iter().map(|of| of.dense + of.sparse).sum(),
        synapse_words: stored.words,
        synapse_words_per_axon: stored.widest,
        synapse_formats: stored.formats.len() as u32,
        accumulators: compartments.saturating_mul(packing::delay_slots(longest)),
        ..CoreUsage::default()
    };
    BoxUse { usage, arriving: arriving.into() }
}

/// Where a layer is cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Lattice {
    /// Channels, rows and columns of a box; those at the end may be smaller.
    pub size: (u32, u32, u32),
    /// Boxes along channels, rows and columns.
    along: (u32, u32, u32),
}

impl Lattice {
    /// A layer of this shape in boxes of this size; `None` when a box has no or more sides than the layer.
    #[must_use]
    pub fn new(shape: (u32, u32, u32), size: (u32, u32, u32)) -> Option<Self> {
        let within = |length: u32, size: u32| (1..=length).contains(&size).then(|| length.div_ceil(size));
        let along = (within(shape.0, size.0)?, within(shape.1, size.1)?, within(shape.2, size.2)?);
        Some(Lattice { size, along })
    }

    /// Number of boxes.
    #[must_use]
    pub fn boxes(&self) -> u32 {
        self.along.0 * self.along.1 * self.along.2
    }

    /// Boxes (channels, row, column) in the order of cores: rows of boxes run to and fro.
    pub fn order(&self) -> impl Iterator<Item = (u32, u32, u32)> + use<> {
        let (channels, rows, columns) = self.along;
        (0..rows).flat_map(move |y| {
            let column = move |x: u32| if y.is_multiple_of(2) { x } else { columns - 1 - x };
            (0..columns).flat_map(move |x| (0..channels).map(move |c| (c, y, column(x))))
        })
    }

    /// The place of a box in that order.
    #[must_use]
    pub fn number(&self, (c, y, x): (u32, u32, u32)) -> u32 {
        let x = if y.is_multiple_of(2) { x } else { self.along.2 - 1 - x };
        (y * self.along.2 + x) * self.along.0 + c
    }

    /// Indices of the compartments of every box, in slot order.
    pub fn members(self, layer: &Layer) -> impl Iterator<Item = Vec<u32>> + use<'_> {
        self.order().map(move |at| tiles::cell(layer.shape, self.size, at, layer.own_only))
    }
}

/// A layer cut into boxes, a core each.
#[derive(Debug, Clone)]
pub struct Cut {
    /// Where.
    pub lattice: Lattice,
    kinds: [Vec<u32>; 3],
    uses: HashMap<(u32, u32, u32), BoxUse>,
}

fn parts(length: u32, size: u32) -> impl Iterator<Item = Range<u32>> {
    (0..length.div_ceil(size)).map(move |at| at * size..((at + 1) * size).min(length))
}

/// Distinct items and the number of each item's kind.
fn kinds<T: Eq + std::hash::Hash + Clone>(items: impl Iterator<Item = T>) -> (Vec<T>, Vec<u32>) {
    let (mut distinct, mut known): (Vec<T>, HashMap<T, u32>) = (Vec::new(), HashMap::new());
    let numbers = items
        .map(|item| {
            *known.entry(item).or_insert_with_key(|item| {
                distinct.push(item.clone());
                distinct.len() as u32 - 1
            })
        })
        .collect();
    (distinct, numbers)
}

/// What a box needs beyond a limit.
fn excess(used: &BoxUse, limits: &Limits) -> bool {
    used.usage.excesses(limits).next().is_some()
}

impl Cut {
    /// A layer cut here.
    #[must_use]
    pub fn new(layer: &Layer, lattice: Lattice, formats: &Formats, limits: &Limits) -> Self {
        let ((c, h, w), size) = (layer.shape, lattice.size);
        let side = |axis: fn(&Window) -> Axis, part: Range<u32>| Side {
            size: part.end - part.start,
            patterns: layer.incoming.iter().map(|incoming| axis(&incoming.window).patterns(&part)).collect(),
        };
        let (channels, of_channels) = kinds(parts(c, size.0).map(|part| Channels::of(layer, &part)));
        let (rows, of_rows) = kinds(parts(h, size.1).map(|part| side(Axis::rows, part)));
        let (columns, of_columns) = kinds(parts(w, size.2).map(|part| side(Axis::columns, part)));
        let mut uses = HashMap::new();
        for (i, channels) in channels.iter().enumerate() {
            for (j, rows) in rows.iter().enumerate() {
                for (k, columns) in columns.iter().enumerate() {
                    let used = use_of(layer, formats, limits, (channels, rows, columns));
                    uses.insert((i as u32, j as u32, k as u32), used);
                }
            }
        }
        Cut { lattice, kinds: [of_channels, of_rows, of_columns], uses }
    }

    /// The first grid, in the order of boxes and then of messages, of which every box fits a core with at most so many
    /// compartments.
    ///
    /// # Errors
    /// What one compartment alone uses, when no grid was found.
    pub fn of(layer: &Layer, formats: &Formats, limits: &Limits, most: u32) -> Result<Self, BoxUse> {
        let windows: Vec<Window> = layer.incoming.iter().map(|incoming| incoming.window).collect();
        let most = most.min(limits.compartments).min(packing::MOST_SLOTS);
        let mut cut = None;
        tiles::first_that_fits(&tiles::grids(&windows, layer.shape, limits, most), TRIALS, |Grid { size, .. }| {
            // Most grids that do not fit are known by a box in the middle, whose windows are whole.
            if excess(&Cut::middle(layer, *size, formats, limits), limits) {
                return false;
            }
            let Some(lattice) = Lattice::new(layer.shape, *size) else { return false };
            let found = Cut::new(layer, lattice, formats, limits);
            let fits = !found.uses.values().any(|used| excess(used, limits));
            cut = fits.then_some(found);
            fits
        });
        cut.map_or_else(
            || {
                let alone = Cut::middle(layer, (1, 1, 1), formats, limits);
                let lattice = Lattice { size: (1, 1, 1), along: layer.shape };
                let found = Cut::new(layer, lattice, formats, limits);
                if found.uses.values().any(|used| excess(used, limits)) { Err(alone) } else { Ok(found) }
            },
            Ok,
        )
    }

    fn middle(layer: &Layer, size: (u32, u32, u32), formats: &Formats, limits: &Limits) -> BoxUse {
        let at = tiles::middle(layer.shape, size);
        let part = |length: u32, size: u32, at: u32| at * size..((at + 1) * size).min(length);
        let side = |axis: fn(&Window) -> Axis, part: Range<u32>| Side {
            size: part.end - part.start,
            patterns: layer.incoming.iter().map(|incoming| axis(&incoming.window).patterns(&part)).collect(),
        };
        let channels = Channels::of(layer, &part(layer.shape.0, size.0, at.0));
        let rows = side(Axis::rows, part(layer.shape.1, size.1, at.1));
        let columns = side(Axis::columns, part(layer.shape.2, size.2, at.2));
        use_of(layer, formats, limits, (&channels, &rows, &columns))
    }

    /// The kind of a box: boxes of one kind use the same.
    #[must_use]
    pub fn kind(&self, (c, y, x): (u32, u32, u32)) -> (u32, u32, u32) {
        (self.kinds[0][c as usize], self.kinds[1][y as usize], self.kinds[2][x as usize])
    }

    /// What the core of a box uses.
    #[must_use]
    pub fn used(&self, at: (u32, u32, u32)) -> &BoxUse {
        &self.uses[&self.kind(at)]
    }
}
