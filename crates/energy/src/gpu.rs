//! A command on a GPU, timed, with the board's power.
//!
//! Input: a command that passes the same samples through a GPU, and a way to read the board's
//! power. Output: time and power. Idle is measured first, for which nothing else may use the board.
//! nsim itself computes nothing on the GPU.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::power::Power;
use nsim_cost::estimate::FigureSource;

/// Interval between readings of power.
const EVERY: Duration = Duration::from_millis(20);

/// Measured time and power.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GpuTiming {
    /// Microseconds of a timestep.
    pub us_per_timestep: f64,
    /// Timesteps that were counted.
    pub timesteps: u64,
    /// Power of the whole board.
    pub power: Power,
    /// Number of readings while the command ran.
    pub readings: u32,
}

/// The last line of a command's output, if it has the command's own counts.
#[derive(Debug, serde::Deserialize)]
struct ReportedCounts {
    timesteps: u64,
    seconds: f64,
}

/// Measures idle power, then a command's; the command's output may replace `timesteps` and time.
///
/// # Errors
/// The reason why the command or the power could not be measured.
pub fn measure(
    command: &str,
    timesteps: u64,
    idle: Duration,
    mut power_mw: impl FnMut() -> Result<f64, String>,
) -> Result<GpuTiming, String> {
    let (mut sum, mut count, begin) = (0.0, 0u32, Instant::now());
    while count == 0 || begin.elapsed() < idle {
        sum += power_mw()?;
        count += 1;
        std::thread::sleep(EVERY.min(idle));
    }
    let idle_mw = sum / f64::from(count);
    // The output goes to a file, since a full pipe would block the command.
    let mut output = tempfile::tempfile().map_err(|error| error.to_string())?;
    let to = output.try_clone().map_err(|error| error.to_string())?;
    let begin = Instant::now();
    let mut child = Command::new("sh")
        .args(["-c", command])
        .stdin(Stdio::null())
        .stdout(to)
        .spawn()
        .map_err(|error| format!("'{command}' cannot be started: {error}"))?;
    let (mut sum, mut readings) = (0.0, 0u32);
    let status = loop {
        sum += power_mw()?;
        readings += 1;
        match child.try_wait() {
            Ok(None) => std::thread::sleep(EVERY),
            Ok(Some(status)) => break status,
            Err(error) => return Err(format!("'{command}': {error}")),
        }
    };
    let took = begin.elapsed().as_secs_f64();
    if !status.success() {
        return Err(format!("'{command}' ended with {status}"));
    }
    let mut text = String::new();
    use std::io::{Read, Seek};
    output.rewind().and_then(|()| output.read_to_string(&mut text)).map_err(|error| error.to_string())?;
    let reported: Option<ReportedCounts> = text.lines().next_back().and_then(|line| serde_json::from_str(line).ok());
    let (timesteps, seconds) = reported.map_or((timesteps, took), |reported| (reported.timesteps, reported.seconds));
    if timesteps == 0 || !(seconds > 0.0 && seconds.is_finite()) {
        return Err(format!("'{command}' counts {timesteps} timesteps in {seconds} s"));
    }
    let busy_mw = sum / f64::from(readings);
    let power = Power { static_mw: idle_mw, dynamic_mw: (busy_mw - idle_mw).max(0.0), source: FigureSource::Measured };
    Ok(GpuTiming { us_per_timestep: seconds * 1e6 / timesteps as f64, timesteps, power, readings })
}

/// Calls `f` with the first GPU's name and a reader of its power through NVML.
///
/// # Errors
/// The reason why there is none.
#[cfg(feature = "nvml")]
pub fn with_nvml<T>(f: impl FnOnce(String, &mut dyn FnMut() -> Result<f64, String>) -> T) -> Result<T, String> {
    let nvml = nvml_wrapper::Nvml::init().map_err(|error| format!("NVML: {error}"))?;
    let device = nvml.device_by_index(0).map_err(|error| format!("NVML, GPU 0: {error}"))?;
    let name = device.name().map_err(|error| format!("NVML, GPU 0: {error}"))?;
    let mut power = || device.power_usage().map(f64::from).map_err(|error| format!("NVML, power of GPU 0: {error}"));
    Ok(f(name, &mut power))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn idle_is_subtracted_and_the_command_may_count_itself() {
        // 10 W at first, 110 W later.
        let mut reading = 0;
        let power = || {
            reading += 1;
            Ok(if reading <= 1 { 10_000.0 } else { 110_000.0 })
        };
        let reported = "echo warming up; echo '{\"timesteps\": 150, \"seconds\": 0.003}'";
        let found = measure(reported, 7, Duration::ZERO, power).unwrap();
        assert_eq!((found.timesteps, found.power.static_mw, found.power.dynamic_mw), (150, 10_000.0, 100_000.0));
        assert!((found.us_per_timestep - 20.0).abs() < 1e-9 && found.readings >= 1);
        let silent = measure("sleep 0.03", 30, Duration::ZERO, || Ok(1.0)).unwrap();
        assert!(silent.timesteps == 30 && silent.us_per_timestep >= 1_000.0, "{silent:?}");
    }

    #[test]
    fn what_fails_says_why() {
        assert!(measure("exit 3", 1, Duration::ZERO, || Ok(1.0)).unwrap_err().contains("exit status: 3"));
        assert_eq!(measure("true", 1, Duration::ZERO, || Err("no board".into())).unwrap_err(), "no board");
        assert!(measure("true", 0, Duration::ZERO, || Ok(1.0)).unwrap_err().contains("0 timesteps"));
    }
}
