//! The reference engine over whole networks, compared with SLAYER's order of operations, and with
//! the machine where their semantics coincide.

use crate::common::noise;
use nsim::files::lower::lower;
use nsim::golden::Golden;
use nsim::ir::base::id::{ChannelId, CompartmentId};
use nsim::ir::base::rng;
use nsim::ir::graph::Graph;
use nsim::ir::spikes::{Engine, Sample};
use nsim::reference::{Kernel, Model, Options, Reference};
use nsim::session::front::front;
use nsim::session::front::real_and_integers;
use nsim_testing::model as network;

const SRM: &str = r#"Network(name: "srm", timestep_ms: 1.0, populations: [
    Input(name: "a", shape: [6]), Input(name: "b", shape: [3]),
    Srm(name: "h", shape: [5], tau_sr_ms: 10, tau_ref_ms: 1, scale_ref: 2, theta: 10),
    Srm(name: "o", shape: [2], tau_sr_ms: 4, tau_ref_ms: 2, scale_ref: 1, theta: 3)],
    projections: [
        Dense(from: ["a", "b"], to: "h", weights: Uniform(low: -2, high: 4, seed: 1)),
        Dense(from: ["h"], to: "o", weights: Uniform(low: -1, high: 2.5, seed: 2), delay: 3)],
    output: "o")"#;

fn sample(channels: u32, steps: u32, rate: f64, seed: u64) -> Sample {
    noise((channels, steps), seed, |_| rate, None)
}

/// SLAYER's method: a layer at a time over all steps, kernels before weights (`spike(fc(psp(x)))`).
fn layer(
    inputs: &[Vec<f64>],
    weights: impl Fn(usize, usize) -> f64,
    n: usize,
    p: [f64; 4],
    delay: usize,
) -> Vec<Vec<f64>> {
    let [tau_sr, tau_ref, scale_ref, theta] = p;
    let alpha = |t: usize, tau: f64| t as f64 / tau * (1.0 - t as f64 / tau).exp();
    let steps = inputs[0].len();
    let psp: Vec<Vec<f64>> = inputs
        .iter()
        .map(|s| {
            (0..steps)
                .map(|t| (0..=t).filter(|&k| k + delay <= t).map(|k| s[k] * alpha(t - k - delay, tau_sr)).sum())
                .collect()
        })
        .collect();
    (0..n)
        .map(|target| {
            let mut spikes = vec![0.0; steps];
            for t in 0..steps {
                let drive: f64 = (0..inputs.len()).map(|source| weights(target, source) * psp[source][t]).sum();
                let own: f64 = (0..t).map(|k| spikes[k] * -scale_ref * theta * alpha(t - k, tau_ref)).sum();
                spikes[t] = f64::from(u8::from(drive + own >= theta));
            }
            spikes
        })
        .collect()
}

#[test]
fn a_network_of_spike_response_neurons_is_what_slayer_computes() {
    let graph = lower(&network(SRM)).unwrap();
    let model = Model::<f64>::new(&graph, Options::default()).unwrap();
    let mut engine = Reference::new(&model);
    let mut spikes = 0;
    for seed in 0..5 {
        let sample = sample(9, 150, 0.1, seed);
        let inputs: Vec<Vec<f64>> = (0..9)
            .map(|c| (0..150).map(|t| f64::from(u8::from(sample.at(t).contains(&ChannelId(c))))).collect())
            .collect();
        let uniform = |low: f64, high: f64, seed: u64, i: usize| low + (high - low) * rng::unit(seed, i as u64, 0);
        let hidden = layer(&inputs, |t, s| uniform(-2.0, 4.0, 1, t * 9 + s), 5, [10.0, 1.0, 2.0, 10.0], 0);
        let output = layer(&hidden, |t, s| uniform(-1.0, 2.5, 2, t * 5 + s), 2, [4.0, 2.0, 1.0, 3.0], 3);
        engine.begin(150);
        for t in 0..150 {
            engine.step(sample.input(t));
            let expected: Vec<CompartmentId> = (hidden.iter().chain(&output).enumerate())
                .filter(|(_, train)| train[t as usize] > 0.0)
                .map(|(i, _)| CompartmentId(i as u32))
                .collect();
            assert_eq!(engine.ascending_spikes(), expected, "sample {seed}, step {t}");
            spikes += expected.len();
        }
        assert_eq!(engine.totals().spikes_in as usize, sample.spikes());
    }
    assert!(spikes > 300, "{spikes} spikes show little");
}

/// Decays and weights whose products stay whole numbers, so that the integer machine loses nothing
/// by rounding.
const WHOLE: &str = r#"Network(name: "whole", timestep_ms: 1.0, populations: [
    Input(name: "in", shape: [4, 3, 3]),
    Loihi(name: "pool", shape: [4, 2, 2], du: 4096, dv: 4096, vth_mant: 3, refractory: 2, start_step: 3),
    Loihi(name: "conv", shape: [2, 1, 2], du: 4096, dv: 0, vth_mant: 20, refractory: 1, bias_mant: 64, bias_exp: 1),
    Loihi(name: "o", shape: [3], du: 0, dv: 4096, vth_mant: 30, refractory: 4)],
    projections: [
        SumPool2d(from: ["in"], to: "pool", kernel: (2, 2), stride: (1, 1), weight: 2),
        Conv2d(from: ["pool"], to: "conv", weights: [[[[2], [4]], [[-2], [6]], [[8], [0]], [[2], [-4]]], [[[4], [2]], [[2], [2]], [[-6], [2]], [[0], [2]]]], delay: 5),
        Random(from: ["conv"], to: "o", fan_out: 4, low: -6, high: 6, seed: 3, delay: 1),
        Sparse(from: ["conv"], to: "conv", synapses: [(0, 1, -4), (2, 0, 6)]),
    ], output: "o", reset: (interval: 40, offset: 7))"#;

#[test]
fn without_anything_to_round_it_is_the_golden_interpreter() {
    assert!(agrees_with_golden(WHOLE) > 500);
}

#[test]
fn in_the_arithmetic_of_other_tools_too_it_is_the_golden_interpreter() {
    let of =
        |semantics: &str| WHOLE.replace("timestep_ms: 1.0,", &format!("timestep_ms: 1.0, semantics: {semantics},"));
    // lava has no refractory period, and its own limits for v; SLAYER has neither limits nor bias.
    for text in [
        of("Lava"),
        of("Lava").replace("vth_mant: 20,", "vth_mant: 20, vmax_exp: 0,"),
        of("Slayer"),
        of("Slayer").replace("refractory: 2", "refractory: 0").replace("vth_mant: 20,", "vth_mant: 20, vmax_exp: 0,"),
    ] {
        let spikes = agrees_with_golden(&text);
        assert!(spikes > 100, "{spikes} spikes show little: {text}");
    }
}

/// Number of spikes, which are equal in both engines.
fn agrees_with_golden(text: &str) -> usize {
    let network = network(text);
    let (graph, quantised): (Graph, _) = real_and_integers(&network).unwrap();
    let model = Model::<f64>::new(&graph, Options::default()).unwrap();
    let (mut engine, mut golden) = (Reference::new(&model), Golden::new(&quantised));
    let mut spikes = 0;
    for seed in 0..4 {
        let sample = sample(36, 200, 0.2, seed);
        engine.begin(200);
        golden.begin(200);
        for t in 0..200 {
            engine.step(sample.input(t));
            golden.step(sample.input(t));
            assert_eq!(engine.ascending_spikes(), golden.ascending_spikes(), "sample {seed}, step {t}");
            for c in (0..quantised.compartments()).map(CompartmentId) {
                assert_eq!(engine.current(c), f64::from(golden.u(c)), "u of {c} in step {t}");
                assert_eq!(engine.potential(c), f64::from(golden.v(c)), "v of {c} in step {t}");
            }
            spikes += engine.spikes().len();
        }
        let (real, whole) = (engine.totals(), golden.totals());
        assert_eq!((real.spikes, real.synaptic_events), (whole.spikes, whole.synaptic_events));
    }
    spikes
}

#[test]
fn single_precision_and_the_truncated_kernel_run_the_same_networks() {
    let graph = lower(&network(SRM)).unwrap();
    let counts = |run: &mut dyn Engine| {
        let sample = sample(9, 150, 0.1, 1);
        run.begin(150);
        (0..150)
            .map(|t| {
                run.step(sample.input(t));
                run.spikes().len()
            })
            .sum::<usize>()
    };
    let exact = Model::<f64>::new(&graph, Options::default()).unwrap();
    let single = Model::<f32>::new(&graph, Options::default()).unwrap();
    let truncated = Model::<f64>::new(&graph, Options { kernel: Kernel::Truncated }).unwrap();
    let counts = [
        counts(&mut Reference::new(&exact)),
        counts(&mut Reference::new(&single)),
        counts(&mut Reference::new(&truncated)),
    ];
    assert!(counts[0] > 50 && counts.iter().all(|&c| c.abs_diff(counts[0]) * 20 < counts[0]), "{counts:?}");
}

#[test]
fn an_srm_network_is_converted_where_integers_are_needed() {
    let quantised = front(&network(SRM)).unwrap().into_quantised();
    assert_eq!(quantised.compartments(), 7);
    assert!(!quantised.parts().notes.is_empty());
}
