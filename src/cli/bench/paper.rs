//! `nsim bench paper`: the tables of the paper on visual and tactile sensing next to nsim's.

use std::path::{Path, PathBuf};

use serde_json::json;

use crate::cli::args::jobs::{self, JobArgs};
use crate::cli::args::values::one_of;
use crate::cli::bench::scenes::each_cell;
use crate::cli::context::{Answer, Context, Format, refuse_if};
use crate::cli::energy::workload::simulate;
use crate::cli::output;
use crate::cli::process::progress;
use crate::cli::train::train;
use nsim_energy::environment::Environment;
use nsim_energy::workload::Workload;
use nsim_files as io;
use nsim_files::shipped::{MODELS, Shipped};
use nsim_ir::base::diagnostic::SourceText;
use nsim_ir::spikes::{Sample, Stimulus};
use nsim_reference::{Model, Options};
use nsim_report::bench::paper as report;
use nsim_session::SampleSettings;
use nsim_session::error::{Error, Result};
use nsim_session::obtain::{EngineKind, Job};
use nsim_session::samples::reference;
use nsim_study::early::Trial;
use nsim_study::published::cells::{LOSSES, Neurons, TestedNetworks, is_among};
use nsim_study::published::paper::{self, PaperRow};
use nsim_train::checkpoint::fingerprint;
use nsim_train::fit::{Example, Plan};
use nsim_train::job::{Job as Training, cross_validate, with_fields};

const EXAMPLES: &str = "\
EXAMPLES:
  nsim bench paper                          stored results next to the printed ones, in grids like the paper's
  nsim bench paper --full                   every figure; the shipped networks are run, a fold of each cell, in about a minute
  nsim bench paper --full --stored --cell slip-both    every stored figure of a cell
  nsim bench paper --train runs -o my.json  train every fold of every cell; the same command continues after an interruption
  nsim bench paper --train runs --cell slip-tactile --folds 5 --epochs 20
  nsim bench paper --results my.json        with your own rows instead of the stored ones";

/// The tables of Taunyazov et al. 2020 on classification, early decisions and hardware: each figure
/// as printed, then the results of trainings with nsim, and their notes
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct PaperArgs {
    /// Files of rows that replace stored ones: {"rows": [{"table": .., "task": .., "measured":
    /// ..}]}
    #[arg(long, value_name = "FILE.json")]
    results: Vec<PathBuf>,
    /// Every figure, with its interval and note; the shipped networks are run
    #[arg(long)]
    full: bool,
    /// Run no network with --full: stored results alone
    #[arg(long)]
    stored: bool,
    /// Train the folds of the cells, keep them in this folder, and run each network on simulated
    /// cores
    #[arg(long, value_name = "DIR")]
    train: Option<PathBuf>,
    /// Only these cells [default: all]
    #[arg(long, value_name = "TASK-SENSES", num_args = 1.., value_parser = one_of(&NAMES, |name| name))]
    cell: Vec<&'static str>,
    /// Only these neurons [default: both]
    #[arg(long, value_name = "NEURONS", num_args = 1.., value_parser = one_of(&Neurons::ALL, Neurons::name))]
    neurons: Vec<Neurons>,
    /// Stratified folds of the scenes
    #[arg(
        long, value_name = "K", requires = "train", default_value_t = FOLDS,
        value_parser = clap::value_parser!(u32).range(2..=100)
    )]
    folds: u32,
    /// Epochs, instead of the training files'
    #[arg(long, value_name = "N", requires = "train", value_parser = clap::value_parser!(u32).range(0..=1_000_000))]
    epochs: Option<u32>,
    /// Scenes of each task, instead of 1000
    #[arg(long, value_name = "N", requires = "train", value_parser = clap::value_parser!(u32).range(2..=100_000))]
    scenes: Option<u32>,
    /// Write the rows of the trained cells for --results
    #[arg(short, long, value_name = "FILE.json", requires = "train")]
    output: Option<PathBuf>,
}

/// Names of the cells.
const NAMES: [&str; 6] =
    ["slip-tactile", "slip-vision", "slip-both", "container-tactile", "container-vision", "container-both"];
/// Folds of the paper.
const FOLDS: u32 = 5;

/// Accuracy of a network over the steps of samples: on simulated cores, or in real numbers for
/// spike response neurons, which no chip has.
fn trial(model: &str, samples: Vec<Sample>, neurons: Neurons, context: Context) -> Result<Trial> {
    let engine = if neurons == Neurons::Srm { EngineKind::Real } else { EngineKind::Mapped };
    let Ok(job) = jobs::prepare(&JobArgs::for_model(model), engine, Some(1), &[])? else {
        return Err(Error::Usage(format!("{model} does not fit the default target: nsim map prints the reasons")));
    };
    let Job::Real(graph, quantised, _) = &job else {
        let (compiled, target) = job.mapped().ok_or_else(|| Error::Fault(format!("{model} is not mapped")))?;
        let order = (0..samples.len()).collect();
        let stimulus = Stimulus { samples, ..Stimulus::default() };
        return timed(&Workload::new(compiled, target, stimulus, order)?, context);
    };
    let samples: Vec<&Sample> = samples.iter().collect();
    let keep = SampleSettings::new(quantised.output());
    let (model, units) =
        (Model::<f64>::new(graph, Options::default())?, (quantised.channels(), quantised.compartments()));
    let outcomes = progress::with_bar(context, samples.len(), "samples", |progress| {
        reference(&model, units, &samples, &keep, progress).outcomes
    });
    let steps = samples.iter().map(|sample| sample.steps() as usize).max().unwrap_or(0);
    Trial::new(&samples, &outcomes, quantised.parts().timestep_ms, steps)
}

/// Accuracy after each step of a mapped network on its samples, all of one length.
fn timed(workload: &Workload<'_>, context: Context) -> Result<Trial> {
    let (metered, _) = workload.meter().offline(workload.target)?;
    let run = simulate(workload, metered, None, true, None, context)?;
    let unequal = || Error::Usage("accuracy over time needs samples of one length".to_string());
    let steps = workload.steps_per_sample().ok_or_else(unequal)?;
    Trial::new(&workload.samples(), &run.outcomes, workload.compiled.one.parts().timestep_ms, steps as usize)
}

fn chosen(samples: &[Sample], numbers: &[usize]) -> Vec<Sample> {
    numbers.iter().map(|&number| samples[number].clone()).collect()
}

/// Trains the folds that the folder lacks, and runs the network of every fold on the scenes that
/// its training did not use.
fn trained(args: &PaperArgs, folder: &Path, context: Context) -> Result<Vec<PaperRow>> {
    let mut rows = Vec::new();
    each_cell(&args.cell, args.scenes, |cell, scenes| {
        let source = SourceText::new(cell.training.path, cell.training.text);
        let job = Training::new(source, None, args.epochs)?;
        let network = job.inputs()?;
        let samples = scenes.samples_for(&network)?;
        let examples = job.examples(&network, &samples, "training")?;
        for neurons in Neurons::ALL.into_iter().filter(|kind| args.neurons.is_empty() || args.neurons.contains(kind)) {
            let neuron = neurons.field(&job.file);
            for (loss, value) in LOSSES.iter().zip(cell.losses(&job.file)?) {
                let mut fields = vec![("loss", value.as_str())];
                fields.extend(neuron.as_deref().map(|neuron| ("neuron", neuron)));
                let job = Training::new(with_fields(&job.source, &fields)?, None, args.epochs)?;
                let print = fingerprint(&job.plan, &examples);
                let mut trials = Vec::new();
                for (fold, tested) in Training::folds(&examples, args.folds).iter().enumerate() {
                    let name = format!("{}-{}-{}-fold{fold}.ron", job.file.name, &print[..12], job.plan.seed);
                    let model = folder.join(name);
                    let state = model.with_extension("state");
                    let keeping = |plan: &Plan, part: &[Example]| Ok(train(plan, part, Some(&state), context)?.0);
                    let (trained, weights) = cross_validate(&job.plan, &examples, tested, keeping)?;
                    tracing::info!("{} {loss}: {trained:.4}", cell.name());
                    let said = format!("{loss} loss, seed {}, fold {fold}: accuracy {trained:.4}", job.plan.seed);
                    job.write(&model, true, &weights, "", &said)?;
                    let model = model.display().to_string();
                    let trial = trial(&model, chosen(&samples, tested), neurons, context)?;
                    let run = trial.accuracy.last().copied().unwrap_or(0.0);
                    // Training and cores compute equal integers. Real numbers have fewer digits in
                    // training.
                    if neurons == Neurons::Loihi && (trained - run).abs() > 1e-9 {
                        return Err(Error::Fault(format!("{model}: accuracy {trained} in training, {run} on cores")));
                    }
                    trials.push(trial);
                }
                let (folds, epochs) = (args.folds, job.plan.epochs);
                rows.extend(TestedNetworks { cell, loss, neurons, folds, epochs, trials: &trials }.rows());
            }
        }
        Ok(())
    })?;
    Ok(rows)
}

/// Runs the shipped network of each cell on the scenes that its training did not use, and adds its
/// accuracy to the stored row.
fn run_shipped(args: &PaperArgs, rows: &mut [PaperRow], context: Context) -> Result<()> {
    each_cell(&args.cell, args.scenes, |cell, scenes| {
        for loss in LOSSES {
            let model = cell.model(loss);
            if Shipped::find(MODELS, &model).is_none() {
                continue;
            }
            let network = nsim_session::front::front(&nsim_import::model::load_model(&model)?)?.into_quantised();
            let samples = scenes.samples_for(&network)?;
            let labels: Vec<u32> = samples.iter().filter_map(Sample::label).collect();
            let folds = Training::folds_by_label(&labels, FOLDS);
            let trial = trial(&model, chosen(&samples, &folds[0]), Neurons::Loihi, context)?;
            let of_cell = ("accuracy", cell.task, cell.modality, Some(loss));
            let is_cell =
                |row: &&mut PaperRow| (&*row.table, &*row.task, &*row.modality, row.loss.as_deref()) == of_cell;
            if let Some(row) = rows.iter_mut().find(is_cell) {
                row.shipped = trial.accuracy.last().map(|share| (share * 1e6).round() / 1e6);
            }
        }
        Ok(())
    })
}

pub fn run(args: &PaperArgs, context: Context) -> Result<Answer> {
    let is_both = args.stored && args.train.is_some();
    refuse_if(is_both, "--stored and --train exclude each other: remove one")?;
    let taken = output::check_files(&args.output, None, context)?;
    let mut columns_given = Vec::new();
    if let Some(folder) = &args.train {
        columns_given = trained(args, folder, context)?;
        if let Some(path) = &args.output {
            let provenance = json!({
                "command": "nsim bench paper --train", "training": "models/train/paper", "folds": args.folds,
                "environment": Environment::here().to_string(),
            });
            io::write::text(path, context.force, &paper::stored(&provenance, &columns_given))?;
        }
    }
    for path in &args.results {
        let source = io::text::read_text(path)?;
        columns_given.extend(paper::parse(&path.display().to_string(), source.text())?);
    }
    let mut rows = paper::rows(columns_given)?;
    rows.retain(|row| is_among(row, &args.cell, &args.neurons));
    if args.full && !args.stored && args.train.is_none() {
        run_shipped(args, &mut rows, context)?;
    }
    let text = || match context.format {
        Format::Markdown => report::document(&rows, "", io::table::markdown),
        Format::Latex => report::document(&rows, "% ", io::table::latex),
        _ if args.full => report::text(&rows),
        _ => report::summary(&rows),
    };
    match context.format {
        _ if taken => {}
        Format::Json | Format::Csv => {
            output::print(context.format, text, || report::json(&rows), || report::csv(&rows))?;
        }
        _ => progress::print(&text())?,
    }
    Ok(Answer::Yes)
}

#[cfg(test)]
mod tests {
    use crate::cli::bench::paper::*;

    #[test]
    fn names_are_those_of_the_cells() {
        assert_eq!(nsim_study::published::cells::cells().map(|cell| cell.name()).collect::<Vec<_>>(), NAMES);
    }
}
