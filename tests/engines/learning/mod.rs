//! Rules that change synapses: recordings of lava's own class and runtime, small networks computed
//! by hand, and random plastic networks, on which engines are compared.

pub mod random;
mod recordings;

use std::sync::Arc;

use crate::common::{Builder, neuron};
use nsim::golden::Golden;
use nsim::ir::base::fixed::{MessageBits, SignMode};
use nsim::ir::base::id::{ChannelId, CompartmentId, IdVec, ProjectionId, RuleId};
use nsim::ir::graph::Shape;
use nsim::ir::learning::draws::{Draws, Use};
use nsim::ir::learning::{Change, Column, LearningSemantics, Rule, RuleText, Trace, Variable, parse};
use nsim::ir::quantised::Quantised;
use nsim::ir::quantised::connectivity::Connectivity;
use nsim::ir::spikes::{Engine, Message, Sample};
use nsim_testing::{format, make_plastic};

/// The columns of a rule, named as in the equations and in recordings.
const COLUMNS: [(&str, Column); 9] = [
    ("w", Column::Variable(Variable::Weight)),
    ("d", Column::Variable(Variable::Delay)),
    ("t", Column::Variable(Variable::Tag)),
    ("x1", Column::Trace(Trace::X1)),
    ("x2", Column::Trace(Trace::X2)),
    ("y1", Column::Trace(Trace::Y1)),
    ("y2", Column::Trace(Trace::Y2)),
    ("y3", Column::Trace(Trace::Y3)),
    ("r1", Column::Trace(Trace::R1)),
];

/// One input and one compartment, whose synapse learns; entries of the input, and of `teach`, which
/// makes the compartment spike.
struct Small {
    dw: &'static str,
    dd: &'static str,
    semantics: LearningSemantics,
    epoch: u8,
    until: Option<u32>,
    delay: i64,
    input: &'static [u32],
    teach: &'static [u32],
    /// The value of y2 in step 3.
    reward: i32,
    steps: u32,
}

const SMALL: Small = Small {
    dw: "",
    dd: "",
    semantics: LearningSemantics::Lava,
    epoch: 1,
    until: None,
    delay: 0,
    input: &[],
    teach: &[],
    reward: 0,
    steps: 6,
};

impl Small {
    fn network(&self) -> Quantised {
        let mut net = Builder::new();
        let (input, teach, reward) = (net.input("in", 1), net.input("teach", 1), net.input("reward", 1));
        net.parts.populations[reward].message = Message::Value(MessageBits::new(17).unwrap());
        let out = net.each("out", Shape::Line(1), &[neuron(4096, 4096, 8_000, 1)], 0);
        let one = |weight| Connectivity::Dense { targets: 1, weights: [weight].into() };
        net.connect(teach, out, format(6, SignMode::Mixed, 8), 0, one(254));
        net.connect(input, out, format(0, SignMode::Mixed, 8), self.delay, one(10));
        let change = |text: &str| if text.is_empty() { Change::default() } else { parse(text).unwrap() };
        let rule = Rule::new(RuleText {
            changes: [self.dw, self.dd, ""].map(change),
            epoch: self.epoch,
            semantics: self.semantics,
            until: self.until,
            ..RuleText::default()
        });
        let id = ProjectionId(1);
        make_plastic(&mut net.parts, id, rule.unwrap());
        let plastic = Arc::make_mut(net.parts.projections[id].plastic.as_mut().unwrap());
        plastic.signals = [None, Some(reward).filter(|_| self.reward != 0), None];
        net.build()
    }

    fn sample(&self) -> Sample {
        let of = |steps: &'static [u32], channel| steps.iter().map(move |&step| (step, ChannelId(channel), 1));
        let reward = (3, ChannelId(2), self.reward);
        let events: Vec<_> = of(self.input, 0).chain(of(self.teach, 1)).chain([reward]).collect();
        Sample::with_values(self.steps, &events, None).unwrap()
    }

    /// The weight after each step and after `settle`.
    fn weights<E: Engine>(&self, engine: &mut E) -> Vec<i32> {
        let sample = self.sample();
        let weight = |engine: &E| engine.learned(RuleId(0), Column::Variable(Variable::Weight))[0];
        engine.begin(self.steps);
        let step = |step| {
            engine.step(sample.input(step));
            weight(engine)
        };
        let mut weights: Vec<i32> = (0..self.steps).map(step).collect();
        engine.settle();
        engine.settle();
        weights.push(weight(engine));
        weights
    }
}

/// Computed by hand. A spike of step s is noted in the call of step s + 1, an input of step s + 1,
/// too.
#[test]
fn weights_change_after_the_steps_in_which_spikes_are_noted() {
    use LearningSemantics::{Lava, Silicon};
    let until = Small { dw: "2*x0", epoch: 2, until: Some(4), input: &[0, 1, 2, 3, 4, 5], ..SMALL };
    for (small, weights, updates) in [
        // The input of step 0 is noted by no rule.
        (Small { dw: "4*x0", input: &[0, 1, 2, 4], ..SMALL }, vec![10, 14, 18, 18, 22, 22, 22], 3),
        // The last spike is noted once by `settle`.
        (Small { dw: "4*y0", teach: &[0, 5], ..SMALL }, vec![10, 14, 14, 14, 14, 14, 18], 2),
        // Epochs of two steps; the last one ends with `settle`.
        (Small { dw: "4*x0", epoch: 2, input: &[0, 1, 3, 4], ..SMALL }, vec![10, 10, 14, 14, 18, 18, 18], 2),
        (Small { dw: "4*u1", epoch: 2, steps: 8, ..SMALL }, vec![10, 10, 10, 10, 14, 14, 14, 14, 18], 2),
        (until, vec![10, 10, 12, 12, 14, 14, 14], 2),
        // An input of step 2 is noted in step 1, and over d = 3 in step 4, of the third epoch.
        (
            Small { dw: "4*x0", epoch: 2, delay: 3, input: &[2], semantics: Silicon, ..SMALL },
            vec![10, 10, 10, 10, 10, 10, 14],
            1,
        ),
        (
            Small { dw: "4*x0", epoch: 2, delay: 3, input: &[2], semantics: Lava, ..SMALL },
            vec![10, 10, 14, 14, 14, 14, 14],
            1,
        ),
        // The value of step 3.
        (Small { dw: "u0*y2", reward: -70, semantics: Silicon, ..SMALL }, vec![10, 10, 10, 10, -60, -60, -60], 6),
        (Small { dw: "u0*y2", reward: 7, ..SMALL }, vec![10, 10, 10, 10, 17, 17, 17], 6),
        (Small { dw: "2^-2*u0*(y2-400)", reward: 900, ..SMALL }, vec![10, -22, -54, -86, -54, -86, -118], 6),
    ] {
        let engine = &mut Golden::new(&small.network());
        let zeros = Use::ALL.into_iter().map(|of| (of, Vec::new())).collect();
        engine.set_draws(&Draws { recorded: IdVec::from(vec![Some(zeros)]).into(), ..Draws::default() });
        assert_eq!((small.weights(engine), engine.synaptic_updates()), (weights.clone(), updates), "{}", small.dw);
        // What was learned stays, or is forgotten.
        engine.begin(1);
        assert_eq!(engine.learned(RuleId(0), Column::Variable(Variable::Weight)), weights[weights.len() - 1..]);
        engine.forget(0);
        assert_eq!((small.weights(engine), engine.synaptic_updates()), (weights, updates), "{} again", small.dw);
    }
}

/// Computed by hand: the compartment's spike of step 1 changes the delay from 2 to 5, from the
/// delivery of step 3 on.
#[test]
fn a_spike_arrives_after_the_delay_of_its_delivery() {
    let moving =
        Small { dd: "3*y0", semantics: LearningSemantics::Silicon, delay: 2, input: &[1, 2, 3], teach: &[1], ..SMALL };
    for (steps, events) in [(9, 4), (8, 3), (4, 2)] {
        let small = Small { steps, ..moving };
        let mut engine = Golden::new(&small.network());
        let sample = small.sample();
        engine.begin(steps);
        for step in 0..steps {
            engine.step(sample.input(step));
            let u = match step {
                1 => 254 * 64 * 64,
                3 | 4 | 8 => 640,
                _ => 0,
            };
            assert_eq!(engine.u(CompartmentId(0)), u, "step {step}");
            let delay = if step < 2 { 2 } else { 5 };
            assert_eq!(engine.learned(RuleId(0), Column::Variable(Variable::Delay)), [delay], "step {step}");
        }
        assert_eq!(engine.totals().synaptic_events, events);
    }
}
