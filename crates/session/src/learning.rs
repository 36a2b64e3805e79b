//! Learning over the samples of a run: where it starts anew, its random numbers, and its results.
//!
//! Input: an engine whose rules change weights, delays and tags, and recorded random numbers. Output:
//! the state of each rule after the last sample ([`LearnedRule`]), and its summary. Samples of a
//! network that learns run in order and keep what was learned, unless each starts anew.

use serde::Serialize;

use nsim_dynamics::synapses::Enumerate;
use nsim_files::network::learned::LearnedState;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::fixed::SignMode;
use nsim_ir::base::id::{CompartmentId, Id, IdVec, ProjectionId, RuleId};
use nsim_ir::learning::draws::{Draws, Place, Recorded, Use};
use nsim_ir::learning::{Column, Learning, LearningSemantics, PES_TRACE_EPOCH, Trace, Variable};
use nsim_ir::quantised::connectivity::SynapseFormat;
use nsim_ir::quantised::{Projection, Quantised};
use nsim_ir::spikes::Engine;

use crate::outcome::{Outcome, Probe, Quantity};

/// Whether any rule changes synapses by itself.
pub fn learns(rules: &IdVec<RuleId, Learning>) -> bool {
    rules.iter().any(|learning| learning.rule.is_active())
}

/// The state of a rule's synapses, by row; empty from engines that do not learn.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct LearnedRule {
    /// Weight of each synapse.
    pub weights: Vec<i32>,
    /// Delay of each synapse.
    pub delays: Vec<i32>,
    /// Tag of each synapse.
    pub tags: Vec<i32>,
}

/// Reads the state of the first rules of an engine.
pub(crate) fn learned<E: Engine + ?Sized>(engine: &E, rules: usize) -> Vec<LearnedRule> {
    let read = |rule: usize| {
        let column = |variable| engine.learned(RuleId::new(rule), Column::Variable(variable));
        let [weights, delays, tags] = [Variable::Weight, Variable::Delay, Variable::Tag].map(column);
        LearnedRule { weights, delays, tags }
    };
    (0..rules).map(read).collect()
}

/// The column of this name.
fn column_named(name: &str) -> Option<Column> {
    let variable = Variable::ALL.into_iter().find(|variable| variable.name() == name).map(Column::Variable);
    variable.or_else(|| Trace::ALL.into_iter().find(|trace| trace.name() == name).map(Column::Trace))
}

/// Parses `NAME.COLUMN` or `NAME.COLUMN.last`, which records only the last step.
pub fn parse_probe(text: &str) -> Option<(&str, Column, bool)> {
    let (each, last) = text.strip_suffix(".last").map_or((text, false), |each| (each, true));
    let (name, column) = each.rsplit_once('.')?;
    Some((name, column_named(column)?, last))
}

/// The projections of a rule.
fn projections(network: &Quantised, rule: RuleId) -> impl Iterator<Item = (ProjectionId, &Projection)> {
    network.plastic().filter(move |(_, projection)| projection.format.rule == Some(rule))
}

/// The probe of a column of a rule: its value after each step, or after the `last` one.
pub fn probe(network: &Quantised, rule: RuleId, column: Column, last: bool) -> Probe {
    let units = |id| network.populations()[id].shape.len();
    let lag = network.parts().rules[rule].rule.lag();
    let mut count = 0;
    for (id, projection) in projections(network, rule) {
        let first = projection.plastic.as_ref().map_or(0, |plastic| plastic.first_source);
        count = match column {
            Column::Variable(_) => count + network.synapses_of(id) as u32,
            Column::Trace(trace) if trace.is_presynaptic() => count.max(first + units(projection.source)),
            Column::Trace(Trace::R1) => projection.plastic.iter().filter_map(|plastic| plastic.reward).count() as u32,
            Column::Trace(_) => units(projection.target),
        };
    }
    Probe { first: CompartmentId(0), count, quantity: Quantity::Learned { rule, column, last, lag } }
}

/// Calls `see` with the row, source, target and first weight of each synapse of a rule. Sources are
/// numbered as those of the rule.
fn each_synapse(network: &Quantised, rule: RuleId, mut see: impl FnMut(u32, (u32, u32), i16)) {
    for (_, projection) in projections(network, rule) {
        let Some(plastic) = &projection.plastic else { continue };
        let mut rows = plastic.rows.iter();
        for source in 0..network.populations()[projection.source].shape.len() {
            projection.connectivity.for_each_from(source, |target, weight| {
                if let Some(&row) = rows.next() {
                    see(row, (plastic.first_source + source, target), weight);
                }
            });
        }
    }
}

/// The source and the target of each synapse of a rule, by row.
pub fn ends(network: &Quantised, rule: RuleId) -> Vec<(u32, u32)> {
    let mut by_row = Vec::new();
    each_synapse(network, rule, |row, ends, _| {
        by_row.resize(by_row.len().max(row as usize + 1), (0, 0));
        by_row[row as usize] = ends;
    });
    by_row
}

/// First weights of a rule by row, and the format of its synapses.
fn first_weights(network: &Quantised, rule: RuleId) -> (Vec<i32>, Option<SynapseFormat>) {
    let (mut by_row, mut format) = (Vec::new(), None);
    for (id, projection) in projections(network, rule) {
        by_row.resize(by_row.len() + network.synapses_of(id) as usize, 0);
        format = Some(projection.format);
    }
    each_synapse(network, rule, |row, _, weight| {
        if let Some(place) = by_row.get_mut(row as usize) {
            *place = weight.into();
        }
    });
    (by_row, format)
}

/// The weights that a rule may give synapses of a format ((L6) of `docs/learning.md`).
fn weight_range(semantics: LearningSemantics, format: SynapseFormat) -> (i32, i32) {
    match (semantics, format.sign) {
        (LearningSemantics::Lava, SignMode::Mixed) => (-256, 255),
        (LearningSemantics::Lava, SignMode::Excitatory) => (0, 255),
        (LearningSemantics::Lava, SignMode::Inhibitory) => (-255, 0),
        (LearningSemantics::Brian, SignMode::Inhibitory) => (-256, 0),
        (LearningSemantics::Brian, SignMode::Excitatory) => (0, 255),
        (_, sign) => {
            let (low, high) = sign.range(format.bits);
            // (L13) has as many negative weights as positive ones.
            let least = if semantics == LearningSemantics::Nengo { sign.step(format.bits) - 256 } else { low };
            (low.max(least).into(), high.into())
        }
    }
}

/// The state of each rule, for a model file.
pub fn states<'a>(network: &'a Quantised, rules: &'a [LearnedRule]) -> Vec<LearnedState<'a>> {
    let states = network.parts().rules.enumerate().zip(rules).filter_map(|((id, learning), state)| {
        let LearnedRule { weights, delays, tags } = state;
        let sign = projections(network, id).next()?.1.format.sign;
        let delays_act = learning.rule.semantics().delays_act();
        Some(LearnedState { name: &learning.name, weights, delays, tags, delays_act, sign })
    });
    states.collect()
}

/// Summary of a rule after a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LearningRow {
    /// The name of its projection.
    pub name: String,
    /// Synapses that were evaluated; `None` where several rules are counted together.
    pub updates: Option<u64>,
    /// Epochs that ended, over all samples.
    pub epochs: u64,
    /// The least weight after the last sample.
    pub weight_min: i32,
    /// The greatest weight after the last sample.
    pub weight_max: i32,
    /// Weights at the ends of their range.
    pub at_bounds: u64,
    /// Weights that differ from those of the model.
    pub changed: u64,
}

/// Epochs of a rule that end within a sample of `steps` steps.
fn epochs(learning: &Learning, steps: u32) -> u32 {
    let rule = &learning.rule;
    rule.until().map_or(steps, |until| steps.min(until.saturating_add(1))) / rule.epoch()
}

/// The summary of each rule.
pub fn rows(network: &Quantised, learned: &[LearnedRule], outcomes: &[Outcome]) -> Vec<LearningRow> {
    let rules = &network.parts().rules;
    let updates: u64 = outcomes.iter().map(|outcome| outcome.synaptic_updates).sum();
    let row = |(id, learning): (RuleId, &Learning)| {
        let (first, format) = first_weights(network, id);
        let last = learned.get(id.index()).map(|rule| &rule.weights).filter(|last| last.len() == first.len());
        let last = last.unwrap_or(&first);
        let (low, high) = format.map_or((0, 0), |format| weight_range(learning.rule.semantics(), format));
        LearningRow {
            name: learning.name.clone(),
            updates: (rules.len() == 1).then_some(updates),
            epochs: outcomes.iter().map(|outcome| u64::from(epochs(learning, outcome.steps))).sum(),
            weight_min: last.iter().copied().min().unwrap_or(0),
            weight_max: last.iter().copied().max().unwrap_or(0),
            at_bounds: last.iter().filter(|&&weight| weight == low || weight == high).count() as u64,
            changed: last.iter().zip(&first).filter(|(last, first)| last != first).count() as u64,
        }
    };
    rules.enumerate().map(row).collect()
}

/// Number of sources and targets of a rule.
pub fn units(network: &Quantised, rule: RuleId) -> (u32, u32) {
    let count = |trace| probe(network, rule, Column::Trace(trace), true).count;
    (count(Trace::X1), count(Trace::Y1))
}

/// A number that a rule takes in a sample: of each entity, one every `every` steps.
struct Taken {
    of: Use,
    count: u32,
    every: u32,
    entities: u64,
}

impl Taken {
    /// The step of a number.
    fn step(&self, number: u64) -> u64 {
        (number / self.entities.max(1) + 1) * u64::from(self.every) - 1
    }
}

/// The random numbers that a rule with these numbers of sources and targets takes in a sample of
/// `steps` steps.
fn numbers_taken(learning: &Learning, (sources, targets): (u32, u32), steps: u32) -> Result<Vec<Taken>, Diagnostic> {
    let Learning { name, rule } = learning;
    let epochs = epochs(learning, steps);
    // Of an epoch that does not end, only the numbers of steps are taken.
    let noted = if rule.until().is_none() { steps } else { epochs * rule.epoch() };
    let (sources, targets) = (u64::from(sources), u64::from(targets));
    let taken = |of, every: u32, entities| Taken { of, count: noted / every, every, entities };
    match rule.semantics() {
        LearningSemantics::Lava => {
            let lava = [Use::PreDecay, Use::PreImpulse, Use::PostDecay, Use::PostImpulse, Use::Round, Use::Post];
            Ok(lava.map(|of| taken(of, if of.is_of_steps() { 1 } else { rule.epoch() }, 1)).into())
        }
        LearningSemantics::Nengo => {
            let weights = taken(Use::Weight, rule.epoch(), sources * targets);
            Ok(vec![taken(Use::Trace, PES_TRACE_EPOCH, sources), weights])
        }
        LearningSemantics::Silicon | LearningSemantics::Brian => {
            let message = format!("the rule of '{name}' draws for each synapse, so there are no numbers to record");
            Err(Diagnostic::new("run.draws", message).help("give learning_semantics: Lava or Nengo, or only --seed"))
        }
    }
}

/// The seeded random numbers that a rule takes in the first sample of a run.
///
/// # Errors
/// `run.draws` for a rule that draws for each synapse.
pub fn recorded(
    draws: &Draws,
    rule: RuleId,
    learning: &Learning,
    units: (u32, u32),
    steps: u32,
) -> Result<Recorded, Diagnostic> {
    let column = |taken: Taken| {
        let number = |number: u64| {
            let (step, entity) = (taken.step(number), (number % taken.entities) as u32);
            match learning.rule.is_pes() {
                true => draws.at(Place { rule, of: taken.of, part: 0, step }).unit(entity),
                false => draws.shared(rule, taken.of, number as u32, step),
            }
        };
        (taken.of, (0..u64::from(taken.count) * taken.entities).map(number).collect())
    };
    Ok(numbers_taken(learning, units, steps)?.into_iter().map(column).collect())
}

/// Checks that a rule with recorded random numbers has all that a sample of `steps` steps takes.
///
/// # Errors
/// `run.draws`.
pub fn check_recorded(
    learning: &Learning,
    units: (u32, u32),
    recorded: &Recorded,
    steps: u32,
) -> Result<(), Diagnostic> {
    for taken in numbers_taken(learning, units, steps)? {
        let (needed, name) = (u64::from(taken.count) * taken.entities, &learning.name);
        let given = recorded.get(&taken.of).map_or(0, Vec::len) as u64;
        if given < needed {
            let (of, step) = (taken.of.name(), taken.step(given));
            let message = format!(
                "the rule of '{name}' takes {needed} numbers of {of} in {steps} steps, but {given} are given: the one \
                 of step {step} is missing"
            );
            let help = match learning.rule.is_pes() {
                true => "give draw_trace [steps / 2, sources] and draw_weight [steps / 4, sources, targets]",
                false => "give a number for each epoch, of draw_post for each step",
            };
            return Err(Diagnostic::new("run.draws", message).help(help));
        }
    }
    Ok(())
}

/// A rule of a network that a session steps.
#[derive(Debug, Clone)]
pub(crate) struct SteppedRule {
    pub learning: Learning,
    /// Number of its synapses.
    pub synapses: usize,
    /// The least and the greatest weight, and the step between weights.
    pub weights: (i32, i32, i32),
    units: (u32, u32),
}

impl SteppedRule {
    /// The rules of a network.
    pub fn all(network: &Quantised) -> IdVec<RuleId, Self> {
        let of = |(id, learning): (RuleId, &Learning)| {
            let (first, format) = first_weights(network, id);
            let semantics = learning.rule.semantics();
            let weights = format.map_or((0, 0, 1), |format| {
                let (low, high) = weight_range(semantics, format);
                let is_whole = semantics == LearningSemantics::Lava;
                (low, high, if is_whole { 1 } else { format.sign.step(format.bits).into() })
            });
            SteppedRule { learning: learning.clone(), synapses: first.len(), weights, units: units(network, id) }
        };
        network.parts().rules.enumerate().map(of).collect()
    }

    /// The random numbers that the rule takes in the call of step `step`: of that step by PES, of
    /// the step before by other rules.
    ///
    /// # Errors
    /// `run.draws` for a rule that draws for each synapse.
    pub fn numbers_of_step(&self, step: u32) -> Result<Vec<(Use, u64)>, Diagnostic> {
        let rule = &self.learning.rule;
        let learned = step.checked_sub(rule.lag()).filter(|&learned| rule.notes(learned));
        let count = |taken: Taken| match learned {
            Some(learned) if (learned + 1).is_multiple_of(taken.every) => (taken.of, taken.entities),
            _ => (taken.of, 0),
        };
        Ok(numbers_taken(&self.learning, self.units, 0)?.into_iter().map(count).collect())
    }

    /// Checks that these are the random numbers that the rule takes in a step.
    ///
    /// # Errors
    /// `run.draws`.
    pub fn check_numbers(&self, recorded: &Recorded, step: u32) -> Result<(), Diagnostic> {
        let taken = self.numbers_of_step(step)?;
        let name = &self.learning.name;
        let of_others = recorded.keys().filter(|of| taken.iter().all(|(known, _)| known != *of)).map(|of| (*of, 0));
        if let Some(message) = recorded.iter().find_map(|(of, numbers)| of.unfit(numbers)) {
            return Err(Diagnostic::new("run.draws", message).help("give numbers in this range"));
        }
        for (of, needed) in taken.iter().copied().chain(of_others) {
            let given = recorded.get(&of).map_or(0, Vec::len) as u64;
            if given != needed {
                let what = of.name();
                let message = format!(
                    "the rule of '{name}' takes {needed} numbers of {what} in step {step}, but {given} are given"
                );
                let all: Vec<String> = taken.iter().map(|(of, count)| format!("{count} of {}", of.name())).collect();
                let help = format!("give it before the step: {}", all.join(", "));
                return Err(Diagnostic::new("run.draws", message).help(help));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outcome::{LearningSettings, SampleSettings};
    use crate::session::Session;
    use nsim_ir::activity::{Overflow, Totals};
    use nsim_ir::arithmetic::ReadOut;
    use nsim_ir::quantised::Output;
    use nsim_ir::spikes::{Sample, Spikes};

    #[test]
    fn samples_start_anew_where_the_run_says_so() {
        let places = |settings: &LearningSettings| (0..5).map(|place| settings.restart(place)).collect::<Vec<_>>();
        let kept = LearningSettings::default();
        assert_eq!(places(&kept), [None; 5]);
        let fresh = LearningSettings { fresh: true, first: 3, ..kept.clone() };
        assert_eq!(places(&fresh), [3, 4, 5, 6, 7].map(Some));
        let repeated = LearningSettings { period: 2, ..kept };
        assert_eq!(places(&repeated), [None, None, Some(1), None, Some(2)]);
    }

    /// Its only weight counts the steps that it learned, each with the delivery after it.
    #[derive(Default)]
    struct Counter {
        learned: i32,
        pending: bool,
    }

    impl Engine for Counter {
        fn channels(&self) -> u32 {
            1
        }
        fn begin(&mut self, _: u32) {}
        fn step(&mut self, _: Spikes<'_>) {
            self.learned += i32::from(std::mem::replace(&mut self.pending, true));
        }
        fn skip_idle(&mut self, steps: u32) -> bool {
            (0..steps).for_each(|_| self.step(Spikes::default()));
            true
        }
        fn settle(&mut self) {
            self.learned += i32::from(std::mem::take(&mut self.pending));
        }
        fn forget(&mut self, run: u32) {
            self.learned = 100 * run as i32;
        }
        fn learned(&self, _: RuleId, _: Column) -> Vec<i32> {
            vec![self.learned, -self.learned]
        }
        fn spikes(&self) -> &[CompartmentId] {
            &[]
        }
        fn u(&self, _: CompartmentId) -> i32 {
            0
        }
        fn v(&self, _: CompartmentId) -> i32 {
            0
        }
        fn v_register(&self, _: CompartmentId) -> i32 {
            0
        }
        fn totals(&self) -> Totals {
            Totals::default()
        }
        fn overflow(&self) -> Overflow {
            Overflow::default()
        }
    }

    #[test]
    fn probes_have_the_values_after_the_learning_of_each_step() {
        let output = Output { first: CompartmentId(0), count: 1, decision: ReadOut::Spikes, start_step: 0 };
        let probe = |last| {
            let column = Column::Variable(Variable::Weight);
            Probe {
                first: CompartmentId(0),
                count: 2,
                quantity: Quantity::Learned { rule: RuleId(0), column, last, lag: 1 },
            }
        };
        let run = |session: &mut Session<Counter>, probes: Vec<Probe>| {
            session.run(&Sample::silent(3), &SampleSettings { probes, ..SampleSettings::new(output) }, ()).probes
        };
        let mut session = Session::new(Counter::default(), 1);
        assert_eq!(run(&mut session, vec![probe(false), probe(true)]), [vec![1, 2, 3, -1, -2, -3], vec![3, -3]]);
        assert_eq!(run(&mut session, vec![probe(true)]), [[6, -6]], "idle steps are skipped, and learning goes on");
        session.engine_mut().forget(2);
        assert_eq!(run(&mut session, vec![probe(false)]), [[201, 202, 203, -201, -202, -203]]);
    }

    #[test]
    fn recorded_numbers_are_those_of_the_run_and_missing_ones_are_named() {
        let change = nsim_ir::learning::parse("x0*y1").unwrap();
        let text = nsim_ir::learning::RuleText {
            changes: [change, Default::default(), Default::default()],
            epoch: 4,
            semantics: LearningSemantics::Lava,
            ..Default::default()
        };
        let learning = Learning { name: "p".to_string(), rule: nsim_ir::learning::Rule::new(text).unwrap() };
        let draws = Draws::seeded(7);
        let numbers = recorded(&draws, RuleId(0), &learning, (1, 1), 11).unwrap();
        assert_eq!((numbers[&Use::Round].len(), numbers[&Use::Post].len(), numbers.len()), (2, 11, 6));
        assert_eq!(numbers[&Use::Round][1], draws.shared(RuleId(0), Use::Round, 1, 7));
        check_recorded(&learning, (1, 1), &numbers, 11).unwrap();
        let said = check_recorded(&learning, (1, 1), &numbers, 12).unwrap_err().to_string();
        assert!(
            said.contains("takes 3 numbers of draw_x_decay in 12 steps, but 2 are given: the one of step 11"),
            "{said}"
        );
    }
}
