//! One population over space: what reaches a box of it, from the geometry of its windows alone.
//!
//! In comes a network in which every projection is a window or all to all; out go its [`Layer`]s, the ways of cutting a
//! layer into boxes, and what a core that holds a box uses. A window reaches rows and columns independently of each other,
//! so the lists of a box are the products of patterns of rows, of columns and of channels: sources with the same patterns
//! have lists of the same make-up, which is counted once, and places whose patterns are the same but for where they begin
//! are a class that may share a table ([`crate::compile::share`]). The counts are those of [`crate::compile::usage`], output
//! axons excepted; a test holds them to it. They could only be greater where two different parts of a kernel have the same
//! weights.

use std::collections::{BTreeMap, HashMap};
use std::ops::Range;

use crate::base::fixed::Delay;
use crate::base::id::{Id, IdVec, PopulationId};
use crate::compile::axis::{Axis, Pattern, relative};
use crate::compile::formats::Formats;
use crate::compile::packing::{self, Group, Widths};
use crate::compile::partition::tiles::{self, Grid, Reaching};
use crate::compile::share::{self, Class, Places};
use crate::compile::usage::{Tallies, Words, skip_of};
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
    /// Channels and positions of a source population that has places.
    placed: Option<(u32, u64)>,
    /// Whether all its weights are the same.
    uniform: bool,
    /// Compartments of the source; `None` for inputs.
    from: Option<u32>,
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
    let (formats, places) = (Formats::of(network), Places::of(network));
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
        let placed = match network.populations()[projection.source].shape.volume() {
            Some((channels, height, width)) if places.holds(network, projection.source) => {
                Some((channels, u64::from(height) * u64::from(width)))
            }
            _ => None,
        };
        layer.incoming.push(Incoming {
            source: projection.source,
            window,
            all_to_all,
            placed,
            from: network.populations()[projection.source]
                .first_compartment()
                .map(|_| network.populations()[projection.source].shape.len()),
            uniform: matches!(projection.connectivity, Connectivity::SumPool2d { .. }),
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

/// A part of an axis, with the patterns of every projection into the layer.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Side {
    size: u32,
    patterns: Vec<Vec<(Pattern, u64)>>,
}

impl Side {
    fn of(layer: &Layer, axis: fn(&Window) -> Axis, part: &Range<u32>) -> Self {
        let patterns = |incoming: &Incoming| axis(&incoming.window).uniform(incoming.uniform).patterns(part);
        Side { size: part.end - part.start, patterns: layer.incoming.iter().map(patterns).collect() }
    }
}

/// A part of the channels: how many of them sources reach, and how many sources reach so many; and the last such source.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Channels {
    size: u32,
    reached: Vec<Vec<(u32, u64)>>,
    last: Vec<u32>,
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
        let last = |incoming: &Incoming| {
            let window = &incoming.window;
            let group = (part.end - 1) / (window.target.0 / window.groups);
            (group + 1) * (window.source.0 / window.groups) - 1
        };
        let (reached, last) = layer.incoming.iter().map(|incoming| (of(incoming), last(incoming))).unzip();
        Channels { size: part.end - part.start, reached, last }
    }
}

/// What a core that holds a box uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BoxUse {
    /// Everything but output axons and profiles.
    pub usage: CoreUsage,
    /// Of its synapses, those in lists without indices.
    pub dense: u64,
}

fn use_of(layer: &Layer, formats: &Formats, limits: &Limits, parts: (&Channels, &Side, &Side)) -> BoxUse {
    let (channels, rows, columns) = parts;
    let compartments = channels.size * rows.size * columns.size;
    let reaching = |i: usize| !rows.patterns[i].is_empty() && !columns.patterns[i].is_empty();
    let reaching: Vec<usize> = (0..layer.incoming.len()).filter(|&i| reaching(i)).collect();
    let longest = reaching.iter().map(|&i| layer.incoming[i].delay).max().unwrap_or(Delay::MIN);
    let widths = Widths::of(compartments, longest, limits.packing);
    let (mut tallies, mut synapses, mut dense) = (Tallies::default(), 0, 0);
    let mut classes = Classes::default();
    let mut slots: Vec<u16> = Vec::new();
    for &i in &reaching {
        let Incoming { format, delay, placed, all_to_all, .. } = layer.incoming[i];
        for (reached_rows, of_rows) in &rows.patterns[i] {
            for (reached_columns, of_columns) in &columns.patterns[i] {
                let mut place = Place::default();
                for &(reached, of_channels) in &channels.reached[i] {
                    slots.clear();
                    if layer.own_only {
                        let height = rows.size;
                        let row = |c: u32, y: u16| (c * height + u32::from(y)) * columns.size;
                        let starts = (0..reached).flat_map(|c| reached_rows.iter().map(move |&(y, _)| row(c, y)));
                        slots.extend(
                            starts.flat_map(|start| reached_columns.iter().map(move |&(x, _)| start as u16 + x)),
                        );
                    } else {
                        for &(y, _) in reached_rows {
                            let starts =
                                reached_columns.iter().map(|&(x, _)| u32::from(y) * columns.size + u32::from(x));
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
                    place.lists(of_channels, tallies.lists(format, group, lists, widths, limits));
                    synapses += lists * slots.len() as u64;
                    dense += if group.dense { lists * slots.len() as u64 } else { 0 };
                }
                let first_slot = {
                    let at = u32::from(reached_rows[0].0) * columns.size + u32::from(reached_columns[0].0);
                    if layer.own_only { at } else { at * channels.size }
                };
                let Some((atoms, positions)) = placed else { continue };
                let behind = first_slot as u16 - share::base_of(first_slot as u16);
                if all_to_all {
                    // Every source has weights of its own; all channels of a position reach the box.
                    let place = place.part(positions);
                    (0..positions).for_each(|_| classes.alone(place, atoms as u16));
                } else {
                    let kind = (i, relative(reached_rows), relative(reached_columns), behind);
                    classes.add(kind, of_rows * of_columns, place, channels.last[i] as u16 + 1);
                }
            }
        }
    }
    tallies.share([&classes.ways[0], &classes.ways[1]], limits);
    BoxUse { usage: tallies.usage(compartments, synapses, longest, limits), dense }
}

/// The lists of one place.
#[derive(Debug, Clone, Copy, Default)]
struct Place {
    lists: u64,
    /// Without and with runs: words as lists of discrete axons, and the fewest and the most of a list in a table.
    ways: [(u64, Option<(u32, u32)>); 2],
}

impl Place {
    fn lists(&mut self, lists: u64, words: [Words; 2]) {
        self.lists += lists;
        for (way, words) in self.ways.iter_mut().zip(words) {
            way.0 += lists * u64::from(words.discrete);
            let (least, most) = way.1.unwrap_or((words.in_table, words.in_table));
            way.1 = Some((least.min(words.in_table), most.max(words.in_table)));
        }
    }

    /// One of so many places with the same lists each.
    fn part(mut self, places: u64) -> Self {
        self.lists /= places;
        self.ways.iter_mut().for_each(|way| way.0 /= places);
        self
    }

    fn class(&self, way: usize, atoms: u16) -> Class {
        let (words, list_words) = self.ways[way];
        let list_words = list_words.unwrap_or_default();
        Class { places: 1, lists: self.lists as u32, atoms, words: words as u32, list_words }
    }
}

/// Projection, relative patterns of rows and columns, and how far behind its base a place begins.
type Kind = (usize, Pattern, Pattern, u16);

/// Classes of places of a box.
#[derive(Debug, Default)]
struct Classes {
    known: HashMap<Kind, usize>,
    ways: [Vec<Class>; 2],
}

impl Classes {
    fn alone(&mut self, place: Place, atoms: u16) {
        self.ways.iter_mut().enumerate().for_each(|(way, classes)| classes.push(place.class(way, atoms)));
    }

    fn add(&mut self, kind: Kind, places: u64, place: Place, atoms: u16) {
        let at = *self.known.entry(kind).or_insert(self.ways[0].len());
        if at == self.ways[0].len() {
            self.alone(place, atoms);
            self.ways.iter_mut().for_each(|classes| classes[at].places = 0);
        }
        self.ways.iter_mut().for_each(|classes| classes[at].places += places as u32);
    }
}

/// A layer cut into boxes, a core each.
#[derive(Debug, Clone)]
pub struct Cut {
    /// Channels, rows and columns of a box; those at the end may be smaller.
    pub size: (u32, u32, u32),
    /// Boxes along channels, rows and columns.
    along: (u32, u32, u32),
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
    fn new(layer: &Layer, size: (u32, u32, u32), formats: &Formats, limits: &Limits) -> Self {
        let (c, h, w) = layer.shape;
        let (channels, of_channels) = kinds(parts(c, size.0).map(|part| Channels::of(layer, &part)));
        let (rows, of_rows) = kinds(parts(h, size.1).map(|part| Side::of(layer, Axis::rows, &part)));
        let (columns, of_columns) = kinds(parts(w, size.2).map(|part| Side::of(layer, Axis::columns, &part)));
        let mut uses = HashMap::new();
        for (i, channels) in channels.iter().enumerate() {
            for (j, rows) in rows.iter().enumerate() {
                for (k, columns) in columns.iter().enumerate() {
                    let used = use_of(layer, formats, limits, (channels, rows, columns));
                    uses.insert((i as u32, j as u32, k as u32), used);
                }
            }
        }
        let along = (of_channels.len() as u32, of_rows.len() as u32, of_columns.len() as u32);
        Cut { size, along, kinds: [of_channels, of_rows, of_columns], uses }
    }

    /// The first grid, in the order of boxes and then of messages, of which every box fits a core with at most so many
    /// compartments.
    ///
    /// # Errors
    /// What one compartment alone uses, when no grid was found.
    pub fn of(layer: &Layer, formats: &Formats, limits: &Limits, most: u32) -> Result<Self, BoxUse> {
        let reaching = |incoming: &Incoming| Reaching {
            window: incoming.window,
            weight_bits: formats.get(incoming.format).bits.get(),
            uniform: incoming.uniform,
            from: incoming.from,
        };
        let windows: Vec<Reaching> = layer.incoming.iter().map(reaching).collect();
        let most = most.min(limits.compartments).min(packing::MOST_SLOTS);
        let mut cut = None;
        tiles::first_that_fits(&tiles::grids(&windows, layer.shape, limits, most), TRIALS, |Grid { size, .. }| {
            // Most grids that do not fit are known by a box in the middle, whose windows are whole.
            if excess(&Cut::middle(layer, *size, formats, limits), limits) {
                return false;
            }
            let found = Cut::new(layer, *size, formats, limits);
            let fits = !found.uses.values().any(|used| excess(used, limits));
            cut = fits.then_some(found);
            fits
        });
        cut.map_or_else(
            || {
                let alone = Cut::middle(layer, (1, 1, 1), formats, limits);
                let found = Cut::new(layer, (1, 1, 1), formats, limits);
                if found.uses.values().any(|used| excess(used, limits)) { Err(alone) } else { Ok(found) }
            },
            Ok,
        )
    }

    fn middle(layer: &Layer, size: (u32, u32, u32), formats: &Formats, limits: &Limits) -> BoxUse {
        let at = tiles::middle(layer.shape, size);
        let part = |length: u32, size: u32, at: u32| at * size..((at + 1) * size).min(length);
        let channels = Channels::of(layer, &part(layer.shape.0, size.0, at.0));
        let rows = Side::of(layer, Axis::rows, &part(layer.shape.1, size.1, at.1));
        let columns = Side::of(layer, Axis::columns, &part(layer.shape.2, size.2, at.2));
        use_of(layer, formats, limits, (&channels, &rows, &columns))
    }

    /// Number of boxes.
    #[must_use]
    pub fn boxes(&self) -> u32 {
        self.along.0 * self.along.1 * self.along.2
    }

    /// Boxes (channels, row, column) in the order of cores: rows of boxes run to and fro.
    pub fn order(&self) -> impl Iterator<Item = (u32, u32, u32)> {
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

    /// The kind of a box: boxes of one kind use the same.
    #[must_use]
    pub fn kind(&self, (c, y, x): (u32, u32, u32)) -> (u32, u32, u32) {
        (self.kinds[0][c as usize], self.kinds[1][y as usize], self.kinds[2][x as usize])
    }

    /// What the core of a box uses.
    #[must_use]
    pub fn used(&self, at: (u32, u32, u32)) -> BoxUse {
        self.uses[&self.kind(at)]
    }
}
