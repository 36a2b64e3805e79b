//! Compartments merged into ever larger groups, by the nets that they share.
//!
//! Input: a hypergraph. Output: levels of labels. On each level, a group of the level below gets
//! the label of the free group with which it shares most of its nets (heavy-connectivity matching,
//! as multilevel partitioners coarsen: Karypis et al., "Multilevel hypergraph partitioning", DAC
//! 1997; Catalyurek & Aykanat, "PaToH", 1999). A net of k pins counts 1 / (k - 1) of its weight for
//! each pair; nets of many pins distinguish no pair from another and are omitted. The levels give
//! an order in which related compartments are consecutive, and the groups that are moved as one
//! during refinement.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::time::Instant;

use crate::options::is_over;
use crate::strategy::hyper::{Groups, Hypergraph, transposed};
use nsim_ir::base::csr::Csr;
use nsim_ir::base::rng;

/// Pins above which a net is ignored.
const LARGEST_NET: usize = 200;
/// Most nets of a group that are considered; a random sample where there are more.
const NETS: u64 = 48;
/// Most levels.
const LEVELS: usize = 40;
const SEED: u64 = 0x1e7e1;
/// Number of compartments between two checks of the clock.
const LOOKS: usize = 64;

/// Labels of compartments, level by level from fine to coarse; `None` for fixed compartments.
#[derive(Debug)]
pub struct Levels {
    /// Label of each compartment by level; the first level labels each compartment by itself.
    pub labels: Vec<Vec<Option<u32>>>,
}

impl Levels {
    /// The levels of a hypergraph without the compartments that are `fixed`; no further level after
    /// the time `end`.
    pub fn new(graph: &Hypergraph, fixed: &[bool], end: Option<Instant>) -> Self {
        let mut numbers = 0u32..;
        let mut labels: Vec<Vec<Option<u32>>> =
            vec![fixed.iter().map(|&fixed| if fixed { None } else { numbers.next() }).collect()];
        for _ in 0..LEVELS {
            let Some(last) = labels.last() else { break };
            let groups = Groups::new(graph, last);
            if groups.len() < 2 {
                break;
            }
            let Some((merged, count)) = matched(graph, &groups, end) else { break };
            if f64::from(count) > 0.97 * groups.len() as f64 {
                break;
            }
            labels.push(last.iter().map(|label| label.map(|label| merged[label as usize])).collect());
        }
        Levels { labels }
    }

    /// All compartments that move, ordered such that each group is consecutive on every level.
    pub fn order(&self) -> Vec<u32> {
        let mut ids: Vec<u32> =
            (0..self.labels[0].len() as u32).filter(|&id| self.labels[0][id as usize].is_some()).collect();
        ids.sort_by_key(|&id| self.labels.iter().rev().map(|level| level[id as usize]).collect::<Vec<_>>());
        ids
    }
}

/// The label of each group's pair, and the number of labels; `None` when `end` comes before all
/// have one.
fn matched(graph: &Hypergraph, groups: &Groups, end: Option<Instant>) -> Option<(Vec<u32>, u32)> {
    let pins: Csr<u32> = transposed(&groups.into, graph.nets.len(), |group, (net, _)| (net, group));
    let owners: Csr<u32> = transposed(&groups.own, graph.nets.len(), |group, (net, _, _)| (net, group));
    let mut partner: Vec<Option<u32>> = vec![None; groups.len()];
    let (mut score, mut touched) = (vec![0f64; groups.len()], Vec::new());
    // Groups are visited in random order: in the file's, the last would find no free partner.
    let mut turns: Vec<u32> = (0..groups.len() as u32).collect();
    turns.sort_unstable_by_key(|&group| rng::bits(SEED, groups.len() as u64, u64::from(group)));
    let size = |group: u32| groups.members.get(group as usize).len();
    for (turn, group) in turns.into_iter().enumerate() {
        if turn % LOOKS == 0 && is_over(end) {
            return None;
        }
        if partner[group as usize].is_some() {
            continue;
        }
        let mut look = |net: u32, weight: f64| {
            let (pins, owners) = (pins.get(net as usize), owners.get(net as usize));
            let all = pins.len() + owners.len();
            if !(2..=LARGEST_NET).contains(&all) {
                return;
            }
            for &other in pins.iter().chain(owners) {
                if other != group && partner[other as usize].is_none() {
                    if score[other as usize] == 0.0 {
                        touched.push(other);
                    }
                    score[other as usize] += weight / (all - 1) as f64;
                }
            }
        };
        let into = groups.into.get(group as usize);
        let sampled = (into.len() as u64).min(NETS);
        for k in 0..sampled {
            let at =
                if sampled == into.len() as u64 { k } else { rng::below(into.len() as u64, SEED, group.into(), k) };
            let net = into[at as usize].0;
            look(net, graph.nets[net as usize].weight as f64);
        }
        groups.own.get(group as usize).iter().for_each(|&(net, _, rate)| look(net, rate as f64));
        let mut best: Option<(f64, u32)> = None;
        for other in touched.drain(..) {
            // Small groups first, so that all grow equally.
            let worth = score[other as usize] / (size(group) * size(other)) as f64;
            score[other as usize] = 0.0;
            if best.is_none_or(|(most, least)| worth > most || (worth == most && other < least)) {
                best = Some((worth, other));
            }
        }
        if let Some((_, other)) = best {
            (partner[group as usize], partner[other as usize]) = (Some(other), Some(group));
        }
    }
    let mut labels = vec![u32::MAX; groups.len()];
    let mut count = 0;
    for group in 0..groups.len() {
        if let Some(other) = partner[group].filter(|&other| (other as usize) < group) {
            labels[group] = labels[other as usize];
        } else {
            labels[group] = count;
            count += 1;
        }
    }
    Some((labels, count))
}

/// An order by growth: the next compartment is the one with most connections to the compartments
/// already chosen.
///
/// Compartments are connected when one reaches the other, or when a small net of inputs or of a
/// dense layer reaches both. Where none is connected, the next in the order of the file starts
/// again. After `core` compartments, only connections to later ones count. After the time `end`,
/// the rest follow in the order of the file.
pub fn grown(graph: &Hypergraph, fixed: &[bool], core: usize, end: Option<Instant>) -> Vec<u32> {
    let n = fixed.len();
    let pins: Csr<u32> = transposed(&graph.into, graph.nets.len(), |id, (net, _)| (net, id));
    let mut owner: Vec<Option<u32>> = vec![None; graph.nets.len()];
    for (id, own) in graph.own.iter().enumerate() {
        if let Some((net, _)) = own
            && graph.nets[*net as usize].sources == 1
        {
            owner[*net as usize] = Some(id as u32);
        }
    }
    let (mut order, mut placed) = (Vec::with_capacity(n), fixed.to_vec());
    let (mut score, mut touched) = (vec![0u64; n], Vec::new());
    let mut heap = BinaryHeap::new();
    let mut next = 0;
    loop {
        if order.len() % LOOKS == 0 && is_over(end) {
            order.extend((0..n as u32).filter(|&id| !placed[id as usize]));
            return order;
        }
        let is_current = |&(stored_score, Reverse(id)): &(u64, Reverse<u32>)| {
            !placed[id as usize] && score[id as usize] == stored_score
        };
        let id = match std::iter::from_fn(|| heap.pop()).find(is_current) {
            Some((_, Reverse(id))) => id,
            None => {
                while next < n && placed[next] {
                    next += 1;
                }
                if next == n {
                    return order;
                }
                next as u32
            }
        };
        if order.len() % core.max(1) == 0 {
            // Another core begins: connections to the last one no longer count.
            heap.clear();
            touched.drain(..).for_each(|id: u32| score[id as usize] = 0);
        }
        placed[id as usize] = true;
        order.push(id);
        let mut join = |other: u32, weight: u64| {
            if !placed[other as usize] {
                if score[other as usize] == 0 {
                    touched.push(other);
                }
                score[other as usize] += weight;
                heap.push((score[other as usize], Reverse(other)));
            }
        };
        if let Some((net, rate)) = graph.own[id as usize] {
            let pins = pins.get(net as usize);
            if pins.len() <= LARGEST_NET {
                pins.iter().for_each(|&other| join(other, rate));
            }
        }
        for &(net, _) in graph.into.get(id as usize) {
            match owner[net as usize] {
                Some(other) => join(other, graph.nets[net as usize].weight),
                // Input channels are on no core: compartments that share one belong together.
                None => {
                    let pins = pins.get(net as usize);
                    if pins.len() <= LARGEST_NET / 4 {
                        pins.iter().for_each(|&other| join(other, graph.nets[net as usize].weight));
                    }
                }
            }
        }
    }
}
