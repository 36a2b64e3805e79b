//! `nsim convert MODEL`: makes integers of a network with real numbers, stage by stage.
//!
//! Input: a model, calibration samples, held-out samples. Output: the gain of each stage, the
//! remaining disagreement, and with `-o` a model file of integers with their provenance. With
//! `--fine-tune` they are then trained for some epochs.

mod fine_tuning;

use std::path::PathBuf;

use crate::cli::args::conversion::TapsArgs;
use crate::cli::args::input::{InputArgs, select};
use crate::cli::args::reading::ReadingArgs;
use crate::cli::context::{Answer, Context};
use crate::cli::convert::fine_tuning::FineTuneArgs;
use crate::cli::output;
use crate::cli::process::progress;
use nsim_files as io;
use nsim_files::network::NetworkFile;
use nsim_files::warnings::show;
use nsim_report::convert::ConvertReport;
use nsim_session::error::Error;
use nsim_train::convert::calibration::{self, RunInput};
use nsim_train::convert::deployed::Conversion;
use nsim_train::convert::job::{Job, SampleSplit};
use nsim_train::convert::next::{CommandWords, suggest};

const EXAMPLES: &str = "\
EXAMPLES:
  nsim convert vtsnn-slip-srm -o slip.ron                  spike response neurons to integers, searched on the model's scene
  nsim convert srm.ron --calibrate train.ron --input test.ron -o loihi.ron
  nsim convert vtsnn-slip-srm --fine-tune 3 -o slip.ron    then train for three epochs with the integers in the forward pass
  nsim convert srm.ron --fine-tune 5 --training srm-training.ron --train recordings/train -o loihi.ron
  nsim convert graph.nir --input spikes.npy --format json  only report the agreement
  nsim agree srm.ron --against loihi.ron                   compare the network with the converted model";

/// Convert a network with real numbers to integers, and report each stage's gain
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A model file or the name of a shipped model
    model: String,
    #[command(flatten)]
    reading: ReadingArgs,
    #[command(flatten)]
    input: InputArgs,
    /// Samples to convert on, as --input takes them [default: the scene with another seed, or the
    /// first half of the input]
    #[arg(long, value_name = "SOURCE")]
    calibrate: Vec<String>,
    /// Samples to convert on
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    calibration_samples: u32,
    #[command(flatten)]
    taps: TapsArgs,
    /// Target of the integers: resets by subtraction become resets to zero if it lacks them
    #[arg(long, default_value = "nahuku-32")]
    target: String,
    #[command(flatten)]
    tuning: FineTuneArgs,
    /// The model file to write; its arrays go next to it as .safetensors
    #[arg(short, long, value_name = "LOIHI.ron")]
    output: Option<PathBuf>,
    /// Replace the section `<!-- convert MODEL -->` of this document
    #[arg(long, value_name = "FILE.md")]
    update: Option<PathBuf>,
}

pub fn run(args: &Args, context: Context) -> Result<Answer, Error> {
    args.output.iter().try_for_each(|path| NetworkFile::check_name(path))?;
    io::write::check_all_free(&args.output, context.force)?;
    let network = args.reading.load(&args.model)?;
    let scene = network.file().scene.clone();
    let job = Job::new(&network, &io::target::load_target(&args.target)?)?;
    args.tuning.check(&job)?;
    show("", &job.integers.parts().warnings);
    let stimulus = args.input.stimulus(&job.integers, scene.as_deref())?;
    let shown = select(&stimulus.samples, &args.input)?;
    let wanted = args.calibration_samples as usize;
    let run = RunInput { sources: &args.input.input, seed: args.input.seed, scene: scene.as_deref() };
    let apart = calibration::stimulus(&job.integers, &args.calibrate, run, wanted)?;
    let split = SampleSplit::new(&stimulus.origin, &shown, apart.as_ref(), wanted);
    let mut search = None;
    let done = job.convert(&split, args.taps.most(), |population| {
        tracing::info!("searching '{population}'");
        drop(search.take());
        search = Some(progress::stage(format!("searching integers of '{population}'")));
    })?;
    drop(search);
    let provenance = job.provenance(&args.model, &split, &done);
    let output = args.output.as_deref().map(|path| (path, provenance.as_str()));
    let tuned = args.tuning.tune(&job, &done, &split.held_out, output, context)?;
    let files = match output {
        Some((path, provenance)) => job.model(&done, tuned.as_ref(), provenance)?.write(path, context.force)?,
        None => Vec::new(),
    };
    for layer in &done.converted.layers {
        if let Some(problem) = &layer.problem {
            tracing::warn!("'{}': {problem}", layer.name);
        }
    }
    let words = output::command_words();
    let sets = words.windows(2).filter(|pair| pair[0] == "--set").flatten().cloned();
    let closer = ["agree", &args.model].map(str::to_string).into_iter().chain(args.input.words()).chain(sets);
    let closer: Vec<String> = closer.chain(["--plot".to_string(), "first.svg".to_string()]).collect();
    let typed = CommandWords {
        model: &args.model,
        conversion: (Conversion::Search, args.taps.most()),
        // The target of `nsim agree` has no reset by subtraction either.
        closer: (!job.resets_are_replaced()).then_some(closer),
        words,
    };
    let next = suggest(&typed, &job.graph, &done.converted.staged, &done.converted.attribution, &split.calibration);
    let report = ConvertReport {
        job: &job,
        done: &done,
        input: &stimulus.origin,
        tuned: tuned.as_ref(),
        files: &files,
        next: next.as_ref(),
    };
    if let Some(path) = &args.update {
        let mark = format!("convert {}", job.graph.facts().name);
        output::update_section(path, &mark, &report.markdown(), None, context)?;
    }
    output::print(context.format, || report.text(), || report.json(), || report.csv())?;
    Ok(Answer::Yes)
}
