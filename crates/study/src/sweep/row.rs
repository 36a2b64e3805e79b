//! Runs one variant: what `nsim run` and `nsim energy --baseline` print of it, in a row.
//!
//! Input: a [`Job`]. Output: a cell for each of [`FIGURES`]; a figure that is not known is empty.
//! Energies, power and latency are the total of one copy. What variants have in common is made
//! once: models and their arrays, targets and their constants, samples, and mappings.
//!
//! Errors: whatever no variant could be run with, such as a path that leads nowhere. What is wrong
//! with one variant stands in its row under `error`.

use std::collections::BTreeSet;
use std::sync::Arc;

use crate::sweep::made::MadeOnce;
use crate::sweep::variants::{FIGURES, Job};
use nsim_compile::{Compiled, DEFAULT_RATE, Form, explore};
use nsim_cost::estimate::{Case, estimate};
use nsim_cost::{CostTable, Deployment, HostWork, MeterSettings, Transport};
use nsim_energy::options::{tables, with_preset};
use nsim_files::changes::{Change, within};
use nsim_files::network::Network;
use nsim_files::target::load_target;
use nsim_import::model::{Unchanged, agreeing, load_model_with};
use nsim_ir::activity::Totals;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::units::Picoseconds;
use nsim_ir::firing_rates::Rates;
use nsim_ir::hardware::Target;
use nsim_ir::quantised::{Quantised, Units};
use nsim_ir::spikes::{Sample, Stimulus};
use nsim_session::error::Error;
use nsim_session::inputs::{require_scene, stimulus};
use nsim_session::priced::{Metered, SampleRun, steps_per_sample};
use nsim_session::samples::Run;
use nsim_session::shapes;
use nsim_session::{accuracy, digest};
use nsim_train::convert::copies::USUAL;
use nsim_train::convert::prepare::integers;

/// The cells of a variant.
pub type Cells = [String; FIGURES.len()];

/// A target and the constants that it is priced by.
#[derive(Debug)]
struct Priced {
    target: Target,
    table: CostTable,
}

/// What variants have in common that share a mapping.
fn shared_by(job: &Job) -> String {
    format!("{:?}", (&job.model, &job.of_model, job.dt_ms, &job.target, &job.of_target, &job.options))
}

/// Runs variants.
#[derive(Debug, Default)]
pub struct Runner {
    models: MadeOnce<String, Option<Unchanged>>,
    targets: MadeOnce<(String, Vec<Change>, Option<String>), Priced>,
    mappings: MadeOnce<String, Compiled>,
    stimuli: MadeOnce<String, Stimulus>,
}

/// Whether an error is of the whole sweep and not of a variant.
fn ends_all(error: &Error) -> bool {
    match error {
        Error::Usage(_) | Error::Fault(_) => true,
        Error::Input(diagnostic) => {
            let code = diagnostic.code;
            code.starts_with("set.")
                || code.starts_with("import.")
                || code.starts_with("io.")
                || code == "energy.input"
                || code.ends_with(".unknown")
                || code.ends_with(".syntax")
        }
    }
}

fn cell<T: ToString>(value: Option<T>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}

impl Runner {
    /// The cells of a variant.
    ///
    /// # Errors
    /// [`Error`] that is not of this variant alone.
    pub fn row(&self, job: &Job) -> Result<Cells, Error> {
        match self.figures(job) {
            Err(error) if ends_all(&error) => Err(error),
            Err(error) => {
                let code = match &error {
                    Error::Input(diagnostic) => diagnostic.code,
                    Error::Usage(_) => "usage",
                    Error::Fault(_) => "fault",
                };
                let mut cells = Cells::default();
                cells[0] = code.to_string();
                if code == "map.does-not-fit" {
                    cells[1] = "false".to_string();
                }
                Ok(cells)
            }
            done => done,
        }
    }

    /// How long a variant runs, compared with others: its model's numbers times its copies.
    pub fn size(&self, job: &Job) -> u64 {
        let Ok(model) = self.model(&job.model) else { return 0 };
        model.as_ref().as_ref().map_or(0, Unchanged::numbers) * u64::from(job.options.copies)
    }

    fn model(&self, name: &str) -> Result<Arc<Option<Unchanged>>, Error> {
        self.models.get(name.to_string(), || Ok(Unchanged::load(name)))
    }

    fn network(&self, job: &Job) -> Result<Network, Error> {
        let model = self.model(&job.model)?;
        Ok(within(&job.of_model, || match &*model {
            Some(model) => agreeing(model.changed()?, job.dt_ms),
            None => load_model_with(&job.model, job.dt_ms),
        })?)
    }

    fn target(&self, job: &Job) -> Result<Arc<Priced>, Error> {
        let key = (job.target.clone(), job.of_target.clone(), job.constants.clone());
        self.targets.get(key, || {
            within(&job.of_target, || {
                let target = load_target(&job.target)?;
                let (target, preset) = with_preset(target, job.constants.as_deref())?;
                let (target, table) = tables(target, preset.as_deref())?;
                Ok(Priced { target, table })
            })
        })
    }

    /// The network of a variant on its cores.
    fn mapped(&self, job: &Job, network: &Network, target: &Target) -> Result<Arc<Compiled>, Error> {
        self.mappings.get(shared_by(job), || {
            shapes::check(network, target, job.options.copies)?;
            let front = integers(network, USUAL)?;
            Form::require_written("running it on cores", front.quantised(), job.options.copies)?;
            Ok(explore::map(front, target, &job.options, &Rates::assumed(DEFAULT_RATE))?)
        })
    }

    fn stimulus(&self, job: &Job, network: &Quantised, scene: Option<&str>) -> Result<Arc<Stimulus>, Error> {
        let parts = network.parts();
        let inputs: Vec<_> = parts
            .populations
            .iter()
            .filter(|one| matches!(one.units, Units::Input(_)))
            .map(|one| (&one.name, one.shape))
            .collect();
        let seen = (&job.input, job.seed, scene, inputs, parts.timestep_ms, &parts.classes);
        self.stimuli.get(format!("{seen:?}"), || stimulus(network, &job.input, scene, job.seed))
    }

    fn figures(&self, job: &Job) -> Result<Cells, Error> {
        let network = self.network(job)?;
        if job.input.is_empty() {
            let help = "give spikes with input: [\"FILE\"] in the sweep, or input: [\"scene:noise\"] to try";
            require_scene(&job.model, network.file().scene.as_deref(), help)?;
        }
        let priced = self.target(job)?;
        let target = &priced.target;
        let compiled = self.mapped(job, &network, target)?;
        let scene = network.file().scene.as_deref();
        let shown = self.stimulus(job, &compiled.one, scene)?;
        let range = job.samples.clone().unwrap_or(0..usize::MAX);
        let all = shown.samples.len();
        if range.start >= all || (range.end != usize::MAX && range.end > all) {
            return Err(Diagnostic::new("sweep.value", format!("input.samples: there are {all} samples")).into());
        }
        let samples: Vec<&Sample> = shown.samples[range.start..range.end.min(all)].iter().collect();
        let (placement, copies) = (&compiled.placement, job.options.copies);
        let work = HostWork::for_target(target);
        let deployment = Deployment::from_placement(job.options.placement.name(), placement, target, copies, work);
        let timestep_ms = compiled.one.parts().timestep_ms;
        let metered = Metered::new(&compiled);
        let settings = MeterSettings {
            tables: vec![priced.table.clone()],
            timing: deployment.timing(Transport::default(), copies),
            routes: metered.routes.clone(),
            timestep: Picoseconds::from_milliseconds(timestep_ms),
            distribution: None,
            by_step: None,
        };
        let run = SampleRun { samples: &samples, early_exit: None, skip: true, progress: &|| (), ranks: None };
        let Run { outcomes, activity, meter, .. } = metered.run(settings, run)?;
        let case = Case {
            mode: job.mode,
            convention: job.convention,
            steps_per_sample: steps_per_sample(&samples),
            ..Case::new(&activity, &meter, &deployment, timestep_ms)
        };
        let estimate = estimate(&case);
        let total = estimate.rows.iter().find(|row| row.unit == "total");
        let figure = |name| cell(total.and_then(|row| row.figure(name)));
        let mut totals = Totals::default();
        outcomes.iter().for_each(|outcome| totals += outcome.totals);
        let copies_run = u64::from(metered.copies_run());
        let chips: BTreeSet<u32> = placement.sites().iter().map(|site| site.chip).collect();
        Ok([
            String::new(),
            true.to_string(),
            compiled.partition.cores().to_string(),
            chips.len().to_string(),
            samples.len().to_string(),
            outcomes.iter().map(|outcome| u64::from(outcome.steps)).sum::<u64>().to_string(),
            cell(accuracy(&outcomes, samples.iter().map(|sample| sample.label()))),
            digest(&outcomes),
            (totals.spikes / copies_run).to_string(),
            (totals.synaptic_events / copies_run).to_string(),
            figure("static_mw"),
            figure("dynamic_mw"),
            figure("total_mw"),
            figure("latency_us"),
            figure("energy_uj"),
            figure("edp_pjs"),
        ])
    }
}
