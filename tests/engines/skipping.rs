//! Skipping at run time changes nothing: recordings of a real sensor and hand-made networks, with
//! skipping and without, in 1, 2 and 8 shards and threads, against the interpreter. The number of
//! skipped steps is tested too.

use crate::common;
use std::collections::hash_map::DefaultHasher;
use std::hash::{Hash, Hasher};

use crate::common::compare::roomy;
use crate::common::{Builder, biased, neuron, random, sessions, unsearched};
use nsim::compile::{Mapping, Options, compile};
use nsim::files::target::load_target;
use nsim::golden::Golden;
use nsim::import::model::load_model;
use nsim::ir::activity::Activity;
use nsim::ir::arithmetic::{Semantics, ThresholdTest};
use nsim::ir::base::id::{ChannelId, CompartmentId};
use nsim::ir::graph::Shape;
use nsim::ir::quantised::{Population, Quantised};
use nsim::ir::resource::Resource;
use nsim::ir::spikes::{Engine, Sample};
use nsim::machine::{Image, Machine, Settings};
use nsim::session::front::front;
use nsim::session::neurobench::NeuroBench;
use nsim::session::observers::StepRange;
use nsim::session::priced::MeteredMapping;
use nsim::session::samples::{RunSettings, fast, golden as golden_run};
use nsim::session::timeline::Timeline;
use nsim::session::{Outcome, Probe, Quantity, SampleSettings, Session};
use nsim_testing::cases;
use rayon::prelude::*;

/// Output spikes, and u and v of every compartment.
fn keep(network: &Quantised) -> SampleSettings {
    let probe = |quantity| Probe { first: CompartmentId(0), count: network.compartments(), quantity };
    SampleSettings {
        probes: [Quantity::Spikes, Quantity::U, Quantity::Potential].map(probe).into(),
        ..SampleSettings::new(network.output())
    }
}

/// An outcome without the values that skipping may change, a hash of its traces, and the number of
/// skipped steps.
fn essence(outcome: Outcome) -> (Outcome, u64, u64) {
    let mut hasher = DefaultHasher::new();
    outcome.probes.hash(&mut hasher);
    let skipped = outcome.skipped_steps;
    (Outcome { probes: Vec::new(), skipped_steps: 0, ..outcome }, hasher.finish(), skipped)
}

/// A model on cores of at most five compartments, so that there are several shards.
fn on_small_cores(model: &str) -> Mapping {
    let chip = load_target("loihi1-chip").unwrap();
    let mut limits = chip.limits().clone();
    limits[Resource::Compartments] = 5;
    compile(front(&load_model(model).unwrap()).unwrap(), &chip.with_limits(limits), &Options::default()).unwrap()
}

/// The interpreter's outcome of a sample, and the number of steps that could be skipped: no input,
/// no spike in the previous step, every register zero.
fn interpreted(network: &Quantised, sample: &Sample, keep: &SampleSettings) -> (Outcome, u64, u64) {
    let (mut idle, mut at_rest) = (0, true);
    let outcome = Session::new(Golden::new(network), 1).run(sample, keep, |engine: &Golden, passed: StepRange| {
        idle += u64::from(at_rest && sample.at(passed.first).is_empty());
        let zero = (0..network.compartments()).map(CompartmentId).all(|c| engine.u(c) == 0 && engine.v(c) == 0);
        at_rest = engine.spikes().is_empty() && zero;
    });
    let (outcome, traces, _) = essence(outcome);
    (outcome, traces, idle)
}

/// Runs the samples with every setting and compares. Returns the numbers of steps without input, of
/// skipped steps and of all steps.
fn compare(model: &str, samples: &[Sample]) -> (u64, u64, u64) {
    let compiled = on_small_cores(model);
    assert!(compiled.program.cores().len() > 8, "one core or more for each of eight shares");
    let (network, keep) = (&compiled.quantised, keep(&compiled.quantised));
    let golden: Vec<(Outcome, u64, u64)> =
        samples.par_iter().map(|sample| interpreted(network, sample, &keep)).collect();
    let mut activity: Option<Vec<Activity>> = None;
    for (shards, skip) in [1, 2, 8].into_iter().flat_map(|shards| [(shards, true), (shards, false)]) {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(shards).build().unwrap();
        let run = |samples: &[Sample]| -> Vec<_> {
            let image = Image::new(&compiled.program, shards).unwrap();
            let mut session = Session::new(Machine::new(&image, Settings { skip, per_step: false }), 1);
            let one = |sample| {
                let outcome = session.run(sample, &keep, ());
                let skipped = session.engine().skipped_updates();
                (essence(outcome), session.engine_mut().take_activity(), skipped)
            };
            samples.iter().map(one).collect()
        };
        let fast: Vec<_> = pool.install(|| run(samples));
        for (index, (((outcome, traces, skipped), _, updates), golden)) in fast.iter().zip(&golden).enumerate() {
            let what = format!("{model}, sample {index}, {shards} shares, skip {skip}");
            assert_eq!((outcome, traces), (&golden.0, &golden.1), "{what}");
            assert_eq!(*skipped, if skip { golden.2 } else { 0 }, "{what}: steps skipped");
            let least = skipped * u64::from(network.compartments());
            assert!(if skip { *updates >= least } else { *updates == 0 }, "{what}: {updates} updates skipped");
        }
        // Core by core: messages, events of both kinds, updates, spikes; and hops of each kind.
        let of_cores: Vec<Activity> = fast.into_iter().map(|(_, activity, _)| activity).collect();
        assert!(of_cores.iter().all(|activity| activity.messages() > 0 && activity.hops().total_links() > 0));
        assert_eq!(
            activity.get_or_insert_with(|| of_cores.clone()),
            &of_cores,
            "{model}, {shards} shares, skip {skip}"
        );
    }
    let steps = samples.iter().map(|sample| u64::from(sample.steps())).sum();
    let silent = |sample: &Sample| (0..sample.steps()).filter(|&step| sample.at(step).is_empty()).count() as u64;
    let spikes: u64 = golden.iter().map(|(outcome, ..)| outcome.totals.spikes).sum();
    assert!(spikes > 0, "{model} never spikes");
    (samples.iter().map(silent).sum(), golden.iter().map(|(_, _, idle)| idle).sum(), steps)
}

/// Every quantity of every population, in its order; the last is the potential.
fn all_quantities(network: &Quantised) -> Vec<Probe> {
    let of_population = |population: &Population| {
        let words = population.neuron_kind().map_or(&[][..], |kind| kind.table().state);
        let names = Quantity::ALL.iter().map(|(_, name)| *name).chain(words.iter().map(|word| word.name));
        let named: Vec<Probe> = names.filter_map(|name| Probe::named(population, name)).collect();
        named.into_iter().chain(Probe::of_potential(population))
    };
    network.populations().iter().flat_map(of_population).collect()
}

/// Probes, traces of plots and pages, and NeuroBench's metrics of mixed kinds, with silence in and
/// after their input: those of the interpreter. A word of state lasts while the network is idle.
#[test]
fn every_quantity_is_the_interpreters_through_silence() {
    let target = roomy("oheo-gulch");
    let networks = cases(2_000);
    let compare = |seed: u64| {
        let network = random::mixed(seed);
        let sample = random::valued(&network, seed, 30);
        let mapping = compile(network.clone(), &target, &unsearched()).unwrap();
        let settings = SampleSettings { probes: all_quantities(&network), ..SampleSettings::new(network.output()) };
        let golden = Session::new(Golden::new(&network), 1).run(&sample, &settings, ());
        let metered = MeteredMapping::new(&mapping);
        let run = fast(&mapping.program, &[&sample], RunSettings::new(&settings), || ()).unwrap();
        let skipped = run.outcomes[0].skipped_steps;
        assert_eq!(Outcome { skipped_steps: 0, ..run.outcomes[0].clone() }, golden, "network {seed}");

        let everyone: Vec<CompartmentId> = (0..network.compartments()).map(CompartmentId).collect();
        let prices = metered.offline(&target).unwrap().0;
        let traced = (everyone.as_slice(), Quantity::Potential);
        let traces = Timeline::new(&metered, &network, prices, &sample, traced).unwrap().traces;
        let mut lasting = 0;
        for (probe, values) in settings.probes.iter().zip(&golden.probes) {
            let steps = sample.steps() as usize;
            for (unit, values) in values.chunks(steps).enumerate() {
                let id = probe.first.0 as usize + unit;
                assert!(probe.quantity != Quantity::Potential || traces[id] == values, "network {seed}, {id}");
                let is_word = matches!(probe.quantity, Quantity::State(_));
                lasting += u64::from(is_word && skipped > 0 && values[steps - 1] != 0);
            }
        }
        let on_golden =
            |samples: &[&Sample], settings: &SampleSettings| Ok(golden_run(&network, samples, settings, &|| ()));
        let on_machine = |samples: &[&Sample], settings: &SampleSettings| {
            fast(&mapping.program, samples, RunSettings::new(settings), || ())
        };
        let metrics = NeuroBench::measure(&network, &[&sample], on_golden).unwrap();
        assert_eq!(NeuroBench::measure(&network, &[&sample], on_machine).unwrap(), metrics, "network {seed}");
        lasting
    };
    let lasting: Vec<u64> = (0..networks).into_par_iter().map(compare).collect();
    let with_lasting = lasting.iter().filter(|&&words| words > 0).count() as u64;
    // 98 of 2,000 do.
    assert!(25 * with_lasting > networks, "{with_lasting} networks end in silence with words other than 0");
}

/// A network whose compartments keep no state between steps, so that every silent step can be
/// skipped.
const FORGETFUL: &str = r#"Network(name: "forgetful", timestep_ms: 20.0, populations: [
    Input(name: "tactile", shape: [78]),
    Loihi(name: "hidden", shape: [32], du: 4096, dv: 4096, vth_mant: 20),
    Loihi(name: "out", shape: [20], du: 4096, dv: 4096, vth_mant: 20),
], projections: [
    Dense(from: ["tactile"], to: "hidden", weights: Uniform(low: -14, high: 14, step: 2, seed: 1)),
    Dense(from: ["hidden"], to: "out", weights: Uniform(low: -60, high: 60, step: 2, seed: 2)),
], output: "out")"#;

#[test]
fn recordings_are_the_same_with_and_without_skipping() {
    let Some(data) = common::data("ev-containers") else { return };
    let samples = common::recordings(&data, &["train", "test"]);
    assert_eq!(samples.len(), 300);
    let folder = tempfile::tempdir().unwrap();
    let forgetful = folder.path().join("forgetful.ron");
    std::fs::write(&forgetful, FORGETFUL).unwrap();
    for model in ["container-tactile", forgetful.to_str().unwrap()] {
        let (silent, skipped, steps) = compare(model, &samples);
        let share = |part: u64| 100.0 * part as f64 / steps as f64;
        println!("{model}: {:.2} % of {steps} steps without input, {:.2} % skipped", share(silent), share(skipped));
        // This figure is from the description of the recordings.
        assert!((share(silent) - 32.5).abs() < 0.05, "{silent} of {steps} steps have no input");
        assert!(skipped > 0 && skipped <= silent);
    }
}

/// Runs a sample on every engine; returns the common outcome and the number of skipped steps.
fn agreed(network: &Quantised, sample: &Sample) -> (Outcome, u64) {
    let keep = keep(network);
    let mut agreed: Option<(Outcome, u64)> = None;
    let mut skipped_steps = 0;
    for (name, mut engine) in sessions(network) {
        let (outcome, traces, skipped) = essence(engine.run(sample, &keep, ()));
        let expected = agreed.get_or_insert_with(|| (outcome.clone(), traces));
        assert_eq!((&outcome, traces), (&expected.0, expected.1), "{name}");
        match name {
            "fast" => skipped_steps = skipped,
            _ => assert_eq!(skipped, 0, "{name}"),
        }
    }
    (agreed.unwrap().0, skipped_steps)
}

fn spikes_at(steps: u32, at: &[u32]) -> Sample {
    Sample::new(steps, &at.iter().map(|&step| (step, ChannelId(0))).collect::<Vec<_>>(), None).unwrap()
}

/// One channel to one compartment, by a weight of 8 over this delay. Thresholds are out of reach
/// unless given.
fn one(neuron: nsim::ir::quantised::Neuron, start_step: u32, delay: i64) -> Builder {
    let mut net = Builder::new();
    let input = net.input("input", 1);
    let out = net.each("out", Shape::Line(1), &[neuron], start_step);
    net.matrix(input, out, delay, &[8]);
    net
}

#[test]
fn a_silent_network_is_skipped_whole() {
    let network = one(neuron(1024, 128, 80, 1), 0, 0).build();
    let (outcome, skipped) = agreed(&network, &spikes_at(1000, &[]));
    assert_eq!((skipped, outcome.totals.compartment_updates, outcome.totals.active_updates), (1000, 1000, 0));
    // Steps are skipped until the first spike, and again once it is forgotten: step 501 still has
    // the state of step 500.
    let network = one(neuron(4096, 4096, 80, 1), 0, 0).build();
    assert_eq!(agreed(&network, &spikes_at(1000, &[500])).1, 500 + 498);
}

#[test]
fn slow_decays_rest_when_the_integers_have_reached_zero() {
    // u(0) = 512 loses an eighth each step, toward zero, and v follows; the step after both are
    // zero is skipped.
    let network = one(neuron(512, 2048, 80, 1), 0, 0).build();
    let (mut u, mut v, mut steps) = (512i64, 512i64, 1);
    while u != 0 || v != 0 {
        u = u * (4096 - 512) / 4096;
        v = v * (4096 - 2048) / 4096 + u;
        steps += 1;
    }
    assert_eq!(agreed(&network, &spikes_at(200, &[0])).1, 200 - steps);
    // A current that never decays is never idle.
    assert_eq!(agreed(&one(neuron(0, 4096, 80, 1), 0, 0).build(), &spikes_at(200, &[0])).1, 0);
}

#[test]
fn a_bias_is_never_skipped_but_where_there_is_none() {
    let with_bias = |semantics| {
        let mut net = one(biased(neuron(4096, 4096, 80, 1), 1, 0), 0, 0);
        net.parts.semantics = semantics;
        agreed(&net.build(), &spikes_at(100, &[]))
    };
    for semantics in [Semantics::Hardware, Semantics::Lava] {
        let (outcome, skipped) = with_bias(semantics);
        assert_eq!((skipped, outcome.totals.active_updates), (0, 100), "{semantics:?}");
    }
    assert_eq!(with_bias(Semantics::Slayer).1, 100);
}

#[test]
fn a_spike_in_flight_is_waited_for() {
    // The spike enters in step 0, arrives in step 10, and is forgotten in step 11.
    let network = one(neuron(4096, 4096, 80, 1), 0, 10).build();
    let (outcome, skipped) = agreed(&network, &spikes_at(50, &[0]));
    assert_eq!((skipped, outcome.totals.synaptic_events), (50 - 12, 1));
    // A spike that would arrive after the end is not awaited: only its own step is computed.
    let (outcome, skipped) = agreed(&one(neuron(4096, 4096, 80, 1), 0, 62).build(), &spikes_at(50, &[3]));
    assert_eq!((skipped, outcome.totals.synaptic_events), (50 - 1, 0));
    // Between compartments: a spike in step 0 arrives in step 6 and is forgotten in step 7.
    let mut net = Builder::new();
    let input = net.input("input", 1);
    let first = net.each("first", Shape::Line(1), &[neuron(4096, 4096, 5, 1)], 0);
    let second = net.each("second", Shape::Line(1), &[neuron(4096, 4096, 5, 1)], 0);
    net.matrix(input, first, 0, &[8]);
    net.matrix(first, second, 5, &[8]);
    let (outcome, skipped) = agreed(&net.build(), &spikes_at(40, &[0]));
    assert_eq!((skipped, outcome.spikes), (40 - 8, vec![(6, 0)]));
}

#[test]
fn a_refractory_period_is_no_rest() {
    // It spikes in step 2 and is free again in step 12: steps 0, 1 and 12 on are idle. A counter
    // that expires in the update of step 12 may occupy that step too.
    let (outcome, skipped) = agreed(&one(neuron(4096, 4096, 5, 10), 0, 0).build(), &spikes_at(50, &[2]));
    assert_eq!(outcome.counts[0], 1);
    assert!((2 + 37..=2 + 38).contains(&skipped), "{skipped}");
    // Arrivals within the period change only u.
    let (outcome, _) = agreed(&one(neuron(4096, 4096, 5, 10), 0, 0).build(), &spikes_at(50, &[2, 11, 12]));
    assert_eq!(outcome.spikes, [(2, 0), (12, 0)]);
    // SLAYER's period of 0 never ends.
    let mut net = one(neuron(4096, 4096, 5, 0), 0, 0);
    net.parts.semantics = Semantics::Slayer;
    let (outcome, skipped) = agreed(&net.build(), &spikes_at(50, &[2, 30]));
    assert_eq!((outcome.counts[0], skipped), (1, 2));
}

#[test]
fn a_reset_brings_rest_and_comes_in_time_after_it() {
    // Nothing decays, so only the resets before steps 10, 20, .. make it idle.
    let mut net = one(neuron(0, 0, 100_000, 1), 0, 0);
    net.reset(10, 0);
    let network = net.build();
    // Not idle from step 3 to step 10, whose update finds zero; again from 27 to 30.
    let (_, skipped) = agreed(&network, &spikes_at(100, &[3, 27]));
    assert_eq!(skipped, 3 + (27 - 11) + (100 - 31));
    // A reset in the step of an arrival, after a long idle time: the arrival of step 50 counts from
    // zero.
    let (outcome, skipped) = agreed(&network, &spikes_at(60, &[50]));
    assert_eq!((skipped, outcome.totals.active_updates), (50, 10));
}

#[test]
fn before_its_start_a_population_rests_whatever_arrives() {
    let (outcome, skipped) = agreed(&one(neuron(0, 0, 5, 1), 20, 0).build(), &spikes_at(40, &[4, 19]));
    assert_eq!((outcome.totals.spikes, skipped), (0, 40 - 2));
    let (outcome, skipped) = agreed(&one(neuron(4096, 4096, 5, 1), 20, 0).build(), &spikes_at(40, &[4, 20]));
    assert_eq!((outcome.spikes, skipped), (vec![(20, 0)], 40 - 3));
    // A bias is held back until the start step.
    let (outcome, _) = agreed(&one(biased(neuron(4096, 4096, 0, 1), 1, 0), 20, 0).build(), &spikes_at(40, &[]));
    assert_eq!(outcome.totals.spikes, 20);
}

#[test]
fn a_threshold_of_zero_that_may_be_met_spikes_at_rest() {
    let at_zero = |test, refractory| {
        let mut net = one(neuron(4096, 4096, 0, refractory), 0, 0);
        net.parts.threshold = test;
        agreed(&net.build(), &spikes_at(30, &[]))
    };
    let (outcome, skipped) = at_zero(ThresholdTest::Inclusive, 1);
    assert_eq!((outcome.counts[0], skipped), (30, 0));
    let (outcome, skipped) = at_zero(ThresholdTest::Inclusive, 7);
    assert_eq!((outcome.counts[0], skipped), (5, 0));
    let (outcome, skipped) = at_zero(ThresholdTest::Strict, 1);
    assert_eq!((outcome.counts[0], skipped), (0, 30));
}
