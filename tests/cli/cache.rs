//! The cache of mappings, and the changes that `--set` makes, from the command line.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

const MODEL: &str = r#"Network(name: "m", timestep_ms: 1.0, populations: [
    Input(name: "in", shape: [300]),
    Loihi(name: "a", shape: [300], du: 4096, dv: 1024, vth_mant: 60, refractory: 1),
    Loihi(name: "b", shape: [40], du: 4096, dv: 1024, vth_mant: 60, refractory: 1),
], projections: [
    Random(from: ["in"], to: "a", fan_out: 40, low: -4, high: 16, seed: 1),
    Random(from: ["a"], to: "a", fan_out: 40, low: -8, high: 8, seed: 2),
    Dense(from: ["a"], to: "b", weights: Uniform(low: -8, high: 16, step: 2, seed: 3)),
], output: "b")"#;
const INPUT: &str = "scene:noise?samples=2&steps=40&seed=1&rate=0.05";

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("m.ron"), MODEL).unwrap();
    folder
}

/// Exit status, JSON and what is said of a command.
fn ran(folder: &Path, line: &str) -> (i32, Value, String) {
    let mut command = Command::new(assert_cmd::cargo::cargo_bin("nsim"));
    command.args(line.split(' ')).args(["--format", "json"]).current_dir(folder);
    let output = command.env("XDG_CACHE_HOME", folder.join("cache")).output().unwrap();
    let printed = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
    (output.status.code().unwrap(), printed, String::from_utf8_lossy(&output.stderr).into_owned())
}

/// A result without what is measured.
fn steady(mut value: Value) -> Value {
    let object = value.as_object_mut().unwrap();
    if let Some(Value::Object(seconds)) = object.get_mut("seconds") {
        seconds.values_mut().for_each(|seconds| *seconds = Value::Null);
    }
    ["wall_s", "us_per_timestep"].iter().for_each(|time| drop(object.remove(*time)));
    value
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    let Ok(found) = std::fs::read_dir(folder.join("cache/nsim/mappings")) else { return Vec::new() };
    found.map(|entry| entry.unwrap().path()).collect()
}

#[test]
fn a_result_is_the_same_with_and_without_the_cache() {
    let folder = folder();
    let lines = [
        "map m.ron".to_string(),
        format!("run m.ron --input {INPUT}"),
        format!("energy m.ron --baseline rtx-2080-ti --input {INPUT}"),
        "map m.ron --objective latency".to_string(),
    ];
    for line in &lines {
        let plain = ran(folder.path(), &format!("{line} --no-cache"));
        assert_eq!(plain.0, 0, "{line}: {}", plain.2);
        let before = entries(folder.path()).len();
        let first = steady(ran(folder.path(), line).1);
        let kept = entries(folder.path());
        let again = steady(ran(folder.path(), line).1);
        assert_eq!(steady(plain.1), first, "{line}");
        assert_eq!(first, again, "{line}");
        // What is mapped by default is mapped once.
        let new = usize::from(line.starts_with("map"));
        assert_eq!((kept.len() - before, entries(folder.path())), (new, kept), "{line}");
    }
}

#[test]
fn a_damaged_entry_is_not_used_and_written_anew() {
    let folder = folder();
    let good = steady(ran(folder.path(), "map m.ron").1);
    let entry = entries(folder.path()).remove(0);
    let bytes = std::fs::read(&entry).unwrap();
    for damaged in [Vec::new(), bytes[..bytes.len() / 2].to_vec(), [&bytes[..], &[0]].concat(), vec![7; bytes.len()]] {
        std::fs::write(&entry, damaged).unwrap();
        let (status, found, said) = ran(folder.path(), "map m.ron");
        assert_eq!((status, said.as_str(), steady(found)), (0, "", good.clone()));
        assert_eq!(std::fs::read(&entry).unwrap(), bytes);
    }
    // Where nothing can be kept nothing is.
    std::fs::remove_dir_all(folder.path().join("cache")).unwrap();
    std::fs::write(folder.path().join("cache"), "a file").unwrap();
    assert_eq!(steady(ran(folder.path(), "map m.ron").1), good);
}

#[test]
fn the_cache_says_what_it_holds_and_is_emptied() {
    let folder = folder();
    let held = |line: &str| {
        let (status, found, said) = ran(folder.path(), line);
        assert_eq!(status, 0, "{said}");
        (found["entries"].as_u64().unwrap(), found["removed"].as_u64().unwrap())
    };
    assert_eq!(held("cache"), (0, 0));
    ran(folder.path(), "map m.ron");
    ran(folder.path(), "map m.ron --seed 3");
    assert_eq!(held("cache"), (2, 0));
    assert_eq!(held("cache --clear"), (0, 2));
    assert_eq!(held("cache"), (0, 0));
}

#[test]
fn run_map_and_energy_map_alike() {
    let folder = folder();
    let mapped = ran(folder.path(), "map m.ron --no-cache").1;
    let cores = |value: &Value| {
        let cores = value["cores"].as_array().unwrap().iter();
        cores.map(|core| [&core["core"], &core["chip"]].map(|n| n.as_u64().unwrap())).collect::<Vec<_>>()
    };
    for line in ["run", "energy"] {
        let found = ran(folder.path(), &format!("{line} m.ron --no-cache --input {INPUT}")).1;
        assert_eq!(cores(&found), cores(&mapped), "{line}");
    }
    let energy = ran(folder.path(), &format!("energy m.ron --no-cache --input {INPUT}")).1;
    assert_eq!(energy["cores_used"], mapped["cores_used"]);
}

#[test]
fn a_time_budget_is_said_and_zero_is_the_quickest_mapping() {
    let folder = folder();
    let budget = |line: &str| ran(folder.path(), line).1["time_budget_s"].clone();
    assert_eq!(budget("map m.ron"), Value::Null);
    assert_eq!(budget("map m.ron --time-budget 0.25"), 0.25);
    assert_eq!(budget("map m.ron --time-budget 0"), 0.0);
    assert_eq!(entries(folder.path()).len(), 1, "a mapping by the clock is not kept");
    for wrong in ["-1", "x", "nan", "1e9"] {
        assert_eq!(ran(folder.path(), &format!("map m.ron --time-budget={wrong}")).0, 2, "{wrong}");
    }
}

#[test]
fn fields_of_model_target_and_constants_are_set() {
    let folder = folder();
    let mapped = |changes: &str| {
        let (status, found, said) = ran(folder.path(), &format!("map m.ron{changes}"));
        assert_eq!(status, 0, "{said}");
        found
    };
    let plain = mapped("");
    let narrow = mapped(" --set target.limits.compartments=20");
    assert_eq!(narrow["limits"]["compartments"], 20);
    assert!(narrow["cores_used"].as_u64() > plain["cores_used"].as_u64());
    assert_eq!(narrow["target"], plain["target"]);
    let small = mapped(" --set populations.b.shape=[40] --set populations.b.refractory=2 --set name=\"other\"");
    assert_eq!(small["model"], "other");
    let energy = |changes: &str| {
        let line = format!("energy m.ron --constants davies2018 --host none --input {INPUT}{changes}");
        let (status, found, said) = ran(folder.path(), &line);
        assert_eq!(status, 0, "{said}");
        found["breakdown_pj_per_timestep"]["hop"].as_f64().unwrap()
    };
    let hop = " --set constants.hop_ew_energy=0 --set constants.hop_ns_energy=0";
    assert!(energy("") >= energy(hop));
    for (wrong, says) in [
        ("nothing=1", "field named `nothing`"),
        ("populations.c.du=1", "populations has no c"),
        ("populations.a.vth=x", "model."),
        ("target.nothing=1", "nothing"),
        ("constants.nothing=1", "no such number"),
        ("constants.barrier=x", "no such number"),
        ("constants.injection_time=0.4", "has no unit"),
    ] {
        let (status, found, said) = ran(folder.path(), &format!("map m.ron --set {wrong}"));
        assert!([2, 3].contains(&status), "{wrong}: {status}");
        assert!((found.to_string() + &said).contains(says), "{wrong}: {said}");
    }
    assert_eq!(ran(folder.path(), "map m.ron --set nothing").0, 2);
}
