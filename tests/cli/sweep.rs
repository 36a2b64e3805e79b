//! `nsim sweep`: its rows equal the results of single commands, and an interruption at any moment
//! changes nothing.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::common::command::{object, said, succeeds as ran};

/// The rows of a table, by column.
fn rows(text: &str) -> Vec<Vec<(String, String)>> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let heads: Vec<String> = reader.headers().unwrap().iter().map(str::to_string).collect();
    let row = |record: csv::StringRecord| heads.iter().cloned().zip(record.iter().map(str::to_string)).collect();
    reader.records().map(|record| row(record.unwrap())).collect()
}

fn cell<'a>(row: &'a [(String, String)], column: &str) -> &'a str {
    &row.iter().find(|(name, _)| name == column).unwrap().1
}

const SMALL: &str = r#"Sweep(samples: "0..2", grid: [
    (name: "threshold", paths: ["populations.touch.vth_mant", "populations.sight.vth_mant"], values: [1000, 1300]),
    (name: "decay", paths: ["populations.out.dv"], from: 300, to: 390, step: 90),
    (name: "bits", paths: ["projections.0.weight_bits", "projections.1.weight_bits"], values: [8, 4]),
])"#;

#[test]
fn rows_are_those_of_the_single_commands() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("s.ron"), SMALL).unwrap();
    std::fs::write(
        folder.join("l.ron"),
        r#"Sweep(samples: "0..2", list: [
            {"model": "slip-tactile", "target": "loihi1-chip"}, {"constants.injection_time": "0.4us"},
            {"options.copies": 3, "options.mode": "realtime"}, {"options.constants": "davies2018", "input.seed": 9},
            {"model": "container-tactile-srm"}, {"options.host": "none"}, {"options.copies": 3, "options.deployment": "packed"},
            {"options.relays": true, "target.limits.axons_in": 1000}, {"options.prune": "static"},
            {"target.limits.axons_in": 100}, {"populations.out.vth_mant": -7},
        ])"#,
    )
    .unwrap();
    for (file, settings) in [
        ("s.ron", None),
        (
            "l.ron",
            Some([
                "slip-tactile --target loihi1-chip",
                "vtsnn-slip --set constants.injection_time=0.4us",
                "vtsnn-slip --copies 3 --mode realtime",
                "vtsnn-slip --constants davies2018 --seed 9",
                "container-tactile-srm",
                "vtsnn-slip --host none",
                "vtsnn-slip --copies 3 --deployment packed",
                "vtsnn-slip --relays --set target.limits.axons_in=1000",
                "vtsnn-slip --prune static",
                "",
                "",
            ]),
        ),
    ] {
        let found = rows(&ran(folder, &format!("sweep {file}")));
        assert_eq!(found.len(), if settings.is_some() { 11 } else { 8 });
        for (number, row) in found.iter().enumerate() {
            assert_eq!(cell(row, "variant"), number.to_string());
            let line = match settings {
                Some(settings) => settings[number].to_string(),
                None => {
                    let [threshold, decay, bits] = ["threshold", "decay", "bits"].map(|name| cell(row, name));
                    let set = |path: &str, value: &str| format!(" --set {path}={value}");
                    "vtsnn-slip".to_string()
                        + &set("populations.touch.vth_mant", threshold)
                        + &set("populations.sight.vth_mant", threshold)
                        + &set("populations.out.dv", decay)
                        + &set("projections.0.weight_bits", bits)
                        + &set("projections.1.weight_bits", bits)
                }
            };
            if line.is_empty() {
                let code = ["map.does-not-fit", "model.range"][number - 9];
                assert_eq!(cell(row, "fits"), ["false", ""][number - 9]);
                assert_eq!(cell(row, "error").split('.').next(), code.split('.').next(), "{row:?}");
                assert_eq!(cell(row, "tightest"), ["axons in 156 %", ""][number - 9]);
                assert!(cell(row, "reason").contains(["input axons", "-7"][number - 9]), "{row:?}");
                continue;
            }
            let copies = if line.contains("--copies") { "" } else { " --copies 1" };
            let energy = object(folder, &format!("energy {line}{copies} --baseline rtx-2080-ti --samples 0..2"), 0);
            let total = energy["rows"].as_array().unwrap().iter().find(|row| row["unit"] == "total").unwrap();
            for figure in ["static_mw", "dynamic_mw", "total_mw", "latency_us", "energy_uj", "edp_pjs"] {
                let number = cell(row, figure).parse::<f64>().ok();
                assert_eq!(number, total[figure].as_f64(), "{line}: {figure}");
            }
            let parts = energy["breakdown_pj_per_timestep"].as_object().unwrap().values();
            let events_uj: f64 = parts.map(|pj| pj.as_f64().unwrap() / 1e6).sum();
            let neuron_dynamic_uj: f64 = cell(row, "neuron_dynamic_uj").parse().unwrap();
            assert!(
                (neuron_dynamic_uj - events_uj).abs() < 1e-9 * events_uj,
                "{line}: {neuron_dynamic_uj} {events_uj}"
            );
            let own = [" --copies 3 --mode realtime", " --copies 3 --deployment packed", " --constants davies2018"];
            let line = own.iter().fold(line.replace(" --host none", ""), |line, own| line.replace(own, ""));
            // The reference engine runs spike response neurons by default.
            let run = object(folder, &format!("run {line} --engine fast --samples 0..2"), 0);
            for (column, value) in [
                ("digest", &run["digest"]),
                ("accuracy", &run["accuracy"]),
                ("timesteps", &run["timesteps"]),
                ("samples", &run["samples"]),
                ("spikes", &run["activity"]["spikes"]),
                ("synaptic_events", &run["activity"]["synaptic_events"]),
            ] {
                let value = value
                    .as_str()
                    .map_or_else(|| value.as_f64().map_or(String::new(), |number| number.to_string()), str::to_string);
                assert_eq!(cell(row, column), value, "{line}: {column}");
            }
            assert_eq!((cell(row, "fits"), cell(row, "error")), ("true", ""));
        }
    }
}

#[test]
fn threads_shards_and_kills_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let text = r#"Sweep(samples: "0..4", grid: [
        (paths: ["populations.out.vth_mant"], from: 900, to: 1500, step: 20),
        (paths: ["populations.touch.dv", "populations.sight.dv"], name: "decay", values: [300, 390, 500]),
    ])"#;
    std::fs::write(folder.join("s.ron"), text).unwrap();
    ran(folder, "sweep s.ron -o whole.csv --threads 2");
    let whole = std::fs::read(folder.join("whole.csv")).unwrap();
    assert_eq!(rows(std::str::from_utf8(&whole).unwrap()).len(), 93);
    assert!(!folder.join("whole.csv.journal").exists());
    assert_eq!(ran(folder, "sweep s.ron --threads 1").as_bytes(), whole);
    // Killed at moments throughout the run; finished rows are not run again.
    let (mut kept, mut kills) = (0, 0);
    for after in 0..400 {
        let mut child = Command::new(assert_cmd::cargo::cargo_bin("nsim"))
            .current_dir(folder)
            .args(["sweep", "s.ron", "-o", "k.csv", "--threads", "2"])
            .stderr(Stdio::null())
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        std::thread::sleep(Duration::from_millis(20 + 37 * (after % 10)));
        let _ = child.kill();
        child.wait().unwrap();
        // The table is written before its journal is removed, and a kill may come between.
        let ended = folder.join("k.csv").exists() && !folder.join("k.csv.journal").exists();
        let journal = std::fs::read_to_string(folder.join("k.csv.journal")).unwrap_or_default();
        assert!(ended || journal.lines().count() >= kept, "rows are lost");
        kept = journal.lines().count();
        kills += u32::from(!ended);
        if ended {
            break;
        }
    }
    assert!(kills > 0);
    if !folder.join("k.csv").exists() || folder.join("k.csv.journal").exists() {
        ran(folder, "sweep s.ron -o k.csv");
    }
    assert!(std::fs::read(folder.join("k.csv")).unwrap() == whole, "after {kills} kills");
    assert!(!folder.join("k.csv.journal").exists());
    // A journal whose last line is incomplete continues after the previous line.
    for shard in 1..=3 {
        ran(folder, &format!("sweep s.ron -o {shard}.csv --shard {shard}/3"));
    }
    ran(folder, "sweep s.ron -o merged.csv --merge 3.csv 1.csv 2.csv");
    assert!(std::fs::read(folder.join("merged.csv")).unwrap() == whole);
    let part = std::fs::read_to_string(folder.join("2.csv")).unwrap();
    let digit = part.rfind(|c: char| c.is_ascii_digit()).unwrap();
    for bad in [
        &part[..part.len() - 1],
        &part[..digit - 20],
        &part.replacen(",true,", ",false,", 1),
        &part.replacen('7', "8", 1),
    ] {
        std::fs::write(folder.join("bad.csv"), bad).unwrap();
        let (status, _, error) = said(folder, "sweep s.ron -o no.csv --merge 1.csv bad.csv 3.csv");
        assert!(status == 3 && error.contains("error[sweep.shard]"), "{bad}: {error}");
    }
    let (status, _, error) = said(folder, "sweep s.ron -o no.csv --merge 1.csv 2.csv");
    assert!(status == 3 && error.contains("variant 2 has no row"), "{error}");
    let (_, _, warned) = said(folder, "sweep s.ron -o p.csv --plot p.svg --axes populations.out.vth_mant,energy_uj");
    assert!(warned.contains("no front: neither less nor more of populations.out.vth_mant"), "{warned}");
    assert!(std::fs::read_to_string(folder.join("p.svg")).unwrap().contains("energy (uJ a timestep)"));
    assert!(!std::fs::read_to_string(folder.join("p.csv")).unwrap().contains("front"), "no threshold is better");
}

#[test]
fn a_journal_is_not_continued_with_changed_weights() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("models");
    for name in ["slip-tactile.ron", "slip-tactile.safetensors"] {
        std::fs::copy(models.join(name), folder.join(name)).unwrap();
    }
    let text =
        r#"Sweep(model: "slip-tactile.ron", grid: [(paths: ["populations.touch.dv"], from: 100, to: 4000, step: 10)])"#;
    std::fs::write(folder.join("s.ron"), text).unwrap();
    let mut child = Command::new(assert_cmd::cargo::cargo_bin("nsim"))
        .current_dir(folder)
        .args(["sweep", "s.ron", "-o", "t.csv"])
        .stderr(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let lines = || std::fs::read_to_string(folder.join("t.csv.journal")).unwrap_or_default().lines().count();
    while lines() < 3 {
        assert!(child.try_wait().unwrap().is_none(), "the sweep ended without a journal");
        std::thread::sleep(Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let (stored, weights) = (lines(), folder.join("slip-tactile.safetensors"));
    let mut bytes = std::fs::read(&weights).unwrap();
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    std::fs::write(&weights, bytes).unwrap();
    let (status, _, error) = said(folder, "sweep s.ron -o t.csv");
    assert!(status == 3 && error.contains("this is the journal of another sweep"), "{error}");
    assert_eq!(lines(), stored);
}

#[test]
fn a_table_says_what_limits_and_what_is_on_the_front() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let text = r#"Sweep(model: "slip-tactile", samples: "0..1", grid: [
        (name: "compartments", paths: ["target.limits.compartments"], values: [2, 8, 64]),
        (name: "axons", paths: ["target.limits.axons_in"], values: [4096, 100]),
    ])"#;
    std::fs::write(folder.join("s.ron"), text).unwrap();
    ran(folder, "sweep s.ron -o t.csv --plot t.svg --axes cores,latency_us");
    let table = std::fs::read_to_string(folder.join("t.csv")).unwrap();
    // A whole table is plotted again without a run, over its columns or others.
    for (axes, same) in [("cores,latency_us", true), ("latency_us,accuracy", false)] {
        ran(folder, &format!("sweep s.ron --merge t.csv -o again.csv --plot again.svg --axes {axes} --force"));
        let [first, again] = ["t.svg", "again.svg"].map(|name| std::fs::read_to_string(folder.join(name)).unwrap());
        assert_eq!(first == again, same, "{axes}");
        assert_eq!(again.contains("interval of 95 %"), !same, "{again}");
    }
    let found = rows(&table);
    // Each row is on the front unless another has at most as many cores and is as fast.
    let figure = |row: &[(String, String)], column: &str| cell(row, column).parse::<f64>().ok();
    let point = |row: &[(String, String)]| Some((figure(row, "cores")?, figure(row, "latency_us")?));
    let points: Vec<(f64, f64)> = found.iter().filter_map(|row| point(row)).collect();
    assert_eq!(points.len(), 3);
    for row in &found {
        let beaten = |own: (f64, f64)| points.iter().any(|p| p.0 <= own.0 && p.1 <= own.1 && *p != own);
        assert_eq!(cell(row, "front"), point(row).is_some_and(|own| !beaten(own)).to_string(), "{row:?}");
        assert_eq!(cell(row, "fits") == "false", cell(row, "axons") == "100");
        let used = figure(row, "used_percent").unwrap();
        assert!(if cell(row, "axons") == "100" { used > 100.0 } else { used <= 100.0 }, "{row:?}");
    }
    // Two compartments of a core are its whole limit.
    assert_eq!((cell(&found[0], "tightest"), cell(&found[0], "used_percent")), ("compartments 100 %", "100"));
    let picture = std::fs::read_to_string(folder.join("t.svg")).unwrap();
    assert!(picture.contains("on the front") && picture.contains("64, 4096"), "{picture}");
    // A smaller size is better; equal rows are counted.
    let text = ran(folder, "sweep s.ron -o size.csv --axes compartments,axons");
    assert!(text.contains("; 1 on the front"), "{text}");
    let sized = rows(&std::fs::read_to_string(folder.join("size.csv")).unwrap());
    let on: Vec<&str> = sized.iter().map(|row| cell(row, "front")).collect();
    assert_eq!(on.iter().filter(|on| **on == "true").count(), 1, "{on:?}");
    let text = ran(folder, "sweep s.ron -o none.csv --axes samples,chips");
    assert!(!text.contains("front"), "{text}");
    let text = ran(folder, "sweep s.ron -o ties.csv --axes chips,spikes");
    assert!(text.contains(" on the front, 3 of them equal to another in both columns"), "{text}");
    // A path that the target lacks is reported on the screen.
    let wrong = r#"Sweep(model: "slip-tactile", samples: "0..1", list: [{"target.limits.memry": 5}])"#;
    std::fs::write(folder.join("wrong.ron"), wrong).unwrap();
    let text = ran(folder, "sweep wrong.ron -o wrong.csv");
    assert!(
        text.contains("1 variant; 1 could not be run") && text.contains("\nthe first: ") && text.contains("memry"),
        "{text}"
    );
    // Words of a reason survive a journal and the tables of parts.
    for shard in 1..=2 {
        ran(folder, &format!("sweep s.ron -o {shard}.csv --shard {shard}/2"));
    }
    ran(folder, "sweep s.ron -o merged.csv --merge 1.csv 2.csv --axes cores,latency_us");
    assert_eq!(std::fs::read_to_string(folder.join("merged.csv")).unwrap(), table);
    let page = ran(folder, "sweep s.ron --format markdown");
    assert!(
        !page.contains("digest") && page.contains(&format!("| {} |", cell(&found[0], "synaptic_events"))),
        "{page}"
    );
    std::fs::write(folder.join("n.ron"), "Sweep(input: \"scene:noise\")").unwrap();
    assert!(said(folder, "sweep n.ron").2.contains("write [\"scene:noise\"]"));
}

#[test]
fn what_no_variant_can_be_run_with_ends_the_sweep() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for (text, code) in [
        (r#"Sweep(grid: [(paths: ["populations.nothing.vth_mant"], values: [1])])"#, "set.path"),
        (r#"Sweep(grid: [(paths: ["constants.nothing"], values: [1])])"#, "set.path"),
        (r#"Sweep(model: "nothing", grid: [(paths: ["options.seed"], values: [1, 2])])"#, "model.unknown"),
        (r#"Sweep(grid: [(paths: ["options.nothing"], values: [1])])"#, "sweep.path"),
        (r#"Sweep(input: ["absent.npy"])"#, "io.missing"),
    ] {
        std::fs::write(folder.join("s.ron"), text).unwrap();
        let (status, out, _) = said(folder, "sweep s.ron --format json");
        let error: serde_json::Value = serde_json::from_str(&out).unwrap();
        assert!(status != 0 && error["code"] == code, "{text}: {status} {error}");
    }
}

#[test]
fn a_model_without_a_scene_is_refused_as_energy_refuses_it() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let model = r#"Network(name: "own", timestep_ms: 1.0, populations: [Input(name: "in", shape: [4]),
        Loihi(name: "out", shape: [2], du: 4095, dv: 4095, vth_mant: 1)], projections: [
        Random(from: ["in"], to: "out", fan_out: 2, low: 8, high: 64, seed: 1)], output: "out")"#;
    std::fs::write(folder.join("own.ron"), model).unwrap();
    std::fs::write(folder.join("s.ron"), r#"Sweep(model: "own.ron")"#).unwrap();
    let (sweep, energy) = (object(folder, "sweep s.ron", 3), object(folder, "energy own.ron", 3));
    assert_eq!((&sweep["code"], &sweep["message"]), (&energy["code"], &energy["message"]));
    assert_eq!(sweep["code"], "energy.input");
    // The suggested remedy.
    let help = sweep["help"].as_str().unwrap();
    let field = help.split(", or try ").nth(1).unwrap();
    std::fs::write(folder.join("s.ron"), format!("Sweep(model: \"own.ron\", {field})")).unwrap();
    let table = rows(&ran(folder, "sweep s.ron"));
    assert_eq!(cell(&table[0], "error"), "");
}

/// Hidden sizes are trained, mapped and priced in one table, as by the single commands.
#[test]
fn variants_train_networks_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let sweep = r#"Sweep(
        train: "slip-tactile",
        set: {
            "train.epochs": 6,
            "train.train": "[\"scene:slip?samples=60&seed=1\"]",
            "train.test": "[\"scene:slip?samples=10&seed=2\"]",
        },
        grid: [
            (name: "hidden", paths: ["train.layers.touch.size"], values: [30, 50]),
            (name: "copies", paths: ["options.copies"], values: [1, 2]),
        ],
    )"#;
    std::fs::write(folder.path().join("sweep.ron"), sweep).unwrap();
    let table = rows(&ran(folder.path(), "sweep sweep.ron"));
    assert_eq!(table.len(), 4);
    let set = "--set layers.touch.size=50 --set epochs=6 --set train=[\"scene:slip?samples=60&seed=1\"] \
               --set test=[\"scene:slip?samples=10&seed=2\"]";
    let trained = object(folder.path(), &format!("train slip-tactile {set} -o h50.ron"), 0);
    let run = object(folder.path(), "run h50.ron --input scene:slip?samples=10&seed=2", 0);
    assert_eq!(cell(&table[2], "digest"), run["digest"].as_str().unwrap());
    assert_eq!(run["digest"], trained["digest"]);
    let energy = object(folder.path(), "energy h50.ron --input scene:slip?samples=10&seed=2 --baseline --copies 2", 0);
    let total = energy["rows"].as_array().unwrap().iter().find(|row| row["unit"] == "total").unwrap();
    assert_eq!(cell(&table[3], "energy_uj"), total["energy_uj"].to_string());
    assert_ne!(cell(&table[0], "digest"), cell(&table[2], "digest"));
    for (text, code) in [
        (r#"Sweep(train: "slip-tactile", model: "slip-tactile")"#, "sweep.value"),
        (r#"Sweep(train: "slip-tactile", set: {"populations.out.du": 1})"#, "sweep.path"),
        (r#"Sweep(set: {"train.epochs": 1})"#, "sweep.path"),
        (r#"Sweep(train: "slip")"#, "train.unknown"),
        (r#"Sweep(train: "slip-tactile", set: {"train.layers.nothing.size": 1})"#, "set.path"),
    ] {
        std::fs::write(folder.path().join("wrong.ron"), text).unwrap();
        let (status, _, err) = said(folder.path(), "sweep wrong.ron");
        assert!(status == 3 && err.contains(code), "{text}: {err}");
    }
}

/// Parts of any other sweep: each file that a run reads, and each option that changes a row.
#[test]
fn parts_of_another_sweep_are_refused_and_the_target_is_the_model_s_own() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
    let array = |name: &str, weights: [i32; 8]| {
        nsim::files::npy::write(std::fs::File::create(folder.join(name)).unwrap(), &[2, 4], weights).unwrap();
    };
    let model = r#"Network(name: "small", timestep_ms: 1.0, populations: [Input(name: "in", shape: [4]),
        Loihi(name: "out", shape: [2], du: 1024, dv: [128, 256], vth_mant: 80)], projections: [
        Dense(from: ["in"], to: "out", weights: Npy("w.npy"))], output: "out", target: "board.ron")"#;
    let sweep = r#"Sweep(model: "m.ron", input: ["in=spikes.csv"], grid: [
        (name: "t", paths: ["populations.out.vth_mant"], values: [40, 60, 80])])"#;
    write("m.ron", model);
    write("s.ron", sweep);
    write("spikes.csv", "timestep,channel\n0,0\n1,1\n2,2\n3,3\n");
    write("board.ron", r#"Target(base: "own", name: "board")"#);
    write("own.ron", r#"Target(base: "oheo-gulch", name: "own")"#);
    array("w.npy", [2, 4, -6, 8, 0, 2, 2, 2]);
    for part in 1..=2 {
        ran(folder, &format!("sweep s.ron -o {part}.csv --shard {part}/2"));
    }
    let merge = "sweep s.ron -o merged.csv --force --merge 1.csv 2.csv";
    let refused = |line: &str, why: &str| {
        let (status, _, error) = said(folder, line);
        assert!(status == 3 && error.contains("error[sweep.shard]") && error.contains("other files"), "{why}: {error}");
    };
    ran(folder, merge);
    ran(folder, "sweep s.ron -o t.csv");
    let first = std::fs::read_to_string(folder.join("t.csv")).unwrap();
    std::fs::copy(folder.join("w.npy"), folder.join("w.npy.before")).unwrap();
    for (file, text) in [
        ("s.ron", sweep.replace("grid", "copies: 4, grid")),
        ("m.ron", model.replace("1024", "1025")),
        ("spikes.csv", "timestep,channel\n0,0\n1,1\n2,2\n3,2\n".to_string()),
        ("board.ron", r#"Target(base: "own", name: "board", chips_x: 2)"#.to_string()),
        ("own.ron", r#"Target(base: "oheo-gulch", name: "own", chips_x: 2)"#.to_string()),
    ] {
        let before = std::fs::read_to_string(folder.join(file)).unwrap();
        write(file, &text);
        refused(merge, file);
        write(file, &before);
    }
    array("w.npy", [2, 4, -6, 8, 0, 2, 2, 4]);
    refused(merge, "an array");
    std::fs::copy(folder.join("w.npy.before"), folder.join("w.npy")).unwrap();
    for option in ["--set populations.out.refractory=3", "--relays"] {
        refused(&format!("{merge} {option}"), option);
    }
    ran(folder, merge);
    assert_eq!(std::fs::read_to_string(folder.join("merged.csv")).unwrap(), first);
    // The sweep maps onto the model's own target, as the command does.
    let energy = object(folder, "energy m.ron --input in=spikes.csv --baseline", 0);
    let total = energy["rows"].as_array().unwrap().iter().find(|row| row["unit"] == "total").unwrap();
    assert_eq!(
        (energy["target"].as_str(), cell(&rows(&first)[2], "energy_uj")),
        (Some("board"), &*total["energy_uj"].to_string())
    );
}
