//! `nsim bench pareto`: run time against error.

use std::path::PathBuf;
use std::time::Duration;

use crate::base::diagnostic::Diagnostic;
use crate::bench::Environment;
use crate::bench::pareto::{ParetoError, Subject, Variant, mark_front};
use crate::cli::args::conversion::{Conversion, fits};
use crate::cli::args::input::{InputArgs, select};
use crate::cli::args::inputs;
use crate::cli::args::values;
use crate::cli::context::{Answer, Context};
use crate::cli::output;
use crate::compile::Form;
use crate::compile::frontend::real_and_integers;
use crate::error::Error;
use crate::io;
use crate::report::bench::pareto::ParetoReport;

const EXAMPLES: &str = "\
EXAMPLES:
  nsim bench pareto                                          the shipped network on its shipped scene
  nsim bench pareto container-tactile-srm --input dataset.ron --svg front.svg
  nsim bench pareto --update docs/benchmarks.md --force      replaces the section of this network and its picture";

/// Run time against error: one network in many forms (precision, bits, merged steps, early exit), on the same samples
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct ParetoArgs {
    /// A model file or the name of a shipped model
    #[arg(value_name = "MODEL", default_value = "vtsnn-slip")]
    model: String,
    #[command(flatten)]
    input: InputArgs,
    /// How a spike response network becomes integers
    #[arg(long, value_enum, default_value = "search")]
    conversion: Conversion,
    /// Samples to search on, as --input takes them [default: the scene with another seed, or the first of the input]
    #[arg(long, value_name = "SOURCE")]
    calibrate: Vec<String>,
    /// Seconds that each variant is measured for, five repeats at least
    #[arg(long, value_name = "S", default_value = "0.5", value_parser = values::seconds)]
    seconds: Duration,
    /// A target file or the name of a shipped target, onto which the network is mapped
    #[arg(long, default_value = "nahuku-32")]
    target: String,
    /// A chart with the front
    #[arg(long, value_name = "FILE.svg")]
    svg: Option<PathBuf>,
    /// A document whose section `<!-- pareto MODEL -->` is replaced; the chart goes beside it
    #[arg(long, value_name = "FILE.md")]
    update: Option<PathBuf>,
}

impl From<ParetoError> for Error {
    fn from(error: ParetoError) -> Self {
        match error {
            ParetoError::Input(diagnostic) => diagnostic.into(),
            ParetoError::Compile(error) => error.into(),
            ParetoError::Variant(message) => Diagnostic::new("pareto.variant", message).into(),
        }
    }
}

/// The command; the answer is no when a variant that claims to be exact is not.
///
/// # Errors
/// [`Error`] when an input cannot be used.
pub fn run(args: &ParetoArgs, context: Context) -> Result<Answer, Error> {
    if let Some(svg) = &args.svg {
        io::write::check_free(svg, context.force)?;
    }
    let environment = Environment::here();
    if environment.profile == "debug" {
        tracing::warn!("this nsim was built without --release; its times mean nothing");
    }
    let network = io::model::load_model(&args.model)?;
    let scene = network.file().scene.clone();
    let (graph, analytic) = real_and_integers(&network)?;
    Form::require_written("nsim bench pareto", &analytic, 1)?;
    let stimulus = inputs::stimulus(&analytic, &args.input.input, scene.as_deref(), args.input.seed)?;
    let samples = select(&stimulus.samples, &args.input)?;
    let count = samples.len();
    let (fits, _) =
        fits(args.conversion, &args.calibrate, 100, &args.input, &graph, &analytic, scene.as_deref(), &samples)?;
    let target = io::target::load_target(&args.target)?;
    let subject = Subject::new(&graph, &fits, &target, samples, args.seconds)?;
    let variants = Variant::all(graph.has_srm());
    let bar = output::progress(context, variants.len() as u64, "variants");
    let mut rows = Vec::new();
    for variant in variants {
        rows.push(subject.measure(variant)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    mark_front(&mut rows);
    let name = &graph.facts().name;
    let report = ParetoReport {
        model: name,
        input: &stimulus.origin,
        seed: stimulus.seed,
        samples: count,
        environment: &environment,
        rows: &rows,
    };
    if let Some(path) = &args.svg {
        io::write::file(path, context.force, |out| out.write_all(report.svg().as_bytes()))?;
    }
    if let Some(path) = &args.update {
        let picture = format!("pareto-{name}.svg");
        output::update_section(
            path,
            &format!("pareto {name}"),
            &report.markdown(&picture),
            &picture,
            &report.svg(),
            context,
        )?;
    }
    output::print(context.format, || report.text(), || report.json(), || report.csv())?;
    Ok(if rows.iter().all(|row| row.exact != Some(false)) { Answer::Yes } else { Answer::No })
}
