//! Graded spikes: a network whose spikes carry 3 is the same as one of binary spikes over weights
//! times 3, in the interpreter and in the machine, on random networks; and the two engines agree on
//! payloads of any size, past every overflow.

use crate::common::random::{self, Draw};
use crate::common::{Net, format, neuron};
use nsim::check::equivalence::check;
use nsim::compile::{Options, compile};
use nsim::dynamics::synapses::Enumerate;
use nsim::files::target::load_target;
use nsim::golden::Golden;
use nsim::ir::activity::{Activity, Overflow, Totals};
use nsim::ir::arithmetic::Semantics;
use nsim::ir::base::fixed::{Payload, SignMode};
use nsim::ir::base::id::{ChannelId, CompartmentId};
use nsim::ir::graph::Shape;
use nsim::ir::program::{Graded, Program};
use nsim::ir::quantised::connectivity::Connectivity;
use nsim::ir::quantised::{Parts, Quantised};
use nsim::ir::resource::Resource;
use nsim::ir::spikes::{Engine, Message, Sample};
use nsim::machine::{Image, Machine, Settings};
use rayon::prelude::*;

/// Everything that an engine shows: spikes and registers after each step, and counts.
#[derive(Debug, PartialEq)]
struct Shown {
    steps: Vec<(Vec<CompartmentId>, Vec<[i32; 3]>)>,
    totals: Totals,
    overflow: Overflow,
    /// Of each step: spikes with what they carry.
    carried: Vec<Vec<(CompartmentId, i32)>>,
}

fn shown(engine: &mut dyn Engine, compartments: u32, sample: &Sample) -> Shown {
    engine.begin(sample.steps());
    let (mut steps, mut carried) = (Vec::new(), Vec::new());
    for step in 0..sample.steps() {
        engine.step(sample.input(step));
        let all = (0..compartments).map(CompartmentId);
        let registers = all.map(|c| [engine.u(c), engine.v(c), engine.v_register(c)]).collect();
        steps.push((engine.ascending_spikes(), registers));
        assert!(engine.payloads().is_empty() || engine.payloads().len() == engine.spikes().len());
        let mut pairs: Vec<_> = engine.spikes().iter().copied().zip(engine.payloads().iter().copied()).collect();
        pairs.sort_unstable();
        carried.push(pairs);
    }
    Shown { steps, totals: engine.totals(), overflow: engine.overflow(), carried }
}

/// What the machine shows in all numbers of shards, with skipping on and off, held to `expected`;
/// returns the activity.
fn assert_machine(network: &Quantised, sample: &Sample, expected: &Shown, what: &str) -> Activity {
    let chip = load_target("oheo-gulch").unwrap();
    let mut limits = chip.limits().clone();
    (limits[Resource::CompartmentProfiles], limits[Resource::ThresholdProfiles], limits[Resource::SynapseFormats]) =
        (1024, 1024, 64);
    (limits[Resource::Accumulators], limits[Resource::AxonsIn]) = (1 << 16, 1 << 16);
    let compiled = compile(network.clone(), &chip.with_limits(limits), &Options::default()).unwrap();
    let mut activity: Option<Activity> = None;
    for shards in [1, 2, 8] {
        let image = Image::new(&compiled.program, shards).unwrap();
        for skip in [true, false] {
            let mut machine = Machine::new(&image, Settings { skip, per_step: false });
            let fast = shown(&mut machine, network.compartments(), sample);
            assert!(fast == *expected, "{what}, {shards} shards, skip {skip}");
            let counts = machine.take_activity();
            assert_eq!(counts.totals(), expected.totals, "{what}: counts by core add up");
            assert_eq!(*activity.get_or_insert_with(|| counts.clone()), counts, "{what}");
        }
    }
    activity.unwrap()
}

/// The network with every weight a multiple of 6 and no larger than 8 bits hold three times, and
/// exponents that lose no bits.
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

/// Random synapses as listed ones, so that their weights can be multiplied.
fn list_random(parts: &mut Parts) {
    for index in 0..parts.projections.len() {
        let projection = &mut parts.projections.as_mut_slice()[index];
        let sources = parts.populations[projection.source].shape.len();
        if let Connectivity::Random { .. } = projection.connectivity {
            let (mut first, mut targets, mut weights) = (vec![0u64], Vec::new(), Vec::new());
            for source in 0..sources {
                let mut list = Vec::new();
                projection.connectivity.for_each_from(source, |target, weight| list.push((target, weight)));
                list.sort_unstable();
                targets.extend(list.iter().map(|synapse| synapse.0));
                weights.extend(list.iter().map(|synapse| synapse.1));
                first.push(targets.len() as u64);
            }
            projection.connectivity =
                Connectivity::Sparse { first: first.into(), targets: targets.into(), weights: weights.into() };
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
            // All populations, or some: then a binary spike stands beside those that carry 3.
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
            let n = graded.compartments();
            let expected = shown(&mut Golden::new(&graded), n, &sample);
            let meant = shown(&mut Golden::new(&binary), n, &sample);
            assert_eq!(
                (&expected.steps, expected.totals, expected.overflow),
                (&meant.steps, meant.totals, meant.overflow)
            );
            let activity = assert_machine(&graded, &sample, &expected, &format!("network {seed}"));
            assert_eq!(activity.totals(), assert_machine(&binary, &sample, &meant, "binary").totals());
            expected.overflow.any()
        })
        .collect();
    let overflowed = overflows.iter().filter(|&&any| any).count();
    assert!(overflowed > 10, "{overflowed} networks overflow: they test too little");
}

/// Payloads of up to 24 bits: sums leave the accumulator, 32 bits, and every register.
#[test]
fn the_engines_agree_on_payloads_of_any_size() {
    let overflows: Vec<bool> = (0..200u64)
        .into_par_iter()
        .map(|seed| {
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
            let sample = random::sample(&network, seed);
            let expected = shown(&mut Golden::new(&network), network.compartments(), &sample);
            assert_machine(&network, &sample, &expected, &format!("network {seed}"));
            expected.overflow.any()
        })
        .collect();
    assert!(overflows.iter().filter(|&&any| any).count() > 40);
}

/// Enough lanes and sources for every form of list and dense block, and a product that the
/// accumulator wraps.
#[test]
fn every_form_of_synapses_carries_payloads() {
    // Dense blocks; lists of three bytes a synapse in runs of 4, 8 and 16; lists of words.
    for (targets, fan_out, high, exponent) in
        [(200, 200, 100, 0), (6_000, 3, 100, 0), (6_000, 8, 100, 0), (6_000, 40, 100, 0), (6_000, 20, 254, 7)]
    {
        let mut net = Net::new();
        let (input, hidden) = (net.input(Shape::Line(300)), vec![neuron(1_000, 2_000, 5_000, 1); targets as usize]);
        let layer = net.loihi(Shape::Line(targets), &hidden, 0);
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
            net.project(source, layer, format(SignMode::Mixed, exponent), seed as i64 - 1, connectivity);
            net.parts.populations[source].message = Message::Payload(Payload::new(401).unwrap());
        }
        let network = net.build();
        let events: Vec<_> = (0..6).flat_map(|t| (0..300).step_by(3).map(move |c| (t, ChannelId(c)))).collect();
        let sample = Sample::new(8, &events, None).unwrap();
        let expected = shown(&mut Golden::new(&network), targets, &sample);
        assert!(expected.totals.spikes > 0);
        assert_machine(&network, &sample, &expected, &format!("{targets} targets, {fan_out} synapses"));
    }
}

/// In every semantics a graded spike adds what as many binary spikes would, if nothing wraps
/// between.
#[test]
fn a_payload_multiplies_the_weight_in_every_semantics() {
    for semantics in [Semantics::Hardware, Semantics::Lava, Semantics::Slayer] {
        let network = |payload: Option<i64>, channels: u32| {
            let mut net = Net::with(semantics);
            let input = net.input(Shape::Line(channels));
            let output = net.loihi(Shape::Line(2), &[neuron(100, 200, 600, 2), neuron(4_096, 50, 900, 1)], 0);
            net.dense(
                input,
                output,
                0,
                &vec![-6, 20].into_iter().flat_map(|w| vec![w; channels as usize]).collect::<Vec<_>>(),
            );
            let message = payload.map(|payload| Message::Payload(Payload::new(payload).unwrap()));
            net.parts.populations[input].message = message.unwrap_or_default();
            net.build()
        };
        let (graded, binary) = (network(Some(7), 1), network(None, 7));
        let spikes = |channels: u32| -> Vec<_> {
            (0..60).filter(|t| t % 3 > 0).flat_map(|t| (0..channels).map(move |c| (t, ChannelId(c)))).collect()
        };
        let sample = |channels| Sample::new(60, &spikes(channels), None).unwrap();
        let one = shown(&mut Golden::new(&graded), 2, &sample(1));
        let seven = shown(&mut Golden::new(&binary), 2, &sample(7));
        assert_eq!(one.steps, seven.steps);
        assert!(one.totals.spikes > 0);
        assert_eq!(seven.totals.synaptic_events, 7 * one.totals.synaptic_events);
        assert_machine(&graded, &sample(1), &one, &format!("{semantics:?}"));
    }
}

/// A change to who carries what.
type Change<'a> = &'a dyn Fn(&mut Vec<Graded>);

#[test]
fn a_payload_that_is_lost_moved_or_changed_in_a_program_is_found() {
    let mut net = Net::new();
    let a = net.input(Shape::Line(3));
    let plain = neuron(1024, 128, 80, 1);
    let b = net.loihi(Shape::Line(4), &[plain; 4], 0);
    let c = net.loihi(Shape::Line(2), &[plain; 2], 0);
    net.dense(a, b, 0, &[40; 12]);
    net.dense(b, c, 0, &[20; 8]);
    let mut parts = net.build().parts().clone();
    parts.populations[b].message = Message::Payload(Payload::new(3).unwrap());
    let network = Quantised::new(parts).unwrap();
    let target = load_target("oheo-gulch").unwrap();
    let mapped = compile(network, &target, &Options::default()).unwrap();
    assert_eq!(check(&mapped.quantised, &mapped.program).map(drop), Ok(()));
    let changed = |change: Change<'_>| {
        let mut parts = mapped.program.parts().clone();
        assert_eq!(parts.graded.len(), 1, "the compartments of one population");
        change(&mut parts.graded);
        Program::new(parts)
    };
    let differs = |program: Program| check(&mapped.quantised, &program).unwrap_err().to_string();
    let wrong: [Change<'_>; 3] =
        [&Vec::clear, &|graded| graded[0].message = Message::Payload(Payload::new(4).unwrap()), &|graded| {
            graded[0].sources.end -= 1;
        }];
    for change in wrong {
        assert!(differs(changed(change).unwrap()).contains("payload"));
    }
    let open: [Change<'_>; 2] = [
        // A source that is not there, and one with two payloads.
        &|graded| graded[0].sources.end = 10_000,
        &|graded| graded.push(graded[0].clone()),
    ];
    for change in open {
        assert!(changed(change).unwrap_err().to_string().contains("payload"));
    }
}
