//! From a mapped network and its samples to a priced run and its report.
//!
//! Input: a [`Workload`], a [`DeploymentPlan`] of its deployment, [`CostOptions`]. Output:
//! [`Evaluation`]. A plan comes first, because a published job gives the number of its copies.

use std::collections::BTreeSet;
use std::sync::Arc;

use crate::baseline::{Baseline, NetworkShape, RowConditions};
use crate::job::{early_exit_savings, per_decision, report};
use crate::options::{CostOptions, DeploymentSource, select_constants};
use crate::other_hardware::{self, CopyWorkload};
use crate::paper;
use crate::published::scenario::{ScenarioFile, shipped_for};
use crate::report::result::{EnergyReport, JobPart};
use crate::workload::Workload;
use nsim_compile::{CopyPlacement, Mapping};
use nsim_cost::estimate::{
    ByStatus, Convention, EnergyRow, EstimateInput, FigureSource, RowUnit, estimate, step_price,
};
use nsim_cost::job::{Accounting, DeployedCores};
use nsim_cost::{CostTable, Deployment, Host, HostWork, MeterSettings, StepMeter, Timing};
use nsim_files::table::three;
use nsim_ir::base::diagnostic::Diagnostic;
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

    /// The model's measured job on this target, and the numbers of cores given in place of its own.
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

/// Whether injection takes more than half of a step.
fn is_mostly_injection(step: f64, injection: f64) -> bool {
    injection > step / 2.0
}

/// Whether injection may take more than half of a step, whose other time is at least the barrier.
fn may_be_mostly_injection(workload: &Workload<'_>, timing: Timing, table: &CostTable) -> bool {
    let samples = workload.samples();
    let steps: u64 = samples.iter().map(|sample| u64::from(sample.steps())).sum();
    let spikes = samples.iter().map(|sample| sample.spikes() as u64).sum::<u64>() * u64::from(workload.copies);
    let times = timing.host_and_barrier(spikes, table);
    let (injection, barriers) = (times.injection.0 as f64, times.barrier.0 as f64 * steps as f64);
    is_mostly_injection(injection + barriers, injection)
}

/// The job's row with inputs already on the chip, where injection is more than half of a step.
fn inputs_on_chip(case: &EstimateInput<'_>, without_host: &Deployment) -> Option<EnergyRow> {
    let total = |case: &EstimateInput<'_>| {
        let estimate = estimate(case);
        Some((estimate.row(RowUnit::Total)?.clone(), estimate.time_us?[0].1))
    };
    let (row, injection_us) = total(case)?;
    if !is_mostly_injection(row.latency_us?, injection_us) {
        return None;
    }
    Some(total(&EstimateInput { without_host: true, deployment: without_host, ..*case })?.0)
}

/// A finished run and its report.
#[derive(Debug)]
pub struct Evaluation {
    /// The report, its detail included.
    pub energy: EnergyReport,
    /// Outcomes, counts and meter of the samples.
    pub run: Run<StepMeter>,
    /// The numbers of cores of its cost.
    pub deployment: Deployment,
}

/// Remark on the price of an update of each declared kind; `time` is the preset's, of a program.
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

/// Target and deployments of a run.
struct Conditions {
    target: Target,
    deployment: Deployment,
    /// The deployment with inputs already on the chip.
    without_host: Deployment,
    /// Indices of the corners of the preset's bounds in the meter's tables.
    corners: Option<[usize; 2]>,
}

impl Conditions {
    fn new(
        plan: &DeploymentPlan,
        workload: &Workload<'_>,
        options: &CostOptions,
    ) -> Result<(Self, MeterSettings), Error> {
        let compiled = workload.compiled;
        let (target, table) = select_constants(workload.target.clone(), options.constants.as_deref())?;
        let work = options.host_work(&target, workload.mean_steps())?;
        let copies = plan.copies(workload.copies);
        let deployment = plan.source.deployment(compiled, &target, copies, work)?;
        options.check_x86(&deployment, &target)?;
        let preset = &target.constants()[0];
        options.check_accounting(&target)?;
        let price = step_price(&table, &deployment, workload.copies, options.mode, options.accounting);
        let corners = if target.is_measured_by(preset) { CostTable::corners(preset)? } else { None };
        let without_host = plan.source.deployment(compiled, &target, copies, HostWork { host: Host::None, ..work })?;
        let timing = |deployment: &Deployment| deployment.timing(options.transport, workload.copies);
        let is_metered_twice = workload.is_stepped || may_be_mostly_injection(workload, timing(&deployment), &table);
        let tables = std::iter::once(table).chain(corners.iter().flatten().cloned()).collect();
        let settings = MeterSettings {
            distribution: Some((0, price)),
            without_host: is_metered_twice.then(|| timing(&without_host)),
            ..workload.metered(tables, &deployment, options.transport)
        };
        Ok((Conditions { deployment, without_host, corners: corners.map(|_| [1, 2]), target }, settings))
    }
}

/// Rows of the published job of a model, where it was measured on the target.
#[derive(Default)]
struct MeasuredJob {
    /// Its total by the report's constants, and its total as printed; with their sources.
    totals: Vec<(EnergyRow, String)>,
    /// Its units by the report's constants, unless the report's own rows are the job's.
    computed: Vec<EnergyRow>,
    /// Its units as printed, in the published convention.
    printed: Vec<EnergyRow>,
}

impl MeasuredJob {
    fn new(
        plan: &DeploymentPlan,
        workload: &Workload<'_>,
        options: &CostOptions,
        target: &Target,
    ) -> Result<Self, Error> {
        let CostOptions { mode, convention, accounting, .. } = *options;
        let steps = workload.steps_per_sample();
        let measured = plan.shipped.as_ref().filter(|job| job.is_on(target) && accounting == Accounting::Profiler);
        let Some(job) = measured else { return Ok(MeasuredJob::default()) };
        let (mut totals, mut computed) = (Vec::new(), Vec::new());
        // The input of a session is not stored, so it does not run as the job.
        if plan.job().is_none() && !workload.is_stepped {
            let is_mapped = plan.mapped_job(target).is_some();
            // The job keeps its own host, whatever is asked for here.
            let of_job = HostWork { steps_per_sample: workload.mean_steps(), ..HostWork::for_target(target) };
            computed = paper::rows(workload, is_mapped, job, options, target, of_job)?;
            let total = computed.iter().find(|row| row.unit == RowUnit::Total).cloned();
            totals.extend(total.map(|total| (total, "the measured job, by the same constants".to_string())));
        }
        totals.extend(paper::printed(job, RowUnit::Total, mode, convention, steps)?);
        let mut printed = Vec::new();
        for unit in [RowUnit::Total, RowUnit::X86, RowUnit::Neuron] {
            printed.extend(paper::printed(job, unit, mode, Convention::Published, steps)?.map(|(row, _)| row));
        }
        Ok(MeasuredJob { totals, computed, printed })
    }

    /// Its x86 core and neuron cores; `own` are the report's rows.
    fn parts(&self, own: &[EnergyRow]) -> Vec<JobPart> {
        let rows = if self.computed.is_empty() { own } else { &self.computed };
        let part = |printed: &EnergyRow| {
            let here = rows.iter().find(|row| row.unit == printed.unit)?.clone();
            Some(JobPart { here, printed: printed.clone() })
        };
        self.printed.iter().filter(|row| row.unit.is_part()).filter_map(part).collect()
    }
}

/// Energy and energy-delay product as printed for the job and other published hardware.
fn printed_figures(measured: &MeasuredJob, options: &CostOptions, one: CopyWorkload<'_>) -> Vec<[f64; 2]> {
    let shape = NetworkShape::from_network(one.network);
    let conditions = RowConditions { convention: Convention::Published, ..one.conditions };
    let row = |file: &Baseline| file.row(&shape, conditions).ok();
    let published = options.baselines.files.iter().filter_map(row).filter(|row| row.source == FigureSource::Published);
    let job = measured.printed.iter().filter(|row| row.unit == RowUnit::Total).cloned();
    job.chain(published).filter_map(|row| Some([row.energy_uj?, row.edp_pjs?])).collect()
}

/// Settings of the meter of a session on a mapping, which is priced by this plan and these options.
///
/// # Errors
/// [`Error`] for options that need the input of the session or its length; otherwise as
/// [`evaluate`].
pub fn session_settings(
    plan: &DeploymentPlan,
    options: &CostOptions,
    compiled: &Mapping,
    target: &Target,
) -> Result<MeterSettings, Error> {
    let refused = if options.baselines.cpu {
        Some("the baseline cpu runs samples again, but the input of a session is not stored")
    } else if options.early_exit.is_some() {
        Some("early_exit decides by the end of a sample, which a session does not know")
    } else if options.reset_words > 0 {
        Some("reset_words are divided by the length of a sample, which a session does not know")
    } else if plan.mapped_job(target).is_some() {
        Some("the deployment maps another network than the session steps")
    } else {
        None
    };
    if let Some(refused) = refused {
        let problem = Diagnostic::new("session.energy", refused);
        return Err(problem.help("price a sample: mapping.energy(spikes, ..)").into());
    }
    Ok(Conditions::new(plan, &Workload::of_session(compiled, target, 1)?, options)?.1)
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
    let network = &workload.compiled.one;
    let (conditions, settings) = Conditions::new(plan, workload, options)?;
    let Conditions { target, deployment, .. } = &conditions;
    // Copies receive equal samples and decide equally, so only the first's outputs are watched.
    let rule = options.early_exit.unwrap_or(Rule::Certain);
    let watched = match options.early_exit {
        Some(rule) => EarlyExit { ends: false, ..EarlyExit::new(rule, network)? },
        None => EarlyExit::recording_only(rule, network),
    };
    let run = simulate(settings, Some(watched))?;
    let preset = &target.constants()[0];
    let by_status = ByStatus::new(preset, deployment.chips_used)?;
    let case = EstimateInput {
        copies_counted: workload.copies,
        hardware: target.chip().hardware(),
        errors: target.errors(preset),
        corners: conditions.corners,
        by_status: Some(&by_status),
        mode,
        accounting,
        convention,
        steps_per_sample: workload.steps_per_sample(),
        ..EstimateInput::new(&run.activity, &run.meter, deployment)
    };
    let one = CopyWorkload {
        network: alone.map_or(network, |(network, _)| network),
        program: alone.map(|(_, program)| program),
        samples: &workload.samples(),
        conditions: RowConditions {
            steps: case.steps_per_sample,
            timestep: run.meter.settings().timestep,
            mode,
            convention,
        },
    };
    let mut others = other_hardware::rows(&options.baselines, one, options.cpu_watts);
    #[cfg(feature = "nvml")]
    if let Some(command) = &options.gpu_command {
        other_hardware::gpu(command, run.activity.steps(), one, &mut others);
    }
    let mut measured = MeasuredJob::new(plan, workload, options, target)?;
    others.rows.splice(0..0, std::mem::take(&mut measured.totals));
    let mut energy = report(&network.parts().name, target, &case, run.outcomes.len() as u64, others.rows);
    energy.parts = if workload.is_stepped { Vec::new() } else { measured.parts(&energy.estimate.rows) };
    energy.printed = printed_figures(&measured, options, one);
    energy.constant_notes.extend(kind_notes(network, &preset.microcode_time));
    energy.constant_notes.extend(plan.relays_note(target));
    if run.meter.settings().without_host.is_some() {
        energy.inputs_on_chip = inputs_on_chip(&case, &conditions.without_host);
    }
    energy.job.clone_from(&plan.shipped);
    let labels = workload.samples().into_iter().map(Sample::label);
    let right = share_correct(&run.outcomes, labels, Outcome::class_when_decided);
    let decision = per_decision(rule, &case, &run.outcomes, right);
    energy.early_exit = options.early_exit.map(|rule| early_exit_savings(rule, &case, &run.outcomes, &decision));
    energy.comparison.per_decision = (network.decides() && !workload.is_stepped).then_some(decision);
    describe_run(workload, &run, &mut energy)?;
    energy.detail.warnings.extend(others.warnings);
    Ok(Evaluation { energy, run, deployment: conditions.deployment })
}

/// Adds to a report what the samples and the run say without constants.
fn describe_run(workload: &Workload<'_>, run: &Run<StepMeter>, energy: &mut EnergyReport) -> Result<(), Error> {
    energy.seed = workload.seed;
    energy.input.clone_from(&workload.origin);
    energy.accuracy = workload.accuracy(&run.outcomes);
    energy.undecided = run.outcomes.iter().filter(|outcome| outcome.class().is_none()).count();
    energy.labelled = workload.samples().iter().filter(|sample| sample.label().is_some()).count() as u64;
    energy.detail = workload.detail(run);
    energy.detail.warnings.extend(energy.estimate.warnings.iter().cloned());
    energy.expected = Some(workload.expected(run)?);
    Ok(())
}
