//! What a mapping costs.

use nsim::cost::Transport;
use nsim::cost::estimate::Convention;
use nsim::desc::published::baseline::Mode;
use nsim::desc::published::workload::Accounting;
use nsim::energy::evaluate::{CostOptions, Plan, evaluate};
use nsim::energy::options::{DeploymentArg, HostArg};
use nsim::energy::workload::Workload;
use nsim::ir::program::Program;
use nsim::report::energy::table::EnergyReport;
use pyo3::prelude::*;

use crate::error::raised;
use crate::html::table;
use crate::keywords::Keywords;
use crate::mapping::Mapping;
use crate::run::{is_long, rule, to_python};
use crate::spikes::Shown;
use crate::work::work;

/// The deployment that `deployment` names.
pub fn plan(py: Python<'_>, model: &str, keywords: &Keywords<'_>) -> PyResult<Plan> {
    let asked = keywords.path("deployment")?;
    let asked = asked.as_deref().map_or(DeploymentArg::Packed, DeploymentArg::from);
    Plan::new(model, &asked).map_err(|error| raised(py, error))
}

fn options(py: Python<'_>, keywords: &Keywords<'_>) -> PyResult<CostOptions> {
    let baselines: Vec<String> = keywords.take("baselines")?.unwrap_or_default();
    let mut options = CostOptions::usual(Some(&baselines)).map_err(|problem| raised(py, problem))?;
    if let Some(mode) = keywords.one_of("mode", &Mode::ALL, Mode::name)? {
        options.mode = mode;
    }
    if let Some(convention) = keywords.one_of("convention", &Convention::ALL, Convention::name)? {
        options.convention = convention;
    }
    if let Some(transport) = keywords.one_of("transport", &Transport::ALL, Transport::name)? {
        options.transport = transport;
    }
    if let Some(host) = keywords.one_of("host", &HostArg::ALL, HostArg::name)? {
        options.host = host;
    }
    if let Some(accounting) = keywords.one_of("accounting", &Accounting::ALL, Accounting::name)? {
        options.accounting = accounting;
    }
    options.constants = keywords.path("constants")?;
    options.early_exit = rule(keywords)?;
    Ok(options)
}

/// Power, latency and energy of one copy.
#[pyclass(frozen, module = "nsim")]
pub struct Energy {
    report: EnergyReport,
}

impl Energy {
    /// Runs and prices a mapping.
    pub fn new(
        py: Python<'_>,
        mapping: &Mapping,
        plan: &Plan,
        spikes: Option<&Bound<'_, PyAny>>,
        keywords: &Keywords<'_>,
    ) -> PyResult<Self> {
        let shared = mapping.shared();
        let compiled = shared.compiled();
        let shown = Shown::new(&compiled.one, shared.scene.as_deref(), spikes, keywords)?;
        let options = options(py, keywords)?;
        keywords.none_left()?;
        let long = is_long(shared, &shown);
        let report = work(py, long, |progress| {
            let Shown { stimulus, order } = shown;
            let workload = Workload::new(compiled, &shared.target, stimulus, order)?;
            // The processor's rows are of one copy, mapped alone.
            let alone = match options.baselines.cpu && workload.copies > 1 {
                true => Some(nsim::compile(compiled.one.clone(), &shared.target, &nsim::Options::default())?),
                false => None,
            };
            let alone: &Program = alone.as_ref().map_or(&compiled.program, |alone| &alone.program);
            let evaluated = evaluate(plan, &workload, &options, Some(alone), |(metered, _), watched| {
                workload.simulate(metered, watched, true, (progress, None))
            })?;
            Ok(evaluated.energy)
        })?;
        Ok(Energy { report })
    }

    fn total(&self, figure: &str) -> Option<f64> {
        self.report.estimate.rows.iter().find(|row| row.unit == "total")?.figure(figure)
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

    /// The rows of the table, a dictionary each: power in mW, latency in us, energy in uJ, the bounds of its interval.
    #[getter]
    fn rows<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.report.json()["rows"])
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
        self.report.headline()
    }

    /// The table for notebooks: a row for each unit of hardware, of a timestep and one copy.
    fn _repr_html_(&self) -> String {
        let json = self.report.json();
        let columns = ["hardware", "unit", "static_mw", "dynamic_mw", "total_mw", "latency_us", "energy_uj", "edp_pjs"];
        let caption = format!("{} on {}, of a timestep and one copy", self.report.model, self.report.target);
        table(&caption, &columns, json["rows"].as_array().map_or(&[], Vec::as_slice))
    }
}
