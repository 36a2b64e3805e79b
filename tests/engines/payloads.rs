//! Graded spikes. A network with spikes of payload 3 equals one of binary spikes over weights times
//! 3, in both engines, on random networks. Both engines agree on payloads of any size, past every
//! overflow.

use crate::common::compare::{Shown, Trace, assert_on_machine, roomy, trace};
use crate::common::random::{self, Draw};
use crate::common::{Builder, format, neuron, unsearched};
use nsim::compile::compile;
use nsim::dynamics;
use nsim::dynamics::synapses::Enumerate;
use nsim::golden::Golden;
use nsim::ir::base::fixed::{MessageBits, Payload, SignMode};
use nsim::ir::base::id::ChannelId;
use nsim::ir::graph::{Shape, Window};
use nsim::ir::neurons::NeuronKind;
use nsim::ir::quantised::connectivity::Connectivity;
use nsim::ir::quantised::{Parts, Quantised};
use nsim::ir::spikes::{Message, Sample};
use nsim_testing::sparse;
use rayon::prelude::*;

/// Compares the machine's trace with the interpreter's; returns the trace.
fn compared(network: &Quantised, sample: &Sample, what: &str) -> Trace {
    let compiled = compile(network.clone(), &roomy("oheo-gulch"), &unsearched()).unwrap();
    let expected = trace(&mut Golden::new(network), network, sample);
    assert_on_machine(network, &compiled.program, sample, &expected, what);
    expected
}

/// The network with weights that are multiples of 6 and fit 8 bits when tripled, and with exponents
/// that lose no bits.
fn tame(network: &Quantised) -> Parts {
    let mut parts = network.parts().clone();
    for projection in parts.projections.iter_mut() {
        projection.format = format(SignMode::Mixed, i64::from(projection.format.exponent.get()).max(0));
        let tame = |weight: i16| weight / 8 * 2;
        projection.connectivity = map_weights(&projection.connectivity, tame);
    }
    parts
}

fn map_weights(connectivity: &Connectivity, f: impl Fn(i16) -> i16) -> Connectivity {
    let mut connectivity = connectivity.clone();
    match &mut connectivity {
        Connectivity::Dense { weights, .. } | Connectivity::Sparse { weights, .. } => {
            *weights = weights.iter().map(|&w| f(w)).collect();
        }
        Connectivity::Conv2d { kernel, .. } => *kernel = kernel.iter().map(|&w| f(w)).collect(),
        Connectivity::SumPool2d { weight, .. } => *weight = f(*weight),
        Connectivity::Random { .. } => unreachable!("random synapses are listed first"),
    }
    connectivity
}

/// Writes random synapses as lists, so that their weights can be multiplied.
fn list_random(parts: &mut Parts) {
    for index in 0..parts.projections.len() {
        let projection = &mut parts.projections.as_mut_slice()[index];
        let sources = parts.populations[projection.source].shape.len();
        if let Connectivity::Random { .. } = projection.connectivity {
            let list = |source| {
                let mut list = Vec::new();
                projection.connectivity.for_each_from(source, |target, weight| list.push((target, weight)));
                list.sort_unstable();
                list
            };
            projection.connectivity = sparse((0..sources).map(list));
        }
    }
}

#[test]
fn spikes_that_carry_3_are_binary_spikes_over_weights_times_3() {
    let overflows: Vec<bool> = (0..200u64)
        .into_par_iter()
        .map(|seed| {
            let mut listed = random::network(seed).parts().clone();
            list_random(&mut listed);
            let parts = tame(&Quantised::new(listed).unwrap());
            let (mut graded, mut binary) = (parts.clone(), parts.clone());
            let draw = &mut Draw::new(seed);
            // All populations, or some: binary spikes then occur along with spikes of payload 3.
            let all = draw.chance(50);
            for population in graded.populations.iter_mut().filter(|_| all || draw.chance(50)) {
                population.message = Message::Payload(Payload::new(3).unwrap());
            }
            for projection in binary.projections.iter_mut() {
                if graded.populations[projection.source].message != Message::Spike {
                    projection.connectivity = map_weights(&projection.connectivity, |weight| 3 * weight);
                }
            }
            let (graded, binary) = (Quantised::new(graded).unwrap(), Quantised::new(binary).unwrap());
            let sample = random::sample(&graded, seed);
            let expected = compared(&graded, &sample, &format!("network {seed}"));
            let meant = compared(&binary, &sample, &format!("network {seed}, binary"));
            let spikes = |trace: &Trace| -> Vec<_> {
                let sources = |step: &Shown| step.0.iter().map(|sent| sent.0).collect::<Vec<_>>();
                trace.steps.iter().map(|step| (sources(step), step.1.clone())).collect()
            };
            assert!(spikes(&expected) == spikes(&meant), "network {seed}");
            assert_eq!((expected.totals, expected.overflow), (meant.totals, meant.overflow), "network {seed}");
            expected.overflow.any()
        })
        .collect();
    let overflowed = overflows.iter().filter(|&&any| any).count();
    assert!(overflowed > 10, "{overflowed} networks overflow: they test too little");
}

/// Payloads of up to 24 bits: sums leave the accumulator, 32 bits, and every register.
#[test]
fn the_engines_agree_on_payloads_of_any_size() {
    let overflows = (0..200u64).into_par_iter().filter(|&seed| {
        let mut parts = random::network(seed).parts().clone();
        let draw = &mut Draw::new(seed ^ 0x9a7);
        for population in parts.populations.iter_mut() {
            let payload = match draw.from(0, 3) {
                0 => draw.one_of(&[-(1 << 23), (1 << 23) - 1, 1, -1]),
                1 => draw.from(-(1 << 23), (1 << 23) - 1),
                2 => draw.from(-9, 9),
                _ => continue,
            };
            population.message = Message::Payload(Payload::new(payload).unwrap());
        }
        let network = Quantised::new(parts).unwrap();
        let trace = compared(&network, &random::sample(&network, seed), &format!("network {seed}"));
        trace.overflow.any()
    });
    assert!(overflows.count() > 40);
}

/// Enough lanes and sources for every form of list and dense block, and a product that wraps in the
/// accumulator.
#[test]
fn every_form_of_synapses_carries_payloads() {
    // Dense blocks; lists of three bytes a synapse in runs of 4, 8 and 16; lists of words.
    for (targets, fan_out, high, exponent) in
        [(200, 200, 100, 0), (6_000, 3, 100, 0), (6_000, 8, 100, 0), (6_000, 40, 100, 0), (6_000, 20, 254, 7)]
    {
        let mut net = Builder::new();
        let (input, hidden) = (net.input("in", 300), vec![neuron(1_000, 2_000, 5_000, 1); targets as usize]);
        let layer = net.each("layer", Shape::Line(targets), &hidden, 0);
        for (source, sources, seed) in [(input, 300, 1), (layer, targets, 2)] {
            let connectivity = Connectivity::Random {
                targets,
                fan_out,
                low: -high,
                high,
                step: 2,
                seed,
                first_source: sources * seed as u32,
            };
            net.connect(source, layer, format(SignMode::Mixed, exponent), seed as i64 - 1, connectivity);
            net.parts.populations[source].message = Message::Payload(Payload::new(401).unwrap());
        }
        let network = net.build();
        let events: Vec<_> = (0..6).flat_map(|t| (0..300).step_by(3).map(move |c| (t, ChannelId(c)))).collect();
        let sample = Sample::new(8, &events, None).unwrap();
        let expected = compared(&network, &sample, &format!("{targets} targets, {fan_out} synapses"));
        assert!(expected.totals.spikes > 0);
    }
}

/// Values grow until sums no longer fit 32 bits, while others are in flight. Sources of a
/// convolution have more rows of weights than the unchecked queue takes.
#[test]
fn values_may_outgrow_the_sums_that_they_began_with() {
    let (from, to, once) = ((2, 24, 24), (4, 14, 14), (1, 1));
    for delay in [0, 3] {
        let mut net = Builder::new();
        let input = net.input_shape("in", Shape::Volume(from.0, from.1, from.2));
        let sums = vec![dynamics::neuron(NeuronKind::Sigma, &[]).unwrap(); (to.0 * to.1 * to.2) as usize];
        let out = net.each("out", Shape::Volume(to.0, to.1, to.2), &sums, 0);
        let window = Window {
            source: from,
            target: to,
            kernel: (11, 11),
            stride: once,
            padding: (0, 0),
            dilation: once,
            groups: 1,
        };
        let kernel = (0..2 * 4 * 121).map(|k| k % 101 * 2 - 100).collect();
        net.connect(input, out, format(SignMode::Mixed, 0), delay, Connectivity::Conv2d { window, kernel });
        for population in net.parts.populations.iter_mut() {
            population.message = Message::Value(MessageBits::MAX);
        }
        let network = net.build();
        for greatest in [1 << 10, 1 << 30] {
            let value = |t: u32, c: u32| ((c * 7919 + t) as i32 % (greatest >> (14 - 2 * t)).max(2)) - 1;
            let events: Vec<_> =
                (0..7).flat_map(|t| (0..1_152).step_by(3).map(move |c| (t, ChannelId(c), value(t, c)))).collect();
            let sample = Sample::with_values(12, &events, None).unwrap();
            let seen = compared(&network, &sample, &format!("delay {delay}, values below {greatest}"));
            assert!(seen.totals.synaptic_events > 100_000);
            assert_eq!(seen.overflow.any(), greatest > 1 << 20);
        }
    }
}
