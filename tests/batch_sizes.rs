//! `nsim bench batch` beside the single commands that its rows are made of.

// A test that cannot go on has failed.
#![allow(clippy::unwrap_used)]

use std::path::Path;
use std::process::Command;

use serde_json::Value;

const NOISE: &str = "scene:noise?samples=3&steps=40&seed=5&rate=0.05";

fn object(folder: &Path, line: &[&str]) -> Value {
    let mut command = Command::new(assert_cmd::cargo::cargo_bin("nsim"));
    let output = command.args(line).args(["--format", "json"]).current_dir(folder).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{line:?}: {said}");
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn rows_of_the_chip_are_what_energy_prints_for_as_many_copies() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let line = ["bench", "batch", "slip-tactile", "--input", NOISE, "--sizes", "4,1", "--seconds", "0.000001"];
    let found = object(here, &[&line[..], &["--plot", "b.svg"]].concat());
    assert_eq!(found["timesteps"], 40);
    let rows = found["rows"].as_array().unwrap();
    let of = |hardware: &str| -> Vec<&Value> {
        rows.iter().filter(|row| row["hardware"].as_str().unwrap().starts_with(hardware)).collect()
    };
    for (row, copies) in of("nahuku-32").into_iter().zip(["1", "4"]) {
        let energy = object(here, &["energy", "slip-tactile", "--input", NOISE, "--copies", copies, "--baseline"]);
        let total = energy["rows"].as_array().unwrap().iter().find(|row| row["unit"] == "total").unwrap();
        let near = |found: &Value, expected: f64| (found.as_f64().unwrap() / expected - 1.0).abs() < 1e-9;
        assert_eq!(row["batch"].to_string(), copies);
        assert!(near(&row["batch_ms"], total["latency_us"].as_f64().unwrap() * 40.0 / 1e3), "{row}");
        assert!(near(&row["energy_uj"], total["energy_uj"].as_f64().unwrap() * 40.0), "{row}");
    }
    for hardware in ["nahuku-32", "RTX 2080 Ti", "CPU, event-driven", "CPU, dense f32"] {
        assert_eq!(of(hardware).len(), 2, "{hardware}: {found}");
    }
    assert!(found["crossings"].as_array().unwrap().iter().any(|one| one["figure"] == "energy"), "{found}");
    assert!(std::fs::read_to_string(here.join("b.svg")).unwrap().contains("RTX 2080 Ti"));
    // Watts that are stated count whole, and are compared with.
    let stated = object(here, &[&line[..], &["--cpu-watts", "5,20"]].concat());
    let compared = |found: &Value| {
        let crossings = found["crossings"].as_array().unwrap().iter();
        crossings
            .filter(|one| one["hardware"].as_str().unwrap().starts_with("CPU") && one["figure"] == "energy")
            .count()
    };
    assert_eq!(compared(&stated), 2);
    let sources: Vec<&str> = of("CPU").iter().map(|row| row["power_source"].as_str().unwrap()).collect();
    assert!(sources.iter().all(|source| *source == "measured") || compared(&found) == 0, "{sources:?}");
}

#[test]
fn more_samples_than_copies_fit_take_rounds() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    // A chip of 128 cores holds fewer than 512 copies of this network.
    let line = ["bench", "batch", "vtsnn-slip", "--target", "loihi1-chip", "--input", NOISE, "--sizes", "2,512"];
    let found = object(here, &[&line[..], &["--seconds", "0.000001"]].concat());
    let row = &found["rows"][1];
    let together = row["together"].as_u64().unwrap();
    assert!((2..512).contains(&together), "{row}");
    assert!(row["note"].as_str().unwrap().contains("rounds"), "{row}");
    let copies = together.to_string();
    let line = ["energy", "vtsnn-slip", "--target", "loihi1-chip", "--input", NOISE, "--copies", &copies, "--baseline"];
    let energy = object(here, &line);
    let total = energy["rows"].as_array().unwrap().iter().find(|row| row["unit"] == "total").unwrap();
    let rounds = 512_u64.div_ceil(together) as f64;
    let expected = rounds * 40.0 * total["latency_us"].as_f64().unwrap() / 1e3;
    assert!((row["batch_ms"].as_f64().unwrap() / expected - 1.0).abs() < 1e-9, "{row}, {expected}");
}
