//! From the options of a cost estimate to a simulated run and its report.

use std::path::Path;

use crate::cli::args::jobs::{self, JobArgs};
use crate::cli::args::values::Switch;
use crate::cli::context::{Answer, Context};
use crate::cli::energy::args::CostArgs;
use crate::cli::energy::workload::{simulate, workload};
use crate::cli::process::ranks;
use nsim_energy::evaluate::{self, DeploymentPlan, Evaluation};
use nsim_energy::options::{CostOptions, baselines};
use nsim_energy::report::result::empty_result;
use nsim_energy::workload::Workload;
use nsim_files::warnings::show;
use nsim_session::error::Error;
use nsim_session::obtain::EngineKind;

/// Runs and prices a job, prints its warnings, and passes the result to `report`. With `steps` each
/// timestep is a row of that file. A model that does not fit is reported, and the answer is no.
pub fn evaluate(
    args: &CostArgs,
    steps: Option<&Path>,
    context: Context,
    report: impl FnOnce(&Workload<'_>, Evaluation) -> Result<Answer, Error>,
) -> Result<Answer, Error> {
    ranks::price();
    let options = options(args)?;
    let plan = DeploymentPlan::new(&args.job.model, args.deployment.as_deref(), args.copies)?;
    if args.job.mapping.is_some() {
        plan.check_mapping()?;
    }
    let copies = plan.mapped_copies();
    let needs_scene = args.input.input.is_empty();
    let mapped_as = JobArgs { placement: plan.placement(), needs_scene, ..args.job.clone() };
    let job = match jobs::prepare(&mapped_as, EngineKind::Mapped, copies, &[])? {
        Ok(job) => job,
        Err(refusal) => {
            let copies = copies.unwrap_or(1);
            return refusal.print(empty_result(copies, args.mode, args.convention), context);
        }
    };
    // The network of a published job is mapped as in its publication.
    let of_job = job.mapped().map(|(compiled, target)| plan.map_job(compiled, target)).transpose()?.flatten();
    let workload = workload(&job, of_job.as_ref(), &args.input)?;
    // Other hardware runs the network without additions for the chip, such as relays.
    let alone = match of_job.is_some() || options.baselines.cpu && workload.copies > 1 {
        true => Some(jobs::prepare(&JobArgs { mapping: None, ..args.job.clone() }, EngineKind::Mapped, Some(1), &[])?),
        false => None,
    };
    let alone = match &alone {
        None => Some((&workload.compiled.one, &workload.compiled.program)),
        Some(Ok(job)) => job.mapped().map(|(compiled, _)| (&compiled.one, &compiled.program)),
        Some(Err(_)) => None,
    };
    let skip = args.skip == Switch::On;
    let mut evaluated = evaluate::evaluate(&plan, &workload, &options, alone, |metered, watched| {
        let run = simulate(&workload, metered, watched, skip, steps, context)?;
        ranks::leave_to_first();
        Ok(run)
    })?;
    let detail = &mut evaluated.energy.detail;
    detail.ranks = ranks::rows(&detail.ranks, Some(&workload.compiled.program));
    show("", &evaluated.energy.detail.warnings);
    report(&workload, evaluated)
}

fn options(args: &CostArgs) -> Result<CostOptions, Error> {
    Ok(CostOptions {
        host: args.host,
        streams: args.streams,
        reset_words: args.reset_words,
        mode: args.mode,
        convention: args.convention,
        baselines: baselines(args.baseline.as_deref())?,
        cpu_watts: args.cpu_watts,
        #[cfg(feature = "nvml")]
        gpu_command: args.gpu_command.clone(),
        constants: args.constants.clone(),
        accounting: args.accounting,
        transport: args.transport,
        early_exit: args.early_exit,
    })
}
