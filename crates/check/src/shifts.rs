//! Which cores are shifts of the first core of their class: the rule *Classes* of
//! [`crate::equivalence`].
//!
//! Input: a network, this many copies, and a program for it. Output: for each core whether its
//! synapses have to be compared with the network's. Those of the others follow from the first core
//! of their class. Nothing is assumed of how either was made: the network's copies are compared
//! too.

use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use nsim_ir::base::id::{ChannelId, ClassId, CompartmentId, CoreId, IdVec, PopulationId, ProjectionId};
use nsim_ir::program::{AxonTarget, Program};
use nsim_ir::quantised::connectivity::Connectivity;
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
    /// The sizes of one of these copies; `None` where the network is not that many equal ones.
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

/// How a core differs from the first of its class.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Shift {
    /// Everything is this many copies later.
    Copies(i64),
    /// All compartments are of this population, this many rows and columns further on.
    Positions(PopulationId, (i64, i64)),
}

/// Rows and columns between two indices of a volume so wide and high; `None` where they are of
/// different channels.
fn distance(from: u32, to: u32, height: u32, width: u32) -> Option<(i64, i64)> {
    let plane = height * width;
    let at = |index: u32| (i64::from(index % plane / width), i64::from(index % width));
    let ((row, column), (to_row, to_column)) = (at(from), at(to));
    (from / plane == to / plane).then_some((to_row - row, to_column - column))
}

struct Shifts<'a> {
    network: &'a Quantised,
    program: &'a Program,
    /// Of one copy, where there are several.
    sizes: Option<Sizes>,
    /// By class with several cores, the source of each input axon of the first.
    sources: IdVec<ClassId, Vec<u32>>,
}

impl Shifts<'_> {
    /// The shift between two cores of a class, from their compartments.
    fn between(&self, first: CoreId, core: CoreId) -> Option<Shift> {
        let [from, to] = [first, core].map(|core| &self.program.cores()[core].ids);
        let (one, other) = (from.first()?, to.first()?);
        let pairs = || from.iter().zip(to);
        if let Some(sizes) = self.sizes {
            let later = i64::from(other.0 / sizes.compartments) - i64::from(one.0 / sizes.compartments);
            let more = later * i64::from(sizes.compartments);
            if pairs().all(|(a, b)| i64::from(b.0) - i64::from(a.0) == more) {
                return Some(Shift::Copies(later));
            }
        }
        let (id, _) = self.network.population_of(*one);
        let population = &self.network.populations()[id];
        let (first, (_, height, width)) = (population.first_compartment()?, population.shape.volume()?);
        let index = |id: CompartmentId| id.0.checked_sub(first.0).filter(|&index| index < population.shape.len());
        let apart = |(&a, &b): (&CompartmentId, &CompartmentId)| distance(index(a)?, index(b)?, height, width);
        let shift = apart((one, other))?;
        pairs().all(|pair| apart(pair) == Some(shift)).then_some(Shift::Positions(id, shift))
    }

    /// Whether a source is where a shift has what is another source at the first core.
    fn leads(&self, shift: Shift, population: PopulationId, from: u32, to: u32) -> bool {
        let (network, channels) = (self.network, self.network.channels());
        match (shift, self.sizes) {
            (Shift::Copies(later), Some(sizes)) => {
                let size = if from < channels { sizes.channels } else { sizes.compartments };
                (from < channels) == (to < channels) && i64::from(to) - i64::from(from) == later * i64::from(size)
            }
            (Shift::Copies(_), None) => false,
            (Shift::Positions(target, (rows, columns)), _) => {
                let source = &network.populations()[population];
                let first = first_source(network, source);
                let Some(from) = from.checked_sub(first).filter(|&from| from < source.shape.len()) else {
                    return false;
                };
                let into = network.outgoing(population).iter().map(|&projection| &network.projections()[projection]);
                into.filter(|projection| projection.target == target).all(|projection| match &projection.connectivity {
                    Connectivity::Conv2d { window, .. } | Connectivity::SumPool2d { window, .. } => {
                        let (down, right) = (i64::from(window.stride.0), i64::from(window.stride.1));
                        let (_, height, width) = window.source;
                        network.populations()[target].shape.volume() == Some(window.target)
                            && distance(from, to - first, height, width) == Some((rows * down, columns * right))
                    }
                    _ => false,
                })
            }
        }
    }
}

/// Whether the synapses of each core have to be compared with the network's.
#[must_use]
pub fn compared(network: &Quantised, program: &Program, copies: u32) -> IdVec<CoreId, bool> {
    let firsts = program.first_cores();
    if firsts.len() == program.cores().len() {
        return program.cores().iter().map(|_| true).collect();
    }
    let is_first = |core: CoreId| firsts[program.cores()[core].class] == core;
    let sources = firsts.iter().map(|&first| vec![0; program.class_of(first).inputs.len()]).collect();
    let mut shifts = Shifts { network, program, sizes: Sizes::new(network, copies), sources };
    for population in network.populations() {
        let first = first_source(network, population);
        for index in 0..population.shape.len() {
            let messages = messages_of(program, &population.units, index).iter();
            for message in messages.filter(|message| is_first(message.core)) {
                let class = program.cores()[message.core].class;
                shifts.sources[class][usize::from(message.axon)] = first + index;
            }
        }
    }
    let all: Vec<CoreId> = program.cores().ids().collect();
    let of = |&core: &CoreId| match is_first(core) {
        true => None,
        false => shifts.between(firsts[program.cores()[core].class], core),
    };
    let found: IdVec<CoreId, Option<Shift>> = all.par_iter().map(of).collect::<Vec<_>>().into();
    let compared: IdVec<CoreId, AtomicBool> = found.iter().map(|shift| AtomicBool::new(shift.is_none())).collect();
    for (id, population) in network.populations().enumerate() {
        (0..population.shape.len()).into_par_iter().for_each(|index| {
            let source = first_source(network, population) + index;
            for message in messages_of(program, &population.units, index) {
                let Some(shift) = found[message.core] else { continue };
                let of_first = shifts.sources[program.cores()[message.core].class][usize::from(message.axon)];
                if !shifts.leads(shift, id, of_first, source) {
                    compared[message.core].store(true, Ordering::Relaxed);
                }
            }
        });
    }
    compared.iter().map(|compared| compared.load(Ordering::Relaxed)).collect()
}

fn first_source(network: &Quantised, population: &Population) -> u32 {
    match &population.units {
        Units::Input(first) => first.0,
        Units::Compartments { first, .. } => network.channels() + first.0,
    }
}

/// Whether a copy of the network is the first, its units numbered later.
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

/// The messages of a source's spike.
pub(super) fn messages_of<'a>(program: &'a Program, units: &Units, index: u32) -> &'a [AxonTarget] {
    match units {
        Units::Input(first) => program.channel(ChannelId(first.0 + index)),
        Units::Compartments { first, .. } => {
            let seat = program.seats()[CompartmentId(first.0 + index)];
            program.cores()[seat.core].axons_out.get(usize::from(seat.slot))
        }
    }
}
