//! Moving groups of compartments between cores while that saves messages.
//!
//! Input: a [`State`] and [`Groups`]. Output: a state that is no worse. Passes follow Fiduccia and
//! Mattheyses ("A linear-time heuristic for improving network partitions", DAC 1982): the best move
//! first, each group once a pass, costly moves are tried too, and at the end of a pass the state
//! returns to its best. Gains are exact: a group's gain is computed again when its turn comes. Two
//! points differ from the paper. There are many cores, so a group considers only cores that already
//! share one of its nets. Cores are nearly full, so a group that does not fit on its best core may
//! be swapped with a group there.
//!
//! Moves are ordered by (gain, number of the group), so the result is equal on every machine.

use std::collections::BinaryHeap;
use std::time::Instant;

use crate::options::is_over;
use crate::strategy::hyper::{Groups, State};
use nsim_ir::base::rng;

/// Most passes over all groups.
const PASSES: usize = 3;
/// Moves without a new best after which a pass ends.
const PATIENCE: usize = 400;
/// Groups of the other core that are considered for a swap.
const PARTNERS: u64 = 12;
/// Work of one net of a swap partner: several searches through the cores that it reaches.
const PARTNER_WORK: u64 = 24;
const SEED: u64 = 0x5eed;

/// Number of groups between two checks of the clock.
const LOOKS: u32 = 64;

/// Scores of cores; clearing resets only the scores that were set.
#[derive(Debug)]
struct Scores {
    of: Vec<u64>,
    touched: Vec<u32>,
}

impl Scores {
    fn add(&mut self, core: u32, weight: u64) {
        let score = &mut self.of[core as usize];
        if *score == 0 {
            self.touched.push(core);
        }
        *score += weight;
    }

    /// The cores with the best scores, best first, without `own`.
    fn best(&mut self, own: u32) -> [Option<u32>; 3] {
        let mut best = [None::<(u64, u32)>; 3];
        for &core in &self.touched {
            let mut entry = Some((std::mem::take(&mut self.of[core as usize]), core)).filter(|_| core != own);
            for place in &mut best {
                let better = match (entry, *place) {
                    (Some((a, x)), Some((b, y))) => (a, std::cmp::Reverse(x)) > (b, std::cmp::Reverse(y)),
                    (Some(_), None) => true,
                    (None, _) => false,
                };
                if better {
                    std::mem::swap(place, &mut entry);
                }
            }
        }
        self.touched.clear();
        best.map(|entry| entry.map(|(_, core)| core))
    }
}

/// Refines a state by moving groups, until `end` at most. `work` is the remaining effort of all
/// passes together, in visits of a net on a core: a measure of time that is equal on every machine.
pub fn refine(state: &mut State, groups: &Groups, work: &mut u64, end: Option<Instant>) {
    for _ in 0..PASSES {
        let before = state.cost();
        if *work == 0 || groups.is_empty() || state.cores() < 2 {
            break;
        }
        pass(state, groups, work, end);
        if state.cost() >= before {
            break;
        }
    }
}

/// A group that goes from one core to another.
#[derive(Debug, Clone, Copy)]
struct Move {
    group: u32,
    from: u32,
    to: u32,
}

impl Move {
    fn apply(self, state: &mut State, groups: &Groups) {
        state.apply(groups, self.group, self.from, self.to);
    }

    fn undo(self, state: &mut State, groups: &Groups) {
        state.apply(groups, self.group, self.to, self.from);
    }
}

fn pass(state: &mut State, groups: &Groups, work: &mut u64, end: Option<Instant>) {
    let mut scores = Scores { of: vec![0; state.cores()], touched: Vec::new() };
    let mut heap: BinaryHeap<(i64, std::cmp::Reverse<u32>)> = BinaryHeap::new();
    for group in 0..groups.len() as u32 {
        if let Some((gain, _)) = wish(state, groups, group, &mut scores, work) {
            heap.push((gain, std::cmp::Reverse(group)));
        }
        if *work == 0 || group % LOOKS == 0 && is_over(end) {
            break;
        }
    }
    let mut by_core: Vec<Vec<u32>> = vec![Vec::new(); state.cores()];
    for group in 0..groups.len() as u32 {
        by_core[core_of(state, groups, group) as usize].push(group);
    }
    let mut locked = vec![false; groups.len()];
    let (mut moves, mut sum, mut best, mut best_length): (Vec<Move>, i64, i64, usize) = (Vec::new(), 0, 0, 0);
    while let Some((stored_gain, std::cmp::Reverse(group))) = heap.pop() {
        if *work == 0 || (moves.len() - best_length) > PATIENCE || is_over(end) {
            break;
        }
        if locked[group as usize] {
            continue;
        }
        let from = core_of(state, groups, group);
        let Some((gain, to)) = wish(state, groups, group, &mut scores, work) else { continue };
        if gain < stored_gain && heap.peek().is_some_and(|next| next.0 > gain) {
            heap.push((gain, std::cmp::Reverse(group)));
            continue;
        }
        if gain <= 0 && moves.len() == best_length && best_length > 0 && gain < -best.max(1) {
            break;
        }
        let wanted = Move { group, from, to };
        let moved = if state.may_move(groups, group, from, to) {
            wanted.apply(state, groups);
            Some((None, gain))
        } else {
            let swapped = swap(state, groups, wanted, &by_core, &locked, work);
            swapped.map(|(partner, gain)| (Some(Move { group: partner, from: to, to: from }), gain))
        };
        if let Some((back, gain)) = moved {
            sum += gain;
            for change in [Some(wanted), back].into_iter().flatten() {
                moves.push(change);
                locked[change.group as usize] = true;
                by_core[change.to as usize].push(change.group);
            }
        }
        if sum > best {
            (best, best_length) = (sum, moves.len());
        }
    }
    moves.drain(best_length..).rev().for_each(|change| change.undo(state, groups));
}

/// The core of a group.
fn core_of(state: &State, groups: &Groups, group: u32) -> u32 {
    state.core_of[groups.members.get(group as usize)[0] as usize]
}

/// The gain of a group's best move, and the core that it goes to.
fn wish(state: &State, groups: &Groups, group: u32, scores: &mut Scores, work: &mut u64) -> Option<(i64, u32)> {
    let from = core_of(state, groups, group);
    let mut looked = 1;
    state.for_each_shared(groups, group, |core, weight| {
        looked += 1;
        scores.add(core, weight);
    });
    // Computing three gains visits the nets again.
    *work = work.saturating_sub(4 * looked);
    let wanted = scores.best(from);
    let gains = wanted.into_iter().flatten().map(|to| (state.gain(groups, group, from, to), std::cmp::Reverse(to)));
    gains.max().map(|(gain, std::cmp::Reverse(to))| (gain, to))
}

/// Makes a move together with a move of a group of the other core back, if that saves messages and
/// fits; returns that group and the gain.
fn swap(
    state: &mut State,
    groups: &Groups,
    wanted: Move,
    by_core: &[Vec<u32>],
    locked: &[bool],
    work: &mut u64,
) -> Option<(u32, i64)> {
    let Move { group, from, to } = wanted;
    let others = &by_core[to as usize];
    if others.is_empty() {
        return None;
    }
    let first = state.gain(groups, group, from, to);
    if first <= 0 {
        return None;
    }
    wanted.apply(state, groups);
    let size = |group: u32| groups.members.get(group as usize).len();
    let mut best: Option<(i64, u32)> = None;
    for draw in 0..PARTNERS {
        let partner = others[rng::below(others.len() as u64, SEED, u64::from(group), draw) as usize];
        let is_there = core_of(state, groups, partner) == to;
        if partner == group || locked[partner as usize] || !is_there || size(partner) > 2 * size(group) {
            continue;
        }
        *work = work.saturating_sub(PARTNER_WORK * (1 + groups.into.get(partner as usize).len() as u64));
        let gain = first + state.gain(groups, partner, to, from);
        if gain > 0 && best.is_none_or(|(most, _)| gain > most) {
            best = Some((gain, partner));
        }
    }
    if let Some((gain, partner)) = best {
        let back = Move { group: partner, from: to, to: from };
        back.apply(state, groups);
        if state.within(from) && state.within(to) && state.senders_within(groups, group, partner) {
            return Some((partner, gain));
        }
        back.undo(state, groups);
    }
    wanted.undo(state, groups);
    None
}
