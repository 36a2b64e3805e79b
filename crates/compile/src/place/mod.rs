//! Placement of logical cores on physical cores.
//!
//! Input: a network, its partition and a target. Output: a [`Placement`]. The partition has counted
//! output axons for cores numbered chip by chip (core k on the k / 128th chip). A message to
//! another chip takes more of them, so the cores of a chip stay together. Placement chooses each
//! core's tile on its chip and each chip's place on the board.
//!
//! - *Sequential*: core k of the partition is core k of the board, counted chip by chip, row of
//!   tiles by row, tile by tile, as the public tools assign cores.
//! - *Annealed*: starts from the better of that order and a Hilbert curve through the tiles from
//!   the corner where inputs enter (Jin et al., ASPLOS 2023, start from one too). Then cores are
//!   exchanged ([`anneal`]): towards the mean position of the cores they exchange messages with
//!   (force-directed) or at random, and accepted as in simulated annealing. The objective is the
//!   number of links that spikes cross in a step, as multicast trees and as single messages; under
//!   [`Objective::Latency`] the busiest link and the longest route count as well. Chips are
//!   annealed in parallel, each against the last places of the others.
//!
//! An annealed placement is taken only if its spikes cross no more links than in the sequential
//! one.

pub mod anneal;
pub mod link_loads;
pub mod nets;
pub mod ranks;

use std::collections::BTreeMap;

use crate::place::anneal::Search;
use crate::place::nets::Nets;
use nsim_ir::base::id::{CoreId, IdVec};
use nsim_ir::hardware::Target;
use nsim_ir::partition::Partition;
use nsim_ir::placement::{Mesh, Placement, Site};
use nsim_ir::quantised::Quantised;
use nsim_partition::options::Objective;
use nsim_partition::reason::Reason;
use nsim_partition::strategy::box_fan_out::everywhere;
use nsim_partition::strategy::boxes::Boxes;

/// A placement and its name.
pub type NamedPlacement = (Placement, &'static str);

/// The name of the sequential placement in results.
pub const SEQUENTIAL: &str = "sequential";
/// The name of the annealed placement in results.
pub const ANNEALED: &str = "annealed";
/// The name of a placement from a file in results.
pub const SAVED: &str = "saved";

/// Number of pairs of a source and a core that it reaches above which cores are not annealed.
const MOST_MESSAGES: u64 = 20_000_000;

/// Returns a place for each of `cores` cores, in order.
///
/// # Errors
/// A [`Reason`] when they are more than the target has.
pub fn sequential(cores: usize, target: &Target) -> Result<Placement, Reason> {
    let mesh = Mesh::for_target(target);
    let too_many = || Reason::of_mapping(target, 1, cores as u64, BTreeMap::new());
    let sites: Option<IdVec<CoreId, Site>> = (0..cores as u32).map(|core| mesh.site(core)).collect();
    Placement::new(mesh, sites.ok_or_else(too_many)?).map_err(|_| too_many())
}

/// Returns a place for every core, near cores it exchanges messages with, and the placement's name.
///
/// # Errors
/// As [`sequential`].
pub fn place(
    network: &Quantised,
    partition: &Partition,
    target: &Target,
    search: Search<'_>,
) -> Result<NamedPlacement, Reason> {
    let (cores, sources) = (partition.cores(), u64::from(network.channels() + network.compartments()));
    let plain = sequential(cores, target)?;
    // A source reaches at most one core a synapse.
    if network.synapses().min(sources * cores as u64) > MOST_MESSAGES {
        return Ok((plain, SEQUENTIAL));
    }
    place_nets(&Nets::new(network, partition, search.rates), cores, target, search)
}

/// Returns a place for the core of each box, near the cores it exchanges messages with; and the
/// name of the placement.
///
/// # Errors
/// As [`sequential`].
pub fn place_boxes(
    network: &Quantised,
    boxes: &Boxes,
    target: &Target,
    search: Search<'_>,
) -> Result<NamedPlacement, Reason> {
    let (cores, rates) = (boxes.uses.len(), everywhere(network, search.rates));
    let flows = boxes.flows(&rates).map(|(own, to, weight)| (own.map(|own| own.0), weight, to.to_vec()));
    place_nets(&Nets::from_flows(cores, flows), cores, target, search)
}

/// Returns a place for each core, given the nets; and the name of the placement.
///
/// # Errors
/// As [`sequential`].
fn place_nets(nets: &Nets, cores: usize, target: &Target, search: Search<'_>) -> Result<NamedPlacement, Reason> {
    let plain = sequential(cores, target)?;
    let starts = [plain.sites().clone(), hilbert(&plain, nets)];
    let mesh = *plain.mesh();
    let cost = |sites: &IdVec<CoreId, Site>| nets.costs(&mesh, sites, search.objective);
    let best = starts.into_iter().min_by_key(|sites| cost(sites).objective(search.objective));
    let Some(start) = best else { return Ok((plain, SEQUENTIAL)) };
    let before = cost(plain.sites());
    let better = |sites: &IdVec<CoreId, Site>| {
        let after = cost(sites);
        after.multicast <= before.multicast
            && after.objective(search.objective) < before.objective(search.objective)
            && (search.objective != Objective::Latency || after.longest <= before.longest)
    };
    // If single messages save links but trees take more, trees count more in the next attempt.
    let attempts = if cores <= mesh.cores_per_chip as usize { 2 } else { 1 };
    for attempt in 0..attempts {
        let search = Search { tree: search.tree << (2 * attempt), ..search };
        let annealed = anneal::anneal(nets, &mesh, start.clone(), search);
        if better(&annealed)
            && let Ok(placement) = Placement::new(mesh, annealed)
        {
            return Ok((placement, ANNEALED));
        }
    }
    Ok((plain, SEQUENTIAL))
}

/// Cores along a Hilbert curve through the tiles of each chip; by input where only inputs arrive.
fn hilbert(plain: &Placement, nets: &Nets) -> IdVec<CoreId, Site> {
    let mesh = plain.mesh();
    let curve = curve(mesh.width, mesh.height);
    let mut sites = plain.sites().clone();
    let cores: Vec<CoreId> = sites.ids().collect();
    for of_chip in cores.chunks(mesh.cores_per_chip as usize) {
        let chip = plain.site(of_chip[0]).chip;
        // All sites of the chip in the order of the curve.
        let all = curve.iter().flat_map(|&(x, y)| (0..mesh.cores_per_tile).map(move |core| Site { chip, x, y, core }));
        let mut all: Vec<Site> = all.filter(|&site| mesh.number(site).is_some()).collect();
        let mut order = of_chip.to_vec();
        if !of_chip.iter().any(|&core| nets.exchanges(core)) {
            // Only inputs: cores with the most of them take the nearest sites to the corner.
            order.sort_by_key(|&core| std::cmp::Reverse(nets.input(core)));
            all.sort_by_key(|site| (site.x + site.y, site.y, site.core));
        }
        order.into_iter().zip(all).for_each(|(core, site)| sites[core] = site);
    }
    sites
}

/// Tiles of a rectangle along the Hilbert curve of its enclosing square from the corner (0, 0).
fn curve(width: u32, height: u32) -> Vec<(u32, u32)> {
    let side = width.max(height).max(1).next_power_of_two();
    let at = |index: u64| {
        let (mut x, mut y, mut rest, mut s) = (0u32, 0u32, index, 1u32);
        while s < side {
            let rx = (rest / 2 % 2) as u32;
            let ry = ((rest ^ u64::from(rx)) % 2) as u32;
            if ry == 0 {
                if rx == 1 {
                    (x, y) = (s - 1 - x, s - 1 - y);
                }
                (x, y) = (y, x);
            }
            (x, y) = (x + s * rx, y + s * ry);
            (rest, s) = (rest / 4, s * 2);
        }
        (x, y)
    };
    (0..u64::from(side) * u64::from(side)).map(at).filter(|&(x, y)| x < width && y < height).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_testing::{limits, target};

    #[test]
    fn cores_are_placed_in_order_and_more_than_there_are_is_a_reason() {
        let target = target(2, 1, limits());
        let placement = sequential(256, &target).unwrap();
        assert_eq!(placement.site(CoreId(131)), Site { chip: 1, x: 0, y: 0, core: 3 });
        let reason = sequential(257, &target).unwrap_err();
        assert_eq!((reason.need, reason.limit), (257, 256));
        assert!(reason.help.contains("a target of 257 cores"), "{}", reason.help);
    }

    #[test]
    fn the_curve_visits_every_tile_and_neighbours_follow_each_other() {
        for (width, height) in [(8, 4), (4, 4), (2, 1), (1, 1), (5, 3)] {
            let curve = curve(width, height);
            let mut sorted = curve.clone();
            sorted.sort_unstable();
            sorted.dedup();
            assert_eq!((curve.len(), sorted.len()), ((width * height) as usize, (width * height) as usize));
            assert_eq!(curve[0], (0, 0));
            if width == height {
                let near = |pair: &[(u32, u32)]| pair[0].0.abs_diff(pair[1].0) + pair[0].1.abs_diff(pair[1].1) == 1;
                assert!(curve.windows(2).all(near), "{curve:?}");
            }
        }
    }
}
