//! Resource use of boxes of a layer, from the geometry of its windows alone.
//!
//! Input: a population that windows (or all sources) reach. Output: the use of a core that holds a
//! box of it (channels x rows x columns). A window reaches rows and columns independently, so the
//! lists of a box are products of fields of rows, columns and channels. Sources with equal fields
//! have lists of equal make-up, which is counted once. Places whose fields differ in their start
//! only are a class that may share a table ([`crate::resources::axon_sharing`]). The counts equal
//! the counts by [`crate::resources::exact`], output axons and profiles excepted; a test compares
//! them. They could only be greater where two different parts of a kernel have the same weights.

use std::collections::{BTreeMap, HashMap};
use std::ops::Range;
use std::sync::Arc;

use crate::resources::axon_sharing::{self, PlaceClass, Places};
use crate::resources::counter::{CoreTotals, ListCounter, Words, skip_bits_for};
use crate::resources::formats::{CoreWords, Formats, Lists, are_counted, by_channel, stored_delay, weight_bits};
use crate::resources::packing::{Group, Widths};
use crate::resources::receptive_field::{ReceptiveField, WindowAxis, relative};
use nsim_ir::base::fixed::Delay;
use nsim_ir::base::id::{Id, PopulationId};
use nsim_ir::graph::Window;
use nsim_ir::neurons::NeuronKind;
use nsim_ir::partition::CoreUsage;
use nsim_ir::quantised::Quantised;
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::resource::{Limits, OutputAxons, Resource};

/// A projection into a layer.
#[derive(Debug, Clone, Copy)]
pub struct Incoming {
    /// Source population.
    pub source: PopulationId,
    /// Its window; a layer that all sources reach has a window of one position.
    pub window: Window,
    /// Whether every source reaches every target.
    pub all_to_all: bool,
    /// Channels and positions of a source population that has places.
    pub placed: Option<(u32, u64)>,
    /// Whether all its weights are equal.
    pub uniform: bool,
    /// Compartments of the source; `None` for inputs, which take no output axon.
    pub from: Option<u32>,
    /// Most synapses that a core stores for one channel of the targets. Weights of 0 are included
    /// where all sources reach all targets.
    pub stored: u64,
    /// Bits of its weights.
    pub weight_bits: u32,
    /// Index of its format among the network's formats.
    pub format: u16,
    /// Its delay.
    pub delay: Delay,
}

/// A population and its incoming projections.
#[derive(Debug, Clone)]
pub struct Layer {
    /// Channels, height and width.
    pub shape: (u32, u32, u32),
    /// Its incoming projections, in the order of the file.
    pub incoming: Vec<Incoming>,
    /// Whether compartments are in the order of channels. They are where each channel receives
    /// input from its own channel only.
    pub by_channel: bool,
    /// The kind of its neurons.
    pub kind: Option<NeuronKind>,
    /// Whether two projections come from one population. Its lists then combine both, which is not
    /// counted here.
    pub joined: bool,
}

impl Layer {
    /// Returns a population and its incoming projections; `None` when one of them is neither a
    /// window nor all to all.
    pub fn for_population(network: &Quantised, id: PopulationId, formats: &Formats, places: &Places) -> Option<Self> {
        let shape_of = |id: PopulationId| network.populations()[id].shape;
        let shape = shape_of(id).volume().unwrap_or((shape_of(id).len(), 1, 1));
        let (mut incoming, mut joined): (Vec<Incoming>, _) = (Vec::new(), false);
        for (id, projection) in network.incoming(id) {
            let source = projection.source;
            let (window, all_to_all) = match (projection.connectivity.window(), &projection.connectivity) {
                (Some(window), _) => (window, false),
                (None, Connectivity::Dense { targets, .. }) if (shape.1, shape.2) == (1, 1) => {
                    let (source, target, once) = ((shape_of(source).len(), 1, 1), (*targets, 1, 1), (1, 1));
                    let (kernel, stride, dilation) = (once, once, once);
                    (Window { source, target, kernel, stride, padding: (0, 0), dilation, groups: 1 }, true)
                }
                _ => return None,
            };
            joined |= incoming.iter().any(|other| other.source == source);
            let positions = |(channels, height, width)| (channels, u64::from(height) * u64::from(width));
            incoming.push(Incoming {
                source,
                window,
                all_to_all,
                placed: shape_of(source).volume().map(positions).filter(|_| places.contain(network, source)),
                from: network.populations()[source].first_compartment().map(|_| shape_of(source).len()),
                uniform: matches!(projection.connectivity, Connectivity::SumPool2d { .. }),
                stored: by_channel(projection).into_iter().max().unwrap_or(window.source.0.into()),
                weight_bits: weight_bits(network, projection),
                format: formats.by_projection()[id.index()],
                delay: stored_delay(network, projection),
            });
        }
        let by_channel = !incoming.is_empty()
            && incoming.iter().all(|of| of.window.groups == of.window.source.0 && of.window.groups > 1);
        let kind = network.populations()[id].neuron_kind();
        Some(Layer { shape, incoming, by_channel, kind, joined })
    }

    /// Use of a core that holds the middle box, whose windows are whole, for boxes of this size.
    pub fn middle(&self, size: (u32, u32, u32), formats: &Formats, limits: &Limits) -> BoxUse {
        let at = middle(self.shape, size);
        let channels = Channels::of_part(self, &part(self.shape.0, size.0, at.0));
        let rows = Side::of_part(self, WindowAxis::rows, &part(self.shape.1, size.1, at.1));
        let columns = Side::of_part(self, WindowAxis::columns, &part(self.shape.2, size.2, at.2));
        use_of(self, formats, limits, Parts { channels: &channels, rows: &rows, columns: &columns })
    }
}

/// A receptive field, and the number of sources with it.
type Field = (ReceptiveField, u64);

/// A part of an axis, with the receptive fields of every projection into the layer.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Side {
    /// Length of the part.
    pub size: u32,
    /// Fields by projection.
    fields: Vec<Vec<Field>>,
}

impl Side {
    /// Returns the fields of a part of one axis of a layer.
    pub fn of_part(layer: &Layer, axis: fn(&Window) -> WindowAxis, part: &Range<u32>) -> Self {
        let fields = |incoming: &Incoming| axis(&incoming.window).uniform(incoming.uniform).fields(part);
        Side { size: part.end - part.start, fields: layer.incoming.iter().map(fields).collect() }
    }

    /// Index of a field among the fields of a projection.
    pub fn number_of(&self, projection: usize, field: &ReceptiveField) -> Option<u32> {
        self.fields[projection].binary_search_by(|(other, _)| other.cmp(field)).ok().map(|at| at as u32)
    }
}

/// A part of the channels. By projection: numbers of channels reached, with the number of source
/// channels that reach as many; and the last such source channel.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Channels {
    /// Number of channels in the part.
    pub size: u32,
    reached: Vec<Vec<(u32, u64)>>,
    last: Vec<u32>,
}

impl Channels {
    /// Returns the channels of a part of a layer.
    pub fn of_part(layer: &Layer, part: &Range<u32>) -> Self {
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

/// Indices of the box in the middle of a grid of boxes; its windows are whole.
pub fn middle(shape: (u32, u32, u32), size: (u32, u32, u32)) -> (u32, u32, u32) {
    (middle_of(shape.0, size.0), middle_of(shape.1, size.1), middle_of(shape.2, size.2))
}

/// Part `at` of an axis that is cut into parts of `size`; the last may be smaller.
pub fn part(length: u32, size: u32, at: u32) -> Range<u32> {
    at * size..((at + 1) * size).min(length)
}

/// Index of the middle part of an axis that is cut into parts of `size`.
pub fn middle_of(length: u32, size: u32) -> u32 {
    (length.div_ceil(size) - 1) / 2
}

/// Synapses of a box with sources in one population.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Arriving {
    /// Population of the sources.
    pub source: PopulationId,
    /// Synapses in lists without indices.
    pub dense: u64,
    /// Synapses in lists with indices or runs.
    pub sparse: u64,
}

/// Resource use of a core that holds a box.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BoxUse {
    /// Use of all resources but output axons and profiles.
    pub usage: CoreUsage,
    /// Its synapses, by source population.
    pub arriving: Arc<[Arriving]>,
    /// Source positions that are members of population axons, by projection into the layer.
    pub members: Arc<[Members]>,
}

/// Storage of the lists that a source position sends to a box.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Membership {
    /// As lists of discrete axons, at least some of them. If only some positions of a class share
    /// its table, none counts as a member.
    #[default]
    Discrete,
    /// As lists of a population axon that takes the slots of a discrete one (pop16).
    Short,
    /// As lists of any other population axon (pop32).
    Long,
}

/// Storage of the lists of a projection's source positions, by the indices of their fields of rows
/// and of columns.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Members {
    columns: usize,
    of: Vec<Membership>,
}

impl Members {
    /// Storage of the lists of the positions with these fields.
    pub fn get(&self, rows: u32, columns: u32) -> Membership {
        self.of.get(rows as usize * self.columns + columns as usize).copied().unwrap_or_default()
    }
}

impl BoxUse {
    /// Whether the use of any resource exceeds its limit.
    pub fn exceeds(&self, limits: &Limits) -> bool {
        self.usage.excesses(limits).next().is_some()
    }
}

/// A box: a part of each axis of a layer.
#[derive(Debug, Clone, Copy)]
pub struct Parts<'a> {
    /// Its channels.
    pub channels: &'a Channels,
    /// Its rows.
    pub rows: &'a Side,
    /// Its columns.
    pub columns: &'a Side,
}

/// Counts the lists of a box.
struct BoxCounter<'a> {
    layer: &'a Layer,
    formats: &'a Formats,
    limits: &'a Limits,
    parts: Parts<'a>,
    counter: ListCounter<'a>,
    classes: Classes,
    /// Slots of the list that is counted.
    slots: Vec<u16>,
}

impl BoxCounter<'_> {
    /// Counts the lists from the positions with these fields; returns the lists of one of them.
    fn count(&mut self, projection: usize, rows: &Field, columns: &Field, arriving: &mut Arriving) -> Place {
        let Incoming { format, delay, .. } = self.layer.incoming[projection];
        let mut place = Place::default();
        for &(reached, of_channels) in &self.parts.channels.reached[projection] {
            self.reach(reached, &rows.0, &columns.0);
            let slots = &self.slots;
            let group = Group {
                weight_bits: self.formats.get(format).bits,
                tag_bits: self.formats.tag_bits(format),
                synapses: slots.len() as u32,
                delayed: delay > Delay::MIN,
                dense: slots.windows(2).all(|pair| pair[1] == pair[0] + 1),
                skip: skip_bits_for(slots.windows(2).map(|pair| pair[1] - pair[0])),
            };
            let lists = rows.1 * columns.1 * of_channels;
            let words = self.counter.group(format, group);
            self.counter.lists(lists, words);
            if self.formats.get(format).is_plastic() {
                self.counter.learning(lists);
            }
            place.lists(of_channels, words);
            *if group.dense { &mut arriving.dense } else { &mut arriving.sparse } += lists * slots.len() as u64;
        }
        place
    }

    /// Puts the slots of these rows and columns of the first `channels` channels into `slots`.
    fn reach(&mut self, channels: u32, rows: &ReceptiveField, columns: &ReceptiveField) {
        let (parts, slots) = (self.parts, &mut self.slots);
        slots.clear();
        if self.layer.by_channel {
            for c in 0..channels {
                for &(y, _) in rows {
                    let row = (c * parts.rows.size + u32::from(y)) * parts.columns.size;
                    slots.extend(columns.iter().map(|&(x, _)| row as u16 + x));
                }
            }
        } else {
            for &(y, _) in rows {
                for &(x, _) in columns {
                    let at = (u32::from(y) * parts.columns.size + u32::from(x)) * parts.channels.size;
                    slots.extend((0..channels).map(|c| (at + c) as u16));
                }
            }
        }
    }

    /// The tables of the positions with these fields and lists; `None` where they have no places.
    fn tables(&mut self, projection: usize, rows: &Field, columns: &Field, place: Place) -> Option<Tables> {
        let Incoming { placed, all_to_all, .. } = self.layer.incoming[projection];
        let (atoms, positions) = placed?;
        let at = u32::from(rows.0[0].0) * self.parts.columns.size + u32::from(columns.0[0].0);
        let first_slot = if self.layer.by_channel { at } else { at * self.parts.channels.size } as u16;
        let base = axon_sharing::base_of(first_slot, self.limits);
        let (classes, atoms) = if all_to_all {
            // Every source has weights of its own; all channels of a position reach the box.
            let (first, place) = (self.classes.len(), place.part(positions));
            (0..positions).for_each(|_| self.classes.alone(place, atoms as u16));
            (first..self.classes.len(), atoms as u16)
        } else {
            let kind = (projection, relative(&rows.0), relative(&columns.0), first_slot - base);
            let atoms = self.parts.channels.last[projection] as u16 + 1;
            let class = self.classes.add(kind, rows.1 * columns.1, place, atoms);
            (class..class + 1, atoms)
        };
        Some(Tables { classes, long: axon_sharing::is_long(atoms, base, self.limits) })
    }
}

/// Use of a core that holds a box.
pub fn use_of(layer: &Layer, formats: &Formats, limits: &Limits, parts: Parts<'_>) -> BoxUse {
    let Parts { channels, rows, columns } = parts;
    let compartments = channels.size * rows.size * columns.size;
    let is_reaching = |&i: &usize| !rows.fields[i].is_empty() && !columns.fields[i].is_empty();
    let reaching: Vec<usize> = (0..layer.incoming.len()).filter(is_reaching).collect();
    let longest = reaching.iter().map(|&i| layer.incoming[i].delay).max().unwrap_or(Delay::MIN);
    let counter = ListCounter::new(formats, Widths::for_core(compartments, longest, limits.packing), limits);
    let classes = Classes::default();
    let mut lists = BoxCounter { layer, formats, limits, parts, counter, classes, slots: Vec::new() };
    let mut all_arriving = Vec::with_capacity(reaching.len());
    // By projection and pair of fields.
    let mut tables: Vec<Vec<Tables>> = vec![Vec::new(); layer.incoming.len()];
    for &i in &reaching {
        let mut arriving = Arriving { source: layer.incoming[i].source, dense: 0, sparse: 0 };
        for rows in &rows.fields[i] {
            for columns in &columns.fields[i] {
                let place = lists.count(i, rows, columns, &mut arriving);
                tables[i].extend(lists.tables(i, rows, columns, place));
            }
        }
        all_arriving.push(arriving);
    }
    let mut totals = CoreTotals { lists: lists.counter.totals(), ..CoreTotals::new(compartments, longest) };
    let forms = totals.lists.iter_mut().zip(&lists.classes.forms);
    let sharing: Vec<Vec<u32>> = forms.map(|(totals, classes)| totals.share(classes, limits)).collect();
    let form = usize::from(totals.stores_runs(limits));
    let membership = |tables: &Tables| tables.membership(&lists.classes.forms[form], &sharing[form]);
    let by_position = matches!(limits.output_axons, OutputAxons::PerPosition { .. });
    let members = tables.iter().zip(&columns.fields).map(|(of, columns)| match by_position {
        true => Members { columns: columns.len(), of: of.iter().map(membership).collect() },
        false => Members::default(),
    });
    let members = members.collect();
    if limits.is_limited(Resource::StoredSynapses) {
        let each: u64 = reaching.iter().map(|&i| layer.incoming[i].stored).sum();
        totals.stored = u64::from(channels.size) * each;
    }
    if are_counted(limits) {
        totals.words = words_of(layer, limits, parts);
    }
    totals.synapses = all_arriving.iter().map(|of| of.dense + of.sparse).sum();
    BoxUse { usage: totals.usage(limits), arriving: all_arriving.into(), members }
}

/// Words of a core that holds a box.
fn words_of(layer: &Layer, limits: &Limits, Parts { channels, rows, columns }: Parts<'_>) -> CoreWords {
    let (lists, positions) = (Lists::new(limits), u64::from(rows.size) * u64::from(columns.size));
    let compartments = u64::from(channels.size) * positions;
    let is_window = layer.incoming.iter().any(|incoming| !incoming.all_to_all);
    let mut words = CoreWords {
        neurons: compartments * layer.kind.map_or(0, |kind| limits.neuron_sizes.words_of(kind).into()),
        axon_map: if is_window { positions } else { compartments },
        groups: 1,
        ..CoreWords::default()
    };
    for (i, Incoming { window, all_to_all, weight_bits, .. }) in layer.incoming.iter().enumerate() {
        let covered = |side: &Side| side.fields[i].iter().map(|(_, sources)| sources).sum::<u64>();
        words.axons_in += if *all_to_all { u64::from(window.source.0) } else { covered(rows) * covered(columns) };
        for &(reached, sources) in &channels.reached[i] {
            words.synapses += match all_to_all {
                true => sources * lists.of_axon(reached.into(), *weight_bits),
                false => {
                    let kernel = u64::from(window.kernel.0) * u64::from(window.kernel.1);
                    sources * kernel * lists.of_row(reached.into(), *weight_bits)
                }
            };
        }
    }
    words
}

/// The classes of the positions with a pair of fields, and whether their axons are pop32 axons.
#[derive(Debug, Clone)]
struct Tables {
    classes: Range<usize>,
    long: bool,
}

impl Tables {
    /// Storage of the lists, from all classes and the number of places that share their tables.
    fn membership(&self, classes: &[PlaceClass], sharing: &[u32]) -> Membership {
        match (self.classes.clone().all(|class| sharing[class] == classes[class].places), self.long) {
            (false, _) => Membership::Discrete,
            (true, false) => Membership::Short,
            (true, true) => Membership::Long,
        }
    }
}

/// The lists of one place.
#[derive(Debug, Clone, Copy, Default)]
struct Place {
    lists: u64,
    /// Without and with runs: words as lists of discrete axons, and the fewest and the most words
    /// of a list in a table.
    forms: [(u64, Option<(u32, u32)>); 2],
}

impl Place {
    fn lists(&mut self, lists: u64, words: [Words; 2]) {
        self.lists += lists;
        for (form, words) in self.forms.iter_mut().zip(words) {
            form.0 += lists * u64::from(words.discrete);
            let (least, most) = form.1.unwrap_or((words.in_table, words.in_table));
            form.1 = Some((least.min(words.in_table), most.max(words.in_table)));
        }
    }

    /// The lists of one of `places` places with equal lists.
    fn part(mut self, places: u64) -> Self {
        self.lists /= places;
        self.forms.iter_mut().for_each(|form| form.0 /= places);
        self
    }

    fn class(&self, form: usize, atoms: u16) -> PlaceClass {
        let (words, list_words) = self.forms[form];
        let list_words = list_words.unwrap_or_default();
        PlaceClass { places: 1, lists: self.lists as u32, atoms, words: words as u32, list_words }
    }
}

/// Projection, relative fields of rows and columns, and distance from a base to the first slot.
type Kind = (usize, ReceptiveField, ReceptiveField, u16);

/// Classes of places of a box.
#[derive(Debug, Default)]
struct Classes {
    known: HashMap<Kind, usize>,
    forms: [Vec<PlaceClass>; 2],
}

impl Classes {
    fn alone(&mut self, place: Place, atoms: u16) {
        self.forms.iter_mut().enumerate().for_each(|(form, classes)| classes.push(place.class(form, atoms)));
    }

    fn len(&self) -> usize {
        self.forms[0].len()
    }

    /// Adds places to the class of their kind; returns its number.
    fn add(&mut self, kind: Kind, places: u64, place: Place, atoms: u16) -> usize {
        let at = *self.known.entry(kind).or_insert(self.forms[0].len());
        if at == self.forms[0].len() {
            self.alone(place, atoms);
            self.forms.iter_mut().for_each(|classes| classes[at].places = 0);
        }
        self.forms.iter_mut().for_each(|classes| classes[at].places += places as u32);
        at
    }
}
