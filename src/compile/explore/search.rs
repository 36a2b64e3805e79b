//! Several mappings of a network, compared by what a step of them is expected to cost.
//!
//! Input: a network, a target and an objective. Output: the best of several *candidates*. A candidate is a strategy and
//! the part of each core that it may fill: cores that hold half as much take half as long and are twice as many. The first
//! candidates are always the sequential order, unplaced as the public tools leave it and placed.
//!
//! The expected step of mean rates is not the simulated one: spikes come in bursts, and more cores mean more messages over
//! the busiest link in a burst. For the time of a step a candidate must therefore be no slower than the unplaced
//! sequential one when every source spikes at once, and when all sources of one population do: over all populations and, but
//! where that is `SHORT`, for each. One that is faster by `MARGIN` at the rates that it is made for, or holds the same
//! compartments on the same cores, may be slower by as much in one population's burst; another must be faster by
//! `EVERYWHERE`, also when every source spikes. Both are parts of the time on the chips: the host takes as long to inject whatever the
//! mapping, and may take most of a step. Where it does, what is saved has to be a part of the whole, too (`OF_WHOLE`).

use std::time::{Duration, Instant};

use rayon::prelude::*;

use crate::compile;
use crate::compile::error::{CompileError, Result};
use crate::compile::explore::box_costs::PlacedBoxes;
use crate::compile::explore::cost_estimate::{Score, score_at};
use crate::compile::form::Form;
use crate::compile::mapping::{Mapping, Synapses};
use crate::compile::mapping_file::file_of_boxes;
use crate::compile::options::{Effort, Objective, Options, Strategy};
use crate::compile::partition::box_fan_out::{PopulationRates, everywhere, only};
use crate::compile::partition::boxes::{Boxes, Layers};
use crate::compile::reason::Reason;
use crate::compile::resources::fan_in::first_source;
use crate::compile::stages::{Front, Unchecked};
use crate::desc::mapping::MappingFile;
use crate::desc::resource::Resource;
use crate::desc::target::Target;
use crate::ir::firing_rates::Rates;
use crate::ir::placement::Placement;
use crate::ir::quantised::Quantised;

/// Parts of a core, as divisors, that candidates fill.
const DIVISORS: [u32; 6] = [1, 2, 4, 8, 16, 32];
/// Those for the shortest step, in the order in which they are likely to take it, for networks so large that the effort is
/// not enough for all (`nsim bench map`). The first two are always tried.
const SHORTEST: [u32; 7] = [4, 1, 8, 32, 16, 64, 2];
/// How much less a mean step must take to be trusted to take no longer in a burst.
const MARGIN: f64 = 0.9;
/// How much less it must take where no burst may take longer and that of all sources takes as much less.
const EVERYWHERE: f64 = 0.95;
/// How much less the whole mean step must take, injection included.
const OF_WHOLE: f64 = 0.99;
/// A step in which one population spikes is short when it takes less than this part of one in which all sources do.
const SHORT: f64 = 0.1;
/// Populations whose bursts candidates are compared in.
const MOST_BURSTS: usize = 16;
/// Compartments that a second of effort allows to be cut into boxes, over all candidates.
const COMPARTMENTS_PER_SECOND: u64 = 20_000_000;
/// Synapses that a second of effort allows to be mapped, over all candidates.
const SYNAPSES_PER_SECOND: u64 = 4_000_000;

/// Stages that follow once cores have their places.
const FINISHING: [&str; 3] = ["route", "verify", "check"];
/// How much more time than the last time is kept for them.
const SLACK: f64 = 1.2;
/// The part of the time that must be left for looking for a better mapping to be worth it.
const LEAST_LEFT: f64 = 0.1;
/// The part of what is left that the partition may take; the rest is for placing.
const PARTITIONING: f64 = 0.7;

/// A way of mapping.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct Candidate {
    /// How compartments are grouped into cores.
    pub strategy: Strategy,
    /// A core is filled to one part in so many.
    pub divisor: u32,
    /// Whether cores are placed by traffic.
    pub placed: bool,
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
struct Made<M> {
    found: Found,
    kept: M,
}

/// A core's limits divided, but for the words that one compartment needs, as far as they are known.
fn divided(target: &Target, divisor: u32, words: u32) -> Target {
    let limits = target.limits();
    let words = (limits[Resource::SynapseWords] / divisor).max(limits[Resource::SynapseWordsPerAxon]).max(words);
    let compartments = (limits[Resource::Compartments] / divisor).max(1);
    let divided = limits.clone().with(Resource::Compartments, compartments).with(Resource::SynapseWords, words);
    target.clone().with_limits(divided)
}

/// The words that one compartment alone needs, when they are all that a divided core lacks and a whole one has them.
fn words_for_one(error: &CompileError, target: &Target) -> Option<u32> {
    let CompileError::DoesNotFit(reasons) = error else { return None };
    let words = |reason: &Reason| Some(reason.need).filter(|_| reason.resource == Resource::SynapseWords);
    let needs: Option<Vec<u64>> = reasons.iter().map(words).collect();
    let most = needs?.into_iter().max()?.try_into().ok()?;
    Some(most).filter(|&most| most <= target.limits()[Resource::SynapseWords])
}

/// What is kept of a candidate until one is taken.
enum Kept {
    /// The mapping, which has not been checked.
    Written(Box<Unchecked>),
    /// Of a symbolic mapping, which takes much memory, only where its boxes are: it is made again from there. With the name
    /// of the placement, and steps in which sources spike at once when they are needed.
    Symbolic { file: Box<MappingFile>, placed: &'static str, bursts: Vec<Score> },
}

/// A mapping for an objective: with [`Objective::Cores`] the one that the options say, otherwise the best of several.
/// `rates` are of one copy.
///
/// # Errors
/// [`CompileError`].
pub fn map(front: Front, target: &Target, options: &Options, rates: &Rates, form: Form) -> Result<Mapping> {
    let target = &*form.counted_on(target);
    if options.objective == Objective::Cores {
        return match options.effort {
            Effort::Work(_) => compile::map(front, target, options, rates, form),
            Effort::Within { end, .. } => by_the_clock(front, target, options, rates, (form, end)),
        };
    }
    let begin = Instant::now();
    let made = Search { form, front: &front, target, options, rates }.all()?;
    let mut bursts = None;
    let kept = chosen(made, options.objective, |kept| match kept {
        Kept::Written(unchecked) => {
            let Mapping { quantised, placement, program: Synapses::Written(program), .. } = unchecked.mapping() else {
                return Ok(Vec::new());
            };
            let bursts = bursts.get_or_insert_with(|| self::bursts(quantised));
            let score = |rates: &Rates| score_at(program, placement, options.copies, rates, target);
            Ok(bursts.iter().map(score).collect::<Result<_, _>>()?)
        }
        Kept::Symbolic { bursts, .. } => Ok(bursts.clone()),
    })?;
    let mut best = match kept {
        Kept::Written(unchecked) => unchecked.check(target)?,
        Kept::Symbolic { file, placed, .. } => {
            let compared = ("compare", begin.elapsed().as_secs_f64());
            let mut again = compile::load(front, target, options, &file, Form::Symbolic)?;
            again.placed = placed;
            again.seconds.insert(0, compared);
            again
        }
    };
    best.options = *options;
    Ok(best)
}

/// The best mapping found until a time: the quickest, unless there is time for a better one.
fn by_the_clock(
    front: Front,
    target: &Target,
    options: &Options,
    rates: &Rates,
    (form, end): (Form, Instant),
) -> Result<Mapping> {
    let begin = Instant::now();
    let given = end.saturating_duration_since(begin);
    let quick = Options { effort: Effort::Work(0), ..*options };
    let mut best = compile::map(front.clone(), target, &quick, rates, form)?;
    best.options = *options;
    // What a mapping takes once its cores have their places.
    let finishing = |mapping: &Mapping| {
        let stages = mapping.seconds.iter().filter(|(stage, _)| FINISHING.contains(stage));
        Duration::from_secs_f64(SLACK * stages.map(|(_, seconds)| seconds).sum::<f64>())
    };
    let left = || end.saturating_duration_since(Instant::now());
    let reserve = finishing(&best);
    if left() < given.mul_f64(LEAST_LEFT) + reserve + begin.elapsed() {
        return Ok(best);
    }
    let until = |part: f64| {
        let end = Instant::now() + left().saturating_sub(reserve).mul_f64(part);
        Options { effort: Effort::Within { budget_ms: 0, end }, ..*options }
    };
    let partitioned = front.partition(target, &until(PARTITIONING), rates, form)?;
    let mut other = partitioned.place(target, &until(1.0))?.emit(target, options)?.check(target)?;
    let costs = |mapping: &Mapping| (mapping.partition.cores(), mapping.traffic().hops_multicast_per_step);
    let ((cores, hops), (most_cores, most_hops)) = (costs(&other), costs(&best));
    if (cores, hops) < (most_cores, most_hops) {
        other.options = *options;
        best = other;
    }
    Ok(best)
}

/// Every candidate that fits and that the effort allows for, the one that others are measured by first.
///
/// # Errors
/// [`CompileError`] of the first candidate, when none fits.
pub fn candidates(front: &Front, target: &Target, options: &Options, rates: &Rates, form: Form) -> Result<Vec<Found>> {
    let target = &*form.counted_on(target);
    Ok(Search { form, front, target, options, rates }.all()?.into_iter().map(|made| made.found).collect())
}

/// What candidates are made of.
struct Search<'a> {
    front: &'a Front,
    form: Form,
    target: &'a Target,
    options: &'a Options,
    rates: &'a Rates,
}

impl Search<'_> {
    /// Strategies, and the part of a core that each may fill, for as many as the effort allows.
    fn ways(&self) -> Result<Vec<(Strategy, u32)>> {
        let Search { front, target, options, .. } = self;
        let (one, copies) = (front.quantised(), u64::from(options.copies));
        let affordable = |each_second: u64, size: u64| options.effort.work(each_second) / size.max(1);
        if self.form == Form::Symbolic {
            let layers = Layers::new(one)?;
            let most = affordable(COMPARTMENTS_PER_SECOND, u64::from(one.compartments()) * copies).max(1);
            let may_fit = |&divisor: &u32| divisor == 1 || layers.may_fit(&divided(target, divisor, 0), copies);
            let divisors = DIVISORS.into_iter().take(most as usize).filter(may_fit);
            return Ok(divisors.map(|divisor| (options.strategy, divisor)).collect());
        }
        let mut ways = vec![(Strategy::Sequential, 1)];
        let (divisors, least) = match options.objective {
            // The host draws its power for as long as a step lasts, and draws more than the cores.
            Objective::Latency | Objective::Energy => (&SHORTEST[..], 2),
            Objective::Cores | Objective::EnergyChip => (&DIVISORS[..], 1),
        };
        let wanted = divisors.iter().map(|&divisor| (options.strategy, divisor)).filter(|way| *way != ways[0]);
        let most = affordable(SYNAPSES_PER_SECOND, one.synapses() * copies).max(least);
        ways.extend(wanted.take(most as usize).collect::<Vec<_>>());
        Ok(ways)
    }

    fn all(&self) -> Result<Vec<Made<Kept>>> {
        let ways = self.ways()?;
        // The effort is for all of them together.
        let options = Options { effort: self.options.effort.shared_by(ways.len()), ..*self.options };
        let one_way = |(number, (strategy, divisor)): (usize, (Strategy, u32))| {
            // The first is tried unplaced too.
            let places = if number == 0 && options.place { &[false, true][..] } else { &[options.place] };
            let made = self.mapped(&Options { strategy, ..options }, divisor, places);
            if let Err(error) = &made {
                tracing::debug!(strategy = strategy.name(), divisor, %error, "candidate");
            }
            made
        };
        let ways = ways.into_iter().enumerate();
        let made: Vec<Result<Vec<Made<Kept>>>> = match self.form {
            Form::Written if self.options.effort.end().is_none() => {
                ways.collect::<Vec<_>>().into_par_iter().map(one_way).collect()
            }
            // One after the other: each takes as much memory as a mapping, and uses all threads.
            // By the clock, those that there is time for.
            Form::Written | Form::Symbolic => self.in_turn(ways, one_way),
        };
        let fits = made.iter().any(Result::is_ok);
        let mut found = Vec::new();
        for (number, made) in made.into_iter().enumerate() {
            match made {
                Ok(made) => found.extend(made),
                Err(error) if number == 0 && (!fits || self.form == Form::Symbolic) => return Err(error),
                Err(_) => {}
            }
        }
        Ok(found)
    }

    /// What ways come to, one after the other, until the next would take longer than there is time; the first in any case.
    fn in_turn<W, T>(&self, ways: impl Iterator<Item = (usize, W)>, map: impl Fn((usize, W)) -> T) -> Vec<T> {
        let (mut made, mut longest) = (Vec::new(), Duration::ZERO);
        for (number, way) in ways {
            let begin = Instant::now();
            if number > 0 && self.options.effort.end().is_some_and(|end| begin + longest > end) {
                break;
            }
            made.push(map((number, way)));
            longest = longest.max(begin.elapsed());
        }
        made
    }

    /// One partition, in these ways of placing it.
    fn mapped(&self, options: &Options, divisor: u32, places: &[bool]) -> Result<Vec<Made<Kept>>> {
        let Search { front, form, target, rates, .. } = *self;
        let partitioned = |words| front.clone().partition(&divided(target, divisor, words), options, rates, form);
        let partitioned = match (partitioned(0), form) {
            (Err(error), Form::Written) => match words_for_one(&error, target) {
                Some(words) => partitioned(words)?,
                None => return Err(error),
            },
            (made, _) => made?,
        };
        let partitioned = partitioned.within(target)?;
        let made = |&placed: &bool| {
            let options = &Options { place: placed, ..*options };
            let candidate = Candidate { strategy: options.strategy, divisor, placed };
            let (score, kept) = match &partitioned.boxes {
                None => {
                    let unchecked = partitioned.clone().place(target, options)?.emit(target, options)?;
                    let mapping = unchecked.mapping();
                    (mapping.score(&mapping.traffic(), target)?, Kept::Written(Box::new(unchecked)))
                }
                Some(boxes) => self.symbolic(&partitioned.all, boxes, partitioned.placement(target, options)?)?,
            };
            let found = Found { candidate, score };
            tracing::debug!(?found, "candidate");
            Ok(Made { found, kept })
        };
        places.iter().map(made).collect()
    }

    /// What is kept of boxes at these places, and what they cost.
    fn symbolic(
        &self,
        all: &Quantised,
        boxes: &Boxes,
        (placement, placed): (Placement, &'static str),
    ) -> Result<(Score, Kept)> {
        let Search { target, options, rates, .. } = *self;
        let at_places = PlacedBoxes { network: all, boxes, placement: &placement };
        let bursts = match options.objective {
            Objective::Latency => population_bursts(all),
            _ => Vec::new(),
        };
        let score = |rates: &PopulationRates| at_places.score(rates, &at_places.traffic(rates), target, options.copies);
        let bursts = bursts.iter().map(score).collect::<Result<_, _>>()?;
        let score = score(&everywhere(all, rates))?;
        let file = Box::new(file_of_boxes(all, boxes, &placement, target.name(), options));
        Ok((score, Kept::Symbolic { file, placed, bursts }))
    }
}

/// The best of candidates, the first of which is what others are measured by; `bursts` are steps in which sources spike at once, that
/// of all sources first.
fn chosen<M>(made: Vec<Made<M>>, objective: Objective, mut bursts: impl FnMut(&M) -> Result<Vec<Score>>) -> Result<M> {
    let mut made = made.into_iter();
    let Some(plain) = made.next() else {
        return Err(CompileError::Fault("there is no candidate".to_string()));
    };
    let better = |other: &Made<M>| other.found.score.better(&plain.found.score, objective).is_lt();
    let mut others: Vec<Made<M>> = made.filter(better).collect();
    others.sort_by(|a, b| a.found.score.better(&b.found.score, objective));
    if objective != Objective::Latency {
        return Ok(others.into_iter().next().unwrap_or(plain).kept);
    }
    let least = if others.is_empty() { Vec::new() } else { bursts(&plain.kept)? };
    let times = |bursts: &[Score]| bursts.iter().map(|score| score.step_us).collect::<Vec<f64>>();
    for other in others {
        let (score, of_plain) = (&other.found.score, &plain.found.score);
        let shorter = |part: f64| score.on_chip_us() < part * of_plain.on_chip_us();
        let matters = score.step_us < OF_WHOLE * of_plain.step_us;
        let trusted = same_cores(&other.found, &plain.found) || matters && shorter(MARGIN);
        let worth_bursts = trusted || matters && shorter(EVERYWHERE);
        // Evaluating them is expensive.
        if !worth_bursts {
            continue;
        }
        let of_other = bursts(&other.kept)?;
        tracing::debug!(candidate = ?other.found.candidate, ?of_other, ?least, "steps of bursts");
        let all = of_other.first().zip(least.first());
        let everywhere = || all.is_none_or(|(all, plain)| all.on_chip_us() < EVERYWHERE * plain.on_chip_us());
        if !trusted && !everywhere() {
            continue;
        }
        let slack = if trusted { 1.0 / MARGIN } else { 1.0 };
        if no_slower(&times(&of_other), &times(&least), slack) {
            return Ok(other.kept);
        }
    }
    Ok(plain.kept)
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

/// [`bursts`], at a rate for each population.
fn population_bursts(network: &Quantised) -> Vec<PopulationRates> {
    let once = Rates::assumed(1.0);
    let of_one = network.populations().ids().take(MOST_BURSTS).map(|id| only(network, id, &once));
    std::iter::once(everywhere(network, &once)).chain(of_one).collect()
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
    fn a_shorter_step_is_a_part_of_the_time_on_the_chips_and_of_the_whole() {
        // A step of so many microseconds on the chips, of which the plain mapping takes 40, besides the host's.
        let taken = |on_chip: f64, host_us: f64| {
            let made = |divisor, on_chip: f64| {
                let step_us = on_chip + host_us;
                let score = Score {
                    cores: 1,
                    cores_powered: 1,
                    energy_uj: 1.0,
                    chip_energy_uj: 1.0,
                    step_us,
                    host_us,
                    static_mw: 1.0,
                };
                let candidate = Candidate { strategy: Strategy::Multilevel, divisor, placed: true };
                Made { found: Found { candidate, score }, kept: (divisor, score) }
            };
            let bursts = |kept: &(u32, Score)| Ok(vec![kept.1]);
            chosen(vec![made(1, 40.0), made(4, on_chip)], Objective::Latency, bursts).unwrap().0
        };
        assert_eq!(taken(30.0, 160.0), 4, "a quarter less on the chips, a twentieth of the whole");
        assert_eq!(taken(39.0, 160.0), 1, "too little on the chips");
        assert_eq!(taken(30.0, 2_000.0), 1, "too little of the whole");
    }

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
