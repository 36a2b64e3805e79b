//! `nsim bench early`: how soon, and for how much energy, a network decides as it will in the end.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::base::diagnostic::Diagnostic;
use crate::base::units::Picoseconds;
use crate::cli::args::input::InputArgs;
use crate::cli::args::jobs::{self, JobArgs, Prepared, Wanted};
use crate::cli::context::{Answer, Context};
use crate::cli::energy::options::{DeploymentArg, deployment, tables, with_preset};
use crate::cli::energy::workload::Workload;
use crate::cli::output;
use crate::cost::Transport;
use crate::cost::estimate::{Case, Convention, spent_by_step_uj};
use crate::desc::baseline::Mode;
use crate::error::Error;
use crate::io;
use crate::report::bench::early::{EarlyReport, Group, Trial};
use crate::train::loss::class_of;

const EXAMPLES: &str = "\
EXAMPLES:
  nsim bench early                                                      the shipped network on its shipped scene
  nsim bench early vtsnn-slip slip-tactile --input 'scene:slip?samples=200&seed=5' -o early
  nsim bench early --study runs --input ev-containers/train -o early    the models of a study with --folds, each on the
                                                                        samples that its training left out";

/// Accuracy on the spikes so far, over time and over the energy spent so far
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct EarlyArgs {
    /// Model files or names of shipped models
    #[arg(value_name = "MODEL", default_value = "vtsnn-slip", conflicts_with = "study")]
    models: Vec<String>,
    /// Instead: the models that a study of `nsim train` left in this folder
    #[arg(long, value_name = "DIR")]
    study: Option<PathBuf>,
    /// Spikes: POPULATION=SOURCE, or SOURCE when it is clear for which [default: the first model's scene]
    #[arg(long, value_name = "SOURCE")]
    input: Vec<String>,
    /// A target file or the name of a shipped target
    #[arg(long, default_value = "nahuku-32")]
    target: String,
    /// Copies of the model on the target; figures are of one
    #[arg(long, value_name = "N", default_value_t = jobs::COPIES, value_parser = clap::value_parser!(u32).range(1..=1024))]
    copies: u32,
    /// Hold every step to the model's timestep, as a live sensor does
    #[arg(long)]
    realtime: bool,
    /// Folder for `early.csv`, `over-time.svg` and `over-energy.svg`
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
}

/// A model of a study and what it is tested on.
struct Member {
    group: String,
    model: String,
    tested: Option<Vec<usize>>,
}

fn members(args: &EarlyArgs) -> Result<Vec<Member>, Error> {
    let Some(folder) = &args.study else {
        let member = |model: &String| Member { group: model.clone(), model: model.clone(), tested: None };
        return Ok(args.models.iter().map(member).collect());
    };
    let unreadable = |path: &Path, why: String| Diagnostic::new("study.run", why).in_file(path);
    let entries = std::fs::read_dir(folder).map_err(|error| unreadable(folder, error.to_string()))?;
    let mut paths: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "json"));
    paths.sort();
    let mut members = Vec::new();
    for path in paths {
        let bytes = io::text::read_bytes(&path, 1 << 26)?;
        let run: Value = serde_json::from_slice(&bytes).map_err(|error| unreadable(&path, error.to_string()))?;
        let text = |key: &str| run[key].as_str().map(str::to_string);
        let (Some(name), Some(setting)) = (text("name"), text("setting")) else {
            return Err(unreadable(&path, "this is no run of a study".to_string()).into());
        };
        let group = if setting.is_empty() { name } else { format!("{name} {setting}") };
        let indices = |list: &Vec<Value>| list.iter().filter_map(|index| Some(index.as_u64()? as usize)).collect();
        let model = path.with_extension("ron").display().to_string();
        members.push(Member { group, model, tested: run["tested"].as_array().map(indices) });
    }
    members.sort_by(|a, b| (&a.group, &a.model).cmp(&(&b.group, &b.model)));
    match members.is_empty() {
        true => Err(unreadable(folder, "there is no run of a study in this folder".to_string()).into()),
        false => Ok(members),
    }
}

/// Accuracy and energy after each step.
fn trial(args: &EarlyArgs, member: &Member, context: Context) -> Result<Option<Trial>, Error> {
    let job = JobArgs { target: args.target.clone(), ..JobArgs::of_model(&member.model) };
    let job = match jobs::prepare(&job, Wanted::Mapped, args.copies)? {
        Prepared::Ready(job) => job,
        Prepared::DoesNotFit(refusal) => {
            refusal.say(serde_json::json!({ "schema": "nsim.bench/1", "name": "early", "rows": [] }), context)?;
            return Ok(None);
        }
    };
    let workload = Workload::new(&job, args.copies, &InputArgs::of(&args.input))?;
    let (target, preset) = with_preset(workload.target.clone(), None)?;
    let (tables, preset) = tables(&target, preset.as_deref())?;
    let deployment = deployment(&DeploymentArg::Packed, args.copies, &workload.compiled.placement, &target)?;
    let metered = workload.metered(tables, &deployment, Transport::Analytic);
    let (run, meter) = workload.simulate(&metered, None, true, context)?;
    let Some(steps) = workload.steps_per_sample() else {
        return Err(Error::Usage("accuracy over time needs samples of one length".to_string()));
    };
    let steps = steps as usize;
    let timestep_ms = workload.compiled.one.parts().timestep_ms;
    let spent = spent_by_step_uj(&Case {
        activity: &run.activity,
        meter: &meter,
        preset,
        copies_counted: args.copies,
        deployment: &deployment,
        mode: if args.realtime { Mode::Realtime } else { Mode::Offline },
        timestep: Picoseconds((timestep_ms * 1e9).round() as u64),
        convention: Convention::Physical,
        steps_per_sample: Some(steps as u32),
    });
    let chosen: Vec<usize> = match &member.tested {
        Some(tested) => tested.clone(),
        None => (0..workload.samples.len()).collect(),
    };
    let mut trial =
        Trial { timestep_ms, accuracy: vec![0.0; steps], energy_uj: vec![0.0; steps], decided_ms: Vec::new() };
    let share = 1.0 / chosen.len().max(1) as f64;
    for &index in &chosen {
        let outcome = run.outcomes.get(index).zip(workload.samples.get(index));
        let Some((outcome, sample)) = outcome else {
            return Err(Error::Usage(format!("the study tested sample {index}, which the input does not have")));
        };
        let Some(label) = sample.label() else {
            return Err(Error::Usage(format!("sample {index} has no label")));
        };
        let mut counts = vec![0.0f32; outcome.counts.len()];
        let mut spikes = outcome.spikes.iter().peekable();
        let mut energy = 0.0;
        let mut right_since = None;
        for step in 0..steps {
            while let Some(&(_, output)) = spikes.next_if(|spike| spike.0 as usize == step) {
                counts[output as usize] += 1.0;
            }
            energy += spent[index * steps + step];
            trial.energy_uj[step] += share * energy;
            if class_of(&counts) == Some(label) {
                trial.accuracy[step] += share;
                right_since.get_or_insert(step);
            } else {
                right_since = None;
            }
        }
        trial.decided_ms.push(right_since.map(|step| (step + 1) as f64 * timestep_ms));
    }
    Ok(Some(trial))
}

/// The command.
///
/// # Errors
/// [`Error`] when a model or an input cannot be used.
pub fn run(args: &EarlyArgs, context: Context) -> Result<Answer, Error> {
    let names = ["early.csv", "over-time.svg", "over-energy.svg"];
    let paths: Vec<PathBuf> =
        args.output.iter().flat_map(|folder| names.iter().map(|name| folder.join(name))).collect();
    for path in &paths {
        io::write::check_free(path, context.force)?;
    }
    let members = members(args)?;
    let bar = output::progress(context, members.len() as u64, "models");
    let mut groups: Vec<Group> = Vec::new();
    for member in &members {
        let Some(trial) = trial(args, member, Context { progress: false, ..context })? else { return Ok(Answer::No) };
        match groups.last_mut().filter(|group| group.name == member.group) {
            Some(group) => group.trials.push(trial),
            None => groups.push(Group { name: member.group.clone(), trials: vec![trial] }),
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    let report = EarlyReport { groups: &groups, copies: args.copies, realtime: args.realtime };
    let texts = [report.csv(), report.over_time(), report.over_energy()];
    for (path, text) in paths.iter().zip(texts) {
        io::write::text(path, context.force, &text)?;
    }
    output::print(context.format, || report.text(), || report.json(), || Ok(report.csv()))?;
    Ok(Answer::Yes)
}
