//! Batches on a GPU give the spikes and registers of the interpreter, bit for bit, and in f32 those
//! of the reference up to the rounding of sums. Software such as Mesa's lavapipe serves too.
#![cfg(feature = "gpu")]

use std::time::Duration;

use crate::common::random;
use nsim::ir::base::id::{ChannelId, CompartmentId};
use nsim::ir::base::rng;
use std::collections::BTreeMap;

use nsim::files::lower::lower;
use nsim::files::network::{Network, NetworkFile};
use nsim::golden::Golden;
use nsim::ir::arithmetic::Semantics;
use nsim::ir::base::diagnostic::SourceText;
use nsim::ir::graph::Graph;
use nsim::ir::neurons::NeuronKind;
use nsim::ir::quantised::{Neuron, Quantised, Units};
use nsim::ir::spikes::{Engine, Sample};
use nsim::reference::{Model, Options, Reference};
use nsim::study::batch::{BatchForm, Gpu};

/// A device, or nothing and loud words; a failure where `NSIM_REQUIRE_GPU` is 1.
fn gpu() -> Option<Gpu> {
    match Gpu::open() {
        Ok(gpu) => {
            eprintln!("batches run on {}", gpu.name());
            Some(gpu)
        }
        Err(reason) => {
            assert!(std::env::var_os("NSIM_REQUIRE_GPU").is_none_or(|value| value != "1"), "{reason}");
            eprintln!("NOT TESTED: {reason}");
            None
        }
    }
}

/// The network in the chip's arithmetic; `kind` replaces its compartments' where it is given.
fn in_hardware(network: &Quantised, kind: Option<NeuronKind>) -> Quantised {
    let mut parts = network.parts().clone();
    parts.semantics = Semantics::Hardware;
    for population in parts.populations.iter_mut() {
        if let (Units::Compartments { neurons, .. }, Some(kind)) = (&mut population.units, kind) {
            let refractory = nsim::ir::base::fixed::Refractory::new(1).unwrap();
            *neurons = neurons.try_map(|_, neuron| Ok::<_, ()>(Neuron { kind, refractory, ..neuron })).unwrap();
        }
    }
    Quantised::new(parts).unwrap()
}

#[test]
fn decays_without_64_bits_are_those_with_them() {
    let Some(gpu) = gpu() else { return };
    let edges = [0, 1, 2, 4095, 4096, 4097, 8191, 8192, 1 << 22, (1 << 23) - 4096, (1 << 23) - 1, 1 << 23];
    let keeps = [0, 1, 2, 2047, 2048, 3072, 4094, 4095, 4096];
    let mut pairs: Vec<(i32, i32)> =
        edges.iter().flat_map(|&x| keeps.iter().flat_map(move |&keep| [(x, keep), (-x, keep)])).collect();
    pairs.extend((0..200_000).map(|at| {
        let value = rng::below((1 << 24) + 1, 7, at, 0) as i32 - (1 << 23);
        (value, rng::below(4097, 7, at, 1) as i32)
    }));
    let exact: Vec<i32> = pairs.iter().map(|&(x, keep)| (i64::from(x) * i64::from(keep) / 4096) as i32).collect();
    assert_eq!(gpu.decays(&pairs).unwrap(), exact);
}

#[test]
fn every_spike_and_register_is_the_interpreters() {
    let Some(gpu) = gpu() else { return };
    let (mut spikes, mut compared) = (0, 0);
    for seed in 0..24 {
        let made = if seed % 4 == 3 { random::convolutional(seed) } else { random::network(seed) };
        let network = in_hardware(&made, (seed % 3 == 2).then_some(NeuronKind::SoftReset));
        let form = BatchForm::new(&network).unwrap();
        // More than a word of 32, not a multiple of it.
        let samples: Vec<Sample> = (0..37).map(|at| random::sample(&network, 1_000 * seed + at)).collect();
        let shown: Vec<&Sample> = samples.iter().collect();
        let steps = samples.iter().map(Sample::steps).max().unwrap();
        let batches = gpu.batches(&form, 37, steps).unwrap();
        // The second run starts from zero again.
        let trains = batches.run(&shown).unwrap();
        assert_eq!(batches.run(&shown).unwrap(), trains, "seed {seed}");
        let mut golden = Golden::new(&network);
        for (at, sample) in samples.iter().enumerate() {
            golden.begin(sample.steps());
            for step in 0..sample.steps() {
                golden.step(sample.at(step));
                assert_eq!(trains.spikes(at, step), golden.ascending_spikes(), "seed {seed}, sample {at}, step {step}");
                spikes += golden.spikes().len();
            }
            if sample.steps() == steps {
                for id in (0..network.compartments()).map(CompartmentId) {
                    assert_eq!(trains.registers(at, id), (golden.u(id), golden.v(id)), "seed {seed}, sample {at}");
                    compared += 1;
                }
            }
        }
    }
    eprintln!("{spikes} spikes and the registers of {compared} compartments are equal");
    assert!(spikes > 1_000 && compared > 100, "{spikes}, {compared}");
}

fn graph(text: &str) -> Graph {
    let source = SourceText::new("m.ron", text);
    lower(&Network::new(NetworkFile::parse(&source).unwrap(), source, BTreeMap::new()).unwrap()).unwrap()
}

/// Spike response and current-based neurons of each kind, dense, random, convolved and pooled,
/// recurrent, with delays and resets.
const REAL: [&str; 3] = [
    r#"Network(name: "srm", timestep_ms: 1.0, populations: [
        Input(name: "a", shape: [20]), Input(name: "b", shape: [10]),
        Srm(name: "h", shape: [40], tau_sr_ms: 10, tau_ref_ms: 1, scale_ref: 2, theta: 10),
        Srm(name: "o", shape: [7], tau_sr_ms: 4, tau_ref_ms: 2, scale_ref: 1, theta: 3)],
        projections: [
            Dense(from: ["a", "b"], to: "h", weights: Uniform(low: -1.5, high: 3, seed: 1)),
            Dense(from: ["h"], to: "h", weights: Uniform(low: -0.4, high: 0.3, seed: 3), delay: 5),
            Dense(from: ["h"], to: "o", weights: Uniform(low: -1, high: 1.2, seed: 2), delay: 3)],
        output: "o", reset: (interval: 40))"#,
    r#"Network(name: "loihi", timestep_ms: 1.0, populations: [
        Input(name: "in", shape: [2, 8, 8]),
        Loihi(name: "c", shape: [2, 8, 8], du: 900, dv: 300, vth_mant: 300, refractory: 2, bias_mant: 3),
        Loihi(name: "p", shape: [2, 4, 4], du: 4095, dv: 4095, vth_mant: 80, refractory: 1),
        SoftReset(name: "o", shape: [12], du: 1500, dv: 100, vth_mant: 700)],
        projections: [
            Conv2d(from: ["in"], to: "c", padding: (1, 1), weights: [
                [[[30, -10, 20], [44, 60, -16], [-20, 8, 50]], [[12, 0, 40], [-18, 36, 22], [54, -6, 10]]],
                [[[-8, 26, 14], [52, -20, 32], [6, 48, -12]], [[40, 18, -4], [24, 58, 2], [-14, 34, 46]]]]),
            SumPool2d(from: ["c"], to: "p", kernel: (2, 2), weight: 40),
            Random(from: ["p"], to: "o", fan_out: 5, low: -40, high: 60, seed: 6, delay: 2)],
        output: "o")"#,
    r#"Network(name: "recurrent", timestep_ms: 1.0, populations: [
        Input(name: "in", shape: [50]),
        Loihi(name: "n", shape: [90], du: 1024, dv: 256, vth_mant: 130, refractory: 3, start_step: 4)],
        projections: [
            Random(from: ["in"], to: "n", fan_out: 6, low: 20, high: 126, seed: 1),
            Random(from: ["n"], to: "n", fan_out: 12, low: -34, high: 26, seed: 2, delay: 7)],
        output: "n")"#,
];

/// Of the threshold: what the rounding of a few hundred sums in f32 comes to.
const NEAR: f64 = 1e-4;

#[test]
fn spikes_in_f32_are_those_of_the_reference() {
    let Some(gpu) = gpu() else { return };
    for text in REAL {
        let graph = graph(text);
        let name = graph.facts().name.clone();
        let (model, form) = (Model::<f32>::new(&graph, Options::default()), BatchForm::real(&graph).unwrap());
        let thresholds = nsim::dynamics::model_thresholds(&graph);
        let noise = |seed: u64| {
            let places = (0..120).flat_map(|step| (0..model.channels()).map(move |channel| (step, ChannelId(channel))));
            let spiked = |&(step, channel): &(u32, ChannelId)| rng::unit(seed, channel.0.into(), step.into()) < 0.12;
            Sample::new(120, &places.filter(spiked).collect::<Vec<_>>(), None).unwrap()
        };
        let samples: Vec<Sample> = (0..37).map(noise).collect();
        let shown: Vec<&Sample> = samples.iter().collect();
        let trains = gpu.batches(&form, 37, 120).unwrap().run(&shown).unwrap();
        let (mut spikes, mut same) = (0, 0);
        for (at, sample) in samples.iter().enumerate() {
            let mut reference = Reference::new(&model);
            reference.begin(120);
            let parted = (0..120).find(|&step| {
                reference.step(sample.at(step));
                spikes += reference.spikes().len();
                trains.spikes(at, step) != reference.spikes()
            });
            if let Some(step) = parted {
                // A spike more than the reference has was on the edge; of one less, the reset has
                // hidden the potential.
                for id in trains.spikes(at, step).iter().filter(|id| !reference.spikes().contains(id)) {
                    let far = (reference.potential(*id) / thresholds[id.0 as usize] - 1.0).abs();
                    assert!(far < NEAR, "{name}, sample {at}, step {step}, compartment {}: {far}", id.0);
                }
                continue;
            }
            same += 1;
            for id in (0..form.compartments()).map(CompartmentId) {
                let far = (f64::from(trains.potential(at, id)) - reference.potential(id)).abs();
                assert!(far < NEAR * thresholds[id.0 as usize], "{name}, sample {at}, compartment {}: {far}", id.0);
            }
        }
        eprintln!("{name}: {same} of 37 samples alike to the last of {spikes} spikes");
        assert!(spikes > 1_000 && same >= 35, "{name}: {same} samples, {spikes} spikes");
    }
}

#[test]
fn a_batch_is_timed_on_the_device() {
    let Some(gpu) = gpu() else { return };
    let network = in_hardware(&random::network(2), None);
    let form = BatchForm::new(&network).unwrap();
    let sample = random::sample(&network, 4);
    let row = nsim::study::batch_sizes::gpu(&gpu, &form, (&[&sample], sample.steps()), 8, Duration::ZERO).unwrap();
    assert_eq!((row.batch, row.together), (8, 8));
    assert!(row.batch_ms > 0.0 && row.hardware.starts_with(gpu.name()), "{row:?}");
    assert_eq!(row.hardware.ends_with("software, integers"), gpu.is_software());
}

#[test]
fn what_does_not_fit_or_is_not_the_chips_is_refused() {
    let mut parts = random::network(1).parts().clone();
    parts.semantics = Semantics::Lava;
    let lava = Quantised::new(parts);
    if let Ok(lava) = lava {
        assert!(BatchForm::new(&lava).unwrap_err().contains("Lava"));
    }
    let Some(gpu) = gpu() else { return };
    let form = BatchForm::new(&in_hardware(&random::network(1), None)).unwrap();
    let large = gpu.batches(&form, 1 << 20, u32::MAX >> 8).unwrap_err();
    assert!(large.contains("bytes") && large.contains("in a buffer"), "{large}");
    let sample = Sample::silent(5);
    let batches = gpu.batches(&form, 1, 4).unwrap();
    assert!(batches.run(&[&sample]).unwrap_err().contains("5 steps"));
    assert!(batches.run(&[&sample, &sample]).unwrap_err().contains("2 samples"));
}
