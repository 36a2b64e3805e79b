//! A network on the cores of a target, flattened for repeated runs.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;

use nsim::compile::{self, CopyPlacement, Objective, Options, Strategy};
use nsim::files::mapping::mapping_text;
use nsim::files::network::Network;
use nsim::files::table::count;
use nsim::ir::base::warning::Warning;
use nsim::ir::hardware::Target;
use nsim::ir::quantised::Population;
use nsim::session::obtain::{Job, Request, TargetChoice, obtain};
use nsim::train::convert::prepare::conversion;
use nsim::train::convert::taps::DEFAULT_TAPS;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::bench::bench;
use crate::energy::{self, Energy};
use crate::error::{exception, warn};
use crate::html::populations;
use crate::keywords::{Keywords, usage};
use crate::projections;
use crate::run::Run;
use crate::session::Session;
use crate::shared::Shared;
use crate::spikes::NetworkInput;
use crate::work::try_detached;

/// The default target.
pub use nsim::files::network::USUAL_TARGET as TARGET;

/// Request for a mapping.
pub struct MappingRequest {
    target: Option<String>,
    file: Option<PathBuf>,
    /// Copies of the network: those of the file unless given, else one.
    pub copies: Option<u32>,
    /// Options of the compiler.
    pub options: Options,
}

impl MappingRequest {
    /// From a target and keywords.
    pub fn new(target: Option<PathBuf>, keywords: &Keywords<'_>) -> PyResult<Self> {
        let usual = Options::default();
        let file: Option<PathBuf> = keywords.take("mapping")?;
        let copies = keywords.whole("copies", 1..=u32::MAX.into())?.map(|copies| copies as u32);
        let strategy = keywords.one_of("strategy", &Strategy::ALL, Strategy::name)?.unwrap_or(usual.strategy);
        let objective = keywords.one_of("objective", &Objective::ALL, Objective::name)?.unwrap_or(usual.objective);
        let seed = keywords.take("seed")?.unwrap_or(usual.seed);
        let placement = keywords.one_of("deployment", &CopyPlacement::ALL, CopyPlacement::name)?;
        let placement = placement.unwrap_or(usual.placement);
        let target = target.map(|target| target.to_string_lossy().into_owned());
        Ok(MappingRequest { target, file, copies, options: Options { placement, strategy, objective, seed, ..usual } })
    }

    fn obtain_mapping(&self, model: &str, network: &Network) -> Result<(compile::Mapping, Target), nsim::Error> {
        let request = Request {
            target: TargetChoice::Named(self.target.as_deref()),
            mapping: self.file.as_deref(),
            copies: self.copies,
            options: self.options,
            ..Request::new(model, network, conversion(DEFAULT_TAPS))
        };
        match obtain(&request)? {
            Job::Mapped(compiled, target, _) => Ok((*compiled, *target)),
            Job::Quantised(..) | Job::Real(..) => Err(nsim::Error::Fault("a mapped job was asked for".to_string())),
        }
    }
}

/// A network on simulated cores.
#[pyclass(frozen, module = "nsim")]
pub struct Mapping(Arc<Shared>);

impl Mapping {
    /// Maps a network, and issues its warnings that are not among those `known`.
    pub fn new(
        py: Python<'_>,
        model: &str,
        known: &[Warning],
        network: &Arc<Network>,
        request: &MappingRequest,
    ) -> PyResult<Self> {
        let shared = |(compiled, target)| Shared::new(model, network, compiled, target);
        let shared = try_detached(py, || request.obtain_mapping(model, network).map(shared))?;
        warn(py, &shared.warnings(), known)?;
        Ok(Mapping(Arc::new(shared)))
    }

    /// The part that runs and energies share.
    pub fn shared(&self) -> &Arc<Shared> {
        &self.0
    }
}

#[pymethods]
impl Mapping {
    /// The network's name.
    #[getter]
    fn model(&self) -> &str {
        &self.0.compiled().one.parts().name
    }

    /// The target's name.
    #[getter]
    fn target(&self) -> &str {
        self.0.target.name()
    }

    /// Copies of the network.
    #[getter]
    fn copies(&self) -> u32 {
        self.0.compiled().options.copies
    }

    /// Neuron cores in use.
    #[getter]
    fn cores(&self) -> usize {
        self.0.compiled().partition.cores()
    }

    /// Chips in use.
    #[getter]
    fn chips(&self) -> usize {
        let cores = self.0.compiled().program.cores().iter();
        cores.map(|image| image.site.chip).collect::<BTreeSet<_>>().len()
    }

    /// The strategy that assigned compartments to cores.
    #[getter]
    fn strategy(&self) -> &'static str {
        self.0.compiled().options.strategy.name()
    }

    /// Seed of the strategy.
    #[getter]
    fn seed(&self) -> u64 {
        self.0.compiled().options.seed
    }

    /// Compartments of all copies.
    #[getter]
    fn compartments(&self) -> u32 {
        self.0.compiled().quantised.compartments()
    }

    /// Populations of one copy as they run: name, kind (input or integers) and shape.
    #[getter]
    fn populations(&self) -> Vec<(String, &'static str, Vec<u32>)> {
        let shown = |population: &Population| {
            let kind = if population.first_channel().is_some() { "input" } else { "integers" };
            (population.name.clone(), kind, population.shape.axes())
        };
        self.0.compiled().one.populations().iter().map(shown).collect()
    }

    /// The output population, which decides the class.
    #[getter]
    fn output(&self) -> &str {
        let network = &self.0.compiled().one;
        &network.populations()[network.parts().output].name
    }

    /// A dictionary for each projection of one copy in integers: `source`, `target`, `weights`,
    /// `exponent`, `delay` in timesteps, `factor` (the payload that multiplies weights, None where
    /// it varies) and, of convolutions and pools, `window`.
    ///
    /// `weights` are `[target, source]`, or a kernel `[C', C / groups, kh, kw]`; a spike adds
    /// `weight * 2 ** (6 + exponent)`.
    fn projections<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        projections::dictionaries(py, &self.0.compiled().one)
    }

    /// The text of `nsim map -o`, for `Network.map(mapping=FILE)` and `nsim run --mapping`.
    fn to_ron(&self, py: Python<'_>) -> PyResult<String> {
        mapping_text(&self.0.compiled().mapping_file()).map_err(|problem| exception(py, problem))
    }

    /// Runs samples on the simulated cores: `nsim run --engine fast`.
    ///
    /// `spikes` is an array `[channels.., T]` or `[samples, channels.., T]` in which one value
    /// above zero is a spike, a dictionary from input populations to such arrays, a source or a
    /// list of sources as for `--input`, or None for the model's own scene. With `time_first`
    /// arrays are `[T, channels..]` or `[samples, T, channels..]`. `labels` are classes of the
    /// samples, `samples` is (first, end), `seed` is the seed of a scene, `early_exit`
    /// 'certain' or a margin in spikes, `probe` a list of POPULATION.spikes, .u, .v or
    /// .v_register to record, and NAME.weight, .delay, .tag or a trace of a projection that learns.
    /// Its random numbers are seeded by `seed`, or `draws`, a dictionary from projections to .npz
    /// files; with `fresh` each sample starts from the weights of the model. The first run of a mapping issues its warnings (`nsim.Warning`);
    /// `Run.warnings` lists them for every run.
    #[pyo3(
        signature = (spikes=None, **options),
        text_signature = "($self, spikes=None, *, labels=None, samples=None, repeat=1, seed=None, time_first=False, \
                          early_exit=None, probe=(), draws=None, fresh=False)"
    )]
    fn run(
        &self,
        py: Python<'_>,
        spikes: Option<&Bound<'_, PyAny>>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Run> {
        let keywords = Keywords::new(options)?;
        let shown = NetworkInput::new(&self.0.compiled().one, self.0.scene.as_deref(), spikes, &keywords)?;
        Run::new(py, &self.0, shown, &keywords)
    }

    /// Opens a session: the network before its first timestep, which a loop steps. A `with` block
    /// closes it. `seed` is of the random numbers of learning. The session counts
    /// what `Session.energy` needs, unless `energy` is False; it may be a dictionary of the options
    /// of `energy`.
    #[pyo3(signature = (seed=None, *, energy=None))]
    fn session(&self, py: Python<'_>, seed: Option<u64>, energy: Option<&Bound<'_, PyAny>>) -> PyResult<Session> {
        Session::new(py, &self.0, seed.unwrap_or(0), energy)
    }

    /// Energy, time and power of the mapping for these samples, compared with the named
    /// `baselines`: `nsim energy`.
    ///
    /// Energies are in uJ and latencies in us, of a timestep and one copy. `spikes` and its
    /// keywords are as in `run`; the others are options of `nsim energy`.
    #[pyo3(
        signature = (spikes=None, **options),
        text_signature = "($self, spikes=None, *, deployment=None, mode='offline', convention='physical', \
                          constants=None, transport='queued', host=None, streams='one', reset_words=0, \
                          accounting='profiler', early_exit=None, baselines=(), labels=None, samples=None, repeat=1, \
                          seed=None, time_first=False)"
    )]
    fn energy(
        &self,
        py: Python<'_>,
        spikes: Option<&Bound<'_, PyAny>>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Energy> {
        let keywords = Keywords::new(options)?;
        if keywords.take::<Bound<'_, PyAny>>("copies")?.is_some() {
            let message = format!("copies= applies to a network, but this mapping has {}", self.copies());
            return Err(usage(
                message,
                "map this number of copies, network.map(copies=N), or call network.energy(spikes, copies=N)",
            ));
        }
        let plan = energy::plan(py, &self.0.model, &keywords, None)?;
        plan.check_mapping().map_err(|error| exception(py, error))?;
        Energy::new(py, &self.0, &plan, spikes, &keywords)
    }

    /// Time to simulate a timestep on one thread, measured for about `seconds` while the first
    /// sample is repeated.
    ///
    /// Returns a dictionary: `us_per_timestep` (the median of the repeats), `fastest_us`,
    /// `spread_us` (between the quartiles), `repeats`, `steps` of each, and `spikes_in`, `spikes`,
    /// `synaptic_events`, `compartment_updates` of a timestep. With `skip=False` no work is
    /// skipped.
    #[pyo3(
        signature = (spikes=None, **options),
        text_signature = "($self, spikes=None, *, seconds=1.0, skip=True, labels=None, samples=None, repeat=1, \
                          seed=None, time_first=False)"
    )]
    fn bench<'py>(
        &self,
        py: Python<'py>,
        spikes: Option<&Bound<'py, PyAny>>,
        options: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        bench(py, &self.0, spikes, &Keywords::new(options)?)
    }

    /// Writes a page of the run and cost of the mapping, for a browser: `nsim report`.
    ///
    /// The keywords are as in `energy`; `force` replaces an existing file. Returns the path.
    #[pyo3(
        signature = (path, spikes=None, *, force=false, **options),
        text_signature = "($self, path, spikes=None, *, force=False, **options)"
    )]
    fn report(
        &self,
        py: Python<'_>,
        path: PathBuf,
        spikes: Option<&Bound<'_, PyAny>>,
        force: bool,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<PathBuf> {
        let keywords = Keywords::new(options)?;
        let plan = energy::plan(py, &self.0.model, &keywords, None)?;
        plan.check_mapping().map_err(|error| exception(py, error))?;
        energy::report(py, &self.0, &plan, spikes, &keywords, path, force)
    }

    fn __repr__(&self) -> String {
        let (copies, cores, chips) = (self.copies(), self.cores(), self.chips());
        let copies = if copies == 1 { String::new() } else { format!("{copies} copies of ") };
        let (cores, chips) = (count(cores as u64, "core"), count(chips as u64, "chip"));
        format!("<nsim.Mapping {copies}{} on {}: {cores}, {chips}>", self.model(), self.target())
    }

    /// The populations as a table for notebooks.
    fn _repr_html_(&self) -> String {
        populations(&self.__repr__(), &self.populations())
    }
}
