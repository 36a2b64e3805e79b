//! `nsim train`: trains a network.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use crate::cli::context::{Answer, Context, refuse_if};
use crate::cli::output;
use crate::cli::process::progress;
use crate::cli::process::signals;
use nsim_files as io;
use nsim_files::network::NetworkFile;
#[cfg(feature = "ann")]
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_report::train::{TrainReport, history_csv};
use nsim_session::error::{Error, Result};
use nsim_train::fit::{Example, Plan, TrainingState};
use nsim_train::job::{self, Checkpoint, Job, training_text, with_fields};

const EXAMPLES: &str = "\
EXAMPLES:
  nsim train vtsnn-slip -o my-slip.ron               train the slip network on synthetic scenes
  nsim train vtsnn-slip --set layers.touch.size=64 -o h64.ron    with 64 hidden units for touch
  nsim train container-tactile --train ev-containers/train --test ev-containers/test -o m.ron
  nsim train c.ron --folds 5 --log history.csv             with the accuracy of a cross-validation
  nsim train c.ron --epochs 500 --checkpoint state.safetensors -o m.ron    resumes an interrupted training";

/// Train a network with SLAYER: spikes in, a model file out
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A training file or the name of a shipped one, such as vtsnn-slip
    #[arg(value_name = "CONFIG.ron|NAME")]
    config: String,
    /// Training samples, as `nsim run --input` takes them [default: what the training file names]
    #[arg(long, value_name = "SOURCE")]
    train: Vec<String>,
    /// Test samples, never used to choose anything [default: what the training file names]
    #[arg(long, value_name = "SOURCE")]
    test: Vec<String>,
    /// Write the model here, its weights next to it as NAME.safetensors
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
    /// Override a field of the training file
    #[arg(long, value_name = "FIELD=VALUE")]
    set: Vec<String>,
    /// Write loss and accuracy of each epoch here, as CSV
    #[arg(long, value_name = "FILE.csv")]
    log: Option<PathBuf>,
    /// Save the state here every tenth epoch and on Ctrl-C, and resume from it if the file exists
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
}

/// Training samples of a file, and its number of classes.
#[cfg(feature = "ann")]
pub(in crate::cli) fn labelled(job: &Job) -> Result<(Vec<Example>, usize)> {
    let samples = job.data(&[], &[])?.train;
    if samples.is_empty() {
        let message = "field train is missing or empty: there are no samples to train on";
        return Err(Diagnostic::new("train.sources", message).in_file(job.source.path()).into());
    }
    Ok((samples, job.plan.topology.classes()))
}

/// Saves the last finished epoch at a signal; returns a message.
fn save_at_signal(finished: &Mutex<Option<TrainingState>>, checkpoint: &Checkpoint, epochs: u32) -> Option<String> {
    let state = finished.lock().ok()?.take()?;
    let (epoch, path) = (state.epoch, checkpoint.path().display());
    Some(match checkpoint.save(&state) {
        Ok(()) => format!("{epoch} of {epochs} epochs are stored in {path}, and the same command continues from there"),
        Err(error) => format!("epoch {epoch} could not be stored: {error}"),
    })
}

/// Trains, with a progress bar, from the checkpoint if any; a signal saves the last epoch in it.
pub(in crate::cli) fn train(
    plan: &Plan,
    examples: &[Example],
    checkpoint: Option<&Path>,
    context: Context,
) -> Result<(TrainingState, f64)> {
    let checkpoint = checkpoint.map(|path| Checkpoint::new(path, plan, examples));
    let bar = progress::bar(context, u64::from(plan.epochs), "epochs");
    let finished = Arc::new(Mutex::new(None));
    let _ending = checkpoint.clone().map(|checkpoint| {
        let (finished, epochs) = (Arc::clone(&finished), plan.epochs);
        signals::at_end(move || save_at_signal(&finished, &checkpoint, epochs))
    });
    let done = job::train(plan, examples, checkpoint.as_ref(), |state| {
        bar.set(u64::from(state.epoch));
        if checkpoint.is_some()
            && let Ok(mut finished) = finished.lock()
        {
            *finished = Some(state.clone());
        }
    });
    drop(bar);
    done
}

pub fn run(args: &Args, context: Context) -> Result<Answer> {
    let source = training_text(&args.config)?;
    let wrong = |text: &String| Error::Usage(format!("--set {text}: write FIELD=VALUE"));
    let fields = args.set.iter().map(|text| text.split_once('=').ok_or_else(|| wrong(text)));
    let source = with_fields(&source, &fields.collect::<Result<Vec<_>, _>>()?)?;
    let job = Job::new(source, args.seed, args.epochs)?;
    args.output.iter().try_for_each(|path| NetworkFile::check_name(path))?;
    let weights = args.output.as_deref().map(job::weights_path);
    let on_stdout = args.output.as_deref().is_some_and(io::text::is_standard_stream);
    refuse_if(on_stdout, "-o -: a trained model has weights, which need a file next to it")?;
    if args.output.is_none() {
        tracing::warn!("the trained network is not written: add -o MODEL.ron");
    }
    let taken = output::check_files(args.output.iter().chain(&weights).chain(&args.log), None, context)?;
    let data = {
        let _busy = progress::stage("reading or making samples");
        job.data(&args.train, &args.test)?
    };
    refuse_if(data.train.is_empty(), "there are no training samples: add --train SOURCE")?;
    let state = train(&job.plan, &data.train, args.checkpoint.as_deref(), context)?;
    let each = |plan: &Plan, examples: &[Example]| Ok(train(plan, examples, None, context)?.0);
    let folds = args.folds.map_or_else(Vec::new, |k| Job::folds(&data.train, k));
    let trained = job.trained(state, &data, &folds, each)?;
    let report = TrainReport { job: &job, trained: &trained, model: args.output.as_deref() };
    if let Some(path) = &args.log {
        io::write::text(path, context.force, &history_csv(&trained.state.history))?;
    }
    if let Some(path) = &args.output {
        let (comment, provenance) = (report.provenance(&args.set), report.summary());
        job.write(path, context.force, job.plan.result(&trained.state), &comment, &provenance)?;
    }
    if !taken {
        output::print(context.format, || report.text(), || report.json(), || report.csv())?;
    }
    Ok(Answer::Yes)
}
