//! Output and pictures of commands.

use std::path::Path;

use serde_json::Value;

use crate::{MODEL, SRM, has_keys, object, said, write};

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
    has_keys(&energy, &["model", "target", "copies", "deployment", "mode", "convention", "seed", "rows", "job"]);
    has_keys(&energy, &["cores_used", "breakdown_pj_per_timestep", "per_timestep_uj", "early_exit", "constants"]);
    let keys = ["synapse", "dendrite", "compartment", "spike", "axon_out", "axon_in", "hop", "learning"];
    has_keys(&energy["breakdown_pj_per_timestep"], &keys);
    has_keys(&energy["per_timestep_uj"], &["min", "p50", "p99", "max"]);
    has_keys(&energy["rows"][0], &["hardware", "unit", "static_mw", "dynamic_mw", "total_mw", "latency_us"]);
    has_keys(&energy["rows"][0], &["energy_uj", "edp_pjs", "low", "high"]);

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
  projections: [Dense(from: [\"in\"], to: \"hid\", weights: [[20, 20, 20, 20], [2, 2, 2, 2], [4, 6, 8, 10]]),
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
    // The population fires at the threshold that the warning names, and not at the next one.
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
    // Cores of both copies: the breakdown of one, without hops.
    let of_cores: f64 =
        energy["cores"].as_array().unwrap().iter().map(|core| core["energy_pj"].as_f64().unwrap()).sum();
    let parts = energy["breakdown_pj_per_timestep"].as_object().unwrap().iter().filter(|(name, _)| *name != "hop");
    let of_parts: f64 = parts.map(|(_, part)| part.as_f64().unwrap()).sum();
    let expected = 2.0 * of_parts * energy["timesteps"].as_f64().unwrap();
    assert!((of_cores / expected - 1.0).abs() < 1e-9, "{of_cores} pJ by core, {expected} pJ by part");
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
    // The array of the input's spikes has as many spikes as the run counted.
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
fn the_answer_fits_a_screen_and_can_be_put_into_a_paper() {
    let energy =
        |more: &[&str]| said(&[&["energy", "--samples", "0..1", "--copies", "1", "--baseline"], more].concat()).1;
    let text = energy(&[]);
    assert!(text.lines().count() <= 24 && text.lines().all(|line| line.chars().count() <= 80), "{text}");
    assert!(energy(&["--full"]).lines().count() > 20);
    let table = energy(&["--format", "markdown"]);
    assert!(table.starts_with("| Hardware | Static (mW) |") && table.lines().count() == 13, "{table}");
    let table = energy(&["--format", "latex"]);
    assert!(
        table.contains("\\begin{tabular}{l") && table.contains("Loihi & ") && table.contains("\\textmu{}J"),
        "{table}"
    );
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
    let board = object(&["energy", "--samples", "0..1", "--copies", "1", "--baseline", "--accounting", "rails"], 0);
    let units: Vec<&str> = board["rows"].as_array().unwrap().iter().map(|row| row["unit"].as_str().unwrap()).collect();
    assert_eq!((board["accounting"].as_str(), units), (Some("rails"), vec!["boot", "idle", "x86", "total"]));
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
    assert!(chart.starts_with("<svg") && chart.contains("energy (uJ)") && chart.contains("loihi"), "{chart}");
    let network = std::fs::read_to_string(Path::new(export).join("snn.yaml")).unwrap();
    assert!(
        network.contains("# run: timesteps=21 leading=1") && network.contains("- c0.0 -> c0.4: [weight: 30.0]"),
        "{network}"
    );
    assert!(
        std::fs::read_to_string(Path::new(export).join("arch.yaml")).unwrap().contains("latency_sync: 600000.0e-12")
    );
    // Existing files are not replaced.
    assert_eq!(object(&both, 3)["code"], "write.exists");
}

#[test]
fn probes_are_written_once_and_replaced_only_by_force() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "small.ron", MODEL);
    let spikes = write(folder.path(), "spikes.csv", "timestep,channel\n0,0\n1,1\n3,2\n3,0\n9,1\n");
    let out = folder.path().join("traces").display().to_string();
    let arguments = ["run", &model, "--input", &spikes, "--probe", "hidden.v", "--probe", "out.spikes", "-o", &out];
    assert_eq!(object(&arguments, 0)["timesteps"], 10);
    let trace = nsim::files::npy::read(&folder.path().join("traces/hidden.v.npy")).unwrap();
    assert_eq!(trace.shape(), [1, 4, 10]);
    // u(0) = 20 * 64 and v(0) = u(0) exceed the threshold of 640 only for compartment 0 and, at
    // 12 * 64, compartment 3.
    assert_eq!([trace.real(0), trace.real(10), trace.real(20), trace.real(30)], [0.0, 128.0, 0.0, 0.0]);
    assert_eq!(said(&arguments).0, 3, "the files exist");
    assert_eq!(said(&[arguments.as_slice(), &["--force"]].concat()).0, 0);
    assert_eq!(said(&["run", &model, "--input", &spikes, "--probe", "in.v", "-o", &out]).0, 2);
}

/// Text fits a terminal of ordinary width.
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
fn a_scene_is_drawn_with_its_onset() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("slip.svg");
    let name = path.display().to_string();
    let scene = object(&["scene", "slip", "--samples", "4", "--plot", &name], 0);
    assert_eq!(scene["samples"], 4);
    let svg = std::fs::read_to_string(&path).unwrap();
    // The first sample with an onset slips.
    assert!(svg.starts_with("<svg") && svg.contains("onset ") && svg.contains(": slip<"));
    assert_eq!(said(&["scene", "slip", "--samples", "4", "--plot", &name]).0, 3);
    assert_eq!(said(&["scene", "slip", "--samples", "4", "--plot", &name, "--force", "--plot-sample", "4"]).0, 2);
}

/// Unchanged files of other tools: the corpus that other tests damage.
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
    // Its layer without a neuron never spikes, and a layer follows it.
    let summary = net["import"].as_str().unwrap();
    assert!(summary.starts_with("not as it is: ") && summary.contains("'layer6'"), "{net}");
    // A file that cannot be imported can be inspected, with the reason.
    let alif = inspected("hdf5/netx_alif", 0, "alif.net", 0);
    assert!(alif["import"].as_str().unwrap().contains("thDecay"), "{alif}");
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
