//! The weights of a rule over the steps of a sample, for pictures.
//!
//! Input: a program, its network, a rule, a sample. Output: [`WeightHistory`]: the number of
//! synapses with each weight at up to a hundred times, each weight at both ends, and the traces of
//! the synapse that changed most at up to a thousand. So its size does not grow with the steps.

use std::collections::BTreeMap;
use std::sync::Arc;

use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::id::{ChannelId, CompartmentId, RuleId};
use nsim_ir::learning::draws::Draws;
use nsim_ir::learning::{Column, Trace, Variable};
use nsim_ir::program::Program;
use nsim_ir::quantised::{Quantised, SpikeSource, Units};
use nsim_ir::spikes::{Engine, Sample};
use nsim_machine::{Image, Machine, Settings};

use crate::learning::ends;

/// The most times at which weights are counted within a sample.
const MOST_TIMES: u32 = 100;
/// The most times at which one synapse is recorded.
const MOST_POINTS: u32 = 1000;

/// The weights of a rule over a sample.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct WeightHistory {
    /// The number of synapses with each weight after a number of steps, ascending: before the
    /// first, at regular times, and after the last.
    pub counts: Vec<(u32, BTreeMap<i32, u32>)>,
    /// Weights before the first step, by row.
    pub first: Vec<i32>,
    /// Weights after the last step, by row.
    pub last: Vec<i32>,
    /// The source and the target of each row.
    pub ends: Vec<(u32, u32)>,
    /// The synapse that changed most; `None` if none changed.
    pub most_changed: Option<OneSynapse>,
}

/// A synapse over the steps of a sample.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct OneSynapse {
    /// Its row among those of the rule.
    pub row: usize,
    /// Numbers of steps after whose learning it was recorded.
    pub times: Vec<u32>,
    /// Its weight at these times.
    pub weights: Vec<i32>,
    /// The traces of its source and of its target that are not always 0, at these times.
    pub traces: [Vec<(Trace, Vec<i32>)>; 2],
    /// The times of these in which its source and its target spiked.
    pub spikes: [Vec<u32>; 2],
}

impl WeightHistory {
    /// Runs a sample from the weights of the network.
    ///
    /// # Errors
    /// `run.too-large`.
    pub fn new(
        program: &Arc<Program>,
        network: &Quantised,
        draws: &Draws,
        rule: RuleId,
        sample: &Sample,
    ) -> Result<Self> {
        let image = Image::new(program, 1).map_err(|error| Diagnostic::new("run.too-large", error.to_string()))?;
        let engine = || {
            let mut machine = Machine::new(&image, Settings::default());
            machine.set_draws(draws);
            machine
        };
        let mut history = WeightHistory::over(&mut engine(), rule, sample);
        history.ends = ends(network, rule);
        let change = |row: &usize| history.first[*row].abs_diff(history.last[*row]);
        // The first of several that changed as much.
        let most = (0..history.first.len()).rev().max_by_key(change).filter(|row| change(row) > 0);
        history.most_changed = most.map(|row| {
            let (source, target) = history.ends[row];
            OneSynapse::new(&mut engine(), network, rule, sample, (row, source, target))
        });
        Ok(history)
    }

    fn over<E: Engine + ?Sized>(engine: &mut E, rule: RuleId, sample: &Sample) -> Self {
        let steps = sample.steps();
        let every = steps.div_ceil(MOST_TIMES).max(1);
        let column = Column::Variable(Variable::Weight);
        let first = engine.learned(rule, column);
        let mut counts = vec![(0, counted(&first))];
        engine.begin(steps);
        for step in 0..steps {
            engine.step(sample.input(step));
            // The call of a step shows what was learned after the one before.
            if step > 0 && step.is_multiple_of(every) {
                counts.push((step, counted(&engine.learned(rule, column))));
            }
        }
        engine.settle();
        let last = engine.learned(rule, column);
        counts.push((steps, counted(&last)));
        WeightHistory { counts, first, last, ..WeightHistory::default() }
    }
}

impl OneSynapse {
    fn new<E: Engine + ?Sized>(
        engine: &mut E,
        network: &Quantised,
        rule: RuleId,
        sample: &Sample,
        (row, source, target): (usize, u32, u32),
    ) -> Self {
        let traces = |of_source: bool| Trace::ALL.into_iter().filter(move |trace| trace.is_presynaptic() == of_source);
        let traces = [true, false].map(|side| traces(side).filter(|&trace| trace != Trace::R1));
        let mut one = OneSynapse {
            row,
            traces: traces.map(|side| side.map(|trace| (trace, vec![])).collect()),
            ..Default::default()
        };
        let [before, after] = ends_in_network(network, rule, source, target);
        let every = sample.steps().div_ceil(MOST_POINTS).max(1);
        engine.begin(sample.steps());
        for step in 0..sample.steps() {
            engine.step(sample.input(step));
            if step > 0 && step.is_multiple_of(every) {
                one.record(step, engine, rule, (source, target));
            }
            for (spikes, end) in one.spikes.iter_mut().zip([before, after]) {
                let spiked = match end {
                    Some(SpikeSource::Channel(channel)) => sample.input(step).ids.contains(&channel),
                    Some(SpikeSource::Compartment(compartment)) => engine.spikes().contains(&compartment),
                    None => false,
                };
                let time = step - step % every;
                spikes.extend(Some(time).filter(|time| spiked && spikes.last() != Some(time)));
            }
        }
        engine.settle();
        one.record(sample.steps(), engine, rule, (source, target));
        one.traces.iter_mut().for_each(|side| side.retain(|(_, values)| values.iter().any(|value| *value != 0)));
        one
    }

    /// Appends what was learned after this number of steps.
    fn record<E: Engine + ?Sized>(&mut self, time: u32, engine: &E, rule: RuleId, (source, target): (u32, u32)) {
        self.times.push(time);
        self.weights.push(engine.learned(rule, Column::Variable(Variable::Weight))[self.row]);
        for (side, unit) in self.traces.iter_mut().zip([source, target]) {
            for (trace, values) in side {
                let column = engine.learned(rule, Column::Trace(*trace));
                values.push(column.get(unit as usize).copied().unwrap_or(0));
            }
        }
    }
}

/// A source and a target of a rule among those of the network.
fn ends_in_network(network: &Quantised, rule: RuleId, source: u32, target: u32) -> [Option<SpikeSource>; 2] {
    let unit = |id, index: u32| match network.populations()[id].units {
        Units::Input(first) => SpikeSource::Channel(ChannelId(first.0 + index)),
        Units::Compartments { first, .. } => SpikeSource::Compartment(CompartmentId(first.0 + index)),
    };
    let mut ends = [None; 2];
    for (_, projection) in network.plastic().filter(|(_, projection)| projection.format.rule == Some(rule)) {
        let first = projection.plastic.as_ref().map_or(0, |plastic| plastic.first_source);
        if (first..first + network.populations()[projection.source].shape.len()).contains(&source) {
            ends = [Some(unit(projection.source, source - first)), Some(unit(projection.target, target))];
        }
    }
    ends
}

fn counted(weights: &[i32]) -> BTreeMap<i32, u32> {
    let mut counts = BTreeMap::new();
    weights.iter().for_each(|&weight| *counts.entry(weight).or_default() += 1);
    counts
}
