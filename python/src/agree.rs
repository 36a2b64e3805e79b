//! How far the integers of a network are from what was trained, and why: `nsim agree`.
//!
//! Input: a network, spikes, and what it is held against. Output: an [`Agreement`], whose figures are those of the command line. Left
//! out on purpose: comparisons with recordings and other models, which the command line has.

use nsim::agree::attribution::attribute;
use nsim::agree::compare::{Counterpart, Deployed, compare, output_layer};
use nsim::agree::ladder::Ladder;
use nsim::compile::frontend::{analytic, real_and_integers};
use nsim::compile::{Form, Options, compile};
use nsim::convert::calibration::{self, RunInput};
use nsim::convert::copies::{MOST, USUAL};
use nsim::convert::search::search;
use nsim::desc::network::Network;
use nsim::ir::spikes::Sample;
use nsim::report::agree::{AgreeReport, named_fits};
use pyo3::prelude::*;
use serde_json::Value;

use crate::error::raised;
use crate::html::table;
use crate::keywords::{Keywords, usage};
use crate::run::to_python;
use crate::spikes::Shown;
use crate::work::work;

/// Where and why two networks disagree.
#[pyclass(frozen, module = "nsim")]
pub struct Agreement {
    json: Value,
    text: String,
}

/// How a spike response network becomes integers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Conversion {
    Search,
    Analytic,
}

/// Samples that a search or an attribution may take, as on the command line.
const MOST_SAMPLES: usize = 100_000;

/// A number from 1 to `most`.
fn counted(keywords: &Keywords<'_>, name: &str, usual: usize, most: usize) -> PyResult<usize> {
    match keywords.take(name)?.unwrap_or(usual) {
        number if (1..=most).contains(&number) => Ok(number),
        number => Err(usage(format!("{name} is from 1 to {most}, not {number}"))),
    }
}

impl Agreement {
    /// Compares a network with its integers on a target.
    pub fn new(
        py: Python<'_>,
        network: &Network,
        target: &str,
        spikes: Option<&Bound<'_, PyAny>>,
        keywords: &Keywords<'_>,
    ) -> PyResult<Self> {
        let (graph, written) = py.detach(|| real_and_integers(network)).map_err(|problem| raised(py, problem))?;
        Form::require_written("agree", &written, 1).map_err(|problem| raised(py, problem))?;
        let target = nsim::load_target(target).map_err(|problem| raised(py, problem))?;
        let against = match keywords.take::<String>("against")?.as_deref() {
            None if graph.has_srm() => Counterpart::Srm,
            Some("srm") if graph.has_srm() => Counterpart::Srm,
            None | Some("cuba") => Counterpart::Cuba,
            Some("golden") => Counterpart::Golden,
            Some("srm") => return Err(usage("against='srm': the network has no spike response neurons".into())),
            Some(other) => return Err(usage(format!("against is one of srm, cuba, golden, not '{other}'"))),
        };
        let conversions = [Conversion::Search, Conversion::Analytic];
        let name = |one| if one == Conversion::Search { "search" } else { "analytic" };
        let conversion = keywords.one_of("conversion", &conversions, name)?.unwrap_or(Conversion::Search);
        let wanted = counted(keywords, "calibration_samples", 60, MOST_SAMPLES)?;
        let copies = counted(keywords, "delayed_copies", USUAL, MOST)?;
        let steps: Option<u32> = keywords.take("steps")?;
        if steps == Some(0) {
            return Err(usage("steps is at least 1".into()));
        }
        let attributed = counted(keywords, "attribution_samples", 100, MOST_SAMPLES)?;
        let most = if keywords.take("attribution")?.unwrap_or(true) { attributed } else { 0 };
        let scene = network.file().scene.as_deref();
        let shown = Shown::new(&written, scene, spikes, keywords)?;
        keywords.none_left()?;
        work(py, true, |progress| {
            let samples = shown.samples();
            let found = match graph.has_srm() && conversion == Conversion::Search {
                false => None,
                true => {
                    let run = RunInput { sources: &shown.stimulus.origin, seed: shown.stimulus.seed, scene };
                    let others = calibration::stimulus(&written, &[], run, wanted)?;
                    let chosen: Vec<&Sample> = match &others {
                        Some(others) => others.samples.iter().take(wanted).collect(),
                        None => samples.iter().take(wanted).copied().collect(),
                    };
                    Some(search(&graph, &chosen, copies, |_| ())?)
                }
            };
            let (fits, ladder) = match &found {
                Some(found) => (found.conversion.fits.clone(), found.conversion.ladder(&graph)?),
                None => {
                    let starts = analytic::starts(&graph);
                    let ladder = Ladder::new(&graph, &starts)?;
                    (starts, ladder)
                }
            };
            let program = &compile(ladder.deployed().clone(), &target, &Options::default())?.program;
            let deployed = Deployed { graph: &graph, fits: &fits, ladder: &ladder, program, samples: &samples, steps };
            let agreement = compare(deployed, &against, progress)?;
            let some = &samples[..samples.len().min(most)];
            let attribution =
                (against.is_real() && most > 0).then(|| attribute(&ladder, &output_layer(ladder.deployed()), some));
            let report = AgreeReport {
                model: &graph.facts().name,
                against: against.name(),
                input: &shown.stimulus.origin,
                seed: shown.stimulus.seed,
                samples: samples.len(),
                same_class: agreement.same_class,
                accuracy: agreement.accuracy,
                layers: &agreement.layers,
                found: found.as_ref(),
                fits: &named_fits(&graph, &fits),
                attribution: attribution.as_ref(),
                attribution_samples: some.len(),
            };
            Ok(Agreement { json: report.json(), text: report.text() })
        })
    }
}

#[pymethods]
impl Agreement {
    /// The share of samples that both networks put in the same class; None where neither has classes.
    #[getter]
    fn class_agreement(&self) -> Option<f64> {
        self.json["class_agreement"].as_f64()
    }

    /// Layer by layer, a dictionary each: how far spikes and potentials differ.
    #[getter]
    fn layers<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.json["layers"])
    }

    /// The causes of the disagreement, a dictionary each.
    #[getter]
    fn attribution<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.json["attribution"])
    }

    /// The object that `nsim agree --format json` prints.
    fn json<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.json)
    }

    fn __repr__(&self) -> String {
        let share = self.class_agreement().map_or("unknown".to_string(), |share| format!("{share:.4}"));
        format!("<nsim.Agreement {}: class agreement {share}>", self.json["model"].as_str().unwrap_or_default())
    }

    fn __str__(&self) -> String {
        self.text.clone()
    }

    /// The layers as a table for notebooks.
    fn _repr_html_(&self) -> String {
        let layers = self.json["layers"].as_array().map_or(&[][..], Vec::as_slice);
        let keys = layers.first().and_then(Value::as_object);
        let columns: Vec<&str> = keys.map_or_else(Vec::new, |keys| {
            keys.iter()
                .filter(|(_, value)| !value.is_object() && !value.is_array())
                .map(|(key, _)| key.as_str())
                .collect()
        });
        table(&self.__repr__().replace(['<', '>'], ""), &columns, layers)
    }
}
