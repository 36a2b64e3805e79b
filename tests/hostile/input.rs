//! Inputs and environments that used to break the command line. It ends with a documented status,
//! in bounded time and memory. Every run is a process of its own with 3 GB of address space.

// A test that cannot continue has failed.
#![allow(clippy::unwrap_used)]
#![cfg(unix)]

use std::io::Write;
use std::os::unix::process::ExitStatusExt;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::torch::{archive, pickle};
use serde_json::Value;

const MODEL: &str = r#"Network(name: "x", timestep_ms: 1.0, populations: [Input(name: "in", shape: [4]),
    Loihi(name: "o", shape: [2], du: 1, dv: 1, vth_mant: 8)],
    projections: [Dense(from: ["in"], to: "o", weights: [[2, 2, 2, 2], [2, 2, 2, 2]])], output: "o")"#;
const NOISE: &str = "scene:noise?samples=3&steps=10&seed=1";

struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Place {
        let place = Place(tempfile::tempdir().unwrap());
        place.put("ok.ron", MODEL);
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn put(&self, name: &str, content: impl AsRef<[u8]>) {
        std::fs::write(self.path(name), content).unwrap();
    }

    /// Runs a shell line in which `nsim` is the program.
    fn run(&self, line: &str) -> Output {
        let program = assert_cmd::cargo::cargo_bin("nsim");
        let script = format!("ulimit -v 3000000; program={}; nsim() {{ $program \"$@\"; }}; {line}", program.display());
        Command::new("bash").args(["-c", &script]).current_dir(self.0.path()).stdin(Stdio::null()).output().unwrap()
    }

    /// Runs a line, and checks its exit status and that it does not panic.
    fn ends(&self, line: &str, statuses: &[i32]) -> Output {
        let output = self.run(line);
        let err = String::from_utf8_lossy(&output.stderr).into_owned();
        let code = output.status.code().unwrap_or(-output.status.signal().unwrap_or(0));
        assert!(statuses.contains(&code), "{line}: {code}, not {statuses:?}: {err}");
        assert!(!err.contains("panicked at") && !err.contains("fault of nsim"), "{line}: {err}");
        output
    }

    /// The JSON object that a line prints.
    fn object(&self, line: &str, status: i32) -> Value {
        let output = self.ends(&format!("{line} --format json"), &[status]);
        serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{line}: {e}"))
    }
}

fn model_with(old: &str, new: &str) -> String {
    assert!(MODEL.contains(old));
    MODEL.replace(old, new)
}

/// Formats of pictures in this build.
const PICTURES: [&str; if cfg!(feature = "pictures") { 3 } else { 1 }] =
    *["svg", "png", "pdf"].first_chunk().expect("there are three");

#[test]
fn export_refuses_what_run_refuses() {
    let place = Place::new();
    let weights = "[[2, 2, 2, 2], [2, 2, 2, 2]]";
    let cases = [
        (weights, "[[2, 2, 2, 2]]"),
        (weights, "[[2, 2], [2, 2], [2, 2], [2, 2]]"),
        (weights, "[[1000, 2, 2, 2], [2, 2, 2, 2]]"),
        ("du: 1", "du: 5000"),
        ("dv: 1", "dv: [1, 2, 3]"),
        ("vth_mant: 8", "vth_mant: -8"),
        ("to: \"o\",", "to: \"o\", delay: 63,"),
    ];
    for (index, (old, new)) in cases.into_iter().enumerate() {
        place.put("m.ron", model_with(old, new));
        let error = place.object(&format!("nsim export m.ron -o {index}.nir"), 3);
        assert_eq!(error["schema"], "nsim.error/1");
        assert!(!place.path(&format!("{index}.nir")).exists());
    }
    place.ends("nsim export ok.ron -o ok.nir", &[0]);
}

#[test]
fn a_data_set_that_names_itself_is_refused() {
    let place = Place::new();
    place.put("self.ron", r#"DataSet(name: "d", populations: {"t": "in"}, recordings: {"t": "self.ron"})"#);
    place.ends("nsim run ok.ron --input self.ron", &[3]);
}

#[test]
fn a_stderr_that_nobody_reads_loses_no_result() {
    let place = Place::new();
    let output = place.ends(&format!("nsim run ok.ron --input '{NOISE}' -vv --format json 2>/dev/full"), &[0]);
    assert_eq!(serde_json::from_slice::<Value>(&output.stdout).unwrap()["schema"], "nsim.run/1");
}

#[test]
fn sizes_are_refused_from_shapes() {
    let place = Place::new();
    let random =
        |fan_out: u64| format!("Random(from: [\"in\"], to: \"o\", fan_out: {fan_out}, low: -9, high: 9, seed: 1)");
    let dense = r#"Dense(from: ["in"], to: "o", weights: [[2, 2, 2, 2], [2, 2, 2, 2]])"#;
    let uniform = r#"Dense(from: ["in"], to: "o", weights: Uniform(low: -9, high: 9, step: 1, seed: 1))"#;
    let sized = |sources: u64, targets: u64, projection: &str| {
        model_with(dense, projection)
            .replace("shape: [4]", &format!("shape: [{sources}]"))
            .replace("shape: [2]", &format!("shape: [{targets}]"))
    };
    for (name, model) in [
        ("fan-out", sized(4, 2, &random(1_000_000_000))),
        ("channels", sized(100_000_000, 2, &random(1))),
        ("board", sized(1_000_000, 1_000_000, &random(1000))),
        ("dense", sized(524_288, 512, uniform)),
    ] {
        place.put("m.ron", model);
        let begin = Instant::now();
        let object = place.object("nsim map m.ron", 1);
        assert_eq!(object["fits"], false, "{name}");
        assert!(!object["reasons"].as_array().unwrap().is_empty());
        assert!(begin.elapsed() < Duration::from_secs(60), "{name}: {:?}", begin.elapsed());
        place.ends("nsim run m.ron --input scene:noise", &[1]);
    }
}

#[test]
fn many_tensors_of_one_storage_are_refused() {
    let place = Place::new();
    let checkpoint = |name: &str, tensors: u32| {
        let tensor = |number| (format!("t{number}"), "0".to_string(), vec![1 << 20]);
        place.put(name, archive(&pickle((0..tensors).map(tensor)), std::iter::once(vec![0; 4 << 20])));
    };
    checkpoint("many.pt", 16_384);
    checkpoint("two.pt", 2);
    place.ends("nsim inspect many.pt", &[3]);
    place.ends("nsim import many.pt", &[3]);
    place.ends("nsim inspect two.pt", &[0]);
}

#[test]
fn packets_that_decompress_without_end_are_refused() {
    let place = Place::new();
    let mut packed = lz4_flex::frame::FrameEncoder::new(Vec::new());
    packed.write_all(&vec![0; 60 << 20]).unwrap();
    let packed = packed.finish().unwrap();
    // A flatbuffer's root table with one field, the compression: 1, LZ4.
    let header: [u8; 20] = [12, 0, 0, 0, 0, 0, 6, 0, 8, 0, 4, 0, 6, 0, 0, 0, 1, 0, 0, 0];
    let mut file = b"#!AER-DAT4.0\r\n".to_vec();
    file.extend((header.len() as u32).to_le_bytes());
    file.extend(header);
    for _ in 0..4 {
        file.extend(0u32.to_le_bytes());
        file.extend((packed.len() as u32).to_le_bytes());
        file.extend(&packed);
    }
    place.put("a.aedat4", file);
    let output = place.ends("nsim run ok.ron --input a.aedat4", &[3]);
    assert!(String::from_utf8_lossy(&output.stderr).contains("decompress"), "{output:?}");
}

#[test]
fn a_row_that_names_a_far_sample_costs_nothing() {
    let place = Place::new();
    for (steps, sample) in [(1, 30_000_000), (1, 1_000_000), (16_000_000, 7)] {
        place.put("far.csv", format!("# steps: {steps}\nsample,timestep,channel\n{sample},0,0\n"));
        let begin = Instant::now();
        let error = place.object("nsim run ok.ron --input far.csv", 3);
        assert_eq!(error["code"], "input.step", "{error}");
        assert!(begin.elapsed() < Duration::from_secs(20), "{:?}", begin.elapsed());
    }
    // Short files that are too long together.
    std::fs::create_dir(place.path("d")).unwrap();
    for sample in 0..9 {
        place.put(&format!("d/sample_{sample}_label_0.bs2"), [0, 0, 0, 0, 0]);
    }
    let error = place.object("nsim run ok.ron --input 'd?size=2,1&steps=16777216'", 3);
    assert_eq!(error["code"], "input.too-long", "{error}");
}

#[test]
fn a_long_time_constant_costs_no_more_than_a_short_one() {
    let place = Place::new();
    let srm = r#"Srm(name: "o", shape: [2], tau_sr_ms: 1e9, tau_ref_ms: 1.0, scale_ref: 2.0, theta: 10.0)"#;
    place.put("m.ron", model_with("Loihi(name: \"o\", shape: [2], du: 1, dv: 1, vth_mant: 8)", srm));
    let begin = Instant::now();
    place.ends("nsim agree m.ron --input 'scene:noise?samples=1&steps=300&seed=1'", &[0, 1, 3]);
    assert!(begin.elapsed() < Duration::from_secs(60), "{:?}", begin.elapsed());
}

#[test]
fn only_regular_files_are_replaced() {
    let place = Place::new();
    place.ends("mkfifo fifo; nsim map ok.ron -o fifo --force", &[2]);
    place.ends("test -p fifo", &[0]);
    place.ends("ln -s /dev/null null; nsim map ok.ron -o null --force", &[2]);
    place.ends("test -c null", &[0]);
    place.ends("nsim map ok.ron -o /dev/null --force", &[2]);
    place.ends("touch real; ln -s real link; nsim map ok.ron -o link --force; test -L link -a -s real", &[0]);
}

#[test]
fn pipes_without_a_writer_do_not_hang() {
    let place = Place::new();
    for name in ["p.bs2", "p.tact", "p.npy", "p.csv", "p.ron", "p.pt"] {
        place.ends(&format!("mkfifo {name}; timeout 60 $program run ok.ron --input {name}"), &[3]);
    }
    place.ends("timeout 60 $program map p.ron", &[3]);
    place.ends("timeout 60 $program inspect p.pt", &[3]);
    place.ends("nsim map <(cat ok.ron)", &[0]);
    let axis = r#"(paths: ["populations.o.vth_mant"], values: [8, 9])"#;
    place.put("sweep.ron", format!("Sweep(model: \"ok.ron\", input: [\"{NOISE}\"], grid: [{axis}])"));
    let output = place.ends("mkfifo t.csv.journal; timeout 60 $program sweep sweep.ron -o t.csv", &[3]);
    assert!(String::from_utf8_lossy(&output.stderr).contains("error[io.not-regular]"), "{output:?}");
}

#[test]
fn a_path_that_changes_nothing_is_refused() {
    let place = Place::new();
    let line = format!("energy ok.ron --input '{NOISE}' --baseline");
    // `nsim_files::changes` tests the refused paths and values.
    for (set, code) in [
        ("constants=nonsense(", "set.path"),
        ("target.=3", "set.path"),
        ("populations.o.vth_mant=9, dv: 3", "set.value"),
        ("target.limits.axons_in=(", "set.value"),
    ] {
        let object = place.object(&format!("nsim {line} --set '{set}'"), 3);
        assert!(object["code"] == code && object["help"].is_string(), "{set}: {object}");
        assert_eq!(place.object(&format!("nsim inspect ok.ron --set '{set}'"), 3)["code"], code, "{set}");
    }
    for both in [
        "--set populations.o.vth_mant=9 --set populations.1.vth_mant=8",
        "--set target.limits.axons_in=9 --set 'target.limits=(axons_in: 8)'",
        "--set target.limits=5 --set target.limits.axons_in=9",
    ] {
        assert_eq!(place.object(&format!("nsim {line} {both}"), 3)["code"], "set.path", "{both}");
    }
    place.ends(&format!("nsim {line} --set populations.o.vth_mant=9 --set target.limits.axons_in=900"), &[0]);
}

#[test]
fn a_name_controls_neither_terminal_nor_page_nor_picture() {
    let place = Place::new();
    let named = |name: &str| model_with("name: \"x\"", &format!("name: \"{name}\""));
    for name in ["small\\u{1}", "\\u{1b}[31mred", "two\\nlines", "\\u{202e}back", "\\u{9b}2J"] {
        place.put("m.ron", named(name));
        for picture in PICTURES.map(|ending| format!("c.{ending}")) {
            let object = place.object(&format!("nsim plot raster m.ron --input '{NOISE}' -o {picture}"), 2);
            assert_eq!(object["code"], "usage", "a format is for results");
            let output = place.ends(&format!("nsim plot raster m.ron --input '{NOISE}' -o {picture}"), &[3]);
            assert!(String::from_utf8_lossy(&output.stderr).contains("error[model.name]"), "{name}: {output:?}");
        }
        let shown = place.ends("nsim inspect m.ron", &[0]).stdout;
        assert!(!String::from_utf8(shown).unwrap().contains(['\u{1}', '\u{1b}', '\u{202e}', '\u{9b}']), "{name}");
    }
    place.put("m.ron", named("<!--<script>&"));
    place.ends(&format!("nsim report m.ron --input '{NOISE}' --baseline -o r.html"), &[0]);
    let page = std::fs::read_to_string(place.path("r.html")).unwrap();
    assert!(!page.contains("<!--<script>") && page.contains("\\u003c!--\\u003cscript>&"));
    place.ends(&format!("nsim plot raster m.ron --input '{NOISE}' -o r.svg"), &[0]);
    assert!(std::fs::read_to_string(place.path("r.svg")).unwrap().contains("&lt;!--&lt;script&gt;&amp;"));
    for line in [
        "run $'a\\e[2J.ron'",
        "run ok.ron --input $'b\\e[2J.npy'",
        "run ok.ron $'--\\e[2J'",
        "map ok.ron --set $'\\e[2J=1'",
    ] {
        let output = place.ends(&format!("nsim {line}"), &[2, 3]);
        assert!(!output.stderr.contains(&0x1b), "{line}: {output:?}");
    }
}

#[test]
fn a_mapping_that_could_not_be_run_is_no_deployment() {
    let place = Place::new();
    place.ends("nsim map ok.ron --target tiny -o good.ron", &[0]);
    let good = std::fs::read_to_string(place.path("good.ron")).unwrap();
    let line = format!("energy ok.ron --target tiny --input '{NOISE}' --baseline --deployment");
    place.ends(&format!("nsim {line} good.ron"), &[0]);
    let (hand, _) = good.split_once("    checksum: ").unwrap();
    let hand = format!("{hand})\n");
    place.put("m.ron", &hand);
    place.ends(&format!("nsim {line} m.ron"), &[0]);
    let (head, holds) = hand.split_once("cores: [").unwrap();
    let held = "population: \"o\", first: 0, count: 2";
    assert!(holds.contains(held), "{hand}");
    let mut cases = vec![
        (format!("{head}cores: [])"), "mapping.missing"),
        (format!("{head})"), "mapping.missing"),
        (hand.replace("model: \"x\"", "model: \"y\""), "mapping.model"),
        (hand.replace("\"tiny\"", "\"nahuku-32\""), "mapping.target"),
        (hand.replace("copies: 1", "copies: 0"), "mapping.copies"),
        (hand.replace(held, "population: \"ghost\", first: 0, count: 2"), "mapping.population"),
        (hand.replace(held, "population: \"o\", first: 0, count: 1"), "mapping.missing"),
        (hand.replace(held, "population: \"o\", first: 0, count: 3"), "mapping.run"),
        (hand.replace(held, "population: \"o\", at: \"0 1 1\""), "mapping.twice"),
        (hand.replace("cores: [", "cores: [(chip: 0, x: 1, y: 0, core: 0, holds: []),"), "mapping.empty"),
        (good.replace("core: 0", "core: 1"), "mapping.checksum"),
        (good.replace("seed: 0", "seed: 1"), "mapping.checksum"),
    ];
    cases.extend((0..hand.len() - 2).step_by(9).map(|end| (good[..end].to_string(), "mapping.syntax")));
    for (text, code) in cases {
        assert_ne!(text, hand);
        place.put("m.ron", &text);
        for line in [line.as_str(), &format!("run ok.ron --target tiny --input '{NOISE}' --mapping")] {
            let object = place.object(&format!("nsim {line} m.ron"), 3);
            let is_code = object["code"] == code || code == "mapping.syntax" && object["code"] == "io.utf8";
            assert!(is_code && (object["help"].is_string() || code == "mapping.syntax"), "{line} {text}: {object}");
        }
    }
}

#[test]
fn a_result_that_was_changed_is_refused() {
    let place = Place::new();
    place.ends(&format!("nsim energy ok.ron --input '{NOISE}' --baseline --format json > e.json"), &[0]);
    let good = std::fs::read_to_string(place.path("e.json")).unwrap();
    let energy = format!("\"energy_uj\": {}", serde_json::from_str::<Value>(&good).unwrap()["rows"][0]["energy_uj"]);
    assert!(good.contains(&energy), "{energy}");
    place.ends("nsim report e.json -o r.html", &[0]);
    for bad in [
        good.replace(&energy, &energy.replace(": ", ": 9")),
        good.replace("\"x\"", "\"y\""),
        good[..good.len() / 2].into(),
    ] {
        place.put("bad.json", bad);
        for line in ["report bad.json -o r.html --force", "plot energy bad.json -o e.svg"] {
            let output = place.ends(&format!("nsim {line}"), &[3]);
            let said = String::from_utf8_lossy(&output.stderr);
            assert!(said.contains("error[report.result]") && said.contains("help"), "{line}: {said}");
        }
    }
    // The layout of the text does not matter.
    place.put("again.json", serde_json::from_str::<Value>(&good).unwrap().to_string());
    place.ends("nsim report again.json -o again.html", &[0]);
}

#[test]
fn nested_brackets_cost_nothing() {
    let place = Place::new();
    for (open, close) in [("Some(", ")"), ("(", ")"), ("[", "]"), ("{1:", "}")] {
        let deep = format!("{}1{}", open.repeat(200_000), close.repeat(200_000));
        for (old, new) in [("du: 1", format!("du: {deep}")), ("to: \"o\"", format!("to: \"o\", delay: {deep}"))] {
            place.put("m.ron", model_with(old, &new));
            let begin = Instant::now();
            assert_eq!(place.object("timeout 60 $program inspect m.ron", 3)["code"], "model.syntax", "{open}");
            assert!(begin.elapsed() < Duration::from_secs(30), "{open}: {:?}", begin.elapsed());
        }
    }
}

/// Processor time of a command in seconds.
fn processor_s(place: &Place, line: &str) -> f64 {
    let output = place.ends(&format!("TIMEFORMAT='%U'; time {line} > /dev/null 2> /dev/null"), &[0]);
    let said = String::from_utf8_lossy(&output.stderr).replace(',', ".");
    said.trim().parse().unwrap_or_else(|_| panic!("{line}: {said}"))
}

#[test]
fn four_times_the_populations_take_about_four_times_as_long() {
    let place = Place::new();
    for count in [4_000, 16_000] {
        let one = |n: u32| format!("Loihi(name: \"p{n}\", shape: [2], du: 1, dv: 1, vth_mant: 1)");
        let into = |n: u32| {
            let from = if n == 0 { "in".to_string() } else { format!("p{}", n - 1) };
            format!("Sparse(from: [\"{from}\"], to: \"p{n}\", synapses: [(0, 0, 2)])")
        };
        let list = |of: &dyn Fn(u32) -> String| (0..count).map(of).collect::<Vec<_>>().join(",");
        let (populations, projections) = (list(&one), list(&into));
        place.put(
            &format!("{count}.ron"),
            format!(
                "Network(name: \"s\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [4]), {populations}],
                projections: [{projections}], output: \"p0\")"
            ),
        );
    }
    let noise = "--input 'scene:noise?samples=1&steps=10&seed=1' --baseline --force -o r.html";
    for line in ["inspect N.ron", "map N.ron", &format!("report N.ron {noise}")] {
        let [few, many] =
            ["4000", "16000"].map(|count| processor_s(&place, &format!("nsim {}", line.replace('N', count))));
        // A quadratic cost would take 16 times as long.
        assert!(many < 8.0 * few + 1.0, "{line}: {few} s and {many} s");
    }
}

#[test]
fn a_file_beyond_its_limit_is_an_error_and_leaves_nothing() {
    let place = Place::new();
    place.ends("ulimit -f 1; nsim scene slip --samples 2 --plot p.svg", &[3]);
    let left: Vec<_> = std::fs::read_dir(place.0.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left, ["ok.ron"]);
}

/// A shell line that runs the program, sends it a signal once a file exists, and ends with its
/// status.
fn signalled(signal: &str, file: &str, arguments: &str) -> String {
    format!(
        "$program {arguments} & pid=$!; while kill -0 $pid && [ ! -e {file} ]; do sleep 0.02; done 2>/dev/null; \
         kill -{signal} $pid 2>/dev/null; wait $pid"
    )
}

#[test]
fn signals_end_with_their_status_and_what_was_begun_is_completed_by_the_same_command() {
    let place = Place::new();
    for (signal, status) in [("INT", 130), ("TERM", 143)] {
        let folder = format!("s{status}");
        let line = format!("scene slip --samples 400 --seed 1 -o {folder} --format json");
        let output = place.run(&signalled(signal, &format!("{folder}/.nsim-unfinished"), &line));
        if output.status.code() == Some(0) {
            continue;
        }
        assert_eq!(output.status.code(), Some(status));
        let error: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(error["code"], "interrupted");
        place.ends(&format!("ls -A {folder} | grep -c 'nsim-.*tmp'"), &[1]);
        place.ends(&format!("nsim run --input {folder}/dataset.ron"), &[3]);
        place.ends(&format!("nsim scene slip --samples 40 --seed 1 -o {folder}"), &[0]);
        place.ends(&format!("nsim run vtsnn-slip --samples 0..2 --input {folder}/dataset.ron"), &[0]);
    }
}

#[test]
fn silence_is_no_agreement() {
    let place = Place::new();
    place.put("m.ron", model_with("vth_mant: 8", "vth_mant: 100000"));
    let object = place.object(&format!("nsim agree m.ron --against golden --input '{NOISE}'"), 0);
    assert_eq!(object["layers"][0]["coincidence"], Value::Null);
    let output = place.ends(&format!("nsim agree m.ron --against golden --input '{NOISE}'"), &[0]);
    assert!(!String::from_utf8_lossy(&output.stdout).contains("every spike agrees"));
}

#[test]
fn options_that_cannot_be_met_are_refused() {
    let place = Place::new();
    place.ends(&format!("nsim run ok.ron --input '{NOISE}' --samples 2..100"), &[2]);
    place.ends(&format!("nsim run ok.ron --input '{NOISE}' --samples 2.."), &[0]);
    place.ends(&format!("nsim run ok.ron --input '{NOISE}' --threads 1000000"), &[2]);
    let output = place.ends("nsim --help > /dev/full", &[3]);
    assert!(!output.stderr.is_empty());
    place.ends("nsim map ok.ron --svg p.gif", &[2]);
    assert!(!place.path("p.png").exists());
    for option in ["--plot", "-o"] {
        let error = place.object(&format!("nsim map ok.ron {option} -"), 2);
        assert_eq!(error["code"], "usage");
        let alone = place.ends(&format!("nsim map ok.ron {option} -"), &[0]);
        assert!(!String::from_utf8_lossy(&alone.stdout).contains("fits"), "{option}");
    }
    place.ends("nsim map ok.ron --svg - -o -", &[2]);
}

#[test]
fn one_process_is_enough() {
    let place = Place::new();
    // Without the right to start threads the command runs on one; root is never limited.
    let program = assert_cmd::cargo::cargo_bin("nsim");
    place.ends(&format!("ulimit -u 1; exec {} run ok.ron --input '{NOISE}' --threads 4", program.display()), &[0]);
}

#[test]
fn stored_trainings_are_the_same_bytes_however_they_were_interrupted() {
    let place = Place::new();
    let config = r#"Training(name: "s", timestep_ms: 1.0, inputs: [(name: "in", shape: [4])],
        layers: [(name: "out", from: ["in"], size: 3)],
        neuron: Srm(tau_sr_ms: Same(5.0), tau_ref_ms: 1.0, scale_ref: 2.0, theta: 1.0),
        loss: SpikeCount(right: 12, wrong: 2), optimiser: Adam(rate: 0.03), batch: 4, epochs: EPOCHS, seed: 3)"#;
    place.put("t.ron", config.replace("EPOCHS", "20"));
    std::fs::create_dir(place.path("d")).unwrap();
    for sample in 0..9u32 {
        let spikes = (0..120u32).map(|at| u8::from((at * 7 + sample * 13) % (5 + sample % 3) == 0));
        let mut npy = Vec::new();
        nsim::files::npy::write(&mut npy, &[4, 30], spikes).unwrap();
        place.put(&format!("d/sample_{sample}_label_{}.npy", sample % 3), npy);
    }
    // After a signal the last finished epoch is kept, and the command resumes from it.
    let line = "train t.ron --train d --set epochs=EPOCHS --checkpoint c.st --log c.csv -o c.ron --force --format json";
    let line = line.replace("EPOCHS", "4000");
    let output = place.run(&signalled("INT", "c.st", &line));
    if output.status.code() != Some(0) {
        assert_eq!(output.status.code(), Some(130));
        let error: Value = serde_json::from_slice(&output.stdout).unwrap();
        let message = error["message"].as_str().unwrap();
        assert!(message.contains("of 4000 epochs are stored in c.st"), "{message}");
        place.ends(&format!("nsim {line}"), &[0]);
        place.ends(&format!("nsim {}", line.replace("c.", "w.")), &[0]);
        for ending in ["st", "csv", "safetensors"] {
            let bytes = |name: &str| std::fs::read(place.path(&format!("{name}.{ending}"))).unwrap();
            assert!(bytes("c") == bytes("w"), "{ending} differs after a signal");
        }
    }
}

#[test]
fn a_scene_whose_writer_was_killed_is_refused_and_made_anew() {
    let place = Place::new();
    place.ends("nsim scene slip --samples 40 --seed 1 -o s", &[0]);
    // State after a kill: the marker without a lock, and no manifest.
    std::fs::remove_file(place.path("s/dataset.ron")).unwrap();
    place.put("s/.nsim-unfinished", "");
    place.ends("nsim run vtsnn-slip --input s/dataset.ron", &[3]);
    place.ends("nsim run slip-tactile --input s/tactile", &[3]);
    place.ends("nsim scene slip --samples 40 --seed 2 -o s", &[0]);
    assert!(!place.path("s/.nsim-unfinished").exists());
}
