//! `nsim compare`: one network on several targets side by side.

use crate::cli::args::input::InputArgs;
use crate::cli::args::jobs::{self, JobArgs, MappingArgs};
use crate::cli::args::reading::ReadingArgs;
use crate::cli::args::values::one_of;
use crate::cli::context::{Answer, Context};
use crate::cli::energy::workload::{simulate, workload};
use crate::cli::output;
use nsim_cost::Host;
use nsim_cost::estimate::RowUnit;
use nsim_cost::job::{Accounting, Mode};
use nsim_energy::evaluate::{self, DeploymentPlan};
use nsim_energy::options::CostOptions;
use nsim_files as io;
use nsim_files::warnings::show;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::hardware::Target;
use nsim_report::compare::{self as report, ComparedTarget, Comparison, Intervals, RefusalReason, TargetCost};
use nsim_session::error::Error;
use nsim_session::obtain::EngineKind;

const EXAMPLES: &str = "\
EXAMPLES:
  nsim compare                                      the shipped network on one Loihi and one Loihi 2
  nsim compare model.ron --targets loihi1-chip,oheo-gulch --input spikes.npy
  nsim compare model.ron --targets oheo-gulch,mine.ron --input scene:noise --format json
  nsim compare --targets loihi1-chip,nahuku-32 --samples 0..4 --format csv > targets.csv
  nsim report a.json b.json -o both.html            two results of nsim energy --format json, side by side";

/// Compare targets for a network: cores, time, energy and power side by side, with intervals
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A model file or the name of a shipped model
    #[arg(value_name = "MODEL", default_value = "vtsnn-slip")]
    model: String,
    #[command(flatten)]
    reading: ReadingArgs,
    #[command(flatten)]
    anew: MappingArgs,
    /// Targets to compare: target files or names of shipped targets, separated by commas
    #[arg(long, value_name = "TARGET,..", value_delimiter = ',', default_value = "loihi1-chip,oheo-gulch")]
    targets: Vec<String>,
    #[command(flatten)]
    input: InputArgs,
    /// As fast as possible, or held to the model's timestep
    #[arg(long, default_value = "offline", value_parser = one_of(&Mode::ALL, Mode::name))]
    mode: Mode,
    /// Source of input spikes, as --host of nsim energy [default: stream where the chip has x86
    /// cores]
    #[arg(long, value_parser = one_of(&Host::ALL, Host::name))]
    host: Option<Host>,
    /// Power that Intel's profiler attributes to the program, of the whole board, or of the whole
    /// unit
    #[arg(long, default_value = "profiler", value_parser = one_of(&Accounting::ALL, Accounting::name))]
    accounting: Accounting,
}

/// The answer is no if the network fits no target. A target that it does not fit is a row.
pub fn run(args: &Args, context: Context) -> Result<Answer, Error> {
    let targets = args.targets.iter().map(|name| Ok(io::target::load_target(name)?));
    let targets = targets.collect::<Result<Vec<Target>, Error>>()?;
    let network = args.reading.load(&args.model)?;
    let name = network.file().name.clone();
    let (mode, accounting) = (args.mode, args.accounting);
    let (input, set, targets_found) = (Vec::new(), Vec::new(), Vec::new());
    let mut comparison =
        Comparison { model: name, input, samples: 0, mode, accounting, seed: None, set, targets: targets_found };
    for (name, target) in args.targets.iter().zip(&targets) {
        let on_target = match priced(args, name, &mut comparison, context) {
            // A diagnostic of mapping reports a feature that a chip lacks.
            Err(Error::Input(problem)) if problem.code.starts_with("map.") => {
                fn reason(problem: &Diagnostic) -> RefusalReason {
                    let help = problem.help.as_ref().map_or(String::new(), |help| format!("; {help}"));
                    RefusalReason { code: problem.code.to_string(), message: problem.message.clone() + &help }
                }
                Err(std::iter::once(&*problem).chain(problem.others()).map(reason).collect())
            }
            other => other?,
        };
        let constants = target.constants().first().map_or(String::new(), |preset| preset.name.clone());
        let hardware = target.chip().hardware().to_string();
        comparison.targets.push(ComparedTarget {
            target: target.name().to_string(),
            hardware,
            constants,
            found: on_target,
        });
    }
    let set = io::changes::process_changes().iter().filter(|change| change.changes_target());
    comparison.set.extend(set.map(|change| change.path().to_string()));
    output::print(
        context.format,
        || report::text(&comparison),
        || report::json(&comparison),
        || report::csv_rows(&comparison),
    )?;
    let holds = comparison.targets.iter().any(|target| target.found.is_ok());
    Ok(if holds { Answer::Yes } else { Answer::No })
}

/// Cost of the network on one target, or the reasons for which it does not fit.
fn priced(
    args: &Args,
    name: &str,
    found: &mut Comparison,
    context: Context,
) -> Result<Result<TargetCost, Vec<RefusalReason>>, Error> {
    let job = JobArgs {
        reading: args.reading,
        target: Some(name.to_string()),
        anew: args.anew.clone(),
        needs_scene: args.input.input.is_empty(),
        ..JobArgs::for_model(&args.model)
    };
    let prepared = match jobs::prepare(&job, EngineKind::Mapped, Some(1), &[])? {
        Ok(job) => job,
        Err(refusal) => return Ok(Err(refusal.reasons().iter().map(RefusalReason::from).collect())),
    };
    let workload = workload(&prepared, None, &args.input)?;
    let plan = DeploymentPlan::new(&args.model, None, Some(1))?;
    let options = CostOptions {
        mode: args.mode,
        host: args.host,
        accounting: args.accounting,
        ..CostOptions::with_baselines(Some(&[]))?
    };
    let evaluated = evaluate::evaluate(&plan, &workload, &options, None, |metered, watched| {
        simulate(&workload, metered, watched, true, None, context)
    })?;
    show("", &evaluated.energy.detail.warnings);
    (found.input, found.seed) = (evaluated.energy.input.clone(), evaluated.energy.seed);
    found.samples = evaluated.energy.samples;
    let x86_share = evaluated.energy.estimate.x86_share;
    let total = evaluated.energy.estimate.row(RowUnit::Total).cloned();
    let row = total.ok_or_else(|| Error::Fault("an estimate without a total".to_string()))?;
    let of_level = if evaluated.energy.level.is_some() { Intervals::Works } else { Intervals::Constants };
    let intervals = row.low.map(|_| of_level);
    let (chips_used, cores_used) = (evaluated.deployment.chips_used, evaluated.deployment.cores_used);
    let constant_notes = evaluated.energy.constant_notes;
    Ok(Ok(TargetCost { chips_used, cores_used, row, intervals, constant_notes, x86_share }))
}
