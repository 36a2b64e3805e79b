//! `nsim bench ann`: networks without spikes, trained on the samples of training files.

use std::path::PathBuf;

use serde_json::json;

use crate::cli::args::values::one_of;
use crate::cli::context::{Answer, Context};
use crate::cli::output;
use crate::cli::process::progress;
use crate::cli::train::labelled;
use nsim_ann::{AnnKind, AnnResult, AnnSettings, Senses, trained};
use nsim_energy::environment::Environment;
use nsim_files as io;
use nsim_files::training::TrainingFile;
use nsim_report::bench::paper as report;
use nsim_session::error::Error;
use nsim_study::published::paper::{PaperRow, stored};
use nsim_train::fit::Example;
use nsim_train::job::Job;
use nsim_train::raster::Raster;

const EXAMPLES: &str = "\
EXAMPLES:
  nsim bench ann models/train/paper/slip-both.ron -o ann.json   MLP-GRU and CNN-3D, five folds each
  nsim bench ann container-both.ron --network CNN-3D --tested 1 --epochs 5
  nsim bench paper --results ann.json                           next to the printed figures";

/// Networks without spikes, which the paper compares with, trained on the samples and folds of
/// training files
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct AnnArgs {
    /// Training files (models/train/paper); their samples, inputs and classes are used
    #[arg(value_name = "CONFIG.ron", required = true)]
    config: Vec<PathBuf>,
    /// Only these networks [default: both]
    #[arg(long, value_name = "NAME", num_args = 1.., value_parser = one_of(&AnnKind::ALL, AnnKind::name))]
    network: Vec<AnnKind>,
    /// Divide the samples into K stratified folds, as nsim train does
    #[arg(long, value_name = "K", default_value_t = 5, value_parser = clap::value_parser!(u32).range(2..=1000))]
    folds: u32,
    /// Test on the first N folds only [default: all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    tested: Option<u32>,
    /// Passes over the samples
    #[arg(long, value_name = "N", default_value_t = 20)]
    epochs: u32,
    /// Seed of initial weights and of the order of samples [default: the training file's]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Write the rows for nsim bench paper --results
    #[arg(short, long, value_name = "FILE.json")]
    output: Option<PathBuf>,
}

/// Learning rate of Adam.
const RATE: f64 = 1e-3;
/// Samples of a step of the optimiser.
const BATCH: usize = 16;

/// Input shapes, timesteps and classes of these samples.
fn senses(file: &TrainingFile, examples: &[Example], classes: usize) -> Result<Senses, Error> {
    let place = |name: &str, shape: &[u64]| match *shape {
        [units] => Ok((1, 1, units as usize)),
        [rows, columns] => Ok((1, rows as usize, columns as usize)),
        [channels, rows, columns] => Ok((channels as usize, rows as usize, columns as usize)),
        _ => Err(Error::Usage(format!("input {name} has {} dimensions: give one to three", shape.len()))),
    };
    let shapes = file.inputs.iter().map(|input| place(&input.name, &input.shape)).collect::<Result<Vec<_>, _>>()?;
    let steps = examples.iter().flat_map(|example| example.inputs.iter().map(Raster::steps)).max();
    Ok(Senses { shapes, steps: steps.unwrap_or(0), classes })
}

/// Task of the samples: the name of their scene, else of the training file.
fn task_of(file: &TrainingFile) -> String {
    let scene = file.train.first().and_then(|source| source.strip_prefix("scene:"));
    scene.map_or_else(|| file.name.clone(), |scene| scene.split('?').next().unwrap_or(scene).to_string())
}

/// Rows of one network on one task.
fn rows(file: &TrainingFile, kind: AnnKind, results: &[AnnResult], folds: u32, epochs: u32) -> Vec<PaperRow> {
    let modality = match file.inputs.as_slice() {
        [one] => one.name.clone(),
        _ => "both".to_string(),
    };
    let synthetic =
        if file.train.iter().all(|source| source.starts_with("scene:")) { "synthetic scenes; " } else { "" };
    let tested = results.len();
    let note = format!("{}, {synthetic}{tested} of {folds} folds, {epochs} epochs", kind.name());
    let mean = results.iter().map(|result| result.accuracy).sum::<f64>() / tested.max(1) as f64;
    let square = results.iter().map(|result| (result.accuracy - mean).powi(2)).sum::<f64>();
    let first = results.first();
    let row = |quantity: &str, measured: Option<f64>, deviation| PaperRow {
        measured,
        deviation,
        note: note.clone(),
        ..PaperRow::new("ann", &task_of(file), &modality, quantity)
    };
    vec![
        row("accuracy", Some(mean), (tested > 1).then(|| (square / (tested - 1) as f64).sqrt())),
        row("parameters", first.map(|result| result.parameters as f64), None),
        row("operations", first.map(|result| result.operations as f64), None),
        row("latency_us", first.map(|result| result.latency_us), None),
    ]
}

pub fn run(args: &AnnArgs, context: Context) -> Result<Answer, Error> {
    let taken = output::check_files(&args.output, None, context)?;
    let kinds = if args.network.is_empty() { AnnKind::ALL.to_vec() } else { args.network.clone() };
    let mut all = Vec::new();
    for config in &args.config {
        let job = Job::new(io::text::read_text(config)?, None, None)?;
        let (examples, classes) = labelled(&job)?;
        let file = &job.file;
        let senses = senses(file, &examples, classes)?;
        let folds = Job::folds(&examples, args.folds);
        let tested = args.tested.unwrap_or(args.folds).min(args.folds) as usize;
        for &kind in &kinds {
            let epochs = u64::from(args.epochs) * tested as u64;
            let bar = progress::bar(context, epochs, kind.name());
            let mut results = Vec::with_capacity(tested);
            for fold in folds.iter().take(tested) {
                let part = |of_fold: bool| {
                    let chosen = (0..examples.len()).filter(|index| fold.binary_search(index).is_ok() == of_fold);
                    chosen.map(|index| &examples[index]).collect::<Vec<&Example>>()
                };
                let seed = args.seed.unwrap_or(file.seed);
                let settings = AnnSettings { epochs: args.epochs, batch: BATCH, rate: RATE, seed };
                let done = trained((kind, &senses), (&part(false), &part(true)), settings, |loss| {
                    tracing::debug!("{} {}: loss {loss:.4}", file.name, kind.name());
                    bar.add(1);
                });
                results.push(done.map_err(|error| Error::Fault(format!("candle: {error}")))?);
            }
            drop(bar);
            all.extend(rows(file, kind, &results, args.folds, args.epochs));
        }
    }
    if let Some(path) = &args.output {
        let names: Vec<String> = args.config.iter().map(|path| path.display().to_string()).collect();
        let provenance = json!({
            "command": "nsim bench ann", "training": names, "epochs": args.epochs, "folds": args.folds,
            "tested": args.tested.unwrap_or(args.folds), "seed": args.seed, "batch": BATCH, "rate": RATE,
            "optimiser": "Adam", "crate": "candle-core 0.9", "environment": Environment::here().to_string(),
        });
        io::write::text(path, context.force, &stored(&provenance, &all))?;
    }
    if !taken {
        output::print(context.format, || report::tables(&all), || report::json(&all), || report::csv(&all))?;
    }
    Ok(Answer::Yes)
}
