//! The deployed network compared with its counterpart, layer by layer.
//!
//! Input: both networks, samples. Output: spikes and potentials compared per layer, classes
//! compared per sample. Errors: recordings of another number of samples, a program whose sums could
//! leave their integers.

use std::sync::Arc;

use rayon::prelude::*;

use super::classes::ClassTally;
use super::staged::{StagedNetwork, layer, layers};
use super::trace::{Comparison, Layer, Trace, measured_shift};
use nsim_dynamics::{model_thresholds, thresholds};
use nsim_golden::Golden;
use nsim_import::spikes::PopulationSpikes;
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::id::CompartmentId;
use nsim_ir::graph::Graph;
use nsim_ir::program::Program;
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::{Engine, Sample};
use nsim_machine::{Image, Machine, Settings};
use nsim_quantise::analytic::{self, Fit};
use nsim_reference::{Model, Options, Reference};
use nsim_session::samples::Progress;

/// Network or recording to compare with the deployed network.
#[derive(Debug)]
pub enum Counterpart {
    /// Spike response neurons, as they were trained.
    Srm,
    /// Current-based neurons in real numbers.
    Cuba,
    /// The golden interpreter of the same integers.
    Golden,
    /// Recorded spikes: the samples of each recorded population.
    Recorded(Vec<(Layer, Vec<PopulationSpikes>)>),
}

impl Counterpart {
    /// Printed name.
    pub fn name(&self) -> &'static str {
        match self {
            Counterpart::Srm => "srm",
            Counterpart::Cuba => "cuba",
            Counterpart::Golden => "golden",
            Counterpart::Recorded(_) => "recorded spikes",
        }
    }

    /// Whether its disagreement can be attributed to causes: it is in real numbers.
    pub fn is_real(&self) -> bool {
        matches!(self, Counterpart::Srm | Counterpart::Cuba)
    }
}

/// A network, its deployed form, and the samples for both.
#[derive(Debug, Clone, Copy)]
pub struct DeployedNetwork<'a> {
    /// The network in real numbers.
    pub graph: &'a Graph,
    /// The converted form of each spike response population.
    pub fits: &'a [Option<Fit>],
    /// Comparison stages from real numbers to integers.
    pub staged: &'a StagedNetwork,
    /// Program of the mapped integer network.
    pub program: &'a Arc<Program>,
    /// Samples, in run order.
    pub samples: &'a [&'a Sample],
    /// Number of steps to compare in each sample; all when `None`.
    pub steps: Option<u32>,
}

/// A layer of the two networks.
#[derive(Debug, Clone, PartialEq)]
pub struct LayerRow {
    /// The population.
    pub name: String,
    /// Steps by which the deployed network answers later; negative, earlier.
    pub shift: i32,
    /// Comparison of the layer.
    pub comparison: Comparison,
}

/// Agreement of a deployed network with its counterpart.
#[derive(Debug)]
pub struct Agreement {
    /// Row of each layer.
    pub layers: Vec<LayerRow>,
    /// Classes of the two; `None` when the output is not compared.
    pub classes: Option<ClassTally>,
    /// Share of right classes of counterpart and deployed network, when samples have labels.
    pub accuracy: Option<(f64, f64)>,
}

/// Samples that are run and compared in one batch: bounds the traces in memory.
const BATCH: usize = 64;

/// The output population as a layer.
pub fn output_layer(network: &Quantised) -> Layer {
    layer(&network.populations()[network.parts().output]).unwrap_or_default()
}

/// An engine's potential as a share of the threshold.
fn relative<E: Engine>(engine: &E, compartment: CompartmentId, thresholds: &[f64]) -> f64 {
    f64::from(engine.v(compartment)) / thresholds[compartment.0 as usize]
}

/// Recorded spikes of one sample as a trace, up to the shortest recording.
fn recorded_trace(
    recorded: &[(Layer, Vec<PopulationSpikes>)],
    index: usize,
    sample: &Sample,
    compartments: u32,
) -> Trace {
    let trains = vec![Vec::new(); compartments as usize];
    let mut trace = Trace { steps: sample.steps(), trains, ..Trace::default() };
    for (layer, samples) in recorded {
        trace.steps = trace.steps.min(samples[index].steps);
        let mut events = samples[index].events.clone();
        events.sort_unstable();
        events.dedup();
        let spikes = events.into_iter().filter(|event| event.1 < layer.count);
        spikes.for_each(|(step, neuron)| trace.trains[(layer.first + neuron) as usize].push(step));
    }
    trace
}

/// Returns a function from a sample to the trace in real numbers, potentials in thresholds.
///
/// # Errors
/// `model.no-real-form`.
pub fn real_trace(graph: &Graph, integers: &Quantised) -> Result<impl Fn(&Sample) -> Trace + Sync + use<>> {
    let recorded = (integers.compartments(), integers.output());
    let (model, thresholds) = (Model::<f64>::new(graph, Options::default())?, model_thresholds(graph));
    Ok(move |sample: &Sample| {
        let mut engine = Reference::new(&model);
        Trace::record(&mut engine, sample, recorded, |engine, c| engine.potential(c) / thresholds[c.0 as usize])
    })
}

/// Returns a function from a sample to the trace of a mapped network.
fn machine_trace<'a>(
    network: &Quantised,
    program: &'a Arc<Program>,
) -> Result<impl Fn(&Sample) -> Trace + Sync + use<'a>> {
    let image = Image::new(program, 1).map_err(|error| Diagnostic::new("run.too-large", error.to_string()))?;
    let (thresholds, recorded) = (thresholds(network), (network.compartments(), network.output()));
    Ok(move |sample: &Sample| {
        let mut machine = Machine::new(&image, Settings { skip: true, per_step: false });
        Trace::record(&mut machine, sample, recorded, |m, c| relative(m, c, &thresholds))
    })
}

/// Compares a network with a second, mapped one. The first runs as it was trained, or on its own
/// cores where `mapped` is its program. Their populations of compartments have the same names and
/// sizes, in any order. The shift of each layer is measured on the first samples.
///
/// # Errors
/// `agree.populations` when the second lacks a population of the first or has it in another size;
/// as [`real_trace`]; `run.too-large`.
pub fn compare_models(
    (graph, integers, mapped): (&Graph, &Quantised, Option<&Arc<Program>>),
    (other, program): (&Quantised, &Arc<Program>),
    samples: &[&Sample],
    steps: Option<u32>,
    progress: Progress<'_>,
) -> Result<Agreement> {
    let trained = real_trace(graph, integers)?;
    let machine = mapped.map(|program| machine_trace(integers, program)).transpose()?;
    let trace = machine_trace(other, program)?;
    let (own, others) = (layers(integers), layers(other));
    let mut pairs = Vec::new();
    for layer in &own {
        let other = others.iter().find(|other| other.name == layer.name && other.count == layer.count);
        pairs.push((
            layer,
            other.ok_or_else(|| {
                let message = format!("the second network has no population '{}' of size {}", layer.name, layer.count);
                Diagnostic::new("agree.populations", message).help("compare networks with equal layers")
            })?,
        ));
    }
    let both = |_, sample: &Sample| {
        let first = machine.as_ref().map_or_else(|| trained(sample), |machine| machine(sample));
        (first, placed(trace(sample), &pairs))
    };
    Ok(agreement(own.clone(), &output_layer(integers), samples, steps, &both, &measured_shift, progress))
}

/// The trace of the second of two networks with its compartments in the places of the first's.
/// `pairs` has each layer in both.
fn placed(trace: Trace, pairs: &[(&Layer, &Layer)]) -> Trace {
    let all = pairs.iter().map(|(layer, _)| layer.first + layer.count).max().unwrap_or(0) as usize;
    let row = trace.steps as usize;
    let mut trains = vec![Vec::new(); all];
    let mut potentials = vec![0.0; if trace.potentials.is_empty() { 0 } else { all * row }];
    for (target, source) in pairs {
        for i in 0..target.count {
            let (to, from) = ((target.first + i) as usize, (source.first + i) as usize);
            trains[to].clone_from(&trace.trains[from]);
            if !potentials.is_empty() {
                potentials[to * row..][..row].copy_from_slice(&trace.potentials[from * row..][..row]);
            }
        }
    }
    Trace { trains, potentials, ..trace }
}

/// The shift of a layer, from the first traces.
type ShiftOf<'a> = &'a dyn Fn(&Layer, &[(&Trace, &Trace)]) -> i32;

/// Compares the two traces that `both` returns for the number of a sample and the sample, up to
/// `steps` steps.
fn agreement(
    layers: Vec<Layer>,
    output: &Layer,
    samples: &[&Sample],
    steps: Option<u32>,
    both: &(dyn Fn(usize, &Sample) -> (Trace, Trace) + Sync),
    shift: ShiftOf<'_>,
    progress: Progress<'_>,
) -> Agreement {
    let limit = steps.unwrap_or(u32::MAX);
    let mut comparisons: Vec<(Comparison, i32)> = Vec::new();
    let (mut classes, mut right) = (ClassTally::default(), (0usize, 0usize));
    for (batch, some) in samples.chunks(BATCH).enumerate() {
        let first = batch * BATCH;
        let traces = some.par_iter().enumerate().map(|(i, sample)| {
            let (a, b) = both(first + i, sample);
            progress();
            (a.until(limit), b.until(limit))
        });
        let traces: Vec<(Trace, Trace)> = traces.collect();
        if comparisons.is_empty() {
            let pairs: Vec<(&Trace, &Trace)> = traces.iter().map(|(a, b)| (a, b)).collect();
            comparisons = layers.iter().map(|layer| (Comparison::default(), shift(layer, &pairs))).collect();
        }
        for (i, ((a, b), sample)) in traces.iter().zip(some).enumerate() {
            for (layer, (comparison, shift)) in layers.iter().zip(&mut comparisons) {
                comparison.add(first + i, layer, a, b, *shift);
            }
            let (class_a, class_b) = (a.class(output), b.class(output));
            classes.add(class_a, class_b);
            right.0 += usize::from(class_a == sample.label());
            right.1 += usize::from(class_b == sample.label());
        }
    }
    let known = layers.contains(output);
    let labelled = known && samples.iter().all(|sample| sample.label().is_some());
    let all = samples.len().max(1) as f64;
    let rows = layers.into_iter().zip(comparisons);
    Agreement {
        layers: rows.map(|(layer, (comparison, shift))| LayerRow { name: layer.name, shift, comparison }).collect(),
        classes: known.then_some(classes),
        accuracy: labelled.then(|| (right.0 as f64 / all, right.1 as f64 / all)),
    }
}

/// The trace of a sample by its number.
type TraceOf<'a> = Box<dyn Fn(usize, &Sample) -> Trace + Sync + 'a>;

/// Runs both networks on all samples and compares them.
///
/// # Errors
/// `agree.samples` when a recording has another number of samples; `run.too-large`.
pub fn compare(deployed: DeployedNetwork<'_>, counterpart: &Counterpart, progress: Progress<'_>) -> Result<Agreement> {
    let DeployedNetwork { graph, fits, staged, program, samples, steps } = deployed;
    let network = staged.deployed();
    let machine = machine_trace(network, program)?;
    let (thresholds, recorded_of) = (thresholds(network), (network.compartments(), network.output()));
    let counterpart_trace: TraceOf<'_> = match counterpart {
        Counterpart::Srm => {
            let trace = real_trace(graph, network)?;
            Box::new(move |_, sample| trace(sample))
        }
        Counterpart::Cuba => {
            let trace = real_trace(&analytic::with_fits(graph, fits), network)?;
            Box::new(move |_, sample| trace(sample))
        }
        Counterpart::Golden => Box::new(|_, sample| {
            Trace::record(&mut Golden::new(network), sample, recorded_of, |g, c| relative(g, c, &thresholds))
        }),
        Counterpart::Recorded(recorded) => {
            if let Some((layer, spikes)) = recorded.iter().find(|(_, spikes)| spikes.len() != samples.len()) {
                let (name, count) = (&layer.name, spikes.len());
                let message = format!("'{name}' was recorded in {count} samples, but the input has {}", samples.len());
                return Err(Diagnostic::new("agree.samples", message).help("choose samples with --samples"));
            }
            Box::new(|index, sample| recorded_trace(recorded, index, sample, network.compartments()))
        }
    };
    let compared = match counterpart {
        Counterpart::Recorded(recorded) => recorded.iter().map(|(layer, _)| layer.clone()).collect(),
        _ => layers(network),
    };
    let both = |index, sample: &Sample| (counterpart_trace(index, sample), machine(sample));
    let shift = |layer: &Layer, pairs: &[(&Trace, &Trace)]| match counterpart {
        Counterpart::Srm => -1,
        Counterpart::Cuba | Counterpart::Golden => 0,
        Counterpart::Recorded(_) => measured_shift(layer, pairs),
    };
    Ok(agreement(compared, &output_layer(network), samples, steps, &both, &shift, progress))
}
