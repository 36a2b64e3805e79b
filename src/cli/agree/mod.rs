//! `nsim agree`: where and why two networks disagree.
//!
//! Input: a model, its counterpart, samples. Output: the differences of spikes and potentials layer
//! by layer, and their causes. The answer is no when a required bound is missed.

mod args;
mod models;

pub use crate::cli::agree::args::Args;

use std::path::Path;

use serde_json::json;

use crate::cli::agree::args::{answer, deployed_warnings, draw};
use crate::cli::agree::models::Compared;
use crate::cli::args::input::select;
use crate::cli::args::recording::RecordingPair;
use crate::cli::args::values::Switch;
use crate::cli::context::{Answer, Context, refuse_if};
use crate::cli::output;
use crate::cli::process::progress;
use nsim_agree::attribution::attribute;
use nsim_agree::compare::{Counterpart, DeployedNetwork, compare, output_layer};
use nsim_agree::staged::layers;
use nsim_compile::refuse_large;
use nsim_files::network::Network;
use nsim_files::target::target_with_neurons;
use nsim_files::warnings::show;
use nsim_import::foreign::Options;
use nsim_import::spikes::{read_source, warning_of_changes};
use nsim_ir::graph::Graph;
use nsim_ir::quantised::Quantised;
use nsim_ir::stimulus::{InputArg, InputSource};
use nsim_report::agree::{AgreeReport, bars, converted_from, named_fits};
use nsim_session::error::Error;
use nsim_session::front::real_and_integers;
use nsim_train::convert::next::{CommandWords, suggest};
use nsim_train::convert::staged::is_real;

pub fn run(args: &Args, context: Context) -> Result<Answer, Error> {
    let taken = output::check_files(None, args.plot_causes.iter().chain(&args.plot), context)?;
    let is_no_share = args.require_class_agreement.is_some_and(|share| !(0.0..=1.0).contains(&share));
    refuse_if(is_no_share, "--require-class-agreement is a share between 0 and 1")?;
    let network = args.reading.load(&args.model)?;
    if let Some(pair) = &args.check {
        return check(args, &network, pair, context);
    }
    let scene = network.file().scene.clone();
    let (graph, analytic) = real_and_integers(&network)?;
    refuse_large("nsim agree", &analytic, 1)?;
    show("", &analytic.parts().warnings);
    let stimulus = args.input.stimulus(&analytic, scene.as_deref())?;
    let samples = select(&stimulus.samples, &args.input)?;
    let models = models::model_files(&args.against)?;
    // A network in real numbers is not mapped; its counterpart is.
    let deployed = match models.as_slice() {
        [other, ..] if is_real(&graph) => &args.reading.load_other(other)?,
        _ => &network,
    };
    let (target, instead) = target_with_neurons(deployed.file(), args.target.as_deref())?;
    instead.iter().for_each(|instead| tracing::warn!("{instead}"));
    let (graph, integers, stimulus, target) = (&graph, &analytic, &stimulus, &target);
    let trained = Compared { graph, integers, stimulus, samples: &samples, target, context };
    match models.as_slice() {
        [] => with_counterpart(args, &trained, scene.as_deref(), taken),
        [other] => models::with_one(args, &trained, other),
        several => models::with_several(args, &trained, several),
    }
}

/// Compares the reference engine's spikes with those that the model's tool recorded.
fn check(args: &Args, network: &Network, pair: &RecordingPair, context: Context) -> Result<Answer, Error> {
    let options = Options { reading: args.reading.reading(), ..Options::default() };
    let (equal, lines) = pair.lines(network, Path::new(&args.model), &options)?;
    let json = || json!({ "schema": "nsim.agree/1", "model": network.file().name, "equal": equal, "check": lines });
    output::print(context.format, || lines.join("\n") + "\n", json, || lines.join("\n") + "\n")?;
    Ok(if equal { Answer::Yes } else { Answer::No })
}

/// Compares the deployed network with a form of its own, or with recorded spikes.
fn with_counterpart(args: &Args, trained: &Compared<'_>, scene: Option<&str>, taken: bool) -> Result<Answer, Error> {
    let Compared { graph, integers: analytic, samples, context, .. } = *trained;
    let against = against(args, graph, analytic)?;
    let wanted = args.calibration_samples as usize;
    let integers = args.conversion.integers(graph, analytic, &args.input, scene, samples, wanted)?;
    let staged = integers.staged(graph)?;
    let Some(compiled) = trained.deployed(&args.model, staged.deployed())? else { return Ok(Answer::No) };
    let attributed = against.is_real() && matches!(args.attribution, Switch::On);
    refuse_if(
        args.plot_causes.is_some() && !attributed,
        "--plot-causes draws the causes of disagreement: it needs --against srm or cuba, with --attribution on",
    )?;
    let (fits, program, steps) = (&integers.fits, &compiled.program, args.steps);
    let deployed = DeployedNetwork { graph, fits, staged: &staged, program, samples, steps };
    let agreement = progress::with_bar(context, samples.len(), "samples", |done| compare(deployed, &against, done))?;
    show("", &deployed_warnings(&compiled, samples)?);
    let some = &samples[..samples.len().min(args.attribution_samples as usize)];
    let attribution = attributed.then(|| {
        let _busy = progress::stage("attributing the disagreement to causes");
        attribute(&staged, &output_layer(staged.deployed()), some)
    });
    let typed = command_words(args);
    let next = attribution.as_ref().and_then(|attribution| suggest(&typed, graph, &staged, attribution, some));
    let name = trained.name();
    let bars = attribution.as_ref().map(|attribution| bars(name, attribution));
    if let (Some(path), Some(svg)) = (&args.plot_causes, &bars) {
        output::write_picture(path, svg, context)?;
    }
    let mut files = draw(args, name, &agreement.layers, context)?;
    files.extend(args.plot_causes.iter().map(|path| path.display().to_string()));
    let report = AgreeReport {
        found: integers.found.as_ref(),
        fits: &named_fits(graph, fits),
        attribution: attribution.as_ref(),
        attribution_samples: some.len(),
        next: next.as_ref(),
        files: &files,
        target: Some(trained.target.name()),
        source: converted_from(graph)
            .filter(|_| matches!(against, Counterpart::Cuba))
            .map(|trained| (trained, format!("nsim agree {trained} --against {}", args.model))),
        ..AgreeReport::for_counterpart((name, against.name()), trained.input(), &agreement)
    };
    if let (Some(path), Some(svg)) = (&args.update, &bars) {
        let (mark, picture) = (format!("agree {name}"), format!("agreement-{name}.svg"));
        output::update_section(path, &mark, &report.markdown(&picture), Some((&picture, svg)), context)?;
    }
    answer(args, &report, taken, context)
}

/// The command as typed, and the same with a picture of the first spike that differs.
fn command_words(args: &Args) -> CommandWords<'_> {
    let words = output::command_words();
    let with_plot = words.iter().cloned().chain(["--plot".to_string(), "first.svg".to_string()]);
    CommandWords {
        closer: args.plot.is_none().then(|| with_plot.collect()),
        words,
        model: &args.model,
        conversion: (args.conversion.conversion, args.conversion.taps.most()),
    }
}

fn against(args: &Args, graph: &Graph, network: &Quantised) -> Result<Counterpart, Error> {
    match args.against.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [] | ["srm"] if graph.has_srm() => return Ok(Counterpart::Srm),
        ["srm"] => {
            let message = format!("{} has no spike response neurons", graph.facts().name);
            return Err(Error::Usage(format!("--against srm: {message}; use cuba or golden")));
        }
        [] | ["cuba"] => return Ok(Counterpart::Cuba),
        ["golden"] => return Ok(Counterpart::Golden),
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
        let recordings = read_source(path, u64::from(layer.count))?;
        show("", warning_of_changes(&layer.name, &recordings).as_slice());
        Ok((layer.clone(), recordings))
    });
    Ok(Counterpart::Recorded(recorded.collect::<Result<_, Error>>()?))
}
