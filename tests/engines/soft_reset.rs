//! Reset by subtraction: every engine computes the same, bounds hold, and only targets that say so
//! have it.

use crate::common::random;
use nsim::agree::causes::Rung;
use nsim::agree::ladder::Ladder;
use nsim::compile::{Options, compile};
use nsim::files::target::load_target;
use nsim::golden::Golden;
use nsim::ir::arithmetic::Semantics;
use nsim::ir::base::id::CompartmentId;
use nsim::ir::graph::Graph;
use nsim::ir::hardware::Target;
use nsim::ir::neurons::NeuronKind;
use nsim::ir::quantised::{Neuron, Quantised, Units};
use nsim::ir::resource::Resource;
use nsim::ir::spikes::{Engine, Sample};
use nsim::machine::{Image, Machine, Settings};
use nsim::quantise::analytic;
use nsim::quantise::prune::{Plan, prune};
use nsim::quantise::quantise::quantise;
use nsim::reference::{Model, Options as RealOptions, Reference};

/// The network in the chip's arithmetic, its compartments of this kind.
fn with_kind(network: &Quantised, kind: NeuronKind) -> Quantised {
    let mut parts = network.parts().clone();
    parts.semantics = Semantics::Hardware;
    for population in parts.populations.iter_mut() {
        if let Units::Compartments { neurons, .. } = &mut population.units {
            let refractory = nsim::ir::base::fixed::Refractory::new(1).unwrap();
            let neuron = |_, neuron| Ok::<_, ()>(Neuron { kind, refractory, ..neuron });
            *neurons = neurons.try_map(neuron).unwrap();
        }
    }
    Quantised::new(parts).unwrap()
}

/// A chip that has them, with room for random parameters.
fn chip() -> Target {
    let chip = load_target("loihi1-chip").unwrap();
    let mut limits = chip.limits().clone();
    (limits[Resource::CompartmentProfiles], limits[Resource::ThresholdProfiles], limits[Resource::Accumulators]) =
        (1024, 1024, 1 << 16);
    limits[Resource::SynapseFormats] = 64;
    let mut kinds = chip.chip().clone();
    kinds.neuron_kinds.push(NeuronKind::SoftReset);
    chip.with_chip(kinds).with_limits(limits)
}

/// Spikes and registers of every step, then the counts.
fn trace(engine: &mut dyn Engine, compartments: u32, sample: &Sample) -> String {
    engine.begin(sample.steps());
    let mut trace = String::new();
    for step in 0..sample.steps() {
        engine.step(sample.input(step));
        let registers = |c| [engine.u(c), engine.v(c), engine.v_register(c)];
        let all: Vec<[i32; 3]> = (0..compartments).map(CompartmentId).map(registers).collect();
        trace += &format!("{:?} {all:?}\n", engine.ascending_spikes());
    }
    trace + &format!("{:?} {:?}", engine.totals(), engine.overflow())
}

#[test]
fn the_machine_and_golden_agree_in_every_bit() {
    let chip = chip();
    let (mut spikes, mut hard_spikes) = (0, 0);
    for seed in 0..60 {
        let drawn = random::network(seed);
        let sample = random::sample(&drawn, seed);
        let soft = with_kind(&drawn, NeuronKind::SoftReset);
        let n = soft.compartments();
        let mut golden = Golden::new(&soft);
        let expected = trace(&mut golden, n, &sample);
        spikes += golden.totals().spikes;
        let mut hard = Golden::new(&with_kind(&drawn, NeuronKind::Loihi));
        trace(&mut hard, n, &sample);
        hard_spikes += hard.totals().spikes;
        let compiled = compile(soft, &chip, &Options::default()).unwrap();
        for shares in [1, 2, 8] {
            let image = Image::new(&compiled.program, shares).unwrap();
            for skip in [true, false] {
                let mut machine = Machine::new(&image, Settings { skip, per_step: false });
                let fast = trace(&mut machine, n, &sample);
                assert_eq!(fast, expected, "network {seed}, {shares} shards, skip {skip}");
            }
        }
    }
    assert!(spikes > hard_spikes && hard_spikes > 1000, "{spikes} {hard_spikes}");
}

/// How many of the output's compartments spiked.
fn of_output(network: &Quantised, engine: &Golden) -> usize {
    let output = &network.populations()[network.parts().output];
    let first = output.first_compartment().unwrap().0;
    engine.spikes().iter().filter(|c| (first..first + output.shape.len()).contains(&c.0)).count()
}

#[test]
fn what_is_pruned_never_reached_the_output() {
    let mut removed = 0;
    for seed in 100..160 {
        let soft = with_kind(&random::network(seed), NeuronKind::SoftReset);
        let sample = random::sample(&soft, seed);
        let pruned = prune(&soft, &Plan::fixed()).unwrap();
        removed += soft.compartments() - pruned.compartments();
        let (mut whole, mut rest) = (Golden::new(&soft), Golden::new(&pruned));
        whole.begin(sample.steps());
        rest.begin(sample.steps());
        for step in 0..sample.steps() {
            whole.step(sample.input(step));
            rest.step(sample.input(step));
            // Elsewhere what leads nowhere is removed too.
            assert_eq!(of_output(&soft, &whole), of_output(&pruned, &rest), "network {seed}, step {step}");
        }
    }
    assert!(removed > 0);
}

fn read(populations: &str) -> Graph {
    let text = format!(
        "Network(name: \"n\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [4]), {populations}], \
         projections: [Dense(from: [\"in\"], to: \"hidden\", weights: [[20, 6, 4, 0], [30, 8, 40, 2], [2, 4, 6, 8]]), \
         Dense(from: [\"hidden\"], to: \"out\", weights: [[8, 20, 2], [6, 4, 2]])], output: \"out\")"
    );
    nsim_testing::graph(text)
}

fn integrators(kind: &str) -> Graph {
    read(&format!(
        "{kind}(name: \"hidden\", shape: [3], du: 4096, dv: 0, vth_mant: [10, 12, 14]), \
         {kind}(name: \"out\", shape: [2], du: 4096, dv: 0, vth_mant: 12)"
    ))
}

#[test]
fn integrators_lose_nothing_and_equal_the_real_ones() {
    let graph = integrators("SoftReset");
    let network = quantise(&graph).unwrap();
    let sample = random::sample(&network, 3);
    let (mut golden, model) = (Golden::new(&network), Model::<f64>::new(&graph, RealOptions::default()).unwrap());
    let mut real = Reference::new(&model);
    golden.begin(sample.steps());
    real.begin(sample.steps());
    let weights = [[20, 30, 2], [6, 8, 4], [4, 40, 6], [0, 2, 8]];
    let (mut arrived, mut spiked) = ([0i64; 3], [0i64; 3]);
    for step in 0..sample.steps() {
        golden.step(sample.input(step));
        real.step(sample.input(step));
        assert_eq!(golden.ascending_spikes(), real.ascending_spikes(), "step {step}");
        for channel in sample.at(step) {
            (0..3).for_each(|i| arrived[i] += 64 * weights[channel.0 as usize][i]);
        }
        golden.spikes().iter().filter(|c| c.0 < 3).for_each(|c| spiked[c.0 as usize] += 1);
        for i in 0..3 {
            let taken = spiked[i] * 64 * [10, 12, 14][i];
            assert_eq!(i64::from(golden.v(CompartmentId(i as u32))), arrived[i] - taken, "step {step}");
        }
    }
    assert!(spiked.iter().sum::<i64>() > 20, "{spiked:?}");
    // The last rung of the ladder too.
    let ladder = Ladder::new(&graph, &analytic::starts(&graph)).unwrap();
    let trains = ladder.run(Rung::MACHINE, &sample, false).trains;
    let spikes: usize = trains.iter().map(Vec::len).sum();
    assert_eq!(spikes as u64, golden.totals().spikes);
}

#[test]
fn a_target_without_it_refuses_it_by_name() {
    let network = quantise(&integrators("SoftReset")).unwrap();
    let problem = compile(network.clone(), &load_target("loihi1-chip").unwrap(), &Options::default()).unwrap_err();
    assert!(problem.to_string().contains("has SoftReset neurons, which loihi1-chip does not have"), "{problem}");
    assert!(compile(network, &chip(), &Options::default()).is_ok());
    let other = read(
        "SoftReset(name: \"hidden\", shape: [3], du: 4096, dv: 0, vth_mant: 3), Loihi(name: \"out\", shape: [2], du: \
         1, dv: 1, vth_mant: 9)",
    );
    assert!(compile(quantise(&other).unwrap(), &chip(), &Options::default()).is_ok());
}
