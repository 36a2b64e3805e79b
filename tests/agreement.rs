//! The ladder from a trained network to the machine: both ends are what they claim, and every rung is real.

// A test that cannot go on has failed.
#![allow(clippy::unwrap_used)]

mod common;

use std::collections::BTreeMap;
use std::path::Path;

use assert_cmd::Command;
use common::data;
use nsim::agree::attribution::{attribute, distances};
use nsim::agree::causes::{Cause, Rung};
use nsim::agree::ladder::{Ladder, layers};
use nsim::agree::trace::{Layer, Trace};
use nsim::base::diagnostic::SourceText;
use nsim::base::id::ChannelId;
use nsim::base::rng;
use nsim::compile::frontend::analytic::{self, Fit};
use nsim::compile::frontend::lower::lower;
use nsim::compile::{Options, compile};
use nsim::convert::search::search;
use nsim::desc::network::{Network, NetworkFile};
use nsim::golden::Golden;
use nsim::io::target::load_target;
use nsim::ir::graph::Graph;
use nsim::ir::spikes::{Engine, Sample};
use nsim::machine::{Image, Machine, Settings};
use nsim::reference::{self, Kernel, Model, Reference};

fn graph(text: &str) -> Graph {
    let source = SourceText::new("m.ron", text);
    lower(&Network::new(NetworkFile::parse(&source).unwrap(), source, BTreeMap::new()).unwrap()).unwrap()
}

/// As the paper's tactile network, small: weights of both signs, high rates.
const SRM: &str = r#"Network(name: "srm", timestep_ms: 1.0, populations: [
    Input(name: "in", shape: [30]),
    Srm(name: "h", shape: [12], tau_sr_ms: 10, tau_ref_ms: 1, scale_ref: 2, theta: 10),
    Srm(name: "o", shape: [4], tau_sr_ms: 10, tau_ref_ms: 1, scale_ref: 2, theta: 10)],
    projections: [
        Dense(from: ["in"], to: "h", weights: Uniform(low: -1.5, high: 3, seed: 1)),
        Dense(from: ["h"], to: "o", weights: Uniform(low: -2, high: 3, seed: 2))],
    output: "o")"#;

/// A network of spike response neurons that tells the classes of [`samples`] apart: each hidden neuron has a class's
/// channels of its own, each output a class's hidden neurons.
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
        // Each class has channels of its own that spike more, and so does another, less.
        let draw = |what: u64| rng::unit(seed, 1_000, what);
        let (strong, weak) = (0.06 + 0.06 * draw(0), 0.035 + 0.05 * draw(1));
        let other = (seed + 1 + (3.0 * draw(2)) as u64) % 4;
        let rate = |c: u32| match u64::from(c) % 4 {
            class if class == seed % 4 => strong,
            class if class == other => weak,
            _ => 0.03,
        };
        let all = (0..150).flat_map(|t| (0..30).map(move |c| (t, ChannelId(c))));
        let events: Vec<_> = all.filter(|&(t, c)| rng::unit(seed, c.0.into(), t.into()) < rate(c.0)).collect();
        Sample::new(150, &events, Some((seed % 4) as u32)).unwrap()
    };
    seeds.map(one).collect()
}

fn borrowed(samples: &[Sample]) -> Vec<&Sample> {
    samples.iter().collect()
}

/// Fits with every free integer away from the analytic start.
fn chosen(graph: &Graph) -> Vec<Option<Fit>> {
    let moved = |fit: Fit, count: u32| Fit {
        dv: nsim::base::fixed::Decay::new(900).unwrap(),
        refractory: nsim::base::fixed::Refractory::new(2).unwrap(),
        copies: vec![(2, 0.7), (5, 0.4)],
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
        let ladder = Ladder::new(&graph, &fits).unwrap();
        let mut spikes = 0;
        for (kernel, rung) in
            [(Kernel::Truncated, Rung::TRAINED), (Kernel::Exact, Rung::TRAINED.with(Cause::Untruncated))]
        {
            let model = Model::<f64>::new(&graph, reference::Options { kernel });
            for sample in &samples(0..6) {
                let engine =
                    Trace::record(&mut Reference::new(&model), sample, (16, ladder.deployed().output()), |e, c| {
                        e.potential(c) / 10.0
                    });
                let trace = ladder.run(rung, sample, true);
                assert_eq!(trace.trains, engine.trains, "{kernel:?}");
                let near = trace.potentials.iter().zip(&engine.potentials).all(|(a, b)| (a - b).abs() < 1e-4);
                assert!(near, "{kernel:?}");
                spikes += trace.trains.iter().map(Vec::len).sum::<usize>();
            }
        }
        assert!(spikes > 2000, "{spikes} spikes show little");
    }
}

/// The last rung against the golden interpreter and the machine, in every spike and every voltage.
fn is_the_machine(graph: &Graph, fits: &[Option<Fit>], samples: &[Sample], some: usize) {
    let ladder = Ladder::new(graph, fits).unwrap();
    let network = ladder.deployed();
    let target = load_target("loihi1-chip").unwrap();
    let compiled = compile(network.clone(), &target, &Options::default()).unwrap();
    let image = Image::new(&compiled.program, 1).unwrap();
    let mut golden = Golden::new(network);
    let mut machine = Machine::new(&image, Settings::default());
    let mut spikes = 0;
    for sample in samples {
        let trace = ladder.run(Rung::MACHINE, sample, true);
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
    let nsim::ir::quantised::Units::Compartments { neurons, .. } = &population.units else { panic!() };
    (0..layer.count).map(|i| 64.0 * f64::from(neurons.get(i).vth.get())).collect()
}

#[test]
fn with_every_cause_it_is_the_machine_bit_for_bit() {
    let srm = graph(SRM);
    is_the_machine(&srm, &analytic::starts(&srm), &samples(0..6), 500);
    is_the_machine(&srm, &chosen(&srm), &samples(0..6), 500);
    let real = graph(REAL);
    is_the_machine(&real, &analytic::starts(&real), &samples(0..6), 500);
    let shipped = lower(&nsim::io::model::load_model("vtsnn-slip").unwrap()).unwrap();
    let noise = |seed: u64| {
        let all = (0..150).flat_map(|t| (0..3306).map(move |c| (t, ChannelId(c))));
        Sample::new(150, &all.filter(|&(t, c)| rng::unit(seed, c.0.into(), t.into()) < 0.03).collect::<Vec<_>>(), None)
            .unwrap()
    };
    is_the_machine(&shipped, &analytic::starts(&shipped), &[noise(1), noise(2)], 0);
}

#[test]
fn every_rung_is_real() {
    let graph = graph(SRM);
    let ladder = Ladder::new(&graph, &chosen(&graph)).unwrap();
    assert_eq!(ladder.causes(), Cause::ALL);
    let (samples, output) = (samples(0..12), ladder.layers()[1].clone());
    let samples = borrowed(&samples);
    let mut rung = ladder.trained();
    for cause in Cause::ALL {
        let next = rung.with(cause);
        let away = distances(&ladder, rung, &[next], &output, &samples)[0];
        // With equal decays the kernel is the alpha kernel itself: that rung shows in time alone.
        match cause {
            Cause::Kernel => {
                let traces = [rung, next].map(|rung| ladder.run(rung, samples[0], false));
                assert_ne!(traces[0].trains, traces[1].trains);
                assert!(away.coincidence > 0.999, "{away:?}");
            }
            _ => assert!(away.potential_rmse.unwrap() > 1e-7, "{}: {away:?}", cause.name()),
        }
        rung = next;
    }
    // Against the trained network, taking the hard reset or the decays away changes the figure.
    let all = distances(&ladder, ladder.trained(), &[Rung::MACHINE], &output, &samples)[0];
    // Decaying current and voltage have no end, so that nothing is left to truncate once they are there.
    for missing in Cause::ALL.into_iter().filter(|&cause| cause != Cause::Untruncated) {
        let without = Cause::ALL.into_iter().filter(|&c| c != missing).fold(Rung::TRAINED, Rung::with);
        let away = distances(&ladder, ladder.trained(), &[without], &output, &samples)[0];
        assert_ne!(away, all, "{}", missing.name());
    }
}

#[test]
fn shares_add_up_to_the_disagreement() {
    let graph = graph(SRM);
    let ladder = Ladder::new(&graph, &analytic::starts(&graph)).unwrap();
    let (samples, output) = (samples(0..10), ladder.layers()[1].clone());
    let attribution = attribute(&ladder, &output, &borrowed(&samples));
    let names: Vec<&str> = attribution.shares.iter().map(|share| share.cause.name()).collect();
    assert!(names.len() >= 5 && !names.contains(&"calibration"), "{names:?}");
    let sum = |pick: fn(&nsim::agree::attribution::Share) -> f64| attribution.shares.iter().map(pick).sum::<f64>();
    assert!((sum(|s| s.forward) - attribution.disagreement).abs() < 1e-9);
    assert!((sum(|s| s.reversed) - attribution.disagreement).abs() < 1e-9);
    assert!((sum(|s| s.share) - 1.0).abs() < 1e-9);
    assert!(attribution.disagreement > 0.01);
    assert_eq!(attribution.shares.last().unwrap().rung.class_agreement, {
        let far = distances(&ladder, ladder.trained(), &[Rung::MACHINE], &output, &borrowed(&samples));
        far[0].class_agreement
    });
}

#[test]
fn the_search_comes_nearer_than_the_analytic_start() {
    let graph = graph(&decided());
    let (calibration, unseen) = (samples(100..130), samples(0..60));
    let found = search(&graph, &borrowed(&calibration), 16, |_| ()).unwrap();
    assert!(found.end.count_error < 0.6 * found.start.count_error, "{:?} {:?}", found.start, found.end);
    assert_eq!(found, search(&graph, &borrowed(&calibration), 16, |_| ()).unwrap(), "the same search twice");
    let output = Ladder::new(&graph, &found.conversion.fits).unwrap().layers()[1].clone();
    let trained = Rung::TRAINED.with(Cause::Untruncated);
    let on_unseen = |fits: &[Option<Fit>]| {
        let ladder = Ladder::new(&graph, fits).unwrap();
        distances(&ladder, trained, &[Rung::MACHINE], &output, &borrowed(&unseen))[0]
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

fn agree(folder: &Path, data: &Path, recorded: [&str; 2], steps: &str) -> (Option<i32>, serde_json::Value) {
    let model = folder.join("silicon.ron");
    std::fs::write(&model, SILICON.replace("DATA", data.to_str().unwrap())).unwrap();
    let mut command = Command::cargo_bin("nsim").unwrap();
    command.arg("agree").arg(&model).arg("--input").arg(data.join("input.npy"));
    for (population, file) in ["hidden", "out"].iter().zip(recorded) {
        command.arg("--against").arg(format!("{population}={}", data.join(file).display()));
    }
    let out = command.args(["--steps", steps, "--require-exact", "--format", "json"]).output().unwrap();
    (out.status.code(), serde_json::from_slice(&out.stdout).unwrap())
}

#[test]
fn the_recorded_spikes_of_the_chip_agree_exactly() {
    let Some(data) = data("silicon") else { return };
    let data = data.canonicalize().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let (status, json) = agree(folder.path(), &data, ["hidden_spikes.npy", "output_spikes.npy"], "499");
    assert_eq!(status, Some(0), "{json:#}");
    assert_eq!((&json["class_agreement"], &json["layers"][0]["spikes_a"]), (&1.0.into(), &639.into()));
    assert_eq!(
        (&json["layers"][0]["shift"], &json["layers"][1]["first_divergence"]),
        (&0.into(), &serde_json::Value::Null)
    );
    // A population held against another's recording does not.
    let model = folder.path().join("silicon.ron");
    let run = Command::cargo_bin("nsim")
        .unwrap()
        .arg("agree")
        .arg(&model)
        .arg("--input")
        .arg(data.join("input.npy"))
        .arg("--against")
        .arg(format!("hidden={}", data.join("hidden_spikes.npy").display()))
        .args(["--require-exact"])
        .output()
        .unwrap();
    assert_eq!(run.status.code(), Some(1), "the recording ends before step 499, in which the chip spiked");
}
