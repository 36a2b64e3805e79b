//! Exchange of cores of a chip, and of chips of the board, to shorten the routes of messages.
//!
//! Input: nets, places to start from and the effort. Output: places, never worse under the
//! objective. A proposal swaps a core with another site of its chip. Half of the time that is a
//! site near the mean position of the cores that it exchanges messages with (the force-directed
//! part), else any. A tile that is not in use receives a whole tile, so that no more tiles are in
//! use than before. A proposal is accepted when it saves links, and otherwise with a probability
//! that falls with its cost and with time (Kirkpatrick et al., "Optimization by simulated
//! annealing", Science 220, 1983). The best places found are the result.
//!
//! Chips are annealed in parallel in rounds, each from the places of all others at the begin of the
//! round. After a round all are combined and accepted if that is better. So the result does not
//! depend on the number of threads.

use std::time::Instant;

use rayon::prelude::*;

use crate::place::nets::{Columns, Nets};
use nsim_ir::base::id::{CoreId, Id, IdVec};
use nsim_ir::base::rng;
use nsim_ir::firing_rates::Rates;
use nsim_ir::placement::{Mesh, Site};
use nsim_partition::options::{Objective, Options, is_over};

/// Weight of a link of a tree, in links of a single message, as in the objective.
const TREE: i64 = 2;
/// Rounds in which chips are annealed against each other; a single chip restarts from its best
/// places.
const ROUNDS: u64 = 6;
/// The first temperature, relative to the average change by a proposal.
const HOTTEST: f64 = 0.3;
/// The last temperature, relative to the first.
const COOLEST: f64 = 5e-2;
/// Destinations of nets that placing visits in a second, approximately.
const PLACED_PER_SECOND: u64 = 25_000_000;
/// Most proposals of a core in a round.
const PROPOSALS: u64 = 200;
/// Least value of the limit on a chip's proposals: a few cores have so few places that all good
/// ones are found, at almost no cost.
const MIN_PROPOSAL_LIMIT: u64 = 1500;

/// Chips are annealed if a round of any of them has a proposal for one core in `FEW`.
const FEW: u64 = 8;
/// Approximate number of nets by which places of whole chips are compared.
const SAMPLED_NETS: usize = 1 << 12;

/// Number of proposals between two checks of the clock.
const LOOKS: u64 = 64;

/// Options of the search for places.
#[derive(Debug, Clone, Copy)]
pub struct Search<'a> {
    /// Objective of the mapping.
    pub objective: Objective,
    /// Firing rates of the sources of the whole network.
    pub rates: &'a Rates,
    /// Seed of the annealing.
    pub seed: u64,
    /// Effort in units of work: destinations of nets visited.
    pub work: u64,
    /// Time at which the search ends in any case.
    pub end: Option<Instant>,
    /// Weight of a link of a multicast tree, in links of a single message.
    pub tree: i64,
}

impl<'a> Search<'a> {
    /// Returns the search for these options, with firing rates of the whole network.
    pub fn new(options: &Options, rates: &'a Rates) -> Self {
        let (work, end) = (options.effort.work(PLACED_PER_SECOND), options.effort.end());
        Search { objective: options.objective, rates, seed: options.seed, work, end, tree: TREE }
    }
}

/// Returns places at which each core is near the cores that exchange messages with it.
pub fn anneal(nets: &Nets, mesh: &Mesh, start: IdVec<CoreId, Site>, search: Search<'_>) -> IdVec<CoreId, Site> {
    let cost = |sites: &IdVec<CoreId, Site>| nets.costs(mesh, sites, search.objective).objective(search.objective);
    let mut best = start;
    if best.len() > mesh.cores_per_chip as usize {
        best = exchanged(nets, mesh, in_rectangle(nets, mesh, best, search.objective), search);
    }
    let cores: Vec<CoreId> = best.ids().collect();
    let chips: Vec<&[CoreId]> = cores.chunks(mesh.cores_per_chip as usize).collect();
    let work = search.work / ROUNDS / chips.len().max(1) as u64;
    // A few proposals among many cores are not worth the cost of counting all nets.
    let worthwhile = chips.iter().any(|cores| proposals(nets, cores, work) * FEW >= cores.len() as u64);
    if !worthwhile {
        return best;
    }
    let mut least = cost(&best);
    for round in 0..ROUNDS {
        if is_over(search.end) {
            break;
        }
        let found: Vec<Vec<Site>> = chips
            .par_iter()
            .enumerate()
            .map(|(chip, cores)| {
                let seed = rng::bits(search.seed, round, chip as u64);
                one_chip(nets, mesh, best.as_slice(), cores, Search { seed, work, ..search })
            })
            .collect();
        let together: IdVec<CoreId, Site> = found.into_iter().flatten().collect::<Vec<Site>>().into();
        let now = cost(&together);
        if now < least {
            (best, least) = (together, now);
        }
    }
    best
}

/// Links of a net as one number, times its rate: `times` the multicast tree plus all routes.
fn weighted_links(nets: &Nets, net: u32, mesh: &Mesh, sites: &[Site], (columns, times): (&mut Columns, i64)) -> i64 {
    let (tree, all) = nets.links(net, mesh, sites, columns);
    (times * tree as i64 + all as i64) * nets.nets[net as usize].weight as i64
}

/// Number of proposals that `work` allows for the cores of one chip.
fn proposals(nets: &Nets, cores: &[CoreId], work: u64) -> u64 {
    let touched: usize = cores
        .iter()
        .flat_map(|core| nets.of_core.get(core.index()))
        .map(|&net| 2 + nets.reached.get(net as usize).len())
        .sum();
    let each = (touched / cores.len().max(1)).max(1) as u64 * 4;
    (work / each).min((PROPOSALS * cores.len() as u64).max(MIN_PROPOSAL_LIMIT))
}

/// Anneals the cores of one chip while all others stay.
fn one_chip(
    nets: &Nets,
    mesh: &Mesh,
    all: &[Site],
    cores: &[CoreId],
    Search { seed, work, end, tree, .. }: Search<'_>,
) -> Vec<Site> {
    let mut sites = all.to_vec();
    let first = cores[0].index();
    let chip = sites[first].chip;
    let own = |sites: &[Site]| sites[first..first + cores.len()].to_vec();
    let start = mesh.number(Site { chip, x: 0, y: 0, core: 0 }).unwrap_or(0);
    let mut held: Vec<Option<usize>> = vec![None; mesh.cores_per_chip as usize];
    for core in cores {
        if let Some(number) = mesh.number(sites[core.index()]) {
            held[(number - start) as usize] = Some(core.index());
        }
    }
    let mut columns = Columns::new(mesh);
    let proposals = proposals(nets, cores, work);
    if cores.len() < 2 && held.len() < 2 || proposals == 0 {
        return own(&sites);
    }
    let (mut now, mut least, mut best) = (0i64, 0i64, own(&sites));
    let mut affected: Vec<u32> = Vec::new();
    let mut moves: Vec<(usize, Site, Site)> = Vec::new();
    let (mut changes, mut tried) = (0.0, 0.0);
    for step in 0..proposals {
        if step % LOOKS == 0 && is_over(end) {
            break;
        }
        let draw = |k: u64, n: u64| rng::below(n, seed, step, k);
        let core = cores[draw(0, cores.len() as u64) as usize].index();
        let from = sites[core];
        let wanted = match draw(1, 2) {
            0 => middle(nets, mesh, &sites, core as u32, chip).map(|(x, y)| {
                let spread = |at: u32, most: u32, k| {
                    (i64::from(at) + draw(k, 3) as i64 - 1).clamp(0, i64::from(most) - 1) as u32
                };
                (spread(x, mesh.width, 3), spread(y, mesh.height, 4))
            }),
            _ => None,
        };
        let any = || (draw(3, u64::from(mesh.width)) as u32, draw(4, u64::from(mesh.height)) as u32);
        let (x, y) = wanted.unwrap_or_else(any);
        let to = Site { chip, x, y, core: draw(5, u64::from(mesh.cores_per_tile)) as u32 };
        let Some(number) = mesh.number(to).filter(|_| (to.x, to.y) != (from.x, from.y)) else { continue };
        moves.clear();
        let tile = |site: Site| (0..mesh.cores_per_tile).map(move |core| Site { core, ..site });
        let holder = |held: &[Option<usize>], site: Site| held[(mesh.number(site)? - start) as usize];
        if tile(to).any(|site| holder(&held, site).is_some()) {
            moves.push((core, from, to));
            moves.extend(held[(number - start) as usize].map(|other| (other, to, from)));
        } else {
            // Power is supplied by tile, so no further tile is begun: all cores of this one move.
            for site in tile(from) {
                let there = Site { core: site.core, ..to };
                moves.extend(holder(&held, site).filter(|_| mesh.number(there).is_some()).map(|c| (c, site, there)));
            }
            if moves.len() != tile(from).filter(|&site| holder(&held, site).is_some()).count() {
                continue;
            }
        }
        affected.clear();
        moves.iter().for_each(|&(core, _, _)| affected.extend(nets.of_core.get(core)));
        if moves.len() > 1 {
            affected.sort_unstable();
            affected.dedup();
        }
        let sum = |sites: &[Site], columns: &mut Columns| -> i64 {
            affected.iter().map(|&net| weighted_links(nets, net, mesh, sites, (columns, tree))).sum()
        };
        let before = sum(&sites, &mut columns);
        moves.iter().for_each(|&(core, _, to)| sites[core] = to);
        let change = sum(&sites, &mut columns) - before;
        // The average change by a proposal so far sets the temperature.
        (changes, tried) = (changes + change.unsigned_abs() as f64, tried + 1.0);
        let temperature = HOTTEST * changes.max(1.0) / tried * COOLEST.powf(step as f64 / proposals as f64);
        let accepted = change <= 0 || rng::unit(seed, step, 6) < (-(change as f64) / temperature).exp();
        if accepted {
            now += change;
            let mut hold = |site: Site, core: Option<usize>| {
                if let Some(number) = mesh.number(site) {
                    held[(number - start) as usize] = core;
                }
            };
            moves.iter().for_each(|&(_, from, _)| hold(from, None));
            moves.iter().for_each(|&(core, _, to)| hold(to, Some(core)));
            if now < least {
                (least, best) = (now, own(&sites));
            }
        } else {
            moves.iter().for_each(|&(core, from, _)| sites[core] = from);
        }
    }
    best
}

/// Tile of this chip nearest to the mean position of the cores that a core exchanges messages with.
fn middle(nets: &Nets, mesh: &Mesh, sites: &[Site], core: u32, chip: u32) -> Option<(u32, u32)> {
    let (mut x, mut y, mut sum) = (0u64, 0u64, 0u64);
    let (left, top) = ((chip % mesh.chips_x) * mesh.width, (chip / mesh.chips_x) * mesh.height);
    let mut pull = |(px, py): (u32, u32), weight: u64| {
        let near = |at: u32, first: u32, size: u32| u64::from(at.clamp(first, first + size - 1) - first);
        x += near(px, left, mesh.width) * weight;
        y += near(py, top, mesh.height) * weight;
        sum += weight;
    };
    for &net in nets.of_core.get(core as usize) {
        let of = nets.nets[net as usize];
        match of.source {
            Some(source) if source == core => {
                nets.reached.get(net as usize).iter().for_each(|&to| pull(mesh.tile(sites[to as usize]), of.weight));
            }
            Some(source) => pull(mesh.tile(sites[source as usize]), of.weight),
            None => pull((left, top), of.weight),
        }
    }
    (sum > 0).then(|| (((x + sum / 2) / sum) as u32, ((y + sum / 2) / sum) as u32))
}

/// Chips in the rectangle in which spikes cross the fewest links, by a sample of nets; unchanged
/// where none is better.
fn in_rectangle(nets: &Nets, mesh: &Mesh, sites: IdVec<CoreId, Site>, objective: Objective) -> IdVec<CoreId, Site> {
    let used = sites.len().div_ceil(mesh.cores_per_chip as usize) as u32;
    let nth = nets.nets.len() / SAMPLED_NETS;
    let cost = |sites: &IdVec<CoreId, Site>| nets.costs_of_every(nth, mesh, sites, objective).objective(objective);
    let rectangle = |columns: u32| {
        let mut sites = sites.clone();
        for (core, site) in sites.iter_mut().enumerate() {
            let chip = core as u32 / mesh.cores_per_chip;
            let (x, y) = (chip % columns, chip / columns);
            // Row by row, there and back, so that a chip and the next are neighbours.
            let x = if y % 2 == 0 { x } else { columns - 1 - x };
            site.chip = y * mesh.chips_x + x;
        }
        sites
    };
    let columns = (1..=mesh.chips_x.min(used)).filter(|columns| used.div_ceil(*columns) <= mesh.chips_y);
    let best = columns.map(rectangle).map(|sites| (cost(&sites), sites)).min_by_key(|(cost, _)| *cost);
    let now = cost(&sites);
    best.filter(|(least, _)| *least < now).map_or(sites, |(_, best)| best)
}

/// Chips exchanged for each other, and for chips not in use, while that saves links.
fn exchanged(nets: &Nets, mesh: &Mesh, mut sites: IdVec<CoreId, Site>, search: Search<'_>) -> IdVec<CoreId, Site> {
    // Only messages between chips matter, so chips represent their cores; few enough to try every
    // pair.
    let used = sites.len().div_ceil(mesh.cores_per_chip as usize);
    let nth = (nets.nets.len() / SAMPLED_NETS).max(1);
    let messages: usize = (nets.reached.items().len() + nets.nets.len()) / nth;
    let near = (used as u32 + mesh.chips_x).min(mesh.chips_x * mesh.chips_y);
    let tries = (search.work / 2 / (messages.max(1) as u64)).min(u64::from(near) * used as u64 * 2);
    // Fewer links of single messages are no gain where trees have more: the whole placement would
    // be refused.
    let cost = |sites: &IdVec<CoreId, Site>| {
        let costs = nets.costs_of_every(nth, mesh, sites, search.objective);
        (costs.multicast, costs.objective(search.objective))
    };
    let mut least = cost(&sites);
    for step in 0..tries {
        if is_over(search.end) {
            break;
        }
        let a = rng::below(used as u64, search.seed, step, 100) as u32;
        let from = sites[CoreId(a * mesh.cores_per_chip)].chip;
        let to = rng::below(u64::from(near), search.seed, step, 101) as u32;
        if from == to {
            continue;
        }
        let mut changed = sites.clone();
        for site in changed.iter_mut() {
            site.chip = match site.chip {
                chip if chip == from => to,
                chip if chip == to => from,
                chip => chip,
            };
        }
        let now = cost(&changed);
        if now.0 <= least.0 && now.1 < least.1 {
            (sites, least) = (changed, now);
        }
    }
    sites
}
