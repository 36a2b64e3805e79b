//! Time of an update of a plastic synapse: 32,768 compartments with 64 plastic synapses each, 2 %
//! spikes a step, pair STDP of epoch 4, one thread.
//!
//! Prints the nanoseconds of an update beyond a step without a rule, for each semantics. The
//! fastest of several rounds is shown.

// A bench that cannot continue has failed.
#![allow(clippy::unwrap_used)]

use std::time::Instant;

use nsim::compile::{Options, compile};
use nsim::ir::base::fixed::{Decay, SignMode, ThresholdMantissa};
use nsim::ir::base::id::{ChannelId, ProjectionId};
use nsim::ir::base::rng;
use nsim::ir::graph::{PerCompartment, Shape};
use nsim::ir::learning::{Change, Impulse, LearningSemantics, Rule, RuleText, Tau, TraceSettings, parse};
use nsim::ir::quantised::connectivity::Connectivity;
use nsim::ir::quantised::{Neuron, Quantised};
use nsim::ir::spikes::{Engine, Spikes};
use nsim::machine::{Image, Machine, Settings};
use nsim_testing::{Builder, format, limits, make_plastic, plain_format, sparse, target};

const COMPARTMENTS: u32 = 32_768;
const FAN_OUT: u32 = 64;
const STEPS: u32 = 200;
const ROUNDS: u32 = 5;

fn network(semantics: Option<LearningSemantics>) -> Quantised {
    let mut builder = Builder::new();
    let input = builder.input("in", COMPARTMENTS);
    // A spike of the input makes one; the plastic synapses alone do not.
    let neuron = Neuron {
        du: Decay::new(4096).unwrap(),
        dv: Decay::new(4096).unwrap(),
        vth: ThresholdMantissa::new(10_000).unwrap(),
        ..Neuron::PLAIN
    };
    let out = builder.loihi_with("out", Shape::Line(COMPARTMENTS), PerCompartment::Same(neuron));
    let one_to_one: Vec<_> = (0..COMPARTMENTS).map(|unit| vec![(unit, 254)]).collect();
    builder.connect(input, out, format(6, SignMode::Mixed, 8), 0, sparse(one_to_one));
    let random = Connectivity::Random {
        targets: COMPARTMENTS,
        fan_out: FAN_OUT,
        low: 0,
        high: 0,
        step: 2,
        seed: 3,
        first_source: 0,
    };
    builder.connect(out, out, plain_format(), 0, random);
    if let Some(semantics) = semantics {
        let trace = TraceSettings { impulse: Impulse::try_from(16.0).unwrap(), tau: Tau::try_from(10.0).unwrap() };
        let mut text = RuleText { epoch: 4, semantics, ..RuleText::default() };
        text.changes = [parse("2^-2*x1*y0 - 2^-2*y1*x0").unwrap(), Change::default(), Change::default()];
        (text.traces[0], text.traces[2]) = (trace, trace);
        make_plastic(&mut builder.parts, ProjectionId(1), Rule::new(text).unwrap());
    }
    Quantised::new(builder.parts).unwrap()
}

/// Nanoseconds of the fastest round, events and updates of a round.
fn measure(semantics: Option<LearningSemantics>, inputs: &[Vec<ChannelId>]) -> (f64, u64, u64) {
    let program = compile(network(semantics), &target(16, 16, limits()), &Options::default()).unwrap().program;
    let mut machine = Machine::new(&Image::new(&program, 1).unwrap(), Settings::default());
    let mut fastest = f64::INFINITY;
    for _ in 0..ROUNDS {
        machine.begin(STEPS);
        let start = Instant::now();
        inputs.iter().for_each(|ids| machine.step(Spikes { ids, values: &[] }));
        machine.settle();
        fastest = fastest.min(start.elapsed().as_secs_f64() * 1e9);
    }
    (fastest, machine.totals().synaptic_events, machine.synaptic_updates())
}

fn main() {
    let spikes = |step: u32| (0..COMPARTMENTS).filter(move |&unit| rng::below(1_000, 5, unit.into(), step.into()) < 20);
    let inputs: Vec<Vec<ChannelId>> = (0..STEPS).map(|step| spikes(step).map(ChannelId).collect()).collect();
    let (still, events, _) = measure(None, &inputs);
    println!("without a rule: {:.2} ns an event, {events} events", still / events as f64);
    for semantics in [LearningSemantics::Silicon, LearningSemantics::Lava] {
        let (time, _, updates) = measure(Some(semantics), &inputs);
        println!("{semantics:?}: {:.1} ns an update beyond that, {updates} updates", (time - still) / updates as f64);
    }
}
