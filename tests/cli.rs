//! The command line end to end: exit status, result objects, files, determinism.

// A test that cannot go on has failed.
#![allow(clippy::unwrap_used)]

use std::path::Path;

use assert_cmd::Command;
use serde_json::Value;

fn nsim(arguments: &[&str]) -> Command {
    let mut command = Command::cargo_bin("nsim").unwrap();
    command.args(arguments);
    command
}

/// Runs and returns exit status, stdout and stderr.
fn said(arguments: &[&str]) -> (i32, String, String) {
    let output = nsim(arguments).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code().unwrap(), text(&output.stdout), text(&output.stderr))
}

/// The result object of a command that should end with this status.
fn object(arguments: &[&str], status: i32) -> Value {
    let (code, stdout, stderr) = said(&[arguments, &["--format", "json"]].concat());
    assert_eq!(code, status, "{arguments:?}: {stderr}");
    serde_json::from_str(&stdout).unwrap_or_else(|e| panic!("{arguments:?}: {e}: {stdout}"))
}

fn has_keys(object: &Value, keys: &[&str]) {
    for key in keys {
        assert!(object.get(key).is_some(), "no key {key} in {}", object["schema"]);
    }
}

const MODEL: &str = "Network(name: \"small\", timestep_ms: 1.0,
  populations: [Input(name: \"in\", shape: [3]), Loihi(name: \"hidden\", shape: [4], du: 1024, dv: 128, vth_mant: 10),
    Loihi(name: \"out\", shape: [2], du: 1024, dv: 128, vth_mant: 10)],
  projections: [Dense(from: [\"in\"], to: \"hidden\", weights: [[20, 0, 4], [2, 30, 6], [0, 8, 40], [12, -6, 2]]),
    Dense(from: [\"hidden\"], to: \"out\", weights: [[30, 0, 20, 2], [0, 40, -10, 8]])],
  output: \"out\", classes: [\"left\", \"right\"])";

fn write(folder: &Path, name: &str, text: &str) -> String {
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path.display().to_string()
}

#[test]
fn every_command_prints_its_object() {
    let map = object(&["map"], 0);
    assert_eq!(map["schema"], "nsim.map/1");
    has_keys(&map, &["model", "target", "copies", "objective", "strategy", "placed", "seed", "fits", "cores_used"]);
    has_keys(&map, &["chips_used", "cores_per_copy", "checked", "cores", "limits", "traffic", "seconds", "reasons"]);
    has_keys(
        &map["cores"][0],
        &["core", "chip", "x", "y", "compartments", "axons_in", "axons_out", "synapses", "synapse_words"],
    );
    has_keys(&map["traffic"], &["cut_spikes_per_step", "hops_per_step", "mean_link_load", "max_link_load"]);
    assert_eq!((&map["cores"][0]["axons_in"], &map["cores"][0]["synapse_words"]), (&3366.into(), &7452.into()));

    let run = object(&["run", "--samples", "0..2"], 0);
    assert_eq!(run["schema"], "nsim.run/1");
    has_keys(&run, &["model", "target", "engine", "samples", "timesteps", "predicted", "labels", "accuracy"]);
    has_keys(
        &run,
        &["output_counts", "digest", "activity", "skipped", "overflow", "decided_at", "wall_s", "us_per_timestep"],
    );
    has_keys(&run["activity"], &["spikes_in", "spikes", "synaptic_events", "compartment_updates", "messages", "hops"]);
    has_keys(&run["overflow"], &["q_wrapped", "u_wrapped", "v_clipped", "first"]);
    assert_eq!((&run["samples"], &run["timesteps"], &run["seed"]), (&2.into(), &300.into(), &3.into()));

    let energy = object(&["energy", "--samples", "0..2", "--copies", "2"], 0);
    assert_eq!(energy["schema"], "nsim.energy/1");
    has_keys(
        &energy,
        &["model", "target", "copies", "deployment", "mode", "convention", "seed", "rows", "cores_powered"],
    );
    has_keys(&energy, &["cores_used", "breakdown_pj_per_timestep", "per_timestep_uj", "early_exit", "constants"]);
    let keys = ["synapse", "dendrite", "compartment", "spike", "axon_out", "axon_in", "hop", "core_step"];
    has_keys(&energy["breakdown_pj_per_timestep"], &keys);
    has_keys(&energy["per_timestep_uj"], &["min", "p50", "p99", "max"]);
    let keys = [
        "hardware",
        "unit",
        "static_mw",
        "dynamic_mw",
        "total_mw",
        "latency_us",
        "energy_uj",
        "edp_pjs",
        "low",
        "high",
    ];
    has_keys(&energy["rows"][0], &keys);

    assert_eq!(object(&["inspect", "vtsnn-slip"], 0)["schema"], "nsim.inspect/1");

    let bench = object(&["bench", "step", "--network", "vtsnn-1pct", "--seconds", "0.02"], 0);
    assert_eq!((&bench["schema"], &bench["name"]), (&"nsim.bench/1".into(), &"step".into()));
    has_keys(&bench["environment"], &["cpu", "cores", "os", "rustc", "nsim"]);
    let rows = bench["rows"].as_array().unwrap();
    assert_eq!(rows.iter().map(|row| &row["skip"]).collect::<Vec<_>>(), [true, false]);
    for row in rows {
        has_keys(row, &["network", "threads", "us_per_timestep", "spread", "bytes_per_synapse"]);
        assert!((350.0..450.0).contains(&row["synaptic_events_per_step"].as_f64().unwrap()), "{row}");
    }
}

/// A network whose hidden population has a threshold out of reach.
const QUIET: &str = "Network(name: \"quiet\", timestep_ms: 1.0,
  populations: [Input(name: \"in\", shape: [4]), Loihi(name: \"hid\", shape: [3], du: 1024, dv: 128, vth_mant: 9000),
    Loihi(name: \"out\", shape: [2], du: 1024, dv: 128, vth_mant: 80)],
  projections: [Dense(from: [\"in\"], to: \"hid\", weights: [[20, 20, 20, 20], [2, 2, 2, 2], [3, 5, 7, 9]]),
    Dense(from: [\"hid\"], to: \"out\", weights: [[2, 2, 2], [2, 2, 2]])], output: \"out\")";

fn sum(rows: &Value, key: &str) -> u64 {
    rows.as_array().unwrap().iter().map(|row| row[key].as_u64().unwrap()).sum()
}

#[test]
fn results_say_what_each_population_and_core_did_and_what_to_change() {
    let folder = tempfile::tempdir().unwrap();
    let quiet = write(folder.path(), "quiet.ron", QUIET);
    let input = ["--input", "scene:noise?samples=2&steps=50&seed=1&rate=0.3"];
    let warnings = |object: &Value| -> Vec<(String, String)> {
        let rows = object["warnings"].as_array().unwrap();
        rows.iter()
            .map(|row| (row["code"].as_str().unwrap().into(), row["population"].as_str().unwrap().into()))
            .collect()
    };
    let silent = [("silent-population", "hid"), ("silent-output", "out")].map(|(a, b)| (a.to_string(), b.to_string()));
    for arguments in [&["run", &quiet][..], &["run", &quiet, "--engine", "golden"], &["energy", &quiet, "--baseline"]] {
        let quiet = object(&[arguments, &input].concat(), 0);
        assert_eq!(warnings(&quiet), silent, "{arguments:?}");
        assert_eq!(sum(&quiet["populations"], "silent"), 5, "{arguments:?}");
        assert_eq!(quiet["cores"].as_array().unwrap().is_empty(), arguments.contains(&"golden"));
    }
    // The threshold that the warning names makes the population fire, the next one does not.
    let (_, _, stderr) = said(&[&["run", &quiet][..], &input].concat());
    assert_eq!(stderr.matches("'hid'").count(), 2, "once for itself, once as the cause: {stderr}");
    let (_, named) = stderr.split_once("lower vth_mant from 9000 to ").unwrap();
    let vth: u32 = named.split(',').next().unwrap().parse().unwrap();
    for (vth, fires) in [(vth, true), (vth + 1, false)] {
        let changed = write(folder.path(), "changed.ron", &QUIET.replace("9000", &vth.to_string()));
        let run = object(&[&["run", &changed][..], &input].concat(), 0);
        assert_eq!(run["populations"][0]["spikes"].as_u64().unwrap() > 0, fires, "vth_mant {vth}");
    }

    let run = object(&["run", "--samples", "0..4"], 0);
    assert_eq!(
        (&run["warnings"], sum(&run["populations"], "spikes")),
        (&Value::Array(vec![]), run["activity"]["spikes"].as_u64().unwrap())
    );
    assert_eq!(sum(&run["inputs"], "spikes"), run["activity"]["spikes_in"].as_u64().unwrap());
    for (key, total) in [("spikes", "spikes"), ("synaptic_events", "synaptic_events"), ("messages_in", "messages")] {
        assert_eq!(sum(&run["cores"], key), run["activity"][total].as_u64().unwrap(), "{key}");
    }
    let energy = object(&["energy", "--samples", "0..4", "--baseline", "--copies", "2"], 0);
    assert_eq!(sum(&energy["cores"], "spikes"), sum(&energy["populations"], "spikes"));
    assert_eq!(sum(&energy["cores"], "slowest_steps"), energy["timesteps"].as_u64().unwrap());
    has_keys(&energy["cores"][0], &["core", "chip", "energy_pj", "busy_us", "messages_in", "messages_out"]);
    let reference = object(&["run", "vtsnn-slip-srm", "--samples", "0..2"], 0);
    assert_eq!((&reference["engine"], &reference["cores"]), (&"reference".into(), &Value::Array(vec![])));
    assert_eq!(sum(&reference["populations"], "spikes"), reference["activity"]["spikes"].as_u64().unwrap());
}

#[test]
fn probes_take_patterns_and_inputs_and_steps_go_to_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "small.ron", MODEL);
    let input = ["--input", "scene:noise?samples=2&steps=30&seed=1&rate=0.3"];
    let (traces, table) = (folder.path().join("traces"), folder.path().join("steps.csv"));
    let files = ["-o", traces.to_str().unwrap(), "--steps", table.to_str().unwrap()];
    let probes = ["--probe", "?n*", "--probe", "*.v", "--probe", "hid*.spikes"];
    let run = object(&[&["run", &model][..], &input, &files, &probes].concat(), 0);
    assert_eq!(run["files"].as_array().unwrap().len(), 5, "{}", run["files"]);
    let names = ["in.spikes", "hidden.v", "out.v", "hidden.spikes"].map(|name| traces.join(format!("{name}.npy")));
    assert!(names.iter().all(|name| name.exists()));
    // The array of the input's spikes holds as many as went in.
    let bytes = std::fs::read(&names[0]).unwrap();
    let ones = bytes[bytes.len() - 2 * 3 * 30..].iter().filter(|&&byte| byte == 1).count() as u64;
    assert_eq!(ones, run["activity"]["spikes_in"].as_u64().unwrap());
    let rows = std::fs::read_to_string(&table).unwrap();
    assert!(
        rows.starts_with("sample,timestep,spikes.in,spikes.hidden,spikes.out,synaptic_events,messages,hops,time_us.")
    );
    assert_eq!(rows.lines().count(), 61);
    for wrong in [
        &["--probe", "x*", "-o", "t"][..],
        &["--probe", "in.v", "-o", "t"],
        &["--steps", "s.txt"],
        &["--steps", "s.csv", "--engine", "golden"],
        &["--steps", "s.npy", "--early-exit", "1"],
    ] {
        let (code, _, stderr) = said(&[&["run", &model][..], &input, wrong].concat());
        assert_eq!(code, 2, "{wrong:?}: {stderr}");
    }
}

#[test]
fn agreement_says_what_each_layer_loses_and_draws_where_spikes_part() {
    let folder = tempfile::tempdir().unwrap();
    let picture = folder.path().join("first.svg");
    let model = write(folder.path(), "srm.ron", SRM);
    let input = ["--input", "scene:noise?samples=4&rate=0.2", "--seed", "3", "--plot", picture.to_str().unwrap()];
    let agree = object(&[&["agree", &model][..], &input].concat(), 0);
    let layers: Vec<&str> = agree["lost"].as_array().unwrap().iter().map(|row| row["name"].as_str().unwrap()).collect();
    assert_eq!(layers, ["hidden", "out"]);
    for row in agree["lost"].as_array().unwrap() {
        let added: f64 = row["causes"].as_object().unwrap().values().map(|added| added.as_f64().unwrap()).sum();
        assert!((added - row["disagreement"].as_f64().unwrap()).abs() < 1e-4, "causes add up: {row}");
    }
    let svg = std::fs::read_to_string(&picture).unwrap();
    assert!(svg.contains("parts in step") && svg.matches("<polyline").count() == 3, "{svg}");
    let (_, text, _) = said(&["agree", &model, "--input", "scene:noise?samples=4&rate=0.2", "--seed", "3"]);
    assert!(text.contains("'hidden' loses "), "{text}");
}

const SRM: &str = "Network(name: \"srm\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [6]),
    Srm(name: \"hidden\", shape: [5], tau_sr_ms: 10, tau_ref_ms: 1, scale_ref: 2, theta: 10),
    Srm(name: \"out\", shape: [2], tau_sr_ms: 10, tau_ref_ms: 1, scale_ref: 2, theta: 10)],
  projections: [Dense(from: [\"in\"], to: \"hidden\", weights: Uniform(low: -1, high: 4, seed: 1)),
    Dense(from: [\"hidden\"], to: \"out\", weights: Uniform(low: -2, high: 4, seed: 2))], output: \"out\")";

#[test]
fn a_spike_response_model_runs_in_real_numbers_and_agrees_or_not() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "srm.ron", SRM);
    let scene = "scene:noise?samples=6&rate=0.1";
    let run =
        object(&["run", &model, "--input", scene, "--probe", "hidden.u", "-o", folder.path().to_str().unwrap()], 0);
    assert_eq!((&run["engine"], &run["samples"]), (&"reference".into(), &6.into()));
    let bytes = std::fs::read(folder.path().join("hidden.u.npy")).unwrap();
    assert!(String::from_utf8_lossy(&bytes[..80]).contains("<f8"));
    let (code, _, stderr) = said(&["run", &model, "--input", scene, "--engine", "fast"]);
    assert!(code == 0 && stderr.contains("equal decays") && stderr.contains("nsim convert"), "{stderr}");
    assert_eq!(said(&["run", &model, "--input", scene, "--engine", "reference", "--prune", "static"]).0, 2);

    let agree = object(&["agree", &model, "--input", scene, "--calibration-samples", "8"], 0);
    assert_eq!((&agree["schema"], &agree["samples"]), (&"nsim.agree/1".into(), &6.into()));
    has_keys(&agree, &["class_agreement", "layers", "attribution", "conversion"]);
    let keys =
        ["name", "shift", "spikes_a", "spikes_b", "coincidence", "van_rossum", "victor_purpura", "potential_rmse"];
    has_keys(&agree["layers"][0], &keys);
    has_keys(&agree["layers"][0]["first_divergence"], &["sample", "timestep", "neuron", "a", "b"]);
    assert!(agree["attribution"].as_array().unwrap().len() >= 5);
    has_keys(&agree["attribution"][0], &["cause", "class_agreement", "coincidence", "potential_rmse", "share"]);
    let search = &agree["conversion"]["search"];
    assert!(search["residual"]["count_error"].as_f64() <= search["start"]["count_error"].as_f64(), "{search}");
    let analytic = ["agree", &model, "--input", scene, "--conversion", "analytic"];
    object(&[&analytic[..], &["--require-exact"]].concat(), 1);
    object(&[&analytic[..], &["--against", "golden", "--require-exact"]].concat(), 0);
    assert_eq!(said(&[&analytic[..], &["--require-class-agreement", "1.5"]].concat()).0, 2);
    assert_eq!(said(&["agree", "vtsnn-slip", "--against", "srm"]).0, 2);
    let one_thread = object(&[&analytic[..], &["--threads", "1"]].concat(), 0);
    assert_eq!(one_thread, object(&[&analytic[..], &["--threads", "2"]].concat(), 0));
}

#[test]
fn the_stability_suite_and_the_front_print_their_objects() {
    let stress = object(&["stress", "--case", "fan-in-4096-negative", "refractory-1-and-63"], 0);
    assert_eq!((&stress["schema"], &stress["cases"][1]["verdict"]), (&"nsim.stress/1".into(), &"pass".into()));
    assert_eq!(said(&["stress", "--case", "no-such"]).0, 2);
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "srm.ron", SRM);
    let svg = folder.path().join("front.svg");
    let document = write(folder.path(), "d.md", "a\n<!-- pareto srm -->\nreplace me\n<!-- end pareto srm -->\nb\n");
    let scene = "scene:noise?samples=4&rate=0.1";
    let pareto = ["bench", "pareto", &model, "--input", scene, "--seconds", "0", "--conversion", "analytic", "--force"];
    let files = ["--svg", svg.to_str().unwrap(), "--update", &document];
    let pareto = object(&[&pareto[..], &files].concat(), 0);
    assert_eq!((&pareto["schema"], &pareto["name"]), (&"nsim.bench/1".into(), &"pareto".into()));
    let rows = pareto["rows"].as_array().unwrap();
    assert!(rows.len() >= 20);
    for row in rows {
        has_keys(
            row,
            &["variant", "us_per_timestep", "spread", "class_agreement", "coincidence", "potential_rmse", "on_front"],
        );
        assert!(row["exact"] != false, "{row}");
    }
    let exact: Vec<&str> =
        rows.iter().filter(|row| row["exact"] == true).filter_map(|row| row["variant"].as_str()).collect();
    assert_eq!(exact, ["golden", "fast", "fast-no-skip", "metered-analytic", "metered-queued"]);
    let trained = &rows[0];
    assert_eq!((&trained["variant"], &trained["coincidence"]), (&"reference-f64-recursion".into(), &1.0.into()));
    let written = std::fs::read_to_string(&document).unwrap();
    assert!(written.contains("| golden |") && !written.contains("replace me") && svg.exists());
    assert!(folder.path().join("pareto-srm.svg").exists());
}

#[test]
fn what_does_not_fit_is_answered_with_the_command_s_own_object() {
    for (command, keys) in [
        ("run", ["samples", "digest", "activity", "wall_s"]),
        ("energy", ["rows", "cores_powered", "breakdown_pj_per_timestep", "constants"]),
    ] {
        let object = object(&[command, "--target", "tiny"], 1);
        assert_eq!((&object["schema"], &object["fits"]), (&format!("nsim.{command}/1").into(), &false.into()));
        has_keys(&object, &keys);
        has_keys(&object["reasons"][0], &["code", "population", "core", "resource", "need", "limit", "help"]);
        assert_eq!((&object["model"], &object["target"]), (&"vtsnn-slip".into(), &"tiny".into()));
    }
}

#[test]
fn the_answer_fits_a_screen_and_can_be_put_into_a_paper() {
    let energy =
        |more: &[&str]| said(&[&["energy", "--samples", "0..1", "--copies", "1", "--baseline"], more].concat()).1;
    let text = energy(&[]);
    assert!(text.lines().count() <= 10 && text.lines().all(|line| line.chars().count() <= 80), "{text}");
    assert!(energy(&["--full"]).lines().count() > 20);
    let table = energy(&["--format", "markdown"]);
    assert!(table.starts_with("| Hardware | Static (mW) |") && table.lines().count() == 5, "{table}");
    let table = energy(&["--format", "latex"]);
    assert!(table.contains("\\begin{tabular}{lrrrrrl}") && table.contains("loihi total & "), "{table}");
    // The chips alone: no x86 power, and a step without the host's turn.
    let [all, alone] = [vec![], vec!["--host", "none"]].map(|more| {
        let line = [&["energy", "--samples", "0..1", "--copies", "1", "--baseline"][..], &more[..]].concat();
        object(&line, 0)
    });
    assert_eq!((&all["host"]["x86_cores"], &alone["host"]["x86_cores"]), (&1.into(), &0.into()));
    assert_eq!(alone["rows"][0]["total_mw"], 0.0);
    assert!(alone["rows"][2]["latency_us"].as_f64() < all["rows"][2]["latency_us"].as_f64());
    let share = &all["rows"][2]["share"];
    let sum: f64 = ["published", "fitted", "assumed"].iter().map(|key| share[key].as_f64().unwrap()).sum();
    assert!((sum - 1.0).abs() < 1e-9, "{share}");
    let board = object(&["energy", "--samples", "0..1", "--copies", "1", "--baseline", "--accounting", "board"], 0);
    assert_eq!((&board["accounting"], &board["preset"]), (&"board".into(), &"loihi1-evidence-board".into()));
}

#[test]
fn other_hardware_stands_beside_the_chip_with_its_source() {
    let energy = object(&["energy", "--samples", "0..1", "--copies", "1", "--cpu-watts", "5,20"], 0);
    let rows = energy["rows"].as_array().unwrap();
    let named: Vec<(&str, &str, &str)> = rows
        .iter()
        .map(|row| {
            let text = |key: &str| row[key].as_str().unwrap();
            (text("hardware"), text("source"), text("power_source"))
        })
        .collect();
    assert_eq!(
        named[3..],
        [
            ("RTX 2080 Ti", "published", "published"),
            ("CPU, dense f32", "measured", "stated"),
            ("CPU, event-driven", "measured", "stated"),
        ]
    );
    for row in &rows[4..] {
        assert_eq!((&row["static_mw"], &row["total_mw"]), (&5_000.0.into(), &20_000.0.into()));
        assert!(row["latency_us"].as_f64().unwrap() > 0.0);
    }
    has_keys(&energy, &["ratios", "per_sample", "per_decision", "packing", "transport", "time_us_per_timestep"]);
    assert_eq!(energy["ratios"].as_array().unwrap().len(), 3);
    assert_eq!(energy["per_sample"].as_array().unwrap().len(), 4);
    // Another network has no published row, but a modelled one.
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "small.ron", MODEL);
    let small =
        object(&["energy", &model, "--input", "scene:noise?samples=1&steps=20", "--baseline", "rtx-2080-ti"], 0);
    assert_eq!(small["rows"][3]["source"], "modelled");
    assert_eq!(object(&["energy", "--baseline", "abacus"], 3)["code"], "baseline.unknown");
    assert_eq!(said(&["energy", "--cpu-watts", "20,5"]).0, 2);
}

#[test]
fn a_chart_and_an_export_are_written() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "small.ron", MODEL);
    let (svg, export) = (folder.path().join("e.svg"), folder.path().join("sanafe"));
    let (svg, export) = (svg.to_str().unwrap(), export.to_str().unwrap());
    let input = "scene:noise?samples=1&steps=20&rate=0.5";
    let line = ["energy", &model, "--input", input, "--copies", "1", "--baseline"];
    let both = [&line[..], &["--svg", svg, "--export-sanafe", export, "--transport", "queued"]].concat();
    let report = object(&both, 0);
    assert_eq!((&report["transport"], &report["rows"].as_array().unwrap().len()), (&"queued".into(), &3));
    let chart = std::fs::read_to_string(svg).unwrap();
    assert!(chart.starts_with("<svg") && chart.contains("x86 busy") && chart.contains("core step"), "{chart}");
    let network = std::fs::read_to_string(Path::new(export).join("snn.yaml")).unwrap();
    assert!(
        network.contains("# run: timesteps=21 leading=1") && network.contains("- c0.0 -> c0.4: [weight: 30.0]"),
        "{network}"
    );
    assert!(
        std::fs::read_to_string(Path::new(export).join("arch.yaml")).unwrap().contains("latency_sync: 600000.0e-12")
    );
    // What is there is not replaced.
    assert_eq!(object(&both, 3)["code"], "write.exists");
}

#[test]
fn what_does_not_fit_is_an_answer() {
    let map = object(&["map", "--target", "tiny", "--copies", "4096"], 1);
    assert_eq!((&map["schema"], &map["fits"]), (&"nsim.map/1".into(), &false.into()));
    has_keys(&map["reasons"][0], &["code", "population", "core", "resource", "need", "limit", "help"]);
    let (code, _, stderr) = said(&["run", "--target", "tiny"]);
    assert_eq!(code, 1);
    assert!(stderr.contains("does not fit"), "{stderr}");
}

#[test]
fn a_slip_is_answered_with_what_was_meant() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "small.ron", MODEL);
    let single = write(folder.path(), "single.ron", &MODEL.replacen("shape: [3]", "shape: 3", 1));
    let unknown = write(folder.path(), "unknown.ron", &MODEL.replacen("from: [\"hidden\"]", "from: [\"hiden\"]", 1));
    let spikes = |name: &str, shape: &str, count: usize| {
        let header = format!("{{'descr': '|u1', 'fortran_order': False, 'shape': {shape}, }}");
        let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
        bytes.extend(format!("{header:<117}\n").bytes().chain(std::iter::repeat_n(0, count)));
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path.display().to_string()
    };
    let (first, samples) = (spikes("first.npy", "(50, 3)", 150), spikes("samples.npy", "(2, 50, 3)", 300));
    for (line, status, answer) in [
        (&["run", "vtsnn-slp"][..], 3, "did you mean 'vtsnn-slip'?"),
        (&["map", "--target", "nahuku32"], 3, "did you mean 'nahuku-32'?"),
        (&["energy", &model, "--constants", "davies2017"], 2, "did you mean 'davies2018'?"),
        (&["run", &unknown], 3, "did you mean 'hidden'?"),
        (&["run", &model, "--input", "inn=x.npy"], 3, "did you mean 'in'?"),
        (&["run", &single], 3, "write [3]"),
        (&["run", &model, "--input", &first], 3, "time before channels"),
        (&["run", &model, "--input", &samples], 3, "time before channels"),
    ] {
        let (code, _, stderr) = said(line);
        assert!(code == status && stderr.contains(answer), "{line:?}: {code} {stderr}");
    }
}

#[test]
fn a_fan_in_beyond_a_core_names_its_population_and_the_ways_out() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(
        folder.path(),
        "both.ron",
        "Network(name: \"both\", timestep_ms: 1.0, populations: [Input(name: \"vision\", shape: [2, 50, 63]),
         Loihi(name: \"sight\", shape: [10], du: 1024, dv: 128, vth_mant: 80)],
         projections: [Dense(from: [\"vision\"], to: \"sight\", weights: Uniform(low: -2, high: 2, step: 2, seed: 1))],
         output: \"sight\")",
    );
    let map = object(&["map", &model], 1);
    let reasons = map["reasons"].as_array().unwrap();
    let axons = reasons.iter().find(|reason| reason["resource"] == "axons_in").unwrap();
    assert_eq!((&axons["population"], &axons["need"], &axons["limit"]), (&"sight".into(), &6300.into(), &4096.into()));
    let help = axons["help"].as_str().unwrap();
    assert!(help.contains("polarit") && help.contains("prune"), "{help}");
}

#[test]
fn independent_errors_of_a_file_are_told_together() {
    let folder = tempfile::tempdir().unwrap();
    let line = |du: u32, second: &str, to: &str, output: &str| {
        format!(
            "Network(name: \"n\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [4]),
             Loihi(name: \"a\", shape: [4], du: {du}, dv: 5001, vth_mant: 130),
             Loihi(name: \"b\", shape: [{second}], du: 1024, dv: 256, vth_mant: 1300000)],
             projections: [Random(from: [\"in\"], to: \"{to}\", fan_out: 2, low: 0, high: 8, seed: 1),
             Random(from: [\"y\"], to: \"a\", fan_out: 2, low: 0, high: 8, seed: 1)], output: \"{output}\")"
        )
    };
    let codes_and_lines = |text: &str| {
        let model = write(folder.path(), "bad.ron", text);
        let error = object(&["map", &model], 3);
        let others = error["others"].as_array().unwrap();
        let (_, _, stderr) = said(&["map", &model]);
        assert_eq!(stderr.matches("error[").count(), 1 + others.len(), "{stderr}");
        std::iter::once(&error)
            .chain(others)
            .map(|one| (one["code"].to_string(), one["line"].to_string()))
            .collect::<Vec<_>>()
    };
    let told = |list: &[(&str, u32)]| -> Vec<(String, String)> {
        list.iter().map(|(code, line)| (format!("\"{code}\""), line.to_string())).collect()
    };
    // A population that cannot be read hides who names it; names that nobody has hide values.
    assert_eq!(codes_and_lines(&line(500, "0", "x", "zz")), told(&[("model.shape", 3)]));
    let unknown = "model.unknown-population";
    assert_eq!(codes_and_lines(&line(500, "2", "x", "zz")), told(&[(unknown, 4), (unknown, 5), (unknown, 5)]));
    let values = line(5000, "2", "a", "b").replace("[\"y\"]", "[\"b\"]");
    let range = "model.range";
    assert_eq!(codes_and_lines(&values), told(&[(range, 2), (range, 2), (range, 3)]));
}

#[test]
fn errors_have_a_status_a_place_and_an_object() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "bad.ron", &MODEL.replace("du: 1024", "du: 5000"));
    let error = object(&["map", &model], 3);
    assert_eq!((&error["schema"], &error["line"]), (&"nsim.error/1".into(), &2.into()));
    has_keys(&error, &["code", "message", "help"]);
    let (code, stdout, stderr) = said(&["map", &model]);
    assert_eq!((code, stdout.as_str()), (3, ""));
    assert!(stderr.contains("bad.ron:2") && stderr.contains("decay 5000"), "{stderr}");

    let usage = object(&["map", "--bogus"], 2);
    assert_eq!((&usage["schema"], &usage["code"]), (&"nsim.error/1".into(), &"usage".into()));
    assert!(usage["message"].as_str().unwrap().contains("--bogus"), "{usage}");
    assert_eq!(said(&["run", "--samples", "5..2"]).0, 2);
    assert_eq!(said(&["run", "--samples", "500000..500001"]).0, 2);
    assert_eq!(said(&["no-such-command"]).0, 2);
    assert_eq!(said(&["run", "--threads", "0"]).0, 2);
    assert_eq!(said(&["bench", "no-such-bench"]).0, 2);
    assert_eq!(said(&["bench", "step", "--network", "random-2m"]).0, 2);
    assert_eq!(said(&["map", "no-such-model"]).0, 3);
    assert_eq!(said(&["run", "--input", "scene:no-such-scene"]).0, 3);
    assert_eq!(said(&["run", "--input", "vision=absent.npy"]).0, 3);
}

#[test]
fn probes_are_written_once_and_replaced_only_by_force() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "small.ron", MODEL);
    let spikes = write(folder.path(), "spikes.csv", "timestep,channel\n0,0\n1,1\n3,2\n3,0\n9,1\n");
    let out = folder.path().join("traces").display().to_string();
    let arguments = ["run", &model, "--input", &spikes, "--probe", "hidden.v", "--probe", "out.spikes", "-o", &out];
    assert_eq!(object(&arguments, 0)["timesteps"], 10);
    let trace = nsim::io::npy::read(&folder.path().join("traces/hidden.v.npy")).unwrap();
    assert_eq!(trace.shape(), [1, 4, 10]);
    // u(0) = 20 * 64 and v(0) = u(0) exceed the threshold of 640 only for compartment 0 and, at 12 * 64, compartment 3.
    assert_eq!([trace.real(0), trace.real(10), trace.real(20), trace.real(30)], [0.0, 128.0, 0.0, 0.0]);
    assert_eq!(said(&arguments).0, 3, "the files exist");
    assert_eq!(said(&[arguments.as_slice(), &["--force"]].concat()).0, 0);
    assert_eq!(said(&["run", &model, "--input", &spikes, "--probe", "in.v", "-o", &out]).0, 2);
}

/// Bytes on stdin are an array or an event list by what they are; a file may have a name like a population's argument.
#[test]
fn spikes_come_through_a_pipe_and_from_oddly_named_files() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "small.ron", MODEL);
    let events = "0,0\n1,1\n3,2\n";
    let mut array = Vec::new();
    nsim::io::npy::write(&mut array, &[3, 4], [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1]).unwrap();
    let piped = |bytes: &[u8]| -> Value {
        let mut command = nsim(&["run", &model, "--input", "-", "--format", "json"]);
        let output = command.write_stdin(bytes).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let (of_events, of_array) = (piped(events.as_bytes()), piped(&array));
    assert_eq!((&of_events["digest"], &of_events["activity"]), (&of_array["digest"], &of_array["activity"]));
    assert_eq!(of_array["activity"]["spikes_in"], 3);
    write(folder.path(), "day=1 it's.csv", events);
    let mut command = nsim(&["run", "small.ron", "--input", "day=1 it's.csv", "--format", "json"]);
    let output = command.current_dir(folder.path()).output().unwrap();
    let odd: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(odd["digest"], of_array["digest"]);
}

#[test]
fn both_classes_occur_over_the_shipped_scene() {
    let run = object(&["run"], 0);
    let classes: Vec<u64> = run["predicted"].as_array().unwrap().iter().filter_map(Value::as_u64).collect();
    assert!(classes.contains(&0) && classes.contains(&1), "{classes:?}");
    let counts = run["output_counts"].as_array().unwrap();
    assert!((0..2).all(|output| counts.iter().any(|sample| sample[output].as_u64() > Some(0))));
}

/// Text for people stands in a terminal of ordinary width.
#[test]
fn text_is_no_wider_than_a_wide_terminal() {
    for arguments in [&["map"][..], &["run"], &["energy"], &["energy", "--deployment", "paper", "--mode", "realtime"]] {
        let (code, stdout, _) = said(arguments);
        assert_eq!(code, 0);
        let widest = stdout.lines().max_by_key(|line| line.chars().count()).unwrap();
        assert!(widest.chars().count() <= 120, "{arguments:?}: {widest}");
    }
}

#[test]
fn a_model_without_a_scenario_has_one_copy_everywhere() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "small.ron", MODEL);
    let energy = ["energy", &model, "--input", "scene:noise?samples=1&steps=20", "--baseline"];
    assert_eq!(object(&["map", &model], 0)["copies"], 1);
    assert_eq!(object(&energy, 0)["copies"], 1);
    let (code, _, stderr) = said(&[&energy[..], &["--deployment", "paper"]].concat());
    assert!(code == 2 && stderr.contains("no scenario ships"), "{stderr}");
    // A scenario of one's own gives its copies and its numbers of cores.
    let own = "Scenario(name: \"s\", model: \"small\", target: \"nahuku-32\", copies: 2, convention: physical, work: \"w\",
        source: \"s\", notes: \"\", deployment: (cores_used: 7, cores_powered: 9, tiles_used: 4, chips_used: 2, x86_cores: 3))";
    let own = write(folder.path(), "own.ron", own);
    let report = object(&[&energy[..], &["--deployment", &own]].concat(), 0);
    assert_eq!((&report["copies"], &report["cores_powered"], &report["x86_cores"]), (&2.into(), &9.into(), &3.into()));
    assert_eq!(object(&["inspect", &own], 0)["kind"], "scenario");
}

#[test]
fn energy_is_of_as_many_copies_as_a_mapping_has() {
    let folder = tempfile::tempdir().unwrap();
    let saved = folder.path().join("mapping.ron").display().to_string();
    assert_eq!(said(&["map", "--copies", "2", "-o", &saved]).0, 0);
    let energy = ["energy", "--samples", "0..1", "--mapping"];
    assert_eq!(object(&[&energy[..], &[&saved]].concat(), 0)["copies"], 2);
    // A pipe can be read but once.
    let piped = nsim(&[&energy[..], &["-", "--format", "json"]].concat()).pipe_stdin(&saved).unwrap().output().unwrap();
    assert_eq!(serde_json::from_slice::<Value>(&piped.stdout).unwrap()["copies"], 2);
    let other = object(&[&energy[..], &[&saved, "--copies", "3"]].concat(), 3);
    assert_eq!((&other["code"], &other["file"]), (&"mapping.copies".into(), &saved.as_str().into()));
    // What a mapping was made with is the file's to say.
    assert_eq!(said(&["map", "--mapping", &saved, "--strategy", "greedy"]).0, 2);
    assert_eq!(said(&["map", "--copies", "2", "--strategy", "greedy", "-o", &saved, "--force"]).0, 0);
    assert_eq!(object(&["map", "--mapping", &saved], 0)["strategy"], "greedy");
}

#[test]
fn map_and_energy_expect_the_same_of_a_mapping_at_the_same_rates() {
    let folder = tempfile::tempdir().unwrap();
    let saved = folder.path().join("mapping.ron").display().to_string();
    let small = write(folder.path(), "small.ron", MODEL);
    let noise = "scene:noise?samples=3&steps=50&seed=4&rate=0.1";
    let jobs =
        [("vtsnn-slip", "scene:noise?samples=2&steps=150&rate=0.02", "32"), (&small, noise, "1"), (&small, noise, "7")];
    for (model, input, copies) in jobs {
        let map = ["map", model, "--copies", copies, "--profile", input];
        let mapped = object(&[&map[..], &["-o", &saved, "--force"]].concat(), 0);
        let loaded = object(&["map", model, "--mapping", &saved, "--profile", input], 0);
        let energy = object(&["energy", model, "--mapping", &saved, "--input", input], 0);
        assert_eq!(energy["copies"], mapped["copies"], "{model}");
        for key in ["energy_uj", "chip_energy_uj", "step_us", "static_mw", "cores", "cores_powered"] {
            let [made, kept, run] = [&mapped, &loaded, &energy].map(|object| &object["expected"][key]);
            assert!(made.as_f64().is_some_and(|figure| figure > 0.0), "{model} {copies} {key}: {made}");
            assert_eq!((made, made), (kept, run), "{model} {copies} {key}");
        }
        assert_eq!(mapped["expected"]["cores_powered"], energy["cores_powered"]);
    }
}

#[test]
fn nothing_is_compared_in_vain() {
    for wrong in [&["--steps", "0"][..], &["--against", "golden", "--svg", "causes.svg"]] {
        let folder = tempfile::tempdir().unwrap();
        let mut command = nsim(&[&["agree", "--samples", "0..1"], wrong].concat());
        assert_eq!(command.current_dir(&folder).output().unwrap().status.code(), Some(2), "{wrong:?}");
        assert!(std::fs::read_dir(&folder).unwrap().next().is_none());
    }
}

#[test]
fn a_saved_mapping_runs_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let saved = folder.path().join("mapping.ron").display().to_string();
    assert_eq!(said(&["map", "-o", &saved]).0, 0);
    let (fresh, kept) =
        (object(&["run", "--samples", "0..3"], 0), object(&["run", "--samples", "0..3", "--mapping", &saved], 0));
    assert_eq!((&fresh["digest"], &fresh["activity"]), (&kept["digest"], &kept["activity"]));
    assert_eq!(object(&["map", "--mapping", &saved], 0)["placed"], "saved");
}

#[test]
fn pruning_changes_no_output_and_says_what_it_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "small.ron", MODEL);
    let spikes = write(folder.path(), "spikes.csv", "timestep,channel\n0,0\n1,0\n3,2\n3,0\n9,2\n");
    let other = write(folder.path(), "other.csv", "# steps: 10\ntimestep,channel\n0,0\n7,1\n");
    let saved = folder.path().join("pruned.ron").display().to_string();
    let row = |object: &Value, kind: &str| {
        let rows = object["pruned"].as_array().unwrap();
        rows.iter().find(|row| row["kind"] == kind).map(|row| row["count"].as_u64().unwrap())
    };

    let none = object(&["map", &model, "--prune", "none"], 0);
    assert_eq!((&none["pruned"], &none["cores"][0]["synapses"]), (&serde_json::json!([]), &20.into()));
    let fixed = object(&["map", &model, "--prune", "static"], 0);
    assert_eq!((row(&fixed, "dead_input"), row(&fixed, "zero_synapse")), (None, Some(4)));
    assert_eq!(fixed["cores"][0]["synapses"], 16);
    has_keys(&fixed["pruned"][0], &["kind", "count", "reason"]);
    let scene = object(&["map", &model, "--prune", &spikes, "-o", &saved], 0);
    assert_eq!(row(&scene, "dead_input"), Some(1));
    let (code, stdout, _) = said(&["map", &model, "--prune", &spikes]);
    assert!(code == 0 && stdout.contains("dead input") && stdout.contains("never fires in"), "{stdout}");

    let whole = object(&["run", &model, "--input", &spikes], 0);
    assert!(whole["activity"]["spikes"].as_u64().unwrap() > 0);
    for more in [
        &["--prune", "static"][..],
        &["--prune", &spikes],
        &["--mapping", &saved],
        &["--prune", &spikes, "--engine", "golden"],
    ] {
        let run = object(&[&["run", &model, "--input", &spikes], more].concat(), 0);
        assert_eq!((&run["digest"], &run["output_counts"]), (&whole["digest"], &whole["output_counts"]), "{more:?}");
        assert!(run["activity"]["synaptic_events"].as_u64() < whole["activity"]["synaptic_events"].as_u64());
    }
    for more in [&["--prune", &spikes][..], &["--mapping", &saved], &["--prune", &spikes, "--engine", "golden"]] {
        let error = object(&[&["run", &model, "--input", &other], more].concat(), 3);
        let message = error["message"].as_str().unwrap();
        assert_eq!(error["code"], "input.pruned");
        for word in ["sample 0", "channel 1 of 'in'", "step 7"] {
            assert!(message.contains(word), "{message}");
        }
    }
    let energy = ["energy", &model, "--copies", "2", "--prune", &spikes, "--input"];
    assert_eq!(object(&[&energy[..], &[&spikes]].concat(), 0)["schema"], "nsim.energy/1");
    assert_eq!(object(&[&energy[..], &[&other]].concat(), 3)["code"], "input.pruned");
    assert_eq!(said(&["run", &model, "--mapping", &saved, "--prune", "static"]).0, 2);
    assert_eq!(said(&["map", &model, "--prune", "static", "--prune", &spikes]).0, 2);
    assert_eq!(said(&["map", &model, "--prune", "no-such-file.npy"]).0, 3);
}

#[test]
fn what_is_probed_is_not_pruned_and_what_is_pruned_not_probed() {
    let folder = tempfile::tempdir().unwrap();
    // Compartment 1 of hidden only reaches out over a weight of 0.
    let model = write(folder.path(), "small.ron", &MODEL.replace("[0, 40, -10, 8]", "[0, 0, -10, 8]"));
    let spikes = write(folder.path(), "spikes.csv", "timestep,channel\n0,0\n1,1\n3,2\n3,0\n9,1\n");
    let saved = folder.path().join("pruned.ron").display().to_string();
    let out = |name: &str| folder.path().join(name).display().to_string();
    let arguments = ["run", &model, "--input", &spikes, "--probe", "hidden.v", "-o"];
    object(&[&arguments[..], &[&out("whole")]].concat(), 0);
    object(&[&arguments[..], &[&out("pruned"), "--prune", "static"]].concat(), 0);
    let bytes = |name: &str| std::fs::read(folder.path().join(name).join("hidden.v.npy")).unwrap();
    assert_eq!(bytes("whole"), bytes("pruned"));
    let map = object(&["map", &model, "--prune", "static", "-o", &saved], 0);
    let unreachable = &map["pruned"].as_array().unwrap()[2];
    assert_eq!((&unreachable["kind"], &unreachable["count"]), (&"unreachable_compartment".into(), &1.into()));
    let refused = object(&[&arguments[..], &[&out("refused"), "--mapping", &saved]].concat(), 3);
    assert!(refused["message"].as_str().unwrap().contains("'hidden'"));
    let kept = ["run", &model, "--input", &spikes, "--mapping", &saved, "--probe", "out.u", "-o", &out("kept")];
    assert_eq!(said(&kept).0, 0);
    assert_eq!(object(&["inspect", &saved], 0)["pruned"], "static");
}

#[test]
fn threads_skipping_and_engines_change_no_result() {
    let of = |more: &[&str]| object(&[&["run", "container-tactile", "--samples", "0..4"], more].concat(), 0);
    let one = of(&["--threads", "1"]);
    assert!(one["activity"]["spikes"].as_u64().unwrap() > 0);
    for more in [&["--threads", "2"][..], &["--threads", "8"], &["--skip", "off"]] {
        let other = of(more);
        assert_eq!(
            (&one["digest"], &one["activity"], &one["output_counts"]),
            (&other["digest"], &other["activity"], &other["output_counts"])
        );
    }
    let golden = of(&["--engine", "golden"]);
    assert_eq!(one["digest"], golden["digest"]);
    for key in ["spikes_in", "spikes", "synaptic_events", "compartment_updates", "active_updates"] {
        assert_eq!(one["activity"][key], golden["activity"][key], "{key}");
    }
}

#[test]
fn repeats_count_and_remember_nothing() {
    let run = object(&["run", "--samples", "0..2", "--repeat", "3"], 0);
    let once = object(&["run", "--samples", "0..2"], 0);
    assert_eq!((&run["samples"], &run["timesteps"]), (&6.into(), &900.into()));
    let counts = |run: &Value| run["output_counts"].as_array().unwrap().clone();
    assert_eq!(counts(&run)[2..4], counts(&once)[..]);
    assert_eq!(run["activity"]["spikes"].as_u64(), once["activity"]["spikes"].as_u64().map(|spikes| 3 * spikes));
}

#[test]
fn a_seed_makes_another_scene_and_is_told() {
    let (one, two) =
        (object(&["run", "--samples", "0..1"], 0), object(&["run", "--samples", "0..1", "--seed", "2"], 0));
    assert_ne!(one["activity"]["spikes_in"], two["activity"]["spikes_in"]);
    assert_eq!(two["seed"], 2);
}

#[test]
fn an_overflow_is_warned_of_with_its_first_place() {
    let folder = tempfile::tempdir().unwrap();
    let text = MODEL.replace("[[20, 0, 4]", "[[254, 0, 4]").replace(
        "projections: [Dense(from: [\"in\"], to: \"hidden\",",
        "projections: [Dense(from: [\"in\"], to: \"hidden\", weight_exp: 7,",
    );
    let model = write(folder.path(), "loud.ron", &text);
    let spikes = write(folder.path(), "spikes.csv", "timestep,channel\n2,0\n2,1\n2,2\n");
    let arguments = ["run", &model, "--input", &spikes];
    let run = object(&arguments, 0);
    assert_eq!(
        run["overflow"]["first"],
        serde_json::json!({"population": "hidden", "compartment": 0, "sample": 0, "step": 2})
    );
    assert!(said(&arguments).2.contains("first at compartment 0, sample 0, step 2"));
}

#[test]
fn folds_of_a_data_set_are_sources() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "m.ron", MODEL);
    for sample in 0..3 {
        write(folder.path(), &format!("{sample}.csv"), &format!("# steps: 5\n0,{sample}\n1,0\n"));
    }
    let samples: String = (0..3).map(|i| format!("(files: {{\"in\": \"{i}.csv\"}}),")).collect();
    let lists = "splits: [(train: \"train_80_20_1.txt\", test: \"test_80_20_1.txt\")]";
    let set = format!("DataSet(name: \"d\", populations: {{\"in\": \"in\"}}, samples: [{samples}], {lists})");
    let set = write(folder.path(), "d.ron", &set);
    write(folder.path(), "train_80_20_1.txt", "2 1\n0 0\n");
    write(folder.path(), "test_80_20_1.txt", "1 1\n");
    let labels = |part: &str| object(&["run", &model, "--input", &format!("{set}{part}")], 0)["labels"].clone();
    assert_eq!(labels("?train=1"), serde_json::json!([1, 0]));
    assert_eq!(labels("?test=1"), serde_json::json!([1]));
    assert_eq!(labels(""), serde_json::json!([0, 1, 1]));
    for part in ["?test=2", "?test=0", "?fold=1"] {
        let error = object(&["run", &model, "--input", &format!("{set}{part}")], 3);
        assert_eq!(error["code"], "input.option", "{part}");
    }
    write(folder.path(), "test_80_20_1.txt", "1 1\n2 0\n");
    let (code, _, stderr) = said(&["run", &model, "--input", &format!("{set}?test=1")]);
    assert!(code == 3 && stderr.contains("test_80_20_1.txt:2:1") && stderr.contains("trained on"), "{stderr}");
}
#[test]
fn every_shipped_model_maps_and_runs() {
    // The names that scripts rely on.
    let names = [
        "vtsnn-slip",
        "vtsnn-slip-srm",
        "slip-tactile",
        "slip-vision",
        "vtsnn-container",
        "container-tactile",
        "container-tactile-srm",
    ];
    let mut shipped: Vec<&str> = nsim::io::shipped::MODELS.iter().map(|model| model.name).collect();
    shipped.sort_unstable();
    assert_eq!(shipped, {
        let mut names = names;
        names.sort_unstable();
        names
    });
    for name in names {
        let map = object(&["map", name], 0);
        assert_eq!(map["model"], name);
        // A converted spike response network has a copy of its synapses for each delay.
        let cores = map["cores_per_copy"].as_f64().unwrap();
        assert!(cores == 1.0 || name.ends_with("-srm") && cores > 1.0, "{name}: {cores}");
        let run = object(&["run", name, "--samples", "0..2"], 0);
        let steps = if name.contains("slip") { 300 } else { 650 };
        assert_eq!((&run["model"], &run["timesteps"]), (&name.into(), &steps.into()));
        let spikes: u64 = run["output_counts"]
            .as_array()
            .unwrap()
            .iter()
            .flat_map(|counts| counts.as_array().unwrap())
            .map(|count| count.as_u64().unwrap())
            .sum();
        assert!(spikes > 0, "{name} is silent");
    }
}

#[test]
fn a_scene_is_drawn_with_its_onset() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("slip.svg");
    let name = path.display().to_string();
    let scene = object(&["scene", "slip", "--samples", "4", "--plot", &name], 0);
    assert_eq!(scene["samples"], 4);
    let svg = std::fs::read_to_string(&path).unwrap();
    // The first sample with an onset is one that slips.
    assert!(svg.starts_with("<svg") && svg.contains("onset ") && svg.contains(": slip<"));
    assert_eq!(said(&["scene", "slip", "--samples", "4", "--plot", &name]).0, 3);
    assert_eq!(said(&["scene", "slip", "--samples", "4", "--plot", &name, "--force", "--plot-sample", "4"]).0, 2);
}

/// Files of other tools, as they wrote them: the corpus that is damaged elsewhere.
#[test]
fn what_other_tools_wrote_is_inspected() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus");
    let folder = tempfile::tempdir().unwrap();
    let inspected = |from: &str, skip: usize, name: &str, status: i32| {
        let bytes = std::fs::read(corpus.join(from)).unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, &bytes[skip..]).unwrap();
        object(&["inspect", path.to_str().unwrap()], status)
    };
    let arrays = |found: &Value| -> Vec<String> {
        let rows = found["arrays"].as_array().unwrap();
        rows.iter().map(|row| row["name"].as_str().unwrap().to_string()).collect()
    };
    let net = inspected("hdf5/netx_every_layer", 0, "a.net", 0);
    assert_eq!(net["kind"], "netx network");
    assert!(arrays(&net).iter().any(|name| name == "layer/1/neuron/vThMant"), "{net}");
    assert!(net["import"].as_str().unwrap().starts_with("as it is: "), "{net}");
    // What cannot be imported can be looked at, and says why.
    let alif = inspected("hdf5/netx_alif", 0, "alif.net", 0);
    assert!(alif["import"].as_str().unwrap().contains("ALIF"), "{alif}");
    let nir = inspected("hdf5/nir_recurrent", 0, "a.nir", 0);
    assert_eq!(nir["kind"], "nir network");
    assert_eq!(inspected("hdf5/nir_events", 0, "events.nir", 0)["kind"], "nir recording");
    assert_eq!(inspected("hdf5/no_network", 0, "other.h5", 0)["kind"], "hdf5");
    let torch = inspected("checkpoint/zip", 0, "a.pt", 0);
    assert_eq!(torch["kind"], "torch checkpoint");
    assert!(torch["arrays"].as_array().unwrap().iter().all(|row| row["shape"].is_array()), "{torch}");
    inspected("checkpoint/module", 0, "module.pt", 3);

    let text = std::fs::read_to_string(corpus.join("../events.csv")).unwrap();
    let times: Vec<i64> = text.lines().skip(1).map(|line| line.split(',').next().unwrap().parse().unwrap()).collect();
    for (from, name) in [("events/aedat4_lz4", "a.aedat4"), ("events/evt3", "a.raw"), ("events/dat", "a.dat")] {
        let recording = inspected(from, 1, name, 0);
        assert_eq!((&recording["kind"], &recording["events"]), (&"recording".into(), &times.len().into()), "{name}");
        assert_eq!(recording["last_us"], *times.iter().max().unwrap(), "{name}");
        assert_eq!(recording["sensor_columns_rows"], serde_json::json!([16, 16]), "{name}");
    }
}

/// Eight thousand million synapses, said in a line: no program is begun that memory would not hold.
#[test]
fn a_network_too_large_for_a_program_is_refused_where_it_is_needed() {
    let folder = tempfile::tempdir().unwrap();
    let model = "Network(name: \"wide\", timestep_ms: 1.0,
        populations: [
            Input(name: \"in\", shape: [1, 600, 600]),
            Loihi(name: \"out\", shape: [1, 301, 301], du: 1, dv: 1, vth_mant: 1),
        ],
        projections: [SumPool2d(from: [\"in\"], to: \"out\", kernel: (300, 300), stride: (1, 1), weight: 1)],
        output: \"out\",
    )";
    let model = write(folder.path(), "wide.ron", model);
    let (status, _, stderr) = said(&["run", &model, "--engine", "fast"]);
    assert_eq!(status, 3, "{stderr}");
    assert!(stderr.contains("written out: 8154090000 synapses,") && stderr.contains("map.described"), "{stderr}");
}

/// A target and its chip may have one name, each in its folder.
#[test]
fn a_target_that_is_named_as_its_chip_finds_it() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("mapping/targets");
    for entry in std::fs::read_dir(root).unwrap() {
        let path = entry.unwrap().path();
        assert_eq!(object(&["inspect", path.to_str().unwrap()], 0)["kind"], "target", "{}", path.display());
    }
}

/// A pooling of 264,196 compartments with 1,024 synapses each: more synapses than are written out.
const TOO_LARGE: &str = "Network(name: \"large\", timestep_ms: 1.0,
  populations: [Input(name: \"in\", shape: [4, 288, 288]),
    Loihi(name: \"out\", shape: [4, 257, 257], du: 1024, dv: 128, vth_mant: 10)],
  projections: [SumPool2d(from: [\"in\"], to: \"out\", kernel: (32, 32), stride: (1, 1), weight: 8)],
  output: \"out\")";

#[test]
fn a_network_too_large_to_write_out_is_mapped_kept_and_run_and_refused_elsewhere() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "large.ron", TOO_LARGE);
    let at = |name: &str| folder.path().join(name).display().to_string();
    let (kept, again, front) = (at("kept.ron"), at("again.ron"), at("front.svg"));
    let map = |options: &[&str], status| {
        let asked = ["map", &model, "--target", "pohoiki-springs", "--time-budget", "0"];
        object(&[&asked, options].concat(), status)
    };
    let made = map(&["-o", &kept, "--pareto", &front], 0);
    assert_eq!((&made["described"], &made["checked"]), (&Value::Bool(true), &Value::Bool(true)));
    assert_eq!(made["checked_how"], "sampled");
    assert!((0.0..0.5).contains(&made["checked_share"].as_f64().unwrap()), "{made}");
    assert!(!made["pareto"].as_array().unwrap().is_empty());
    assert!(std::fs::read_to_string(&front).unwrap().contains("<svg"));
    let same = map(&["--mapping", &kept, "-o", &again], 0);
    assert_eq!((&same["placed"], &same["cores"]), (&Value::from("saved"), &made["cores"]));
    assert_eq!((&same["traffic"], &same["expected"]), (&made["traffic"], &made["expected"]));
    let text = std::fs::read_to_string(&kept).unwrap();
    assert_eq!(text, std::fs::read_to_string(&again).unwrap());
    assert!(text.lines().count() < 100 && text.len() < 100_000, "{} bytes", text.len());
    let found = object(&["inspect", &kept], 0);
    assert_eq!(found["cores_used"], made["cores_used"]);
    let other = write(folder.path(), "other.ron", &text.replacen("population: \"out\"", "population: \"in\"", 1));
    assert_eq!(map(&["--mapping", &other], 3)["code"], "mapping.population");
    // What needs every synapse is refused before anything is made of them.
    let refused = |arguments: &[&str]| {
        let (code, stdout, stderr) = said(&[arguments, &["--format", "json"]].concat());
        assert_eq!(code, 3, "{arguments:?}: {stdout}{stderr}");
        let text = stdout + &stderr;
        assert!(text.contains("map.described") && text.contains("--engine reference"), "{arguments:?}: {text}");
    };
    let board = ["--target", "pohoiki-springs"];
    let with_mapping = ["--target", "pohoiki-springs", "--mapping", &kept];
    let scene = ["--input", "scene:noise?samples=1&steps=12&rate=0.001"];
    let ran = object(&[&["run", &model][..], &board, &scene].concat(), 0);
    let [one, two] = ["1", "2"]
        .map(|threads| object(&[&["run", &model, "--threads", threads][..], &with_mapping, &scene].concat(), 0));
    assert_eq!((&one["digest"], &one["activity"]), (&two["digest"], &two["activity"]));
    // Other places change hops, nothing else.
    assert_eq!((&ran["digest"], &ran["activity"]["messages"]), (&one["digest"], &one["activity"]["messages"]));
    assert!(ran["activity"]["spikes"].as_u64().unwrap() > 1_000, "{ran}");
    let energy = object(&[&["energy", &model][..], &board, &scene].concat(), 0);
    let total = energy["rows"].as_array().unwrap().iter().find(|row| row["unit"] == "total").unwrap();
    assert!(total["energy_uj"].as_f64().unwrap() > 0.0, "{total}");
    refused(&["run", &model, "--engine", "golden"]);
    refused(&["run", &model, "--engine", "golden", "--prune", "static"]);
    refused(&[&["map", &model, "--prune", "static"][..], &board].concat());
    refused(&[&["map", &model, "--profile", "scene"][..], &board].concat());
    refused(&["bench", "pareto", &model]);
    refused(&["agree", &model]);
}
