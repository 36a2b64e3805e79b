//! `nsim map`: networks that fit or do not, stored and pruned mappings.

use std::path::Path;

use serde_json::Value;

use nsim::compile::{Options, compile};
use nsim::files::target::load_target;
use nsim::ir::base::diagnostic::SourceText;
use nsim::ir::partition::Partition;
use nsim::ir::placement::Placement;
use nsim::ir::program::Program;
use nsim::ir::quantised::Quantised;
use nsim::ir::spanned::parse;

use crate::{MODEL, has_keys, nsim, object, said, succeeds, write};

#[test]
fn what_does_not_fit_is_answered_with_the_command_s_own_object() {
    for (command, keys) in [
        ("map", &["reasons", "remedies"][..]),
        ("run", &["samples", "digest", "activity", "wall_s"]),
        ("energy", &["rows", "cores_used", "breakdown_pj_per_timestep", "constants"]),
    ] {
        let line = [command, "--target", "tiny"];
        let object = object(&line, 1);
        assert_eq!((&object["schema"], &object["fits"]), (&format!("nsim.{command}/1").into(), &false.into()));
        has_keys(&object, keys);
        has_keys(&object["reasons"][0], &["code", "population", "core", "resource", "need", "limit", "help"]);
        assert_eq!((&object["model"], &object["target"]), (&"vtsnn-slip".into(), &"tiny".into()));
        let (code, _, stderr) = said(&line);
        assert!(code == 1 && (command == "map" || stderr.contains("does not fit")), "{command}: {stderr}");
    }
}

/// A user's chip and constants: stated values, inherited ones with their file, and typed ones.
#[test]
fn each_constant_and_limit_names_the_file_that_states_it() {
    let folder = tempfile::tempdir().unwrap();
    let constant = "(value: 2.0, unit: pJ, source: \"mine\", status: assumed)";
    let first = format!("Constants(base: \"loihi1-evidence\", name: \"first\", hop_ew_energy: {constant})");
    write(folder.path(), "first.ron", &first);
    let second = format!("Constants(base: \"first\", name: \"second\", spike_energy: {constant})");
    let second = write(folder.path(), "second.ron", &second);
    let chip = "Target(base: \"loihi1-chip\", limits: (axons_out: 8192))";
    let chip = write(folder.path(), "chip.ron", chip);
    let from = |line: &[&str], table: &str, key: &str, name: &str| {
        let found = object(&[&["inspect"], line].concat(), 0);
        let rows = found[table].as_array().unwrap();
        rows.iter().find(|row| row[key] == name).unwrap()["from"].as_str().unwrap().to_string()
    };
    let of_constant = |name: &str| from(&[&second], "constants", "name", name);
    assert_eq!(
        ["spike_energy", "hop_ew_energy", "turn_time", "barrier, 1 tiles"].map(of_constant),
        ["here", "first", "loihi1-evidence", "loihi1-evidence"]
    );
    let of_limit = |name: &str| from(&[&chip], "limits", "limit", name);
    assert_eq!(["axons_out", "axons_in"].map(of_limit), ["here", "loihi1"]);
    assert_eq!(from(&["loihi1-chip"], "limits", "limit", "axons_in"), "loihi1");
}

#[test]
fn a_file_is_shown_by_its_path() {
    let folder = tempfile::tempdir().unwrap();
    let path = write(folder.path(), "tiny.ron", MODEL);
    assert_eq!(said(&["show", &path]), (0, MODEL.to_string(), String::new()));
    assert_eq!(said(&["show", "./none.ron"]).0, 2);
}

#[test]
fn stages_of_the_compiler_are_shown_as_text_that_reads_back() {
    let shown = |stage: &str| {
        let stdout = succeeds(&["show", "vtsnn-slip", "--as", stage, "--target", "loihi1-chip"]);
        SourceText::new("stage.ron", stdout)
    };
    let network: Quantised = parse(&shown("quantised"), "stage").unwrap();
    let partition: Partition = parse(&shown("partition"), "stage").unwrap();
    let placement: Placement = parse(&shown("placement"), "stage").unwrap();
    let program: Program = parse(&shown("program"), "stage").unwrap();
    let compiled = compile(network, &load_target("loihi1-chip").unwrap(), &Options::default()).unwrap();
    assert!((partition, placement, program.into()) == (compiled.partition, compiled.placement, compiled.program));
    // More copies leave the tables of classes unchanged; cores and their compartments grow.
    let classes = |copies: &str| {
        let line = ["show", "vtsnn-slip", "--as", "program", "--target", "pohoiki-springs", "--copies", copies];
        let (_, text, _) = said(&line);
        let begin = text.find("classes: [").unwrap_or_else(|| panic!("{copies}"));
        let end = text[begin..].find("cores: [").unwrap();
        (text[begin..begin + end].to_string(), text.len())
    };
    let (few, many) = (classes("32"), classes("1024"));
    assert!(few.0 == many.0 && few.0.len() > 100_000 && many.1 > few.1, "{} {}", few.0.len(), many.0.len());
    let refused = object(&["show", "vtsnn-slip", "--as", "program", "--target", "tiny"], 1);
    assert_eq!((&refused["schema"], &refused["fits"]), (&"nsim.show/1".into(), &false.into()));
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
    let wide = nsim(&["map", &model, "--prune", &spikes]).env("COLUMNS", "400").output().unwrap();
    let stdout = String::from_utf8(wide.stdout).unwrap();
    assert!(wide.status.success() && stdout.contains("dead input") && stdout.contains("never fires in"), "{stdout}");

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
    // The only outgoing weight of compartment 1 of hidden is 0.
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
fn every_shipped_model_maps_and_runs() {
    // Names that scripts rely on.
    let names = "vtsnn-slip vtsnn-slip-srm slip-tactile slip-vision vtsnn-container container-tactile \
                 container-tactile-clock container-tactile-srm slip-tactile-rf slip-tactile-sdnn";
    // Models that learn, and the steps of their first sample.
    let plastic = [("cartpole", 2_000), ("container-few-shot", 326), ("pes-channel", 2_000), ("stdp-pattern", 20_000)];
    // A network of the first fold of each cell of the paper's tables.
    let cells =
        ["slip", "container"].into_iter().flat_map(|task| ["tactile", "vision", "both"].map(|senses| (task, senses)));
    let of_paper =
        cells.flat_map(|(task, senses)| ["count", "weighted"].map(|loss| format!("paper-{task}-{senses}-{loss}")));
    let names: Vec<String> =
        names.split(' ').chain(plastic.map(|(name, _)| name)).map(String::from).chain(of_paper).collect();
    let mut shipped: Vec<&str> = nsim::files::shipped::MODELS.iter().map(|model| model.name).collect();
    shipped.sort_unstable();
    assert_eq!(shipped, {
        let mut names: Vec<&str> = names.iter().map(String::as_str).collect();
        names.sort_unstable();
        names
    });
    for name in &names {
        let map = object(&["map", name], 0);
        assert_eq!(map["model"], name.as_str());
        // A converted spike response network has a copy of its synapses for each delay.
        let cores = map["cores_per_copy"].as_f64().unwrap();
        let several = name.ends_with("-srm") || name.starts_with("paper-");
        assert!(cores == 1.0 || several && cores > 1.0, "{name}: {cores}");
        let learns = plastic.iter().find(|(plastic, _)| plastic == name);
        let run = object(&["run", name, "--samples", if learns.is_some() { "0..1" } else { "0..2" }], 0);
        let steps = learns.map_or(if name.contains("slip") { 300 } else { 650 }, |&(_, steps)| steps);
        assert_eq!(run["learning"].is_array(), learns.is_some(), "{name}");
        assert_eq!((&run["model"], &run["timesteps"]), (&name.as_str().into(), &steps.into()));
        let spikes: u64 = run["output_counts"]
            .as_array()
            .unwrap()
            .iter()
            .flat_map(|counts| counts.as_array().unwrap())
            .map(|count| count.as_u64().unwrap())
            .sum();
        // The outputs of these are read by their potentials.
        let by_potential = ["container-few-shot", "slip-tactile-rf"].contains(&name.as_str());
        assert_eq!(spikes > 0, !by_potential, "{name}: {spikes} spikes");
    }
}

/// Eight thousand million synapses in one line: no program beyond the memory is begun.
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
    assert!(
        stderr.contains("needs a program of wide: 8154090000 synapses,") && stderr.contains("map.described"),
        "{stderr}"
    );
}

/// A target and its chip may have one name, each in its own folder.
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
    assert_eq!((&made["checked_how"], &made["checked_share"]), (&Value::from("classes"), &Value::from(1.0)));
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
    // A command that needs every synapse is refused before it allocates.
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
    // Other places change only hops.
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
