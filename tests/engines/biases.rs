//! Compartments that differ in their biases alone are updated as vectors, and integers may be added
//! to each in a step: the machine equals the interpreter in spikes, registers and counts.

use std::cell::Cell;

use crate::common::compare::{assert_on_machine, roomy, shown, trace, with_neurons};
use crate::common::{biased, neuron, random, unsearched};
use nsim::compile::compile;
use nsim::golden::Golden;
use nsim::ir::arithmetic::Semantics;
use nsim::ir::base::id::CompartmentId;
use nsim::ir::base::rng;
use nsim::ir::neurons::NeuronKind;
use nsim::ir::quantised::{Neuron, Population, Quantised};
use nsim::ir::spikes::{Added, Engine};
use nsim::machine::{Image, Machine, Settings};

/// The network, its compartments alike but for their biases: every third has none, some large ones.
fn alike_but_for_bias(network: &Quantised, seed: u64) -> Quantised {
    let of_all = |use_: u64, limit| rng::below(limit, seed, 0, use_) as i64;
    let alike = neuron(of_all(1, 4097), of_all(2, 4097), 1 + of_all(3, 300), 1 + of_all(4, 5));
    let number = Cell::new(0);
    with_neurons(network, |_| {
        let i = number.replace(number.get() + 1);
        let draw = |use_: u64, limit| rng::below(limit, seed, 1 + i, use_) as i64;
        if i.is_multiple_of(3) {
            alike
        } else {
            biased(alike, draw(5, 8192) - 4096, draw(6, if i.is_multiple_of(7) { 8 } else { 3 }))
        }
    })
}

#[test]
fn compartments_that_differ_in_their_biases_alone_equal_the_interpreter() {
    let (board, mut spikes, mut overflows) = (roomy("nahuku-32"), 0, 0);
    for seed in 0..120 {
        let network = alike_but_for_bias(&random::network(seed), seed);
        let sample = random::sample(&network, seed);
        let Ok(mapped) = compile(network.clone(), &board, &unsearched()) else { continue };
        let expected = trace(&mut Golden::new(&network), &network, &sample);
        assert_on_machine(&network, &mapped.program, &sample, &expected, &format!("network {seed}"));
        spikes += expected.totals.spikes;
        overflows += u32::from(expected.overflow.any());
    }
    assert!(spikes > 20_000 && overflows > 5, "{spikes} spikes, {overflows} networks with overflow");
}

/// Integers of a step: small and large ones, for some compartments that take them.
fn added(kinds: &[NeuronKind], seed: u64, step: u32) -> Vec<Added> {
    let draw = |i: u64, use_: u64, limit| rng::below(limit, seed, i << 20 | u64::from(step), use_);
    let signed = |i, use_| {
        let magnitude = draw(i, use_, 1 << draw(i, use_ + 1, 25)) as i32;
        if draw(i, use_ + 2, 2) == 0 { magnitude } else { -magnitude }
    };
    let takes = |i: u64| matches!(kinds[i as usize], NeuronKind::Loihi | NeuronKind::If);
    let chosen = (0..kinds.len() as u64).filter(|&i| takes(i) && draw(i, 0, 3) == 0);
    chosen.map(|i| Added { compartment: CompartmentId(i as u32), to_q: signed(i, 1), to_bias: signed(i, 4) }).collect()
}

#[test]
fn integers_added_to_a_step_act_in_it_alone_and_as_in_the_interpreter() {
    let board = roomy("oheo-gulch");
    let (mut compared, mut spikes, mut wrapped) = (0, 0, 0);
    for seed in 0..90 {
        let network = if seed % 3 == 0 { random::joined(seed) } else { random::network(seed) };
        let network = if seed % 3 == 1 { alike_but_for_bias(&network, seed) } else { network };
        let Ok(mapped) = compile(network.clone(), &board, &unsearched()) else { continue };
        if network.parts().semantics != Semantics::Hardware {
            continue;
        }
        let sample = random::sample(&network, seed);
        let neurons: Vec<Neuron> = network.populations().iter().flat_map(Population::each_neuron).collect();
        let kinds: Vec<NeuronKind> = neurons.iter().map(|neuron| neuron.kind).collect();
        let mut golden = Golden::new(&network);
        let machine = |shards, skip| {
            Machine::new(&Image::new(&mapped.program, shards).unwrap(), Settings { skip, per_step: !skip })
        };
        let mut machines = [machine(1, true), machine(2, true), machine(1, false)];
        golden.begin(sample.steps());
        machines.iter_mut().for_each(|machine| machine.begin(sample.steps()));
        for step in 0..sample.steps() {
            // In every second step none is added.
            let given = if step % 2 == 0 { added(&kinds, seed, step) } else { Vec::new() };
            let (first, rest) = given.split_at(given.len() / 2);
            // Calls before a step add up.
            [first, rest, &given].into_iter().for_each(|added| golden.add(added));
            golden.step(sample.input(step));
            let expected = shown(&golden, &kinds);
            for (place, machine) in machines.iter_mut().enumerate() {
                (0..2).for_each(|_| machine.add(&given));
                assert!(given.is_empty() || !machine.skip_idle(1), "a step with integers is not idle");
                machine.step(sample.input(step));
                let found = shown(machine, &kinds);
                let what = format!("network {seed}, step {step}, machine {place}");
                assert_eq!(found.0, expected.0, "{what}: spikes");
                let word = expected.1.iter().zip(&found.1).position(|(meant, found)| meant != found);
                assert!(word.is_none(), "{what}: word {word:?} of {:?} and {:?}", expected.1, found.1);
            }
        }
        for machine in &machines {
            assert_eq!((machine.totals(), machine.overflow()), (golden.totals(), golden.overflow()), "network {seed}");
        }
        compared += 1;
        spikes += golden.totals().spikes;
        wrapped += golden.overflow().q_wrapped.min(1) + golden.overflow().u_wrapped.min(1);
    }
    assert!(compared > 50 && spikes > 5_000 && wrapped > 40, "{compared} networks, {spikes} spikes, {wrapped} wraps");
}
