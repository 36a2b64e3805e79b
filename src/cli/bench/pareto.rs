//! `nsim bench pareto`: run time against error.

use std::path::PathBuf;
use std::time::Duration;

use crate::cli::args::conversion::ConversionArgs;
use crate::cli::args::input::{InputArgs, select};
use crate::cli::args::reading::ReadingArgs;
use crate::cli::args::values;
use crate::cli::context::{Answer, Context};
use crate::cli::output;
use crate::cli::process::progress;
use nsim_compile::refuse_large;
use nsim_files as io;
use nsim_report::bench::pareto::ParetoReport;
use nsim_report::charts::picture::FILE;
use nsim_session::error::Error;
use nsim_session::front::real_and_integers;
use nsim_study::pareto::{Subject, Variant, mark_front};

const EXAMPLES: &str = "\
EXAMPLES:
  nsim bench pareto                                          the shipped network on its shipped scene
  nsim bench pareto container-tactile-srm --input dataset.ron --plot front.svg
  nsim bench pareto --update notes.md --force                replaces the section of this network and its picture";

/// Run time against error: variants of one network (precision, bits, merged steps, early exit) on
/// the same samples
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct ParetoArgs {
    /// A model file or the name of a shipped model
    #[arg(value_name = "MODEL", default_value = "vtsnn-slip")]
    model: String,
    #[command(flatten)]
    reading: ReadingArgs,
    #[command(flatten)]
    input: InputArgs,
    #[command(flatten)]
    conversion: ConversionArgs,
    /// Seconds of measurement per variant, at least five repeats
    #[arg(long, value_name = "S", default_value = "0.5", value_parser = values::seconds)]
    seconds: Duration,
    /// The target: a file or the name of a shipped target
    #[arg(long, default_value = "nahuku-32")]
    target: String,
    /// Write a chart with the Pareto front
    #[arg(long, visible_alias = "svg", value_name = FILE)]
    plot: Option<PathBuf>,
    /// Replace the section `<!-- pareto MODEL -->` of this document, and write the chart next to it
    #[arg(long, value_name = "FILE.md")]
    update: Option<PathBuf>,
}

/// Samples of the search of a conversion.
const CALIBRATION_SAMPLES: usize = 100;

/// The answer is no when a variant that claims to be exact is not.
pub fn run(args: &ParetoArgs, context: Context) -> Result<Answer, Error> {
    let taken = output::check_files(None, &args.plot, context)?;
    let environment = output::environment();
    let network = args.reading.load(&args.model)?;
    let scene = network.file().scene.clone();
    let (graph, analytic) = real_and_integers(&network)?;
    refuse_large("nsim bench pareto", &analytic, 1)?;
    let stimulus = args.input.stimulus(&analytic, scene.as_deref())?;
    let samples = select(&stimulus.samples, &args.input)?;
    let count = samples.len();
    let integers =
        args.conversion.integers(&graph, &analytic, &args.input, scene.as_deref(), &samples, CALIBRATION_SAMPLES)?;
    let target = io::target::load_target(&args.target)?;
    let subject = Subject::new(&graph, &integers.fits, &target, samples, args.seconds)?;
    let variants = Variant::all(graph.has_srm());
    let mut rows = progress::with_bar(context, variants.len(), "variants", |done| {
        let measured = variants.into_iter().map(|variant| subject.measure(variant));
        measured.inspect(|_| done()).collect::<Result<Vec<_>, _>>()
    })?;
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
    if let Some(path) = &args.plot {
        output::write_picture(path, &report.svg(), context)?;
    }
    if let Some(path) = &args.update {
        let picture = format!("pareto-{name}.svg");
        let (mark, section) = (format!("pareto {name}"), report.markdown(&picture));
        output::update_section(path, &mark, &section, Some((&picture, &report.svg())), context)?;
    }
    if !taken {
        output::print(context.format, || report.text(), || report.json(), || report.csv())?;
    }
    Ok(if rows.iter().all(|row| row.exact != Some(false)) { Answer::Yes } else { Answer::No })
}
