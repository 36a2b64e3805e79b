//! `nsim agree MODEL --against FILE..`: a network as it was trained beside other model files in
//! integers.
//!
//! Input: the network, one model file or several, samples. Output: for one file the comparison
//! layer by layer, for several a table with all of them. Errors: files of other populations;
//! pictures of more than one comparison.

use std::path::Path;

use crate::cli::agree::args::{Args, answer, deployed_warnings, draw};
use crate::cli::args::jobs::Refusal;
use crate::cli::context::{Answer, Context};
use crate::cli::output;
use nsim_agree::compare::{Agreement, compare_models};
use nsim_compile::{CompileError, Form, Mapping, Options, compile};
use nsim_files as io;
use nsim_import::kind::FileKind;
use nsim_ir::graph::Graph;
use nsim_ir::hardware::Target;
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::{Sample, Stimulus};
use nsim_report::agree::{AgreeReport, role};
use nsim_report::side_by_side::{Compared, SideBySideReport};
use nsim_session::error::Error;
use nsim_session::front::real_and_integers;
use nsim_train::convert::staged::is_real;

/// The model files that `--against` names; none where it names something else.
///
/// # Errors
/// Usage, where only some of several are model files.
pub(super) fn named(against: &[String]) -> Result<Vec<&str>, Error> {
    let is_model = |word: &&str| {
        let path = Path::new(word);
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase());
        let foreign = extension.as_deref().is_some_and(|extension| ["nir", "net"].contains(&extension))
            || FileKind::detect(path).is_ok_and(|kind| kind == FileKind::Torch);
        // A manifest of recorded spikes is RON as well.
        let written = extension.as_deref() == Some("ron");
        let model = written && io::text::read_text(path).is_ok_and(|text| text.text().contains("Network("));
        path.exists() && (foreign || model)
    };
    let models: Vec<&str> = against.iter().map(String::as_str).filter(is_model).collect();
    if !models.is_empty() && models.len() < against.len() {
        let message = "several --against are all model files, or all recorded spikes";
        return Err(Error::Usage(message.to_string()));
    }
    Ok(models)
}

/// Why networks are not compared: one does not fit, which is an answer, or something cannot be
/// used.
enum Obstacle {
    Refused(Refusal),
    Error(Error),
}

impl<E: Into<Error>> From<E> for Obstacle {
    fn from(error: E) -> Self {
        Obstacle::Error(error.into())
    }
}

impl Obstacle {
    fn say(self, context: Context) -> Result<Answer, Error> {
        match self {
            Obstacle::Refused(refusal) => refusal.say(nsim_report::agree::nothing(), context),
            Obstacle::Error(error) => Err(error),
        }
    }
}

/// A network on simulated cores.
fn deployed(model: &str, network: &Quantised, target: &Target) -> Result<Mapping, Obstacle> {
    match compile(network.clone(), target, &Options::default()) {
        Ok(compiled) => Ok(compiled),
        Err(CompileError::DoesNotFit(reasons)) => Err(Obstacle::Refused(Refusal::new(model, target.clone(), reasons))),
        Err(other) => Err(other.into()),
    }
}

/// A model file on simulated cores.
struct Other {
    name: String,
    role: &'static str,
    cores: usize,
}

/// The network as it was trained, and other files in integers, each compared with it.
fn compared(
    args: &Args,
    (graph, integers): (&Graph, &Quantised),
    files: &[&str],
    samples: &[&Sample],
    (target, context): (&Target, Context),
) -> Result<Vec<(Agreement, Other)>, Obstacle> {
    // A network in real numbers is not mapped: it runs as it was trained.
    let mapped = match is_real(graph) {
        true => None,
        false => Some(deployed(&args.model, integers, target)?),
    };
    let mut all = Vec::new();
    for file in files {
        let (trained, second) = real_and_integers(&args.timestep.load(file)?)?;
        Form::require_written("nsim agree", &second, 1)?;
        let compiled = deployed(file, &second, target)?;
        let first = (graph, integers, mapped.as_ref().map(|mapped| &mapped.program));
        let agreement = output::with_progress(context, samples.len(), "samples", |done| {
            compare_models(first, (&second, &compiled.program), samples, args.steps, done)
        })?;
        output::warn_all(&deployed_warnings(&compiled, samples)?);
        let name = second.parts().name.clone();
        all.push((agreement, Other { name, role: role(&trained), cores: compiled.program.cores().len() }));
    }
    Ok(all)
}

/// A network as it was trained beside another model file.
pub(super) fn with_one(
    args: &Args,
    (graph, integers): (&Graph, &Quantised),
    other: &str,
    (stimulus, samples): (&Stimulus, &[&Sample]),
    (target, context): (&Target, Context),
) -> Result<Answer, Error> {
    let mut all = match compared(args, (graph, integers), &[other], samples, (target, context)) {
        Ok(all) => all,
        Err(obstacle) => return obstacle.say(context),
    };
    let Some((agreement, second)) = all.pop() else { return Ok(Answer::No) };
    let files = draw(args, &graph.facts().name, &agreement.layers, context)?;
    let shown = (stimulus.origin.as_slice(), stimulus.seed, samples.len());
    let two = AgreeReport::of_two([(&graph.facts().name, role(graph)), (&second.name, second.role)], shown, &agreement);
    let report = AgreeReport { files: &files, target: Some(target.name()), ..two };
    report.falls().iter().for_each(|falls| tracing::warn!("{falls}"));
    if args.plot.as_deref().is_none_or(|path| !io::text::is_standard_stream(path)) {
        output::print(context.format, || report.text(), || report.json(), || report.csv())?;
    }
    Ok(answer(args, &report))
}

/// A network as it was trained beside several model files.
pub(super) fn with_several(
    args: &Args,
    (graph, integers): (&Graph, &Quantised),
    files: &[&str],
    (stimulus, samples): (&Stimulus, &[&Sample]),
    (target, context): (&Target, Context),
) -> Result<Answer, Error> {
    if args.plot.is_some() || args.plot_causes.is_some() || args.update.is_some() {
        let message = "--plot, --plot-causes and --update show one comparison: give one --against";
        return Err(Error::Usage(message.to_string()));
    }
    let all = match compared(args, (graph, integers), files, samples, (target, context)) {
        Ok(all) => all,
        Err(obstacle) => return obstacle.say(context),
    };
    let row = |(file, (agreement, other)): (&&str, (Agreement, Other))| Compared {
        against: (*file).to_string(),
        name: other.name,
        cores: other.cores,
        agreement,
    };
    let report = SideBySideReport {
        model: &graph.facts().name,
        input: &stimulus.origin,
        seed: stimulus.seed,
        samples: samples.len(),
        networks: files.iter().zip(all).map(row).collect(),
    };
    output::print(context.format, || report.text(), || report.json(), || report.csv())?;
    let enough = args
        .require_class_agreement
        .is_none_or(|share| report.class_agreement().is_some_and(|agreement| agreement >= share));
    Ok(if enough && (report.exact() || !args.require_exact) { Answer::Yes } else { Answer::No })
}
