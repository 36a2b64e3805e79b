//! What each core did in a run, and what that cost.
//!
//! Input: a program, its activity, perhaps the meter that saw its steps. Output: a row for each
//! core, in the program's order. Sums over the rows are the totals of the activity, and their
//! energy is all that the cores and not the links between them spent, exactly: energy is linear in
//! the counts.

use nsim_cost::StepMeter;
use nsim_cost::model::{Breakdown, core_time, energy_of_counts};
use nsim_ir::activity::{Activity, CoreCounts, HopCounts};
use nsim_ir::base::id::{CoreId, Id};
use nsim_ir::base::units::Picoseconds;
use nsim_ir::program::Program;

/// A core over a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CoreRow {
    /// The core, as `nsim map` numbers it.
    pub core: CoreId,
    /// The chip that it is on.
    pub chip: u32,
    /// What it did.
    pub counts: CoreCounts,
    /// What that cost, when steps were metered.
    pub spent: Option<CoreSpent>,
}

/// What a core's events cost under the first preset of a meter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CoreSpent {
    /// Energy of its events, by part; messages under way belong to no core.
    pub energy: Breakdown,
    /// Time in which it delivered and updated.
    pub busy: Picoseconds,
    /// Steps in which no core took longer, nor as long with a lower number.
    pub slowest_steps: u64,
}

/// A row for each core; priced when there is a meter.
pub fn core_rows(program: &Program, activity: &Activity, meter: Option<&StepMeter>) -> Vec<CoreRow> {
    let spent = |core: CoreId, counts: CoreCounts| {
        let table = meter?.tables().first()?;
        Some(CoreSpent {
            energy: energy_of_counts(counts, HopCounts::default(), table),
            busy: core_time(&counts, table),
            slowest_steps: meter?.slowest_steps().get(core.index()).copied().unwrap_or(0),
        })
    };
    let cores = program.cores().enumerate().zip(activity.cores());
    cores
        .map(|((core, image), &counts)| CoreRow { core, chip: image.site.chip, counts, spent: spent(core, counts) })
        .collect()
}
