//! `nsim train`: trains a network, or studies how well one trains over seeds, folds and settings.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use serde_json::Value;

use crate::base::diagnostic::{Diagnostic, SourceText};
use crate::base::folds::stratified_folds;
use crate::cli::args::values::SampleRange;
use crate::cli::context::{Answer, Context};
use crate::cli::output;
use crate::cli::process::signals;
use crate::compile;
use crate::desc::training::TrainingFile;
use crate::drive::inputs;
use crate::drive::{Outcome, digest};
use crate::error::{Error, Result};
use crate::io;
use crate::io::shipped::Origin;
use crate::ir::quantised::Quantised;
use crate::report::train::{StudyReport, StudyRun, TrainReport, history_csv};
use crate::train::checkpoint;
use crate::train::export;
use crate::train::fit::{Example, Plan, TrainingState};
use crate::train::network::Weights;
use crate::train::plan::plan;
use crate::train::raster::Raster;
use crate::train::text::with_field;

const EXAMPLES: &str = "\
EXAMPLES:
  nsim train models/train/vtsnn-slip.ron -o my-slip.ron    train the slip network on synthetic scenes
  nsim train models/train/container-tactile.ron --train ev-containers/train --test ev-containers/test -o m.ron
  nsim train c.ron --folds 5 --log history.csv             with the accuracy of a cross-validation
  nsim train c.ron --epochs 500 --checkpoint state.safetensors -o m.ron    resumes an interrupted training
  nsim train c.ron --study runs --seeds 1..6 --folds 5 --set weight_decay=0 --set weight_decay=0.01
                                                           every combination; runs already in the folder are kept";

/// Train a network with SLAYER: spikes in, a model file out
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A training file
    #[arg(value_name = "CONFIG.ron")]
    config: PathBuf,
    /// Training samples, as `nsim run --input` takes them [default: what the training file names]
    #[arg(long, value_name = "SOURCE")]
    train: Vec<String>,
    /// Test samples, never used to choose anything [default: what the training file names]
    #[arg(long, value_name = "SOURCE")]
    test: Vec<String>,
    /// Write the model here, its weights beside it as NAME.safetensors
    #[arg(short, long, value_name = "MODEL.ron")]
    output: Option<PathBuf>,
    /// Seed, instead of the training file's
    #[arg(long)]
    seed: Option<u64>,
    /// Epochs, instead of the training file's
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=1_000_000))]
    epochs: Option<u32>,
    /// Also cross-validate with K stratified folds
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(2..=100))]
    folds: Option<u32>,
    /// Override a field of the training file; with --study a field may have several values
    #[arg(long, value_name = "FIELD=VALUE")]
    set: Vec<String>,
    /// Write loss and accuracy of each epoch here, as CSV
    #[arg(long, value_name = "FILE.csv")]
    log: Option<PathBuf>,
    /// Save the state here every tenth epoch and on Ctrl-C, and resume from it if the file exists
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// Train every combination of --seeds, --folds and --set, save each result in this folder, and resume an interrupted
    /// study
    #[arg(long, value_name = "DIR", conflicts_with_all = ["output", "log", "checkpoint", "seed"])]
    study: Option<PathBuf>,
    /// Seeds of a study
    #[arg(long, value_name = "A..B", requires = "study", default_value = "1..6")]
    seeds: SampleRange,
}

/// A training file, checked.
struct Job {
    file: TrainingFile,
    plan: Plan,
}

fn job(source: &SourceText, args: &Args) -> Result<Job> {
    let mut file = TrainingFile::parse(source)?;
    file.seed = args.seed.unwrap_or(file.seed);
    file.epochs = args.epochs.unwrap_or(file.epochs);
    let plan = plan(&file, source)?;
    Ok(Job { file, plan })
}

/// The text of the training file with fields replaced.
fn with_fields(source: &SourceText, fields: &[(&str, &str)]) -> Result<SourceText> {
    let mut text = source.text().to_string();
    for (key, value) in fields {
        let changed = with_field(&text, key, value);
        text = changed.ok_or_else(|| Error::Usage(format!("--set {key}: the training file is no Training(..)")))?;
    }
    Ok(SourceText::new(source.path(), text))
}

/// A network with the inputs of the training file, by which sources are read as for `nsim run`.
fn stand_in(file: &TrainingFile) -> Result<Quantised> {
    let mut text = String::from("Network(name: \"inputs\", timestep_ms: 1.0, populations: [");
    for input in &file.inputs {
        text += &format!("Input(name: {:?}, shape: {:?}),", input.name, input.shape);
    }
    text += "Loihi(name: \"stand-in-for-the-layers\", shape: [1], du: 0, dv: 0, vth_mant: 0)], projections: [";
    for input in &file.inputs {
        text += &format!(
            "Random(from: [{:?}], to: \"stand-in-for-the-layers\", fan_out: 1, low: 0, high: 0, seed: 0),",
            input.name
        );
    }
    text += "], output: \"stand-in-for-the-layers\")";
    let network = io::model::network(SourceText::new("inputs of the training file", text), Origin::File)?;
    Ok(compile::front(&network)?.into_quantised())
}

/// Labelled samples of the given sources, or of those that the training file names.
fn examples(
    network: &Quantised,
    given: &[String],
    named: &[String],
    (what, classes): (&str, usize),
    config: &Path,
) -> Result<Vec<Example>> {
    let sources = if given.is_empty() { named } else { given };
    if sources.is_empty() {
        return Ok(Vec::new());
    }
    let stimulus = inputs::stimulus(network, sources, None, None)?;
    let mut examples = Vec::with_capacity(stimulus.samples.len());
    for (index, sample) in stimulus.samples.iter().enumerate() {
        let wrong = |message: String| Diagnostic::new("train.label", message).in_file(config);
        let example = Example::from_sample(network, sample)
            .ok_or_else(|| wrong(format!("{what} sample {index} has no label")))?;
        if example.label as usize >= classes {
            return Err(wrong(format!("a sample has label {}, the network {classes} outputs", example.label)).into());
        }
        examples.push(example);
    }
    Ok(examples)
}

/// The training samples of a file, and its number of classes.
///
/// # Errors
/// As those of a training.
#[cfg(feature = "ann")]
pub(in crate::cli) fn labelled(file: &TrainingFile, source: &SourceText) -> Result<(Vec<Example>, usize)> {
    let classes = plan(file, source)?.topology.classes();
    let samples = examples(&stand_in(file)?, &[], &file.train, ("training", classes), source.path())?;
    if samples.is_empty() {
        return Err(Diagnostic::new("train.sources", "it names no samples to train on").in_file(source.path()).into());
    }
    Ok((samples, classes))
}

/// Training and test samples.
struct Data {
    train: Vec<Example>,
    test: Vec<Example>,
}

fn data(file: &TrainingFile, classes: usize, args: &Args) -> Result<Data> {
    let network = stand_in(file)?;
    let train = examples(&network, &args.train, &file.train, ("training", classes), &args.config)?;
    let test = examples(&network, &args.test, &file.test, ("test", classes), &args.config)?;
    if train.is_empty() {
        return Err(Error::Usage("there are no training samples: add --train SOURCE".to_string()));
    }
    Ok(Data { train, test })
}

/// Keeps the last finished epoch of a training that a signal ends.
fn keep(finished: &Mutex<Option<TrainingState>>, path: &Path, print: &str, epochs: u32) -> Option<String> {
    let state = finished.lock().ok()?.take()?;
    Some(match checkpoint::save(path, &state, print) {
        Ok(()) => format!(
            "{} of {epochs} epochs are kept in {}, and the same command goes on from there",
            state.epoch,
            path.display()
        ),
        Err(error) => format!("epoch {} could not be kept: {error}", state.epoch),
    })
}

/// Trains to the end, from the checkpoint when there is one.
fn train(plan: &Plan, examples: &[Example], kept: Option<&Path>, context: Context) -> Result<TrainingState> {
    let of = kept.map(|path| (path, checkpoint::fingerprint(plan, examples)));
    let state = of.as_ref().map(|(path, print)| checkpoint::load(path, plan, print)).transpose()?.flatten();
    let mut state = state.unwrap_or_else(|| plan.start());
    let bar = output::progress(context, u64::from(plan.epochs), "epochs");
    let mut failed = Ok(());
    let finished = Arc::new(Mutex::new(None));
    let _ending = of.as_ref().map(|(path, print)| {
        let (finished, path, print, epochs) = (Arc::clone(&finished), path.to_path_buf(), print.clone(), plan.epochs);
        signals::at_end(move || keep(&finished, &path, &print, epochs))
    });
    plan.run(&mut state, examples, |state| {
        bar.set_position(u64::from(state.epoch));
        if of.is_some()
            && let Ok(mut finished) = finished.lock()
        {
            *finished = Some(state.clone());
        }
        if let Some((path, print)) = &of
            && (state.epoch.is_multiple_of(10) || state.epoch == plan.epochs)
        {
            failed = checkpoint::save(path, state, print);
        }
        failed.is_ok()
    });
    bar.finish_and_clear();
    failed?;
    Ok(state)
}

/// Trains on all samples but those of a fold, and scores on them.
fn cross_validate(plan: &Plan, examples: &[Example], fold: &[usize], context: Context) -> Result<(f64, Weights)> {
    let part = |tested: bool| {
        let chosen = (0..examples.len()).filter(|index| fold.contains(index) == tested);
        chosen.map(|index| examples[index].clone()).collect::<Vec<_>>()
    };
    let state = train(plan, &part(false), None, context)?;
    let weights = plan.result(&state).clone();
    Ok((plan.score(&weights, &part(true)).accuracy, weights))
}

/// Folds are drawn from a fixed seed, so that every setting is tried on the same ones.
const FOLD_SEED: u64 = 0;

/// So many folds of these samples.
pub(in crate::cli) fn folds_of(examples: &[Example], k: u32) -> Vec<Vec<usize>> {
    let labels: Vec<u32> = examples.iter().map(|example| example.label).collect();
    stratified_folds(&labels, k as usize, FOLD_SEED)
}

fn folds(args: &Args, examples: &[Example]) -> Vec<Vec<usize>> {
    args.folds.map_or_else(Vec::new, |k| folds_of(examples, k))
}

/// Output spikes as a run shows them.
fn outcome(output: &Raster) -> Outcome {
    Outcome { spikes: output.events().collect(), ..Outcome::default() }
}

fn weights_path(model: &Path) -> PathBuf {
    model.with_extension("safetensors")
}

/// Writes a model file and its weights beside it.
fn write_model(
    path: &Path,
    force: bool,
    file: &TrainingFile,
    plan: &Plan,
    weights: &Weights,
    comment: &str,
    provenance: &str,
) -> Result<()> {
    let beside = weights_path(path);
    let name = beside.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let model = export::model(file, &plan.topology, weights, &name, comment, provenance)?;
    let mut files = io::write::Batch::new(force);
    files.add(&beside, |out| out.write_all(&model.weights))?;
    files.add(path, |out| out.write_all(model.ron.as_bytes()))?;
    Ok(files.commit()?)
}

/// Runs the command.
///
/// # Errors
/// [`Error`] when the training file or a source cannot be used.
pub fn run(args: &Args, context: Context) -> Result<Answer> {
    let source = io::text::read_text(&args.config)?;
    let fields = args
        .set
        .iter()
        .map(|text| text.split_once('=').ok_or_else(|| Error::Usage(format!("--set {text}: write FIELD=VALUE"))));
    let fields = fields.collect::<Result<Vec<_>, _>>()?;
    if let Some(folder) = &args.study {
        return study(args, &source, &fields, folder, context);
    }
    let source = with_fields(&source, &fields)?;
    let job = job(&source, args)?;
    let weights = args.output.as_deref().map(weights_path);
    if args.output.as_deref().is_some_and(io::text::is_standard_stream) {
        return Err(Error::Usage("-o -: a trained model has weights, which need a file beside it".to_string()));
    }
    let taken = output::check_files(args.output.iter().chain(&weights).chain(&args.log), None, context)?;
    let data = data(&job.file, job.plan.topology.classes(), args)?;
    let begin = Instant::now();
    let state = train(&job.plan, &data.train, args.checkpoint.as_deref(), context)?;
    let seconds = begin.elapsed().as_secs_f64();
    let weights = job.plan.result(&state);
    let score = |examples: &[Example]| job.plan.score(weights, examples).accuracy;
    let (train_accuracy, test_accuracy) = (score(&data.train), (!data.test.is_empty()).then(|| score(&data.test)));
    let seen = if data.test.is_empty() { &data.train } else { &data.test };
    let outcomes: Vec<Outcome> = job.plan.outputs(weights, seen).iter().map(outcome).collect();
    let mut fold_accuracies = Vec::new();
    for fold in folds(args, &data.train) {
        fold_accuracies.push(cross_validate(&job.plan, &data.train, &fold, context)?.0);
    }
    let report = TrainReport {
        name: &job.file.name,
        epochs: state.epoch,
        seed: job.plan.seed,
        seconds,
        samples: (data.train.len(), data.test.len()),
        train_accuracy,
        test_accuracy,
        folds: &fold_accuracies,
        model: args.output.as_deref(),
        loss: state.history.last().map(|row| row.loss),
        digest: &digest(&outcomes),
    };
    if let Some(path) = &args.log {
        io::write::text(path, context.force, &history_csv(&state.history))?;
    }
    if let Some(path) = &args.output {
        let (comment, provenance) = (report.provenance(&source, &args.set), report.summary());
        write_model(path, context.force, &job.file, &job.plan, weights, &comment, &provenance)?;
    }
    if !taken {
        output::print(context.format, || report.text(), || report.json(), || report.csv())?;
    }
    Ok(Answer::Yes)
}

/// Every combination of the values that fields are given.
fn combinations<'a>(fields: &[(&'a str, &'a str)]) -> Vec<Vec<(&'a str, &'a str)>> {
    let mut keys: Vec<&str> = Vec::new();
    for (key, _) in fields {
        if !keys.contains(key) {
            keys.push(key);
        }
    }
    let mut all = vec![Vec::new()];
    for key in keys {
        let values: Vec<_> = fields.iter().filter(|field| field.0 == key).collect();
        let with = |combination: &Vec<_>| {
            values.iter().map(|&&value| combination.iter().copied().chain([value]).collect()).collect::<Vec<Vec<_>>>()
        };
        all = all.iter().flat_map(with).collect();
    }
    all
}

/// The most bytes of a run of a study.
const MOST_RUN: u64 = 1 << 26;

/// A run of a study from its file, when it is there, whole and of the same training.
fn kept(path: &Path, print: &str) -> Result<Option<StudyRun>> {
    let bytes = match io::text::read_bytes(path, MOST_RUN) {
        Err(absent) if absent.code == "io.missing" => return Ok(None),
        read => read?,
    };
    let value = serde_json::from_slice(&bytes).ok().filter(|value: &Value| value["fingerprint"] == print);
    Ok(value.and_then(|value| serde_json::from_value(value).ok()))
}

fn study(args: &Args, source: &SourceText, fields: &[(&str, &str)], folder: &Path, context: Context) -> Result<Answer> {
    let seeds = args.seeds.0.clone();
    if seeds.end > seeds.start.saturating_add(1000) {
        return Err(Error::Usage("--seeds: at most 1000 seeds".to_string()));
    }
    let mut runs = Vec::new();
    let mut read: Option<Data> = None;
    let done = Arc::new(AtomicUsize::new(0));
    let _ending = {
        let (done, folder) = (Arc::clone(&done), folder.display().to_string());
        signals::at_end(move || {
            let done = done.load(Ordering::SeqCst);
            (done > 0).then(|| format!("{done} runs are kept in {folder}, and the same command goes on from there"))
        })
    };
    for (number, setting) in combinations(fields).iter().enumerate() {
        let source = with_fields(source, setting)?;
        let Job { file, mut plan } = job(&source, args)?;
        let data = match &mut read {
            Some(data) => data,
            none => none.insert(data(&file, plan.topology.classes(), args)?),
        };
        let folds = folds(args, &data.train);
        let name = setting.iter().map(|(key, value)| format!("{key}={value}")).collect::<Vec<_>>().join(" ");
        for seed in seeds.clone() {
            plan.seed = seed as u64;
            let print = checkpoint::fingerprint(&plan, &data.train);
            let parts = if folds.is_empty() { vec![None] } else { folds.iter().map(Some).collect::<Vec<_>>() };
            for (part, fold) in parts.into_iter().enumerate() {
                let kind = if fold.is_some() { format!("fold{part}") } else { "test".to_string() };
                let path = folder.join(format!("{}-{}-{seed}-{kind}.json", file.name, &print[..12]));
                let run = match kept(&path, &print)? {
                    Some(run) => run,
                    None => {
                        let begin = Instant::now();
                        let (accuracy, weights) = match fold {
                            Some(fold) => cross_validate(&plan, &data.train, fold, context)?,
                            None => {
                                let state = train(&plan, &data.train, None, context)?;
                                let weights = plan.result(&state).clone();
                                (plan.score(&weights, &data.test).accuracy, weights)
                            }
                        };
                        let model = path.with_extension("ron");
                        let said = format!("{name} seed {seed}, {kind}, of a study: accuracy {accuracy:.4}");
                        write_model(&model, true, &file, &plan, &weights, "", &said)?;
                        let seconds = begin.elapsed().as_secs_f64();
                        let run = StudyRun {
                            setting: name.clone(),
                            number,
                            seed: seed as u64,
                            fold: fold.map(|_| part as u32),
                            accuracy,
                            seconds,
                        };
                        let mut value = serde_json::json!(run);
                        value["fingerprint"] = print.clone().into();
                        value["name"] = file.name.clone().into();
                        value["tested"] = fold.cloned().into();
                        io::write::text(&path, true, &format!("{value:#}\n"))?;
                        run
                    }
                };
                tracing::info!("{name} seed {seed} {kind}: {:.4}", run.accuracy);
                runs.push(StudyRun { number, ..run });
                done.store(runs.len(), Ordering::SeqCst);
            }
        }
    }
    let report = StudyReport { name: &args.config.display().to_string(), runs: &runs };
    output::print(context.format, || report.text(), || report.json(), || report.csv())?;
    Ok(Answer::Yes)
}
