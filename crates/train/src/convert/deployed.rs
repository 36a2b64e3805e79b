//! The integers of a network and the trained network: the two that `nsim agree` compares.
//!
//! Input: a network with its analytic integers, how better ones are searched for, samples. Output:
//! [`Integers`], whose stages lead from the trained network to the machine. Omitted on purpose:
//! the comparison itself (`agree`).

use crate::convert::calibration::{self, RunInput};
use crate::convert::search::{self, SearchResult};
use nsim_agree::ladder::Ladder;
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

/// How integers are found.
#[derive(Debug, Clone, Copy)]
pub struct Choice<'a> {
    /// With a search or without.
    pub conversion: Conversion,
    /// Samples to search on; those that [`calibration::stimulus`] chooses when empty.
    pub calibrate: &'a [String],
    /// What the run itself shows.
    pub run: RunInput<'a>,
    /// Number of samples to search on.
    pub wanted: usize,
    /// The most delayed copies of what comes in.
    pub most_copies: usize,
}

/// Integers that represent a network.
#[derive(Debug)]
pub struct Integers {
    /// The converted form of each spike response population.
    pub fits: Vec<Option<Fit>>,
    /// The search, if there was one.
    pub found: Option<SearchResult>,
}

impl Integers {
    /// Finds integers for a network. `searching` gets the populations one by one, and `None`
    /// first where it has to be searched on the samples that are compared.
    ///
    /// # Errors
    /// When a source cannot be used.
    pub fn find(
        (graph, network): (&Graph, &Quantised),
        choice: Choice<'_>,
        samples: &[&Sample],
        mut searching: impl FnMut(Option<&str>),
    ) -> Result<Self> {
        if !graph.has_srm() || choice.conversion == Conversion::Analytic {
            return Ok(Integers { fits: analytic::starts(graph), found: None });
        }
        let stimulus = calibration::stimulus(network, choice.calibrate, choice.run, choice.wanted)?;
        let calibration: Vec<&Sample> = match &stimulus {
            Some(stimulus) => stimulus.samples.iter().take(choice.wanted).collect(),
            None => {
                searching(None);
                samples.iter().take(choice.wanted).copied().collect()
            }
        };
        let found = search::search(graph, &calibration, choice.most_copies, |population| searching(Some(population)))?;
        Ok(Integers { fits: found.conversion.fits.clone(), found: Some(found) })
    }

    /// From the trained network to these integers.
    ///
    /// # Errors
    /// As `nsim_quantise::quantise`.
    pub fn ladder(&self, graph: &Graph) -> Result<Ladder> {
        Ok(match &self.found {
            Some(found) => found.conversion.ladder(graph)?,
            None => Ladder::new(graph, &self.fits)?,
        })
    }
}
