//! Several mappings of a network, compared by what a step of them is expected to cost.
//!
//! In come a network, a target and an objective; out goes the best of several *candidates*. A candidate is a strategy and
//! the part of each core that it may fill: cores that hold half as much take half as long and are twice as many. The first
//! candidates are always the sequential order, unplaced as the public tools leave it and placed.
//!
//! The expected step of mean rates is not the simulated one: spikes come together, and more cores mean more messages over
//! the busiest link when they do. For the time of a step a candidate must therefore be no slower than the unplaced
//! sequential one when every source spikes at once, and when all sources of one population do unless that is `SHORT`; and,
//! unless it holds the same compartments on the same cores, faster by `MARGIN` at the rates that it is made for.

use std::sync::Mutex;

use rayon::prelude::*;

use crate::compile::expect::{Score, score, score_at};
use crate::compile::fanin::first_source;
use crate::compile::rates::Rates;
use crate::compile::{CompileError, Compiled, Objective, Options, Routed, Strategy, partitioned};
use crate::desc::target::{Limits, Target};
use crate::ir::quantised::Quantised;

/// Parts of a core, as divisors, that candidates fill.
const DIVISORS: [u32; 6] = [1, 2, 4, 8, 16, 32];
/// How much less a mean step must take to be trusted to take no longer when spikes come together.
const MARGIN: f64 = 0.9;
/// A step in which one population spikes is short when it takes less than this part of one in which all sources do.
const SHORT: f64 = 0.1;
/// Populations whose bursts candidates are compared in.
const MOST_BURSTS: usize = 16;
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
    /// Whether cores are placed by traffic.
    pub placed: bool,
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
    routed: Routed,
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

/// Every candidate that fits and that the effort allows for, the sequential ones first.
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
    let mut all = vec![(Strategy::Sequential, 1)];
    let wanted = DIVISORS.map(|divisor| (options.strategy, divisor));
    all.extend(wanted.into_iter().filter(|way| *way != all[0]).take(affordable).collect::<Vec<_>>());
    // The effort is for all of them together.
    let options = &Options { effort_s: options.effort_s.div_ceil(all.len() as u32), ..*options };
    let first_error = Mutex::new(None);
    let found: Vec<Vec<Found>> = all
        .into_par_iter()
        .enumerate()
        .map(|(number, (strategy, divisor))| {
            // The sequential cores are looked at unplaced too.
            let places = if number == 0 && options.place { &[false, true][..] } else { &[options.place] };
            mapped(one, target, options, rates, (strategy, divisor), places).unwrap_or_else(|error| {
                let mut first = first_error.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                if first.is_none() || number == 0 {
                    *first = Some(error);
                }
                Vec::new()
            })
        })
        .collect();
    let found: Vec<Found> = found.into_iter().flatten().collect();
    match first_error.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner) {
        Some(error) if found.is_empty() => Err(error),
        _ => Ok(found),
    }
}

/// One partition, in these ways of placing it.
fn mapped(
    one: &Quantised,
    target: &Target,
    options: &Options,
    rates: &Rates,
    (strategy, divisor): (Strategy, u32),
    places: &[bool],
) -> Result<Vec<Found>, CompileError> {
    let asked = Options { strategy, ..*options };
    let mut partitioned = partitioned(one.clone(), &divided(target, divisor), &asked, rates)?;
    partitioned.within(target)?;
    let found = |&placed: &bool| {
        let routed = partitioned.routed(target, &Options { place: placed, ..asked })?;
        let score = score(&routed.0, target).map_err(CompileError::Input)?;
        Ok(Found { candidate: Candidate { strategy, divisor, placed }, score, routed })
    };
    places.iter().map(found).collect()
}

/// The best of all candidates.
///
/// # Errors
/// As [`candidates`].
pub fn best(one: &Quantised, target: &Target, options: &Options, rates: &Rates) -> Result<Compiled, CompileError> {
    let mut found = candidates(one, target, options, rates)?.into_iter();
    let Some(plain) = found.next() else {
        return Err(CompileError::Fault("there is no candidate".to_string()));
    };
    let mut others: Vec<Found> = found.filter(|other| better(other, &plain, options.objective)).collect();
    others.sort_by(|a, b| a.score.better(&b.score, options.objective));
    let mut best = None;
    if options.objective == Objective::Latency {
        let bursts = bursts(&plain.routed.0.quantised);
        let times = |found: &Found| {
            let of = |rates: &Rates| score_at(&found.routed.0, rates, target).map(|score| score.step_us);
            bursts.iter().map(of).collect::<Result<Vec<f64>, _>>().map_err(CompileError::Input)
        };
        let least = if others.is_empty() { Vec::new() } else { times(&plain)? };
        for other in others {
            if no_slower(&times(&other)?, &least) {
                best = Some(other);
                break;
            }
        }
    } else {
        best = others.into_iter().next();
    }
    let mut best = best.unwrap_or(plain).routed.proved(target)?;
    best.options = *options;
    Ok(best)
}

/// Whether a candidate is better than the unplaced sequential one by enough to be looked at.
fn better(other: &Found, plain: &Found, objective: Objective) -> bool {
    let same_cores = other.candidate.strategy == Strategy::Sequential && other.candidate.divisor == 1;
    let margin = if same_cores { 1.0 } else { MARGIN };
    other.score.better(&plain.score, objective).is_lt()
        && (objective != Objective::Latency || other.score.step_us < margin * plain.score.step_us)
}

/// Whether no burst takes longer than in the unplaced sequential mapping, but for those of one population that are short
/// in both beside the first, in which all sources spike.
fn no_slower(times: &[f64], plain: &[f64]) -> bool {
    let short = plain.first().map_or(0.0, |all| SHORT * all);
    times
        .iter()
        .zip(plain)
        .enumerate()
        .all(|(burst, (time, plain))| *time <= if burst == 0 { *plain } else { plain.max(short) })
}

/// Rates of steps in which all sources spike, and in which those of one population do, for as many as are affordable.
fn bursts(network: &Quantised) -> Vec<Rates> {
    let mut bursts = vec![Rates::assumed(1.0)];
    for population in network.populations().iter().take(MOST_BURSTS) {
        let mut spikes = vec![0u64; (network.channels() + network.compartments()) as usize];
        let first = first_source(network, population) as usize;
        spikes[first..first + population.shape.len() as usize].fill(1);
        let (channels, compartments) = spikes.split_at(network.channels() as usize);
        bursts.push(Rates::profile(channels, compartments, 1));
    }
    bursts
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
