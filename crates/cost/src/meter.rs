//! Energy and time of the steps of a run, for every preset simultaneously, in memory that does not
//! grow with the run.
//!
//! Input: the counts of each timestep, and whether its sample was decided before. Output: exact
//! sums of energy and time, over all steps and over the steps until the decision; on request, the
//! distribution of a step's energy. Invariant: a meter is a function of the multiset of its
//! samples, so meters of parallel samples give equal figures in any order of merging.
//!
//! The distribution is of the whole energy of a step, so a [`StepPrice`] is known in advance.

use std::sync::Arc;

use rayon::prelude::*;

use crate::constants::CostTable;
use crate::model::{StepTime, core_time, core_time_by_constant, energy_of_counts};
use crate::quantiles::Quantiles;
use crate::transport::{MessageRoutes, QueueMemory, Timing};
use nsim_ir::activity::{HopCounts, StepActivity};
use nsim_ir::base::units::{Femtojoules, Picoseconds};

/// Sums over steps under one preset, exact.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StepSums {
    /// Timesteps that were added.
    pub steps: u64,
    /// Energy of their events.
    pub energy: Femtojoules,
    /// Time in ps, as fast as possible.
    pub time: u128,
    /// Time in ps when every step takes at least the timestep.
    pub paced_time: u128,
    /// The parts of `time`, in the order of [`StepTime::parts`].
    pub parts: [u128; 6],
}

impl StepSums {
    fn add(&mut self, energy: Femtojoules, time: &StepTime, timestep: Picoseconds, times: u64) {
        let total = time.total();
        self.steps += times;
        self.energy += energy * times;
        self.time += u128::from(total.0) * u128::from(times);
        self.paced_time += u128::from(total.max(timestep).0) * u128::from(times);
        for (sum, (_, part)) in self.parts.iter_mut().zip(time.parts()) {
            *sum += u128::from(part.0) * u128::from(times);
        }
    }

    fn merge(&mut self, other: &StepSums) {
        self.steps += other.steps;
        self.energy += other.energy;
        self.time += other.time;
        self.paced_time += other.paced_time;
        self.parts.iter_mut().zip(other.parts).for_each(|(sum, part)| *sum += part);
    }
}

/// The steps of a run under one preset.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Lane {
    /// Sums over all steps.
    pub whole: StepSums,
    /// Sums over the steps of each sample up to its decision; over all steps if undecided.
    pub until_decided: StepSums,
}

/// Energy of a step: events * `events` + `step_fj` + `always_mw` * time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepPrice {
    /// Factor of counted events: one over the copies counted, for the energy of one copy.
    pub events: f64,
    /// Energy that each step takes, regardless of its length, in fJ.
    pub step_fj: f64,
    /// Power that is drawn all the time, mW.
    pub always_mw: f64,
    /// Whether each step takes at least the timestep.
    pub paced: bool,
}

/// Distribution of the energy of a step over a run, in fJ of one copy.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Distribution {
    /// Energy of the events of neuron cores.
    pub dynamic: Quantiles,
    /// This energy, and all power that is drawn in the step.
    pub whole: Quantiles,
}

/// Energy and time of the steps so far.
#[derive(Debug, Clone)]
pub struct StepMeter {
    settings: Arc<MeterSettings>,
    lanes: Vec<Lane>,
    distribution: Distribution,
    hops: HopCounts,
    /// Number of steps in which each core was the slowest, under the first preset.
    slowest: Vec<u64>,
    /// Time of the slowest core by constant, as [`core_time_by_constant`], first preset, ps.
    core_time: [u128; 9],
    /// The time of the last step under the first preset.
    last_time: StepTime,
    /// Memory of each step that is metered in parallel.
    memory: Vec<QueueMemory>,
}

/// The conditions under which steps are metered.
#[derive(Debug)]
pub struct MeterSettings {
    /// Presets, one a lane; then as many lanes without a host, if requested.
    pub tables: Vec<CostTable>,
    /// The routes of the program's messages.
    pub routes: Arc<MessageRoutes>,
    /// The model of the mesh, tiles and host.
    pub timing: Timing,
    /// Length of a timestep of the model.
    pub timestep: Picoseconds,
    /// Timing without a host, under which steps are metered a second time.
    pub without_host: Option<Timing>,
    /// The preset (an index into `tables`) and price of the distribution of a step's energy.
    pub distribution: Option<(usize, StepPrice)>,
}

impl MeterSettings {
    /// Returns settings for sums only.
    pub fn new(tables: Vec<CostTable>, timing: Timing, routes: Arc<MessageRoutes>, timestep: Picoseconds) -> Self {
        MeterSettings { tables, timing, routes, timestep, without_host: None, distribution: None }
    }
}

impl MeterSettings {
    /// The times of a step, a lane each.
    fn step_times(&self, step: &StepActivity, memory: &mut QueueMemory) -> Vec<StepTime> {
        let timings = [Some(self.timing), self.without_host].into_iter().flatten();
        timings.flat_map(|timing| self.routes.step_times(step, &self.tables, timing, memory)).collect()
    }
}

/// The slowest core of a step; the first on a tie, so that each step has one.
fn slowest(step: &StepActivity, table: &CostTable) -> usize {
    let by_time = step.cores.iter().enumerate().map(|(core, counts)| (core_time(counts, table), core));
    by_time.reduce(|most, next| if next.0 > most.0 { next } else { most }).map_or(0, |(_, core)| core)
}

impl StepMeter {
    /// A meter for these presets.
    pub fn new(settings: impl Into<Arc<MeterSettings>>) -> Self {
        let settings = settings.into();
        let timings = 1 + usize::from(settings.without_host.is_some());
        let lanes = vec![Lane::default(); timings * settings.tables.len()];
        StepMeter {
            settings,
            lanes,
            distribution: Distribution::default(),
            hops: HopCounts::default(),
            slowest: Vec::new(),
            core_time: [0; 9],
            last_time: StepTime::default(),
            memory: Vec::new(),
        }
    }

    /// An empty meter of the same kind, for another sample.
    pub fn fresh(&self) -> Self {
        StepMeter::new(self.settings.clone())
    }

    /// Adds a timestep that occurred `times` times; `decided`: its sample was decided before.
    pub fn add(&mut self, step: &StepActivity, times: u32, decided: bool) {
        self.memory.resize_with(self.memory.len().max(1), QueueMemory::default);
        let step_times = self.settings.step_times(step, &mut self.memory[0]);
        self.add_timed(step, times, decided, &step_times);
    }

    /// Adds these steps sequentially; threads compute the times of their messages in parallel.
    pub fn add_all(&mut self, steps: &[(StepActivity, u32, bool)]) {
        self.memory.resize_with(self.memory.len().max(steps.len()), QueueMemory::default);
        let settings = &*self.settings;
        let timed = steps.par_iter().zip(&mut self.memory);
        let timed = timed.map(|((step, ..), memory)| settings.step_times(step, memory));
        for ((step, times, decided), step_times) in steps.iter().zip(timed.collect::<Vec<_>>()) {
            self.add_timed(step, *times, *decided, &step_times);
        }
    }

    fn add_timed(&mut self, step: &StepActivity, times: u32, decided: bool, step_times: &[StepTime]) {
        let MeterSettings { tables, routes, timestep, distribution, .. } = &*self.settings;
        let (sum, hops) = (routes.sum_of_cores(step), routes.hops(step));
        self.hops += hops.times(times.into());
        if let (Some(table), Some(time)) = (tables.first(), step_times.first()) {
            self.last_time = *time;
            self.slowest.resize(step.cores.len(), 0);
            let core = slowest(step, table);
            if let (Some(steps), Some(counts)) = (self.slowest.get_mut(core), step.cores.as_slice().get(core)) {
                *steps += u64::from(times);
                for (sum, own) in self.core_time.iter_mut().zip(core_time_by_constant(counts, table)) {
                    *sum += u128::from(own.0) * u128::from(times);
                }
            }
        }
        for (number, ((lane, table), time)) in
            self.lanes.iter_mut().zip(tables.iter().cycle()).zip(step_times).enumerate()
        {
            let energy = energy_of_counts(sum, hops, table).total();
            lane.whole.add(energy, time, *timestep, times.into());
            if !decided {
                lane.until_decided.add(energy, time, *timestep, times.into());
            }
            if let Some((_, price)) = distribution.filter(|&(preset, _)| preset == number) {
                let took = if price.paced { time.total().max(*timestep) } else { time.total() };
                let dynamic = energy.0 as f64 * price.events;
                self.distribution.dynamic.add(dynamic, times.into());
                // 1 mW for 1 ps is 1 fJ.
                self.distribution.whole.add(dynamic + price.step_fj + price.always_mw * took.0 as f64, times.into());
            }
        }
    }

    /// Adds the sums of another meter, of other samples.
    ///
    /// # Panics
    /// When the other meter has other settings: a mistake of the caller.
    pub fn merge(&mut self, other: &StepMeter) {
        assert!(Arc::ptr_eq(&self.settings, &other.settings), "meters of one kind");
        for (lane, more) in self.lanes.iter_mut().zip(&other.lanes) {
            lane.whole.merge(&more.whole);
            lane.until_decided.merge(&more.until_decided);
        }
        self.hops += other.hops;
        self.distribution.dynamic.merge(&other.distribution.dynamic);
        self.distribution.whole.merge(&other.distribution.whole);
        self.slowest.resize(self.slowest.len().max(other.slowest.len()), 0);
        self.slowest.iter_mut().zip(&other.slowest).for_each(|(sum, more)| *sum += more);
        self.core_time.iter_mut().zip(other.core_time).for_each(|(sum, more)| *sum += more);
    }

    /// The conditions under which steps are metered.
    pub fn settings(&self) -> &MeterSettings {
        &self.settings
    }

    /// The presets.
    pub fn tables(&self) -> &[CostTable] {
        &self.settings.tables
    }

    /// Links that messages crossed in all steps, for all groups of cores.
    pub fn hops(&self) -> HopCounts {
        self.hops
    }

    /// The steps under each preset, in the presets' order; then without a host, if requested.
    pub fn lanes(&self) -> &[Lane] {
        &self.lanes
    }

    /// Share of the slowest core's time for each of [`CORE_TIMES`], under the first preset; all 0
    /// where no core takes time.
    ///
    /// [`CORE_TIMES`]: crate::model::CORE_TIMES
    pub fn core_time_shares(&self) -> [f64; 9] {
        let all = self.core_time.iter().sum::<u128>().max(1);
        self.core_time.map(|own| own as f64 / all as f64)
    }

    /// Distribution of a step's energy; empty unless the settings request it.
    pub fn distribution(&self) -> &Distribution {
        &self.distribution
    }

    /// Replaces the counts of slowest steps, for a meter of other cores than the program's.
    #[must_use]
    pub fn with_slowest_steps(self, slowest: Vec<u64>) -> Self {
        StepMeter { slowest, ..self }
    }

    /// Number of steps in which each core was the slowest under the first preset, the first core on
    /// a tie. They sum to the number of steps. Empty before the first step.
    pub fn slowest_steps(&self) -> &[u64] {
        &self.slowest
    }

    /// The time of the step that was added last, under the first preset.
    pub fn last_time(&self) -> StepTime {
        self.last_time
    }

    /// Number of timesteps.
    pub fn steps(&self) -> u64 {
        self.lanes.first().map_or(0, |lane| lane.whole.steps)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::constants::tests::table;
    use crate::model::energy;
    use crate::model::tests::any_step;
    use crate::transport::Transport;
    use crate::transport::tests::{no_routes, timing};
    use nsim_ir::activity::Activity;

    /// A meter of steps under the analytic model of the mesh.
    pub(crate) fn meter(
        tables: Vec<CostTable>,
        tiles_used: u64,
        distribution: Option<(usize, StepPrice)>,
    ) -> StepMeter {
        let timing = Timing { tiles_used, ..timing(Transport::Analytic) };
        let settings = MeterSettings::new(tables, timing, Arc::new(no_routes()), Picoseconds(1_000_000_000));
        StepMeter::new(MeterSettings { distribution, ..settings })
    }

    proptest! {
        #[test]
        fn meters_of_parts_merge_to_the_meter_of_the_whole(
            steps in proptest::collection::vec(any_step(2), 0..10), cut in 0..10usize,
        ) {
            let price = StepPrice { events: 0.5, step_fj: 3e3, always_mw: 0.5, paced: false };
            let mut whole = meter(vec![table("davies2018"), table("sanafe-calibrated")], 3, Some((1, price)));
            let (mut first, mut second) = (whole.fresh(), whole.fresh());
            let mut activity = Activity::new(2);
            let mut one_by_one = whole.fresh();
            for (i, step) in steps.iter().enumerate() {
                let (times, decided) = (1 + i as u32 % 3, i > 6);
                activity.add_steps(step, times.into());
                (0..times).for_each(|_| one_by_one.add(step, 1, decided));
                if i < cut { first.add(step, times, decided) } else { second.add(step, times, decided) }
            }
            let mut batch = whole.fresh();
            let alike = |(i, step): (usize, &StepActivity)| (step.clone(), 1 + i as u32 % 3, i > 6);
            batch.add_all(&steps.iter().enumerate().map(alike).collect::<Vec<_>>());
            whole.merge(&second);
            whole.merge(&first);
            prop_assert_eq!(one_by_one.lanes(), whole.lanes());
            prop_assert_eq!(batch.lanes(), whole.lanes());
            prop_assert_eq!(batch.slowest_steps(), whole.slowest_steps());
            prop_assert_eq!(one_by_one.distribution(), whole.distribution());
            for parts in [&batch, &whole] {
                prop_assert_eq!((parts.hops, parts.core_time), (one_by_one.hops, one_by_one.core_time));
            }
            prop_assert_eq!(one_by_one.steps(), activity.steps());
            prop_assert_eq!(one_by_one.slowest_steps(), whole.slowest_steps());
            prop_assert_eq!(whole.slowest_steps().iter().sum::<u64>(), activity.steps());
            for (lane, table) in whole.lanes().iter().zip(whole.tables()) {
                let Lane { whole, until_decided } = lane;
                prop_assert_eq!(whole.energy, energy(&activity, table).total());
                prop_assert_eq!(whole.parts.iter().sum::<u128>(), whole.time);
                prop_assert!(whole.paced_time >= whole.time && until_decided.time <= whole.time);
                prop_assert_eq!(until_decided == whole, steps.len() <= 7);
            }
        }
    }
}
