//! Disagreement of the integers of a network with its trained form, and its causes: `nsim agree`.
//!
//! Input: a network, spikes, and its counterpart. Output: an [`Agreement`] with the figures of the
//! command line. Only the command line compares with recordings.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use nsim::agree::attribution::attribute;
use nsim::agree::compare::{Counterpart, DeployedNetwork, LayerRow, compare, compare_models, output_layer};
use nsim::compile::{CompileError, refuse_large};
use nsim::files::network::Network;
use nsim::files::target::target_with_neurons;
use nsim::files::write::check_free;
use nsim::files::{shipped, write};
use nsim::ir::base::diagnostic::Diagnostic;
use nsim::ir::graph::Graph;
use nsim::ir::hardware::Target;
use nsim::ir::quantised::Quantised;
use nsim::report::agree::{AgreeReport, converted_from, named_fits, potentials, role};
use nsim::session::front::real_and_integers;
use nsim::session::obtain::map_with_defaults;
use nsim::session::samples::Progress;
use nsim::train::convert::calibration::RunInput;
use nsim::train::convert::deployed::{Conversion, ConversionSettings, ConvertedIntegers};
use nsim::train::convert::next::suggest_in_python;
use nsim::train::convert::staged::is_real;
use nsim::train::convert::taps::{DEFAULT_TAPS, MOST_TAPS};
use pyo3::prelude::*;
use serde_json::Value;

use crate::error::{exception, in_python, issue_warning, warn};
use crate::html::{columns, frame, table};
use crate::keywords::{Keywords, usage};
use crate::spikes::{NetworkInput, sources};
use crate::value::to_python;
use crate::work::{try_detached, work};

/// Disagreement of two networks, and its causes.
#[pyclass(frozen, module = "nsim")]
pub struct Agreement {
    json: Value,
    text: String,
}

/// Most samples of a search or an attribution, as on the command line.
pub const MOST_SAMPLES: usize = 100_000;

/// A keyword from 1 to `most`, `usual` without it.
pub fn count_keyword(keywords: &Keywords<'_>, name: &str, usual: usize, most: usize) -> PyResult<usize> {
    Ok(keywords.whole(name, 1..=most as u64)?.map_or(usual, |number| number as usize))
}

/// Keywords of a comparison, without those of its input.
struct Settings {
    conversion: Conversion,
    calibrate: Vec<String>,
    calibration_samples: usize,
    most_taps: usize,
    steps: Option<u32>,
    /// Most samples of the attribution; 0 without one.
    attribution_samples: usize,
    plot: Option<PathBuf>,
    force: bool,
}

impl Settings {
    fn read(py: Python<'_>, keywords: &Keywords<'_>, extract_network: NetworkExtractor) -> PyResult<Self> {
        let given: Option<Bound<'_, PyAny>> = keywords.only("conversion")?.take("conversion")?;
        if given.is_some_and(|given| extract_network(&given).is_some()) {
            let message =
                "conversion is a network, but it selects how spike response neurons become integers".to_string();
            return Err(usage(message, "give the network or the nsim.Conversion as against="));
        }
        let conversion = keywords.one_of("conversion", &Conversion::ALL, Conversion::name)?;
        let mut settings = Settings {
            conversion: conversion.unwrap_or(Conversion::Search),
            calibrate: sources(keywords.take("calibrate")?.as_ref())?,
            calibration_samples: count_keyword(keywords, "calibration_samples", 60, MOST_SAMPLES)?,
            most_taps: count_keyword(keywords, "delayed_copies", DEFAULT_TAPS, MOST_TAPS)?,
            steps: keywords.whole("steps", 1..=u32::MAX.into())?.map(|steps| steps as u32),
            attribution_samples: count_keyword(keywords, "attribution_samples", 100, MOST_SAMPLES)?,
            plot: None,
            force: false,
        };
        if !keywords.take("attribution")?.unwrap_or(true) {
            settings.attribution_samples = 0;
        }
        settings.plot = keywords.take("plot")?;
        settings.force = keywords.take("force")?.unwrap_or(false);
        if let Some(path) = &settings.plot {
            if path.extension().is_none_or(|extension| extension != "svg") {
                let message = format!("plot is {}, which does not end in .svg", path.display());
                return Err(usage(message, "name a file that ends in .svg"));
            }
            check_free(path, settings.force).map_err(|problem| exception(py, problem))?;
        }
        Ok(settings)
    }
}

/// The counterpart of a keyword, which is no network.
fn counterpart(word: Option<&str>, graph: &Graph) -> PyResult<Counterpart> {
    match word {
        None | Some("srm") if graph.has_srm() => Ok(Counterpart::Srm),
        None | Some("cuba") => Ok(Counterpart::Cuba),
        Some("golden") => Ok(Counterpart::Golden),
        Some("srm") => {
            let message = "against='srm': the network has no spike response neurons".to_string();
            Err(usage(message, "compare it with against='cuba' or against='golden'"))
        }
        Some(other) => {
            let message = format!("against is '{other}', which is neither a keyword nor a model file");
            let help = "against is one of srm, cuba, golden, a model file, an nsim.Network or an nsim.Conversion";
            Err(usage(message, help))
        }
    }
}

impl Agreement {
    /// Compares a network with its integers on a target.
    pub fn new(
        py: Python<'_>,
        network: &Network,
        target: Option<&str>,
        spikes: Option<&Bound<'_, PyAny>>,
        keywords: &Keywords<'_>,
        extract_network: NetworkExtractor,
    ) -> PyResult<Self> {
        let (graph, written) = try_detached(py, || real_and_integers(network))?;
        refuse_large("agree", &written, 1).map_err(|problem| exception(py, problem))?;
        let against: Option<Bound<'_, PyAny>> = keywords.take("against")?;
        let other = against.as_ref().map(|given| model(py, given, extract_network)).transpose()?.flatten();
        // A network in real numbers is not mapped; its counterpart is.
        let deployed = other.as_ref().filter(|_| is_real(&graph)).map_or(network, |(other, ..)| other);
        let (on, instead) = target_with_neurons(deployed.file(), target).map_err(|problem| exception(py, problem))?;
        let named_target = target.map(str::to_string).or_else(|| instead.as_ref().map(|_| on.name().to_string()));
        let word = match &other {
            Some(_) => None,
            None => against.map(|given| given.extract::<String>()).transpose()?,
        };
        let against = counterpart(word.as_deref(), &graph)?;
        let settings = Settings::read(py, keywords, extract_network)?;
        let scene = network.file().scene.as_deref();
        let input = NetworkInput::new(&written, scene, spikes, keywords)?;
        keywords.refuse_unread()?;
        let (agreement, falls) = work(py, true, |progress| {
            let (graph, written, target) = (&graph, &written, &on);
            let comparison = Comparison { graph, written, target, scene, input: &input, settings: &settings, progress };
            match &other {
                Some(other) => comparison.with_network(other),
                None => comparison.with_counterpart(&against, named_target.as_deref()),
            }
        })?;
        instead.iter().chain(&falls).try_for_each(|warning| issue_warning(py, warning))?;
        Ok(agreement)
    }
}

/// A network to be compared: its integers, its input and its target.
struct Comparison<'c> {
    graph: &'c Graph,
    written: &'c Quantised,
    target: &'c Target,
    scene: Option<&'c str>,
    input: &'c NetworkInput,
    settings: &'c Settings,
    progress: Progress<'c>,
}

impl Comparison<'_> {
    fn name(&self) -> &str {
        &self.graph.facts().name
    }

    fn described_input(&self) -> (&[String], Option<u64>, usize) {
        let stimulus = &self.input.stimulus;
        (&stimulus.origin, stimulus.seed, self.input.order.len())
    }

    fn with_network(&self, (_, kind, other): &ComparedNetwork) -> Result<(Agreement, Option<String>), nsim::Error> {
        let Comparison { graph, written, target, .. } = *self;
        refuse_large("agree", other, 1)?;
        let own = match is_real(graph) {
            true => None,
            false => Some(map_with_defaults(written.clone(), target)?.program),
        };
        let second = map_with_defaults(other.clone(), target);
        let second = second.map_err(|problem| does_not_fit(&problem, target.name()))?;
        let first = (graph, written, own.as_ref());
        let (samples, steps) = (self.input.samples(), self.settings.steps);
        let agreement = compare_models(first, (other, &second.program), &samples, steps, self.progress)?;
        let names = [(self.name(), role(graph)), (other.parts().name.as_str(), *kind)];
        self.finish(AgreeReport::for_two_networks(names, self.described_input(), &agreement), &agreement.layers)
    }

    /// Compares the deployed network with a form of its own; `named_target` is the target of the
    /// suggested call.
    fn with_counterpart(
        &self,
        against: &Counterpart,
        named_target: Option<&str>,
    ) -> Result<(Agreement, Option<String>), nsim::Error> {
        let Comparison { graph, written, settings, progress, .. } = *self;
        let (samples, stimulus) = (self.input.samples(), &self.input.stimulus);
        let choice = ConversionSettings {
            conversion: settings.conversion,
            calibrate: &settings.calibrate,
            run: RunInput { sources: &stimulus.origin, seed: stimulus.seed, scene: self.scene },
            wanted: settings.calibration_samples,
            most_taps: settings.most_taps,
        };
        let integers = ConvertedIntegers::find(graph, written, choice, &samples, |_| progress())?;
        let (fits, staged) = (&integers.fits, integers.staged(graph)?);
        let program = &map_with_defaults(staged.deployed().clone(), self.target)?.program;
        let steps = settings.steps;
        let deployed = DeployedNetwork { graph, fits, staged: &staged, program, samples: &samples, steps };
        let agreement = compare(deployed, against, progress)?;
        let some = &samples[..samples.len().min(settings.attribution_samples)];
        let attribution = (against.is_real() && settings.attribution_samples > 0)
            .then(|| attribute(&staged, &output_layer(staged.deployed()), some));
        let next = attribution.as_ref().and_then(|attribution| suggest_in_python(attribution, named_target));
        let trained = converted_from(graph).filter(|_| matches!(against, Counterpart::Cuba));
        let closer = "network.agree(spikes, against=conversion), of the network that was converted";
        let report = AgreeReport {
            found: integers.found.as_ref(),
            fits: &named_fits(graph, fits),
            attribution: attribution.as_ref(),
            attribution_samples: some.len(),
            next: next.as_ref(),
            source: trained.map(|trained| (trained, closer.to_string())),
            ..AgreeReport::for_counterpart((self.name(), against.name()), self.described_input(), &agreement)
        };
        self.finish(report, &agreement.layers)
    }

    /// Draws the potentials; returns the agreement, and a warning where accuracy falls.
    fn finish(&self, report: AgreeReport<'_>, layers: &[LayerRow]) -> Result<(Agreement, Option<String>), nsim::Error> {
        if let (Some(path), Some(svg)) = (&self.settings.plot, potentials(self.name(), layers)) {
            write::text(path, self.settings.force, &svg)?;
        }
        let report = AgreeReport { target: Some(self.target.name()), ..report };
        Ok((Agreement { json: report.json(), text: report.text() }, report.falls()))
    }
}

/// Error for another network that does not fit on the target of this one.
fn does_not_fit(problem: &CompileError, target: &str) -> nsim::Error {
    let message = format!("the network of against= does not run on {target}: {problem}");
    let help = "give target=, or call agree of that network, with this one as against=";
    Diagnostic::new("usage", message).help(help).into()
}

/// Returns the network of an `nsim.Network` or an `nsim.Conversion`; none for another object.
pub type NetworkExtractor = fn(&Bound<'_, PyAny>) -> Option<Arc<Network>>;

/// A network to compare with, its role, and its integers.
type ComparedNetwork = (Arc<Network>, &'static str, Quantised);

/// The network of an `nsim.Network`, an `nsim.Conversion` or a model file; none for other text.
fn model(
    py: Python<'_>,
    given: &Bound<'_, PyAny>,
    extract_network: NetworkExtractor,
) -> PyResult<Option<ComparedNetwork>> {
    let loaded = match (extract_network(given), given.extract::<PathBuf>()) {
        (Some(network), _) => network,
        (_, Ok(path)) if path.exists() || shipped::MODELS.iter().any(|known| Path::new(known.name) == path) => {
            let name = path.to_string_lossy().into_owned();
            Arc::new(try_detached(py, || nsim::load_model(&name))?)
        }
        (_, Ok(_)) => return Ok(None),
        (_, Err(_)) => {
            let message = "against is neither text nor a network".to_string();
            return Err(usage(message, "give srm, cuba, golden, a model file, an nsim.Network or an nsim.Conversion"));
        }
    };
    let (graph, integers) = try_detached(py, || real_and_integers(&loaded))?;
    if given.extract::<PathBuf>().is_ok() {
        warn(py, &in_python(integers.parts().warnings.clone()), &[])?;
    }
    Ok(Some((loaded, role(&graph), integers)))
}

#[pymethods]
impl Agreement {
    /// The share of samples that both networks put in the same class; None where neither has
    /// classes.
    #[getter]
    fn class_agreement(&self) -> Option<f64> {
        self.json["class_agreement"].as_f64()
    }

    /// A dictionary for each layer, with the differences of spikes and potentials.
    #[getter]
    fn layers<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.json["layers"])
    }

    /// A dictionary for each cause of the disagreement.
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

    /// Layers and causes as tables for notebooks.
    fn _repr_html_(&self) -> String {
        let rows = |key: &str| self.json[key].as_array().map_or(&[][..], Vec::as_slice);
        let layers = table(&self.__repr__().replace(['<', '>'], ""), &columns(rows("layers")), rows("layers"));
        match rows("attribution") {
            [] => layers,
            causes => layers + &table("why", &columns(causes), causes),
        }
    }
}
