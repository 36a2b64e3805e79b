//! Fan-out of the cores of boxes: whole boxes are reached, so destinations follow from positions.
//!
//! Input: layers, their cuts and the compartments of each core. Output: for each core, the distinct
//! sets of cores that its compartments' spikes reach, with numbers of compartments and of output
//! axons; and likewise for the input channels. Nothing is enumerated synapse by synapse: a source
//! position reaches some rows and some columns of boxes, and all boxes where they cross.

use std::collections::{BTreeMap, HashSet};
use std::ops::Range;

use rayon::prelude::*;

use crate::resources::closed_form::{Incoming, Layer, Membership, Side, part};
use crate::resources::fan_out::{ChipOf, axon_slots};
use crate::resources::receptive_field::WindowAxis;
use crate::strategy::lattice::Cut;
use crate::strategy::members::Members;
use nsim_ir::base::id::{CoreId, IdVec, PopulationId};
use nsim_ir::firing_rates::Rates;
use nsim_ir::quantised::Quantised;
use nsim_ir::resource::{Limits, OutputAxons};

/// Channels of one task.
const PIECE: u32 = 1 << 14;

/// Sources of one core, or of the inputs, that reach the same cores.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sends {
    /// Cores reached, ascending; the sources' own core may be among them.
    pub to: Vec<u32>,
    /// Number of sources.
    pub sources: u64,
    /// Output axons to each of these cores: one for the sources at a position whose spikes all go
    /// to population axons, one for each source otherwise.
    pub axons: u64,
    /// Number of these output axons, over all cores, that lead to pop32 axons.
    pub longer: u64,
}

/// Fan-out of all sources.
#[derive(Debug, Clone)]
pub struct BoxFanOut {
    /// Fan-out of the channels of each population.
    pub inputs: IdVec<PopulationId, Vec<Sends>>,
    /// Fan-out of the compartments of each core.
    pub cores: Vec<Vec<Sends>>,
}

/// Boxes of a layer: its cut and the number of its first core.
#[derive(Debug, Clone)]
pub struct Placed {
    /// The cut.
    pub cut: Cut,
    /// The first core.
    pub first: u32,
}

/// Boxes of each layer; none for inputs.
pub type PlacedLayers = IdVec<PopulationId, Option<Placed>>;

/// Destinations of one projection.
struct Outlet<'a> {
    to: &'a Placed,
    /// Its index among the projections into its target.
    projection: usize,
    reaches: Reaches,
}

/// Boxes that the sources of a projection reach.
enum Reaches {
    /// Every source reaches all.
    All,
    /// Boxes by row and by column of the source, each with the index of the source's field there;
    /// and boxes by channel.
    Window { rows: Vec<Vec<(u32, u32)>>, columns: Vec<Vec<(u32, u32)>>, channels: Vec<Range<u32>> },
}

/// The cores that a source reaches, ascending, and the storage of its lists there.
#[derive(Debug, Default)]
struct Reached {
    cores: Vec<u32>,
    /// Whether it is a member of a population axon on each.
    shared: bool,
    /// Number of these cores on which that axon is pop32.
    longer: u64,
}

/// The outlets out of a population, and its shape.
struct Outgoing<'a> {
    shape: (u32, u32, u32),
    outlets: Vec<Outlet<'a>>,
}

impl<'a> Outgoing<'a> {
    fn from_population(source: PopulationId, layers: &IdVec<PopulationId, Layer>, placed: &'a PlacedLayers) -> Self {
        let mut outlets = Vec::new();
        for (target, layer) in layers.enumerate() {
            let Some(to) = &placed[target] else { continue };
            let from_source = |(_, incoming): &(usize, &Incoming)| incoming.source == source;
            for (projection, incoming) in layer.incoming.iter().enumerate().filter(from_source) {
                if incoming.all_to_all {
                    outlets.push(Outlet { to, projection, reaches: Reaches::All });
                    continue;
                }
                let window = &incoming.window;
                let boxes = |axis: WindowAxis, lengths: (u32, u32), size: u32, side: fn(&Cut, u32) -> &Side| {
                    let axis = axis.uniform(incoming.uniform);
                    let of = |at| {
                        let mut boxes: Vec<u32> = axis.reached(at).map(|to| to / size).collect();
                        boxes.dedup();
                        let field = |number| axis.field(at, &part(lengths.1, size, number));
                        let in_box = |number| side(&to.cut, number).number_of(projection, &field(number));
                        boxes.into_iter().map(|number| (number, in_box(number).unwrap_or(u32::MAX))).collect()
                    };
                    (0..lengths.0).map(of).collect::<Vec<Vec<(u32, u32)>>>()
                };
                let (of_group, sources) = (window.target.0 / window.groups, window.source.0 / window.groups);
                let channels = |channel: u32| {
                    let first = channel / sources * of_group;
                    first / to.cut.lattice.size.0..(first + of_group - 1) / to.cut.lattice.size.0 + 1
                };
                let (size, from, onto) = (to.cut.lattice.size, window.source, window.target);
                let reaches = Reaches::Window {
                    rows: boxes(WindowAxis::rows(window), (from.1, onto.1), size.1, Cut::rows),
                    columns: boxes(WindowAxis::columns(window), (from.2, onto.2), size.2, Cut::columns),
                    channels: (0..window.source.0).map(channels).collect(),
                };
                outlets.push(Outlet { to, projection, reaches });
            }
        }
        Outgoing { shape: layers[source].shape, outlets }
    }

    /// Whether two sources certainly reach the same cores.
    fn same(&self, one: u32, other: u32) -> bool {
        let (_, height, width) = self.shape;
        let plane = height * width;
        one % plane == other % plane
            && self.outlets.iter().all(|outlet| match &outlet.reaches {
                Reaches::All => true,
                Reaches::Window { channels: of, .. } => of[(one / plane) as usize] == of[(other / plane) as usize],
            })
    }

    /// The cores that a source reaches.
    fn reached(&self, index: u32) -> Reached {
        let (_, height, width) = self.shape;
        let (channel, y, x) = (index / (height * width), index / width % height, index % width);
        let mut reached = Reached { shared: true, ..Reached::default() };
        for Outlet { to, projection, reaches } in &self.outlets {
            let mut one = |at: (u32, u32, u32), fields: (u32, u32)| {
                reached.cores.push(to.first + to.cut.lattice.number(at));
                match to.cut.used(at).members[*projection].get(fields.0, fields.1) {
                    Membership::Discrete => reached.shared = false,
                    Membership::Short => {}
                    Membership::Long => reached.longer += 1,
                }
            };
            match reaches {
                Reaches::All => to.cut.lattice.order().for_each(|at| one(at, (0, 0))),
                Reaches::Window { rows, columns, channels } => {
                    for &(row, of_rows) in &rows[y as usize] {
                        for &(column, of_columns) in &columns[x as usize] {
                            let of_channel = channels[channel as usize].clone();
                            of_channel.for_each(|c| one((c, row, column), (of_rows, of_columns)));
                        }
                    }
                }
            }
        }
        reached.cores.sort_unstable();
        reached
    }

    /// Fan-out of sources with these indices, ascending by the cores that they reach.
    fn sends(&self, indices: impl Iterator<Item = u32>) -> Vec<Sends> {
        // Keyed by the cores reached; sources at a position that share output axons count as one
        // there.
        let mut sends: BTreeMap<Vec<u32>, Sends> = BTreeMap::new();
        let mut positions: HashSet<(u32, Vec<u32>)> = HashSet::new();
        let plane = self.shape.1 * self.shape.2;
        let mut end = |(index, sources): (u32, u64)| {
            let Reached { cores, shared, longer } = self.reached(index);
            let alone = !shared || cores.is_empty();
            let axons = if alone { sources } else { u64::from(positions.insert((index % plane, cores.clone()))) };
            let none = |to: &Vec<u32>| Sends { to: to.clone(), sources: 0, axons: 0, longer: 0 };
            let sends = sends.entry(cores).or_insert_with_key(none);
            sends.add(&Sends { to: Vec::new(), sources, axons, longer: longer * axons });
        };
        let mut run: Option<(u32, u64)> = None;
        for index in indices {
            match &mut run {
                Some((first, sources)) if self.same(*first, index) => *sources += 1,
                _ => {
                    run.replace((index, 1)).into_iter().for_each(&mut end);
                }
            }
        }
        run.into_iter().for_each(end);
        sends.into_values().collect()
    }
}

impl Sends {
    /// Adds other sources that reach the same cores.
    fn add(&mut self, other: &Sends) {
        self.sources += other.sources;
        self.axons += other.axons;
        self.longer += other.longer;
    }
}

/// Returns the fan-out of all sources of a network.
pub fn fan_out(
    network: &Quantised,
    layers: &IdVec<PopulationId, Layer>,
    placed: &PlacedLayers,
    members: &Members,
) -> BoxFanOut {
    let outgoing: IdVec<PopulationId, Outgoing<'_>> =
        network.populations().ids().map(|id| Outgoing::from_population(id, layers, placed)).collect();
    let mut inputs: IdVec<PopulationId, Vec<Sends>> = vec![Vec::new(); network.populations().len()].into();
    let mut cores: Vec<Vec<Sends>> = Vec::with_capacity(members.len());
    for (id, population) in network.populations().enumerate() {
        let (out, size) = (&outgoing[id], population.shape.len());
        match &placed[id] {
            None => {
                let starts: Vec<u32> = (0..size).step_by(PIECE as usize).collect();
                let pieces: Vec<_> =
                    starts.into_par_iter().map(|from| out.sends(from..size.min(from + PIECE))).collect();
                let mut all: BTreeMap<Vec<u32>, Sends> = BTreeMap::new();
                for sends in pieces.into_iter().flatten().filter(|sends| !sends.to.is_empty()) {
                    match all.get_mut(&sends.to) {
                        Some(known) => known.add(&sends),
                        None => drop(all.insert(sends.to.clone(), sends)),
                    }
                }
                inputs[id] = all.into_values().collect();
            }
            Some(Placed { cut, first: core }) => {
                let held = &members.as_slice()[*core as usize..(core + cut.lattice.boxes()) as usize];
                let own = population.first_compartment().map_or(0, |first| first.0);
                cores.par_extend(held.par_iter().map(|held| out.sends(held.iter().map(|id| id.0 - own))));
            }
        }
    }
    BoxFanOut { inputs, cores }
}

/// Output axon slots of a core's compartments together and the most output axons of one, with cores
/// numbered chip by chip.
pub fn axons(core: CoreId, sends: &[Sends], chips: &ChipOf, limits: &Limits) -> (u64, u32) {
    let more_slots = match limits.output_axons {
        OutputAxons::PerPosition { more_slots, .. } => u64::from(more_slots),
        OutputAxons::PerCompartment => 0,
    };
    let slots = |sends: &Sends| {
        let each = axon_slots(Some(core), sends.to.iter().map(|&to| CoreId(to)), chips, limits);
        sends.axons * u64::from(each) + sends.longer * more_slots
    };
    (sends.iter().map(slots).sum(), sends.iter().map(|sends| sends.to.len() as u32).max().unwrap_or(0))
}

/// Spikes of each source of a population, in the steps that rates count.
pub type PopulationRates = IdVec<PopulationId, u64>;

/// Returns the assumed rate for all populations.
pub fn everywhere(network: &Quantised, rates: &Rates) -> PopulationRates {
    vec![rates.rate_of(0); network.populations().len()].into()
}

/// Returns the rate of one population; others have the profile rate of silent sources.
pub fn only(network: &Quantised, population: PopulationId, rates: &Rates) -> PopulationRates {
    let never = Rates::assumed(0.0);
    network.populations().ids().map(|id| if id == population { rates.rate_of(0) } else { never.rate_of(0) }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_reaches_what_its_windows_cover() {
        use nsim_ir::graph::Window;
        for (kernel, stride, padding, dilation) in [(3, 1, 1, 1), (5, 2, 0, 1), (2, 3, 1, 2), (4, 4, 0, 1)] {
            let (source, target) = (17u32, 7u32);
            let pair = |n| (1, n);
            let window = Window {
                source: (1, 1, source),
                target: (1, 1, target),
                kernel: pair(kernel),
                stride: pair(stride),
                padding: (0, padding),
                dilation: pair(dilation),
                groups: 1,
            };
            let axis = WindowAxis::columns(&window);
            for s in 0..source {
                let mut meant = Vec::new();
                nsim_dynamics::synapses::for_each_position(&window, s, |_, x, _, _| meant.push(x));
                assert_eq!(axis.reached(s).collect::<Vec<_>>(), meant);
            }
        }
    }
}
