//! From a mapped network and its samples to a priced run and its report.
//!
//! Input: a [`Workload`], a [`Plan`] of its deployment, [`CostOptions`]. Output: [`Evaluated`]. A plan comes first, because the
//! scenario that ships for a model says how many copies of it are mapped.

use crate::base::diagnostic::Diagnostic;
use crate::cost::estimate::{Case, Convention, step_price};
use crate::cost::{CostTable, Deployment, MeterSettings, StepMeter, Transport};
use crate::desc::published::baseline::Mode;
use crate::desc::published::scenario::ScenarioFile;
use crate::desc::published::workload::Accounting;
use crate::drive::decision::{EarlyExit, Rule};
use crate::drive::samples::Run;
use crate::energy::job::{EnergyJob, per_decision, report, saved};
use crate::energy::options::{
    BaselineSelection, DeploymentArg, DeploymentSource, HostArg, Watts, baselines, tables, with_preset,
};
use crate::energy::other_hardware::{self, OneCopy};
use crate::energy::workload::Workload;
use crate::error::Error;
use crate::io;
use crate::ir::program::Program;
use crate::report::energy::table::EnergyReport;

/// How a run is priced, and what it is compared with.
#[derive(Debug)]
pub struct CostOptions {
    /// Whether the deployment's host counts.
    pub host: HostArg,
    /// As fast as possible, or held to the model's timestep.
    pub mode: Mode,
    /// How energy is computed.
    pub convention: Convention,
    /// Other hardware to compare with.
    pub baselines: BaselineSelection,
    /// Power of this machine's processor at idle and busy.
    pub cpu_watts: Option<Watts>,
    /// A command that passes the same samples through a GPU.
    #[cfg(feature = "nvml")]
    pub gpu_command: Option<String>,
    /// A preset of the target, by name, or a file; its first when left out.
    pub constants: Option<String>,
    /// Which measurements the evidence for constants counts.
    pub accounting: Accounting,
    /// How long messages take.
    pub transport: Transport,
    /// By which rule to say what ending samples early would save.
    pub early_exit: Option<Rule>,
}

impl CostOptions {
    /// What `nsim energy` does unless it is told otherwise, compared with these other pieces of hardware: all when `None`.
    ///
    /// # Errors
    /// A name that no baseline has.
    pub fn usual(names: Option<&[String]>) -> Result<Self, Diagnostic> {
        Ok(CostOptions {
            host: HostArg::Board,
            mode: Mode::Offline,
            convention: Convention::Physical,
            baselines: baselines(names)?,
            cpu_watts: None,
            #[cfg(feature = "nvml")]
            gpu_command: None,
            constants: None,
            accounting: Accounting::Profiler,
            transport: Transport::default(),
            early_exit: None,
        })
    }
}

/// The deployment of a model, as far as it is known before mapping.
#[derive(Debug)]
pub struct Plan {
    asked: DeploymentArg,
    shipped: Option<ScenarioFile>,
    source: DeploymentSource,
}

impl Plan {
    /// For a model, given by path or shipped name.
    ///
    /// # Errors
    /// As [`DeploymentSource::load`].
    pub fn new(model: &str, asked: &DeploymentArg) -> Result<Plan, Error> {
        let shipped = io::published::scenario::shipped_for(model)?;
        let source = DeploymentSource::load(asked, model, shipped.as_ref())?;
        Ok(Plan { asked: asked.clone(), shipped, source })
    }

    /// The published job whose deployment it is.
    fn deployed(&self) -> Option<&ScenarioFile> {
        match &self.source {
            DeploymentSource::Scenario(_, scenario) => Some(scenario),
            _ => None,
        }
    }

    /// Copies of the model in its scenario, if it has one.
    #[must_use]
    pub fn copies(&self) -> Option<u32> {
        self.deployed().or(self.shipped.as_ref()).map(|scenario| scenario.copies.value)
    }
}

/// A finished run and its report.
#[derive(Debug)]
pub struct Evaluated {
    /// The report, its detail included.
    pub energy: EnergyReport,
    /// What ran.
    pub run: Run<StepMeter>,
    /// The numbers of cores that it is priced with.
    pub deployment: Deployment,
}

/// Prices a workload. `alone` is the program of one copy, if there is one; `simulate` runs the workload under settings that so many
/// powered cores pay for.
///
/// # Errors
/// [`Error`] when an option does not fit the workload; those of `simulate`.
pub fn evaluate(
    plan: &Plan,
    workload: &Workload<'_>,
    options: &CostOptions,
    alone: Option<&Program>,
    simulate: impl FnOnce((MeterSettings, u64), Option<EarlyExit>) -> Result<Run<StepMeter>, Error>,
) -> Result<Evaluated, Error> {
    let CostOptions { mode, convention, accounting, .. } = *options;
    let (compiled, copies, deployed) = (workload.compiled, workload.copies, plan.deployed());
    let target = workload.target.clone();
    let (target, preset) = with_preset(target, options.constants.as_deref(), deployed, accounting)?;
    let (target, tables) = tables(target, preset.as_deref())?;
    let placement = &compiled.placement;
    let model = &compiled.one.parts().name;
    let deployment = plan.source.deployment(model, copies, placement, &target)?;
    let deployment = Deployment { host: deployment.host.filter(|_| options.host == HostArg::Board), ..deployment };
    let other = match (&plan.asked, &plan.shipped) {
        (DeploymentArg::Packed, Some(job)) if job.copies.value == copies => {
            Some(Deployment::from_scenario("paper", job))
        }
        (DeploymentArg::Packed, _) => None,
        _ => Some(Deployment::from_placement("packed", placement, target.chip(), copies)),
    };
    let price = step_price(&tables[0], &deployment, copies, mode);
    let metered = workload.metered(tables, &deployment, options.transport);
    let metered = MeterSettings { distribution: Some((0, price)), ..metered };
    // Copies see the same samples and decide alike; the outputs that are watched are those of the first.
    let rule = options.early_exit.unwrap_or(Rule::Certain);
    let watched = EarlyExit::watched(rule, &compiled.one);
    let run = simulate((metered, deployment.cores_powered), Some(watched))?;
    let case = Case::new(&run.activity, &run.meter, &deployment, compiled.one.parts().timestep_ms);
    let steps_per_sample = workload.steps_per_sample();
    let one = OneCopy {
        network: &compiled.one,
        program: alone,
        samples: &workload.samples(),
        steps: steps_per_sample,
        timestep: case.timestep,
    };
    #[cfg_attr(not(feature = "nvml"), allow(unused_mut))]
    let mut others = other_hardware::rows(&options.baselines, one, mode, convention, options.cpu_watts);
    #[cfg(feature = "nvml")]
    if let Some(command) = &options.gpu_command {
        other_hardware::gpu(command, run.activity.steps(), one, mode, convention, &mut others);
    }
    let ends = run.meter.tables().len() - 1;
    let by_status = CostTable::by_status(&target.constants()[0])?;
    let by_status = Some(&by_status);
    let case = Case { ends, by_status, mode, convention, steps_per_sample, ..case };
    let decision = per_decision(rule, &case, &run.outcomes);
    let mut energy = report(&EnergyJob {
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
        accounting,
        early_exit: options.early_exit.map(|rule| saved(rule, &case, &run.outcomes)),
    });
    energy.notes.extend(others.notes);
    energy.detail = workload.detail(&run);
    energy.expected = Some(workload.expected(&run)?);
    Ok(Evaluated { energy, run, deployment })
}
