//! Reset by subtraction: integrators lose nothing, and only targets that name it support it.

use crate::common::random;
use nsim::agree::causes::ComparisonStage;
use nsim::agree::staged::StagedNetwork;
use nsim::compile::{Options, compile};
use nsim::files::target::load_target;
use nsim::golden::Golden;
use nsim::ir::base::id::CompartmentId;
use nsim::ir::graph::Graph;
use nsim::ir::spikes::Engine;
use nsim::quantise::analytic;
use nsim::quantise::quantise::quantise;
use nsim::reference::{Model, Options as RealOptions, Reference};

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
    // The last comparison stage agrees too.
    let staged = StagedNetwork::new(&graph, &analytic::starts(&graph)).unwrap();
    let trains = staged.run(ComparisonStage::MACHINE, &sample, false).trains;
    let spikes: usize = trains.iter().map(Vec::len).sum();
    assert_eq!(spikes as u64, golden.totals().spikes);
}

#[test]
fn a_target_without_it_refuses_it_by_name() {
    let network = quantise(&integrators("SoftReset")).unwrap();
    let chip = load_target("oheo-gulch").unwrap();
    let problem = compile(network.clone(), &load_target("loihi1-chip").unwrap(), &Options::default()).unwrap_err();
    assert!(problem.to_string().contains("has SoftReset neurons, which loihi1-chip does not have"), "{problem}");
    assert!(compile(network, &chip, &Options::default()).is_ok());
    let other = read(
        "SoftReset(name: \"hidden\", shape: [3], du: 4096, dv: 0, vth_mant: 3), Loihi(name: \"out\", shape: [2], du: \
         1, dv: 1, vth_mant: 9)",
    );
    assert!(compile(quantise(&other).unwrap(), &chip, &Options::default()).is_ok());
}
