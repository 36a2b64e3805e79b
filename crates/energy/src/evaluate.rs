//! From a mapped network and its samples to a priced run and its report.
//!
//! Input: a [`Workload`], a [`DeploymentPlan`] of its deployment, [`CostOptions`]. Output:
//! [`Evaluation`]. A plan comes first, because a published job gives the number of its copies.

use std::collections::BTreeSet;
use std::sync::Arc;

use crate::baseline::{Baseline, NetworkShape};
use crate::job::{early_exit_savings, per_decision, report};
use crate::options::{CostOptions, DeploymentSource, select_constants};
use crate::other_hardware::{self, CopyWorkload};
use crate::paper;
use crate::published::scenario::{ScenarioFile, shipped_for};
use crate::report::table::{EnergyReport, JobPart};
use crate::workload::Workload;
use nsim_compile::{CopyPlacement, Mapping};
use nsim_cost::estimate::{ByStatus, Convention, EnergyRow, EstimateInput, FigureSource, estimate, step_price};
use nsim_cost::job::{Accounting, DeployedCores};
use nsim_cost::{CostTable, Deployment, Host, HostWork, MeterSettings, StepMeter};
use nsim_files::table::three;
use nsim_ir::hardware::Target;
use nsim_ir::hardware::constants::{Constant, Status};
use nsim_ir::microcode::{COMPARTMENT_INSTRUCTIONS, UpdatePrice};
use nsim_ir::program::Program;
use nsim_ir::quantised::{Population, Quantised};
use nsim_ir::spikes::Sample;
use nsim_session::decision::{EarlyExit, Rule};
use nsim_session::error::Error;
use nsim_session::samples::Run;
use nsim_session::{Outcome, share_correct};

/// The deployment of a model, as far as it is known before mapping.
#[derive(Debug)]
pub struct DeploymentPlan {
    /// Whether the deployment was given.
    is_explicit: bool,
    copies: Option<u32>,
    shipped: Option<ScenarioFile>,
    source: DeploymentSource,
}

impl DeploymentPlan {
    /// Returns the plan for a model, by path or shipped name, and the requested number of copies.
    ///
    /// # Errors
    /// As [`DeploymentSource::load`].
    pub fn new(model: &str, deployment: Option<&str>, copies: Option<u32>) -> Result<DeploymentPlan, Error> {
        let shipped = shipped_for(model)?;
        let named = deployment.unwrap_or(CopyPlacement::default().name());
        let source = DeploymentSource::load(named, model)?;
        Ok(DeploymentPlan { is_explicit: deployment.is_some(), copies, shipped, source })
    }

    /// The published job whose deployment it is.
    pub fn job(&self) -> Option<&ScenarioFile> {
        match &self.source {
            DeploymentSource::Scenario(_, scenario) => Some(scenario),
            _ => None,
        }
    }

    /// Number of copies to map, if known: one where a job or numbers of cores are given.
    pub fn mapped_copies(&self) -> Option<u32> {
        match &self.source {
            DeploymentSource::Scenario(..) | DeploymentSource::Numbers(_) => Some(1),
            DeploymentSource::Mapping(_, file) => self.copies.or(Some(file.copies)),
            DeploymentSource::Mapped(_) => self.copies,
        }
    }

    /// Checks that the plan can apply to an existing mapping.
    ///
    /// # Errors
    /// [`Error::Usage`] where the plan places copies anew.
    pub fn check_mapping(&self) -> Result<(), Error> {
        match &self.source {
            DeploymentSource::Mapped(copies) if self.is_explicit => Err(Error::Usage(format!(
                "the mapping already places its copies: map with the deployment {}, or remove it here",
                copies.name()
            ))),
            _ => Ok(()),
        }
    }

    /// Placement of the mapping's copies.
    pub fn placement(&self) -> CopyPlacement {
        if let DeploymentSource::Mapped(copies) = self.source { copies } else { CopyPlacement::default() }
    }

    /// Number of copies of the deployment, of which `mapped` are mapped.
    fn copies(&self, mapped: u32) -> u32 {
        match &self.source {
            DeploymentSource::Scenario(_, scenario) => self.copies.unwrap_or(scenario.copies.value),
            DeploymentSource::Numbers(_) => self.copies.unwrap_or(1),
            DeploymentSource::Mapped(_) | DeploymentSource::Mapping(..) => mapped,
        }
    }

    /// The model's measured job on this target, if numbers of cores were given: they are numbers of
    /// that job, with others.
    fn job_of_numbers(&self, target: &Target) -> Option<(&ScenarioFile, DeployedCores)> {
        let DeploymentSource::Numbers(cores) = self.source else { return None };
        self.shipped.as_ref().filter(|job| job.is_on(target)).map(|job| (job, cores))
    }

    /// The published job whose network is mapped: of `paper` or a file; of numbers of cores, if a
    /// copy has as many as in the model's measured job, since fewer cannot hold its network.
    fn mapped_job(&self, target: &Target) -> Option<&ScenarioFile> {
        let copies = u64::from(self.copies.unwrap_or(1));
        let has_room = |(job, cores): &(&ScenarioFile, DeployedCores)| {
            let of_job = job.deployment.value.cores_used * copies;
            cores.cores_used * u64::from(job.copies.value) >= of_job
        };
        self.job().or_else(|| self.job_of_numbers(target).filter(has_room).map(|(job, _)| job))
    }

    /// Maps the network of the published job, with input relays where the job had them.
    ///
    /// # Errors
    /// When the job is of other networks, or its network does not compile.
    pub fn map_job(&self, compiled: &Mapping, target: &Target) -> Result<Option<Mapping>, Error> {
        self.source.check_network(&compiled.one)?;
        self.mapped_job(target).map(|scenario| paper::mapped(&compiled.one, scenario, target)).transpose()
    }

    /// Remark on relays of the measured job, where numbers of cores were given.
    fn relays_note(&self, target: &Target) -> Option<String> {
        let (job, _) = self.job_of_numbers(target).filter(|(job, _)| job.input_relays)?;
        let each = three(job.deployment.value.cores_used as f64 / f64::from(job.copies.value));
        Some(match self.mapped_job(target) {
            Some(_) => format!("Inputs have relays, as in {}, because a copy has its {each} cores.", job.work),
            None => format!("No relays of inputs: a copy has fewer than the {each} cores of {}.", job.work),
        })
    }
}

/// Whether the injection of the inputs takes as long as the barrier. Where it does not, injection
/// is less than half of a step.
fn may_be_half_of_a_step(
    workload: &Workload<'_>,
    deployment: &Deployment,
    options: &CostOptions,
    table: &CostTable,
) -> bool {
    let samples = workload.samples();
    let steps: u64 = samples.iter().map(|sample| u64::from(sample.steps())).sum();
    let spikes = samples.iter().map(|sample| sample.spikes() as u64).sum::<u64>() * u64::from(workload.copies);
    let times = deployment.timing(options.transport, workload.copies).host_and_barrier(spikes, table);
    times.injection.0 > 0 && times.injection.0 / steps.max(1) >= times.barrier.0
}

/// The job's row with inputs already on the chip, where injection is more than half of a step.
fn inputs_on_chip(case: &EstimateInput<'_>, without_host: &Deployment) -> Option<EnergyRow> {
    let total = |case: &EstimateInput<'_>| {
        let found = estimate(case);
        Some((found.rows.into_iter().find(|row| row.unit == "total")?, found.time_us?[0].1))
    };
    let (row, injection_us) = total(case)?;
    if injection_us <= row.latency_us? / 2.0 {
        return None;
    }
    Some(total(&EstimateInput { without_host: true, deployment: without_host, ..*case })?.0)
}

/// A finished run and its report.
#[derive(Debug)]
pub struct Evaluation {
    /// The report, its detail included.
    pub energy: EnergyReport,
    /// The run.
    pub run: Run<StepMeter>,
    /// The numbers of cores of its cost.
    pub deployment: Deployment,
}

/// Remark on the price of an update of each kind that the model declares; `time` is the preset's
/// time of a program.
fn kind_notes(network: &Quantised, time: &Constant) -> BTreeSet<String> {
    let kinds = network.populations().iter().map(Population::kind);
    let note = |(name, price): (&str, UpdatePrice)| match price {
        UpdatePrice::Stated { energy, time } => {
            let [energy, time] = [energy, time].map(|thousandths| thousandths as f64 / 1e3);
            format!("An update of {name} costs {energy} pJ and {time} ns, as the model states.")
        }
        UpdatePrice::Instructions(instructions) => {
            let share = format!("{instructions}/{COMPARTMENT_INSTRUCTIONS} of a visited compartment");
            let cost = match (time.status, time.bounds) {
                (Status::NotGiven, _) => format!("has {instructions} instructions and costs {share}"),
                (_, bounds) => {
                    let bounds = bounds.map_or(String::new(), |(low, high)| format!(" ({low} to {high})"));
                    format!(
                        "takes {} ns{bounds}, regardless of its program, and the energy of {share}",
                        time.value.value
                    )
                }
            };
            format!("An update of {name} {cost} (time: \"5ns\", energy: \"12pJ\" in its Kind state a price).")
        }
    };
    kinds.filter_map(|kind| Some((kind.name(), kind.own_price()?))).map(note).collect()
}

/// Prices a workload; `simulate` runs it under settings. `alone` is one copy of the model and its
/// program, if there is one, for the rows of other hardware.
///
/// # Errors
/// [`Error`] when an option does not fit the workload; otherwise as `simulate`.
pub fn evaluate(
    plan: &DeploymentPlan,
    workload: &Workload<'_>,
    options: &CostOptions,
    alone: Option<(&Quantised, &Arc<Program>)>,
    simulate: impl FnOnce(MeterSettings, Option<EarlyExit>) -> Result<Run<StepMeter>, Error>,
) -> Result<Evaluation, Error> {
    let CostOptions { mode, convention, accounting, .. } = *options;
    let compiled = workload.compiled;
    let (target, table) = select_constants(workload.target.clone(), options.constants.as_deref())?;
    let model = &compiled.one.parts().name;
    let steps_per_sample = workload.steps_per_sample();
    let work = options.host_work(&target, workload.mean_steps())?;
    let copies = plan.copies(workload.copies);
    let deployment = plan.source.deployment(compiled, &target, copies, work)?;
    options.check_x86(&deployment, &target)?;
    let preset = &target.constants()[0];
    options.check_accounting(&target)?;
    let price = step_price(&table, &deployment, workload.copies, (mode, accounting));
    let corners = if target.is_measured_by(preset) { CostTable::corners(preset)? } else { None };
    let without_host = plan.source.deployment(compiled, &target, copies, HostWork { host: Host::None, ..work })?;
    let may_be_half = may_be_half_of_a_step(workload, &deployment, options, &table);
    let tables = std::iter::once(table).chain(corners.iter().flatten().cloned()).collect();
    let metered = MeterSettings {
        distribution: Some((0, price)),
        without_host: may_be_half.then(|| without_host.timing(options.transport, workload.copies)),
        ..workload.metered(tables, &deployment, options.transport)
    };
    // Copies receive equal samples and decide equally, so only the first's outputs are watched.
    let rule = options.early_exit.unwrap_or(Rule::Certain);
    let watched = match options.early_exit {
        Some(rule) => EarlyExit { ends: false, ..EarlyExit::new(rule, &compiled.one)? },
        None => EarlyExit::recording_only(rule, &compiled.one),
    };
    let run = simulate(metered, Some(watched))?;
    let by_status = ByStatus::new(preset, deployment.chips_used)?;
    let case = EstimateInput {
        copies_counted: workload.copies,
        hardware: target.chip().hardware(),
        errors: target.errors(preset),
        corners: corners.map(|_| [1, 2]),
        by_status: Some(&by_status),
        mode,
        accounting,
        convention,
        steps_per_sample,
        ..EstimateInput::new(&run.activity, &run.meter, &deployment)
    };
    let one = CopyWorkload {
        network: alone.map_or(&compiled.one, |(network, _)| network),
        program: alone.map(|(_, program)| program),
        samples: &workload.samples(),
        steps: steps_per_sample,
        timestep: run.meter.settings().timestep,
    };
    let mut others = other_hardware::rows(&options.baselines, one, mode, convention, options.cpu_watts);
    #[cfg(feature = "nvml")]
    if let Some(command) = &options.gpu_command {
        other_hardware::gpu(command, run.activity.steps(), one, mode, convention, &mut others);
    }
    let measured_job = plan.shipped.as_ref().filter(|job| job.is_on(&target) && accounting == Accounting::Profiler);
    let (mut rows, mut as_in) = (Vec::new(), Vec::new());
    if let Some(job) = measured_job {
        if plan.job().is_none() {
            let is_mapped = plan.mapped_job(&target).is_some();
            // The job keeps its own host, whatever is asked for here.
            let of_job = HostWork { steps_per_sample: work.steps_per_sample, ..HostWork::for_target(&target) };
            as_in = paper::rows((workload, is_mapped), job, options, &target, of_job)?;
            let total = as_in.iter().find(|row| row.unit == "total").cloned();
            rows.extend(total.map(|total| (total, "the measured job, by the same constants".to_string())));
        }
        rows.extend(paper::printed(job, "total", mode, convention, steps_per_sample)?);
    }
    others.rows.splice(0..0, rows);
    let as_printed = |unit| match measured_job {
        Some(job) => paper::printed(job, unit, mode, Convention::Published, steps_per_sample),
        None => Ok(None),
    };
    let shape = NetworkShape::from_network(one.network);
    let row = |file: &Baseline| file.row(&shape, one.steps, one.timestep, mode, Convention::Published).ok();
    let published = options.baselines.files.iter().filter_map(row).filter(|row| row.source == FigureSource::Published);
    let published = as_printed("total")?.map(|(row, _)| row).into_iter().chain(published);
    let printed = published.filter_map(|row| Some([row.energy_uj?, row.edp_pjs?])).collect();
    let mut energy = report(model, &target, &case, run.outcomes.len() as u64, others.rows);
    let here = if as_in.is_empty() { &energy.estimate.rows } else { &as_in };
    for unit in ["x86", "neuron"] {
        let own = here.iter().find(|row| row.unit == unit).cloned();
        let parts = own.zip(as_printed(unit)?).map(|(here, (printed, _))| JobPart { here, printed });
        energy.parts.extend(parts);
    }
    energy.constant_notes.extend(kind_notes(&compiled.one, &preset.microcode_time));
    energy.inputs_on_chip = may_be_half.then(|| inputs_on_chip(&case, &without_host)).flatten();
    energy.constant_notes.extend(plan.relays_note(&target));
    energy.seed = workload.seed;
    energy.input.clone_from(&workload.origin);
    let labels = workload.samples().into_iter().map(Sample::label);
    let right = share_correct(&run.outcomes, labels, Outcome::class_when_decided);
    let decision = per_decision(rule, &case, &run.outcomes, right);
    energy.job.clone_from(&plan.shipped);
    energy.early_exit = options.early_exit.map(|rule| early_exit_savings(rule, &case, &run.outcomes, &decision));
    energy.comparison.per_decision = compiled.one.decides().then_some(decision);
    energy.printed = printed;
    energy.accuracy = workload.accuracy(&run.outcomes);
    energy.undecided = run.outcomes.iter().filter(|outcome| outcome.class().is_none()).count();
    energy.labelled = workload.samples().iter().filter(|sample| sample.label().is_some()).count() as u64;
    energy.detail = workload.detail(&run);
    energy.detail.warnings.extend(energy.estimate.warnings.iter().cloned().chain(others.warnings));
    energy.expected = Some(workload.expected(&run)?);
    Ok(Evaluation { energy, run, deployment })
}
