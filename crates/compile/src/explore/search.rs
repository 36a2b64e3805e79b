//! Several mappings of a network, compared by their expected cost of a step.
//!
//! Input: a network, a target and an objective. Output: the best of several *candidates*. A
//! candidate is a strategy and the part of each core that it may fill: half-filled cores take half
//! as long and are twice as many. The first candidates are always the sequential order, unplaced as
//! the public tools leave it and placed. [`choice`](crate::explore::choice) decides which is
//! better.

use std::time::{Duration, Instant};

use rayon::prelude::*;

use crate as compile;
use crate::explore::box_costs::PlacedBoxes;
use crate::explore::bursts::{bursts, messages, population_bursts, simulated_us};
use crate::explore::choice::{Bursts, Candidate, Choice, MappedCandidate, ScoredCandidate};
use crate::explore::cost_estimate::{Score, score_at};
use crate::mapping::Mapping;
use crate::mapping_file::file_of_boxes;
use crate::spread::spread;
use crate::stages::{Front, Unchecked};
use nsim_ir::firing_rates::Rates;
use nsim_ir::hardware::Target;
use nsim_ir::mapping::MappingFile;
use nsim_ir::placement::Placement;
use nsim_ir::quantised::Quantised;
use nsim_ir::resource::Resource;
use nsim_partition::error::{CompileError, Result};
use nsim_partition::large::counted_in_boxes;
use nsim_partition::options::{Effort, Objective, Options, Strategy};
use nsim_partition::reason::Reason;
use nsim_partition::strategy::box_fan_out::{PopulationRates, everywhere};
use nsim_partition::strategy::boxes::{Boxes, Layers};

/// Parts of a core, as divisors, that candidates fill.
const DIVISORS: [u32; 6] = [1, 2, 4, 8, 16, 32];
/// Divisors for the shortest step, the most likely first, for networks so large that the effort is
/// not enough for all (`nsim bench map`). The first two are always tried.
const SHORTEST: [u32; 7] = [4, 1, 8, 32, 16, 64, 2];
/// The divisor that is tried when no candidate with these is taken.
const HALF: u32 = 2;
/// Compartments that a second of effort allows to be cut into boxes, over all candidates.
const COMPARTMENTS_PER_SECOND: u64 = 20_000_000;
/// Synapses that a second of effort allows to be mapped, over all candidates.
const SYNAPSES_PER_SECOND: u64 = 4_000_000;

/// Number of synapses of 8 bits in a word.
const SYNAPSES_PER_WORD: u64 = 8;

/// Stages after placement.
const FINISHING: [&str; 3] = ["route", "verify", "check"];
/// Time reserved for them, relative to their last time.
const SLACK: f64 = 1.2;
/// Fraction of the time that must be left for a second mapping to be worth trying.
const LEAST_REMAINING: f64 = 0.1;
/// Fraction of the remaining time for the partition; the rest is for placement.
const PARTITIONING: f64 = 0.7;

/// The target with a core's limits divided; words stay enough for the known need of a compartment.
fn divided(target: &Target, divisor: u32, words: u32) -> Target {
    let limits = target.limits();
    let per_axon = Resource::SynapseWordsPerAxon;
    let list = if limits.is_limited(per_axon) { limits[per_axon] } else { 0 };
    let words = (limits[Resource::SynapseWords] / divisor).max(list).max(words);
    let compartments = (limits[Resource::Compartments] / divisor).max(1);
    let divided = limits.clone().with(Resource::Compartments, compartments).with(Resource::SynapseWords, words);
    target.clone().with_limits(divided)
}

/// Most synapses of a core that is filled to a part: the synapses of 8 bits in the part's words;
/// `None` for a whole core, which has no such bound.
fn most_synapses(target: &Target, divisor: u32) -> Option<u64> {
    let words = u64::from(target.limits()[Resource::SynapseWords]);
    (divisor > 1).then(|| words * SYNAPSES_PER_WORD / u64::from(divisor))
}

/// Words that one compartment alone needs, when words are all that a divided core lacks and a whole
/// one has enough.
fn words_for_one(error: &CompileError, target: &Target) -> Option<u32> {
    let CompileError::DoesNotFit(reasons) = error else { return None };
    let words = |reason: &Reason| Some(reason.need).filter(|_| reason.resource == Resource::SynapseWords);
    let needs: Option<Vec<u64>> = reasons.iter().map(words).collect();
    let most = needs?.into_iter().max()?.try_into().ok()?;
    Some(most).filter(|&most| most <= target.limits()[Resource::SynapseWords])
}

/// The stored form of a candidate until one is taken.
enum StoredMapping {
    /// The mapping, which has not been checked.
    Whole(Box<Unchecked>),
    /// A mapping in boxes takes much memory, so only its boxes and places are stored, from which it
    /// is made again. Further: the name of the placement, and the cost of bursts when they are
    /// needed.
    Boxes { file: Box<MappingFile>, placed: &'static str, bursts: Vec<Score> },
}

/// Messages of a step that is followed to compare candidates.
const SIMULATED_MESSAGES: f64 = (1 << 20) as f64;

/// The bursts of stored candidates; the first evaluated one decides the number that is affordable.
struct StoredBursts<'a> {
    target: &'a Target,
    copies: u32,
    rates: Option<Vec<Rates>>,
    /// Probability that a compartment spikes in a followed step.
    chance: Option<f64>,
}

impl Bursts<StoredMapping> for StoredBursts<'_> {
    fn expected(&mut self, kept: &StoredMapping) -> Result<Vec<Score>> {
        match kept {
            StoredMapping::Whole(unchecked) => {
                let Mapping { quantised, placement, program, .. } = unchecked.mapping();
                let bursts = self.rates.get_or_insert_with(|| bursts(quantised));
                let score = |rates: &Rates| score_at(program, placement, self.copies, rates, self.target);
                Ok(bursts.iter().map(score).collect::<Result<_, _>>()?)
            }
            StoredMapping::Boxes { bursts, .. } => Ok(bursts.clone()),
        }
    }

    fn simulated_us(&mut self, kept: &StoredMapping) -> Result<Option<f64>> {
        let StoredMapping::Whole(unchecked) = kept else { return Ok(None) };
        let Mapping { placement, program, .. } = unchecked.mapping();
        let chance =
            *self.chance.get_or_insert_with(|| (SIMULATED_MESSAGES / messages(program).max(1) as f64).min(1.0));
        Ok(Some(simulated_us(program, placement, self.target, self.copies, chance)?))
    }
}

/// Returns a mapping for an objective: with [`Objective::Cores`] the mapping of the options,
/// otherwise the best of several. `rates` are of one copy.
///
/// # Errors
/// [`CompileError`].
pub fn map(front: Front, target: &Target, options: &Options, rates: &Rates) -> Result<Mapping> {
    let one = |front: Front, options: &Options| {
        let mapping = map(front, target, options, rates)?;
        Ok((mapping.partition.to_members(), mapping.placement, mapping.placed))
    };
    if let Some(spread) = spread(&front, target, options, rates, one)? {
        return spread.emit(target, options)?.check(target);
    }
    if options.objective == Objective::Cores || front.has_stated() {
        return match options.effort {
            Effort::Work(_) => compile::map(front, target, options, rates),
            Effort::Within { end, .. } => by_the_clock(front, target, options, rates, end),
        };
    }
    let begin = Instant::now();
    let search = Search::new(&front, target, options, rates);
    let settings = search.settings()?;
    let mut made = search.all(&settings, 0)?;
    if made.is_empty() {
        return Err(CompileError::Fault("there is no candidate".to_string()));
    }
    let (plain, found) = (made.remove(0), made.iter().map(|made| made.scored).collect::<Vec<_>>());
    let bursts = StoredBursts { target, copies: options.copies, rates: None, chance: None };
    let mut choice = Choice::new(&plain, options.objective, bursts);
    let mut taken = choice.best_of(made)?;
    if let (None, Some(setting)) = (&taken, search.extra_setting(&settings, &found)) {
        taken = choice.best_of(search.all(&[setting], settings.len())?)?;
    }
    let mut best = match taken.unwrap_or(plain.mapping) {
        StoredMapping::Whole(unchecked) => unchecked.check(target)?,
        StoredMapping::Boxes { file, placed, .. } => {
            let compared = ("compare", begin.elapsed().as_secs_f64());
            let mut again = compile::load(front, target, options, &file)?;
            again.placed = placed;
            again.seconds.insert(0, compared);
            again
        }
    };
    best.options = *options;
    Ok(best)
}

/// The best mapping found until `end`: the quickest, unless there is time for a better one.
fn by_the_clock(front: Front, target: &Target, options: &Options, rates: &Rates, end: Instant) -> Result<Mapping> {
    let begin = Instant::now();
    let given = end.saturating_duration_since(begin);
    let quick = Options { effort: Effort::Work(0), ..*options };
    let mut best = compile::map(front.clone(), target, &quick, rates)?;
    best.options = *options;
    // Time of a mapping's stages after placement.
    let finishing = |mapping: &Mapping| {
        let stages = mapping.seconds.iter().filter(|(stage, _)| FINISHING.contains(stage));
        Duration::from_secs_f64(SLACK * stages.map(|(_, seconds)| seconds).sum::<f64>())
    };
    let left = || end.saturating_duration_since(Instant::now());
    let reserve = finishing(&best);
    if left() < given.mul_f64(LEAST_REMAINING) + reserve + begin.elapsed() {
        return Ok(best);
    }
    let until = |part: f64| {
        let end = Instant::now() + left().saturating_sub(reserve).mul_f64(part);
        Options { effort: Effort::Within { budget_ms: 0, end }, ..*options }
    };
    let partitioned = front.partition(target, &until(PARTITIONING), rates)?;
    let mut other = partitioned.place(target, &until(1.0))?.emit(target, options)?.check(target)?;
    let costs = |mapping: &Mapping| (mapping.partition.cores(), mapping.traffic().hops_multicast_per_step);
    let ((cores, hops), (most_cores, most_hops)) = (costs(&other), costs(&best));
    if (cores, hops) < (most_cores, most_hops) {
        other.options = *options;
        best = other;
    }
    Ok(best)
}

/// Every candidate that fits and that the effort allows for, first the one that all others are
/// compared with.
///
/// # Errors
/// [`CompileError`] of the first candidate, when none fits.
pub fn candidates(front: &Front, target: &Target, options: &Options, rates: &Rates) -> Result<Vec<ScoredCandidate>> {
    let search = Search::new(front, target, options, rates);
    Ok(search.all(&search.settings()?, 0)?.into_iter().map(|made| made.scored).collect())
}

/// Common input of the candidates.
struct Search<'a> {
    front: &'a Front,
    in_boxes: bool,
    target: &'a Target,
    options: &'a Options,
    rates: &'a Rates,
}

impl<'a> Search<'a> {
    fn new(front: &'a Front, target: &'a Target, options: &'a Options, rates: &'a Rates) -> Self {
        Search { in_boxes: front.in_boxes(options.copies), front, target, options, rates }
    }

    /// Strategies, and the divisor of the part of a core that each fills, as many as the effort
    /// allows.
    fn settings(&self) -> Result<Vec<(Strategy, u32)>> {
        let Search { front, target, options, .. } = self;
        let (one, copies) = (front.quantised(), u64::from(options.copies));
        let affordable = |each_second: u64, size: u64| options.effort.work(each_second) / size.max(1);
        if self.in_boxes {
            let (layers, target) = (Layers::new(one)?, counted_in_boxes(true, one, target));
            let most = affordable(COMPARTMENTS_PER_SECOND, u64::from(one.compartments()) * copies).max(1);
            let may_fit = |&divisor: &u32| {
                divisor == 1 || {
                    let most_synapses = most_synapses(&target, divisor);
                    layers.may_fit(&divided(&target, divisor, 0), copies, most_synapses)
                }
            };
            let divisors = DIVISORS.into_iter().take(most as usize).filter(may_fit);
            return Ok(divisors.map(|divisor| (options.strategy, divisor)).collect());
        }
        let mut settings = vec![(Strategy::Sequential, 1)];
        let (divisors, least) = match options.objective {
            // The host draws its power for as long as a step lasts, and draws more than the cores.
            Objective::Latency | Objective::Energy => (&SHORTEST[..], 2),
            Objective::Cores | Objective::EnergyChip => (&DIVISORS[..], 1),
        };
        let wanted =
            divisors.iter().map(|&divisor| (options.strategy, divisor)).filter(|setting| *setting != settings[0]);
        let most = affordable(SYNAPSES_PER_SECOND, one.synapses() * copies).max(least);
        settings.extend(wanted.take(most as usize).collect::<Vec<_>>());
        Ok(settings)
    }

    /// One more setting for the shortest step, where none within the effort is taken: cores filled
    /// to a half, unless a quarter of a core takes no more cores than a whole one.
    fn extra_setting(&self, settings: &[(Strategy, u32)], found: &[ScoredCandidate]) -> Option<(Strategy, u32)> {
        let Search { in_boxes, options, .. } = self;
        let setting = (options.strategy, HALF);
        let cores = |divisor| {
            let of = |found: &&ScoredCandidate| {
                (found.candidate.strategy, found.candidate.divisor) == (options.strategy, divisor)
            };
            found.iter().find(of).map(|found| found.score.cores)
        };
        let wanted = options.objective == Objective::Latency
            && options.effort.end().is_none()
            && !in_boxes
            && !settings.contains(&setting)
            && cores(1) != cores(SHORTEST[0]);
        wanted.then_some(setting)
    }

    /// The candidates of these settings that fit, after `earlier` other settings.
    fn all(&self, settings: &[(Strategy, u32)], earlier: usize) -> Result<Vec<MappedCandidate<StoredMapping>>> {
        // The effort is for all of them together.
        let options = Options { effort: self.options.effort.shared_by(settings.len() + earlier), ..*self.options };
        let map_one = |(number, &(strategy, divisor)): (usize, &(Strategy, u32))| {
            // The first is tried unplaced too.
            let places = if number + earlier == 0 && options.place { &[false, true][..] } else { &[options.place] };
            let made = self.mapped(&Options { strategy, ..options }, divisor, places);
            if let Err(error) = &made {
                tracing::debug!(strategy = strategy.name(), divisor, %error, "candidate");
            }
            made
        };
        let numbered = settings.iter().enumerate();
        let made: Vec<Result<Vec<MappedCandidate<StoredMapping>>>> =
            if self.in_boxes || self.options.effort.end().is_some() {
                // Sequentially: each takes as much memory as a mapping, and uses all threads. By
                // the clock, they are tried while there is time.
                self.sequential(numbered, map_one)
            } else {
                numbered.collect::<Vec<_>>().into_par_iter().map(map_one).collect()
            };
        let fits = made.iter().any(Result::is_ok);
        let mut found = Vec::new();
        for (number, made) in made.into_iter().enumerate() {
            match made {
                Ok(made) => found.extend(made),
                Err(error) if number + earlier == 0 && (!fits || self.in_boxes) => return Err(error),
                Err(_) => {}
            }
        }
        Ok(found)
    }

    /// Results of settings, computed sequentially until the next would exceed the time; the first
    /// in any case.
    fn sequential<W, T>(&self, settings: impl Iterator<Item = (usize, W)>, map: impl Fn((usize, W)) -> T) -> Vec<T> {
        let (mut made, mut longest) = (Vec::new(), Duration::ZERO);
        for (number, setting) in settings {
            let begin = Instant::now();
            if number > 0 && self.options.effort.end().is_some_and(|end| begin + longest > end) {
                break;
            }
            made.push(map((number, setting)));
            longest = longest.max(begin.elapsed());
        }
        made
    }

    /// Candidates of one partition, placed or not.
    fn mapped(&self, options: &Options, divisor: u32, places: &[bool]) -> Result<Vec<MappedCandidate<StoredMapping>>> {
        let Search { front, in_boxes, target, rates, .. } = *self;
        let options = &Options { most_synapses: most_synapses(target, divisor), ..*options };
        let partitioned = |words| front.clone().partition(&divided(target, divisor, words), options, rates);
        let partitioned = match (partitioned(0), in_boxes) {
            (Err(error), false) => match words_for_one(&error, target) {
                Some(words) => partitioned(words)?,
                None => return Err(error),
            },
            (made, _) => made?,
        };
        let partitioned = partitioned.within(target)?;
        let made = |&placed: &bool| {
            let options = &Options { place: placed, ..*options };
            let candidate = Candidate { strategy: options.strategy, divisor, placed };
            let (score, stored) = match &partitioned.boxes {
                None => {
                    let unchecked = partitioned.clone().place(target, options)?.emit(target, options)?;
                    let mapping = unchecked.mapping();
                    (mapping.score(&mapping.traffic(), target)?, StoredMapping::Whole(Box::new(unchecked)))
                }
                Some(boxes) => {
                    let (placement, name) = partitioned.placement(target, options)?;
                    self.of_boxes(&partitioned.all, boxes, &placement, name)?
                }
            };
            let scored = ScoredCandidate { candidate, score };
            tracing::debug!(found = ?scored, "candidate");
            Ok(MappedCandidate { scored, mapping: stored })
        };
        places.iter().map(made).collect()
    }

    /// Stored form of boxes at these places, and their cost.
    fn of_boxes(
        &self,
        all: &Quantised,
        boxes: &Boxes,
        placement: &Placement,
        placed: &'static str,
    ) -> Result<(Score, StoredMapping)> {
        let Search { target, options, rates, .. } = *self;
        let at_places = PlacedBoxes { network: all, boxes, placement };
        let bursts = if options.objective == Objective::Latency { population_bursts(all) } else { Vec::new() };
        let score = |rates: &PopulationRates| at_places.score(rates, &at_places.traffic(rates), target, options.copies);
        let bursts = bursts.iter().map(score).collect::<Result<_, _>>()?;
        let score = score(&everywhere(all, rates))?;
        let file = Box::new(file_of_boxes(all, &boxes.lattices(), placement, target.name(), options));
        Ok((score, StoredMapping::Boxes { file, placed, bursts }))
    }
}
