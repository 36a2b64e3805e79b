//! Energy, time and power of a mapping.

use std::path::PathBuf;

use nsim::cost::estimate::{Convention, RowUnit};
use nsim::cost::job::{Accounting, Mode};
use nsim::cost::{Host, MeterSettings, Streams, Transport};
use nsim::energy::evaluate::{DeploymentPlan, Evaluation, evaluate, session_settings};
use nsim::energy::options::CostOptions;
use nsim::energy::report::result::EnergyReport;
use nsim::energy::workload::Workload;
use nsim::files::text::sha256;
use nsim::files::write::{self, check_free};
use nsim::report::page::job as page;
use nsim::report::page::{Origin, Provenance, html};
use nsim::session::inputs::require_scene;
use nsim::session::metering::MeteredSteps;
use nsim::session::obtain::map_with_defaults;
use nsim::session::samples::Progress;
use pyo3::prelude::*;

use crate::error::{exception, in_python, python_message, warn};
use crate::html::{frame, table};
use crate::keywords::Keywords;
use crate::run::{is_long, rule};
use crate::shared::Shared;
use crate::spikes::NetworkInput;
use crate::value::to_python;
use crate::work::{try_detached, work};

/// The deployment that `deployment` names.
pub fn plan(py: Python<'_>, model: &str, keywords: &Keywords<'_>, copies: Option<u32>) -> PyResult<DeploymentPlan> {
    let asked = keywords.path("deployment")?;
    DeploymentPlan::new(model, asked.as_deref(), copies).map_err(|error| exception(py, error))
}

fn options(py: Python<'_>, keywords: &Keywords<'_>) -> PyResult<CostOptions> {
    let baselines: Vec<String> = keywords.take("baselines")?.unwrap_or_default();
    let usual = CostOptions::with_baselines(Some(&baselines)).map_err(|problem| exception(py, problem))?;
    Ok(CostOptions {
        mode: keywords.one_of("mode", &Mode::ALL, Mode::name)?.unwrap_or(usual.mode),
        convention: keywords.one_of("convention", &Convention::ALL, Convention::name)?.unwrap_or(usual.convention),
        transport: keywords.one_of("transport", &Transport::ALL, Transport::name)?.unwrap_or(usual.transport),
        host: keywords.one_of("host", &Host::ALL, Host::name)?,
        streams: keywords.one_of("streams", &Streams::ALL, Streams::name)?.unwrap_or_default(),
        reset_words: keywords.take("reset_words")?.unwrap_or(0),
        accounting: keywords.one_of("accounting", &Accounting::ALL, Accounting::name)?.unwrap_or(usual.accounting),
        constants: keywords.path("constants")?,
        early_exit: rule(keywords)?,
        ..usual
    })
}

/// How the steps of a session are priced.
pub struct Metering {
    plan: DeploymentPlan,
    options: CostOptions,
}

impl Metering {
    /// The pricing that keywords state, as those of `Mapping.energy`, and settings of its meter.
    pub fn new(py: Python<'_>, shared: &Shared, keywords: &Keywords<'_>) -> PyResult<(Self, MeterSettings)> {
        let plan = plan(py, &shared.model, keywords, None)?;
        plan.check_mapping().map_err(|error| exception(py, error))?;
        let options = options(py, keywords)?;
        keywords.refuse_unread()?;
        let settings = try_detached(py, || session_settings(&plan, &options, shared.compiled(), &shared.target))?;
        Ok((Metering { plan, options }, settings))
    }
}

/// Power, latency and energy of one copy.
#[pyclass(frozen, module = "nsim")]
pub struct Energy {
    report: EnergyReport,
}

/// Input of a priced run. Energy depends on activity, so without spikes the model ships a scene.
fn read_input(
    py: Python<'_>,
    shared: &Shared,
    spikes: Option<&Bound<'_, PyAny>>,
    keywords: &Keywords<'_>,
) -> PyResult<NetworkInput> {
    if spikes.is_none() {
        let help = "give spikes, or 'scene:noise' to try";
        require_scene(&shared.model, shared.scene.as_deref(), help).map_err(|problem| exception(py, problem))?;
    }
    NetworkInput::new(&shared.compiled().one, shared.scene.as_deref(), spikes, keywords)
}

/// Runs and prices a mapping; `then` takes the result.
fn run_and_price<T: Send>(
    py: Python<'_>,
    shared: &Shared,
    plan: &DeploymentPlan,
    shown: NetworkInput,
    keywords: &Keywords<'_>,
    then: impl FnOnce(&Workload<'_>, Evaluation, (Transport, Progress<'_>)) -> Result<T, nsim::Error> + Send,
) -> PyResult<T> {
    let compiled = shared.compiled();
    let options = options(py, keywords)?;
    keywords.refuse_unread()?;
    let long = is_long(shared, &shown);
    let known = [&shared.warnings()[..], &shown.stimulus.warnings].concat();
    let (result, warnings) = work(py, long, |progress| {
        let NetworkInput { stimulus, order, learning } = shown;
        // The network of a published job is mapped as in its publication.
        let of_job = plan.map_job(compiled, &shared.target)?;
        let mut workload = Workload::new(of_job.as_ref().unwrap_or(compiled), &shared.target, stimulus, order)?;
        workload.learning = learning;
        // The rows of the processor need one copy, mapped alone.
        let alone = match options.baselines.cpu && compiled.options.copies > 1 {
            true => Some(map_with_defaults(compiled.one.clone(), &shared.target)?),
            false => None,
        };
        let program = alone.as_ref().map_or(&compiled.program, |alone| &alone.program);
        let mut evaluated = evaluate(plan, &workload, &options, Some((&compiled.one, program)), |metered, watched| {
            workload.simulate(metered, watched, true, progress, None)
        })?;
        let warnings = in_python(std::mem::take(&mut evaluated.energy.detail.warnings));
        evaluated.energy.detail.warnings.clone_from(&warnings);
        Ok((then(&workload, evaluated, (options.transport, progress))?, warnings))
    })?;
    if shared.warns() {
        warn(py, &warnings, &known)?;
    }
    Ok(result)
}

/// Writes the page of a run to a path; `force` replaces an existing file.
pub fn report(
    py: Python<'_>,
    shared: &Shared,
    plan: &DeploymentPlan,
    spikes: Option<&Bound<'_, PyAny>>,
    keywords: &Keywords<'_>,
    path: PathBuf,
    force: bool,
) -> PyResult<PathBuf> {
    check_free(&path, force).map_err(|problem| exception(py, problem))?;
    let network = &shared.network;
    let shown = read_input(py, shared, spikes, keywords)?;
    let page = run_and_price(py, shared, plan, shown, keywords, |workload, evaluated, (transport, progress)| {
        let mut sections = page::sections(workload, &evaluated, transport)?;
        if let Some(trained) = page::trained(workload, network)? {
            sections.agreement = page::agreement(workload, &trained, progress)?;
        }
        let source = network.source();
        let name = source.path().display().to_string();
        let origins = vec![Origin { what: "model", name, sha256: sha256(source.text().as_bytes()) }];
        let title = format!("{} on {}", workload.compiled.one.parts().name, workload.target.name());
        let command = format!("report, nsim {} for Python", env!("CARGO_PKG_VERSION"));
        Ok(html(&title, &sections, &Provenance { command, origins }))
    })?;
    try_detached(py, || write::text(&path, force, &page))?;
    Ok(path)
}

impl Energy {
    /// Runs and prices a mapping.
    pub fn new(
        py: Python<'_>,
        shared: &Shared,
        plan: &DeploymentPlan,
        spikes: Option<&Bound<'_, PyAny>>,
        keywords: &Keywords<'_>,
    ) -> PyResult<Self> {
        let shown = read_input(py, shared, spikes, keywords)?;
        run_and_price(py, shared, plan, shown, keywords, |_, evaluated, _| Ok(Energy { report: evaluated.energy }))
    }

    /// Prices the steps of a session.
    pub fn of_session(py: Python<'_>, shared: &Shared, metering: &Metering, steps: MeteredSteps) -> PyResult<Self> {
        let Metering { plan, options } = metering;
        let compiled = shared.compiled();
        let energy = try_detached(py, || {
            let workload = Workload::of_session(compiled, &shared.target, steps.outcome.steps)?;
            let alone = Some((&compiled.one, &compiled.program));
            let run = |_, _| Ok(workload.meter().run_of_session(steps));
            let mut energy = evaluate(plan, &workload, options, alone, run)?.energy;
            energy.detail.warnings = in_python(std::mem::take(&mut energy.detail.warnings));
            Ok::<_, nsim::Error>(energy)
        })?;
        if shared.warns() {
            warn(py, &energy.detail.warnings, &shared.warnings())?;
        }
        Ok(Energy { report: energy })
    }

    fn total(&self, figure: &str) -> Option<f64> {
        self.report.estimate.row(RowUnit::Total)?.figure(figure)
    }
}

#[pymethods]
impl Energy {
    /// Energy of a timestep of one copy in uJ, host included.
    #[getter]
    fn energy_uj(&self) -> Option<f64> {
        self.total("energy_uj")
    }

    /// Time of a timestep in us.
    #[getter]
    fn latency_us(&self) -> Option<f64> {
        self.total("latency_us")
    }

    /// A dictionary for each row of the table: power in mW, latency in us, energy in uJ, the bounds
    /// of its interval.
    #[getter]
    fn rows<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.report.json()["rows"])
    }

    /// The rows of the table as a data frame of pandas, or of polars where only that is installed.
    fn table<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        frame(py, &self.report.json()["rows"])
    }

    /// A dictionary for each warning, as `Run.warnings`.
    #[getter]
    fn warnings<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &serde_json::json!(self.report.detail.warnings))
    }

    /// The object that `nsim energy --format json` prints.
    fn json<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.report.json())
    }

    fn __repr__(&self) -> String {
        let shown = |figure: Option<f64>, unit| figure.map_or("unknown".to_string(), |x| format!("{x:.4} {unit}"));
        let (energy, latency) = (shown(self.energy_uj(), "uJ"), shown(self.latency_us(), "us"));
        format!("<nsim.Energy {} on {}: {energy}, {latency} a timestep>", self.report.model, self.report.target)
    }

    fn __str__(&self) -> String {
        python_message(&self.report.headline())
    }

    /// The table for notebooks: a row for each unit of hardware, of a timestep and one copy.
    fn _repr_html_(&self) -> String {
        let json = self.report.json();
        let mut rows = json["rows"].as_array().cloned().unwrap_or_default();
        let interval = match json["level"].as_f64() {
            Some(level) => format!("{:.0} % interval (uJ)", 100.0 * level),
            None => "model's bounds (uJ)".to_string(),
        };
        for row in &mut rows {
            if let (Some(low), Some(high)) = (row["low"]["energy_uj"].as_f64(), row["high"]["energy_uj"].as_f64()) {
                row[interval.as_str()] = format!("{low:.3} .. {high:.3}").into();
            }
        }
        let columns = ["hardware", "unit", "static_mw", "dynamic_mw", "total_mw", "latency_us", "energy_uj", "edp_pjs"];
        let columns: Vec<&str> = columns.into_iter().chain([interval.as_str()]).collect();
        let caption = format!("{} on {}, of a timestep and one copy", self.report.model, self.report.target);
        table(&caption, &columns, &rows)
    }
}
