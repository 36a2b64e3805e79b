//! `nsim energy` takes the memory of `nsim run`, and a part that does not grow with the run.

// A test that cannot continue has failed.
#![allow(clippy::unwrap_used)]
#![cfg(feature = "cli")]

use crate::common;
use std::ffi::OsString;
use std::process::{Command, ExitCode};

/// Environment variable of a process that runs one command alone: its command line.
const LINE: &str = "NSIM_TEST_LINE";
/// Most additional memory of `nsim energy`, in KiB.
const MOST: u64 = 64 << 10;

/// In a process that requests it, runs a command and prints the peak memory of the process.
#[test]
fn a_command_alone() {
    let Some(line) = std::env::var_os(LINE) else { return };
    let line = line.to_str().unwrap().split('\n').map(OsString::from);
    assert_eq!(nsim::cli::run_line(line), ExitCode::SUCCESS);
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    println!("\npeak {}", peak.trim().trim_end_matches(" kB"));
}

/// Peak memory of a command in KiB; the input is noise of this many samples and steps.
fn peak_kib(command: &[&str], samples: u32, steps: u32) -> u64 {
    let input = format!("scene:noise?samples={samples}&steps={steps}&rate=0.02&seed=3");
    let line =
        [&["nsim"], command, &["slip-tactile", "--input", &input, "--threads", "2", "--format", "json"]].concat();
    let mut test = Command::new(std::env::current_exe().unwrap());
    test.args(["energy_memory::a_command_alone", "--exact", "--nocapture"]).env(LINE, line.join("\n"));
    let output = test.output().unwrap();
    let out = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{line:?}: {out}\n{}", String::from_utf8_lossy(&output.stderr));
    out.lines().find_map(|line| line.strip_prefix("peak ")).unwrap().parse().unwrap()
}

#[test]
fn energy_takes_no_memory_for_its_steps() {
    if !std::path::Path::new("/proc/self/status").exists() {
        common::say("skipped: no /proc/self/status says how much memory this takes");
        return;
    }
    // Few steps, 500,000 in long samples and in many samples, and samples shared by copies.
    for (copies, samples, steps) in [("1", 1, 2_000), ("1", 5, 100_000), ("1", 1_000, 500), ("3", 100, 500)] {
        let run = peak_kib(&["run"], samples, steps);
        let energy = peak_kib(&["energy", "--copies", copies, "--baseline", "--early-exit", "certain"], samples, steps);
        println!("{copies} copies, {samples} samples of {steps} steps: run {run} KiB, energy {energy} KiB");
        assert!(energy < run + MOST, "{copies} copies, {samples} samples of {steps} steps: {energy} KiB against {run}");
    }
}
