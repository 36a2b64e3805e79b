//! Networks that learn, from the command line: probes, random numbers, learned models, refusals.

use std::path::Path;

use crate::common::command::{object, said};
use nsim::files::network::ProjectionKind;

/// A network with a rule in lava's semantics and one in the chip's, whose synapses have delays.
fn model(semantics: &str) -> String {
    format!(
        "Network(name: \"m\", timestep_ms: 1.0, learning_semantics: {semantics}, weight_rounding: Floor, populations: [
            Input(name: \"in\", shape: [4]), Signal(name: \"reward\", shape: [1]),
            Loihi(name: \"out\", shape: [3], du: 4096, dv: 2048, vth_mant: 4)],
        projections: [
            Sparse(from: [\"in\"], to: \"out\", synapses: [(0, 0, 8), (1, 1, 8), (2, 2, 8)]),
            Dense(name: \"p\", from: [\"in\"], to: \"out\", weights: [[8, 2, 4, 6], [2, 8, 4, 6], [4, 6, 8, 2]],
                learning: Rule(dw: \"2^-2*x1*y0 - 2^-2*y1*x0\", dt: \"x0*y2\", epoch: 4, tags: 3,
                    x1: (impulse: 16, tau: 10), y1: (impulse: 16, tau: 10), y2: Signal(\"reward\"))),
            Random(name: \"q\", from: [\"in\"], to: \"out\", fan_out: 2, low: 0, high: 4, seed: 3, delay: 2,
                learning: Rule(dd: \"x0*y0\"))],
        output: \"out\")"
    )
}

const INPUT: &str = "--input scene:noise?samples=3&steps=20&rate=0.4&seed=1";

fn folder(semantics: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("m.ron"), model(semantics)).unwrap();
    folder
}

/// Shape and numbers of an array of 32-bit integers.
pub fn array(path: &Path) -> (Vec<usize>, Vec<i32>) {
    let array = nsim::files::npy::read(path).unwrap();
    (array.shape().to_vec(), array.reals().map(|number| number as i32).collect())
}

#[test]
fn columns_of_rules_are_probed_on_both_engines() {
    let folder = folder("Silicon");
    let columns = ["weight", "tag", "delay", "x1", "x2", "y1", "y2", "y3"];
    let probes: String = columns.iter().map(|column| format!(" --probe p.{column}")).collect();
    for engine in ["golden", "fast"] {
        let line = format!("run m.ron {INPUT} --engine {engine} --probe q.delay.last{probes} -o {engine}");
        let run = object(folder.path(), &line, 0);
        assert_eq!(run["files"].as_array().unwrap().len(), 9);
        assert_eq!(run["learning"][0]["name"], "p");
        assert_eq!(run["learning"][0]["epochs"], 15);
        assert!(run["activity"]["synaptic_updates"].is_u64());
        for (column, rows) in columns.iter().zip([12, 12, 12, 4, 4, 3, 3, 3]) {
            let (shape, _) = array(&folder.path().join(format!("{engine}/p.{column}.npy")));
            assert_eq!(shape, [3, rows, 20], "{engine} {column}");
        }
        let (shape, _) = array(&folder.path().join(format!("{engine}/q.delay.last.npy")));
        assert_eq!(shape, [3, 8, 1], "{engine}");
    }
    for column in columns {
        let of = |engine: &str| array(&folder.path().join(format!("{engine}/p.{column}.npy")));
        assert_eq!(of("golden"), of("fast"), "{column}");
    }
}

#[test]
fn recorded_random_numbers_repeat_a_run() {
    let folder = folder("Lava");
    // The scene has the same seed.
    let probes = "--samples 1..2 --probe p.weight --probe q.delay --seed 5";
    object(folder.path(), &format!("run m.ron {INPUT} {probes} --record-draws draws -o first"), 0);
    let draws = "--draws p=draws/p.npz --draws q=draws/q.npz";
    object(folder.path(), &format!("run m.ron {INPUT} {probes} --engine golden {draws} -o again"), 0);
    object(folder.path(), &format!("run m.ron {INPUT} {probes} --draws p=draws/q.npz -o other"), 0);
    let of = |run: &str, probe: &str| array(&folder.path().join(format!("{run}/{probe}.npy")));
    for probe in ["p.weight", "q.delay"] {
        assert_eq!(of("first", probe), of("again", probe), "{probe}");
    }
    assert_ne!(of("first", "p.weight"), of("other", "p.weight"), "other numbers");
    let (_, _, stderr) = said(folder.path(), "run m.ron --input scene:noise?samples=1&steps=24 --draws p=draws/p.npz");
    let missing = "takes 6 numbers of draw_x_decay in 24 steps, but 5 are given: the one of step 23";
    assert!(stderr.split_whitespace().collect::<Vec<_>>().join(" ").contains(missing), "{stderr}");
}

#[test]
fn a_learned_model_is_a_model() {
    for semantics in ["Silicon", "Lava"] {
        let folder = folder(semantics);
        let line = format!("run m.ron {INPUT} --probe p.weight.last --learned after.ron -o traces");
        let run = object(folder.path(), &line, 0);
        assert_eq!(run["files"].as_array().unwrap().len(), 3);
        let path = folder.path().join("after.ron");
        let learned = nsim::import::model::load_model(path.to_str().unwrap()).unwrap();
        let projections = &learned.file().projections;
        let ProjectionKind::Dense(weights) = &projections[1].kind else { panic!("{projections:?}") };
        let written: Vec<i32> = learned.tensor(weights).unwrap().reals().map(|weight| weight as i32).collect();
        let (shape, probed) = array(&folder.path().join("traces/p.weight.last.npy"));
        assert_eq!(shape, [3, 12, 1]);
        if run["activity"]["synaptic_updates"] != 0 {
            assert_eq!(written, probed[24..], "{semantics}");
        }
        assert!(projections[1].learning.is_some());
        object(folder.path(), &format!("run after.ron {INPUT}"), 0);
        object(folder.path(), &format!("run m.ron {INPUT} --fresh --learned frozen.ron --freeze"), 0);
        let frozen = nsim::import::model::load_model(folder.path().join("frozen.ron").to_str().unwrap()).unwrap();
        assert!(frozen.file().projections.iter().all(|projection| projection.learning.is_none()));
        object(folder.path(), &format!("run frozen.ron {INPUT}"), 0);
    }
}

#[test]
fn rules_and_options_of_rules_are_refused_by_name() {
    let folder = folder("Silicon");
    let random = "Random(name: \"q\", from: [\"in\"], to: \"out\", fan_out: 2, low: 0, high: 4, seed: 3";
    let listed = "Sparse(name: \"q\", from: [\"in\"], to: \"out\", synapses: [(0, 1, 4)]";
    std::fs::write(folder.path().join("listed.ron"), model("Silicon").replace(random, listed)).unwrap();
    for (line, code, says) in [
        ("run m.ron INPUT --engine reference", 3, "learning rule of projection 'p' cannot be run in real numbers"),
        ("agree m.ron INPUT", 3, "learning rule of projection 'p'"),
        ("convert m.ron INPUT -o c.ron", 3, "learning rule of projection 'p' cannot be converted"),
        ("export listed.ron -o m.nir", 3, "projection 'p' has a learning rule"),
        ("map m.ron --prune static", 3, "plastic"),
        ("run m.ron INPUT --probe z.weight -o t", 2, "projections that learn: p, q"),
        ("run m.ron INPUT --probe p.rate -o t", 2, "there is no rate; a rule has .weight, .delay"),
        ("run m.ron INPUT --draws z=a.npz --samples 0..1", 2, "projections that learn: p, q"),
        ("run m.ron INPUT --draws p=a.npz", 2, "choose one with --samples"),
        ("run m.ron INPUT --record-draws d --samples 0..1", 3, "draws for each synapse"),
        ("run slip-tactile --samples 0..1 --fresh", 2, "no projection of the model has a rule"),
        ("run m.ron INPUT --freeze", 2, "--learned"),
    ] {
        let (status, _, stderr) = said(folder.path(), &line.replace("INPUT", INPUT));
        let stderr = stderr.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(status == code && stderr.contains(says), "{line}: {status} {stderr}");
    }
}

/// A network that learns by PES.
fn pes(learning: &str) -> String {
    format!(
        "Network(name: \"m\", timestep_ms: 1.0, learning_semantics: Nengo, populations: [
            Input(name: \"in\", shape: [4]), Signal(name: \"err\", shape: [2]), Signal(name: \"three\", shape: [3]),
            Loihi(name: \"out\", shape: [4], du: 4096, dv: 2048, vth_mant: 4)],
        projections: [Dense(name: \"p\", from: [\"in\"], to: \"out\", learning: {learning},
            weights: [[8, 2, 4, 6], [2, 8, 4, 6], [4, 6, 8, 2], [2, 4, 4, 2]])],
        output: \"out\")"
    )
}

#[test]
fn pes_learns_alike_on_both_engines_and_from_recorded_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let rule = "Pes(error: \"err\", x1: (impulse: 99.5, tau: 5), until: 30)";
    std::fs::write(folder.path().join("m.ron"), pes(rule)).unwrap();
    let input = INPUT.replace("steps=20", "steps=40");
    let line = format!("run m.ron {input} --samples 1..2 --probe p.weight --probe p.x1 --probe p.weight.last");
    let run = object(folder.path(), &format!("{line} --record-draws draws --learned after.ron -o first"), 0);
    // 16 synapses in 7 epochs up to step 27.
    assert_eq!((&run["learning"][0]["updates"], &run["learning"][0]["epochs"]), (&(16 * 7).into(), &7.into()));
    object(folder.path(), &format!("{line} --engine golden --draws p=draws/p.npz -o again"), 0);
    object(folder.path(), &format!("{line} --seed 6 -o other"), 0);
    let of = |run: &str, probe: &str| array(&folder.path().join(format!("{run}/{probe}.npy")));
    for (probe, rows) in [("p.weight", 16), ("p.x1", 4)] {
        let (shape, values) = of("first", probe);
        assert_eq!(of("again", probe).1, values, "{probe}");
        assert_ne!(of("other", probe).1, values, "{probe}");
        assert_eq!(shape[..2], [1, rows]);
    }
    // The step in which weights learn has them.
    let (shape, weights) = of("first", "p.weight");
    let steps = shape[2];
    let differ = |step: usize| (0..16).any(|row| weights[row * steps + step] != weights[row * steps + step - 1]);
    assert!((1..steps).filter(|&step| differ(step)).all(|step| step % 4 == 3));
    assert!(differ(3) || differ(7));
    let last: Vec<i32> = (0..16).map(|row| weights[row * steps + steps - 1]).collect();
    assert_eq!(of("first", "p.weight.last").1, last);
    let path = folder.path().join("after.ron");
    let learned = nsim::import::model::load_model(path.to_str().unwrap()).unwrap();
    assert!(std::fs::read_to_string(path).unwrap().contains("learning: Pes("), "{:?}", learned.file().projections);
    object(folder.path(), &format!("run after.ron {input} --draws p=draws/p.npz --samples 0..1"), 0);
}

#[test]
fn what_learning_semantics_lack_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let reward = "Rule(dw: \"u0*r1\", r1: (from: \"in\", impulse: 2, tau: 1))";
    let plain = "Pes(error: \"err\", x1: (impulse: 9, tau: 5))";
    let brian = |rule: &str| pes(&format!("Rule({rule})")).replace("Nengo", "Brian");
    std::fs::write(folder.path().join("m.ron"), brian("dw: \"2^-3*x1*y0\", x1: (impulse: 64, tau: 8)")).unwrap();
    object(folder.path(), &format!("run m.ron {INPUT}"), 0);
    std::fs::write(folder.path().join("m.ron"), pes(reward).replace("Nengo", "Silicon")).unwrap();
    object(folder.path(), &format!("run m.ron {INPUT} --probe p.r1 --learned after.ron -o traces"), 0);
    assert_eq!(array(&folder.path().join("traces/p.r1.npy")).0, [3, 1, 20]);
    object(folder.path(), &format!("run after.ron {INPUT}"), 0);
    for (text, says) in [
        (pes("Rule(dw: \"x0\")"), "have Pes alone | 4"),
        (pes(plain).replace("Nengo", "Lava"), "the network's learning semantics are Lava | 4"),
        (brian("dw: \"x0\", dt: \"y0\""), "Brian lack the variable tag"),
        (brian("dw: \"x0*d\""), "Brian lack the variable delay"),
        (brian("dw: \"x0*r1\""), "Brian lack the reward channel r1"),
        (brian("dw: \"x0\", epoch: 2"), "each step learns"),
        (brian("dw: \"x0\", y1: (impulse: 2.5, tau: 3)"), "Brian have whole impulses, and whole taus from 1; tau is 3"),
        (brian("dw: \"x0*w*w*x1\""), "add up to 33554432, the limit is 4194304"),
        (brian("dw: \"x0*y2\", y2: Signal(\"err\")"), "Brian lack signals"),
        (pes(reward).replace("Nengo", "Lava"), "semantics Lava lack the reward channel r1"),
        (pes("Rule(dw: \"u0*r1\")").replace("Nengo", "Lava"), "semantics Lava lack the reward channel r1"),
        (pes(&plain.replace("err\"", "three\"")), "'three' has 3 values for 4 targets, which are not two"),
        (pes(&plain.replace("err\"", "in\"")), "'in' is not a Signal population"),
        (pes(&plain.replace("tau: 5)", "tau: 5), dw: \"x0\"")), "`dw`"),
    ] {
        std::fs::write(folder.path().join("m.ron"), text).unwrap();
        let (status, _, stderr) = said(folder.path(), &format!("run m.ron {INPUT}"));
        let stderr = stderr.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(status == 3 && stderr.contains(says), "{says}: {status} {stderr}");
    }
}

/// A network of two projections into one compartment, each with its rule or none.
fn two_rules(sources: usize, rules: [&str; 2]) -> String {
    let weights = vec!["2"; sources].join(", ");
    let [a, b] = rules.map(|rule| if rule.is_empty() { String::new() } else { format!(", learning: Rule({rule})") });
    format!(
        "Network(name: \"m\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [{sources}]), \
         Input(name: \"in2\", shape: [1]), Loihi(name: \"out\", shape: [1], du: 4095, dv: 128, vth_mant: 80)], \
         projections: [Dense(name: \"a\", from: [\"in\"], to: \"out\", weights: [[{weights}]]{a}), \
         Dense(name: \"b\", from: [\"in2\"], to: \"out\", weights: [[2]]{b})], output: \"out\")"
    )
}

/// Each remedy of each reason is tried.
#[test]
fn what_a_core_cannot_learn_is_refused_with_remedies_that_work() {
    let folder = tempfile::tempdir().unwrap();
    let fits = |more: &str, sources, rules: [&str; 2]| {
        std::fs::write(folder.path().join("m.ron"), two_rules(sources, rules)).unwrap();
        let map = object(folder.path(), &format!("map m.ron {more}"), 0);
        assert_eq!(map["fits"], true, "{more} {rules:?}: {}", map["reasons"]);
    };
    let sum = |products: usize| format!("dw: \"{}\"", vec!["x1*y1*y0"; products].join(" + "));
    let (nine, eight) = (sum(9), sum(8));
    let traces = |x1, x2| format!("dw: \"x1*x2*y0\", x1: (impulse: {x1}, tau: 5), x2: (impulse: {x2}, tau: 5)");
    let (one, other) = (traces(1, 2), traces(3, 4));
    let pair = "dw: \"x1*y0 - y1*x0\"";
    let remove = "; or remove `learning` from";
    for (sources, rules, resource, need, limit, advice, remedies) in [
        (
            1,
            [&*nine, &eight],
            "rule_words",
            17,
            16,
            "equal rules, or rules of fewer products",
            vec![[&*nine, &nine], [&eight, &eight]],
        ),
        (1, [&one, &other], "trace_configurations", 4, 3, "equal impulse and tau", vec![[&*one, &one]]),
        (2048, [pair, ""], "axons_in", 4097, 4096, remove, vec![]),
    ] {
        std::fs::write(folder.path().join("m.ron"), two_rules(sources, rules)).unwrap();
        let map = object(folder.path(), "map m.ron", 1);
        let reason = &map["reasons"][0];
        let found = [&reason["resource"], &reason["need"], &reason["limit"], &reason["population"]];
        assert_eq!(found.map(ToString::to_string).join(" "), format!("\"{resource}\" {need} {limit} \"out\""));
        let help = reason["help"].as_str().unwrap();
        assert!(help.contains(advice) && help.contains(&format!("{remove} 'a'")), "{help}");
        remedies.into_iter().for_each(|rules| fits("--target loihi1-chip", sources, rules));
        fits("--target loihi1-chip", sources, ["", rules[1]]);
        fits(&format!("--set target.limits.{resource}={need}"), sources, rules);
    }
    // A target that does not learn.
    let target = |name: &str, learns: bool| {
        let text = format!("Target(base: \"loihi1-chip\", name: \"{name}\", notes: \"\", learning: {learns})");
        std::fs::write(folder.path().join(format!("{name}.ron")), text).unwrap();
    };
    target("fixed", false);
    target("own", true);
    std::fs::write(folder.path().join("m.ron"), two_rules(1, [pair, ""])).unwrap();
    let refused = object(folder.path(), "map m.ron --target fixed.ron", 3);
    assert_eq!(refused["code"], "map.learning");
    let all = format!("{} {}", refused["message"], refused["help"]);
    let says = "'a' has a learning rule, and synapses of fixed do not learn";
    assert!(all.contains(says) && all.contains("set learning: true"), "{refused}");
    fits("--target own.ron", 1, [pair, ""]);
    fits("--target loihi1-chip", 1, [pair, ""]);
    fits("--target fixed.ron", 1, ["", ""]);
}
