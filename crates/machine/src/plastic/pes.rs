//! PES: traces of the sources of a projection, and weights that learn from an error, (L12), (L13).
//!
//! Input: the spikes that arrive in a step, and the error of that step. Output: new weights in the
//! state of each shard, which the next delivery has.

use rayon::prelude::*;

use crate::layout::image::Image;
use crate::layout::plastic::ProjectionPlan;
use crate::layout::shard::Shard;
use crate::update::state::ShardState;
use nsim_dynamics::pes::Pes;
use nsim_ir::base::id::{Id, RuleId};
use nsim_ir::learning::PES_TRACE_EPOCH;
use nsim_ir::learning::draws::{Draws, Place, Use};

/// State of a projection that learns by PES.
#[derive(Debug, Clone)]
pub(crate) struct Learner {
    /// Its index among the plastic projections.
    pub projection: usize,
    /// Trace of each source.
    pub traces: Vec<i16>,
    /// Whether a spike of each source arrived since traces changed.
    spiked: Vec<bool>,
    /// Sources of its rule.
    sources: usize,
    pes: Pes,
}

/// What a step brings to PES.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Arrivals<'a> {
    pub step: u32,
    /// The step's number since learning began.
    pub since: u64,
    pub draws: &'a Draws,
    /// Sources whose spikes arrive.
    pub units: &'a [u32],
    /// Value of each signal, from this channel on.
    pub signals: (u32, &'a [i32]),
}

impl Learner {
    /// The projections of an image that learn by PES.
    pub fn all(image: &Image) -> Vec<Learner> {
        let projections = &image.plastic.projections;
        let rule = |plan: &ProjectionPlan| image.plastic.rules[plan.of.plastic.rule].rule();
        let end = |plan: &ProjectionPlan| plan.of.plastic.first_source as usize + plan.of.sources.len();
        let of = |(projection, plan): (usize, &ProjectionPlan)| {
            let is_of_rule = |other: &&ProjectionPlan| other.of.plastic.rule == plan.of.plastic.rule;
            Learner {
                projection,
                traces: vec![0; plan.of.sources.len()],
                spiked: vec![false; plan.of.sources.len()],
                sources: projections.iter().filter(is_of_rule).map(end).max().unwrap_or(0),
                pes: Pes::new(rule(plan), plan.of.format),
            }
        };
        projections.iter().enumerate().filter(|(_, plan)| rule(plan).is_pes()).map(of).collect()
    }

    /// Begins a sample.
    pub fn clear(&mut self) {
        self.traces.fill(0);
        self.spiked.fill(false);
    }

    /// Learns from the arrivals of a step. Returns the number of synapses that were evaluated.
    pub fn advance(&mut self, arrivals: Arrivals<'_>, image: &Image, shards: &mut [ShardState]) -> u64 {
        let plan = &image.plastic.projections[self.projection];
        let rule = image.plastic.rules[plan.of.plastic.rule].rule();
        if !rule.notes(arrivals.step) {
            return 0;
        }
        for unit in arrivals.units.iter().filter(|unit| plan.of.sources.contains(unit)) {
            self.spiked[(unit - plan.of.sources.start) as usize] = true;
        }
        let step = arrivals.step + 1;
        if step.is_multiple_of(PES_TRACE_EPOCH) {
            self.change_traces(arrivals, plan);
        }
        if !step.is_multiple_of(rule.epoch()) {
            return 0;
        }
        let change = Change { learner: self, plan, arrivals, number: step / rule.epoch() - 1 };
        let errors = errors(plan, arrivals.signals);
        let all = shards.par_iter_mut().zip(&image.shards);
        all.map(|(state, shard)| change.change_weights(&errors, state, shard)).sum()
    }

    /// (L12).
    fn change_traces(&mut self, arrivals: Arrivals<'_>, plan: &ProjectionPlan) {
        let number = (arrivals.step + 1) / PES_TRACE_EPOCH - 1;
        let entities = (plan.of.plastic.first_source..).zip(self.traces.iter_mut().zip(&mut self.spiked));
        for (entity, (trace, spiked)) in entities {
            let place = arrivals.place(plan.of.plastic.rule, Use::Trace);
            let draw = || arrivals.draws.each(place, number, entity, self.sources);
            *trace = self.pes.trace(*trace, std::mem::take(spiked), draw);
        }
    }
}

impl Arrivals<'_> {
    fn place(&self, rule: RuleId, of: Use) -> Place {
        Place { rule, of, part: 0, step: self.since }
    }
}

/// The error of each target: the first half of the targets has the negative ones.
fn errors(plan: &ProjectionPlan, (first, signals): (u32, &[i32])) -> Vec<i32> {
    let channels = plan.of.signals[0].clone().unwrap_or_default();
    let values = &signals[(channels.start - first) as usize..(channels.end - first) as usize];
    let clipped = values.iter().map(|&value| Pes::error(value));
    clipped.clone().map(|error| -error).chain(clipped).collect()
}

/// A change of the weights of a projection, the one of this number in the sample.
struct Change<'a> {
    learner: &'a Learner,
    plan: &'a ProjectionPlan,
    arrivals: Arrivals<'a>,
    number: u32,
}

impl Change<'_> {
    /// (L13) in a shard. Returns the number of its synapses.
    fn change_weights(&self, errors: &[i32], ShardState { state, .. }: &mut ShardState, shard: &Shard) -> u64 {
        let Learner { projection, traces, sources, pes, .. } = self.learner;
        let (of, rows) = (&self.plan.of.plastic, &shard.plastic.projections[*projection]);
        let mut synapses = 0;
        for (source, &trace) in (of.first_source..).zip(traces) {
            let places = rows.of_source((source - of.first_source) as usize);
            synapses += places.len() as u64;
            for place in places {
                let target = shard.plastic.targets[place];
                let (random, entity) =
                    (self.arrivals.place(of.rule, Use::Weight), source * errors.len() as u32 + target);
                let draw = || self.arrivals.draws.each(random, self.number, entity, sources * errors.len());
                let weight = &mut state.plastic.weights[place];
                *weight = pes.weight(*weight, trace, errors[target as usize], draw);
                state.updates[rows.core_of[target as usize].index()] += 1;
            }
        }
        synapses
    }
}
