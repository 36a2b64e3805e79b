//! Conversion of a network to integers by a search on samples: `nsim convert`.
//!
//! Input: a network with real numbers, spikes. Output: a [`Conversion`], as the command line's.

use nsim::files::network::NetworkFile;
use nsim::files::shipped;
use nsim::report::convert::ConvertReport;
use nsim::train::convert::calibration::{self, RunInput};
use nsim::train::convert::fine_tune::trainable;
use nsim::train::convert::job::{FineTuning, Job, SampleSplit};
use nsim::train::convert::taps::{DEFAULT_TAPS, MOST_TAPS};
use pyo3::prelude::*;
use serde_json::Value;
use std::path::PathBuf;

use crate::agree::{MOST_SAMPLES, count_keyword};
use crate::error::exception;
use crate::html::{columns, frame, table};
use crate::keywords::{Keywords, usage};
use crate::spikes::{NetworkInput, sources};
use crate::value::to_python;
use crate::work::{try_detached, work};

/// The greatest number of epochs of fine-tuning, as on the command line.
const MOST_EPOCHS: u32 = 100_000;

/// A network converted to integers, and its agreement with the trained form.
#[pyclass(frozen, module = "nsim")]
pub struct Conversion {
    json: Value,
    text: String,
    model: NetworkFile,
    network: Py<PyAny>,
}

impl Conversion {
    /// Converts a network for a target; `built` makes the network of the written model.
    pub fn new(
        py: Python<'_>,
        name: &str,
        network: &nsim::files::network::Network,
        target: &str,
        spikes: Option<&Bound<'_, PyAny>>,
        keywords: &Keywords<'_>,
        built: impl FnOnce(&NetworkFile) -> PyResult<Py<PyAny>>,
    ) -> PyResult<Self> {
        let target = nsim::load_target(target).map_err(|problem| exception(py, problem))?;
        let job = try_detached(py, || Job::new(network, &target))?;
        let calibrate: Option<Bound<'_, PyAny>> = keywords.take("calibrate")?;
        let layout = keywords.only("time_first")?;
        let searched = |given| Ok::<_, PyErr>(NetworkInput::new(&job.integers, None, Some(given), &layout)?.stimulus);
        let searched = calibrate.as_ref().map(searched).transpose()?;
        let wanted = count_keyword(keywords, "calibration_samples", 60, MOST_SAMPLES)?;
        let taps = count_keyword(keywords, "delayed_copies", DEFAULT_TAPS, MOST_TAPS)?;
        let epochs = keywords.whole("fine_tune", 0..=MOST_EPOCHS.into())?.unwrap_or(0) as u32;
        if epochs > 0 {
            trainable(&job.graph).map_err(|problem| exception(py, problem))?;
        }
        let training = keywords.path("training")?;
        let train = sources(keywords.take("train")?.as_ref())?;
        if epochs == 0 && (training.is_some() || !train.is_empty()) {
            let message = "training= and train= are for fine-tuning, but fine_tune is 0".to_string();
            return Err(usage(message, "give fine_tune=EPOCHS, or remove training= and train="));
        }
        let scene = network.file().scene.as_deref();
        let shown = NetworkInput::new(&job.integers, scene, spikes, keywords)?;
        keywords.refuse_unread()?;
        let (json, text, model) = work(py, true, |progress| {
            let samples = shown.samples();
            let origin = &shown.stimulus.origin;
            let run = RunInput { sources: origin, seed: shown.stimulus.seed, scene };
            let apart = match searched {
                Some(samples) => Some(samples),
                None => calibration::stimulus(&job.integers, &[], run, wanted)?,
            };
            let split = SampleSplit::new(origin, &samples, apart.as_ref(), wanted);
            let done = job.convert(&split, taps, |_| progress())?;
            let tuned = match epochs {
                0 => None,
                _ => {
                    let named = training.as_deref().unwrap_or(&job.graph.facts().name);
                    let (source, _) =
                        shipped::path_or_shipped_text(named, shipped::TRAININGS, "training file", "convert.training")
                            .map_err(|error| error.help("training= names the training file of the model"))?;
                    let (converted, held_out) = (&done.converted, split.held_out.as_slice());
                    let tuning = FineTuning::new(&job, converted, &source, &train, held_out, epochs)?;
                    Some(tuning.run(converted, held_out, &|| progress(), |_| ())?)
                }
            };
            let model = job.model(&done, tuned.as_ref(), &job.provenance(name, &split, &done))?;
            // A Python program has no use for a command of a shell.
            let report =
                ConvertReport { job: &job, done: &done, input: origin, tuned: tuned.as_ref(), files: &[], next: None };
            Ok((report.json(), report.text(), model))
        })?;
        let network = built(&model)?;
        Ok(Conversion { json, text, model, network })
    }
}

#[pymethods]
impl Conversion {
    /// The network in integers.
    #[getter]
    pub fn network(&self, py: Python<'_>) -> Py<PyAny> {
        self.network.clone_ref(py)
    }

    /// The share of the held-out samples that both networks put in the same class. Without held-out
    /// samples, the share of the samples of the search.
    #[getter]
    fn class_agreement(&self) -> Option<f64> {
        let held_out = self.json["held_out"]["class_agreement"].as_f64();
        held_out.or(self.json["class_agreement"].as_f64())
    }

    /// A dictionary for each stage: the agreement of the integers, and the gain of the stage.
    #[getter]
    fn stages<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.json["stages"])
    }

    /// A dictionary for each layer: coincidence, clipped voltages, advice.
    #[getter]
    fn layers<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.json["layers"])
    }

    /// Writes the model file of `nsim convert -o`, and its arrays next to it; `force` replaces
    /// existing files.
    ///
    /// Returns the names of the files.
    #[pyo3(signature = (path, *, force=false))]
    fn save(&self, py: Python<'_>, path: PathBuf, force: bool) -> PyResult<Vec<String>> {
        try_detached(py, || self.model.write(&path, force))
    }

    /// The stages as a data frame of pandas, or of polars where only that is installed.
    fn table<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        frame(py, &self.json["stages"])
    }

    /// The object that `nsim convert --format json` prints.
    fn json<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.json)
    }

    fn __repr__(&self) -> String {
        let share = self.class_agreement().map_or("unknown".to_string(), |share| format!("{share:.4}"));
        format!("<nsim.Conversion {}: class agreement {share}>", self.json["model"].as_str().unwrap_or_default())
    }

    fn __str__(&self) -> String {
        self.text.clone()
    }

    /// The stages as a table for notebooks.
    fn _repr_html_(&self) -> String {
        let stages = self.json["stages"].as_array().map_or(&[][..], Vec::as_slice);
        table(&self.__repr__().replace(['<', '>'], ""), &columns(stages), stages)
    }
}
