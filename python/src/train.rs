//! Trains networks: `nsim train`.
//!
//! Input: a training file, labelled spikes. Output: a [`Training`] with the figures, digest and
//! model of the command line. A study is several calls.

use std::path::PathBuf;

use nsim::ir::base::diagnostic::SourceText;
use nsim::report::train::{TrainReport, history_csv};
use nsim::train::fit::{Example, Plan, TrainingState};
use nsim::train::job::{Checkpoint, Data, Job, Part, Trained, train as trained_to_the_end, training_text, with_fields};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use serde_json::{Value, json};

use crate::error::exception;
use crate::html::{columns, frame, table};
use crate::keywords::Keywords;
use crate::memory;
use crate::network::Network;
use crate::spikes::{NetworkInput, sources};
use crate::value::to_python;
use crate::work::{try_detached, work};

/// Bounds of the command line.
const MOST_EPOCHS: u64 = 1_000_000;
const MOST_FOLDS: u64 = 100;

/// A trained network.
#[pyclass(frozen, module = "nsim")]
pub struct Training {
    job: Job,
    trained: Trained,
    changed: Vec<String>,
    network: Py<Network>,
}

/// Samples of a training.
enum SampleSource {
    /// Named sources; if empty, the sources of the training file.
    Sources(Vec<String>),
    /// Arrays with labels.
    Arrays(Vec<Example>),
}

/// Reads `(spikes, labels)`, a source, a list of sources, or nothing.
fn read_sample_source(
    py: Python<'_>,
    job: &Job,
    keywords: &Keywords<'_>,
    key: &str,
    time_first: bool,
) -> PyResult<SampleSource> {
    let Some(value) = keywords.take::<Bound<'_, PyAny>>(key)? else { return Ok(SampleSource::Sources(Vec::new())) };
    let pair = value.cast::<PyTuple>().ok().filter(|pair| pair.len() == 2);
    let Some(pair) = pair.filter(|pair| pair.extract::<(String, String)>().is_err()) else {
        return sources(Some(&value)).map(SampleSource::Sources);
    };
    let options = PyDict::new(py);
    options.set_item("labels", pair.get_item(1)?)?;
    options.set_item("time_first", time_first)?;
    let network = try_detached(py, || job.inputs())?;
    // The job checks the classes, so any label is allowed here.
    let options = Keywords::new(Some(&options))?;
    let shown = NetworkInput::with_class_count(1 << 32, &network, None, Some(&pair.get_item(0)?), &options)?;
    let what = if key == "test" { "test" } else { "training" };
    try_detached(py, || job.examples(&network, &shown.stimulus.samples, what)).map(SampleSource::Arrays)
}

/// Trains a network with SLAYER: `nsim train`.
///
/// `config` is the path or the text of a training file. `train` and `test` are a source or a list
/// of sources as for `nsim run --input`, a pair (spikes, labels) of arrays as for `Mapping.run`, or
/// None for the samples of the training file. `seed` and `epochs` replace the values of the file,
/// `set` is a dictionary of other fields and values. `folds` also cross-validates; `checkpoint` is
/// a file from which an interrupted training resumes.
#[pyfunction]
#[pyo3(
    signature = (config, **options),
    text_signature = "(config, *, train=None, test=None, seed=None, epochs=None, set=None, folds=None, \
                      checkpoint=None, time_first=False)"
)]
pub fn train(py: Python<'_>, config: PathBuf, options: Option<&Bound<'_, PyDict>>) -> PyResult<Training> {
    let keywords = Keywords::new(options)?;
    let text = config.to_string_lossy();
    let source = match text.contains("Training(") {
        true => SourceText::new(memory::memory_name("training"), text.into_owned()),
        false => training_text(&text).map_err(|problem| exception(py, problem))?,
    };
    let mut fields: Vec<(String, String)> = Vec::new();
    for (key, value) in keywords.take::<Bound<'_, PyDict>>("set")?.into_iter().flatten() {
        // RON writes Python's truth values in small letters.
        let value = value.str()?.to_string();
        let value = if value == "True" || value == "False" { value.to_lowercase() } else { value };
        fields.push((key.extract()?, value));
    }
    let changes: Vec<(&str, &str)> = fields.iter().map(|(key, value)| (key.as_str(), value.as_str())).collect();
    let seed = keywords.take("seed")?;
    let epochs = keywords.whole("epochs", 0..=MOST_EPOCHS)?.map(|epochs| epochs as u32);
    let folds = keywords.whole("folds", 2..=MOST_FOLDS)?.map(|folds| folds as u32);
    let checkpoint: Option<PathBuf> = keywords.take("checkpoint")?;
    let time_first = keywords.take("time_first")?.unwrap_or(false);
    let job = try_detached(py, || with_fields(&source, &changes).and_then(|source| Job::new(source, seed, epochs)))?;
    let (train, test) = (
        read_sample_source(py, &job, &keywords, "train", time_first)?,
        read_sample_source(py, &job, &keywords, "test", time_first)?,
    );
    keywords.refuse_unread()?;
    let changed: Vec<String> = fields.iter().map(|(key, value)| format!("{key}={value}")).collect();
    let (trained, network) = work(py, true, |progress| {
        let data = data(&job, train, test)?;
        let folds = folds.map_or_else(Vec::new, |k| Job::folds(&data.train, k));
        let to_the_end = |plan: &Plan, examples: &[Example], kept: Option<&Checkpoint>| {
            trained_to_the_end(plan, examples, kept, |_: &TrainingState| progress())
        };
        let stored = checkpoint.map(|path| Checkpoint::new(&path, &job.plan, &data.train));
        let state = to_the_end(&job.plan, &data.train, stored.as_ref())?;
        let each = |plan: &Plan, examples: &[Example]| Ok(to_the_end(plan, examples, None)?.0);
        let trained = job.trained(state, &data, &folds, each)?;
        let report = TrainReport { job: &job, trained: &trained, model: None };
        let network = job.network(job.plan.result(&trained.state), &report.summary())?;
        Ok((trained, network))
    })?;
    let network = Py::new(py, Network::without_file(py, network, Vec::new())?)?;
    Ok(Training { job, trained, changed, network })
}

fn data(job: &Job, train: SampleSource, test: SampleSource) -> Result<Data, nsim::Error> {
    let read = |part, given| match given {
        SampleSource::Sources(sources) => job.read(part, &sources),
        SampleSource::Arrays(examples) => Ok(examples),
    };
    let data = Data { train: read(Part::Train, train)?, test: read(Part::Test, test)? };
    if data.train.is_empty() {
        return Err(nsim::Error::Usage("there are no training samples: give train=".to_string()));
    }
    Ok(data)
}

impl Training {
    /// The history, an object for each epoch.
    fn epochs(&self) -> Vec<Value> {
        self.trained.state.history.iter().map(|row| json!(row)).collect()
    }

    fn report(&self) -> TrainReport<'_> {
        TrainReport { job: &self.job, trained: &self.trained, model: None }
    }
}

#[pymethods]
impl Training {
    /// The trained network.
    #[getter]
    fn network(&self, py: Python<'_>) -> Py<Network> {
        self.network.clone_ref(py)
    }

    /// The share of the training samples with a correct class.
    #[getter]
    fn train_accuracy(&self) -> f64 {
        self.trained.train_accuracy
    }

    /// The share of the test samples with a correct class; None without any.
    #[getter]
    fn test_accuracy(&self) -> Option<f64> {
        self.trained.test_accuracy
    }

    /// Accuracy on each held-out fold of the training samples.
    #[getter]
    fn folds(&self) -> Vec<f64> {
        self.trained.folds.clone()
    }

    /// Digest of the output spikes on the test samples (without any, the training samples), as in
    /// `Run.digest`.
    #[getter]
    fn digest(&self) -> &str {
        &self.trained.digest
    }

    /// (epoch, mean loss, accuracy) of each epoch.
    #[getter]
    fn history(&self) -> Vec<(u32, f64, f64)> {
        self.trained.state.history.iter().map(|row| (row.epoch, row.loss, row.accuracy)).collect()
    }

    /// The history as `nsim train --log` writes it.
    fn csv(&self) -> String {
        history_csv(&self.trained.state.history)
    }

    /// Writes the model file of `nsim train -o`, and its weights next to it; `force` replaces
    /// existing files.
    ///
    /// Returns the names of the files.
    #[pyo3(signature = (path, *, force=false))]
    fn save(&self, py: Python<'_>, path: PathBuf, force: bool) -> PyResult<[PathBuf; 2]> {
        let (comment, provenance) = (self.report().provenance(&self.changed), self.report().summary());
        let weights = self.job.plan.result(&self.trained.state);
        try_detached(py, || self.job.write(&path, force, weights, &comment, &provenance))
    }

    /// The epochs as a data frame of pandas, or of polars where only that is installed.
    fn table<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        frame(py, &Value::Array(self.epochs()))
    }

    /// The object that `nsim train --format json` prints.
    fn json<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.report().json())
    }

    fn __repr__(&self) -> String {
        let (train, test) = (self.trained.train_accuracy, self.trained.test_accuracy);
        let test = test.map_or(String::new(), |test| format!(", {test:.4} on test samples"));
        format!(
            "<nsim.Training {}: {} epochs, accuracy {train:.4}{test}>",
            self.job.file.name, self.trained.state.epoch
        )
    }

    fn __str__(&self) -> String {
        self.report().text()
    }

    /// The epochs as a table for notebooks.
    fn _repr_html_(&self) -> String {
        let rows = self.epochs();
        table(&self.__repr__().replace(['<', '>'], ""), &columns(&rows), &rows)
    }
}
