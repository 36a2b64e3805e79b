//! The rules of a timestep other than arithmetic: arrival of spikes, holding, reset, counts.

use crate::common::{Builder, biased, engines, format, neuron};
use nsim::ir::activity::Totals;
use nsim::ir::arithmetic::{Semantics, ThresholdTest};
use nsim::ir::base::fixed::SignMode;
use nsim::ir::base::id::{ChannelId, CompartmentId};
use nsim::ir::graph::{Shape, Window};
use nsim::ir::quantised::Quantised;
use nsim::ir::quantised::connectivity::Connectivity;
use nsim::ir::spikes::Engine;

const FIRST: CompartmentId = CompartmentId(0);

/// Runs every engine over (step, channel) input spikes. Returns the values of `f` after each step,
/// which are equal on all engines.
fn watch<T: PartialEq + std::fmt::Debug>(
    network: &Quantised,
    steps: u32,
    input: &[(u32, u32)],
    f: impl Fn(&dyn Engine) -> T,
) -> (Vec<T>, Totals) {
    let mut seen: Option<(Vec<T>, Totals)> = None;
    for (name, mut engine) in engines(network) {
        // The second round must not depend on the first.
        for round in 0..2 {
            engine.begin(steps);
            let mut trace = Vec::new();
            for step in 0..steps {
                let channels: Vec<_> = input.iter().filter(|e| e.0 == step).map(|e| ChannelId(e.1)).collect();
                engine.step((&channels).into());
                trace.push(f(engine.as_ref()));
            }
            let here = (trace, engine.totals());
            match &seen {
                None => seen = Some(here),
                Some(before) => assert_eq!(&here, before, "{name}, round {round}"),
            }
        }
    }
    seen.expect("there is an engine")
}

/// (step, compartment) of every spike.
fn spikes(network: &Quantised, steps: u32, input: &[(u32, u32)]) -> (Vec<(usize, u32)>, Totals) {
    let (trace, totals) = watch(network, steps, input, |engine| engine.ascending_spikes());
    let flat = trace.iter().enumerate().flat_map(|(step, ids)| ids.iter().map(move |id| (step, id.0))).collect();
    (flat, totals)
}

#[test]
fn a_spike_takes_its_delay_and_one_step_more_between_compartments() {
    let relay = neuron(4096, 4096, 1, 1);
    for (d, e) in [(0, 0), (1, 0), (0, 5), (62, 62)] {
        let mut net = Builder::new();
        let input = net.input("input", 1);
        let a = net.each("a", Shape::Line(1), &[relay], 0);
        let b = net.each("b", Shape::Line(1), &[relay], 0);
        net.matrix(input, a, d, &[2]);
        net.matrix(a, b, e, &[2]);
        let network = net.build();
        let (d, e) = (d as usize, e as usize);
        let (seen, totals) = spikes(&network, 200, &[(3, 0), (5, 0)]);
        let (x, y) = (3 + d, 5 + d);
        let mut expected = vec![(x, 0), (y, 0), (x + 1 + e, 1), (y + 1 + e, 1)];
        expected.sort_unstable();
        assert_eq!(seen, expected, "delays {d} and {e}");
        assert_eq!((totals.spikes_in, totals.spikes, totals.synaptic_events), (2, 4, 4));
    }
}

#[test]
fn a_loop_sustains_itself_through_the_longest_delay() {
    let mut net = Builder::new();
    let input = net.input("input", 1);
    let relay = net.each("relay", Shape::Line(1), &[neuron(4096, 4096, 1, 1)], 0);
    net.matrix(input, relay, 0, &[2]);
    net.matrix(relay, relay, 62, &[2]);
    let (seen, _) = spikes(&net.build(), 200, &[(0, 0)]);
    assert_eq!(seen, [(0, 0), (63, 0), (126, 0), (189, 0)]);
}

#[test]
fn deliveries_after_the_last_step_are_not_counted() {
    let mut net = Builder::new();
    let input = net.input("input", 1);
    let a = net.each("a", Shape::Line(1), &[neuron(4096, 4096, 1, 1)], 0);
    let b = net.each("b", Shape::Line(3), &[neuron(4096, 4096, 1, 1); 3], 0);
    net.matrix(input, a, 2, &[2]);
    net.matrix(a, b, 0, &[2, 2, 0]);
    // The spike enters a in step 5; its spike would enter b in step 6.
    let network = net.build();
    let events = |steps| spikes(&network, steps, &[(3, 0)]).1.synaptic_events;
    assert_eq!([events(5), events(6), events(7), events(8)], [0, 1, 4, 4]);
}

#[test]
fn a_population_is_held_at_zero_before_its_start() {
    let mut net = Builder::new();
    let input = net.input("input", 1);
    let late = net.each("late", Shape::Line(1), &[biased(neuron(4096, 0, 131_071, 1), 10, 0)], 3);
    net.matrix(input, late, 0, &[2]);
    let (v, totals) = watch(&net.build(), 6, &[(2, 0), (4, 0)], |engine| engine.v(FIRST));
    // Arrivals of step 2 are lost, and so is the bias of three steps.
    assert_eq!(v, [0, 0, 0, 10, 148, 158]);
    assert_eq!((totals.synaptic_events, totals.compartment_updates, totals.active_updates), (2, 6, 3));
}

#[test]
fn a_reset_zeroes_current_voltage_and_refractory_period_before_the_update() {
    let mut net = Builder::new();
    let input = net.input("input", 1);
    let counting = biased(neuron(0, 0, 131_071, 1), 10, 0);
    let silent = neuron(4096, 4096, 1, 60);
    let target = net.each("target", Shape::Line(2), &[counting, silent], 2);
    net.matrix(input, target, 0, &[2, 4]);
    net.reset(4, 1);
    let input = [(2, 0), (3, 0), (4, 0), (7, 0), (8, 0)];
    let (seen, _) = watch(&net.build(), 10, &input, |engine| {
        (engine.u(FIRST), engine.v(FIRST), engine.spikes().contains(&CompartmentId(1)))
    });
    let expected = [
        (0, 0, false),
        (0, 0, false),
        (128, 138, true),
        // The first reset falls on start + offset = 3.
        (128, 138, true),
        (256, 404, false),
        (256, 670, false),
        (256, 936, false),
        (128, 138, true),
        (256, 404, false),
        (256, 670, false),
    ];
    assert_eq!(seen, expected);
}

#[test]
fn a_refractory_period_of_zero_is_one_on_the_chip_and_for_ever_in_slayer() {
    let input: Vec<_> = (0..8).map(|step| (step, 0)).collect();
    let run = |semantics, refractory| {
        let mut net = Builder::with(semantics);
        let source = net.input("source", 1);
        let target = net.each("target", Shape::Line(1), &[neuron(4096, 77, 1, refractory)], 0);
        net.matrix(source, target, 0, &[2]);
        let (seen, _) = watch(&net.build(), 8, &input, |engine| {
            (engine.spikes().len() == 1, engine.v(FIRST), engine.v_register(FIRST))
        });
        assert!(seen.iter().all(|&(_, membrane, _)| membrane == 0));
        let steps: Vec<_> = (0..8).filter(|&step| seen[step].0).collect();
        (steps, seen.iter().map(|&(_, _, register)| register).collect::<Vec<_>>())
    };
    let every: Vec<usize> = (0..8).collect();
    assert_eq!(run(Semantics::Hardware, 0), (every.clone(), vec![128; 8]));
    assert_eq!(run(Semantics::Hardware, 1), (every.clone(), vec![128; 8]));
    assert_eq!(run(Semantics::Hardware, 3), (vec![0, 3, 6], vec![384, 385, 386, 384, 385, 386, 384, 385]));
    // lava has no refractory period.
    assert_eq!(run(Semantics::Lava, 3), (every, vec![0; 8]));
    // SLAYER skips step 0 and shows dv at a spike.
    assert_eq!(run(Semantics::Slayer, 3), (vec![1, 4, 7], vec![0, 77, 0, 0, 77, 0, 0, 77]));
    assert_eq!(run(Semantics::Slayer, 0), (vec![1], vec![0, 77, 0, 0, 0, 0, 0, 0]));
}

#[test]
fn a_voltage_on_the_threshold_spikes_only_when_the_test_includes_it() {
    for (threshold, expected) in
        [(ThresholdTest::Strict, vec![(2, 0)]), (ThresholdTest::Inclusive, vec![(1, 0), (2, 0)])]
    {
        let mut net = Builder::new();
        net.parts.threshold = threshold;
        let source = net.input("source", 2);
        let target = net.each("target", Shape::Line(1), &[neuron(4096, 4096, 2, 1)], 0);
        net.matrix(source, target, 0, &[2, 4]);
        assert_eq!(spikes(&net.build(), 4, &[(1, 0), (2, 1)]).0, expected, "{threshold:?}");
    }
}

#[test]
fn a_compartment_is_active_unless_nothing_can_move_it() {
    let mut net = Builder::new();
    let source = net.input("source", 2);
    let plain = neuron(4096, 4096, 131_071, 1);
    let refractory = neuron(4096, 4096, 0, 4);
    let target = net.each("target", Shape::Line(3), &[plain, refractory, biased(plain, 1, 0)], 0);
    net.matrix(source, target, 0, &[2, -2, 2, -2, 0, 0]);
    let network = net.build();
    let totals = |input: &[(u32, u32)]| spikes(&network, 10, input).1;
    // A bias keeps its compartment active in all ten steps.
    let silent = totals(&[]);
    assert_eq!((silent.compartment_updates, silent.active_updates), (30, 10));
    // Arrivals that cancel are six events and change nothing.
    let cancelled = totals(&[(2, 0), (2, 1)]);
    assert_eq!((cancelled.synaptic_events, cancelled.active_updates, cancelled.spikes), (6, 10, 0));
    // The plain one is active in step 2 and, since u is not zero at its start, in step 3. The
    // spiking one is also active in steps 4 and 5, during its refractory period.
    let moved = totals(&[(2, 0)]);
    assert_eq!((moved.synaptic_events, moved.active_updates, moved.spikes), (3, 16, 1));
}

#[test]
fn a_convolution_does_not_flip_its_kernel() {
    // [1, 2, 3] under a 2 x 2 kernel [[2, 4], [8, 16]] without padding gives [1, 1, 2].
    let window = Window {
        source: (1, 2, 3),
        target: (1, 1, 2),
        kernel: (2, 2),
        stride: (1, 1),
        padding: (0, 0),
        dilation: (1, 1),
        groups: 1,
    };
    let mut net = Builder::new();
    let source = net.input_shape("source", Shape::Volume(1, 2, 3));
    let target = net.each("target", Shape::Volume(1, 1, 2), &[neuron(4096, 4096, 131_071, 1); 2], 0);
    let connectivity = Connectivity::Conv2d { window, kernel: [2, 4, 8, 16].into() };
    net.connect(source, target, format(SignMode::Mixed, 0), 0, connectivity);
    let input: Vec<_> = (0..6).map(|channel| (channel, channel)).collect();
    let (u, totals) = watch(&net.build(), 6, &input, |engine| [engine.u(FIRST) / 64, engine.u(CompartmentId(1)) / 64]);
    // Channels in order: (0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2).
    assert_eq!(u, [[2, 0], [4, 2], [0, 4], [8, 0], [16, 8], [0, 16]]);
    assert_eq!(totals.synaptic_events, 8);
}
