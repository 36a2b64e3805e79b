//! The integers with which a spike response network is best deployed, by a deterministic search over calibration samples.
//!
//! Input: the graph and calibration samples. Output: a [`Fit`] for each population, and what of the disagreement is
//! left. From the analytic start (`compile::frontend::analytic`) the search goes through the populations from the input on. Each gets
//! the spikes that its converted sources send, and is to send those that the trained population sends:
//!
//! 1. *Shape*: du, dv and the refractory period over a grid around the start, with the best threshold for each; then finer
//!    steps while they help. The grid is tried on some of the samples, what is best there on all. The alpha kernel's refractory response is short and a hard reset's effect lasts as long as the
//!    voltage, so that a faster voltage than the start's often serves better.
//! 2. *Compartments*: for each its own gain of the incoming weights and its own bias, both free integers of the hardware.
//!
//! The distance is van Rossum's squared, and a tenth of the squared difference of counts (the whole of it for the output,
//! whose counts are classes), over all calibration samples. This is done three times, with compartments of their own
//! nowhere, in the output, everywhere; these and the start are run as integers, and what is nearest to the trained network is
//! returned: the search never makes things worse on the calibration samples. No randomness; ties go to the first.

use std::collections::HashMap;

use petgraph::algo::toposort;
use petgraph::graph::NodeIndex;
use rayon::prelude::*;

use crate::agree::compare::output_layer;
use crate::agree::ladder::{Cause, Ladder, Rung};
use crate::agree::metrics::{TAU, TrainSums};
use crate::agree::trace::{Comparison, Layer, Trace};
use crate::base::diagnostic::Result;
use crate::base::fixed::{Decay, Refractory};
use crate::compile::frontend::analytic::{self, Fit};
use crate::ir::graph::{Graph, PopulationKind, SrmParameters};
use crate::ir::spikes::Sample;
use crate::reference::synapses::Synapses;

/// Most neuron-steps that a candidate is tried on; calibration samples beyond are left out.
const MOST_WORK: u64 = 4_000_000;

/// Samples that the coarse grid is tried on.
const FEW: usize = 20;

/// How near a conversion is on the calibration samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConversionScore {
    /// Share of samples with the class of the trained network.
    pub class_agreement: f64,
    /// Coincidence factor over all layers.
    pub coincidence: f64,
    /// Differences of the output's spike counts relative to all of its spikes.
    pub count_error: f64,
}

impl ConversionScore {
    /// What is minimised: wrong classes, and wrong counts of the output.
    fn distance(&self) -> f64 {
        (1.0 - self.class_agreement) + self.count_error
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
    /// Candidates that were tried.
    pub tried: u64,
    /// Calibration samples.
    pub samples: usize,
}

/// A population's inputs and what it should do with them: per sample `[step][neuron]`.
struct Task {
    neurons: usize,
    /// Weighted input of each step.
    arrivals: Vec<Vec<f64>>,
    /// Which steps should have a spike.
    wanted: Vec<Vec<bool>>,
    /// What a squared difference of counts weighs beside the distance of trains.
    count_weight: f64,
}

/// A candidate for one neuron.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    keep_u: f64,
    keep_v: f64,
    threshold: f64,
    refractory: u32,
    gain: f64,
    bias: f64,
}

impl Task {
    /// The distance of a neuron with these parameters from what it should do.
    fn distance(&self, neuron: usize, c: &Candidate) -> f64 {
        let fades = libm::exp(-1.0 / TAU);
        let share = (1.0 - fades * fades) / 2.0;
        let mut sum = 0.0;
        for (arrivals, wanted) in self.arrivals.iter().zip(&self.wanted) {
            let (mut u, mut v, mut held, mut height, mut count) = (0.0, 0.0, 0u32, 0.0f64, 0.0f64);
            let mine = (neuron..arrivals.len()).step_by(self.neurons);
            for at in mine {
                u = c.keep_u * u + c.gain * arrivals[at];
                v = c.keep_v * v + u + c.bias;
                let mut fires = false;
                if held > 0 {
                    (held, v) = (held - 1, 0.0);
                } else if v > c.threshold {
                    (fires, held, v) = (true, c.refractory - 1, 0.0);
                }
                let difference = f64::from(u8::from(fires)) - f64::from(u8::from(wanted[at]));
                height += difference;
                count += difference;
                sum += height * height * share;
                height *= fades;
            }
            sum += height * height / 2.0 + self.count_weight * count * count;
        }
        sum
    }

    fn total(&self, candidate: &Candidate) -> f64 {
        (0..self.neurons).map(|neuron| self.distance(neuron, candidate)).sum()
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

/// The two decays, the refractory period and a factor of the matched threshold.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Shape {
    du: i64,
    dv: i64,
    refractory: i64,
    factor: f64,
}

impl Shape {
    fn valid(&self) -> bool {
        (1..=4096).contains(&self.du)
            && (1..=4096).contains(&self.dv)
            && (1..=63).contains(&self.refractory)
            && (0.05..=20.0).contains(&self.factor)
    }

    fn keeps(&self) -> (f64, f64) {
        (1.0 - self.du as f64 / 4096.0, 1.0 - self.dv as f64 / 4096.0)
    }

    fn candidate(&self, srm: &SrmParameters, timestep_ms: f64) -> Candidate {
        let (keep_u, keep_v) = self.keeps();
        let threshold = self.factor * analytic::matched_threshold(srm, timestep_ms, keep_u, keep_v);
        Candidate { keep_u, keep_v, threshold, refractory: self.refractory as u32, gain: 1.0, bias: 0.0 }
    }
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
    let material = Material { graph, layers: &layers, samples, trained: &trained, starts: &starts };
    for own in [Own::Nowhere, Own::Output, Own::Everywhere] {
        let fits = material.pipeline(own, &mut shapes, &mut tried, &mut progress)?;
        let score = score(&fits)?;
        if score.distance() < best.1.distance() {
            best = (fits, score);
        }
    }
    Ok(SearchResult { fits: best.0, start, end: best.1, tried, samples: samples.len() })
}

/// Which populations' compartments get gains and biases of their own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Own {
    Nowhere,
    Output,
    Everywhere,
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
        own: Own,
        shapes: &mut HashMap<NodeIndex, Shape>,
        tried: &mut u64,
        progress: &mut impl FnMut(&str),
    ) -> Result<Vec<Option<Fit>>> {
        let (graph, timestep_ms) = (self.graph, self.graph.facts().timestep_ms);
        let mut fits = self.starts.to_vec();
        let order = toposort(graph.petgraph(), None).unwrap_or_else(|_| graph.petgraph().node_indices().collect());
        let mut converted: Vec<Trace> = self.trained.iter().map(earlier).collect();
        for node in order {
            let population = graph.population(node);
            let PopulationKind::Srm(srm) = &population.kind else { continue };
            let Some(layer) = self.layers.iter().find(|layer| layer.name == population.name) else { continue };
            progress(&population.name);
            let output = node == graph.output();
            // Classes are counts of the output; timing serves the layers behind.
            let count_weight = if output { 1.0 } else { 0.1 };
            let task = task(graph, node, layer, (self.samples, &converted, self.trained), count_weight);
            // What only inputs drive is the same in every pipeline.
            let inputs_only = graph
                .projections()
                .filter(|(_, _, target, _)| *target == node)
                .all(|(_, source, _, _)| matches!(graph.population(source).kind, PopulationKind::Input));
            let shape = match shapes.get(&node) {
                Some(shape) if inputs_only => *shape,
                _ => best_shape(&task, srm, timestep_ms, tried),
            };
            shapes.insert(node, shape);
            let mut fit = fit_of(&shape, srm, timestep_ms);
            if own == Own::Everywhere || (own == Own::Output && output) {
                let shared = shape.candidate(srm, timestep_ms);
                (fit.gains, fit.biases) = compartments(&task, &shared, takes_gains(graph, node), tried);
            }
            fits[node.index()] = Some(fit);
            // What follows is to be calibrated on what this population will really send.
            let so_far = Ladder::new(graph, &fits)?;
            converted = self.samples.par_iter().map(|sample| so_far.run(Rung::MACHINE, sample, false)).collect();
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
    let each: Vec<(TrainSums, TrainSums, bool)> = samples
        .par_iter()
        .zip(trained)
        .map(|(sample, trained)| {
            let machine = ladder.run(Rung::MACHINE, sample, false);
            let of = |layer: &Layer| {
                let mut comparison = Comparison::default();
                comparison.add(0, layer, trained, &machine, -1);
                comparison.tally
            };
            let mut all = TrainSums::default();
            layers.iter().for_each(|layer| all.merge(&of(layer)));
            (all, of(output), trained.class(output) == machine.class(output))
        })
        .collect();
    let (mut all, mut last, mut same) = (TrainSums::default(), TrainSums::default(), 0usize);
    for (layers, output, agrees) in &each {
        all.merge(layers);
        last.merge(output);
        same += usize::from(*agrees);
    }
    ConversionScore {
        class_agreement: same as f64 / samples.len().max(1) as f64,
        coincidence: all.coincidence(),
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
        let mut wanted = vec![false; steps * neurons];
        for neuron in 0..neurons {
            let train = trained.trains[layer.first as usize + neuron].iter().filter_map(|t| t.checked_sub(1));
            train.for_each(|step| wanted[step as usize * neurons + neuron] = true);
        }
        (arrivals, wanted)
    };
    let (arrivals, wanted) = samples.par_iter().zip(converted).zip(trained).map(of_sample).unzip();
    Task { neurons, arrivals, wanted, count_weight }
}

/// Thresholds that are tried for each pair of decays, relative to the matched one.
const FACTORS: [f64; 9] = [0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.15, 1.35, 1.6];

fn best_shape(task: &Task, srm: &SrmParameters, timestep_ms: f64, tried: &mut u64) -> Shape {
    let base = analytic::start(srm, timestep_ms).du.get();
    let times = |factor: f64| (f64::from(base) * factor).round() as i64;
    let start = Shape { du: i64::from(base), dv: i64::from(base), refractory: 1, factor: 1.0 };
    let mut shapes = vec![start];
    for du in [0.5, 0.7, 1.0, 1.4, 2.0, 3.0] {
        for dv in [0.7, 1.0, 1.5, 2.2, 3.5, 5.5, 8.0] {
            for refractory in 1..=3 {
                let shape = |&factor: &f64| Shape { du: times(du), dv: times(dv).min(4096), refractory, factor };
                shapes.extend(FACTORS.iter().map(shape).filter(Shape::valid));
            }
        }
    }
    let ranked = |task: &Task, shapes: &[Shape], tried: &mut u64| {
        *tried += shapes.len() as u64;
        let distance = |shape: &Shape| task.total(&shape.candidate(srm, timestep_ms));
        let distances: Vec<f64> = shapes.par_iter().map(distance).collect();
        let mut order: Vec<usize> = (0..shapes.len()).collect();
        order.sort_by(|&a, &b| distances[a].total_cmp(&distances[b]));
        order.into_iter().map(|place| (shapes[place], distances[place])).collect::<Vec<_>>()
    };
    let nearest = |shapes: &[Shape], tried: &mut u64| ranked(task, shapes, tried)[0];
    // The best of the sketch, and the start, on everything.
    let mut few: Vec<Shape> = ranked(&task.sketch(), &shapes, tried).into_iter().take(12).map(|r| r.0).collect();
    few.push(start);
    let mut best = nearest(&few, tried);
    for step in [1.2, 1.1, 1.05, 1.02] {
        loop {
            let scale = |x: i64, factor: f64| ((x as f64 * factor).round() as i64).clamp(1, 4096);
            let Shape { du, dv, refractory, factor } = best.0;
            let mut near = Vec::new();
            for by in [step, 1.0 / step] {
                near.push(Shape { du: scale(du, by), ..best.0 });
                near.push(Shape { dv: scale(dv, by), ..best.0 });
                near.push(Shape { factor: factor * by, ..best.0 });
                near.push(Shape { du: scale(du, by), dv: scale(dv, 1.0 / by), ..best.0 });
            }
            near.push(Shape { refractory: refractory + 1, ..best.0 });
            near.push(Shape { refractory: refractory - 1, ..best.0 });
            near.retain(Shape::valid);
            let next = nearest(&near, tried);
            if next.1 >= best.1 * (1.0 - 1e-6) {
                break;
            }
            best = next;
        }
    }
    best.0
}

fn fit_of(shape: &Shape, srm: &SrmParameters, timestep_ms: f64) -> Fit {
    let start = analytic::start(srm, timestep_ms);
    Fit {
        du: Decay::new(shape.du).unwrap_or(start.du),
        dv: Decay::new(shape.dv).unwrap_or(start.dv),
        refractory: Refractory::new(shape.refractory).unwrap_or(start.refractory),
        threshold: shape.candidate(srm, timestep_ms).threshold,
        gains: Vec::new(),
        biases: Vec::new(),
    }
}

/// Whether each compartment's incoming weights are its own.
fn takes_gains(graph: &Graph, node: NodeIndex) -> bool {
    let mut into = graph.projections().filter(|(_, _, target, _)| *target == node);
    into.all(|(_, _, _, projection)| projection.kind.has_own_weights())
}

/// The best gain and bias of each compartment.
fn compartments(task: &Task, shared: &Candidate, gains: bool, tried: &mut u64) -> (Vec<f64>, Vec<f64>) {
    // A bias that alone brings the voltage to the threshold, and no further.
    let unit = shared.threshold * (1.0 - shared.keep_v);
    let one = |neuron: usize| {
        let (mut best, mut count) = (*shared, 0u64);
        let mut least = task.distance(neuron, &best);
        for (gain_step, bias_step) in [(1.3, 0.1), (1.15, 0.05), (1.07, 0.02), (1.03, 0.01), (1.015, 0.005)] {
            // Few enough rounds to end, more than enough to get anywhere in range.
            for _ in 0..8 {
                let mut near = Vec::new();
                if gains {
                    near.push(Candidate { gain: best.gain * gain_step, ..best });
                    near.push(Candidate { gain: best.gain / gain_step, ..best });
                }
                near.push(Candidate { bias: best.bias + bias_step * unit, ..best });
                near.push(Candidate { bias: best.bias - bias_step * unit, ..best });
                near.retain(|c| (0.3..=3.0).contains(&c.gain) && c.bias.abs() <= 0.5 * unit);
                count += near.len() as u64;
                let mut moved = false;
                for candidate in near {
                    let distance = task.distance(neuron, &candidate);
                    if distance < least {
                        (best, least, moved) = (candidate, distance, true);
                    }
                }
                if !moved {
                    break;
                }
            }
        }
        (best.gain, best.bias, count)
    };
    let each: Vec<(f64, f64, u64)> = (0..task.neurons).into_par_iter().map(one).collect();
    // A compartment is one of as many as a candidate for all is tried on.
    *tried += each.iter().map(|(_, _, count)| count).sum::<u64>() / task.neurons.max(1) as u64;
    let list = if gains { each.iter().map(|e| e.0).collect() } else { Vec::new() };
    (list, each.iter().map(|e| e.1).collect())
}
