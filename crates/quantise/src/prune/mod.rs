//! Prunes the parts of a network that cannot change its output.
//!
//! Input: a [`Quantised`] network and a [`Plan`]. Output: a smaller one with the record
//! ([`Pruned`]) of the pruned parts and the reasons. Every output spike of every sample is
//! unchanged. So is every spike of a remaining compartment, for every stimulus that fires no dead
//! channel ([`check_stimulus`] refuses the others):
//!
//! 1. *Dead inputs* are channels that a given stimulus never fires. They stay in their population,
//!    so channels keep their numbers, but have no synapses; a channel without synapses takes no
//!    axon.
//! 2. *Zero synapses* add nothing (equation 1 turns small weights of negative exponents to 0 too).
//! 3. *Silent compartments* never spike, as [`bound`] proves.
//! 4. *Unreachable compartments* have no path to an output or a probed compartment over the
//!    remaining synapses.
//! 5. *Loose synapses* have a dead, silent or pruned source, or a pruned target.
//!
//! The output population, probed populations, children and parents stay whole. All sources that can
//! fire and reach them stay too. So each remaining compartment receives all its input, and its u
//! and v are unchanged at every step.
//!
//! *Why a separate network.* A mask over the whole network would have to be obeyed by the
//! partitioner, the router, the checker, the interpreter and the machine, and each could forget it.
//! A smaller network changes none of them: `nsim_check::equivalence` proves the program equal to
//! it, synapse by synapse, and the interpreter runs it as any other. The record keeps the model's
//! names and numbers for the user: populations keep their order and names, channels and outputs
//! their numbers, and mappings, probes and messages count compartments as the model does.
//!
//! Omitted on purpose: proofs from the order of spikes or from refractory periods; and packing. A
//! list without its zero has a gap, so a core stores it with an index for each synapse. That can
//! take more words than the zero did.

pub mod bound;

use std::sync::Arc;

use nsim_dynamics::arithmetic::scaled;
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::csr::Csr;
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::id::{ChannelId, CompartmentId, Id, IdVec, PopulationId};
use nsim_ir::base::warning::{Warning, WarningCode};
use nsim_ir::graph::Shape;
use nsim_ir::pruned::{Kind, Row};
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::quantised::{Inconsistent, Parts, Population, Projection, Pruned, Quantised, Units};
use nsim_ir::spikes::{Sample, Stimulus};

/// A property of each compartment.
type Flags = IdVec<CompartmentId, bool>;

/// Channels that a stimulus never fires.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Scene {
    /// Origin of the stimulus.
    pub stimulus: Vec<String>,
    /// The channels, ascending.
    pub dead: Vec<ChannelId>,
}

/// Assumption about the stimulus, and populations that pruning keeps whole.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Plan {
    /// The only stimulus that the network will receive; `None` for any.
    pub scene: Option<Scene>,
    /// Populations that stay whole besides the output, because they are probed.
    pub probed: Vec<PopulationId>,
}

impl Plan {
    /// Returns the plan for every stimulus.
    pub fn fixed() -> Plan {
        Plan::default()
    }

    /// Returns the plan for the channels that a stimulus fires in any of its samples.
    pub fn for_stimulus(network: &Quantised, stimulus: &Stimulus) -> Plan {
        let mut fired: IdVec<ChannelId, bool> = vec![false; network.channels() as usize].into();
        for sample in &stimulus.samples {
            for step in 0..sample.steps() {
                sample.at(step).iter().for_each(|&channel| fired[channel] = true);
            }
        }
        let dead = fired.enumerate().filter(|(_, fired)| !**fired).map(|(channel, _)| channel).collect();
        Plan { scene: Some(Scene { stimulus: stimulus.origin.clone(), dead }), probed: Vec::new() }
    }

    /// Returns this plan with these populations whole.
    #[must_use]
    pub fn probing(mut self, populations: impl IntoIterator<Item = PopulationId>) -> Plan {
        self.probed.extend(populations);
        self.probed.sort_unstable();
        self.probed.dedup();
        self
    }
}

/// Returns the network without the parts that the plan makes superfluous.
///
/// [`Inconsistent`] when the plan is of another network, or the network has been pruned already or
/// has plastic projections: a weight that is 0 need not stay 0.
pub fn prune(network: &Quantised, plan: &Plan) -> Result<Quantised, Inconsistent> {
    if network.pruned().is_some() {
        return Err(Inconsistent("the network has been pruned already".to_string()));
    }
    if let Some((_, projection)) = network.plastic().next() {
        let why = "is plastic: its weights may change, which would invalidate a proof from their present values";
        return Err(Inconsistent(format!("projection {} {why}", projection.name)));
    }
    let mut dead: IdVec<ChannelId, bool> = vec![false; network.channels() as usize].into();
    for &channel in plan.scene.iter().flat_map(|scene| &scene.dead) {
        let missing = || Inconsistent(format!("there is no channel {channel} to prune"));
        *dead.as_mut_slice().get_mut(channel.index()).ok_or_else(missing)? = true;
    }
    let mut whole: IdVec<PopulationId, bool> = vec![false; network.populations().len()].into();
    for &id in plan.probed.iter().chain([&network.parts().output]) {
        let missing = || Inconsistent(format!("there is no population {id} to probe"));
        *whole.as_mut_slice().get_mut(id.index()).ok_or_else(missing)? = true;
    }
    for child in &network.parts().children {
        (whole[child.population], whole[child.parent]) = (true, true);
    }
    let fires = bound::may_fire(network, &dead);
    let reaches = reaches(network, &fires, &whole);
    let mut tally = Tally::new(plan.scene.as_ref());
    let survey = Survey::new(network, dead, fires, &reaches, &whole, &mut tally);
    let (parts, kept) = rebuilt(network, &survey, &mut tally);
    let record = Pruned {
        before: network.sizes(),
        kept,
        probed: plan.probed.clone(),
        stimulus: plan.scene.as_ref().map(|scene| scene.stimulus.clone()),
        dead: plan.scene.as_ref().map_or_else(Vec::new, |scene| scene.dead.clone()),
        rows: tally.rows,
    };
    Quantised::new(parts)?.with_record(Some(Arc::new(record)))
}

/// Refuses samples that fire a channel that was pruned; `first` is the number of the first sample.
///
/// # Errors
/// `input.pruned` with population, channel, sample and step of the first such spike.
pub fn check_stimulus(network: &Quantised, samples: &[&Sample], first: usize) -> Result<()> {
    let Some(pruned) = network.pruned().filter(|pruned| !pruned.dead.is_empty()) else { return Ok(()) };
    let mut dead: IdVec<ChannelId, bool> = vec![false; network.channels() as usize].into();
    pruned.dead.iter().for_each(|&channel| dead[channel] = true);
    for (number, sample) in samples.iter().enumerate() {
        for step in 0..sample.steps() {
            let Some(&channel) = sample.at(step).iter().find(|&&channel| dead[channel]) else { continue };
            let inputs = network.inputs().filter_map(|(_, p)| Some((p, channel.0.checked_sub(p.first_channel()?.0)?)));
            let source = inputs.filter(|(population, index)| *index < population.shape.len()).last();
            let (name, index) =
                source.map_or(("?", channel.0), |(population, index)| (population.name.as_str(), index));
            let stimulus = pruned.stimulus.as_deref().unwrap_or_default().join(" ");
            let message = format!(
                "sample {} fires channel {index} of '{name}' in step {step}, but the network was pruned for \
                 {stimulus}, which never fires that channel",
                first + number
            );
            let help = "prune for this input (--prune INPUT), for every input (--prune static), or do not prune";
            return Err(Diagnostic::new("input.pruned", message).help(help));
        }
    }
    Ok(())
}

/// Counts by kind and by name.
struct Tally {
    rows: Vec<Row>,
}

impl Tally {
    fn new(scene: Option<&Scene>) -> Tally {
        let kinds = Kind::ALL.into_iter().filter(|&kind| scene.is_some() || kind != Kind::DeadInput);
        let reason = |kind| match kind {
            Kind::DeadInput => {
                format!("never fires in {}", scene.map_or_else(String::new, |scene| scene.stimulus.join(" ")))
            }
            Kind::ZeroSynapse => "its scaled weight is 0".to_string(),
            Kind::SilentCompartment => "the bounds on its u and v exclude a spike".to_string(),
            Kind::UnreachableCompartment => "reaches neither the output nor a probe".to_string(),
            Kind::LooseSynapse => "its source never spikes, or its target is pruned".to_string(),
        };
        Tally { rows: kinds.map(|kind| Row { kind, count: 0, reason: reason(kind), of: Vec::new() }).collect() }
    }

    fn add(&mut self, kind: Kind, name: &str, count: u64) {
        if let Some(row) = self.rows.iter_mut().find(|row| row.kind == kind && count > 0) {
            row.count += count;
            row.of.push((name.to_string(), count));
        }
    }
}

/// Whether each compartment reaches a population that stays whole, over synapses of sources that
/// can fire.
fn reaches(network: &Quantised, fires: &Flags, whole: &IdVec<PopulationId, bool>) -> Flags {
    let count = network.compartments() as usize;
    // Sources by target: the synapses transposed.
    let sources = Csr::by_row(count, |put| {
        for_each_living(network, fires, |source, target| put(target.index(), source.0));
    });
    let mut reaches: Flags = vec![false; count].into();
    let mut new = Vec::new();
    for (id, population) in network.populations().enumerate() {
        let Some(begin) = population.first_compartment().filter(|_| whole[id]) else { continue };
        new.extend((begin.0..begin.0 + population.shape.len()).map(CompartmentId));
    }
    new.iter().for_each(|&root| reaches[root] = true);
    while let Some(target) = new.pop() {
        for source in sources.get(target.index()).iter().copied().map(CompartmentId) {
            if !std::mem::replace(&mut reaches[source], true) {
                new.push(source);
            }
        }
    }
    reaches
}

/// Calls `f(source, target)` for every synapse between compartments with a scaled weight other than
/// 0 and a source that can fire.
fn for_each_living(network: &Quantised, fires: &Flags, mut f: impl FnMut(CompartmentId, CompartmentId)) {
    for projection in network.projections() {
        let source = &network.populations()[projection.source];
        let target = network.populations()[projection.target].first_compartment();
        let (Some(from), Some(to)) = (source.first_compartment(), target) else { continue };
        for index in 0..source.shape.len() {
            let source = CompartmentId(from.0 + index);
            if fires[source] {
                projection.connectivity.for_each_from(index, |target, weight| {
                    if scaled(projection.format, weight) != 0 {
                        f(source, CompartmentId(to.0 + target));
                    }
                });
            }
        }
    }
}

/// The remaining parts of a network.
struct Survey {
    dead: IdVec<ChannelId, bool>,
    fires: Flags,
    /// New index of each compartment in its population; `None` when it is pruned.
    place: IdVec<CompartmentId, Option<u32>>,
    /// Whether no compartment of a population is pruned.
    complete: IdVec<PopulationId, bool>,
}

impl Survey {
    fn new(
        network: &Quantised,
        dead: IdVec<ChannelId, bool>,
        fires: Flags,
        reaches: &Flags,
        whole: &IdVec<PopulationId, bool>,
        tally: &mut Tally,
    ) -> Survey {
        let (mut place, mut complete) = (IdVec::new(), IdVec::new());
        for (id, population) in network.populations().enumerate() {
            match &population.units {
                Units::Input(first) => {
                    let dead = (0..population.shape.len()).filter(|index| dead[ChannelId(first.0 + index)]);
                    tally.add(Kind::DeadInput, &population.name, dead.count() as u64);
                    complete.push(true);
                }
                Units::Compartments { first, .. } => {
                    let (mut next, mut silent, mut unreachable) = (0, 0, 0);
                    for compartment in (first.0..first.0 + population.shape.len()).map(CompartmentId) {
                        let stays = whole[id] || (fires[compartment] && reaches[compartment]);
                        place.push(stays.then_some(next));
                        next += u32::from(stays);
                        silent += u64::from(!stays && !fires[compartment]);
                        unreachable += u64::from(!stays && fires[compartment]);
                    }
                    complete.push(next == population.shape.len());
                    tally.add(Kind::SilentCompartment, &population.name, silent);
                    tally.add(Kind::UnreachableCompartment, &population.name, unreachable);
                }
            }
        }
        Survey { dead, fires, place, complete }
    }
}

/// The remaining network, and the remaining old indices of populations that lost compartments.
fn rebuilt(network: &Quantised, survey: &Survey, tally: &mut Tally) -> (Parts, IdVec<PopulationId, Option<Vec<u32>>>) {
    let before = network.parts();
    let mut compartments = 0;
    let mut kept = IdVec::new();
    let mut populations = IdVec::new();
    for population in &before.populations {
        let Units::Compartments { first, neurons, start_step } = &population.units else {
            kept.push(None);
            populations.push(population.clone());
            continue;
        };
        let stays = |index: &u32| survey.place[CompartmentId(first.0 + index)].is_some();
        let indices: Vec<u32> = (0..population.shape.len()).filter(stays).collect();
        let all = indices.len() == population.shape.len() as usize;
        let shape = if all { population.shape } else { Shape::Line(indices.len() as u32) };
        let neurons = if all { neurons.clone() } else { neurons.pick(&indices) };
        let units = Units::Compartments { first: CompartmentId(compartments), neurons, start_step: *start_step };
        compartments += shape.len();
        populations.push(Population { shape, units, ..population.clone() });
        kept.push((!all).then_some(indices));
    }
    let mut warnings = before.warnings.clone();
    let projections = before.projections.iter().filter_map(|projection| {
        let connectivity = thinned(network, projection, survey, tally)?;
        let is_listed = matches!(projection.connectivity, Connectivity::Conv2d { .. } | Connectivity::SumPool2d { .. })
            && connectivity != projection.connectivity;
        warnings.extend(is_listed.then(|| listed(network, projection, &connectivity)));
        Some(Projection { connectivity, ..projection.clone() })
    });
    let projections = projections.collect();
    let parts = Parts {
        projections,
        populations,
        children: before.children.clone(),
        rules: before.rules.clone(),
        name: before.name.clone(),
        classes: before.classes.clone(),
        notes: before.notes.clone(),
        warnings,
        ..*before
    };
    (parts, kept)
}

/// Warning of a convolution whose synapses pruning lists, instead of a kernel.
fn listed(network: &Quantised, projection: &Projection, left: &Connectivity) -> Warning {
    let message = format!(
        "--prune lists the {} synapses of the convolution {} one by one, which can take more cores than its kernel: \
         compare nsim map without --prune",
        left.count(0),
        projection.name
    );
    Warning::of_population(WarningCode::ConvolutionListed, &network.populations()[projection.target].name, message)
}

/// The remaining synapses of a projection, `None` when there is none; unchanged when none is
/// pruned.
fn thinned(network: &Quantised, projection: &Projection, survey: &Survey, tally: &mut Tally) -> Option<Connectivity> {
    let (source, target) = (&network.populations()[projection.source], &network.populations()[projection.target]);
    let to = target.first_compartment()?;
    let stays = |index: u32| match &source.units {
        Units::Input(_) => true,
        Units::Compartments { first, .. } => survey.place[CompartmentId(first.0 + index)].is_some(),
    };
    // Whether the spikes of a source can change anything.
    let matters = |index: u32| match &source.units {
        Units::Input(first) => !survey.dead[ChannelId(first.0 + index)],
        Units::Compartments { first, .. } => survey.fires[CompartmentId(first.0 + index)] && stays(index),
    };
    let place = |index: u32| survey.place[CompartmentId(to.0 + index)];
    let (mut zero, mut loose, mut left) = (0, 0, 0u64);
    for index in 0..source.shape.len() {
        let matters = matters(index);
        projection.connectivity.for_each_from(index, |target, weight| match scaled(projection.format, weight) {
            0 => zero += 1,
            _ if matters && place(target).is_some() => left += 1,
            _ => loose += 1,
        });
    }
    tally.add(Kind::ZeroSynapse, &projection.name, zero);
    tally.add(Kind::LooseSynapse, &projection.name, loose);
    if left == 0 {
        return None;
    }
    let complete = survey.complete[projection.source] && survey.complete[projection.target];
    if zero + loose == 0 && complete {
        return Some(projection.connectivity.clone());
    }
    let (mut first, mut targets, mut weights) =
        (vec![0u64], Vec::with_capacity(left as usize), Vec::with_capacity(left as usize));
    let mut row: Vec<(u32, i16)> = Vec::new();
    for index in (0..source.shape.len()).filter(|&index| stays(index)) {
        if matters(index) {
            projection.connectivity.for_each_from(index, |target, weight| {
                if let Some(target) = place(target).filter(|_| scaled(projection.format, weight) != 0) {
                    row.push((target, weight));
                }
            });
            // Random synapses are unordered.
            row.sort_by_key(|&(target, _)| target);
            targets.extend(row.iter().map(|&(target, _)| target));
            weights.extend(row.drain(..).map(|(_, weight)| weight));
        }
        first.push(targets.len() as u64);
    }
    Some(Connectivity::Sparse { first: first.into(), targets: targets.into(), weights: weights.into() })
}
