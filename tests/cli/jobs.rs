//! Jobs of several processes, started by `mpirun`: results of one process, files of the first rank,
//! and for any failure an end with one message within two seconds. It needs the feature `mpi`, and
//! reports an absent `mpirun`.

// A test that cannot continue has failed.
#![allow(clippy::unwrap_used)]
#![cfg(all(feature = "mpi", unix))]

use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::common;

const MODEL: &str = "Network(name: \"ranks\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [4000]), \
    Loihi(name: \"n\", shape: [4000], du: 1024, dv: 256, vth_mant: 130, refractory: 1)], \
    projections: [Random(from: [\"in\"], to: \"n\", fan_out: 2, low: 100, high: 126, seed: 1), \
    Random(from: [\"n\"], to: \"n\", fan_out: 32, low: -24, high: 16, seed: 2, delay: 2)], output: \"n\")";
const SHORT: &str = "scene:noise?samples=2&steps=40&seed=1&rate=0.02";
/// Longer than any test waits.
const LONG: &str = "scene:noise?samples=400&steps=4000&seed=1&rate=0.02";

/// Ranks that wait for others keep processor cores busy: one test at a time.
static ALONE: Mutex<()> = Mutex::new(());

/// A folder with a model, if there is an `mpirun`; without it nothing is tested.
fn ready() -> Option<(tempfile::TempDir, MutexGuard<'static, ()>)> {
    let alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let found = Command::new("mpirun").arg("--version").stdout(Stdio::null()).status().is_ok();
    if !found {
        common::say("skipped: mpirun is absent (Debian: libopenmpi-dev openmpi-bin), no job was started");
        return None;
    }
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("m.ron"), MODEL).unwrap();
    std::fs::write(folder.path().join("bad.ron"), &MODEL[..60]).unwrap();
    Some((folder, alone))
}

/// A job: for each group of ranks their number and their working folder below `folder`, and the
/// line that all ranks run.
fn job(folder: &Path, groups: &[(u32, &str)], line: &[&str]) -> Command {
    let mut command = Command::new("mpirun");
    command.current_dir(folder).args(["--oversubscribe", "--allow-run-as-root", "--bind-to", "none"]);
    for (place, (ranks, below)) in groups.iter().enumerate() {
        command.args(if place > 0 { [":"].as_slice() } else { &[] }).args(["-n", &ranks.to_string()]);
        command.arg("--wdir").arg(folder.join(below));
        command.arg(env!("CARGO_BIN_EXE_nsim")).args(line);
    }
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn run(folder: &Path, groups: &[(u32, &str)], line: &[&str]) -> Output {
    job(folder, groups, line).output().unwrap()
}

fn json(output: &Output) -> serde_json::Value {
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{}: {said}", output.status);
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: not one object"))
}

/// A line that runs the model.
fn simulated<'a>(input: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    let mut line = vec!["run", "m.ron", "--target", "pohoiki-springs", "--threads", "1", "--input", input];
    line.extend_from_slice(more);
    line
}

#[test]
fn a_job_finds_what_one_process_finds() {
    let Some((folder, _alone)) = ready() else { return };
    let line = simulated(SHORT, &["--format", "json"]);
    let alone = Command::new(env!("CARGO_BIN_EXE_nsim")).current_dir(folder.path()).args(&line).output().unwrap();
    let alone = json(&alone);
    assert!(alone.get("ranks").is_none());
    for ranks in 1..=4 {
        let found = json(&run(folder.path(), &[(ranks, "")], &line));
        for key in ["digest", "activity", "output_counts", "populations", "inputs", "cores", "overflow", "warnings"] {
            assert_eq!(alone[key], found[key], "{key} on {ranks} ranks");
        }
        let parts = found["ranks"].as_array().unwrap();
        let sum = |key: &str| parts.iter().map(|part| part[key].as_u64().unwrap()).sum::<u64>();
        assert_eq!((parts.len() as u32, sum("compartments"), sum("synapses")), (ranks, 4_000, 136_000));
        let most = parts.iter().map(|part| part["synapses"].as_u64().unwrap()).max().unwrap();
        assert!(most * u64::from(ranks) < 136_000 * 14 / 10, "{most} synapses on one of {ranks} ranks");
    }
    let line =
        ["energy", "vtsnn-slip", "--input", "scene:slip?samples=2", "--copies", "3", "--baseline", "--format", "json"];
    let alone = Command::new(env!("CARGO_BIN_EXE_nsim")).current_dir(folder.path()).args(line).output().unwrap();
    let (mut alone, mut found) = (json(&alone), json(&run(folder.path(), &[(2, "")], &line)));
    assert_eq!(found.as_object_mut().unwrap().remove("ranks").unwrap().as_array().unwrap().len(), 2);
    // Checksums cover the rows of ranks, so they differ.
    for result in [&mut alone, &mut found] {
        result.as_object_mut().unwrap().remove("checksum").unwrap();
    }
    assert_eq!(alone, found, "energy on two ranks");
}

#[test]
fn rows_of_steps_are_those_of_one_process() {
    let Some((folder, _alone)) = ready() else { return };
    let line =
        |file: &str| [simulated(SHORT, &["--steps"]), vec![file]].concat().iter().map(|w| (*w).to_string()).collect();
    let priced = |file: &str| -> Vec<String> {
        let line =
            ["energy", "vtsnn-slip", "--input", "scene:slip?samples=2", "--copies", "2", "--baseline", "--steps", file];
        line.iter().map(|word| (*word).to_string()).collect()
    };
    type Line<'l> = &'l dyn Fn(&str) -> Vec<String>;
    let lines: [Line<'_>; 2] = [&line, &priced];
    for (number, line) in lines.into_iter().enumerate() {
        for form in ["csv", "npy"] {
            let written = |ranks: u32| {
                let file = format!("{number}-{ranks}.{form}");
                let words = line(&file);
                let words: Vec<&str> = words.iter().map(String::as_str).collect();
                let output = run(folder.path(), &[(ranks, "")], &words);
                assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
                std::fs::read(folder.path().join(file)).unwrap()
            };
            let alone = written(1);
            assert!(alone.len() > 1_000, "{} bytes", alone.len());
            assert!([2, 3].into_iter().all(|ranks| written(ranks) == alone), "{form} of line {number}");
        }
    }
}

/// Messages of nsim in the output of a job; messages of `mpirun` are between lines of dashes.
fn messages(output: &Output) -> Vec<String> {
    let said = [&output.stdout[..], &output.stderr[..]].concat();
    let said = String::from_utf8_lossy(&said).into_owned();
    let own = |line: &&str| line.starts_with("error") || line.starts_with("nsim:");
    said.lines().filter(own).map(str::to_string).collect()
}

#[test]
fn a_job_that_fails_says_so_once() {
    let Some((folder, _alone)) = ready() else { return };
    let probed = simulated(SHORT, &["--probe", "n.spikes", "-o", "traces"]);
    std::fs::write(folder.path().join("spikes.csv"), "timestep,channel\n3,5\n9,70\n").unwrap();
    std::fs::create_dir(folder.path().join("other")).unwrap();
    std::fs::write(folder.path().join("other/m.ron"), MODEL).unwrap();
    let unwritable = simulated(SHORT, &["--probe", "n.spikes", "-o", "m.ron/traces"]);
    let from_file = simulated("spikes.csv", &[]);
    let malformed = ["run", "bad.ron"];
    type Failing<'a> = (&'a [(u32, &'a str)], &'a [&'a str], &'a str);
    let cases: [Failing<'_>; 5] = [
        (&[(3, "")], &malformed, "error[model."),
        (&[(2, "")], &["map", "m.ron"], "error: this command runs in one process"),
        // Rank 0 alone writes; the input is absent on rank 1 alone.
        (&[(2, "")], &unwritable, "error[write."),
        (&[(1, ""), (1, "other")], &from_file, "error[io.missing]"),
        (&[(2, "")], &["run", "--nonsense"], "error: unexpected argument"),
    ];
    for (groups, line, message) in cases {
        let begin = Instant::now();
        let output = run(folder.path(), groups, line);
        let took = begin.elapsed();
        let said = messages(&output);
        assert!(said.len() == 1 && said[0].starts_with(message), "{line:?}: {said:?}, not {message}");
        assert!(!output.status.success() && took < Duration::from_secs(30), "{line:?}: {} in {took:?}", output.status);
    }
    // Rank 0 alone writes.
    let output = run(folder.path(), &[(1, ""), (1, "other")], &probed);
    let is_written = |below: &str| folder.path().join(below).join("traces/n.spikes.npy").exists();
    assert!(output.status.success() && is_written("") && !is_written("other"), "{:?}", messages(&output));
}

/// A network of every kind of projection, small enough for its file.
fn mixed() -> String {
    let draw = |at: u32, below: u32| (at.wrapping_mul(2_654_435_761) >> 8) % below;
    let synapse = |at: u32| {
        let weight = 2 * (20 + draw(at + 7_000, 60));
        format!("({}, {}, {weight}),", draw(at, 75), draw(at + 9_000, 400))
    };
    let synapses: String = (0..3_000).map(synapse).collect();
    let row = |target: u32| {
        let weights: Vec<String> = (0..400).map(|source| (2 * draw(target * 400 + source, 120)).to_string()).collect();
        format!("[{}]", weights.join(","))
    };
    let rows: Vec<String> = (0..60).map(row).collect();
    let neurons = "du: 1024, dv: 256, vth_mant: 130, refractory: 2";
    format!(
        "Network(name: \"mixed\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [3, 5, 5]), \
         Loihi(name: \"image\", shape: [4, 5, 5], {neurons}), Loihi(name: \"n\", shape: [400], {neurons}), \
         Loihi(name: \"out\", shape: [60], {neurons})], projections: [\
         Conv2d(from: [\"in\"], to: \"image\", weights: Kernel, padding: (1, 1)), \
         Sparse(from: [\"in\"], to: \"n\", synapses: [{synapses}], delay: 3), \
         Random(from: [\"image\"], to: \"n\", fan_out: 20, low: -40, high: 60, seed: 3), \
         Random(from: [\"n\"], to: \"n\", fan_out: 16, low: -40, high: 40, seed: 4, delay: 1), \
         Dense(from: [\"n\"], to: \"out\", weights: [{}])], output: \"out\")",
        rows.join(",")
    )
    .replace("Kernel", &kernel())
}

/// Weights of a convolution from three channels to four.
fn kernel() -> String {
    let of_pair = "[[20, 40, 20], [40, 80, 40], [20, 40, -20]]";
    let of_channel = format!("[{}]", [of_pair; 3].join(","));
    format!("[{}]", [of_channel.as_str(); 4].join(","))
}

#[test]
fn every_kind_of_projection_is_distributed() {
    let Some((folder, _alone)) = ready() else { return };
    std::fs::write(folder.path().join("mixed.ron"), mixed()).unwrap();
    let limit = "--set target.limits.compartments=16";
    let line = format!("run mixed.ron --target nahuku-32 --threads 1 --input {SHORT} {limit} --format json");
    let line: Vec<&str> = line.split(' ').collect();
    let alone = Command::new(env!("CARGO_BIN_EXE_nsim")).current_dir(folder.path()).args(&line).output().unwrap();
    let alone = json(&alone);
    assert!(alone["activity"]["spikes"].as_u64().unwrap() > 1_000, "{}", alone["activity"]);
    for ranks in 2..=5 {
        let found = json(&run(folder.path(), &[(ranks, "")], &line));
        for key in ["digest", "activity", "output_counts", "populations", "inputs", "cores", "overflow", "warnings"] {
            assert_eq!(alone[key], found[key], "{key} on {ranks} ranks");
        }
    }
}

#[test]
fn what_does_not_fit_is_answered_as_by_one_process() {
    let Some((folder, _alone)) = ready() else { return };
    let line = ["run", "m.ron", "--target", "tiny", "--format", "json"];
    let alone = Command::new(env!("CARGO_BIN_EXE_nsim")).current_dir(folder.path()).args(line).output().unwrap();
    let found = run(folder.path(), &[(3, "")], &line);
    assert_eq!((alone.status.code(), found.status.code()), (Some(1), Some(1)), "{:?}", messages(&found));
    let object = |output: &Output| -> serde_json::Value { serde_json::from_slice(&output.stdout).unwrap() };
    assert_eq!(object(&alone), object(&found));
    assert_eq!(object(&alone)["fits"], false);
}

/// The processes that a job has started, by rank.
fn process_of(job: &Child, rank: u32) -> Option<u32> {
    let wanted = format!("OMPI_COMM_WORLD_RANK={rank}");
    let parent = format!("PPid:\t{}", job.id());
    let numbers =
        std::fs::read_dir("/proc").unwrap().filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok());
    let mut numbers: Vec<u32> = numbers.collect();
    numbers.retain(|number| {
        let read = |name: &str| std::fs::read(format!("/proc/{number}/{name}")).unwrap_or_default();
        let environment = read("environ");
        let is_rank = environment.split(|&byte| byte == 0).any(|entry| entry == wanted.as_bytes());
        is_rank && String::from_utf8_lossy(&read("status")).lines().any(|line| line == parent)
    });
    numbers.first().copied()
}

#[test]
fn a_rank_that_is_killed_and_an_interrupt_end_all() {
    let Some((folder, _alone)) = ready() else { return };
    for signal in ["KILL", "INT"] {
        let job = job(folder.path(), &[(3, "")], &simulated(LONG, &[])).spawn().unwrap();
        std::thread::sleep(Duration::from_secs(4));
        let ranks: Vec<u32> = (0..3).map(|rank| process_of(&job, rank).expect("a rank is not running")).collect();
        let target = if signal == "KILL" { ranks[1] } else { job.id() };
        assert!(Command::new("kill").args([&format!("-{signal}"), &target.to_string()]).status().unwrap().success());
        let begin = Instant::now();
        let output = job.wait_with_output().unwrap();
        let took = begin.elapsed();
        assert!(took < Duration::from_millis(2_500) && !output.status.success(), "{signal}: {took:?}");
        // mpirun names a killed rank; rank 0 reports its own end, if it has the time.
        let said = String::from_utf8_lossy(&output.stderr);
        let mut distinct = messages(&output);
        distinct.dedup();
        assert!(distinct.len() <= 1, "{signal}: {distinct:?}");
        assert!(signal == "INT" || said.contains("signal 9"), "{signal}: {said}");
        // A process that has ended, but was not reaped since mpirun has ended as well, is a zombie.
        let is_left = |rank: &u32| {
            let status = std::fs::read_to_string(format!("/proc/{rank}/status")).unwrap_or_default();
            !status.is_empty() && !status.lines().any(|line| line.starts_with("State:\tZ"))
        };
        while ranks.iter().any(is_left) {
            assert!(begin.elapsed() < Duration::from_millis(2_500), "{signal}: ranks are left");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}
