//! Runs samples on a mapped network and estimates what that costs.
//!
//! Input: a compiled network, its target, samples of one copy. Output: outcomes, counts, power,
//! latency and energy.

use std::sync::Arc;

use super::observers::Passed;
use super::samples::{Meter, Run, Running, fast};
use super::{Keep, Outcome};
use nsim_compile::Mapping;
use nsim_cost::estimate::{Case, Estimate, estimate, step_price};
use nsim_cost::job::{Accounting, Mode};
use nsim_cost::{CostTable, Deployment, HostWork, MessageRoutes, MeterSettings, StepMeter, Transport};
use nsim_ir::activity::{Activity, CoreCounts, StepActivity};
use nsim_ir::base::diagnostic::Result;
use nsim_ir::base::id::{CoreId, Id};
use nsim_ir::base::units::Picoseconds;
use nsim_ir::groups::CoreGroups;
use nsim_ir::hardware::Target;
use nsim_ir::program::Program;
use nsim_ir::spikes::{Copies, Sample};

impl Meter for StepMeter {
    fn see(&mut self, step: &StepActivity, passed: Passed) {
        self.add(step, passed.steps, passed.decided);
    }

    fn merge(&mut self, other: Self) {
        StepMeter::merge(self, &other);
    }
}

/// Messages of a step from which on it waits for others, which threads follow at the same time.
const MANY: u64 = 1 << 12;

/// A meter whose busy steps are followed by several threads.
struct Shared {
    meter: StepMeter,
    /// As many steps as threads at most.
    waiting: Vec<(StepActivity, u32, bool)>,
}

impl Shared {
    fn follow(&mut self) {
        self.meter.add_all(&self.waiting);
        self.waiting.clear();
    }
}

impl Meter for Shared {
    fn see(&mut self, step: &StepActivity, passed: Passed) {
        if step.cores.iter().map(|core| core.messages_in).sum::<u64>() < MANY {
            return self.meter.see(step, passed);
        }
        self.waiting.push((step.clone(), passed.steps, passed.decided));
        if self.waiting.len() >= rayon::current_num_threads() {
            self.follow();
        }
    }

    fn merge(&mut self, mut other: Self) {
        self.follow();
        other.follow();
        self.meter.merge(&other.meter);
    }
}

/// A mapping as it is metered: the program that is run, and where its messages and those of cores
/// that do the same go.
#[derive(Debug)]
pub struct Metered<'c> {
    compiled: &'c Mapping,
    /// One group of cores of each kind; `None` where all cores are run.
    groups: Option<CoreGroups>,
    /// The routes of all messages.
    pub routes: Arc<MessageRoutes>,
}

impl<'c> Metered<'c> {
    /// Of groups of cores that hold identical copies, one is run for all.
    pub fn new(compiled: &'c Mapping) -> Self {
        let groups = compiled.core_groups();
        let routes = match &groups {
            Some(groups) => MessageRoutes::of_groups(groups),
            None => MessageRoutes::of_program(&compiled.program),
        };
        Metered { compiled, groups, routes: Arc::new(routes) }
    }

    /// Metered steps with every core run: the obvious way, which tests compare with.
    pub fn every_core(compiled: &'c Mapping) -> Self {
        let one = compiled.one_copy();
        let groups = CoreGroups::each(&compiled.program, one, &compiled.together()).ok();
        let program = MessageRoutes::of_program(&compiled.program);
        let routes = groups.as_ref().map_or(program, MessageRoutes::of_groups);
        Metered { compiled, groups, routes: Arc::new(routes) }
    }

    /// What steps are metered under when they run as fast as the chip can, with the cores that the
    /// mapping uses and the target's first constants; and that deployment.
    ///
    /// # Errors
    /// A constant that no integer holds.
    pub fn offline(&self, target: &Target) -> Result<(MeterSettings, Deployment)> {
        self.offline_with(target, HostWork::for_target(target))
    }

    /// As [`Self::offline`], where x86 cores do this work.
    ///
    /// # Errors
    /// As [`Self::offline`].
    pub fn offline_with(&self, target: &Target, work: HostWork) -> Result<(MeterSettings, Deployment)> {
        let Mapping { placement, options, .. } = self.compiled;
        let deployment = Deployment::from_placement(options.placement.name(), placement, target, options.copies, work);
        let tables = vec![CostTable::new(&target.constants()[0])?];
        Ok((self.settings(tables, &deployment, Transport::default()), deployment))
    }

    /// What steps are metered under by these presets and a deployment: sums alone.
    pub fn settings(&self, tables: Vec<CostTable>, deployment: &Deployment, transport: Transport) -> MeterSettings {
        let Mapping { options, one, .. } = self.compiled;
        let timestep = Picoseconds::from_milliseconds(one.parts().timestep_ms);
        MeterSettings::new(tables, deployment.timing(transport, options.copies), self.routes.clone(), timestep)
    }

    /// Copies that are run, which do what all do.
    pub fn copies_run(&self) -> u32 {
        self.groups.as_ref().map_or(self.compiled.options.copies, CoreGroups::copies)
    }

    /// Copies that there are.
    pub(super) fn copies(&self) -> u32 {
        self.compiled.options.copies
    }

    /// The cores that are run.
    fn program(&self) -> &Arc<Program> {
        self.groups.as_ref().map_or(&self.compiled.program, |groups| &groups.program)
    }

    /// Runs samples on these, all copies seeing them, with a meter for each sample.
    pub(super) fn run_with<M: Meter>(
        &self,
        samples: &[&Sample],
        running: Running<'_>,
        new_meter: impl Fn() -> M + Sync,
    ) -> Result<Run<M>> {
        // Copies share no input channels: each sees the whole sample.
        let copies = Copies { copies: self.copies_run(), channels: self.compiled.one.channels() };
        fast(self.program(), samples, Running { copies, per_step: true, ..running }, new_meter)
    }

    /// Runs samples and meters each step. Counts and sums are those of all copies, outcomes those
    /// of the first; counts by source, what was skipped, and an outcome's totals and what left its
    /// field, are those of the cores that were run.
    ///
    /// # Errors
    /// As [`fast`].
    pub fn run(&self, settings: MeterSettings, samples: &[&Sample], running: Running<'_>) -> Result<Run<StepMeter>> {
        let settings = Arc::new(settings);
        let shared = || Shared { meter: StepMeter::new(settings.clone()), waiting: Vec::new() };
        let run = self.run_with(samples, running, shared)?;
        // Meters of samples follow what waits as they are merged.
        Ok(self.of_all_copies(run.map_meter(|shared| shared.meter)))
    }

    /// What all cores did, from what those did that were run.
    pub(super) fn of_all_copies(&self, run: Run<StepMeter>) -> Run<StepMeter> {
        let Some(groups) = &self.groups else { return run };
        // Every copy does the same.
        let spikes_in = run.activity.spikes_in() / u64::from(groups.copies()) * u64::from(self.copies());
        let mut cores = vec![CoreCounts::default(); self.compiled.program.cores().len()];
        for group in &groups.groups {
            for (core, run_core) in group.cores.iter().zip(groups.kinds[group.kind].cores.clone()) {
                cores[core.index()] = run.activity.cores()[CoreId(run_core)];
            }
        }
        // Of identical groups the first represents all, as of cores that take as long.
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

/// What samples did, and what they cost.
#[derive(Debug)]
pub struct Priced {
    /// Spikes and class of each sample, in run order.
    pub outcomes: Vec<Outcome>,
    /// Counts of the whole run, all copies.
    pub activity: Activity,
    /// Power, latency and energy of one copy.
    pub estimate: Estimate,
}

/// Runs samples as fast as the chip can and estimates power, latency and energy by the target's
/// first constants, with the cores that the mapping uses.
///
/// # Errors
/// A constant that no integer holds; as [`fast`].
pub fn run_priced(compiled: &Mapping, target: &Target, samples: &[Sample]) -> Result<Priced> {
    let copies = compiled.options.copies;
    let metered = Metered::new(compiled);
    let (settings, deployment) = metered.offline(target)?;
    let price = step_price(&settings.tables[0], &deployment, copies, (Mode::Offline, Accounting::Profiler));
    let settings = MeterSettings { distribution: Some((0, price)), ..settings };
    let samples: Vec<&Sample> = samples.iter().collect();
    let run = metered.run(settings, &samples, Running::new(&Keep::new(compiled.program.output())))?;
    let case = Case::new(&run.activity, &run.meter, &deployment);
    let estimate = estimate(&Case { steps_per_sample: steps_per_sample(&samples), ..case });
    Ok(Priced { outcomes: run.outcomes, activity: run.activity, estimate })
}
