//! What rules change, computed from `docs/learning.md` alone. Functions name their equations.
//!
//! All values of all traces are stored by step, and every synapse is visited.

mod pes;

use std::collections::BTreeMap;

use nsim_ir::base::fixed::SignMode;
use nsim_ir::base::id::{ChannelId, CompartmentId, Id, PopulationId, RuleId};
use nsim_ir::learning::draws::{Draws, Place, Use};
use nsim_ir::learning::{
    Dependency, Factor, GREATEST_TRACE, Graded, Impulse, LearningSemantics, Product, Quantity, Rule, TRACES, Trace,
    Variable,
};
use nsim_ir::quantised::connectivity::SynapseFormat;
use nsim_ir::quantised::{Projection, Quantised, SpikeSource, Units};

use crate::plastic::{Columns, Plastic};

/// Spikes that a delivery carries, with their values, and the inputs of the step before it.
#[derive(Debug)]
pub(crate) struct Delivery {
    /// Inputs of the step after the noted one.
    pub channels: Vec<Option<i64>>,
    /// Spikes of the noted step.
    pub compartments: Vec<Option<i64>>,
    /// Inputs of the noted step.
    pub inputs: Vec<Option<i64>>,
}

impl Delivery {
    fn carries(&self, source: SpikeSource) -> Option<i64> {
        match source {
            SpikeSource::Channel(channel) => self.channels[channel.index()],
            SpikeSource::Compartment(compartment) => self.compartments[compartment.index()],
        }
    }
}

/// The random numbers of a sample whose step 0 is step `base` since learning began.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Numbers<'a> {
    pub draws: &'a Draws,
    pub base: u64,
}

/// A source or a target of a rule.
#[derive(Debug, Clone, Default)]
struct End {
    /// Its traces in the order of [`Trace`]; the others stay 0.
    traces: [i64; TRACES],
    /// (L1): k of the last spike noted in this epoch, 0 without one.
    note: u32,
    /// Every step at which a spike was noted, ascending.
    noted: Vec<u32>,
    /// (L15): its traces before the spikes of the last step.
    before: [i64; TRACES],
    /// (L8): X(s), by trace and step of the sample.
    history: [Vec<i64>; TRACES],
    /// (L10): the values of a signal in place of a trace, by step of the sample.
    signals: [Vec<i64>; TRACES],
}

impl End {
    /// X(s); 0 before the first step.
    fn at(&self, trace: Trace, step: i64) -> i64 {
        usize::try_from(step).map_or(0, |step| self.history[trace.index()][step])
    }
}

/// A rule in one copy of a network.
#[derive(Debug, Clone)]
pub(crate) struct Learner {
    id: RuleId,
    rule: Rule,
    sources: BTreeMap<u32, (SpikeSource, End)>,
    targets: Vec<(CompartmentId, End)>,
    /// (L14): the sources of rewards, with one trace.
    reward: (Vec<SpikeSource>, End),
    /// The input channel of each target whose values replace a trace.
    signals: [Option<Vec<ChannelId>>; TRACES],
}

/// The units of a population.
fn spikes_of(network: &Quantised, id: PopulationId) -> Vec<SpikeSource> {
    let population = &network.populations()[id];
    let unit = |index| match population.units {
        Units::Input(first) => SpikeSource::Channel(ChannelId(first.0 + index)),
        Units::Compartments { first, .. } => SpikeSource::Compartment(CompartmentId(first.0 + index)),
    };
    (0..population.shape.len()).map(unit).collect()
}

/// add(z, I, r).
fn add(z: i64, impulse: Impulse, r: f64) -> i64 {
    let fraction = i64::from(r < f64::from(impulse.fraction));
    (z + i64::from(impulse.whole) + fraction).clamp(0, i64::from(GREATEST_TRACE))
}

/// (L11): half a payload, to even, modulo 256.
fn half(payload: i64) -> i64 {
    let half = payload.div_euclid(2);
    (half + payload.rem_euclid(2) * half.rem_euclid(2)).rem_euclid(256)
}

impl Learner {
    /// The rule of a projection, with its targets.
    pub(crate) fn new(network: &Quantised, projection: &Projection) -> Learner {
        let id = projection.format.rule.expect("the projection is plastic");
        let target = &network.populations()[projection.target];
        let first = target.first_compartment().expect("a target has compartments").0;
        let targets = first..first + target.shape.len();
        Learner {
            id,
            rule: network.parts().rules[id].rule.clone(),
            sources: BTreeMap::new(),
            targets: targets.map(|target| (CompartmentId(target), End::default())).collect(),
            reward: Default::default(),
            signals: Default::default(),
        }
    }

    /// Adds the sources and signals of a projection.
    pub(crate) fn join(&mut self, network: &Quantised, projection: &Projection) {
        let plastic = projection.plastic.as_ref().expect("the projection is plastic");
        for (index, spikes) in (plastic.first_source..).zip(spikes_of(network, projection.source)) {
            self.sources.insert(index, (spikes, End::default()));
        }
        self.reward.0 = plastic.reward.map_or(Vec::new(), |reward| spikes_of(network, reward));
        for (trace, signal) in [Trace::Y1, Trace::Y2, Trace::Y3].into_iter().zip(plastic.signals) {
            let Some(signal) = signal.map(|id| &network.populations()[id]) else { continue };
            let first = signal.first_channel().expect("a signal is an input").0;
            // One for each target, one for all of them, or one for each pair in PES.
            let channel = |target| ChannelId(first + target % signal.shape.len());
            self.signals[trace.index()] = Some((0..self.targets.len() as u32).map(channel).collect());
        }
    }

    /// Clears traces and notes.
    pub(crate) fn begin(&mut self) {
        self.sources.values_mut().for_each(|(_, end)| *end = End::default());
        self.targets.iter_mut().for_each(|(_, end)| *end = End::default());
        self.reward.1 = End::default();
    }

    /// A trace of each source or target.
    pub(crate) fn traces(&self, trace: Trace) -> Vec<i32> {
        let value = |end: &End| i32::try_from(end.traces[trace.index()]).expect("messages have 32 bits");
        match trace.is_presynaptic() {
            true => self.sources.values().map(|(_, end)| value(end)).collect(),
            false if trace == Trace::R1 => self.reward.0.first().map(|_| value(&self.reward.1)).into_iter().collect(),
            false => self.targets.iter().map(|(_, end)| value(end)).collect(),
        }
    }

    pub(crate) fn learns_after(&self, step: u32) -> bool {
        self.rule.learns_after(step)
    }

    fn is_lava(&self) -> bool {
        self.rule.semantics() == LearningSemantics::Lava
    }

    fn is_signal(&self, trace: Trace) -> bool {
        self.signals[trace.index()].is_some()
    }

    /// The impulse of a trace. (L10), (L11): signals have none, nor has x1 where it takes payloads.
    fn impulse(&self, trace: Trace) -> Impulse {
        let takes_payloads = trace == Trace::X1 && self.rule.graded() != Graded::Regular;
        if self.is_signal(trace) || takes_payloads { Impulse::default() } else { self.rule.trace(trace).impulse }
    }

    /// The time constant of a trace in steps, with (L10) and (L14).
    fn tau(&self, trace: Trace) -> f64 {
        let tau = self.rule.trace(trace).tau.get();
        match trace {
            Trace::R1 => tau * f64::from(self.rule.epoch()),
            _ if self.is_signal(trace) => 65_535.0,
            _ => tau,
        }
    }

    /// The factor of a trace's decay in a step: (L4), (L15).
    fn factor(&self, trace: Trace) -> f64 {
        match self.rule.semantics() {
            LearningSemantics::Brian if self.impulse(trace) == Impulse::default() => 0.0,
            LearningSemantics::Brian => 1.0 - 1.0 / self.tau(trace),
            _ => libm::exp(-1.0 / self.tau(trace)),
        }
    }

    fn place(&self, of: Use, trace: Trace, step: u64) -> Place {
        Place { rule: self.id, of, part: trace.index() as u8, step }
    }

    /// (L9) for (L3): r of a further spike.
    fn further(&self, numbers: Numbers<'_>, trace: Trace, entity: u32, step: u32) -> f64 {
        let now = numbers.base + u64::from(step);
        match (self.rule.semantics(), trace.is_presynaptic()) {
            (LearningSemantics::Lava, true) => 0.0,
            (LearningSemantics::Lava, false) => numbers.draws.shared(self.id, Use::Post, step, now),
            (_, pre) => {
                let of = if pre { Use::Pre } else { Use::Post };
                (numbers.draws.at(self.place(of, trace, now)).bits(entity) >> 56) as f64
            }
        }
    }

    /// (L9) for (L4): r of the decay toward a step of the epoch that ends at step `last`.
    fn decay(&self, numbers: Numbers<'_>, trace: Trace, entity: u32, step: u32, last: u32) -> f64 {
        let of = if trace.is_presynaptic() { Use::PreDecay } else { Use::PostDecay };
        match self.is_lava() {
            true => self.shared(numbers, of, last),
            false => numbers.draws.at(self.place(of, trace, numbers.base + u64::from(step))).unit(entity),
        }
    }

    /// (L9) for (L4): r of the impulse in the epoch that ends at step `last`.
    fn fraction(&self, numbers: Numbers<'_>, trace: Trace, entity: u32, last: u32) -> f64 {
        let of = if trace.is_presynaptic() { Use::PreImpulse } else { Use::PostImpulse };
        match self.is_lava() {
            true => self.shared(numbers, of, last),
            false => {
                let place = self.place(of, trace, numbers.base + u64::from(last));
                (numbers.draws.at(place).bits(entity) >> 56) as f64
            }
        }
    }

    /// (L9) for (L6): r of a variable of a synapse.
    fn rounding(&self, numbers: Numbers<'_>, variable: Variable, source: u32, target: u32, last: u32) -> f64 {
        let step = numbers.base + u64::from(last);
        let part = variable as u8;
        match self.is_lava() {
            true => self.shared(numbers, Use::Round, last),
            false => {
                let numbers = numbers.draws.at(Place { rule: self.id, of: Use::Round, part, step });
                f64::from(numbers.of_synapse(numbers.of_source(source), target)) / 2f64.powi(32)
            }
        }
    }

    /// The number that all entities share in the epoch that ends at step `last`.
    fn shared(&self, numbers: Numbers<'_>, of: Use, last: u32) -> f64 {
        let number = (last + 1) / self.rule.epoch() - 1;
        numbers.draws.shared(self.id, of, number, numbers.base + u64::from(last))
    }

    /// (L1) and (L3): notes what is delivered after the update of a step.
    pub(crate) fn note(&mut self, numbers: Numbers<'_>, step: u32, delivery: &Delivery) {
        // A rule that changes nothing has no traces.
        if !self.rule.learns() || !self.rule.notes(step) {
            return;
        }
        let indices: Vec<u32> = self.sources.keys().copied().collect();
        for index in indices {
            let (source, mut end) = self.sources[&index].clone();
            self.note_source(numbers, step, index, &mut end, delivery.carries(source));
            self.sources.insert(index, (source, end));
        }
        for index in 0..self.targets.len() {
            let (target, mut end) = self.targets[index].clone();
            if delivery.compartments[target.index()].is_some() {
                self.note_spike(numbers, step, index as u32, &mut end, &[Trace::Y1, Trace::Y2, Trace::Y3]);
            }
            for trace in [Trace::Y1, Trace::Y2, Trace::Y3] {
                let Some(channels) = &self.signals[trace.index()] else { continue };
                let value = delivery.inputs[channels[index].index()].unwrap_or(0);
                end.traces[trace.index()] = value;
                end.signals[trace.index()].push(value);
            }
            self.targets[index].1 = end;
        }
        let (sources, mut end) = self.reward.clone();
        if sources.iter().any(|&source| delivery.carries(source).is_some()) {
            self.note_spike(numbers, step, 0, &mut end, &[Trace::R1]);
        }
        self.reward = (sources, end);
    }

    /// A step of a source, which spiked with a payload or did not. (L11) where x1 takes payloads.
    fn note_source(&self, numbers: Numbers<'_>, step: u32, index: u32, end: &mut End, payload: Option<i64>) {
        let x1 = end.traces[Trace::X1.index()];
        let half = payload.map_or(0, half);
        let (x1, is_noted) = match self.rule.graded() {
            Graded::Regular if payload.is_some() => {
                return self.note_spike(numbers, step, index, end, &[Trace::X1, Trace::X2]);
            }
            Graded::AddWithoutSaturation => match (x1 + half) % 256 {
                sum @ 128.. => (sum - 127, payload.is_some()),
                sum => (sum, false),
            },
            Graded::Overwrite if payload.is_some() => (half, true),
            Graded::AddSaturating if payload.is_some() => (((x1 + half) % 256).min(127), true),
            Graded::Regular | Graded::Overwrite | Graded::AddSaturating => return,
        };
        end.traces[Trace::X1.index()] = x1;
        if is_noted {
            self.note_spike(numbers, step, index, end, &[Trace::X2]);
        }
    }

    /// (L3): notes a spike, which is a further one where another was noted in this epoch.
    fn note_spike(&self, numbers: Numbers<'_>, step: u32, index: u32, end: &mut End, traces: &[Trace]) {
        for &trace in traces.iter().filter(|_| end.note > 0) {
            let r = self.further(numbers, trace, index, step);
            let value = &mut end.traces[trace.index()];
            *value = add(*value, self.impulse(trace), r);
        }
        end.note = step % self.rule.epoch() + 1;
        end.noted.push(step);
    }

    /// (L4): appends the epoch that ends at step `last` to all histories.
    pub(crate) fn remember(&mut self, numbers: Numbers<'_>, last: u32) {
        let indices: Vec<u32> = self.sources.keys().copied().collect();
        for index in indices {
            let (source, end) = self.sources[&index].clone();
            let end = self.remembered(numbers, last, index, end, &[Trace::X1, Trace::X2]);
            self.sources.insert(index, (source, end));
        }
        for index in 0..self.targets.len() {
            let end = self.targets[index].1.clone();
            let traces = [Trace::Y1, Trace::Y2, Trace::Y3];
            self.targets[index].1 = self.remembered(numbers, last, index as u32, end, &traces);
        }
        self.reward.1 = self.remembered(numbers, last, 0, self.reward.1.clone(), &[Trace::R1]);
    }

    fn remembered(&self, numbers: Numbers<'_>, last: u32, index: u32, mut end: End, traces: &[Trace]) -> End {
        let first = last + 1 - self.rule.epoch();
        for &trace in traces {
            // (L10).
            if self.is_signal(trace) && !self.is_lava() {
                end.history[trace.index()] = end.signals[trace.index()].clone();
                continue;
            }
            let mut value = end.traces[trace.index()];
            for step in first..=last {
                let z = self.factor(trace) * value as f64;
                let r = self.decay(numbers, trace, index, step, last);
                let fraction = match self.rule.semantics() {
                    LearningSemantics::Brian => (self.factor(trace) * end.before[trace.index()] as f64).fract(),
                    _ => z - z.floor(),
                };
                value = z.floor() as i64 + i64::from(r < fraction);
                end.before[trace.index()] = value;
                if step - first + 1 == end.note {
                    value = add(value, self.impulse(trace), self.fraction(numbers, trace, index, last));
                }
                end.history[trace.index()].push(value);
            }
            if !self.is_signal(trace) {
                end.traces[trace.index()] = value;
            }
        }
        end
    }

    /// (L6): changes the synapses of a projection after step `last`. Returns the number of those
    /// whose rule was evaluated.
    pub(crate) fn learn(&self, numbers: Numbers<'_>, last: u32, plastic: &mut Plastic) -> u64 {
        let Columns(before) = plastic.latest();
        let mut after = before.clone();
        let mut evaluated = 0;
        for (number, &(source, target)) in plastic.ends.iter().enumerate() {
            let synapse = Synapse {
                rule: &self.rule,
                format: plastic.format,
                last: last.into(),
                source: &self.sources[&source].1,
                target: &self.targets[target as usize].1,
                reward: &self.reward.1,
                variables: before.each_ref().map(|column| column[number].into()),
            };
            let is_counted = self.rule.all_products().any(|product| synapse.is_true(product.when));
            if !is_counted && !synapse.exceeds() {
                continue;
            }
            evaluated += u64::from(is_counted);
            for variable in Variable::ALL.into_iter().filter(|&variable| self.rule.changes(variable)) {
                let r = self.rounding(numbers, variable, source, target, last);
                after[variable as usize][number] = synapse.changed(variable, r) as i16;
            }
        }
        // (L2): the delivery after this one is that of inputs of step `last` + 2.
        plastic.write(last + 2, Columns(after));
        evaluated
    }

    /// Ends an epoch.
    pub(crate) fn clear_notes(&mut self) {
        self.sources.values_mut().for_each(|(_, end)| end.note = 0);
        self.targets.iter_mut().for_each(|(_, end)| end.note = 0);
        self.reward.1.note = 0;
    }
}

/// A synapse at the end of an epoch.
struct Synapse<'a> {
    rule: &'a Rule,
    format: SynapseFormat,
    /// The epoch's last step, T + E.
    last: i64,
    source: &'a End,
    target: &'a End,
    reward: &'a End,
    /// w, d and t before they change.
    variables: [i64; 3],
}

impl Synapse<'_> {
    /// T, the last step of the epoch before.
    fn before(&self) -> i64 {
        self.last - i64::from(self.rule.epoch())
    }

    /// d in (L8), 0 where delays do not act.
    fn delay(&self) -> i64 {
        if self.rule.semantics().delays_act() { self.variables[Variable::Delay as usize] } else { 0 }
    }

    /// (L8): the step of the last presynaptic spike that counts in this epoch.
    fn spiked(&self) -> Option<i64> {
        let counted = self.before() + 1 - self.delay()..=self.last - self.delay();
        self.source.noted.iter().rev().map(|&step| i64::from(step)).find(|step| counted.contains(step))
    }

    /// (L5).
    fn is_true(&self, when: Dependency) -> bool {
        let epochs = (self.last + 1) / i64::from(self.rule.epoch());
        match when {
            Dependency::Pre => self.spiked().is_some(),
            Dependency::Post => self.target.note > 0,
            Dependency::Epoch => epochs % (1 << self.rule.slow()) == 0,
        }
    }

    /// The step at which traces are read: T + tx, T + ty or T + E.
    fn read_at(&self, when: Dependency) -> i64 {
        match when {
            Dependency::Pre => self.spiked().expect("x0 is true") + self.delay(),
            Dependency::Post => self.before() + i64::from(self.target.note),
            Dependency::Epoch => self.last,
        }
    }

    fn quantity(&self, quantity: Quantity, when: Dependency) -> i64 {
        match quantity {
            Quantity::Pre => self.is_true(Dependency::Pre).into(),
            Quantity::Post => self.is_true(Dependency::Post).into(),
            Quantity::Trace(trace) if trace.is_presynaptic() => {
                self.source.at(trace, self.read_at(when) - self.delay())
            }
            Quantity::Trace(Trace::R1) => self.reward.at(Trace::R1, self.read_at(when)),
            Quantity::Trace(trace) => self.target.at(trace, self.read_at(when)),
            Quantity::Variable(variable) => self.variables[variable as usize],
        }
    }

    /// Whether a variable with a change is below the accumulator's range, which (L6) mends.
    fn exceeds(&self) -> bool {
        let tag = self.variables[Variable::Tag as usize];
        self.rule.semantics() == LearningSemantics::Lava && self.rule.changes(Variable::Tag) && tag < -256
    }

    /// m in (L6).
    fn product(&self, product: &Product) -> i64 {
        let mut m = 1;
        let mut width = self.rule.semantics().mantissa_bits();
        for &Factor { of, plus, sign } in &product.factors {
            let sum = self.quantity(of, product.when) + i64::from(plus);
            let value = if sign { sum.signum() } else { sum };
            let bits = of.bits();
            m *= value.clamp(-(1 << bits), (1 << bits) - 1);
            width += bits;
        }
        m *= i64::from(product.mantissa);
        m = m.div_euclid(1 << width.saturating_sub(15));
        m * (1 << (product.exponent + 7))
    }

    /// (L16): a weight after learning.
    fn changed_in_brian(&self) -> i64 {
        let mut change = 0.0;
        for product in self.rule.products(Variable::Weight).iter().filter(|product| self.is_true(product.when)) {
            let mut m = 1;
            for &Factor { of, plus, sign } in &product.factors {
                let sum = self.quantity(of, product.when) + i64::from(plus);
                m *= if sign { sum.signum() } else { sum };
            }
            change += (m * i64::from(product.mantissa)) as f64 * 2f64.powi(product.exponent.into());
        }
        let step = i64::from(self.format.sign.step(self.format.bits));
        let away = if change < 0.0 { change.floor() } else { change.ceil() } as i64;
        let (least, greatest) = self.range(Variable::Weight);
        (self.variables[Variable::Weight as usize] + away / step * step).clamp(least, greatest)
    }

    /// (L6) and (L7): a variable after learning.
    fn changed(&self, variable: Variable, r: f64) -> i64 {
        if self.rule.semantics() == LearningSemantics::Brian {
            return self.changed_in_brian();
        }
        let (low, high) = self.rule.semantics().accumulator();
        let clip = |value: i64| value.clamp(low.into(), high.into());
        let mut acc = self.variables[variable as usize] * 128;
        for product in self.rule.products(variable) {
            let m = if self.is_true(product.when) { self.product(product) } else { 0 };
            acc = clip(acc + clip(m));
        }
        let step = self.step(variable);
        let unit = 128 * step;
        let up = r < acc.rem_euclid(unit) as f64 / unit as f64;
        let (least, greatest) = self.range(variable);
        (step * (acc.div_euclid(unit) + i64::from(up))).clamp(least, greatest)
    }

    fn step(&self, variable: Variable) -> i64 {
        match (variable, self.rule.semantics()) {
            (Variable::Weight, LearningSemantics::Silicon) => self.format.sign.step(self.format.bits).into(),
            _ => 1,
        }
    }

    fn range(&self, variable: Variable) -> (i64, i64) {
        let SynapseFormat { sign, bits, .. } = self.format;
        let semantics = self.rule.semantics();
        let (least, greatest) = match (variable, semantics) {
            (Variable::Weight, LearningSemantics::Lava) => match sign {
                SignMode::Mixed => (-256, 255),
                SignMode::Excitatory => (0, 255),
                SignMode::Inhibitory => (-255, 0),
            },
            (Variable::Weight, LearningSemantics::Brian) => match sign {
                SignMode::Mixed => (-256, 254),
                SignMode::Excitatory => (0, 255),
                SignMode::Inhibitory => (-256, 0),
            },
            (Variable::Weight, _) => {
                let (least, greatest) = sign.range(bits);
                (least.into(), greatest.into())
            }
            (Variable::Delay, _) => semantics.delays(),
            (Variable::Tag, _) => semantics.tags(),
        };
        (least.into(), greatest.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::base::fixed::{WeightBits, WeightExponent};
    use nsim_ir::learning::RuleText;

    #[test]
    fn halves_are_even_and_bytes() {
        assert_eq!([0, 1, 2, 3, 5, 254, 255, 511, -1, -3].map(half), [0, 0, 1, 2, 2, 127, 128, 0, 0, 254]);
    }

    #[test]
    fn an_impulse_has_a_fraction_and_a_limit() {
        let impulse = Impulse::try_from(16.5).unwrap();
        assert_eq!(
            [(0, 127.0), (0, 128.0), (111, 0.0), (-40, 200.0)].map(|(z, r)| add(z, impulse, r)),
            [17, 16, 127, 0]
        );
    }

    /// A synapse of w 10, d 0 and t -3 at the end of the epoch of steps 4 to 7. Its source was noted
    /// in steps 1 and 5, its target in step 6. X(s) is 10 s + 10, Y(s) is s + 1.
    fn evaluated(dw: &str, semantics: LearningSemantics, d: i64, r: f64) -> i64 {
        let changes = [nsim_ir::learning::parse(dw).unwrap(), Default::default(), Default::default()];
        let rule = Rule::new(RuleText { changes, epoch: 4, semantics, ..RuleText::default() }).unwrap();
        let mut source = End { note: 2, noted: vec![1, 5], ..End::default() };
        source.history[Trace::X1.index()] = (0..8).map(|s| 10 * s + 10).collect();
        let mut target = End { note: 3, noted: vec![6], ..End::default() };
        target.history[Trace::Y1.index()] = (0..8).map(|s| s + 1).collect();
        let format = SynapseFormat {
            exponent: WeightExponent::ZERO,
            sign: SignMode::Mixed,
            bits: WeightBits::new(8).unwrap(),
            port: Default::default(),
            apart: None,
            rule: None,
        };
        let synapse = Synapse {
            rule: &rule,
            format,
            last: 7,
            source: &source,
            target: &target,
            reward: &target,
            variables: [10, d, -3],
        };
        synapse.changed(Variable::Weight, r)
    }

    #[test]
    fn products_are_those_computed_by_hand() {
        use LearningSemantics::{Lava, Silicon};
        for (dw, semantics, d, r, w) in [
            // (L6): traces at tx = 2, ty = 3 and E = 4.
            ("x0*x1", Lava, 0, 0.0, 10 + 60),
            ("y0*x1", Lava, 0, 0.0, 10 + 70),
            ("u0*x1", Lava, 0, 0.0, 10 + 80),
            ("x0*y1", Lava, 0, 0.0, 10 + 6),
            // (L5): the second epoch.
            ("u1*x1", Lava, 0, 0.0, 10 + 80),
            ("u2*x1", Lava, 0, 0.0, 10),
            // Widths of 4 + 7 + 7 bits lose 3, of 3 + 7 + 7 lose 2; toward minus infinity.
            ("y0*x1*y1", Lava, 0, 0.9, 10 + 61),
            ("y0*x1*y1", Silicon, 0, 0.9, 10 + 122),
            ("-y0*x1*y1", Lava, 0, 0.9, 10 - 62),
            // 2^-2 * 7 = 1.75: w + 2 where r < .75.
            ("2^-2*y0*y1", Lava, 0, 0.74, 12),
            ("2^-2*y0*y1", Lava, 0, 0.75, 11),
            // (L7): steps of 2, so .875 of a step.
            ("2^-2*y0*y1", Silicon, 0, 0.87, 12),
            ("2^-2*y0*y1", Silicon, 0, 0.88, 10),
            // Constants and signs, factors clipped to 9 bits, the range of w.
            ("x0*(t-5)", Lava, 0, 0.0, 2),
            ("3*x0*sgn(t+2)", Lava, 0, 0.0, 7),
            ("2^-3*x0*(w+9999)", Lava, 0, 0.9, 10 + 63),
            ("2^8*x0", Lava, 0, 0.0, 255),
            ("2^8*x0", Silicon, 0, 0.0, 254),
            ("-2^8*x0", Silicon, 0, 0.999, -246),
            ("-2^8*x0 - 2^8*x0", Silicon, 0, 0.999, -256),
            // The order of clipped sums.
            ("2^8*x0 - 2^8*y0", Lava, 0, 0.999, -1),
            ("2^8*x0 - 2^8*y0 + 5*2^7*u0", Lava, 0, 0.0, 255),
            // (L8): over d = 3 the spike of step 1 counts, with tx = 1, the one of step 5 does not.
            ("x0*x1", Silicon, 3, 0.0, 10 + 20),
            ("x0*y1", Silicon, 3, 0.99, 10 + 4),
            ("y0*x1", Silicon, 3, 0.0, 10 + 40),
            ("u0*x1", Silicon, 3, 0.0, 10 + 50),
            // Over d = 7 none counts, and T + ty - d is before the first step.
            ("2*x0 + 4*y0 - 6*y0*x0", Silicon, 7, 0.0, 14),
            ("4*y0 + y0*x1", Silicon, 7, 0.0, 14),
            // In lava d = 3 is a number.
            ("x0*x1", Lava, 3, 0.0, 10 + 60),
        ] {
            assert_eq!(evaluated(dw, semantics, d, r), w, "{dw}, {semantics:?}, d = {d}, r = {r}");
        }
    }
}
