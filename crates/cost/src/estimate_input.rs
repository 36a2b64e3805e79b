//! Input of an estimate: counts, steps and conditions of a run.

use crate::constants::CostTable;
use crate::deployment::Deployment;
use crate::job::{Accounting, Convention, Mode};
use crate::meter::{Lane, StepMeter, StepPrice, StepSums};
use crate::model::{CORE_TIMES, energy};
use crate::power::{JobPower, job_power, step_price};
use crate::row::{EnergyRow, FigureSource, RowUnit};
use nsim_ir::activity::Activity;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::warning::{Warning, WarningCode};
use nsim_ir::hardware::constants::{ClassError, Constants, Status};

/// A preset split by the status of its constants.
#[derive(Debug, Clone)]
pub struct ByStatus {
    /// The preset by status, other constants 0: published, fitted, assumed.
    pub(crate) tables: [CostTable; 3],
    /// Least trusted status of each part of a step's time; `None` where `core` has it by constant.
    pub(crate) time: [Option<Status>; 6],
    /// The statuses of [`CORE_TIMES`].
    pub(crate) core: [Status; 9],
}

/// Least trusted status of the constants of these names that are not 0.
fn least_trusted(constants: &Constants, names: impl Fn(&str) -> bool) -> Status {
    let of = constants.list().into_iter().filter(|(name, constant)| names(name) && constant.value.value > 0.0);
    of.map(|(_, constant)| constant.status).max().unwrap_or(Status::Published)
}

impl ByStatus {
    /// Splits constants, for a number of chips: links between chips count where there are several.
    ///
    /// # Errors
    /// As [`CostTable::new`].
    pub fn new(constants: &Constants, chips: u64) -> Result<Self, Diagnostic> {
        let one = |name: &'static str| least_trusted(constants, |own| own == name);
        fn mesh(name: &str) -> bool {
            name.ends_with("hop_time") || name.starts_with("link_")
        }
        let of_mesh = least_trusted(constants, |name| mesh(name) && (chips > 1 || !name.contains("chip")));
        let tiles = constants.barrier.iter().map(|entry| entry.time.status).max().unwrap_or(Status::Published);
        let barrier = if chips > 1 { tiles.max(one("chip_hop_time")) } else { tiles };
        let [injection, turn, reset] = ["injection_time", "turn_time", "reset_word_time"].map(one);
        let time = [Some(injection), Some(turn), None, Some(of_mesh), Some(barrier), Some(reset)];
        Ok(ByStatus { tables: CostTable::by_status(constants)?, time, core: CORE_TIMES.map(one) })
    }
}

/// Input of an estimate.
#[derive(Debug, Clone, Copy)]
pub struct EstimateInput<'a> {
    /// Counts of the whole run.
    pub activity: &'a Activity,
    /// Its steps, under every preset.
    pub meter: &'a StepMeter,
    /// The preset of the figures, an index into the meter's tables.
    pub preset: usize,
    /// Whether the steps are those without a host ([`crate::MeterSettings::without_host`]).
    pub without_host: bool,
    /// The corners of the preset's bounds, indices into the meter's tables, as
    /// [`CostTable::corners`]; they bound figures in place of errors.
    pub corners: Option<[usize; 2]>,
    /// The name of the hardware in the rows.
    pub hardware: &'a str,
    /// Errors of such predictions; empty where they are unknown.
    pub errors: &'a [ClassError],
    /// The preset by the status of its constants.
    pub by_status: Option<&'a ByStatus>,
    /// Number of copies whose activity was counted: 1 when one represents all, else the mapping's.
    pub copies_counted: u32,
    /// The deployment of the copies.
    pub deployment: &'a Deployment,
    /// As fast as possible, or paced by the timestep.
    pub mode: Mode,
    /// The accounting of power.
    pub accounting: Accounting,
    /// The definition of energy.
    pub convention: Convention,
    /// Timesteps of a sample; `None` when samples differ.
    pub steps_per_sample: Option<u32>,
}

impl<'a> EstimateInput<'a> {
    /// Returns the case of all copies as fast as possible, energy physical, under the first preset.
    pub fn new(activity: &'a Activity, meter: &'a StepMeter, deployment: &'a Deployment) -> Self {
        EstimateInput {
            activity,
            meter,
            preset: 0,
            without_host: false,
            corners: None,
            hardware: "chip",
            errors: &[],
            by_status: None,
            copies_counted: deployment.copies,
            deployment,
            mode: Mode::Offline,
            accounting: Accounting::Profiler,
            convention: Convention::Physical,
            steps_per_sample: None,
        }
    }
}

impl EstimateInput<'_> {
    /// Time of steps in ps, exact.
    pub(crate) fn time(&self, steps: &StepSums) -> u128 {
        match self.mode {
            Mode::Offline => steps.time,
            Mode::Realtime => steps.paced_time,
        }
    }

    /// Warning of steps that take longer than their timestep in real time.
    pub(crate) fn late_steps(&self, steps: &StepSums) -> Option<Warning> {
        let timestep = self.meter.settings().timestep;
        let all = u128::from(steps.steps) * u128::from(timestep.0);
        let is_late = self.mode == Mode::Realtime && steps.paced_time > all;
        is_late.then(|| {
            let (limit, mean) = (timestep.microseconds(), steps.time as f64 / 1e6 / steps.steps.max(1) as f64);
            let behind = (steps.paced_time - all) as f64 / 1e6;
            Warning::of_network(
                WarningCode::RealtimeMissed,
                format!(
                    "steps take longer than the timestep of {limit:.0} us, {mean:.0} us in the mean: the chip falls \
                     {behind:.0} us behind its input in {} steps",
                    steps.steps
                ),
            )
        })
    }

    /// Returns the price of a step of the `total` row, under one preset.
    pub fn price(&self, table: &CostTable) -> StepPrice {
        step_price(table, self.deployment, self.copies_counted, self.mode, self.accounting)
    }

    /// Powers of all copies under one preset.
    pub fn job(&self, table: &CostTable, steps: &StepSums) -> JobPower {
        self.job_in_time(table, steps.steps, self.time(steps))
    }

    /// Powers of all copies under one preset, in steps of this time in ps.
    pub(crate) fn job_in_time(&self, table: &CostTable, steps: u64, time: u128) -> JobPower {
        let copies = f64::from(self.deployment.copies.max(1)) / f64::from(self.copies_counted.max(1));
        let events = energy(self.activity, table).total().0 as f64 * copies;
        job_power(table, self.deployment, events, steps, time)
    }

    pub(crate) fn latency_us(&self, steps: &StepSums) -> Option<f64> {
        let time = self.time(steps);
        (time > 0).then(|| time as f64 / 1e6 / steps.steps as f64)
    }

    /// Share of steps in which x86 cores inject, take their turn and reset.
    pub(crate) fn x86_share(&self, steps: &StepSums) -> Option<f64> {
        let [injection, turn, .., reset] = steps.parts;
        let time = self.time(steps);
        (self.deployment.x86_cores > 0 && time > 0).then(|| (injection + turn + reset) as f64 / time as f64)
    }

    pub(crate) fn rows(&self, job: &JobPower, latency_us: Option<f64>) -> Vec<EnergyRow> {
        let row = |unit, powers: (f64, Option<f64>), latency_us, source| {
            EnergyRow::new(self.hardware, unit, self.convention, powers, latency_us, source, self.steps_per_sample)
        };
        let (modelled, simulated) = (FigureSource::Modelled, FigureSource::Simulated);
        match self.accounting {
            Accounting::Profiler => {
                let counts = self.deployment.rows_count();
                let (copies, x86) = (counts.copies as f64, counts.x86_rows as f64);
                let of_x86 = (job.x86_static / x86, job.x86_dynamic().map(|power| power / x86));
                let of_cores = (job.core_static / copies, job.core_dynamic.map(|power| power / copies));
                let both = of_x86.1.zip(of_cores.1).map(|(x86, cores)| x86 + cores);
                let x86_row = row(RowUnit::X86, of_x86, latency_us, modelled);
                vec![
                    EnergyRow { x86_cores: Some(counts.x86_cores), ..x86_row },
                    row(RowUnit::Neuron, of_cores, latency_us, simulated),
                    row(RowUnit::Total, (of_x86.0 + of_cores.0, both), latency_us, simulated),
                ]
            }
            Accounting::Rails => {
                let loaded = job.boot + job.x86_on;
                let running = job.rails_running().map(|power| power - loaded);
                let at_work = row(RowUnit::X86, (0.0, Some(job.x86_at_work)), None, modelled);
                vec![
                    row(RowUnit::Boot, (job.boot, Some(0.0)), None, modelled),
                    row(RowUnit::Idle, (loaded, Some(job.x86_clock)), None, modelled),
                    EnergyRow { x86_cores: Some(self.deployment.x86_at_work()), ..at_work },
                    row(RowUnit::Total, (loaded, running), latency_us, simulated),
                ]
            }
            Accounting::Unit => vec![
                row(RowUnit::Idle, (job.unit, Some(0.0)), None, modelled),
                row(RowUnit::Total, (job.unit, job.at_work()), latency_us, simulated),
            ],
        }
    }

    /// The steps under a table of the meter.
    pub(crate) fn lane(&self, table: usize) -> &'_ Lane {
        let tables = if self.without_host { self.meter.tables().len() } else { 0 };
        &self.meter.lanes()[tables + table]
    }
}
