//! Cores that only windows reach.
//!
//! Input: a network of equal copies, and the compartments of a core. Output: the core's
//! [`Pattern`], if all its compartments belong to one population and only convolutions or pools
//! lead into it; and the synapses of such a core. Cores of one pattern have equal sources, shifted
//! by some rows and columns.
//!
//! A window reaches rows and columns independently. So a source's synapses on a core depend on its
//! field in both, which [`WindowAxis::pattern`] lists in order. A test compares these tables with
//! tables from all synapses.

use std::ops::Range;

use nsim_ir::base::fixed::Delay;
use nsim_ir::base::id::{CompartmentId, Id, IdVec, PopulationId, ProjectionId};
use nsim_ir::graph::{PerCompartment, Window};
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::quantised::{Neuron, Quantised, Units};
use nsim_partition::resources::formats::Formats;
use nsim_partition::resources::receptive_field::{ReceptiveField, WindowAxis};
use nsim_partition::resources::sorted_synapses::Key;

/// Sources of an axis that reach a core, relative to the first, and the field of each.
type ReachedSources = Vec<(u32, ReceptiveField)>;

/// Parameters of a core that decide its tables.
#[derive(Debug, PartialEq, Eq, Hash)]
pub struct Pattern {
    /// The population, in the first copy.
    population: PopulationId,
    /// Compartments in slot order, relative to the first row and column that is held.
    members: Vec<u32>,
    /// By window: rows and columns of sources, relative to the first, with the field of each.
    reached: Vec<[ReachedSources; 2]>,
    /// Their neurons, where each has separate parameters.
    neurons: Vec<Neuron>,
}

/// Origin of a window's sources.
#[derive(Debug, Clone, Copy)]
pub struct Origin {
    /// Number of the population's first source, in the first copy.
    pub first: u32,
    /// Number of sources.
    pub sources: u32,
    /// Index of the source at the first row and column that reach a core.
    pub at: i64,
}

/// A window into a population.
#[derive(Debug, Clone, Copy)]
struct Incoming<'n> {
    projection: ProjectionId,
    /// The number of the first source.
    first: u32,
    window: Window,
    weights: Weights<'n>,
}

/// The weights of a window.
#[derive(Debug, Clone, Copy)]
enum Weights<'n> {
    Kernel(&'n [i16]),
    Same(i16),
}

impl Incoming<'_> {
    /// Target channels of a channel of sources.
    fn reached(&self, channel: u32) -> Range<u32> {
        let outgoing = self.window.target.0 / self.window.groups;
        let group = channel / self.ingoing();
        group * outgoing..(group + 1) * outgoing
    }

    /// Number of source channels of a target channel.
    fn ingoing(&self) -> u32 {
        self.window.source.0 / self.window.groups
    }

    /// The weight between two channels at a place of the kernel.
    fn weight(&self, from: u32, to: u32, place: (u32, u32)) -> i16 {
        match self.weights {
            Weights::Kernel(kernel) => {
                let of_pair = to * self.ingoing() + from % self.ingoing();
                kernel[((of_pair * self.window.kernel.0 + place.0) * self.window.kernel.1 + place.1) as usize]
            }
            Weights::Same(weight) => weight,
        }
    }
}

/// By population of the first copy, the windows into it in the order of their sources; `None` where
/// other projections lead into it too, or two from one population.
#[derive(Debug)]
pub struct Windows<'n> {
    network: &'n Quantised,
    into: IdVec<PopulationId, Option<Vec<Incoming<'n>>>>,
}

/// Compartments of one population, with their rows and columns.
struct CoreWindows {
    population: PopulationId,
    indices: Vec<u32>,
    rows: Range<u32>,
    columns: Range<u32>,
    width: u32,
    height: u32,
    /// By window into it: the first row and column that reach these compartments, and the fields of
    /// all rows and columns that do.
    reached: Vec<[(u32, ReachedSources); 2]>,
}

impl<'n> Windows<'n> {
    /// The windows of a network of `copies` equal copies.
    pub fn new(network: &'n Quantised, copies: u32) -> Self {
        let ids = network.populations().ids().take(network.populations().len() / copies.max(1) as usize);
        let into = ids.map(|id| windows_into(network, id)).collect();
        Windows { network, into }
    }

    /// Returns these compartments, `later` compartments after the first copy; `None` where they
    /// belong to several populations, or theirs has other inputs than windows.
    fn core_windows(&self, held: &[CompartmentId], later: u32) -> Option<(CoreWindows, &[Incoming<'n>])> {
        let (id, _) = self.network.population_of(CompartmentId(held.first()?.0 - later));
        let incoming = self.into[id].as_ref()?;
        let population = &self.network.populations()[id];
        let (first, (_, height, width)) = (population.first_compartment()?.0 + later, population.shape.volume()?);
        let index = |id: &CompartmentId| id.0.checked_sub(first).filter(|index| *index < population.shape.len());
        let indices: Vec<u32> = held.iter().map(index).collect::<Option<_>>()?;
        let around = |places: &mut dyn Iterator<Item = u32>| {
            let (first, end) = places.fold((u32::MAX, 0), |(first, end), at| (first.min(at), end.max(at + 1)));
            first..end
        };
        let rows = around(&mut indices.iter().map(|index| index / width % height));
        let columns = around(&mut indices.iter().map(|index| index % width));
        let axes = |window| [WindowAxis::rows(window).pattern(&rows), WindowAxis::columns(window).pattern(&columns)];
        let reached = incoming.iter().map(|incoming| axes(&incoming.window)).collect();
        Some((CoreWindows { population: id, indices, rows, columns, width, height, reached }, incoming))
    }

    /// The pattern of these compartments, and the origin of each window's sources.
    pub fn pattern(&self, held: &[CompartmentId], later: u32) -> Option<(Pattern, Box<[Origin]>)> {
        let (CoreWindows { population, indices, rows, columns, width, reached, .. }, incoming) =
            self.core_windows(held, later)?;
        let origin = |(incoming, [(row, _), (column, _)]): (&Incoming<'_>, &[(u32, _); 2])| {
            let (channels, high, wide) = incoming.window.source;
            let at = i64::from(*row) * i64::from(wide) + i64::from(*column);
            Origin { first: incoming.first, sources: channels * high * wide, at }
        };
        let origins = incoming.iter().zip(&reached).map(origin).collect();
        let reached = reached.into_iter().map(|axes| axes.map(|(_, fields)| fields)).collect();
        let neurons = match &self.network.populations()[population].units {
            Units::Compartments { neurons: PerCompartment::Each(each), .. } => {
                indices.iter().map(|&index| each[index as usize]).collect()
            }
            _ => Vec::new(),
        };
        let corner = rows.start * width + columns.start;
        let members = indices.into_iter().map(|index| index - corner).collect();
        Some((Pattern { population, members, reached, neurons }, origins))
    }

    /// Synapses of a core that only windows reach, in the order of its lists, and their longest
    /// delay. `before`: channels and compartments in the copies before the core's.
    pub fn keys(&self, held: &[CompartmentId], before: [u32; 2], formats: &Formats) -> Option<(Vec<Key>, Delay)> {
        let (CoreWindows { indices, rows, columns, width, height, reached, .. }, incoming) =
            self.core_windows(held, before[1])?;
        let (mut keys, mut longest) = (Vec::new(), Delay::MIN);
        let channel = |index: u32| index / (width * height);
        let channels = indices.iter().map(|&index| channel(index));
        let (least, most) = (channels.clone().min()?, channels.max()?);
        let (high, wide) = (rows.end - rows.start, columns.end - columns.start);
        let place = |c: u32, y: u32, x: u32| (((c - least) * high + y) * wide + x) as usize;
        let mut slots: Vec<Option<u16>> = vec![None; place(most + 1, 0, 0)];
        for (slot, &index) in (0..).zip(&indices) {
            let (y, x) = (index / width % height, index % width);
            slots[place(channel(index), y - rows.start, x - columns.start)] = Some(slot);
        }
        for (incoming, [(row, of_rows), (column, of_columns)]) in incoming.iter().zip(&reached) {
            let window = &incoming.window;
            let first = incoming.first + before[usize::from(incoming.first >= self.network.channels())];
            let delay = self.network.projections()[incoming.projection].delay;
            let format = formats.by_projection()[incoming.projection.index()];
            let sources = (0..window.source.0).flat_map(|from| of_rows.iter().map(move |of_row| (from, of_row)));
            for (from, (down, fields)) in sources {
                let of_row = first + (from * window.source.1 + row + down) * window.source.2 + column;
                let reached = incoming.reached(from);
                for (right, across) in of_columns {
                    let begin = keys.len();
                    for to in reached.start.max(least)..reached.end.min(most + 1) {
                        let targets = fields.iter().flat_map(|y| across.iter().map(move |x| (y, x)));
                        keys.extend(targets.filter_map(|(&(y, ky), &(x, kx))| {
                            let slot = slots[place(to, y.into(), x.into())]?;
                            let weight = incoming.weight(from, to, (ky, kx));
                            Some(Key::new(of_row + right, format, slot, delay.get(), weight))
                        }));
                    }
                    if !keys[begin..].is_sorted() {
                        keys[begin..].sort_unstable();
                    }
                    longest = if keys.len() > begin { longest.max(delay) } else { longest };
                }
            }
        }
        Some((keys, longest))
    }
}

/// The windows into a population.
fn windows_into(network: &Quantised, id: PopulationId) -> Option<Vec<Incoming<'_>>> {
    let mut windows: Vec<Incoming<'_>> = Vec::new();
    for (projection, of) in network.incoming(id) {
        let window = of.connectivity.window()?;
        let weights = match &of.connectivity {
            Connectivity::Conv2d { kernel, .. } => Weights::Kernel(kernel),
            Connectivity::SumPool2d { weight, .. } => Weights::Same(*weight),
            _ => return None,
        };
        let first = network.first_source(&network.populations()[of.source]);
        if windows.iter().any(|other| other.first == first) {
            return None;
        }
        windows.push(Incoming { projection, first, window, weights });
    }
    windows.sort_unstable_by_key(|incoming| incoming.first);
    Some(windows)
}
