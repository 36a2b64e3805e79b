//! Choice of the best of several mappings for an objective.
//!
//! Input: candidates with the expected cost of a step. The others are compared with the first: the
//! sequential order, unplaced as the public tools leave it. Output: the candidate to take, if any
//! is better.
//!
//! The expected step of mean rates is not the simulated one: spikes come in bursts, and more cores
//! mean more messages over the busiest link in a burst. For the time of a step, a candidate must
//! therefore be no slower than the first when every source spikes simultaneously, and when one
//! population's sources do. The latter holds for their sum, and for each except where it is
//! `SHORT`. A candidate that is faster by `MARGIN` at its own rates, or has the same compartments
//! on the same cores, may be slower by as much in one population's burst. Any other must be faster
//! by `EVERYWHERE`, also when every source spikes. Both are parts of the time on the chips: the
//! host injects equally long for all mappings, which may be most of a step. So the saving has to be
//! a part of the whole, too (`OF_WHOLE`). Last, a step in which random compartments spike and every
//! message is followed may take no longer, with the same allowance.

use crate::explore::cost_estimate::Score;
use nsim_partition::error::Result;
use nsim_partition::options::{Objective, Strategy};

/// Ratio of mean steps below which a candidate is trusted to take no longer in a burst.
const MARGIN: f64 = 0.9;
/// Ratio of mean steps that suffices if no burst takes longer and the burst of all sources has this
/// ratio too.
const EVERYWHERE: f64 = 0.95;
/// Ratio of whole mean steps, injection included, that is required.
const OF_WHOLE: f64 = 0.99;
/// Ratio to the step in which all sources spike, below which a step in which one population spikes
/// is short.
const SHORT: f64 = 0.1;

/// Options of one mapping.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct Candidate {
    /// Strategy that groups compartments into cores.
    pub strategy: Strategy,
    /// A core is filled to one part in `divisor`.
    pub divisor: u32,
    /// Whether cores are placed by traffic.
    pub placed: bool,
}

/// A candidate that fits.
#[derive(Debug, Clone, Copy)]
pub struct ScoredCandidate {
    /// Its options.
    pub candidate: Candidate,
    /// Its expected cost.
    pub score: Score,
}

/// A candidate with its mapping.
#[derive(Debug)]
pub struct MappedCandidate<M> {
    /// Its options and expected cost.
    pub scored: ScoredCandidate,
    /// Stored part of its mapping.
    pub mapping: M,
}

/// Steps in which many sources spike simultaneously; evaluating them is expensive.
pub trait Bursts<M> {
    /// Expected cost of a step in which all sources spike, then of the steps in which one
    /// population's sources do.
    ///
    /// # Errors
    /// When the target's constants cannot be used.
    fn expected(&mut self, mapping: &M) -> Result<Vec<Score>>;

    /// Time in microseconds of a step in which random compartments spike, the same in all
    /// candidates, with every message followed; none where it is unknown.
    ///
    /// # Errors
    /// When the target's constants cannot be used.
    fn simulated_us(&mut self, mapping: &M) -> Result<Option<f64>>;
}

/// A choice among candidates.
#[derive(Debug)]
pub struct Choice<'p, M, B> {
    plain: &'p MappedCandidate<M>,
    objective: Objective,
    bursts: B,
    /// Cost of the first candidate's bursts, once it is needed.
    expected: Option<Vec<Score>>,
    simulated_us: Option<Option<f64>>,
}

impl<'p, M, B: Bursts<M>> Choice<'p, M, B> {
    /// Returns a choice among candidates that are compared with `plain`.
    pub fn new(plain: &'p MappedCandidate<M>, objective: Objective, bursts: B) -> Self {
        Choice { plain, objective, bursts, expected: None, simulated_us: None }
    }

    /// The best of these, if it is better than the first.
    ///
    /// # Errors
    /// Errors of [`Bursts`].
    pub fn best_of(&mut self, others: Vec<MappedCandidate<M>>) -> Result<Option<M>> {
        let (plain, objective) = (&self.plain.scored, self.objective);
        let better = |other: &MappedCandidate<M>| other.scored.score.better(&plain.score, objective).is_lt();
        let mut others: Vec<MappedCandidate<M>> = others.into_iter().filter(better).collect();
        others.sort_by(|a, b| a.scored.score.better(&b.scored.score, objective));
        for other in others {
            if objective != Objective::Latency || self.is_shorter(&other)? {
                return Ok(Some(other.mapping));
            }
        }
        Ok(None)
    }

    /// Whether its steps are shorter, in the mean and when many sources spike.
    fn is_shorter(&mut self, other: &MappedCandidate<M>) -> Result<bool> {
        let (score, of_plain) = (&other.scored.score, &self.plain.scored.score);
        let shorter = |part: f64| score.on_chip_us() < part * of_plain.on_chip_us();
        let matters = score.step_us < OF_WHOLE * of_plain.step_us;
        let trusted = same_cores(&other.scored, &self.plain.scored) || matters && shorter(MARGIN);
        if !(trusted || matters && shorter(EVERYWHERE)) {
            return Ok(false);
        }
        let expected = self.bursts.expected(&other.mapping)?;
        if self.expected.is_none() {
            self.expected = Some(self.bursts.expected(&self.plain.mapping)?);
        }
        let least = self.expected.as_deref().unwrap_or_default();
        tracing::debug!(candidate = ?other.scored.candidate, ?expected, ?least, "steps of bursts");
        let all = expected.first().zip(least.first());
        let everywhere = all.is_none_or(|(all, plain)| all.on_chip_us() < EVERYWHERE * plain.on_chip_us());
        let times = |bursts: &[Score]| bursts.iter().map(|score| score.step_us).collect::<Vec<f64>>();
        let slack = if trusted { 1.0 / MARGIN } else { 1.0 };
        if !trusted && !everywhere || !no_slower(&times(&expected), &times(least), slack) {
            return Ok(false);
        }
        let least = match self.simulated_us {
            Some(least) => least,
            None => self.bursts.simulated_us(&self.plain.mapping)?,
        };
        self.simulated_us = Some(least);
        let simulated = self.bursts.simulated_us(&other.mapping)?;
        tracing::debug!(candidate = ?other.scored.candidate, followed = ?simulated, ?least, "steps followed");
        Ok(simulated.zip(least).is_none_or(|(followed, least)| followed <= slack * least))
    }
}

/// Whether two candidates hold the same compartments on the same cores.
fn same_cores(one: &ScoredCandidate, other: &ScoredCandidate) -> bool {
    let cores = |found: &ScoredCandidate| (found.candidate.strategy, found.candidate.divisor);
    cores(one) == cores(other)
}

/// Whether bursts take no longer than in the unplaced sequential mapping: the first, in which all
/// sources spike; the others, of one population each, in sum; and each of these, but for `slack`
/// and for bursts that are short compared with the first.
fn no_slower(times: &[f64], plain: &[f64], slack: f64) -> bool {
    let (Some((all, each)), Some((all_plain, each_plain))) = (times.split_first(), plain.split_first()) else {
        return true;
    };
    let short = SHORT * all_plain;
    all <= all_plain
        && each.iter().sum::<f64>() <= each_plain.iter().sum::<f64>()
        && each.iter().zip(each_plain).all(|(time, plain)| *time <= (plain * slack).max(short))
}

/// Candidates that no other dominates in cores, energy and time.
pub fn front(found: &[ScoredCandidate]) -> Vec<&ScoredCandidate> {
    let dominated = |one: &ScoredCandidate| found.iter().any(|other| other.score.dominates(&one.score));
    let mut front: Vec<&ScoredCandidate> = Vec::new();
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

    /// Bursts with a stored cost, and a followed step with a stored time in microseconds.
    struct Same;

    impl Bursts<(u32, Score, f64)> for Same {
        fn expected(&mut self, kept: &(u32, Score, f64)) -> Result<Vec<Score>> {
            Ok(vec![kept.1])
        }

        fn simulated_us(&mut self, kept: &(u32, Score, f64)) -> Result<Option<f64>> {
            Ok(Some(kept.2))
        }
    }

    /// Divisor of the chosen candidate, if any, from candidates with their time on the chips and
    /// followed; the first takes 40 and 100 us.
    fn taken(host_us: f64, others: &[(u32, f64, f64)]) -> Option<u32> {
        let made = |(divisor, on_chip, followed): (u32, f64, f64)| {
            let step_us = on_chip + host_us;
            let score = Score { cores: 1, energy_uj: 1.0, chip_energy_uj: 1.0, step_us, host_us, static_mw: 1.0 };
            let candidate = Candidate { strategy: Strategy::Multilevel, divisor, placed: true };
            MappedCandidate { scored: ScoredCandidate { candidate, score }, mapping: (divisor, score, followed) }
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
        assert_eq!(taken(0.0, &[(4, 20.0, 112.0), (2, 30.0, 111.0)]), Some(2), "faster: a ninth longer is allowed");
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
        assert!(no_slower(&[900.0, 300.0, 300.0, 99.0], &plain, 1.0), "a tenth of the step when all spike is short");
    }
}
