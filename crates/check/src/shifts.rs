//! Finds the cores that are shifts of the first core of their class: the rule *Classes* of
//! [`crate::equivalence`].
//!
//! Input: a network, its number of copies, and a program for it. Output: for each core whether its
//! synapses have to be compared with the network's. The synapses of all other cores follow from the
//! first core of their class. The origin of network and program does not matter: the network's
//! copies are compared too.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use nsim_ir::base::id::{ClassId, CoreId, IdVec, PopulationId, ProjectionId};
use nsim_ir::messages::Messages;
use nsim_ir::program::Program;
use nsim_ir::quantised::{Population, Projection, Quantised, Units};

/// Sizes of one copy.
#[derive(Debug, Clone, Copy)]
struct Sizes {
    populations: u32,
    projections: u32,
    channels: u32,
    compartments: u32,
}

impl Sizes {
    /// Returns the sizes of one copy; `None` where the network is not `copies` equal copies.
    fn new(network: &Quantised, copies: u32) -> Option<Self> {
        let counts = [
            network.populations().len() as u32,
            network.projections().len() as u32,
            network.channels(),
            network.compartments(),
        ];
        if copies < 2 || counts.iter().any(|count| count % copies != 0) {
            return None;
        }
        let [populations, projections, channels, compartments] = counts.map(|count| count / copies);
        let sizes = Sizes { populations, projections, channels, compartments };
        (1..copies).all(|copy| is_copy(network, copy, sizes)).then_some(sizes)
    }
}

/// Difference between a core and the first of its class.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Shift {
    /// Number of copies by which all units are later.
    copies: i64,
    /// Population of all compartments, and the rows and columns by which they are further on.
    positions: Option<(PopulationId, (i64, i64))>,
}

/// Returns the rows and columns between two indices of a volume; `None` where their channels
/// differ.
fn distance(from: u32, to: u32, height: u32, width: u32) -> Option<(i64, i64)> {
    let plane = height * width;
    let at = |index: u32| (i64::from(index % plane / width), i64::from(index % width));
    let ((row, column), (to_row, to_column)) = (at(from), at(to));
    (from / plane == to / plane).then_some((to_row - row, to_column - column))
}

/// Sources, the valid range of their numbers after an addition, and the number to add.
type ShiftedSources = (Range<u32>, Range<i64>, i64);

/// Bounds on the rows and columns of sources of a population.
struct Bounds {
    population: PopulationId,
    rows: (i64, i64),
    columns: (i64, i64),
}

impl Bounds {
    /// Returns the bounds of these sources, by population; `None` where one is no volume.
    fn around(network: &Quantised, sources: &[u32]) -> Option<Vec<Self>> {
        let mut windows: Vec<(Range<u32>, (u32, u32), Bounds)> = Vec::new();
        for &source in sources {
            let at = match windows.iter().position(|(range, ..)| range.contains(&source)) {
                Some(at) => at,
                None => {
                    let range = |population: &Population| {
                        let first = network.first_source(population);
                        first..first + population.shape.len()
                    };
                    let mut all = network.populations().enumerate();
                    let (id, population) = all.find(|(_, population)| range(population).contains(&source))?;
                    let (_, height, width) = population.shape.volume()?;
                    let none = (i64::MAX, i64::MIN);
                    let bounds = Bounds { population: id, rows: none, columns: none };
                    windows.push((range(population), (height, width), bounds));
                    windows.len() - 1
                }
            };
            let (range, (height, width), bounds) = &mut windows[at];
            let position = (source - range.start) % (*height * *width);
            fn wider(of: (i64, i64), at: u32) -> (i64, i64) {
                (of.0.min(at.into()), of.1.max(at.into()))
            }
            bounds.rows = wider(bounds.rows, position / *width);
            bounds.columns = wider(bounds.columns, position % *width);
        }
        Some(windows.into_iter().map(|(.., bounds)| bounds).collect())
    }

    /// Whether the sources stay inside the volume, `down` rows and `right` columns further on.
    fn hold(&self, down: i64, right: i64, volume: (u32, u32, u32)) -> bool {
        let inside = |(low, high): (i64, i64), by: i64, size: u32| low + by >= 0 && high + by < i64::from(size);
        inside(self.rows, down, volume.1) && inside(self.columns, right, volume.2)
    }
}

struct Shifts<'a> {
    network: &'a Quantised,
    program: &'a Program,
    /// Sizes of one copy, where there are several.
    sizes: Option<Sizes>,
    /// For each class, bounds of the sources of the first core's input axons; `None` where some
    /// population is no volume.
    bounds: IdVec<ClassId, Option<Vec<Bounds>>>,
}

impl Shifts<'_> {
    /// Returns the shift between two cores of a class, from their compartments.
    fn between(&self, first: CoreId, core: CoreId) -> Option<Shift> {
        let [from, to] = [first, core].map(|core| &self.program.cores()[core].ids);
        let (one, other) = (from.first()?, to.first()?);
        let size = self.sizes.map_or(u32::MAX, |sizes| sizes.compartments);
        let copies = i64::from(other.0 / size) - i64::from(one.0 / size);
        let more = copies * i64::from(size);
        let pairs = || from.iter().zip(&**to).map(|(a, b)| (a.0, i64::from(b.0) - more));
        if copies != 0 && pairs().all(|(a, b)| i64::from(a) == b) {
            return Some(Shift { copies, positions: None });
        }
        let (id, _) = self.network.population_of(*one);
        let population = &self.network.populations()[id];
        let (first, (_, height, width)) = (population.first_compartment()?.0, population.shape.volume()?);
        let index = |id: i64| {
            let index = u32::try_from(id).ok()?.checked_sub(first)?;
            (index < population.shape.len()).then_some(index)
        };
        let apart = |(a, b): (u32, i64)| distance(index(a.into())?, index(b)?, height, width);
        let by = apart(pairs().next()?)?;
        pairs().all(|pair| apart(pair) == Some(by)).then_some(Shift { copies, positions: Some((id, by)) })
    }

    /// Returns the numbers that a shift adds to the sources of the first core of a class. `None`
    /// where a source would leave its population, or the network differs there.
    fn shifted_sources(&self, class: ClassId, Shift { copies, positions }: Shift) -> Option<Vec<ShiftedSources>> {
        let (network, channels) = (self.network, self.network.channels());
        let of_copies = |is_channel: bool| {
            let size = self.sizes.map_or(0, |sizes| if is_channel { sizes.channels } else { sizes.compartments });
            copies * i64::from(size)
        };
        fn within(range: Range<u32>, more: i64) -> Range<i64> {
            i64::from(range.start) + more..i64::from(range.end) + more
        }
        let Some((target, (rows, columns))) = positions else {
            let added = |range: Range<u32>, is_channel| (range.clone(), within(range, 0), of_copies(is_channel));
            let all = channels + network.compartments();
            return Some(vec![added(0..channels, true), added(channels..all, false)]);
        };
        let of_source = |bounds: &Bounds| {
            let population = &network.populations()[bounds.population];
            let into = network.outgoing(bounds.population).iter().map(|&id| &network.projections()[id]);
            let mut by = into.filter(|projection| projection.target == target).map(|projection| {
                let window = projection.connectivity.window()?;
                let volumes = [&network.populations()[target], population].map(|p| p.shape.volume());
                let (down, right) = (rows * i64::from(window.stride.0), columns * i64::from(window.stride.1));
                let same = volumes == [Some(window.target), Some(window.source)];
                (same && bounds.hold(down, right, window.source)).then_some(down * i64::from(window.source.2) + right)
            });
            let (first, one) = (network.first_source(population), by.next()??);
            let (range, later) = (first..first + population.shape.len(), of_copies(first < channels));
            by.all(|other| other == Some(one)).then(|| (range.clone(), within(range, later), later + one))
        };
        self.bounds[class].as_ref()?.iter().map(of_source).collect()
    }
}

/// Whether the synapses of each core have to be compared with the network's.
pub fn compared(network: &Quantised, program: &Program, copies: u32) -> IdVec<CoreId, bool> {
    let firsts = program.first_cores();
    if firsts.len() == program.cores().len() {
        return program.cores().iter().map(|_| true).collect();
    }
    let class = |core: CoreId| program.cores()[core].class;
    let is_first = |core: CoreId| firsts[class(core)] == core;
    let mut sources: IdVec<ClassId, Vec<u32>> =
        firsts.iter().map(|&first| vec![0; program.class_of(first).inputs.len()]).collect();
    let mut note = |source: u32, messages: Messages<'_>| {
        for message in messages.filter(|message| is_first(message.core)) {
            sources[class(message.core)][usize::from(message.axon)] = source;
        }
    };
    let channels = network.channels();
    (0..channels).for_each(|channel| note(channel, program.messages(channel)));
    for image in program.cores().iter().filter(|image| image.axons_out.cores().iter().any(|&core| is_first(core))) {
        image.ids.iter().zip(image.axons_out.iter()).for_each(|(id, messages)| note(channels + id.0, messages));
    }
    let bounds = sources.as_slice().par_iter().map(|of| Bounds::around(network, of)).collect::<Vec<_>>().into();
    let shifts = Shifts { network, program, sizes: Sizes::new(network, copies), bounds };
    let all: Vec<CoreId> = program.cores().ids().collect();
    let of = |&core: &CoreId| match is_first(core) {
        true => None,
        false => shifts.shifted_sources(class(core), shifts.between(firsts[class(core)], core)?),
    };
    let found: IdVec<CoreId, Option<Vec<ShiftedSources>>> = all.par_iter().map(of).collect::<Vec<_>>().into();
    let compared: IdVec<CoreId, AtomicBool> = found.iter().map(|added| AtomicBool::new(added.is_none())).collect();
    let look_at = |source: u32, messages: Messages<'_>| {
        for message in messages {
            let Some(added) = &found[message.core] else { continue };
            let of_first = sources[class(message.core)][usize::from(message.axon)];
            let leads = |(range, within, by): &ShiftedSources| {
                let source = i64::from(source);
                range.contains(&of_first) && within.contains(&source) && i64::from(of_first) + by == source
            };
            if !added.iter().any(leads) {
                compared[message.core].store(true, Ordering::Relaxed);
            }
        }
    };
    (0..channels).into_par_iter().for_each(|channel| look_at(channel, program.messages(channel)));
    program.cores().as_slice().par_iter().for_each(|image| {
        image.ids.iter().zip(image.axons_out.iter()).for_each(|(id, messages)| look_at(channels + id.0, messages));
    });
    compared.iter().map(|compared| compared.load(Ordering::Relaxed)).collect()
}

/// Whether a copy of the network equals the first, except for later numbers of its units.
fn is_copy(network: &Quantised, copy: u32, sizes: Sizes) -> bool {
    let population = |n: u32| {
        let [one, other] = [0, copy].map(|k| &network.populations()[PopulationId(k * sizes.populations + n)]);
        same_population(one, other, copy, sizes)
    };
    let projection = |n: u32| {
        let [one, other] = [0, copy].map(|k| &network.projections()[ProjectionId(k * sizes.projections + n)]);
        let of_copy = |id: PopulationId| id.0 < sizes.populations;
        of_copy(one.source) && of_copy(one.target) && same_projection(one, other, copy * sizes.populations)
    };
    (0..sizes.populations).all(population) && (0..sizes.projections).all(projection)
}

fn same_population(one: &Population, other: &Population, later: u32, sizes: Sizes) -> bool {
    let units = match (&one.units, &other.units) {
        (Units::Input(one), Units::Input(other)) => other.0 == one.0 + later * sizes.channels,
        (Units::Compartments { first: one, .. }, Units::Compartments { first: other, .. }) => {
            // Parameters have been compared with the program's, compartment by compartment.
            other.0 == one.0 + later * sizes.compartments
        }
        _ => false,
    };
    units && one.shape == other.shape && one.message == other.message
}

fn same_projection(one: &Projection, other: &Projection, later: u32) -> bool {
    other.source.0 == one.source.0 + later
        && other.target.0 == one.target.0 + later
        && one.format == other.format
        && one.delay == other.delay
        && one.connectivity == other.connectivity
}
