//! Energy and time of each step of a run, for every preset at once.
//!
//! Input: the counts of each timestep. Output: energy and time of each step, and order statistics of them. Meters of
//! samples that ran in parallel are merged in the order of the samples.
//!
//! The constant energy of powered cores (equation (8)) is not metered: it depends on the deployment, not on the
//! activity, and [`crate::cost::estimate`] adds it.

use std::sync::Arc;

use crate::base::units::{Femtojoules, Picoseconds};
use crate::cost::constants::CostTable;
use crate::cost::model::{StepTime, step_energy};
use crate::cost::transport::{MessageRoutes, Transport};
use crate::ir::activity::StepActivity;
use crate::ir::program::Program;

/// The steps of a run under one preset.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Lane {
    /// Energy of each step's events.
    pub energy: Vec<Femtojoules>,
    /// Time of each step.
    pub time: Vec<StepTime>,
}

/// Energy and time of each step so far.
#[derive(Debug, Clone)]
pub struct StepMeter {
    board: Arc<MeterSettings>,
    lanes: Vec<Lane>,
}

/// The conditions under which steps are metered.
#[derive(Debug)]
pub struct MeterSettings {
    /// Presets, one a lane.
    pub tables: Vec<CostTable>,
    /// Tiles in the barrier.
    pub tiles_used: u64,
    /// Copies in the program, whose outputs are all read.
    pub copies: u64,
    /// The routes of the program's messages.
    pub routes: Arc<MessageRoutes>,
    /// The model of the mesh.
    pub transport: Transport,
}

impl MeterSettings {
    /// Settings for one program.
    #[must_use]
    pub fn new(tables: Vec<CostTable>, tiles_used: u64, copies: u64, program: &Program, transport: Transport) -> Self {
        let routes = Arc::new(MessageRoutes::of_program(program));
        MeterSettings { tables, tiles_used, copies, routes, transport }
    }
}

impl StepMeter {
    /// A meter for these presets.
    #[must_use]
    pub fn new(metered: impl Into<Arc<MeterSettings>>) -> Self {
        let board = metered.into();
        let lanes = vec![Lane::default(); board.tables.len()];
        StepMeter { board, lanes }
    }

    /// An empty meter of the same kind, for another sample.
    #[must_use]
    pub fn fresh(&self) -> Self {
        StepMeter::new(self.board.clone())
    }

    /// Adds a timestep that happened so many times in a row.
    pub fn add(&mut self, step: &StepActivity, times: u32) {
        let MeterSettings { tables, tiles_used, copies, routes, transport } = &*self.board;
        let step_times = routes.step_times(step, tables, *transport, *tiles_used, *copies);
        for ((lane, table), time) in self.lanes.iter_mut().zip(tables).zip(step_times) {
            let energy = step_energy(step, table, 0).total();
            lane.energy.extend(std::iter::repeat_n(energy, times as usize));
            lane.time.extend(std::iter::repeat_n(time, times as usize));
        }
    }

    /// Adds the steps of the samples that follow.
    ///
    /// # Panics
    /// When the other meter has other presets: a mistake of the caller.
    pub fn merge(&mut self, later: &StepMeter) {
        assert!(Arc::ptr_eq(&self.board, &later.board), "meters of one kind");
        for (lane, more) in self.lanes.iter_mut().zip(&later.lanes) {
            lane.energy.extend_from_slice(&more.energy);
            lane.time.extend_from_slice(&more.time);
        }
    }

    /// The presets.
    #[must_use]
    pub fn tables(&self) -> &[CostTable] {
        &self.board.tables
    }

    /// The model of the mesh.
    #[must_use]
    pub fn transport(&self) -> Transport {
        self.board.transport
    }

    /// The steps under each preset, in the presets' order.
    #[must_use]
    pub fn lanes(&self) -> &[Lane] {
        &self.lanes
    }

    /// Number of timesteps.
    #[must_use]
    pub fn steps(&self) -> u64 {
        self.lanes.first().map_or(0, |lane| lane.energy.len() as u64)
    }
}

/// The least, median, 99th percentile and greatest of a series, by nearest rank.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Spread {
    /// The least.
    pub min: f64,
    /// The least that half of the series does not exceed.
    pub p50: f64,
    /// The least that 99 % of the series does not exceed.
    pub p99: f64,
    /// The greatest.
    pub max: f64,
}

impl Spread {
    /// Of a series; `None` when it is empty.
    #[must_use]
    pub fn from_series(mut series: Vec<f64>) -> Option<Self> {
        series.sort_unstable_by(f64::total_cmp);
        let rank = |percent: usize| series[(series.len() * percent).div_ceil(100).max(1) - 1];
        (!series.is_empty()).then(|| Spread { min: series[0], p50: rank(50), p99: rank(99), max: rank(100) })
    }
}

/// Time of a step in a run that is held to `bin` per step, or free when there is none.
#[must_use]
pub fn paced(time: Picoseconds, bin: Option<Picoseconds>) -> Picoseconds {
    bin.map_or(time, |bin| time.max(bin))
}

#[cfg(test)]
pub(crate) mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::cost::constants::tests::table;
    use crate::cost::model::{energy, tests::any_step};
    use crate::cost::transport::tests::no_routes;
    use crate::ir::activity::Activity;

    /// A meter of steps whose messages are not followed.
    pub(crate) fn meter(tables: Vec<CostTable>, tiles_used: u64) -> StepMeter {
        let metered = MeterSettings {
            tables,
            tiles_used,
            copies: 1,
            routes: Arc::new(no_routes()),
            transport: Transport::Analytic,
        };
        StepMeter::new(metered)
    }

    #[test]
    fn order_statistics_are_by_nearest_rank() {
        let spread = Spread::from_series((1..=200).rev().map(f64::from).collect()).unwrap();
        assert_eq!(spread, Spread { min: 1.0, p50: 100.0, p99: 198.0, max: 200.0 });
        assert_eq!(Spread::from_series(vec![3.0]).unwrap(), Spread { min: 3.0, p50: 3.0, p99: 3.0, max: 3.0 });
        assert_eq!(Spread::from_series(vec![]), None);
    }

    proptest! {
        #[test]
        fn meters_of_parts_merge_to_the_meter_of_the_whole(
            steps in proptest::collection::vec(any_step(2), 0..10), cut in 0..10usize,
        ) {
            let mut whole = meter(vec![table("davies2018"), table("sanafe-calibrated")], 3);
            let (mut first, mut second) = (whole.fresh(), whole.fresh());
            let mut activity = Activity::new(2);
            for (i, step) in steps.iter().enumerate() {
                whole.add(step, 1);
                activity.add_steps(step, 1);
                if i < cut { first.add(step, 1) } else { second.add(step, 1) }
            }
            first.merge(&second);
            prop_assert_eq!(first.lanes(), whole.lanes());
            for (lane, table) in whole.lanes().iter().zip(whole.tables()) {
                prop_assert_eq!(lane.energy.iter().copied().sum::<Femtojoules>(), energy(&activity, table, 0).total());
            }
        }
    }
}
