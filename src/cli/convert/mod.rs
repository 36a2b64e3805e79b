//! `nsim convert MODEL`: a network with real numbers becomes integers, stage by stage, and is kept.
//!
//! Input: a model, calibration samples, held-out samples. Output: what each stage gained, what is left, and with `-o` a model
//! file of integers whose provenance says how it was made. With `--fine-tune` it is then trained for some epochs.

mod fine_tuning;

use std::path::PathBuf;
use std::time::Instant;

use self::fine_tuning::FineTuneArgs;
use crate::base::diagnostic::Diagnostic;
use crate::cli::args::conversion::CopiesArgs;
use crate::cli::args::input::{InputArgs, select};
use crate::cli::context::{Answer, Context};
use crate::cli::output;
use crate::compile::Form;
use crate::compile::frontend::real_and_integers;
use crate::convert::calibration::{self, RunInput};
use crate::convert::{model_file, resets, staged};
use crate::desc::neurons::NeuronKind;
use crate::drive::inputs;
use crate::error::Error;
use crate::io;
use crate::ir::spikes::Sample;
use crate::report::convert::{ConvertReport, sentence};

const EXAMPLES: &str = "\
EXAMPLES:
  nsim convert vtsnn-slip-srm -o slip.ron                  spike response neurons to integers, searched on the model's scene
  nsim convert srm.ron --calibrate train.ron --input test.ron -o loihi.ron
  nsim convert vtsnn-slip-srm --fine-tune 3 -o slip.ron    then train for three epochs with the integers in the forward pass
  nsim convert srm.ron --fine-tune 5 --training srm-training.ron --train recordings/train -o loihi.ron
  nsim convert graph.nir --input spikes.npy --format json  only say how near it comes
  nsim agree srm.ron --against loihi.ron                   compare the network with what was kept";

/// Convert a network with real numbers to integers, and say what each stage gains
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A model file or the name of a shipped model
    model: String,
    #[command(flatten)]
    input: InputArgs,
    /// Samples to convert on, as --input takes them [default: the scene with another seed, or the first half of the input]
    #[arg(long, value_name = "SOURCE")]
    calibrate: Vec<String>,
    /// How many samples to convert on
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    calibration_samples: u32,
    #[command(flatten)]
    copies: CopiesArgs,
    /// What the integers are for: a target without resets by subtraction makes them resets to zero
    #[arg(long, default_value = "nahuku-32")]
    target: String,
    #[command(flatten)]
    tuning: FineTuneArgs,
    /// The model file to write; its arrays go beside it as .safetensors
    #[arg(short, long, value_name = "LOIHI.ron")]
    output: Option<PathBuf>,
    /// Replace the section `<!-- convert MODEL -->` of this document
    #[arg(long, value_name = "FILE.md")]
    update: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// [`Error`] when an input cannot be used.
pub fn run(args: &Args, context: Context) -> Result<Answer, Error> {
    io::write::check_all_free(&args.output, context.force)?;
    let network = io::model::load_model(&args.model)?;
    let scene = network.file().scene.clone();
    let (graph, integers) = real_and_integers(&network)?;
    let target = io::target::load_target(&args.target)?;
    let soft_reset = target.chip().neuron_kinds.contains(&NeuronKind::SoftReset);
    if !staged::is_real(&graph) && (soft_reset || !resets::has_soft_reset(&graph)) {
        let message = format!("{} has no real numbers to convert", graph.facts().name);
        return Err(Diagnostic::new("convert.integers", message).help("it runs as it is").into());
    }
    Form::require_written("nsim convert", &integers, 1)?;
    let stimulus = inputs::stimulus(&integers, &args.input.sources()?, scene.as_deref(), args.input.seed)?;
    let shown = select(&stimulus.samples, &args.input)?;
    let wanted = args.calibration_samples as usize;
    let run = RunInput { sources: &args.input.input, seed: args.input.seed, scene: scene.as_deref() };
    let apart = calibration::stimulus(&integers, &args.calibrate, run, wanted)?;
    let (calibration, held_out): (Vec<&Sample>, Vec<&Sample>) = match &apart {
        Some(apart) => (apart.samples.iter().take(wanted).collect(), shown),
        None => {
            let half = shown.len().div_ceil(2).min(wanted);
            (shown[..half].to_vec(), shown[half..].to_vec())
        }
    };
    let choices = staged::Choices { most_copies: args.copies.most(), soft_reset };
    let start = Instant::now();
    let converted = staged::convert(&graph, &calibration, choices, |population| {
        tracing::info!("searching '{population}'");
    })?;
    let seconds = start.elapsed().as_secs_f64();
    let held = (!held_out.is_empty()).then(|| converted.on(&held_out));
    let hash = io::text::sha256(network.source().text().as_bytes());
    let provenance = {
        let kept: Vec<&str> = converted.stages.iter().filter(|row| row.kept).map(|row| row.name.as_str()).collect();
        let mut provenance = format!(
            "nsim convert {}; SHA-256 of its text {hash}; {} calibration samples of {}; stages: {}; on these {}",
            args.model,
            converted.calibration.samples,
            apart.as_ref().map_or(&stimulus.origin, |apart| &apart.origin).join(" "),
            kept.join(", "),
            sentence(&converted.calibration)
        );
        if let Some(held) = &held {
            provenance += &format!("; on {} held-out samples {}", held.samples, sentence(held));
        }
        if let Some(before) = &graph.facts().provenance {
            provenance += &format!("; converted from: {before}");
        }
        provenance
    };
    let output = args.output.as_deref().map(|path| (path, provenance.as_str()));
    let tuned = args.tuning.tune((&graph, &integers, &converted), &held_out, output, context)?;
    let mut files = Vec::new();
    match (&tuned, output) {
        (Some(tuned), Some((path, provenance))) => {
            let provenance = format!("{provenance}; {}", tuned.sentence());
            files = model_file::model(&graph, tuned.integers.deployed(), provenance)?.write(path, context.force)?;
        }
        (None, Some((path, provenance))) => {
            let provenance = provenance.to_string();
            files = model_file::model(&graph, &converted.network, provenance)?.write(path, context.force)?;
        }
        (_, None) => {}
    }
    for layer in &converted.layers {
        if let Some(advice) = layer.advice.as_ref().filter(|_| layer.clipped > 0 || layer.coincidence.is_none()) {
            tracing::warn!("'{}': {advice}", layer.name);
        }
    }
    let report = ConvertReport {
        model: &graph.facts().name,
        hash: &hash,
        input: &stimulus.origin,
        converted: &converted,
        held_out: held.as_ref(),
        tuned: tuned.as_ref(),
        files: &files,
        seconds,
    };
    if let Some(path) = &args.update {
        output::update_text(path, &format!("convert {}", graph.facts().name), &report.markdown(), context)?;
    }
    output::print(context.format, || report.text(), || report.json(), || report.csv())?;
    Ok(Answer::Yes)
}
