//! Results of samples on the simulated cores.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;

use nsim::files::network::NetworkFile;
use nsim::import::draws::read_draws;
use nsim::ir::arithmetic::ReadOut;
use nsim::ir::base::diagnostic::Diagnostic;
use nsim::ir::base::id::Id;
use nsim::ir::learning::draws::Draws;
use nsim::ir::quantised::Quantised;
use nsim::ir::spikes::Sample;
use nsim::report::run::RunReport;
use nsim::session::cores::core_rows;
use nsim::session::decision::{EarlyExit, Rule};
use nsim::session::detail::Detail;
use nsim::session::learning;
use nsim::session::neurobench::NeuroBench;
use nsim::session::outcome::LearningSettings;
use nsim::session::populations::CountsByPopulation;
use nsim::session::samples::{Division, RunSettings, fast, fast_on_image};
use nsim::session::warnings::{FinishedRun, RunEngine, warnings};
use nsim::session::{Outcome, Probe, SampleSettings, digest, samples};
use numpy::{PyArray1, PyArray2, PyArrayMethods, ToPyArray};
use pyo3::prelude::*;

use crate::error::{exception, in_python, warn};
use crate::html::{frame, table};
use crate::keywords::{Keywords, usage};
use crate::shared::Shared;
use crate::spikes::NetworkInput;
use crate::value::to_python;
use crate::work::{on_own_threads, run_detached, try_detached, work};

/// Most recorded numbers of probes, 4 bytes each.
const MOST_PROBED: u64 = 1 << 28;

/// Updates of compartments from which on a run counts as long: a signal should not wait for it.
const LONG: u64 = 20_000_000;

/// Results of samples.
#[pyclass(frozen, module = "nsim")]
pub struct Run {
    mapping: Arc<Shared>,
    shown: NetworkInput,
    run: samples::Run<()>,
    early_exit: Option<Rule>,
    /// Names of the probes.
    probes: Vec<String>,
}

/// Probes of names POPULATION.WHAT, and of a projection that learns NAME.weight and so on.
fn probes(network: &Quantised, names: &[String]) -> PyResult<Vec<Probe>> {
    let probe = |name: &String| {
        if let Some((rule, column, last)) = learning::parse_probe(name)
            && let Some((id, _)) = network.parts().rules.enumerate().find(|(_, known)| known.name == rule)
        {
            return Ok(learning::probe(network, id, column, last));
        }
        let (population, what) = name.rsplit_once('.').unwrap_or((name, "spikes"));
        let probed = network.population_named(population).map(|id| &network.populations()[id]);
        match probed.filter(|probed| probed.first_compartment().is_some()) {
            Some(probed) => Probe::named(probed, what).ok_or_else(|| {
                let message = format!("probe '{name}': '{population}' has no quantity '{what}'");
                usage(message, "a probe ends in .spikes, .message, .u, .v, .v_register or a word of its neurons' state")
            }),
            None => {
                let message = format!("probe '{name}': there is no population of compartments '{population}'");
                let known = network.populations().iter().filter(|known| known.first_compartment().is_some());
                let known: Vec<&str> = known.map(|known| known.name.as_str()).collect();
                Err(usage(message, &format!("populations of compartments are: {}", known.join(", "))))
            }
        }
    };
    names.iter().map(probe).collect()
}

/// Learning of a run: the keywords `draws`, a dictionary from projections to files, and `fresh`.
fn learning_settings(
    py: Python<'_>,
    network: &Quantised,
    shown: &NetworkInput,
    keywords: &Keywords<'_>,
) -> PyResult<LearningSettings> {
    let rules = &network.parts().rules;
    let fresh = keywords.take("fresh")?.unwrap_or(false);
    let files: HashMap<String, PathBuf> = keywords.take("draws")?.unwrap_or_default();
    let samples = shown.samples();
    if !files.is_empty() && samples.len() != 1 {
        let message = format!("draws are random numbers of one sample, but {} run", samples.len());
        return Err(usage(message, "choose one: samples=(FIRST, END)"));
    }
    let mut recorded = vec![None; rules.len()];
    for (name, path) in &files {
        let Some((id, rule)) = rules.enumerate().find(|(_, rule)| rule.name == *name) else {
            let known: Vec<&str> = rules.iter().map(|rule| rule.name.as_str()).collect();
            let message = format!("draws: no projection '{name}' learns");
            return Err(usage(message, &format!("projections that learn are: {}", known.join(", "))));
        };
        let read = || {
            let numbers = read_draws(path)?;
            let steps = samples.first().map_or(0, |sample| sample.steps());
            learning::check_recorded(rule, learning::units(network, id), &numbers, steps).map(|()| numbers)
        };
        recorded[id.index()] = Some(read().map_err(|problem| exception(py, problem))?);
    }
    let draws = Draws { recorded: Arc::new(recorded.into()), ..shown.learning.draws.clone() };
    Ok(LearningSettings { draws, fresh, ..shown.learning.clone() })
}

/// Rule by which samples end, from `early_exit`: 'certain' or a number of spikes.
pub fn rule(keywords: &Keywords<'_>) -> PyResult<Option<Rule>> {
    let Some(given) = keywords.take::<Bound<'_, PyAny>>("early_exit")? else { return Ok(None) };
    given
        .str()?
        .to_string()
        .parse()
        .map(Some)
        .map_err(|problem| usage(format!("early_exit: {problem}"), "it is 'certain' or a margin in spikes, such as 3"))
}

/// Whether samples have more than [`LONG`] updates.
pub fn is_long(mapping: &Shared, shown: &NetworkInput) -> bool {
    let steps: u64 = shown.samples().iter().map(|sample| u64::from(sample.steps())).sum();
    steps * u64::from(mapping.compiled().quantised.compartments().max(1)) > LONG
}

/// Runs samples on the simulated cores.
fn simulate(
    mapping: &Shared,
    samples: &[&Sample],
    keep: &SampleSettings,
    progress: samples::Progress<'_>,
) -> Result<samples::Run<()>, Diagnostic> {
    let compiled = mapping.compiled();
    let run_settings = RunSettings { copies: compiled.options.copies, progress, ..RunSettings::new(keep) };
    let division = Division::new(&compiled.program, samples.len());
    match mapping.image(division) {
        Some(image) => Ok(fast_on_image(image, division, samples, run_settings, || ())),
        None => fast(&compiled.program, samples, run_settings, || ()),
    }
}

impl Run {
    /// Runs samples.
    pub fn new(py: Python<'_>, mapping: &Arc<Shared>, shown: NetworkInput, keywords: &Keywords<'_>) -> PyResult<Self> {
        let early_exit = rule(keywords)?;
        let names: Vec<String> = keywords.take("probe")?.unwrap_or_default();
        let learning = learning_settings(py, &mapping.compiled().one, &shown, keywords)?;
        keywords.refuse_unread()?;
        let (network, program) = (&mapping.compiled().one, &mapping.compiled().program);
        let probes = probes(network, &names)?;
        if early_exit.is_some() && !names.is_empty() {
            let message = "probe records every step of a sample, but early_exit ends samples early".to_string();
            return Err(usage(message, "remove probe= or early_exit="));
        }
        let steps: u64 = shown.samples().iter().map(|sample| u64::from(sample.steps())).sum();
        let probed: u64 = probes.iter().map(|probe| u64::from(probe.count)).sum();
        if probed.saturating_mul(steps) > MOST_PROBED {
            let message =
                format!("probe would record {probed} compartments over {steps} steps, more than {MOST_PROBED} numbers");
            return Err(usage(message, "run some of the samples: samples=(FIRST, END), or record fewer populations"));
        }
        let run = work(py, is_long(mapping, &shown), |progress| {
            let early_exit = early_exit.map(|rule| EarlyExit::new(rule, network)).transpose()?;
            let keep = SampleSettings { output: program.output(), probes, early_exit, learning };
            Ok(simulate(mapping, &shown.samples(), &keep, progress)?)
        })?;
        let run = Run { mapping: mapping.clone(), shown, run, early_exit, probes: names };
        if mapping.warns() {
            let known = [&mapping.warnings()[..], &run.shown.stimulus.warnings].concat();
            warn(py, &run_detached(py, || run.detail().warnings), &known)?;
        }
        Ok(run)
    }

    fn detail(&self) -> Detail {
        let compiled = self.mapping.compiled();
        let (network, program) = (&compiled.one, &compiled.program);
        let sums = CountsByPopulation::new(network, &self.run.counts);
        let samples = self.shown.samples();
        let engine = RunEngine::Program(program);
        let (of_input, outcomes) = (&self.shown.stimulus.warnings, &self.run.outcomes);
        let finished = FinishedRun { network, engine, sums: &sums, samples: &samples, of_input, outcomes };
        // The check of a silent population runs samples once more.
        let warnings = in_python(on_own_threads(|| warnings(finished)));
        Detail { sums, cores: core_rows(program, &self.run.activity, None), warnings, ranks: Vec::new() }
    }

    fn with_report<T>(&self, detail: &Detail, read: impl FnOnce(&RunReport<'_>) -> T) -> T {
        let labels = self.labels();
        let learning = learning::rows(&self.mapping.compiled().one, &self.run.learned, &self.run.outcomes);
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
            neurobench: None,
            learning: &learning,
            files: &[],
        })
    }
}

#[pymethods]
impl Run {
    /// SHA-256 over (sample, step, output) of all output spikes: equal digests mean equal spikes.
    #[getter]
    fn digest(&self) -> String {
        digest(&self.run.outcomes)
    }

    /// Spikes of each output, `[samples, outputs]`, uint32. All are 0 where a potential decides,
    /// whose numbers are in `scores`.
    #[getter]
    fn counts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        let rows: Vec<Vec<u32>> = self.run.outcomes.iter().map(|outcome| outcome.counts.clone()).collect();
        Ok(PyArray2::from_vec2(py, &rows)?)
    }

    /// Scores of the decision, `[samples, outputs]`, float64: the spikes of each output, or the
    /// greatest, the sum or the last of its potential, by the `decision` of `json()`.
    #[getter]
    fn scores<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let of_sample = |outcome: &Outcome| match &outcome.potentials {
            Some(potentials) => potentials.scores().to_vec(),
            None => outcome.counts.iter().copied().map(f64::from).collect(),
        };
        Ok(PyArray2::from_vec2(py, &self.run.outcomes.iter().map(of_sample).collect::<Vec<_>>())?)
    }

    /// The class of each sample, None for an undecided one.
    #[getter]
    fn predicted(&self) -> Vec<Option<u32>> {
        self.run.outcomes.iter().map(Outcome::class).collect()
    }

    /// The label of each sample, None where it is unknown.
    #[getter]
    fn labels(&self) -> Vec<Option<u32>> {
        self.shown.samples().iter().map(|sample| sample.label()).collect()
    }

    /// The share of the samples with a correct class; None unless all have labels.
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

    /// The recording of a probe, `[samples, compartments, T]`, int32: spikes are 0 or 1, `u` and
    /// `v` the registers of one copy after each timestep. Of a projection that learns
    /// `[samples, rows, T]`, after the learning of each timestep.
    fn probe<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let Some(index) = self.probes.iter().position(|known| known == name) else {
            let known = self.probes.join(", ");
            let message = format!("'{name}' was not recorded; the run recorded '{known}'");
            return Err(usage(message, &format!("run once more with probe=['{name}']")));
        };
        let outcomes = &self.run.outcomes;
        let steps = outcomes.first().map_or(0, |outcome| outcome.steps as usize);
        if outcomes.iter().any(|outcome| outcome.steps as usize != steps) {
            let message = "samples of different lengths cannot form one array".to_string();
            return Err(usage(message, "run samples of one length at a time: samples=(FIRST, END)"));
        }
        let is_last = learning::parse_probe(name).is_some_and(|(.., last)| last);
        let steps = if is_last { 1 } else { steps };
        let numbers: Vec<i32> = outcomes.iter().flat_map(|outcome| outcome.probes[index].iter().copied()).collect();
        let compartments = numbers.len().checked_div(outcomes.len() * steps).unwrap_or(0);
        Ok(PyArray1::from_vec(py, numbers).reshape([outcomes.len(), compartments, steps])?.into_any())
    }

    /// Writes the model with the weights, delays and tags after the last sample, without rules if
    /// `freeze`; `force` replaces an existing file. Returns the files.
    #[pyo3(signature = (path, *, freeze=false, force=false))]
    fn learned(&self, py: Python<'_>, path: PathBuf, freeze: bool, force: bool) -> PyResult<Vec<String>> {
        let (network, file) = (&self.mapping.compiled().one, &self.mapping.network);
        try_detached(py, || {
            let states = learning::states(network, &self.run.learned);
            let (model, arrays) = file.learned(&states, freeze, &NetworkFile::arrays_name(&path))?;
            model.write_with(
                arrays,
                &format!("{} after a run, with what it learned", network.parts().name),
                &path,
                force,
            )
        })
    }

    /// The metrics of NeuroBench's harness, as in `nsim run --neurobench`; the samples run once
    /// more.
    fn neurobench<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        if self.early_exit.is_some() {
            return Err(usage("NeuroBench counts whole samples".into(), "run without early_exit="));
        }
        let mapping = &self.mapping;
        let metrics = work(py, is_long(mapping, &self.shown), |progress| {
            let measured = NeuroBench::measure(&mapping.compiled().one, &self.shown.samples(), |samples, keep| {
                simulate(mapping, samples, keep, progress)
            });
            Ok(measured?)
        })?;
        to_python(py, &serde_json::json!(metrics))
    }

    /// Counts over all samples: spikes, synaptic events, updates, messages, hops.
    #[getter]
    fn activity<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let activity = self.with_report(&Detail::default(), |report| report.json()["activity"].take());
        to_python(py, &activity)
    }

    /// A dictionary for each warning of the run: `code`, `population`, `message`.
    #[getter]
    fn warnings<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let warnings = run_detached(py, || self.detail().warnings);
        to_python(py, &serde_json::json!(warnings))
    }

    /// Seconds of simulation.
    #[getter]
    fn wall_s(&self) -> f64 {
        self.run.wall_s
    }

    /// A data frame of pandas, or of polars where only that is installed, with a row for each
    /// population.
    fn table<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        frame(py, &self.with_report(&self.detail(), |report| report.json())["populations"])
    }

    /// A data frame with a row for each sample: `sample`, `label`, `predicted`, `steps`, and
    /// `counts_K` for the spikes of output K.
    fn samples<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let rows = self.run.outcomes.iter().zip(self.labels()).enumerate().map(|(sample, (outcome, label))| {
            let counts: serde_json::Map<_, _> =
                outcome.counts.iter().enumerate().map(|(output, &count)| (output.to_string(), count.into())).collect();
            serde_json::json!({
                "sample": sample, "label": label, "predicted": outcome.class(), "steps": outcome.steps,
                "counts": counts,
            })
        });
        frame(py, &rows.collect())
    }

    /// The object that `nsim run --format json` prints.
    fn json<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let object = run_detached(py, || self.with_report(&self.detail(), |report| report.json()));
        to_python(py, &object)
    }

    fn __len__(&self) -> usize {
        self.run.outcomes.len()
    }

    fn __repr__(&self) -> String {
        let steps: u64 = self.run.outcomes.iter().map(|outcome| u64::from(outcome.steps)).sum();
        let accuracy = self.accuracy().map_or(String::new(), |accuracy| format!(", accuracy {accuracy:.4}"));
        let samples = self.run.outcomes.len();
        let parts = self.mapping.compiled().one.parts();
        let by = match parts.decision {
            ReadOut::Spikes => String::new(),
            potential => format!(", decided by {}", potential.name()),
        };
        format!("<nsim.Run {}: {samples} samples, {steps} timesteps{accuracy}{by}>", parts.name)
    }

    fn __str__(&self) -> String {
        self.with_report(&self.detail(), |report| report.text())
    }

    /// The table for notebooks: a row for each population.
    fn _repr_html_(&self) -> String {
        let json = self.with_report(&self.detail(), |report| report.json());
        let accuracy = self.accuracy().map_or(String::new(), |accuracy| format!(", accuracy {accuracy:.4}"));
        let caption = format!("{}, {} samples{accuracy}", self.mapping.compiled().one.parts().name, self.__len__());
        let columns = ["name", "compartments", "spikes", "silent", "clipped", "wrapped"];
        table(&caption, &columns, json["populations"].as_array().map_or(&[], Vec::as_slice))
    }
}
