//! Several mappings of a network, compared by what a step of them is expected to cost.
//!
//! In come a network, a target and an objective; out goes the best of several *candidates*. A candidate is a strategy and
//! the part of each core that it may fill: cores that hold half as much take half as long and are twice as many. The first
//! candidate is always the sequential order, placed; another one must be better than it by `MARGIN` to be taken for the
//! time of a step, because the expected step is not the simulated one.

use std::sync::Mutex;

use rayon::prelude::*;

use crate::compile::expect::{Score, score};
use crate::compile::rates::Rates;
use crate::compile::{CompileError, Compiled, Objective, Options, Strategy, partitioned};
use crate::desc::target::{Limits, Target};
use crate::ir::quantised::Quantised;

/// Parts of a core, as divisors, that candidates fill.
const DIVISORS: [u32; 6] = [1, 2, 4, 8, 16, 32];
/// How much less a mean step must take to be trusted to take no longer when spikes come together.
const MARGIN: f64 = 0.9;
/// Synapses that a second of effort allows to be mapped anew, over all candidates.
const SYNAPSES_PER_SECOND: u64 = 4_000_000;

/// A way of mapping.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct Candidate {
    /// How compartments are gathered.
    #[serde(serialize_with = "strategy_name")]
    pub strategy: Strategy,
    /// A core is filled to one part in so many.
    pub divisor: u32,
}

fn strategy_name<S: serde::Serializer>(strategy: &Strategy, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(strategy.name())
}

/// A candidate that fits.
#[derive(Debug, Clone)]
pub struct Found {
    /// How it was made.
    pub candidate: Candidate,
    /// What it is worth.
    pub score: Score,
    /// The mapping.
    pub compiled: Compiled,
}

/// A core's limits divided, never below what one compartment of any network may need.
fn divided(target: &Target, divisor: u32) -> Target {
    let limits = target.limits();
    let divided = Limits {
        compartments: (limits.compartments / divisor).max(1),
        synapse_words: (limits.synapse_words / divisor).max(limits.synapse_words_per_axon),
        ..*limits
    };
    target.clone().with_limits(divided)
}

/// Every candidate that fits and that the effort allows for, the sequential one first.
///
/// # Errors
/// [`CompileError`] of the first candidate, when none fits.
pub fn candidates(
    one: &Quantised,
    target: &Target,
    options: &Options,
    rates: &Rates,
) -> Result<Vec<Found>, CompileError> {
    let synapses = one.synapses() * u64::from(options.copies);
    let affordable = (u64::from(options.effort_s) * SYNAPSES_PER_SECOND / synapses.max(1)).max(1) as usize;
    let wanted = DIVISORS.map(|divisor| Candidate { strategy: options.strategy, divisor });
    let sequential = Candidate { strategy: Strategy::Sequential, divisor: 1 };
    let mut all = vec![sequential];
    all.extend(wanted.into_iter().filter(|&candidate| candidate != sequential).take(affordable));
    // The effort is for all of them together.
    let options = &Options { effort_s: options.effort_s.div_ceil(all.len() as u32), ..*options };
    let first_error = Mutex::new(None);
    let found: Vec<Option<Found>> = all
        .into_par_iter()
        .map(|candidate| match mapped(one, target, options, rates, candidate) {
            Ok(found) => Some(found),
            Err(error) => {
                let mut first = first_error.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                if first.is_none() || candidate == sequential {
                    *first = Some(error);
                }
                None
            }
        })
        .collect();
    let found: Vec<Found> = found.into_iter().flatten().collect();
    match first_error.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner) {
        Some(error) if found.is_empty() => Err(error),
        _ => Ok(found),
    }
}

fn mapped(
    one: &Quantised,
    target: &Target,
    options: &Options,
    rates: &Rates,
    candidate: Candidate,
) -> Result<Found, CompileError> {
    let asked = Options { strategy: candidate.strategy, ..*options };
    let mut partitioned = partitioned(one.clone(), &divided(target, candidate.divisor), &asked, rates)?;
    partitioned.within(target)?;
    let compiled = partitioned.placed(target, &asked)?;
    let score = score(&compiled, target).map_err(CompileError::Input)?;
    Ok(Found { candidate, score, compiled })
}

/// The best of all candidates.
///
/// # Errors
/// As [`candidates`].
pub fn best(one: &Quantised, target: &Target, options: &Options, rates: &Rates) -> Result<Compiled, CompileError> {
    let mut found = candidates(one, target, options, rates)?.into_iter();
    let Some(mut best) = found.next() else {
        return Err(CompileError::Fault("there is no candidate".to_string()));
    };
    let plain = best.score;
    for other in found {
        let trusted = options.objective != Objective::Latency || other.score.step_us < MARGIN * plain.step_us;
        if trusted && other.score.better(&best.score, options.objective).is_lt() {
            best = other;
        }
    }
    best.compiled.options = *options;
    Ok(best.compiled)
}

/// Those that no other is better than in everything: cores, energy and time.
#[must_use]
pub fn front(found: &[Found]) -> Vec<&Found> {
    let dominated = |one: &Found| found.iter().any(|other| other.score.dominates(&one.score));
    let mut front: Vec<&Found> = Vec::new();
    for one in found.iter().filter(|one| !dominated(one)) {
        if !front.iter().any(|other| other.score == one.score) {
            front.push(one);
        }
    }
    front.sort_by(|a, b| a.score.better(&b.score, Objective::Cores));
    front
}
