//! `nsim bench early`: how soon, and for how much energy, a network decides as it will in the end.

use std::path::PathBuf;

use crate::cli::args::input::InputArgs;
use crate::cli::args::jobs;
use crate::cli::args::jobs::{JobArgs, Prepared, Wanted};
use crate::cli::args::timestep::TimestepArgs;
use crate::cli::context::{Answer, Context};
use crate::cli::energy::workload::{simulate, workload};
use crate::cli::output;
use nsim_cost::estimate::{Case, spent_by_step_uj};
use nsim_cost::job::Mode;
use nsim_cost::{CostTable, Deployment, HostWork, MeterSettings, Transport};
use nsim_energy::workload::Workload;
use nsim_files as io;
use nsim_report::bench::early::EarlyReport;
use nsim_session::error::Error;
use nsim_study::early::{StudyModel, Trial, TrialGroup, TrialRun, study_models};

const EXAMPLES: &str = "\
EXAMPLES:
  nsim bench early                                                      the shipped network on its shipped scene
  nsim bench early vtsnn-slip slip-tactile --input 'scene:slip?samples=200&seed=5' -o early
  nsim bench early --plot early.svg                                     accuracy over time as a picture
  nsim bench early --study runs --input 'scene:slip?samples=1000&seed=1&shear=0.32&edge_px=2'
                                                                        the networks that bench paper --train runs made,
                                                                        each on the samples that its training left out";

/// Accuracy of decisions made early: over the time and over the energy used so far
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct EarlyArgs {
    /// Model files or names of shipped models
    #[arg(value_name = "MODEL", default_value = "vtsnn-slip", conflicts_with = "study")]
    models: Vec<String>,
    #[command(flatten)]
    timestep: TimestepArgs,
    /// Use the networks of the folds that `bench paper --train` made in this folder instead
    #[arg(long, value_name = "DIR")]
    study: Option<PathBuf>,
    /// Input spikes: SOURCE, or POPULATION=SOURCE when the model has several input populations
    /// [default: each model's scene]
    #[arg(long, value_name = "SOURCE")]
    input: Vec<String>,
    /// A target file or the name of a shipped target
    #[arg(long, default_value = "nahuku-32")]
    target: String,
    /// Copies of the model on the target; the figures are for one copy [default: those of the
    /// scenario that ships for the first model, else 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    copies: Option<u32>,
    /// Let every step take at least the model's timestep, as with a live sensor
    #[arg(long)]
    realtime: bool,
    /// Folder for `early.csv`, `over-time.svg` and `over-energy.svg`
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Write a chart of accuracy over time
    #[arg(long, value_name = "FILE.svg|png|pdf")]
    plot: Option<PathBuf>,
}

fn models(args: &EarlyArgs) -> Result<Vec<StudyModel>, Error> {
    let model = |model: &String| StudyModel { group: model.clone(), model: model.clone(), tested: None };
    match &args.study {
        Some(folder) => Ok(study_models(folder)?),
        None => Ok(args.models.iter().map(model).collect()),
    }
}

/// Accuracy and energy after each step.
fn trial(args: &EarlyArgs, model: &StudyModel, copies: u32, context: Context) -> Result<Option<Trial>, Error> {
    let (target, needs_scene) = (args.target.clone(), args.input.is_empty());
    let job = JobArgs { target, timestep: args.timestep, needs_scene, ..JobArgs::for_model(&model.model) };
    let job = match jobs::prepare(&job, Wanted::Mapped, copies)? {
        Prepared::Ready(job) => job,
        Prepared::DoesNotFit(refusal) => {
            refusal.say(serde_json::json!({ "schema": "nsim.bench/1", "name": "early", "rows": [] }), context)?;
            return Ok(None);
        }
    };
    let mut workload = workload(&job, &InputArgs::from_sources(&args.input))?;
    if let Some(tested) = &model.tested {
        workload.choose(tested).map_err(|sample| {
            Error::Usage(format!("the study tested sample {sample}, which the input does not have"))
        })?;
    }
    timed(&workload, args.realtime, context).map(Some)
}

/// Accuracy and energy after each step of a mapped network on its samples.
///
/// # Errors
/// [`Error`] for samples of several lengths or without labels.
pub(super) fn timed(workload: &Workload<'_>, realtime: bool, context: Context) -> Result<Trial, Error> {
    let table = CostTable::new(&workload.target.constants()[0])?;
    let placement = &workload.compiled.placement;
    let work = HostWork::for_target(workload.target);
    let deployment = Deployment::from_placement("mapped", placement, workload.target, workload.copies, work);
    let metered = workload.metered(vec![table], &deployment, Transport::default());
    let run = simulate(workload, MeterSettings { by_step: Some(0), ..metered }, None, true, context)?;
    let Some(steps) = workload.steps_per_sample() else {
        return Err(Error::Usage("accuracy over time needs samples of one length".to_string()));
    };
    let timestep_ms = workload.compiled.one.parts().timestep_ms;
    let spent = spent_by_step_uj(&Case {
        mode: if realtime { Mode::Realtime } else { Mode::Offline },
        steps_per_sample: Some(steps),
        ..Case::new(&run.activity, &run.meter, &deployment, timestep_ms)
    });
    let (samples, outcomes) = (workload.samples(), &run.outcomes);
    let steps = steps as usize;
    Trial::new(TrialRun { samples: &samples, outcomes, steps, timestep_ms, spent_uj: &spent })
}

/// Runs the command.
///
/// # Errors
/// [`Error`] when a model or an input cannot be used.
pub fn run(args: &EarlyArgs, context: Context) -> Result<Answer, Error> {
    let names = ["early.csv", "over-time.svg", "over-energy.svg"];
    let paths: Vec<PathBuf> =
        args.output.iter().flat_map(|folder| names.iter().map(|name| folder.join(name))).collect();
    let taken = output::check_files(&paths, &args.plot, context)?;
    let models = models(args)?;
    let scenario = models
        .first()
        .map(|model| nsim_energy::published::files::scenario::shipped_for(&model.model))
        .transpose()?
        .flatten();
    let copies = args.copies.or(scenario.map(|scenario| scenario.copies.value)).unwrap_or(1);
    let quiet = Context { progress: false, ..context };
    let groups = output::with_progress(context, models.len(), "models", |done| {
        let mut groups: Vec<TrialGroup> = Vec::new();
        for model in &models {
            let Some(trial) = trial(args, model, copies, quiet)? else { return Ok(None) };
            match groups.last_mut().filter(|group| group.name == model.group) {
                Some(group) => group.trials.push(trial),
                None => groups.push(TrialGroup { name: model.group.clone(), trials: vec![trial] }),
            }
            done();
        }
        Ok::<_, Error>(Some(groups))
    })?;
    let Some(groups) = groups else { return Ok(Answer::No) };
    let report = EarlyReport { groups: &groups, copies, realtime: args.realtime };
    let texts = [report.csv(), report.over_time(), report.over_energy()];
    let mut batch = io::write::Batch::new(context.force);
    for (path, text) in paths.iter().zip(texts) {
        let bytes = if path.ends_with("early.csv") { text.into_bytes() } else { output::picture_bytes(path, &text)? };
        batch.add(path, |out| out.write_all(&bytes))?;
    }
    if let Some(path) = args.plot.as_ref().filter(|_| !taken) {
        let bytes = output::picture_bytes(path, &report.over_time())?;
        batch.add(path, |out| out.write_all(&bytes))?;
    }
    batch.commit()?;
    if let Some(path) = args.plot.as_ref().filter(|_| taken) {
        output::write_picture(path, &report.over_time(), context)?;
        return Ok(Answer::Yes);
    }
    output::print(context.format, || report.text(), || report.json(), || Ok(report.csv()))?;
    Ok(Answer::Yes)
}
