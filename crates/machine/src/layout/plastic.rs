//! The plastic synapses of an image: by source, by target, and by number.
//!
//! Input: a [`Program`], the lane of each compartment, the first lane of each shard. Output: a
//! [`Plan`] of the plastic projections, and for each shard its plastic synapses. A *place* is the
//! index of a synapse in the columns of a shard. Places are ordered by projection, then source,
//! then target, so that a spike reads consecutive places.
//!
//! The tables of cores name rules, not projections. A synapse is identified by its ends, delay and
//! format, which two plastic projections never share. Several synapses with these in common are
//! identified by their weight before the first step; those of equal weight are interchangeable.
//!
//! They are in no dense block, row or list: these forms scale, sum and compare weights when they
//! are made, and a weight could not be recovered after a negative exponent.

use crate::lanes::sums::Sums;
use nsim_dynamics::learning::Compiled;
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::csr::Csr;
use nsim_ir::base::fixed::Delay;
use nsim_ir::base::id::{CompartmentId, CoreId, Id, IdVec, RuleId};
use nsim_ir::learning::Variable;
use nsim_ir::program::{PlasticProjection, Program};
use nsim_ir::quantised::connectivity::SynapseFormat;

/// The plastic projections of a program, for all shards.
#[derive(Debug, Default)]
pub(crate) struct Plan {
    /// The rules.
    pub rules: IdVec<RuleId, Compiled>,
    pub projections: Vec<ProjectionPlan>,
    /// Indices of the projections of each source, channels first.
    pub of_source: Csr<u32>,
    /// Indices of the projections to each compartment.
    pub of_target: Csr<u32>,
    /// Columns that the state needs, besides weights.
    pub has_delays: bool,
    pub has_tags: bool,
}

/// A plastic projection.
#[derive(Debug, Clone)]
pub(crate) struct ProjectionPlan {
    pub of: PlasticProjection,
    /// Whether the rule changes delays that act.
    pub moves: bool,
    /// Whether the rule sees spikes later than they are delivered: (L8).
    pub sees_late: bool,
}

impl Plan {
    /// The plan of a program.
    pub fn new(program: &Program) -> Self {
        let learning = &program.parts().learning;
        if learning.is_empty() {
            return Plan::default();
        }
        let rules: IdVec<RuleId, Compiled> =
            learning.rules.iter().map(|learning| Compiled::new(&learning.rule)).collect();
        let plan = |of: &PlasticProjection| {
            let rule = rules[of.plastic.rule].rule();
            let acts = rule.semantics().delays_act();
            let moves = acts && rule.changes(Variable::Delay);
            ProjectionPlan { of: of.clone(), moves, sees_late: acts && (moves || of.delay > Delay::MIN) }
        };
        let projections: Vec<ProjectionPlan> = learning.projections.iter().map(plan).collect();
        let by_unit = |units: u32, range: fn(&PlasticProjection) -> std::ops::Range<u32>| {
            Csr::by_row(units as usize, |put| {
                for (number, projection) in (0..).zip(&projections) {
                    range(&projection.of).for_each(|unit| put(unit as usize, number));
                }
            })
        };
        let uses = |variable| rules.iter().any(|rule| rule.uses(variable));
        Plan {
            of_source: by_unit(program.channels() + program.compartments(), |of| of.sources.clone()),
            of_target: by_unit(program.compartments(), |of| of.targets.clone()),
            has_delays: uses(Variable::Delay) || projections.iter().any(|plan| !plan.of.plastic.delays.is_empty()),
            has_tags: uses(Variable::Tag) || projections.iter().any(|plan| !plan.of.plastic.tags.is_empty()),
            projections,
            rules,
        }
    }

    /// Whether a rule changes delays that act.
    pub fn moves(&self) -> bool {
        self.projections.iter().any(|projection| projection.moves)
    }
}

/// The plastic synapses of a shard, in columns by place.
#[derive(Debug, Default)]
pub(crate) struct PlasticSynapses {
    /// By projection.
    pub projections: Vec<Rows>,
    /// Lane of the sum that each adds to, within the shard.
    pub lanes: Vec<u32>,
    /// Target of each, within its population.
    pub targets: Vec<u32>,
    /// Row of each among those of its rule.
    pub row_of: Vec<u32>,
    /// Whether each is in a list without indices on its core.
    pub dense: Vec<bool>,
    /// The state of each before learning; delays and tags only where a rule uses them.
    pub first: Columns,
}

/// The variables of synapses, by place.
#[derive(Debug, Clone, Default)]
pub(crate) struct Columns {
    pub weights: Vec<i16>,
    pub delays: Vec<i16>,
    pub tags: Vec<i16>,
}

impl Columns {
    /// Bytes of memory that they hold.
    pub fn bytes(&self) -> usize {
        2 * (self.weights.len() + self.delays.len() + self.tags.len())
    }

    /// A variable's column; empty where no rule uses it.
    pub fn column(&self, variable: Variable) -> &[i16] {
        match variable {
            Variable::Weight => &self.weights,
            Variable::Delay => &self.delays,
            Variable::Tag => &self.tags,
        }
    }

    /// A variable's column.
    pub fn column_mut(&mut self, variable: Variable) -> &mut [i16] {
        match variable {
            Variable::Weight => &mut self.weights,
            Variable::Delay => &mut self.delays,
            Variable::Tag => &mut self.tags,
        }
    }
}

/// The synapses of a projection in a shard.
#[derive(Debug, Default)]
pub(crate) struct Rows {
    /// First place of each source, and the end of the last.
    pub firsts: Vec<u32>,
    /// Places of synapses by target.
    pub by_target: Csr<u32>,
    /// The source of each of these, within its population.
    pub sources: Vec<u32>,
    /// Core of each target.
    pub core_of: Vec<CoreId>,
}

impl Rows {
    /// Places of the projection.
    pub fn places(&self) -> std::ops::Range<usize> {
        self.firsts[0] as usize..self.firsts[self.firsts.len() - 1] as usize
    }

    /// Places of a source of the projection.
    #[inline]
    pub fn of_source(&self, source: usize) -> std::ops::Range<usize> {
        self.firsts[source] as usize..self.firsts[source + 1] as usize
    }

    /// Places of the synapses of a target, and their sources.
    #[inline]
    pub fn of_target(&self, target: u32) -> (&[u32], &[u32]) {
        let firsts = self.by_target.firsts();
        let range = firsts[target as usize] as usize..firsts[target as usize + 1] as usize;
        (&self.by_target.items()[range.clone()], &self.sources[range])
    }
}

/// A synapse of a source, before it has a place.
struct Found {
    target: CompartmentId,
    weight: i16,
    /// Its number among those of the projection.
    number: u32,
    dense: bool,
}

impl PlasticSynapses {
    /// The plastic synapses of each shard.
    pub fn by_shard(program: &Program, plan: &Plan, lanes: &[u32], bases: &[u32], sums: &Sums) -> Vec<Self> {
        let mut all: Vec<Self> = bases.iter().map(|_| Self::default()).collect();
        for projection in &plan.projections {
            let sources = projection.of.sources.len();
            let core_of = projection.of.targets.clone().map(|id| program.seats()[CompartmentId(id)].core);
            let core_of: Vec<CoreId> = core_of.collect();
            for of_shard in &mut all {
                let firsts = Vec::with_capacity(sources + 1);
                of_shard.projections.push(Rows { firsts, core_of: core_of.clone(), ..Rows::default() });
            }
            let mut next = 0;
            for source in 0..sources as u32 {
                all.iter_mut().for_each(PlasticSynapses::begin_row);
                for found in of_source(program, &projection.of, source, &mut next) {
                    let lane = lanes[found.target.index()];
                    let shard = bases.partition_point(|&base| base <= lane) - 1;
                    let offset = sums.offset(found.target, projection.of.format, projection.of.delay.get());
                    all[shard].push(projection, &found, lane - bases[shard] + offset, plan);
                }
            }
            for of_shard in &mut all {
                of_shard.begin_row();
                of_shard.index_targets(projection.of.targets.len());
            }
        }
        all
    }

    fn begin_row(&mut self) {
        let place = self.lanes.len() as u32;
        if let Some(rows) = self.projections.last_mut() {
            rows.firsts.push(place);
        }
    }

    fn push(&mut self, projection: &ProjectionPlan, found: &Found, lane: u32, plan: &Plan) {
        let (of, number) = (&projection.of, found.number as usize);
        self.lanes.push(lane);
        self.targets.push(found.target.0 - of.targets.start);
        self.row_of.push(of.plastic.rows[number]);
        self.dense.push(found.dense);
        self.first.weights.push(found.weight);
        if plan.has_delays {
            let acts = plan.rules[of.plastic.rule].rule().semantics().delays_act();
            self.first.delays.push(if acts { of.delay.get().into() } else { of.plastic.delay(number) });
        }
        if plan.has_tags {
            self.first.tags.push(of.plastic.tag(number));
        }
    }

    /// Indexes the places of the last projection by target.
    fn index_targets(&mut self, targets: usize) {
        let Some(rows) = self.projections.last_mut() else { return };
        let (first, end) = (rows.firsts[0], self.targets.len() as u32);
        rows.by_target = Csr::by_row(targets, |put| {
            (first..end).for_each(|place| put(self.targets[place as usize] as usize, place));
        });
        let lengths = (0..).zip(rows.firsts.windows(2).map(|ends| ends[1] - ends[0]));
        let source_of: Vec<u32> = lengths.flat_map(|(source, len)| std::iter::repeat_n(source, len as usize)).collect();
        rows.sources = rows.by_target.items().iter().map(|place| source_of[(place - first) as usize]).collect();
    }

    /// Bytes of memory that they hold.
    pub fn bytes(&self) -> usize {
        let rows = self
            .projections
            .iter()
            .map(|rows| 4 * (rows.firsts.len() + 2 * rows.by_target.items().len() + rows.by_target.len()));
        13 * self.lanes.len() + self.first.bytes() + rows.sum::<usize>()
    }
}

/// The local synapses of a source of a projection, by target; `next` is the number of its first.
fn of_source(program: &Program, of: &PlasticProjection, source: u32, next: &mut u32) -> Vec<Found> {
    let mut numbered = Vec::new();
    of.connectivity.for_each_from(source, |target, weight| {
        let target = CompartmentId(of.targets.start + target);
        if program.is_local(program.seats()[target].core) {
            numbered.push(Found { target, weight, number: *next, dense: false });
        }
        *next += 1;
    });
    numbered.sort_unstable_by_key(|found| (found.target, found.weight, found.number));
    let mut stored = Vec::with_capacity(numbered.len());
    for message in program.messages(of.sources.start + source) {
        let (class, ids) = (program.class_of(message.core), &program.cores()[message.core].ids);
        for synapse in class.inputs.get(usize::from(message.axon)).synapses() {
            let (format, target) = (class.formats[usize::from(synapse.format)], ids[usize::from(synapse.slot)]);
            if is_of(of, format.synapse, synapse.delay, target) {
                stored.push((target, synapse.weight, format.index_bits.is_none()));
            }
        }
    }
    stored.sort_unstable();
    debug_assert!(stored.iter().map(|s| (s.0, s.1)).eq(numbered.iter().map(|found| (found.target, found.weight))));
    numbered.iter_mut().zip(stored).for_each(|(found, (.., dense))| found.dense = dense);
    numbered
}

/// Whether a stored synapse is one of a projection.
fn is_of(of: &PlasticProjection, format: SynapseFormat, delay: Delay, target: CompartmentId) -> bool {
    format == of.format && delay == of.delay && of.targets.contains(&target.0)
}
