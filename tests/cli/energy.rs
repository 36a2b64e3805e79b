//! `nsim energy`: copies, other hardware, rates.

use serde_json::{Value, json};

use crate::{MODEL, has_keys, nsim, object, said, succeeds, write};

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
            ("loihi, as in the VT-SNN paper", "simulated", "simulated"),
            ("the VT-SNN paper, printed", "published", "published"),
            ("RTX 2080 Ti", "published", "published"),
            ("CPU, dense", "measured", "stated"),
            ("CPU, by events", "measured", "stated"),
        ]
    );
    for row in &rows[6..] {
        assert_eq!((&row["static_mw"], &row["total_mw"]), (&5_000.0.into(), &20_000.0.into()));
        assert!(row["latency_us"].as_f64().unwrap() > 0.0);
    }
    has_keys(&energy, &["ratios", "per_sample", "per_decision", "job", "transport", "time_us_per_timestep"]);
    assert_eq!(energy["ratios"].as_array().unwrap().len(), 5);
    assert_eq!(energy["per_sample"].as_array().unwrap().len(), 6);
    // Another network has no published row, but a modelled one if requested.
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "small.ron", MODEL);
    let small =
        object(&["energy", &model, "--input", "scene:noise?samples=1&steps=20", "--baseline", "rtx-2080-ti"], 0);
    assert_eq!(small["rows"].as_array().unwrap().len(), 3);
    assert!(small["warnings"].to_string().contains("--baseline gpu-roofline"), "{}", small["warnings"]);
    let (_, _, why) =
        said(&["energy", &model, "--input", "scene:noise?samples=1&steps=20", "--baseline", "rtx-2080-ti"]);
    assert!(why.contains("no row for"), "{why}");
    let input = "scene:noise?samples=1&steps=20";
    let small = object(&["energy", &model, "--input", input, "--baseline", "gpu-roofline"], 0);
    assert_eq!(small["rows"][3]["source"], "modelled");
    assert_eq!(object(&["energy", "--baseline", "abacus"], 3)["code"], "baseline.unknown");
    assert_eq!(said(&["energy", "--cpu-watts", "20,5"]).0, 2);
}

/// Accuracy of early decisions is of the shortened samples, as `nsim run` counts it.
#[test]
fn an_early_exit_is_priced_with_the_accuracy_that_it_has() {
    let folder = tempfile::tempdir().unwrap();
    let same = ["slip-tactile", "--input", "scene:slip?samples=30&seed=2", "--early-exit", "2"];
    let run = object(&[&["run"], &same[..]].concat(), 0);
    let energy = object(&[&["energy"], &same[..], &["--baseline"]].concat(), 0);
    let (early, decision) = (&energy["early_exit"], &energy["per_decision"]);
    assert_eq!((&early["accuracy"], &early["median_step"]), (&run["accuracy"], &run["early_exit"]["median_step"]));
    assert_ne!(early["accuracy"], energy["accuracy"], "this tests too little");
    for key in ["accuracy", "median_step", "energy_uj"] {
        assert_eq!(early[key], decision[key], "{key}");
    }
    let whole = energy["per_sample"][0]["energy_uj"].as_f64().unwrap();
    let saved = early["energy_saved_uj"].as_f64().unwrap() / 30.0;
    assert!((decision["energy_uj"].as_f64().unwrap() + saved - whole).abs() < 1e-6 * whole, "{energy}");
    for full in [&[][..], &["--full"]] {
        let (_, text, _) = said(&[&["energy"], &same[..], &["--baseline"], full].concat());
        let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
        let [then, end] = [early, &energy].map(|of| of["accuracy"].as_f64().unwrap());
        let wanted = format!(
            "Right when decided: {then:.3} ({end:.3} at the end); median after {} ms of the sample (step {} from 0)",
            early["median_step"].as_u64().unwrap() + 1,
            early["median_step"]
        );
        assert!(text.contains(&wanted), "{wanted}: {text}");
        assert!(text.contains("if the chip is off after the decision"), "{text}");
    }
    // Without labels nothing is right or wrong.
    let model = write(folder.path(), "small.ron", MODEL);
    let noise = "scene:noise?samples=3&steps=20&rate=0.3";
    let small = object(&["energy", &model, "--input", noise, "--baseline", "--early-exit", "1"], 0);
    assert_eq!(small["early_exit"]["accuracy"], Value::Null);
}

/// The paper's rows of x86 and neuron cores are next to its total, each with its value here.
#[test]
fn every_unit_of_the_paper_s_job_stands_by_what_it_is_here() {
    for (deployment, mode, printed) in [
        ("spread", "offline", [[0.19, 21.1, 21.3], [11.7, 0.64, 12.4]]),
        ("paper", "realtime", [[0.19, 20.1, 20.3], [11.9, 0.15, 12.1]]),
    ] {
        let line = ["energy", "--samples", "0..2", "--baseline", "--deployment", deployment, "--mode", mode];
        let energy = object(&line, 0);
        let parts = energy["parts"].as_array().unwrap();
        assert_eq!(parts.len(), 2);
        let total = if deployment == "paper" { 2 } else { 3 };
        for ((part, unit), printed) in parts.iter().zip(["x86", "neuron"]).zip(printed) {
            assert_eq!(part["unit"], unit);
            for (key, printed) in ["static_mw", "dynamic_mw", "total_mw"].into_iter().zip(printed) {
                assert_eq!(part["printed"][key], printed);
                let here = part["here"][key].as_f64().unwrap();
                assert!((part["ratio"][key].as_f64().unwrap() - here / printed).abs() < 1e-12, "{part}");
            }
        }
        let sum: f64 = parts.iter().map(|part| part["here"]["total_mw"].as_f64().unwrap()).sum();
        assert!((sum - energy["rows"][total]["total_mw"].as_f64().unwrap()).abs() < 1e-9, "{energy}");
        let (_, text, _) = said(&line);
        let [x86, neuron] = printed.map(|row| row.map(|mw| mw.to_string()).join(" "));
        let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
        for wanted in [format!("x86 core {x86}"), format!("neuron cores {neuron}")] {
            assert!(text.contains(&wanted), "{wanted}: {text}");
        }
        let ratio = &parts[1]["ratio"];
        let [fixed, dynamic] = ["static_mw", "dynamic_mw"].map(|key| ratio[key].as_f64().unwrap());
        assert!(text.contains(&format!("neuron cores {fixed:.2}, {dynamic:.2}. Inferred:")), "{text}");
    }
    let (_, full, _) = said(&["energy", "--samples", "0..1", "--baseline", "--full"]);
    assert!(full.contains("624") && full.contains("nsim show loihi1-evidence"), "{full}");
    assert!(said(&["show", "loihi1-evidence"]).1.contains("231 us a step less its other parts"));
}

/// For one copy the x86 row is all x86 cores, and its number; for several it is one of them.
#[test]
fn the_total_of_one_copy_is_its_job_and_more_hardware_never_draws_less() {
    let mut least = 0.0;
    for (copies, deployment, x86) in
        [(1, "1,1,1", 1), (1, "1,1,3", 3), (1, "2,2,6", 6), (1, "24,24,24", 24), (1, "24,24,72", 72), (2, "2,2,6", 6)]
    {
        let copies = copies.to_string();
        let line = ["energy", "--samples", "0..1", "--baseline", "--copies", &copies, "--deployment", deployment];
        let energy = object(&line, 0);
        let mw = |at: usize| energy["rows"][at]["total_mw"].as_f64().unwrap();
        let job = energy["job"]["total_mw"].as_f64().unwrap();
        assert!((mw(0) + mw(1) - mw(2)).abs() < 1e-9 * job, "{energy}");
        let text = said(&line).1;
        if copies == "1" {
            assert!((mw(2) - job).abs() < 1e-9 * job && job > least, "{deployment}: {energy}");
            least = job;
            assert_eq!(energy["rows"][0]["x86_cores"], x86);
            let row = if x86 == 1 { "\nx86 core ".to_string() } else { format!("\n{x86} x86 cores ") };
            assert!(text.contains(&row), "{text}");
        } else {
            assert!((mw(0) * f64::from(x86) + mw(1) * 2.0 - job).abs() < 1e-9 * job, "{energy}");
            assert!(energy["rows"][0]["x86_cores"] == 1 && text.contains("\nx86 core "), "{text}");
        }
    }
}

/// Times of measured boards, bounds of constants, accountings, and the row without a host.
#[test]
fn loihi_2_is_priced_as_its_boards_were_measured() {
    let folder = tempfile::tempdir().unwrap();
    let cells = |kind: &str, weights: &str| {
        format!(
            "Network(name: \"pair\", timestep_ms: 1.0, kinds: [Kind(name: \"Own\", state: [(name: \"v\", bits: 24, \
             overflow: Clip)], update: [\"v = v + in\"], spikes: \"v > 100\", reset: [\"v = 0\"])], populations: \
             [Input(name: \"in\", shape: [40]), {kind}], projections: [Dense(from: [\"in\"], to: \"a\", weights: \
             [{weights}, {weights}])], output: \"a\")"
        )
    };
    let weights = format!("{:?}", [2; 40]);
    write(folder.path(), "own.ron", &cells("Own(name: \"a\", shape: [2])", &weights));
    write(folder.path(), "lif.ron", &cells("Loihi(name: \"a\", shape: [2], du: 4096, dv: 0, vth_mant: 100)", &weights));
    write(folder.path(), "silent.csv", "# steps: 100\ntimestep,channel\n");
    let energy = |line: &str| crate::common::command::object(folder.path(), &format!("energy {line} --baseline"), 0);
    let total = |of: &Value| of["rows"].as_array().unwrap().iter().find(|row| row["unit"] == "total").unwrap().clone();
    let bounded =
        |row: &Value, key: &str| [&row["low"][key], &row[key], &row["high"][key]].map(|x| x.as_f64().unwrap());
    // No turn in a step without input: the barrier, and two neurons of either kind.
    for (model, each) in [("lif", [0.00059, 0.003, 0.004]), ("own", [0.020, 0.028, 0.035])] {
        let row = total(&energy(&format!("{model}.ron --target oheo-gulch --input silent.csv")));
        for (found, (barrier, each)) in
            bounded(&row, "latency_us").into_iter().zip([1.16, 1.16, 1.17].into_iter().zip(each))
        {
            assert!((found - barrier - 2.0 * each).abs() < 1e-6, "{model}: {row}");
        }
    }
    // Dynamic energy reaches 60 times its own constants.
    let row = total(&energy(
        "lif.ron --target oheo-gulch --input silent.csv --set constants.core_static_power=0 --host none",
    ));
    let [low, figure, high] = bounded(&row, "energy_uj");
    assert!((low / figure - 1.0).abs() < 1e-6 && (high / figure - 60.0).abs() < 1e-3, "{row}");
    // The two accountings of boards; no source prints the whole unit of a Loihi 1.
    let power =
        |line: &str| total(&energy(&format!("lif.ron --input silent.csv --host none {line}")))["static_mw"].clone();
    assert_eq!(power("--target oheo-gulch --accounting rails"), 233.9);
    assert_eq!(power("--target kapoho-point --accounting unit"), 8.0 * 270.4);
    let (code, _, stderr) = said(&["energy", "--accounting", "unit", "--baseline"]);
    assert!(code == 2 && stderr.contains("have no unit_power"), "{stderr}");
    // Where injection is most of a step, the second row is that of the job without a host.
    for target in ["oheo-gulch --host stream", "loihi1-chip"] {
        let model = if target.starts_with("loihi1") { "slip-tactile" } else { "lif.ron" };
        let input =
            if model == "lif.ron" { "--input scene:noise?samples=1&steps=50&rate=0.5" } else { "--samples 0..1" };
        let with = energy(&format!("{model} {input} --target {target}"));
        let target = target.split(' ').next().unwrap();
        let without = energy(&format!("{model} {input} --target {target} --host none"));
        let (row, alone) = (&with["inputs_on_chip"], total(&without));
        for key in ["latency_us", "energy_uj", "total_mw", "low", "high"] {
            assert_eq!(row[key], alone[key], "{target} {key}");
        }
        assert!(
            without["inputs_on_chip"].is_null() && total(&with)["latency_us"].as_f64() > row["latency_us"].as_f64()
        );
    }
}

/// The job that is priced is the one that was typed: relays, hosts, resets, samples.
#[test]
fn deployments_and_hosts_are_priced_as_typed() {
    let energy = |line: &str| {
        let base = ["energy", "--samples", "0..2"].into_iter();
        object(&base.chain(line.split_whitespace()).chain(["--baseline"]).collect::<Vec<_>>(), 0)
    };
    let row = |of: &Value, unit: &str| {
        let rows = of["rows"].as_array().unwrap();
        rows.iter().find(|row| row["hardware"] == "loihi" && row["unit"] == unit).unwrap().clone()
    };
    // The numbers of the paper's job are its job; others keep its relays while there is room.
    let paper = energy("--deployment paper");
    let named = |line: &str| row(&energy(line), "neuron")["dynamic_mw"].as_f64().unwrap();
    let (own, of_paper) = (named(""), row(&paper, "neuron")["dynamic_mw"].as_f64().unwrap());
    assert_eq!(named("--copies 32 --deployment 594,5,5"), of_paper);
    assert!(of_paper > 4.0 * own && (named("--copies 32 --deployment 600,5,6") / of_paper - 1.0).abs() < 0.01);
    assert_eq!(named("--deployment 1,1,1"), own);
    for (line, says) in [("--deployment 594,5,5", "Inputs have relays"), ("--deployment 18,1,1", "No relays of inputs")]
    {
        assert!(energy(line)["notes"].to_string().contains(says), "{line}");
    }
    // A network of the paper's inputs has its job, whatever its file.
    let same = energy(concat!(env!("CARGO_MANIFEST_DIR"), "/models/vtsnn-slip.ron --deployment paper"));
    assert_eq!(row(&same, "total"), row(&paper, "total"));
    let other = energy("paper-slip-both-count --deployment paper");
    assert_eq!(
        (&other["deployment"], &other["cores_used"], &other["parts"]),
        (&"paper".into(), &594.into(), &json!([]))
    );
    // An x86 core that only resets runs; without x86 cores there is neither host nor reset.
    let (alone, resets) = (energy("--host none"), energy("--host none --reset-words 10496"));
    assert_eq!((&alone["host"]["x86_cores"], &resets["host"]["x86_cores"]), (&0.into(), &1.into()));
    let time = |of: &Value, part: &str| of["time_us_per_timestep"][part].as_f64().unwrap();
    assert!(time(&resets, "reset") > 1.0 && time(&resets, "injection") == 0.0 && time(&resets, "turn") > 1.0);
    assert!(resets["host"]["x86_share"].as_f64().unwrap() > 0.0 && alone["host"]["x86_share"].is_null());
    assert_eq!(time(&energy("--deployment 1,1,0"), "injection"), 0.0);
    for option in [&["--host", "stream"][..], &["--reset-words", "9"]] {
        let (code, _, stderr) = said(&[&["energy", "--deployment", "1,1,0"], option].concat());
        assert!(code == 2 && stderr.contains("needs an x86 core, and deployment as given has none"), "{stderr}");
    }
    // Every interval has a width, in real time and on rails, and lies around its figure.
    for line in ["", "--mode realtime", "--accounting rails", "--accounting rails --mode realtime"] {
        for row in energy(line)["rows"].as_array().unwrap().iter().filter(|row| row["hardware"] == "loihi") {
            for key in ["total_mw", "latency_us", "energy_uj", "edp_pjs"].into_iter().filter(|key| !row[key].is_null())
            {
                let [low, figure, high] = [&row["low"][key], &row[key], &row["high"][key]].map(|x| x.as_f64().unwrap());
                assert!(low <= figure && figure < high, "{line} {key}: {row}");
            }
        }
    }
    let rails = said(&["energy", "--samples", "0..1", "--baseline", "--accounting", "rails"]).1;
    let at_work = rails.lines().skip_while(|line| !line.starts_with("x86 core ")).nth(1).unwrap();
    assert!(at_work.contains("80 % interval") && at_work.contains('-'), "{rails}");
    // The last line is a sample of the row, and its neuron cores alone.
    let offline = energy("");
    let (text, sample) = (said(&["energy", "--samples", "0..2", "--baseline"]).1, &offline["sample"]);
    let energy_uj = |unit: &str| 150.0 * row(&offline, unit)["energy_uj"].as_f64().unwrap();
    for (key, wanted) in [("energy_uj", energy_uj("total")), ("cores_uj", energy_uj("neuron")), ("steps", 150.0)] {
        assert!((sample[key].as_f64().unwrap() / wanted - 1.0).abs() < 1e-9, "{key}: {sample}");
    }
    let last = text.lines().last().unwrap();
    assert!(
        last.starts_with("A sample of 150 steps: ") && last.contains(" uJ; of it the neuron cores alone: "),
        "{last}"
    );
    // What was computed from printed figures says so.
    let printed =
        |of: &Value| of["rows"].as_array().unwrap().iter().find(|row| row["source"] == "published").unwrap().clone();
    assert_eq!(printed(&offline)["energy_source"], "computed");
    assert_eq!(printed(&energy("--convention published"))["energy_source"], "published");
}

#[test]
fn the_readme_shows_lines_that_are_printed() {
    let readme = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/README.md")).unwrap();
    let shown = readme.split("```text\n").nth(1).unwrap().split("```").next().unwrap();
    let printed = said(&["energy", "--baseline", "rtx-2080-ti"]).1;
    let mut lines = printed.lines();
    let strange = shown.lines().find(|line| !lines.any(|other| other == *line));
    assert_eq!(strange, None, "{printed}");
}

#[test]
fn a_model_without_a_scenario_has_one_copy_everywhere() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "small.ron", MODEL);
    let energy = ["energy", &model, "--input", "scene:noise?samples=1&steps=20", "--baseline"];
    assert_eq!(object(&["map", &model], 0)["copies"], 1);
    assert_eq!(object(&energy, 0)["copies"], 1);
    let (code, _, stderr) = said(&[&energy[..], &["--deployment", "paper"]].concat());
    assert!(code == 2 && stderr.contains("networks with inputs of 156 and 3150 channels"), "{stderr}");
    // A user's scenario gives its copies and its numbers of cores.
    let own = "Scenario(name: \"s\", model: \"small\", target: \"nahuku-32\", copies: 2, work: \"w\", source: \"s\",
        notes: \"\", deployment: (cores_used: 7, chips_used: 2, x86_cores: 3))";
    let own = write(folder.path(), "own.ron", own);
    let report = object(&[&energy[..], &["--deployment", &own]].concat(), 0);
    assert_eq!((&report["copies"], &report["cores_used"], &report["x86_cores"]), (&2.into(), &7.into(), &3.into()));
    assert_eq!(object(&["inspect", &own], 0)["kind"], "scenario");
}

/// Relays are required by the chip alone: measured hardware without them, and a comparison with the
/// trained network, omit them.
#[test]
fn relays_of_the_measured_job_are_not_the_networks() {
    let folder = tempfile::tempdir().unwrap();
    let paper = ["--deployment", "paper", "--samples", "0..2"];
    let energy = object(&[&["energy", "--baseline", "rtx-2080-ti"], &paper[..]].concat(), 0);
    let rows = energy["rows"].as_array().unwrap();
    assert!(rows.iter().any(|row| row["hardware"] == "RTX 2080 Ti"), "{rows:?}");
    let page = folder.path().join("paper.html").display().to_string();
    succeeds(&[&["report", "-o", &page, "--baseline"], &paper[..]].concat());
    assert!(std::fs::read_to_string(&page).unwrap().contains("the trained network"));
    let (status, _, error) = said(&["energy", "--deployment", "papper"]);
    assert!(status == 3 && error.contains("--deployment is spread, packed, paper"), "{error}");
}

/// A target's own constants do not hide the shipped ones.
#[test]
fn a_shipped_preset_is_for_every_target() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "own.ron", "Constants(base: \"loihi1-evidence\")");
    let target = "Target(base: \"loihi1-chip\", name: \"mine\", constants: [\"own\"])";
    let target = write(folder.path(), "mine.ron", target);
    let energy = ["energy", "--samples", "0..1", "--baseline", "--target", &target, "--constants"];
    assert_eq!(object(&[&energy[..], &["davies2018"]].concat(), 0)["target"], "mine");
    assert_eq!(said(&[&energy[..], &["davies2017"]].concat()).0, 2);
}

#[test]
fn a_chip_of_ones_own_with_the_constants_of_another_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let target = "Target(base: \"loihi1-chip\", name: \"mine\", cores_per_tile: 8)";
    let target = write(folder.path(), "mine.ron", target);
    let energy = ["energy", "--samples", "0..1", "--baseline", "--target", &target];
    let noted = |line: &[&str]| {
        let text = succeeds(line);
        text.split_whitespace()
            .collect::<Vec<_>>()
            .join(" ")
            .matches("Uses constants of loihi, also for static power")
            .count()
    };
    assert_eq!((noted(&energy), noted(&[&energy[..], &["--full"]].concat()), noted(&energy[..4])), (1, 1, 0));
    let (_, full, _) = said(&[&energy[..], &["--full"]].concat());
    assert!(full.contains("mine, until decided") && !full.contains("loihi, until"), "{full}");
    let own = "Constants(base: \"loihi1-evidence\", hardware: \"mine\")";
    let own = write(folder.path(), "own.ron", own);
    assert_eq!(noted(&[&energy[..], &["--constants", &own]].concat()), 0);
}

/// A figure that depends on a changed constant has no interval; screen and JSON state this.
#[test]
fn figures_without_an_interval_are_named_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let target = "Target(base: \"loihi1-chip\", name: \"mine\", cores_per_tile: 8)";
    let target = write(folder.path(), "mine.ron", target);
    let constants = "Constants(base: \"loihi1-evidence\", hop_ew_energy: (value: 2.0, unit: pJ, source: \"me\", \
                     status: assumed))";
    let constants = write(folder.path(), "own.ron", constants);
    let energy = |more: &[&str]| {
        let line = [&["energy", "--samples", "0..1", "--baseline"], more].concat();
        let (_, text, _) = said(&line);
        let words = text.split_whitespace().collect::<Vec<_>>().join(" ");
        let found = object(&line, 0);
        let said: Vec<String> = found["notes"].as_array().unwrap().iter().map(ToString::to_string).collect();
        let reason = said.into_iter().find(|note| note.contains("No interval"));
        let reason = reason.map(|note| note.trim_matches('"').to_string());
        assert_eq!(reason.is_some(), found["high"].as_object().unwrap().values().any(Value::is_null), "{found}");
        assert_eq!(words.contains("No interval"), reason.is_some(), "{text}");
        assert!(reason.iter().all(|reason| words.contains(reason)), "{text}");
        reason.unwrap_or_default()
    };
    assert_eq!(energy(&[]), "");
    for (more, why) in [
        (&["--set", "constants.turn_time=1us"][..], "power, latency, energy, EDP: turn_time is changed, and its error"),
        (&["--constants", &constants], "power, energy, EDP: hop_ew_energy is changed, and its error"),
        (&["--constants", "davies2018"], "power, latency, energy, EDP: the errors of 29 constants of davies2018 are"),
        (&["--target", &target], "power, latency, energy, EDP: the constants' errors on mine"),
    ] {
        let said = energy(more);
        assert!(said.starts_with(&format!("No interval of {why}")), "{more:?}: {said}");
    }
}

#[test]
fn energy_is_of_as_many_copies_as_a_mapping_has() {
    let folder = tempfile::tempdir().unwrap();
    let saved = folder.path().join("mapping.ron").display().to_string();
    assert_eq!(said(&["map", "--copies", "2", "-o", &saved]).0, 0);
    let energy = ["energy", "--samples", "0..1", "--mapping"];
    assert_eq!(object(&[&energy[..], &[&saved]].concat(), 0)["copies"], 2);
    // A pipe can be read only once.
    let piped = nsim(&[&energy[..], &["-", "--format", "json"]].concat()).pipe_stdin(&saved).unwrap().output().unwrap();
    assert_eq!(serde_json::from_slice::<Value>(&piped.stdout).unwrap()["copies"], 2);
    let other = object(&[&energy[..], &[&saved, "--copies", "3"]].concat(), 3);
    assert_eq!((&other["code"], &other["file"]), (&"mapping.copies".into(), &saved.as_str().into()));
    // The options of a saved mapping come from its file.
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
        for key in ["energy_uj", "chip_energy_uj", "step_us", "static_mw", "cores"] {
            let [made, kept, run] = [&mapped, &loaded, &energy].map(|object| &object["expected"][key]);
            assert!(made.as_f64().is_some_and(|figure| figure > 0.0), "{model} {copies} {key}: {made}");
            assert_eq!((made, made), (kept, run), "{model} {copies} {key}");
        }
        assert_eq!(mapped["expected"]["cores"], energy["cores_used"]);
    }
}
