//! A few epochs of training with the integers in the forward pass.
//!
//! Input: a network of spike response neurons, the converted form of each population, a training
//! plan and labelled training samples. Output: the trained weights whose integers decide best, and
//! their scores. Invariants: in every minibatch `quantise` makes the weights integers, and exactly
//! these run the samples (`agree::staged`, whose last stage equals the golden interpreter bit for
//! bit). The gradient is the trained neurons' at the integers' potentials, in thresholds, and at
//! their spikes. Rounding, reset and taps have a derivative of 1. The selected epoch does
//! best on the unvaried training samples, the start included: most right, then least loss. Held-out
//! samples are only counted, at the start and at the end. Errors: networks that the plan does not
//! describe.
//!
//! No training samples are set aside to choose the epoch: the network was trained on all of them,
//! so the start would be judged on known samples.
//!
//! A converted layer responds one step earlier than the trained one (`docs/semantics.md`, 18). So
//! samples get one more, empty step, the integers run without it, and their spikes and potentials
//! are read one step later.

use std::sync::Arc;

use petgraph::graph::NodeIndex;
use rayon::prelude::*;

use crate::cells::Cells;
use crate::checkpoint;
use crate::convert::resets::subtracts;
use crate::convert::search::first_indices;
use crate::convert::staged::MeasuredDistance;
use crate::fit::{Example, Forward, Plan};
use crate::network::{Deployed, Source, Weights, Workspace};
use crate::raster::Raster;
use crate::trace::Trace as TrainedTrace;
use nsim_agree::causes::ComparisonStage;
use nsim_agree::compare::output_layer;
use nsim_agree::staged::StagedNetwork;
use nsim_agree::trace::{Layer, Trace};
use nsim_files::training::TrainingFile;
use nsim_ir::arithmetic::ReadOut;
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::id::ChannelId;
use nsim_ir::graph::{Graph, PopulationKind, ProjectionKind};
use nsim_ir::spikes::{Message, Sample};
use nsim_ir::tensor::{Numbers, Tensor};
use nsim_quantise::analytic::Fit;
use nsim_quantise::exponents::Detail;

/// A network to fine-tune, its integers and the plan.
#[derive(Debug)]
pub struct Task {
    graph: Graph,
    fits: Vec<Option<Fit>>,
    detail: Detail,
    plan: Plan,
    /// For each projection of the graph, its target layer and the place of its first source.
    places: Vec<ProjectionPlace>,
    /// The plan's layers, with the integers' numbering of compartments.
    layers: Vec<Layer>,
}

#[derive(Debug, Clone, Copy)]
struct ProjectionPlace {
    layer: usize,
    offset: usize,
    sources: usize,
    first_column: usize,
}

/// Accuracy and loss of integers.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize)]
pub struct TaskScore {
    /// Fraction of samples with the right class, 0..=1.
    pub accuracy: f64,
    /// Mean loss.
    pub loss: f64,
}

/// Score of an epoch.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct FineTuneRow {
    /// Score of its integers on the unvaried training samples.
    #[serde(flatten)]
    pub score: TaskScore,
    /// The epoch, 0 before the first.
    pub epoch: u32,
}

/// Scores on samples that were not trained on.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct HeldOutScores {
    /// Number of samples.
    pub samples: usize,
    /// Fraction with the right class in the trained network.
    #[serde(rename = "trained_accuracy")]
    pub trained: f64,
    /// Score of the integers before.
    pub before: TaskScore,
    /// Score of the selected integers.
    pub after: TaskScore,
}

/// Result of a fine-tuning.
#[derive(Debug, Clone)]
pub struct FineTuned {
    /// The selected weights.
    pub weights: Weights,
    /// The epoch of these weights; 0 if no epoch was better than the start.
    pub kept: u32,
    /// One row before the first epoch, and one after each.
    pub rows: Vec<FineTuneRow>,
    /// Number of training samples.
    pub samples: usize,
    /// Scores on samples that were not trained on; none without labelled ones.
    pub held_out: Option<HeldOutScores>,
    /// The seed of the order of samples.
    pub seed: u64,
    /// SHA-256 of the plan and of all training samples.
    pub fingerprint: String,
}

impl FineTuned {
    /// Scores of the first and of the selected integers, on the training samples.
    pub fn scores(&self) -> (TaskScore, TaskScore) {
        let of =
            |epoch: u32| self.rows.iter().find(|row| row.epoch == epoch).map_or_else(TaskScore::default, |r| r.score);
        (of(0), of(self.kept))
    }
}

/// Fine-tuned integers.
#[derive(Debug)]
pub struct TunedIntegers {
    /// The epochs and their scores.
    pub tuned: FineTuned,
    /// Requested number of epochs.
    pub epochs: u32,
    /// The selected integers.
    pub integers: StagedNetwork,
    /// Sources of the training samples.
    pub samples: Vec<String>,
    /// Distance from the trained network on samples that no stage used.
    pub held_out: Option<MeasuredDistance>,
}

impl TunedIntegers {
    /// A sentence for a model's provenance.
    pub fn provenance_text(&self) -> String {
        let FineTuned { kept, samples, held_out, seed, fingerprint, .. } = &self.tuned;
        fn change(before: &TaskScore, after: &TaskScore) -> String {
            format!("{:.4} -> {:.4}", before.accuracy, after.accuracy)
        }
        let (before, after) = self.tuned.scores();
        let unseen = held_out.map_or_else(String::new, |held| {
            let change = change(&held.before, &held.after);
            format!(", {change} on {} held-out samples (as trained {:.4})", held.samples, held.trained)
        });
        format!(
            "fine-tuned for {} with seed {seed} on {samples} training samples of {}, SHA-256 of plan and samples \
             {fingerprint}; epoch \
             {kept} is kept; accuracy {} on the training samples{unseen}",
            if self.epochs == 1 { "1 epoch".to_string() } else { format!("{} epochs", self.epochs) },
            self.samples.join(" "),
            change(&before, &after),
        )
    }
}

/// The best epoch so far.
#[derive(Debug, Clone)]
pub struct BestEpoch {
    /// Its weights.
    pub weights: Weights,
    /// Its number.
    pub epoch: u32,
    /// Score on the training samples.
    pub score: TaskScore,
}

fn unsupported(graph: &Graph, message: &str) -> Diagnostic {
    Diagnostic::new("convert.fine-tune", format!("{}: {message}", graph.facts().name))
        .help("fine-tuning supports dense layers of spike response neurons, with their training file")
}

/// Checks that a network has dense layers of spike response neurons without loops or delays.
///
/// # Errors
/// `convert.fine-tune` with the unsupported property.
pub fn trainable(graph: &Graph) -> Result<()> {
    if graph.facts().decision != ReadOut::Spikes {
        let message = "it decides by potentials, but fine-tuning needs decisions by spikes";
        return Err(unsupported(graph, message).help(
            "train it as Loihi neurons instead: nsim train, with the loss Potential and theta: inf for its output",
        ));
    }
    for (_, population) in graph.populations() {
        if matches!(population.kind, PopulationKind::Neurons(_)) {
            let message = format!("'{}' has neurons that are not spike response neurons", population.name);
            let unlike = unsupported(graph, &message);
            return Err(match subtracts(&population.kind) {
                true => unlike.help(
                    "train the network again with a reset to zero (snnTorch: reset_mechanism='zero'): the conversion \
                     then loses nothing to the reset, so no fine-tuning is needed",
                ),
                false => unlike.help(
                    "fine-tuning supports spike response neurons; docs/tutorials/rounded-weights.md trains others in \
                     PyTorch, with rounded weights",
                ),
            });
        }
    }
    for (_, source, target, projection) in graph.projections() {
        let plain = matches!(projection.kind, ProjectionKind::Dense { .. }) && projection.delay.get() == 0;
        if !plain || source >= target || graph.population(source).message != Message::Spike {
            let message = format!("projection {} is not a dense layer without a delay", projection.name);
            return Err(unsupported(graph, &message));
        }
    }
    Ok(())
}

impl Task {
    /// A task from a network, the fits of its populations, and the training file with its plan.
    ///
    /// # Errors
    /// `convert.fine-tune` if the training file describes another network.
    pub fn new(
        graph: &Graph,
        (fits, detail): (&[Option<Fit>], Detail),
        file: &TrainingFile,
        plan: Plan,
    ) -> Result<Task> {
        trainable(graph)?;
        let mut channels = graph.populations().filter(|(_, p)| matches!(p.kind, PopulationKind::Input));
        for (input, &size) in file.inputs.iter().zip(&plan.topology.inputs) {
            if !channels.next().is_some_and(|(_, p)| p.name == input.name && p.shape.len() as usize == size) {
                let message = format!("the training file's input '{}' is not its next input", input.name);
                return Err(unsupported(graph, &message));
            }
        }
        if let Some((_, more)) = channels.next() {
            return Err(unsupported(graph, &format!("the training file has no input '{}'", more.name)));
        }
        let node_of = |name: &str| graph.populations().find(|(_, p)| p.name == name).map(|(node, _)| node);
        let inputs: Vec<Option<NodeIndex>> = file.inputs.iter().map(|input| node_of(&input.name)).collect();
        let nodes: Vec<Option<NodeIndex>> = file.layers.iter().map(|layer| node_of(&layer.name)).collect();
        let mut layers = Vec::new();
        let firsts = first_indices(graph);
        for (layer, node) in plan.topology.layers.iter().zip(&nodes) {
            let population = node.map(|node| (node, graph.population(node)));
            let timestep_ms = graph.facts().timestep_ms;
            let same = population.filter(|(_, population)| match (&population.kind, &layer.cells) {
                (PopulationKind::Srm(srm), Cells::Srm(cells)) => {
                    let decay = libm::exp(-timestep_ms / srm.tau_sr_ms);
                    population.shape.len() as usize == layer.cells.count()
                        && (f64::from(cells.theta) - srm.theta).abs() <= 1e-5 * srm.theta.abs()
                        && cells.response.iter().all(|&(is, _)| (f64::from(is) - decay).abs() < 1e-5)
                }
                _ => false,
            });
            let Some((node, population)) = same else {
                let message = format!("there is no population '{}' with the neurons of the training file", layer.name);
                return Err(unsupported(graph, &message));
            };
            let first = firsts[node.index()];
            layers.push(Layer { name: population.name.clone(), first, count: population.shape.len() });
        }
        if file.inputs.len() + layers.len() != firsts.len() || nodes.last().copied().flatten() != Some(graph.output()) {
            return Err(unsupported(
                graph,
                "its layers, with the output last, differ from the layers of the training file",
            ));
        }
        let mut places = Vec::new();
        for (_, source, target, projection) in graph.projections() {
            let place = nodes.iter().position(|&node| node == Some(target)).and_then(|layer| {
                let mut offset = 0;
                for &from in &plan.topology.layers[layer].sources {
                    let node = match from {
                        Source::Input(input) => inputs[input],
                        Source::Layer(earlier) => nodes[earlier],
                    };
                    let sources = node.map_or(0, |node| graph.population(node).shape.len() as usize);
                    if node == Some(source) {
                        let first_column = projection.first_source as usize;
                        return Some(ProjectionPlace { layer, offset, sources, first_column });
                    }
                    offset += sources;
                }
                None
            });
            let Some(place) = place else {
                let message = format!("projection {} is not a dense layer of the training file", projection.name);
                return Err(unsupported(graph, &message));
            };
            places.push(place);
        }
        if places.len() != plan.topology.layers.iter().map(|layer| layer.sources.len()).sum::<usize>() {
            return Err(unsupported(graph, "it lacks projections of the training file"));
        }
        Ok(Task { graph: graph.clone(), fits: fits.to_vec(), detail, plan, places, layers })
    }

    /// The weights in the plan's order.
    fn weights(&self) -> Weights {
        let mut all = self.plan.topology.zeros();
        for ((_, _, _, projection), place) in self.graph.projections().zip(&self.places) {
            let ProjectionKind::Dense { weights, .. } = &projection.kind else { continue };
            for (declared, planned) in self.pairs(*place, weights.len()) {
                all[place.layer][planned] = weights.real(declared) as f32;
            }
        }
        all
    }

    /// Indices of each weight of a projection: among all declared with it, and in the plan's layer.
    fn pairs(&self, place: ProjectionPlace, declared: usize) -> impl Iterator<Item = (usize, usize)> {
        let ProjectionPlace { layer, offset, sources, first_column } = place;
        let targets = self.plan.topology.layers[layer].cells.count();
        let columns = declared / targets.max(1);
        (0..targets).flat_map(move |target| {
            let pair = move |source| (target * columns + first_column + source, (offset + source) * targets + target);
            (0..sources).map(pair)
        })
    }

    /// The network with other weights; projections of one declaration share an array.
    pub fn with_weights(&self, weights: &Weights) -> Graph {
        let mut declared: Vec<(Arc<Tensor>, Vec<f64>)> = Vec::new();
        let mut at = Vec::new();
        for ((_, _, _, projection), place) in self.graph.projections().zip(&self.places) {
            let ProjectionKind::Dense { weights: before, .. } = &projection.kind else { continue };
            let index = declared.iter().position(|(tensor, _)| Arc::ptr_eq(tensor, before)).unwrap_or_else(|| {
                declared.push((before.clone(), before.reals().collect()));
                declared.len() - 1
            });
            at.push(index);
            for (entry, planned) in self.pairs(*place, before.len()) {
                declared[index].1[entry] = f64::from(weights[place.layer][planned]);
            }
        }
        let changed: Vec<Arc<Tensor>> = declared
            .into_iter()
            .map(|(before, numbers)| {
                Tensor::new(before.shape().to_vec(), Numbers::Reals(numbers)).map_or(before, Arc::new)
            })
            .collect();
        let mut at = at.into_iter();
        self.graph.with_projections(|_, projection| {
            let mut projection = projection.clone();
            if let ProjectionKind::Dense { weights, .. } = &mut projection.kind
                && let Some(index) = at.next()
            {
                *weights = changed[index].clone();
            }
            projection
        })
    }

    /// The integers of these weights.
    ///
    /// # Errors
    /// As `nsim_quantise::quantise`.
    pub fn integers(&self, weights: &Weights) -> Result<StagedNetwork> {
        StagedNetwork::with_exponents(&self.with_weights(weights), &self.fits, self.detail)
    }

    /// The score of integers on examples.
    fn score(&self, staged: &StagedNetwork, examples: &[Example], step: &(impl Fn() + Sync)) -> TaskScore {
        let output = output_layer(staged.deployed());
        let one = |example: &Example| {
            let trace = staged.run(ComparisonStage::MACHINE, &sample(&example.inputs), false);
            let mut error = vec![0.0; (trace.steps as usize + 1) * output.count as usize];
            let spikes = TrainedTrace { spikes: raster(&trace, &output), ..TrainedTrace::default() };
            let loss = self.plan.loss.evaluate(&spikes, example.label, &mut error);
            step();
            (loss, trace.class(&output) == Some(example.label))
        };
        let each: Vec<(f64, bool)> = examples.par_iter().map(one).collect();
        let all = each.len().max(1) as f64;
        TaskScore {
            accuracy: each.iter().filter(|(_, right)| *right).count() as f64 / all,
            loss: each.iter().map(|(loss, _)| loss).sum::<f64>() / all,
        }
    }

    /// Trains; `shown` is called after each sample, `after` with each new best epoch.
    ///
    /// # Errors
    /// As [`Task::integers`], if weights exceed the range of the integers.
    pub fn run(
        &self,
        examples: &[Example],
        held_out: &[Example],
        epochs: u32,
        shown: &(impl Fn() + Sync),
        mut after: impl FnMut(&BestEpoch),
    ) -> Result<FineTuned> {
        let fingerprint = checkpoint::fingerprint(&self.plan, examples);
        let train: Vec<Example> = examples.iter().map(padded).collect();
        let unseen: Vec<Example> = held_out.iter().map(padded).collect();
        // The rate is that of the training's end; dropout is off, as the integers run whole.
        let mut plan = Plan { epochs, dropout: 0.0, ..self.plan.clone() };
        plan.rates.iter_mut().for_each(|rate| *rate *= self.plan.last_rate);
        let mut state = plan.start_from(self.weights());
        let start = self.integers(&state.weights)?;
        let score = self.score(&start, &train, shown);
        let before = self.score(&start, &unseen, shown);
        let trained = plan.accuracy(&state.weights, held_out);
        let mut best = BestEpoch { weights: state.weights.clone(), epoch: 0, score };
        after(&best);
        let mut rows = vec![FineTuneRow { epoch: 0, score }];
        let integers = IntegerForward { task: self, shown };
        let mut workers = Vec::new();
        while state.epoch < epochs {
            plan.epoch(&integers, &mut state, &train, &mut workers)?;
            let weights = plan.result(&state);
            let score = self.score(&self.integers(weights)?, &train, shown);
            rows.push(FineTuneRow { epoch: state.epoch, score });
            if (score.accuracy, -score.loss) > (best.score.accuracy, -best.score.loss) {
                best = BestEpoch { weights: weights.clone(), epoch: state.epoch, score };
                after(&best);
            }
        }
        let after = self.score(&self.integers(&best.weights)?, &unseen, shown);
        let held_out = (!unseen.is_empty()).then_some(HeldOutScores { samples: unseen.len(), trained, before, after });
        let (weights, kept) = (best.weights, best.epoch);
        Ok(FineTuned { weights, kept, rows, samples: train.len(), held_out, seed: plan.seed, fingerprint })
    }
}

/// The integers as the forward pass of a training.
#[derive(Debug)]
struct IntegerForward<'a, F> {
    task: &'a Task,
    shown: &'a F,
}

impl<F: Fn() + Sync> Forward for IntegerForward<'_, F> {
    type Network = StagedNetwork;
    type Error = Diagnostic;

    fn network(&self, weights: &Weights) -> Result<StagedNetwork> {
        self.task.integers(weights)
    }

    fn run(&self, staged: &StagedNetwork, _: &Deployed, inputs: &[Raster], work: &mut Workspace) {
        let trace = staged.run(ComparisonStage::MACHINE, &sample(inputs), true);
        let each = self.task.layers.iter().zip(&self.task.plan.topology.layers).zip(&mut work.traces);
        for ((layer, trained), kept) in each {
            let theta = trained.cells.theta();
            // Credit of spike response neurons does not depend on the state of a neuron.
            let (potential, spikes) = (potentials(&trace, layer, theta), raster(&trace, layer));
            *kept = TrainedTrace { potential, spikes, ..TrainedTrace::default() };
        }
        (self.shown)();
    }
}

/// The example with an empty step at the end.
fn padded(example: &Example) -> Example {
    let longer = |raster: &Raster| Raster::from_events(raster.units(), raster.steps() + 1, raster.events().collect());
    Example { inputs: example.inputs.iter().map(longer).collect(), label: example.label }
}

/// A sample for the network in integers: all but the last, empty step.
fn sample(inputs: &[Raster]) -> Sample {
    let steps = inputs.first().map_or(0, Raster::steps).saturating_sub(1) as u32;
    let mut first = 0;
    let mut events = Vec::with_capacity(inputs.iter().map(Raster::count).sum());
    for raster in inputs {
        let all = raster.events().filter(|&(step, _)| step < steps);
        events.extend(all.map(|(step, unit)| (step, ChannelId(first + unit))));
        first += raster.units() as u32;
    }
    // All events are in range; a raster counts its events in 32 bits, as a sample does.
    Sample::new(steps, &events, None).unwrap_or_else(|_| Sample::silent(steps))
}

/// A layer's spikes one step later.
fn raster(trace: &Trace, layer: &Layer) -> Raster {
    let trains = trace.trains.iter().skip(layer.first as usize).take(layer.count as usize);
    let events = trains.zip(0..).flat_map(|(train, neuron)| train.iter().map(move |&step| (step + 1, neuron)));
    Raster::from_events(layer.count as usize, trace.steps as usize + 1, events.collect())
}

/// A layer's potentials one step later, `[step][neuron]`, in the trained network's units.
fn potentials(trace: &Trace, layer: &Layer, theta: f32) -> Vec<f32> {
    let (steps, count) = (trace.steps as usize, layer.count as usize);
    let mut out = vec![0.0; (steps + 1) * count];
    let rows = trace.potentials.chunks_exact(steps.max(1)).skip(layer.first as usize).take(count);
    for (neuron, row) in rows.enumerate() {
        for (step, potential) in row.iter().enumerate() {
            out[(step + 1) * count + neuron] = theta * potential;
        }
    }
    out
}
