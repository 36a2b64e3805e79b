//! Which of several mappings is best for an objective.
//!
//! Input: candidates with what a step of them is expected to cost, the first of which is what
//! others are measured by: the sequential order, unplaced as the public tools leave it. Output: the
//! one to take, if any is better.
//!
//! The expected step of mean rates is not the simulated one: spikes come in bursts, and more cores
//! mean more messages over the busiest link in a burst. For the time of a step a candidate must
//! therefore be no slower than the first when every source spikes simultaneously, and when all
//! sources of one population do: over all populations and, but where that is `SHORT`, for each. One
//! that is faster by `MARGIN` at the rates that it is made for, or holds the same compartments on
//! the same cores, may be slower by as much in one population's burst; another must be faster by
//! `EVERYWHERE`, also when every source spikes. Both are parts of the time on the chips: the host
//! takes equally long to inject for all mappings, and may take most of a step. Where it does, what
//! is saved has to be a part of the whole, too (`OF_WHOLE`). Last, a step in which random
//! compartments spike and every message is followed may take no longer, with the same allowance.

use crate::explore::cost_estimate::Score;
use nsim_partition::error::Result;
use nsim_partition::options::{Objective, Strategy};

/// How much less a mean step must take to be trusted to take no longer in a burst.
const MARGIN: f64 = 0.9;
/// How much less it must take where no burst may take longer and that of all sources takes as much
/// less.
const EVERYWHERE: f64 = 0.95;
/// How much less the whole mean step must take, injection included.
const OF_WHOLE: f64 = 0.99;
/// A step in which one population spikes is short when it takes less than this part of one in which
/// all sources do.
const SHORT: f64 = 0.1;

/// A way of mapping.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct Candidate {
    /// How compartments are grouped into cores.
    pub strategy: Strategy,
    /// A core is filled to one part in this many.
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
pub struct Made<M> {
    /// What it is worth.
    pub found: Found,
    /// The stored part of it.
    pub kept: M,
}

/// Steps in which many sources spike simultaneously, which are expensive to know.
pub trait Bursts<M> {
    /// The expected cost of a step in which all sources spike, then of those in which the sources
    /// of one population do.
    ///
    /// # Errors
    /// When the target's constants cannot be used.
    fn expected(&mut self, kept: &M) -> Result<Vec<Score>>;

    /// The time of a step in which random compartments spike, the same in all candidates, every
    /// message followed, in microseconds; none where that cannot be known.
    ///
    /// # Errors
    /// When the target's constants cannot be used.
    fn followed_us(&mut self, kept: &M) -> Result<Option<f64>>;
}

/// A choice among candidates.
#[derive(Debug)]
pub struct Choice<'p, M, B> {
    plain: &'p Made<M>,
    objective: Objective,
    bursts: B,
    /// What bursts take in the first, once they are needed.
    expected: Option<Vec<Score>>,
    followed_us: Option<Option<f64>>,
}

impl<'p, M, B: Bursts<M>> Choice<'p, M, B> {
    /// Among candidates that are measured by this one.
    pub fn new(plain: &'p Made<M>, objective: Objective, bursts: B) -> Self {
        Choice { plain, objective, bursts, expected: None, followed_us: None }
    }

    /// The best of these, if it is better than the first.
    ///
    /// # Errors
    /// Those of [`Bursts`].
    pub fn best_of(&mut self, others: Vec<Made<M>>) -> Result<Option<M>> {
        let (plain, objective) = (&self.plain.found, self.objective);
        let better = |other: &Made<M>| other.found.score.better(&plain.score, objective).is_lt();
        let mut others: Vec<Made<M>> = others.into_iter().filter(better).collect();
        others.sort_by(|a, b| a.found.score.better(&b.found.score, objective));
        for other in others {
            if objective != Objective::Latency || self.is_shorter(&other)? {
                return Ok(Some(other.kept));
            }
        }
        Ok(None)
    }

    /// Whether its steps are shorter, in the mean and when many sources spike.
    fn is_shorter(&mut self, other: &Made<M>) -> Result<bool> {
        let (score, of_plain) = (&other.found.score, &self.plain.found.score);
        let shorter = |part: f64| score.on_chip_us() < part * of_plain.on_chip_us();
        let matters = score.step_us < OF_WHOLE * of_plain.step_us;
        let trusted = same_cores(&other.found, &self.plain.found) || matters && shorter(MARGIN);
        if !(trusted || matters && shorter(EVERYWHERE)) {
            return Ok(false);
        }
        let expected = self.bursts.expected(&other.kept)?;
        if self.expected.is_none() {
            self.expected = Some(self.bursts.expected(&self.plain.kept)?);
        }
        let least = self.expected.as_deref().unwrap_or_default();
        tracing::debug!(candidate = ?other.found.candidate, ?expected, ?least, "steps of bursts");
        let all = expected.first().zip(least.first());
        let everywhere = all.is_none_or(|(all, plain)| all.on_chip_us() < EVERYWHERE * plain.on_chip_us());
        let times = |bursts: &[Score]| bursts.iter().map(|score| score.step_us).collect::<Vec<f64>>();
        let slack = if trusted { 1.0 / MARGIN } else { 1.0 };
        if !trusted && !everywhere || !no_slower(&times(&expected), &times(least), slack) {
            return Ok(false);
        }
        let least = match self.followed_us {
            Some(least) => least,
            None => self.bursts.followed_us(&self.plain.kept)?,
        };
        self.followed_us = Some(least);
        let followed = self.bursts.followed_us(&other.kept)?;
        tracing::debug!(candidate = ?other.found.candidate, ?followed, ?least, "steps followed");
        Ok(followed.zip(least).is_none_or(|(followed, least)| followed <= slack * least))
    }
}

/// Whether two candidates hold the same compartments on the same cores.
fn same_cores(one: &Found, other: &Found) -> bool {
    let cores = |found: &Found| (found.candidate.strategy, found.candidate.divisor);
    cores(one) == cores(other)
}

/// Whether bursts take no longer than in the unplaced sequential mapping: the first, in which all
/// sources spike; those of one population, all of them together; and each of these, but for `slack`
/// and for those that are short compared with the first.
fn no_slower(times: &[f64], plain: &[f64], slack: f64) -> bool {
    let (Some((all, each)), Some((all_plain, each_plain))) = (times.split_first(), plain.split_first()) else {
        return true;
    };
    let short = SHORT * all_plain;
    all <= all_plain
        && each.iter().sum::<f64>() <= each_plain.iter().sum::<f64>()
        && each.iter().zip(each_plain).all(|(time, plain)| *time <= (plain * slack).max(short))
}

/// Those that no other is better than in everything: cores, energy and time.
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

    /// Bursts that take what was stored, and a followed step of this many microseconds.
    struct Same;

    impl Bursts<(u32, Score, f64)> for Same {
        fn expected(&mut self, kept: &(u32, Score, f64)) -> Result<Vec<Score>> {
            Ok(vec![kept.1])
        }

        fn followed_us(&mut self, kept: &(u32, Score, f64)) -> Result<Option<f64>> {
            Ok(Some(kept.2))
        }
    }

    /// The divisor of the one that is taken, if any, of candidates with their time on the chips and
    /// followed; the first takes 40 and 100 us.
    fn taken(host_us: f64, others: &[(u32, f64, f64)]) -> Option<u32> {
        let made = |(divisor, on_chip, followed): (u32, f64, f64)| {
            let step_us = on_chip + host_us;
            let score = Score { cores: 1, energy_uj: 1.0, chip_energy_uj: 1.0, step_us, host_us, static_mw: 1.0 };
            let candidate = Candidate { strategy: Strategy::Multilevel, divisor, placed: true };
            Made { found: Found { candidate, score }, kept: (divisor, score, followed) }
        };
        let plain = made((1, 40.0, 100.0));
        let others = others.iter().map(|&other| made(other)).collect();
        let best = Choice::new(&plain, Objective::Latency, Same).best_of(others).unwrap();
        best.map(|(divisor, ..)| divisor)
    }

    #[test]
    fn a_shorter_step_is_a_part_of_the_time_on_the_chips_and_of_the_whole() {
        assert_eq!(taken(160.0, &[(4, 30.0, 90.0)]), Some(4), "a quarter less on the chips, a twentieth of the whole");
        assert_eq!(taken(160.0, &[(4, 39.0, 90.0)]), None, "too little on the chips");
        assert_eq!(taken(2_000.0, &[(4, 30.0, 90.0)]), None, "too little of the whole");
    }

    #[test]
    fn a_candidate_whose_messages_wait_longer_is_left_for_the_next() {
        assert_eq!(
            taken(0.0, &[(4, 20.0, 112.0), (2, 30.0, 111.0)]),
            Some(2),
            "faster in the mean, so a ninth longer is allowed"
        );
        assert_eq!(taken(0.0, &[(4, 20.0, 112.0)]), None);
        assert_eq!(taken(0.0, &[(4, 37.0, 101.0)]), None);
        assert_eq!(taken(0.0, &[(4, 37.0, 100.0)]), Some(4));
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
