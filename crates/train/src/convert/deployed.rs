//! A network's integers and the trained network, for the comparison by `nsim agree`.
//!
//! Input: a network with its analytic integers, the settings of a search for better ones, samples.
//! Output: [`ConvertedIntegers`], whose stages lead from the trained network to the machine.
//! Omitted on purpose: the comparison itself (`agree`).

use crate::convert::calibration::{self, RunInput};
use crate::convert::search::{self, SearchResult};
use nsim_agree::staged::StagedNetwork;
use nsim_ir::base::names::named_variants;
use nsim_ir::graph::Graph;
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::Sample;
use nsim_quantise::analytic::{self, Fit};
use nsim_session::error::Result;

/// How a spike response network becomes integers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Conversion {
    /// The analytic start, then a search on calibration samples.
    Search,
    /// The analytic start alone.
    Analytic,
}

named_variants!(Conversion { Search = "search", Analytic = "analytic" });

/// Settings of a conversion.
#[derive(Debug, Clone, Copy)]
pub struct ConversionSettings<'a> {
    /// The conversion, with a search or without.
    pub conversion: Conversion,
    /// Samples for the search; [`calibration::stimulus`] chooses them if empty.
    pub calibrate: &'a [String],
    /// Input of the compared run.
    pub run: RunInput<'a>,
    /// Number of samples for the search.
    pub wanted: usize,
    /// Most taps of a population's input.
    pub most_taps: usize,
}

/// Integers that represent a network.
#[derive(Debug)]
pub struct ConvertedIntegers {
    /// The converted form of each spike response population.
    pub fits: Vec<Option<Fit>>,
    /// Result of the search, if there was one.
    pub found: Option<SearchResult>,
}

impl ConvertedIntegers {
    /// Finds integers for a network. `searching` receives the name of each population, and first
    /// `None` if the search has to use the compared samples.
    ///
    /// # Errors
    /// A source that cannot be used.
    pub fn find(
        graph: &Graph,
        network: &Quantised,
        choice: ConversionSettings<'_>,
        samples: &[&Sample],
        mut searching: impl FnMut(Option<&str>),
    ) -> Result<Self> {
        if !graph.has_srm() || choice.conversion == Conversion::Analytic {
            return Ok(ConvertedIntegers { fits: analytic::starts(graph), found: None });
        }
        let stimulus = calibration::stimulus(network, choice.calibrate, choice.run, choice.wanted)?;
        let calibration: Vec<&Sample> = match &stimulus {
            Some(stimulus) => stimulus.samples.iter().take(choice.wanted).collect(),
            None => {
                searching(None);
                samples.iter().take(choice.wanted).copied().collect()
            }
        };
        let search_result =
            search::search(graph, &calibration, choice.most_taps, |population| searching(Some(population)))?;
        Ok(ConvertedIntegers { fits: search_result.conversion.fits.clone(), found: Some(search_result) })
    }

    /// The comparison stages from the trained network to these integers.
    ///
    /// # Errors
    /// As `nsim_quantise::quantise`.
    pub fn staged(&self, graph: &Graph) -> Result<StagedNetwork> {
        Ok(match &self.found {
            Some(found) => found.conversion.staged(graph)?,
            None => StagedNetwork::new(graph, &self.fits)?,
        })
    }
}
