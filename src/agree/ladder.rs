//! A ladder of networks from the trained one to the machine, each differing from the last in one thing.
//!
//! Input: a graph, and the converted form of its spike response populations ([`Fit`]). Output: [`Trace`]s of the network with
//! any set of the [`Cause`]s switched on. One simulation serves all rungs: potentials and thresholds are in register units
//! throughout, so that two rungs differ in their causes alone. Tests hold both ends: with no cause it spikes as `reference`
//! with truncated kernels does, with all causes it equals the machine bit for bit.
//!
//! Arithmetic is in doubles. With all causes, every number is an integer below 2^53 and every product one of 24 by 13 bits,
//! so that the doubles hold exactly what the chip's registers hold.

use std::sync::OnceLock;

use petgraph::graph::NodeIndex;

use crate::base::diagnostic::Diagnostic;
use crate::compile::frontend::analytic::{self, Fit};
use crate::compile::frontend::exponents::Detail;
use crate::compile::frontend::quantise::{quantise_with, scales};
use crate::desc::network::ThresholdTest;
use crate::ir::graph::{self, Graph, NeuronParameters, PopulationKind, SrmParameters};
use crate::ir::quantised::{self, Quantised, Reset, Units};
use crate::ir::spikes::Sample;
use crate::neuron::RealForm;
use crate::reference::kernel::{Alpha, EPSILON};
use crate::reference::synapses::Synapses;

use super::trace::{Layer, Trace};
use crate::base::names::named_variants;

/// Something in which the machine differs from the trained network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Cause {
    /// The response and refractory kernels without end instead of cut.
    Untruncated,
    /// Decaying current and voltage instead of the alpha kernel: one step earlier, and a step longer at the end.
    Kernel,
    /// A hard reset and a refractory period instead of the refractory kernel.
    HardReset,
    /// Decays in 4096ths.
    Decays,
    /// The thresholds and synapses onto itself that a search chose instead of those of the analysis.
    Calibration,
    /// Integer weights, thresholds and biases.
    Weights,
    /// Integer state: rounding toward zero, wrapping, clipping.
    State,
}

named_variants!(Cause {
    Untruncated = "exact-kernel",
    Kernel = "cuba-kernel",
    HardReset = "hard-reset",
    Decays = "quantised-decays",
    Calibration = "calibration",
    Weights = "quantised-weights",
    State = "integer-state",
});

/// Which causes are switched on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Rung([bool; 7]);

impl Rung {
    /// The trained network.
    pub const TRAINED: Rung = Rung([false; 7]);
    /// The machine.
    pub const MACHINE: Rung = Rung([true; 7]);

    /// Whether a cause is on.
    #[must_use]
    pub fn has(self, cause: Cause) -> bool {
        self.0[cause as usize]
    }

    /// The same with one less.
    #[must_use]
    pub fn without(mut self, cause: Cause) -> Rung {
        self.0[cause as usize] = false;
        self
    }

    /// The same with one more.
    #[must_use]
    pub fn with(mut self, cause: Cause) -> Rung {
        self.0[cause as usize] = true;
        self
    }
}

/// What a population was before it was converted.
#[derive(Debug, Clone)]
enum Origin {
    Srm(SrmParameters, Fit),
    Loihi(NeuronParameters),
}

#[derive(Debug)]
struct Population {
    origin: Option<Origin>,
    first: u32,
    count: u32,
    /// Register units for a real unit.
    scale: f64,
}

#[derive(Debug)]
struct Link {
    source: usize,
    target: usize,
    /// Several: of delayed copies, whose weights from one source then follow one another.
    delays: Vec<u32>,
    /// Whether it stands for what a hard reset takes.
    restores: bool,
    /// In register units.
    synapses: Synapses<f64>,
}

impl Link {
    /// Adds a spike that arrives without delay at this step to what arrives at its targets.
    fn deliver(&self, neuron: u32, step: u32, arrivals: &mut [Vec<f64>]) {
        let slots = arrivals.len();
        let slot = |delay: u32| (step + delay) as usize % slots;
        match (&self.synapses, self.delays.as_slice()) {
            (synapses, [delay]) => _ = synapses.deliver(neuron, &mut arrivals[slot(*delay)]),
            (Synapses::Dense { targets, weights }, delays) => {
                let all = *targets as usize;
                let row = &weights[neuron as usize * all..(neuron as usize + 1) * all];
                for (weights, &delay) in row.chunks(all / delays.len()).zip(delays) {
                    arrivals[slot(delay)].iter_mut().zip(weights).for_each(|(sum, weight)| *sum += weight);
                }
            }
            _ => {}
        }
    }

    /// Dense links from one population to another as one: a spike then reads memory in order.
    fn merged(links: Vec<Link>) -> Vec<Link> {
        let mut merged: Vec<Vec<Link>> = Vec::new();
        for link in links {
            let fits = |first: &&mut Vec<Link>| {
                let dense = |link: &Link| matches!(link.synapses, Synapses::Dense { .. });
                let ends = |link: &Link| (link.source, link.target, link.restores);
                first.first().is_some_and(|first| dense(first) && dense(&link) && ends(first) == ends(&link))
            };
            match merged.iter_mut().find(fits) {
                Some(bundle) => bundle.push(link),
                None => merged.push(vec![link]),
            }
        }
        merged.into_iter().filter_map(Link::bundle).collect()
    }

    fn bundle(mut links: Vec<Link>) -> Option<Link> {
        if links.len() < 2 {
            return links.pop();
        }
        let delays = links.iter().flat_map(|link| link.delays.clone()).collect();
        let (source, target, restores) = (links[0].source, links[0].target, links[0].restores);
        let mut rows = Vec::new();
        let mut width = 0;
        for link in &links {
            if let Synapses::Dense { targets, weights } = &link.synapses {
                rows.push(weights.chunks((*targets as usize).max(1)));
                width += targets;
            }
        }
        let mut weights = Vec::new();
        while let Some(row) = rows.iter_mut().map(Iterator::next).collect::<Option<Vec<&[f64]>>>() {
            row.into_iter().for_each(|part| weights.extend_from_slice(part));
        }
        Some(Link { source, target, delays, restores, synapses: Synapses::Dense { targets: width, weights } })
    }
}

/// A network in every form at once.
#[derive(Debug)]
pub struct Ladder {
    populations: Vec<Population>,
    /// What the rungs are made from.
    graph: Graph,
    fits: Vec<Option<Fit>>,
    plain: Vec<Option<Fit>>,
    detail: Detail,
    /// Register units for a real unit of each population whose scale is chosen.
    units: Vec<Option<f64>>,
    /// By `links`: made when a rung first needs them.
    links: [OnceLock<Vec<Link>>; 8],
    compartments: u32,
    slots: usize,
    test: ThresholdTest,
    reset: Option<Reset>,
    timestep_ms: f64,
    /// The converted network without what a search chose, made when a rung first needs it, and with it.
    rounded: OnceLock<Quantised>,
    calibrated: Quantised,
    causes: Vec<Cause>,
}

/// A compartment as a rung has it.
#[derive(Debug, Clone, Copy)]
struct Neuron {
    keep_u: f64,
    keep_v: f64,
    threshold: f64,
    bias: f64,
    refractory: u32,
    clip: (f64, f64),
}

fn wrapped(x: f64, bits: i32) -> f64 {
    let half = f64::from(1 << bits);
    if x >= -half && x < half { x } else { (x + half).rem_euclid(2.0 * half) - half }
}

impl Ladder {
    /// The ladder of a network; `fits` are in the order of its populations.
    ///
    /// # Errors
    /// As [`quantise`](crate::compile::frontend::quantise::quantise).
    pub fn new(graph: &Graph, fits: &[Option<Fit>]) -> Result<Ladder, Diagnostic> {
        Ladder::with_exponents(graph, fits, Detail::default())
    }

    /// The same with exponents chosen this finely.
    ///
    /// # Errors
    /// As [`quantise`](crate::compile::frontend::quantise::quantise).
    pub fn with_exponents(graph: &Graph, fits: &[Option<Fit>], detail: Detail) -> Result<Ladder, Diagnostic> {
        let timestep_ms = graph.facts().timestep_ms;
        let plain: Vec<Option<Fit>> = graph
            .populations()
            .zip(fits)
            .map(|((_, population), fit)| match (&population.kind, fit) {
                (PopulationKind::Srm(srm), Some(fit)) => Some(uncalibrated(srm, fit, timestep_ms)),
                _ => None,
            })
            .collect();
        let chosen = analytic::with_fits(graph, fits);
        let calibrated = quantise_with(&chosen, detail)?;
        // Everything is in the register units of the network that is deployed.
        let units = scales(&chosen, detail)?;
        let (mut channels, mut compartments) = (0, 0);
        let mut populations = Vec::new();
        for (((node, population), fit), scale) in graph.populations().zip(fits).zip(&units) {
            let count = population.shape.len();
            let origin = match (&population.kind, fit) {
                (PopulationKind::Srm(srm), Some(fit)) => Some(Origin::Srm(*srm, fit.clone())),
                (PopulationKind::Neurons(parameters), _) => Some(Origin::Loihi(parameters.clone())),
                (PopulationKind::Srm(srm), None) => Some(Origin::Srm(*srm, analytic::start(srm, timestep_ms))),
                (PopulationKind::Input, _) => None,
            };
            debug_assert_eq!(node.index(), populations.len());
            let counter = if origin.is_none() { &mut channels } else { &mut compartments };
            populations.push(Population { origin, first: *counter, count, scale: scale.unwrap_or(1.0) });
            *counter += count;
        }
        let facts = graph.facts();
        let reset = facts.reset.map(|reset| Reset { interval: reset.interval as u32, offset: reset.offset as u32 });
        let latest = fits.iter().flatten().flat_map(|fit| &fit.copies).map(|&(delay, _)| delay).max().unwrap_or(0);
        let delays = chosen.projections().map(|(_, _, _, projection)| u32::from(projection.delay.get()));
        let slots = (delays.max().unwrap_or(0) + latest + 2) as usize;
        let mut ladder = Ladder {
            populations,
            graph: graph.clone(),
            fits: fits.to_vec(),
            plain,
            detail,
            units,
            links: Default::default(),
            compartments,
            slots,
            test: facts.threshold,
            reset,
            timestep_ms,
            rounded: OnceLock::new(),
            calibrated,
            causes: Vec::new(),
        };
        ladder.causes = ladder.present();
        Ok(ladder)
    }

    /// Whether what comes in is copied: an alpha kernel needs no copies, only current and voltage with decays of their own do.
    fn copied(&self, rung: Rung) -> bool {
        let single = self.fits.iter().flatten().all(|fit| fit.copies == [(0, 1.0)]);
        single || rung.has(Cause::Kernel) && rung.has(Cause::Decays)
    }

    /// The synapses of a rung.
    fn links(&self, rung: Rung) -> &[Link] {
        let (weights, chosen) = (rung.has(Cause::Weights), rung.has(Cause::Calibration));
        let copied = self.copied(rung);
        let place = usize::from(weights) * 4 + usize::from(chosen) * 2 + usize::from(copied);
        self.links[place].get_or_init(|| {
            let fits = if chosen { &self.fits } else { &self.plain };
            let single = |fit: &Option<Fit>| fit.clone().map(|fit| Fit { copies: vec![(0, 1.0)], ..fit });
            let of = match copied {
                true => analytic::with_fits(&self.graph, fits),
                false => analytic::with_fits(&self.graph, &fits.iter().map(single).collect::<Vec<_>>()),
            };
            Link::merged(match weights {
                false => self.real_links(&of),
                true if chosen && copied => self.integer_links(&self.calibrated, &self.units),
                true => match (quantise_with(&of, self.detail), scales(&of, self.detail)) {
                    (Ok(network), Ok(units)) => self.integer_links(&network, &units),
                    // What the deployed network's parameters allow, fewer of them allow too.
                    _ => self.real_links(&of),
                },
            })
        })
    }

    fn real_links(&self, graph: &Graph) -> Vec<Link> {
        let link = |(_, source, target, projection): (_, NodeIndex, NodeIndex, &graph::Projection)| {
            let factor = self.units[target.index()].unwrap_or_else(|| {
                let scale = projection.weight_scale.as_ref().map_or(1.0, |scale| scale.value);
                scale * libm::exp2(6.0 + projection.weight_exp.value as f64)
            });
            let (sources, targets) = (self.populations[source.index()].count, self.populations[target.index()].count);
            let factor = factor * graph.population(source).spike_factor();
            Link {
                source: source.index(),
                target: target.index(),
                delays: vec![projection.delay.get().into()],
                restores: analytic::stands_for_reset(&projection.name),
                synapses: Synapses::new(projection, sources, targets, factor),
            }
        };
        graph.projections().map(link).collect()
    }

    /// A network rounded at a scale of its own, in the units of the deployed one.
    fn integer_links(&self, network: &Quantised, own: &[Option<f64>]) -> Vec<Link> {
        let link = |projection: &quantised::Projection| {
            let (source, target) = (projection.source.0 as usize, projection.target.0 as usize);
            let rescale = match (self.units[target], own[target]) {
                (Some(here), Some(there)) => here / there,
                _ => 1.0,
            };
            let payload = f64::from(network.populations()[projection.source].spike_factor());
            Link {
                source,
                target,
                delays: vec![projection.delay.get().into()],
                restores: analytic::stands_for_reset(&projection.name),
                synapses: integer(projection, self.populations[source].count, rescale * payload),
            }
        };
        network.projections().iter().map(link).collect()
    }

    /// The network in integers without what a search chose.
    fn rounded(&self) -> &Quantised {
        self.rounded.get_or_init(|| {
            let plain = analytic::with_fits(&self.graph, &self.plain);
            quantise_with(&plain, self.detail).unwrap_or_else(|_| self.calibrated.clone())
        })
    }

    /// Register units for a real unit of each population whose scale is chosen.
    #[must_use]
    pub fn units(&self) -> &[Option<f64>] {
        &self.units
    }

    /// The causes that tell this network from its trained form.
    fn present(&self) -> Vec<Cause> {
        let (graph, srm) = (&self.graph, self.graph.has_srm());
        let real = self.populations.iter().any(|population| match &population.origin {
            Some(Origin::Loihi(p)) => p.get("vth").is_some(),
            Some(Origin::Srm(..)) => true,
            None => false,
        }) || graph.projections().any(|(_, _, _, projection)| projection.weight_scale.is_some());
        let timed = self.populations.iter().any(|population| match &population.origin {
            Some(Origin::Loihi(p)) => p.get("tau_u_ms").or(p.get("tau_v_ms")).is_some(),
            Some(Origin::Srm(..)) => true,
            None => false,
        });
        let holds = |cause: &Cause| match cause {
            Cause::Untruncated | Cause::Kernel | Cause::HardReset => srm,
            Cause::Decays => timed,
            Cause::Calibration => self.fits != self.plain,
            Cause::Weights => real,
            Cause::State => true,
        };
        Cause::ALL.into_iter().filter(holds).collect()
    }

    /// The trained network: what tells nothing apart here counts as switched on.
    #[must_use]
    pub fn trained(&self) -> Rung {
        Cause::ALL.into_iter().filter(|cause| !self.causes.contains(cause)).fold(Rung::TRAINED, Rung::with)
    }

    /// The causes that tell this network from its trained form, in the order of the ladder.
    #[must_use]
    pub fn causes(&self) -> &[Cause] {
        &self.causes
    }

    /// The steps by which a rung answers later than the trained network: negative, it answers earlier.
    #[must_use]
    pub fn shift(&self, rung: Rung) -> i32 {
        -i32::from(self.causes.contains(&Cause::Kernel) && rung.has(Cause::Kernel))
    }

    /// The network that the last rung is.
    #[must_use]
    pub fn deployed(&self) -> &Quantised {
        &self.calibrated
    }

    /// The populations with compartments.
    #[must_use]
    pub fn layers(&self) -> Vec<Layer> {
        layers(&self.calibrated)
    }

    /// A compartment as a rung has it.
    fn neuron(&self, population: usize, index: u32, rung: Rung) -> Neuron {
        let of = &self.populations[population];
        let network = if rung.has(Cause::Calibration) { &self.calibrated } else { self.rounded() };
        let integers = match &network.populations().as_slice()[population].units {
            Units::Compartments { neurons, .. } => RealForm::from(&neurons.get(index)),
            Units::Input(_) => RealForm::from(&quantised::Neuron::PLAIN),
        };
        let clip = if rung.has(Cause::State) { integers.clip } else { (f64::MIN, f64::MAX) };
        match &of.origin {
            Some(Origin::Srm(srm, fit)) => {
                // An alpha kernel has one decay; only current and voltage can have two.
                let keeps = match (rung.has(Cause::Decays), rung.has(Cause::Kernel)) {
                    (true, true) => (analytic::keep(fit.du), analytic::keep(fit.dv)),
                    (true, false) => {
                        let r = analytic::keep(analytic::start(srm, self.timestep_ms).du);
                        (r, r)
                    }
                    (false, _) => {
                        let r = analytic::real_keep(srm, self.timestep_ms);
                        (r, r)
                    }
                };
                let copied = rung.has(Cause::Decays) && rung.has(Cause::Kernel);
                let at = analytic::matched_threshold_of(srm, self.timestep_ms, fit);
                let matched = match copied {
                    true => at,
                    false => analytic::matched_threshold(srm, self.timestep_ms, keeps.0, keeps.1),
                };
                let chosen = rung.has(Cause::Calibration);
                // The factor by which a search moved the threshold from where the peaks match.
                let moved = if chosen { fit.threshold / at } else { 1.0 };
                let real = matched * moved * of.scale;
                let weights = rung.has(Cause::Weights);
                Neuron {
                    keep_u: keeps.0,
                    keep_v: keeps.1,
                    // The mantissa's own when decays and calibration are the deployed ones.
                    threshold: match (weights, chosen && copied) {
                        (true, true) => integers.threshold,
                        (true, false) => (real / 64.0).round_ties_even() * 64.0,
                        (false, _) => real,
                    },
                    bias: integers.bias,
                    refractory: u32::from(fit.refractory.get()).max(1),
                    clip,
                }
            }
            Some(Origin::Loihi(p)) => {
                let decay = |time_constant: &str, integer: f64| match p.get(time_constant) {
                    Some(tau) if !rung.has(Cause::Decays) => libm::exp(-self.timestep_ms / tau.each.get(index)),
                    _ => integer,
                };
                let in_registers = |real: &str, integer: f64| match p.get(real) {
                    Some(values) if !rung.has(Cause::Weights) => values.each.get(index) * of.scale,
                    _ => integer,
                };
                Neuron {
                    keep_u: decay("tau_u_ms", integers.keep_u),
                    keep_v: decay("tau_v_ms", integers.keep_v),
                    threshold: in_registers("vth", integers.threshold),
                    bias: in_registers("bias", integers.bias),
                    refractory: integers.refractory,
                    clip,
                }
            }
            None => Neuron { keep_u: 0.0, keep_v: 0.0, threshold: 1.0, bias: 0.0, refractory: 1, clip },
        }
    }

    /// What the network of a rung does in a sample.
    #[must_use]
    pub fn run(&self, rung: Rung, sample: &Sample, potentials: bool) -> Trace {
        let steps = sample.steps();
        let mut states: Vec<Option<State>> =
            (0..self.populations.len()).map(|index| State::new(self, index, rung)).collect();
        let mut arrivals: Vec<Vec<Vec<f64>>> = self
            .populations
            .iter()
            .map(|p| vec![vec![0.0; if p.origin.is_some() { p.count as usize } else { 0 }]; self.slots])
            .collect();
        let mut trace = Trace {
            steps,
            trains: vec![Vec::new(); self.compartments as usize],
            potentials: if potentials { vec![0.0; self.compartments as usize * steps as usize] } else { Vec::new() },
        };
        let mut spikes: Vec<(usize, u32)> = Vec::new();
        let links = self.links(rung);
        for now in 0..steps {
            for link in links.iter().filter(|link| self.populations[link.source].origin.is_none()) {
                let of = &self.populations[link.source];
                // Spike response kernels are 0 at their start.
                let late = states[link.target].as_ref().is_some_and(|state| state.late);
                let mine = sample.at(now).iter().filter_map(|c| c.0.checked_sub(of.first)).filter(|&c| c < of.count);
                mine.for_each(|c| link.deliver(c, now + u32::from(late), &mut arrivals[link.target]));
            }
            spikes.clear();
            let slot = now as usize % self.slots;
            for (index, state) in states.iter_mut().enumerate() {
                let Some(state) = state else { continue };
                if self.reset.is_some_and(|reset| reset.falls_on(now, state.start_step)) {
                    state.clear();
                }
                let sums = &mut arrivals[index][slot];
                let first = self.populations[index].first;
                if now >= state.start_step {
                    state.step(sums, |neuron| {
                        spikes.push((index, neuron));
                        trace.trains[(first + neuron) as usize].push(now);
                    });
                }
                sums.fill(0.0);
                if potentials {
                    for (neuron, potential) in state.shown.iter().enumerate() {
                        let place = (first as usize + neuron) * steps as usize + now as usize;
                        trace.potentials[place] = (potential / state.neurons[neuron].threshold) as f32;
                    }
                }
            }
            for link in links.iter().filter(|link| !link.restores || rung.has(Cause::HardReset)) {
                for &(_, neuron) in spikes.iter().filter(|(population, _)| *population == link.source) {
                    link.deliver(neuron, now + 1, &mut arrivals[link.target]);
                }
            }
        }
        trace
    }
}

/// The populations of a network that have compartments.
#[must_use]
pub fn layers(network: &Quantised) -> Vec<Layer> {
    let layer = |p: &quantised::Population| {
        Some(Layer { name: p.name.clone(), first: p.first_compartment()?.0, count: p.shape.len() })
    };
    network.populations().iter().filter_map(layer).collect()
}

/// A fit without what only a search would choose: the peaks matched, no synapse onto itself.
fn uncalibrated(srm: &SrmParameters, fit: &Fit, timestep_ms: f64) -> Fit {
    Fit { threshold: analytic::matched_threshold_of(srm, timestep_ms, fit), own: Vec::new(), ..fit.clone() }
}

/// Integer synapses as what they add to the accumulator.
fn integer(projection: &quantised::Projection, sources: u32, factor: f64) -> Synapses<f64> {
    let mut synapses = Vec::new();
    for source in 0..sources {
        projection.connectivity.for_each_from(source, |target, weight| {
            if weight != 0 {
                synapses.push((source, target, f64::from(projection.format.scaled(weight)) * factor));
            }
        });
    }
    Synapses::list(sources, synapses)
}

/// A population of a rung while it runs.
#[derive(Debug)]
struct State {
    neurons: Vec<Neuron>,
    start_step: u32,
    /// Whether input spikes count a step later.
    late: bool,
    strict: bool,
    integers: bool,
    hard: bool,
    u: Vec<f64>,
    v: Vec<f64>,
    /// With truncated kernels: the response's taps, the inputs of the past, and what resets and biases left.
    taps: Vec<f64>,
    past: Vec<Vec<f64>>,
    newest: usize,
    left: Vec<f64>,
    /// The refractory kernel relative to the threshold: decay, factor, taps when truncated, and its state.
    nu: Alpha,
    nu_taps: Vec<f64>,
    nu_first: Vec<f64>,
    nu_second: Vec<f64>,
    spiked: Vec<f64>,
    own: Vec<Vec<u32>>,
    held: Vec<u32>,
    now: u32,
    shown: Vec<f64>,
}

impl State {
    fn new(ladder: &Ladder, population: usize, rung: Rung) -> Option<State> {
        let of = &ladder.populations[population];
        let origin = of.origin.as_ref()?;
        let count = of.count as usize;
        let neurons: Vec<Neuron> = (0..of.count).map(|index| ladder.neuron(population, index, rung)).collect();
        let (srm, nu) = match origin {
            Origin::Srm(srm, _) => (true, Alpha { peak: -srm.scale_ref, tau: srm.tau_ref_ms / ladder.timestep_ms }),
            Origin::Loihi(_) => (false, Alpha { peak: 0.0, tau: 1.0 }),
        };
        let hard = !srm || rung.has(Cause::HardReset);
        let truncated = srm && !rung.has(Cause::Untruncated) && !rung.has(Cause::Kernel);
        // (k + 1) r^k, cut where the alpha kernel that it is falls below SLAYER's limit.
        let taps: Vec<f64> = match (truncated, origin) {
            (true, Origin::Srm(srm, _)) => {
                let alpha = Alpha { peak: 1.0, tau: srm.tau_sr_ms / ladder.timestep_ms };
                let length = alpha.truncated(EPSILON, 100_000).len().saturating_sub(1);
                let r = neurons.first().map_or(0.0, |n| n.keep_u);
                (0..length).map(|k| (k as f64 + 1.0) * libm::pow(r, k as f64)).collect()
            }
            _ => Vec::new(),
        };
        // SLAYER's limit is for the kernel with its factor, threshold included.
        let nu_taps = match (truncated, origin) {
            (true, Origin::Srm(srm, _)) => nu.truncated(EPSILON / srm.theta, 100_000),
            _ => Vec::new(),
        };
        let start_step = match origin {
            Origin::Srm(..) => 0,
            Origin::Loihi(p) => p.start_step,
        };
        Some(State {
            start_step,
            late: srm && !rung.has(Cause::Kernel),
            strict: hard && ladder.test == ThresholdTest::Strict,
            integers: rung.has(Cause::State),
            hard,
            u: vec![0.0; count],
            v: vec![0.0; count],
            past: vec![vec![0.0; count]; taps.len().max(1)],
            taps,
            newest: 0,
            left: vec![0.0; count],
            nu,
            nu_taps,
            nu_first: vec![0.0; count],
            nu_second: vec![0.0; count],
            spiked: vec![0.0; count],
            own: vec![Vec::new(); count],
            held: vec![0; count],
            now: 0,
            shown: vec![0.0; count],
            neurons,
        })
    }

    fn clear(&mut self) {
        for zero in
            [&mut self.u, &mut self.v, &mut self.left, &mut self.nu_first, &mut self.nu_second, &mut self.spiked]
        {
            zero.fill(0.0);
        }
        self.past.iter_mut().for_each(|row| row.fill(0.0));
        self.own.iter_mut().for_each(Vec::clear);
        self.held.fill(0);
    }

    /// The refractory response of a neuron in register units.
    fn refractory(&mut self, i: usize) -> f64 {
        let threshold = self.neurons[i].threshold;
        let relative = if self.nu_taps.is_empty() {
            let r = self.nu.decay();
            self.nu_first[i] = r * self.nu_first[i] + self.spiked[i];
            self.nu_second[i] = r * (self.nu_second[i] + self.nu_first[i]);
            self.nu.gain() * self.nu_second[i]
        } else {
            let ago = |&spike: &u32| self.nu_taps.get((self.now - spike) as usize).copied().unwrap_or(0.0);
            self.own[i].iter().rev().take(self.nu_taps.len()).map(ago).sum()
        };
        relative * threshold
    }

    fn step(&mut self, arrivals: &[f64], mut spike: impl FnMut(u32)) {
        let integers = self.integers;
        let narrow = |x: f64| if integers { x.trunc() } else { x };
        let truncated = !self.taps.is_empty();
        if truncated {
            let rows = self.past.len();
            self.newest = (self.newest + rows - 1) % rows;
            self.past[self.newest].copy_from_slice(arrivals);
        }
        for (i, &arrived) in arrivals.iter().enumerate() {
            let n = self.neurons[i];
            let x = narrow(arrived);
            let q = if self.integers { wrapped(x, 21) } else { x };
            let free = if truncated {
                self.past[self.newest][i] = q;
                let rows = self.past.len();
                let response: f64 =
                    self.taps.iter().enumerate().map(|(k, tap)| tap * self.past[(self.newest + k) % rows][i]).sum();
                self.left[i] = narrow(n.keep_v * self.left[i]) + n.bias;
                narrow(response) + self.left[i]
            } else {
                let u = narrow(n.keep_u * self.u[i]) + q;
                self.u[i] = if self.integers { wrapped(u, 23) } else { u };
                let input = self.u[i] + n.bias;
                let input = if self.integers { wrapped(input, 23) } else { input };
                narrow(n.keep_v * self.v[i]) + input
            };
            let mut v = free.clamp(n.clip.0, n.clip.1);
            if !truncated {
                self.v[i] = v;
            }
            if !self.hard {
                let own = self.refractory(i);
                v += if self.integers { own.trunc() } else { own };
            }
            let held = self.hard && self.held[i] > 0;
            let over = if self.strict { v > n.threshold } else { v >= n.threshold };
            let fires = over && !held;
            self.shown[i] = v;
            if self.hard && (held || fires) {
                // The reset leaves 0 here, and what it took away decays as the voltage does.
                self.held[i] = if fires { n.refractory - 1 } else { self.held[i] - 1 };
                if truncated {
                    self.left[i] -= free;
                } else {
                    self.v[i] = 0.0;
                }
                if held {
                    self.shown[i] = 0.0;
                }
            }
            self.spiked[i] = f64::from(u8::from(fires));
            if fires {
                if !self.hard {
                    self.own[i].push(self.now);
                }
                spike(i as u32);
            }
        }
        self.now += 1;
    }
}
