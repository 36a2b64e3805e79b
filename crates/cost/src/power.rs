//! Powers of a job of several copies, and the price of a step, by constants and deployment.

use crate::constants::CostTable;
use crate::deployment::{Deployment, Host};
use crate::job::{Accounting, Mode};
use crate::meter::StepPrice;

/// Powers of a whole job, all copies together, in mW.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct JobPower {
    /// Static power of the neuron cores in use.
    pub core_static: f64,
    /// Power of their events; `None` without timesteps.
    pub core_dynamic: Option<f64>,
    /// Static power of the x86 cores that run.
    pub x86_static: f64,
    /// Power of their clocks, one a chip.
    pub x86_clock: f64,
    /// Power of their work; `None` without timesteps where it depends on them.
    pub x86_active: Option<f64>,
    /// Power of all chips of the board before a program is loaded, as the rails show it.
    pub boot: f64,
    /// Power that x86 cores add once a program is loaded, as the rails show it.
    pub x86_on: f64,
    /// Power that x86 cores add while they work, as the rails show it.
    pub x86_at_work: f64,
    /// Power that neuron cores in use add while they run, as the rails show it.
    pub core_rails: f64,
    /// Power of the whole unit while nothing runs.
    pub unit: f64,
}

impl JobPower {
    /// Dynamic power of the x86 cores.
    pub fn x86_dynamic(&self) -> Option<f64> {
        Some(self.x86_clock + self.x86_active?)
    }

    /// Power of the job by an accounting; `None` where it depends on timesteps and none was run.
    pub fn total(&self, accounting: Accounting) -> Option<f64> {
        match accounting {
            Accounting::Profiler => self.profiler(),
            Accounting::Rails => self.rails_running(),
            Accounting::Unit => self.unit_running(),
        }
    }

    /// Power that the profiler attributes to the job.
    pub fn profiler(&self) -> Option<f64> {
        Some(self.core_static + self.core_dynamic? + self.x86_static + self.x86_dynamic()?)
    }

    /// Power of the whole board once a program is loaded, before it runs.
    pub fn rails_idle(&self) -> f64 {
        self.boot + self.x86_on + self.x86_clock
    }

    /// Power of the whole board while the program runs.
    pub fn rails_running(&self) -> Option<f64> {
        Some(self.rails_idle() + self.at_work()?)
    }

    /// Power that all cores add while the program runs, as the rails show it.
    pub(crate) fn at_work(&self) -> Option<f64> {
        Some(self.x86_at_work + self.core_rails + self.core_dynamic?)
    }

    /// Power of the whole unit while the program runs.
    pub fn unit_running(&self) -> Option<f64> {
        Some(self.unit + self.at_work()?)
    }
}

/// Equation (20): power of injecting x86 cores, mW; energy of a step of resetting ones, fJ.
fn x86_work(table: &CostTable, deployment: &Deployment) -> (f64, f64) {
    let each = table.x86_active_power.milliwatts() * deployment.x86_working as f64;
    match deployment.host {
        Host::None if !deployment.takes_turns() => (0.0, 0.0),
        // An x86 core works for the time of reset and turn; 1 mW for 1 ps is 1 fJ.
        Host::None => (0.0, each * (deployment.reset.time(table.reset_word_time).0 + table.turn_time.0) as f64),
        Host::Stream | Host::Memory => (each * table.x86_injecting_share.ratio(), 0.0),
    }
}

/// Returns the powers of a job that spends `events_fj` on events, in `steps` steps of `time_ps`.
pub fn job_power(table: &CostTable, deployment: &Deployment, events_fj: f64, steps: u64, time_ps: u128) -> JobPower {
    let (injecting, resetting) = x86_work(table, deployment);
    let known = (time_ps > 0).then_some(time_ps as f64);
    JobPower {
        core_static: deployment.cores_used as f64 * table.core_static_power.milliwatts()
            + deployment.chips_used as f64 * table.chip_static_power.milliwatts(),
        // 1 fJ in 1 ps is 1 mW.
        core_dynamic: known.map(|time| events_fj / time),
        x86_static: deployment.x86_cores as f64 * table.x86_static_mw(),
        x86_clock: deployment.x86_chips as f64 * table.x86_clock_power.milliwatts(),
        x86_active: match resetting > 0.0 {
            true => known.map(|time| resetting * steps as f64 / time),
            false => Some(injecting),
        },
        boot: deployment.board_chips as f64 * table.chip_boot_power.milliwatts()
            + deployment.board_chips as f64 * table.chip_static_power.milliwatts(),
        x86_on: deployment.x86_cores as f64 * table.x86_on_power.milliwatts(),
        x86_at_work: deployment.x86_at_work() as f64 * table.x86_rails_power.milliwatts(),
        core_rails: deployment.cores_used as f64 * table.core_rails_power.milliwatts(),
        unit: deployment.board_chips as f64 * table.unit_power.milliwatts(),
    }
}

/// Returns the price of a step of the `total` row, under one preset.
pub fn step_price(
    table: &CostTable,
    deployment: &Deployment,
    copies_counted: u32,
    mode: Mode,
    accounting: Accounting,
) -> StepPrice {
    let (injecting, resetting) = x86_work(table, deployment);
    let power = job_power(table, deployment, 0.0, 0, 0);
    let counted = f64::from(copies_counted.max(1));
    let rows = deployment.rows_count();
    let (copies, x86) = (rows.copies as f64, rows.x86_rows as f64);
    let (events, step_fj, always_mw) = match accounting {
        Accounting::Profiler => {
            let of_x86 = (power.x86_static + power.x86_clock + injecting) / x86;
            (1.0 / counted, resetting / x86, of_x86 + power.core_static / copies)
        }
        Accounting::Rails | Accounting::Unit => {
            let idle = if accounting == Accounting::Unit { power.unit } else { power.rails_idle() };
            (f64::from(deployment.copies.max(1)) / counted, 0.0, idle + power.x86_at_work + power.core_rails)
        }
    };
    StepPrice { events, step_fj, always_mw, paced: mode == Mode::Realtime }
}
