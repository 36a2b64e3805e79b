//! Recordings of lava-nc 0.10.0, single connections of its own class and networks of its runtime,
//! and of nengo-loihi 1.1.0's emulator, with the random numbers that they used.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use super::COLUMNS;
use crate::common::compare::roomy;
use crate::common::{Archive, Array, Builder, biased, data, neuron, unsearched};
use nsim::compile::compile;
use nsim::golden::Golden;
use nsim::ir::arithmetic::Semantics;
use nsim::ir::base::fixed::{MessageBits, SignMode};
use nsim::ir::base::id::{ChannelId, CompartmentId, IdVec, PopulationId, RuleId};
use nsim::ir::graph::Shape;
use nsim::ir::learning::draws::{Draws, Recorded, Use};
use nsim::ir::learning::{
    Change, Column, Graded, LearningSemantics, Plastic, Rule, RuleText, Trace, TraceSettings, Variable, parse,
};
use nsim::ir::quantised::Quantised;
use nsim::ir::quantised::connectivity::Connectivity;
use nsim::ir::spikes::{Engine, Message, Sample};
use nsim::machine::{Image, Machine, Settings};
use nsim_testing::{format, make_plastic, sparse};
use serde::Deserialize;

/// A connection as the recordings describe it.
#[derive(Deserialize)]
struct Connection {
    #[serde(default)]
    name: String,
    #[serde(default)]
    from: String,
    #[serde(default)]
    to: String,
    rule: BTreeMap<String, String>,
    traces: BTreeMap<String, TraceSettings>,
    epoch: u8,
    sign: SignMode,
    weight_bits: i64,
    weight_exp: i64,
    graded: Graded,
    #[serde(default)]
    sources: u32,
    #[serde(default)]
    targets: u32,
    #[serde(default)]
    steps: u32,
}

impl Connection {
    fn rule(&self) -> Rule {
        let change = |name| self.rule.get(name).map_or(Change::default(), |text| parse(text).unwrap());
        Rule::new(RuleText {
            changes: ["dw", "dd", "dt"].map(change),
            epoch: self.epoch,
            traces: Trace::ALL.map(|trace| self.traces.get(trace.name()).copied().unwrap_or_default()),
            semantics: LearningSemantics::Lava,
            graded: self.graded,
            until: None,
        })
        .unwrap()
    }

    /// Adds the connection with its first values, of which `prefix` begins the names. Rows are in
    /// the order target, source.
    fn connect(
        &self,
        net: &mut Builder,
        ends: (PopulationId, PopulationId),
        exponent: i64,
        archive: &Archive,
        prefix: &str,
    ) -> RuleId {
        let [w, d, t] = ["w0", "d0", "t0"].map(|name| archive.array(&format!("{prefix}{name}")));
        let format = format(exponent, self.sign, self.weight_bits);
        net.connect(ends.0, ends.1, format, 0, dense(&w, |w| cut(w, self.sign, self.weight_bits)));
        let id = net.parts.projections.ids().last().unwrap();
        let rule = make_plastic(&mut net.parts, id, self.rule());
        let [targets, sources] = [w.shape[0] as u32, w.shape[1] as u32];
        net.parts.projections[id].plastic = Some(Arc::new(Plastic {
            rule,
            first_source: 0,
            rows: (0..sources * targets).map(|number| number % targets * sources + number / targets).collect(),
            tags: by_source(&t, |t| t).into(),
            delays: by_source(&d, |d| d).into(),
            signals: [None; 3],
            reward: None,
        }));
        rule
    }
}

/// Values `[source][target]` of an array `[target][source]`.
fn by_source(array: &Array, change: impl Fn(i64) -> i64) -> Vec<i16> {
    let (targets, sources) = (array.shape[0], array.shape[1]);
    let places = (0..sources).flat_map(|source| (0..targets).map(move |target| [target, source]));
    places.map(|place| change(array.at(place)) as i16).collect()
}

fn dense(weights: &Array, change: impl Fn(i64) -> i64) -> Connectivity {
    Connectivity::Dense { targets: weights.shape[0] as u32, weights: by_source(weights, change).into() }
}

/// A first weight, cut to its bits: down, or toward zero where it inhibits.
fn cut(weight: i64, sign: SignMode, bits: i64) -> i64 {
    let step = 1 << (8 - bits + i64::from(sign == SignMode::Mixed));
    if sign == SignMode::Inhibitory { weight / step * step } else { weight.div_euclid(step) * step }
}

fn recorded(archive: &Archive, prefix: &str) -> Option<Recorded> {
    let names = Use::ALL.into_iter().map(|of| (of, format!("{prefix}{}", of.name())));
    Some(names.filter(|(_, name)| archive.has(name)).map(|(of, name)| (of, archive.reals(&name))).collect())
}

/// What a recording has a row of for each step.
enum Read {
    /// After the learning of the step.
    Column(RuleId, Column),
    Spikes(PopulationId),
    U(PopulationId),
    V(PopulationId),
}

/// A network with its input, its random numbers and the values that were recorded.
struct Recording {
    name: String,
    network: Quantised,
    draws: Draws,
    sample: Sample,
    values: Vec<(Read, Array)>,
}

/// Number of compared values and of differing ones, and the first of these.
#[derive(Default)]
struct Compared {
    values: u64,
    differ: u64,
    first: Option<String>,
}

impl Compared {
    /// Compares the values of a step.
    fn row(&mut self, recording: &Recording, step: u32, engine: &dyn Engine, is_settled: bool) {
        for (number, (read, array)) in recording.values.iter().enumerate() {
            // The call of step s mostly shows the learning after step s - 1, and `settle` that
            // after the last.
            let lag = match read {
                Read::Column(rule, _) => recording.network.parts().rules[*rule].rule.lag(),
                _ => 0,
            };
            let Some(step) = step.checked_sub(if is_settled { 0 } else { lag }) else { continue };
            if is_settled && lag == 0 || step as usize >= array.shape[0] {
                continue;
            }
            let population = |id: PopulationId| {
                let population = &recording.network.populations()[id];
                let first = population.first_compartment().unwrap().0;
                (first..first + population.shape.len()).map(CompartmentId)
            };
            let found: Vec<i32> = match *read {
                Read::Column(rule, column) => engine.learned(rule, column),
                Read::Spikes(id) => population(id).map(|id| engine.spikes().contains(&id).into()).collect(),
                Read::U(id) => population(id).map(|id| engine.u(id)).collect(),
                Read::V(id) => population(id).map(|id| engine.v(id)).collect(),
            };
            let size: usize = array.shape[1..].iter().product();
            let expected = &array.values[step as usize * size..][..size];
            assert_eq!(found.len(), size, "{}: array {number}", recording.name);
            let differ = found.iter().zip(expected).filter(|&(&found, &meant)| i64::from(found) != meant).count();
            self.values += size as u64;
            self.differ += differ as u64;
            if differ > 0 {
                let what = format!("{}, array {number}, step {step}: {found:?}, not {expected:?}", recording.name);
                self.first.get_or_insert(what);
            }
        }
    }
}

/// Compares an engine with a recording, step by step.
fn compare<E: Engine>(engine: &mut E, recording: &Recording, compared: &mut Compared) {
    engine.set_draws(&recording.draws);
    engine.forget(0);
    engine.begin(recording.sample.steps());
    for step in 0..recording.sample.steps() {
        engine.step(recording.sample.input(step));
        compared.row(recording, step, engine, false);
    }
    engine.settle();
    compared.row(recording, recording.sample.steps() - 1, engine, true);
}

/// The recorded columns of a rule.
fn columns<'a>(rule: RuleId, archive: &'a Archive, prefix: &'a str) -> impl Iterator<Item = (Read, Array)> + 'a {
    let named = COLUMNS.into_iter().map(move |(name, column)| (format!("{prefix}{name}"), column));
    let recorded = named.filter(|(name, _)| archive.has(name));
    recorded.map(move |(name, column)| (Read::Column(rule, column), archive.array(&name)))
}

/// A single connection. What it receives in step t is entry t + 1 of `in`; entry t of `teach` makes
/// `out` spike.
fn connection(folder: &Path, case: &Connection) -> Recording {
    let archive = Archive::read(&folder.join(format!("{}.npz", case.name)));
    let mut net = Builder::new();
    let (input, teach) = (net.input("in", case.sources), net.input("teach", case.targets));
    let bits = |bits| Message::Value(MessageBits::new(bits).unwrap());
    net.parts.populations[input].message = bits(10);
    let third = archive.has("third").then(|| archive.array("third"));
    let signals = ["y1", "y2", "y3"].map(|name| {
        third.as_ref()?;
        let signal = net.input(name, case.targets);
        net.parts.populations[signal].message = bits(17);
        Some(signal)
    });
    let neurons = vec![neuron(4096, 4096, 8_000, 1); case.targets as usize];
    let out = net.each("out", Shape::Line(case.targets), &neurons, 0);
    let one_to_one = sparse((0..case.targets).map(|target| vec![(target, 254)]));
    net.connect(teach, out, format(6, SignMode::Mixed, 8), 0, one_to_one);
    let rule = case.connect(&mut net, (input, out), -8, &archive, "");
    let id = net.parts.projections.ids().last().unwrap();
    Arc::make_mut(net.parts.projections[id].plastic.as_mut().unwrap()).signals = signals;

    let [pre, post] = ["pre", "post"].map(|name| archive.array(name));
    let (n, m) = (case.sources as usize, case.targets as usize);
    let mut events = Vec::new();
    for step in 0..case.steps {
        let of = |first: usize, units: usize, array: &Array, row: usize| {
            let values = array.values[row * units..][..units].to_vec();
            values.into_iter().enumerate().map(move |(unit, value)| (ChannelId((first + unit) as u32), value as i32))
        };
        events.extend(of(0, n, &pre, step as usize).map(|(channel, value)| (step + 1, channel, value)));
        events.extend(of(n, m, &post, step as usize).map(|(channel, value)| (step, channel, value)));
        for (k, third) in third.iter().flat_map(|third| [0, 1, 2].map(|k| (k, third))) {
            let row = k * case.steps as usize + step as usize;
            events.extend(of(n + m + k * m, m, third, row).map(|(channel, value)| (step, channel, value)));
        }
    }
    let mut values: Vec<_> = columns(rule, &archive, "").collect();
    values.push((Read::Spikes(out), post));
    let recorded = IdVec::from(vec![recorded(&archive, "")]);
    Recording {
        name: case.name.clone(),
        network: net.build(),
        draws: Draws { recorded: recorded.into(), ..Draws::default() },
        sample: Sample::with_values(case.steps + 1, &events, None).unwrap(),
        values,
    }
}

fn connections(folder: &Path) -> Vec<Recording> {
    let text = std::fs::read_to_string(folder.join("cases.json")).unwrap();
    let cases: Vec<Connection> = serde_json::from_str(&text).unwrap();
    cases.iter().map(|case| connection(folder, case)).collect()
}

#[derive(Deserialize)]
struct Net {
    name: String,
    steps: u32,
    populations: Vec<NetPopulation>,
    r#static: Vec<Static>,
    plastic: Vec<Connection>,
}

#[derive(Deserialize)]
struct NetPopulation {
    name: String,
    n: u32,
    /// Decays, threshold and biases of compartments.
    #[serde(default)]
    bias_mant: Vec<i64>,
    #[serde(default)]
    bias_exp: i64,
    #[serde(default)]
    du: i64,
    #[serde(default)]
    dv: i64,
    #[serde(default)]
    vth: i64,
}

#[derive(Deserialize)]
struct Static {
    from: String,
    to: String,
    weight_exp: i64,
    sign: SignMode,
}

/// A whole network of lava's runtime.
fn net(folder: &Path, case: &Net) -> Recording {
    let archive = Archive::read(&folder.join(format!("{}.npz", case.name)));
    let mut net = Builder::with(Semantics::Lava);
    let (mut ids, mut values, mut events) = (BTreeMap::new(), Vec::new(), Vec::new());
    let mut channels = 0;
    for population in &case.populations {
        let name = population.name.as_str();
        if population.bias_mant.is_empty() {
            ids.insert(name, net.input(name, population.n));
            let input = archive.array(&format!("in_{name}"));
            let all = (0..population.n).flat_map(|unit| (0..case.steps).map(move |step| (unit, step)));
            let spikes = all.filter(|&(unit, step)| input.at([unit as usize, step as usize]) != 0);
            events.extend(spikes.map(|(unit, step)| (step, ChannelId(channels + unit))));
            channels += population.n;
            continue;
        }
        let plain = neuron(population.du, population.dv, population.vth, 1);
        let neurons: Vec<_> =
            population.bias_mant.iter().map(|&bias| biased(plain, bias, population.bias_exp)).collect();
        let id = net.each(name, Shape::Line(population.n), &neurons, 0);
        ids.insert(name, id);
        for (what, read) in [("spikes", Read::Spikes(id)), ("u", Read::U(id)), ("v", Read::V(id))] {
            values.push((read, archive.array(&format!("{name}_{what}"))));
        }
    }
    for (number, Static { from, to, weight_exp, sign }) in case.r#static.iter().enumerate() {
        let weights = archive.array(&format!("static{number}_w"));
        let connectivity = dense(&weights, |weight| cut(weight, *sign, 8));
        net.connect(ids[from.as_str()], ids[to.as_str()], format(*weight_exp, *sign, 8), 0, connectivity);
    }
    let mut draws = Vec::new();
    for (number, plastic) in case.plastic.iter().enumerate() {
        let prefix = format!("plastic{number}_");
        let ends = (ids[plastic.from.as_str()], ids[plastic.to.as_str()]);
        let rule = plastic.connect(&mut net, ends, plastic.weight_exp, &archive, &prefix);
        draws.push(recorded(&archive, &prefix));
        values.extend(columns(rule, &archive, &prefix));
    }
    Recording {
        name: case.name.clone(),
        network: net.build(),
        draws: Draws { recorded: IdVec::from(draws).into(), ..Draws::default() },
        sample: Sample::new(case.steps, &events, None).unwrap(),
        values,
    }
}

fn nets(folder: &Path) -> Vec<Recording> {
    let text = std::fs::read_to_string(folder.join("nets.json")).unwrap();
    let nets: Vec<Net> = serde_json::from_str(&text).unwrap();
    nets.iter().map(|case| net(folder, case)).collect()
}

#[derive(Deserialize)]
struct Pes {
    name: String,
    axons: u32,
    dims: u32,
    steps: u32,
    tau: f64,
    magnitude: f64,
    /// Of the weights as they are recorded, 6 more than in a format.
    weight_exp: i64,
}

/// A connection that learns by PES from `error`, of which entry t is the one of step t.
fn pes(folder: &Path, case: &Pes) -> Recording {
    let archive = Archive::read(&folder.join(format!("{}.npz", case.name)));
    let mut net = Builder::new();
    let (input, error) = (net.input("in", case.axons), net.input("error", case.dims));
    net.parts.populations[error].message = Message::Value(MessageBits::new(17).unwrap());
    let targets = 2 * case.dims;
    let neurons = vec![neuron(4096, 4096, 8_000, 1); targets as usize];
    let out = net.each("out", Shape::Line(targets), &neurons, 0);
    let mantissas = |name| {
        let mut array = archive.array(name);
        array.values.iter_mut().for_each(|weight| *weight >>= case.weight_exp);
        array
    };
    let weights = mantissas("w0").values.iter().map(|&weight| weight as i16).collect();
    let format = format(case.weight_exp - 6, SignMode::Mixed, 8);
    net.connect(input, out, format, 0, Connectivity::Dense { targets, weights });
    let x1 = TraceSettings { impulse: case.magnitude.try_into().unwrap(), tau: case.tau.try_into().unwrap() };
    let id = net.parts.projections.ids().last().unwrap();
    let rule = make_plastic(&mut net.parts, id, Rule::pes(x1, None));
    let plastic = Arc::make_mut(net.parts.projections[id].plastic.as_mut().unwrap());
    plastic.signals = [Some(error), None, None];
    let mut events = Vec::new();
    for (name, units, first) in [("spikes", case.axons, 0), ("error", case.dims, case.axons)] {
        let values = archive.array(name).values;
        let all = (0..case.steps).flat_map(|step| (0..units).map(move |unit| (step, unit)));
        let event = |(step, unit)| (step, ChannelId(first + unit), values[(step * units + unit) as usize] as i32);
        events.extend(all.map(event));
    }
    let columns =
        [(Column::Variable(Variable::Weight), mantissas("w")), (Column::Trace(Trace::X1), archive.array("trace"))];
    Recording {
        name: case.name.clone(),
        network: net.build(),
        draws: Draws { recorded: IdVec::from(vec![recorded(&archive, "")]).into(), ..Draws::default() },
        sample: Sample::with_values(case.steps, &events, None).unwrap(),
        values: columns.map(|(column, array)| (Read::Column(rule, column), array)).into(),
    }
}

/// Compares golden with recordings; returns the number of values, none of which differs.
fn on_golden(recordings: &[Recording]) -> u64 {
    let mut compared = Compared::default();
    for recording in recordings {
        compare(&mut Golden::new(&recording.network), recording, &mut compared);
    }
    assert_eq!(compared.differ, 0, "of {} values: {:?}", compared.values, compared.first);
    compared.values
}

/// Compares the machine with recordings; returns the number of values, none of which differs.
fn on_machine(recordings: &[Recording]) -> u64 {
    let mut compared = Compared::default();
    for recording in recordings {
        let compiled = compile(recording.network.clone(), &roomy("oheo-gulch"), &unsearched()).unwrap();
        let image = Image::new(&compiled.program, 1).unwrap();
        compare(&mut Machine::new(&image, Settings::default()), recording, &mut compared);
    }
    assert_eq!(compared.differ, 0, "of {} values: {:?}", compared.values, compared.first);
    compared.values
}

#[test]
fn lavas_connections_learn_as_recorded() {
    let Some(folder) = data("learning/lava") else { return };
    let recordings = connections(&folder);
    assert_eq!((recordings.len(), on_golden(&recordings), on_machine(&recordings)), (95, 1_072_859, 1_072_859));
}

#[test]
fn lavas_networks_learn_as_recorded() {
    let Some(folder) = data("learning/lava_nets") else { return };
    let recordings = nets(&folder);
    assert_eq!((recordings.len(), on_golden(&recordings), on_machine(&recordings)), (6, 140_960, 140_960));
}

#[test]
fn pes_learns_as_recorded() {
    let Some(folder) = data("learning/pes") else { return };
    let text = std::fs::read_to_string(folder.join("cases.json")).unwrap();
    let cases: Vec<Pes> = serde_json::from_str(&text).unwrap();
    let recordings: Vec<Recording> = cases.iter().map(|case| pes(&folder, case)).collect();
    assert_eq!((recordings.len(), on_golden(&recordings), on_machine(&recordings)), (6, 148_080, 148_080));
}

#[derive(Deserialize)]
struct Rewards {
    steps: u32,
    weight_first: i16,
    /// Whether cycle i of 128 steps ends with a reward.
    rewards_printed: Vec<u8>,
}

/// Weights and rewards after each step of the chip's reward run, for a seed.
fn rewarded<E: Engine>(case: &Rewards, seed: u64, engine: impl Fn(&Quantised) -> E) -> [Vec<i32>; 2] {
    let mut net = Builder::new();
    let (input, reward) = (net.input("in", 1), net.input("reward", 1));
    let out = net.each("out", Shape::Line(1), &[neuron(4096, 4096, 8_000, 1)], 0);
    let one = Connectivity::Dense { targets: 1, weights: [case.weight_first].into() };
    net.connect(input, out, format(0, SignMode::Mixed, 8), 0, one);
    let mut text = RuleText {
        changes: [parse("u0*r1").unwrap(), Change::default(), Change::default()],
        epoch: 2,
        ..RuleText::default()
    };
    text.traces[Trace::R1.index()] = TraceSettings { impulse: 2.0.try_into().unwrap(), tau: 1.0.try_into().unwrap() };
    let id = net.parts.projections.ids().last().unwrap();
    let rule = make_plastic(&mut net.parts, id, Rule::new(text).unwrap());
    Arc::make_mut(net.parts.projections[id].plastic.as_mut().unwrap()).reward = Some(reward);
    let ends = (1..).zip(&case.rewards_printed).filter(|(_, reward)| **reward == 1).map(|(cycle, _)| 128 * cycle);
    let steps = std::iter::once(1).chain(ends).filter(|&step| step < case.steps);
    let events: Vec<_> = steps.map(|step| (step, ChannelId(1))).collect();
    let sample = Sample::new(case.steps, &events, None).unwrap();
    let mut engine = engine(&net.build());
    engine.set_draws(&Draws::seeded(seed));
    engine.forget(0);
    engine.begin(case.steps);
    let mut values = [Vec::new(), Vec::new()];
    for step in 0..case.steps {
        engine.step(sample.input(step));
        // The call of step s shows the learning after step s - 1.
        if step > 0 {
            values[0].extend(engine.learned(rule, Column::Variable(Variable::Weight)));
            values[1].extend(engine.learned(rule, Column::Trace(Trace::R1)));
        }
    }
    values
}

/// Weights of a chip, read from a plot, by step.
const REWARDED: [(usize, i32); 9] =
    [(3, 102), (126, 102), (129, 104), (382, 104), (385, 106), (510, 106), (520, 114), (1022, 114), (1032, 120)];

/// A seed with these weights; what is random on the chip has many outcomes.
const EQUAL: u64 = 96;

#[test]
fn rewards_raise_a_weight_as_on_a_chip() {
    let Some(folder) = data("learning") else { return };
    let text = std::fs::read_to_string(folder.join("reward_chip.json")).unwrap();
    let case: Rewards = serde_json::from_str(&text).unwrap();
    let machine = |network: &Quantised| {
        let compiled = compile(network.clone(), &roomy("oheo-gulch"), &unsearched()).unwrap();
        Machine::new(&Image::new(&compiled.program, 1).unwrap(), Settings::default())
    };
    let [weights, traces] = rewarded(&case, EQUAL, Golden::new);
    assert_eq!(REWARDED.map(|(step, _)| (step, weights[step])), REWARDED);
    assert_eq!([weights, traces], rewarded(&case, EQUAL, machine));
    let runs: Vec<[Vec<i32>; 2]> = (0..100).map(|seed| rewarded(&case, seed, Golden::new)).collect();
    for [weights, traces] in &runs {
        assert!(weights.windows(2).all(|pair| [0, 2].contains(&(pair[1] - pair[0]))));
        // The rewards of steps 128, 384, 512 and 1,024, which are noted at the end of an epoch.
        let rises = |step: &usize| weights[*step] == weights[step - 1] + 2 && traces[*step] >= 2;
        assert!([127, 383, 511, 1023].iter().all(rises));
    }
    // The last weight, 120, and the printed sum of the trace, 34, are within two standard
    // deviations.
    for (name, recorded, of) in [("weight", 120.0, 0), ("sum", 34.0, 1)] {
        let value = |run: &[Vec<i32>; 2]| f64::from(if of == 0 { run[0][1200] } else { run[1].iter().sum() });
        let mean = runs.iter().map(value).sum::<f64>() / runs.len() as f64;
        let variance = runs.iter().map(|run| (value(run) - mean).powi(2)).sum::<f64>() / runs.len() as f64;
        assert!(
            (recorded - mean).abs() < 2.0 * variance.sqrt(),
            "{name}: {recorded}, mean {mean}, variance {variance}"
        );
    }
}

#[derive(Deserialize)]
struct Windows {
    windows: Vec<PairWindow>,
}

/// Mean changes of a weight by a pair of spikes, by lag.
#[derive(Deserialize)]
struct PairWindow {
    rule: String,
    sign: SignMode,
    w0: i16,
    impulse: f64,
    tau: f64,
    rows: Vec<Lag>,
}

#[derive(Deserialize)]
struct Lag {
    /// Steps from the update in which the presynaptic spike arrives to that of the postsynaptic
    /// one.
    lag: i64,
    mean: f64,
    sd: f64,
    n: f64,
}

/// Pairs of each lag in a network.
const PAIRS: usize = 250;

impl PairWindow {
    /// `PAIRS` synapses for each lag, from sources of their own, which learn from one pair of
    /// spikes each. The presynaptic spikes are entries of step 21.
    fn network(&self) -> (Quantised, Sample) {
        let mut net = Builder::new();
        let count = (self.rows.len() * PAIRS) as u32;
        let (input, teach) = (net.input("in", count), net.input("teach", self.rows.len() as u32));
        let out = net.each("out", Shape::Line(count), &vec![neuron(4096, 4096, 8_000, 1); count as usize], 0);
        let row = |row: u32| (row * PAIRS as u32..(row + 1) * PAIRS as u32).map(|target| (target, 254)).collect();
        let all = sparse((0..self.rows.len() as u32).map(row));
        net.connect(teach, out, format(6, SignMode::Mixed, 8), 0, all);
        net.connect(input, out, format(0, self.sign, 8), 0, sparse((0..count).map(|unit| vec![(unit, self.w0)])));
        let mut text = RuleText {
            changes: [parse(&self.rule).unwrap(), Change::default(), Change::default()],
            epoch: 1,
            semantics: LearningSemantics::Brian,
            ..RuleText::default()
        };
        let settings = TraceSettings { impulse: self.impulse.try_into().unwrap(), tau: self.tau.try_into().unwrap() };
        [Trace::X1, Trace::Y1].into_iter().for_each(|trace| text.traces[trace.index()] = settings);
        let id = net.parts.projections.ids().last().unwrap();
        make_plastic(&mut net.parts, id, Rule::new(text).unwrap());
        let pre = (0..count).map(|unit| (21, ChannelId(unit)));
        let post = (count..).zip(&self.rows).map(|(channel, row)| ((21 + row.lag) as u32, ChannelId(channel)));
        (net.build(), Sample::new(44, &pre.chain(post).collect::<Vec<_>>(), None).unwrap())
    }

    /// Compares the mean changes of `runs` runs with a seed, each of `PAIRS` pairs a lag.
    fn compare<E: Engine>(&self, engine: &mut E, sample: &Sample, seed: u64, runs: u32) {
        let mut sums = vec![[0.0; 2]; self.rows.len()];
        engine.set_draws(&Draws::seeded(seed));
        for run in 0..runs {
            engine.forget(run);
            engine.begin(sample.steps());
            (0..sample.steps()).for_each(|step| engine.step(sample.input(step)));
            engine.settle();
            let weights = engine.learned(RuleId(0), Column::Variable(Variable::Weight));
            for (place, weight) in weights.into_iter().enumerate() {
                let change = f64::from(weight) - f64::from(self.w0);
                let [sum, squares] = &mut sums[place / PAIRS];
                (*sum, *squares) = (*sum + change, *squares + change * change);
            }
        }
        let n = f64::from(runs) * PAIRS as f64;
        for (row, [sum, squares]) in self.rows.iter().zip(sums) {
            let mean = sum / n;
            let variance = (squares / n - mean * mean).max(0.0);
            let error = (row.sd * row.sd / row.n + variance / n).sqrt();
            let (lag, meant) = (row.lag, row.mean);
            assert!((mean - meant).abs() <= 4.5 * error, "{}, lag {lag}: {mean}, not {meant} +- {error}", self.rule);
        }
    }
}

/// Three seeds of 10,000 pairs a lag where `NSIM_LONG` is 1, else one of 1,000.
#[test]
fn pairs_of_spikes_change_weights_as_in_brian2loihi() {
    let Some(folder) = data("learning") else { return };
    let text = std::fs::read_to_string(folder.join("brian2loihi_window.json")).unwrap();
    let Windows { windows } = serde_json::from_str(&text).unwrap();
    let (seeds, runs) = if nsim_testing::cases(3) == 3 { (3, 40) } else { (1, 4) };
    for window in windows {
        let (network, sample) = window.network();
        window.compare(&mut Golden::new(&network), &sample, 5, 1);
        let compiled = compile(network, &roomy("oheo-gulch"), &unsearched()).unwrap();
        let image = Image::new(&compiled.program, 1).unwrap();
        for seed in 0..seeds {
            window.compare(&mut Machine::new(&image, Settings::default()), &sample, seed, runs);
        }
    }
}
