//! How far the integers of a network are from what was trained, and why: `nsim agree`.
//!
//! Input: a network, spikes, and what it is held against. Output: an [`Agreement`], whose figures
//! are those of the command line. Left out on purpose: comparisons with recordings and other
//! models, which the command line has.

use nsim::agree::attribution::attribute;
use nsim::agree::compare::{Counterpart, Deployed, compare, output_layer};
use nsim::compile::{Form, Options, compile};
use nsim::files::network::Network;
use nsim::report::agree::{AgreeReport, named_fits};
use nsim::session::front::real_and_integers;
use nsim::train::convert::calibration::RunInput;
use nsim::train::convert::copies::{MOST, USUAL};
use nsim::train::convert::deployed::{Choice, Conversion, Integers};
use pyo3::prelude::*;
use serde_json::Value;

use crate::error::raised;
use crate::html::{columns, frame, table};
use crate::keywords::{Keywords, usage};
use crate::spikes::{Shown, sources};
use crate::value::to_python;
use crate::work::{detached, work};

/// Where and why two networks disagree.
#[pyclass(frozen, module = "nsim")]
pub struct Agreement {
    json: Value,
    text: String,
}

/// Samples that a search or an attribution may take, as on the command line.
pub const MOST_SAMPLES: usize = 100_000;

/// A number from 1 to `most`.
pub fn counted(keywords: &Keywords<'_>, name: &str, usual: usize, most: usize) -> PyResult<usize> {
    Ok(keywords.whole(name, 1..=most as u64)?.map_or(usual, |number| number as usize))
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
        let (graph, written) = detached(py, || real_and_integers(network)).map_err(|problem| raised(py, problem))?;
        Form::require_written("agree", &written, 1).map_err(|problem| raised(py, problem))?;
        let target = nsim::load_target(target).map_err(|problem| raised(py, problem))?;
        let against = match keywords.take::<String>("against")?.as_deref() {
            None if graph.has_srm() => Counterpart::Srm,
            Some("srm") if graph.has_srm() => Counterpart::Srm,
            None | Some("cuba") => Counterpart::Cuba,
            Some("golden") => Counterpart::Golden,
            Some("srm") => {
                let message = "against='srm': the network has no spike response neurons".to_string();
                return Err(usage(message, "compare it with against='cuba' or against='golden'"));
            }
            Some(other) => {
                let message = format!("against is '{other}', which is not known");
                return Err(usage(message, "against is one of srm, cuba, golden"));
            }
        };
        let conversion = keywords.one_of("conversion", &Conversion::ALL, Conversion::name)?;
        let conversion = conversion.unwrap_or(Conversion::Search);
        let calibrate = sources(keywords.take("calibrate")?.as_ref())?;
        let wanted = counted(keywords, "calibration_samples", 60, MOST_SAMPLES)?;
        let copies = counted(keywords, "delayed_copies", USUAL, MOST)?;
        let steps = keywords.whole("steps", 1..=u32::MAX.into())?.map(|steps| steps as u32);
        let attributed = counted(keywords, "attribution_samples", 100, MOST_SAMPLES)?;
        let most = if keywords.take("attribution")?.unwrap_or(true) { attributed } else { 0 };
        let scene = network.file().scene.as_deref();
        let shown = Shown::new(&written, scene, spikes, keywords)?;
        keywords.none_left()?;
        work(py, true, |progress| {
            let samples = shown.samples();
            let run = RunInput { sources: &shown.stimulus.origin, seed: shown.stimulus.seed, scene };
            let choice = Choice { conversion, calibrate: &calibrate, run, wanted, most_copies: copies };
            let integers = Integers::find((&graph, &written), choice, &samples, |_| progress())?;
            let (fits, ladder) = (&integers.fits, integers.ladder(&graph)?);
            let program = &compile(ladder.deployed().clone(), &target, &Options::default())?.program;
            let deployed = Deployed { graph: &graph, fits, ladder: &ladder, program, samples: &samples, steps };
            let agreement = compare(deployed, &against, progress)?;
            let some = &samples[..samples.len().min(most)];
            let attribution =
                (against.is_real() && most > 0).then(|| attribute(&ladder, &output_layer(ladder.deployed()), some));
            let seen = (shown.stimulus.origin.as_slice(), shown.stimulus.seed, samples.len());
            let report = AgreeReport {
                found: integers.found.as_ref(),
                fits: &named_fits(&graph, fits),
                attribution: attribution.as_ref(),
                attribution_samples: some.len(),
                ..AgreeReport::of_two((&graph.facts().name, against.name()), seen, &agreement)
            };
            Ok(Agreement { json: report.json(), text: report.text() })
        })
    }
}

#[pymethods]
impl Agreement {
    /// The share of samples that both networks put in the same class; None where neither has
    /// classes.
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

    /// The layers as a data frame of pandas, or of polars where only that is installed.
    fn table<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        frame(py, &self.json["layers"])
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
        table(&self.__repr__().replace(['<', '>'], ""), &columns(layers), layers)
    }
}
