//! Described mappings against the same mappings with every synapse written out.

use super::*;
use crate::base::fixed::SignMode;
use crate::base::rng;
use crate::compile::testing::{Builder, format, limits, neurons, target};
use crate::compile::traffic::traffic;
use crate::compile::{Objective, finished};
use crate::desc::target::Packing;
use crate::ir::graph::{Shape, Window};
use crate::ir::quantised::Connectivity;

/// Two inputs and layers of windows, some of which skip a layer or see their own channel only, and a dense one at the end.
fn layered(seed: u64) -> Quantised {
    let draw = |n: u64, k: u64| rng::below(n, seed, 9, k) as u32;
    let mut net = Builder::new();
    let side = |k: u64| 5 + draw(14, k);
    let (h, w) = (side(0), side(1));
    let volume = |c, h, w| Shape::Volume(c, h, w);
    let mut all = vec![(net.input_shape("in", volume(2, h, w)), (2, h, w))];
    for layer in 0..3u64 {
        let k = 100 * (layer + 1);
        let (from, source) = all[all.len() - 1];
        let (kernel, stride) = ((1 + draw(3, k), 1 + draw(3, k + 1)), (1 + draw(2, k + 2), 1 + draw(2, k + 3)));
        let (padding, dilation) = ((draw(2, k + 4), draw(2, k + 5)), (1 + draw(2, k + 6), 1));
        let own = draw(3, k + 7) == 0;
        let groups = if own { source.0 } else { [1, 2][draw(2, k + 8) as usize] };
        let channels = if own { source.0 } else { 2 * (1 + draw(4, k + 9)) };
        let reach = |size: u32, kernel: u32, stride: u32, padding: u32, dilation: u32| {
            (size + 2 * padding).saturating_sub(dilation * (kernel - 1) + 1) / stride + 1
        };
        let shape = (
            channels,
            reach(source.1, kernel.0, stride.0, padding.0, dilation.0),
            reach(source.2, kernel.1, stride.1, padding.1, dilation.1),
        );
        let window = Window { source, target: shape, kernel, stride, padding, dilation, groups };
        let mut own_neurons = neurons();
        if draw(2, k + 10) == 0 {
            let n = shape.0 * shape.1 * shape.2;
            let of = |i: u32| crate::base::fixed::Decay::new(i64::from(i % 3) * 100).unwrap();
            own_neurons.du = PerCompartment::Each((0..n).map(of).collect());
        }
        let to = net.loihi_with(&format!("layer{layer}"), volume(shape.0, shape.1, shape.2), own_neurons);
        let sign = [SignMode::Mixed, SignMode::Excitatory][draw(2, k + 11) as usize];
        let kind = format(0, sign, [8, 6][draw(2, k + 12) as usize]);
        let delay = i64::from([0, 0, 2][draw(3, k + 13) as usize]);
        if own && draw(2, k + 14) == 0 {
            net.connect((from, to), kind, delay, Connectivity::SumPool2d { window, weight: 8 });
        } else {
            let weights = (shape.0 * source.0 / groups * kernel.0 * kernel.1) as usize;
            let kernel = (0..weights).map(|i| 8 * (i % 7) as i16).collect();
            net.connect((from, to), kind, delay, Connectivity::Conv2d { window, kernel });
        }
        // Itself, as recurrent convolutions have it.
        if draw(3, k + 15) == 0 {
            let once = Window {
                source: shape,
                target: shape,
                kernel: (3, 1),
                stride: (1, 1),
                padding: (1, 0),
                dilation: (1, 1),
                groups: 1,
            };
            let kernel = vec![4; (shape.0 * shape.0 * 3) as usize].into();
            net.connect((to, to), format(0, SignMode::Mixed, 8), 0, Connectivity::Conv2d { window: once, kernel });
        }
        all.push((to, shape));
    }
    let out = net.loihi("out", 11);
    net.dense(all[3].0, out, |s, t| ((s + t) % 9) as i16 * 2);
    if draw(2, 50) == 0 {
        net.dense(all[2].0, out, |s, t| ((s * t) % 9) as i16 * 2);
    }
    net.build()
}

fn small(seed: u64) -> Limits {
    let packing = if seed.is_multiple_of(2) { Packing::Nengo } else { Packing::Nxtf };
    Limits { compartments: 24 + (seed % 40) as u32, synapse_words: 2_000, packing, ..limits() }
}

#[test]
fn counts_traffic_and_cost_are_those_of_the_written_program() {
    let mut several = 0;
    for seed in 0..60 {
        let board = target(8, 4, small(seed));
        let options = Options { copies: 1 + (seed % 3) as u32, place: seed % 4 > 0, effort_s: 0, ..Options::default() };
        let made = describe(layered(seed), &board, &options).unwrap_or_else(|e| panic!("seed {seed}: {e}"));
        let network = &made.quantised;
        let chips = row_of_chips(made.partition.cores(), &board);
        let (members, seats) = (made.partition.members(), made.partition.seats());
        let exact = crate::compile::usage::usage(network, members, seats, &chips, board.limits());
        assert_eq!(made.partition.usage().as_slice(), exact.as_slice(), "seed {seed}");
        let Described { one, quantised, partition, placement, placed, rates, .. } = made.clone();
        let clock = Clock::default();
        let written = finished(one, quantised, partition, placement, placed, &board, &options, rates, clock).unwrap();
        let of_program = traffic(&written.program, &written.rates);
        assert_eq!(made.traffic(), of_program, "seed {seed}");
        assert_eq!(made.links().busiest(), traffic::links(&written.program, &written.rates).busiest(), "seed {seed}");
        assert_eq!(made.score(&of_program, &board).unwrap(), expect::score(&written, &board).unwrap(), "seed {seed}");
        several += usize::from(written.partition.cores() > 8);
    }
    assert!(several > 30, "{several} networks take several cores");
}

#[test]
fn output_axons_make_boxes_smaller() {
    let few = Limits { axons_out: 24, ..small(1) };
    let options = Options { effort_s: 0, ..Options::default() };
    let (many, plain) = (target(8, 8, few), target(8, 8, Limits { axons_out: 4096, ..few }));
    let cores = |board: &Target| describe(layered(3), board, &options).unwrap().partition.cores();
    assert!(cores(&many) > cores(&plain), "{} and {}", cores(&many), cores(&plain));
    let none = Limits { axons_out: 1, ..few };
    let Err(CompileError::DoesNotFit(reasons)) = describe(layered(3), &target(8, 8, none), &options) else {
        panic!("it fits")
    };
    assert!(reasons.iter().all(|reason| reason.resource == Resource::AxonsOut), "{reasons:?}");
}

#[test]
fn what_cannot_be_described_is_said() {
    let board = target(1, 1, limits());
    let mut net = Builder::new();
    let (a, b) = (net.input("a", 20), net.loihi("b", 5));
    net.random(a, b, 2, 1);
    assert!(layer::layers(&net.build()).is_none());
    let sequential = Options { strategy: Strategy::Sequential, ..Options::default() };
    let said = describe(layered(1), &board, &sequential).unwrap_err().to_string();
    assert!(said.contains("no sequential mapping"), "{said}");
    assert!(!applies(&layered(1), &Options { objective: Objective::Cores, ..Options::default() }));
}

#[test]
fn a_wrong_count_is_found() {
    let board = target(8, 4, small(2));
    let options = Options { effort_s: 0, ..Options::default() };
    let made = describe(layered(2), &board, &options).unwrap();
    let chips = row_of_chips(made.partition.cores(), &board);
    let every: Vec<CoreId> = made.partition.usage().ids().collect();
    let checked = |change: fn(&mut CoreUsage), cores: &[CoreId]| {
        let mut usage = made.partition.usage().clone();
        change(&mut usage[CoreId(1)]);
        let members = made.partition.members().clone();
        let partition = Partition::new(made.quantised.compartments(), members, usage, board.limits()).unwrap();
        check::check(&made.quantised, &partition, cores, &chips, board.limits())
    };
    checked(|_| {}, &every).unwrap();
    for change in [
        |used: &mut CoreUsage| used.synapses -= 1,
        |used: &mut CoreUsage| used.synapse_words -= 1,
        |used: &mut CoreUsage| used.axons_in -= 1,
        |used: &mut CoreUsage| used.axons_out += 1,
        |used: &mut CoreUsage| used.compartment_profiles += 1,
    ] {
        assert!(checked(change, &every).is_err());
    }
    // The sum of synapses needs no core.
    assert!(checked(|used| used.synapses -= 1, &[]).is_err());
}
