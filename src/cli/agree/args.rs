//! Arguments of `nsim agree`, and the last steps that all its comparisons share.
//!
//! Input: the arguments, comparisons. Output: the answer, warnings about the deployed network, the
//! picture of `--plot`.

use std::path::PathBuf;

use crate::cli::args::conversion::ConversionArgs;
use crate::cli::args::input::InputArgs;
use crate::cli::args::reading::ReadingArgs;
use crate::cli::args::recording::{RecordingPair, recording_pair};
use crate::cli::args::values::Switch;
use crate::cli::context::{Answer, Context};
use crate::cli::output;
use nsim_agree::compare::LayerRow;
use nsim_compile::Mapping;
use nsim_ir::base::warning::{Warning, WarningCode};
use nsim_ir::spikes::Sample;
use nsim_report::agree::AgreeReport;
use nsim_report::charts::picture::FILE;
use nsim_session::error::Error;
use nsim_session::warnings::run_warnings;

const EXAMPLES: &str = "\
EXAMPLES:
  nsim agree                                             the shipped spike response network against its conversion
  nsim agree container-tactile --input dataset.ron       a network of Loihi neurons against itself in real numbers
  nsim agree model.ron --input s.npy --against golden --require-exact
  nsim agree model.ron --input in.npy --against hidden=h.npy --against out=o.npy --require-exact
  nsim agree net.nir --from sinabs --check in.npy=out.npy    a file against the spikes of its tool
  nsim agree srm.ron --against converted.ron             the trained network against a model file, on the same input
  nsim agree srm.ron --against converted.ron --against tuned.ron    several model files side by side
  nsim agree srm.ron --against converted.ron --plot first.svg    both potentials around the first spike that differs
  nsim agree --require-class-agreement 0.99 --plot-causes causes.svg";

/// Compare a trained network with its deployed form: spikes, potentials, classes, and the causes of
/// differences
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A model file or the name of a shipped model
    #[arg(value_name = "MODEL", default_value = "vtsnn-slip-srm")]
    pub(super) model: String,
    #[command(flatten)]
    pub(super) reading: ReadingArgs,
    #[command(flatten)]
    pub(super) input: InputArgs,
    /// Counterpart of the deployed network: srm (as trained), cuba (current-based neurons in real
    /// numbers), golden (the reference interpreter), a model file or several, or recorded spikes,
    /// [POPULATION=]FILE [default: srm for spike response networks, else cuba]
    #[arg(long, value_name = "srm|cuba|golden|FILE")]
    pub(super) against: Vec<String>,
    #[command(flatten)]
    pub(super) conversion: ConversionArgs,
    /// Samples to search on
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub(super) calibration_samples: u32,
    /// Compare only this many steps of each sample
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) steps: Option<u32>,
    /// Attribute the disagreement to causes
    #[arg(long, value_enum, default_value = "on")]
    pub(super) attribution: Switch,
    /// Samples that the attribution uses
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub(super) attribution_samples: u32,
    /// Write a bar chart of the causes
    #[arg(long, visible_alias = "svg", value_name = FILE)]
    pub(super) plot_causes: Option<PathBuf>,
    /// Draw both potentials around the first spike that differs
    #[arg(long, value_name = FILE)]
    pub(super) plot: Option<PathBuf>,
    /// Replace the section `<!-- agree MODEL -->` of this document, and write the bar chart next to
    /// it
    #[arg(long, value_name = "FILE.md")]
    pub(super) update: Option<PathBuf>,
    /// The target of the deployed network: a file or the name of a shipped target [default: that of
    /// the model or nahuku-32, or the first that has the model's neurons]
    #[arg(long)]
    pub(super) target: Option<String>,
    /// Exit with status 1 if fewer than this share of the samples have the same class
    #[arg(long, value_name = "SHARE")]
    pub(super) require_class_agreement: Option<f64>,
    /// Exit with status 1 unless every spike is the same
    #[arg(long)]
    pub(super) require_exact: bool,
    /// Compare nothing but the reference engine's spikes with those that the model's tool recorded:
    /// spikes of the input and of the output, as arrays
    #[arg(long, value_name = "IN.npy=OUT.npy", value_parser = recording_pair, conflicts_with_all = ["against", "input"])]
    pub(super) check: Option<RecordingPair>,
}

/// Prints a comparison, unless a file is on stdout, and checks the required bounds. It is not exact
/// if the first network never spikes.
pub(super) fn answer(args: &Args, report: &AgreeReport<'_>, taken: bool, context: Context) -> Result<Answer, Error> {
    report.falls().iter().for_each(|falls| tracing::warn!("{falls}"));
    if !taken {
        output::print(context.format, || report.text(), || report.json(), || report.csv())?;
    }
    let fired = report.layers.iter().any(|row| row.comparison.tally.spikes_a > 0);
    let exact = fired && report.layers.iter().all(|row| row.comparison.first_divergence.is_none());
    Ok(within_bounds(args, report.class_agreement(), exact))
}

/// Returns `Yes` where the share of samples of equal class and, if required, exact spikes are
/// within the bounds.
pub(super) fn within_bounds(args: &Args, class_agreement: Option<f64>, exact: bool) -> Answer {
    let enough = args.require_class_agreement.is_none_or(|share| class_agreement.is_some_and(|is| is >= share));
    if enough && (exact || !args.require_exact) { Answer::Yes } else { Answer::No }
}

/// Warnings about the deployed network, except of rounding, whose cost the comparison reports.
pub(super) fn deployed_warnings(deployed: &Mapping, samples: &[&Sample]) -> Result<Vec<Warning>, Error> {
    let mut warnings = run_warnings(&deployed.quantised, &deployed.program, samples)?;
    warnings.retain(|warning| warning.code != WarningCode::WeightsRounded);
    Ok(warnings)
}

/// Writes the picture of both potentials, where `--plot` names one and a spike differs; returns the
/// written files.
pub(super) fn draw(args: &Args, model: &str, layers: &[LayerRow], context: Context) -> Result<Vec<String>, Error> {
    let Some(path) = &args.plot else { return Ok(Vec::new()) };
    match nsim_report::agree::potentials(model, layers) {
        Some(svg) => {
            output::write_picture(path, &svg, context)?;
            Ok(vec![path.display().to_string()])
        }
        None => {
            tracing::warn!("no difference in spikes has known potentials: {} is not written", path.display());
            Ok(Vec::new())
        }
    }
}
