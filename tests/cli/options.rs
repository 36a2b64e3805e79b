//! `--time-budget`, and changes by `--set`, from the command line.

use std::path::Path;

use serde_json::Value;

use crate::common::command::said;

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

/// Exit status, JSON and stderr of a command.
fn ran(folder: &Path, line: &str) -> (i32, Value, String) {
    let (status, printed, error) = said(folder, &format!("{line} --format json"));
    (status, serde_json::from_str(&printed).unwrap_or(Value::Null), error)
}

#[test]
fn run_map_and_energy_map_alike() {
    let folder = folder();
    let mapped = ran(folder.path(), "map m.ron").1;
    let cores = |value: &Value| {
        let cores = value["cores"].as_array().unwrap().iter();
        cores.map(|core| [&core["core"], &core["chip"]].map(|n| n.as_u64().unwrap())).collect::<Vec<_>>()
    };
    for line in ["run", "energy"] {
        let found = ran(folder.path(), &format!("{line} m.ron --input {INPUT}")).1;
        assert_eq!(cores(&found), cores(&mapped), "{line}");
    }
    let energy = ran(folder.path(), &format!("energy m.ron --input {INPUT}")).1;
    assert_eq!(energy["cores_used"], mapped["cores_used"]);
}

#[test]
fn a_time_budget_is_said_and_zero_is_the_quickest_mapping() {
    let folder = folder();
    let budget = |line: &str| ran(folder.path(), line).1["time_budget_s"].clone();
    assert_eq!(budget("map m.ron"), Value::Null);
    assert_eq!(budget("map m.ron --time-budget 0.25"), 0.25);
    assert_eq!(budget("map m.ron --time-budget 0"), 0.0);
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
        ("nothing=1", "has no field `nothing`"),
        ("populations.c.du=1", "populations has no c; it has in, a"),
        ("populations.a.vt_mant=1", "did you mean 'vth_mant'?"),
        ("populations.a.vth=x", "model."),
        ("target.nothing=1", "nothing"),
        ("constants.nothing=1", "no such constant"),
        ("constants.barrier=x", "no such constant"),
        ("constants.injection_time=0.4", "has no unit"),
    ] {
        let (status, found, said) = ran(folder.path(), &format!("map m.ron --set {wrong}"));
        assert!([2, 3].contains(&status), "{wrong}: {status}");
        assert!((found.to_string() + &said).contains(says), "{wrong}: {said}");
    }
    assert_eq!(ran(folder.path(), "map m.ron --set nothing").0, 2);
}
