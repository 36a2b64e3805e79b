//! `nsim import FILE`: describes a model of another tool, and writes it in nsim's format.
//!
//! Input: a file, and options for the values that it lacks. Output: the content of the model with
//! its conventions, and with `-o` the model as RON with its arrays next to it. The model is lowered
//! before it is written, so an invalid model is refused here.

use std::path::PathBuf;

use serde_json::json;

use crate::cli::args::reading::ReadingArgs;
use crate::cli::args::recording::{RecordingPair, recording_pair, with_rows};
use crate::cli::args::values::one_of;
use crate::cli::context::{Answer, Context, refuse_if};
use crate::cli::inspect::network::kind_and_parameters;
use crate::cli::output;
use nsim_files::changes;
use nsim_files::network::ProjectionKind;
use nsim_files::warnings::show;
use nsim_import::foreign::{self, DecayRule, Imported, Options};
use nsim_ir::arithmetic::{ReadOut, ThresholdTest};
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_report::inspect::{Findings, FindingsTable};
use nsim_session::error::Error;

/// Command-line arguments.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "EXAMPLES:
  nsim import network.net -o model.ron              a network of lava-dl's netx
  nsim import network.net --image digit.npy         its input layer driven by an image
  nsim import weights.pt --neuron slip_loihi.yml    a state dict of SLAYER or lava-dl, or VT_SNN's sets of .npy
  nsim import graph.nir --from snntorch -o model.ron   NIR, by the conventions of the tool that wrote it
  nsim import graph.nir --dt 0.1 -o model.ron       NIR, with the timestep that its file does not have
  nsim import graph.nir --check in.npy=out.npy      with the tool's own spikes: which conventions give them
  nsim import network.net                           only describe the file")]
pub struct Args {
    /// The foreign file
    pub file: PathBuf,
    #[command(flatten)]
    reading: ReadingArgs,
    /// Type and parameters of the neurons, where the file has none: a YAML file
    #[arg(long, value_name = "FILE")]
    neuron: Option<PathBuf>,
    /// Share of a state kept per step, where the file has time constants (NIR): 1 - dt / tau, as
    /// snnTorch and Norse (euler), or exp(-dt / tau), as sinabs and Rockpool (exponential)
    /// [default: that of --from, else euler]
    #[arg(long, value_name = "HOW", value_parser = one_of(&DecayRule::ALL, DecayRule::name))]
    decay: Option<DecayRule>,
    /// Whether a compartment spikes above its threshold (strict, as on the chip) or also at it
    /// (inclusive, as in sinabs, spikingjelly and SLAYER 2) [default: that of --from, else strict]
    #[arg(long, value_name = "HOW", value_parser = one_of(&ThresholdTest::ALL, ThresholdTest::name))]
    threshold: Option<ThresholdTest>,
    /// Score of an output: its spikes, or its potential, the greatest, the sum or the last
    /// [default: spikes, or the potential of an output that never spikes]
    #[arg(long, value_name = "HOW", value_parser = one_of(&ReadOut::ALL, ReadOut::name))]
    decision: Option<ReadOut>,
    /// An image as .npy, 0 to 1 or 8 bits, that drives the bias of an input layer with neurons
    #[arg(long, value_name = "FILE")]
    image: Option<PathBuf>,
    /// The step at which the first layer starts, each next one a step later
    #[arg(long, value_name = "STEP")]
    first_step: Option<u32>,
    /// Reset u and v of each layer at this interval, counted from its start
    #[arg(long, value_name = "STEPS", value_parser = clap::value_parser!(u32).range(1..))]
    reset_interval: Option<u32>,
    /// The first of these resets, counted from a layer's start
    #[arg(long, value_name = "STEPS", default_value_t = 0, requires = "reset_interval")]
    reset_offset: u32,
    /// Size of the input of a network that begins with a convolution, or with a dense layer on an
    /// image
    #[arg(long, value_name = "C,H,W", value_delimiter = ',')]
    input_shape: Option<Vec<u64>>,
    /// Bits of the fraction of a message of SDNN neurons (netx) [default: 6]
    #[arg(long, value_name = "BITS", value_parser = clap::value_parser!(u8).range(..=7))]
    spike_exp: Option<u8>,
    /// Bits of the fraction of their state below that [default: 6]
    #[arg(long, value_name = "BITS", value_parser = clap::value_parser!(u8).range(..=7))]
    state_exp: Option<u8>,
    /// Compare the reference engine's spikes with those that the tool recorded: spikes of the input
    /// and of the output, as arrays; where they differ, with the conventions of each tool, too
    #[arg(long, value_name = "IN.npy=OUT.npy", value_parser = recording_pair)]
    check: Option<RecordingPair>,
    /// The model file to write; its arrays go next to it as .safetensors
    #[arg(short, long, value_name = "MODEL.ron")]
    output: Option<PathBuf>,
}

impl Args {
    fn options(&self) -> Result<Options, Error> {
        if let Some(shape) = self.input_shape.as_ref().filter(|shape| shape.len() != 3 || shape.contains(&0)) {
            return Err(Error::Usage(format!("--input-shape {shape:?}: write CHANNELS,HEIGHT,WIDTH")));
        }
        Ok(Options {
            reading: self.reading.reading(),
            known: false,
            neuron: self.neuron.clone(),
            decay: self.decay,
            threshold: self.threshold,
            decision: self.decision,
            image: self.image.clone(),
            first_step: self.first_step,
            reset_interval: self.reset_interval,
            reset_offset: self.reset_offset,
            input_shape: self.input_shape.clone(),
            spike_exp: self.spike_exp,
            state_exp: self.state_exp,
        })
    }
}

pub fn run(args: &Args, context: Context) -> Result<Answer, Error> {
    let taken = output::check_files(&args.output, None, context)?;
    let message = "--set is not supported by import; give it to the command that uses the model";
    refuse_if(!changes::process_changes().is_empty(), message)?;
    let options = args.options()?;
    let imported = foreign::read(&args.file, &options).map_err(|problem| match &args.check {
        Some(check) => with_rows(problem, &check.by_tool(&args.file, &options)),
        None => problem,
    })?;
    show(&args.file.display().to_string(), &imported.warnings);
    let shown = args.output.as_deref().unwrap_or(&args.file);
    // An error of the model is reported for the foreign file, which the user did write.
    let in_the_file = |mut problem: Diagnostic| {
        problem.place = None;
        problem.in_file(&args.file)
    };
    let network = imported.model.build(shown)?;
    nsim_session::front::check(&network).map_err(in_the_file)?;
    let checked = args.check.as_ref().map(|check| check.lines(&network, &args.file, &options)).transpose()?;
    let files = match &args.output {
        Some(path) => imported.model.write(path, context.force)?,
        None => Vec::new(),
    };
    let findings = findings(&imported, &files, checked.as_ref().map(|(_, lines)| lines.as_slice()));
    let file = args.file.display().to_string();
    if !taken {
        output::print(
            context.format,
            || findings.text(&file),
            || findings.json("nsim.import/1", &file),
            || findings.csv(),
        )?;
    }
    Ok(if checked.is_none_or(|(equal, _)| equal) { Answer::Yes } else { Answer::No })
}

/// Report of an imported model.
fn findings(imported: &Imported, files: &[String], checked: Option<&[String]>) -> Findings {
    let model = &imported.model;
    let every =
        model.reset.map(|reset| format!("every {} steps from step {} of a layer", reset.interval, reset.offset));
    let reset = every.or(imported.reset.map(|reset| reset.name().to_string()));
    let populations = model.populations.iter().map(|population| {
        let (kind, parameters) = kind_and_parameters(population);
        json!([population.name, kind, population.shape, population.start_step, parameters])
    });
    let projections = model.projections.iter().map(|projection| {
        let (kind, weights) = match &projection.kind {
            ProjectionKind::Dense(weights) => ("dense", weights.tensor().shape().to_vec()),
            ProjectionKind::Sparse(synapses) => ("sparse", vec![synapses.len()]),
            ProjectionKind::Conv2d { weights, .. } => ("conv2d", weights.tensor().shape().to_vec()),
            ProjectionKind::SumPool2d { kernel, .. } => ("sumpool2d", vec![kernel.0 as usize, kernel.1 as usize]),
            ProjectionKind::Arrays(_) | ProjectionKind::Random { .. } => ("sparse", Vec::new()),
        };
        let from = projection.from.join(" + ");
        json!([from, projection.to, kind, weights, projection.delay, projection.weight_exp.unwrap_or(0)])
    });
    let layers = imported
        .layers
        .iter()
        .map(|layer| json!([layer.name, layer.shape, layer.scale, layer.zeroed, layer.greatest_error]));
    Findings {
        kind: imported.kind,
        facts: vec![
            ("name", json!(model.name)),
            ("timestep_ms", json!(model.timestep_ms)),
            ("semantics", json!(model.semantics)),
            ("threshold", json!(model.threshold)),
            ("output", json!(model.output)),
            ("decision", json!(model.decision)),
            ("drain", json!(model.drain)),
            ("reset", json!(reset)),
            ("notes", json!(imported.notes)),
            ("check", json!(checked)),
            ("written", if files.is_empty() { json!(null) } else { json!(files) }),
        ],
        tables: vec![
            FindingsTable::new("populations", &["name", "kind", "shape", "start_step", "parameters"], populations),
            FindingsTable::new("layers", &["name", "weights", "scale", "became_zero", "largest_error"], layers),
            FindingsTable::new("projections", &["from", "to", "kind", "weights", "delay", "weight_exp"], projections),
        ],
    }
}
