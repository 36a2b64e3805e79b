//! Random networks with random rules, and the comparison of two engines that learn.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use super::COLUMNS;
use crate::common::compare::{Shown, shown, small_cores};
use crate::common::random::Draw;
use crate::common::unsearched;
use crate::plastic::{plastic, sample};
use crate::ranks::{on_ranks, share};
use nsim::compile::{Options, compile};
use nsim::golden::Golden;
use nsim::ir::activity::{Activity, Overflow, Totals};
use nsim::ir::base::fixed::{Delay, MessageBits};
use nsim::ir::base::id::{ChannelId, Id, IdVec, PopulationId, ProjectionId, RuleId};
use nsim::ir::graph::Shape;
use nsim::ir::learning::draws::{Draws, Recorded, Use};
use nsim::ir::learning::{
    Change, Column, Factor, Graded, Impulse, LearningSemantics, Plastic, Quantity, Rule, RuleText, Tau, Trace,
    TraceSettings, Variable, parse,
};
use nsim::ir::neurons::NeuronKind;
use nsim::ir::quantised::{Parts, Population, Projection, Quantised, Units};
use nsim::ir::spikes::{Engine, Message, Sample};
use nsim::machine::{Image, Machine, Settings};
use nsim::quantise::copies::copies;
use nsim::session::Session;
use nsim_testing::{cases, few_or_all, sparse};
use rayon::prelude::*;

/// A random change: one to three products of what the semantics have, that fit the widths.
fn change(draw: &mut Draw, slow: i64, semantics: LearningSemantics) -> String {
    let mut text = String::new();
    for count in 0..draw.from(1, 3) {
        let sign = if draw.chance(50) { "-" } else { ["", "+"][usize::from(count > 0)] };
        let (mantissa, exponent) = (draw.from(1, 7), draw.one_of(&[-7, -5, -4, -3, -2, -1, 0, 0, 1, 3, 8]));
        let when = match draw.from(0, 4) {
            0 | 1 => "x0".to_string(),
            2 | 3 => "y0".to_string(),
            _ => format!("u{slow}"),
        };
        text += &format!("{sign}{mantissa}*2^{exponent}*{when}");
        let mut bits = 4;
        for _ in 0..draw.from(0, 3) {
            let names = ["x1", "x2", "x1", "y1", "y2", "y3", "y1", "w", "x0", "y0", "d", "t", "r1"];
            let count = match semantics {
                LearningSemantics::Silicon => 13,
                LearningSemantics::Brian => 10,
                _ => 12,
            };
            let name = draw.one_of(&names[..count]);
            // x0 and y0 beside u would be the dependency.
            if when.starts_with('u') && name.ends_with('0') {
                continue;
            }
            bits += if name.ends_with('0') {
                1
            } else if name.len() == 2 {
                7
            } else {
                9
            };
            if bits > 31 {
                break;
            }
            let plus = draw.one_of(&[-300, -64, -5, 3, 40]);
            text += &match draw.from(0, 5) {
                0 if !name.ends_with('0') => format!("*({name}{plus:+})"),
                1 if name.len() == 1 => format!("*sgn({name}{plus:+})"),
                _ => format!("*{name}"),
            };
        }
    }
    text
}

/// A random trace; in Brian's semantics of whole numbers.
fn trace(draw: &mut Draw, semantics: LearningSemantics) -> TraceSettings {
    let is_brian = semantics == LearningSemantics::Brian;
    let impulses = if is_brian { [0.0, 1.0, 16.0, 24.0, 90.0, 127.0] } else { [0.0, 1.5, 16.0, 24.3, 90.0, 127.998] };
    let taus = if is_brian { [1.0, 2.0, 6.0, 10.0, 25.0, 200.0] } else { [0.0, 1.0, 5.0, 10.0, 25.5, 200.0] };
    let (impulse, tau) = (draw.one_of(&impulses), draw.one_of(&taus));
    TraceSettings { impulse: Impulse::try_from(impulse).unwrap(), tau: Tau::try_from(tau).unwrap() }
}

/// A random rule, PES only for pairs of targets. Delays that act change only where `moves`.
fn rule(draw: &mut Draw, moves: bool, targets: u32) -> Rule {
    use LearningSemantics::{Brian, Lava, Nengo, Silicon};
    let until = draw.chance(20).then(|| draw.from(0, 60) as u32);
    if targets > 0 && targets.is_multiple_of(2) && draw.chance(25) {
        return Rule::pes(trace(draw, Nengo), until);
    }
    let semantics = draw.one_of(&[Silicon, Silicon, Lava, Lava, Brian]);
    let is_brian = semantics == Brian;
    let slow = draw.one_of(&[0, 0, 1, 2]);
    // A sum of products may be too large for Brian's semantics.
    loop {
        let others = [draw.chance(40) && (moves || !semantics.delays_act()), draw.chance(40)];
        let changed = [draw.chance(90), !is_brian && others[0], !is_brian && others[1]];
        let mut texts = changed.map(|changes| if changes { change(draw, slow, semantics) } else { String::new() });
        if draw.chance(30) {
            texts[0] = format!("2^-2*x1*y0 - 2^-2*y1*x0 + 2*u{slow}");
        }
        let mut text = RuleText {
            changes: texts.map(|text| if text.is_empty() { Change::default() } else { parse(&text).unwrap() }),
            epoch: if is_brian { 1 } else { draw.one_of(&[1, 1, 2, 3, 4, 7, 8, 16, 63]) },
            traces: Trace::ALL.map(|_| trace(draw, semantics)),
            semantics,
            graded: if is_brian || draw.chance(70) { Graded::Regular } else { draw.one_of(&Graded::ALL) },
            until,
        };
        if semantics != Silicon {
            text.traces[Trace::R1.index()] = TraceSettings::default();
        }
        match Rule::new(text) {
            Ok(rule) => return rule,
            Err(problem) => assert!(is_brian && problem.message.contains("add up to"), "{problem}"),
        }
    }
}

/// Adds an input population of one of these sizes that may be a signal of a projection.
fn signal(parts: &mut Parts, draw: &mut Draw, sizes: &[u32]) -> PopulationId {
    let inputs = parts.populations.iter().filter(|population| matches!(population.units, Units::Input(_)));
    let channels: u32 = inputs.map(|population| population.shape.len()).sum();
    let name = format!("signal{}", parts.populations.len());
    let shape = Shape::Line(draw.one_of(sizes));
    let message = if draw.chance(30) { Message::Spike } else { Message::Value(MessageBits::new(12).unwrap()) };
    parts.populations.push(Population { name, shape, units: Units::Input(ChannelId(channels)), message })
}

/// A second projection of a rule: from the same sources with another delay, or from others.
fn sibling(parts: &Parts, draw: &mut Draw, id: ProjectionId) -> Projection {
    let own = &parts.projections[id];
    let same_sources = draw.chance(50);
    let other = PopulationId(draw.from(0, parts.populations.len() as i64 - 1) as u32);
    let source = if same_sources { own.source } else { other };
    let targets = i64::from(parts.populations[own.target].shape.len());
    let list = |_| {
        let mut reached: Vec<u32> =
            (0..draw.from(0, 4)).filter(|_| targets > 0).map(|_| draw.from(0, targets - 1) as u32).collect();
        reached.sort_unstable();
        reached.into_iter().map(|target| (target, draw.weight(own.format))).collect()
    };
    let connectivity = sparse((0..parts.populations[source].shape.len()).map(list));
    let delay = Delay::new((i64::from(own.delay.get()) + 5) % 63).unwrap();
    let first_source = if same_sources { 0 } else { parts.populations[own.source].shape.len() };
    let plastic = Plastic { first_source, ..Plastic::clone(own.plastic.as_ref().unwrap()) };
    Projection {
        name: format!("{} again", own.name),
        source,
        delay,
        connectivity,
        plastic: Some(plastic.into()),
        ..own.clone()
    }
}

/// Gives the projections of a rule its rows, from the last synapse or the first, and first tags and
/// delays.
fn set_synapses(
    parts: &mut Parts,
    draw: &mut Draw,
    ids: &[ProjectionId],
    rule: &Rule,
    signals: [Option<PopulationId>; 3],
) {
    let population = draw.from(0, parts.populations.len() as i64 - 1) as u32;
    let reward =
        (rule.semantics() == LearningSemantics::Silicon && draw.chance(60)).then_some(PopulationId(population));

    let count = |id: &ProjectionId| {
        let projection = &parts.projections[*id];
        projection.connectivity.count(parts.populations[projection.source].shape.len().into()) as u32
    };
    let counts: Vec<u32> = ids.iter().map(count).collect();
    let all: u32 = counts.iter().sum();
    let (backward, has_tags) = (draw.chance(50), draw.chance(40));
    let has_delays = draw.chance(40) && !rule.semantics().delays_act();
    let mut first = 0;
    for (&id, count) in ids.iter().zip(counts) {
        let values = |draw: &mut Draw, (low, high): (i32, i32), has: bool| -> Vec<i16> {
            (0..if has { count } else { 0 }).map(|_| draw.from(low.into(), high.into()) as i16).collect()
        };
        let rows = (first..first + count).map(|row| if backward { all - 1 - row } else { row }).collect();
        first += count;
        let tags = values(draw, rule.semantics().tags(), has_tags).into();
        let delays = values(draw, rule.semantics().delays(), has_delays).into();
        let own = Arc::make_mut(parts.projections[id].plastic.as_mut().unwrap());
        *own = Plastic { rows, tags, delays, signals, reward, ..own.clone() };
    }
}

/// A random network of any kinds with random rules, and random numbers, which are recorded for some
/// of them.
pub fn random_plastic(seed: u64) -> (Quantised, Draws) {
    let mut network = plastic(seed);
    let draw = &mut Draw::new(seed ^ 0x1ea2);
    let ids: Vec<ProjectionId> = network.plastic().map(|(id, _)| id).collect();
    for id in ids {
        let mut parts = network.parts().clone();
        let own = &parts.projections[id];
        let (of_rule, targets) = (own.format.rule.unwrap(), parts.populations[own.target].shape.len());
        let rule = rule(draw, own.format.apart.is_none(), targets);
        let mut signals = [None; 3];
        if rule.is_pes() {
            signals[0] = Some(signal(&mut parts, draw, &[targets / 2]));
        } else if rule.semantics() != LearningSemantics::Brian {
            for place in &mut signals {
                *place = draw.chance(12).then(|| signal(&mut parts, draw, &[1, targets]));
            }
        }
        parts.rules[of_rule].rule = rule.clone();
        let without = parts.clone();
        let mut joined = vec![id];
        if draw.chance(30) {
            let other = sibling(&parts, draw, id);
            joined.push(parts.projections.push(other));
        }
        set_synapses(&mut parts, draw, &joined, &rule, signals);
        network = Quantised::new(parts).unwrap_or_else(|_| {
            let mut parts = without;
            set_synapses(&mut parts, draw, &[id], &rule, signals);
            Quantised::new(parts).unwrap()
        });
    }
    let mut numbers = |rule: &Rule, of: Use| -> Vec<f64> {
        let count = match of {
            Use::Trace | Use::Weight => 900,
            _ if of.is_of_steps() => 90,
            _ => 90 / rule.epoch(),
        };
        (0..count)
            .map(|_| if of.is_whole() { draw.from(0, 127) as f64 } else { draw.from(0, 999) as f64 / 1e3 })
            .collect()
    };
    let rules = network.parts().rules.iter();
    let recorded = rules.enumerate().map(|(number, learning)| {
        let is_recorded = seed.is_multiple_of(3)
            && number.is_multiple_of(2)
            && matches!(learning.rule.semantics(), LearningSemantics::Lava | LearningSemantics::Nengo);
        is_recorded.then(|| Use::ALL.into_iter().map(|of| (of, numbers(&learning.rule, of))).collect())
    });
    let recorded: Vec<Option<Recorded>> = recorded.collect();
    (network, Draws { seed, recorded: IdVec::from(recorded).into(), of_step: false })
}

/// All columns of all rules.
type Columns = Vec<Vec<i32>>;

/// What an engine shows of a sample in which rules learn.
#[derive(Debug, PartialEq)]
pub struct Learned {
    /// After each step.
    steps: Vec<(Shown, Columns)>,
    /// After the last one's learning.
    settled: Columns,
    totals: Totals,
    overflow: Overflow,
    updates: u64,
}

impl Learned {
    /// Panics at the first difference, without printing all values.
    pub fn assert_same(&self, other: &Learned, what: &str) {
        assert_eq!(self.steps.len(), other.steps.len(), "{what}: steps");
        for (step, (meant, found)) in self.steps.iter().zip(&other.steps).enumerate() {
            assert_eq!(meant.0.0, found.0.0, "{what}: messages of step {step}");
            let word = meant.0.1.iter().zip(&found.0.1).position(|(meant, found)| meant != found);
            assert!(word.is_none(), "{what}: step {step}, word {word:?}");
            same_columns(&meant.1, &found.1, &format!("{what}: step {step}"));
        }
        same_columns(&self.settled, &other.settled, &format!("{what}: settled"));
        let counts = |learned: &Learned| (learned.totals, learned.overflow, learned.updates);
        assert_eq!(counts(self), counts(other), "{what}: counts");
    }
}

fn same_columns(meant: &Columns, found: &Columns, what: &str) {
    assert_eq!(meant.len(), found.len());
    for (number, (meant, found)) in meant.iter().zip(found).enumerate() {
        let (rule, column) = (number / COLUMNS.len(), COLUMNS[number % COLUMNS.len()].0);
        assert_eq!(meant, found, "{what}: {column} of rule {rule}");
    }
}

fn learned(engine: &dyn Engine, network: &Quantised) -> Columns {
    let of_rule = |rule| COLUMNS.map(|(_, column)| engine.learned(rule, column));
    network.parts().rules.ids().flat_map(of_rule).collect()
}

/// Runs a sample; silence is skipped where the engine can.
fn record(engine: &mut dyn Engine, network: &Quantised, sample: &Sample) -> Learned {
    let neurons = network.populations().iter().flat_map(Population::each_neuron);
    let kinds: Vec<NeuronKind> = neurons.map(|neuron| neuron.kind).collect();
    engine.begin(sample.steps());
    let mut steps = Vec::new();
    for step in 0..sample.steps() {
        if !sample.at(step).is_empty() || !engine.skip_idle(1) {
            engine.step(sample.input(step));
        }
        steps.push((shown(engine, &kinds), learned(engine, network)));
    }
    engine.settle();
    let (totals, overflow, updates) = (engine.totals(), engine.overflow(), engine.synaptic_updates());
    Learned { steps, settled: learned(engine, network), totals, overflow, updates }
}

/// Runs samples, of which each begins with what the one before learned, then the first one again,
/// without that and as another run.
pub fn learn(engine: &mut dyn Engine, (network, draws): (&Quantised, &Draws), samples: &[Sample]) -> Vec<Learned> {
    engine.set_draws(draws);
    engine.forget(0);
    let mut all: Vec<Learned> = samples.iter().map(|sample| record(engine, network, sample)).collect();
    engine.forget(7);
    all.push(record(engine, network, &samples[0]));
    all
}

/// A sample several times in a row.
fn longer(sample: &Sample, times: u32) -> Sample {
    let spikes = (0..times * sample.steps()).flat_map(|step| {
        let input = sample.input(step % sample.steps());
        let values = input.values.iter().copied().chain(std::iter::repeat(1));
        input.ids.iter().zip(values).map(move |(&channel, value)| (step, channel, value))
    });
    Sample::with_values(times * sample.steps(), &spikes.collect::<Vec<_>>(), None).unwrap()
}

/// Two samples of a network, of which the second may be long.
pub fn samples(network: &Quantised, seed: u64) -> [Sample; 2] {
    let [first, second] = [0, 0x5a5a].map(|other| sample(network, seed ^ other));
    // Late spikes and traces are kept for 128 steps.
    let long = if seed % 4 == 1 { longer(&second, 5) } else { second };
    [first, long]
}

#[test]
fn random_rules_change_weights_delays_and_tags() {
    let tried: Vec<_> = (0..cases(120))
        .into_par_iter()
        .map(|seed| {
            let (network, draws) = random_plastic(seed);
            let golden = &mut Golden::new(&network);
            let all = learn(golden, (&network, &draws), &samples(&network, seed));
            let again = learn(golden, (&network, &draws), &samples(&network, seed));
            let what = format!("network {seed}, again");
            all.iter().zip(&again).for_each(|(first, again)| first.assert_same(again, &what));
            let (first, settled) = (&all[0].steps.first().unwrap().1, &all[1].settled);
            let changed = [0, 1, 2]
                .map(|column| (0..settled.len()).any(|i| i % COLUMNS.len() == column && first[i] != settled[i]));
            let rules = network.parts().rules.iter().map(|learning| &learning.rule);
            let moves = rules.clone().any(|r| r.semantics().delays_act() && r.changes(Variable::Delay)) && changed[1];
            let has_signals = |projection: &Projection| projection.plastic.as_ref().unwrap().signals != [None; 3];
            let signals = network.plastic().any(|(_, projection)| has_signals(projection));
            let siblings = network.plastic().count() > network.parts().rules.len();
            let graded = rules.clone().any(|rule| rule.graded() != Graded::Regular);
            // Another run has other random numbers.
            let differs = all[0].settled != all[2].settled;
            let updates: u64 = all.iter().map(|learned| learned.updates).sum();
            let pes = rules.clone().any(Rule::is_pes);
            let is_r1 = |factor: &Factor| factor.of == Quantity::Trace(Trace::R1);
            let has_r1 = |rule: &Rule| rule.all_products().any(|product| product.factors.iter().any(is_r1));
            let is_rewarded = |(_, projection): (_, &Projection)| {
                projection.plastic.as_ref().is_some_and(|plastic| {
                    plastic.reward.is_some() && has_r1(&network.parts().rules[plastic.rule].rule)
                })
            };
            let rewards = network.plastic().any(is_rewarded);
            let brian = rules.clone().any(|rule| rule.semantics() == LearningSemantics::Brian);
            let [w, d, t] = changed;
            let flags = [w, d, t, moves, signals, siblings, graded, differs, pes, rewards, brian];
            (flags, updates, all.iter().map(|learned| learned.totals.spikes).sum::<u64>())
        })
        .collect();
    let networks = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10].map(|flag| tried.iter().filter(|tried| tried.0[flag]).count());
    let updates: u64 = tried.iter().map(|tried| tried.1).sum();
    let spikes: u64 = tried.iter().map(|tried| tried.2).sum();
    let least = [160, 65, 100, 45, 110, 100, 60, 160, 60, 30, 40].map(|least| least * tried.len() / 200);
    let enough = networks.iter().zip(least).all(|(found, least)| *found >= least);
    assert!(
        enough && updates > 1_000_000 && spikes > 100_000,
        "{networks:?} of {}, {updates} updates, {spikes} spikes",
        tried.len()
    );
}

/// The machine equals golden in 1, 2 and 8 shards, with skipping and without. Counts by core add up,
/// and those of each step where they are asked for.
#[test]
fn random_rules_act_alike_in_both_engines() {
    // The rule of 208 has traces and no products.
    let updates: u64 = (0..few_or_all(134, 500))
        .into_par_iter()
        .chain([208])
        .map(|seed| {
            let (network, draws) = random_plastic(seed);
            let samples = samples(&network, seed);
            let expected = learn(&mut Golden::new(&network), (&network, &draws), &samples);
            let compiled = compile(network.clone(), &small_cores("oheo-gulch", 7), &unsearched()).unwrap();
            let total = |of: fn(&Learned) -> u64| expected.iter().map(of).sum::<u64>();
            let (events, updates) = (total(|learned| learned.totals.synaptic_events), total(|learned| learned.updates));
            let mut counts: Option<Activity> = None;
            for shards in [1, 2, 8] {
                let image = Image::new(&compiled.program, shards).unwrap();
                for (skip, per_step) in [(true, false), (false, true)] {
                    let what = format!("network {seed}, {shards} shards, skip {skip}");
                    let mut machine = Machine::new(&image, Settings { skip, per_step });
                    let found = learn(&mut machine, (&network, &draws), &samples);
                    expected.iter().zip(&found).for_each(|(meant, found)| meant.assert_same(found, &what));
                    let activity = machine.take_activity();
                    let sum = activity.sum();
                    let counted = (sum.events_dense + sum.events_sparse, sum.synaptic_updates);
                    assert_eq!(counted, (events, updates), "{what}: counts by core");
                    assert_eq!(*counts.get_or_insert_with(|| activity.clone()), activity, "{what}: counts by core");
                }
            }
            updates
        })
        .sum();
    assert!(updates > 1_000_000, "{updates} updates");
}

/// Copies draw alike, and each learns for itself.
#[test]
fn copies_learn_alike() {
    let updates: u64 = (0..cases(60))
        .into_par_iter()
        .map(|seed| {
            let (network, draws) = random_plastic(seed);
            let two = copies(&network, 2).unwrap();
            let one = samples(&network, seed);
            let of_two = one.clone().map(|sample| sample.copies(2, network.channels()));
            let expected = learn(&mut Golden::new(&network), (&network, &draws), &one);
            let found = learn(&mut Golden::new(&two), (&two, &draws), &of_two);
            for (meant, found) in expected.iter().zip(&found) {
                assert_eq!(2 * meant.updates, found.updates, "network {seed}");
                assert_eq!(meant.settled, found.settled, "network {seed}");
                for ((meant, columns), (found, columns_of_two)) in meant.steps.iter().zip(&found.steps) {
                    assert_eq!((&meant.1.repeat(2), columns), (&found.1, columns_of_two), "network {seed}");
                }
            }
            expected.iter().map(|learned| learned.updates).sum::<u64>()
        })
        .sum();
    assert!(updates > 100_000, "{updates} updates");
}

/// Spikes of every rank, and the sum of their counts and columns, equal golden's on 2 and 4 ranks.
#[test]
fn random_rules_act_alike_on_any_number_of_ranks() {
    let updates: u64 = (0..few_or_all(27, 500))
        .map(|seed| {
            let (network, draws) = random_plastic(seed);
            let sample = &samples(&network, seed)[0];
            let samples = std::slice::from_ref(sample);
            let expected = learn(&mut Golden::new(&network), (&network, &draws), samples);
            for count in [2, 4] {
                let sum = Mutex::new((Totals::default(), 0, Vec::<Vec<Vec<i32>>>::new()));
                on_ranks(count, |rank, ranks| {
                    let options = Options { share: share(rank, count, false), ..unsearched() };
                    let compiled = compile(network.clone(), &small_cores("oheo-gulch", 7), &options).unwrap();
                    let image = Image::new(&compiled.program, 1).unwrap();
                    let settings = Settings { skip: seed % 2 == 0, per_step: false };
                    let mut machine = Machine::of_part(&image, settings, ranks.unwrap(), None);
                    machine.set_draws(&draws);
                    machine.forget(0);
                    machine.begin(sample.steps());
                    (0..sample.steps()).for_each(|step| machine.step(sample.input(step)));
                    machine.settle();
                    let mut sum = sum.lock().unwrap();
                    sum.0 += machine.totals();
                    sum.1 += machine.synaptic_updates();
                    let weights = |rule| machine.learned(rule, Column::Variable(Variable::Weight));
                    sum.2.push(network.parts().rules.ids().map(weights).collect());
                });
                let (totals, updates, of_ranks) = sum.into_inner().unwrap();
                let what = format!("network {seed} on {count} ranks");
                assert_eq!((totals, updates), (expected[0].totals, expected[0].updates), "{what}");
                for (rule, meant) in expected[0].settled.iter().step_by(COLUMNS.len()).enumerate() {
                    let mut found = vec![0; meant.len()];
                    for of_rank in &of_ranks {
                        found.iter_mut().zip(&of_rank[rule]).for_each(|(sum, value)| *sum += value);
                    }
                    assert_eq!(*meant, found, "{what}: weights of rule {rule}");
                }
            }
            expected[0].updates
        })
        .sum();
    assert!(updates > 50_000, "{updates} updates");
}

/// Numbers of each rule and use that were given.
type Given = BTreeMap<(usize, Use), usize>;

/// Gives a session the recorded numbers that its next step takes; beyond the end of a recording
/// they are 0.
fn give_numbers(session: &mut Session, draws: &Draws, given: &mut Given) -> bool {
    let mut any = false;
    for (rule, recorded) in draws.recorded.iter().enumerate() {
        let Some(recorded) = recorded else { continue };
        let mut numbers = Recorded::new();
        for (of, count) in session.draws_needed(RuleId::new(rule)).unwrap() {
            let first = given.entry((rule, of)).or_default();
            let number = |place| recorded[&of].get(place).copied().unwrap_or(0.0);
            numbers.insert(of, (*first..*first + count as usize).map(number).collect());
            *first += count as usize;
            any |= count > 0;
        }
        session.set_draws(RuleId::new(rule), numbers).unwrap();
    }
    any
}

/// Steps a session through a sample from a step on, and compares it with a run.
fn step_as(
    session: &mut Session,
    network: &Quantised,
    (sample, draws): (&Sample, &Draws),
    given: &mut Given,
    (expected, what): (&Learned, &str),
) -> u64 {
    let neurons = network.populations().iter().flat_map(Population::each_neuron);
    let kinds: Vec<NeuronKind> = neurons.map(|neuron| neuron.kind).collect();
    let mut steps_with_numbers = 0;
    for step in session.steps()..sample.steps() {
        if give_numbers(session, draws, given) {
            steps_with_numbers += 1;
        }
        let input = sample.input(step);
        let values = input.values.iter().copied().chain(std::iter::repeat(1));
        let mut all: Vec<(ChannelId, i32)> = input.ids.iter().copied().zip(values).collect();
        if !all.is_empty() || !session.skip(1) {
            // Messages that are set before the step are like those of the step.
            session.set_next(all.pop()).unwrap();
            session.step(all).unwrap();
        }
        let (messages, columns) = &expected.steps[step as usize];
        let (found, meant) = (shown(session.engine_mut(), &kinds), learned(session.engine(), network));
        assert!(found == *messages, "{what}: messages and words of step {step}");
        same_columns(columns, &meant, &format!("{what}: step {step}"));
    }
    steps_with_numbers
}

/// A session equals runs of its samples, between which it is reset, and a snapshot has all that it
/// learned. Recorded numbers are given step by step.
#[test]
fn sessions_learn_as_runs_do_and_continue_from_snapshots() {
    let steps_with_numbers: u64 = (0..cases(90))
        .into_par_iter()
        .map(|seed| {
            let (network, draws) = random_plastic(seed);
            let samples = samples(&network, seed);
            let expected = learn(&mut Golden::new(&network), (&network, &draws), &samples);
            let compiled = compile(network.clone(), &small_cores("oheo-gulch", 7), &unsearched()).unwrap();
            let image = Image::new(&compiled.program, 1 + seed as usize % 2).unwrap();
            let mut session = Session::open(&image, &network, 1);
            session.set_seed(draws.seed);
            let mut steps_with_numbers = 0;
            let mut run = |session: &mut Session, sample: usize, given: &mut Given, what: &str| {
                let (what, input) = (format!("network {seed}, {what}"), (&samples[sample], &draws));
                steps_with_numbers += step_as(session, &network, input, given, (&expected[sample], &what));
            };
            for what in ["first", "again, all reset"] {
                let mut given = Given::new();
                run(&mut session, 0, &mut given, what);
                give_numbers(&mut session, &draws, &mut given);
                session.reset().unwrap();
                // Traces are 0 after a reset.
                let found = learned(session.engine(), &network);
                let variables = (0..found.len()).filter(|column| column % COLUMNS.len() < 3);
                variables.for_each(|column| assert!(found[column] == expected[0].settled[column], "network {seed}"));
                let mut given = Given::new();
                let beginning = samples[1].beginning(samples[1].steps() / 2);
                step_as(&mut session, &network, (&beginning, &draws), &mut given, (&expected[1], "beginning"));
                let middle = (session.clone(), given.clone());
                run(&mut session, 1, &mut given, "second sample");
                (session, given) = middle;
                run(&mut session, 1, &mut given, "second sample from its middle");
                session.reset_all();
            }
            steps_with_numbers
        })
        .sum();
    assert!(steps_with_numbers > 1_000, "{steps_with_numbers} steps");
}
