//! The whole command line on generated and mutated input: for any input it ends with a documented
//! status.
//!
//! Input: the number of a case, from which files and arguments are generated. A grammar makes a
//! model, a training file or a data set, with numbers that are often at or beyond a limit; or a
//! stored file of any kind has bytes, digits or pieces changed. Output: a status of 0 to 3 within
//! bounds on time and memory, without a panic. `NSIM_FUZZ=A..B` runs other cases than the default
//! ones. A failure names its case and keeps its files.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use nsim::ir::base::rng;
use rayon::prelude::*;

/// Cases of the normal tests; `.ci/nightly` runs ten times as many.
const CASES: u64 = 1_000;
/// Limits of processor time and of elapsed time: machines that run tests and other work are slow.
const LONGEST: Duration = Duration::from_secs(20);
const LONGEST_WAIT: Duration = Duration::from_secs(600);
/// Memory limit: a constant, this multiple of the input, and this many bytes for each weight that
/// the model generates from a seed.
const MOST_KIB: u64 = 256 << 10;
const MOST_TIMES: u64 = 32;
const MOST_DRAWN: u64 = 48;

struct Draw {
    case: u64,
    at: u64,
}

impl Draw {
    fn below(&mut self, end: usize) -> usize {
        self.at += 1;
        rng::below(end as u64, 0xf022, self.case, self.at) as usize
    }

    fn chance(&mut self, percent: usize) -> bool {
        self.below(100) < percent
    }

    fn one<'a>(&mut self, items: &[&'a str]) -> &'a str {
        items[self.below(items.len())]
    }

    fn word<'a>(&mut self, line: &'a str) -> &'a str {
        self.one(&line.split(' ').collect::<Vec<_>>())
    }

    /// A number as text: mostly an ordinary one, sometimes one at a limit or beyond.
    fn number(&mut self) -> &'static str {
        let usual = "0 1 2 3 4 8 64 128 255";
        let rare = "-1 -8 1000 4096 5000 65536 1000000 100000000 4294967296 9223372036854775807 \
                    18446744073709551616 -9223372036854775809 0.5 1e-300 1e300 1e999 nan inf -0.0 \"x\" [] None true";
        if self.chance(80) { self.word(usual) } else { self.word(rare) }
    }
}

/// A model; for a conversion its last layers are spike response neurons.
fn model(draw: &mut Draw, real: bool) -> String {
    let mut text = String::from("Network(name: \"f\", timestep_ms: ");
    let _ = write!(
        text,
        "{}, populations: [Input(name: \"in\", shape: [{}])",
        draw.one(&["1.0", "1", "0.1"]),
        draw.number()
    );
    let count = 1 + draw.below(3);
    for index in 0..count {
        let shape = match draw.below(4) {
            0 => format!("{}, {}, {}", draw.number(), draw.number(), draw.number()),
            _ => draw.number().to_string(),
        };
        let kind = match if real { 0 } else { draw.below(4) } {
            0 => format!("tau_sr_ms: {}, tau_ref_ms: 1.0, scale_ref: 2.0, theta: {}", draw.number(), draw.number()),
            1 => format!("tau_u_ms: {}, tau_v_ms: {}, vth: {}", draw.number(), draw.number(), draw.number()),
            _ => format!("du: {}, dv: {}, vth_mant: {}", draw.number(), draw.number(), draw.number()),
        };
        let name = if kind.contains("tau_sr") { "Srm" } else { "Loihi" };
        let _ = write!(text, ", {name}(name: \"p{index}\", shape: [{shape}], {kind})");
    }
    text += "], projections: [";
    for index in 0..=count {
        let to = format!("p{}", index % count);
        let from = if index == 0 || draw.chance(30) { "in".to_string() } else { format!("p{}", index - 1) };
        let numbers = |draw: &mut Draw, count: usize| (0..count).map(|_| draw.number()).collect::<Vec<_>>().join(", ");
        let ends = format!("from: [\"{from}\"], to: \"{to}\"");
        let projection = match draw.below(7) {
            0 => format!(
                "Random({ends}, fan_out: {}, low: {}, high: {}, seed: 1)",
                draw.number(),
                draw.number(),
                draw.number()
            ),
            1 => format!("Sparse({ends}, synapses: [({})])", numbers(draw, 3)),
            2 => format!("Conv2d({ends}, weights: [[[[{}]]]], stride: ({}))", numbers(draw, 2), numbers(draw, 2)),
            3 => format!("SumPool2d({ends}, kernel: ({}), weight: {})", numbers(draw, 2), draw.number()),
            4 => format!(
                "Dense({ends}, weights: Uniform(low: -9, high: 9, step: {}, seed: 1), weight_exp: {})",
                draw.number(),
                draw.number()
            ),
            5 => format!(
                "Dense({ends}, weights: Npy(\"{}\"))",
                draw.one(&["none.npy", "input", "m.ron", "/dev/zero", "."])
            ),
            _ => {
                let rows = 1 + draw.below(3);
                let width = 1 + draw.below(4);
                let rows: Vec<String> = (0..rows).map(|_| format!("[{}]", numbers(draw, width))).collect();
                format!(
                    "Dense({ends}, weights: [{}], weight_bits: {}, delay: {})",
                    rows.join(", "),
                    draw.number(),
                    draw.number()
                )
            }
        };
        text += &projection;
        text += ", ";
    }
    let _ = write!(text, "], output: \"p{}\")", draw.below(count));
    text
}

/// A training file of a small network.
fn training(draw: &mut Draw) -> String {
    let times = |draw: &mut Draw| match draw.below(2) {
        0 => format!("Same({})", draw.number()),
        _ => format!("Spread({}, {}, {})", draw.number(), draw.number(), draw.number()),
    };
    let neuron = match draw.below(4) {
        0 => format!(
            "Srm(tau_sr_ms: {}, tau_ref_ms: 1.0, scale_ref: {}, theta: {})",
            times(draw),
            draw.number(),
            draw.number()
        ),
        1 => format!("SigmaDelta(weight_scale: {}, theta: {})", draw.number(), draw.number()),
        2 => format!(
            "Rf(period_ms: {}, tau_ms: {}, weight_scale: 9, theta: {})",
            times(draw),
            times(draw),
            draw.number()
        ),
        _ => format!(
            "Loihi(tau_u_ms: {}, tau_v_ms: {}, weight_scale: {}, theta: {})",
            times(draw),
            times(draw),
            draw.number(),
            draw.number()
        ),
    };
    let loss = match draw.below(3) {
        0 => format!("CrossEntropy(scale: {})", draw.number()),
        1 => format!("NumSpikes(right: {}, wrong: {})", draw.number(), draw.number()),
        _ => format!("SpikeCount(right: {}, wrong: {})", draw.number(), draw.number()),
    };
    let optimiser = draw.one(&["Adam", "RmsProp", "Sgd"]);
    format!(
        "Training(name: \"t\", timestep_ms: 1.0, inputs: [(name: \"in\", shape: [{}])], layers: [(name: \"hid\", from: \
         [\"in\"], size: {}), (name: \"out\", from: [\"hid\"], size: {})], neuron: {neuron}, loss: {loss}, optimiser: \
         {optimiser}(rate: {}), batch: {}, epochs: {}, seed: {}, train: [\"{}\"])",
        draw.number(),
        draw.number(),
        draw.number(),
        draw.number(),
        draw.number(),
        draw.one(&["0", "1", "2", "3"]),
        draw.number(),
        draw.one(&["scene:noise?samples=2&steps=9", "self.ron", "d", "absent"]),
    )
}

/// A target whose chip is its own or a shipped one.
fn target(draw: &mut Draw) -> String {
    format!(
        "Target(name: \"t\", chip: \"{}\", chips_x: {}, chips_y: {}, constants: [\"{}\"])",
        draw.one(&["loihi1", "tiny", "input.ron", "none"]),
        draw.number(),
        draw.number(),
        draw.one(&["davies2018", "vtsnn-calibrated", "input.ron", "none"]),
    )
}

/// Changes bytes, digits or pieces of a file.
fn mutate(draw: &mut Draw, bytes: &mut Vec<u8>) {
    for _ in 0..1 + draw.below(4) {
        if bytes.is_empty() {
            return;
        }
        // Most significant bytes are at the beginning.
        let reach = if draw.chance(50) { bytes.len().min(256) } else { bytes.len() };
        let at = draw.below(reach);
        match draw.below(7) {
            0 => bytes[at] ^= 1 << draw.below(8),
            1 => bytes[at] = [0, 0xff, 0x7f, 0x80, b'9', b'(', b'"'][draw.below(7)],
            2 => bytes.truncate(at),
            3 => {
                let end = (at + 1 + draw.below(64)).min(bytes.len());
                bytes.drain(at..end);
            }
            4 => {
                let end = (at + 1 + draw.below(64)).min(bytes.len());
                let piece = bytes[at..end].to_vec();
                for _ in 0..1 + draw.below(20) {
                    bytes.splice(at..at, piece.iter().copied());
                }
            }
            5 => {
                // A number in the text is replaced by another.
                if let Some(start) = bytes[at..].iter().position(u8::is_ascii_digit) {
                    let start = at + start;
                    let length = bytes[start..].iter().take_while(|byte| byte.is_ascii_digit()).count();
                    let number = draw.number();
                    bytes.splice(start..start + length, number.bytes());
                }
            }
            _ => {
                for (index, byte) in bytes[at..].iter_mut().take(8).enumerate() {
                    *byte = if index < 4 { 0xff } else { 0 };
                }
            }
        }
    }
}

fn seeds() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut found = Vec::new();
    let mut folders = ["models", "mapping", "tests/fuzz/corpus"].map(|folder| root.join(folder)).to_vec();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            match path.is_dir() {
                true => folders.push(path),
                false => found.push(path),
            }
        }
    }
    found.sort();
    found
}

/// The extension for a stored file of the corpus.
fn extension(draw: &mut Draw, path: &Path) -> String {
    let folder = path.parent().and_then(Path::file_name).unwrap_or_default().to_string_lossy().into_owned();
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    if draw.chance(5) {
        return draw.one(&["npy", "ron", "nir", "pt", "aedat4", "csv", "net", "safetensors"]).to_string();
    }
    match folder.as_str() {
        "arrays" => draw.one(&["npy", "csv", "safetensors"]).to_string(),
        "checkpoint" => "pt".to_string(),
        "hdf5" => draw.one(&["nir", "net", "h5"]).to_string(),
        "yaml" => "yaml".to_string(),
        "events" => match stem.split('_').next().unwrap_or_default() {
            "evt2" | "evt3" => "raw".to_string(),
            "tact4" => "tact".to_string(),
            other => other.to_string(),
        },
        _ => path.extension().unwrap_or_default().to_string_lossy().into_owned(),
    }
}

/// Writes files to a folder, and returns the arguments that use them.
fn case(number: u64, seeds: &[PathBuf], folder: &Path) -> Vec<String> {
    let draw = &mut Draw { case: number, at: 0 };
    let command = draw.below(18);
    for (name, text) in [("m.ron", model(draw, command == 14)), ("t.ron", training(draw)), ("g.ron", target(draw))] {
        let mut text = text.into_bytes();
        if draw.chance(20) {
            mutate(draw, &mut text);
        }
        std::fs::write(folder.join(name), text).unwrap();
    }
    let seed = &seeds[draw.below(seeds.len())];
    let mut bytes = std::fs::read(seed).unwrap();
    mutate(draw, &mut bytes);
    let input = format!("input.{}", extension(draw, seed));
    std::fs::write(folder.join(&input), bytes).unwrap();
    let recordings = draw.one(&["self.ron", "none.npy", "m.ron", ".", ".."]).to_string();
    let mut set = format!(
        "DataSet(name: \"d\", populations: {{\"t\": \"in\"}}, recordings: {{\"t\": \"{}\"}}, steps: {})",
        if draw.chance(50) { &input } else { &recordings },
        draw.number()
    );
    if draw.chance(30) {
        let mut bytes = set.into_bytes();
        mutate(draw, &mut bytes);
        set = String::from_utf8_lossy(&bytes).into_owned();
    }
    std::fs::write(folder.join("self.ron"), set).unwrap();
    let noise = format!(
        "scene:noise?samples={}&steps={}&seed={}",
        draw.one(&["1", "2", "0", "-1"]),
        draw.one(&["10", "0", "1e9", "99"]),
        draw.number()
    );
    let source = match draw.below(4) {
        0 => noise,
        1 => "self.ron".to_string(),
        2 => {
            format!("{input}?{}={}", draw.one(&["dt_ms", "polarity", "window", "origin", "train", "x"]), draw.number())
        }
        _ => input.clone(),
    };
    let named = ["m.ron", "slip-tactile", "self.ron", input.as_str(), "absent"];
    let model = if draw.chance(60) { named[draw.below(2)] } else { named[draw.below(5)] }.to_string();
    let words = |line: &str| line.split(' ').map(str::to_string).collect::<Vec<_>>();
    let out = ["-o out.ron", "--plot out2.svg", "--pareto out.svg", "-q"];
    let mut arguments = match command {
        0 | 1 => [words("inspect"), vec![input]].concat(),
        2 => [words("import"), vec![input], words("-o out.ron")].concat(),
        3 => [words("map"), vec![model], words("--time-budget 0"), words(draw.one(&out))].concat(),
        4 => {
            let target = if draw.chance(50) { "g.ron".to_string() } else { input };
            [words("map slip-tactile --time-budget 0 --target"), vec![target]].concat()
        }
        5 => [words("run slip-tactile --samples 0..1 --mapping"), vec![input]].concat(),
        6 | 7 => [words("run"), vec![model], words("--input"), vec![source]].concat(),
        8 => [words("export"), vec![model], words("-o out.nir")].concat(),
        9 => [words("run"), vec![model], words("--engine golden --input"), vec![source]].concat(),
        10 => match draw.below(6) {
            4 => {
                let what = draw.one(&["raster", "voltage", "map", "time", "pareto"]);
                let probe = draw.one(&["--probe p0", "--probe p0[0]", "--probe *", "--probe x[9]", "-q"]);
                let line = format!("plot {what} -o out.svg --samples 0..1 {probe} --input");
                [words(&line), vec![source, model]].concat()
            }
            5 => {
                let mut bytes = br#"{"schema": "nsim.bench/1", "name": "pareto", "rows": [{"variant": "a",
                    "us_per_timestep": 1.5, "coincidence": 0.5, "on_front": true}], "pareto": [{}]}"#
                    .to_vec();
                mutate(draw, &mut bytes);
                std::fs::write(folder.join("r.json"), bytes).unwrap();
                words(draw.one(&["plot pareto r.json -o o.svg"]))
            }
            0 => [words("report"), vec![model], words("-o out.html --samples 0..1 --input"), vec![source]].concat(),
            1 => {
                let mut bytes = br#"{"schema": "nsim.run/1", "model": "m", "populations": [{"name": "a"}]}"#.to_vec();
                mutate(draw, &mut bytes);
                std::fs::write(folder.join("r.json"), bytes).unwrap();
                words("report r.json r.json -o out.html")
            }
            _ => [words("energy"), vec![model], words("--samples 0..1 --input"), vec![source]].concat(),
        },
        11 => [words("agree"), vec![model], words("--attribution off --steps 20 --input"), vec![source]].concat(),
        12 => {
            // The data of shipped trainings take minutes.
            let (config, few) = if draw.chance(80) { ("t.ron".to_string(), draw.chance(50)) } else { (input, true) };
            let options = ["-o out.ron", "--log l.csv", "--checkpoint input.ron", "--folds 2"];
            let train = if few { vec!["--train".to_string(), source] } else { Vec::new() };
            let test = if few { words("--test scene:noise?samples=1&steps=9") } else { Vec::new() };
            [words("train"), vec![config], train, test, words(draw.one(&options)), words("--epochs 2")].concat()
        }
        13 => {
            let scene = format!(
                "{}?{}={}&samples=1",
                draw.one(&["slip", "container", "noise", "x"]),
                draw.one(&["steps", "grip_n", "pixel_noise_hz", "seed", "rate_hz", "touch_noise_hz"]),
                draw.number()
            );
            if draw.chance(50) {
                let paths =
                    ["populations.p0.vth_mant", "target.limits.axons_in", "options.seed", "model", "input", "x"];
                let text = format!(
                    "Sweep(model: {model:?}, input: [{source:?}], samples: \"0..1\", list: [{{{:?}: {}}}], grid: \
                     [(paths: [{:?}], \
                     values: [{}, \"certain\"])])",
                    draw.one(&paths),
                    draw.number(),
                    draw.one(&paths),
                    draw.number()
                );
                let mut bytes = text.into_bytes();
                if draw.chance(40) {
                    mutate(draw, &mut bytes);
                }
                std::fs::write(folder.join("sweep.ron"), bytes).unwrap();
                let ends =
                    ["-o t.csv", "-o t.csv --shard 1/2", "-o t.csv --plot p.svg --axes x,spikes", "--merge d.csv"];
                words(&format!("sweep sweep.ron {}", draw.one(&ends)))
            } else {
                [words("scene"), vec![scene], words(draw.one(&["-o s", "--plot p.svg", "-q"]))].concat()
            }
        }
        14 => {
            [words("convert"), vec![model], words("-o out.ron --calibration-samples 1 --input"), vec![source]].concat()
        }
        15 => {
            let option = draw.one(&["--constants", "--deployment", "--baseline", "--mapping"]);
            [words("energy slip-tactile --samples 0..1"), vec![option.to_string(), input]].concat()
        }
        16 => {
            let options = ["--neuron", "--image", "--dt", "--first-step", "--reset-interval", "--input-shape"];
            let value = match draw.below(3) {
                0 => "input.ron".to_string(),
                1 => "1,2,2".to_string(),
                _ => draw.number().to_string(),
            };
            [words("import"), vec![input, draw.one(&options).to_string(), value]].concat()
        }
        _ => {
            let probes = ["p0.v", "p0.spikes", "in.spikes", "p0.u", "p1.v", "x"];
            let formats = ["npy", "csv", "nir"];
            let (probe, format) = (draw.one(&probes).to_string(), draw.one(&formats).to_string());
            let probed = vec!["--probe".to_string(), probe, "--probe-format".to_string(), format];
            [words("run m.ron -o p --input"), vec![source], probed].concat()
        }
    };
    if draw.chance(15) {
        let options = "--samples --threads --copies --seed --repeat --probe -o --steps --plot --early-exit";
        let values = "0 1 2..1 0..9 -1 x.svg certain o.v .";
        arguments.extend([options, values].map(|words| draw.word(words).to_string()));
    }
    if draw.chance(50) {
        arguments.extend(words("--format json"));
    }
    arguments
}

/// Number of weights that the models of a folder generate from seeds. Their cost follows from
/// shapes, not from the file's size.
fn drawn(folder: &Path) -> u64 {
    use nsim::files::network::{ProjectionDesc, ProjectionKind, Source, Weights};
    let weights = |name: &str| {
        let network = nsim::import::model::load_model(&folder.join(name).display().to_string()).ok()?;
        let file = network.file();
        let units = |name: &str| -> Option<u64> {
            let found = file.population(name)?;
            found.shape.iter().try_fold(1u64, |product, &axis| product.checked_mul(axis))
        };
        let projection = |projection: &ProjectionDesc| {
            let sources = projection.from.iter().filter_map(|name| units(name)).sum::<u64>();
            match &projection.kind {
                ProjectionKind::Dense(Weights::From(Source::Uniform { .. })) => {
                    sources.checked_mul(units(&projection.to)?)
                }
                ProjectionKind::Random { fan_out, .. } => sources.checked_mul(*fan_out),
                _ => None,
            }
        };
        Some(file.projections.iter().filter_map(projection).fold(0, u64::saturating_add))
    };
    ["m.ron", "input.ron"].iter().filter_map(|name| weights(name)).sum()
}

/// Processor time of a process: fields 14 and 15 of `/proc/PID/stat`, in hundredths of a second
/// (proc(5)).
fn busy(process: u32) -> Duration {
    let text = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    // The second field, the name in parentheses, may hold spaces.
    let fields = text.rsplit(')').next().unwrap_or_default().split_whitespace();
    let ticks: u64 = fields.skip(11).take(2).filter_map(|field| field.parse::<u64>().ok()).sum();
    Duration::from_millis(10 * ticks)
}

/// Runs a case; returns its failure, if any.
fn judge(number: u64, seeds: &[PathBuf], peak_kib: &AtomicU64, slowest_ms: &AtomicU64) -> Option<String> {
    let folder = tempfile::Builder::new().prefix("nsim-fuzz-").tempdir().unwrap();
    let arguments = case(number, seeds, folder.path());
    let input: u64 =
        std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().metadata().unwrap().len()).sum();
    let log = |name: &str| std::fs::File::create(folder.path().join(name)).unwrap();
    let begin = Instant::now();
    let mut child = Command::new(assert_cmd::cargo::cargo_bin("nsim"))
        .args(&arguments)
        .args(["--threads", "2"])
        .current_dir(folder.path())
        .stdin(Stdio::null())
        .stdout(log("stdout"))
        .stderr(log("stderr"))
        .spawn()
        .unwrap();
    let mut most = MOST_KIB + MOST_TIMES * input / 1024;
    let mut is_drawn = false;
    let mut peak = 0;
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break Ok(status);
        }
        let status = std::fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        peak = line.and_then(|line| line.split_whitespace().next()?.parse().ok()).unwrap_or(0).max(peak);
        if peak > most && !std::mem::replace(&mut is_drawn, true) {
            most = most.saturating_add((MOST_DRAWN * drawn(folder.path()).min(1 << 40)) / 1024);
        }
        let wait = begin.elapsed();
        // Two threads compute for at most twice the elapsed time.
        let busy = if wait > LONGEST / 2 { busy(child.id()) } else { Duration::ZERO };
        if busy > LONGEST || wait > LONGEST_WAIT || peak > most {
            let _ = child.kill();
            let _ = child.wait();
            break Err(format!("{busy:?} in {wait:?} and {} MiB, where {} are allowed", peak >> 10, most >> 10));
        }
        std::thread::sleep(Duration::from_millis(2));
    };
    if !is_drawn {
        peak_kib.fetch_max(peak, Ordering::Relaxed);
    }
    slowest_ms.fetch_max(begin.elapsed().as_millis() as u64, Ordering::Relaxed);
    let err = std::fs::read_to_string(folder.path().join("stderr")).unwrap_or_default();
    let wrong = match status {
        Err(limit) => Some(limit),
        Ok(status) if !matches!(status.code(), Some(0..=3)) => Some(format!("{status}: {err}")),
        Ok(_) if err.contains("panicked at") => Some(err),
        Ok(_) => None,
    }?;
    let kept = folder.keep();
    Some(format!("case {number}: nsim {} in {}: {wrong}", arguments.join(" "), kept.display()))
}

#[test]
fn every_case_ends_as_promised() {
    let cases = std::env::var("NSIM_FUZZ").ok().and_then(|text| {
        let (first, end) = text.split_once("..")?;
        Some(first.parse().ok()?..end.parse().ok()?)
    });
    let seeds = seeds();
    let (peak_kib, slowest_ms) = (AtomicU64::new(0), AtomicU64::new(0));
    let cases = cases.unwrap_or(0..CASES);
    let count = cases.end - cases.start;
    let begin = Instant::now();
    let wrong: Vec<String> =
        cases.into_par_iter().filter_map(|number| judge(number, &seeds, &peak_kib, &slowest_ms)).collect();
    println!(
        "{count} cases in {:.0} s, the slowest {} ms, the largest {} MiB",
        begin.elapsed().as_secs_f64(),
        slowest_ms.into_inner(),
        peak_kib.into_inner() >> 10
    );
    assert!(wrong.is_empty(), "{} cases:\n{}", wrong.len(), wrong.join("\n"));
}
