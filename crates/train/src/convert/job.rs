//! A conversion from a network to integers that can be stored, with samples for the search and
//! others to judge the result.
//!
//! Input: a network with real numbers, its target, samples. Output: [`Converted`] with its
//! measures, fine-tuned if requested; the model of the integers, and a sentence on their origin.
//! Errors: `convert.*`, `train.label`.

use std::sync::Arc;
use std::time::Instant;

use crate::convert::fine_tune::{BestEpoch, Task, TunedIntegers};
use crate::convert::staged::{self, Converted, MeasuredDistance};
use crate::convert::{model_file, resets};
use crate::fit::Example;
use crate::plan::plan;
use nsim_compile::refuse_large;
use nsim_files::network::{Network, NetworkFile};
use nsim_files::text::sha256;
use nsim_files::training::TrainingFile;
use nsim_ir::base::diagnostic::{Diagnostic, SourceText};
use nsim_ir::graph::Graph;
use nsim_ir::hardware::Target;
use nsim_ir::neurons::NeuronKind;
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::{Sample, Stimulus};
use nsim_session::error::Result;
use nsim_session::front::real_and_integers;
use nsim_session::inputs;

/// A network whose real numbers become integers.
#[derive(Debug)]
pub struct Job {
    /// The network as it was trained.
    pub graph: Graph,
    /// The integers of the analytic start.
    pub integers: Quantised,
    /// SHA-256 of the text of the model file.
    pub hash: String,
    soft_reset: bool,
}

/// Samples for the search, and samples that judge its integers.
#[derive(Debug)]
pub struct SampleSplit<'s> {
    /// Sources of the calibration samples.
    pub origin: &'s [String],
    /// Samples for the search.
    pub calibration: Vec<&'s Sample>,
    /// Samples that judge the result.
    pub held_out: Vec<&'s Sample>,
}

impl<'s> SampleSplit<'s> {
    /// Splits samples: without others for the search (`apart`), it takes the first half of `shown`.
    pub fn new(origin: &'s [String], shown: &[&'s Sample], apart: Option<&'s Stimulus>, wanted: usize) -> Self {
        match apart {
            Some(apart) => SampleSplit {
                origin: &apart.origin,
                calibration: apart.samples.iter().take(wanted).collect(),
                held_out: shown.to_vec(),
            },
            None => {
                let half = shown.len().div_ceil(2).min(wanted);
                SampleSplit { origin, calibration: shown[..half].to_vec(), held_out: shown[half..].to_vec() }
            }
        }
    }
}

/// Converted integers and their distances.
#[derive(Debug)]
pub struct ConversionRun {
    /// The conversion, by stages.
    pub converted: Converted,
    /// Measures on samples that no stage used; none without such samples.
    pub held_out: Option<MeasuredDistance>,
    /// Seconds of the search.
    pub seconds: f64,
}

/// The distance of integers in words.
pub fn distance_text(measured: &MeasuredDistance) -> String {
    let layers = measured.layers.iter().map(|(name, coincidence, _)| match coincidence {
        Some(coincidence) => format!("{name} {coincidence:.3}"),
        None => format!("{name} silent"),
    });
    let layers: Vec<String> = layers.collect();
    let classes = measured
        .distance
        .class_agreement
        .map_or("no class is compared".to_string(), |share| format!("classes agree in {share:.4}"));
    format!("{classes}, coincidence {}", layers.join(", "))
}

impl Job {
    /// A network to convert for a target; without resets by subtraction they become resets to zero.
    ///
    /// # Errors
    /// `convert.integers` if there is nothing to convert; `model.*`.
    pub fn new(network: &Network, target: &Target) -> Result<Self> {
        let (graph, integers) = real_and_integers(network)?;
        graph.refuse_rules("cannot be converted")?;
        let soft_reset = target.chip().neuron_kinds.contains(&NeuronKind::SoftReset.family());
        if !staged::is_real(&graph) && (soft_reset || !resets::has_soft_reset(&graph)) {
            let message = format!("{} has no real numbers to convert", graph.facts().name);
            return Err(Diagnostic::new("convert.integers", message).help("run it unchanged").into());
        }
        refuse_large("nsim convert", &integers, 1)?;
        Ok(Job { graph, integers, hash: sha256(network.source().text().as_bytes()), soft_reset })
    }

    /// Whether the network has resets by subtraction that the target lacks.
    pub fn resets_are_replaced(&self) -> bool {
        !self.soft_reset && resets::has_soft_reset(&self.graph)
    }

    /// Searches for integers; `searching` receives the name of each population.
    ///
    /// # Errors
    /// As `nsim_quantise::quantise`.
    pub fn convert(
        &self,
        samples: &SampleSplit<'_>,
        most_taps: usize,
        searching: impl FnMut(&str),
    ) -> Result<ConversionRun> {
        let choices = staged::ConversionLimits { most_taps, soft_reset: self.soft_reset };
        let start = Instant::now();
        let converted = staged::convert(&self.graph, &samples.calibration, choices, searching)?;
        let seconds = start.elapsed().as_secs_f64();
        let held_out = (!samples.held_out.is_empty()).then(|| converted.measure(&converted.staged, &samples.held_out));
        Ok(ConversionRun { converted, held_out, seconds })
    }

    /// The origin of the integers for their model file; `model` is the network's file or name.
    pub fn provenance(&self, model: &str, samples: &SampleSplit<'_>, done: &ConversionRun) -> String {
        let ConversionRun { converted, held_out, .. } = done;
        let stages: Vec<&str> = converted.stages.iter().filter(|row| row.kept).map(|row| row.name.as_str()).collect();
        let mut provenance = format!(
            "nsim convert {model}; SHA-256 of its text {}; {} calibration samples of {}; stages: {}; on these {}",
            self.hash,
            converted.calibration.samples,
            samples.origin.join(" "),
            stages.join(", "),
            distance_text(&converted.calibration)
        );
        if let Some(held) = held_out {
            provenance += &format!("; on {} held-out samples {}", held.samples, distance_text(held));
        }
        if let Some(before) = &self.graph.facts().provenance {
            provenance += &format!("; converted from: {before}");
        }
        provenance
    }

    /// The model of the integers, or of the fine-tuned ones if there are any.
    ///
    /// # Errors
    /// `convert.*` for integers that a model file cannot have.
    pub fn model(&self, done: &ConversionRun, tuned: Option<&TunedIntegers>, provenance: &str) -> Result<NetworkFile> {
        let (integers, provenance) = match tuned {
            Some(tuned) => (tuned.integers.deployed(), format!("{provenance}; {}", tuned.provenance_text())),
            None => (&done.converted.network, provenance.to_string()),
        };
        Ok(model_file::model(&self.graph, integers, provenance)?)
    }
}

/// Continued training with the integers in the forward pass.
#[derive(Debug)]
pub struct FineTuning {
    /// The network to train, its integers and its plan.
    pub task: Arc<Task>,
    epochs: u32,
    origin: Vec<String>,
    examples: Vec<Example>,
    unseen: Vec<Example>,
}

impl FineTuning {
    /// Fine-tuning as a training file says, on the samples of `sources`, by default the file's.
    ///
    /// # Errors
    /// `convert.fine-tune` for a file of another network, `train.sources` without samples,
    /// `train.label`.
    pub fn new(
        job: &Job,
        converted: &Converted,
        training: &SourceText,
        sources: &[String],
        held_out: &[&Sample],
        epochs: u32,
    ) -> Result<Self> {
        let file = TrainingFile::parse(training)?;
        let fits = (converted.fits.as_slice(), converted.detail);
        let task = Task::new(&job.graph, fits, &file, plan(&file, training)?)?;
        let sources = if sources.is_empty() { &file.train } else { sources };
        if sources.is_empty() {
            let message = "the training file names no training samples";
            return Err(Diagnostic::new("train.sources", message).help("add --train SOURCE").into());
        }
        let stimulus = inputs::stimulus(&job.integers, sources, None, None)?;
        let classes = file.layers.last().map_or(0, |layer| layer.size);
        let labelled =
            |sample: &Sample| Example::from_sample(&job.integers, sample).filter(|example| example.label < classes);
        let example = |(index, sample): (usize, &Sample)| {
            labelled(sample).ok_or_else(|| {
                let message = format!("training sample {index} has no label of the network's {classes} outputs");
                Diagnostic::new("train.label", message)
            })
        };
        let examples = stimulus.samples.iter().enumerate().map(example).collect::<Result<Vec<_>, _>>()?;
        let unseen = held_out.iter().filter_map(|sample| labelled(sample)).collect();
        Ok(FineTuning { task: Arc::new(task), epochs, origin: stimulus.origin, examples, unseen })
    }

    /// Number of samples to run, for a progress bar.
    pub fn work(&self) -> u64 {
        let (all, held_out) = (self.examples.len() as u64, self.unseen.len() as u64);
        all + 2 * u64::from(self.epochs) * all + 2 * held_out
    }

    /// Trains; `shown` is called after each sample, `after` with each new best epoch.
    ///
    /// # Errors
    /// As [`Task::integers`].
    pub fn run(
        self,
        converted: &Converted,
        held_out: &[&Sample],
        shown: &(impl Fn() + Sync),
        after: impl FnMut(&BestEpoch),
    ) -> Result<TunedIntegers> {
        let FineTuning { task, epochs, origin, examples, unseen } = self;
        let tuned = task.run(&examples, &unseen, epochs, shown, after)?;
        let integers = task.integers(&tuned.weights)?;
        let held_out = (!held_out.is_empty()).then(|| converted.measure(&integers, held_out));
        Ok(TunedIntegers { tuned, epochs, integers, samples: origin, held_out })
    }
}
