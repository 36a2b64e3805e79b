//! Weights written between steps. Both engines agree, in parts and ranks, with skipping and
//! without, over delays and with payloads; unsupported projections are refused.

use std::sync::Mutex;

use crate::common::compare::{Trace, roomy, shown, small_cores};
use crate::common::random::{self, Draw};
use crate::common::{Builder, format, neuron, unsearched};
use crate::ranks::{on_ranks, share};
use nsim::compile::{CompileError, Front, Options, compile};
use nsim::dynamics;
use nsim::dynamics::synapses::Enumerate;
use nsim::golden::Golden;
use nsim::ir::activity::{Activity, Totals};
use nsim::ir::base::fixed::{SignMode, WeightExponent};
use nsim::ir::base::id::{ChannelId, CompartmentId, ProjectionId, RuleId};
use nsim::ir::graph::{PerCompartment, Shape, Window};
use nsim::ir::learning::{Column, Rule, Variable};
use nsim::ir::neurons::NeuronKind;
use nsim::ir::quantised::connectivity::Connectivity;
use nsim::ir::quantised::{Parts, Population, Projection, Quantised, Units};
use nsim::ir::spikes::{Engine, Sample, Spikes};
use nsim::machine::{Image, Machine, Settings};
use nsim::quantise::prune::Plan;
use nsim::quantise::relays::relayed;
use nsim::session::Session;
use nsim_testing::{make_plastic, sparse};
use rayon::prelude::*;

const NETWORKS: u64 = 200;
pub const MOST_RANKS: u32 = 4;

/// Synapses of a projection, source by source.
fn synapses(network: &Parts, projection: &Projection) -> Vec<Vec<(u32, i16)>> {
    let lists = (0..network.populations[projection.source].shape.len()).map(|source| {
        let mut list = Vec::new();
        projection.connectivity.for_each_from(source, |target, weight| list.push((target, weight)));
        list
    });
    lists.collect()
}

/// A random network of any kinds, in which most eligible projections are plastic; kernels are first
/// written as lists.
pub fn plastic(seed: u64) -> Quantised {
    let mut network = match seed % 4 {
        0 => random::mixed(seed),
        1 => random::joined(seed),
        _ => random::network(seed),
    };
    let draw = &mut Draw::new(seed ^ 0x91a5);
    for id in network.projections().ids() {
        let mut parts = network.parts().clone();
        if draw.chance(70) {
            let listed = synapses(&parts, &parts.projections[id]);
            if parts.projections[id].connectivity.window().is_some() {
                parts.projections[id].connectivity = sparse(listed);
            }
            make_plastic(&mut parts, id, Rule::written());
        }
        network = Quantised::new(parts).unwrap_or(network);
    }
    network
}

/// A random sample; messages have an integer where they can.
pub fn sample(network: &Quantised, seed: u64) -> Sample {
    let (plain, draw) = (random::sample(network, seed), &mut Draw::new(seed ^ 0x7a1e));
    let ids = (0..plain.steps()).flat_map(|step| plain.at(step).iter().map(move |&channel| (step, channel)));
    let events: Vec<_> = ids.map(|(step, channel)| (step, channel, draw.one_of(&[-900, -3, 1, 40, 900]))).collect();
    Sample::with_values(plain.steps(), &events, None).unwrap()
}

/// Weights written before a step.
pub type Writes = Vec<(ProjectionId, Vec<i16>)>;

fn written(network: &Quantised, draw: &mut Draw, percent: i64) -> Writes {
    let all: Vec<_> = network.plastic().filter(|_| draw.chance(percent)).collect();
    let weights = |(id, projection): (ProjectionId, &Projection)| {
        let weight = |_| if draw.chance(20) { 0 } else { draw.weight(projection.format) };
        (id, (0..network.synapses_of(id)).map(weight).collect())
    };
    all.into_iter().map(weights).collect()
}

/// Weights for some steps of a sample.
pub fn schedule(network: &Quantised, sample: &Sample, seed: u64) -> Vec<Writes> {
    let draw = &mut Draw::new(seed ^ 0x3717e);
    (0..sample.steps()).map(|_| written(network, draw, 20)).collect()
}

/// Runs a sample; weights are written before each step.
pub fn trace<E: Engine>(
    engine: &mut E,
    (network, sample): (&Quantised, &Sample),
    writes: &[Writes],
    write: impl Fn(&mut E, ProjectionId, &[i16]),
) -> Trace {
    let neurons = network.populations().iter().flat_map(Population::each_neuron);
    let kinds: Vec<NeuronKind> = neurons.map(|neuron| neuron.kind).collect();
    engine.forget(0);
    engine.begin(sample.steps());
    let mut steps = Vec::new();
    for (step, writes) in (0..).zip(writes) {
        writes.iter().for_each(|(id, weights)| write(engine, *id, weights));
        if !sample.at(step).is_empty() || !engine.skip_idle(1) {
            engine.step(sample.input(step));
        }
        steps.push(shown(engine, &kinds));
    }
    engine.settle();
    Trace { steps, totals: engine.totals(), overflow: engine.overflow() }
}

fn on_golden(network: &Quantised, sample: &Sample, writes: &[Writes]) -> Trace {
    trace(&mut Golden::new(network), (network, sample), writes, Golden::write_weights)
}

/// The rule of a plastic projection, whose rows are its synapses.
fn rule_of(network: &Quantised, id: ProjectionId) -> RuleId {
    network.projections()[id].format.rule.unwrap()
}

fn wide(weights: &[i16]) -> Vec<i32> {
    weights.iter().map(|&weight| weight.into()).collect()
}

fn weights_of<E: Engine>(engine: &E, rule: RuleId) -> Vec<i32> {
    engine.learned(rule, Column::Variable(Variable::Weight))
}

/// Compares the machine with a trace in 1, 2 and 8 shards, with skipping and without. Returns its
/// counts by core.
fn assert_on_machine(
    network: &Quantised,
    sample: &Sample,
    writes: &[Writes],
    expected: &Trace,
    what: &str,
) -> Activity {
    let options = unsearched();
    let compiled = compile(network.clone(), &small_cores("oheo-gulch", 7), &options).unwrap();
    let mut counts: Option<Activity> = None;
    for shards in [1, 2, 8] {
        let image = Image::new(&compiled.program, shards).unwrap();
        for (skip, per_step) in [(true, false), (false, true)] {
            let what = format!("{what}, {shards} shards, skip {skip}");
            let mut machine = Machine::new(&image, Settings { skip, per_step });
            for (id, projection) in network.plastic() {
                let first = synapses(network.parts(), projection);
                let first: Vec<i16> = first.iter().flatten().map(|synapse| synapse.1).collect();
                assert!(wide(&first) == weights_of(&machine, rule_of(network, id)), "{what}: {}", projection.name);
            }
            // The second sample begins with the network's own weights.
            for _ in 0..2 {
                let write = |machine: &mut Machine, id, weights: &[i16]| {
                    machine.write_weights(rule_of(network, id), &wide(weights));
                    assert_eq!(weights_of(machine, rule_of(network, id)), wide(weights));
                };
                expected.assert_same(&trace(&mut machine, (network, sample), writes, write), &what);
                let activity = machine.take_activity();
                assert_eq!(activity.totals(), expected.totals, "{what}: counts by core add up");
                assert_eq!(*counts.get_or_insert_with(|| activity.clone()), activity, "{what}: counts by core");
            }
        }
    }
    counts.unwrap()
}

#[test]
fn written_weights_act_alike_in_both_engines() {
    let tried: Vec<(u64, usize, bool)> = (0..NETWORKS)
        .into_par_iter()
        .map(|seed| {
            let network = plastic(seed);
            let sample = sample(&network, seed);
            let writes = schedule(&network, &sample, seed);
            let expected = on_golden(&network, &sample, &writes);
            assert_on_machine(&network, &sample, &writes, &expected, &format!("network {seed}"));
            let differs = expected != on_golden(&network, &sample, &vec![Vec::new(); writes.len()]);
            (expected.totals.spikes, network.plastic().count(), differs)
        })
        .collect();
    let (spikes, plastic) = tried.iter().fold((0, 0), |sum, tried| (sum.0 + tried.0, sum.1 + tried.1));
    let differing = tried.iter().filter(|tried| tried.2).count();
    let what = format!("{spikes} spikes, {plastic} plastic projections, {differing} networks that writes change");
    assert!(spikes > 10_000 && plastic > 200 && differing > 80, "{what}");
}

/// Weights written before the first step act as the network's own, counts by core included.
#[test]
fn weights_written_first_are_those_of_a_network_that_has_them() {
    let compared = (0..80u64).into_par_iter().filter(|&seed| {
        let mut parts = plastic(seed).parts().clone();
        for id in parts.projections.ids() {
            // Written as lists in both networks, they are on equal cores.
            parts.projections[id].connectivity = sparse(synapses(&parts, &parts.projections[id]));
        }
        let network = Quantised::new(parts.clone()).unwrap();
        let sample = sample(&network, seed);
        let draw = &mut Draw::new(seed);
        let mut writes = vec![Vec::new(); sample.steps() as usize];
        let Some(first) = writes.first_mut() else { return false };
        *first = written(&network, draw, 100);
        for (id, weights) in first.iter() {
            let mut weights = weights.iter();
            let lists = synapses(&parts, &parts.projections[*id]);
            let with = |list: &Vec<(u32, i16)>| list.iter().map(|own| (own.0, *weights.next().unwrap())).collect();
            let lists: Vec<Vec<(u32, i16)>> = lists.iter().map(with).collect();
            parts.projections[*id].connectivity = sparse(lists);
        }
        let meant = Quantised::new(parts).unwrap();
        let none = vec![Vec::new(); writes.len()];
        let expected = on_golden(&meant, &sample, &none);
        let what = format!("network {seed}");
        let counts = assert_on_machine(&meant, &sample, &none, &expected, &format!("{what}, as meant"));
        assert_eq!(counts, assert_on_machine(&network, &sample, &writes, &expected, &what), "{what}");
        expected.totals.spikes > 0
    });
    assert!(compared.count() > 40);
}

/// Every rank receives all weights, and takes those of its synapses.
#[test]
fn written_weights_act_alike_on_any_number_of_ranks() {
    let events: u64 = (0..40u64)
        .into_par_iter()
        .map(|seed| {
            let network = plastic(seed);
            let sample = sample(&network, seed);
            let writes = schedule(&network, &sample, seed);
            let expected = on_golden(&network, &sample, &writes);
            for count in 2..=MOST_RANKS {
                let what = format!("network {seed} on {count} ranks");
                let sum = Mutex::new(Totals::default());
                on_ranks(count, |rank, ranks| {
                    let options = Options { share: share(rank, count, false), ..unsearched() };
                    let compiled = compile(network.clone(), &small_cores("oheo-gulch", 7), &options).unwrap();
                    let image = Image::new(&compiled.program, 1).unwrap();
                    let all = Some((CompartmentId(0), network.compartments()));
                    let settings = Settings { skip: seed % 2 == 0, per_step: false };
                    let mut machine = Machine::of_part(&image, settings, ranks.unwrap(), all);
                    machine.begin(sample.steps());
                    for (step, writes) in (0..).zip(&writes) {
                        for (id, weights) in writes {
                            machine.write_weights(rule_of(&network, *id), &wide(weights));
                        }
                        machine.step(sample.input(step));
                        let mut spikes: Vec<CompartmentId> = machine.spikes().to_vec();
                        spikes.sort_unstable();
                        let meant = expected.steps[step as usize].0.iter().map(|sent| sent.0);
                        assert!(meant.eq(spikes), "{what}: step {step} on rank {rank}");
                    }
                    machine.settle();
                    *sum.lock().unwrap() += machine.totals();
                });
                assert_eq!(sum.into_inner().unwrap(), expected.totals, "{what}");
            }
            expected.totals.synaptic_events
        })
        .sum();
    assert!(events > 10_000, "{events} events");
}

/// `in -> first` with a delay of 2 and `first -> second`, plastic, of weights 10.
pub fn chain() -> Builder {
    let mut net = Builder::new();
    let input = net.input("in", 1);
    let memoryless = |vth| [neuron(4096, 4096, vth, 1)];
    let first = net.each("first", Shape::Line(1), &memoryless(1), 0);
    let second = net.each("second", Shape::Line(1), &memoryless(1_000), 0);
    let ten = || Connectivity::Dense { targets: 1, weights: [10].into() };
    net.connect(input, first, format(SignMode::Mixed, 0), 2, ten());
    net.connect(first, second, format(SignMode::Mixed, 0), 0, ten());
    [IN, BETWEEN].into_iter().for_each(|id| _ = make_plastic(&mut net.parts, id, Rule::written()));
    net
}

pub const IN: ProjectionId = ProjectionId(0);
pub const BETWEEN: ProjectionId = ProjectionId(1);

pub fn session(network: &Quantised, copies: u32) -> Session {
    let options = Options { copies, ..Options::default() };
    let compiled = compile(network.clone(), &roomy("oheo-gulch"), &options).unwrap();
    Session::open(&Image::new(&compiled.program, 1).unwrap(), &compiled.one, copies)
}

/// Computed by hand: an input of step t is delivered in step t, a compartment's spike in step t +
/// 1. The weight of the step of delivery counts.
#[test]
fn a_weight_holds_from_the_next_delivery_on() {
    let network = chain().build();
    let mut session = session(&network, 1);
    let mut golden = Golden::new(&network);
    golden.begin(8);
    // The weight written before the step, whether the channel spikes, and u of both compartments.
    let steps = [
        (None, true, [0, 0]),
        (Some((IN, 20)), true, [0, 0]),
        (Some((IN, -6)), false, [640, 0]),
        (Some((BETWEEN, 30)), false, [1280, 1920]),
        (Some((BETWEEN, 0)), false, [0, 0]),
        (None, false, [0, 0]),
    ];
    for (step, (write, spikes, u)) in steps.into_iter().enumerate() {
        if let Some((id, weight)) = write {
            session.write_weights(rule_of(&network, id), &[weight.into()]).unwrap();
            golden.write_weights(id, &[weight]);
            assert_eq!(weights_of(session.engine(), rule_of(&network, id)), [i32::from(weight)]);
            assert_eq!(golden.weights(id), [weight]);
        }
        let channels: &[ChannelId] = if spikes { &[ChannelId(0)] } else { &[] };
        session.step(channels.iter().map(|&channel| (channel, 1))).unwrap();
        golden.step(Spikes { ids: channels, values: &[] });
        assert_eq!([0, 1].map(|id| session.engine().u(CompartmentId(id))), u, "step {step}");
        assert_eq!([0, 1].map(|id| golden.u(CompartmentId(id))), u, "step {step}, golden");
    }
}

/// A copy of a session has its own weights, `reset` undoes all writes, and every copy of the
/// network has equal weights.
#[test]
fn snapshots_carry_weights() {
    let (mut spikes, mut parted) = (0, 0);
    for seed in 0..40u64 {
        let network = plastic(seed);
        let sample = sample(&network, seed);
        let writes = schedule(&network, &sample, seed);
        let expected = on_golden(&network, &sample, &writes);
        let copies = 1 + seed as u32 % 3;
        let mut session = session(&network, copies);
        let all_weights =
            |session: &Session| network.parts().rules.ids().map(|rule| weights_of(session.engine(), rule)).collect();
        let write = |session: &mut Session, writes: &Writes| {
            let write = |(id, weights): &(ProjectionId, Vec<i16>)| {
                session.write_weights(rule_of(&network, *id), &wide(weights)).unwrap();
            };
            writes.iter().for_each(write);
        };
        let first: Vec<Vec<i32>> = all_weights(&session);
        let n = network.compartments();
        let step = |session: &mut Session, t: u32| {
            let input = sample.input(t);
            let values = input.values.iter().copied().chain(std::iter::repeat(1));
            session.step(input.ids.iter().copied().zip(values)).unwrap();
            (0..copies).map(|k| session.spikes(CompartmentId(k * n), n)).collect::<Vec<_>>()
        };
        let middle = sample.steps() / 2;
        for again in 0..2 {
            let mut middle_state = None;
            for (t, writes) in (0..).zip(&writes) {
                if t == middle {
                    middle_state = Some(session.clone());
                }
                write(&mut session, writes);
                let now = step(&mut session, t);
                assert!(now.iter().all(|of_copy| *of_copy == now[0]), "network {seed}, step {t}: copies");
                let meant: Vec<u32> = expected.steps[t as usize].0.iter().map(|sent| sent.0.0).collect();
                let found: Vec<u32> = now[0].iter().map(|sent| sent.0).collect();
                assert!(found == meant, "network {seed}, step {t}, run {again}");
                spikes += found.len();
            }
            let after: Vec<Vec<i32>> = all_weights(&session);
            if let Some(mut middle_state) = middle_state {
                parted += usize::from(all_weights(&middle_state) != after);
                for (t, writes) in (middle..).zip(&writes[middle as usize..]) {
                    write(&mut middle_state, writes);
                    let found: Vec<u32> = step(&mut middle_state, t)[0].iter().map(|sent| sent.0).collect();
                    let meant: Vec<u32> = expected.steps[t as usize].0.iter().map(|sent| sent.0.0).collect();
                    assert!(found == meant, "network {seed}, step {t} after going back");
                }
            }
            session.reset_all();
            assert!(all_weights(&session) == first, "network {seed}: weights after a reset");
        }
    }
    assert!(spikes > 1_000 && parted > 20, "{spikes} spikes, {parted} sessions part");
}

#[test]
fn what_cannot_be_written_is_refused_by_name() {
    let network = chain().build();
    let (mut session, rule) = (session(&network, 2), rule_of(&network, IN));
    let refused = session.rule_named("proj7").unwrap_err();
    assert_eq!(
        (refused.code, refused.help.as_deref()),
        ("session.rule", Some("projections that learn are: proj0, proj1"))
    );
    assert_eq!(session.rule_named("proj0").unwrap(), rule);
    assert_eq!(session.write_weights(rule, &[0, 2]).unwrap_err().code, "session.weights.size");
    for weight in [3, 256, -258] {
        let refused = session.write_weights(rule, &[weight]).unwrap_err();
        assert_eq!(refused.code, "session.weights.range");
        assert!(refused.message.contains("'proj0'") && refused.message.contains(&weight.to_string()));
        assert!(refused.help.unwrap().contains("multiples of 2 from -256 to 254"));
    }
    assert_eq!(weights_of(session.engine(), rule), [10]);
}

#[test]
fn what_does_not_support_plastic_projections_refuses_them_by_name() {
    let refused = |change: &dyn Fn(&mut Builder), what: &str| {
        let mut net = chain();
        change(&mut net);
        let error = Quantised::new(net.parts).unwrap_err().to_string();
        assert!(error.contains(what) && error.contains("projection in -> first"), "{error}");
    };
    refused(&|net| _ = net.parts.projections.push(net.parts.projections[IN].clone()), "give one another delay");
    let window = Window {
        source: (1, 1, 1),
        target: (1, 1, 1),
        kernel: (1, 1),
        stride: (1, 1),
        padding: (0, 0),
        dilation: (1, 1),
        groups: 1,
    };
    let volume = Shape::Volume(1, 1, 1);
    refused(
        &|net| {
            net.parts.populations.iter_mut().for_each(|population| population.shape = volume);
            net.parts.projections[IN].connectivity = Connectivity::Conv2d { window, kernel: [10].into() };
        },
        "list the synapses",
    );
    refused(
        &|net| {
            let sums = vec![dynamics::neuron(NeuronKind::Sigma, &[]).unwrap(); 1];
            let first = net.parts.projections[IN].target;
            if let Units::Compartments { neurons, .. } = &mut net.parts.populations[first].units {
                *neurons = PerCompartment::Each(sums);
            }
            net.parts.projections[IN].format.exponent = WeightExponent::new(-1).unwrap();
        },
        "lose bits",
    );
    let network = chain().build();
    let Err(CompileError::Input(problem)) = Front::from(network.clone()).prune(&Plan::fixed()) else {
        panic!("pruned");
    };
    assert_eq!(problem.code, "map.prune");
    assert!(problem.message.contains("in -> first") && problem.help.unwrap().contains("--prune"));
    assert!(relayed(&network, 4).is_ok(), "no compartment needs relays");
    let mut net = chain();
    let first = net.parts.projections[IN].target;
    let many = net.loihi("many", 9);
    net.dense(first, many, |_, _| 2);
    let problem = relayed(&net.build(), 4).unwrap_err();
    assert!(problem.code == "map.relays" && problem.message.contains("in -> first is plastic"), "{problem:?}");
}
