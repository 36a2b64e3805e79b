//! Runs samples on a mapped network and estimates their cost.
//!
//! Input: a compiled network, its target, samples of one copy. Output: outcomes, counts, power,
//! latency and energy.

use std::sync::Arc;

use super::metering::MeteredSteps;
use super::observers::StepRange;
use super::samples::{Meter, Run, RunSettings, fast};
use super::{Outcome, SampleSettings};
use nsim_compile::Mapping;
use nsim_cost::estimate::{Estimate, EstimateInput, estimate, step_price};
use nsim_cost::job::{Accounting, Mode};
use nsim_cost::{CostTable, Deployment, HostWork, MessageRoutes, MeterSettings, StepMeter, Transport};
use nsim_ir::activity::{Activity, CoreCounts, StepActivity};
use nsim_ir::base::diagnostic::Result;
use nsim_ir::base::id::{CoreId, Id};
use nsim_ir::base::units::Picoseconds;
use nsim_ir::groups::CoreGroups;
use nsim_ir::hardware::Target;
use nsim_ir::program::Program;
use nsim_ir::spikes::Sample;

impl Meter for StepMeter {
    fn observe(&mut self, step: &StepActivity, range: StepRange) {
        self.add(step, range.steps, range.decided);
    }

    fn merge(&mut self, other: Self) {
        StepMeter::merge(self, &other);
    }
}

/// Least number of messages of a step that is queued, so that threads meter several in parallel.
const LEAST_QUEUED: u64 = 1 << 12;

/// A meter whose steps with many messages are metered by several threads.
struct ParallelMeter {
    meter: StepMeter,
    /// Queued steps, at most one for each thread.
    queue: Vec<(StepActivity, u32, bool)>,
}

impl ParallelMeter {
    fn flush(&mut self) {
        self.meter.add_all(&self.queue);
        self.queue.clear();
    }
}

impl Meter for ParallelMeter {
    fn observe(&mut self, step: &StepActivity, range: StepRange) {
        if step.cores.iter().map(|core| core.messages_in).sum::<u64>() < LEAST_QUEUED {
            return self.meter.observe(step, range);
        }
        self.queue.push((step.clone(), range.steps, range.decided));
        if self.queue.len() >= rayon::current_num_threads() {
            self.flush();
        }
    }

    fn merge(&mut self, mut other: Self) {
        self.flush();
        other.flush();
        self.meter.merge(&other.meter);
    }
}

/// A mapping to be metered: the program that runs, and the routes of its messages and of the
/// messages of identical cores.
#[derive(Debug)]
pub struct MeteredMapping<'c> {
    compiled: &'c Mapping,
    /// One group of cores of each kind, which runs; `None` where all cores run.
    groups: Option<CoreGroups>,
    /// The routes of all messages.
    pub routes: Arc<MessageRoutes>,
}

impl<'c> MeteredMapping<'c> {
    /// Runs one group of cores for all groups that hold identical copies.
    pub fn new(compiled: &'c Mapping) -> Self {
        let groups = compiled.core_groups();
        let routes = match &groups {
            Some(groups) => MessageRoutes::of_groups(groups),
            None => MessageRoutes::of_program(&compiled.program),
        };
        MeteredMapping { compiled, groups, routes: Arc::new(routes) }
    }

    /// Runs every core: the plain method, against which tests compare.
    pub fn every_core(compiled: &'c Mapping) -> Self {
        let one = compiled.one_copy();
        let groups = CoreGroups::each(&compiled.program, one, &compiled.together()).ok();
        let program = MessageRoutes::of_program(&compiled.program);
        let routes = groups.as_ref().map_or(program, MessageRoutes::of_groups);
        MeteredMapping { compiled, groups, routes: Arc::new(routes) }
    }

    /// Returns meter settings and deployment for steps as fast as possible, on the cores of the
    /// mapping, with the target's first constants.
    ///
    /// # Errors
    /// A constant that does not fit an integer.
    pub fn offline(&self, target: &Target) -> Result<(MeterSettings, Deployment)> {
        self.offline_with(target, HostWork::for_target(target))
    }

    /// As [`Self::offline`], for this work of the x86 cores. Errors are those of [`Self::offline`].
    pub fn offline_with(&self, target: &Target, work: HostWork) -> Result<(MeterSettings, Deployment)> {
        let Mapping { placement, options, .. } = self.compiled;
        let deployment = Deployment::from_placement(options.placement.name(), placement, target, options.copies, work);
        let tables = vec![CostTable::new(&target.constants()[0])?];
        Ok((self.settings(tables, &deployment, Transport::default()), deployment))
    }

    /// Returns the settings of the meter for these presets and a deployment, for sums only.
    pub fn settings(&self, tables: Vec<CostTable>, deployment: &Deployment, transport: Transport) -> MeterSettings {
        let Mapping { options, one, .. } = self.compiled;
        let timestep = Picoseconds::from_milliseconds(one.parts().timestep_ms);
        MeterSettings::new(tables, deployment.timing(transport, options.copies), self.routes.clone(), timestep)
    }

    /// Number of copies that run; all copies behave as they do.
    pub fn copies_run(&self) -> u32 {
        self.groups.as_ref().map_or(self.compiled.options.copies, CoreGroups::copies)
    }

    /// Number of all copies.
    pub(super) fn copies(&self) -> u32 {
        self.compiled.options.copies
    }

    /// The program that runs.
    pub fn program(&self) -> &Arc<Program> {
        self.groups.as_ref().map_or(&self.compiled.program, |groups| &groups.program)
    }

    /// Runs samples on this program, with equal input to all copies and a meter for each sample.
    pub(super) fn run_with<M: Meter>(
        &self,
        samples: &[&Sample],
        run_settings: RunSettings<'_>,
        new_meter: impl Fn() -> M + Sync,
    ) -> Result<Run<M>> {
        fast(
            self.program(),
            samples,
            RunSettings { copies: self.copies_run(), per_step: true, ..run_settings },
            new_meter,
        )
    }

    /// Runs samples and meters each step. Counts by core and sums cover all copies, outcomes the
    /// first copy. Counts by source, skipped updates, and the totals and overflows of an outcome
    /// cover only the cores that ran. Errors are those of [`fast`].
    pub fn run(
        &self,
        settings: MeterSettings,
        samples: &[&Sample],
        run_settings: RunSettings<'_>,
    ) -> Result<Run<StepMeter>> {
        let settings = Arc::new(settings);
        let run = self.run_with(samples, run_settings, || ParallelMeter {
            meter: StepMeter::new(settings.clone()),
            queue: Vec::new(),
        })?;
        // Merging the meters of samples has metered all queued steps.
        Ok(self.extend_to_all_copies(run.map_meter(|shared| shared.meter)))
    }

    /// Returns the steps of a session over the program that runs here, as the run of a sample.
    pub fn run_of_session(&self, steps: MeteredSteps) -> Run<StepMeter> {
        let MeteredSteps { outcome, activity, counts, meter, skipped_updates } = steps;
        let (ranks, learned) = (Vec::new(), Vec::new());
        let outcomes = vec![outcome];
        let run = Run { outcomes, activity, counts, meter, skipped_updates, wall_s: 0.0, ranks, learned };
        self.extend_to_all_copies(run)
    }

    /// Extends the counts of the cores that ran to all cores.
    pub(super) fn extend_to_all_copies(&self, run: Run<StepMeter>) -> Run<StepMeter> {
        let Some(groups) = &self.groups else { return run };
        // Every copy receives equal input.
        let spikes_in = run.activity.spikes_in() / u64::from(groups.copies()) * u64::from(self.copies());
        let mut cores = vec![CoreCounts::default(); self.compiled.program.cores().len()];
        for group in &groups.groups {
            for (core, run_core) in group.cores.iter().zip(groups.kinds[group.kind].cores.clone()) {
                cores[core.index()] = run.activity.cores()[CoreId(run_core)];
            }
        }
        // Of identical groups only the first counts as slowest, as with cores of equal times.
        let mut slowest = vec![0; cores.len()];
        for (kind, number) in groups.kinds.iter().zip(0..) {
            let first = groups.groups.iter().find(|group| group.kind == number);
            for (core, run_core) in first.iter().flat_map(|group| &group.cores).zip(kind.cores.clone()) {
                slowest[core.index()] = run.meter.slowest_steps().get(run_core as usize).copied().unwrap_or(0);
            }
        }
        let activity = run.activity.on_cores(cores.into(), run.meter.hops(), spikes_in);
        Run { activity, meter: run.meter.with_slowest_steps(slowest), ..run }
    }
}

/// Timesteps of each sample; `None` when samples differ.
pub fn steps_per_sample(samples: &[&Sample]) -> Option<u32> {
    let same = samples.windows(2).all(|pair| pair[0].steps() == pair[1].steps());
    samples.first().filter(|_| same).map(|sample| sample.steps())
}

/// Outcomes, counts and cost of samples.
#[derive(Debug)]
pub struct Priced {
    /// Spikes and class of each sample, in run order.
    pub outcomes: Vec<Outcome>,
    /// Counts of the whole run, all copies.
    pub activity: Activity,
    /// Power, latency and energy of one copy.
    pub estimate: Estimate,
}

/// Runs samples as fast as possible and estimates power, latency and energy by the target's first
/// constants, on the cores of the mapping.
///
/// # Errors
/// A constant that does not fit an integer; as [`fast`].
pub fn run_priced(compiled: &Mapping, target: &Target, samples: &[Sample]) -> Result<Priced> {
    let copies = compiled.options.copies;
    let metered = MeteredMapping::new(compiled);
    let (settings, deployment) = metered.offline(target)?;
    let price = step_price(&settings.tables[0], &deployment, copies, Mode::Offline, Accounting::Profiler);
    let settings = MeterSettings { distribution: Some((0, price)), ..settings };
    let samples: Vec<&Sample> = samples.iter().collect();
    let run = metered.run(settings, &samples, RunSettings::new(&SampleSettings::new(compiled.program.output())))?;
    let case = EstimateInput::new(&run.activity, &run.meter, &deployment);
    let estimate = estimate(&EstimateInput { steps_per_sample: steps_per_sample(&samples), ..case });
    Ok(Priced { outcomes: run.outcomes, activity: run.activity, estimate })
}
