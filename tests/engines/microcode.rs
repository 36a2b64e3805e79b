//! Neurons whose rule a model file states. The kinds of Loihi 2 as such rules equal nsim's own, on
//! random networks; stated rules are preserved by every text.

use std::collections::BTreeMap;

use crate::common::compare::{assert_on_machine, roomy, small_cores, trace, with_neurons};
use crate::common::random::{self, Draw};
use crate::common::unsearched;
use nsim::compile::{Options, compile};
use nsim::files::lower::lower;
use nsim::files::mapping::pretty;
use nsim::files::network::{Network, NetworkFile};
use nsim::golden::Golden;
use nsim::ir::activity::Overflow;
use nsim::ir::base::diagnostic::{Diagnostic, SourceText};
use nsim::ir::base::id::{ChannelId, PopulationId};
use nsim::ir::neurons::NeuronKind;
use nsim::ir::program::Program;
use nsim::ir::quantised::{Neuron, Quantised, Units};
use nsim::ir::spanned::parse;
use nsim::ir::spikes::Sample;
use nsim::quantise::integers;
use nsim::session::Probe;
use nsim_testing::cases;
use nsim_testing::kinds::stated;
use rayon::prelude::*;

#[test]
fn stated_kinds_are_the_same_as_those_that_nsim_has() {
    let targets = [("roomy", roomy("oheo-gulch")), ("small cores", small_cores("oheo-gulch", 7))];
    let networks = cases(400);
    let seen: Vec<(bool, bool, bool)> = (0..networks)
        .into_par_iter()
        .map(|seed| {
            let network = random::mixed(seed);
            // Every kind that has a text is stated.
            let own = with_neurons(&network, |neuron| Neuron { kind: stated(neuron.kind), ..neuron });
            if own == network {
                return (false, false, false);
            }
            let draw = &mut Draw::new(seed ^ 0x3c0d);
            let bare = random::sample(&network, seed);
            let events = (0..bare.steps()).flat_map(|t| bare.at(t).iter().map(move |&channel| (t, channel)));
            let reach = draw.one_of(&[30, 3_000, 300_000_000]);
            let valued: Vec<_> = events.map(|(t, channel)| (t, channel, draw.from(-reach, reach) as i32)).collect();
            let sample = Sample::with_values(bare.steps(), &valued, None).unwrap();
            let golden = trace(&mut Golden::new(&own), &own, &sample);
            trace(&mut Golden::new(&network), &network, &sample).assert_same(&golden, &format!("network {seed}"));
            let options = unsearched();
            for (what, target) in &targets {
                let program = compile(own.clone(), target, &options).unwrap().program;
                assert_on_machine(&own, &program, &sample, &golden, &format!("network {seed}, {what}"));
            }
            let skipped = golden.totals.active_updates < golden.totals.compartment_updates;
            (true, skipped, golden.overflow != Overflow::default())
        })
        .collect();
    let count = |of: fn(&&(bool, bool, bool)) -> bool| seen.iter().filter(of).count() as u64;
    let parts = [6, 8, 20].map(|part| networks / part);
    assert!(count(|seen| seen.0) > parts[0] && count(|seen| seen.1) > parts[1] && count(|seen| seen.2) > parts[2]);
}

const MODEL: &str = r#"Network(
    name: "own",
    timestep_ms: 1.0,
    kinds: [
        Kind(
            name: "Leaky",
            state: [(name: "v", bits: 24, overflow: Clip)],
            parameters: [(name: "dv", range: (0, 4096), default: 128), (name: "theta", range: (0, 100000))],
            update: ["v = tz(v * (4096 - dv), 12) + (in << 6)"],
            spikes: "v > theta",
            reset: ["v = 0"],
        ),
    ],
    populations: [
        Input(name: "in", shape: [3]),
        Leaky(name: "cells", shape: [3], theta: [100, 200, 90000], start_step: 1),
        Leaky(name: "out", shape: [1], dv: 0, theta: 64, payload: 3),
    ],
    projections: [
        Sparse(from: ["in"], to: "cells", synapses: [(0, 0, 2), (1, 1, 2), (2, 2, 2)]),
        Dense(from: ["cells"], to: "out", weights: [[2, 2, 2]]),
    ],
    output: "out",
    target: "oheo-gulch",
)"#;

fn quantised(text: &str) -> Result<Quantised, Diagnostic> {
    integers(&lower(&model(text)?)?)
}

fn model(text: &str) -> Result<Network, Diagnostic> {
    let source = SourceText::new("own.ron", text);
    Network::new(NetworkFile::parse(&source)?, source, BTreeMap::new())
}

#[test]
fn a_stated_kind_is_kept_by_every_text() {
    let network = model(MODEL).unwrap();
    let (text, tensors) = network.file().ron("arrays").unwrap();
    assert_eq!(tensors.len(), 1, "the weights of the dense projection");
    assert_eq!(NetworkFile::parse(&SourceText::new("again.ron", text.as_str())).unwrap().kinds, network.file().kinds);
    let quantised = quantised(MODEL).unwrap();
    let read: Quantised = parse(&SourceText::new("q.ron", pretty(&quantised, 3).unwrap()), "q").unwrap();
    assert_eq!(read, quantised);
    let compiled = compile(quantised.clone(), &roomy("oheo-gulch"), &Options::default()).unwrap();
    let program: Program = parse(&SourceText::new("p.ron", pretty(&*compiled.program, 5).unwrap()), "p").unwrap();
    assert_eq!(program, *compiled.program);
    let cells = &quantised.populations()[PopulationId(1)];
    let Units::Compartments { neurons, .. } = &cells.units else { panic!("it has compartments") };
    assert_eq!((neurons.get(1).parameter("theta"), neurons.get(1).parameter("dv")), (200, 128));
    assert!(Probe::named(cells, "v").is_some() && Probe::named(cells, "u").is_none());
    let events: Vec<_> = (0..40).flat_map(|t| (0..3).map(move |channel| (t, ChannelId(channel)))).collect();
    let sample = Sample::new(40, &events, None).unwrap();
    let golden = trace(&mut Golden::new(&quantised), &quantised, &sample);
    assert!(golden.totals.spikes > 20);
    assert_on_machine(&quantised, &compiled.program, &sample, &golden, "own");
}

#[test]
fn a_parameter_of_a_stated_kind_may_have_any_name() {
    let events: Vec<_> = (0..40).flat_map(|t| (0..3).map(move |channel| (t, ChannelId(channel)))).collect();
    let sample = Sample::new(40, &events, None).unwrap();
    let seen = |network: &Quantised| trace(&mut Golden::new(network), network, &sample);
    let meant = quantised(MODEL).unwrap();
    let of_loihi = NeuronKind::Loihi.parameters().iter().flat_map(|f| [Some(f.name), f.real.map(|(real, _)| real)]);
    for name in of_loihi.flatten().filter(|name| *name != "dv") {
        let named = quantised(&MODEL.replace("theta", name)).unwrap();
        assert_eq!(named.projections(), meant.projections(), "{name}");
        seen(&named).assert_same(&seen(&meant), name);
    }
}

#[test]
fn what_is_wrong_in_a_stated_kind_is_told_with_line_and_column() {
    let mut wrong = Vec::new();
    for (from, to, code, line, column, part) in [
        ("tz(v *", "tz(w *", "model.kind", 9, 30, "'w' is not defined"),
        ("v > theta", "v > thta", "model.kind", 10, 26, "did you mean 'theta'?"),
        ("bits: 24", "bits: 40", "model.kind", 7, 21, "40 bits are outside 2..=32"),
        ("overflow: Clip", "overflow: Clap", "model.kind", 7, 53, "Clap"),
        ("reset: [", "rest: [", "model.kind", 11, 13, "rest"),
        ("name: \"Leaky\",\n", "name: \"Loihi\",\n", "model.kind", 6, 20, "is the name of another kind"),
        ("Leaky(name: \"out\"", "Leeky(name: \"out\"", "model.syntax", 17, 9, "did you mean 'Leaky'?"),
        ("dv: 0, theta: 64", "dw: 0, theta: 64", "model.syntax", 17, 40, "dw"),
        ("dv: 0, theta: 64", "dv: 4097, theta: 64", "model.range", 17, 44, "4097"),
        ("dv: 0, theta: 64", "dv: 0", "model.parameter-missing", 17, 9, "field theta is missing"),
        ("[100, 200, 90000]", "[100, 200]", "model.parameter-size", 16, 49, "theta has 2 values for 3 compartments"),
        ("payload: 3", "message_bits: 3", "model.syntax", 17, 58, "message_bits"),
    ] {
        let text = MODEL.replacen(from, to, 1);
        assert_ne!(text, MODEL, "{from}");
        let problem = quantised(&text).unwrap_err();
        let place = problem.position().map(|place| (place.line, place.column));
        if (problem.code, place) != (code, Some((line, column))) || !problem.to_string().contains(part) {
            wrong.push(format!("{from} -> {to}: {} {place:?} {problem}", problem.code));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_chip_that_does_not_list_microcode_refuses_it() {
    let binary = MODEL.replace(", payload: 3", "");
    let refused =
        compile(quantised(&binary).unwrap(), &roomy("loihi1-chip"), &Options::default()).unwrap_err().to_string();
    assert!(refused.contains("population 'cells' has Leaky neurons"), "{refused}");
}
