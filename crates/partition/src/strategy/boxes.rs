//! A network of layers cut into boxes, a core each, with the resource use and fan-out of the boxes.
//!
//! Input: the [`Layers`] of a network. Output: its [`Boxes`], either the fewest that fit a target's
//! limits or the boxes of given lattices, in the order of populations and lattices.

use std::collections::BTreeMap;

use crate::error::{CompileError, Result};
use crate::options::{Options, Strategy};
use crate::reason::Reason;
use crate::resources::closed_form::{BoxUse, Layer};
use crate::resources::counter::Profiles;
use crate::resources::exact::Usages;
use crate::resources::fan_out::ChipOf;
use crate::resources::formats::Formats;
use crate::strategy::box_fan_out::{self, BoxFanOut, Placed, PopulationRates};
use crate::strategy::lattice::{self, Cut, Lattice};
use crate::strategy::members::{Members, partition_of, row_of_chips};
use crate::strategy::tiles::most_compartments;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::id::{CompartmentId, CoreId, Id, IdVec, PopulationId};
use nsim_ir::graph::PerCompartment;
use nsim_ir::hardware::Target;
use nsim_ir::partition::Partition;
use nsim_ir::quantised::{Quantised, Units};
use nsim_ir::resource::{Limits, Resource};

/// Rounds of making boxes smaller because their output axons do not fit.
const ROUNDS: usize = 12;

/// Lattice of every layer; none for inputs.
pub type Lattices = IdVec<PopulationId, Option<Lattice>>;

/// A network of layers.
#[derive(Debug, Clone)]
pub struct Layers<'n> {
    /// The network, all copies.
    pub network: &'n Quantised,
    /// Its layers.
    pub layers: IdVec<PopulationId, Layer>,
    formats: Formats,
}

impl<'n> Layers<'n> {
    /// The layers of a network.
    ///
    /// # Errors
    /// [`CompileError::Input`] when it does not consist of layers.
    pub fn new(network: &'n Quantised) -> Result<Self> {
        let not_layers = || {
            let message = "a projection is neither a window nor all to all, so the network cannot be mapped by layers";
            Diagnostic::new("map.layers", message)
        };
        let layers = lattice::layers(network).ok_or_else(not_layers)?;
        Ok(Layers { network, layers, formats: Formats::for_network(network) })
    }

    /// Finds the fewest boxes that each fit a core with at most `most` compartments, before output
    /// axons are counted.
    fn fewest(&self, most: &IdVec<PopulationId, u32>, limits: &Limits, cuts: &mut Cuts) -> Result<()> {
        let mut reasons = Vec::new();
        for (id, population) in self.network.populations().enumerate() {
            if population.first_compartment().is_none() || cuts[id].is_some() {
                continue;
            }
            let reason = |(resource, need, limit)| Reason::of_population(self.network, id, resource, need, limit);
            match Cut::fewest_boxes(&self.layers[id], &self.formats, limits, most[id]) {
                Ok(cut) => cuts[id] = Some(cut),
                Err(alone) => reasons.extend(alone.excesses(limits).map(reason)),
            }
        }
        if reasons.is_empty() { Ok(()) } else { Err(CompileError::DoesNotFit(reasons)) }
    }

    fn no_cuts(&self) -> Cuts {
        vec![None; self.layers.len()].into()
    }

    /// Whether the boxes of `copies` copies, of at most `most_synapses` synapses each, are no more
    /// than the cores of the target, before output axons are counted.
    pub fn may_fit(&self, target: &Target, copies: u64, most_synapses: Option<u64>) -> bool {
        let most = most_compartments(self.network, target.limits(), most_synapses);
        let mut cuts = self.no_cuts();
        let fewest = self.fewest(&most, target.limits(), &mut cuts);
        let boxes: u64 = cuts.iter().flatten().map(|cut| u64::from(cut.lattice.boxes())).sum();
        fewest.is_ok() && boxes * copies <= u64::from(target.cores())
    }
}

type Cuts = IdVec<PopulationId, Option<Cut>>;

/// A network in boxes, a core each.
#[derive(Debug, Clone)]
pub struct Boxes {
    /// Cut and first core of each layer.
    pub placed: IdVec<PopulationId, Option<Placed>>,
    /// The compartments of every box, in slot order.
    pub members: Members,
    /// Fan-out of boxes and inputs.
    pub sends: BoxFanOut,
    /// The layer of each box.
    pub layer: IdVec<CoreId, PopulationId>,
    /// Resource use of each box.
    pub uses: Vec<BoxUse>,
}

impl Boxes {
    /// Cuts every layer into the fewest boxes, of at most `most_synapses` synapses if given. Boxes
    /// are smaller where their output axons do not fit.
    ///
    /// # Errors
    /// [`CompileError::DoesNotFit`].
    pub fn fewest(network: &Layers<'_>, target: &Target, copies: u32, most_synapses: Option<u64>) -> Result<Self> {
        let limits = target.limits();
        let mut most = most_compartments(network.network, limits, most_synapses);
        let mut cuts = network.no_cuts();
        for round in 0.. {
            network.fewest(&most, limits, &mut cuts)?;
            let boxes: u64 = cuts.iter().flatten().map(|cut| u64::from(cut.lattice.boxes())).sum();
            if boxes > u64::from(target.cores()) {
                return Err(Reason::of_mapping(target, copies, boxes, BTreeMap::new()).into());
            }
            let found = Boxes::of_cuts(network, &cuts);
            let chips = row_of_chips(found.members.len(), target);
            let usage = found.usage(network.network, &chips, limits);
            let mut reasons: Vec<Reason> = Vec::new();
            for (core, used) in usage.enumerate() {
                let id = found.layer[core];
                for (resource, need, limit) in used.excesses(limits) {
                    // No smaller box reduces the output axons of one compartment, or the use of a
                    // single one.
                    let held = used[Resource::Compartments];
                    if resource == Resource::AxonsOutPerCompartment || held == 1 || round == ROUNDS {
                        let reason = Reason::of_population(network.network, id, resource, need, limit);
                        let same = |r: &Reason| (&r.resource, &r.population) == (&reason.resource, &reason.population);
                        if !reasons.iter().any(same) {
                            reasons.push(reason);
                        }
                        continue;
                    }
                    let fitting = (held * limit / need).max(1) as u32;
                    if fitting < most[id] {
                        (most[id], cuts[id]) = (fitting, None);
                    }
                }
            }
            if !reasons.is_empty() {
                return Err(CompileError::DoesNotFit(reasons));
            }
            if cuts.enumerate().all(|(id, cut)| cut.is_some() || found.placed[id].is_none()) {
                return Ok(found);
            }
        }
        unreachable!("the last round gives reasons or boxes")
    }

    /// The boxes of these lattices, whether or not they fit; none may hold more than
    /// [`MOST_SLOTS`](crate::resources::packing::MOST_SLOTS) compartments.
    pub fn of_lattices(network: &Layers<'_>, lattices: &Lattices, limits: &Limits) -> Self {
        let cut = |(id, lattice): (PopulationId, &Option<Lattice>)| {
            lattice.map(|lattice| Cut::new(&network.layers[id], lattice, &network.formats, limits))
        };
        Boxes::of_cuts(network, &lattices.enumerate().map(cut).collect())
    }

    fn of_cuts(network: &Layers<'_>, cuts: &Cuts) -> Self {
        let mut next = 0;
        let mut placed: IdVec<PopulationId, Option<Placed>> = IdVec::new();
        let (mut members, mut layer, mut uses) = (Members::new(), IdVec::new(), Vec::new());
        for (id, population) in network.network.populations().enumerate() {
            let (Some(first), Some(cut)) = (population.first_compartment(), cuts[id].clone()) else {
                placed.push(None);
                continue;
            };
            for held in cut.lattice.members(&network.layers[id], first) {
                members.push(held);
                layer.push(id);
            }
            uses.extend(cut.lattice.order().map(|at| cut.used(at).clone()));
            let boxes = cut.lattice.boxes();
            placed.push(Some(Placed { cut, first: next }));
            next += boxes;
        }
        let sends = box_fan_out::fan_out(network.network, &network.layers, &placed, &members);
        Boxes { placed, members, sends, layer, uses }
    }

    /// Lattice of every layer.
    pub fn lattices(&self) -> Lattices {
        self.placed.iter().map(|placed| placed.as_ref().map(|placed| placed.cut.lattice)).collect()
    }

    /// Moves the members into a partition, with the chip of each core given.
    ///
    /// # Errors
    /// As [`partition_of`].
    pub fn into_partition(mut self, network: &Quantised, chips: &ChipOf, limits: &Limits) -> Result<(Partition, Self)> {
        let usage = self.usage(network, chips, limits);
        let partition = partition_of(network, std::mem::take(&mut self.members), usage, limits)?;
        Ok((partition, self))
    }

    /// Resource use of every core, with its chip given.
    pub fn usage(&self, network: &Quantised, chips: &ChipOf, limits: &Limits) -> Usages {
        let of = |(core, held): (CoreId, &Vec<CompartmentId>)| {
            let (axons_out, axons_out_per_compartment) =
                box_fan_out::axons(core, &self.sends.cores[core.index()], chips, limits);
            let (compartment_profiles, threshold_profiles) = profiles_of(network, held);
            self.uses[core.index()]
                .usage
                .with(Resource::AxonsOut, axons_out)
                .with(Resource::AxonsOutPerCompartment, axons_out_per_compartment.into())
                .with(Resource::CompartmentProfiles, compartment_profiles.into())
                .with(Resource::ThresholdProfiles, threshold_profiles.into())
        };
        self.members.enumerate().map(of).collect()
    }

    /// Spikes between cores, inputs first: core of the sources, none for inputs; cores reached,
    /// ascending; number of spikes in the steps that `rates` counts.
    pub fn flows<'a>(&'a self, rates: &'a PopulationRates) -> impl Iterator<Item = (Option<CoreId>, &'a [u32], u64)> {
        let inputs = self.sends.inputs.enumerate().flat_map(move |(population, sends)| {
            sends.iter().map(move |sends| (None, &sends.to[..], sends.sources * rates[population]))
        });
        let cores = self.layer.enumerate().flat_map(move |(core, &population)| {
            let sends = self.sends.cores[core.index()].iter();
            sends.map(move |sends| (Some(core), &sends.to[..], sends.sources * rates[population]))
        });
        inputs.chain(cores)
    }
}

/// The fewest boxes of which each fits a core, as a partition with cores placed chip by chip.
///
/// # Errors
/// [`CompileError`]; [`CompileError::Input`] when the network does not consist of layers or the
/// strategy is sequential.
pub fn partition(all: &Quantised, target: &Target, options: &Options) -> Result<(Partition, Option<Boxes>)> {
    if options.strategy == Strategy::Sequential {
        let message = "a network of this size is cut into boxes; it has no sequential mapping";
        return Err(Diagnostic::new("map.strategy", message).into());
    }
    let boxes = Boxes::fewest(&Layers::new(all)?, target, options.copies, options.most_synapses)?;
    let chips = row_of_chips(boxes.members.len(), target);
    let (partition, boxes) = boxes.into_partition(all, &chips, target.limits())?;
    Ok((partition, Some(boxes)))
}

/// Distinct compartment and threshold profiles of compartments of one population.
fn profiles_of(network: &Quantised, held: &[CompartmentId]) -> (u32, u32) {
    let Some(&id) = held.first() else { return (0, 0) };
    let (population, index) = network.population_of(id);
    let Units::Compartments { first, neurons, .. } = &network.populations()[population].units else { return (0, 0) };
    let same = matches!(neurons, PerCompartment::Same(_));
    let looked_at = if same { &[CompartmentId(first.0 + index)][..] } else { held };
    let mut profiles = Profiles::default();
    looked_at.iter().for_each(|id| profiles.insert(&neurons.get(id.0 - first.0)));
    profiles.counts()
}
