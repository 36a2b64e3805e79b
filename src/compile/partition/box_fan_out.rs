//! What the cores of boxes send: whole boxes are reached, so destinations follow from positions.
//!
//! Input: layers, their cuts and the compartments of each core. Output: core by core, the distinct sets of cores that its
//! compartments' spikes reach, with how many compartments; and the same of the input channels. Nothing is
//! enumerated synapse by synapse: a source position reaches some rows and some columns of boxes, and all boxes where they
//! cross.

use std::collections::BTreeMap;
use std::ops::Range;

use rayon::prelude::*;

use crate::base::id::{CoreId, IdVec, PopulationId};
use crate::compile::partition::lattice::Cut;
use crate::compile::partition::members::Members;
use crate::compile::resources::closed_form::Layer;
use crate::compile::resources::fan_out::axon_slots;
use crate::compile::resources::receptive_field::WindowAxis;
use crate::desc::resource::Limits;
use crate::ir::firing_rates::Rates;
use crate::ir::quantised::Quantised;

/// Channels of one task.
const PIECE: u32 = 1 << 14;

/// Sources of one core, or of the inputs, that reach the same cores.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sends {
    /// Cores reached, ascending; the own one may be among them.
    pub to: Vec<u32>,
    /// How many sources.
    pub sources: u64,
}

/// What all sources send.
#[derive(Debug, Clone)]
pub struct BoxFanOut {
    /// Of the channels of each population.
    pub inputs: IdVec<PopulationId, Vec<Sends>>,
    /// Of the compartments of each core.
    pub cores: Vec<Vec<Sends>>,
}

/// Where the boxes of a layer are: its cut and the number of its first core.
#[derive(Debug, Clone)]
pub struct Placed {
    /// The cut.
    pub cut: Cut,
    /// The first core.
    pub first: u32,
}

/// Where one projection leads.
enum Outlet<'a> {
    /// Every source reaches all of these cores.
    All(Range<u32>),
    /// Boxes by row, by column and by channel of the source.
    Window { to: &'a Placed, rows: Vec<Vec<u32>>, columns: Vec<Vec<u32>>, channels: Vec<Range<u32>> },
}

/// The outlets out of a population, and its shape.
struct Outgoing<'a> {
    shape: (u32, u32, u32),
    outlets: Vec<Outlet<'a>>,
}

impl<'a> Outgoing<'a> {
    fn from_population(
        source: PopulationId,
        layers: &IdVec<PopulationId, Layer>,
        placed: &'a IdVec<PopulationId, Option<Placed>>,
    ) -> Self {
        let mut outlets = Vec::new();
        for (target, layer) in layers.enumerate() {
            let Some(to) = &placed[target] else { continue };
            for incoming in layer.incoming.iter().filter(|incoming| incoming.source == source) {
                if incoming.all_to_all {
                    outlets.push(Outlet::All(to.first..to.first + to.cut.lattice.boxes()));
                    continue;
                }
                let window = &incoming.window;
                let boxes = |axis: WindowAxis, length: u32, size: u32| -> Vec<Vec<u32>> {
                    let of = |at| {
                        let mut boxes: Vec<u32> = axis.reached(at).map(|to| to / size).collect();
                        boxes.dedup();
                        boxes
                    };
                    (0..length).map(of).collect()
                };
                let (of_group, sources) = (window.target.0 / window.groups, window.source.0 / window.groups);
                let channels = |channel: u32| {
                    let first = channel / sources * of_group;
                    first / to.cut.lattice.size.0..(first + of_group - 1) / to.cut.lattice.size.0 + 1
                };
                outlets.push(Outlet::Window {
                    to,
                    rows: boxes(WindowAxis::rows(window), window.source.1, to.cut.lattice.size.1),
                    columns: boxes(WindowAxis::columns(window), window.source.2, to.cut.lattice.size.2),
                    channels: (0..window.source.0).map(channels).collect(),
                });
            }
        }
        Outgoing { shape: layers[source].shape, outlets }
    }

    /// Whether two sources reach the same cores for certain.
    fn same(&self, one: u32, other: u32) -> bool {
        let (_, height, width) = self.shape;
        let plane = height * width;
        one % plane == other % plane
            && self.outlets.iter().all(|outlet| match outlet {
                Outlet::All(_) => true,
                Outlet::Window { channels, .. } => {
                    channels[(one / plane) as usize] == channels[(other / plane) as usize]
                }
            })
    }

    /// The cores that a source reaches, ascending.
    fn reached(&self, index: u32) -> Vec<u32> {
        let (_, height, width) = self.shape;
        let (channel, y, x) = (index / (height * width), index / width % height, index % width);
        let mut cores = Vec::new();
        for outlet in &self.outlets {
            match outlet {
                Outlet::All(all) => cores.extend(all.clone()),
                Outlet::Window { to, rows, columns, channels } => {
                    for &row in &rows[y as usize] {
                        for &column in &columns[x as usize] {
                            let of = |c| to.first + to.cut.lattice.number((c, row, column));
                            cores.extend(channels[channel as usize].clone().map(of));
                        }
                    }
                }
            }
        }
        cores.sort_unstable();
        cores
    }

    /// What sources with these indices send.
    fn sends(&self, indices: impl Iterator<Item = u32>) -> BTreeMap<Vec<u32>, u64> {
        let mut sends: BTreeMap<Vec<u32>, u64> = BTreeMap::new();
        let mut run: Option<(u32, u64)> = None;
        let mut end = |(index, sources): (u32, u64)| *sends.entry(self.reached(index)).or_default() += sources;
        for index in indices {
            match &mut run {
                Some((first, sources)) if self.same(*first, index) => *sources += 1,
                _ => {
                    run.replace((index, 1)).into_iter().for_each(&mut end);
                }
            }
        }
        run.into_iter().for_each(end);
        sends
    }
}

fn listed(sends: BTreeMap<Vec<u32>, u64>) -> Vec<Sends> {
    sends.into_iter().map(|(to, sources)| Sends { to, sources }).collect()
}

/// What all sources of a network send.
#[must_use]
pub fn fan_out(
    network: &Quantised,
    layers: &IdVec<PopulationId, Layer>,
    placed: &IdVec<PopulationId, Option<Placed>>,
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
                let piece = |from: u32| out.sends(from..size.min(from + PIECE));
                let starts: Vec<u32> = (0..size).step_by(PIECE as usize).collect();
                let pieces: Vec<_> = starts.into_par_iter().map(piece).collect();
                let mut all: BTreeMap<Vec<u32>, u64> = BTreeMap::new();
                for (to, sources) in pieces.into_iter().flatten().filter(|(to, _)| !to.is_empty()) {
                    *all.entry(to).or_default() += sources;
                }
                inputs[id] = listed(all);
            }
            Some(Placed { cut, first: core }) => {
                let held = &members.as_slice()[*core as usize..(core + cut.lattice.boxes()) as usize];
                let own = population.first_compartment().map_or(0, |first| first.0);
                cores.par_extend(held.par_iter().map(|held| listed(out.sends(held.iter().map(|id| id.0 - own)))));
            }
        }
    }
    BoxFanOut { inputs, cores }
}

/// Output axon slots of a core's compartments together and the most output axons of one, with cores numbered chip by chip.
#[must_use]
pub fn axons(core: CoreId, sends: &[Sends], chips: &IdVec<CoreId, u32>, limits: &Limits) -> (u64, u32) {
    let slots = |sends: &Sends| axon_slots(Some(core), sends.to.iter().map(|&to| CoreId(to)), chips, limits);
    (
        sends.iter().map(|sends| sends.sources * u64::from(slots(sends))).sum(),
        sends.iter().map(|sends| sends.to.len() as u32).max().unwrap_or(0),
    )
}

/// Spikes of each source of a population in as many steps as rates count.
pub type PopulationRates = IdVec<PopulationId, u64>;

/// The same rate for all populations, as it is assumed.
#[must_use]
pub fn everywhere(network: &Quantised, rates: &Rates) -> PopulationRates {
    vec![rates.rate_of(0); network.populations().len()].into()
}

/// The rate of one population; others have that of what never spiked in a profile run.
#[must_use]
pub fn only(network: &Quantised, population: PopulationId, rates: &Rates) -> PopulationRates {
    let never = Rates::assumed(0.0);
    network.populations().ids().map(|id| if id == population { rates.rate_of(0) } else { never.rate_of(0) }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_reaches_what_its_windows_cover() {
        use crate::ir::graph::Window;
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
                window.for_each_position(s, |_, x, _, _| meant.push(x));
                assert_eq!(axis.reached(s).collect::<Vec<_>>(), meant);
            }
        }
    }
}
