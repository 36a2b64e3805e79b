//! Counts and cost of each core in a run.
//!
//! Input: a program, its activity, optionally the meter of its steps. Output: a row for each core,
//! in the program's order. Rows sum exactly to the totals of the activity. Their energy sums to the
//! energy of all cores without the links, since energy is linear in the counts.

use nsim_cost::StepMeter;
use nsim_cost::model::{Breakdown, core_time, energy_of_counts};
use nsim_ir::activity::{Activity, CoreCounts, HopCounts};
use nsim_ir::base::id::{CoreId, Id};
use nsim_ir::base::units::Picoseconds;
use nsim_ir::program::Program;

/// Counts and cost of one core over a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CoreRow {
    /// The core, as `nsim map` numbers it.
    pub core: CoreId,
    /// The chip that it is on.
    pub chip: u32,
    /// Its counts.
    pub counts: CoreCounts,
    /// Their cost; `None` where steps were not metered.
    pub spent: Option<CoreSpent>,
}

/// Energy and time of a core's events under the first preset of a meter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CoreSpent {
    /// Energy of its events, by part; messages between cores belong to no core.
    pub energy: Breakdown,
    /// Time in which it delivered and updated.
    pub busy: Picoseconds,
    /// Steps in which no core took longer, and no core with a lower number as long.
    pub slowest_steps: u64,
}

/// Returns a row for each core, with its cost if there is a meter.
pub fn core_rows(program: &Program, activity: &Activity, meter: Option<&StepMeter>) -> Vec<CoreRow> {
    let priced = meter.and_then(|meter| Some((meter, meter.tables().first()?)));
    let rows = program.cores().enumerate().zip(activity.cores()).map(|((core, image), &counts)| {
        let spent = priced.map(|(meter, table)| CoreSpent {
            energy: energy_of_counts(counts, HopCounts::default(), table),
            busy: core_time(&counts, table),
            slowest_steps: meter.slowest_steps().get(core.index()).copied().unwrap_or(0),
        });
        CoreRow { core, chip: image.site.chip, counts, spent }
    });
    rows.collect()
}
