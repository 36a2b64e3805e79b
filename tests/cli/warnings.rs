//! What changes a model, or rests on an assumption, is in the text, in JSON, on pages and in
//! Python.
//!
//! Each reader of models and of recordings has a case, and each code of a warning is made by one.

use std::collections::BTreeSet;
use std::path::Path;

use nsim::files::npy;
use nsim::import::hdf5::{self, Group, Numbers};
use nsim::ir::base::warning::WarningCode;
use serde_json::{Value, json};

use crate::advice::nir_with;
use crate::common::command;
use crate::page;
#[path = "../common/torch.rs"]
mod torch;
#[path = "../files/tree.rs"]
#[allow(dead_code)]
mod tree;

use crate::{MODEL, SRM, write};
use tree::{int, ints, nir, node, reals, typed};

/// A model of an input of 4 channels and a population of 2.
fn model(neuron: &str, projection: &str, network: &str) -> String {
    format!(
        "Network(name: \"m\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [4]),
         Loihi(name: \"out\", shape: [2], {neuron})], projections: [Dense(from: [\"in\"], to: \"out\", {projection})],
         output: \"out\", {network})"
    )
}

/// A file of netx: a dense layer with these weights.
fn netx(folder: &Path, name: &str, weights: [f64; 2]) {
    let [du, dv, vth] = [2048, 512, 40].map(int);
    let neuron = Group::default().with("type", "CUBA").with("iDecay", du).with("vDecay", dv).with("vThMant", vth);
    let dense = typed("dense").with("shape", ints(&[1])).with("neuron", neuron);
    let dense = dense.with("weight", Numbers::f64(&[1, 2], &weights));
    let input = typed("input").with("shape", ints(&[2]));
    let file = Group::default().with("layer", Group::default().with("0", input).with("1", dense));
    std::fs::write(folder.join(name), hdf5::write(&file).unwrap()).unwrap();
}

/// A file of netx whose fields contradict each other, with a delay of 70 steps.
fn contradicting_netx(folder: &Path) {
    let neuron = |vth: i64| typed("CUBA").with("iDecay", int(2048)).with("vDecay", int(512)).with("vThMant", int(vth));
    let dense = |neuron: Group| {
        let weights = Numbers::f64(&[1, 1], &[20.0]);
        typed("dense").with("shape", ints(&[1])).with("neuron", neuron).with("weight", weights)
    };
    let first = dense(neuron(40).with("theta", int(100))).with("delay", ints(&[70]));
    let second = dense(neuron(200_000)).with("inFeatures", int(9));
    let input = typed("input").with("shape", ints(&[1]));
    let layers = Group::default().with("0", input).with("1", first).with("2", second);
    std::fs::write(folder.join("fields.net"), hdf5::write(&Group::default().with("layer", layers)).unwrap()).unwrap();
}

/// A graph of NIR that states little: a rest potential, a loop, two outputs, edges twice and to
/// nowhere.
fn terse_nir(folder: &Path) {
    let matrix = || typed("Linear").with("weight", Numbers::f64(&[2, 2], &[0.5, -0.25, 1.0, 0.75]));
    let rest = [("tau", 0.008), ("r", 9.0), ("v_leak", -65.0), ("v_reset", -65.0), ("v_threshold", -64.0)];
    let nodes = [
        ("i", typed("Input").with("shape", ints(&[2]))),
        ("w", matrix()),
        ("d", typed("Delay").with("delay", reals(&[0.0004, 0.001]))),
        ("n", node("LIF", &[2], &rest)),
        ("x", matrix()),
        ("m", node("LIF", &[2], &rest)),
        ("y", matrix()),
        ("z", matrix()),
        ("o", typed("Output")),
        ("p", typed("Output")),
    ];
    let edges = [("i", "w"), ("w", "d"), ("d", "n"), ("n", "x"), ("x", "m"), ("m", "o"), ("m", "y"), ("y", "n")];
    let odd = [("n", "p"), ("n", "z"), ("i", "w")];
    let root = nir(nodes, edges.into_iter().chain(odd));
    std::fs::write(folder.join("terse.nir"), hdf5::write(&root).unwrap()).unwrap();
}

fn array(folder: &Path, name: &str, shape: &[u64], numbers: &[f64]) {
    npy::write(std::fs::File::create(folder.join(name)).unwrap(), shape, numbers.iter().copied()).unwrap();
}

fn files(folder: &Path) {
    nir_with(folder, 1.0);
    netx(folder, "fraction.net", [20.0, -6.5]);
    netx(folder, "odd.net", [513.0, -7.0]);
    contradicting_netx(folder);
    terse_nir(folder);
    array(folder, "1-fc1.npy", &[1, 2], &[1000.0, 2.0]);
    let dense: Vec<torch::Entry> =
        vec![("fc1.weight", vec![2, 3, 1, 1, 1], vec![20.0; 6]), ("fc2.weight", vec![2, 2, 1, 1, 1], vec![20.0; 4])];
    std::fs::write(folder.join("net.pt"), torch::checkpoint(&dense)).unwrap();
    let yaml = "neuron:\n  type: LOIHI\n  vThMant: 80\n  vDecay: 128\n  iDecay: 1024\n  refDelay: 1\n  wgtExp: 0\n";
    let strong = "du: 4096, dv: 1024, vth_mant: 1";
    let none = "weights: [[64, 64, 64, 64], [64, 64, 64, 64]]";
    for (name, text) in [
        ("loihi.yml", yaml),
        (
            "slow.ron",
            "Constants(base: \"loihi1-evidence\", turn_time: (value: 2000.0, unit: us, source: \"me\", \
             status: assumed))",
        ),
        ("srm.ron", SRM),
        (
            "wide.ron",
            &MODEL.replace("shape: [3]", "shape: [2, 1, 4]").replace(
                "weights: [[20, 0, 4], [2, 30, 6], [0, 8, 40], [12, -6, 2]]",
                "weights: Uniform(low: 2, high: 60, step: 2, seed: 1)",
            ),
        ),
        ("odd.ron", &model(strong, "weights: [[63, 64, 65, 66], [64, -64, 64, 64]]", "")),
        ("lava.ron", &model(&format!("{strong}, refractory: 5, vmax_exp: 3"), none, "semantics: Lava")),
        ("slayer.ron", &model(&format!("{strong}, bias_mant: 3"), none, "semantics: Slayer")),
        (
            "conv.ron",
            "Network(name: \"conv\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [1, 4, 4]), \
             Loihi(name: \"out\", shape: [1, 3, 3], du: 4096, dv: 0, vth_mant: 9)], projections: [Conv2d(from: \
             [\"in\"], to: \"out\", weights: [[[[0, 20], [30, 40]]]])], output: \"out\")",
        ),
        ("clipped.ron", &model("du: 4096, dv: 0, vth_mant: 100, vmax_exp: 1", none, "")),
        (
            "wrapped.ron",
            &model(
                "du: 0, dv: 4096, vth_mant: 1",
                "weights: Uniform(low: 250, high: 254, step: 2, seed: 1), weight_exp: 7",
                "",
            ),
        ),
        ("silent.ron", &MODEL.replace("vth_mant: 10", "vth_mant: 9000")),
        ("events.csv", "t_us,x,y,p\n0,1,0,1\n900,9,0,1\n1500,2,0,0\n2600,3,0,1\n"),
        ("late.txt", "t_us,x,y,p\n0,1,0,1\n3000,2,0,1\n1000,2,0,0\n"),
    ] {
        write(folder, name, text);
    }
    // Samples of 3 and of 5 steps.
    std::fs::create_dir(folder.join("lengths")).unwrap();
    array(folder, "lengths/sample_0_label_0.npy", &[8, 3], &[1.0; 24]);
    array(folder, "lengths/sample_1_label_1.npy", &[8, 5], &[1.0; 40]);
    // Addresses: column, row, polarity and 23 bits of time; the second is beyond the sensor.
    std::fs::write(folder.join("events.bin"), [1, 0, 0x80, 0, 0, 30, 0, 0x80, 4, 0, 2, 0, 0, 9, 0]).unwrap();
}

/// The codes of a command's warnings. Each line that it prints is one of them, and the other way
/// around; its result in text has the same lines, a page has the same records.
fn codes(folder: &Path, line: &str) -> BTreeSet<String> {
    let is_page = line.starts_with("report ");
    let baseline = if line.contains("--baseline") { "" } else { " --baseline" };
    let line = if is_page { format!("{line}{baseline} -o page.html --force") } else { line.to_string() };
    let json = if is_page { line.clone() } else { format!("{line} --format json") };
    let (status, out, err) = command::said(folder, &json);
    assert!(status < 2, "{line}: {err}{out}");
    let result = match is_page {
        true => page::data(&folder.join("page.html"))["results"][0].clone(),
        false => serde_json::from_str(&out).unwrap(),
    };
    let lines: Vec<&str> = err.lines().filter_map(|line| line.trim_start().strip_prefix("WARN ")).collect();
    let rows = result["warnings"].as_array().unwrap_or_else(|| panic!("{line}: {out}"));
    let said = |row: &Value| match row["population"].as_str() {
        Some(population) => format!("'{population}': {}", row["message"].as_str().unwrap()),
        None => row["message"].as_str().unwrap().to_string(),
    };
    for row in rows {
        assert_eq!(lines.iter().filter(|line| line.ends_with(&said(row))).count(), 1, "{line}: {row} in {err}");
    }
    assert_eq!(lines.len(), rows.len(), "{line}: {err}");
    let (_, _, text) = command::said(folder, &line);
    assert_eq!(text, err, "{line}");
    rows.iter().map(|row| row["code"].as_str().unwrap().to_string()).collect()
}

/// Warnings that no page has, because `nsim report` has no option of these readers.
const WITHOUT_PAGE: [WarningCode; 2] = [WarningCode::DecisionByPotential, WarningCode::LayerOrder];

/// Each code is made by a case, in the text, in JSON and on a page. The cases stay in a folder,
/// where `python/tests/test_warnings.py` makes them again, and prints a list of the codes and
/// places.
#[test]
fn a_warning_is_in_text_json_and_page_alike_and_each_code_is_made() {
    use WarningCode::*;
    const TERSE: [WarningCode; 9] = [
        ThresholdAssumed,
        LowerBoundAssumed,
        Gain,
        RestPotential,
        DelaysRounded,
        LoopSlower,
        OutputAssumed,
        EdgeDoubled,
        EdgeDropped,
    ];
    const EACH: &[&str] = &["run", "energy --baseline", "agree", "report"];
    let folder = &Path::new(env!("CARGO_TARGET_TMPDIR")).join("warnings");
    let _ = std::fs::remove_dir_all(folder);
    std::fs::create_dir_all(folder).unwrap();
    files(folder);
    let noise = "scene:noise?samples=1&steps=40&rate=0.5&seed=1";
    // Commands, a model with its options, an input, codes.
    type Case = (&'static [&'static str], &'static str, &'static str, &'static [WarningCode]);
    let cases: [Case; 27] = [
        (EACH, "net.nir --dt 1", noise, &[ResetAssumed]),
        (
            &["map", "import", "import -o made.ron --force", "export -o made.nir --force"],
            "net.nir --dt 1",
            "",
            &[ResetAssumed],
        ),
        (&["compare --targets loihi1-chip"], "net.nir --dt 1", noise, &[ResetAssumed]),
        (&["import", "report"], "net.nir --dt 50 --from sinabs --reset zero", noise, &[LongTimestep, ToolBeyond]),
        (&["import"], "net.nir --dt 1 --reset zero --decision greatest_v", "", &[DecisionByPotential]),
        (&["map", "import", "report"], "terse.nir --dt 1", noise, &TERSE),
        (&["import", "report"], "fields.net", noise, &[DelayClipped, ThetaIgnored, ThresholdClipped, SizeIgnored]),
        (&["map", "import", "report"], "fraction.net", noise, &[FractionLost]),
        (&["run", "energy --baseline", "report"], "odd.net", noise, &[WeightsRounded]),
        (&["import"], "1-fc1.npy --neuron loihi.yml", "", &[WeightsRounded]),
        (&["import"], "net.pt --neuron loihi.yml", "", &[LayerOrder]),
        (EACH, "wide.ron", "in=events.csv?size=4,1&steps=3", &[EventsChanged]),
        (&["run"], "wide.ron", "in=late.txt?size=4,1&steps=5", &[EventsChanged]),
        (&["run"], "wide.ron", "in=events.bin?size=4,1&steps=5", &[EventsChanged]),
        (&["run --engine golden"], "odd.ron", noise, &[WeightsRounded]),
        (EACH, "odd.ron", noise, &[WeightsRounded]),
        (&["map", "map --copies 3"], "odd.ron", "", &[WeightsRounded]),
        (&["run", "run --engine reference", "report"], "lava.ron", noise, &[ParameterIgnored]),
        (&["run", "energy --baseline"], "slayer.ron", noise, &[ParameterIgnored]),
        (&["map", "report"], "srm.ron", noise, &[Converted]),
        (&["run", "energy --baseline", "report"], "clipped.ron", noise, &[Clipped]),
        (&["run", "report"], "wrapped.ron", noise, &[Wrapped]),
        (&["run", "energy --baseline", "report"], "silent.ron", noise, &[SilentPopulation, SilentOutput]),
        (
            &["map --prune static", "run --prune static", "report --prune static"],
            "conv.ron",
            noise,
            &[ConvolutionListed],
        ),
        (&["energy", "report --baseline rtx-2080-ti"], "wide.ron", noise, &[BaselineMissing]),
        (
            &["energy --convention published --baseline", "report --convention published"],
            "wide.ron",
            "lengths",
            &[CostUnknown],
        ),
        (
            &["energy --mode realtime --constants slow.ron --baseline", "report --mode realtime --constants slow.ron"],
            "wide.ron",
            noise,
            &[RealtimeMissed],
        ),
    ];
    let (mut made, mut on_page) = (BTreeSet::new(), BTreeSet::new());
    for (commands, arguments, input, expected) in &cases {
        for command in *commands {
            let reads_no_input = ["map", "import", "export"].iter().any(|name| command.starts_with(name));
            let input = if reads_no_input { String::new() } else { format!(" --input {input}") };
            // A list of names ends with the line.
            let (command, options) = command.split_once(' ').unwrap_or((command, ""));
            let found = codes(folder, format!("{command} {arguments}{input} {options}").trim_end());
            for code in *expected {
                assert!(found.contains(code.name()), "{command} {arguments}: {code:?} is not among {found:?}");
                made.insert(*code);
                on_page.extend(command.starts_with("report").then_some(*code));
            }
        }
    }
    assert_eq!(made, BTreeSet::from(WarningCode::ALL));
    on_page.extend(WITHOUT_PAGE);
    assert_eq!(on_page, made);
    let listed = cases.map(|(commands, model, input, codes)| json!([commands, model, input, codes]));
    write(folder, "cases.json", &json!({"cases": listed, "without_page": WITHOUT_PAGE}).to_string());
    let page = std::fs::read_to_string("docs/results.md").unwrap();
    let (_, table) = page.split_once("\n## Warnings\n").unwrap();
    let rows: Vec<&str> = table.lines().filter_map(|line| line.strip_prefix("| `")?.split('`').next()).collect();
    let codes = WarningCode::ALL.map(WarningCode::name);
    assert_eq!(rows[..codes.len()], codes, "docs/results.md has a row for each");
    assert!(WarningCode::ALL.iter().all(|code| serde_json::json!(code) == code.name()));
}

/// Every source of arrays, in which two values or a sign are more than a spike.
#[test]
fn counts_and_signs_in_arrays_are_refused_where_spikes_would_lose_them() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path();
    let binary = model("du: 4096, dv: 1024, vth_mant: 1", "weights: [[64, 64, 64, 64], [64, 64, 64, 64]]", "");
    write(folder, "m.ron", &binary);
    write(folder, "graded.ron", &binary.replace("shape: [4])", "shape: [4], message_bits: 8)"));
    write(folder, "set.ron", "DataSet(name: \"s\", populations: {\"a\": \"in\"}, recordings: {\"a\": \"counts.npy\"})");
    std::fs::create_dir(folder.join("all")).unwrap();
    for name in ["counts.npy", "all/sample_0_label_0.npy"] {
        array(folder, name, &[4, 2], &[0.0, 1.0, 2.0, 0.0, 3.0, 1.0, 0.0, 0.0]);
    }
    array(folder, "signs.npy", &[4, 2], &[0.0, -1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0]);
    array(folder, "one.npy", &[4, 2], &[0.0, 255.0, 0.0, 255.0, 0.0, 0.0, 0.0, 0.0]);
    let spikes =
        |arguments: &str| command::object(folder, &format!("run {arguments}"), 0)["activity"]["spikes_in"].clone();
    let counts = "2 of 4 entries other than 0 are greater than 1";
    for (source, says) in [
        ("counts.npy", counts),
        ("all", counts),
        ("set.ron", counts),
        ("signs.npy", "2 of 2 entries other than 0 are negative"),
    ] {
        for command in ["run", "energy", "agree", "map --profile"] {
            let input = if command.starts_with("map") { "" } else { " --input" };
            let line = match input {
                "" => format!("{command} {source} m.ron"),
                _ => format!("{command} m.ron{input} {source}"),
            };
            let (status, _, err) = command::said(folder, &line);
            assert!(
                status == 3 && err.contains(says) && err.contains("least=") && err.contains("message_bits"),
                "{line}: {err}"
            );
        }
    }
    // What the refusal names.
    assert_eq!(spikes("m.ron --input counts.npy?least=1"), 4);
    assert_eq!(spikes("m.ron --input counts.npy?least=2"), 2);
    assert_eq!(spikes("m.ron --input one.npy"), 2);
    assert_eq!(spikes("graded.ron --target oheo-gulch --input counts.npy"), 4);
    assert_eq!(spikes("graded.ron --target oheo-gulch --input signs.npy"), 2);
}
