//! Rules that change weights at the end of each epoch. Both engines agree, in parts and ranks, with
//! skipping and without, also with written weights; rules that cannot act are refused.

use std::iter::repeat;
use std::sync::Arc;

use crate::common::compare::small_cores;
use crate::common::random::Draw;
use crate::common::unsearched;
use crate::plastic::{BETWEEN, IN, MOST_RANKS, Writes, chain, plastic, sample, schedule, session, trace, write};
use crate::ranks::{on_ranks, share};
use nsim::compile::{Options, compile};
use nsim::golden::Golden;
use nsim::ir::base::id::{ChannelId, CompartmentId, ProjectionId};
use nsim::ir::learning::LearningRule;
use nsim::ir::quantised::Quantised;
use nsim::ir::spikes::{Engine, Sample, Spikes};
use nsim::machine::plastic::places::PlasticProjection;
use nsim::machine::{Image, Machine, Settings};
use nsim::session::Session;
use rayon::prelude::*;

const NETWORKS: u64 = 200;

/// Adds `by` in an epoch in which the source is noted, and subtracts it if the target is. All
/// weights decay.
#[derive(Debug)]
struct Counter {
    epoch: u32,
    by: i16,
    decay: i16,
}

impl LearningRule for Counter {
    fn epoch(&self) -> u32 {
        self.epoch
    }

    fn learn(&self, weight: i16, pre: bool, post: bool) -> i16 {
        weight + self.by * (i16::from(pre) - i16::from(post)) - self.decay * weight.signum()
    }
}

/// A network, its sample, the written weights, and its rule.
struct Case {
    network: Quantised,
    sample: Sample,
    writes: Vec<Writes>,
    rule: Arc<dyn LearningRule>,
}

impl Case {
    fn new(seed: u64) -> Case {
        let (network, draw) = (plastic(seed), &mut Draw::new(seed ^ 0x1ea2));
        let sample = sample(&network, seed);
        let none = || (0..sample.steps()).map(|_| Writes::new()).collect();
        let writes = if draw.chance(50) { schedule(&network, &sample, seed) } else { none() };
        let (epoch, by) = (draw.one_of(&[1, 2, 3, 7, 20]), draw.one_of(&[1, -9, 16, 150]));
        let rule = Arc::new(Counter { epoch, by, decay: draw.one_of(&[0, 0, 4]) });
        Case { network, sample, writes, rule }
    }

    fn shown(&self) -> (&Quantised, &Sample) {
        (&self.network, &self.sample)
    }
}

/// Asserts that the weights of a machine's local synapses equal the interpreter's.
fn assert_weights(projections: &[PlasticProjection], machine: &Machine, golden: &Golden, what: &str) {
    for PlasticProjection { id, name, places, .. } in projections {
        let mut held = places[0].iter().zip(golden.weights(*id)).filter(|(place, _)| place.is_some());
        assert!(held.all(|(&place, &weight)| machine.weight(place) == weight), "{what}: weights of {name}");
    }
}

#[test]
fn learned_weights_act_alike_in_both_engines() {
    let tried: Vec<(u64, bool)> = (0..NETWORKS)
        .into_par_iter()
        .map(|seed| {
            let case = Case::new(seed);
            let Case { network, writes, rule, .. } = &case;
            let mut golden = Golden::new(network);
            let unlearned = trace(&mut golden, case.shown(), writes, Golden::write_weights);
            golden.set_rule(rule.clone());
            let expected = trace(&mut golden, case.shown(), writes, Golden::write_weights);
            let options = unsearched();
            let compiled = compile(network.clone(), &small_cores("oheo-gulch", 7), &options).unwrap();
            for shards in [1, 2, 8] {
                let image = Image::new(&compiled.program, shards).unwrap();
                let projections = PlasticProjection::all(&image, network, 1);
                for skip in [true, false] {
                    let what = format!("network {seed}, {shards} shards, skip {skip}");
                    let mut machine = Machine::new(&image, Settings { skip, per_step: false });
                    machine.set_rule(rule.clone());
                    let write = |machine: &mut Machine, id, weights: &[i16]| write(&projections, machine, id, weights);
                    // The second sample begins with the network's own weights, and no notes.
                    for _ in 0..2 {
                        expected.assert_same(&trace(&mut machine, case.shown(), writes, write), &what);
                        assert_weights(&projections, &machine, &golden, &what);
                    }
                }
            }
            (expected.totals.spikes, expected != unlearned)
        })
        .collect();
    let (spikes, differing) = (tried.iter().map(|tried| tried.0).sum::<u64>(), tried.iter().filter(|tried| tried.1));
    let differing = differing.count();
    assert!(spikes > 10_000 && differing > 80, "{spikes} spikes, {differing} networks that the rule changes");
}

/// Every rank notes the spikes of other ranks that its synapses receive.
#[test]
fn ranks_learn_the_same() {
    let spikes: u64 = (0..40u64)
        .into_par_iter()
        .map(|seed| {
            let case = Case::new(seed);
            let Case { network, sample, writes, rule } = &case;
            let mut golden = Golden::new(network);
            golden.set_rule(rule.clone());
            let expected = trace(&mut golden, case.shown(), writes, Golden::write_weights);
            for count in 2..=MOST_RANKS {
                on_ranks(count, |rank, ranks| {
                    let what = format!("network {seed}, rank {rank} of {count}");
                    let options = Options { share: share(rank, count, false), ..unsearched() };
                    let compiled = compile(network.clone(), &small_cores("oheo-gulch", 7), &options).unwrap();
                    let image = Image::new(&compiled.program, 1).unwrap();
                    let projections = PlasticProjection::all(&image, network, 1);
                    let all = (!seed.is_multiple_of(3)).then_some((CompartmentId(0), network.compartments()));
                    let mut machine = Machine::of_part(&image, Settings::default(), ranks.unwrap(), all);
                    machine.set_rule(rule.clone());
                    machine.begin(sample.steps());
                    for (step, writes) in (0..).zip(writes) {
                        writes.iter().for_each(|(id, weights)| write(&projections, &mut machine, *id, weights));
                        if !sample.at(step).is_empty() || !machine.skip_idle(1) {
                            machine.step(sample.input(step));
                        }
                    }
                    machine.settle();
                    assert_weights(&projections, &machine, &golden, &what);
                });
            }
            expected.totals.spikes
        })
        .sum();
    assert!(spikes > 2_000, "{spikes} spikes");
}

/// Computed by hand, in epochs of two steps from step 1 on. Inputs count in their own step, spikes
/// in the next.
#[test]
fn an_epoch_changes_weights_by_what_it_delivered() {
    let network = chain().build();
    let rule = Arc::new(Counter { epoch: 2, by: 4, decay: 0 });
    let (mut session, mut golden) = (session(&network, 1), Golden::new(&network));
    session.set_rule(rule.clone()).unwrap();
    golden.set_rule(rule);
    golden.begin(8);
    // Whether the channel spikes, u of both compartments, and both weights after the step. The
    // first compartment spikes in steps 2 and 4.
    let steps = [
        (true, [0, 0], [10, 10]),
        (false, [0, 0], [10, 10]),
        (true, [640, 0], [14, 10]),
        (false, [0, 640], [14, 10]),
        (false, [640, 0], [10, 14]),
        (false, [0, 896], [10, 14]),
        (false, [0, 0], [6, 18]),
    ];
    for (step, (spikes, u, weights)) in steps.into_iter().enumerate() {
        let channels: &[ChannelId] = if spikes { &[ChannelId(0)] } else { &[] };
        session.step(channels.iter().map(|&channel| (channel, 1))).unwrap();
        golden.step(Spikes { ids: channels, values: &[] });
        assert_eq!([0, 1].map(|id| session.engine().u(CompartmentId(id))), u, "step {step}");
        assert_eq!([IN, BETWEEN].map(|id| session.weights(id).unwrap()), weights.map(|weight| [weight]), "step {step}");
        assert_eq!([IN, BETWEEN].map(|id| golden.weights(id)[0]), weights, "step {step}, golden");
    }
}

/// Spikes and plastic weights after each step.
type Seen = Vec<(Vec<u32>, Vec<Vec<i16>>)>;

/// A copy of a session within an epoch continues as the session does, and skipping keeps the notes.
#[test]
fn copies_and_skips_keep_what_an_epoch_noted() {
    let mut skipped = 0;
    for seed in 0..60u64 {
        let Case { network, sample, rule, .. } = &Case::new(seed);
        let ids: Vec<ProjectionId> = network.plastic().map(|(id, _)| id).collect();
        let mut session = session(network, 1 + seed as u32 % 2);
        if ids.is_empty() {
            assert_eq!(session.set_rule(rule.clone()).unwrap_err().code, "session.rule.not-plastic");
            continue;
        }
        session.set_rule(rule.clone()).unwrap();
        let mut golden = Golden::new(network);
        golden.set_rule(rule.clone());
        golden.begin(u32::MAX);
        let mut run = |session: &mut Session, steps: std::ops::Range<u32>| -> Seen {
            let step = |step| {
                let input = sample.input(step);
                let given = input.ids.iter().copied().zip(input.values.iter().copied().chain(repeat(1)));
                if input.ids.is_empty() && session.skip(1) {
                    skipped += 1;
                } else {
                    session.step(given).unwrap();
                }
                let spikes = session.spikes(CompartmentId(0), network.compartments());
                let weights = ids.iter().map(|&id| session.weights(id).unwrap()).collect();
                (spikes.into_iter().map(|(spike, _)| spike).collect(), weights)
            };
            steps.map(step).collect()
        };
        let meant = (0..sample.steps()).map(|step| {
            golden.step(sample.input(step));
            let spikes = golden.spikes().iter().map(|spike| spike.0).collect();
            (spikes, ids.iter().map(|&id| golden.weights(id).to_vec()).collect())
        });
        let meant: Seen = meant.collect();
        let middle = sample.steps() / 2;
        let first = run(&mut session, 0..middle);
        let mut copy = session.clone();
        let second = run(&mut session, middle..sample.steps());
        assert!(second == run(&mut copy, middle..sample.steps()), "network {seed}: a copy");
        assert!([first, second].concat() == meant, "network {seed}");
    }
    assert!(skipped > 10, "{skipped} steps skipped");
}

/// Skipped steps end their current epoch and the later ones that they contain.
#[test]
fn epochs_end_in_skipped_steps() {
    let network = chain().build();
    let rule = Arc::new(Counter { epoch: 7, by: 16, decay: 2 });
    for skipped in 1..40 {
        let (mut session, mut golden) = (session(&network, 1), Golden::new(&network));
        session.set_rule(rule.clone()).unwrap();
        golden.set_rule(rule.clone());
        golden.begin(u32::MAX);
        for step in 0u32..30 {
            // It has been idle since step 12, with notes of the epoch that ends with step 14.
            if step == 12 && session.skip(skipped) {
                (0..skipped).for_each(|_| golden.step(Spikes::default()));
            } else {
                let shown = if step.is_multiple_of(7) { &[ChannelId(0)][..] } else { &[] };
                session.step(shown.iter().map(|&channel| (channel, 1))).unwrap();
                golden.step(Spikes { ids: shown, values: &[] });
            }
            for id in [IN, BETWEEN] {
                assert_eq!(session.weights(id).unwrap(), golden.weights(id), "step {step}, {skipped} skipped");
            }
        }
        assert_eq!(session.steps(), 29 + skipped);
    }
}

#[test]
fn rules_that_cannot_act_are_refused_by_name() {
    let rule = |epoch| Arc::new(Counter { epoch, by: 1, decay: 0 });
    let mut learning = session(&chain().build(), 1);
    for epoch in [0, 64] {
        let refused = learning.set_rule(rule(epoch)).unwrap_err();
        assert!(refused.code == "session.rule.epoch" && refused.message.contains(&format!("{epoch} steps")));
        assert!(refused.help.unwrap().contains("1 to 63"));
    }
    learning.set_rule(rule(63)).unwrap();
    // The recorded input is no sample that could be run again without the rule.
    learning.reset();
    assert_eq!(learning.sample().unwrap_err().code, "session.weights.written");
    let mut net = chain();
    net.parts.projections.iter_mut().for_each(|projection| projection.format.plastic = false);
    let refused = session(&net.build(), 1).set_rule(rule(1)).unwrap_err();
    assert!(refused.code == "session.rule.not-plastic" && refused.help.unwrap().contains("format.plastic"));
}
