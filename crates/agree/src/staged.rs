//! Comparison stages: networks from the trained one to the machine; each adds one cause.
//!
//! Input: a graph, and the converted form of its spike response populations ([`Fit`]). Output:
//! [`Trace`]s of the network with any set of the [`Cause`]s switched on. One simulation (`state`,
//! `links`) serves all stages: potentials and thresholds are always in register units, so two
//! stages differ only in their causes. Tests fix both ends. With no cause it spikes as `reference`
//! does (with truncated spike response kernels); with all causes it equals the machine bit for bit.
//!
//! Arithmetic is in doubles. With all causes, every number is an integer below 2^53 and every
//! product one of 24 by 13 bits, so the doubles equal the chip's registers exactly.

use std::sync::OnceLock;

use nsim_dynamics::RealForm;
use nsim_dynamics::arithmetic::falls_on;
use nsim_ir::arithmetic::{ReadOut, Semantics, ThresholdTest};
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::id::Id;
use nsim_ir::graph::{Graph, NeuronParameters, PopulationKind, SrmParameters};
use nsim_ir::neurons::NeuronKind;
use nsim_ir::quantised::{self, Quantised, Reset};
use nsim_ir::spikes::Sample;
use nsim_quantise::analytic::{self, Fit};
use nsim_quantise::exponents::Detail;
use nsim_quantise::quantise::{quantise_with, scales};
use nsim_reference::synapses::{SumOrder, Synapses};

use super::causes::{Cause, ComparisonStage};
use super::links::{Link, integer_synapses};
use super::pipeline::Pipeline;
use super::state::{PopulationState, Timing};
use super::trace::{Layer, Trace};

/// Neurons of a population before conversion.
#[derive(Debug, Clone)]
enum Origin {
    Srm(SrmParameters, Fit),
    /// `subtracts`: whether its spikes subtract the threshold, where the deployed network clears v.
    Loihi {
        parameters: NeuronParameters,
        subtracts: bool,
    },
}

#[derive(Debug)]
struct Population {
    origin: Option<Origin>,
    first: u32,
    count: u32,
    /// Order of the sums of its arrivals.
    order: SumOrder,
    /// Register units per real unit.
    scale: f64,
}

/// A network in all its stages.
#[derive(Debug)]
pub struct StagedNetwork {
    populations: Vec<Population>,
    /// The graph that the stages are made from.
    graph: Graph,
    fits: Vec<Option<Fit>>,
    plain: Vec<Option<Fit>>,
    detail: Detail,
    /// Register units per real unit of each population whose scale is chosen.
    units: Vec<Option<f64>>,
    /// Synapses of stages, indexed as in `links()`; made on first use.
    links: [OnceLock<Vec<Link>>; 8],
    compartments: u32,
    slots: usize,
    /// Steps missing in the layers for an answer to every input step; `None` if none is missing.
    pipeline: Option<Pipeline>,
    test: ThresholdTest,
    reset: Option<Reset>,
    timestep_ms: f64,
    /// The converted network without and with the searched parameters; the first is made lazily.
    rounded: OnceLock<Quantised>,
    calibrated: Quantised,
    causes: Vec<Cause>,
}

impl StagedNetwork {
    /// The stages of a network; `fits` are in the order of its populations.
    /// Errors are those of [`quantise`](nsim_quantise::quantise::quantise).
    pub fn new(graph: &Graph, fits: &[Option<Fit>]) -> Result<StagedNetwork, Diagnostic> {
        StagedNetwork::with_exponents(graph, fits, Detail::default())
    }

    /// The stages of a network with exponents chosen at this level of detail.
    /// Errors are those of [`quantise`](nsim_quantise::quantise::quantise).
    pub fn with_exponents(graph: &Graph, fits: &[Option<Fit>], detail: Detail) -> Result<StagedNetwork, Diagnostic> {
        let timestep_ms = graph.facts().timestep_ms;
        let plain: Vec<Option<Fit>> = graph
            .populations()
            .zip(fits)
            .map(|((_, population), fit)| match (&population.kind, fit) {
                // Without a search the kernels' peaks match, and no neuron has a synapse onto
                // itself.
                (PopulationKind::Srm(srm), Some(fit)) => {
                    let threshold = analytic::matched_threshold_of(srm, timestep_ms, fit);
                    Some(Fit { threshold, own: Vec::new(), ..fit.clone() })
                }
                _ => None,
            })
            .collect();
        let chosen = analytic::with_fits(graph, fits);
        let calibrated = quantise_with(&chosen, detail)?;
        // All stages use the register units of the deployed network.
        let units = scales(&chosen, detail)?;
        let (mut channels, mut compartments) = (0, 0);
        let mut populations = Vec::new();
        for (((node, population), fit), scale) in graph.populations().zip(fits).zip(&units) {
            let count = population.shape.len();
            let origin = match (&population.kind, fit) {
                (PopulationKind::Srm(srm), Some(fit)) => Some(Origin::Srm(*srm, fit.clone())),
                (PopulationKind::Neurons(parameters), _) => {
                    Some(Origin::Loihi { parameters: parameters.clone(), subtracts: false })
                }
                (PopulationKind::Srm(srm), None) => Some(Origin::Srm(*srm, analytic::start(srm, timestep_ms))),
                (PopulationKind::Input, _) => None,
            };
            debug_assert_eq!(node.index(), populations.len());
            let counter = if origin.is_none() { &mut channels } else { &mut compartments };
            let incoming = chosen.projections().filter(|(_, _, target, _)| *target == node).map(|(.., p)| p);
            let order = SumOrder::for_projections(count, incoming);
            populations.push(Population { origin, first: *counter, count, order, scale: scale.unwrap_or(1.0) });
            *counter += count;
        }
        let facts = graph.facts();
        let reset = facts.reset.map(|reset| Reset { interval: reset.interval as u32, offset: reset.offset as u32 });
        let latest = fits.iter().flatten().flat_map(|fit| &fit.taps).map(|&(delay, _)| delay).max().unwrap_or(0);
        let delays = chosen.projections().map(|(_, _, _, projection)| u32::from(projection.delay.get()));
        let pipeline = Pipeline::missing(graph);
        let waits = pipeline.as_ref().map_or(0, |pipeline| pipeline.longest_wait);
        let slots = (delays.max().unwrap_or(0) + latest + waits + 2) as usize;
        let mut staged = StagedNetwork {
            populations,
            graph: graph.clone(),
            fits: fits.to_vec(),
            plain,
            detail,
            units,
            links: Default::default(),
            compartments,
            slots,
            pipeline,
            test: facts.threshold,
            reset,
            timestep_ms,
            rounded: OnceLock::new(),
            calibrated,
            causes: Vec::new(),
        };
        staged.causes = staged.present();
        Ok(staged)
    }

    /// These stages, begun at network `given`, whose resets by subtraction became resets to zero.
    #[must_use]
    pub fn from_subtraction(mut self, given: &Graph) -> StagedNetwork {
        for (population, (_, before)) in self.populations.iter_mut().zip(given.populations()) {
            if let (Some(Origin::Loihi { parameters, subtracts }), PopulationKind::Neurons(given)) =
                (&mut population.origin, &before.kind)
            {
                *subtracts = given.kind == NeuronKind::SoftReset && parameters.kind != given.kind;
            }
        }
        self.causes = self.present();
        self
    }

    /// Whether a stage has delayed copies of synapses; only two decays need them.
    fn has_copies(&self, stage: ComparisonStage) -> bool {
        let single = self.fits.iter().flatten().all(|fit| fit.taps == [(0, 1.0)]);
        single || stage.has(Cause::Kernel) && stage.has(Cause::Decays)
    }

    fn links(&self, stage: ComparisonStage) -> &[Link] {
        let (weights, chosen) = (stage.has(Cause::Weights), stage.has(Cause::Calibration));
        let has_copies = self.has_copies(stage);
        let place = usize::from(weights) * 4 + usize::from(chosen) * 2 + usize::from(has_copies);
        self.links[place].get_or_init(|| {
            let fits = if chosen { &self.fits } else { &self.plain };
            let mut fits = fits.clone();
            if !has_copies {
                fits.iter_mut().flatten().for_each(|fit| fit.taps = vec![(0, 1.0)]);
            }
            let of = analytic::with_fits(&self.graph, &fits);
            Link::merged(match weights {
                false => self.real_links(&of),
                true if chosen && has_copies => self.integer_links(&self.calibrated, &self.units),
                true => match (quantise_with(&of, self.detail), scales(&of, self.detail)) {
                    (Ok(network), Ok(units)) => self.integer_links(&network, &units),
                    // Not reached: the deployed network quantises, and this one has fewer
                    // parameters.
                    _ => self.real_links(&of),
                },
            })
        })
    }

    fn real_links(&self, graph: &Graph) -> Vec<Link> {
        let links = graph.projections().map(|(_, source, target, projection)| {
            let factor = self.units[target.index()].unwrap_or_else(|| {
                let scale = projection.weight_scale.as_ref().map_or(1.0, |scale| scale.value);
                scale * libm::exp2(6.0 + projection.weight_exp.value as f64)
            });
            let (sources, order) = (self.populations[source.index()].count, self.populations[target.index()].order);
            let factor = factor * f64::from(graph.population(source).message.factor().unwrap_or(1));
            Link {
                source: source.index(),
                target: target.index(),
                delays: vec![projection.delay.get().into()],
                restores: analytic::is_reset_name(&projection.name),
                synapses: Synapses::new(projection, sources, order, factor),
            }
        });
        links.collect()
    }

    /// Synapses of a network rounded at its own scale, in units of the deployed network.
    fn integer_links(&self, network: &Quantised, own: &[Option<f64>]) -> Vec<Link> {
        let links = network.projections().iter().map(|projection| {
            let (source, target) = (projection.source.0 as usize, projection.target.0 as usize);
            // Sums that are shifted are in finer units.
            let finer = f64::from(1 << shift_of(&network.populations()[projection.target]));
            let rescale = match (self.units[target], own[target]) {
                (Some(here), Some(there)) => here / there / finer,
                _ => 1.0 / finer,
            };
            let payload = f64::from(network.populations()[projection.source].message.factor().unwrap_or(1));
            Link {
                source,
                target,
                delays: vec![projection.delay.get().into()],
                restores: analytic::is_reset_name(&projection.name),
                synapses: integer_synapses(
                    projection,
                    self.populations[source].count,
                    self.populations[target].order,
                    rescale * payload,
                ),
            }
        });
        links.collect()
    }

    /// Quantised network of a stage; it has the searched parameters if the stage has calibration.
    fn network(&self, stage: ComparisonStage) -> &Quantised {
        if stage.has(Cause::Calibration) {
            return &self.calibrated;
        }
        self.rounded.get_or_init(|| {
            let plain = analytic::with_fits(&self.graph, &self.plain);
            quantise_with(&plain, self.detail).unwrap_or_else(|_| self.calibrated.clone())
        })
    }

    /// Register units per real unit of each population whose scale is chosen.
    pub fn units(&self) -> &[Option<f64>] {
        &self.units
    }

    /// The causes that distinguish this network from its trained form.
    fn present(&self) -> Vec<Cause> {
        let srm = self.graph.has_srm();
        let mut origins = self.populations.iter().filter_map(|population| population.origin.as_ref());
        let subtracts = origins.any(|origin| matches!(origin, Origin::Loihi { subtracts: true, .. }));
        let present = Cause::ALL.into_iter().filter(|cause| match cause {
            Cause::Pipeline => self.pipeline.is_some(),
            Cause::Untruncated | Cause::Kernel => srm,
            Cause::HardReset => srm || subtracts,
            Cause::Decays => self.has_real(&["tau_u_ms", "tau_v_ms"]),
            Cause::Calibration => self.fits != self.plain,
            Cause::Weights => self.has_real(&["vth", "bias"]) || self.rounds(),
            Cause::State => true,
        });
        present.collect()
    }

    /// Whether a population has real numbers for one of these parameters.
    fn has_real(&self, names: &[&str]) -> bool {
        self.populations.iter().any(|population| match &population.origin {
            Some(Origin::Loihi { parameters, .. }) => names.iter().any(|name| parameters.real(name).is_some()),
            Some(Origin::Srm(..)) => true,
            None => false,
        })
    }

    /// Whether weights are rounded, sums included. Notes report weights between two steps of their
    /// format; a negative exponent drops bits.
    fn rounds(&self) -> bool {
        let noted = self.calibrated.parts().notes.iter().any(|note| note.rounded.is_some_and(|r| r.changed > 0));
        let drops = self.calibrated.projections().iter().any(|projection| projection.format.exponent.get() < 0);
        noted || drops || self.calibrated.populations().iter().any(|population| shift_of(population) > 0)
    }

    /// Stage of the trained network; a cause without effect here counts as switched on.
    pub fn trained(&self) -> ComparisonStage {
        Cause::ALL
            .into_iter()
            .filter(|cause| !self.causes.contains(cause))
            .fold(ComparisonStage::TRAINED, ComparisonStage::with)
    }

    /// The causes that distinguish this network from its trained form, in order of stages.
    pub fn causes(&self) -> &[Cause] {
        &self.causes
    }

    /// Steps by which a stage answers later than the trained network; negative, earlier.
    pub fn shift(&self, stage: ComparisonStage) -> i32 {
        -i32::from(self.causes.contains(&Cause::Kernel) && stage.has(Cause::Kernel))
    }

    /// Steps missing in the layers for an answer to every input step; `None` if none is missing.
    pub fn pipeline(&self) -> Option<&Pipeline> {
        self.pipeline.as_ref()
    }

    /// The network of the last stage.
    pub fn deployed(&self) -> &Quantised {
        &self.calibrated
    }

    /// The populations with compartments.
    pub fn layers(&self) -> Vec<Layer> {
        layers(&self.calibrated)
    }

    /// Parameters of a compartment in a stage.
    fn neuron(&self, population: usize, origin: &Origin, index: u32, stage: ComparisonStage) -> RealForm {
        let of = &self.populations[population];
        let network = self.network(stage);
        let semantics = network.parts().semantics;
        let neurons = network.populations().as_slice()[population].neurons();
        let neuron = neurons.map_or(quantised::Neuron::PLAIN, |neurons| neurons.get(index));
        let integers = RealForm::of_neuron(&neuron, semantics);
        match origin {
            Origin::Srm(srm, fit) => {
                // An alpha kernel has one decay; only current and voltage can have two.
                let [keep_u, keep_v] = match (stage.has(Cause::Decays), stage.has(Cause::Kernel)) {
                    (true, true) => [fit.du, fit.dv].map(analytic::keep),
                    (true, false) => [analytic::keep(analytic::start(srm, self.timestep_ms).du); 2],
                    (false, _) => [analytic::real_keep(srm, self.timestep_ms); 2],
                };
                let has_copies = stage.has(Cause::Decays) && stage.has(Cause::Kernel);
                let at = analytic::matched_threshold_of(srm, self.timestep_ms, fit);
                let matched = match has_copies {
                    true => at,
                    false => analytic::matched_threshold(srm, self.timestep_ms, keep_u, keep_v),
                };
                let chosen = stage.has(Cause::Calibration);
                // Ratio of the searched threshold to the threshold at which the peaks match.
                let moved = if chosen { fit.threshold / at } else { 1.0 };
                let real = matched * moved * of.scale;
                let weights = stage.has(Cause::Weights);
                RealForm {
                    keep_u,
                    keep_v,
                    // The deployed mantissa where decays and calibration are the deployed ones.
                    threshold: match (weights, chosen && has_copies) {
                        (true, true) => integers.threshold,
                        (true, false) => (real / 64.0).round_ties_even() * 64.0,
                        (false, _) => real,
                    },
                    refractory: u32::from(fit.refractory.get()).max(1),
                    subtracts: false,
                    clip: if stage.has(Cause::State) { integers.clip } else { (f64::MIN, f64::MAX) },
                    ..integers
                }
            }
            Origin::Loihi { parameters, subtracts } => {
                // Parameters of the reference engine; a real threshold has no registers to clip in.
                let real = nsim_dynamics::model(parameters, index, self.timestep_ms, semantics);
                let decays = if stage.has(Cause::Decays) { &integers } else { &real };
                let (threshold, bias) = match stage.has(Cause::Weights) {
                    true => (integers.threshold, integers.bias),
                    false => (real.threshold * of.scale, real.bias * of.scale),
                };
                RealForm {
                    keep_u: decays.keep_u,
                    keep_v: decays.keep_v,
                    threshold,
                    bias,
                    subtracts: integers.subtracts || *subtracts && !stage.has(Cause::HardReset),
                    clip: if stage.has(Cause::State) { integers.clip } else { real.clip },
                    ..integers
                }
            }
        }
    }

    /// A population of a stage before its first step; none for inputs.
    fn state(&self, population: usize, stage: ComparisonStage) -> Option<PopulationState> {
        let of = &self.populations[population];
        let origin = of.origin.as_ref()?;
        let neurons: Vec<RealForm> = (0..of.count).map(|index| self.neuron(population, origin, index, stage)).collect();
        let (response, resets_from, floors) = match origin {
            Origin::Srm(srm, _) => (Some((srm, self.timestep_ms)), 0, false),
            Origin::Loihi { parameters, .. } => {
                let depth = self.added_pipeline(stage).map_or(0, |pipeline| pipeline.start_step(population));
                let is_shifted = shift_of(&self.network(stage).populations().as_slice()[population]) > 0;
                (None, parameters.start_step.max(depth), is_shifted && stage.has(Cause::Weights))
            }
        };
        // SLAYER's loop starts at step 1; its resets are counted from the step as given.
        let first = u32::from(response.is_none() && self.graph.facts().semantics == Semantics::Slayer);
        let timing = Timing { start_step: resets_from.max(first), resets_from, floors };
        Some(PopulationState::new(&neurons, response, timing, self.test, stage))
    }

    /// The steps that a stage adds to its layers; `None` in stages without them.
    fn added_pipeline(&self, stage: ComparisonStage) -> Option<&Pipeline> {
        self.pipeline.as_ref().filter(|_| !stage.has(Cause::Pipeline))
    }

    /// Steps by which a stage delays the spikes of a link.
    fn wait(&self, stage: ComparisonStage, link: &Link) -> u32 {
        self.added_pipeline(stage).map_or(0, |pipeline| pipeline.wait(link.source, link.target))
    }

    /// The trace of a stage's network in a sample.
    pub fn run(&self, stage: ComparisonStage, sample: &Sample, potentials: bool) -> Trace {
        let Some(pipeline) = self.added_pipeline(stage) else { return self.run_sample(stage, sample, potentials) };
        let mut trace = self.run_sample(stage, &sample.clone().followed_by(pipeline.more_steps()), potentials);
        // A layer before the last runs more steps here than in the tool.
        for (index, population) in self.populations.iter().enumerate().filter(|(_, p)| p.origin.is_some()) {
            let end = pipeline.window(index, sample.steps());
            let trains = &mut trace.trains[population.first as usize..][..population.count as usize];
            trains.iter_mut().for_each(|train| train.retain(|&step| step < end));
        }
        trace
    }

    fn run_sample(&self, stage: ComparisonStage, sample: &Sample, potentials: bool) -> Trace {
        let steps = sample.steps();
        let mut states: Vec<Option<PopulationState>> =
            (0..self.populations.len()).map(|index| self.state(index, stage)).collect();
        let mut arrivals: Vec<Vec<Vec<f64>>> = self
            .populations
            .iter()
            .map(|p| vec![vec![0.0; if p.origin.is_some() { p.count as usize } else { 0 }]; self.slots])
            .collect();
        let mut trace = Trace {
            steps,
            trains: vec![Vec::new(); self.compartments as usize],
            potentials: if potentials { vec![0.0; self.compartments as usize * steps as usize] } else { Vec::new() },
            decision: self.calibrated.parts().decision,
            deciding: Vec::new(),
        };
        let deciding = self.calibrated.parts().output.index();
        let mut firing = Firing::new(self.links(stage), self.populations.len());
        let mut by_unit = Vec::new();
        let inputs: Vec<usize> = (0..states.len()).filter(|&index| self.populations[index].origin.is_none()).collect();
        for now in 0..steps {
            for channel in sample.at(now) {
                let after = inputs.partition_point(|&index| self.populations[index].first <= channel.0);
                let Some(index) = after.checked_sub(1).map(|place| inputs[place]) else { continue };
                let Population { first, count, .. } = self.populations[index];
                if channel.0 - first < count {
                    firing.add(index, channel.0 - first);
                }
            }
            firing.for_each_link(|link, channels| {
                // Spike response kernels are 0 at their start, so input counts a step later.
                let late = states[link.target].as_ref().is_some_and(|state| state.late);
                let at = now + u32::from(late) + self.wait(stage, link);
                channels.iter().for_each(|&c| link.deliver(c, at, &mut arrivals[link.target]));
            });
            let slot = now as usize % self.slots;
            for (index, state) in states.iter_mut().enumerate() {
                let Some(state) = state else { continue };
                if self.reset.is_some_and(|reset| falls_on(reset, now, state.resets_from)) {
                    state.clear();
                }
                let sums = &mut arrivals[index][slot];
                let first = self.populations[index].first;
                if now >= state.start_step {
                    state.step(self.populations[index].order.by_unit(sums, &mut by_unit), |neuron| {
                        firing.add(index, neuron);
                        trace.trains[(first + neuron) as usize].push(now);
                    });
                }
                sums.fill(0.0);
                if potentials {
                    let relative =
                        state.step_potentials.iter().zip(state.thresholds()).map(|(v, vth)| (v / vth) as f32);
                    for (neuron, potential) in relative.enumerate() {
                        trace.potentials[(first as usize + neuron) * steps as usize + now as usize] = potential;
                    }
                }
                if index == deciding && trace.decision != ReadOut::Spikes && now >= state.start_step {
                    trace.deciding.push(state.potentials().to_vec());
                }
            }
            firing.for_each_link(|link, neurons| {
                if !link.restores || stage.has(Cause::HardReset) {
                    let at = now + 1 + self.wait(stage, link);
                    neurons.iter().for_each(|&neuron| link.deliver(neuron, at, &mut arrivals[link.target]));
                }
            });
        }
        trace
    }
}

/// The units that spike, by population, and the links that they spike into.
struct Firing<'l> {
    links: &'l [Link],
    /// Indices of the links from each population.
    from: Vec<Vec<usize>>,
    units: Vec<Vec<u32>>,
    /// Populations with a unit that spikes.
    populations: Vec<usize>,
}

impl<'l> Firing<'l> {
    fn new(links: &'l [Link], populations: usize) -> Self {
        let mut from = vec![Vec::new(); populations];
        links.iter().enumerate().for_each(|(index, link)| from[link.source].push(index));
        Firing { links, from, units: vec![Vec::new(); populations], populations: Vec::new() }
    }

    fn add(&mut self, population: usize, unit: u32) {
        if self.units[population].is_empty() {
            self.populations.push(population);
        }
        self.units[population].push(unit);
    }

    /// Calls `deliver` with each link and the units of its source that spike, and forgets them. The
    /// links are in their order, as sums of real numbers depend on it.
    fn for_each_link(&mut self, mut deliver: impl FnMut(&Link, &[u32])) {
        let mut active: Vec<usize> = self.populations.iter().flat_map(|&source| &self.from[source]).copied().collect();
        active.sort_unstable();
        for link in active.into_iter().map(|index| &self.links[index]) {
            deliver(link, &self.units[link.source]);
        }
        self.populations.drain(..).for_each(|source| self.units[source].clear());
    }
}

/// The populations of a network that have compartments.
pub fn layers(network: &Quantised) -> Vec<Layer> {
    network.populations().iter().filter_map(layer).collect()
}

/// A population as a layer, if it has compartments.
pub(super) fn layer(population: &quantised::Population) -> Option<Layer> {
    let first = population.first_compartment()?.0;
    Some(Layer { name: population.name.clone(), first, count: population.shape.len() })
}

/// Bits by which lava shifts the sums of a population.
fn shift_of(population: &quantised::Population) -> u8 {
    population.neurons().map_or(0, |neurons| neurons.get(0).shift)
}
