//! An `If` population against a `Loihi` one with du = 4096 and dv = 0: every engine gives equal
//! numbers.

use std::path::Path;

use crate::common::compare::{assert_on_machine, roomy, trace, with_neurons};
use crate::common::random;
use crate::common::unsearched;
use nsim::compile::compile;
use nsim::files::lower::lower;
use nsim::files::shipped::Origin;
use nsim::golden::Golden;
use nsim::import::model::network;
use nsim::ir::arithmetic::Semantics;
use nsim::ir::base::diagnostic::SourceText;
use nsim::ir::base::fixed::Decay;
use nsim::ir::graph::Graph;
use nsim::ir::neurons::NeuronKind;
use nsim::ir::quantised::{Neuron, Parts, Quantised};
use nsim::quantise::prune::{Plan, prune};
use nsim::quantise::quantise::quantise;
use nsim::reference::{Model, Options as RealOptions, Reference};
use nsim::session::decision::SpikeBounds;

/// The network with all compartments of one kind, without memory of currents and without leaks.
fn with_kind(network: &Quantised, kind: NeuronKind) -> Quantised {
    let hardware = Parts { semantics: Semantics::Hardware, ..network.parts().clone() };
    let simple = |neuron| Neuron { kind, du: Decay::MAX, dv: Decay::MIN, ..neuron };
    with_neurons(&Quantised::new(hardware).unwrap(), simple)
}

#[test]
fn it_equals_a_loihi_compartment_that_forgets_all_current_and_no_voltage() {
    let chip = roomy("loihi1-chip");
    let mut spikes = 0;
    for seed in 0..100 {
        let drawn = random::network(seed);
        let sample = random::sample(&drawn, seed);
        let (loihi, simple) = (with_kind(&drawn, NeuronKind::Loihi), with_kind(&drawn, NeuronKind::If));
        let expected = trace(&mut Golden::new(&loihi), &loihi, &sample);
        spikes += expected.totals.spikes;
        expected.assert_same(&trace(&mut Golden::new(&simple), &simple, &sample), &format!("network {seed}, golden"));
        let program = compile(simple.clone(), &chip, &unsearched()).unwrap().program;
        assert_on_machine(&simple, &program, &sample, &expected, &format!("network {seed}"));
    }
    assert!(spikes > 10_000, "{spikes}");
}

fn read(population: &str, out: &str) -> Graph {
    let text = format!(
        "Network(name: \"n\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [4]), {population}, {out}], \
         projections: [Dense(from: [\"in\"], to: \"hidden\", weights: [[20, -6, 4, 0], [0, 8, 40, 2], [-2, -4, -6, \
         -8]]), \
         Dense(from: [\"hidden\"], to: \"out\", weights: [[8, 20, 2], [6, -4, 2]])], output: \"out\")"
    );
    lower(&network(SourceText::new("n.ron", text), Origin::File).unwrap()).unwrap()
}

const OTHERS: &str = "bias_mant: [0, 3, 0], bias_exp: 2, refractory: 3, vmin_exp: 12, vmax_exp: 3, start_step: 2";

fn both() -> [Graph; 2] {
    [
        read(
            &format!("Loihi(name: \"hidden\", shape: [3], du: 4096, dv: 0, vth_mant: [10, 12, 14], {OTHERS})"),
            "Loihi(name: \"out\", shape: [2], du: 4096, dv: 0, vth_mant: 12, refractory: 2)",
        ),
        read(
            &format!("If(name: \"hidden\", shape: [3], vth_mant: [10, 12, 14], {OTHERS})"),
            "If(name: \"out\", shape: [2], vth_mant: 12, refractory: 2)",
        ),
    ]
}

#[test]
fn a_model_file_names_it_and_every_stage_follows() {
    let [loihi, simple] = both();
    let [a, b] = [quantise(&loihi).unwrap(), quantise(&simple).unwrap()];
    for (id, population) in a.populations().enumerate() {
        let (Some(a), Some(b)) = (population.neurons(), b.populations()[id].neurons()) else { continue };
        for index in 0..population.shape.len() {
            assert_eq!(Neuron { kind: NeuronKind::If, ..a.get(index) }, b.get(index), "{} {index}", population.name);
        }
    }
    let sample = random::sample(&a, 3);
    assert_eq!(trace(&mut Golden::new(&a), &a, &sample), trace(&mut Golden::new(&b), &b, &sample));
    // Models in real numbers, with bounds for pruning and for early exit.
    let [x, y] = [
        Model::<f64>::new(&loihi, RealOptions::default()).unwrap(),
        Model::<f64>::new(&simple, RealOptions::default()).unwrap(),
    ];
    assert_eq!(trace(&mut Reference::new(&x), &a, &sample), trace(&mut Reference::new(&y), &b, &sample));
    let [p, q] = [prune(&a, &Plan::fixed()).unwrap(), prune(&b, &Plan::fixed()).unwrap()];
    assert_eq!(p.compartments(), 4, "the third hidden compartment has no positive weight and no bias");
    assert_eq!((p.compartments(), p.synapses()), (q.compartments(), q.synapses()));
    assert_eq!(SpikeBounds::for_output(&a), SpikeBounds::for_output(&b));
}

#[test]
fn it_is_written_as_it_is_read_and_refuses_what_it_has_not() {
    let text = "Network(name: \"n\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [1]), \
                If(name: \"out\", shape: [2], vth_mant: [3, 4], refractory: 2)], \
                projections: [Dense(from: [\"in\"], to: \"out\", weights: [[2], [4]])], output: \"out\")";
    let model = network(SourceText::new("n.ron", text), Origin::File).unwrap();
    let builder = model.resolved().unwrap();
    let again = builder.build(Path::new("again.ron")).unwrap();
    assert_eq!(again.resolved().unwrap(), builder);
    assert!(
        builder.ron("arrays").unwrap().0.contains("If(name: \"out\", shape: [2], vth_mant: [3, 4], refractory: 2)")
    );
    let leak = text.replace("refractory: 2", "dv: 2");
    let problem = network(SourceText::new("n.ron", leak), Origin::File).unwrap_err();
    assert!(problem.message.contains("`If` has no field `dv`"), "{problem}");
    let lava = text.replace("output:", "semantics: Lava, output:");
    let graph = lower(&network(SourceText::new("n.ron", lava), Origin::File).unwrap()).unwrap();
    assert_eq!(quantise(&graph).unwrap_err().code, "model.semantics");
}
