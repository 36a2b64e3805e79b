//! Random numbers of learning: functions of (seed, rule, use, entity, step), or recorded ones.
//!
//! An entity is the index of a source or target among those of the rule, or a synapse by its ends.
//! So results depend on neither threads, cores nor the division into ranks. Copies of a network
//! have equal numbers.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::base::id::{Id, IdVec, RuleId};
use crate::base::names::named_variants;
use crate::base::rng;

named_variants! {
    /// What a random number decides. The names are the keys of recorded draws.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
    pub enum Use {
        /// Decay of presynaptic traces.
        PreDecay = "draw_x_decay",
        /// The fraction of a presynaptic impulse.
        PreImpulse = "draw_x_impulse",
        /// Decay of postsynaptic traces.
        PostDecay = "draw_y_decay",
        /// The fraction of a postsynaptic impulse.
        PostImpulse = "draw_y_impulse",
        /// Rounding of the variables of synapses.
        Round = "draw_round",
        /// The fraction of a further spike of a target in an epoch.
        Post = "draw_post",
        /// The fraction of a further spike of a source in an epoch, where it is drawn.
        Pre = "draw_pre",
        /// Rounding of a trace of PES, for each source.
        Trace = "draw_trace",
        /// Rounding of a weight of PES, for each source and target.
        Weight = "draw_weight",
    }
}

impl Use {
    /// Whether there is one number for each step, not for each epoch.
    pub const fn is_of_steps(self) -> bool {
        matches!(self, Use::Post | Use::Pre)
    }

    /// Whether the numbers are integers from 0 to 127; the others are real, from 0 to below 1.
    pub const fn is_whole(self) -> bool {
        matches!(self, Use::PreImpulse | Use::PostImpulse | Use::Post | Use::Pre)
    }

    /// The first of these numbers that is none of this use, as a message.
    pub fn unfit(self, numbers: &[f64]) -> Option<String> {
        let fits = |x: f64| match self.is_whole() {
            true => x.fract() == 0.0 && (0.0..128.0).contains(&x),
            false => (0.0..1.0).contains(&x),
        };
        let place = numbers.iter().position(|&x| !fits(x))?;
        let range = if self.is_whole() { "a whole number from 0 to 127" } else { "from 0 to below 1" };
        Some(format!("{}: number {place} is {}, not {range}", self.name(), numbers[place]))
    }
}

/// Recorded numbers of one rule, by use.
pub type Recorded = BTreeMap<Use, Vec<f64>>;

/// The random numbers of a run.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Draws {
    /// The seed.
    pub seed: u64,
    /// Recorded numbers, which replace the seeded ones of lava's semantics and of PES.
    pub recorded: Arc<IdVec<RuleId, Option<Recorded>>>,
    /// Whether these are the numbers of a single step, not of a run.
    pub of_step: bool,
}

/// What random numbers decide in a step, one for each entity.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Place {
    /// The rule.
    pub rule: RuleId,
    /// Their use.
    pub of: Use,
    /// Number of the trace or variable among those of the rule.
    pub part: u8,
    /// The step, counted over the samples since learning began.
    pub step: u64,
}

/// The random numbers of a place.
#[derive(Debug, Clone, Copy)]
pub struct Numbers(u64);

impl Numbers {
    /// 64 random bits for an entity.
    #[inline]
    pub fn bits(self, entity: u32) -> u64 {
        rng::digest(self.0, entity.into())
    }

    /// A real number in [0, 1), a multiple of 2^-32.
    #[inline]
    pub fn unit(self, entity: u32) -> f64 {
        f64::from((self.bits(entity) >> 32) as u32) / (1u64 << 32) as f64
    }

    /// The part of a source in the numbers of its synapses.
    #[inline(always)]
    pub fn of_source(self, source: u32) -> u32 {
        rng::mix32(source ^ self.0 as u32)
    }

    /// 32 random bits for a synapse, from the part of its source. Synapses with the same ends have
    /// the same. They have half the width of other numbers, which vectors multiply in one step.
    #[inline(always)]
    pub fn of_synapse(self, of_source: u32, target: u32) -> u32 {
        rng::mix32(of_source ^ target.wrapping_add((self.0 >> 32) as u32))
    }
}

impl Draws {
    /// Seeded numbers.
    pub fn seeded(seed: u64) -> Self {
        Draws { seed, ..Draws::default() }
    }

    /// The random numbers of a place: a function of the seed, the place and the entity.
    pub fn at(&self, Place { rule, of, part, step }: Place) -> Numbers {
        let part = u64::from(part) | (of as u64) << 8 | (rule.index() as u64) << 16;
        Numbers(rng::bits(self.seed, part, step))
    }

    /// The place of a number among the recorded ones of its entity.
    fn place(&self, number: u32) -> usize {
        if self.of_step { 0 } else { number as usize }
    }

    /// The number of one of a count of entities, real in [0, 1). `number` counts those of each
    /// entity in the run from 0; recorded ones have all entities in a row.
    pub fn each(&self, place: Place, number: u32, entity: u32, count: usize) -> f64 {
        match self.recorded.get(place.rule).and_then(Option::as_ref).and_then(|recorded| recorded.get(&place.of)) {
            Some(numbers) => numbers.get(self.place(number) * count + entity as usize).copied().unwrap_or(0.0),
            None => self.at(place).unit(entity),
        }
    }

    /// The number that all entities of a rule share: real in [0, 1), or whole from 0 to 127.
    /// `number` counts epochs or steps of the run from 0, `step` those since learning began.
    pub fn shared(&self, rule: RuleId, of: Use, number: u32, step: u64) -> f64 {
        let recorded = self.recorded.get(rule).and_then(Option::as_ref).and_then(|recorded| recorded.get(&of));
        if let Some(numbers) = recorded {
            return numbers.get(self.place(number)).copied().unwrap_or(0.0);
        }
        let numbers = self.at(Place { rule, of, part: 0, step });
        if of.is_whole() { (numbers.bits(0) >> 57) as f64 } else { numbers.unit(0) }
    }
}
