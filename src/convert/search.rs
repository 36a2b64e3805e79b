//! The integers with which a spike response network is best deployed, by a deterministic search over calibration samples.
//!
//! Input: the graph and calibration samples. Output: a [`Fit`] for each population, and how near each stage comes. From the
//! analytic start (`compile::frontend::analytic`) each stage goes through the populations from the input on. A population gets the
//! spikes that its converted sources send, and is to send those that the trained population sends, step by step:
//!
//! 1. [`Stage::Reset`]: synapses of each compartment onto itself give back what the hard reset takes.
//! 2. [`Stage::Shape`]: du, dv, delay, threshold and those synapses together: a few shapes, then finer steps from the best while
//!    they help. A faster voltage behind a slower current loses less at a reset than the alpha kernel's equal decays.
//! 3. [`Stage::Compartments`]: for each compartment its own gain of the incoming weights, its own bias, and its own synapse onto
//!    itself.
//!
//! What is minimised is 1 minus the coincidence factor, and a share of the difference of spike counts (a greater one for the
//! output, whose counts are classes). The start and every stage are run as integers; what is nearest to the trained network is
//! returned: the search never makes things worse on the calibration samples. No randomness; ties go to the first.

use std::collections::HashMap;

use petgraph::algo::toposort;
use petgraph::graph::NodeIndex;
use rayon::prelude::*;

use crate::agree::compare::output_layer;
use crate::agree::ladder::{Cause, Ladder, Rung};
use crate::agree::metrics::{TrainSums, coincidence};
use crate::agree::trace::{Comparison, Layer, Trace};
use crate::base::diagnostic::Result;
use crate::base::fixed::{DECAY_ONE, Decay, Refractory};
use crate::base::names::named_variants;
use crate::compile::frontend::analytic::{self, Fit};
use crate::ir::graph::{Graph, PopulationKind, SrmParameters};
use crate::ir::spikes::Sample;
use crate::reference::synapses::Synapses;

/// Most neuron-steps that a candidate is tried on; calibration samples beyond are left out.
const MOST_WORK: u64 = 2_000_000;

/// Samples that shapes are first tried on.
const FEW: usize = 20;

/// Synapses of a compartment onto itself: the paper's refractory response is below 0.01 thresholds after so many steps.
const OWN: usize = 10;

/// The most compartments of a population that get synapses onto themselves, which are listed one by one.
const MOST_OWN: u32 = 1 << 16;

/// What of the search is done, each stage on top of the last.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// The analytic start.
    Start,
    /// What a reset takes is given back.
    Reset,
    /// Decays, delay, threshold and synapses onto itself of each population together.
    Shape,
    /// Gain, bias and synapse onto itself of each compartment.
    Compartments,
}

named_variants!(Stage {
    Start = "analytic start",
    Reset = "reset given back",
    Shape = "decays, delay and threshold together",
    Compartments = "each compartment",
});

/// How near a conversion is on the calibration samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConversionScore {
    /// Share of samples with the class of the trained network.
    pub class_agreement: f64,
    /// Coincidence factor over all layers.
    pub coincidence: f64,
    /// The least coincidence factor of a layer.
    pub least_coincidence: f64,
    /// Differences of the output's spike counts relative to all of its spikes.
    pub count_error: f64,
}

impl ConversionScore {
    /// What is minimised: wrong classes, wrong counts of the output, spikes that do not coincide.
    fn distance(&self) -> f64 {
        2.0 * (1.0 - self.class_agreement) + self.count_error + (1.0 - self.least_coincidence)
    }
}

/// What a search found.
#[derive(Debug, Clone, PartialEq)]
pub struct SearchResult {
    /// In the order of the populations.
    pub fits: Vec<Option<Fit>>,
    /// The analytic start.
    pub start: ConversionScore,
    /// What is left.
    pub end: ConversionScore,
    /// Every stage as it scored, the start first.
    pub stages: Vec<(Stage, Vec<Option<Fit>>, ConversionScore)>,
    /// Candidates that were tried.
    pub tried: u64,
    /// Calibration samples.
    pub samples: usize,
}

/// A population's inputs and what it should do with them.
struct Task {
    neurons: usize,
    /// Weighted input of each sample, `[step][neuron]`.
    arrivals: Vec<Vec<f64>>,
    /// The steps in which each neuron of each sample should spike.
    wanted: Vec<Vec<Vec<u32>>>,
    /// What a difference of counts weighs beside coincidence.
    count_weight: f64,
}

/// A candidate for one neuron.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    keep_u: f64,
    keep_v: f64,
    threshold: f64,
    delay: usize,
    gain: f64,
    bias: f64,
    own: [f64; OWN],
}

/// How far spikes are from those wanted, in sums that add up over neurons.
#[derive(Debug, Clone, Copy, Default)]
struct Gap {
    beyond_chance: f64,
    at_most: f64,
    counts: f64,
    spikes: f64,
}

impl Gap {
    fn add(self, other: Gap) -> Gap {
        Gap {
            beyond_chance: self.beyond_chance + other.beyond_chance,
            at_most: self.at_most + other.at_most,
            counts: self.counts + other.counts,
            spikes: self.spikes + other.spikes,
        }
    }

    fn distance(self, count_weight: f64) -> f64 {
        let missed = if self.at_most > 0.0 { 1.0 - self.beyond_chance / self.at_most } else { 0.0 };
        missed + count_weight * self.counts / self.spikes.max(1.0)
    }
}

impl Task {
    fn gap(&self, neuron: usize, c: &Candidate) -> Gap {
        let mut gap = Gap::default();
        let mut got = Vec::new();
        for (arrivals, wanted) in self.arrivals.iter().zip(&self.wanted) {
            let steps = arrivals.len() / self.neurons;
            got.clear();
            let (mut u, mut v) = (0.0, 0.0);
            // What its own spikes bring in this step and those to come.
            let (mut coming, mut at) = ([0.0; OWN], 0);
            for step in 0..steps {
                let arrived = step.checked_sub(c.delay).map_or(0.0, |t| arrivals[t * self.neurons + neuron]);
                u = c.keep_u * u + c.gain * arrived + coming[at];
                coming[at] = 0.0;
                at = if at + 1 == OWN { 0 } else { at + 1 };
                v = c.keep_v * v + u + c.bias;
                if v > c.threshold {
                    v = 0.0;
                    got.push(step as u32);
                    for (k, weight) in c.own.iter().enumerate() {
                        coming[(at + k) % OWN] += weight;
                    }
                }
            }
            let wanted = &wanted[neuron];
            if !(wanted.is_empty() && got.is_empty()) {
                let (beyond_chance, at_most) = coincidence(wanted, &got, steps as u32);
                let counts = wanted.len().abs_diff(got.len()) as f64;
                let spikes = (wanted.len() + got.len()) as f64;
                gap = gap.add(Gap { beyond_chance, at_most, counts, spikes });
            }
        }
        gap
    }

    fn distance(&self, candidate: &Candidate) -> f64 {
        let gaps = (0..self.neurons).map(|neuron| self.gap(neuron, candidate));
        gaps.fold(Gap::default(), Gap::add).distance(self.count_weight)
    }

    /// The same over [`FEW`] of the samples, evenly taken: enough to tell far shapes apart.
    fn sketch(&self) -> Task {
        let every = self.arrivals.len().div_ceil(FEW).max(1);
        Task {
            neurons: self.neurons,
            arrivals: self.arrivals.iter().step_by(every).cloned().collect(),
            wanted: self.wanted.iter().step_by(every).cloned().collect(),
            count_weight: self.count_weight,
        }
    }
}

/// What the compartments of a population share.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Shape {
    du: f64,
    dv: f64,
    delay: i64,
    /// Of the threshold at which a constant input counts the same.
    factor: f64,
    /// The voltage at a spike, and the refractory response, in those of the trained neuron.
    given_back: f64,
    refractory: f64,
    /// Whether there are synapses onto itself at all.
    own: bool,
}

impl Shape {
    fn valid(&self) -> bool {
        (1.0..=4096.0).contains(&self.du)
            && (1.0..=4096.0).contains(&self.dv)
            && (0..=20).contains(&self.delay)
            && (0.05..=20.0).contains(&self.factor)
            && (0.0..=6.0).contains(&self.given_back)
            && (0.0..=6.0).contains(&self.refractory)
    }

    fn keeps(&self) -> (f64, f64) {
        (1.0 - self.du.round() / DECAY_ONE as f64, 1.0 - self.dv.round() / DECAY_ONE as f64)
    }

    fn candidate(&self, srm: &SrmParameters, timestep_ms: f64) -> Candidate {
        let (keep_u, keep_v) = self.keeps();
        let threshold = self.factor * analytic::area_threshold(srm, timestep_ms, keep_u, keep_v);
        let mut candidate =
            Candidate { keep_u, keep_v, threshold, delay: self.delay as usize, gain: 1.0, bias: 0.0, own: [0.0; OWN] };
        if self.own {
            candidate.own = own(srm, timestep_ms, &candidate, (self.given_back, self.refractory));
        }
        candidate
    }
}

fn own(srm: &SrmParameters, timestep_ms: f64, c: &Candidate, (given, refractory): (f64, f64)) -> [f64; OWN] {
    let relative = analytic::own_synapses((srm, timestep_ms), (c.keep_u, c.keep_v), (given, refractory), OWN);
    let mut own = [0.0; OWN];
    own.iter_mut().zip(relative).for_each(|(own, relative)| *own = relative * c.threshold);
    own
}

/// Searches.
///
/// # Errors
/// As `compile::frontend::quantise`.
pub fn search(graph: &Graph, samples: &[&Sample], mut progress: impl FnMut(&str)) -> Result<SearchResult> {
    let starts = analytic::starts(graph);
    let ladder = Ladder::new(graph, &starts)?;
    let largest = ladder.layers().iter().map(|layer| u64::from(layer.count)).max().unwrap_or(1);
    let steps: u64 = samples.iter().map(|sample| u64::from(sample.steps())).max().unwrap_or(1);
    let fitting = (MOST_WORK / (largest * steps).max(1)).max(4) as usize;
    let samples = &samples[..samples.len().min(fitting)];
    let trained: Vec<Trace> =
        samples.par_iter().map(|sample| ladder.run(Rung::TRAINED.with(Cause::Untruncated), sample, false)).collect();
    let layers = ladder.layers();
    let output = output_layer(ladder.deployed());
    let score = |fits: &[Option<Fit>]| -> Result<ConversionScore> {
        Ok(scored(&Ladder::new(graph, fits)?, &layers, &output, samples, &trained))
    };
    let start = score(&starts)?;
    let mut best = (starts.clone(), start);
    let (mut tried, mut shapes) = (0, HashMap::new());
    let mut stages = vec![(Stage::Start, starts.clone(), start)];
    let material = Material { graph, layers: &layers, samples, trained: &trained, starts: &starts };
    for stage in [Stage::Reset, Stage::Shape, Stage::Compartments] {
        let fits = material.pipeline(stage, &mut shapes, &mut tried, &mut progress)?;
        let score = score(&fits)?;
        stages.push((stage, fits.clone(), score));
        if score.distance() < best.1.distance() {
            best = (fits, score);
        }
    }
    Ok(SearchResult { fits: best.0, start, end: best.1, stages, tried, samples: samples.len() })
}

struct Material<'a> {
    graph: &'a Graph,
    layers: &'a [Layer],
    samples: &'a [&'a Sample],
    trained: &'a [Trace],
    starts: &'a [Option<Fit>],
}

impl Material<'_> {
    /// Goes through the populations from the input on.
    fn pipeline(
        &self,
        stage: Stage,
        shapes: &mut HashMap<NodeIndex, Shape>,
        tried: &mut u64,
        progress: &mut impl FnMut(&str),
    ) -> Result<Vec<Option<Fit>>> {
        let (graph, timestep_ms) = (self.graph, self.graph.facts().timestep_ms);
        let mut fits = self.starts.to_vec();
        let order = toposort(graph.petgraph(), None).unwrap_or_else(|_| graph.petgraph().node_indices().collect());
        let mut converted: Vec<Trace> = self.trained.iter().map(earlier).collect();
        let mut known = true;
        for node in order {
            let population = graph.population(node);
            let PopulationKind::Srm(srm) = &population.kind else { continue };
            let Some(layer) = self.layers.iter().find(|layer| layer.name == population.name) else { continue };
            progress(&population.name);
            let output = node == graph.output();
            // What only inputs drive is the same in every pipeline.
            let inputs_only = graph
                .projections()
                .filter(|(_, _, target, _)| *target == node)
                .all(|(_, source, _, _)| matches!(graph.population(source).kind, PopulationKind::Input));
            if !inputs_only && !known {
                // What follows is calibrated on what the populations before it will really send.
                let so_far = Ladder::new(graph, &fits)?;
                converted = self.samples.par_iter().map(|sample| so_far.run(Rung::MACHINE, sample, false)).collect();
            }
            let count_weight = if output { 0.5 } else { 0.2 };
            let task = task(graph, node, layer, (self.samples, &converted, self.trained), count_weight);
            let start = start_shape(srm, timestep_ms, layer.count <= MOST_OWN);
            let shape = match shapes.get(&node) {
                _ if stage == Stage::Reset => start,
                Some(shape) if inputs_only || stage == Stage::Compartments && !output => *shape,
                _ => best_shape(&task, start, srm, timestep_ms, tried),
            };
            if stage != Stage::Reset {
                shapes.insert(node, shape);
            }
            let shared = shape.candidate(srm, timestep_ms);
            let mut fit = fit_of(&shape, &shared, srm, timestep_ms);
            if stage == Stage::Compartments {
                let each = compartments(&task, &shape, (srm, timestep_ms), takes_gains(graph, node), tried);
                if takes_gains(graph, node) {
                    fit.gains = each.iter().map(|c| c.gain).collect();
                }
                fit.biases = each.iter().map(|c| c.bias).collect();
                if shape.own {
                    fit.own = (0..OWN).map(|k| each.iter().map(|c| c.own[k]).collect()).collect();
                }
            }
            fits[node.index()] = Some(fit);
            known = false;
        }
        Ok(fits)
    }
}

/// A trace one step earlier, as a converted layer answers.
fn earlier(trace: &Trace) -> Trace {
    let train = |train: &Vec<u32>| train.iter().filter_map(|&t| t.checked_sub(1)).collect();
    Trace { trains: trace.trains.iter().map(train).collect(), ..trace.clone() }
}

fn scored(
    ladder: &Ladder,
    layers: &[Layer],
    output: &Layer,
    samples: &[&Sample],
    trained: &[Trace],
) -> ConversionScore {
    let each: Vec<(Vec<TrainSums>, bool)> = samples
        .par_iter()
        .zip(trained)
        .map(|(sample, trained)| {
            let machine = ladder.run(Rung::MACHINE, sample, false);
            let sums = |layer: &Layer| {
                let mut comparison = Comparison::default();
                comparison.add(0, layer, trained, &machine, -1);
                comparison.tally
            };
            (layers.iter().map(sums).collect(), trained.class(output) == machine.class(output))
        })
        .collect();
    let (mut by_layer, mut same) = (vec![TrainSums::default(); layers.len()], 0usize);
    for (sums, agrees) in &each {
        by_layer.iter_mut().zip(sums).for_each(|(all, sums)| all.merge(sums));
        same += usize::from(*agrees);
    }
    let mut all = TrainSums::default();
    by_layer.iter().for_each(|sums| all.merge(sums));
    let last = layers.iter().position(|layer| layer == output).map_or(all, |place| by_layer[place]);
    ConversionScore {
        class_agreement: same as f64 / samples.len().max(1) as f64,
        coincidence: all.coincidence(),
        least_coincidence: by_layer.iter().map(TrainSums::coincidence).fold(1.0, f64::min),
        count_error: last.count_error(),
    }
}

/// What arrives at a population from its converted sources, and what it should send, in the converted network's time.
fn task(
    graph: &Graph,
    node: NodeIndex,
    layer: &Layer,
    (samples, converted, trained): (&[&Sample], &[Trace], &[Trace]),
    count_weight: f64,
) -> Task {
    let neurons = layer.count as usize;
    let mut firsts = Vec::new();
    let (mut channels, mut compartments) = (0, 0);
    for (_, population) in graph.populations() {
        let counter = if matches!(population.kind, PopulationKind::Input) { &mut channels } else { &mut compartments };
        firsts.push(*counter);
        *counter += population.shape.len();
    }
    let links: Vec<_> = graph
        .projections()
        .filter(|(_, _, target, _)| *target == node)
        .map(|(_, source, _, projection)| {
            let count = graph.population(source).shape.len();
            let input = matches!(graph.population(source).kind, PopulationKind::Input);
            let synapses = Synapses::<f64>::new(projection, count, layer.count, 1.0);
            (firsts[source.index()], count, input, u32::from(projection.delay.get()), synapses)
        })
        .collect();
    let of_sample = |((sample, converted), trained): ((&&Sample, &Trace), &Trace)| {
        let steps = sample.steps() as usize;
        let mut arrivals = vec![0.0; steps * neurons];
        for (first, count, input, delay, synapses) in &links {
            let mut send = |source: u32, step: usize| {
                if step < steps {
                    synapses.deliver(source, &mut arrivals[step * neurons..(step + 1) * neurons]);
                }
            };
            if *input {
                for step in 0..sample.steps() {
                    let mine = sample.at(step).iter().filter_map(|c| c.0.checked_sub(*first)).filter(|c| c < count);
                    mine.for_each(|channel| send(channel, (step + delay) as usize));
                }
            } else {
                for source in 0..*count {
                    let train = &converted.trains[(first + source) as usize];
                    train.iter().for_each(|step| send(source, (step + 1 + delay) as usize));
                }
            }
        }
        let train = |neuron: usize| &trained.trains[layer.first as usize + neuron];
        let wanted = (0..neurons).map(|neuron| train(neuron).iter().filter_map(|t| t.checked_sub(1)).collect());
        (arrivals, wanted.collect())
    };
    let (arrivals, wanted) = samples.par_iter().zip(converted).zip(trained).map(of_sample).unzip();
    Task { neurons, arrivals, wanted, count_weight }
}

/// The analytic start with what a reset takes given back.
fn start_shape(srm: &SrmParameters, timestep_ms: f64, own: bool) -> Shape {
    let base = f64::from(analytic::start(srm, timestep_ms).du.get());
    let shape = Shape { du: base, dv: base, delay: 0, factor: 1.0, given_back: 1.0, refractory: 1.0, own };
    let (keep_u, keep_v) = shape.keeps();
    let peak = analytic::matched_threshold(srm, timestep_ms, keep_u, keep_v);
    Shape { factor: peak / analytic::area_threshold(srm, timestep_ms, keep_u, keep_v), ..shape }
}

/// Current and voltage decays relative to the start, with the delay that brings the peak of the answer back to its place.
const DECAYS: [(f64, f64, i64); 7] =
    [(1.0, 1.0, 0), (0.85, 1.3, 0), (0.67, 1.9, 1), (0.6, 2.5, 2), (0.55, 3.5, 2), (0.5, 5.0, 3), (0.65, 3.5, 4)];

fn best_shape(task: &Task, start: Shape, srm: &SrmParameters, timestep_ms: f64, tried: &mut u64) -> Shape {
    let mut shapes = vec![start];
    for (du, dv, delay) in DECAYS {
        for factor in [0.4, 0.6, 0.8, 1.0] {
            for given_back in [1.0, 1.15, 1.5, 2.0] {
                shapes.push(Shape {
                    du: start.du * du,
                    dv: start.dv * dv,
                    delay,
                    factor: factor * start.factor,
                    given_back,
                    ..start
                });
            }
        }
    }
    shapes.retain(Shape::valid);
    let ranked = |task: &Task, shapes: &[Shape], tried: &mut u64| {
        *tried += shapes.len() as u64;
        let distances: Vec<f64> =
            shapes.par_iter().map(|shape| task.distance(&shape.candidate(srm, timestep_ms))).collect();
        let mut order: Vec<usize> = (0..shapes.len()).collect();
        order.sort_by(|&a, &b| distances[a].total_cmp(&distances[b]));
        order.into_iter().map(|place| (shapes[place], distances[place])).collect::<Vec<_>>()
    };
    let descend = |task: &Task, from: (Shape, f64), steps: &[f64], tried: &mut u64| {
        let mut best = from;
        for &step in steps {
            // Few enough rounds to end, more than enough to get anywhere in range.
            for _ in 0..12 {
                let next = ranked(task, &near(&best.0, step), tried).first().copied();
                match next {
                    Some(next) if next.1 < best.1 - 1e-6 => best = next,
                    _ => break,
                }
            }
        }
        best
    };
    let sketch = task.sketch();
    let few: Vec<(Shape, f64)> = ranked(&sketch, &shapes, tried).into_iter().take(3).collect();
    let mut found: Vec<Shape> =
        few.into_iter().map(|from| descend(&sketch, from, &[1.2, 1.1, 1.05], tried).0).collect();
    found.push(start);
    let Some(&best) = ranked(task, &found, tried).first() else { return start };
    descend(task, best, &[1.05, 1.02], tried).0
}

/// Shapes one step away.
fn near(best: &Shape, step: f64) -> Vec<Shape> {
    let mut near = Vec::new();
    for by in [step, 1.0 / step] {
        near.push(Shape { du: best.du * by, ..*best });
        near.push(Shape { dv: best.dv * by, ..*best });
        near.push(Shape { du: best.du * by, dv: best.dv / by, ..*best });
        near.push(Shape { factor: best.factor * by, ..*best });
        if best.own {
            near.push(Shape { given_back: best.given_back * by, ..*best });
            near.push(Shape { refractory: best.refractory * by, ..*best });
            near.push(Shape { factor: best.factor * by, given_back: best.given_back / by, ..*best });
            near.push(Shape {
                factor: best.factor * by,
                given_back: best.given_back / by,
                refractory: best.refractory / by,
                ..*best
            });
        }
    }
    near.push(Shape { delay: best.delay + 1, ..*best });
    near.push(Shape { delay: best.delay - 1, ..*best });
    near.retain(Shape::valid);
    near
}

fn fit_of(shape: &Shape, candidate: &Candidate, srm: &SrmParameters, timestep_ms: f64) -> Fit {
    let start = analytic::start(srm, timestep_ms);
    let own = if shape.own { candidate.own.iter().map(|&weight| vec![weight]).collect() } else { Vec::new() };
    Fit {
        du: Decay::new(shape.du.round() as i64).unwrap_or(start.du),
        dv: Decay::new(shape.dv.round() as i64).unwrap_or(start.dv),
        refractory: Refractory::new(1).unwrap_or(start.refractory),
        threshold: candidate.threshold,
        delay: shape.delay as u32,
        own,
        gains: Vec::new(),
        biases: Vec::new(),
    }
}

/// Whether each compartment's incoming weights are its own.
fn takes_gains(graph: &Graph, node: NodeIndex) -> bool {
    let mut into = graph.projections().filter(|(_, _, target, _)| *target == node);
    into.all(|(_, _, _, projection)| projection.kind.has_own_weights())
}

/// The best gain, bias and synapse onto itself of each compartment.
fn compartments(
    task: &Task,
    shape: &Shape,
    (srm, timestep_ms): (&SrmParameters, f64),
    gains: bool,
    tried: &mut u64,
) -> Vec<Candidate> {
    let shared = shape.candidate(srm, timestep_ms);
    // A bias that alone brings the voltage to the threshold, and no further.
    let unit = shared.threshold * (1.0 - shared.keep_v);
    let one = |neuron: usize| {
        let distance = |c: &Candidate| task.gap(neuron, c).distance(task.count_weight);
        let with = |c: &Candidate, given: f64, refractory: f64| match shape.own {
            true => Candidate { own: own(srm, timestep_ms, c, (given, refractory)), ..*c },
            false => *c,
        };
        let (mut given, mut refractory) = (shape.given_back, shape.refractory);
        let (mut best, mut count) = (shared, 0u64);
        let mut least = distance(&best);
        // What does not bring a spike more to its place on a few samples is chance.
        let spikes: usize = task.wanted.iter().map(|wanted| wanted[neuron].len()).sum();
        let margin = 1.0 / spikes.max(1) as f64;
        for step in [1.15, 1.07, 1.03, 1.015] {
            for _ in 0..6 {
                let mut near = Vec::new();
                for by in [step, 1.0 / step] {
                    if gains {
                        near.push((Candidate { gain: best.gain * by, ..best }, given, refractory));
                    }
                    near.push((Candidate { bias: best.bias + (by - 1.0) * unit, ..best }, given, refractory));
                    if shape.own {
                        near.push((with(&best, given * by, refractory), given * by, refractory));
                        near.push((with(&best, given, refractory * by), given, refractory * by));
                    }
                }
                near.retain(|(c, _, _)| (0.3..=3.0).contains(&c.gain) && c.bias.abs() <= 0.5 * unit);
                count += near.len() as u64;
                let mut moved = false;
                for (candidate, g, r) in near {
                    let here = distance(&candidate);
                    if here < least - margin {
                        (best, least, given, refractory, moved) = (candidate, here, g, r, true);
                    }
                }
                if !moved {
                    break;
                }
            }
        }
        (best, count)
    };
    let each: Vec<(Candidate, u64)> = (0..task.neurons).into_par_iter().map(one).collect();
    // A compartment is one of as many as a candidate for all is tried on.
    *tried += each.iter().map(|(_, count)| count).sum::<u64>() / task.neurons.max(1) as u64;
    each.into_iter().map(|(candidate, _)| candidate).collect()
}
