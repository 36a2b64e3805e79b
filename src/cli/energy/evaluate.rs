//! From the options of a cost estimate to a simulated run and its report.

use std::path::Path;

use super::args::CostArgs;
use super::job::{self, EnergyJob, per_decision, saved};
use super::options::{DeploymentArg, DeploymentSource, HostArg, baselines, tables, with_preset};
use super::other_hardware::{self, OneCopy};
use super::workload::Workload;
use crate::cli::args::jobs::{self, JobArgs, Prepared, Wanted};
use crate::cli::args::values::Switch;
use crate::cli::context::{Answer, Context};
use crate::cli::output;
use crate::cost::estimate::{Case, step_price};
use crate::cost::{CostTable, Deployment, MeterSettings, StepMeter};
use crate::drive::decision::{EarlyExit, Rule};
use crate::drive::samples::Run;
use crate::error::Error;
use crate::io;
use crate::report::energy::table::{EnergyReport, nothing};

/// A finished run and its report.
pub struct Evaluated<'e> {
    /// The report, its detail included.
    pub energy: EnergyReport,
    /// What ran.
    pub workload: &'e Workload<'e>,
    /// What it did.
    pub run: &'e Run<StepMeter>,
    /// The numbers of cores that it is priced with.
    pub deployment: &'e Deployment,
}

/// Runs and prices a job, with a row for each timestep in a file where one is named, and warns of what stands out; `report` takes
/// the result. What does not fit is said, and the answer is no.
///
/// # Errors
/// [`Error`] when an input cannot be used; those of `report`.
pub fn evaluate(
    args: &CostArgs,
    steps: Option<&Path>,
    context: Context,
    report: impl FnOnce(Evaluated<'_>) -> Result<Answer, Error>,
) -> Result<Answer, Error> {
    let asked = baselines(args.baseline.as_deref())?;
    let (mode, convention) = (args.mode, args.convention);
    let shipped = io::published::scenario::shipped_for(&args.job.model)?;
    let source = DeploymentSource::load(&args.deployment, &args.job.model, shipped.as_ref())?;
    let deployed = match &source {
        DeploymentSource::Scenario(_, scenario) => Some(&**scenario),
        _ => None,
    };
    let scenario = deployed.or(shipped.as_ref()).filter(|_| args.job.mapping.is_none());
    let copies = args.copies.or(scenario.map(|scenario| scenario.copies.value));
    let job = match jobs::prepare_probed(&args.job, Wanted::Mapped, copies, &[])? {
        Prepared::Ready(job) => job,
        Prepared::DoesNotFit(refusal) => {
            let copies = copies.unwrap_or(1);
            return refusal.say(nothing(copies, mode, convention), context);
        }
    };
    let copies = job.copies();
    let workload = Workload::new(&job, copies, &args.input)?;
    let (compiled, target) = (workload.compiled, workload.target);
    let (target, preset) = with_preset(target.clone(), args.constants.as_deref(), deployed, args.accounting)?;
    let (target, tables) = tables(target, preset.as_deref())?;
    let placement = &compiled.placement;
    let model = &compiled.one.parts().name;
    let deployment = source.deployment(model, copies, placement, &target)?;
    let deployment = Deployment { host: deployment.host.filter(|_| args.host == HostArg::Board), ..deployment };
    let other = match (&args.deployment, &shipped) {
        (DeploymentArg::Packed, Some(job)) if job.copies.value == copies => {
            Some(Deployment::from_scenario("paper", job))
        }
        (DeploymentArg::Packed, _) => None,
        _ => Some(Deployment::from_placement("packed", placement, target.chip(), copies)),
    };
    let price = step_price(&tables[0], &deployment, copies, mode);
    let metered = workload.metered(tables, &deployment, args.transport);
    let metered = MeterSettings { distribution: Some((0, price)), ..metered };
    // Copies see the same samples and decide alike; the outputs that are watched are those of the first.
    let rule = args.early_exit.unwrap_or(Rule::Certain);
    let watched = EarlyExit::watched(rule, &compiled.one);
    let (watched, skip) = (Some(watched), args.skip == Switch::On);
    let run = match steps {
        Some(steps) => {
            workload.simulate_recorded((metered, deployment.cores_powered), watched, skip, steps, context)?
        }
        None => workload.simulate(metered, watched, skip, context)?,
    };
    let case = Case::new(&run.activity, &run.meter, &deployment, compiled.one.parts().timestep_ms);
    let steps_per_sample = workload.steps_per_sample();
    let alone = match asked.cpu && copies > 1 {
        true => Some(jobs::prepare(&JobArgs { mapping: None, ..args.job.clone() }, Wanted::Mapped, 1)?),
        false => None,
    };
    let program = match &alone {
        None => Some(&compiled.program),
        Some(Prepared::Ready(job)) => job.program(),
        Some(Prepared::DoesNotFit(_)) => None,
    };
    let one = OneCopy {
        network: &compiled.one,
        program,
        samples: &workload.samples(),
        steps: steps_per_sample,
        timestep: case.timestep,
    };
    #[cfg_attr(not(feature = "nvml"), allow(unused_mut))]
    let mut others = other_hardware::rows(&asked, one, mode, convention, args.cpu_watts);
    #[cfg(feature = "nvml")]
    if let Some(command) = &args.gpu_command {
        other_hardware::gpu(command, run.activity.steps(), one, mode, convention, &mut others);
    }
    let ends = run.meter.tables().len() - 1;
    let by_status = CostTable::by_status(&target.constants()[0])?;
    let by_status = Some(&by_status);
    let case = Case { ends, by_status, mode, convention, steps_per_sample, ..case };
    let decision = per_decision(rule, &case, &run.outcomes);
    let mut energy = job::report(&EnergyJob {
        model,
        target: &target,
        case,
        samples: run.outcomes.len() as u64,
        seed: workload.seed,
        input: &workload.origin,
        baselines: &others.rows,
        per_decision: Some(&decision),
        other: other.as_ref(),
        scenario: deployed,
        accounting: args.accounting,
        early_exit: args.early_exit.map(|rule| saved(rule, &case, &run.outcomes)),
    });
    energy.notes.extend(others.notes);
    energy.detail = workload.detail(&run);
    energy.expected = Some(workload.expected(&run)?);
    output::warn_all(&energy.detail.warnings);
    report(Evaluated { energy, workload: &workload, run: &run, deployment: &deployment })
}
