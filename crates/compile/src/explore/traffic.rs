//! Distances that messages travel, at given firing rates.
//!
//! Input: a program and a rate for every source. Output: a [`Traffic`]. Each source sends one
//! message to each of its cores. A message goes along its row of tiles first, then along its column
//! (see [`nsim_ir::placement`]); an input's message enters at the corner of its target's chip.
//! Links are counted in both directions separately, over the whole board. Routes are added as
//! differences at their ends, so that the work does not depend on their length. A multicast spike,
//! copied where routes part, crosses each link once for all its messages. Everything is counted in
//! whole numbers ([`Rates`]), then divided by the number of steps.

use std::ops::Range;

use rayon::prelude::*;
use serde::Serialize;

use crate::place::link_loads::LinkLoads;
use crate::place::nets::Columns;
use nsim_ir::base::id::{CoreId, Id};
use nsim_ir::firing_rates::{RATE_STEPS, Rates};
use nsim_ir::placement::{Mesh, Placement, Site};
use nsim_ir::program::{AxonTarget, Program};

/// Expected messages in a step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Traffic {
    /// Messages to another core than the source's own; all messages of inputs are included.
    pub cut_spikes_per_step: f64,
    /// Links crossed, each message counted separately.
    pub hops_per_step: f64,
    /// Links crossed when a spike is copied where the routes of its messages part.
    pub hops_multicast_per_step: f64,
    /// Messages over a link, on average over all links of the board.
    pub mean_link_load: f64,
    /// Messages over the busiest link.
    pub max_link_load: f64,
    /// Messages over the busiest link between two chips, which takes longer for each.
    pub max_chip_link_load: f64,
}

/// Messages over each link in a step, both directions together.
#[derive(Debug, Clone)]
pub struct Links {
    columns: usize,
    rows: usize,
    /// From each tile eastwards, row by row.
    east_west: Vec<f64>,
    /// From each tile southwards, column by column.
    north_south: Vec<f64>,
}

impl Links {
    /// Messages over the link from a tile of the board to its eastern neighbour and back.
    pub fn east_west(&self, x: u32, y: u32) -> f64 {
        self.east_west.get(y as usize * self.columns + x as usize).copied().unwrap_or(0.0)
    }

    /// Messages over the link from a tile of the board to its southern neighbour and back.
    pub fn north_south(&self, x: u32, y: u32) -> f64 {
        self.north_south.get(x as usize * self.rows + y as usize).copied().unwrap_or(0.0)
    }

    /// Messages over the busiest link.
    pub fn busiest(&self) -> f64 {
        self.east_west.iter().chain(&self.north_south).copied().fold(0.0, f64::max)
    }
}

/// The totals of messages: loads of links, messages between cores, links of multicast trees.
pub struct Counts<'a> {
    mesh: &'a Mesh,
    loads: LinkLoads,
    cut: u64,
    multicast: u64,
    tree: Columns,
    of_chip: Vec<(u32, (u32, u32))>,
}

/// The totals of flows. A flow has its sending core (none for inputs), the cores reached, and its
/// spikes in the steps that rates count.
pub fn of_flows<T: Iterator<Item = CoreId> + Clone>(
    placement: &Placement,
    flows: impl Iterator<Item = (Option<CoreId>, T, u64)>,
) -> Counts<'_> {
    let mut counts = Counts::new(placement.mesh());
    let site = |core: CoreId| placement.site(core);
    flows.for_each(|(source, to, weight)| match source {
        Some(core) => counts.spikes(core, site(core), to.map(|to| (to, site(to))), weight),
        None => counts.inputs(to.map(site), weight),
    });
    counts
}

/// Number of parts in which a program's cores, and its channels, are counted; fixed, so that
/// nothing depends on threads.
const PARTS: usize = 8;

/// Ranges of nearly equal size over `items` items, at most [`PARTS`].
pub(crate) fn parts(items: usize) -> Vec<Range<usize>> {
    let size = items.div_ceil(PARTS).max(1);
    (0..items).step_by(size).map(|from| from..(from + size).min(items)).collect()
}

/// The totals of a program's messages.
pub fn of_program<'a>(program: &'a Program, rates: &Rates) -> Counts<'a> {
    let cores = program.cores().as_slice();
    let sites: Vec<Site> = cores.iter().map(|image| image.site).collect();
    let site = |message: AxonTarget| sites[message.core.index()];
    let of_cores = |part: Range<usize>| {
        let mut counts = Counts::new(program.mesh());
        for (core, image) in part.clone().zip(&cores[part]) {
            for (slot, messages) in image.axons_out.iter().enumerate() {
                let weight = rates.rate_of(program.channels() + image.ids[slot].0);
                counts.spikes(CoreId::new(core), image.site, messages.map(|m| (m.core, site(m))), weight);
            }
        }
        counts
    };
    let of_channels = |part: Range<usize>| {
        let mut counts = Counts::new(program.mesh());
        for channel in part {
            let messages = program.messages(channel as u32);
            counts.inputs(messages.map(site), rates.rate_of(channel as u32));
        }
        counts
    };
    let channels = parts(program.channels() as usize).into_par_iter().map(of_channels);
    let all = parts(cores.len()).into_par_iter().map(of_cores).chain(channels);
    all.reduce(|| Counts::new(program.mesh()), |a, b| a.together(&b))
}

impl<'a> Counts<'a> {
    fn new(mesh: &'a Mesh) -> Self {
        let (loads, tree) = (LinkLoads::new(mesh), Columns::new(mesh));
        Counts { mesh, loads, cut: 0, multicast: 0, tree, of_chip: Vec::new() }
    }

    /// Sum of both.
    fn together(mut self, other: &Self) -> Self {
        self.loads.merge(&other.loads);
        self.cut += other.cut;
        self.multicast += other.multicast;
        self
    }

    /// Adds spikes of a core's compartments.
    fn spikes(&mut self, core: CoreId, site: Site, to: impl Iterator<Item = (CoreId, Site)> + Clone, weight: u64) {
        let (mesh, from) = (self.mesh, self.mesh.tile(site));
        for (other, site) in to.clone() {
            self.cut += u64::from(other != core) * weight;
            self.loads.add(from, mesh.tile(site), weight as i64);
        }
        self.multicast += weight * self.tree.links(from, to.map(|(_, site)| mesh.tile(site))).0;
    }

    /// Adds spikes of input channels, which enter each chip at its corner.
    fn inputs(&mut self, to: impl Iterator<Item = Site>, weight: u64) {
        let mesh = self.mesh;
        // Chips of a list are not in order when chips were exchanged.
        let mut of_chip = std::mem::take(&mut self.of_chip);
        of_chip.clear();
        of_chip.extend(to.map(|site| (site.chip, mesh.tile(site))));
        of_chip.sort_unstable();
        self.cut += weight * of_chip.len() as u64;
        for &(_, tile) in &of_chip {
            self.loads.add(corner(mesh, tile), tile, weight as i64);
        }
        for same in of_chip.chunk_by(|a, b| a.0 == b.0) {
            self.multicast += weight * self.tree.links(corner(mesh, same[0].1), same.iter().map(|&(_, tile)| tile)).0;
        }
        self.of_chip = of_chip;
    }

    /// The expected messages of a step.
    pub fn traffic(&self) -> Traffic {
        let (columns, rows) = (self.mesh.chips_x * self.mesh.width, self.mesh.chips_y * self.mesh.height);
        let [most, between, hops] = self.loads.greatest(self.mesh);
        let (columns, rows) = (u64::from(columns), u64::from(rows));
        let links = 2 * (rows * columns.saturating_sub(1) + columns * rows.saturating_sub(1));
        let mean = if links == 0 { 0.0 } else { hops as f64 / RATE_STEPS / links as f64 };
        Traffic {
            cut_spikes_per_step: self.cut as f64 / RATE_STEPS,
            hops_per_step: hops as f64 / RATE_STEPS,
            hops_multicast_per_step: self.multicast as f64 / RATE_STEPS,
            mean_link_load: mean,
            max_link_load: most as f64 / RATE_STEPS,
            max_chip_link_load: between as f64 / RATE_STEPS,
        }
    }

    /// The expected messages over each link in a step.
    pub fn links(&self) -> Links {
        let [east_west, north_south] = self.loads.both_directions();
        let in_a_step = |loads: Vec<u64>| loads.into_iter().map(|load| load as f64 / RATE_STEPS).collect();
        Links {
            columns: (self.mesh.chips_x * self.mesh.width) as usize,
            rows: (self.mesh.chips_y * self.mesh.height) as usize,
            east_west: in_a_step(east_west),
            north_south: in_a_step(north_south),
        }
    }
}

/// The tile at the north-west corner of a tile's chip, where inputs enter.
fn corner(mesh: &Mesh, tile: (u32, u32)) -> (u32, u32) {
    (tile.0 - tile.0 % mesh.width, tile.1 - tile.1 % mesh.height)
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;
    use crate::{Options, compile};
    use nsim_ir::resource::Resource;
    use nsim_testing::{limits, random_network, target};

    /// The totals by walking every message link by link.
    fn walked(program: &Program) -> (u64, u64, u64) {
        let mesh = program.mesh();
        type Tile = (u32, u32);
        let mut links: HashMap<(Tile, Tile), u64> = HashMap::new();
        let (mut cut, mut hops) = (0, 0);
        let mut walk = |mut at: (u32, u32), to: (u32, u32)| {
            while at != to {
                let next = if at.0 != to.0 {
                    (if at.0 < to.0 { at.0 + 1 } else { at.0 - 1 }, at.1)
                } else {
                    (at.0, if at.1 < to.1 { at.1 + 1 } else { at.1 - 1 })
                };
                *links.entry((at, next)).or_default() += 1;
                hops += 1;
                at = next;
            }
        };
        for (core, image) in program.cores().enumerate() {
            for message in image.axons_out.items() {
                cut += u64::from(core != message.core);
                walk(mesh.tile(image.site), mesh.tile(program.cores()[message.core].site));
            }
        }
        for message in program.parts().channels.items() {
            let site = program.cores()[message.core].site;
            cut += 1;
            assert_eq!(mesh.route_from_corner(site).links(), site.x + site.y);
            walk(corner(mesh, mesh.tile(site)), mesh.tile(site));
        }
        (cut, hops, links.values().copied().max().unwrap_or(0))
    }

    #[test]
    fn differences_add_up_to_the_ways_walked() {
        for seed in 0..30u64 {
            let limits = limits().with(Resource::Compartments, 1).with(Resource::AxonsOutPerCompartment, 4096);
            let target = target(2, 2, limits);
            // Only the sites of cores matter; searching for them takes most of the time.
            let options = Options { place: seed.is_multiple_of(6), ..Options::default() };
            let compiled = compile(random_network(seed), &target, &options).unwrap();
            let traffic = of_program(&compiled.program, &Rates::assumed(1.0)).traffic();
            let (cut, hops, most) = walked(&compiled.program);
            assert_eq!((traffic.cut_spikes_per_step, traffic.hops_per_step), (cut as f64, hops as f64));
            assert_eq!(traffic.max_link_load, most as f64);
            // 16 columns and 8 rows of tiles: 2 (8 x 15 + 16 x 7) links.
            assert_eq!(traffic.mean_link_load, hops as f64 / 464.0);
        }
    }
}
