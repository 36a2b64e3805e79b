//! Neurons of several compartments: each parent adds the value that its child pushes in a step.

use std::sync::Arc;

use crate::common::compare::{assert_on_machine, roomy, small_cores, trace};
use crate::common::random;
use crate::common::{Builder, engines, neuron, unsearched};
use crate::pruning::assert_same;
use nsim::check::equivalence::{Difference, check_copies};
use nsim::check::verify::{Violation, verify};
use nsim::compile::{CompileError, Options, Strategy, compile, load};
use nsim::golden::Golden;
use nsim::ir::arithmetic::{Semantics, ThresholdTest};
use nsim::ir::base::fixed::Refractory;
use nsim::ir::base::id::{ChannelId, CompartmentId, PopulationId};
use nsim::ir::graph::{PerCompartment, Shape};
use nsim::ir::neurons::{NeuronKind, Role, Stack};
use nsim::ir::program::Program;
use nsim::ir::quantised::{Child, Neuron, Parts, Quantised, Units};
use nsim::ir::spikes::Engine;
use nsim::quantise::prune::{Plan, prune};
use rayon::prelude::*;

/// Populations of the network of [`pairs`].
const CHILD: PopulationId = PopulationId(1);
const PARENT: PopulationId = PopulationId(2);

/// Neurons of two compartments, each with a channel into the child and one into the parent. The
/// child keeps half of its voltage in a step, the parent half of its current.
fn pairs(neurons: u32) -> Builder {
    let mut net = Builder::new();
    let input = net.input("in", 2 * neurons);
    let line = Shape::Line(neurons);
    let child = net.loihi_with("child", line, PerCompartment::Same(neuron(4096, 2048, 3, 1)));
    let parent = net.loihi_with("parent", line, PerCompartment::Same(neuron(2048, 4096, 4, 1)));
    net.dense(input, child, |channel, index| if channel == index { 2 } else { 0 });
    net.dense(input, parent, |channel, index| if channel == neurons + index { 2 } else { 0 });
    net.parts.children.push(Child { population: child, parent, role: Role::Add });
    net
}

/// By hand from equations (2) to (7): a spike of a channel adds 128 to a current. The child pushes
/// 128, 192, 224 and 0; with the 224 it spikes.
#[test]
fn a_parent_adds_what_its_child_pushes_in_the_same_step() {
    // Spikes of channels; spike, u and v of the child and of the parent.
    let steps: [(&[u32], [i32; 3], [i32; 3]); 5] = [
        (&[0], [0, 128, 128], [0, 0, 128]),
        (&[0, 1], [0, 128, 192], [1, 128, 0]),
        (&[0], [1, 128, 0], [1, 64, 0]),
        (&[], [0, 0, 0], [0, 32, 32]),
        (&[], [0, 0, 0], [0, 16, 16]),
    ];
    for (name, mut engine) in engines(&pairs(1).build()) {
        engine.begin(steps.len() as u32);
        for (step, (channels, child, parent)) in steps.into_iter().enumerate() {
            engine.step((&channels.iter().copied().map(ChannelId).collect::<Vec<_>>()).into());
            for (id, expected) in [(CompartmentId(0), child), (CompartmentId(1), parent)] {
                let spiked = i32::from(engine.spikes().contains(&id));
                assert_eq!([spiked, engine.u(id), engine.v(id)], expected, "{name}, step {step}, compartment {id}");
            }
        }
        // Both compartments are active in every step, except the child in the last.
        assert_eq!(engine.totals().active_updates, 9, "{name}");
    }
}

#[test]
fn random_neurons_of_several_compartments_are_the_same_in_both_engines() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(8).build().unwrap();
    let compare = |seed: u64| {
        let network = random::joined(seed);
        let sample = random::sample(&network, seed);
        let expected = trace(&mut Golden::new(&network), &network, &sample);
        let targets = [roomy("loihi1-chip"), small_cores("loihi1-chip", 40), small_cores("loihi1-chip", 13)];
        for (target, strategy) in targets.into_iter().zip(Strategy::ALL) {
            let options = Options { strategy, ..unsearched() };
            let program = compile(network.clone(), &target, &options).unwrap().program;
            assert_on_machine(&network, &program, &sample, &expected, &format!("network {seed}, {strategy:?}"));
        }
        let apart = Parts { children: Vec::new(), ..network.parts().clone() };
        let apart = trace(&mut Golden::new(&Quantised::new(apart).unwrap()), &network, &sample);
        (u64::from(apart != expected), expected.overflow.u_wrapped)
    };
    let found: Vec<(u64, u64)> = pool.install(|| (0..200).into_par_iter().map(compare).collect());
    let (matter, wrap) = (found.iter().map(|found| found.0).sum::<u64>(), found.iter().filter(|found| found.1 > 0));
    assert!(matter > 80 && wrap.count() > 5, "children matter in {matter} networks");
}

#[test]
fn copies_and_pruned_networks_have_the_same_neurons() {
    let network = pairs(30).build();
    let pruned = prune(&network, &Plan::fixed()).unwrap();
    assert_eq!(pruned.parts().children, network.parts().children);
    // A core of 7 holds three neurons.
    let options = Options { copies: 3, place: false, ..Options::default() };
    let compiled = compile(pruned, &small_cores("loihi1-chip", 7), &options).unwrap();
    assert_eq!((compiled.quantised.children().count(), compiled.partition.cores()), (90, 30));
}

#[test]
fn pruning_changes_no_neuron() {
    let mut pruned_away = 0;
    for seed in 0..100 {
        let network = random::joined(seed);
        let (pruned, sample) = (prune(&network, &Plan::fixed()).unwrap(), random::sample(&network, seed));
        let small = &mut Golden::new(&pruned);
        let whole = &mut Golden::new(&network);
        let engines = &mut [("pruned".to_string(), small as &mut dyn Engine)];
        assert_same(whole, engines, (&network, &pruned), &sample, &format!("network {seed}"));
        pruned_away += network.synapses() - pruned.synapses();
    }
    assert!(pruned_away > 1_000, "{pruned_away} synapses");
}

#[test]
fn compartments_of_a_neuron_that_are_apart_are_found() {
    let (network, target) = (pairs(4).build(), roomy("loihi1-chip"));
    let compiled = compile(network.clone(), &target, &Options::default()).unwrap();
    // Children of two neurons exchange places: every compartment still has its parameters.
    let mut parts = (*compiled.program).clone().into_parts();
    let [a, b] = [CompartmentId(0), CompartmentId(1)];
    let (at_a, at_b) = (parts.seats[a], parts.seats[b]);
    let seats = Arc::make_mut(&mut parts.seats);
    (seats[a], seats[b]) = (at_b, at_a);
    Arc::make_mut(&mut parts.cores[at_a.core].ids).swap(at_a.slot.into(), at_b.slot.into());
    let swapped = Program::new(parts).unwrap();
    assert_eq!(verify(&swapped, &target), Ok(()));
    assert_eq!(check_copies(&network, &swapped, 1), Err(Difference::Neuron(a)));
    // No compartment pushes the value that a parent pops.
    for slot in [0, 1] {
        let mut parts = (*compiled.program).clone().into_parts();
        let class = parts.classes.iter_mut().next().unwrap();
        class.compartments[slot].neuron.stack = Stack::UNUSED;
        let found = verify(&Program::new(parts).unwrap(), &target);
        assert!(matches!(found, Err(Violation::Neuron { slot: 1, .. })), "{found:?}");
    }
    let mut file = compiled.mapping_file();
    assert!(load(network.clone(), &target, &Options::default(), &file).is_ok());
    file.cores[0].holds.swap(1, 2);
    match load(network, &target, &Options::default(), &file).unwrap_err() {
        CompileError::Input(error) => assert_eq!(error.code, "mapping.neuron", "{error}"),
        other => panic!("{other}"),
    }
}

#[test]
fn what_cannot_be_a_child_is_refused() {
    const OTHER: PopulationId = PopulationId(3);
    let refused = |what: &str, change: fn(&mut Parts)| {
        let mut net = pairs(2);
        net.loihi_with("other", Shape::Line(2), PerCompartment::Same(neuron(4096, 0, 3, 1)));
        assert!(Quantised::new(net.parts.clone()).is_ok());
        change(&mut net.parts);
        let error = Quantised::new(net.parts).unwrap_err();
        assert!(error.0.contains(what), "{error}, not {what}");
    };
    fn add(parts: &mut Parts, population: PopulationId, parent: PopulationId) {
        parts.children.push(Child { population, parent, role: Role::Add });
    }
    fn each(parts: &mut Parts, id: PopulationId, change: fn(&mut Neuron)) {
        let Units::Compartments { neurons: PerCompartment::Same(neuron), .. } = &mut parts.populations[id].units else {
            panic!("{id} has no neurons that are all the same")
        };
        change(neuron);
    }
    refused("does not exist", |parts| add(parts, PARENT, PopulationId(9)));
    refused("inputs have no compartments", |parts| add(parts, PopulationId(0), OTHER));
    refused("no circle", |parts| add(parts, PARENT, PARENT));
    refused("no circle", |parts| add(parts, PARENT, CHILD));
    refused("another parent", |parts| add(parts, CHILD, OTHER));
    refused("another child", |parts| {
        parts.children[0].parent = OTHER;
        add(parts, PARENT, OTHER);
    });
    refused("shapes or start steps", |parts| parts.populations[CHILD].shape = Shape::Volume(2, 1, 1));
    refused("shapes or start steps", |parts| {
        if let Units::Compartments { start_step, .. } = &mut parts.populations[PARENT].units {
            *start_step = 1;
        }
    });
    refused("If neurons neither push nor add", |parts| each(parts, CHILD, |neuron| neuron.kind = NeuronKind::If));
    refused("Sigma neurons neither", |parts| each(parts, PARENT, |neuron| neuron.kind = NeuronKind::Sigma));
    refused("refractory period above 1", |parts| {
        each(parts, CHILD, |neuron| neuron.refractory = Refractory::new(2).unwrap());
    });
    refused("strict threshold", |parts| parts.threshold = ThresholdTest::Inclusive);
    refused("the chip's semantics", |parts| parts.semantics = Semantics::Lava);
    refused("4 compartments at most", |parts| {
        let mut last = PARENT;
        for first in [6, 8, 10] {
            let mut next = parts.populations[OTHER].clone();
            if let Units::Compartments { first: number, .. } = &mut next.units {
                *number = CompartmentId(first);
            }
            let next = parts.populations.push(next);
            add(parts, last, next);
            last = next;
        }
    });
}
