//! A training, from its file to its result.
//!
//! Input: the text of a training file, labelled samples. Output: [`Trained`], with weights, their
//! score and the digest of their output spikes; and the model with these weights. Errors:
//! `train.*`. Omitted on purpose: studies of many trainings.

use std::path::{Path, PathBuf};
use std::time::Instant;

use crate::fit::{Example, Plan, TrainingState};
use crate::network::Weights;
use crate::plan::plan;
use crate::raster::Raster;
use crate::{checkpoint, export};
use nsim_files::network::{Network, NetworkFile, Parameter, PopulationDesc, ProjectionDesc, ProjectionKind};
use nsim_files::shipped;
use nsim_files::training::TrainingFile;
use nsim_ir::base::diagnostic::{Diagnostic, SourceText};
use nsim_ir::base::folds::stratified_folds;
use nsim_ir::locate;
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::Sample;
use nsim_session::error::Result;
use nsim_session::{Outcome, digest, inputs};

/// The text of a training file, by its path or the name of a shipped one.
///
/// # Errors
/// `io.*`; `train.unknown` for a name that is not shipped.
pub fn training_text(argument: &str) -> Result<SourceText> {
    Ok(shipped::path_or_shipped_text(argument, shipped::TRAININGS, "training file", "train.unknown")?.0)
}

/// The text of a training file with fields replaced, such as `layers.touch.size`.
///
/// # Errors
/// `set.path` when the file has no such field.
pub fn with_fields(source: &SourceText, fields: &[(&str, &str)]) -> Result<SourceText> {
    let text = locate::all_replaced(source.text(), fields).map_err(|(number, problem)| {
        Diagnostic::new("set.path", format!("{}: {problem}", fields[number].0)).in_file(source.path()).help(
            "a path is a field, or the name of an input or layer and its field, such as layers.out.size or epochs",
        )
    })?;
    Ok(SourceText::new(source.path(), text))
}

/// A checked training file.
#[derive(Debug)]
pub struct Job {
    /// Its text.
    pub source: SourceText,
    /// Its fields.
    pub file: TrainingFile,
    /// The plan that results from them.
    pub plan: Plan,
}

/// Purpose of samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// To train on.
    Train,
    /// To score on.
    Test,
}

/// Training and test samples.
#[derive(Debug, Default)]
pub struct Data {
    /// Samples to train on.
    pub train: Vec<Example>,
    /// Samples to score on, never used to choose anything.
    pub test: Vec<Example>,
}

/// File of a training's state, with the fingerprint of the training.
#[derive(Debug, Clone)]
pub struct Checkpoint {
    path: PathBuf,
    fingerprint: String,
}

/// Result of a training.
#[derive(Debug)]
pub struct Trained {
    /// Weights and the history of the epochs.
    pub state: TrainingState,
    /// Fraction of the training samples with the right class, 0..=1.
    pub train_accuracy: f64,
    /// Fraction of the test samples with the right class; none without test samples.
    pub test_accuracy: Option<f64>,
    /// Digest of the output spikes on the test (else training) samples, as `nsim run` computes it.
    pub digest: String,
    /// Accuracy on each fold excluded from the training samples.
    pub folds: Vec<f64>,
    /// Numbers of training and test samples.
    pub samples: (usize, usize),
    /// Seconds of training, without reading samples.
    pub seconds: f64,
}

impl Job {
    /// Reads a training file; `seed` and `epochs` replace the file's.
    ///
    /// # Errors
    /// `train.*` at the field that cannot be used.
    pub fn new(source: SourceText, seed: Option<u64>, epochs: Option<u32>) -> Result<Self> {
        let mut file = TrainingFile::parse(&source)?;
        file.seed = seed.unwrap_or(file.seed);
        file.epochs = epochs.unwrap_or(file.epochs);
        let plan = plan(&file, &source)?;
        Ok(Job { source, file, plan })
    }

    /// A network with the inputs of the training file; samples are read with it as for `nsim run`.
    ///
    /// # Errors
    /// `model.*` for an input that no network can have.
    pub fn inputs(&self) -> Result<Quantised> {
        let (layers, mut model) = ("stand-in-for-the-layers", NetworkFile::new("inputs", 1.0));
        for input in &self.file.inputs {
            model.populations.push(PopulationDesc::input(&input.name, input.shape.clone()));
            let kind = ProjectionKind::Random { fan_out: 1, low: 0, high: 0, seed: 0 };
            model.projections.push(ProjectionDesc::new(&input.name, layers, kind));
        }
        let parameters = ["du", "dv", "vth_mant"].map(|name| (name, Parameter::Same(0.0)));
        model.populations.push(PopulationDesc::loihi(layers, vec![1], parameters.to_vec()));
        model.output = layers.to_string();
        let network = model.build(Path::new("inputs of the training file"))?;
        Ok(nsim_session::front::front(&network)?.into_quantised())
    }

    /// Labelled samples as examples; `what` names them in messages.
    ///
    /// # Errors
    /// `train.label` for a sample without a label, or with one that no output represents.
    pub fn examples(&self, network: &Quantised, samples: &[Sample], what: &str) -> Result<Vec<Example>> {
        let classes = self.plan.topology.classes();
        let wrong = |message: String| Diagnostic::new("train.label", message).in_file(self.source.path());
        let labelled = |(index, sample): (usize, &Sample)| {
            let example = Example::from_sample(network, sample)
                .ok_or_else(|| wrong(format!("{what} sample {index} has no label")))?;
            if example.label as usize >= classes {
                let message = format!("a sample has label {}, the network {classes} outputs", example.label);
                return Err(wrong(message).into());
            }
            Ok(example)
        };
        samples.iter().enumerate().map(labelled).collect()
    }

    /// Samples of the given sources, or of the training file's sources.
    ///
    /// # Errors
    /// As [`Self::examples`]; a source that cannot be read.
    pub fn read(&self, part: Part, given: &[String]) -> Result<Vec<Example>> {
        let (what, named) = match part {
            Part::Train => ("training", &self.file.train),
            Part::Test => ("test", &self.file.test),
        };
        let sources = if given.is_empty() { named } else { given };
        if sources.is_empty() {
            return Ok(Vec::new());
        }
        let network = self.inputs()?;
        self.examples(&network, &inputs::stimulus(&network, sources, None, None)?.samples, what)
    }

    /// Training and test samples.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn data(&self, train: &[String], test: &[String]) -> Result<Data> {
        Ok(Data { train: self.read(Part::Train, train)?, test: self.read(Part::Test, test)? })
    }

    /// Stratified folds of samples from a fixed seed: equal folds for every setting.
    pub fn folds(examples: &[Example], k: u32) -> Vec<Vec<usize>> {
        let labels: Vec<u32> = examples.iter().map(|example| example.label).collect();
        Job::folds_by_label(&labels, k)
    }

    /// Stratified folds, from the labels of samples alone.
    pub fn folds_by_label(labels: &[u32], k: u32) -> Vec<Vec<usize>> {
        stratified_folds(labels, k as usize, FOLD_SEED)
    }

    /// Scores a trained state, and for each fold a training without its samples.
    ///
    /// # Errors
    /// Errors of `each`, which trains on the given samples to the end.
    pub fn trained(
        &self,
        (state, seconds): (TrainingState, f64),
        data: &Data,
        folds: &[Vec<usize>],
        mut each: impl FnMut(&Plan, &[Example]) -> Result<TrainingState>,
    ) -> Result<Trained> {
        let weights = self.plan.result(&state);
        let score = |examples: &[Example]| self.plan.accuracy(weights, examples);
        let test_accuracy = (!data.test.is_empty()).then(|| score(&data.test));
        let seen = if data.test.is_empty() { &data.train } else { &data.test };
        let outcome = |(output, _): &(Raster, _)| Outcome { spikes: output.events().collect(), ..Outcome::default() };
        let outcomes: Vec<Outcome> = self.plan.outputs(weights, seen).iter().map(outcome).collect();
        let mut accuracies = Vec::new();
        for fold in folds {
            accuracies.push(cross_validate(&self.plan, &data.train, fold, &mut each)?.0);
        }
        Ok(Trained {
            train_accuracy: score(&data.train),
            test_accuracy,
            digest: digest(&outcomes),
            folds: accuracies,
            samples: (data.train.len(), data.test.len()),
            seconds,
            state,
        })
    }

    /// The model of trained weights.
    ///
    /// # Errors
    /// `train.export` for neurons that a model file cannot describe.
    pub fn model(&self, weights: &Weights, provenance: &str) -> Result<NetworkFile> {
        Ok(export::model(&self.file, &self.plan.topology, weights, provenance)?)
    }

    /// Writes the model of trained weights to a path, and the weights next to it; returns both
    /// paths. `force` replaces existing files.
    ///
    /// # Errors
    /// As [`Self::model`]; `write.*`.
    pub fn write(
        &self,
        path: &Path,
        force: bool,
        weights: &Weights,
        comment: &str,
        provenance: &str,
    ) -> Result<[PathBuf; 2]> {
        let mut model = self.model(weights, provenance)?;
        // The training file's name is another network's; this one has its file's name.
        model.name = path.file_stem().map_or(model.name, |stem| stem.to_string_lossy().into_owned());
        model.write_under(comment, path, force)?;
        Ok([path.to_path_buf(), weights_path(path)])
    }

    /// The network of trained weights, in memory.
    ///
    /// # Errors
    /// As [`Self::model`]; `model.*`.
    pub fn network(&self, weights: &Weights, provenance: &str) -> Result<Network> {
        let place = format!("{} (in memory)", self.file.name);
        Ok(self.model(weights, provenance)?.build(Path::new(&place))?)
    }
}

/// The path of the weights of a model file.
pub fn weights_path(model: &Path) -> PathBuf {
    model.with_extension("safetensors")
}

const FOLD_SEED: u64 = 0;

/// Trains on all samples except a fold's, and scores on the fold; returns accuracy and weights.
///
/// # Errors
/// Errors of `train`.
pub fn cross_validate(
    plan: &Plan,
    examples: &[Example],
    fold: &[usize],
    mut train: impl FnMut(&Plan, &[Example]) -> Result<TrainingState>,
) -> Result<(f64, Weights)> {
    let part = |tested: bool| {
        let chosen = (0..examples.len()).filter(|index| fold.contains(index) == tested);
        chosen.map(|index| examples[index].clone()).collect::<Vec<_>>()
    };
    let state = train(plan, &part(false))?;
    let weights = plan.result(&state).clone();
    Ok((plan.accuracy(&weights, &part(true)), weights))
}

impl Checkpoint {
    /// The file in which a training of these samples is saved.
    pub fn new(path: &Path, plan: &Plan, examples: &[Example]) -> Self {
        Checkpoint { path: path.to_path_buf(), fingerprint: checkpoint::fingerprint(plan, examples) }
    }

    /// Saves a state.
    ///
    /// # Errors
    /// `write.*`.
    pub fn save(&self, state: &TrainingState) -> Result<()> {
        Ok(checkpoint::save(&self.path, state, &self.fingerprint)?)
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// Trains to the end, from the checkpoint if there is one; returns the state and the seconds taken.
/// `after` receives the state after each epoch.
///
/// # Errors
/// `train.checkpoint` for a file of another training; `write.*` if a state cannot be saved.
pub fn train(
    plan: &Plan,
    examples: &[Example],
    kept: Option<&Checkpoint>,
    mut after: impl FnMut(&TrainingState),
) -> Result<(TrainingState, f64)> {
    let begin = Instant::now();
    let state = kept.map(|kept| checkpoint::load(&kept.path, plan, &kept.fingerprint)).transpose()?.flatten();
    let mut state = state.unwrap_or_else(|| plan.start());
    let mut workers = Vec::new();
    while state.epoch < plan.epochs {
        let Ok(()) = plan.epoch(&plan.topology, &mut state, examples, &mut workers);
        after(&state);
        if let Some(kept) = kept
            && (state.epoch.is_multiple_of(10) || state.epoch == plan.epochs)
        {
            kept.save(&state)?;
        }
    }
    Ok((state, begin.elapsed().as_secs_f64()))
}
