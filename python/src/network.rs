//! Models in Python.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use nsim::agree::compare::real_trace;
use nsim::agree::recording::compare_recording;
use nsim::agree::staged::layers;
use nsim::energy::evaluate::DeploymentPlan;
use nsim::files::network::NetworkFile;
use nsim::import::foreign;
use nsim::import::spikes::PopulationSpikes;
use nsim::ir::base::diagnostic::Diagnostic;
use nsim::ir::base::warning::Warning;
use nsim::session::front::real_and_integers;
use numpy::ToPyArray;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::agree::Agreement;
use crate::convert::Conversion;
use crate::energy::{self, Energy};
use crate::error::{in_python, issue_warning, python_message};
use crate::html::populations;
use crate::keywords::{Keywords, whole};
use crate::mapping::{Mapping, MappingRequest, TARGET};
use crate::memory;
use crate::spikes::NetworkInput;
use crate::value::to_python;
use crate::work::{try_detached, work};

/// Loads a model.
///
/// `model` is the path of a model file (`.ron`, `.nir`, `.net`, ..) or the name of a shipped model.
/// Values that the file of another tool lacks are options, as in `nsim import`: `dt_ms`, `neuron`
/// (a file), `reset`, `decay`, `threshold`, `decision`, `input_shape`.
#[pyfunction]
#[pyo3(signature = (model, **options), text_signature = "(model, **options)")]
pub fn load(py: Python<'_>, model: PathBuf, options: Option<&Bound<'_, PyDict>>) -> PyResult<Network> {
    let model = model.to_string_lossy().into_owned();
    let given = options.filter(|given| !given.is_empty());
    let options = given.map(|given| memory::options(&Keywords::new(Some(given))?)).transpose()?;
    let network = try_detached(py, || {
        let path = Path::new(&model);
        let network = match &options {
            None => nsim::load_model(&model)?,
            Some(options) if foreign::is_foreign(path) => foreign::network(path, options)?,
            Some(_) => {
                let message =
                    format!("{model} is not a file of another tool, but the options apply only to such files");
                return Err(
                    Diagnostic::new("usage", message).help("remove the options: the model's file has all parameters")
                );
            }
        };
        Ok::<_, Diagnostic>(network)
    })?;
    let notes = network.conventions().notes.clone();
    Network::with_notes(py, &format!("{model}: "), model, network, notes)
}

/// A network from the bytes of a file of another tool.
#[pyfunction]
#[pyo3(signature = (name, content, **options))]
pub fn from_bytes(
    py: Python<'_>,
    name: &str,
    content: Vec<u8>,
    options: Option<&Bound<'_, PyDict>>,
) -> PyResult<Network> {
    let (network, notes) = memory::import_bytes(py, name, content, &Keywords::new(options)?)?;
    Network::without_file(py, network, notes)
}

/// A network from NIR nodes in memory; neurons of the nodes `held` stay at zero for a step after a
/// spike. `notes` become notes of the network.
#[pyfunction]
#[pyo3(signature = (name, nodes, edges, held, notes=Vec::new(), **options))]
pub fn from_nodes(
    py: Python<'_>,
    name: &str,
    nodes: &Bound<'_, PyDict>,
    edges: Vec<(String, String)>,
    held: Vec<String>,
    notes: Vec<String>,
    options: Option<&Bound<'_, PyDict>>,
) -> PyResult<Network> {
    let (network, conventions) = memory::import_nodes(py, name, nodes, edges, &held, &Keywords::new(options)?)?;
    Network::without_file(py, network, [conventions, notes].concat())
}

/// The spikes of each population of a network in real numbers, rows (sample, step, neuron). Steps
/// are counted from the first step of the population.
#[pyfunction]
pub fn real_spikes<'py>(
    py: Python<'py>,
    network: &Network,
    spikes: &Bound<'py, PyAny>,
) -> PyResult<Vec<(String, Bound<'py, PyAny>)>> {
    let file = network.network.file();
    let (graph, integers) = try_detached(py, || real_and_integers(&network.network))?;
    let shown = NetworkInput::new(&integers, None, Some(spikes), &Keywords::new(None)?)?;
    let traces = work(py, true, |progress| {
        let trace = real_trace(&graph, &integers)?;
        Ok(shown.samples().into_iter().inspect(|_| progress()).map(trace).collect::<Vec<_>>())
    })?;
    let rows = layers(&integers).into_iter().map(|layer| {
        let start = file.population(&layer.name).map_or(0, |population| population.start_step);
        let mut rows: Vec<u32> = Vec::new();
        for (sample, trace) in (0..).zip(&traces) {
            for neuron in 0..layer.count {
                let train = &trace.trains[(layer.first + neuron) as usize];
                train.iter().for_each(|step| rows.extend([sample, step.saturating_sub(start), neuron]));
            }
        }
        Ok((layer.name, rows.to_pyarray(py).call_method1("reshape", (-1, 3))?))
    });
    rows.collect()
}

/// The number of values in which a tool's recorded spikes of the output differ from a network's in
/// real numbers, and a sentence. `recorded` has the steps and the (step, neuron) of each sample.
#[pyfunction]
pub fn check_recording(
    py: Python<'_>,
    network: &Network,
    spikes: &Bound<'_, PyAny>,
    recorded: Vec<(u32, Vec<(u32, u32)>)>,
) -> PyResult<(u64, String)> {
    let (graph, integers) = try_detached(py, || real_and_integers(&network.network))?;
    let shown = NetworkInput::new(&integers, None, Some(spikes), &Keywords::new(None)?)?;
    let sample = |(steps, events)| PopulationSpikes { steps, events, ..PopulationSpikes::default() };
    let recorded: Vec<PopulationSpikes> = recorded.into_iter().map(sample).collect();
    let result = try_detached(py, || compare_recording(&graph, &integers, &shown.samples(), &recorded))?;
    Ok((result.differing, result.lines().join("; ")))
}

/// A network as in its file.
#[pyclass(frozen, module = "nsim")]
pub struct Network {
    model: String,
    network: Arc<nsim::files::network::Network>,
    notes: Vec<String>,
    warnings: Vec<Warning>,
}

impl Network {
    /// The network of a written model.
    pub fn from_model(py: Python<'_>, model: &NetworkFile) -> PyResult<Self> {
        let place = PathBuf::from(memory::memory_name(&model.name));
        let network = try_detached(py, || model.build(&place))?;
        Network::without_file(py, network, Vec::new())
    }

    /// A network whose warnings, of its reader and of its conversion to integers, are issued after
    /// `prefix`.
    fn with_notes(
        py: Python<'_>,
        prefix: &str,
        model: String,
        network: nsim::files::network::Network,
        notes: Vec<String>,
    ) -> PyResult<Self> {
        let (_, integers) = try_detached(py, || real_and_integers(&network))?;
        let warnings = in_python(integers.parts().warnings.clone());
        warnings.iter().try_for_each(|warning| issue_warning(py, &format!("{prefix}{warning}")))?;
        Ok(Network { model, network: Arc::new(network), notes, warnings })
    }

    /// The mapping to price, and its deployment: one copy unless `copies` or the deployment has
    /// more.
    fn mapping_to_price(
        &self,
        py: Python<'_>,
        target: Option<PathBuf>,
        copies: Option<&Bound<'_, PyAny>>,
        keywords: &Keywords<'_>,
    ) -> PyResult<(Mapping, DeploymentPlan)> {
        let copies = copies.map(|copies| whole("copies", copies, 1..=u32::MAX.into())).transpose()?;
        let copies = copies.map(|copies| copies as u32);
        let plan = energy::plan(py, &self.model, keywords, copies)?;
        let mut request = MappingRequest::new(target, &Keywords::new(None)?)?;
        request.copies = plan.mapped_copies();
        request.options.placement = plan.placement();
        Ok((Mapping::new(py, &self.model, &self.warnings, &self.network, &request)?, plan))
    }

    /// A network that has no file.
    pub fn without_file(py: Python<'_>, network: nsim::files::network::Network, notes: Vec<String>) -> PyResult<Self> {
        let model = memory::memory_name(&network.file().name);
        Network::with_notes(py, "", model, network, notes)
    }
}

#[pymethods]
impl Network {
    /// A network of populations and projections, dictionaries whose keys are the fields of a model
    /// file.
    ///
    /// A population has `name`, `shape` (a number, `[n]` or `[channels, height, width]`) and `kind`
    /// ('Input', 'Loihi' and the other kinds of neurons); parameters such as `du`, `dv`, `vth_mant`
    /// are a number or an array with one for each neuron. A projection has `from`, `to` and
    /// `weights`: `[target, source]`, a kernel `[C', C / groups, kh, kw]` or a SciPy sparse array
    /// `[target, source]`. `learning` is a `Rule`, a `Pes` or the text of either in a model file;
    /// `learning_semantics` is 'Silicon', 'Lava', 'Nengo' or 'Brian'. `timestep_ms` is in ms.
    #[new]
    #[pyo3(signature = (
        name, populations, projections, *, output, timestep_ms=1.0, classes=Vec::new(), learning_semantics=None
    ))]
    #[expect(clippy::too_many_arguments, reason = "keywords of Python")]
    fn new(
        py: Python<'_>,
        name: &str,
        populations: Vec<Bound<'_, PyDict>>,
        projections: Vec<Bound<'_, PyDict>>,
        output: &str,
        timestep_ms: f64,
        classes: Vec<String>,
        learning_semantics: Option<String>,
    ) -> PyResult<Self> {
        let mut model = memory::network_file(name, &populations, &projections, output, timestep_ms, classes)?;
        model.learning_semantics = learning_semantics.map(|given| memory::learning_semantics(&given)).transpose()?;
        Network::from_model(py, &model)
    }

    /// Conventions by which another tool's network was read, and the changes.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.notes.iter().map(|note| python_message(note)).collect()
    }

    /// A dictionary for each warning, of the reader and of the conversion to integers: `code`,
    /// `population`, `message`.
    #[getter]
    fn warnings<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &serde_json::json!(self.warnings))
    }

    /// Its name.
    #[getter]
    fn name(&self) -> &str {
        &self.network.file().name
    }

    /// Populations in the order of the file: name, kind (input, integers or real) and shape.
    #[getter]
    fn populations(&self) -> Vec<(String, &'static str, Vec<u64>)> {
        let populations = self.network.file().populations.iter();
        populations
            .map(|population| {
                let kind = match (&population.loihi, population.srm) {
                    (Some(_), _) => "integers",
                    (None, Some(_)) => "real",
                    (None, None) => "input",
                };
                (population.name.clone(), kind, population.shape.clone())
            })
            .collect()
    }

    /// Names of its classes; empty when the file has none.
    #[getter]
    fn classes(&self) -> Vec<String> {
        self.network.file().classes.clone()
    }

    /// This network on the cores of a target.
    ///
    /// `target` is a target file or a shipped name; `copies` (1, or those of `mapping`),
    /// `deployment` ('spread', 'packed'), `strategy` ('multilevel', 'greedy', 'sequential'),
    /// `objective` ('cores', 'energy', 'energy:chip', 'latency') and `seed` (0) are as in
    /// `nsim map`; `mapping` is a file of `nsim map -o`. Spike response neurons become integers as
    /// in `nsim map`.
    #[pyo3(
        signature = (target=None, **options),
        text_signature = "($self, target='nahuku-32', *, copies=None, deployment='spread', strategy='multilevel', \
                          objective='cores', seed=0, mapping=None)"
    )]
    fn map(&self, py: Python<'_>, target: Option<PathBuf>, options: Option<&Bound<'_, PyDict>>) -> PyResult<Mapping> {
        let keywords = Keywords::new(options)?;
        let request = MappingRequest::new(target, &keywords)?;
        keywords.refuse_unread()?;
        Mapping::new(py, &self.model, &self.warnings, &self.network, &request)
    }

    /// Energy, time and power of the network on the chip: `nsim energy`.
    ///
    /// Without `copies` there is one copy, or with `deployment='paper'` the number of the measured
    /// job; figures are per copy. `spikes` and the other keywords are as in `Mapping.energy`.
    #[pyo3(
        signature = (spikes=None, *, target=None, copies=None, **options),
        text_signature = "($self, spikes=None, *, target='nahuku-32', copies=None, deployment='spread', \
                          mode='offline', convention='physical', constants=None, transport='queued', host=None, \
                          streams='one', reset_words=0, accounting='profiler', early_exit=None, baselines=(), \
                          labels=None, samples=None, repeat=1, seed=None, time_first=False)"
    )]
    fn energy(
        &self,
        py: Python<'_>,
        spikes: Option<&Bound<'_, PyAny>>,
        target: Option<PathBuf>,
        copies: Option<&Bound<'_, PyAny>>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Energy> {
        let keywords = Keywords::new(options)?;
        let (mapping, plan) = self.mapping_to_price(py, target, copies, &keywords)?;
        Energy::new(py, mapping.shared(), &plan, spikes, &keywords)
    }

    /// Writes a page of the run and cost of the network, for a browser: `nsim report`.
    ///
    /// The keywords are as in `energy`; `force` replaces an existing file. Returns the path.
    #[pyo3(
        signature = (path, spikes=None, *, target=None, copies=None, **options),
        text_signature = "($self, path, spikes=None, *, target='nahuku-32', copies=None, force=False, **options)"
    )]
    fn report(
        &self,
        py: Python<'_>,
        path: PathBuf,
        spikes: Option<&Bound<'_, PyAny>>,
        target: Option<PathBuf>,
        copies: Option<&Bound<'_, PyAny>>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<PathBuf> {
        let keywords = Keywords::new(options)?;
        let force = keywords.take("force")?.unwrap_or(false);
        let (mapping, plan) = self.mapping_to_price(py, target, copies, &keywords)?;
        energy::report(py, mapping.shared(), &plan, spikes, &keywords, path, force)
    }

    /// Disagreement of the integers with the trained network, and its causes: `nsim agree`.
    ///
    /// `against` is 'srm', 'cuba' or 'golden', by default the trained form, or a model file, a
    /// network or a conversion that is run on these spikes. `conversion` 'search' or 'analytic'
    /// makes integers of spike response neurons; the search runs on `calibration_samples` (60)
    /// samples of the sources `calibrate`. `steps` compares only this many timesteps of each
    /// sample. `attribution` finds the causes, on `attribution_samples` (100). `plot` is an .svg
    /// with both potentials around the first spike that differs; `force` lets it replace a file.
    /// The default `target` is the first that has the neurons. `spikes` and its keywords are as in
    /// `Mapping.run`.
    #[pyo3(
        signature = (spikes=None, *, target=None, **options),
        text_signature = "($self, spikes=None, *, target=None, against=None, conversion='search', \
                          calibrate=None, calibration_samples=60, \
                          delayed_copies=None, steps=None, attribution=True, attribution_samples=100, plot=None, \
                          force=False, labels=None, samples=None, \
                          repeat=1, seed=None, time_first=False)"
    )]
    fn agree(
        &self,
        py: Python<'_>,
        spikes: Option<&Bound<'_, PyAny>>,
        target: Option<PathBuf>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Agreement> {
        let target = target.map(|target| target.to_string_lossy().into_owned());
        Agreement::new(py, &self.network, target.as_deref(), spikes, &Keywords::new(options)?, |given| {
            let of = |given: &Bound<'_, PyAny>| Some(given.cast::<Network>().ok()?.get().network.clone());
            of(given).or_else(|| of(given.cast::<Conversion>().ok()?.get().network(given.py()).bind(given.py())))
        })
    }

    /// The network in integers, by a search on samples: `nsim convert`.
    ///
    /// The search runs on `calibration_samples` (60) of `calibrate`, which has the form of
    /// `spikes`: by default the scene with another seed, or the first half of `spikes`. `fine_tune`
    /// then trains for this many epochs by the training file `training` (by default the shipped one
    /// with the model's name), on the sources `train`. `spikes`, which test the result, and its
    /// keywords are as in `Mapping.run`.
    #[pyo3(
        signature = (spikes=None, *, target=None, **options),
        text_signature = "($self, spikes=None, *, target='nahuku-32', calibrate=None, calibration_samples=60, \
                          delayed_copies=None, fine_tune=0, training=None, train=None, labels=None, \
                          samples=None, repeat=1, seed=None, time_first=False)"
    )]
    fn convert(
        &self,
        py: Python<'_>,
        spikes: Option<&Bound<'_, PyAny>>,
        target: Option<PathBuf>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Conversion> {
        let target = target.map_or_else(|| TARGET.to_string(), |target| target.to_string_lossy().into_owned());
        let built = |model: &NetworkFile| Ok(Py::new(py, Network::from_model(py, model)?)?.into_any());
        Conversion::new(py, &self.model, &self.network, &target, spikes, &Keywords::new(options)?, built)
    }

    /// Writes the network as a model file, and its arrays next to it; `force` replaces existing
    /// files.
    ///
    /// Returns the names of the files.
    #[pyo3(signature = (path, *, force=false))]
    fn save(&self, py: Python<'_>, path: PathBuf, force: bool) -> PyResult<Vec<String>> {
        try_detached(py, || self.network.resolved()?.write(&path, force))
    }

    fn __repr__(&self) -> String {
        let populations: Vec<String> =
            self.populations().iter().map(|(name, _, shape)| format!("{name}{shape:?}")).collect();
        format!("<nsim.Network {}: {}>", self.name(), populations.join(", "))
    }

    /// The populations as a table for notebooks.
    fn _repr_html_(&self) -> String {
        populations(&self.__repr__(), &self.populations())
    }
}
