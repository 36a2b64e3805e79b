//! Rows of other hardware: published, modelled, or measured on this machine.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use crate::baseline::{Figures, NetworkShape, RowConditions, Work};
use crate::cpu::{self, MeasuredTime};
use crate::environment::Environment;
use crate::options::{BaselineSelection, ROOFLINE, Watts};
use crate::power::{POWERCAP, PackagePower, Power, PowerMeter};
use nsim_cost::estimate::{EnergyRow, FigureSource};
use nsim_cost::job::Mode;
use nsim_ir::base::warning::{Warning, WarningCode};
use nsim_ir::program::Program;
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::Sample;

/// Approximate time of each of the two measurements.
const BUDGET: Duration = Duration::from_millis(80);
/// Time of measuring the counters at idle.
const IDLE: Duration = Duration::from_millis(300);
/// Approximate number of timesteps of a repeat; more would only take longer.
const TIMESTEPS: u64 = 1_500;

/// Above this share of the processors in use a measurement says that the machine was busy.
const BUSY_SHARE: f64 = 0.5;

/// Number of processors in use over the last minute, where Linux says so.
fn load() -> Option<f64> {
    std::fs::read_to_string("/proc/loadavg").ok()?.split_whitespace().next()?.parse().ok()
}

/// The workload of one copy.
#[derive(Debug, Clone, Copy)]
pub struct CopyWorkload<'a> {
    /// The network in integers, without relays and other additions for the chip.
    pub network: &'a Quantised,
    /// The network, mapped alone.
    pub program: Option<&'a Arc<Program>>,
    /// Its input samples.
    pub samples: &'a [&'a Sample],
    /// Conditions of its rows.
    pub conditions: RowConditions,
}

/// Rows with their sources, and why others are absent.
#[derive(Debug, Default)]
pub struct HardwareRows {
    /// Rows and their sources, in the order of the table.
    pub rows: Vec<(EnergyRow, String)>,
    /// Reasons for absent rows.
    pub warnings: Vec<Warning>,
}

impl HardwareRows {
    fn without(&mut self, reason: String) {
        self.warnings.push(Warning::of_network(WarningCode::BaselineMissing, reason));
    }
}

/// Returns the rows of all requested hardware.
pub fn rows(asked: &BaselineSelection, one: CopyWorkload<'_>, watts: Option<Watts>) -> HardwareRows {
    let mut rows = HardwareRows::default();
    let (shape, work) = (NetworkShape::from_network(one.network), Work::from_network(one.network));
    for baseline in &asked.files {
        match baseline.row(&shape, one.conditions) {
            Ok(row) => rows.rows.push((row, baseline.source())),
            Err(reason) => {
                if let Some(row) = asked.roofline.then(|| baseline.modelled(&work, one.conditions)).flatten() {
                    let source = "modelled from its peak rate, bandwidth, overhead a layer and power (equation 18)";
                    rows.rows.push((row, format!("{source}: {reason}")));
                } else {
                    rows.without(format!("{reason}; --baseline {ROOFLINE} models it"));
                }
            }
        }
    }
    if asked.cpu {
        add_cpu_rows(one, watts, &mut rows);
    }
    rows
}

/// Adds the row of a command on a GPU that processes `steps` timesteps.
#[cfg(feature = "nvml")]
pub fn gpu(command: &str, steps: u64, one: CopyWorkload<'_>, found: &mut HardwareRows) {
    use crate::gpu;
    let idle = Duration::from_secs(2);
    let measured = gpu::with_nvml(|name, power| (name, gpu::measure(command, steps, idle, power)));
    match measured.and_then(|(name, measured)| Ok((name, measured?))) {
        Err(reason) => found.without(format!("no row for --gpu-command: {reason}")),
        Ok((name, measured)) => {
            let figures = figures(measured.us_per_timestep, measured.power, one.conditions, true);
            let source = format!(
                "'{command}', {} timesteps, board power in {} readings by NVML, idle measured first",
                measured.timesteps, measured.readings
            );
            found.rows.push((figures.row(&name, one.conditions.convention, one.conditions.steps), source));
        }
    }
}

/// Returns measured figures in a mode; with `window`, the hardware waits for a whole window.
fn figures(latency_us: f64, power: Power, conditions: RowConditions, window: bool) -> Figures {
    let Power { static_mw, dynamic_mw, source: power_source } = power;
    let figures = Figures { static_mw, dynamic_mw, latency_us, source: FigureSource::Measured, power_source };
    match conditions.mode {
        Mode::Offline => figures,
        Mode::Realtime => figures.in_real_time(conditions.timestep.microseconds(), window, true),
    }
}

fn add_cpu_rows(one: CopyWorkload<'_>, watts: Option<Watts>, found: &mut HardwareRows) {
    let load_before = load();
    let available = std::thread::available_parallelism().map_or(1, usize::from);
    let busy = load_before.filter(|load| *load > BUSY_SHARE * available as f64);
    let package = PackagePower::assumed();
    let meter = PowerMeter::new(Path::new(POWERCAP), watts.map(|Watts(idle, busy)| (idle, busy)), package, IDLE);
    let samples = cpu::first_samples(one.samples, TIMESTEPS);
    let environment = Environment::here();
    let mut add = |name: &str, window: bool, (timed, power): (Result<MeasuredTime, String>, Power)| match timed {
        Err(reason) => found.without(format!("no row for {name}: {reason}")),
        Ok(timed) => {
            // Other programs disturbed the fastest repeat least.
            let figures = figures(timed.fastest, power, one.conditions, window);
            let source = format!(
                "one thread of {environment}; fastest of {} repeats of {} timesteps, median {:.3} us, quartiles \
                 {:.3} us apart{}{}; {}",
                timed.repeats,
                timed.timesteps,
                timed.us_per_timestep,
                timed.spread,
                busy.map_or(String::new(), |load| format!("; {load} of {available} processors were busy before")),
                if environment.profile == "debug" { "; slow, because nsim was built without optimisation" } else { "" },
                meter.source()
            );
            let row = figures.row(name, one.conditions.convention, one.conditions.steps);
            found.rows.push((EnergyRow { busy, ..row }, source));
        }
    };
    add("CPU, dense", true, meter.during(|| cpu::dense(one.network, samples, BUDGET)));
    match one.program {
        Some(program) => {
            add("CPU, by events", false, meter.during(|| cpu::event_driven(program, samples, BUDGET)));
        }
        None => found.without("no row for CPU, by events: one copy alone could not be mapped".to_string()),
    }
}
