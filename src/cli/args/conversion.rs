//! `--conversion` and `--calibrate`: how a spike response network becomes integers.

use crate::cli::args::input::InputArgs;
use crate::cli::args::values::one_of;
use crate::cli::process::progress;
use nsim_ir::graph::Graph;
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::Sample;
use nsim_session::error::Error;
use nsim_train::convert::calibration::RunInput;
use nsim_train::convert::deployed::{Conversion, ConversionSettings, ConvertedIntegers};
use nsim_train::convert::taps;

/// Limit on the taps, delayed copies of an input, of a conversion.
#[derive(Debug, Clone, clap::Args)]
pub struct TapsArgs {
    /// Most delayed copies of the input of a spike response population, each with synapses of its
    /// own; twice this number where synapses are few
    #[arg(
        long = "delayed-copies",
        help_heading = "Conversion",
        value_name = "N",
        default_value_t = taps::DEFAULT_TAPS as u32,
        value_parser = clap::value_parser!(u32).range(1..=taps::MOST_TAPS as i64)
    )]
    pub most_taps: u32,
}

impl TapsArgs {
    /// The greatest number of taps.
    pub fn most(&self) -> usize {
        self.most_taps as usize
    }
}

/// Method of converting a spike response network to integers, and the samples of its search.
#[derive(Debug, Clone, clap::Args)]
pub struct ConversionArgs {
    /// How a spike response network becomes integers: by a search on samples, or by the analytic
    /// start alone
    #[arg(
        help_heading = "Conversion", long, default_value = "search",
        value_parser = one_of(&Conversion::ALL, Conversion::name)
    )]
    pub conversion: Conversion,
    /// Samples for the search, as --input takes them [default: the scene with another seed, or the
    /// first input samples]
    #[arg(help_heading = "Conversion", long, value_name = "SOURCE")]
    pub calibrate: Vec<String>,
    #[command(flatten)]
    pub taps: TapsArgs,
}

impl ConversionArgs {
    /// The converted form of each spike response population of a network.
    pub fn integers(
        &self,
        graph: &Graph,
        network: &Quantised,
        input: &InputArgs,
        scene: Option<&str>,
        samples: &[&Sample],
        wanted: usize,
    ) -> Result<ConvertedIntegers, Error> {
        let run = RunInput { sources: &input.input, seed: input.seed, scene };
        let choice = ConversionSettings {
            conversion: self.conversion,
            calibrate: &self.calibrate,
            run,
            wanted,
            most_taps: self.taps.most(),
        };
        let _busy = (graph.has_srm() && self.conversion == Conversion::Search)
            .then(|| progress::stage("searching for integers"));
        ConvertedIntegers::find(graph, network, choice, samples, |population| match population {
            Some(population) => tracing::info!("searching '{population}'"),
            None => tracing::warn!("calibrating on the first samples of the input itself; --calibrate gives others"),
        })
    }
}
