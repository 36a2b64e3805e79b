//! The metrics of NeuroBench's harness, compared with a step-by-step count over matrices, on the
//! golden interpreter and the machine.

use std::collections::BTreeMap;

use crate::common::compare::roomy;
use crate::common::random;
use nsim::compile::{Options, compile};
use nsim::dynamics::synapses::Enumerate;
use nsim::golden::Golden;
use nsim::ir::base::id::{CompartmentId, Id};
use nsim::ir::quantised::connectivity::Connectivity;
use nsim::ir::quantised::{Quantised, Units};
use nsim::ir::spikes::{Engine, Sample};
use nsim::session::neurobench::NeuroBench;
use nsim::session::samples::{RunSettings, fast, golden};

/// Sums over the samples: operations with binary and with graded spikes, all operations of a
/// network without zeros, membrane updates, spikes.
#[derive(Debug, Default, PartialEq)]
struct Sums {
    plain: u64,
    graded: u64,
    dense: u64,
    updates: u64,
    spikes: u64,
    timesteps: u64,
}

/// Visits every source of every projection in every step.
fn counted(network: &Quantised, samples: &[&Sample]) -> Sums {
    let matrices: Vec<Vec<BTreeMap<u32, i64>>> = network
        .projections()
        .iter()
        .map(|projection| {
            let sources = network.populations()[projection.source].shape.len();
            let row = |source| {
                let mut row = BTreeMap::new();
                projection.connectivity.for_each_from(source, |target, weight| {
                    *row.entry(target).or_insert(0) += i64::from(weight);
                });
                row
            };
            (0..sources).map(row).collect()
        })
        .collect();
    let mut sums = Sums::default();
    for sample in samples {
        let mut engine = Golden::new(network);
        engine.begin(sample.steps());
        let mut before: Vec<i32> = Vec::new();
        for step in 0..sample.steps() {
            engine.step(sample.input(step));
            let fired = engine.ascending_spikes();
            sums.timesteps += 1;
            sums.spikes += fired.len() as u64;
            for (projection, matrix) in network.projections().iter().zip(&matrices) {
                let source = &network.populations()[projection.source];
                let whole = matches!(
                    projection.connectivity,
                    Connectivity::Dense { .. } | Connectivity::Sparse { .. } | Connectivity::Random { .. }
                );
                for (index, row) in (0..).zip(matrix) {
                    let targets = u64::from(network.populations()[projection.target].shape.len());
                    sums.dense += if whole { targets } else { row.len() as u64 };
                    let spikes = match source.units {
                        Units::Input(first) => sample.at(step).contains(&Id::new(first.index() + index)),
                        Units::Compartments { first, .. } => fired.contains(&CompartmentId(first.0 + index as u32)),
                    };
                    if spikes {
                        let met = row.values().filter(|&&weight| weight != 0).count() as u64;
                        *(if source.message.factor() == Some(1) { &mut sums.plain } else { &mut sums.graded }) += met;
                    }
                }
            }
            let now: Vec<i32> = (0..network.compartments()).map(|id| engine.v(CompartmentId(id))).collect();
            let changed = |id: &usize| before.get(*id) != Some(&now[*id]);
            sums.updates += (0..now.len()).filter(changed).count() as u64;
            before = now;
        }
    }
    sums
}

#[test]
fn metrics_are_those_of_a_count_over_matrices() {
    let target = roomy("loihi1-chip");
    let mut all = Sums::default();
    for seed in 0..60 {
        let network = if seed % 2 == 0 { random::network(seed) } else { random::convolutional(seed) };
        let given: Vec<Sample> = (0..3).map(|k| random::sample(&network, seed + 1_000 * k)).collect();
        let samples: Vec<&Sample> = given.iter().collect();
        let expected = counted(&network, &samples);
        let interpreted =
            NeuroBench::measure(&network, &samples, |samples, keep| Ok(golden(&network, samples, keep, &|| ())))
                .unwrap();
        let options = Options { place: false, copies: 2, ..Options::default() };
        let compiled = compile(network.clone(), &target, &options).unwrap();
        let simulated = NeuroBench::measure(&network, &samples, |samples, keep| {
            let running = RunSettings { copies: 2, skip: seed % 4 < 2, ..RunSettings::new(keep) };
            fast(&compiled.program, samples, running, || ())
        })
        .unwrap();
        assert_eq!(interpreted, simulated, "network {seed}");
        let a_sample = |count: u64| count as f64 / 3.0;
        let operations = &interpreted.synaptic_operations;
        assert_eq!(operations.dense, a_sample(expected.dense), "network {seed}");
        assert_eq!(operations.effective_acs, a_sample(expected.plain), "network {seed}");
        assert_eq!(operations.effective_macs, a_sample(expected.graded), "network {seed}");
        assert_eq!(interpreted.membrane_updates, a_sample(expected.updates), "network {seed}");
        let places = expected.timesteps * u64::from(network.compartments());
        let sparsity = (places - expected.spikes) as f64 / places as f64;
        assert_eq!(interpreted.activation_sparsity, sparsity * 3.0 / 3.0, "network {seed}");
        all.plain += expected.plain;
        all.graded += expected.graded;
        all.updates += expected.updates;
    }
    assert!(all.plain > 0 && all.updates > 0, "{all:?}");
}
