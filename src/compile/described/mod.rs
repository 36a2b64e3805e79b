//! Mapping a layered network without ever writing out its synapses.
//!
//! In comes a network in which every projection is a window (convolution, pooling) or all to all, a target and options; out
//! goes a [`Described`] mapping: compartments on cores, what every core uses, places, traffic and expected cost. Kernels
//! stay kernels: a layer is cut into boxes, a core each, and synapses, input axons and words of a box are counted from the
//! geometry of its windows ([`layer`]), destinations from positions ([`sends`]). [`check::check`] then compares one
//! core of each kind with its synapses, one by one.
//!
//! What it leaves out: there is no program, so such a mapping cannot be run; cores hold boxes of one layer only; rates are
//! assumed; and there is one candidate, the fewest boxes, whatever the objective of the partition (places follow it).

pub mod check;
pub mod layer;
pub mod sends;
#[cfg(test)]
mod tests;

use std::collections::BTreeSet;

use crate::base::diagnostic::Diagnostic;
use crate::base::id::{CompartmentId, CoreId, Id, IdVec, PopulationId};
use crate::compile::boxes::{BoxUse, Layer};
use crate::compile::described::layer::Cut;
use crate::compile::described::sends::{AllSends, Placed, Sends};
use crate::compile::expect::{self, Score};
use crate::compile::formats::Formats;
use crate::compile::packing::MOST_SLOTS;
use crate::compile::partition::{Members, row_of_chips, tiles};
use crate::compile::place::nets::Nets;
use crate::compile::rates::{Rates, UNIT};
use crate::compile::reason::Reason;
use crate::compile::traffic::{self, Links, Traffic};
use crate::compile::usage::profiles;
use crate::compile::{Clock, CompileError, Layout, Options, PLACED_PER_SECOND, Strategy, all_copies, place};
use crate::desc::target::{Limits, Target};
use crate::ir::activity::StepActivity;
use crate::ir::graph::PerCompartment;
use crate::ir::partition::{CoreUsage, Partition, Resource};
use crate::ir::placement::Placement;
use crate::ir::quantised::{Neurons, Quantised, Units};

/// Synapses, of all copies, above which a network that can be is described: twice this number takes two gigabytes of
/// tables and several more on the way to them.
pub const MOST_WRITTEN: u64 = 1 << 28;
/// Rounds of making boxes smaller because their output axons do not fit.
const ROUNDS: usize = 12;

/// A mapping of a network that stays described.
#[derive(Debug, Clone)]
pub struct Described {
    /// The network, one copy.
    pub one: Quantised,
    /// The network, all copies.
    pub quantised: Quantised,
    /// Compartments on cores; within every limit.
    pub partition: Partition,
    /// Cores on the board.
    pub placement: Placement,
    /// What cores and inputs send.
    sends: AllSends,
    /// What each core's box uses.
    uses: Vec<BoxUse>,
    /// Seconds of each stage, in order.
    pub seconds: Vec<(&'static str, f64)>,
    /// How it was made.
    pub options: Options,
    /// Name of the placement.
    pub placed: &'static str,
    /// Rates of all sources.
    pub rates: Rates,
}

/// Why something that needs every synapse of such a network cannot be done.
#[must_use]
pub fn needs_synapses(what: &str, network: &Quantised) -> Diagnostic {
    let synapses = network.synapses();
    let message = format!("{what} needs the {synapses} synapses of the network written out, which are too many");
    let help = format!("networks of more than {MOST_WRITTEN} synapses are mapped by their kernels alone");
    Diagnostic::new("map.described", message).help(help)
}

/// Whether a network is so large that it is described, and made of layers so that it can be.
#[must_use]
pub fn applies(one: &Quantised, options: &Options) -> bool {
    one.synapses().saturating_mul(u64::from(options.copies)) > MOST_WRITTEN && layer::layers(one).is_some()
}

/// A mapping of a network of layers, whatever its size.
///
/// # Errors
/// [`CompileError`]; [`CompileError::Input`] when it is not made of layers or the sequential strategy is asked for.
pub fn describe(one: Quantised, target: &Target, options: &Options) -> Result<Described, CompileError> {
    let mut clock = Clock::default();
    if options.strategy == Strategy::Sequential {
        let message =
            "a network that is described by its kernels is cut into boxes; there is no sequential mapping of it";
        return Err(CompileError::Input(Diagnostic::new("map.strategy", message)));
    }
    within_compartments(&one, target, options)?;
    let quantised = clock.stage("copies", || all_copies(&one, options))?;
    let network = &quantised;
    let not_layers = || {
        let message = "a projection is neither a window nor all to all, so the network cannot be described by layers";
        CompileError::Input(Diagnostic::new("map.layers", message))
    };
    let layers = layer::layers(network).ok_or_else(not_layers)?;
    let rates = Rates::assumed(traffic::DEFAULT_RATE);
    let Boxes { placed: grids, members, sends, chips } =
        clock.stage("boxes", || boxes(network, &layers, target, options, &rates))?;
    let limits = target.limits();
    let of_cores = || grids.iter().flatten().flat_map(|placed| placed.cut.order().map(move |at| (placed, at)));
    let uses: Vec<BoxUse> = of_cores().map(|(placed, at)| placed.cut.used(at)).collect();
    let usage = clock.stage("usage", || usage(network, &members, &sends, &uses, &chips, limits));
    let fault = |error: &dyn std::fmt::Display| CompileError::Fault(error.to_string());
    let partition = clock
        .stage("seats", || Partition::new(network.compartments(), members, usage, limits))
        .map_err(|e| fault(&e))?;
    let (placement, name) = clock
        .stage("place", || {
            if !options.place {
                return Ok((place::sequential(&partition, target)?, place::SEQUENTIAL));
            }
            let nets =
                Nets::of(partition.cores(), told(&sends).map(|(own, sends)| (own, sends.weight, sends.to.clone())));
            let work = u64::from(options.effort_s) * PLACED_PER_SECOND;
            let search = place::Search { objective: options.objective, rates: &rates, seed: options.seed, work };
            place::place_nets(&nets, &partition, target, search)
        })
        .map_err(super::does_not_fit)?;
    let kinds = of_cores().map(|(placed, at)| (placed.first, placed.cut.kind(at)));
    let cores = check::one_of_each(kinds);
    clock
        .stage("check", || check::check(network, &partition, &cores, &chips, limits))
        .map_err(|error| fault(&error))?;
    let (seconds, options) = (clock.0, *options);
    Ok(Described { one, quantised, partition, placement, sends, uses, seconds, options, placed: name, rates })
}

/// Refuses what has more compartments than the target.
fn within_compartments(one: &Quantised, target: &Target, options: &Options) -> Result<(), CompileError> {
    let (limits, compartments) = (target.limits(), u64::from(one.compartments()) * u64::from(options.copies));
    match compartments > u64::from(target.cores()) * u64::from(limits.compartments) {
        true => Err(super::does_not_fit(Reason::of_compartments(target, limits, options.copies, compartments))),
        false => Ok(()),
    }
}

/// Boxes on cores, and what they send.
struct Boxes {
    placed: IdVec<PopulationId, Option<Placed>>,
    members: Members,
    sends: AllSends,
    chips: IdVec<CoreId, u32>,
}

/// Cuts every layer into the fewest boxes, smaller where their output axons do not fit.
fn boxes(
    network: &Quantised,
    layers: &IdVec<PopulationId, Layer>,
    target: &Target,
    options: &Options,
    rates: &Rates,
) -> Result<Boxes, CompileError> {
    let (limits, formats) = (target.limits(), Formats::of(network));
    let mut most: IdVec<PopulationId, u32> = vec![limits.compartments.min(MOST_SLOTS); layers.len()].into();
    let mut cuts: IdVec<PopulationId, Option<Cut>> = vec![None; layers.len()].into();
    for round in 0.. {
        let mut reasons = Vec::new();
        for (id, population) in network.populations().enumerate() {
            if population.first_compartment().is_none() || cuts[id].is_some() {
                continue;
            }
            match Cut::of(&layers[id], &formats, limits, most[id]) {
                Ok(cut) => cuts[id] = Some(cut),
                Err(alone) => reasons.extend(
                    alone
                        .usage
                        .excesses(limits)
                        .map(|(resource, need, limit)| Reason::of_population(&population.name, resource, need, limit)),
                ),
            }
        }
        if !reasons.is_empty() {
            return Err(CompileError::DoesNotFit(reasons));
        }
        let mut first = 0u64;
        let mut placed: IdVec<PopulationId, Option<Placed>> = IdVec::new();
        for cut in &cuts {
            placed.push(cut.as_ref().map(|cut| Placed { cut: cut.clone(), first: first as u32 }));
            first += cut.as_ref().map_or(0, |cut| u64::from(cut.boxes()));
        }
        if first > u64::from(target.cores()) {
            return Err(super::does_not_fit(Reason::of_cores(target, options.copies, first)));
        }
        let members = members(network, layers, &placed);
        let chips = row_of_chips(members.len(), target);
        let sends = sends::sends(network, layers, &placed, &members, rates);
        for (id, placed) in placed.enumerate() {
            let Some(Placed { cut, first }) = placed else { continue };
            let name = &network.populations()[id].name;
            for core in *first as usize..(first + cut.boxes()) as usize {
                let (slots, axons) = sends::axons(core, &sends.cores[core], &chips, limits);
                let held = members.as_slice()[core].len() as u32;
                if axons > limits.axons_out_per_compartment {
                    let (resource, limit) = (Resource::AxonsOutPerCompartment, limits.axons_out_per_compartment);
                    reasons.push(Reason::of_population(name, resource, axons.into(), limit.into()));
                    break;
                }
                if slots <= u64::from(limits.axons_out) {
                    continue;
                }
                if held == 1 || round == ROUNDS {
                    reasons.push(Reason::of_population(name, Resource::AxonsOut, slots, limits.axons_out.into()));
                    break;
                }
                let fitting = (u64::from(held) * u64::from(limits.axons_out) / slots).max(1) as u32;
                if fitting < most[id] {
                    (most[id], cuts[id]) = (fitting, None);
                }
            }
        }
        if !reasons.is_empty() {
            return Err(CompileError::DoesNotFit(reasons));
        }
        if cuts.enumerate().all(|(id, cut)| cut.is_some() || placed[id].is_none()) {
            return Ok(Boxes { placed, members, sends, chips });
        }
    }
    unreachable!("the last round gives reasons or boxes")
}

/// The compartments of every box, in slot order.
fn members(
    network: &Quantised,
    layers: &IdVec<PopulationId, Layer>,
    placed: &IdVec<PopulationId, Option<Placed>>,
) -> Members {
    let mut members = Members::new();
    for (id, population) in network.populations().enumerate() {
        let (Some(first), Some(Placed { cut, .. })) = (population.first_compartment(), &placed[id]) else { continue };
        let layer = &layers[id];
        for at in cut.order() {
            let held = tiles::cell(layer.shape, cut.size, at, layer.own_only);
            members.push(held.into_iter().map(|index| CompartmentId(first.0 + index)).collect());
        }
    }
    members
}

/// What every core uses.
fn usage(
    network: &Quantised,
    members: &Members,
    sends: &AllSends,
    uses: &[BoxUse],
    chips: &IdVec<CoreId, u32>,
    limits: &Limits,
) -> IdVec<CoreId, CoreUsage> {
    let of = |(core, held): (CoreId, &Vec<CompartmentId>)| {
        let (axons_out, axons_out_per_compartment) =
            sends::axons(core.index(), &sends.cores[core.index()], chips, limits);
        let axons_out = u32::try_from(axons_out).unwrap_or(u32::MAX);
        let (compartment_profiles, threshold_profiles) = profiles_of(network, held);
        CoreUsage {
            axons_out,
            axons_out_per_compartment,
            compartment_profiles,
            threshold_profiles,
            ..uses[core.index()].usage
        }
    };
    members.enumerate().map(of).collect()
}

/// Distinct compartment and threshold profiles of compartments of one population.
fn profiles_of(network: &Quantised, held: &[CompartmentId]) -> (u32, u32) {
    let Some(&id) = held.first() else { return (0, 0) };
    let (population, index) = network.population_of(id);
    let Units::Loihi { first, neurons, .. } = &network.populations()[population].units else { return (0, 0) };
    let Neurons { du, dv, vth, refractory, .. } = neurons;
    let same = matches!(
        (du, dv, vth, refractory),
        (PerCompartment::Same(_), PerCompartment::Same(_), PerCompartment::Same(_), PerCompartment::Same(_))
    );
    let looked_at = if same { &[CompartmentId(first.0 + index)][..] } else { held };
    let all = looked_at.iter().map(|id| profiles(&neurons.get(id.0 - first.0)));
    let (profiles, thresholds): (BTreeSet<_>, BTreeSet<_>) = all.unzip();
    (profiles.len() as u32, thresholds.len() as u32)
}

/// What is sent, with the core that sends it; none for inputs.
fn told(sends: &AllSends) -> impl Iterator<Item = (Option<u32>, &Sends)> {
    let cores =
        sends.cores.iter().enumerate().flat_map(|(core, of)| of.iter().map(move |sends| (Some(core as u32), sends)));
    sends.inputs.iter().map(|sends| (None, sends)).chain(cores)
}

impl Described {
    /// Where everything is.
    #[must_use]
    pub fn layout(&self) -> Layout<'_> {
        Layout {
            one: &self.one,
            quantised: &self.quantised,
            partition: &self.partition,
            placement: &self.placement,
            seconds: &self.seconds,
            options: &self.options,
            placed: self.placed,
            rates: &self.rates,
            written: false,
        }
    }

    fn flows(&self) -> impl Iterator<Item = (Option<CoreId>, impl Iterator<Item = CoreId> + Clone, u64)> {
        told(&self.sends).map(|(own, sends)| (own.map(CoreId), sends.to.iter().map(|&to| CoreId(to)), sends.weight))
    }

    /// The expected traffic.
    #[must_use]
    pub fn traffic(&self) -> Traffic {
        traffic::of_flows(&self.placement, self.flows())
    }

    /// The expected messages over each link.
    #[must_use]
    pub fn links(&self) -> Links {
        traffic::links_of_flows(&self.placement, self.flows())
    }

    /// What a mean step with this traffic is expected to cost.
    ///
    /// # Errors
    /// As [`expect::score`].
    pub fn score(&self, traffic: &Traffic, target: &Target) -> Result<Score, Diagnostic> {
        let mut sum = StepActivity::new(self.partition.cores());
        let rate = self.rates.of(0);
        for (core, used) in self.uses.iter().enumerate() {
            let counts = &mut sum.cores[CoreId::new(core)];
            counts.events_dense += used.dense * rate;
            counts.events_sparse += (used.usage.synapses - used.dense) * rate;
            let steps = u64::from(used.usage.compartments) * UNIT as u64;
            counts.visited += steps;
            counts.active += steps;
            counts.spikes += u64::from(used.usage.compartments) * rate;
        }
        sum.spikes_in += u64::from(self.quantised.channels()) * rate;
        let (mesh, site) = (self.placement.mesh(), |core| self.placement.site(core));
        for (own, to, weight) in self.flows() {
            for core in to {
                sum.cores[core].messages_in += weight;
                let route = match own {
                    Some(own) => {
                        sum.cores[own].messages_out += weight;
                        mesh.route(site(own), site(core))
                    }
                    None => {
                        sum.messages_from_inputs += weight;
                        mesh.route_from_corner(site(core))
                    }
                };
                sum.add_routes(route, weight);
            }
        }
        expect::score_of(&sum, traffic, &self.placement, target, self.options.copies)
    }
}
