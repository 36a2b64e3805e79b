//! Several mappings of a network, compared by what a step of them is expected to cost.
//!
//! In come a network, a target and an objective; out goes the best of several *candidates*. A candidate is a strategy and
//! the part of each core that it may fill: cores that hold half as much take half as long and are twice as many. The first
//! candidates are always the sequential order, unplaced as the public tools leave it and placed.
//!
//! The expected step of mean rates is not the simulated one: spikes come together, and more cores mean more messages over
//! the busiest link when they do. For the time of a step a candidate must therefore be no slower than the unplaced
//! sequential one when every source spikes at once, and when all sources of one population do: over all populations and, but
//! where that is `SHORT`, for each. One that is faster by `MARGIN` at the rates that it is made for, or holds the same
//! compartments on the same cores, may be slower by as much in one population's burst; another must be faster by
//! `EVERYWHERE`, also when every source spikes.

use std::sync::Mutex;

use rayon::prelude::*;

use crate::compile::explore::cost_estimate::{Score, score, score_at};
use crate::compile::reason::Reason;
use crate::compile::resources::fan_in::first_source;
use crate::compile::{CompileError, Compiled, Objective, Options, Routed, Strategy, partitioned};
use crate::desc::target::{Limits, Target};
use crate::ir::firing_rates::Rates;
use crate::ir::partition::Resource;
use crate::ir::quantised::Quantised;

/// Parts of a core, as divisors, that candidates fill.
pub(crate) const DIVISORS: [u32; 6] = [1, 2, 4, 8, 16, 32];
/// Those for the shortest step, in the order in which they are likely to take it, for networks so large that the effort is
/// not enough for all (`nsim bench map`). The first two are always tried.
const SHORTEST: [u32; 7] = [8, 1, 16, 32, 4, 64, 2];
/// How much less a mean step must take to be trusted to take no longer when spikes come together.
const MARGIN: f64 = 0.9;
/// How much less it must take where no burst may take longer and that of all sources takes as much less.
const EVERYWHERE: f64 = 0.95;
/// A step in which one population spikes is short when it takes less than this part of one in which all sources do.
const SHORT: f64 = 0.1;
/// Populations whose bursts candidates are compared in.
pub(crate) const MOST_BURSTS: usize = 16;
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
#[derive(Debug, Clone, Copy)]
pub struct Found {
    /// How it was made.
    pub candidate: Candidate,
    /// What it is worth.
    pub score: Score,
}

/// A candidate with its mapping.
#[derive(Debug)]
pub(crate) struct Made<M> {
    pub(crate) found: Found,
    pub(crate) mapping: M,
}

/// A core's limits divided, but for the words that one compartment needs, as far as they are known.
pub(crate) fn divided(target: &Target, divisor: u32, words: u32) -> Target {
    let limits = target.limits();
    let divided = Limits {
        compartments: (limits.compartments / divisor).max(1),
        synapse_words: (limits.synapse_words / divisor).max(limits.synapse_words_per_axon).max(words),
        ..*limits
    };
    target.clone().with_limits(divided)
}

/// The words that one compartment alone needs, when they are all that a divided core lacks and a whole one has them.
fn words_for_one(error: &CompileError, target: &Target) -> Option<u32> {
    let CompileError::DoesNotFit(reasons) = error else { return None };
    let words = |reason: &Reason| Some(reason.need).filter(|_| reason.resource == Resource::SynapseWords);
    let needs: Option<Vec<u64>> = reasons.iter().map(words).collect();
    let most = needs?.into_iter().max()?.try_into().ok()?;
    Some(most).filter(|&most| most <= target.limits().synapse_words)
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
    Ok(all(one, target, options, rates)?.into_iter().map(|made| made.found).collect())
}

fn all(one: &Quantised, target: &Target, options: &Options, rates: &Rates) -> Result<Vec<Made<Routed>>, CompileError> {
    let synapses = one.synapses() * u64::from(options.copies);
    let affordable = u64::from(options.effort_s) * SYNAPSES_PER_SECOND / synapses.max(1);
    let mut all = vec![(Strategy::Sequential, 1)];
    let (divisors, least) = match options.objective {
        Objective::Latency => (&SHORTEST[..], 2),
        Objective::Cores | Objective::Energy => (&DIVISORS[..], 1),
    };
    let wanted =
        divisors.iter().map(|&divisor| (options.strategy, divisor)).filter(|way| *way != (Strategy::Sequential, 1));
    all.extend(wanted.take(affordable.max(least) as usize));
    // The effort is for all of them together.
    let options = &Options { effort_s: options.effort_s.div_ceil(all.len() as u32), ..*options };
    let first_error = Mutex::new(None);
    let found: Vec<Vec<Made<Routed>>> = all
        .into_par_iter()
        .enumerate()
        .map(|(number, (strategy, divisor))| {
            // The sequential cores are looked at unplaced too.
            let places = if number == 0 && options.place { &[false, true][..] } else { &[options.place] };
            mapped(one, target, options, rates, (strategy, divisor), places).unwrap_or_else(|error| {
                tracing::debug!(strategy = strategy.name(), divisor, %error, "candidate");
                let mut first = first_error.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                if first.is_none() || number == 0 {
                    *first = Some(error);
                }
                Vec::new()
            })
        })
        .collect();
    let found: Vec<Made<Routed>> = found.into_iter().flatten().collect();
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
) -> Result<Vec<Made<Routed>>, CompileError> {
    let asked = Options { strategy, ..*options };
    let gathered = |words| partitioned(one.clone(), &divided(target, divisor, words), &asked, rates);
    let mut partitioned = gathered(0).or_else(|error| match words_for_one(&error, target) {
        Some(words) => gathered(words),
        None => Err(error),
    })?;
    partitioned.within(target)?;
    let made = |&placed: &bool| {
        let routed = partitioned.routed(target, &Options { place: placed, ..asked })?;
        let score = score(&routed.0, target).map_err(CompileError::Input)?;
        let found = Found { candidate: Candidate { strategy, divisor, placed }, score };
        tracing::debug!(?found, "candidate");
        Ok(Made { found, mapping: routed })
    };
    places.iter().map(made).collect()
}

/// The best of all candidates.
///
/// # Errors
/// As [`candidates`].
pub fn best(one: &Quantised, target: &Target, options: &Options, rates: &Rates) -> Result<Compiled, CompileError> {
    let made = all(one, target, options, rates)?;
    let bursts = made.first().map_or_else(Vec::new, |plain| bursts(&plain.mapping.0.quantised));
    let times = |routed: &Routed| {
        let of = |rates: &Rates| score_at(&routed.0, rates, target).map(|score| score.step_us);
        bursts.iter().map(of).collect::<Result<Vec<f64>, _>>().map_err(CompileError::Input)
    };
    let mut best = chosen(made, options.objective, times)?.proved(target)?;
    best.options = *options;
    Ok(best)
}

/// The best of candidates, the first of which is what others are measured by; `times` are those of steps in which spikes
/// come together, all of them first.
pub(crate) fn chosen<M>(
    made: Vec<Made<M>>,
    objective: Objective,
    times: impl Fn(&M) -> Result<Vec<f64>, CompileError>,
) -> Result<M, CompileError> {
    let mut made = made.into_iter();
    let Some(plain) = made.next() else {
        return Err(CompileError::Fault("there is no candidate".to_string()));
    };
    let better = |other: &Made<M>| other.found.score.better(&plain.found.score, objective).is_lt();
    let mut others: Vec<Made<M>> = made.filter(better).collect();
    others.sort_by(|a, b| a.found.score.better(&b.found.score, objective));
    if objective != Objective::Latency {
        return Ok(others.into_iter().next().unwrap_or(plain).mapping);
    }
    let least = if others.is_empty() { Vec::new() } else { times(&plain.mapping)? };
    for other in others {
        let shorter = |part: f64| other.found.score.step_us < part * plain.found.score.step_us;
        let trusted = same_cores(&other.found, &plain.found) || shorter(MARGIN);
        // Bursts take long to reckon.
        if !trusted && !shorter(EVERYWHERE) {
            continue;
        }
        let times = times(&other.mapping)?;
        tracing::debug!(candidate = ?other.found.candidate, ?times, ?least, "steps of bursts in microseconds");
        let everywhere = || times.first().zip(least.first()).is_none_or(|(all, plain)| *all < EVERYWHERE * plain);
        if !trusted && !everywhere() {
            continue;
        }
        let slack = if trusted { 1.0 / MARGIN } else { 1.0 };
        if no_slower(&times, &least, slack) {
            return Ok(other.mapping);
        }
    }
    Ok(plain.mapping)
}

/// Whether two candidates hold the same compartments on the same cores.
fn same_cores(one: &Found, other: &Found) -> bool {
    let cores = |found: &Found| (found.candidate.strategy, found.candidate.divisor);
    cores(one) == cores(other)
}

/// Whether bursts take no longer than in the unplaced sequential mapping: the first, in which all sources spike; those of one
/// population, all of them together; and each of these, but for `slack` and for those that are short beside the first.
fn no_slower(times: &[f64], plain: &[f64], slack: f64) -> bool {
    let (Some((all, each)), Some((all_plain, each_plain))) = (times.split_first(), plain.split_first()) else {
        return true;
    };
    let short = SHORT * all_plain;
    all <= all_plain
        && each.iter().sum::<f64>() <= each_plain.iter().sum::<f64>()
        && each.iter().zip(each_plain).all(|(time, plain)| *time <= (plain * slack).max(short))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bursts_are_no_slower_all_together_and_each_but_for_slack_or_where_they_are_short() {
        let plain = [1_000.0, 400.0, 300.0, 20.0];
        assert!(no_slower(&plain, &plain, 1.0));
        assert!(!no_slower(&[1_001.0, 400.0, 300.0, 20.0], &plain, 2.0), "when all spike there is no slack");
        assert!(!no_slower(&[900.0, 410.0, 200.0, 20.0], &plain, 1.0));
        assert!(no_slower(&[900.0, 410.0, 200.0, 20.0], &plain, 1.0 / MARGIN));
        assert!(!no_slower(&[900.0, 450.0, 200.0, 20.0], &plain, 1.0 / MARGIN));
        assert!(!no_slower(&[900.0, 410.0, 300.0, 20.0], &plain, 1.0 / MARGIN), "all populations together take longer");
        assert!(
            no_slower(&[900.0, 300.0, 300.0, 99.0], &plain, 1.0),
            "a tenth of the step in which all spike is short"
        );
    }
}
