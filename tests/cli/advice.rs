//! Advice works: each remedy is typed, and the command then succeeds.

use std::path::Path;

use nsim::import::hdf5;
use nsim::import::hdf5::{Group, Item, Numbers};
use serde_json::Value;

use crate::common::command;
use crate::{MODEL, SRM, nsim, object, said, succeeds, write};

/// A NIR file whose neurons imply no timestep.
fn nir(folder: &Path) -> String {
    nir_with(folder, 1.0)
}

/// A NIR file of neurons with this resistance.
pub fn nir_with(folder: &Path, r: f64) -> String {
    let typed = |kind: &str| Group::default().with("type", kind);
    let one = |value: f64| Numbers::f64(&[2], &[value; 2]);
    let neuron = typed("LIF").with("tau", one(0.02)).with("r", one(r)).with("v_leak", one(0.0));
    let nodes = Group::default()
        .with("input", typed("Input").with("shape", Numbers::i64(&[1], &[3])))
        .with("w", typed("Linear").with("weight", Numbers::f64(&[2, 3], &[30.0, 20.0, 40.0, 10.0, 35.0, 25.0])))
        .with("n", neuron.with("v_threshold", one(1.0)))
        .with("output", typed("Output").with("shape", Numbers::i64(&[1], &[2])));
    let edges = ["input", "w", "w", "n", "n", "output"].map(String::from).to_vec();
    let graph = typed("NIRGraph").with("nodes", nodes).with("edges", Item::Texts(vec![3, 2], edges));
    let path = folder.join("net.nir");
    std::fs::write(&path, hdf5::write(&Group::default().with("node", graph)).unwrap()).unwrap();
    path.display().to_string()
}

fn array(folder: &Path, name: &str, shape: &[u64], numbers: &[f64]) -> String {
    let path = folder.join(name);
    nsim::files::npy::write(std::fs::File::create(&path).unwrap(), shape, numbers.iter().copied()).unwrap();
    path.display().to_string()
}

#[test]
fn every_command_that_reads_models_takes_the_timestep_that_a_file_lacks() {
    let folder = tempfile::tempdir().unwrap();
    let net = nir(folder.path());
    let at = |name: &str| folder.path().join(name).display().to_string();
    let sweep = write(folder.path(), "s.ron", &format!("Sweep(model: {net:?}, input: [\"scene:noise?samples=1\"])"));
    let (page, raster, again) = (at("page.html"), at("raster.svg"), at("again.nir"));
    let noise = "scene:noise?samples=1&steps=20";
    for line in [
        &["map", &net][..],
        &["run", &net, "--input", noise],
        &["energy", &net, "--input", noise, "--baseline"],
        &["agree", &net, "--input", noise],
        &["convert", &net, "--input", "scene:noise?samples=4&steps=20"],
        &["report", &net, "--input", noise, "-o", &page],
        &["plot", "raster", &net, "--input", noise, "-o", &raster],
        &["sweep", &sweep],
        &["import", &net],
        &["export", &net, "-o", &again],
    ] {
        let (code, _, stderr) = said(line);
        assert!(
            code == 3 && stderr.contains("help: give --from TOOL") && stderr.contains("--dt MS"),
            "{line:?}: {code} {stderr}"
        );
        succeeds(&[line, &["--dt", "0.1"]].concat());
    }
    // Inspecting such a file names the option that its import needs.
    let import = |more: &[&str]| object(&[&["inspect", &net], more].concat(), 0)["import"].to_string();
    assert!(import(&[]).contains("--dt MS") && import(&["--dt", "0.1"]).contains("timestep 0.1 ms"));
    // If the nodes imply a timestep by a tool's conventions, the note names their parameters.
    let notes = object(&["import", &nir_with(folder.path(), 20.0), "--from", "snntorch"], 0)["notes"].to_string();
    assert!(notes.contains("timestep 1 ms: tau / r, on which"), "{notes}");
    // A file with a timestep keeps it.
    let model = write(folder.path(), "m.ron", MODEL);
    for line in [&["run", &model, "--input", noise, "--dt", "2"][..], &["inspect", &model, "--dt", "2"]] {
        let error = object(line, 3);
        assert_eq!((&error["code"], &error["line"]), (&"model.timestep".into(), &1.into()));
        assert!(error["help"].as_str().unwrap().contains("--set timestep_ms=2"), "{error}");
        let tool = [&line[..line.len() - 2], &["--from", "sinabs"]].concat();
        assert_eq!(object(&tool, 3)["code"], "import.option");
        object(&[line, &["--set", "timestep_ms=2"]].concat(), 0);
    }
    assert_eq!(said(&["run", &net, "--dt", "0"]).0, 2);
}

#[test]
fn changes_reach_models_of_other_tools() {
    let folder = tempfile::tempdir().unwrap();
    let net = nir(folder.path());
    let spikes = |more: &[&str]| {
        let line = ["run", &net, "--dt", "0.1", "--input", "scene:noise?samples=2&rate=0.3"];
        object(&[&line[..], more].concat(), 0)["activity"]["spikes"].as_u64().unwrap()
    };
    assert!(spikes(&[]) > spikes(&["--set", "populations.n.vth=4"]));
    assert_eq!(object(&["map", &net, "--dt", "0.1", "--set", "populations.x.vth=4"], 3)["code"], "set.path");
    assert_eq!(said(&["import", &net, "--dt", "0.1", "--set", "populations.n.vth=4"]).0, 2);
}

#[test]
fn energy_follows_activity_which_a_model_without_a_scene_is_given() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "m.ron", MODEL);
    let page = folder.path().join("page.html").display().to_string();
    for line in [&["energy", &model, "--baseline"][..], &["report", &model, "-o", &page]] {
        let (code, stdout, stderr) = said(line);
        assert!(code == 3 && stdout.is_empty() && stderr.contains("energy depends on activity"), "{line:?}: {stderr}");
        assert!(stderr.contains("help: give spikes with --input FILE, or --input scene:noise to try"), "{stderr}");
        assert_eq!(said(&[line, &["--input", "scene:noise"]].concat()).0, 0);
    }
}

#[test]
fn fractions_are_spikes_where_that_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "m.ron", MODEL);
    let real = array(folder.path(), "real.npy", &[3, 2], &[0.3, 0.7, 0.5, 0.0, 1.0, 0.0]);
    let error = object(&["run", &model, "--input", &real], 3);
    assert_eq!(error["code"], "input.value");
    let advised = format!("{real}?least=0.5");
    assert!(error["help"].as_str().unwrap().ends_with(&advised), "{error}");
    let spikes = |source: &str| object(&["run", &model, "--input", source], 0)["activity"]["spikes_in"].clone();
    assert_eq!(spikes(&advised), 3);
    // One value is a spike, regardless of its type; several are counts.
    assert_eq!(spikes(&array(folder.path(), "whole.npy", &[3, 2], &[0.0, 2.0, 2.0, 0.0, 2.0, 0.0])), 3);
    let counts = array(folder.path(), "counts.npy", &[3, 2], &[0.0, 2.0, 1.0, 0.0, 1.0, 0.0]);
    assert_eq!(object(&["run", &model, "--input", &counts], 3)["code"], "input.value");
}

/// Remedies of a network that does not fit, each typed after the command.
#[test]
fn each_remedy_of_a_mapping_makes_it_fit() {
    let folder = tempfile::tempdir().unwrap();
    let dead = MODEL
        .replace("[[20, 0, 4], [2, 30, 6], [0, 8, 40], [12, -6, 2]]", "[[20, 0, 0], [2, 0, 0], [8, 0, 0], [12, 0, 0]]");
    let dead = write(folder.path(), "dead.ron", &dead);
    let wide = MODEL
        .replace("shape: [4]", "shape: [400]")
        .replace("[[20, 0, 4], [2, 30, 6], [0, 8, 40], [12, -6, 2]]", "Uniform(low: -120, high: 120, step: 2, seed: 1)")
        .replace("[[30, 0, 20, 2], [0, 40, -10, 8]]", "Uniform(low: -120, high: 120, step: 2, seed: 2)");
    let wide = write(folder.path(), "wide.ron", &wide);
    let bits = "Network(name: \"bits\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [40]),
         Loihi(name: \"out\", shape: [64], du: 1024, dv: 128, vth_mant: 10)], projections: [Dense(from: [\"in\"], to: \
                       \"out\",
         weights: Uniform(low: -120, high: 120, step: 2, seed: 1))], output: \"out\")";
    let bits = write(folder.path(), "bits.ron", bits);
    let small = write(folder.path(), "small.ron", MODEL);
    let own = "Target(base: \"tiny\", name: \"own\", width: 40, height: 2, cores_per_tile: 4, cores_per_chip: 150)";
    let own = write(folder.path(), "own.ron", own);
    let mut kinds = Vec::new();
    for line in [
        &["map", &dead, "--target", "loihi1-chip", "--set", "target.limits.axons_in=3"][..],
        &["map", &wide, "--target", "loihi1-chip", "--copies", "2000"],
        &["map", &wide, "--target", "tiny", "--copies", "9"],
        &["map", &bits, "--target", "tiny", "--set", "target.chips_x=1", "--set", "target.limits.synapse_words=80"],
        // A change that other boards cannot have does not change the reasons.
        &["map", &small, "--target", &own, "--copies", "20000", "--set", "target.cores_per_tile=40"],
    ] {
        let map = object(line, 1);
        assert!(!map["reasons"].as_array().unwrap().is_empty(), "{line:?}");
        for remedy in map["remedies"].as_array().unwrap() {
            kinds.push(remedy["kind"].as_str().unwrap().to_string());
            let change = remedy["change"].as_str().unwrap();
            let typed: Vec<&str> = change.rsplit_once(": ").unwrap().1.split(' ').collect();
            let mut words: Vec<&str> = line.to_vec();
            match words.iter().position(|word| *word == typed[0] && *word != "--set") {
                Some(place) => words[place + 1] = typed[1],
                None => words.extend(&typed),
            }
            let fits = object(&words, 0);
            assert_eq!(fits["fits"], true, "{words:?}");
        }
    }
    for kind in ["prune", "copies", "target", "weight_bits"] {
        assert!(kinds.iter().any(|found| found == kind), "{kind} is not tried: {kinds:?}");
    }
}

#[test]
fn every_reason_is_told_in_one_go() {
    let folder = tempfile::tempdir().unwrap();
    let model = MODEL
        .replace("shape: [4]", "shape: [4000]")
        .replace("[[20, 0, 4], [2, 30, 6], [0, 8, 40], [12, -6, 2]]", "Uniform(low: 2, high: 120, step: 2, seed: 1)")
        .replace("[[30, 0, 20, 2], [0, 40, -10, 8]]", "Uniform(low: 2, high: 120, step: 2, seed: 2)");
    let model = write(folder.path(), "m.ron", &model);
    let resources = |target: &[&str]| -> Vec<String> {
        let map = object(&[&["map", &model, "--set", "target.limits.axons_in=1000"], target].concat(), 1);
        let reasons = map["reasons"].as_array().unwrap().iter();
        reasons.map(|reason| reason["resource"].as_str().unwrap().to_string()).collect()
    };
    let few = resources(&["--target", "tiny"]);
    assert!(few.contains(&"compartments".to_string()) && few.contains(&"axons_in".to_string()), "{few:?}");
    assert_eq!(resources(&["--target", "loihi1-chip"]), ["axons_in"]);
}

#[test]
fn values_that_wrap_leave_room_after_the_change_and_the_spikes_stay() {
    let folder = tempfile::tempdir().unwrap();
    let run = |exponent: u32| {
        let text = format!(
            "Network(name: \"loud\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [2]),
             Loihi(name: \"out\", shape: [1], du: 256, dv: 256, vth_mant: {})], projections: [Dense(from: [\"in\"],
             to: \"out\", weights: [[254, 254]], weight_exp: {exponent})], output: \"out\")",
            800 << exponent
        );
        let model = write(folder.path(), "loud.ron", &text);
        object(&["run", &model, "--input", "scene:noise?samples=1&steps=200&rate=0.9"], 0)
    };
    let advised =
        |run: &Value| run["warnings"].to_string().contains("lower the weight_exp of its inputs by 1, and halve");
    let first = (0..7).rev().find(|&exponent| !advised(&run(exponent))).unwrap();
    assert!(advised(&run(first + 1)), "{first}");
    assert_eq!(run(first)["digest"], run(first - 1)["digest"], "half the values make the same spikes");
}

#[test]
fn a_voltage_that_clips_where_nothing_fires_is_no_matter() {
    let folder = tempfile::tempdir().unwrap();
    let codes = |clip: &str, weight: &str| -> (u64, String) {
        let text = format!(
            "Network(name: \"low\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [1]),
             Loihi(name: \"out\", shape: [1], du: 4096, dv: 0, vth_mant: 9000, {clip})],
             projections: [Dense(from: [\"in\"], to: \"out\", weights: [[{weight}]])], output: \"out\")"
        );
        let model = write(folder.path(), "low.ron", &text);
        let run = object(&["run", &model, "--input", "scene:noise?samples=1&steps=100&rate=0.9"], 0);
        (run["populations"][0]["clipped"].as_u64().unwrap(), run["warnings"].to_string())
    };
    let (clipped, warnings) = codes("vmin_exp: 10", "-250");
    assert!(clipped > 10 && !warnings.contains("clipped"), "{clipped} {warnings}");
    let (clipped, warnings) = codes("vmax_exp: 1", "250");
    assert!(clipped > 10 && warnings.contains("raise vmax_exp"), "{clipped} {warnings}");
}

/// The options of a command.
fn options(command: &str) -> String {
    said(&[&["help"][..], &command.split(' ').collect::<Vec<_>>()].concat()).1
}

/// Advice of every stage, printed by commands that lack another command's options.
#[test]
fn options_in_advice_are_those_of_the_command_or_of_one_that_it_names() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let model = write(folder.path(), "m.ron", MODEL);
    let srm = write(folder.path(), "srm.ron", SRM);
    let net = nir(folder.path());
    let weights = array(folder.path(), "w.npy", &[2, 3], &[1.0; 6]);
    let events = write(folder.path(), "e.csv", "t,x,y,p\n0.1,1,1,1\n0.2,1,1,0\n");
    let yaml = write(folder.path(), "n.yml", "neuron:\n  type: LOIHI\n");
    let fan_out = "Network(name: \"f\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [1]),
         Loihi(name: \"a\", shape: [1], du: 1, dv: 1, vth_mant: 1), Loihi(name: \"b\", shape: [9000], du: 1, dv: 1, \
                       vth_mant: 1)],
         projections: [Dense(from: [\"in\"], to: \"a\", weights: [[2]]),
         Dense(from: [\"a\"], to: \"b\", weights: Uniform(low: 2, high: 2, step: 2, seed: 1))], output: \"b\")";
    let fan_out = write(folder.path(), "fan.ron", fan_out);
    let few = ["--set", "target.limits.axons_out_per_compartment=2", "--input", "scene:noise?samples=1"];
    let mut seen = 0;
    for line in [
        &["run", &net][..],
        &["energy", &model],
        &["run", &weights],
        &["energy", &weights],
        &["export", &weights, "-o", &at("x.nir")],
        &["run", &yaml],
        &["map", &events],
        &["run", &model, "--input", &events],
        &["inspect", &events],
        &["inspect", &at("absent.npy")],
        &["run", &srm, "--prune", "static", "--engine", "reference"],
        &[&["agree", &fan_out][..], &few].concat(),
        &[&["run", &fan_out][..], &few].concat(),
        &[&["energy", &fan_out][..], &few].concat(),
        &["agree", &model, "--against", "srm"],
        &["run", &model, "--samples", "5..9", "--input", "scene:noise?samples=2"],
        &["plot", "energy", &model, "-o", &at("x.svg")],
        &["plot", "agreement", &model, "-o", &at("x.svg")],
        &["scene", "noise"],
        &["train", &at("absent.ron")],
        &["map", "--target", "nowhere"],
        &["run", &model, "--set", "x.y=1"],
        &["energy", "--host", "stream", "--target", "tiny"],
        &["energy", &model, "--deployment", "paper"],
    ] {
        let (code, _, stderr) = said(line);
        assert_ne!(code, 0, "{line:?}");
        let advice: Vec<&str> = stderr.split_whitespace().collect();
        let mut commands = vec![line[0].to_string()];
        for (place, word) in advice.iter().enumerate() {
            let word = word.trim_matches(|c: char| !c.is_ascii_alphanumeric() && c != '-');
            if word.ends_with("nsim") {
                let next = advice.get(place + 1).unwrap_or(&"").trim_matches(|c: char| !c.is_ascii_alphanumeric());
                commands.push(next.to_string());
            }
        }
        let known: String = commands.iter().map(|command| options(command)).collect();
        for option in advice.iter().filter_map(|word| word.trim_start_matches(|c: char| c != '-').strip_prefix("--")) {
            let name: String = option.chars().take_while(|c| c.is_ascii_alphanumeric() || *c == '-').collect();
            seen += 1;
            assert!(known.contains(&format!("--{name}")), "{line:?}: --{name} of {commands:?}: {stderr}");
        }
    }
    assert!(seen > 20, "{seen}");
}

/// Each line has one fault, and its advice is typed.
#[test]
fn what_is_advised_is_what_helps() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(here, "m.ron", MODEL);
    write(here, "s.csv", "timestep,channel\n0,0\n1,1\n3,2\n");
    write(here, "t.csv", "t,x\n0.001,1\n0.002,2\n");
    let whole = std::fs::read(array(here, "whole.npy", &[3, 9], &[1.0; 27])).unwrap();
    std::fs::write(here.join("cut.npy"), &whole[..whole.len() - 8]).unwrap();
    for line in ["map m.ron -o one.ron", "map m.ron --copies 2 -o two.ron"] {
        assert_eq!(command::said(here, line).0, 0, "{line}");
    }
    // A line, the advice in its error, and a line that follows the advice.
    for (line, advice, then) in [
        ("inspect t.csv", "?unit=s", "inspect t.csv?unit=s"),
        ("run m.ron --input t.csv", "?unit=s", "run m.ron --input t.csv?unit=s&size=3,1&polarity=on"),
        ("map m.ron -o one.ron", "--force", "map m.ron -o one.ron --force"),
        (
            "energy m.ron --mapping two.ron --copies 3 --input s.csv",
            "--copies 2",
            "energy m.ron --mapping two.ron --copies 2 --input s.csv",
        ),
        ("agree m.ron --against srm --input s.csv", "use cuba or golden", "agree m.ron --against golden --input s.csv"),
        ("import s.csv", "nsim run MODEL --input FILE", "run m.ron --input s.csv"),
        ("run s.csv", "nsim run MODEL --input FILE", "run m.ron --input s.csv"),
        ("scene noise", "--input scene:noise", "run m.ron --input scene:noise"),
        ("run m.ron --mapping one.ron --target loihi1-chip", "nsim map", "run m.ron --mapping one.ron"),
        ("inspect absent.ron", "check the path", "inspect m.ron"),
        ("run .", "name a file in it", "run ./m.ron --input whole.npy"),
        ("run m.ron --input cut.npy", "write the array again with numpy.save", "run m.ron --input whole.npy"),
        ("run m.ron --input whole.npy?unit=s", "remove the option", "run m.ron --input whole.npy"),
        ("map m.ron -o m.ron/x.ron", "name another file", "map m.ron -o x.ron"),
        ("map m.ron --mapping m.ron", "nsim map MODEL -o FILE", "map m.ron --mapping x.ron"),
        ("run m.ron --set populations.out.du=5000", "nsim show NAME prints a shipped one", "show vtsnn-slip"),
        ("sweep m.ron -o u.csv", "nsim inspect FILE names the kind of a file", "inspect m.ron"),
    ] {
        let (status, _, error) = command::said(here, line);
        assert!([2, 3].contains(&status) && error.replace("\n  ", " ").contains(advice), "{line}: {status} {error}");
        command::succeeds(here, then);
    }
}

#[test]
fn a_recording_is_inspected_with_its_options_and_words_stay_whole_in_a_pipe() {
    let folder = tempfile::tempdir().unwrap();
    let seconds = write(folder.path(), "t.csv", "t,x\n0.001,1\n0.004,2\n");
    let found = object(&["inspect", &format!("{seconds}?unit=s")], 0);
    assert_eq!((&found["events"], &found["duration_ms"]), (&2.into(), &3.0.into()));
    for option in ["stream=1", "pool=2", "unit=h", "nothing=1"] {
        let error = object(&["inspect", &format!("{seconds}?{option}")], 3);
        assert!(error["code"] == "input.option" && error["help"].is_string(), "{option}: {error}");
    }
    let long = "a_population_whose_name_is_longer_than_any_column_of_a_terminal_of_eighty_columns";
    let model = write(folder.path(), "m.ron", &MODEL.replace("hidden", long));
    let (code, stdout, _) = said(&["inspect", &model]);
    assert!(code == 0 && stdout.matches(long).count() >= 3, "{stdout}");
}

/// Every command recognises each kind of file by its content, under names of other kinds.
#[test]
fn the_content_says_what_a_file_is_under_any_name() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "m.ron", MODEL);
    let spikes = array(folder.path(), "s.npy", &[3, 4], &[1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
    let named = |source: &str, name: &str| {
        let path = folder.path().join(name);
        std::fs::copy(source, &path).unwrap();
        path.display().to_string()
    };
    let sources = [
        (model.clone(), "model"),
        (nir(folder.path()), "nir network"),
        (spikes, "npy"),
        (write(folder.path(), "l.csv", "timestep,channel\n0,0\n1,1\n3,2\n"), "events"),
        (write(folder.path(), "e.csv", "t_us,x,y,p\n1,1,0,1\n2001,2,0,1\n"), "recording"),
    ];
    for (source, kind) in &sources {
        for name in ["a.dat", "a.txt", "a", "a.pt", "a.npy", "a.csv", "a.ron", "a.net"] {
            let file = named(source, name);
            assert_eq!(object(&["inspect", &file], 0)["kind"], *kind, "{kind} as {name}");
            let (imported, _, why) = said(&["import", &file, "--dt", "0.1"]);
            let source = if *kind == "recording" { format!("{file}?size=3,1&polarity=on") } else { file.clone() };
            let (ran, _, not) = said(&["run", &model, "--input", &source]);
            let (mapped, _, no_model) = said(&["map", &file, "--dt", if *kind == "model" { "1" } else { "0.1" }]);
            let is_model = ["model", "nir network"].contains(kind);
            assert_eq!(mapped == 0, is_model, "{kind} as {name}: {no_model}");
            assert_eq!(imported == 0, *kind == "nir network", "{kind} as {name}: {why}");
            assert_eq!(ran == 0, !is_model, "{kind} as {name}: {not}");
            for (code, said) in [(mapped, &no_model), (imported, &why), (ran, &not)] {
                assert!(code == 0 || code == 3 && said.contains("help: "), "{kind} as {name}: {code} {said}");
            }
        }
    }
    let piped = nsim(&["inspect", "-"]).pipe_stdin(&sources[0].0).unwrap().output().unwrap();
    assert!(piped.status.success());
}
