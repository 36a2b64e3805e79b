//! Networks with relays against the golden interpreter of these networks without relays, and
//! changed relays against the checker.

use crate::common;
use std::collections::BTreeSet;

use crate::common::compare::small_cores;
use crate::common::random::{self, Draw};
use crate::common::unsearched;
use nsim::check::relays::check;
use nsim::compile::compile;
use nsim::golden::Golden;
use nsim::ir::base::fixed::{Decay, Delay, Payload, Refractory};
use nsim::ir::base::id::{CompartmentId, Id, PopulationId, ProjectionId};
use nsim::ir::graph::PerCompartment;
use nsim::ir::quantised::connectivity::Connectivity;
use nsim::ir::quantised::{Parts, Quantised, Units};
use nsim::ir::resource::Resource;
use nsim::ir::spikes::{Engine, Message, Sample, Spikes};
use nsim::machine::{Image, Machine, Settings};
use nsim::quantise::relays::{Relayed, relayed};

const NETWORKS: u64 = 400;

/// The spikes of the original's compartments, shifted earlier by the delay of their population.
fn spikes(
    engine: &mut dyn Engine,
    network: &Quantised,
    sample: &Sample,
    later: impl Fn(PopulationId) -> u32,
) -> BTreeSet<(u32, CompartmentId)> {
    let late = network.populations().ids().map(&later).max().unwrap_or(0);
    engine.begin(sample.steps() + late);
    let mut spikes = BTreeSet::new();
    for step in 0..sample.steps() + late {
        engine.step(if step < sample.steps() { sample.input(step) } else { Spikes::default() });
        for id in engine.ascending_spikes().into_iter().filter(|id| id.0 < network.compartments()) {
            let (population, _) = network.population_of(id);
            let step = step.checked_sub(later(population)).expect("a spike before its population may spike");
            if step < sample.steps() {
                spikes.insert((step, id));
            }
        }
    }
    spikes
}

/// Random networks with relays, where delays leave time for them.
fn with_relays() -> impl Iterator<Item = (u64, Quantised, u32, Relayed)> {
    (0..NETWORKS).filter_map(|seed| {
        let network = random::network(seed);
        let most = Draw::new(seed ^ 0xfa0).from(2, 9) as u32;
        let relayed = relayed(&network, most).ok()?;
        (relayed.relays > 0).then_some((seed, network, most, relayed))
    })
}

#[test]
fn original_compartments_spike_as_without_relays() {
    let chip = small_cores("nahuku-32", 7);
    let (mut compared, mut padded, mut spiking, mut deep) = (0, 0, 0, 0);
    for (seed, network, most, Relayed { network: with, later, .. }) in with_relays() {
        check(&network, &with, &later).unwrap_or_else(|error| panic!("{seed}: {error}"));
        let limits = chip.limits().clone().with(Resource::AxonsOutPerCompartment, most);
        let options = unsearched();
        let compiled = compile(with.clone(), &chip.clone().with_limits(limits), &options);
        let compiled = compiled.unwrap_or_else(|error| panic!("{seed}, {most} axons: {error}"));
        let sample = random::sample(&network, seed);
        let meant = spikes(&mut Golden::new(&network), &network, &sample, |_| 0);
        let image = Image::new(&compiled.program, 2).unwrap();
        let mut machine = Machine::new(&image, Settings::default());
        let found = spikes(&mut machine, &network, &sample, |population| later[population]);
        assert_eq!(found, meant, "network {seed}");
        let relays = with.compartments() - network.compartments();
        let counted = machine.take_activity().totals();
        assert!(counted.spikes as usize >= meant.len() && relays > 0, "activity counts relays");
        compared += 1;
        padded += u32::from(later.iter().any(|&later| later > 0));
        spiking += u32::from(!meant.is_empty());
        deep += u32::from(with.populations().iter().any(|p| p.name.ends_with(".relays.relays")));
    }
    println!("{compared} networks, {padded} padded, {spiking} spiking, {deep} with trees of several levels");
    assert!(compared >= 40 && padded >= 10 && spiking >= 25 && deep >= 5);
}

/// Changes a synapse of a projection; projections to and from relays come first.
fn synapse(parts: &mut Parts, draw: &mut Draw, change: impl Fn(&mut Vec<u32>, &mut Vec<i16>, usize, u32, i16)) -> bool {
    let lists = |p: &nsim::ir::quantised::Projection| matches!(&p.connectivity, Connectivity::Sparse { targets, .. } if !targets.is_empty());
    let ids: Vec<ProjectionId> = parts.projections.enumerate().filter(|(_, p)| lists(p)).map(|(id, _)| id).collect();
    let id = draw.one_of(&ids);
    let size = parts.populations[parts.projections[id].target].shape.len();
    let projection = &mut parts.projections[id];
    let step = projection.format.sign.step(projection.format.bits);
    let Connectivity::Sparse { first, targets, weights } = &mut projection.connectivity else { return false };
    let (mut to, mut of, at) = (targets.to_vec(), weights.to_vec(), draw.from(0, targets.len() as i64 - 1) as usize);
    change(&mut to, &mut of, at, size, step);
    let changed = to[..] != targets[..] || of[..] != weights[..];
    (*targets, *weights) = (to.into(), of.into());
    changed && first.len() > 1
}

type Mutation = (&'static str, fn(&mut Parts, &mut Draw, usize) -> bool);

const MUTATIONS: [Mutation; 9] = [
    ("weight", |parts, draw, _| {
        synapse(parts, draw, |_, weights, at, _, step| weights[at] -= weights[at].signum().max(1) * step)
    }),
    ("target", |parts, draw, _| synapse(parts, draw, |targets, _, at, size, _| targets[at] = (targets[at] + 1) % size)),
    ("sources swapped", |parts, draw, _| {
        synapse(parts, draw, |targets, _, at, _, _| {
            let other = (at + 1) % targets.len();
            targets.swap(at, other);
        })
    }),
    ("delay of what a relay sends or gets", |parts, draw, own| {
        let of_relays = |p: &nsim::ir::quantised::Projection| p.source.index() >= own || p.target.index() >= own;
        let ids: Vec<_> = parts.projections.enumerate().filter(|(_, p)| of_relays(p)).map(|(id, _)| id).collect();
        let delay = &mut parts.projections[draw.one_of(&ids)].delay;
        *delay = Delay::new((i64::from(delay.get()) + 1) % 63).unwrap();
        true
    }),
    ("a relay with memory", |parts, _, own| neurons(parts, own, |n| n.dv = Decay::new(4095).unwrap())),
    ("a relay that rests after spikes", |parts, _, own| {
        neurons(parts, own, |n| n.refractory = Refractory::new(2).unwrap())
    }),
    ("a relay that is never reached by its weight", |parts, _, own| {
        neurons(parts, own, |n| n.vth = nsim::ir::base::fixed::ThresholdMantissa::new(9).unwrap())
    }),
    ("a relay that starts late", |parts, _, own| {
        let Units::Compartments { start_step, .. } = &mut parts.populations[PopulationId::new(own)].units else {
            return false;
        };
        *start_step += 20;
        true
    }),
    ("a relay that multiplies", |parts, _, own| {
        parts.populations[PopulationId::new(own)].message = Message::Payload(Payload::new(2).unwrap());
        true
    }),
];

fn neurons(parts: &mut Parts, own: usize, change: fn(&mut nsim::ir::quantised::Neuron)) -> bool {
    let Units::Compartments { neurons, .. } = &mut parts.populations[PopulationId::new(own)].units else {
        return false;
    };
    let mut neuron = neurons.get(0);
    change(&mut neuron);
    *neurons = PerCompartment::Same(neuron);
    true
}

#[test]
fn changed_relays_are_rejected() {
    let (mut rejected, mut same) = (vec![0; MUTATIONS.len()], 0);
    for (seed, network, _, Relayed { network: with, later, .. }) in with_relays() {
        let own = network.populations().len();
        for (kind, (name, mutate)) in MUTATIONS.iter().enumerate() {
            let (mut parts, mut draw) = (with.parts().clone(), Draw::new(seed ^ (kind as u64) << 32));
            if !mutate(&mut parts, &mut draw, own) {
                continue;
            }
            // An invalid network needs no checker.
            let Ok(mutated) = Quantised::new(parts) else { continue };
            match check(&network, &mutated, &later) {
                Err(_) => rejected[kind] += 1,
                // Exchanging synapses of one source changes no meaning.
                Ok(()) if *name == "sources swapped" || *name == "delay of what a relay sends or gets" => same += 1,
                Ok(()) => panic!("network {seed}: {name} was not noticed"),
            }
        }
        let mut wrong = later.clone();
        wrong.as_mut_slice()[own - 1] += 1;
        assert!(check(&network, &with, &wrong).is_err(), "network {seed}: another shift was not noticed");
    }
    println!("rejected {rejected:?}, meaning the same {same}");
    assert!(rejected.iter().all(|&count| count > 10), "{rejected:?}");
}

#[test]
fn what_relays_cannot_do_is_said() {
    use nsim::ir::graph::Shape;
    let neuron = common::neuron(4096, 4096, 10, 1);
    // All-to-all connections among eight, without delay, form a loop.
    let mut net = common::Builder::new();
    let all = net.each("all", Shape::Line(8), &[neuron; 8], 0);
    net.matrix(all, all, 0, &[2; 64]);
    let refused = relayed(&net.build(), 4).unwrap_err();
    assert_eq!(refused.code, "map.relays");
    assert!(refused.message.contains("(delay 0) needs a delay of 1"), "{}", refused.message);
    // The network with a step of delay.
    let mut net = common::Builder::new();
    let all = net.each("all", Shape::Line(8), &[neuron; 8], 0);
    net.matrix(all, all, 1, &[2; 64]);
    let network = net.build();
    let found = relayed(&network, 4).unwrap();
    assert_eq!((found.relays, found.later.as_slice()), (8 * 2, &[0][..]));
    check(&network, &found.network, &found.later).unwrap();
    // A chain is padded with delays.
    let mut net = common::Builder::new();
    let from = net.each("from", Shape::Line(1), &[neuron], 0);
    let to = net.each("to", Shape::Line(8), &[neuron; 8], 0);
    net.matrix(from, to, 0, &[2; 8]);
    let network = net.build();
    let found = relayed(&network, 4).unwrap();
    assert_eq!((found.relays, found.later.as_slice()), (2, &[0, 1][..]));
    check(&network, &found.network, &found.later).unwrap();
    assert!(relayed(&network, 8).unwrap().relays == 0);
}
