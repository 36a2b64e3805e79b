//! What samples did on the simulated cores.

use std::sync::Arc;

use nsim::drive::cores::core_rows;
use nsim::drive::decision::{EarlyExit, Rule};
use nsim::drive::populations::ByPopulation;
use nsim::drive::samples::{self, Division, Running, fast, fast_on};
use nsim::drive::warnings::{Finished, Ran, warnings};
use nsim::drive::{Keep, Outcome, digest};
use nsim::ir::spikes::Copies;
use nsim::report::detail::Detail;
use nsim::report::run::RunReport;
use numpy::{PyArray2, ToPyArray};
use pyo3::prelude::*;

use crate::keywords::{Keywords, usage};
use crate::mapping::Shared;
use crate::spikes::Shown;
use crate::work::work;

/// Updates of compartments that take longer than a signal may wait.
const LONG: u64 = 20_000_000;

/// Samples that ran.
#[pyclass(frozen, module = "nsim")]
pub struct Run {
    mapping: Arc<Shared>,
    shown: Shown,
    run: samples::Run<()>,
    early_exit: Option<Rule>,
}

/// By which rule samples end, from `early_exit`: 'certain' or a number of spikes.
pub fn rule(keywords: &Keywords<'_>) -> PyResult<Option<Rule>> {
    let Some(given) = keywords.take::<Bound<'_, PyAny>>("early_exit")? else { return Ok(None) };
    given.str()?.to_string().parse().map(Some).map_err(|problem| usage(format!("early_exit: {problem}")))
}

/// Whether samples are long work.
pub fn is_long(mapping: &Shared, shown: &Shown) -> bool {
    let steps: u64 = shown.samples().iter().map(|sample| u64::from(sample.steps())).sum();
    steps * u64::from(mapping.compiled().quantised.compartments().max(1)) > LONG
}

/// JSON as Python's own dictionaries and lists.
pub fn to_python<'py>(py: Python<'py>, value: &serde_json::Value) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (value.to_string(),))
}

impl Run {
    /// Runs samples.
    pub fn new(py: Python<'_>, mapping: &Arc<Shared>, shown: Shown, keywords: &Keywords<'_>) -> PyResult<Self> {
        let early_exit = rule(keywords)?;
        keywords.none_left()?;
        let compiled = mapping.compiled();
        let (network, program) = (&compiled.one, &compiled.program);
        let run = work(py, is_long(mapping, &shown), |progress| {
            let samples = shown.samples();
            let early_exit = early_exit.map(|rule| EarlyExit::new(rule, network));
            let keep = Keep { output: program.output(), probes: Vec::new(), early_exit };
            // Copies share no input channels: each sees the whole sample.
            let copies = Copies { copies: compiled.options.copies, channels: network.channels() };
            let running = Running { keep: &keep, copies, skip: true, per_step: false, progress, ranks: None };
            let division = Division::new(program, samples.len());
            Ok(match mapping.image(division) {
                Some(image) => fast_on(image, division, &samples, running, || ()),
                None => fast(program, &samples, running, || ())?,
            })
        })?;
        Ok(Run { mapping: mapping.clone(), shown, run, early_exit })
    }

    fn detail(&self) -> Detail {
        let compiled = self.mapping.compiled();
        let (network, program) = (&compiled.one, &compiled.program);
        let sums = ByPopulation::new(network, &self.run.counts);
        let samples = self.shown.samples();
        let ran = Ran::Program(program);
        let found = warnings(Finished { network, ran, sums: &sums, samples: &samples, outcomes: &self.run.outcomes });
        Detail { sums, cores: core_rows(program, &self.run.activity, None), warnings: found, ranks: Vec::new() }
    }

    fn labels(&self) -> Vec<Option<u32>> {
        self.shown.samples().iter().map(|sample| sample.label()).collect()
    }

    fn with_report<T>(&self, detail: &Detail, read: impl FnOnce(&RunReport<'_>) -> T) -> T {
        let labels = self.labels();
        read(&RunReport {
            network: &self.mapping.compiled().one,
            target: Some(self.mapping.target.name()),
            engine: "fast",
            input: &self.shown.stimulus.origin,
            seed: self.shown.stimulus.seed,
            outcomes: &self.run.outcomes,
            labels: &labels,
            activity: Some(&self.run.activity),
            skipped_updates: self.run.skipped_updates,
            early_exit: self.early_exit,
            wall_s: self.run.wall_s,
            detail,
            files: &[],
        })
    }
}

#[pymethods]
impl Run {
    /// SHA-256 over (sample, step, output) of all output spikes: equal digests, equal spikes.
    #[getter]
    fn digest(&self) -> String {
        digest(&self.run.outcomes)
    }

    /// Spikes of each output, `[samples, outputs]`, uint32.
    #[getter]
    fn counts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        let rows: Vec<Vec<u32>> = self.run.outcomes.iter().map(|outcome| outcome.counts.clone()).collect();
        Ok(PyArray2::from_vec2(py, &rows)?)
    }

    /// The class of each sample, None where all outputs are silent.
    #[getter]
    fn predicted(&self) -> Vec<Option<u32>> {
        self.run.outcomes.iter().map(Outcome::class).collect()
    }

    /// The class that each sample shows, None where it is not known.
    #[getter(labels)]
    fn given_labels(&self) -> Vec<Option<u32>> {
        self.labels()
    }

    /// The share of the samples whose class was predicted; None unless all have one.
    #[getter]
    fn accuracy(&self) -> Option<f64> {
        self.with_report(&Detail::default(), |report| report.json()["accuracy"].as_f64())
    }

    /// Timesteps that ran, of each sample.
    #[getter]
    fn steps(&self) -> Vec<u32> {
        self.run.outcomes.iter().map(|outcome| outcome.steps).collect()
    }

    /// Output spikes, `[spikes, 3]`, uint32: sample, step, output, ascending.
    #[getter]
    fn spikes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let outcomes = (0u32..).zip(&self.run.outcomes);
        let spikes: Vec<u32> = outcomes
            .flat_map(|(sample, outcome)| outcome.spikes.iter().flat_map(move |&(step, output)| [sample, step, output]))
            .collect();
        spikes.to_pyarray(py).call_method1("reshape", (-1, 3))
    }

    /// Counts over all samples: spikes, synaptic events, updates, messages, hops.
    #[getter]
    fn activity<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let activity = self.with_report(&Detail::default(), |report| report.json()["activity"].take());
        to_python(py, &activity)
    }

    /// Seconds of simulation.
    #[getter]
    fn wall_s(&self) -> f64 {
        self.run.wall_s
    }

    /// The object that `nsim run --format json` prints.
    fn json<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let object = py.detach(|| self.with_report(&self.detail(), |report| report.json()));
        to_python(py, &object)
    }

    fn __len__(&self) -> usize {
        self.run.outcomes.len()
    }

    fn __repr__(&self) -> String {
        let steps: u64 = self.run.outcomes.iter().map(|outcome| u64::from(outcome.steps)).sum();
        let accuracy = self.accuracy().map_or(String::new(), |accuracy| format!(", accuracy {accuracy:.4}"));
        let samples = self.run.outcomes.len();
        let name = &self.mapping.compiled().one.parts().name;
        format!("<nsim.Run {name}: {samples} samples, {steps} timesteps{accuracy}>")
    }

    fn __str__(&self) -> String {
        self.with_report(&self.detail(), |report| report.text())
    }
}
