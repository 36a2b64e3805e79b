//! Decides samples before their last step.
//!
//! Input: a [`Rule`], a bound on the spikes that each output can still make, and the output spikes
//! of each step. Output: whether the sample is decided. Invariants, for [`Rule::Certain`]: the
//! class after the deciding step is the class of the whole sample, for any later spikes. No earlier
//! step is provably decided by output spikes and refractory periods alone. [`Rule::Margin`]
//! guarantees neither.
//!
//! Weights, potentials and future input are omitted on purpose. They could decide a sample earlier,
//! but only by simulating it.

use std::fmt;
use std::num::NonZeroU32;
use std::str::FromStr;

use nsim_dynamics as neuron;
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::quantised::{Quantised, Reset, Units};

/// Criterion by which a sample is decided.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rule {
    /// The leading output has at least this many spikes more than every other output. A single
    /// output has at least this many spikes.
    Margin(NonZeroU32),
    /// No spikes that the refractory periods still allow can change the class.
    Certain,
}

impl FromStr for Rule {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "certain" => Ok(Rule::Certain),
            margin => margin
                .parse()
                .map(Rule::Margin)
                .map_err(|_| format!("'{text}' is neither a margin in spikes, such as 4, nor 'certain'")),
        }
    }
}

impl fmt::Display for Rule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Rule::Margin(margin) => margin.fmt(f),
            Rule::Certain => f.write_str("certain"),
        }
    }
}

impl serde::Serialize for Rule {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// Bounds on the spikes of a population, from `docs/semantics.md` (7), (9), (10), (11).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SpikeBounds {
    /// Least number of steps from a spike to the next, for each compartment; `None` where only a
    /// reset allows another spike.
    pub gaps: Vec<Option<NonZeroU32>>,
    /// The step before which all compartments are held.
    pub start: u32,
    /// Periodic resets, which end refractory periods, and the step that they are counted from.
    pub reset: Option<(Reset, u32)>,
}

impl SpikeBounds {
    /// Returns the bounds of a network's output population.
    pub fn for_output(network: &Quantised) -> SpikeBounds {
        let (parts, output) = (network.parts(), &network.populations()[network.parts().output]);
        // `Quantised` guarantees that the output is a population of compartments.
        let Units::Compartments { neurons, start_step, .. } = &output.units else {
            return SpikeBounds { gaps: Vec::new(), start: 0, reset: None };
        };
        let (mut gaps, mut starts) = (Vec::new(), Vec::new());
        for neuron in (0..output.shape.len()).map(|index| neurons.get(index)) {
            gaps.push(neuron::shortest_interval(&neuron, parts.semantics));
            starts.push(neuron::fields(&neuron, *start_step, parts.semantics, parts.threshold).start_step);
        }
        SpikeBounds {
            gaps,
            start: starts.into_iter().min().unwrap_or(*start_step),
            reset: parts.reset.map(|reset| (reset, *start_step)),
        }
    }

    /// Step of the first reset from `step` on.
    fn next_reset(&self, step: u64) -> Option<u64> {
        let (reset, counted_from) = self.reset?;
        let first = u64::from(counted_from) + u64::from(reset.offset);
        let interval = u64::from(reset.interval);
        Some(first + step.saturating_sub(first).div_ceil(interval) * interval)
    }

    /// The first step after a spike in which the compartment is not refractory; `None` for never.
    fn free_after(&self, output: usize, spike: u32) -> Option<u64> {
        let ends = self.gaps[output].map(|gap| u64::from(spike) + u64::from(gap.get()));
        match (ends, self.next_reset(u64::from(spike) + 1)) {
            (Some(ends), Some(reset)) => Some(ends.min(reset)),
            (ends, reset) => ends.or(reset),
        }
    }

    /// Maximum number of spikes of a compartment in steps `from..steps`, not refractory from `free`
    /// on. Spiking as early as possible attains it, since it never delays a later spike.
    fn most_spikes(&self, output: usize, free: Option<u64>, from: u64, steps: u64) -> u64 {
        let Some(free) = free else { return 0 };
        let from = from.max(u64::from(self.start)).max(free);
        match (self.reset, self.next_reset(from + 1)) {
            (Some((reset, _)), Some(first)) if first < steps => {
                let interval = u64::from(reset.interval);
                let (whole, rest) = ((steps - first) / interval, (steps - first) % interval);
                self.spikes_within(output, first - from)
                    + whole * self.spikes_within(output, interval)
                    + self.spikes_within(output, rest)
            }
            _ => self.spikes_within(output, steps.saturating_sub(from)),
        }
    }

    /// Maximum number of spikes of a compartment in this many steps without a reset, not refractory
    /// at the first.
    fn spikes_within(&self, output: usize, steps: u64) -> u64 {
        match self.gaps[output] {
            _ if steps == 0 => 0,
            Some(gap) => steps.div_ceil(u64::from(gap.get())),
            None => 1,
        }
    }
}

/// An early-exit rule for a network's outputs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EarlyExit {
    /// The rule that decides.
    pub rule: Rule,
    /// Bounds on the spikes of the outputs.
    pub bounds: SpikeBounds,
    /// Whether a decided sample ends; if not, its decision is only recorded.
    pub ends: bool,
}

impl EarlyExit {
    /// Returns this rule for the output population of a network; decided samples end.
    ///
    /// # Errors
    /// `run.early-exit` where the output decides no class.
    pub fn new(rule: Rule, network: &Quantised) -> Result<EarlyExit> {
        if !network.decides() {
            let name = &network.populations()[network.parts().output].name;
            let message = format!("'{name}' sends values, which decide no class, so no sample ends early");
            return Err(Diagnostic::new("run.early-exit", message).help("remove the early exit"));
        }
        Ok(EarlyExit { ends: true, ..EarlyExit::recording_only(rule, network) })
    }

    /// Returns this rule for the output population of a network; no decided sample ends.
    pub fn recording_only(rule: Rule, network: &Quantised) -> EarlyExit {
        EarlyExit { rule, bounds: SpikeBounds::for_output(network), ends: false }
    }
}

/// The state of a sample that is being decided.
#[derive(Debug, Clone)]
pub struct Decision<'e> {
    exit: &'e EarlyExit,
    steps: u64,
    counts: Vec<u32>,
    /// The first step in which each output is not refractory; `None` for never.
    free: Vec<Option<u64>>,
    /// The output with most spikes, the lowest on a tie.
    leader: Option<usize>,
    /// The earliest step after which the sample can be decided, for any spikes until then.
    open_until: u64,
}

impl<'e> Decision<'e> {
    /// Returns the state before the first of `steps` steps.
    pub fn new(exit: &'e EarlyExit, steps: u32) -> Self {
        let outputs = exit.bounds.gaps.len();
        Decision {
            exit,
            steps: steps.into(),
            counts: vec![0; outputs],
            free: vec![Some(0); outputs],
            leader: None,
            open_until: 0,
        }
    }

    /// Records a spike of an output.
    pub fn spike(&mut self, step: u32, output: u32) {
        let output = output as usize;
        self.counts[output] += 1;
        self.free[output] = self.exit.bounds.free_after(output, step);
        let count = self.counts[output];
        if self.leader.is_none_or(|l| count > self.counts[l] || (count == self.counts[l] && output < l)) {
            self.leader = Some(output);
        }
    }

    /// The class by the spikes so far.
    pub fn class(&self) -> Option<u32> {
        self.leader.map(|leader| leader as u32)
    }

    /// Whether the sample is decided after the update of `step`. All spikes of the step have to be
    /// recorded before, and calls pass ascending steps.
    pub fn decided_after(&mut self, step: u32) -> bool {
        if u64::from(step) < self.open_until {
            return false;
        }
        let steps_to_decision = self.steps_to_decision(step);
        self.open_until = u64::from(step) + steps_to_decision;
        steps_to_decision == 0
    }

    /// Least number of steps after the update of `step` until the sample can be decided, for any
    /// spikes; 0 when it is decided.
    fn steps_to_decision(&self, step: u32) -> u64 {
        match self.exit.rule {
            Rule::Margin(margin) => {
                // An output gains at most one spike a step, so the lead grows by at most 1.
                let leads = self.leader.map_or(0, |leader| {
                    let others = self.counts.iter().enumerate().filter(|&(other, _)| other != leader);
                    self.counts[leader] - others.map(|(_, &count)| count).max().unwrap_or(0)
                });
                margin.get().saturating_sub(leads).into()
            }
            Rule::Certain => self.steps_to_certainty(step),
        }
    }

    /// The class is certain if the leader stays ahead although it never spikes again and any one
    /// other output spikes as often as it can. No worse case exists: other outputs do not help each
    /// other, and the leader's spikes only help the leader.
    ///
    /// In the end, all but one output can reach at most the leader's count. A step adds at most 1
    /// to that count. It lowers the reach of an output by at most 1, if the output could have
    /// spiked and did not.
    fn steps_to_certainty(&self, step: u32) -> u64 {
        let from = u64::from(step) + 1;
        let ahead = self.leader.map_or(0, |leader| u64::from(self.counts[leader]));
        let (mut open, mut highest, mut second) = (false, 0, 0);
        for output in 0..self.counts.len() {
            let more = self.exit.bounds.most_spikes(output, self.free[output], from, self.steps);
            let reach = u64::from(self.counts[output]) + more;
            (highest, second) = (highest.max(reach), second.max(reach.min(highest)));
            // A tie goes to the lower index.
            open |= match self.leader {
                Some(leader) if leader < output => reach > ahead,
                Some(leader) if leader > output => reach >= ahead,
                Some(_) => false,
                None => reach > 0,
            };
        }
        if open { second.saturating_sub(ahead).div_ceil(2).max(1) } else { 0 }
    }

    /// The first step of `begin..end` after which the sample is decided when no output spikes in
    /// any of them.
    pub fn decided_in_silence(&self, begin: u32, end: u32) -> Option<u32> {
        // The possible later spikes only decrease, so a decided sample stays decided.
        let (mut open, mut decided) = (begin.max(self.open_until.min(end.into()) as u32), end);
        while open < decided {
            let middle = open + (decided - open) / 2;
            if self.steps_to_decision(middle) == 0 {
                decided = middle;
            } else {
                open = middle + 1;
            }
        }
        (decided < end).then_some(decided)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_dynamics::arithmetic::falls_on;
    use nsim_ir::base::rng;

    fn margin(margin: u32) -> Rule {
        Rule::Margin(NonZeroU32::new(margin).unwrap())
    }

    fn exit(rule: Rule, gaps: &[u32]) -> EarlyExit {
        let gaps = gaps.iter().map(|&gap| NonZeroU32::new(gap)).collect();
        EarlyExit { rule, bounds: SpikeBounds { gaps, start: 0, reset: None }, ends: true }
    }

    #[test]
    fn rules_are_read_and_written() {
        assert_eq!("certain".parse(), Ok(Rule::Certain));
        assert_eq!("7".parse(), Ok(margin(7)));
        assert_eq!((margin(7).to_string(), Rule::Certain.to_string()), ("7".to_string(), "certain".to_string()));
        for wrong in ["", "0", "-1", "1.5", "Certain", "4294967296"] {
            assert!(wrong.parse::<Rule>().unwrap_err().contains("certain"), "{wrong}");
        }
    }

    #[test]
    fn a_margin_is_a_lead_over_every_other_output_seen_in_the_step_that_reaches_it() {
        for seed in 0..2000 {
            let outputs = 1 + rng::below(5, seed, 0, 0) as u32;
            let least = 1 + rng::below(9, seed, 0, 1) as u32;
            let (exit, mut counts) = (exit(margin(least), &vec![1; outputs as usize]), vec![0; outputs as usize]);
            let mut decision = Decision::new(&exit, 200);
            for step in 0..200 {
                for output in 0..outputs {
                    let rate = if output == 0 { 60 } else { 40 };
                    if rng::below(100, seed, 2 + u64::from(output), step.into()) < rate {
                        decision.spike(step, output);
                        counts[output as usize] += 1;
                    }
                }
                let mut ranked = counts.clone();
                ranked.sort_unstable_by(|a, b| b.cmp(a));
                let lead = ranked[0] - ranked.get(1).unwrap_or(&0);
                assert_eq!(decision.decided_after(step), lead >= least, "seed {seed}, step {step}");
            }
        }
    }

    /// Whether a compartment may spike, found from its earlier spikes instead of by formula.
    fn may_spike(bounds: &SpikeBounds, output: usize, train: &[u32], step: u32) -> bool {
        let Some(&last) = train.last() else { return step >= bounds.start };
        let was_reset = bounds.reset.is_some_and(|(reset, from)| (last + 1..=step).any(|s| falls_on(reset, s, from)));
        let over = bounds.gaps[output].is_some_and(|gap| step - last >= gap.get());
        step >= bounds.start && (was_reset || over)
    }

    fn class(trains: &[Vec<u32>]) -> Option<usize> {
        let most = trains.iter().map(Vec::len).max().filter(|&most| most > 0)?;
        trains.iter().position(|train| train.len() == most)
    }

    /// Whether every legal continuation from `step` on ends with this class, by enumeration.
    fn all_end_with(
        bounds: &SpikeBounds,
        trains: &mut [Vec<u32>],
        step: u32,
        steps: u32,
        wanted: Option<usize>,
    ) -> bool {
        if step == steps {
            return class(trains) == wanted;
        }
        (0u32..1 << trains.len()).all(|spiking| {
            let chosen = |output: usize| spiking >> output & 1 == 1;
            if (0..trains.len()).any(|o| chosen(o) && !may_spike(bounds, o, &trains[o], step)) {
                return true;
            }
            (0..trains.len()).filter(|&o| chosen(o)).for_each(|o| trains[o].push(step));
            let same = all_end_with(bounds, trains, step + 1, steps, wanted);
            (0..trains.len()).filter(|&o| chosen(o)).for_each(|o| _ = trains[o].pop());
            same
        })
    }

    fn random_bounds(seed: u64, outputs: usize) -> SpikeBounds {
        let draw = |what, below| rng::below(below, seed, 1, what) as u32;
        let gap = |output: usize| match draw(output as u64, 6) {
            0 => None,
            gap => NonZeroU32::new(gap),
        };
        let (start, offset) = (draw(10, 4) * draw(11, 2), draw(12, 3));
        // SLAYER holds a population until step 1 but counts its resets from 0.
        let counted_from = if start == 1 { draw(13, 2) } else { start };
        let reset = (draw(14, 3) == 0).then(|| (Reset { interval: 1 + draw(15, 5), offset }, counted_from));
        SpikeBounds { gaps: (0..outputs).map(gap).collect(), start, reset }
    }

    #[test]
    fn certain_is_exactly_when_no_legal_continuation_changes_the_class() {
        let (mut decided, mut open, mut early) = (0u32, 0u32, 0u32);
        for seed in 0..4000 {
            let draw = |step: u32, output: usize| rng::below(100, seed, 2 + output as u64, u64::from(step));
            let outputs = 1 + rng::below(3, seed, 0, 0) as usize;
            let steps = 1 + rng::below(14, seed, 0, 1) as u32;
            let busy = [5, 30, 60, 100][rng::below(4, seed, 0, 2) as usize];
            let exit = EarlyExit { rule: Rule::Certain, bounds: random_bounds(seed, outputs), ends: true };
            let mut decision = Decision::new(&exit, steps);
            let mut trains = vec![Vec::new(); outputs];
            let mut first = None;
            for step in 0..steps {
                for (output, train) in trains.iter_mut().enumerate() {
                    // One output spikes more often than the others, so that not every sample is a
                    // tie.
                    let rate = if output as u64 == seed % outputs as u64 { busy } else { busy / 2 };
                    if may_spike(&exit.bounds, output, train, step) && draw(step, output) < rate {
                        train.push(step);
                        decision.spike(step, output as u32);
                    }
                }
                let now = class(&trains);
                assert_eq!(decision.class(), now.map(|class| class as u32));
                let says = decision.decided_after(step);
                // The enumeration grows as 2^(outputs * steps).
                if (steps - step - 1) as usize * outputs <= 12 {
                    let holds = all_end_with(&exit.bounds, &mut trains.clone(), step + 1, steps, now);
                    assert_eq!(says, holds, "seed {seed}, step {step}: {exit:?} {trains:?}");
                    *(if says { &mut decided } else { &mut open }) += 1;
                }
                if says && first.is_none() {
                    first = Some((step, now));
                    early += u32::from(step + 1 < steps);
                }
            }
            assert_eq!(first.unwrap().1, class(&trains), "seed {seed}: {exit:?} {trains:?}");
        }
        assert!(decided > 5000 && open > 5000 && early > 2000, "{decided} decided, {open} open, {early} early");
    }

    #[test]
    fn certain_never_changes_the_class_of_a_long_sample() {
        let (mut early, mut saved) = (0, 0);
        for seed in 0..5000 {
            let outputs = 2 + rng::below(19, seed, 0, 0) as usize;
            let steps = 20 + rng::below(300, seed, 0, 1) as u32;
            let exit = EarlyExit { rule: Rule::Certain, bounds: random_bounds(seed, outputs), ends: true };
            let mut decision = Decision::new(&exit, steps);
            let mut trains = vec![Vec::new(); outputs];
            let mut first = None;
            for step in 0..steps {
                for (output, train) in trains.iter_mut().enumerate() {
                    let rate = rng::below(100, seed, 1, output as u64) / 2 + if output == 0 { 50 } else { 0 };
                    let lucky = rng::below(100, seed, 2 + output as u64, u64::from(step)) < rate;
                    if lucky && may_spike(&exit.bounds, output, train, step) {
                        train.push(step);
                        decision.spike(step, output as u32);
                    }
                }
                let decided = decision.decided_after(step);
                assert_eq!(decided, decision.steps_to_decision(step) == 0, "seed {seed}: not looked at in time");
                assert!(decided || first.is_none(), "seed {seed}: a decision was taken back");
                if decided && first.is_none() {
                    first = Some((step, class(&trains)));
                }
            }
            let (step, decided) = first.unwrap();
            assert_eq!(decided, class(&trains), "seed {seed}: {exit:?}");
            early += u32::from(step + 1 < steps);
            saved += steps - step - 1;
        }
        assert!(early > 2000, "{early} of 5000 early, {saved} steps");
    }

    #[test]
    fn a_silence_is_decided_in_the_step_that_it_would_be_step_by_step() {
        for seed in 0..2000 {
            let outputs = 1 + rng::below(4, seed, 0, 0) as usize;
            let steps = 2 + rng::below(60, seed, 0, 1) as u32;
            let exit = EarlyExit { rule: Rule::Certain, bounds: random_bounds(seed, outputs), ends: true };
            let mut decision = Decision::new(&exit, steps);
            let begin = rng::below(u64::from(steps), seed, 0, 2) as u32;
            for step in exit.bounds.start.min(begin)..begin {
                if rng::below(3, seed, 5, u64::from(step)) == 0 {
                    decision.spike(step, rng::below(outputs as u64, seed, 6, u64::from(step)) as u32);
                }
                let _ = decision.decided_after(step);
            }
            let by_steps = (begin..steps).find(|&step| decision.steps_to_decision(step) == 0);
            assert_eq!(decision.decided_in_silence(begin, steps), by_steps, "seed {seed}");
            assert_eq!(decision.decided_in_silence(begin, begin), None);
        }
    }
}
