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

use std::ops::Range;
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

/// A core that goes from one site to another.
#[derive(Clone, Copy)]
struct Move {
    core: usize,
    from: Site,
    to: Site,
}

/// Random numbers of one proposal.
#[derive(Clone, Copy)]
struct Draws {
    seed: u64,
    step: u64,
}

impl Draws {
    /// Number `k` of the proposal, below `n`.
    fn below(self, k: u64, n: u32) -> u32 {
        rng::below(u64::from(n), self.seed, self.step, k) as u32
    }
}

/// A chip whose cores are annealed while all others stay.
struct Chip<'a> {
    nets: &'a Nets,
    mesh: &'a Mesh,
    /// Weight of a link of a multicast tree.
    tree: i64,
    chip: u32,
    /// Number of the first site of the chip.
    start: u32,
    /// Indices of its cores.
    cores: Range<usize>,
    /// The site of each core of the board.
    sites: Vec<Site>,
    /// The core on each site of the chip.
    occupants: Vec<Option<usize>>,
    columns: Columns,
}

impl<'a> Chip<'a> {
    fn new(nets: &'a Nets, mesh: &'a Mesh, all: &[Site], cores: &[CoreId], tree: i64) -> Self {
        let first = cores[0].index();
        let (chip, cores) = (all[first].chip, first..first + cores.len());
        let start = mesh.number(Site { chip, x: 0, y: 0, core: 0 }).unwrap_or(0);
        let occupants = vec![None; mesh.cores_per_chip as usize];
        let (sites, columns) = (all.to_vec(), Columns::new(mesh));
        let mut this = Chip { nets, mesh, tree, chip, start, cores, sites, occupants, columns };
        this.cores.clone().for_each(|core| this.occupy(this.sites[core], Some(core)));
        this
    }

    /// The sites of its cores.
    fn own(&self) -> Vec<Site> {
        self.sites[self.cores.clone()].to_vec()
    }

    fn occupant(&self, site: Site) -> Option<usize> {
        self.occupants[(self.mesh.number(site)? - self.start) as usize]
    }

    fn occupy(&mut self, site: Site, core: Option<usize>) {
        if let Some(number) = self.mesh.number(site) {
            self.occupants[(number - self.start) as usize] = core;
        }
    }

    /// The proposed site of a core: half of the time near the cores that it exchanges messages
    /// with, else any.
    fn proposed(&self, core: usize, draws: Draws) -> Site {
        let mesh = self.mesh;
        let is_near = draws.below(1, 2) == 0;
        let near = if is_near { middle(self.nets, mesh, &self.sites, core as u32, self.chip) } else { None };
        let spread = |at: u32, size: u32, k: u64| {
            (i64::from(at) + i64::from(draws.below(k, 3)) - 1).clamp(0, i64::from(size) - 1) as u32
        };
        let (x, y) = match near {
            Some((x, y)) => (spread(x, mesh.width, 3), spread(y, mesh.height, 4)),
            None => (draws.below(3, mesh.width), draws.below(4, mesh.height)),
        };
        Site { chip: self.chip, x, y, core: draws.below(5, mesh.cores_per_tile) }
    }

    /// Puts the moves that bring a core to a site into `moves`; none where it stays on its tile, or
    /// where the other tile does not have the sites.
    fn moves_to(&self, core: usize, to: Site, moves: &mut Vec<Move>) {
        moves.clear();
        let from = self.sites[core];
        if (to.x, to.y) == (from.x, from.y) || self.mesh.number(to).is_none() {
            return;
        }
        let tile = |site: Site| (0..self.mesh.cores_per_tile).map(move |core| Site { core, ..site });
        if tile(to).any(|site| self.occupant(site).is_some()) {
            moves.push(Move { core, from, to });
            moves.extend(self.occupant(to).map(|other| Move { core: other, from: to, to: from }));
            return;
        }
        // Power is supplied by tile, so no further tile is begun: all cores of this one move.
        for from in tile(from) {
            let Some(core) = self.occupant(from) else { continue };
            let to = Site { core: from.core, ..to };
            if self.mesh.number(to).is_none() {
                moves.clear();
                return;
            }
            moves.push(Move { core, from, to });
        }
    }

    /// Links of nets as one number, times their rates: `tree` times the multicast trees plus all
    /// routes.
    fn weighted_links(&mut self, nets: &[u32]) -> i64 {
        let of_net = |&net: &u32| {
            let (tree, all) = self.nets.links(net, self.mesh, &self.sites, &mut self.columns);
            (self.tree * tree as i64 + all as i64) * self.nets.nets[net as usize].weight as i64
        };
        nets.iter().map(of_net).sum()
    }
}

/// Anneals the cores of one chip while all others stay.
fn one_chip(nets: &Nets, mesh: &Mesh, all: &[Site], cores: &[CoreId], search: Search<'_>) -> Vec<Site> {
    let Search { seed, work, end, tree, .. } = search;
    let mut chip = Chip::new(nets, mesh, all, cores, tree);
    let proposals = proposals(nets, cores, work);
    if cores.len() < 2 && chip.occupants.len() < 2 || proposals == 0 {
        return chip.own();
    }
    let (mut now, mut least, mut best) = (0i64, 0i64, chip.own());
    let (mut affected, mut moves): (Vec<u32>, Vec<Move>) = (Vec::new(), Vec::new());
    let (mut changes, mut tried) = (0.0, 0.0);
    for step in 0..proposals {
        if step % LOOKS == 0 && is_over(end) {
            break;
        }
        let draws = Draws { seed, step };
        let core = cores[draws.below(0, cores.len() as u32) as usize].index();
        chip.moves_to(core, chip.proposed(core, draws), &mut moves);
        if moves.is_empty() {
            continue;
        }
        affected.clear();
        moves.iter().for_each(|change| affected.extend(nets.of_core.get(change.core)));
        if moves.len() > 1 {
            affected.sort_unstable();
            affected.dedup();
        }
        let before = chip.weighted_links(&affected);
        moves.iter().for_each(|change| chip.sites[change.core] = change.to);
        let change = chip.weighted_links(&affected) - before;
        // The average change by a proposal so far sets the temperature.
        (changes, tried) = (changes + change.unsigned_abs() as f64, tried + 1.0);
        let temperature = HOTTEST * changes.max(1.0) / tried * COOLEST.powf(step as f64 / proposals as f64);
        let accepted = change <= 0 || rng::unit(seed, step, 6) < (-(change as f64) / temperature).exp();
        if !accepted {
            moves.iter().for_each(|change| chip.sites[change.core] = change.from);
            continue;
        }
        now += change;
        moves.iter().for_each(|change| chip.occupy(change.from, None));
        moves.iter().for_each(|change| chip.occupy(change.to, Some(change.core)));
        if now < least {
            (least, best) = (now, chip.own());
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
