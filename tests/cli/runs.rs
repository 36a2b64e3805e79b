//! `nsim run`: sources of spikes, settings that change nothing, seeds.

use serde_json::{Value, json};

use crate::{MODEL, nsim, object, said, write};

/// Bytes on stdin are recognised by content as an array or an event list. The name of a file may
/// look like a population's argument.
#[test]
fn spikes_come_through_a_pipe_and_from_oddly_named_files() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "small.ron", MODEL);
    let events = "0,0\n1,1\n3,2\n";
    let mut array = Vec::new();
    nsim::files::npy::write(&mut array, &[3, 4], [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1]).unwrap();
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
    // Refused before any result is allocated.
    let (_, _, error) = said(&["run", "--samples", "0..5", "--repeat", "1000000"]);
    assert!(error.contains("5000000 runs, more than 4194304"), "{error}");
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
fn a_clock_goes_beside_recordings() {
    let folder = tempfile::tempdir().unwrap();
    let text = MODEL
        .replace(
            "Input(name: \"in\", shape: [3]),",
            "Input(name: \"in\", shape: [3]), Input(name: \"phase\", shape: \
                                                      [2]),",
        )
        .replace(
            "    Dense(from: [\"hidden\"]",
            "    Dense(from: [\"phase\"], to: \"hidden\", weights: [[8, 2], [0, \
                                                  4], [6, 0], [2, 2]]), Dense(from: [\"hidden\"]",
        );
    let model = write(folder.path(), "m.ron", &text);
    let spikes = write(folder.path(), "touch.csv", "# steps: 7\n0,0\n2,1\n5,2\n");
    let clock = write(folder.path(), "clock.csv", "# steps: 7\n0,0\n1,0\n2,0\n3,1\n4,1\n5,1\n6,1\n");
    let touch = format!("in={spikes}");
    let with = |phase: &str| object(&["run", &model, "--input", &touch, "--input", &format!("phase={phase}")], 0);
    let (made, read) = (with("scene:clock?span=3"), with(&clock));
    assert_eq!((&made["digest"], &made["activity"]), (&read["digest"], &read["activity"]));
    assert_eq!(made["activity"]["spikes_in"], 10);
    for (arguments, message) in [
        (&["--input", "scene:clock"][..], "a clock is combined with recordings"),
        (&["--input", "phase=scene:clock?span=0", "--input", &touch], "is not within 1..=100000"),
        (&["--input", "phase=scene:noise", "--input", &touch], "allows no other input"),
        (&["--input", "phase=scene:clock", "--input", "in=scene:clock"], "which give the length of a sample"),
    ] {
        let (code, _, stderr) = said(&[&["run", &model], arguments].concat());
        assert!(code != 0 && stderr.contains(message), "{arguments:?}: {code}, {stderr}");
    }
}

#[test]
fn a_network_of_values_decides_no_class() {
    let folder = tempfile::tempdir().unwrap();
    let model = |classes: &str| {
        write(
            folder.path(),
            "values.ron",
            &format!(
                "Network(name: \"values\", timestep_ms: 1.0, target: \"oheo-gulch\", populations: [Input(name: \"in\", \
                 shape: [1], message_bits: 8), SigmaDelta(name: \"out\", shape: [2], vth_mant: 3, bias_mant: 0)], \
                 projections: [Dense(from: [\"in\"], to: \"out\", weights: [[2], [4]])], output: \"out\"{classes})"
            ),
        )
    };
    let values = model("");
    let noise = ["--input", "scene:noise?samples=2&steps=20&rate=0.5"];
    let run = object(&[&["run", &values], &noise[..]].concat(), 0);
    assert_eq!((&run["predicted"], &run["undecided"]), (&json!([null, null]), &json!(0)));
    let (_, text, _) = said(&[&["run", &values], &noise[..]].concat());
    assert!(text.contains("'out' sends values: --probe out -o FOLDER") && !text.contains("undecided"), "{text}");
    assert_eq!(object(&[&["energy", &values, "--baseline"], &noise[..]].concat(), 0)["per_decision"], Value::Null);
    for command in ["run", "energy"] {
        let early = [&[command, &values, "--early-exit", "1"], &noise[..]].concat();
        assert_eq!(object(&early, 3)["code"], "run.early-exit");
    }
    // Scenes that a model lacks are no rates.
    assert_eq!(object(&["map", &values, "--profile", "scene"], 3)["code"], "map.profile");
    let classes = model(", classes: [\"a\", \"b\"]");
    assert_ne!(object(&[&["run", &classes], &noise[..]].concat(), 0)["predicted"], json!([null, null]));
}
