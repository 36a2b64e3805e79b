//! The best integers for a spike response network, by a deterministic search over calibration
//! samples.
//!
//! Input: the graph and calibration samples. Output: a [`Fit`] for each population, and the
//! distance of each stage. From the analytic start (`nsim_quantise::analytic`) each stage goes
//! through the populations from the input on. A population receives the spikes of its converted
//! sources, and is to send the spikes of the trained population, step by step:
//!
//! 1. [`Stage::Shape`]: du, dv, and taps of the input (`super::taps`), with synapses of
//!    each compartment onto itself for the refractory response. Then threshold and these synapses
//!    are refined in finer steps while they help. A voltage that forgets everything in a step loses
//!    nothing at a reset, and the taps turn the current's exponential into an alpha kernel.
//! 2. [`Stage::Rounding`]: the rounding error of a tap is carried to the next one
//!    (`nsim_quantise::carry`).
//!
//! The objective is 1 minus the coincidence factor, plus a share of the difference of spike counts
//! (greater for the output, whose counts are classes). The start and every stage are run as
//! integers. The nearest to the trained network is returned, so a search never does harm on the
//! calibration samples. Nothing is random; ties go to the first.

use petgraph::algo::toposort;
use petgraph::graph::NodeIndex;
use rayon::prelude::*;

use nsim_agree::attribution::{ComparedSample, StageComparison};
use nsim_agree::causes::{Cause, ComparisonStage};
use nsim_agree::classes::ClassTally;
use nsim_agree::compare::output_layer;
use nsim_agree::metrics::{TrainSums, coincidence};
use nsim_agree::staged::StagedNetwork;
use nsim_agree::trace::{Layer, Trace};
use nsim_ir::base::diagnostic::Result;
use nsim_ir::base::fixed::{DECAY_ONE, Decay, Delay, Refractory};
use nsim_ir::base::names::named_variants;
use nsim_ir::graph::{Graph, Population, PopulationKind, ProjectionKind, SrmParameters};
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::Sample;
use nsim_quantise::analytic::{self, Fit};
use nsim_quantise::exponents::Detail;
use nsim_quantise::quantise::quantise_with;
use nsim_reference::synapses::{SumOrder, Synapses};

use super::taps::{self, Arrivals, MOST_TAPS, Taps};

/// Most neuron-steps on which a candidate is tried; further calibration samples are skipped.
const MOST_WORK: u64 = 2_000_000;

/// Neuron-steps of the first trial of shapes, and most neuron-steps of the refinement.
const FIRST_TRIAL_WORK: usize = 40_000;
const REFINEMENT_WORK: usize = 240_000;
/// Least number of samples of a first trial and of a refinement.
const LEAST_SAMPLES: usize = 8;

/// Synapses of a compartment onto itself. After this many steps the paper's refractory response is
/// below 0.001 thresholds. With 10, its tail costs 0.01 to 0.03 in coincidence.
const SELF_SYNAPSES: usize = 12;

/// Factor on the greatest input of the calibration samples up to which no register wraps.
const INPUT_MARGIN: f64 = 2.0;

/// Distance that one more tap must gain: a constant, and a part for each synapse.
const TAP_PRICE: f64 = 0.0005;
const SYNAPSE_PRICE: f64 = 5e-8;

/// Most synapses of the taps of a compartment's input: a core's memory at 20 bits a synapse.
const MOST_SYNAPSES: usize = 49_152;

/// Most synapses of the taps, half a core, of a population that gets twice the taps.
const FEW_SYNAPSES: f64 = 24_576.0;

/// Most compartments of a searched population, whose synapses onto themselves are listed.
const MOST_SELF_CONNECTED: u32 = 1 << 16;

named_variants! {
    /// Stages of the search, each added to the previous one.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum Stage {
        /// The analytic start.
        Start = "analytic start",
        /// Decays, taps, threshold and self-synapses of each population together.
        Shape = "decays, delayed copies and reset together",
        /// Rounding errors carried over to the next tap.
        Rounding = "rounding errors carried to the next copy",
    }
}

/// Distance of a conversion on the calibration samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConversionScore {
    /// Agreement of the classes of the trained and the converted network.
    pub classes: ClassTally,
    /// Coincidence factor over all layers.
    pub coincidence: f64,
    /// The mean of the layers' coincidence factors.
    pub mean_coincidence: f64,
    /// Differences of the output's spike counts, relative to all of its spikes.
    pub count_error: f64,
}

impl ConversionScore {
    /// The objective: wrong classes, wrong counts of the output, spikes that do not coincide.
    fn distance(&self) -> f64 {
        2.0 * (1.0 - self.classes.share_reproduced()) + self.count_error + (1.0 - self.mean_coincidence)
    }
}

/// The converted form of a network of spike response neurons.
#[derive(Debug, Clone, PartialEq)]
pub struct Conversion {
    /// The fit of each population, in the order of the populations.
    pub fits: Vec<Option<Fit>>,
    /// Detail at which exponents and weights are chosen.
    pub detail: Detail,
}

impl Conversion {
    /// The comparison stages from the network to these integers.
    ///
    /// # Errors
    /// As `nsim_quantise::quantise`.
    pub fn staged(&self, graph: &Graph) -> Result<StagedNetwork> {
        StagedNetwork::with_exponents(graph, &self.fits, self.detail)
    }

    /// The integers.
    ///
    /// # Errors
    /// As `nsim_quantise::quantise`.
    pub fn integers(&self, graph: &Graph) -> Result<Quantised> {
        quantise_with(&analytic::with_fits(graph, &self.fits), self.detail)
    }
}

/// Result of a search.
#[derive(Debug, Clone, PartialEq)]
pub struct SearchResult {
    /// The conversion that is nearest to the trained network.
    pub conversion: Conversion,
    /// Score of the analytic start.
    pub start: ConversionScore,
    /// Score of the returned conversion.
    pub end: ConversionScore,
    /// Conversions of all stages, the start first.
    pub stages: Vec<(Stage, Conversion)>,
    /// Number of candidates tried.
    pub tried: u64,
    /// Number of calibration samples.
    pub samples: usize,
}

/// A population's inputs and its wanted spikes.
struct Task {
    neurons: usize,
    /// Weighted input of each sample, `[neuron][step]`.
    arrivals: Vec<Vec<f64>>,
    /// Wanted spike steps of each neuron, by sample.
    wanted: Vec<Vec<Vec<u32>>>,
    /// Weight of a difference of counts relative to coincidence.
    count_weight: f64,
}

/// A candidate for one neuron.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    keep_u: f64,
    keep_v: f64,
    threshold: f64,
    taps: Taps,
    own: [f64; SELF_SYNAPSES],
}

impl Candidate {
    /// Simulates its spikes; `see` receives the input of each step and the current after it.
    fn spikes(&self, arrived: &[f64], spikes: &mut Vec<u32>, mut see: impl FnMut(f64, f64)) {
        spikes.clear();
        let (mut u, mut v) = (0.0, 0.0);
        // Arrivals from its own spikes, in this step and the next ones.
        let (mut coming, mut at) = ([0.0; SELF_SYNAPSES], 0);
        for (step, x) in arrived.iter().enumerate() {
            let x = x + coming[at];
            u = self.keep_u * u + x;
            see(x, u);
            coming[at] = 0.0;
            at = if at + 1 == SELF_SYNAPSES { 0 } else { at + 1 };
            v = self.keep_v * v + u;
            if v > self.threshold {
                v = 0.0;
                spikes.push(step as u32);
                let (first, rest) = self.own.split_at(SELF_SYNAPSES - at);
                coming[at..].iter_mut().zip(first).for_each(|(sum, weight)| *sum += weight);
                coming.iter_mut().zip(rest).for_each(|(sum, weight)| *sum += weight);
            }
        }
    }
}

/// Distance of spikes from the wanted ones, in sums that add up over neurons.
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
    fn arrived(&self) -> Arrivals<'_> {
        Arrivals { neurons: self.neurons, samples: &self.arrivals }
    }

    /// The summed input through all taps, laid out as [`Task::arrivals`].
    fn through_taps(&self, taps: &Taps) -> Vec<Vec<f64>> {
        let of_sample = |arrivals: &Vec<f64>| {
            let steps = (arrivals.len() / self.neurons.max(1)).max(1);
            let mut sums = vec![0.0; arrivals.len()];
            for (sums, arrived) in sums.chunks_mut(steps).zip(arrivals.chunks(steps)) {
                for &(delay, factor) in taps.as_slice() {
                    let late = (delay as usize).min(sums.len());
                    sums[late..].iter_mut().zip(arrived).for_each(|(sum, x)| *sum += factor * x);
                }
            }
            sums
        };
        self.arrivals.par_iter().map(of_sample).collect()
    }

    fn gap(&self, neuron: usize, c: &Candidate, arrived: &[Vec<f64>], spikes: &mut Vec<u32>) -> Gap {
        let mut gap = Gap::default();
        for (arrived, wanted) in arrived.iter().zip(&self.wanted) {
            let steps = arrived.len() / self.neurons;
            c.spikes(&arrived[neuron * steps..(neuron + 1) * steps], spikes, |_, _| ());
            let (wanted, got) = (&wanted[neuron], &*spikes);
            if !(wanted.is_empty() && got.is_empty()) {
                let (beyond_chance, at_most) = coincidence(wanted, got, steps as u32);
                let counts = wanted.len().abs_diff(got.len()) as f64;
                let spikes = (wanted.len() + got.len()) as f64;
                gap = gap.add(Gap { beyond_chance, at_most, counts, spikes });
            }
        }
        gap
    }

    /// The greatest input of a step to plan for: `INPUT_MARGIN` times the greatest of these
    /// samples, or times the constant input that holds the current at its greatest value.
    fn greatest_input(&self, c: &Candidate) -> f64 {
        let of_sample = |arrived: &Vec<f64>| {
            let (mut most, mut spikes) = (0.0, Vec::new());
            for row in arrived.chunks((arrived.len() / self.neurons.max(1)).max(1)) {
                c.spikes(row, &mut spikes, |x, u| most = f64::max(most, x.abs().max(u.abs() * (1.0 - c.keep_u))));
            }
            most
        };
        INPUT_MARGIN * self.through_taps(&c.taps).par_iter().map(of_sample).reduce(|| 0.0, f64::max)
    }

    fn distance(&self, candidate: &Candidate, arrived: &[Vec<f64>]) -> f64 {
        let mut spikes = Vec::new();
        let gaps = (0..self.neurons).map(|neuron| self.gap(neuron, candidate, arrived, &mut spikes));
        gaps.fold(Gap::default(), Gap::add).distance(self.count_weight)
    }

    /// The task over evenly chosen samples, enough to distinguish shapes.
    fn part(&self, neuron_steps: usize) -> Task {
        let all: usize = self.arrivals.iter().map(Vec::len).sum();
        let every = all.div_ceil(neuron_steps).clamp(1, self.arrivals.len().div_ceil(LEAST_SAMPLES).max(1));
        Task {
            neurons: self.neurons,
            arrivals: self.arrivals.iter().step_by(every).cloned().collect(),
            wanted: self.wanted.iter().step_by(every).cloned().collect(),
            count_weight: self.count_weight,
        }
    }
}

/// Parameters shared by the compartments of a population.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Shape {
    keep_u: f64,
    keep_v: f64,
    taps: Taps,
    threshold: f64,
    /// Voltage at a spike in thresholds, and factor on the trained neuron's refractory response.
    given_back: f64,
    refractory: f64,
}

impl Shape {
    fn valid(&self) -> bool {
        (0.0..=6.0).contains(&self.given_back) && (0.0..=6.0).contains(&self.refractory)
    }

    fn candidate(&self, srm: &SrmParameters, timestep_ms: f64) -> Candidate {
        let Shape { keep_u, keep_v, taps, threshold, given_back, refractory } = *self;
        let relative =
            analytic::own_synapses((srm, timestep_ms), (keep_u, keep_v), (given_back, refractory), SELF_SYNAPSES);
        let own = std::array::from_fn(|step| relative.get(step).map_or(0.0, |relative| relative * threshold));
        Candidate { keep_u, keep_v, threshold, taps, own }
    }

    /// Distance that its taps have to gain.
    fn price(&self, synapses: f64) -> f64 {
        (TAP_PRICE + SYNAPSE_PRICE * synapses) * self.taps.as_slice().len() as f64
    }
}

/// Searches for the integers of a network.
///
/// # Errors
/// As `nsim_quantise::quantise`.
///
/// `most` is the greatest number of taps of a population's input.
pub fn search(graph: &Graph, samples: &[&Sample], most: usize, progress: impl FnMut(&str)) -> Result<SearchResult> {
    let starts = analytic::starts(graph);
    let staged = StagedNetwork::new(graph, &starts)?;
    let largest = staged.layers().iter().map(|layer| u64::from(layer.count)).max().unwrap_or(1);
    let steps: u64 = samples.iter().map(|sample| u64::from(sample.steps())).max().unwrap_or(1);
    let fitting = (MOST_WORK / (largest * steps).max(1)).max(4) as usize;
    let samples = &samples[..samples.len().min(fitting)];
    let trained: Vec<Trace> = samples
        .par_iter()
        .map(|sample| staged.run(ComparisonStage::TRAINED.with(Cause::Untruncated), sample, false))
        .collect();
    let layers = staged.layers();
    let output = output_layer(staged.deployed());
    let score = |conversion: &Conversion| -> Result<ConversionScore> {
        Ok(scored(&conversion.staged(graph)?, &layers, &output, samples, &trained))
    };
    let analysis = Conversion { fits: starts.clone(), detail: Detail::Groups };
    let start = score(&analysis)?;
    let (fits, tried) = pipeline(graph, &layers, samples, &trained, starts, most, progress);
    let searched = Conversion { fits, detail: Detail::Carried };
    let end = score(&searched)?;
    let stages = vec![
        (Stage::Start, analysis.clone()),
        (Stage::Shape, Conversion { detail: Detail::Groups, ..searched.clone() }),
        (Stage::Rounding, searched.clone()),
    ];
    let (conversion, end) = if end.distance() < start.distance() { (searched, end) } else { (analysis, start) };
    Ok(SearchResult { conversion, start, end, stages, tried, samples: samples.len() })
}

/// Searches populations from the input on; returns the fits, and the number of candidates tried.
fn pipeline(
    graph: &Graph,
    layers: &[Layer],
    samples: &[&Sample],
    trained: &[Trace],
    mut fits: Vec<Option<Fit>>,
    most: usize,
    mut progress: impl FnMut(&str),
) -> (Vec<Option<Fit>>, u64) {
    let (timestep_ms, mut tried) = (graph.facts().timestep_ms, 0);
    let order = toposort(graph.petgraph(), None).unwrap_or_else(|_| graph.petgraph().node_indices().collect());
    let as_trained: Vec<Trace> = trained.iter().map(earlier).collect();
    for node in order {
        let population = graph.population(node);
        let PopulationKind::Srm(srm) = &population.kind else { continue };
        let Some(layer) = layers.iter().find(|layer| layer.name == population.name) else { continue };
        if layer.count > MOST_SELF_CONNECTED {
            // It keeps its analytic fit.
            continue;
        }
        progress(&population.name);
        let output = node == graph.output();
        let count_weight = if output { 0.5 } else { 0.2 };
        let task = task(graph, node, layer, samples, &as_trained, trained, count_weight);
        let Some(shape) = best_shape(&task, graph, node, srm, most, &mut tried) else {
            let name = &population.name;
            tracing::warn!("{name}: it receives no spikes in these samples, so its integers follow from analysis only");
            continue;
        };
        let mut fit = fit_of(&shape, srm, timestep_ms);
        fit.greatest_input = Some(task.greatest_input(&shape.candidate(srm, timestep_ms)));
        fits[node.index()] = Some(fit);
    }
    (fits, tried)
}

/// A trace one step earlier, as a converted layer responds.
fn earlier(trace: &Trace) -> Trace {
    let trains = trace.trains.iter().map(|train| train.iter().filter_map(|step| step.checked_sub(1)).collect());
    Trace { trains: trains.collect(), ..trace.clone() }
}

fn scored(
    staged: &StagedNetwork,
    layers: &[Layer],
    output: &Layer,
    samples: &[&Sample],
    trained: &[Trace],
) -> ConversionScore {
    let compared = |(sample, trained): (&&Sample, &Trace)| {
        ComparedSample::new(layers, output, (trained, &staged.run(ComparisonStage::MACHINE, sample, false)), -1)
    };
    let each: Vec<ComparedSample> = samples.par_iter().zip(trained).map(compared).collect();
    let StageComparison { distance, layers: by_layer, classes, .. } = StageComparison::new(layers.len(), each.iter());
    let last = layers.iter().position(|layer| layer == output).map(|place| by_layer[place]).unwrap_or_default();
    ConversionScore {
        classes,
        coincidence: distance.coincidence,
        mean_coincidence: by_layer.iter().map(TrainSums::coincidence).sum::<f64>() / by_layer.len().max(1) as f64,
        count_error: last.count_error(),
    }
}

/// The first channel or compartment of each population.
pub(super) fn first_indices(graph: &Graph) -> Vec<u32> {
    let (mut channels, mut compartments) = (0, 0);
    let first = |(_, population): (NodeIndex, &Population)| {
        let counter = if matches!(population.kind, PopulationKind::Input) { &mut channels } else { &mut compartments };
        *counter += population.shape.len();
        *counter - population.shape.len()
    };
    graph.populations().map(first).collect()
}

/// A population's input and wanted spikes, in the converted network's time.
fn task(
    graph: &Graph,
    node: NodeIndex,
    layer: &Layer,
    samples: &[&Sample],
    converted: &[Trace],
    trained: &[Trace],
    count_weight: f64,
) -> Task {
    let (neurons, firsts) = (layer.count as usize, first_indices(graph));
    let links: Vec<_> = graph
        .incoming(node)
        .map(|(source, projection)| {
            let count = graph.population(source).shape.len();
            let input = matches!(graph.population(source).kind, PopulationKind::Input);
            let synapses = Synapses::<f64>::new(projection, count, SumOrder::of_units(layer.count), 1.0);
            (firsts[source.index()], count, input, u32::from(projection.delay.get()), synapses)
        })
        .collect();
    let of_sample = |((sample, converted), trained): ((&&Sample, &Trace), &Trace)| {
        let steps = sample.steps() as usize;
        let mut arrived = vec![0.0; steps * neurons];
        for (first, count, input, delay, synapses) in &links {
            let mut send = |source: u32, step: usize| {
                if step < steps {
                    synapses.deliver(source, &mut arrived[step * neurons..(step + 1) * neurons]);
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
        let by_neuron = (0..neurons).flat_map(|neuron| arrived.iter().skip(neuron).step_by(neurons).copied());
        (by_neuron.collect(), wanted.collect())
    };
    let (arrivals, wanted) = samples.par_iter().zip(converted).zip(trained).map(of_sample).unzip();
    Task { neurons, arrivals, wanted, count_weight }
}

/// A shape and its distance, with the price of its taps.
#[derive(Clone, Copy)]
struct RatedShape {
    shape: Shape,
    distance: f64,
}

/// Trials of shapes for one population.
struct Trials<'t> {
    srm: &'t SrmParameters,
    timestep_ms: f64,
    /// Synapses of one tap.
    synapses: f64,
    /// Number of candidates tried.
    tried: &'t mut u64,
}

impl Trials<'_> {
    fn rated(&self, task: &Task, shape: Shape, arrived: &[Vec<f64>]) -> RatedShape {
        let distance = task.distance(&shape.candidate(self.srm, self.timestep_ms), arrived);
        RatedShape { shape, distance: distance + shape.price(self.synapses) }
    }

    /// The shapes, the nearest first.
    fn ranked(&mut self, task: &Task, shapes: &[Shape]) -> Vec<RatedShape> {
        *self.tried += shapes.len() as u64;
        let rated = shapes.par_iter().map(|shape| self.rated(task, *shape, &task.through_taps(&shape.taps)));
        let mut rated: Vec<RatedShape> = rated.collect();
        rated.sort_by(|a, b| a.distance.total_cmp(&b.distance));
        rated
    }

    /// The nearest shape that is reached by steps of these factors, each while it helps.
    fn descend(&mut self, task: &Task, from: RatedShape, steps: &[f64]) -> RatedShape {
        let mut best = from;
        let arrived = task.through_taps(&from.shape.taps);
        for &step in steps {
            // A bound on the rounds, with room to reach any value in range.
            for _ in 0..12 {
                let near = near(&best.shape, step);
                *self.tried += near.len() as u64;
                let rated: Vec<_> = near.par_iter().map(|shape| self.rated(task, *shape, &arrived)).collect();
                let nearest = rated.into_iter().reduce(|a, b| if b.distance < a.distance { b } else { a });
                match nearest {
                    Some(next) if next.distance < best.distance - 1e-6 => best = next,
                    _ => break,
                }
            }
        }
        best
    }
}

/// The shape nearest to the trained spikes; `None` where no spikes arrive.
fn best_shape(
    task: &Task,
    graph: &Graph,
    node: NodeIndex,
    srm: &SrmParameters,
    most: usize,
    tried: &mut u64,
) -> Option<Shape> {
    let timestep_ms = graph.facts().timestep_ms;
    let (sketch, drawing) = (task.part(FIRST_TRIAL_WORK), task.part(REFINEMENT_WORK));
    let into = || graph.incoming(node).map(|(_, projection)| projection);
    let latest = into().map(|projection| u32::from(projection.delay.get())).max().unwrap_or(0);
    let room = u32::from(Delay::MAX.get()) - latest;
    // The number for all-to-all connections; windows have fewer, so it overrates their price.
    let sources = graph.incoming(node).map(|(source, _)| f64::from(graph.population(source).shape.len()));
    let synapses = sources.sum::<f64>() * task.neurons as f64;
    let most = if into().any(|projection| matches!(projection.kind, ProjectionKind::Random { .. })) { 1 } else { most };
    let fan_in = (synapses / task.neurons.max(1) as f64) as usize;
    // With few synapses, taps are almost free.
    let most = if 2.0 * most as f64 * synapses <= FEW_SYNAPSES { (2 * most).min(MOST_TAPS) } else { most };
    let most = most.min(MOST_SYNAPSES / fan_in.max(1)).max(1);
    let shape = |(keep_u, keep_v, taps): (f64, f64, Taps)| {
        // Random weights have no factor, so the threshold is scaled.
        let unit = if most == 1 { taps.as_slice().first().map_or(1.0, |tap| tap.1) } else { 1.0 };
        let threshold = srm.theta / unit;
        Shape { keep_u, keep_v, taps: taps.scaled(1.0 / unit), threshold, given_back: 1.15, refractory: 1.0 }
    };
    let shapes: Vec<Shape> =
        taps::candidates(sketch.arrived(), srm, timestep_ms, most, room).into_iter().map(shape).collect();
    let mut trials = Trials { srm, timestep_ms, synapses, tried };
    let few: Vec<RatedShape> = trials.ranked(&sketch, &shapes).into_iter().take(3).collect();
    let refined: Vec<Shape> = few.into_iter().map(|from| trials.descend(&sketch, from, &[1.1, 1.05]).shape).collect();
    let best = *trials.ranked(&drawing, &refined).first()?;
    Some(trials.descend(&drawing, best, &[1.02]).shape)
}

/// Shapes one step away.
fn near(best: &Shape, step: f64) -> Vec<Shape> {
    let mut near = Vec::new();
    for by in [step, 1.0 / step] {
        near.push(Shape { threshold: best.threshold * by, ..*best });
        near.push(Shape { refractory: best.refractory * by, ..*best });
        near.push(Shape { threshold: best.threshold * by, refractory: best.refractory / by, ..*best });
        if best.keep_v > 0.0 {
            near.push(Shape { given_back: best.given_back * by, ..*best });
            near.push(Shape { threshold: best.threshold * by, given_back: best.given_back / by, ..*best });
        }
    }
    near.retain(Shape::valid);
    near
}

fn fit_of(shape: &Shape, srm: &SrmParameters, timestep_ms: f64) -> Fit {
    let (start, candidate) = (analytic::start(srm, timestep_ms), shape.candidate(srm, timestep_ms));
    let decay = |keep: f64| Decay::new(libm::rint(DECAY_ONE as f64 * (1.0 - keep)) as i64);
    Fit {
        du: decay(shape.keep_u).unwrap_or(start.du),
        dv: decay(shape.keep_v).unwrap_or(start.dv),
        refractory: Refractory::new(1).unwrap_or(start.refractory),
        threshold: candidate.threshold,
        taps: shape.taps.as_slice().to_vec(),
        own: candidate.own.iter().map(|&weight| vec![weight]).collect(),
        greatest_input: None,
    }
}
