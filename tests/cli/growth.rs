//! Processor time against the size of a model: populations, inputs, sources of one declaration,
//! projections, kinds.

use std::path::Path;
use std::process::Command;

/// Greatest exponent of time against size.
const MOST: f64 = 1.15;
/// Precision of a time, seconds.
const PRECISION: f64 = 0.05;
/// Size whose time is start-up.
const SMALL: usize = 16;

/// Two sizes of a model that are mapped in the same way. More than 4,096 compartments need several
/// cores, whose search takes a constant time that one core does not take.
fn sizes(what: &str) -> [usize; 2] {
    if matches!(what, "populations" | "projections") { [8_000, 32_000] } else { [4_000, 16_000] }
}

fn list(count: usize, item: impl Fn(usize) -> String) -> String {
    (0..count).map(item).collect::<Vec<_>>().join(",")
}

fn neurons(name: &str, count: usize) -> String {
    format!("Loihi(name:\"{name}\",shape:[{count}],du:4096,dv:0,vth_mant:1)")
}

/// A model of a size: kinds, populations, projections.
fn model(what: &str, n: usize) -> String {
    let (kinds, populations, projections) = match what {
        "populations" => {
            let layers = list(n, |i| neurons(&format!("p{i}"), 1));
            let dense = |i| format!("Dense(from:[\"in\"],to:\"p{i}\",weights:[[200]])");
            let out = "Dense(from:[\"in\"],to:\"o\",weights:[[200]])";
            let inputs = "Input(name:\"in\",shape:[1])";
            (String::new(), format!("{inputs},{layers},{}", neurons("o", 1)), format!("{},{out}", list(n, dense)))
        }
        "inputs" => {
            let inputs = list(n, |i| format!("Input(name:\"i{i}\",shape:[1])"));
            // Sums of all inputs stay small, so that `agree` finds no loss at any size.
            let sign = |i: usize| if i.is_multiple_of(2) { "" } else { "-" };
            let dense = |i| format!("Dense(from:[\"i{i}\"],to:\"o\",weights:[[{0}2],[{0}4]])", sign(i));
            (String::new(), format!("{inputs},{}", neurons("o", 2)), list(n, dense))
        }
        "sources" => {
            let inputs = list(n, |i| format!("Input(name:\"i{i}\",shape:[1])"));
            let sparse = format!(
                "Sparse(from:[{}],to:\"o\",synapses:[{}])",
                list(n, |i| format!("\"i{i}\"")),
                list(n, |i| format!("({i},0,2)"))
            );
            (String::new(), format!("{inputs},{}", neurons("o", 2)), sparse)
        }
        "projections" => {
            let sparse = |i| format!("Sparse(from:[\"in\"],to:\"o\",synapses:[({},{i},2)])", i % 64);
            (String::new(), format!("Input(name:\"in\",shape:[64]),{}", neurons("o", n)), list(n, sparse))
        }
        _ => {
            let kind = |i| {
                format!(
                    "Kind(name:\"k{i}\",state:[(name:\"v\",bits:24,overflow:Wrap)],update:[\"v = v + in + {i}\"],\
                     spikes:\"v > 100\",reset:[\"v = 0\"])"
                )
            };
            let layers = list(n, |i| format!("k{i}(name:\"p{i}\",shape:[1])"));
            let dense = |i| format!("Dense(from:[\"in\"],to:\"p{i}\",weights:[[64]])");
            (
                format!("target:\"oheo-gulch\",kinds:[{}],", list(n, kind)),
                format!("Input(name:\"in\",shape:[1]),{layers},k0(name:\"o\",shape:[1])"),
                format!("{},Dense(from:[\"in\"],to:\"o\",weights:[[64]])", list(n, dense)),
            )
        }
    };
    format!(
        "Network(name:\"g\",timestep_ms:1.0,{kinds}populations:[{populations}],projections:[{projections}],output:\"o\")"
    )
}

/// Least processor time of a command, in a process of its own, of some runs.
fn seconds(folder: &Path, line: &str, status: i32) -> f64 {
    let program = assert_cmd::cargo::cargo_bin("nsim");
    let timed = format!("TIMEFORMAT=%U; time '{}' {line} > out 2> err; exit $?", program.display());
    let mut least = f64::INFINITY;
    for _ in 0..3 {
        let output = Command::new("bash").args(["-c", &timed]).current_dir(folder).output().unwrap();
        assert_eq!(output.status.code(), Some(status), "{line}");
        least = least.min(String::from_utf8_lossy(&output.stderr).trim().parse().unwrap());
    }
    least
}

#[test]
#[ignore = "takes minutes; run by .ci/nightly"]
fn time_is_proportional_to_the_model() {
    let folder = tempfile::tempdir().unwrap();
    let fits = "--set target.limits.compartments=60000 --set target.limits.axons_in=60000";
    let small = "--set target.limits.compartments=1 --set target.limits.axons_in=1 --set target.chips_x=1 \
                 --set target.chips_y=1";
    // Other processors are measured for a second each.
    let (mut shown, mut failures) = (Vec::new(), Vec::new());
    for what in ["populations", "inputs", "sources", "projections", "kinds"] {
        let sizes = sizes(what);
        for n in [SMALL].into_iter().chain(sizes) {
            std::fs::write(folder.path().join(format!("{n}.ron")), model(what, n)).unwrap();
        }
        // Kinds of a model's own have no form in real numbers, and are groups of a core's memory.
        let kinds = what == "kinds";
        let fits = &if kinds { format!("{fits} --set target.limits.groups=60000") } else { fits.to_string() };
        let input = &format!("--input 'scene:noise?samples=1&steps=10&seed=1&rate=1' --threads 1 {fits}");
        let priced = &format!("{input} --baseline");
        let commands = [
            ("inspect", "", 0),
            ("map", fits, 0),
            ("map", small, 1),
            ("run", input, 0),
            ("agree", input, 0),
            ("energy", priced, 0),
        ];
        for (command, options, status) in commands.into_iter().filter(|(name, ..)| !kinds || *name != "agree") {
            let seconds = |n: usize| seconds(folder.path(), &format!("{command} {n}.ron {options}"), status);
            // A network of 16 populations fits where one of 8,000 does not.
            let start = if status == 0 { seconds(SMALL) } else { 0.0 };
            // What is slow by chance is measured again: a shared machine is slower at times.
            let mut slow = true;
            for _ in 0..4 {
                let [few, many] = sizes.map(|n| seconds(n) - start);
                let ratio = sizes[1] as f64 / sizes[0] as f64;
                let exponent = (many / few).ln() / ratio.ln();
                shown.push(format!("{what}: {command} {options}: {few:.2} s, {many:.2} s, exponent {exponent:.2}"));
                slow = many > few * ratio.powf(MOST) + PRECISION;
                if !slow {
                    break;
                }
            }
            failures.extend(slow.then(|| shown[shown.len() - 1].clone()));
        }
    }
    println!("{}", shown.join("\n"));
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}
