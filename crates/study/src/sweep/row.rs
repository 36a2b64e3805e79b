//! Runs one variant; its row has the figures that `nsim run` and `nsim energy --baseline` print.
//!
//! Input: a [`Job`]. Output: a cell for each of [`FIGURES`]; an unknown figure is empty. Energies,
//! power and latency are the total of one copy. The ends of accuracy are its 95 % Wilson interval.
//! The tightest resource has the greatest use of its limit on any core; for a variant that does not
//! fit, it is the first exceeded one. Data shared by variants is made once: models and their
//! arrays, targets and their constants, samples, and mappings.
//!
//! Errors: problems of every variant, such as a path without a field. The error of one variant is
//! in its row, as a code under `error`, in words under `reason`.

use std::sync::Arc;

use crate::sweep::cache::SharedCache;
use crate::sweep::variants::{FIGURES, Job, Training};
use nsim_compile::{Front, Mapping};
use nsim_cost::HostWork;
use nsim_cost::estimate::{EstimateInput, RowUnit, estimate};
use nsim_energy::options::select_constants;
use nsim_files::changes::{Change, with_changes};
use nsim_files::network::Network;
use nsim_files::table::or_empty;
use nsim_files::target::load_target;
use nsim_import::model::{BaseModel, check_reading, load_model_with};
use nsim_ir::activity::Totals;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::stats::wilson;
use nsim_ir::hardware::Target;
use nsim_ir::quantised::Quantised;
use nsim_ir::resource::Capacity;
use nsim_ir::spikes::{Sample, Stimulus};
use nsim_quantise::prune::check_stimulus;
use nsim_session::error::Error;
use nsim_session::front::has_srm;
use nsim_session::inputs::{require_scene, stimulus};
use nsim_session::obtain::{Request, TargetChoice, prepare_converted};
use nsim_session::priced::{MeteredMapping, steps_per_sample};
use nsim_session::samples::{Run, RunSettings};
use nsim_session::{SampleSettings, accuracy, digest};
use nsim_train::convert::prepare::conversion;
use nsim_train::job as train;
use nsim_train::job::{Part, training_text, with_fields};

/// The cells of a variant.
pub type Cells = [String; FIGURES.len()];

/// Trained network of a variant, and the sources of its test samples.
#[derive(Debug)]
struct Trained {
    network: Network,
    test: Vec<String>,
}

impl Trained {
    /// Trains to the end on the samples that the training file names.
    fn new(training: &Training) -> Result<Self, Error> {
        let source = training_text(&training.config)?;
        let fields = training.fields.iter().map(|(field, value)| (field.as_str(), value.as_str()));
        let file = train::Job::new(with_fields(&source, &fields.collect::<Vec<_>>())?, None, None)?;
        let examples = file.read(Part::Train, &[])?;
        if examples.is_empty() {
            let problem =
                Diagnostic::new("train.sources", "field train is missing or empty: there are no samples to train on");
            return Err(problem.help("list them in its field train").in_file(source.path()).into());
        }
        let (state, _) = train::train(&file.plan, &examples, None, |_| ())?;
        let network = file.network(file.plan.result(&state), "trained by a sweep")?;
        Ok(Trained { network, test: file.file.test })
    }
}

/// Key of a mapping; variants with the same key share it.
fn mapping_key(job: &Job) -> String {
    let of_model = (&job.model, &job.training, &job.model_changes, job.reading);
    let of_mapping = (&job.options, job.relays, &job.prune, job.most_taps);
    format!("{:?}", (of_model, &job.target, &job.target_changes, of_mapping))
}

/// Runs variants.
#[derive(Debug, Default)]
pub struct Runner {
    models: SharedCache<String, Option<BaseModel>>,
    trained: SharedCache<String, Trained>,
    converted: SharedCache<String, Front>,
    /// The preset that prices a variant comes first among its target's constants.
    targets: SharedCache<(String, Vec<Change>, Option<String>), Target>,
    mappings: SharedCache<String, Mapping>,
    stimuli: SharedCache<String, Stimulus>,
}

/// Whether an error concerns the whole sweep and not one variant.
fn stops_sweep(error: &Error) -> bool {
    let code = error.code();
    matches!(error, Error::Usage(_) | Error::Fault(_))
        || code == "energy.input"
        || ["set.", "import.", "io."].iter().any(|begin| code.starts_with(begin))
        || [".unknown", ".syntax"].iter().any(|end| code.ends_with(end))
}

/// The place of a figure among the cells of a row.
pub fn place(figure: &str) -> usize {
    FIGURES.iter().position(|name| *name == figure).unwrap_or_default()
}

/// A resource with its use, such as `synapse words 81.3 %`, and its use alone, with one decimal.
fn share(of: Option<(&Capacity, u64, u64)>) -> [String; 2] {
    of.map_or_else(Default::default, |(resource, need, limit)| {
        let percent = (1e3 * need as f64 / limit.max(1) as f64).round() / 10.0;
        [format!("{} {percent} %", resource.name().replace('_', " ")), percent.to_string()]
    })
}

/// The resource with the greatest use of its limit on any core, with use and limit.
fn tightest(compiled: &Mapping, target: &Target) -> Option<(Capacity, u64, u64)> {
    let cores = compiled.partition.usage().iter().flat_map(|used| target.limits().against(used.of));
    let of_cores = cores.filter(|(resource, ..)| resource.heading().is_some());
    of_cores.reduce(|a, b| if b.1 * a.2.max(1) > a.1 * b.2.max(1) { b } else { a })
}

impl Runner {
    /// The cells of a variant.
    ///
    /// # Errors
    /// [`Error`] that concerns the whole sweep.
    pub fn row(&self, job: &Job) -> Result<Cells, Error> {
        match self.figures(job) {
            Err(error) if stops_sweep(&error) => Err(error),
            Err(error) => {
                let first = if let Error::DoesNotFit(reasons) = &error { reasons.first() } else { None };
                let (of, reason) = match (first, &error) {
                    (Some(first), _) => (Some((&first.resource, first.need, first.limit)), first.to_string()),
                    (None, Error::Input(problem)) => (None, problem.message.clone()),
                    (None, error) => (None, error.to_string()),
                };
                let [tightest, used] = share(of);
                let one_line = reason.split_whitespace().collect::<Vec<_>>().join(" ");
                let fits = if matches!(error, Error::DoesNotFit(_)) { "false" } else { "" };
                let known = [error.code(), fits, &tightest, &used, &one_line];
                let mut cells = Cells::default();
                for (name, text) in ["error", "fits", "tightest", "used_percent", "reason"].iter().zip(known) {
                    cells[place(name)] = text.to_string();
                }
                Ok(cells)
            }
            done => done,
        }
    }

    /// Relative run time of a variant: the elements of its model's arrays times its copies.
    pub fn size(&self, job: &Job) -> u64 {
        let Ok(model) = self.model(&job.model) else { return 0 };
        model.as_ref().as_ref().map_or(0, BaseModel::element_count) * u64::from(job.options.copies)
    }

    fn model(&self, name: &str) -> Result<Arc<Option<BaseModel>>, Error> {
        self.models.get(name.to_string(), || Ok(BaseModel::load(name)))
    }

    fn trained(&self, training: &Training) -> Result<Arc<Trained>, Error> {
        self.trained.get(format!("{training:?}"), || Trained::new(training))
    }

    fn network(&self, job: &Job) -> Result<Network, Error> {
        if let Some(training) = &job.training {
            return Ok(check_reading(self.trained(training)?.network.clone(), &job.reading)?);
        }
        let model = self.model(&job.model)?;
        Ok(with_changes(&job.model_changes, || match &*model {
            Some(model) => check_reading(model.with_changes()?, &job.reading),
            None => load_model_with(&job.model, &job.reading),
        })?)
    }

    fn target(&self, job: &Job, network: &Network) -> Result<Arc<Target>, Error> {
        let name = network.file().target_or_usual(job.target.as_deref());
        let key = (name.to_string(), job.target_changes.clone(), job.constants.clone());
        self.targets.get(key, || {
            with_changes(&job.target_changes, || {
                let (target, _) = select_constants(load_target(name)?, job.constants.as_deref())?;
                Ok(target)
            })
        })
    }

    /// The mapping of a variant's network.
    fn mapped(&self, job: &Job, network: &Network, target: &Target) -> Result<Arc<Mapping>, Error> {
        let request = Request {
            target: TargetChoice::Loaded(target),
            copies: Some(job.options.copies),
            options: job.options,
            prune: &job.prune,
            relays: job.relays,
            ..Request::new(&job.model, network, conversion(job.most_taps))
        };
        self.mappings.get(mapping_key(job), || {
            let (front, settings) = prepare_converted(&request, || self.converted(job, &request))?;
            settings.compiled(front)
        })
    }

    /// The network of a variant in integers; searches are stored.
    fn converted(&self, job: &Job, request: &Request<'_>) -> Result<Front, Error> {
        let convert = || request.conversion.convert(request.network);
        if !has_srm(request.network) {
            return convert();
        }
        let key = format!("{:?}", (&job.model, &job.training, job.reading, &job.model_changes, job.most_taps));
        Ok(Front::clone(&*self.converted.get(key, convert)?))
    }

    fn stimulus(
        &self,
        job: &Job,
        input: &[String],
        network: &Quantised,
        scene: Option<&str>,
    ) -> Result<Arc<Stimulus>, Error> {
        let parts = network.parts();
        let inputs: Vec<_> = network.inputs().map(|(_, one)| (&one.name, one.shape)).collect();
        let seen = (input, job.seed, scene, inputs, parts.timestep_ms, &parts.classes);
        self.stimuli.get(format!("{seen:?}"), || stimulus(network, input, scene, job.seed))
    }

    fn figures(&self, job: &Job) -> Result<Cells, Error> {
        let network = self.network(job)?;
        let input = match &job.training {
            Some(training) if job.input.is_empty() => self.trained(training)?.test.clone(),
            _ => job.input.clone(),
        };
        if input.is_empty() {
            let help = "give spikes with input: [\"FILE\"] in the sweep, or try input: [\"scene:noise\"]";
            require_scene(&job.model, network.file().scene.as_deref(), help)?;
        }
        let target = self.target(job, &network)?;
        let compiled = self.mapped(job, &network, &target)?;
        let scene = network.file().scene.as_deref();
        let shown = self.stimulus(job, &input, &compiled.one, scene)?;
        let range = job.samples.clone().unwrap_or(0..usize::MAX);
        let all = shown.samples.len();
        if range.start >= all || (range.end != usize::MAX && range.end > all) {
            return Err(Diagnostic::new("sweep.value", format!("input.samples: there are {all} samples")).into());
        }
        let samples: Vec<&Sample> = shown.samples[range.start..range.end.min(all)].iter().collect();
        check_stimulus(&compiled.one, &samples, range.start)?;
        let metered = MeteredMapping::new(&compiled);
        let work = HostWork::fed_by(job.host, &target)
            .map_err(|problem| Diagnostic::new("sweep.value", format!("options.host: {problem}")))?;
        let (settings, deployment) = metered.offline_with(&target, work)?;
        let sample_settings = SampleSettings::new(compiled.program.output());
        let Run { outcomes, activity, meter, .. } =
            metered.run(settings, &samples, RunSettings::new(&sample_settings))?;
        let labels = || samples.iter().map(|sample| sample.label());
        let accuracy = accuracy(&outcomes, labels());
        let ends = accuracy.map(|share| wilson(share, labels().flatten().count()));
        let case = EstimateInput {
            mode: job.mode,
            convention: job.convention,
            accounting: job.accounting,
            steps_per_sample: steps_per_sample(&samples),
            ..EstimateInput::new(&activity, &meter, &deployment)
        };
        let estimate = estimate(&case);
        let total = estimate.row(RowUnit::Total);
        let figure = |name| or_empty(total.and_then(|row| row.figure(name)));
        let mut totals = Totals::default();
        outcomes.iter().for_each(|outcome| totals += outcome.totals);
        let copies_run = u64::from(metered.copies_run());
        let neuron_dynamic_uj = estimate.breakdown_pj.iter().flatten().map(|(_, pj)| pj / 1e6);
        let of_core = tightest(&compiled, &target);
        let [resource, used] = share(of_core.as_ref().map(|(resource, need, limit)| (resource, *need, *limit)));
        Ok([
            String::new(),
            true.to_string(),
            compiled.partition.cores().to_string(),
            compiled.placement.chips_used().to_string(),
            samples.len().to_string(),
            outcomes.iter().map(|outcome| u64::from(outcome.steps)).sum::<u64>().to_string(),
            or_empty(accuracy),
            digest(&outcomes),
            (totals.spikes / copies_run).to_string(),
            (totals.synaptic_events / copies_run).to_string(),
            figure("static_mw"),
            figure("dynamic_mw"),
            figure("total_mw"),
            figure("latency_us"),
            figure("energy_uj"),
            figure("edp_pjs"),
            or_empty(estimate.breakdown_pj.is_some().then(|| neuron_dynamic_uj.sum::<f64>())),
            resource,
            used,
            String::new(),
            or_empty(ends.map(|(low, _)| low)),
            or_empty(ends.map(|(_, high)| high)),
            (activity.messages() / copies_run).to_string(),
            (activity.hops().total_links() / copies_run).to_string(),
            or_empty(estimate.job.total(job.accounting)),
        ])
    }
}
