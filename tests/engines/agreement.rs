//! The stages from a trained network to the machine: both ends equal the networks that they
//! represent, and every stage makes a difference.

use std::process::Command;

use crate::common::command::{object, said, succeeds};
use crate::common::{data, noise};
use nsim::agree::attribution::{Distance, as_trained, attribute, compare_stages};
use nsim::agree::causes::{Cause, ComparisonStage};
use nsim::agree::staged::{StagedNetwork, layers};
use nsim::agree::trace::{Layer, Trace};
use nsim::compile::{Options, compile};
use nsim::files::lower::lower;
use nsim::files::target::load_target;
use nsim::golden::Golden;
use nsim::ir::base::rng;
use nsim::ir::graph::Graph;
use nsim::ir::spikes::{Engine, Sample};
use nsim::machine::{Image, Machine, Settings};
use nsim::quantise::analytic;
use nsim::quantise::analytic::Fit;
use nsim::reference;
use nsim::reference::{Kernel, Model, Reference};
use nsim::train::convert::search::search;
use nsim_testing::graph;

/// A small network like the paper's tactile one: weights of both signs, high rates.
const SRM: &str = r#"Network(name: "srm", timestep_ms: 1.0, populations: [
    Input(name: "in", shape: [30]),
    Srm(name: "h", shape: [12], tau_sr_ms: 10, tau_ref_ms: 1, scale_ref: 2, theta: 10),
    Srm(name: "o", shape: [4], tau_sr_ms: 10, tau_ref_ms: 1, scale_ref: 2, theta: 10)],
    projections: [
        Dense(from: ["in"], to: "h", weights: Uniform(low: -1.5, high: 3, seed: 1)),
        Dense(from: ["h"], to: "o", weights: Uniform(low: -2, high: 3, seed: 2))],
    output: "o")"#;

/// A network of spike response neurons that distinguishes the classes of [`samples`]. Each hidden
/// neuron has its own channels of one class, each output its own hidden neurons.
fn decided() -> String {
    let row = |own: u32, columns: u32, strong: f64, seed: u64| {
        let weight = |c: u32| {
            let noise = 0.3 * (rng::unit(seed, own.into(), c.into()) - 0.5);
            format!("{:.4}", if c % 4 == own % 4 { strong * (1.0 + noise) } else { -0.15 * strong + 0.3 * noise })
        };
        format!("[{}]", (0..columns).map(weight).collect::<Vec<_>>().join(", "))
    };
    let rows = |rows: u32, columns: u32, strong: f64, seed: u64| {
        format!("[{}]", (0..rows).map(|own| row(own, columns, strong, seed)).collect::<Vec<_>>().join(",\n"))
    };
    SRM.replace("Uniform(low: -1.5, high: 3, seed: 1)", &rows(12, 30, 0.9, 1))
        .replace("Uniform(low: -2, high: 3, seed: 2)", &rows(4, 12, 1.2, 2))
}

/// Loihi neurons given in real numbers, with a recurrent projection, a bias and a convolution.
const REAL: &str = r#"Network(name: "real", timestep_ms: 1.0, populations: [
    Input(name: "in", shape: [1, 5, 6]),
    Loihi(name: "c", shape: [2, 3, 3], tau_u_ms: 4.2, tau_v_ms: 17.0, vth: 1.3, refractory: 2),
    Loihi(name: "o", shape: [4], tau_u_ms: 3.0, tau_v_ms: 30.0, vth: 2.0, bias: 0.03, start_step: 2)],
    projections: [
        Conv2d(from: ["in"], to: "c", weights: [[[[0.3, -0.1], [0.2, 0.77], [0.5, 0.1]]], [[[0.1, 0.4], [-0.2, 0.3], [0.9, 0.35]]]], stride: (1, 2)),
        Dense(from: ["c"], to: "o", weights: Uniform(low: -0.4, high: 0.7, seed: 2), delay: 2),
        Dense(from: ["o"], to: "o", weights: Uniform(low: -0.6, high: 0.2, seed: 3), weight_exp: -1)],
    output: "o")"#;

fn samples(seeds: std::ops::Range<u64>) -> Vec<Sample> {
    let one = |seed: u64| {
        // Each class has its own channels with many spikes; another class has somewhat more.
        let draw = |what: u64| rng::unit(seed, 1_000, what);
        let (strong, weak) = (0.06 + 0.06 * draw(0), 0.035 + 0.05 * draw(1));
        let other = (seed + 1 + (3.0 * draw(2)) as u64) % 4;
        let rate = |c: u32| match u64::from(c) % 4 {
            class if class == seed % 4 => strong,
            class if class == other => weak,
            _ => 0.03,
        };
        noise((30, 150), seed, rate, Some((seed % 4) as u32))
    };
    seeds.map(one).collect()
}

fn borrowed(samples: &[Sample]) -> Vec<&Sample> {
    samples.iter().collect()
}

/// Distance between two comparison stages.
fn distance(
    staged: &StagedNetwork,
    (from, to): (ComparisonStage, ComparisonStage),
    output: &Layer,
    samples: &[&Sample],
) -> Distance {
    compare_stages((staged, from), &[(staged, to)], output, samples)[0].distance
}

/// Fits whose free integers all differ from the analytic start.
fn chosen(graph: &Graph) -> Vec<Option<Fit>> {
    let moved = |fit: Fit, count: u32| Fit {
        dv: nsim::ir::base::fixed::Decay::new(900).unwrap(),
        refractory: nsim::ir::base::fixed::Refractory::new(2).unwrap(),
        taps: vec![(2, 0.7), (5, 0.4)],
        own: vec![vec![fit.threshold * 0.2], (0..count).map(|i| -0.02 * fit.threshold * f64::from(i)).collect()],
        threshold: fit.threshold * 0.6,
        ..fit
    };
    let starts = analytic::starts(graph).into_iter();
    starts.zip(graph.populations()).map(|(fit, (_, p))| fit.map(|fit| moved(fit, p.shape.len()))).collect()
}

#[test]
fn without_a_cause_it_is_the_trained_network() {
    let graph = graph(SRM);
    for fits in [analytic::starts(&graph), chosen(&graph)] {
        let staged = StagedNetwork::new(&graph, &fits).unwrap();
        let mut spikes = 0;
        for (kernel, stage) in [
            (Kernel::Truncated, ComparisonStage::TRAINED),
            (Kernel::Exact, ComparisonStage::TRAINED.with(Cause::Untruncated)),
        ] {
            let model = Model::<f64>::new(&graph, reference::Options { kernel }).unwrap();
            for sample in &samples(0..6) {
                let engine =
                    Trace::record(&mut Reference::new(&model), sample, (16, staged.deployed().output()), |e, c| {
                        e.potential(c) / 10.0
                    });
                let trace = staged.run(stage, sample, true);
                assert_eq!(trace.trains, engine.trains, "{kernel:?}");
                let near = trace.potentials.iter().zip(&engine.potentials).all(|(a, b)| (a - b).abs() < 1e-4);
                assert!(near, "{kernel:?}");
                spikes += trace.trains.iter().map(Vec::len).sum::<usize>();
            }
        }
        assert!(spikes > 2000, "{spikes} spikes show little");
    }
}

/// Networks whose parameters do not fit the chip's fields, in many ways.
fn unrounded() -> [String; 4] {
    let [h, o, own] =
        [integers((6, 30), 1, (-7, 15), 2), integers((3, 6), 1, (-30, 61), 3), integers((3, 3), 1, (-9, 7), 4)];
    [
        REAL.to_string(),
        // Integers of the chip, with odd weights, a negative exponent and a narrow range of v.
        format!(
            r#"Network(name: "integers", timestep_ms: 1.0, populations: [
                Input(name: "in", shape: [30]),
                Loihi(name: "h", shape: [6], du: 1000, dv: 137, vth_mant: 60, refractory: 2, vmin_exp: 10, bias_mant: 3, bias_exp: 2),
                Loihi(name: "o", shape: [3], tau_u_ms: 3.3, tau_v_ms: 71.7, vth_mant: 90)],
                projections: [Dense(from: ["in"], to: "h", weights: {h}, weight_exp: -1),
                    Dense(from: ["h"], to: "o", weights: {o}), Dense(from: ["o"], to: "o", weights: {own}, delay: 2)],
                output: "o")"#
        ),
        // Long time constants, which 4096ths represent coarsely.
        r#"Network(name: "slow", timestep_ms: 1.0, populations: [
            Input(name: "in", shape: [30]),
            Loihi(name: "h", shape: [8], tau_u_ms: 900.0, tau_v_ms: 1700.0, vth: 30, start_step: 3),
            Loihi(name: "o", shape: [4], tau_u_ms: 1100.0, tau_v_ms: 1300.0, vth: 20, bias: 0.11)],
            projections: [Dense(from: ["in"], to: "h", weights: Uniform(low: -0.4, high: 0.7, seed: 2)),
                Dense(from: ["h"], to: "o", weights: Uniform(low: -0.4, high: 0.7, seed: 3))],
            output: "o", reset: (interval: 60, offset: 2), drain: 2)"#
            .to_string(),
        format!(
            r#"Network(name: "slayer", timestep_ms: 1.0, semantics: Slayer, populations: [
                Input(name: "in", shape: [30]),
                Loihi(name: "o", shape: [4], du: 700, dv: 200, vth_mant: 70, refractory: 1)],
                projections: [Dense(from: ["in"], to: "o", weights: {})], output: "o")"#,
            integers((4, 30), 1, (-30, 60), 3)
        ),
    ]
}

#[test]
fn it_begins_where_the_reference_engine_ends() {
    let mut spikes = 0;
    for text in unrounded() {
        let graph = graph(&text);
        let staged = StagedNetwork::new(&graph, &analytic::starts(&graph)).unwrap();
        let network = staged.deployed();
        let model = Model::<f64>::new(&graph, reference::Options::default()).unwrap();
        let thresholds = nsim::dynamics::model_thresholds(&graph);
        let begin = staged.trained().with(Cause::Pipeline);
        assert_ne!(begin, ComparisonStage::MACHINE);
        for sample in &samples(0..6) {
            let of = (network.compartments(), network.output());
            let engine = Trace::record(&mut Reference::new(&model), sample, of, |engine, c| {
                engine.potential(c) / thresholds[c.0 as usize]
            });
            let trace = staged.run(begin, sample, true);
            assert_eq!(trace.trains, engine.trains, "{}", graph.facts().name);
            for (at, (a, b)) in trace.potentials.iter().zip(&engine.potentials).enumerate() {
                let (c, t) = (at / 150, (at % 150) as u32);
                let spiked = trace.trains[c].binary_search(&t).is_ok();
                assert!(spiked || (a - b).abs() < 1e-4, "{}: {c} {t} {a} {b}", graph.facts().name);
            }
            spikes += trace.trains.iter().map(Vec::len).sum::<usize>();
        }
    }
    assert!(spikes > 500, "{spikes} spikes show little");
}

/// Compares the last stage with the golden interpreter and the machine, in all spikes and v.
fn is_the_machine(graph: &Graph, fits: &[Option<Fit>], samples: &[Sample], some: usize) {
    let staged = StagedNetwork::new(graph, fits).unwrap();
    let network = staged.deployed();
    let target = load_target("loihi1-chip").unwrap();
    let compiled = compile(network.clone(), &target, &Options::default()).unwrap();
    let image = Image::new(&compiled.program, 1).unwrap();
    let mut golden = Golden::new(network);
    let mut machine = Machine::new(&image, Settings::default());
    let mut spikes = 0;
    for sample in samples {
        let trace = staged.run(ComparisonStage::MACHINE, sample, true);
        let count = (network.compartments(), network.output());
        let a = Trace::record(&mut golden, sample, count, |e, c| f64::from(e.v(c)));
        let b = Trace::record(&mut machine, sample, count, |e, c| f64::from(e.v(c)));
        assert_eq!(trace.trains, a.trains);
        assert_eq!(a, b);
        let thresholds: Vec<f64> = layers(network).iter().flat_map(|layer| thresholds(network, layer)).collect();
        for (c, threshold) in thresholds.iter().enumerate() {
            for t in 0..150u32 {
                if trace.trains[c].binary_search(&t).is_err() {
                    let at = c * 150 + t as usize;
                    assert_eq!(trace.potentials[at], (f64::from(a.potentials[at]) / threshold) as f32, "{c} {t}");
                }
            }
        }
        spikes += trace.trains.iter().map(Vec::len).sum::<usize>();
    }
    assert!(spikes > some, "{spikes} spikes show little");
}

fn thresholds(network: &nsim::ir::quantised::Quantised, layer: &Layer) -> Vec<f64> {
    let population = &network.populations()[network.population_named(&layer.name).unwrap()];
    population.each_neuron().map(|neuron| 64.0 * f64::from(neuron.vth.get())).collect()
}

#[test]
fn with_every_cause_it_is_the_machine_bit_for_bit() {
    let srm = graph(SRM);
    is_the_machine(&srm, &analytic::starts(&srm), &samples(0..6), 500);
    is_the_machine(&srm, &chosen(&srm), &samples(0..6), 500);
    let real = graph(REAL);
    is_the_machine(&real, &analytic::starts(&real), &samples(0..6), 500);
    let shipped = lower(&nsim::import::model::load_model("vtsnn-slip").unwrap()).unwrap();
    let shown = [1, 2].map(|seed| noise((3306, 150), seed, |_| 0.03, None));
    is_the_machine(&shipped, &analytic::starts(&shipped), &shown, 0);
}

#[test]
fn every_rung_is_real() {
    let graph = graph(SRM);
    let staged = StagedNetwork::new(&graph, &chosen(&graph)).unwrap();
    // A spike response network was trained with a latency of one step a layer.
    let of_srm = || Cause::ALL.into_iter().filter(|&cause| cause != Cause::Pipeline);
    assert_eq!(staged.causes(), of_srm().collect::<Vec<_>>());
    let (samples, output) = (samples(0..12), staged.layers()[1].clone());
    let samples = borrowed(&samples);
    let mut stage = staged.trained();
    for cause in of_srm() {
        let next = stage.with(cause);
        let away = distance(&staged, (stage, next), &output, &samples);
        // With equal decays the kernel is the alpha kernel itself: this stage shifts time alone.
        match cause {
            Cause::Kernel => {
                let traces = [stage, next].map(|stage| staged.run(stage, samples[0], false));
                assert_ne!(traces[0].trains, traces[1].trains);
                assert!(away.coincidence > 0.999, "{away:?}");
            }
            _ => assert!(away.potential_rmse.unwrap() > 1e-7, "{}: {away:?}", cause.name()),
        }
        stage = next;
    }
    // Compared with the trained network, each stage that is taken away changes the figure.
    let all = distance(&staged, (staged.trained(), ComparisonStage::MACHINE), &output, &samples);
    // Decaying current and voltage are not truncated, so once they are there the truncation has no
    // effect.
    for missing in of_srm().filter(|&cause| cause != Cause::Untruncated) {
        let without =
            Cause::ALL.into_iter().filter(|&c| c != missing).fold(ComparisonStage::TRAINED, ComparisonStage::with);
        let away = distance(&staged, (staged.trained(), without), &output, &samples);
        assert_ne!(away, all, "{}", missing.name());
    }
}

#[test]
fn shares_add_up_to_the_disagreement() {
    let graph = graph(SRM);
    let staged = StagedNetwork::new(&graph, &analytic::starts(&graph)).unwrap();
    let (samples, output) = (samples(0..10), staged.layers()[1].clone());
    let attribution = attribute(&staged, &output, &borrowed(&samples));
    let names: Vec<&str> = attribution.shares.iter().map(|share| share.cause.name()).collect();
    assert!(names.len() >= 5 && !names.contains(&"calibration"), "{names:?}");
    let sum = |pick: fn(&nsim::agree::attribution::Share) -> f64| attribution.shares.iter().map(pick).sum::<f64>();
    assert!((sum(|s| s.forward) - attribution.disagreement).abs() < 1e-9);
    assert!((sum(|s| s.reversed) - attribution.disagreement).abs() < 1e-9);
    // Shares are fractions of the whole, or there are none.
    let shares: Vec<f64> = attribution.shares.iter().filter_map(|share| share.share).collect();
    assert!(shares.is_empty() || (shares.iter().sum::<f64>() - 1.0).abs() < 1e-9, "{shares:?}");
    assert!(shares.iter().all(|share| (0.0..=1.0).contains(share)), "{shares:?}");
    assert!(attribution.disagreement > 0.01);
    assert_eq!(attribution.shares.last().unwrap().stage.class_agreement, {
        let trained = as_trained(&staged, &output, &borrowed(&samples));
        distance(&staged, (trained, ComparisonStage::MACHINE), &output, &borrowed(&samples)).class_agreement
    });
}

#[test]
fn the_search_comes_nearer_than_the_analytic_start() {
    let graph = graph(decided());
    let (calibration, unseen) = (samples(100..130), samples(0..60));
    let found = search(&graph, &borrowed(&calibration), 16, |_| ()).unwrap();
    assert!(found.end.count_error < 0.6 * found.start.count_error, "{:?} {:?}", found.start, found.end);
    assert_eq!(found, search(&graph, &borrowed(&calibration), 16, |_| ()).unwrap(), "the same search twice");
    let output = StagedNetwork::new(&graph, &found.conversion.fits).unwrap().layers()[1].clone();
    let trained = ComparisonStage::TRAINED.with(Cause::Untruncated);
    let on_unseen = |fits: &[Option<Fit>]| {
        let staged = StagedNetwork::new(&graph, fits).unwrap();
        distance(&staged, (trained, ComparisonStage::MACHINE), &output, &borrowed(&unseen))
    };
    let (start, end) = (on_unseen(&analytic::starts(&graph)), on_unseen(&found.conversion.fits));
    assert!(end.coincidence > start.coincidence + 0.5, "{start:?} {end:?}");
    assert!(end.potential_rmse < start.potential_rmse.map(|error| error / 2.0), "{start:?} {end:?}");
}

const SILICON: &str = r#"Network(name: "silicon", timestep_ms: 1.0, populations: [
    Input(name: "in", shape: [250]),
    Loihi(name: "hidden", shape: [25], du: 1024, dv: 128, vth_mant: 80),
    Loihi(name: "out", shape: [1], du: 1024, dv: 128, vth_mant: 80)],
    projections: [Dense(from: ["in"], to: "hidden", weights: Npy("DATA/weights_1.npy")),
        Dense(from: ["hidden"], to: "out", weights: Npy("DATA/weights_2.npy"))],
    output: "out")"#;

#[test]
fn the_recorded_spikes_of_the_chip_agree_exactly() {
    let Some(data) = data("silicon") else { return };
    let data = data.canonicalize().unwrap();
    let (folder, at) = (tempfile::tempdir().unwrap(), |file: &str| data.join(file).display().to_string());
    let input = at("input.npy");
    std::fs::write(folder.path().join("silicon.ron"), SILICON.replace("DATA", data.to_str().unwrap())).unwrap();
    let [hidden, out] = [("hidden", "hidden_spikes.npy"), ("out", "output_spikes.npy")]
        .map(|(population, file)| format!("{population}={}", at(file)));
    let line = ["agree", "silicon.ron", "--input", &input, "--require-exact", "--against", &hidden];
    let json = object(folder.path(), &[&line[..], &["--against", &out, "--steps", "499"]].concat(), 0);
    assert_eq!((&json["class_agreement"], &json["layers"][0]["spikes_a"]), (&1.0.into(), &639.into()));
    assert_eq!(
        (&json["layers"][0]["shift"], &json["layers"][1]["first_divergence"]),
        (&0.into(), &serde_json::Value::Null)
    );
    // The recording ends before step 499, in which the chip spiked.
    assert_eq!(said(folder.path(), &line).0, 1);
}

/// A matrix of random multiples of a step.
fn integers((rows, columns): (u32, u32), step: i64, (low, high): (i64, i64), seed: u64) -> String {
    let weight = |at: u32| step * (low + rng::below((high - low + 1) as u64, seed, at.into(), 0) as i64);
    let row = |row: u32| {
        let weights = (0..columns).map(|column| weight(row * columns + column).to_string());
        format!("[{}]", weights.collect::<Vec<_>>().join(", "))
    };
    format!("[{}]", (0..rows).map(row).collect::<Vec<_>>().join(", "))
}

/// The words of a result's suggested command, as a shell splits them.
fn next_words(result: &serde_json::Value) -> Vec<String> {
    let command = result["next"]["command"].as_str().unwrap_or_else(|| panic!("nothing is named: {result:#}"));
    let line = Command::new("sh").args(["-c", &format!("printf '%s\\n' {command}")]).output().unwrap();
    String::from_utf8(line.stdout).unwrap().lines().skip(1).map(str::to_string).collect()
}

const NOISE: &str = "scene:noise?samples=12&steps=80&rate=0.15&seed=4";

#[test]
fn each_command_that_is_named_does_what_it_says() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let model = |thresholds: (u32, u32), (du, dv): (u32, u32), weights: [String; 2], exponent: i32| {
        let ([first, second], (h, o)) = (weights, thresholds);
        format!(
            r#"Network(name: "n", timestep_ms: 1.0, populations: [Input(name: "in", shape: [30]),
                Loihi(name: "h", shape: [9], du: {du}, dv: {dv}, vth_mant: {h}, bias_mant: 3),
                Loihi(name: "o", shape: [4], du: {du}, dv: {dv}, vth_mant: {o})],
                projections: [Dense(from: ["in"], to: "h", weights: {first}, weight_exp: {exponent}),
                    Dense(from: ["h"], to: "o", weights: {second}, weight_exp: {exponent})], output: "o", drain: 1)"#
        )
    };
    let weights =
        |least: i64, most: i64| [integers((9, 30), 2, (-least, least), 1), integers((4, 9), 2, (-least, most), 2)];
    let state = model((8, 9), (1500, 10), weights(1, 2), 0);
    let dropped = model((3, 2), (1000, 137), weights(8, 16), -4);
    let narrow = r#"Network(name: "narrow", timestep_ms: 1.0, populations: [Input(name: "in", shape: [30]),
        Loihi(name: "o", shape: [6], tau_u_ms: 4.2, tau_v_ms: 17.0, vth: 1.3)],
        projections: [Dense(from: ["in"], to: "o", weights: Uniform(low: -0.2, high: 0.5, seed: 2), weight_bits: 3)],
        output: "o")"#;
    let disagreement = |result: &serde_json::Value| result["disagreement"].as_f64().unwrap();
    for (name, text, cause, options) in [
        ("state.ron", &state[..], Some("integer-state"), &[][..]),
        ("dropped.ron", &dropped, Some("quantised-weights"), &[]),
        ("narrow.ron", narrow, Some("quantised-weights"), &[]),
        ("srm.ron", &decided(), Some("hard-reset"), &["--conversion", "analytic"]),
        ("srm.ron", &decided(), None, &["--delayed-copies", "1"]),
    ] {
        std::fs::write(folder.join(name), text).unwrap();
        let words = [&["agree", name, "--input", NOISE], options].concat();
        let before = object(folder, &words, 0);
        let what = format!("{name} {options:?}: {before:#}");
        assert!(cause.is_none_or(|cause| before["next"]["cause"] == cause), "{what}");
        let words = next_words(&before);
        let out = succeeds(folder, &words.join(" "));
        let after: serde_json::Value = serde_json::from_str(&out).unwrap();
        assert!(disagreement(&after) < disagreement(&before) - 0.005, "{words:?}: {what}");
        // A picture is suggested where no option helps.
        if after["next"]["cause"].is_null() && after["next"].is_object() {
            let words = next_words(&after);
            assert_eq!(said(folder, &words.join(" ")).0, 0, "{words:?}");
            assert!(std::fs::remove_file(folder.join("first.svg")).is_ok(), "{words:?}");
        }
    }
}

#[test]
fn a_loss_to_rounded_weights_leads_to_the_page_that_regains_it() {
    let folder = tempfile::tempdir().unwrap();
    let page = "docs/tutorials/rounded-weights.md";
    assert!(std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(page).exists());
    let text = r#"Network(name: "r", timestep_ms: 1.0, populations: [Input(name: "in", shape: [30]),
        Loihi(name: "o", shape: [6], du: 4096, dv: 400, vth: 1.3)],
        projections: [Dense(from: ["in"], to: "o", weights: Uniform(low: -0.2, high: 0.5, seed: 2), weight_bits: 3)],
        output: "o")"#;
    std::fs::write(folder.path().join("r.ron"), text).unwrap();
    let joined = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    for line in ["agree r.ron", "convert r.ron"] {
        let text = joined(&succeeds(folder.path(), &format!("{line} --input {NOISE}")));
        assert!(text.contains("most to rounded weights") && text.contains(page), "{line}: {text}");
        assert!(text.contains("weight_bits=8"), "{line}: {text}");
        // With all bits no change of the file helps, but training does.
        let all = format!("{line} --input {NOISE} --set projections.0.weight_bits=8");
        let all = joined(&succeeds(folder.path(), &all));
        assert!(all.contains("--plot first.svg") && all.contains(page), "{line}: {all}");
    }
    let (code, _, refusal) = said(folder.path(), &format!("convert r.ron --fine-tune 3 --input {NOISE}"));
    assert!(code == 3 && joined(&refusal).contains(page), "{code}: {refusal}");
}

#[test]
fn agree_and_convert_blame_the_same_cause() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for (name, text) in [("srm.ron", &decided()[..]), ("real.ron", REAL)] {
        std::fs::write(folder.join(name), text).unwrap();
        let [agree, convert] = ["agree", "convert"]
            .map(|command| object(folder, &format!("{command} {name} --calibrate {NOISE} --input {NOISE}"), 0));
        let blamed = |result: &serde_json::Value| -> Vec<(String, serde_json::Value)> {
            let rows = result["lost"].as_array().unwrap().iter();
            rows.map(|row| (row["name"].as_str().unwrap().to_string(), row["cause"].clone())).collect()
        };
        assert_eq!(blamed(&agree), blamed(&convert), "{name}: {agree:#} {convert:#}");
        assert_eq!(agree["lost"], convert["lost"], "{name}");
    }
    // The missing reset of the target is the cost, not the rounding of weights.
    let soft = r#"Network(name: "soft", timestep_ms: 1.0, populations: [Input(name: "in", shape: [30]),
        SoftReset(name: "h", shape: [8], tau_u_ms: 4, tau_v_ms: 12, vth: 1.1),
        SoftReset(name: "o", shape: [3], tau_u_ms: 4, tau_v_ms: 12, vth: 1.3)],
        projections: [Dense(from: ["in"], to: "h", weights: Uniform(low: -0.2, high: 0.5, seed: 1)),
            Dense(from: ["h"], to: "o", weights: Uniform(low: -0.3, high: 0.8, seed: 2))], output: "o", drain: 1)"#;
    std::fs::write(folder.join("soft.ron"), soft).unwrap();
    let convert = object(folder, &format!("convert soft.ron --input {NOISE}"), 0);
    let lost = convert["lost"].as_array().unwrap();
    assert!(lost[0]["disagreement"].as_f64().unwrap() > 0.1, "{convert:#}");
    for row in lost.iter().filter(|row| !row["cause"].is_null()) {
        assert_eq!(row["cause"], "hard-reset", "{convert:#}");
    }
    assert_eq!(lost[0]["cause"], "hard-reset", "{convert:#}");
    assert!(convert["next"].is_null(), "{convert:#}");
}

#[test]
fn a_negative_exponent_shifts_the_sum_under_lava() {
    let (first, own) = (integers((5, 30), 2, (-9, 14), 1), integers((5, 5), 2, (-20, 8), 2));
    let text = format!(
        r#"Network(name: "lava", timestep_ms: 1.0, semantics: Lava, populations: [Input(name: "in", shape: [30]),
            Loihi(name: "o", shape: [5], du: 1000, dv: 137, vth_mant: 20)],
            projections: [Dense(from: ["in"], to: "o", weights: {first}, weight_exp: -3),
                Dense(from: ["o"], to: "o", weights: {own}, weight_exp: -2, delay: 1)], output: "o")"#
    );
    let refused = lower_and_quantise(&text).unwrap_err();
    assert!(refused.code == "model.semantics" && refused.to_string().contains("at most one projection"), "{refused}");
    // The suggested remedies.
    lower_and_quantise(&text.replace("semantics: Lava, ", "")).unwrap();
    let raised =
        text.replace("vth_mant: 20", "vth_mant: 160").replace("exp: -2", "exp: 1").replace("exp: -3", "exp: 0");
    lower_and_quantise(&raised).unwrap();

    // A loop without lost bits, next to a projection with them.
    let network = lower_and_quantise(&text.replace("exp: -2", "exp: 1")).unwrap();
    let graph = graph(text.replace("exp: -2", "exp: 1"));
    let matrix = |text: &str| -> Vec<Vec<i64>> { serde_json::from_str(text).unwrap() };
    let (first, own) = (matrix(&first), matrix(&own));
    let target = load_target("loihi1-chip").unwrap();
    let compiled = compile(network.clone(), &target, &Options::default()).unwrap();
    let image = Image::new(&compiled.program, 1).unwrap();
    let staged = StagedNetwork::new(&graph, &analytic::starts(&graph)).unwrap();
    assert!(staged.causes().contains(&Cause::Weights));
    let (mut golden, mut machine) = (Golden::new(&network), Machine::new(&image, Settings::default()));
    let (mut all, mut each_weight) = (0, 0);
    for sample in &samples(0..4) {
        let trace = staged.run(ComparisonStage::MACHINE, sample, true);
        let (mut u, mut v, mut before) = ([0i64; 5], [0i64; 5], vec![[0i64; 5]; 2]);
        golden.begin(150);
        machine.begin(150);
        for step in 0..150u32 {
            golden.step(sample.input(step));
            machine.step(sample.input(step));
            let mut spikes = [0i64; 5];
            for unit in 0..5 {
                let sum: i64 = sample.at(step).iter().map(|channel| first[unit][channel.0 as usize]).sum();
                let back: i64 = (0..5).map(|source| own[unit][source] * before[1][source]).sum();
                let single: i64 = sample.at(step).iter().map(|channel| first[unit][channel.0 as usize] / 8).sum();
                each_weight += i64::from(single != sum >> 3);
                let decay = |x: i64, d: i64| x * (4096 - d) / 4096;
                u[unit] = decay(u[unit], 1000) + 64 * ((sum >> 3) + 2 * back);
                v[unit] = decay(v[unit], 137) + u[unit];
                if v[unit] > 64 * 20 {
                    (spikes[unit], v[unit]) = (1, 0);
                }
                let compartment = nsim::ir::base::id::CompartmentId(unit as u32);
                assert_eq!(i64::from(golden.u(compartment)), u[unit], "{step} {unit}");
                assert_eq!(i64::from(golden.v(compartment)), v[unit], "{step} {unit}");
                assert_eq!(machine.v(compartment), golden.v(compartment), "{step} {unit}");
                let fired = trace.trains[unit].binary_search(&step).is_ok();
                assert_eq!(i64::from(fired), spikes[unit], "{step} {unit}");
            }
            before = vec![spikes, before[0]];
            all += spikes.iter().sum::<i64>();
        }
    }
    assert!(all > 100 && each_weight > 100, "{all} spikes, {each_weight} sums that weights alone do not give");
}

fn lower_and_quantise(text: &str) -> Result<nsim::ir::quantised::Quantised, nsim::ir::base::diagnostic::Diagnostic> {
    nsim::quantise::quantise::quantise(&graph(text))
}
