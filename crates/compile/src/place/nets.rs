//! Messages between cores, and the links that they cross.
//!
//! Input: a network, its partition and rates. Output: *nets*: a core, or the corner where a chip's
//! inputs enter, and the cores that its messages go to, with their rate. Sources of one core with
//! equal destinations are one net. At given places, a net costs links: links of the multicast tree,
//! in which a spike is sent once and copied where routes part, and links of all routes together
//! (unicast). Routes follow [`nsim_ir::placement`]: east or west first.

use std::collections::HashMap;

use rayon::prelude::*;

use crate::place::link_loads::LinkLoads;
use nsim_ir::base::csr::Csr;
use nsim_ir::base::id::{CoreId, Id, IdVec};
use nsim_ir::firing_rates::Rates;
use nsim_ir::partition::Partition;
use nsim_ir::placement::{Mesh, Site};
use nsim_ir::quantised::Quantised;
use nsim_partition::options::Objective;
use nsim_partition::resources::fan_out::by_source;

/// Number of nets of one task.
const PIECE: usize = 1 << 11;

/// One net's source and rate.
#[derive(Debug, Clone, Copy)]
pub struct Net {
    /// The core; none for inputs.
    pub source: Option<u32>,
    /// Spikes in the steps that rates count.
    pub weight: u64,
}

/// All nets.
#[derive(Debug)]
pub struct Nets {
    /// Sources and rates.
    pub nets: Vec<Net>,
    /// Cores that each net reaches, ascending; a net of inputs reaches cores of one chip.
    pub reached: Csr<u32>,
    /// Nets of each core, as source or destination.
    pub of_core: Csr<u32>,
}

/// Costs of places.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Costs {
    /// Links of multicast trees, times rates.
    pub multicast: u64,
    /// Links of single messages, times rates.
    pub unicast: u64,
    /// Rate over the link with the most single messages.
    pub busiest: u64,
    /// Links of the longest route.
    pub longest: u32,
}

impl Costs {
    /// The objective as one number, to be minimised.
    pub fn objective(&self, objective: Objective) -> u128 {
        let hops = 2 * u128::from(self.multicast) + u128::from(self.unicast);
        match objective {
            Objective::Cores | Objective::Energy | Objective::EnergyChip => hops,
            Objective::Latency => hops + u128::from(self.busiest) * 8 + (u128::from(self.longest) << 80),
        }
    }
}

/// Rows of tiles by column while the links of a net are counted.
#[derive(Debug)]
pub struct Columns {
    of: Vec<(u32, u32, u32)>,
    stamp: u32,
    used: Vec<u32>,
}

impl Columns {
    /// Returns empty columns of a board.
    pub fn new(mesh: &Mesh) -> Self {
        Columns { of: vec![(0, 0, 0); (mesh.chips_x * mesh.width) as usize], stamp: 0, used: Vec::new() }
    }

    /// Links of the multicast tree and of all single routes from a tile to others.
    pub fn links(&mut self, from: (u32, u32), to: impl Iterator<Item = (u32, u32)>) -> (u64, u64) {
        self.stamp += 1;
        self.used.clear();
        let (mut west, mut east, mut unicast) = (from.0, from.0, 0u64);
        for (x, y) in to {
            (west, east) = (west.min(x), east.max(x));
            unicast += u64::from(x.abs_diff(from.0) + y.abs_diff(from.1));
            let column = &mut self.of[x as usize];
            if column.0 != self.stamp {
                *column = (self.stamp, y.min(from.1), y.max(from.1));
                self.used.push(x);
            } else {
                *column = (self.stamp, column.1.min(y), column.2.max(y));
            }
        }
        let down: u64 = self.used.iter().map(|&x| self.of[x as usize]).map(|(_, top, end)| u64::from(end - top)).sum();
        (u64::from(east - west) + down, unicast)
    }
}

impl Nets {
    /// The nets of a partition whose cores are numbered chip by chip.
    pub fn new(network: &Quantised, partition: &Partition, rates: &Rates) -> Self {
        let core_of = partition.seats().iter().map(|seat| seat.core).collect();
        let flows: Vec<(Option<u32>, u64, Vec<u32>)> =
            by_source(network, &core_of, partition.cores(), true, |source, own, reached| {
                let mut reached: Vec<u32> = reached.iter().map(|core| core.0).collect();
                reached.sort_unstable();
                (own.map(|core| core.0), rates.rate_of(source), reached)
            });
        Nets::from_flows(partition.cores(), flows.into_iter())
    }

    /// The nets of `all_cores` cores, from flows (core, none for inputs; rate; cores reached,
    /// ascending).
    pub fn from_flows(all_cores: usize, flows: impl Iterator<Item = (Option<u32>, u64, Vec<u32>)>) -> Self {
        let mut known: HashMap<(Option<u32>, Vec<u32>), usize> = HashMap::new();
        let (mut nets, mut reached): (Vec<Net>, Csr<u32>) = (Vec::new(), Csr::default());
        for (source, weight, cores) in flows {
            // A message within its own core crosses no link, so it is ignored.
            if cores.is_empty() || (source.is_some() && cores.len() == 1 && cores.first() == source.as_ref()) {
                continue;
            }
            let at = *known.entry((source, cores)).or_insert_with_key(|(_, cores)| {
                nets.push(Net { source, weight: 0 });
                reached.push(cores.iter().copied());
                nets.len() - 1
            });
            nets[at].weight += weight;
        }
        drop(known);
        let of_core = Csr::by_row(all_cores, |put| {
            for (net, (Net { source, .. }, cores)) in (0..).zip(nets.iter().zip(reached.iter())) {
                cores.iter().for_each(|&core| put(core as usize, net));
                if let Some(source) = source.filter(|source| cores.binary_search(source).is_err()) {
                    put(source as usize, net);
                }
            }
        });
        Nets { nets, reached, of_core }
    }

    /// Whether a core sends messages to another or receives any from one.
    pub fn exchanges(&self, core: CoreId) -> bool {
        self.of_core.get(core.index()).iter().any(|&net| self.nets[net as usize].source.is_some())
    }

    /// Rate of inputs into a core.
    pub fn input(&self, core: CoreId) -> u64 {
        let of = self.of_core.get(core.index()).iter().map(|&net| self.nets[net as usize]);
        of.filter(|net| net.source.is_none()).map(|net| net.weight).sum()
    }

    /// Links of the multicast tree and of all single routes of one net.
    pub fn links(&self, net: u32, mesh: &Mesh, sites: &[Site], columns: &mut Columns) -> (u64, u64) {
        let reached = self.reached.get(net as usize);
        let tile = |core: u32| mesh.tile(sites[core as usize]);
        match self.nets[net as usize].source {
            Some(source) => columns.links(tile(source), reached.iter().map(|&core| tile(core))),
            // Inputs enter every chip at its corner, and are copied from there.
            None => {
                let chip = |core: &u32| sites[*core as usize].chip;
                let (mut tree, mut all) = (0, 0);
                let mut cores = reached;
                while let Some(first) = cores.first() {
                    let here = chip(first);
                    let of_chip = cores.iter().take_while(|core| chip(core) == here).count();
                    let site = sites[*first as usize];
                    let (x, y) = mesh.tile(site);
                    let corner = (x - site.x, y - site.y);
                    let to = cores[..of_chip].iter().map(|&core| tile(core));
                    let (t, a) = columns.links(corner, to);
                    (tree, all) = (tree + t, all + a);
                    cores = &cores[of_chip..];
                }
                (tree, all)
            }
        }
    }

    /// Costs of places; the busiest link and the longest route only where the objective includes
    /// them.
    pub fn costs(&self, mesh: &Mesh, sites: &IdVec<CoreId, Site>, objective: Objective) -> Costs {
        self.costs_of_every(1, mesh, sites, objective)
    }

    /// Costs of places by every `nth` net, for comparing places.
    pub fn costs_of_every(&self, nth: usize, mesh: &Mesh, sites: &IdVec<CoreId, Site>, objective: Objective) -> Costs {
        let (sites, of_links) = (sites.as_slice(), objective == Objective::Latency);
        let of_part = |part: std::ops::Range<usize>| {
            let mut columns = Columns::new(mesh);
            let mut loads = of_links.then(|| LinkLoads::new(mesh));
            let mut costs = Costs::default();
            for net in part.step_by(nth.max(1)) {
                let of = self.nets[net];
                let (tree, all) = self.links(net as u32, mesh, sites, &mut columns);
                costs.multicast += of.weight * tree;
                costs.unicast += of.weight * all;
                let Some(loads) = &mut loads else { continue };
                for &core in self.reached.get(net) {
                    let site = sites[core as usize];
                    let (tx, ty) = mesh.tile(site);
                    let corner = (tx - site.x, ty - site.y);
                    let (fx, fy) = of.source.map_or(corner, |source| mesh.tile(sites[source as usize]));
                    costs.longest = costs.longest.max(fx.abs_diff(tx) + fy.abs_diff(ty));
                    loads.add((fx, fy), (tx, ty), of.weight as i64);
                }
            }
            if let Some(loads) = loads {
                [costs.busiest, ..] = loads.greatest(mesh);
            }
            costs
        };
        // The busiest link depends on all nets together.
        if of_links || self.nets.len() / nth.max(1) < PIECE {
            return of_part(0..self.nets.len());
        }
        let part = PIECE * nth.max(1);
        let parts: Vec<usize> = (0..self.nets.len()).step_by(part).collect();
        let sums = parts.into_par_iter().map(|from| of_part(from..(from + part).min(self.nets.len())));
        sums.reduce(Costs::default, |a, b| Costs {
            multicast: a.multicast + b.multicast,
            unicast: a.unicast + b.unicast,
            ..a
        })
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use nsim_ir::base::rng;

    const MESH: Mesh = Mesh { chips_x: 2, chips_y: 2, width: 4, height: 3, cores_per_tile: 2, cores_per_chip: 24 };

    #[test]
    fn a_tree_is_the_union_of_ways() {
        let mut columns = Columns::new(&MESH);
        for seed in 0..200 {
            let draw = |k: u64, n: u64| rng::below(n, seed, 3, k) as u32;
            let from = (draw(0, 8), draw(1, 6));
            let to: Vec<(u32, u32)> =
                (0..1 + u64::from(draw(2, 9))).map(|k| (draw(10 + k, 8), draw(50 + k, 6))).collect();
            let (mut links, mut all) = (BTreeSet::new(), 0);
            for &(x, y) in &to {
                let mut at = from;
                while at != (x, y) {
                    let next = match at.0 == x {
                        false => (if at.0 < x { at.0 + 1 } else { at.0 - 1 }, at.1),
                        true => (at.0, if at.1 < y { at.1 + 1 } else { at.1 - 1 }),
                    };
                    links.insert((at, next));
                    all += 1;
                    at = next;
                }
            }
            assert_eq!(columns.links(from, to.into_iter()), (links.len() as u64, all), "seed {seed}");
        }
    }
}
