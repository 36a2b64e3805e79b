//! The decision of a sample, by spikes of the output or by its potential: every engine, command and
//! reader uses one rule. And the number of its steps, so that the last layer responds to the last
//! step of the input.

use crate::common;
use crate::common::command::{object, said as nsim, succeeds};
use crate::tree::{self, ints, nir, typed};
use std::path::Path;

use crate::common::random;
use nsim::files::npy;
use nsim::import::hdf5;
use nsim::import::hdf5::Numbers;
use nsim::ir::arithmetic::ReadOut;
use nsim::ir::base::rng;
use nsim::ir::quantised::{Parts, Quantised};
use nsim::session::decision::{EarlyExit, Rule};
use nsim::session::{Outcome, Probe, Quantity, SampleSettings};
use rayon::prelude::*;
use serde_json::Value;

/// The class by its definition, from the potentials `[output][step]` from the output's start step
/// on.
fn class(read_out: ReadOut, v: &[Vec<i32>]) -> Option<u32> {
    let score = |v: &Vec<i32>| match read_out {
        ReadOut::GreatestV => v.iter().copied().max().map_or(0, i64::from),
        ReadOut::SumOfV => v.iter().copied().map(i64::from).sum(),
        _ => v.last().copied().map_or(0, i64::from),
    };
    let scores: Vec<i64> = v.iter().map(score).collect();
    let moved = v.iter().flatten().any(|&v| v != 0);
    let best = scores.iter().max().filter(|_| moved)?;
    scores.iter().position(|score| score == best).map(|class| class as u32)
}

fn keep(network: &Quantised, rule: Option<Rule>) -> SampleSettings {
    let output = network.output();
    let probe = Probe { first: output.first, count: output.count, quantity: Quantity::Potential };
    let early_exit = rule.map(|rule| EarlyExit::new(rule, network).unwrap());
    let probes = if rule.is_none() { vec![probe] } else { Vec::new() };
    SampleSettings { probes, early_exit, ..SampleSettings::new(output) }
}

#[test]
fn every_engine_decides_by_the_potentials_that_a_probe_reads() {
    let decided: usize = (0..240u64)
        .into_par_iter()
        .map(|seed| {
            let random = random::network(seed);
            let decision = ReadOut::ALL[1 + seed as usize % 3];
            let network = Quantised::new(Parts { decision, ..random.parts().clone() }).unwrap();
            let sample = random::sample(&network, seed);
            let mut classes = Vec::new();
            for (name, mut engine) in common::sessions(&network) {
                let what = format!("network {seed}, {name}");
                let mut run = |rule| engine.run(&sample, &keep(&network, rule), ());
                let whole = run(None);
                let from = (network.output().start_step as usize).min(whole.steps as usize);
                let rows = whole.probes[0].chunks(sample.steps().max(1) as usize).map(|row| row[from..].to_vec());
                assert_eq!(whole.class(), class(decision, &rows.collect::<Vec<_>>()), "{what}");
                // Nothing is certain before the last step, so no early exit skips a step.
                let certain = Outcome {
                    probes: whole.probes.clone(),
                    skipped_steps: whole.skipped_steps,
                    ..run(Some(Rule::Certain))
                };
                assert_eq!(certain, whole, "{what}");
                let margin = run(Some("40".parse().unwrap()));
                let until = margin.steps as usize;
                let row = |row: &[i32]| row[from.min(until)..until].to_vec();
                let rows: Vec<Vec<i32>> = whole.probes[0].chunks(sample.steps().max(1) as usize).map(row).collect();
                assert_eq!(margin.class(), class(decision, &rows), "{what}");
                classes.push((whole.class(), whole.potentials, margin.potentials));
            }
            assert!(classes.iter().all(|found| *found == classes[0]), "network {seed}");
            usize::from(classes[0].0.is_some())
        })
        .sum();
    assert!(decided > 100, "{decided} decided");
}

const STEPS: usize = 40;
const SAMPLES: usize = 6;
const CHANNELS: usize = 4;

/// Random spikes `[samples, channels, steps]`, with `empty` silent steps at the end; the last
/// sample is silent.
fn write_input(folder: &Path, name: &str, empty: usize) {
    let spike = |i: u64| u8::from((i as usize) < (SAMPLES - 1) * CHANNELS * STEPS && rng::below(5, 3, i, 0) == 0);
    let spikes: Vec<u8> = (0..(SAMPLES * CHANNELS * STEPS) as u64).map(spike).collect();
    let bytes: Vec<u8> = spikes.chunks(STEPS).flat_map(|row| [row, &vec![0; empty]].concat()).collect();
    let steps = STEPS + empty;
    write_array(folder, name, [SAMPLES, CHANNELS, steps], &bytes);
}

fn write_array(folder: &Path, name: &str, shape: [usize; 3], bytes: &[u8]) {
    let shape = shape.map(|axis| axis as u64);
    let file = std::fs::File::create(folder.join(name)).unwrap();
    npy::write(file, &shape, bytes.iter().copied()).unwrap();
}

const WEIGHTS: [f64; 12] = [0.5, -0.25, 0.125, 0.25, -0.5, 0.75, 0.25, -0.125, 0.25, 0.5, -0.75, 0.125];

/// A NIR file of an input, weights, and this node as its output.
fn write_nir(folder: &Path, node: Option<(&str, &[(&str, f64)])>) {
    let weights = typed("Linear").with("weight", Numbers::f64(&[3, CHANNELS], &WEIGHTS));
    let input = typed("Input").with("shape", ints(&[CHANNELS as i64]));
    let own = match node {
        Some((kind, fields)) => tree::node(kind, &[3], fields),
        None => tree::node("IF", &[CHANNELS], &[("r", 1.0), ("v_threshold", 0.5)]),
    };
    let nodes = [("in", input), ("w", weights), ("out", typed("Output").with("shape", ints(&[3]))), ("own", own)];
    let edges = match node {
        Some(_) => [("in", "w"), ("w", "own"), ("own", "out")],
        None => [("in", "own"), ("own", "w"), ("w", "out")],
    };
    std::fs::write(folder.join("net.nir"), hdf5::write(&nir(nodes, edges)).unwrap()).unwrap();
}

const LEAKY: (&str, &[(&str, f64)]) = ("LI", &[("tau", 5e-3), ("r", 5.0), ("v_leak", 0.0)]);

/// The classes of a run, from a probe of v over all of its steps.
fn by_probe(folder: &Path, model: &str, (population, drain): (&str, usize), read_out: ReadOut) -> Vec<Option<u32>> {
    write_input(folder, "long.npy", drain);
    let line = format!("run {model} --input long.npy --set drain=0 --probe {population}.v -o probes --force");
    object(folder, &line, 0);
    let v = common::Array::read(&folder.join(format!("probes/{population}.v.npy")));
    let row =
        |sample, output| (drain..STEPS + drain).map(|step| v.at([sample, output, step]) as i32).collect::<Vec<_>>();
    (0..SAMPLES).map(|sample| class(read_out, &(0..3).map(|output| row(sample, output)).collect::<Vec<_>>())).collect()
}

fn predicted(object: &Value) -> Vec<Option<u32>> {
    object["predicted"].as_array().unwrap().iter().map(|class| class.as_u64().map(|class| class as u32)).collect()
}

#[test]
fn an_output_that_never_spikes_is_read_out_by_its_potential() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_input(folder, "in.npy", 0);
    let integrator: (&str, &[(&str, f64)]) = ("I", &[("r", 1.0)]);
    for (node, output, decision, name) in [
        (Some(LEAKY), ("own", 0), ReadOut::GreatestV, "greatest_v"),
        (Some(integrator), ("own", 0), ReadOut::LastV, "last_v"),
        // A second layer: one more step, from step 1 on.
        (None, ("output", 1), ReadOut::SumOfV, "sum_of_v"),
    ] {
        write_nir(folder, node);
        let text = succeeds(folder, "import net.nir --dt 1 -o m.ron --force");
        let unwrapped = text.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(unwrapped.contains("its potential decides"), "{text}");
        let run = object(folder, "run m.ron --input in.npy", 0);
        assert_eq!((&run["decision"], &run["undecided"]), (&name.into(), &1.into()));
        assert_eq!(predicted(&run), by_probe(folder, "m.ron", output, decision), "{name}");
        assert!(predicted(&run)[..SAMPLES - 1].iter().all(Option::is_some), "{run}");
        // No message suggests making it spike, and a sample without input causes no warning.
        assert_eq!(run["warnings"], Value::Array(Vec::new()), "{name}");
        for engine in ["golden", "reference", "fast --early-exit certain", "fast --neurobench"] {
            let other = object(folder, &format!("run m.ron --input in.npy --engine {engine}"), 0);
            assert_eq!(other["predicted"], run["predicted"], "{name}, {engine}");
        }
        let agree = object(folder, "agree m.ron --input in.npy --require-class-agreement 1", 0);
        assert_eq!((&agree["compared"], &agree["class_agreement"]), (&5.into(), &1.0.into()), "{name}");
        assert_eq!(agree["attribution"][0]["class_agreement"], 1.0, "{name}");
        // The option of the import and the model's field change the decision that the import chose.
        for other in ["greatest_v", "sum_of_v", "last_v"] {
            object(folder, &format!("import net.nir --dt 1 --decision {other} -o other.ron --force"), 0);
            let run = object(folder, "run other.ron --input in.npy", 0);
            let read_out = ReadOut::ALL.into_iter().find(|read_out| read_out.name() == other).unwrap();
            assert_eq!(predicted(&run), by_probe(folder, "other.ron", output, read_out), "{name} by {other}");
            let set = object(folder, &format!("run m.ron --input in.npy --set decision={read_out:?}"), 0);
            assert_eq!((&set["predicted"], &set["decision"]), (&run["predicted"], &other.into()), "{name} by {other}");
        }
        // An exported file preserves it.
        assert_eq!(nsim(folder, "export m.ron -o back.nir --force").0, 0);
        assert_eq!(object(folder, "run back.nir --input in.npy", 0)["decision"], name);
    }
}

#[test]
fn samples_without_a_decision_are_no_agreement() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_input(folder, "in.npy", 0);
    write_nir(folder, Some(LEAKY));
    object(folder, "import net.nir --dt 1 --decision spikes -o silent.ron", 0);
    let run = object(folder, "run silent.ron --input in.npy", 0);
    assert_eq!((&run["undecided"], &run["decision"]), (&SAMPLES.into(), &"spikes".into()));
    // The suggested remedy decides every sample with input.
    let message = run["warnings"][0]["message"].as_str().unwrap();
    assert!(message.contains("--set decision=GreatestV"), "{message}");
    let remedied = object(folder, "run silent.ron --input in.npy --set decision=GreatestV", 0);
    assert_eq!((&remedied["undecided"], remedied["warnings"].as_array().unwrap().len()), (&1.into(), 0));
    let agree = object(folder, "agree silent.ron --input in.npy --require-class-agreement 0", 1);
    assert_eq!((&agree["compared"], &agree["class_agreement"]), (&0.into(), &Value::Null));
    let (code, text, _) = nsim(folder, "agree silent.ron --input in.npy");
    assert_eq!(code, 0);
    let in_one_line = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(in_one_line(&text).contains("not compared: 6 neither decides"), "{text}");
    // Two networks, each with its own decision.
    object(folder, "import net.nir --dt 1 -o decided.ron", 0);
    let line = "agree decided.ron --input in.npy --against silent.ron";
    assert_eq!(object(folder, line, 0)["compared"], 0);
    let text = in_one_line(&nsim(folder, line).1);
    assert!(text.contains("not compared: 5 a decides alone, 1 neither decides"), "{text}");
    let several = format!("{line} --against decided.ron --require-class-agreement 1");
    let both = object(folder, &several, 1);
    assert_eq!(both["networks"][0]["compared"], 0);
    assert_eq!((&both["networks"][1]["compared"], &both["networks"][1]["class_agreement"]), (&5.into(), &1.0.into()));
    // A network whose output receives nothing still has its warning.
    let nothing = "run decided.ron --input scene:noise?samples=1&steps=20&rate=0";
    let run = object(folder, nothing, 0);
    assert_eq!(run["warnings"][0]["code"], "silent-output");
    assert!(run["warnings"][0]["message"].as_str().unwrap().contains("'in' is silent"), "{run}");
}

#[test]
fn a_conversion_keeps_what_decides() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_input(folder, "in.npy", 0);
    let model = r#"Network(name: "read-out", timestep_ms: 1.0, populations: [Input(name: "in", shape: [4]),
        Srm(name: "hidden", shape: [5], tau_sr_ms: 5, tau_ref_ms: 1, scale_ref: 2, theta: 10),
        Srm(name: "out", shape: [3], tau_sr_ms: 5, tau_ref_ms: 1, scale_ref: 2, theta: 1000)],
        projections: [Dense(from: ["in"], to: "hidden", weights: Uniform(low: -1, high: 9, seed: 1)),
          Dense(from: ["hidden"], to: "out", weights: Uniform(low: -4, high: 6, seed: 2))],
        output: "out", decision: SumOfV)"#;
    std::fs::write(folder.join("srm.ron"), model).unwrap();
    for name in ["out.nir", "out.net"] {
        let (code, _, error) = nsim(folder, format!("export container-tactile-srm -o {name}").as_str());
        assert!(code == 3 && error.contains("'hidden' has spike response neurons"), "{code}: {error}");
        assert!(error.contains("nsim convert MODEL --input INPUT -o FILE.ron") && !folder.join(name).exists());
    }
    let convert = object(folder, "convert srm.ron --input in.npy -o loihi.ron", 0);
    assert!(convert["class_agreement"].is_number(), "{convert}");
    object(folder, "export loihi.ron -o out.nir", 0);
    let (trained, converted) = ("run srm.ron --input in.npy", "run loihi.ron --input in.npy");
    let (trained, converted) = (object(folder, trained, 0), object(folder, converted, 0));
    assert_eq!((&trained["decision"], &converted["decision"]), (&"sum_of_v".into(), &"sum_of_v".into()));
    assert_eq!(trained["undecided"], 1);
    let same = predicted(&trained).iter().zip(&predicted(&converted)).filter(|(a, b)| a == b).count();
    assert!(same >= SAMPLES - 1, "{trained} {converted}");
}

/// Fraction of the voltage lost in a step, which is no multiple of 1/4096.
const FRACTION: f64 = 1.0 / 7.3;
/// Units of the layers of [`layered`].
const SIZES: [usize; 4] = [CHANNELS, 5, 6, 3];

/// The weights from one layer to another, `[target][source]`.
fn weights(from: usize, to: usize) -> Vec<f64> {
    let count = SIZES[from] * SIZES[to];
    (0..count as u64).map(|i| 1.5 * rng::unit(9, (8 * from + to) as u64, i) - 0.45).collect()
}

/// A file of three layers of LIF neurons with a leak potential, and projections (from, to), where 0
/// is the input.
fn write_layered(folder: &Path, ways: &[(usize, usize)]) {
    let names = ["in", "a", "b", "c"];
    let shaped = |kind, n: usize| typed(kind).with("shape", ints(&[n as i64]));
    let fields = [("tau", 1e-3 / FRACTION), ("r", 1.0 / FRACTION), ("v_leak", 0.4), ("v_threshold", 1.0)];
    let neurons = names.into_iter().zip(SIZES).skip(1).map(|(name, n)| (name, tree::node("LIF", &[n], &fields)));
    let linear = |&(from, to): &(usize, usize)| {
        typed("Linear").with("weight", Numbers::f64(&[SIZES[to], SIZES[from]], &weights(from, to)))
    };
    let ends = |&(from, to): &(usize, usize)| (names[from], format!("w{from}{to}"), names[to]);
    let ends: Vec<_> = ways.iter().map(ends).collect();
    let linear = ends.iter().map(|(_, name, _)| name.as_str()).zip(ways.iter().map(linear));
    let nodes = [("in", shaped("Input", CHANNELS)), ("out", shaped("Output", 3))].into_iter().chain(neurons);
    let edges = ends.iter().flat_map(|(from, way, to)| [(*from, way.as_str()), (way.as_str(), *to)]);
    let root = nir(nodes.chain(linear), edges.chain([("c", "out")]));
    std::fs::write(folder.join("net.nir"), hdf5::write(&root).unwrap()).unwrap();
}

/// The output's spike counts of each sample in a tool whose layers all respond in one step, and
/// whose loops take effect in the next.
fn counted(input: &common::Array, ways: &[(usize, usize)]) -> Vec<Vec<u64>> {
    let sample = |sample: usize| {
        let mut v: Vec<Vec<f64>> = SIZES.iter().map(|&n| vec![0.0; n]).collect();
        let mut spikes: Vec<Vec<bool>> = SIZES.iter().map(|&n| vec![false; n]).collect();
        let mut counts = vec![0; SIZES[3]];
        for step in 0..STEPS {
            spikes[0] = (0..CHANNELS).map(|channel| input.at([sample, channel, step]) != 0).collect();
            for to in 1..SIZES.len() {
                let arrived = |unit: usize| -> f64 {
                    let way = |&(from, _): &(usize, usize)| -> f64 {
                        let row = weights(from, to)[unit * SIZES[from]..][..SIZES[from]].to_vec();
                        row.iter().zip(&spikes[from]).filter(|(_, spike)| **spike).map(|(weight, _)| weight).sum()
                    };
                    ways.iter().filter(|way| way.1 == to).map(way).sum()
                };
                let currents: Vec<f64> = (0..SIZES[to]).map(arrived).collect();
                for (unit, current) in currents.into_iter().enumerate() {
                    v[to][unit] = (1.0 - FRACTION) * v[to][unit] + current + FRACTION * 0.4;
                    spikes[to][unit] = v[to][unit] > 1.0;
                    if spikes[to][unit] {
                        v[to][unit] = 0.0;
                    }
                }
            }
            counts.iter_mut().zip(&spikes[3]).for_each(|(count, spike)| *count += u64::from(*spike));
        }
        counts
    };
    (0..SAMPLES).map(sample).collect()
}

#[test]
fn imported_layers_answer_to_every_step_of_the_input_as_in_the_tool_that_trained_them() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_input(folder, "in.npy", 0);
    let input = common::Array::read(&folder.join("in.npy"));
    let chain = [(0, 1), (1, 2), (2, 3)];
    for more in [&[][..], &[(2, 2)], &[(0, 3), (1, 3)], &[(0, 2), (3, 3), (1, 1), (1, 3)]] {
        let ways = [&chain[..], more].concat();
        write_layered(folder, &ways);
        succeeds(folder, "import net.nir --dt 1 -o m.ron --force");
        let run = object(folder, "run m.ron --input in.npy --engine reference", 0);
        let counts: Vec<Vec<u64>> = serde_json::from_value(run["output_counts"].clone()).unwrap();
        assert_eq!(counts, counted(&input, &ways), "{ways:?}");
        assert!(counts.iter().flatten().sum::<u64>() > 30, "{counts:?}");
        // Two layers after the first: two more steps, counted everywhere and printed.
        let steps = (SAMPLES * (STEPS + 2)) as u64;
        assert_eq!((&run["drain"], &run["timesteps"]), (&2.into(), &steps.into()), "{ways:?}");
        let mapped = object(folder, "run m.ron --input in.npy", 0);
        let updates = steps * SIZES[1..].iter().sum::<usize>() as u64;
        assert_eq!(
            (&mapped["timesteps"], &mapped["activity"]["compartment_updates"]),
            (&steps.into(), &updates.into())
        );
        assert!(nsim(folder, "run m.ron --input in.npy").1.contains("of each sample 2 after its last input step"));
        // Without them the last responses are missing, or the layers differ in time.
        let cut = object(folder, "run m.ron --input in.npy --engine reference --set drain=0", 0);
        assert_ne!(cut["output_counts"], run["output_counts"], "{ways:?}");
        // The trained network has the file's semantics: the decays are rounded on the chip alone,
        // and the stages report this.
        let agree = object(folder, "agree m.ron --input in.npy", 0);
        let causes: Vec<&str> =
            agree["attribution"].as_array().unwrap().iter().map(|c| c["cause"].as_str().unwrap()).collect();
        assert!(causes.contains(&"quantised-decays"), "{causes:?}");
    }
}

/// The first cause that `agree` reports, and the words of its suggested command.
fn first_cause(agree: &Value) -> (String, Vec<String>) {
    let cause = agree["attribution"][0]["cause"].as_str().unwrap().to_string();
    let command = agree["next"]["command"].as_str().unwrap_or_default();
    (
        cause,
        command.split(' ').skip(1).filter(|word| !["--format", "json"].contains(word)).map(str::to_string).collect(),
    )
}

#[test]
fn layers_that_answer_late_are_told_from_rounded_weights() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // Samples of a few steps end before the third layer has responded.
    let spikes = (0..24 * CHANNELS as u64 * 9).map(|i| u8::from(rng::below(3, 8, i, 0) == 0));
    write_array(folder, "in.npy", [24, CHANNELS, 9], &spikes.collect::<Vec<u8>>());
    let chain = [(0, 1), (1, 2), (2, 3)];
    for more in [&[][..], &[(2, 2)], &[(0, 3), (1, 3)]] {
        let ways = [&chain[..], more].concat();
        write_layered(folder, &ways);
        object(folder, "import net.nir --dt 1 -o m.ron --force", 0);
        // The model as for the chip: every layer from the first step on, no step at the end.
        let text = std::fs::read_to_string(folder.join("m.ron")).unwrap();
        let plain = text.lines().filter(|line| !line.trim_start().starts_with("provenance"));
        let plain: String = plain.map(|line| format!("{line}\n")).collect();
        let plain =
            ["start_step: 1", "start_step: 2"].iter().fold(plain, |text, step| text.replace(step, "start_step: 0"));
        let plain =
            plain.replace("drain: 2", "drain: 0").replace("delay: 1", "delay: 0").replace("delay: 2", "delay: 0");
        std::fs::write(folder.join("chip.ron"), plain).unwrap();
        let steps = "agree chip.ron --input in.npy";
        let agree = object(folder, steps, 0);
        let (cause, words) = first_cause(&agree);
        assert_eq!(cause, "pipeline-delay", "{ways:?}: {agree:#}");
        assert_eq!(agree["next"]["cause"], "pipeline-delay", "{ways:?}: {agree:#}");
        let (_, text, _) = nsim(folder, steps);
        assert!(text.contains("Classes agree in") && text.contains("without pipeline delay"), "{text}");
        // The command makes the changes that import makes.
        let line = words.join(" ");
        assert!(line.starts_with("agree chip.ron --input") && line.contains("--set drain=2"), "{line}");
        let mended = object(folder, &line.replace('\'', ""), 0);
        let causes = mended["attribution"].as_array().unwrap().iter().map(|row| row["cause"].as_str().unwrap());
        assert!(!causes.clone().any(|cause| cause == "pipeline-delay"), "{mended:#}");
        let classes =
            |agree: &Value| agree["attribution"].as_array().unwrap().last().unwrap()["class_agreement"].as_f64();
        assert!(classes(&mended) > classes(&agree), "{ways:?}: {agree:#} {mended:#}");
        let imported = object(folder, "run m.ron --input in.npy --engine reference", 0);
        let sets = line.split(" --set ").skip(1).map(|set| format!(" --set {set}")).collect::<String>();
        let chip = object(folder, &format!("run chip.ron --input in.npy --engine reference{sets}"), 0);
        assert_eq!(chip["output_counts"], imported["output_counts"], "{ways:?}");
        // An import with these changes loses nothing to the pipeline.
        assert_ne!(first_cause(&object(folder, "agree m.ron --input in.npy", 0)).0, "pipeline-delay");
    }
}

#[test]
fn what_reads_spikes_alone_refuses_an_output_read_out_by_its_potential() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_input(folder, "in.npy", 0);
    write_nir(folder, Some(LEAKY));
    object(folder, "import net.nir --dt 1 -o m.ron", 0);
    let (code, _, stderr) = nsim(folder, "convert m.ron --input in.npy --fine-tune 1");
    assert!(code == 3 && stderr.contains("it decides by potentials"), "{code}: {stderr}");
    assert!(stderr.contains("nsim train, with the loss Potential"), "{stderr}");
    // An imported network is refused before its conversion, and no message suggests fine-tuning it.
    write_layered(folder, &[(0, 1), (1, 2), (2, 3)]);
    let (code, _, stderr) = nsim(folder, "convert net.nir --dt 1 --input in.npy --fine-tune 1");
    assert!(code == 3 && stderr.contains("not spike response neurons"), "{code}: {stderr}");
    for command in ["convert", "agree"] {
        let (_, text, stderr) = nsim(folder, &format!("{command} net.nir --dt 1 --input in.npy"));
        assert!(!text.contains("fine-tun") && !stderr.contains("fine-tun"), "{text}{stderr}");
    }
}

#[test]
fn a_drain_is_bounded() {
    let folder = tempfile::tempdir().unwrap();
    write_layered(folder.path(), &[(0, 1), (1, 2), (2, 3)]);
    object(folder.path(), "import net.nir --dt 1 -o m.ron", 0);
    let (code, _, stderr) = nsim(folder.path(), "run m.ron --set drain=65536");
    assert!(code == 3 && stderr.contains("drain 65536 is outside 0..=65535"), "{code}: {stderr}");
}

#[test]
fn public_cases_have_the_classes_of_their_potentials() {
    let Some(cases) = common::data("cases") else { return };
    let case = cases.join("readout-by-potential");
    let right = std::fs::read_to_string(case.join("right.csv")).unwrap();
    let column = |place| right.lines().skip(1).map(|line| line.split(',').nth(place).unwrap().parse().ok()).collect();
    let folder = tempfile::tempdir().unwrap();
    std::fs::copy(case.join("net.nir"), folder.path().join("net.nir")).unwrap();
    std::fs::copy(case.join("input.npy"), folder.path().join("in.npy")).unwrap();
    for (place, decision) in [(1, "greatest_v"), (2, "sum_of_v"), (3, "last_v")] {
        let column: Vec<Option<u32>> = column(place);
        object(folder.path(), &format!("import net.nir --decision {decision} -o m.ron --force"), 0);
        for engine in ["fast", "golden", "reference"] {
            // The potentials are of the chip's steps, without the extra step of the second layer.
            let line = format!("run m.ron --input in=in.npy --set drain=0 --engine {engine}");
            let run = object(folder.path(), &line, 0);
            assert_eq!(predicted(&run), column, "{decision}, {engine}");
        }
    }
}
