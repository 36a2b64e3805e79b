//! Networks with real numbers become integers, are written, and are read again as equal integers.

use std::path::Path;

use crate::common::command::{object, said};
use crate::common::{data, noise};
use nsim::dynamics::synapses::Enumerate;
use nsim::files::lower::lower;
use nsim::files::training::TrainingFile;
use nsim::golden::Golden;
use nsim::ir::base::diagnostic::SourceText;
use nsim::ir::base::rng;
use nsim::ir::graph::Graph;
use nsim::ir::quantised::{Population, Quantised, Units};
use nsim::ir::spikes::{Engine, Sample};
use nsim::quantise::quantise::quantise;
use nsim::train::convert::fine_tune::Task;
use nsim::train::convert::staged::ConversionLimits;
use nsim::train::convert::{model_file, staged};
use nsim::train::fit::Example;
use nsim::train::plan::plan;

fn graph(populations: &str, projections: &str) -> Graph {
    let text = format!(
        "Network(name: \"n\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [1, 5, 6]), {populations}], \
         projections: [{projections}], output: \"o\")"
    );
    nsim_testing::graph(text)
}

/// Real thresholds, a convolution, a recurrent projection with a heavy tail, biases, individual
/// decays.
fn real() -> Graph {
    let row = |t: u32| {
        let weight = |s: u32| if (s + t).is_multiple_of(7) { -6.5 } else { 0.05 + 0.01 * f64::from(s) };
        format!("[{}]", (0..18).map(|s| weight(s).to_string()).collect::<Vec<_>>().join(", "))
    };
    let rows = (0..18).map(row).collect::<Vec<_>>().join(", ");
    graph(
        "Loihi(name: \"c\", shape: [2, 3, 3], tau_u_ms: 4.2, tau_v_ms: 17.0, vth: 1.3, refractory: 2), \
         Loihi(name: \"o\", shape: [4], du: [4096, 2000, 900, 300], dv: 100, vth: 2.0, bias: 0.03, start_step: 2)",
        &format!(
            "Conv2d(from: [\"in\"], to: \"c\", weights: [[[[0.3, -0.1], [0.2, 0.77], [0.5, 0.1]]], [[[0.1, 0.4], \
             [-0.2, 0.3], [0.9, 0.35]]]], stride: (1, 2)), \
             Dense(from: [\"c\"], to: \"c\", weights: [{rows}]), \
             Dense(from: [\"c\"], to: \"o\", weights: Uniform(low: -0.4, high: 0.7, seed: 2), delay: 2)"
        ),
    )
}

fn srm() -> Graph {
    graph(
        "Srm(name: \"h\", shape: [8], tau_sr_ms: 10, tau_ref_ms: 1, scale_ref: 2, theta: 10), \
         Srm(name: \"o\", shape: [3], tau_sr_ms: 10, tau_ref_ms: 1, scale_ref: 2, theta: 10)",
        "Dense(from: [\"in\"], to: \"h\", weights: Uniform(low: -1.5, high: 3, seed: 1)), \
         Dense(from: [\"h\"], to: \"o\", weights: Uniform(low: -2, high: 4, seed: 2))",
    )
}

fn choices(most_taps: usize) -> ConversionLimits {
    ConversionLimits { most_taps, soft_reset: false }
}

fn samples(seeds: std::ops::Range<u64>) -> Vec<Sample> {
    seeds.map(|seed| noise((30, 120), seed, |_| 0.06, None)).collect()
}

/// Every number of a network in integers.
fn numbers(network: &Quantised) -> Vec<String> {
    let populations = network.populations().iter().map(|population| match &population.units {
        Units::Input(_) => format!("{} input", population.name),
        Units::Compartments { start_step, .. } => {
            let each: Vec<_> = population.each_neuron().collect();
            format!("{} {start_step} {each:?}", population.name)
        }
    });
    let projections = network.projections().iter().map(|p| {
        let sources = network.populations()[p.source].shape.len();
        let mut synapses = Vec::new();
        for source in 0..sources {
            p.connectivity.for_each_from(source, |target, weight| synapses.push((source, target, weight)));
        }
        format!("{:?} {:?} {:?} {:?} {synapses:?}", p.source, p.target, p.format, p.delay)
    });
    populations.chain(projections).collect()
}

#[test]
fn what_is_written_is_read_as_the_same_integers() {
    let all = samples(0..12);
    let few: Vec<&Sample> = all.iter().collect();
    for graph in [real(), srm()] {
        let converted = staged::convert(&graph, &few, choices(16), |_| ()).unwrap();
        let model = model_file::model(&graph, &converted.network, "a test".to_string()).unwrap();
        let again = quantise(&lower(&model.build(Path::new("written.ron")).unwrap()).unwrap()).unwrap();
        assert_eq!(numbers(&again), numbers(&converted.network));
        assert!(converted.stages.len() >= 2);
        let (first, last) = (converted.stages[0].distance, converted.calibration.distance);
        assert!(last.coincidence >= first.coincidence, "{first:?} {last:?}");
    }
}

#[test]
fn heavy_weights_cost_less_with_their_own_exponent() {
    let all = samples(20..40);
    let few: Vec<&Sample> = all.iter().collect();
    let converted = staged::convert(&real(), &few, choices(16), |_| ()).unwrap();
    let gained: Vec<f64> = converted.stages.iter().map(|row| row.distance.coincidence).collect();
    assert!(gained[2] > gained[0], "{gained:?}");
}

#[test]
fn a_reset_by_subtraction_becomes_one_to_zero_where_the_target_has_none() {
    let soft = graph(
        "SoftReset(name: \"h\", shape: [8], tau_u_ms: 4, tau_v_ms: 12, vth: 1.1), \
         SoftReset(name: \"o\", shape: [3], tau_u_ms: 4, tau_v_ms: 12, vth: 1.3)",
        "Dense(from: [\"in\"], to: \"h\", weights: Uniform(low: -0.2, high: 0.5, seed: 1)), \
         Dense(from: [\"h\"], to: \"o\", weights: Uniform(low: -0.3, high: 0.8, seed: 2))",
    );
    let all = samples(0..12);
    let few: Vec<&Sample> = all.iter().collect();
    let kinds = |network: &Quantised| {
        let neurons = network.populations().iter().filter_map(Population::neurons);
        neurons.map(|neurons| neurons.get(0).kind.name()).collect::<Vec<_>>()
    };
    let zero = staged::convert(&soft, &few, choices(8), |_| ()).unwrap();
    assert_eq!(kinds(&zero.network), ["Loihi", "Loihi"]);
    let [given, reset, ..] = zero.stages.as_slice() else { panic!() };
    assert!(given.name.starts_with("reset by subtraction") && !given.kept);
    assert!(reset.name.starts_with("reset to zero") && reset.gain.unwrap() < -0.05, "{reset:?}");
    let kept = staged::convert(&soft, &few, ConversionLimits { soft_reset: true, ..choices(8) }, |_| ()).unwrap();
    assert_eq!(kinds(&kept.network), ["SoftReset", "SoftReset"]);
    assert!(kept.calibration.distance.coincidence > zero.calibration.distance.coincidence + 0.05);
    let model = model_file::model(&soft, &kept.network, "a test".to_string()).unwrap();
    let again = quantise(&lower(&model.build(Path::new("written.ron")).unwrap()).unwrap()).unwrap();
    assert_eq!(numbers(&again), numbers(&kept.network));
}

/// A training file that describes [`srm`].
const TRAINING: &str = "Training(name: \"n\", timestep_ms: 1.0, inputs: [(name: \"in\", shape: [30])], \
    layers: [(name: \"h\", from: [\"in\"], size: 8), (name: \"o\", from: [\"h\"], size: 3)], \
    neuron: Srm(tau_sr_ms: Same(10), tau_ref_ms: 1, scale_ref: 2, theta: 10), loss: SpikeCount(right: 20, wrong: 2), \
    optimiser: Adam(rate: 0.1), last_rate: 0.5, batch: 4, epochs: 9, seed: 3)";

/// Three classes: a third of the channels spikes more.
fn labelled(seeds: std::ops::Range<u64>) -> Vec<Sample> {
    let one = |seed: u64| {
        let class = (seed % 3) as u32;
        noise((30, 120), seed, |c| if c / 10 == class { 0.07 } else { 0.05 }, Some(class))
    };
    seeds.map(one).collect()
}

fn right(network: &Quantised, samples: &[Sample]) -> usize {
    let mut engine = Golden::new(network);
    let output = &network.populations()[network.parts().output];
    let first = output.first_compartment().unwrap().0;
    let mut right = 0;
    for sample in samples {
        let mut counts = vec![0; output.shape.len() as usize];
        engine.begin(sample.steps());
        for step in 0..sample.steps() {
            engine.step(sample.input(step));
            engine.spikes().iter().filter_map(|c| c.0.checked_sub(first)).for_each(|c| counts[c as usize] += 1);
        }
        let most = *counts.iter().max().unwrap();
        let class = counts.iter().position(|&count| count == most).filter(|_| most > 0);
        right += usize::from(class.map(|class| class as u32) == sample.label());
    }
    right
}

#[test]
fn fine_tuning_starts_at_the_integers_and_keeps_what_golden_confirms() {
    let (graph, all) = (srm(), labelled(0..60));
    let few: Vec<&Sample> = all.iter().take(20).collect();
    let converted = staged::convert(&graph, &few, choices(8), |_| ()).unwrap();
    let source = SourceText::new("t.ron", TRAINING);
    let file = TrainingFile::parse(&source).unwrap();
    let task = || {
        let of = (&converted.fits[..], converted.detail);
        Task::new(&graph, of, &file, plan(&file, &source).unwrap()).unwrap()
    };
    let examples: Vec<Example> =
        all.iter().map(|sample| Example::from_sample(&converted.network, sample).unwrap()).collect();
    let (shown, held) = examples.split_at(48);
    let nothing = task().run(shown, held, 0, &|| (), |_| ()).unwrap();
    let start = task().integers(&nothing.weights).unwrap();
    assert_eq!(numbers(start.deployed()), numbers(&converted.network));
    assert_eq!(nothing.kept, 0);
    let mut kept = Vec::new();
    let tuned = task().run(shown, held, 4, &|| (), |best| kept.push(best.epoch)).unwrap();
    assert_eq!((kept.first(), kept.last()), (Some(&0), Some(&tuned.kept)));
    assert_eq!((tuned.rows.len(), tuned.samples), (5, 48));
    // The golden interpreter counts these scores.
    let share = |right: usize, of: usize| right as f64 / of as f64;
    let (before, after) = tuned.scores();
    let unseen = tuned.held_out.unwrap();
    let integers = task().integers(&tuned.weights).unwrap();
    for (ladder, train, held) in [(start, before, unseen.before), (integers, after, unseen.after)] {
        assert_eq!(train.accuracy, share(right(ladder.deployed(), &all[..48]), 48));
        assert_eq!(held.accuracy, share(right(ladder.deployed(), &all[48..]), 12));
    }
    assert!(tuned.kept > 0 && after.loss < before.loss, "{:?}", tuned.rows);
    // Threads and repetition change nothing.
    let again = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let again = again.install(|| task().run(shown, held, 4, &|| (), |_| ()).unwrap());
    assert_eq!((again.weights, again.rows), (tuned.weights, tuned.rows));
}

#[test]
fn fine_tuning_refuses_what_the_training_file_does_not_describe() {
    let graph = srm();
    for (from, to) in [("size: 8", "size: 7"), ("[30]", "[29]"), ("theta: 10", "theta: 9"), ("Same(10)", "Same(11)")] {
        let source = SourceText::new("t.ron", TRAINING.replace(from, to));
        let file = TrainingFile::parse(&source).unwrap();
        let starts = nsim::quantise::analytic::starts(&graph);
        let of = (&starts[..], nsim::quantise::exponents::Detail::Carried);
        let error = Task::new(&graph, of, &file, plan(&file, &source).unwrap()).unwrap_err();
        assert_eq!(error.code, "convert.fine-tune", "{to}");
    }
}

/// 20 seeded inputs of 15 %, as [samples, channels, steps] of bytes.
fn write_noise(path: &Path) {
    let spikes = (0..20 * 12 * 256).map(|i| u8::from(rng::unit(5, 0, i) < 0.15));
    nsim::files::npy::write(std::fs::File::create(path).unwrap(), &[20, 12, 256], spikes).unwrap();
}

#[test]
fn an_imported_recurrent_network_coincides_without_an_exponent_by_hand() {
    let Some(data) = data("nir") else { return };
    let folder = tempfile::tempdir().unwrap();
    write_noise(&folder.path().join("x.npy"));
    let network = data.join("braille_noDelay_bias_zero.nir").canonicalize().unwrap();
    let run = |line: &str| object(folder.path(), &format!("{line} --input x.npy"), 0);
    let network = network.to_str().unwrap();
    let agreed = run(&format!("agree {network} --against cuba --attribution off"));
    let coincidence = |object: &serde_json::Value, name: &str| {
        let layers = object["layers"].as_array().unwrap();
        layers.iter().find(|layer| layer["name"] == name).unwrap()["coincidence"].as_f64().unwrap()
    };
    assert_eq!(agreed["class_agreement"], 1.0);
    assert!(coincidence(&agreed, "lif1_lif") >= 0.9 && coincidence(&agreed, "lif2") >= 0.7, "{agreed:#}");
    // The stored network is compared unchanged, and has equal results.
    let converted = run(&format!("convert {network} -o kept.ron"));
    assert_eq!(converted["schema"], "nsim.convert/1");
    assert!(converted["stages"].as_array().unwrap().len() >= 2, "{converted:#}");
    let again = run(&format!("agree {network} --against kept.ron"));
    assert_eq!(coincidence(&again, "lif2"), coincidence(&agreed, "lif2"));
}

/// Without spikes to compare, a conversion continues.
#[test]
fn a_layer_that_no_spikes_reach_is_converted_by_analysis() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("srm.ron"), crate::SRM).unwrap();
    let line =
        "convert srm.ron --input scene:noise?samples=4&steps=20 --calibrate scene:noise?samples=4&steps=20 -o c.ron";
    let (status, _, err) = said(folder.path(), line);
    assert!(status < 2 && err.contains("it receives no spikes"), "{status}: {err}");
}
