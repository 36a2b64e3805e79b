//! `nsim agree`: where and why two networks disagree.

use std::path::{Path, PathBuf};

use crate::agree::attribution::attribute;
use crate::agree::compare::{
    Counterpart, Deployed, LayerRow, Side, compare, compare_networks, machine_trace, output_layer, real_trace,
};
use crate::agree::ladder::{Ladder, layers};
use crate::cli::args::conversion::ConversionArgs;
use crate::cli::args::input::{InputArgs, select};
use crate::cli::args::jobs::Refusal;
use crate::cli::args::values::Switch;
use crate::cli::context::{Answer, Context};
use crate::cli::output;
use crate::compile::frontend::analytic::Fit;
use crate::compile::frontend::real_and_integers;
use crate::compile::{CompileError, Compiled, Form, Options, compile};
use crate::convert::staged::is_real;
use crate::desc::stimulus::{InputArg, InputSource};
use crate::drive::inputs;
use crate::drive::warnings::{Warning, warnings_of};
use crate::error::Error;
use crate::io;
use crate::io::spikes::read_source;
use crate::ir::graph::Graph;
use crate::ir::quantised::Quantised;
use crate::ir::spikes::{Sample, Stimulus};
use crate::report::agree::AgreeReport;

const EXAMPLES: &str = "\
EXAMPLES:
  nsim agree                                             the shipped spike response network against its conversion
  nsim agree container-tactile --input dataset.ron       a network of Loihi neurons against itself in real numbers
  nsim agree model.ron --input s.npy --against golden --require-exact
  nsim agree model.ron --input in.npy --against hidden=h.npy --against out=o.npy --require-exact
  nsim agree srm.ron --against converted.ron             the trained network against a model file, on the same input
  nsim agree srm.ron --against converted.ron --plot first.svg    both potentials around the first spike that differs
  nsim agree --require-class-agreement 0.99 --svg causes.svg";

/// Compare a trained network with its deployed form: spikes, potentials, classes, and the causes of differences
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A model file or the name of a shipped model
    #[arg(value_name = "MODEL", default_value = "vtsnn-slip-srm")]
    model: String,
    #[command(flatten)]
    input: InputArgs,
    /// What the deployed network is compared with: srm (as trained), cuba (current-based neurons in real numbers), golden
    /// (the reference interpreter), a model file, or recorded spikes, [POPULATION=]FILE [default: srm for spike response networks, else cuba]
    #[arg(long, value_name = "srm|cuba|golden|FILE")]
    against: Vec<String>,
    #[command(flatten)]
    conversion: ConversionArgs,
    /// How many samples to search on
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    calibration_samples: u32,
    /// Compare only so many steps of each sample
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    steps: Option<u32>,
    /// Attribute the disagreement to causes
    #[arg(long, value_enum, default_value = "on")]
    attribution: Switch,
    /// How many samples the attribution uses
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    attribution_samples: u32,
    /// Write a bar chart of the causes
    #[arg(long, value_name = "FILE.svg")]
    svg: Option<PathBuf>,
    /// Draw both potentials around the first spike in which the two part
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
    /// Replace the section `<!-- agree MODEL -->` of this document, and write the bar chart next to it
    #[arg(long, value_name = "FILE.md")]
    update: Option<PathBuf>,
    /// The target of the deployed network: a file or the name of a shipped target
    #[arg(long, default_value = "nahuku-32")]
    target: String,
    /// Exit with status 1 if fewer than this share of the samples have the same class
    #[arg(long, value_name = "SHARE")]
    require_class_agreement: Option<f64>,
    /// Exit with status 1 unless every spike is the same
    #[arg(long)]
    require_exact: bool,
}

/// Runs the command; the answer is no when a bound that was asked for is missed.
///
/// # Errors
/// [`Error`] when an input cannot be used.
pub fn run(args: &Args, context: Context) -> Result<Answer, Error> {
    let taken = output::check_files(None, args.svg.iter().chain(&args.plot), context)?;
    if args.require_class_agreement.is_some_and(|share| !(0.0..=1.0).contains(&share)) {
        return Err(Error::Usage("--require-class-agreement is a share between 0 and 1".to_string()));
    }
    let network = io::model::load_model(&args.model)?;
    let scene = network.file().scene.clone();
    let (graph, analytic) = real_and_integers(&network)?;
    Form::require_written("nsim agree", &analytic, 1)?;
    let stimulus = inputs::stimulus(&analytic, &args.input.input, scene.as_deref(), args.input.seed)?;
    let samples = select(&stimulus.samples, &args.input)?;
    if let Some(other) = model_file(args) {
        return with_model(args, (&graph, &analytic), other, (&stimulus, &samples), context);
    }
    let against = against(args, &graph, &analytic)?;

    let wanted = args.calibration_samples as usize;
    let (fits, found) = args.conversion.fits((&graph, &analytic), &args.input, scene.as_deref(), &samples, wanted)?;
    let ladder = match &found {
        Some(found) => found.conversion.ladder(&graph)?,
        None => Ladder::new(&graph, &fits)?,
    };
    let target = io::target::load_target(&args.target)?;
    let compiled = match compile(ladder.deployed().clone(), &target, &Options::default()) {
        Ok(compiled) => compiled,
        Err(CompileError::DoesNotFit(reasons)) => {
            return Refusal::new(&args.model, target, reasons).say(crate::report::agree::nothing(), context);
        }
        Err(other) => return Err(other.into()),
    };
    let attributed = against.is_real() && matches!(args.attribution, Switch::On);
    if args.svg.is_some() && !attributed {
        let message = "--svg draws the causes of disagreement, which --against srm or cuba has, with --attribution on";
        return Err(Error::Usage(message.to_string()));
    }
    let program = &compiled.program;
    let deployed =
        Deployed { graph: &graph, fits: &fits, ladder: &ladder, program, samples: &samples, steps: args.steps };
    let agreement = output::with_progress(context, samples.len(), "samples", |done| compare(deployed, &against, done))?;
    output::warn_all(&deployed_warnings(&compiled, &samples)?);
    let attribution = match attributed {
        true => {
            let some = &samples[..samples.len().min(args.attribution_samples as usize)];
            Some(attribute(&ladder, &output_layer(ladder.deployed()), some))
        }
        false => None,
    };
    if let (Some(path), Some(attribution)) = (&args.svg, &attribution) {
        let svg = crate::report::agree::bars(&args.model, attribution);
        io::write::file(path, context.force, |out| out.write_all(svg.as_bytes()))?;
    }
    draw(args, &graph.facts().name, &agreement.layers, context)?;
    let report = AgreeReport {
        model: &graph.facts().name,
        against: against.name(),
        input: &stimulus.origin,
        seed: stimulus.seed,
        samples: samples.len(),
        same_class: agreement.same_class,
        accuracy: agreement.accuracy,
        layers: &agreement.layers,
        found: found.as_ref(),
        fits: &named(&graph, &fits),
        attribution: attribution.as_ref(),
        attribution_samples: samples.len().min(args.attribution_samples as usize),
    };
    if let (Some(path), Some(attribution)) = (&args.update, &attribution) {
        let name = &graph.facts().name;
        let (mark, picture) = (format!("agree {name}"), format!("agreement-{name}.svg"));
        let svg = crate::report::agree::bars(name, attribution);
        output::update_section(path, &mark, &report.markdown(&picture), &picture, &svg, context)?;
    }
    if !taken {
        output::print(context.format, || report.text(), || report.json(), || report.csv())?;
    }
    Ok(answer(args, &report))
}

/// Whether the bounds that were asked for are kept; layers that never fire agree in nothing.
fn answer(args: &Args, report: &AgreeReport<'_>) -> Answer {
    let fired = report.layers.iter().any(|row| row.comparison.tally.spikes_a > 0);
    let exact = fired && report.layers.iter().all(|row| row.comparison.first_divergence.is_none());
    let enough =
        args.require_class_agreement.is_none_or(|share| report.class_agreement().is_some_and(|is| is >= share));
    if enough && (exact || !args.require_exact) { Answer::Yes } else { Answer::No }
}

/// The model file that `--against` names, if it names one.
fn model_file(args: &Args) -> Option<&str> {
    let [word] = args.against.as_slice() else { return None };
    let extension = Path::new(word).extension()?.to_string_lossy().to_ascii_lowercase();
    let foreign = ["nir", "net"].contains(&extension.as_str());
    // A manifest of recorded spikes is RON as well.
    let model = extension == "ron" && io::text::read_text(Path::new(word)).is_ok_and(|t| t.text().contains("Network("));
    (Path::new(word).exists() && (foreign || model)).then_some(word)
}

/// A network as it was trained beside another model file in integers, on the same input.
fn with_model(
    args: &Args,
    (graph, integers): (&Graph, &Quantised),
    other: &str,
    (stimulus, samples): (&Stimulus, &[&Sample]),
    context: Context,
) -> Result<Answer, Error> {
    let (_, second) = real_and_integers(&io::model::load_model(other)?)?;
    Form::require_written("nsim agree", &second, 1)?;
    let target = io::target::load_target(&args.target)?;
    let options = Options::default();
    let programs = compile(integers.clone(), &target, &options)
        .and_then(|first| Ok((first, compile(second.clone(), &target, &options)?)));
    let (first, deployed) = match programs {
        Ok(programs) => programs,
        Err(CompileError::DoesNotFit(reasons)) => {
            return Refusal::new(&args.model, target, reasons).say(crate::report::agree::nothing(), context);
        }
        Err(other) => return Err(other.into()),
    };
    let (real, machine) = (real_trace(graph, integers.compartments()), machine_trace(integers, &first.program)?);
    let second_trace = machine_trace(&second, &deployed.program)?;
    let (here, there) = (layers(integers), layers(&second));
    let a = Side { layers: &here, trace: if is_real(graph) { &real } else { &machine } };
    let b = Side { layers: &there, trace: &second_trace };
    let output = output_layer(integers);
    let agreement = output::with_progress(context, samples.len(), "samples", |done| {
        compare_networks((a, b), &output, samples, args.steps, done)
    })?;
    output::warn_all(&deployed_warnings(&deployed, samples)?);
    draw(args, &graph.facts().name, &agreement.layers, context)?;
    let report = AgreeReport {
        model: &graph.facts().name,
        against: "another model",
        input: &stimulus.origin,
        seed: stimulus.seed,
        samples: samples.len(),
        same_class: agreement.same_class,
        accuracy: agreement.accuracy,
        layers: &agreement.layers,
        found: None,
        fits: &[],
        attribution: None,
        attribution_samples: 0,
    };
    if args.plot.as_deref().is_none_or(|path| !io::text::is_standard_stream(path)) {
        output::print(context.format, || report.text(), || report.json(), || report.csv())?;
    }
    Ok(answer(args, &report))
}

/// What to warn of in the deployed network. What its rounding costs, the comparison says itself.
fn deployed_warnings(deployed: &Compiled, samples: &[&Sample]) -> Result<Vec<Warning>, Error> {
    let mut warnings = warnings_of(&deployed.quantised, &deployed.program, samples)?;
    warnings.retain(|warning| warning.code != "weights-rounded");
    Ok(warnings)
}

/// Writes the picture of both potentials, where one is asked for and something parts.
fn draw(args: &Args, model: &str, layers: &[LayerRow], context: Context) -> Result<(), Error> {
    let Some(path) = &args.plot else { return Ok(()) };
    match crate::report::agree::potentials(model, layers) {
        Some(svg) => Ok(io::write::text(path, context.force, &svg)?),
        None => {
            tracing::warn!("no spike parts whose potentials are known: {} is not written", path.display());
            Ok(())
        }
    }
}

fn named(graph: &Graph, fits: &[Option<Fit>]) -> Vec<(String, Fit)> {
    let each = graph.populations().zip(fits);
    each.filter_map(|((_, population), fit)| Some((population.name.clone(), fit.clone()?))).collect()
}

fn against(args: &Args, graph: &Graph, network: &Quantised) -> Result<Counterpart, Error> {
    let word = match args.against.as_slice() {
        [] if graph.has_srm() => "srm",
        [] => "cuba",
        [word] => word,
        _ => "",
    };
    match word {
        "srm" if graph.has_srm() => return Ok(Counterpart::Srm),
        "srm" => {
            let message = format!("{} has no spike response neurons", graph.facts().name);
            return Err(Error::Usage(format!("--against srm: {message}; use cuba or golden")));
        }
        "cuba" => return Ok(Counterpart::Cuba),
        "golden" => return Ok(Counterpart::Golden),
        _ => {}
    }
    let layers = layers(network);
    let recorded = args.against.iter().map(|text| {
        let argument = match InputArg::parse(text)? {
            InputArg { population: Some(name), .. }
                if Path::new(text).exists() && !layers.iter().any(|l| l.name == name) =>
            {
                InputArg { population: None, source: InputSource::Path(text.into()) }
            }
            argument => argument,
        };
        let InputSource::Path(path) = &argument.source else {
            return Err(Error::Usage(format!("--against {text}: a scene is an input, not a recording")));
        };
        let name = argument.population.unwrap_or_else(|| output_layer(network).name);
        let layer = layers.iter().find(|layer| layer.name == name).ok_or_else(|| {
            let names: Vec<&str> = layers.iter().map(|layer| layer.name.as_str()).collect();
            Error::Usage(format!("--against {text}: populations with compartments are: {}", names.join(", ")))
        })?;
        Ok((layer.clone(), read_source(path, u64::from(layer.count))?))
    });
    Ok(Counterpart::Recorded(recorded.collect::<Result<_, Error>>()?))
}
