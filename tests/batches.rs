//! Batches on a GPU give the spikes and registers of the interpreter, bit for bit. Software such as Mesa's lavapipe serves too.
#![cfg(feature = "gpu")]
// A test that cannot go on has failed.
#![allow(clippy::unwrap_used)]

mod common;

use std::time::Duration;

use common::random;
use nsim::base::id::CompartmentId;
use nsim::base::rng;
use nsim::bench::batch::{BatchForm, Gpu};
use nsim::desc::network::Semantics;
use nsim::desc::neurons::NeuronKind;
use nsim::golden::Golden;
use nsim::ir::quantised::{Neuron, Quantised, Units};
use nsim::ir::spikes::{Engine, Sample};

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
            let refractory = nsim::base::fixed::Refractory::new(1).unwrap();
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

#[test]
fn a_batch_is_timed_on_the_device() {
    let Some(gpu) = gpu() else { return };
    let network = in_hardware(&random::network(2), None);
    let form = BatchForm::new(&network).unwrap();
    let sample = random::sample(&network, 4);
    let row = nsim::bench::batch_sizes::gpu(&gpu, &form, (&[&sample], sample.steps()), 8, Duration::ZERO).unwrap();
    assert_eq!((row.batch, row.together), (8, 8));
    assert!(row.batch_ms > 0.0 && row.hardware.starts_with(gpu.name()), "{row:?}");
    assert_eq!(row.hardware.ends_with("software"), gpu.is_software());
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
