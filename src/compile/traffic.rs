//! How far messages go, at an assumed rate of spikes.
//!
//! In come a program and a rate for every source; out goes a [`Traffic`]. Each source sends one message to each of its
//! cores. A message goes along its row of tiles first, then along its column (see [`crate::ir::placement`]); an input's
//! message enters at the corner of its target's chip. Links are counted in both directions separately, over the whole
//! board. Ways are added as differences at their ends, so that a message costs the same however long it is. Everything is
//! counted in whole messages before it is multiplied by the rate.

use serde::Serialize;

use crate::base::id::CoreId;
use crate::ir::placement::Mesh;
use crate::ir::program::Program;

/// Spikes of a source in a step, when nothing is known: one in 100 steps.
pub const DEFAULT_RATE: f64 = 0.01;

/// Expected messages in a step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Traffic {
    /// Messages to another core than the source's own; an input's are all of this kind.
    pub cut_spikes_per_step: f64,
    /// Links crossed.
    pub hops_per_step: f64,
    /// Messages over a link, on average over all links of the board.
    pub mean_link_load: f64,
    /// Messages over the busiest link.
    pub max_link_load: f64,
}

/// Loads of the links of one direction: lines of tiles, each with a link between neighbours.
struct Lines {
    /// One more than links of a line, so that a way can end at the last tile.
    length: usize,
    differences: Vec<i64>,
}

impl Lines {
    fn new(lines: u32, tiles: u32) -> Self {
        Lines { length: tiles as usize, differences: vec![0; lines as usize * tiles as usize] }
    }

    /// Adds a way from tile `low` to tile `high` of a line, `low <= high`.
    fn add(&mut self, line: u32, low: u32, high: u32) {
        let start = line as usize * self.length;
        self.differences[start + low as usize] += 1;
        self.differences[start + high as usize] -= 1;
    }

    /// The greatest load and the sum of loads.
    fn loads(&self) -> (u64, u64) {
        let (mut most, mut sum) = (0, 0);
        for line in self.differences.chunks(self.length.max(1)) {
            let mut load = 0i64;
            for difference in line {
                load += difference;
                most = most.max(load as u64);
                sum += load as u64;
            }
        }
        (most, sum)
    }
}

/// The expected traffic of a program in which every source spikes at `rate` spikes a step.
#[must_use]
pub fn traffic(program: &Program, rate: f64) -> Traffic {
    let mesh = program.mesh();
    let (columns, rows) = (mesh.chips_x * mesh.width, mesh.chips_y * mesh.height);
    let (mut east, mut west) = (Lines::new(rows, columns), Lines::new(rows, columns));
    let (mut south, mut north) = (Lines::new(columns, rows), Lines::new(columns, rows));
    let mut add = |(fx, fy): (u32, u32), (tx, ty): (u32, u32)| {
        match fx <= tx {
            true => east.add(fy, fx, tx),
            false => west.add(fy, tx, fx),
        }
        match fy <= ty {
            true => south.add(tx, fy, ty),
            false => north.add(tx, ty, fy),
        }
    };
    let tile = |core: CoreId| mesh.tile(program.cores()[core].site);
    let mut cut = 0u64;
    for (core, image) in program.cores().enumerate() {
        for message in image.axons_out.items() {
            cut += u64::from(message.core != core);
            add(tile(core), tile(message.core));
        }
    }
    for message in program.parts().channels.items() {
        cut += 1;
        add(corner(mesh, tile(message.core)), tile(message.core));
    }
    let loads = [east.loads(), west.loads(), south.loads(), north.loads()];
    let (most, hops) = loads.iter().fold((0, 0), |(most, sum), load| (load.0.max(most), load.1 + sum));
    let (columns, rows) = (u64::from(columns), u64::from(rows));
    let links = 2 * (rows * columns.saturating_sub(1) + columns * rows.saturating_sub(1));
    let mean = if links == 0 { 0.0 } else { hops as f64 / links as f64 };
    Traffic {
        cut_spikes_per_step: cut as f64 * rate,
        hops_per_step: hops as f64 * rate,
        mean_link_load: mean * rate,
        max_link_load: most as f64 * rate,
    }
}

/// The tile at the north-west corner of a tile's chip, where inputs enter.
fn corner(mesh: &Mesh, (x, y): (u32, u32)) -> (u32, u32) {
    (x - x % mesh.width, y - y % mesh.height)
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;
    use crate::compile::testing::{limits, random_network, target};
    use crate::compile::{Options, compile_quantised};
    use crate::desc::target::Limits;

    /// The same by walking every message link by link.
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
        for seed in 0..30 {
            let limits = Limits { compartments: 1, axons_out_per_compartment: 4096, ..limits() };
            let target = target(2, 2, limits);
            let compiled = compile_quantised(random_network(seed), &target, &Options::default()).unwrap();
            let traffic = traffic(&compiled.program, 1.0);
            let (cut, hops, most) = walked(&compiled.program);
            assert_eq!((traffic.cut_spikes_per_step, traffic.hops_per_step), (cut as f64, hops as f64));
            assert_eq!(traffic.max_link_load, most as f64);
            // 16 columns and 8 rows of tiles: 2 (8 x 15 + 16 x 7) links.
            assert_eq!(traffic.mean_link_load, hops as f64 / 464.0);
        }
    }
}
