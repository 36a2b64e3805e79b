//! `--conversion` and `--calibrate`: how a spike response network becomes integers.

use crate::cli::args::input::InputArgs;
use crate::cli::output;
use crate::compile::frontend::analytic::{self, Fit};
use crate::convert::calibration::{self, RunInput};
use crate::convert::copies;
use crate::convert::search::{self, SearchResult};
use crate::error::Error;
use crate::ir::graph::Graph;
use crate::ir::quantised::Quantised;
use crate::ir::spikes::Sample;

/// How a spike response network becomes integers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Conversion {
    /// The analytic start, then a search on calibration samples.
    Search,
    /// The analytic start alone.
    Analytic,
}

/// What a conversion may cost.
#[derive(Debug, Clone, clap::Args)]
pub struct CopiesArgs {
    /// At most so many delayed copies of what comes in to a spike response population, each with synapses of its own; twice as
    /// many where they are few
    #[arg(
        long,
        help_heading = "Conversion",
        value_name = "N",
        default_value_t = copies::USUAL as u32,
        value_parser = clap::value_parser!(u32).range(1..=copies::MOST as i64)
    )]
    pub delayed_copies: u32,
}

impl CopiesArgs {
    /// The greatest number of copies.
    #[must_use]
    pub fn most(&self) -> usize {
        self.delayed_copies as usize
    }
}

/// How a spike response network becomes integers, and on which samples it is searched for.
#[derive(Debug, Clone, clap::Args)]
pub struct ConversionArgs {
    /// How a spike response network becomes integers
    #[arg(help_heading = "Conversion", long, value_enum, default_value = "search")]
    pub conversion: Conversion,
    /// Samples for the search, as --input takes them [default: the scene with another seed, or the first input samples]
    #[arg(help_heading = "Conversion", long, value_name = "SOURCE")]
    pub calibrate: Vec<String>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub copies: CopiesArgs,
}

impl ConversionArgs {
    /// What stands for each spike response population of a network, and the search that found it, if there was one.
    ///
    /// # Errors
    /// [`Error`] when a source cannot be used.
    pub fn fits(
        &self,
        (graph, network): (&Graph, &Quantised),
        input: &InputArgs,
        scene: Option<&str>,
        samples: &[&Sample],
        wanted: usize,
    ) -> Result<(Vec<Option<Fit>>, Option<SearchResult>), Error> {
        if !graph.has_srm() || self.conversion == Conversion::Analytic {
            return Ok((analytic::starts(graph), None));
        }
        let run = RunInput { sources: &input.input, seed: input.seed, scene };
        let stimulus = calibration::stimulus(network, &self.calibrate, run, wanted)?;
        let calibration: Vec<&Sample> = match &stimulus {
            Some(stimulus) => stimulus.samples.iter().take(wanted).collect(),
            None => {
                tracing::warn!("calibrating on the first samples of the input itself; --calibrate gives others");
                samples.iter().take(wanted).copied().collect()
            }
        };
        let _busy = output::busy("searching for integers");
        let found = search::search(graph, &calibration, self.copies.most(), |population| {
            tracing::info!("searching '{population}'");
        })?;
        Ok((found.conversion.fits.clone(), Some(found)))
    }
}
