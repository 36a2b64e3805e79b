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
use nsim::files::shipped;
use nsim::files::target::target_with_neurons;
use nsim::files::write;
use nsim::files::write::check_free;
use nsim::ir::base::diagnostic::Diagnostic;
use nsim::ir::quantised::Quantised;
use nsim::report::agree::{AgreeReport, converted_from, named_fits, potentials, role};
use nsim::session::front::real_and_integers;
use nsim::session::obtain::map_with_defaults;
use nsim::train::convert::calibration::RunInput;
use nsim::train::convert::copies::{DEFAULT_COPIES, MOST_COPIES};
use nsim::train::convert::deployed::{Conversion, ConversionSettings, ConvertedIntegers};
use nsim::train::convert::next::suggest_in_python;
use nsim::train::convert::staged::is_real;
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
        let typed = target.map(str::to_string).or_else(|| instead.as_ref().map(|_| on.name().to_string()));
        let target = on;
        let word = match &other {
            Some(_) => None,
            None => against.map(|given| given.extract::<String>()).transpose()?,
        };
        let against = match word.as_deref() {
            None if graph.has_srm() => Counterpart::Srm,
            Some("srm") if graph.has_srm() => Counterpart::Srm,
            None | Some("cuba") => Counterpart::Cuba,
            Some("golden") => Counterpart::Golden,
            Some("srm") => {
                let message = "against='srm': the network has no spike response neurons".to_string();
                return Err(usage(message, "compare it with against='cuba' or against='golden'"));
            }
            Some(other) => {
                let message = format!("against is '{other}', which is neither a keyword nor a model file");
                let help = "against is one of srm, cuba, golden, a model file, an nsim.Network or an nsim.Conversion";
                return Err(usage(message, help));
            }
        };
        let given: Option<Bound<'_, PyAny>> = keywords.only("conversion")?.take("conversion")?;
        if given.is_some_and(|given| extract_network(&given).is_some()) {
            let message =
                "conversion is a network, but it selects how spike response neurons become integers".to_string();
            return Err(usage(message, "give the network or the nsim.Conversion as against="));
        }
        let conversion = keywords.one_of("conversion", &Conversion::ALL, Conversion::name)?;
        let conversion = conversion.unwrap_or(Conversion::Search);
        let calibrate = sources(keywords.take("calibrate")?.as_ref())?;
        let wanted = count_keyword(keywords, "calibration_samples", 60, MOST_SAMPLES)?;
        let copies = count_keyword(keywords, "delayed_copies", DEFAULT_COPIES, MOST_COPIES)?;
        let steps = keywords.whole("steps", 1..=u32::MAX.into())?.map(|steps| steps as u32);
        let attributed = count_keyword(keywords, "attribution_samples", 100, MOST_SAMPLES)?;
        let most = if keywords.take("attribution")?.unwrap_or(true) { attributed } else { 0 };
        let plot: Option<PathBuf> = keywords.take("plot")?;
        let force = keywords.take("force")?.unwrap_or(false);
        if let Some(path) = &plot {
            if path.extension().is_none_or(|extension| extension != "svg") {
                let message = format!("plot is {}, which does not end in .svg", path.display());
                return Err(usage(message, "name a file that ends in .svg"));
            }
            check_free(path, force).map_err(|problem| exception(py, problem))?;
        }
        let scene = network.file().scene.as_deref();
        let shown = NetworkInput::new(&written, scene, spikes, keywords)?;
        keywords.refuse_unread()?;
        let (json, text, falls) = work(py, true, |progress| {
            let samples = shown.samples();
            let seen = (shown.stimulus.origin.as_slice(), shown.stimulus.seed, samples.len());
            let name = graph.facts().name.as_str();
            let mapped = |network: &Quantised| map_with_defaults(network.clone(), &target);
            let done = |report: AgreeReport<'_>,
                        layers: &[LayerRow]|
             -> Result<(Value, String, Option<String>), nsim::Error> {
                if let (Some(path), Some(svg)) = (&plot, potentials(name, layers)) {
                    write::text(path, force, &svg)?;
                }
                let report = AgreeReport { target: Some(target.name()), ..report };
                Ok((report.json(), report.text(), report.falls()))
            };
            if let Some((_, kind, other)) = &other {
                refuse_large("agree", other, 1)?;
                let own = match is_real(&graph) {
                    true => None,
                    false => Some(mapped(&written)?.program),
                };
                let second = mapped(other).map_err(|problem| does_not_fit(&problem, target.name()))?;
                let both = ((&graph, &written, own.as_ref()), (other, &second.program));
                let agreement = compare_models(both.0, both.1, &samples, steps, progress)?;
                let two = [(name, role(&graph)), (other.parts().name.as_str(), *kind)];
                return done(AgreeReport::for_two_networks(two, seen, &agreement), &agreement.layers);
            }
            let run = RunInput { sources: &shown.stimulus.origin, seed: shown.stimulus.seed, scene };
            let choice = ConversionSettings { conversion, calibrate: &calibrate, run, wanted, most_copies: copies };
            let integers = ConvertedIntegers::find((&graph, &written), choice, &samples, |_| progress())?;
            let (fits, staged) = (&integers.fits, integers.staged(&graph)?);
            let program = &mapped(staged.deployed())?.program;
            let deployed = DeployedNetwork { graph: &graph, fits, staged: &staged, program, samples: &samples, steps };
            let agreement = compare(deployed, &against, progress)?;
            let some = &samples[..samples.len().min(most)];
            let attribution =
                (against.is_real() && most > 0).then(|| attribute(&staged, &output_layer(staged.deployed()), some));
            let next = attribution.as_ref().and_then(|attribution| suggest_in_python(attribution, typed.as_deref()));
            let trained = converted_from(&graph).filter(|_| matches!(against, Counterpart::Cuba));
            let closer = "network.agree(spikes, against=conversion), of the network that was converted";
            let report = AgreeReport {
                found: integers.found.as_ref(),
                fits: &named_fits(&graph, fits),
                attribution: attribution.as_ref(),
                attribution_samples: some.len(),
                next: next.as_ref(),
                source: trained.map(|trained| (trained, closer.to_string())),
                ..AgreeReport::for_counterpart((name, against.name()), seen, &agreement)
            };
            done(report, &agreement.layers)
        })?;
        instead.iter().chain(&falls).try_for_each(|said| issue_warning(py, said))?;
        Ok(Agreement { json, text })
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
