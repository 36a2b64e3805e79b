//! `nsim compare`: one row for each target, with the prices of `nsim energy` there.

use serde_json::Value;

use crate::common::command::{object, said};
use crate::{MODEL, write};

const INPUT: &str = "scene:noise?samples=2&steps=20&rate=0.3&seed=3";

/// A network that sends integers, for which Loihi 1 has no messages.
const GRADED: &str = "Network(name: \"graded\", timestep_ms: 1.0, populations: [
    Input(name: \"in\", shape: [3], message_bits: 8), Sigma(name: \"out\", shape: [2], message_bits: 16)],
  projections: [Dense(from: [\"in\"], to: \"out\", weights: [[2, 0, 4], [0, 6, 2]])], output: \"out\")";

#[test]
fn a_row_is_what_energy_says_of_that_target() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(here, "m.ron", MODEL);
    let relays = " --relays --set target.limits.axons_in=2";
    for options in ["", " --host none", " --accounting rails", " --mode realtime", " --prune static"] {
        rows_are_those_of_energy(here, ["loihi1-chip", "oheo-gulch"], options);
    }
    rows_are_those_of_energy(here, ["loihi1-chip", "nahuku-32"], relays);
    // 130 cores are on two chips, hence two x86 cores.
    let wide = format!(
        "Network(name: \"small\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [3]),
           Loihi(name: \"out\", shape: [130], du: 1024, dv: 128, vth_mant: 10)],
         projections: [Dense(from: [\"in\"], to: \"out\", weights: {:?})], output: \"out\")",
        [[9; 3]; 130]
    );
    write(here, "m.ron", &wide);
    rows_are_those_of_energy(here, ["nahuku-32", "pohoiki-springs"], " --set target.limits.compartments=1");
}

fn rows_are_those_of_energy(here: &std::path::Path, targets: [&str; 2], options: &str) {
    let line = format!("compare m.ron --targets {} --input {INPUT}{options}", targets.join(","));
    let compared = object(here, &line, 0);
    assert_eq!((&compared["schema"], &compared["model"]), (&"nsim.compare/1".into(), &"small".into()));
    for (row, name) in compared["targets"].as_array().unwrap().iter().zip(targets) {
        let energy = object(here, &format!("energy m.ron --target {name} --baseline --input {INPUT}{options}"), 0);
        let rows = energy["rows"].as_array().unwrap();
        let total = rows.iter().find(|row| row["unit"] == "total").unwrap();
        assert_eq!((&row["target"], &row["fits"]), (&name.into(), &true.into()));
        for key in ["latency_us", "energy_uj", "total_mw"] {
            assert_eq!(row[key], total[key], "{name} {key}");
            let ends = [("low", format!("{key}_low")), ("high", format!("{key}_high"))];
            ends.iter().for_each(|(end, own)| assert_eq!(row[own], total[end][key], "{name} {own}"));
            let [low, high] = ["low", "high"].map(|end| row[format!("{key}_{end}")].as_f64());
            // A paced step is never shorter than its timestep.
            let at_end = options.contains("realtime") && low == row[key].as_f64();
            assert!(low.is_some() && (low < row[key].as_f64() || at_end) && row[key].as_f64() < high, "{name} {key}");
        }
        let (all, job) = (total["total_mw"].as_f64().unwrap(), energy["job"]["total_mw"].as_f64().unwrap());
        assert!((all / job - 1.0).abs() < 1e-9, "{name}: {all} mW of {job}");
        assert_eq!(row["x86_share"], energy["host"]["x86_share"], "{name}");
        assert_eq!(row["cores_used"], energy["cores_used"]);
        // Bounds of modelled constants have no level.
        let modelled = energy["level"] == Value::Null;
        let bounded = name == "oheo-gulch";
        assert_eq!((row["intervals"] == "constants", bounded), (modelled, modelled));
    }
}

#[test]
fn a_target_that_cannot_hold_the_network_is_a_row_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(here, "g.ron", GRADED);
    let line = format!("compare g.ron --targets loihi1-chip,oheo-gulch --input {INPUT}");
    let compared = object(here, &line, 0);
    let (refused, held) = (&compared["targets"][0], &compared["targets"][1]);
    assert_eq!((&refused["fits"], &held["fits"]), (&false.into(), &true.into()));
    assert!(refused["cores_used"].is_null() && refused["latency_us"].is_null());
    assert!(refused["reasons"][0]["code"].as_str().unwrap().starts_with("map."), "{refused}");
    let (_, text, _) = said(here, &line);
    assert!(text.contains("it does not fit loihi1-chip: ") && text.lines().all(|line| line.len() <= 80), "{text}");
    let (status, csv, _) = said(here, &format!("{line} --format csv"));
    assert!(status == 0 && csv.lines().count() == 3 && csv.starts_with("target,hardware,constants,fits,"), "{csv}");
    // No target supports it: the answer is no.
    assert_eq!(said(here, &format!("compare g.ron --targets loihi1-chip --input {INPUT}")).0, 1);
    assert_eq!(said(here, "compare g.ron --targets no-such-board").0, 3);
}
