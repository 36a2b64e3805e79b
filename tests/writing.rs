//! Faults of the disk, injected into every command that writes or reads files: what it writes is
//! absent, old or complete, and never of two generations side by side; what it prints is right, or
//! its status says that it failed.
//!
//! A command runs without a fault once for the old files and once for the new ones, and names its
//! operations on the file system. Then it runs with a fault in each of them, in an empty folder and
//! on the old files, and once more without. Some operations are left out to save time;
//! `NSIM_FAULTS=all` takes every one.

// A test that cannot go on has failed.
#![allow(clippy::unwrap_used)]
#![cfg(unix)]

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use rayon::prelude::*;

/// A command: its arguments with GEN for what differs between generations.
struct Case {
    arguments: &'static str,
    generations: [&'static str; 2],
    /// Whether it takes a second or more, so that only every hundredth operation fails.
    slow: bool,
}

const fn case(arguments: &'static str, old: &'static str, new: &'static str) -> Case {
    Case { arguments, generations: [old, new], slow: false }
}

/// Commands that write. Inputs lie in `i`.
const WRITING: [Case; 48] = [
    case("map i/GEN.ron -o m.ron", "a", "b"),
    case("map i/GEN.ron --plot m.svg", "a", "b"),
    case("map i/GEN.ron --pareto p.svg --time-budget 0", "a", "b"),
    case("map i/GEN.ron -o deep/er/m.ron --plot m.png --pareto p.pdf", "a", "b"),
    // These are large enough for the cache: what it holds is old or complete, and no fault in it is
    // one of the command.
    case("map i/GEN.ron", "large-a", "large-b"),
    case("map i/GEN.ron -o m.ron", "large-a", "large-a"),
    case("map i/GEN.ron -o -", "a", "b"),
    case("map i/GEN.ron --svg -", "a", "b"),
    case("plot raster i/GEN.ron --input scene:noise?samples=1&steps=9 -o r.svg", "a", "b"),
    case("plot voltage i/GEN.ron --input i/labels.ron --probe o -o v.pdf", "a", "b"),
    case("plot map i/GEN.ron -o m.png", "a", "b"),
    case("plot agreement i/GEN.json -o a.svg", "agree-one", "agree-two"),
    case("export i/GEN.ron -o m.nir", "a", "b"),
    case("export i/GEN.ron -o m.nir --format csv", "w", "x"),
    case("import i/GEN.nir -o m.ron --format json", "w", "x"),
    case("import i/GEN.nir -o m.ron --dt 1", "a", "b"),
    case("scene slip --samples 3 --seed GEN -o s", "1", "2"),
    case("scene slip --samples 2 --seed GEN -o s --plot s.svg --format json", "1", "2"),
    case("scene container --samples 1 --seed GEN --plot s.svg", "1", "2"),
    case("run i/GEN.ron --input scene:noise?samples=1&steps=9 --probe o.spikes --probe o.v -o p", "a", "b"),
    case("run i/GEN.ron --input i/e.csv --probe o.u --probe-format csv -o p --format json", "a", "b"),
    case("run i/GEN.ron --input i/e.npy --probe o.v --probe o.u --probe-format nir -o p", "a", "b"),
    case("run i/GEN.ron --input i/labels.ron --steps s.npy --probe i* --probe *.v -o p", "a", "b"),
    case("run i/GEN.ron --input scene:noise?samples=2&steps=9 --steps s.csv --format json", "a", "b"),
    case("energy i/GEN.ron --baseline --input scene:noise?samples=1&steps=9 --steps s.csv", "a", "b"),
    case("report i/GEN.ron --baseline --input scene:noise?samples=1&steps=9 -o page.html", "a", "b"),
    case("report i/GEN.json i/one.json -o page.html", "one", "two"),
    case("help --man GEN", "one", "two"),
    case("train i/t.ron --set seed=GEN --log l.csv -o m.ron", "1", "2"),
    case("train i/t.ron --set seed=1 --checkpoint GEN.st -o m.ron --format json", "1", "2"),
    case("train i/t.ron --seed GEN --log - -o m.ron", "1", "2"),
    case("energy i/GEN.ron --baseline rtx-2080-ti --input scene:noise?samples=1&steps=9 --plot e.svg", "a", "b"),
    case("energy i/GEN.ron --baseline rtx-2080-ti --input scene:noise?samples=1&steps=9 --export-sanafe s", "a", "b"),
    case("sweep i/GEN.ron -o t.csv", "sweep-a", "sweep-b"),
    case("sweep i/GEN.ron -o t.csv --plot t.svg --axes threshold,spikes --format json", "sweep-a", "sweep-b"),
    case("agree i/GEN.ron --input scene:noise?samples=1&steps=9 --plot-causes g.svg", "a", "b"),
    case("agree i/GEN.ron --input i/e.npy --against i/b.ron --plot g.svg", "a", "r"),
    case("agree i/GEN.ron --input scene:noise?samples=1&steps=9 --update page.md --force", "a", "b"),
    case("convert i/GEN.ron --input scene:noise?samples=2&steps=9 -o m.ron", "r", "q"),
    case("convert i/GEN.ron --input scene:noise?samples=2&steps=9 --update page.md --force --format json", "r", "q"),
    case("bench early i/GEN.ron --input i/labels.ron -o early --plot e.svg", "a", "b"),
    case(
        "bench batch i/GEN.ron --input scene:noise?samples=1&steps=9 --sizes 1,2 --seconds 0.000001 --plot p.svg",
        "a",
        "b",
    ),
    case("bench pareto i/GEN.ron --input scene:noise?samples=1&steps=9 --seconds 0.000001 --plot p.svg", "a", "b"),
    case(
        "bench pareto i/GEN.ron --input scene:noise?samples=1&steps=9 --seconds 0.000001 --update page.md --force",
        "a",
        "b",
    ),
    case("run i/GEN.ron --mapping i/GEN-map.ron --input i/labels.ron --probe o.spikes -o p --format json", "a", "b"),
    case("bench paper --stored --results i/GEN-rows.json --markdown t.md", "one", "two"),
    case(
        "bench paper --train runs --cell slip-GEN --neurons loihi --scenes 4 --folds 2 --epochs 0 -o r.json",
        "tactile",
        "vision",
    ),
    Case { arguments: "bench published --plot GEN.svg --preset GEN.ron", generations: ["one", "two"], slow: true },
];

/// Commands that only read.
const READING: [&str; 19] = [
    "inspect i/w.nir",
    "inspect i/a.ron --format json",
    "inspect i/many.safetensors",
    "run i/a.ron --input i/e.npy --format json",
    "run i/a.ron --input i/e.csv --format json",
    "run i/a.ron --input i/e.npz --format json",
    "run i/a.ron --input i/e.npy --labels i/labels.npy --format json",
    "run i/a.ron --input i/events.csv?polarity=merge&steps=9 --format json",
    "run i/a.ron --input i/labels.ron --format json",
    "run i/v.ron --input i/d --format json",
    "run i/v.ron --input i/events.bs2?size=6,2&polarity=merge --format json",
    "run i/v.ron --input i/events.aedat4?size=6,2&polarity=merge&steps=9 --format json",
    "run i/w.nir --input i/d --format json",
    "map i/a.ron --target i/target.ron",
    "import i/set-fc1.npy --neuron i/neuron.yaml --format json",
    "import i/checkpoint.pt --neuron i/neuron.yaml --format json",
    "import i/every-layer.net --format json",
    "energy i/a.ron --baseline rtx-2080-ti --input i/e.npy --constants i/constants.ron --format json",
    "agree i/a.ron --against i/b.ron --input i/e.npy --format json",
];

/// Kinds of faults and the classes of operations that they befall.
const KINDS: [(&str, &[&str]); 15] = [
    ("kill", &["Write", "Make", "Change"]),
    ("power", &["Write", "Make", "Change"]),
    ("torn", &["Write"]),
    ("eio", &["Write", "Make", "Change"]),
    ("broken", &["Write", "Make", "Change"]),
    ("enospc", &["Write", "Make", "Change"]),
    ("full", &["Write", "Make"]),
    ("short", &["Write"]),
    ("partial", &["Write"]),
    ("interrupted", &["Write"]),
    ("read-eio", &["Read", "Look"]),
    ("read-broken", &["Read", "Look"]),
    ("read-partial", &["Read"]),
    ("read-interrupted", &["Read"]),
    ("read-end", &["Read"]),
];

type Files = BTreeMap<String, Vec<u8>>;

/// What a folder holds besides its inputs.
fn files(folder: &Path) -> Files {
    let mut found = Files::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(next) = folders.pop() {
        for entry in std::fs::read_dir(next).unwrap() {
            let entry = entry.unwrap();
            let path = entry.path();
            if entry.file_type().unwrap().is_dir() {
                folders.push(path);
            } else if entry.file_type().unwrap().is_file() {
                let name = path.strip_prefix(folder).unwrap().display().to_string();
                found.insert(name, std::fs::read(path).unwrap());
            }
        }
    }
    found
}

/// A folder in memory where there is one: it holds more files in a second than a disk.
fn folder() -> tempfile::TempDir {
    let memory = Path::new("/dev/shm");
    let mut builder = tempfile::Builder::new();
    builder.prefix("nsim-writing-");
    if memory.is_dir() { builder.tempdir_in(memory).or_else(|_| builder.tempdir()) } else { builder.tempdir() }.unwrap()
}

fn npy(shape: &str, bytes: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': '|u1', 'fortran_order': False, 'shape': {shape}, }}\n");
    let mut npy = b"\x93NUMPY\x01\x00".to_vec();
    npy.extend((header.len() as u16).to_le_bytes());
    npy.extend(header.bytes());
    npy.extend(bytes);
    npy
}

fn prepare(i: &Path) {
    let put = |name: &str, content: &[u8]| std::fs::write(i.join(name), content).unwrap();
    let network = |inputs: usize, neurons: &str, weights: &str| {
        format!(
            "Network(name: \"x\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [{inputs}]), {neurons}], \
             projections: [Dense(from: [\"in\"], to: \"o\", weights: {weights})], output: \"o\")"
        )
    };
    let loihi = |units: usize| format!("Loihi(name: \"o\", shape: [{units}], du: 1024, dv: 1024, vth_mant: 8)");
    let srm = "Srm(name: \"o\", shape: [2], tau_sr_ms: 5, tau_ref_ms: 1, scale_ref: 2, theta: 1)";
    for (name, weight) in [("a", 20), ("b", 26)] {
        let weights = format!("[[{weight}, 2, 2, 2], [2, 2, {weight}, 2]]");
        put(&format!("{name}.ron"), network(4, &loihi(2), &weights).as_bytes());
    }
    for (name, weight) in [("r", 0.75), ("q", 0.5)] {
        let weights = format!("[[{weight}, 0.25, 0.5, 0.5], [0.25, 0.5, {weight}, 0.125]]");
        put(&format!("{name}.ron"), network(4, srm, &weights).as_bytes());
    }
    // Larger ones, whose arrays lie beside the model that they are imported to.
    for (name, weight) in [("w", 20), ("x", 26)] {
        let rows = vec![format!("[{}]", vec![weight.to_string(); 12].join(", ")); 3].join(", ");
        put(&format!("{name}.ron"), network(12, &loihi(3), &format!("[{rows}]")).as_bytes());
    }
    for (name, seed) in [("large-a", 1), ("large-b", 2)] {
        let random = network(250, &loihi(90), &format!("Uniform(low: -8, high: 8, step: 2, seed: {seed})"));
        put(&format!("{name}.ron"), random.as_bytes());
    }
    put("v.ron", network(12, &loihi(3), "Npy(\"v.npy\")").as_bytes());
    put("v.npy", &npy("(3, 12)", &[20; 36]));
    let training = r#"Training(name: "s", timestep_ms: 1.0, inputs: [(name: "in", shape: [12])],
        layers: [(name: "out", from: ["in"], size: 3)],
        neuron: Srm(tau_sr_ms: Same(5.0), tau_ref_ms: 1.0, scale_ref: 2.0, theta: 1.0),
        loss: SpikeCount(right: 12, wrong: 2), optimiser: Adam(rate: 0.03), batch: 4, epochs: 2, seed: 3,
        train: ["i/d"])"#;
    put("t.ron", training.as_bytes());
    std::fs::create_dir(i.join("d")).unwrap();
    for sample in 0..4u8 {
        let spikes: Vec<u8> = (0..60).map(|at| u8::from((at + sample) % 3 == 0)).collect();
        put(&format!("d/sample_{sample}_label_{}.npy", sample % 2), &npy("(12, 5)", &spikes));
    }
    put("e.npy", &npy("(4, 9)", &(0..36).map(|at| u8::from(at % 3 == 0)).collect::<Vec<u8>>()));
    put("labels.npy", &npy("(1,)", &[1]));
    put("events.csv", b"p,t,x\n1,0,0\n0,1000,1\n1,4000,3\n");
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, array) in [("in.npy", npy("(1, 4, 9)", &[1; 36])), ("y.npy", npy("(1,)", &[1]))] {
        zip.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        zip.write_all(&array).unwrap();
    }
    put("e.npz", &zip.finish().unwrap().into_inner());
    put("e.csv", b"# steps: 9\n0,0\n1,1\n2,2\n3,3\n5,0\n7,2\n");
    put(
        "labels.ron",
        br#"DataSet(name: "l", populations: {"in": "in"}, samples: [
            (files: {"in": "e.npy"}, label: Some(0)), (files: {"in": "e.npy"}, label: Some(1))])"#,
    );
    for name in ["a", "b"] {
        let sweep = format!(
            "Sweep(model: \"i/{name}.ron\", input: [\"i/e.npy\"], grid: [(name: \"threshold\", paths: \
             [\"populations.o.vth_mant\"], values: [4, 8, 9])])"
        );
        put(&format!("sweep-{name}.ron"), sweep.as_bytes());
    }
    for (name, accuracy) in [("one", "0.5"), ("two", "0.25")] {
        let rows = format!(
            "{{\"rows\": [{{\"table\": \"accuracy\", \"task\": \"slip\", \"modality\": \"both\", \"loss\": \"count\", \
             \"quantity\": \"accuracy\", \"measured\": {accuracy}, \"note\": \"made up\"}}]}}"
        );
        put(&format!("{name}-rows.json"), rows.as_bytes());
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for (name, source) in [
        ("checkpoint.pt", "tests/fuzz/corpus/checkpoint/zip"),
        ("every-layer.net", "tests/fuzz/corpus/hdf5/netx_every_layer"),
        ("neuron.yaml", "tests/fuzz/corpus/yaml/srm"),
        ("many.safetensors", "models/container-tactile.safetensors"),
        ("target.ron", "mapping/targets/tiny.ron"),
        ("constants.ron", "mapping/constants/davies2018.ron"),
    ] {
        put(name, &std::fs::read(root.join(source)).unwrap());
    }
    put("set-fc1.npy", &npy("(3, 12)", &[1; 36]));
    put("set-fc2.npy", &npy("(2, 3)", &[1; 6]));
    // x, y, and 24 bits of polarity and microseconds.
    put("events.bs2", &(0..40u8).flat_map(|at| [at % 6, at % 2, 0, at, 0]).collect::<Vec<u8>>());
    // The corpus has a byte before each file, which says how it is read.
    put("events.aedat4", &std::fs::read(root.join("tests/fuzz/corpus/events/aedat4_zstd")).unwrap()[1..]);
    for name in ["one", "two"] {
        put(&format!("{name}.json"), format!("{{\"schema\": \"nsim.run/1\", \"model\": \"{name}\"}}").as_bytes());
    }
    for (name, layer) in [("agree-one", "hidden"), ("agree-two", "out")] {
        let layers = format!("[{{\"name\": \"{layer}\", \"coincidence\": 0.5}}]");
        put(&format!("{name}.json"), format!("{{\"schema\": \"nsim.agree/1\", \"layers\": {layers}}}").as_bytes());
    }
    let page = |mark: &str| format!("# A page\n<!-- {mark} x -->\nold\n<!-- end {mark} x -->\nmore\n");
    put("page.md", ["agree", "convert", "pareto"].map(page).concat().as_bytes());
    let here = i.parent().unwrap();
    for line in [
        "export i/w.ron -o i/w.nir",
        "export i/x.ron -o i/x.nir",
        "export i/a.ron -o i/a.nir",
        "export i/b.ron -o i/b.nir",
        "map i/a.ron -o i/a-map.ron",
        "map i/b.ron -o i/b-map.ron",
    ] {
        let ran = run(here, line, None);
        assert_eq!(ran.status, Some(0), "{line}: {}", ran.said);
    }
}

/// How a command ended.
struct Ran {
    status: Option<i32>,
    printed: Vec<u8>,
    said: String,
}

fn run(folder: &Path, line: &str, fault: Option<&str>) -> Ran {
    let mut command = Command::new(assert_cmd::cargo::cargo_bin("nsim"));
    command.args(line.split(' ')).args(["--threads", "1"]).current_dir(folder).stdin(Stdio::null());
    if let Some(fault) = fault {
        command.env("NSIM_FAULT", fault);
    }
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!said.contains("fault of nsim"), "{line} {fault:?}: {said}");
    Ran { status: output.status.code(), printed: output.stdout, said }
}

/// A folder that holds these files, and the inputs.
fn place(content: &Files, inputs: &Path) -> tempfile::TempDir {
    let folder = folder();
    std::os::unix::fs::symlink(inputs, folder.path().join("i")).unwrap();
    for (name, bytes) in content {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
    folder
}

/// A command on what is there before it, without a fault.
struct Expected {
    line: String,
    before: Files,
    after: Files,
    printed: Vec<u8>,
    status: i32,
    /// How many operations of each class there are.
    operations: BTreeMap<String, u64>,
    stride: u64,
}

impl Expected {
    fn new(line: String, before: Files, inputs: &Path, stride: u64) -> Expected {
        let again = || {
            let folder = place(&before, inputs);
            let ran = run(folder.path(), &line, Some("list:1"));
            assert!(matches!(ran.status, Some(0 | 1)), "{line}: {:?}: {}", ran.status, ran.said);
            (ran, files(folder.path()))
        };
        let (one, after) = again();
        let mut operations = BTreeMap::new();
        for class in one.said.lines().filter_map(|line| line.strip_prefix("operation: ")) {
            *operations.entry(class.to_string()).or_insert(0) += 1;
        }
        Expected { status: one.status.unwrap(), printed: one.printed, line, before, after, operations, stride }
    }

    /// The same file, or a whole one with other figures.
    fn is_new(&self, name: &str, bytes: &[u8]) -> bool {
        let Some(new) = self.after.get(name) else { return false };
        let alike = |one: &[u8], other: &[u8]| {
            let (first, last) = (24.min(one.len()), one.len().saturating_sub(6));
            other.starts_with(&one[..first]) && other.ends_with(&one[last..]) && other.len() * 4 > one.len() * 3
        };
        // Measured times differ from run to run.
        let measured = ["bench pareto", "bench batch"].iter().any(|line| self.line.starts_with(line));
        let times = name.starts_with("runs/") && name.ends_with(".json") || measured;
        new == bytes || times && alike(new, bytes)
    }

    /// Whether this was printed, but for lines with measured times.
    fn is_printed(&self, printed: &[u8]) -> bool {
        let times = ["wall_s", "us_per_timestep", "us a timestep", "ms: ", "\"seconds\"", "\"checksum\"", " s,"];
        let steady = |printed: &[u8]| {
            // A line that is too long goes on behind two spaces.
            let text = String::from_utf8_lossy(printed).replace("\n  ", " ");
            let lines =
                text.lines().filter(|line| !line.ends_with(" s") && !times.iter().any(|time| line.contains(time)));
            lines.map(str::to_string).collect::<Vec<_>>()
        };
        // Each line of these has some.
        let measured = ["bench pareto", "bench batch"].iter().any(|line| self.line.starts_with(line));
        measured || steady(printed) == steady(&self.printed)
    }

    /// Whether all is there; whether something is kept in the cache is not for the command to say.
    fn is_complete(&self, there: &Files) -> bool {
        let own = |files: &Files| files.keys().filter(|name| !name.starts_with("cache/")).cloned().collect::<Vec<_>>();
        own(there) == own(&self.after)
            && there.iter().all(|(name, bytes)| name.starts_with("cache/") || self.is_new(name, bytes))
    }

    /// What is there after a fault is old or new, and not both where files belong together.
    fn check(&self, what: &str, there: &Files) {
        let (mut olds, mut news) = (Vec::new(), Vec::new());
        for (name, bytes) in there.iter().filter(|(name, _)| !name.contains(".nsim-") && !name.ends_with(".journal")) {
            let (is_old, is_new) = (self.before.get(name) == Some(bytes), self.is_new(name, bytes));
            assert!(is_old || is_new, "{what}: {name} is neither old nor new");
            if is_old != is_new {
                if is_old { &mut olds } else { &mut news }.push(name.as_str());
            }
        }
        // A folder of recordings may hold both while it says that it is unfinished; pictures,
        // histories, documents and checkpoints are files on their own, as are the runs of a study.
        let unfinished = there.contains_key("s/.nsim-unfinished") && !there.contains_key("s/dataset.ron");
        let apart = |name: &&str| {
            [".svg", ".csv", ".st", ".md", ".png", ".pdf"].iter().any(|end| name.ends_with(end))
                || name.starts_with("runs/")
        };
        if !self.line.contains("bench early") {
            olds.retain(|name| !apart(name));
            news.retain(|name| !apart(name));
        }
        assert!(olds.is_empty() || news.is_empty() || unfinished, "{what}: {olds:?} are old, {news:?} new");
        for run in there.keys().filter(|name| name.starts_with("runs/") && name.ends_with(".json")) {
            for other in ["ron", "safetensors"].map(|end| run.replace("json", end)) {
                assert!(there.contains_key(&other), "{what}: {run} stands there without {other}");
            }
        }
    }

    /// The numbers of the operations that fail, for a kind.
    fn numbers(&self, kind: usize) -> Vec<u64> {
        let count = KINDS[kind].1.iter().filter_map(|class| self.operations.get(*class)).sum::<u64>();
        let offset = (self.line.len() + kind) as u64;
        (1..=count).filter(|number| (number + offset).is_multiple_of(self.stride)).collect()
    }

    /// Injects a fault and judges what becomes of it.
    fn inject(&self, kind: &str, number: u64, inputs: &Path) {
        let folder = place(&self.before, inputs);
        let fault = format!("{kind}:{number}");
        let what = format!("{} with {fault}", self.line);
        let ran = run(folder.path(), &self.line, Some(&fault));
        assert!(ran.said.contains("injected:"), "{what}: nothing was injected");
        let good = Some(self.status);
        let there = files(folder.path());
        match kind {
            "kill" | "power" | "torn" => assert_eq!(ran.status, Some(137), "{what}"),
            // These are no errors.
            "partial" | "interrupted" | "read-partial" | "read-interrupted" => {
                assert_eq!(ran.status, good, "{what}: {}", ran.said);
            }
            _ => assert!(ran.status == good || matches!(ran.status, Some(2 | 3)), "{what}: {:?}", ran.status),
        }
        self.check(&what, &there);
        if ran.status == good {
            assert!(self.is_complete(&there), "{what} says that it is done and leaves {:?}", there.keys());
            let printed = || String::from_utf8_lossy(&ran.printed).into_owned();
            assert!(self.is_printed(&ran.printed), "{what} prints something else: {}", printed());
            return;
        }
        if matches!(ran.status, Some(2 | 3)) {
            let left = there.keys().find(|name| name.ends_with(".tmp"));
            assert!(left.is_none() || kind == "broken", "{what} leaves {left:?}");
            // What it could not replace is still there; a disk that is broken for good cannot be
            // helped.
            let lost = self.before.keys().find(|name| !there.contains_key(*name));
            let unfinished = there.contains_key("s/.nsim-unfinished");
            assert!(lost.is_none() || unfinished || kind == "broken", "{what} loses {lost:?}");
        }
        if there != self.before {
            // The same command again completes it and tidies up.
            let again = run(folder.path(), &format!("{} --force", self.line.replace(" --force", "")), None);
            assert_eq!(again.status, good, "{what}, then again: {}", again.said);
            let there = files(folder.path());
            assert!(self.is_complete(&there), "{what}, then again: {:?}", there.keys());
        }
    }
}

#[test]
fn every_command_writes_all_or_nothing_and_says_what_it_could_not_read() {
    let all = std::env::var("NSIM_FAULTS").is_ok_and(|value| value == "all");
    let stride = |slow: bool| match (all, slow) {
        (true, false) => 1,
        (true, true) => 100,
        (false, false) => 7,
        (false, true) => u64::MAX,
    };
    let shared = folder();
    let inputs = shared.path().join("i");
    std::fs::create_dir(&inputs).unwrap();
    prepare(&inputs);
    let page = Files::from([("page.md".to_string(), std::fs::read(inputs.join("page.md")).unwrap())]);
    let nothing = |line: &str| if line.contains("page.md") { page.clone() } else { Files::new() };
    let writing = WRITING.par_iter().filter(|case| all || !case.slow).flat_map_iter(|case| {
        let [old, new] = case.generations.map(|name| case.arguments.replace("GEN", name));
        let folder = place(&nothing(&old), &inputs);
        let ran = run(folder.path(), &old, None);
        assert!(matches!(ran.status, Some(0 | 1)), "{old}: {}", ran.said);
        let forced = format!("{} --force", new.replace(" --force", ""));
        let stride = stride(case.slow);
        let fresh = Expected::new(new.clone(), nothing(&new), &inputs, stride);
        let replaced = (!case.slow).then(|| Expected::new(forced, files(folder.path()), &inputs, stride));
        [Some(fresh), replaced].into_iter().flatten()
    });
    let reading =
        READING.par_iter().map(|line| Expected::new((*line).to_string(), Files::new(), &inputs, stride(false)));
    let expected: Vec<Expected> = writing.chain(reading).collect();
    let faults: Vec<(&Expected, usize, u64)> = expected
        .iter()
        .flat_map(|one| {
            (0..KINDS.len()).flat_map(move |kind| one.numbers(kind).into_iter().map(move |n| (one, kind, n)))
        })
        .collect();
    let judged = |&(one, kind, number): &(&Expected, usize, u64)| {
        let injected = std::panic::catch_unwind(|| one.inject(KINDS[kind].0, number, &inputs));
        injected.err().map(|wrong| wrong.downcast_ref::<String>().cloned().unwrap_or_default())
    };
    let wrong: Vec<String> = faults.par_iter().filter_map(judged).collect();
    let count = |index: usize| faults.iter().filter(|(_, kind, _)| *kind == index).count();
    let counts: Vec<String> = (0..KINDS.len()).map(|kind| format!("{} {}", KINDS[kind].0, count(kind))).collect();
    println!("{} faults in {} commands: {}", faults.len(), expected.len(), counts.join(", "));
    assert!(wrong.is_empty(), "{} faults do harm:\n{}", wrong.len(), wrong.join("\n"));
    assert!(faults.len() > if all { 5000 } else { 500 }, "only {} faults", faults.len());
}

/// Every option that takes a file or a folder is one that is read, or stands in a command above.
#[test]
fn every_option_that_writes_is_tried() {
    const READ: [&str; 10] = [
        "--mapping",
        "--image",
        "--neuron",
        "--constants",
        "--deployment",
        "--against",
        "--input",
        "--labels",
        "--training",
        "--merge",
    ];
    let commands = [
        "map", "run", "energy", "plot", "report", "help", "agree", "convert", "scene", "sweep", "train", "import",
        "export", "inspect", "stress",
    ];
    let benches = ["step", "map", "batch", "early", "pareto", "published"].map(|name| format!("bench {name}"));
    for command in commands.map(str::to_string).iter().chain(&benches) {
        let help = run(Path::new("."), &format!("{command} --help"), None).printed;
        for line in String::from_utf8(help).unwrap().lines().map(str::trim_start).filter(|line| line.starts_with('-')) {
            let takes_file = ["FILE", "DIR", ".ron>", ".svg>", ".md>", ".csv>", ".nir>", "<OUTPUT>"];
            if !takes_file.iter().any(|name| line.contains(name)) {
                continue;
            }
            let options: Vec<&str> = line.split([' ', ',']).filter(|word| word.starts_with('-')).collect();
            let tried = |case: &Case| {
                let words: Vec<&str> = case.arguments.split(' ').collect();
                case.arguments.starts_with(command.as_str()) && options.iter().any(|option| words.contains(option))
            };
            let is_read = options.iter().any(|option| READ.contains(option));
            assert!(is_read || WRITING.iter().any(tried), "{command} {options:?} is not tried");
        }
    }
}

/// A path for what is read only when something fails.
#[test]
fn inputs_are_not_written() {
    let shared = folder();
    let inputs: PathBuf = shared.path().join("i");
    std::fs::create_dir(&inputs).unwrap();
    prepare(&inputs);
    let before = files(&inputs);
    for line in READING {
        run(shared.path(), line, None);
    }
    assert!(files(&inputs) == before);
}
