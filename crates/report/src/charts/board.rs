//! A mapping as a picture: cores on their chips, their populations and use, loads of links.
//!
//! Input: a compiled program, its target and the load of every link. Output: one SVG text, the same
//! for the same mapping. Chips without a core in use are omitted, row by row and column by column
//! of chips. A core is a square, filled from below by its fullest resource, in the colour of the
//! population with most of its compartments. The width of a link between tiles shows its load.
//! Below, a bar a core shows the use of each resource.

use std::collections::{BTreeMap, BTreeSet};

use super::draw::{COLOURS, GREY, SMALL, Sheet, filled, stroked};
use nsim_compile::Mapping;
use nsim_compile::explore::traffic::Links;
use nsim_files::table::{count, three};
use nsim_ir::base::id::{CoreId, Id, PopulationId};
use nsim_ir::hardware::Target;
use nsim_ir::placement::Mesh;
use nsim_ir::resource::Resource;

const CORE: f64 = 15.0;
const LINK: f64 = 9.0;
const GAP: f64 = 20.0;
const LEFT: f64 = 20.0;
const TOP: f64 = 56.0;
/// Room for the legend, on the right.
const LEGEND: f64 = 185.0;
/// Greatest number of populations in the legend.
const MOST_NAMES: usize = 24;
/// Greatest number of cores with bars; more would be thinner than a line.
const MOST_BARS: usize = 512;
const BAR_HEIGHT: f64 = 54.0;
const BARS: [(Resource, &str); 4] = [
    (Resource::Compartments, "compartments"),
    (Resource::AxonsIn, "axons in"),
    (Resource::AxonsOut, "axons out"),
    (Resource::SynapseWords, "synapse words"),
];

/// The picture.
pub fn svg(compiled: &Mapping, target: &Target, links: &Links) -> String {
    let layout = Layout::new(compiled);
    let bars_top = TOP + layout.rows.len() as f64 * layout.chip_height() + 8.0;
    let cores = compiled.partition.cores();
    let populations = compiled.one.populations();
    let with_compartments = || populations.enumerate().filter(|(_, one)| one.first_compartment().is_some());
    let names = with_compartments().count().min(MOST_NAMES);
    let width = (LEFT * 2.0 + layout.columns.len() as f64 * layout.chip_width()).max(560.0) + LEGEND + 5.0;
    let bars_height = if cores <= MOST_BARS { BARS.len() as f64 * (BAR_HEIGHT + 22.0) + 20.0 } else { 20.0 };
    let height = (bars_top + bars_height).max(TOP + 130.0 + 18.0 * names as f64);
    let (of_cores, of_chips) = (count(cores as u64, "core"), count(u64::from(compiled.placement.chips_used()), "chip"));
    let title = format!("{} on {}: {of_cores} on {of_chips}", compiled.one.parts().name, target.name());
    let mut sheet = Sheet::new((width, height), LEFT, &title);
    let busiest = links.busiest();
    let words = "fill: use of a core's fullest resource; the busiest link carries";
    sheet.text(LEFT, 40.0, GREY, &format!("{words} {busiest:.3} messages a step"));
    // Links first, so that cores lie above them.
    layout.used.iter().for_each(|&chip| draw_chip(&mut sheet, &layout, chip, links, busiest));
    let shown = draw_cores(&mut sheet, &layout, compiled, target);
    let x = width - LEGEND;
    for (index, (id, population)) in with_compartments().take(MOST_NAMES).enumerate() {
        let y = TOP + 18.0 * index as f64;
        let (full, note) = if shown.contains(&id) { (1.0, "") } else { (0.0, " (with others)") };
        square(&mut sheet, x, y, full, colour(id));
        sheet.text(x + 19.0, y + 11.0, "", &format!("{}{note}", population.name));
    }
    scales(&mut sheet, x, TOP + 18.0 * names as f64 + 16.0, busiest);
    if cores <= MOST_BARS {
        bars(&mut sheet, compiled, target, bars_top, width - LEGEND - 25.0);
    }
    sheet.svg()
}

/// Positions of chips and cores on the sheet.
struct Layout {
    mesh: Mesh,
    /// Chips with cores in use.
    used: BTreeSet<u32>,
    /// Rank of each column, and of each row, of the board that has such chips.
    columns: BTreeMap<u32, usize>,
    rows: BTreeMap<u32, usize>,
    /// Cores along a side of a tile.
    side: f64,
    /// Distance of neighbouring tiles.
    tile: f64,
}

impl Layout {
    fn new(compiled: &Mapping) -> Self {
        let mesh = *compiled.placement.mesh();
        let side = f64::from(mesh.cores_per_tile).sqrt().ceil().max(1.0);
        let used: BTreeSet<u32> = compiled.placement.sites().iter().map(|site| site.chip).collect();
        let columns = ranks(used.iter().map(|chip| chip % mesh.chips_x));
        let rows = ranks(used.iter().map(|chip| chip / mesh.chips_x));
        Layout { mesh, used, columns, rows, side, tile: side * CORE + LINK }
    }

    fn chip_width(&self) -> f64 {
        f64::from(self.mesh.width) * self.tile + GAP
    }

    fn chip_height(&self) -> f64 {
        f64::from(self.mesh.height) * self.tile + GAP
    }

    /// The corner of a tile of a chip.
    fn tile(&self, chip: u32, x: u32, y: u32) -> (f64, f64) {
        let (column, row) = (self.columns[&(chip % self.mesh.chips_x)], self.rows[&(chip / self.mesh.chips_x)]);
        let (left, top) = (LEFT + column as f64 * self.chip_width(), TOP + row as f64 * self.chip_height());
        (left + f64::from(x) * self.tile, top + f64::from(y) * self.tile)
    }

    fn middle(&self, chip: u32, x: u32, y: u32) -> (f64, f64) {
        let ((left, top), half) = (self.tile(chip, x, y), self.side * CORE / 2.0);
        (left + half, top + half)
    }
}

/// The rank of each distinct number.
fn ranks(numbers: impl Iterator<Item = u32>) -> BTreeMap<u32, usize> {
    let distinct: BTreeSet<u32> = numbers.collect();
    distinct.into_iter().enumerate().map(|(rank, number)| (number, rank)).collect()
}

fn draw_chip(sheet: &mut Sheet, layout: &Layout, chip: u32, links: &Links, busiest: f64) {
    let (mesh, (x0, y0)) = (&layout.mesh, layout.tile(chip, 0, 0));
    let (width, height) = (layout.chip_width(), layout.chip_height());
    let size = [x0 - 4.0, y0 - 4.0, width - GAP + 8.0 - LINK, height - GAP + 8.0 - LINK];
    sheet.rect(size, &stroked("#999", 1.0, ""));
    let (left, top) = ((chip % mesh.chips_x) * mesh.width, (chip / mesh.chips_x) * mesh.height);
    for (x, y) in (0..mesh.height).flat_map(|y| (0..mesh.width).map(move |x| (x, y))) {
        let (from_x, from_y) = layout.middle(chip, x, y);
        for (load, to) in [
            (links.east_west(left + x, top + y), (x + 1 < mesh.width).then(|| layout.middle(chip, x + 1, y))),
            (links.north_south(left + x, top + y), (y + 1 < mesh.height).then(|| layout.middle(chip, x, y + 1))),
        ] {
            if let Some((to_x, to_y)) = to.filter(|_| load > 0.0) {
                sheet.titled(&format!("{load:.4} messages a step"), |sheet| {
                    sheet.line([from_x, from_y, to_x, to_y], &link(load / busiest.max(f64::MIN_POSITIVE)));
                });
            }
        }
    }
}

/// All cores; returns the populations that have a core in their colour.
fn draw_cores(sheet: &mut Sheet, layout: &Layout, compiled: &Mapping, target: &Target) -> BTreeSet<PopulationId> {
    let mut shown = BTreeSet::new();
    for (core, usage) in compiled.partition.usage().enumerate() {
        let site = compiled.placement.site(core);
        let (left, top) = layout.tile(site.chip, site.x, site.y);
        let x = left + f64::from(site.core % layout.side as u32) * CORE;
        let y = top + f64::from(site.core / layout.side as u32) * CORE;
        let parts = target.limits().against(usage.of);
        let (resource, most) = parts
            .map(|(capacity, need, limit)| (capacity, need as f64 / limit.max(1) as f64))
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .unwrap_or((Resource::Compartments.into(), 0.0));
        let population = mostly(compiled, core);
        shown.insert(population);
        let name = compiled.one.populations().get(population).map_or("", |population| &population.name);
        let compartments = usage[Resource::Compartments];
        let resource = resource.name();
        let words = format!("{core}: {compartments} compartments, mostly {name}; {:.0} % of {resource}", 100.0 * most);
        sheet.titled(&words, |sheet| square(sheet, x, y, most, colour(population)));
    }
    shown
}

/// A core, filled from below.
fn square(sheet: &mut Sheet, x: f64, y: f64, full: f64, colour: &str) {
    let (inner, filled_to) = (CORE - 1.0, (CORE - 1.0) * full.clamp(0.0, 1.0));
    sheet.rect([x, y, inner, inner], r##"fill="#eee" stroke="#444" stroke-width="0.5""##);
    sheet.rect([x, y + inner - filled_to, inner, filled_to], &filled(colour));
}

/// Legend of the fill of cores and the width of links.
fn scales(sheet: &mut Sheet, x: f64, top: f64, busiest: f64) {
    sheet.text(x, top, GREY, "use of the fullest resource");
    for (index, percent) in [25, 50, 100].into_iter().enumerate() {
        let (left, y) = (x + 46.0 * index as f64, top + 6.0);
        square(sheet, left, y, f64::from(percent) / 100.0, "#666");
        sheet.text(left + CORE + 2.0, y + 11.0, SMALL, &format!("{percent} %"));
    }
    if busiest <= 0.0 {
        return;
    }
    sheet.text(x, top + 42.0, GREY, "messages a step on a link");
    for (index, part) in [0.1, 0.5, 1.0].into_iter().enumerate() {
        let y = top + 55.0 + 15.0 * index as f64;
        sheet.line([x, y, x + 24.0, y], &link(part));
        sheet.text(x + 30.0, y + 4.0, "", &three(part * busiest));
    }
}

/// Style of a link by its load, as a fraction of the busiest one's.
fn link(part: f64) -> String {
    stroked(if part > 0.66 { "#b2182b" } else { "#777" }, 0.4 + 5.0 * part, "")
}

/// A bar a core for each resource.
fn bars(sheet: &mut Sheet, compiled: &Mapping, target: &Target, top: f64, width: f64) {
    let each = (width - LEFT) / compiled.partition.cores().max(1) as f64;
    for (row, (resource, name)) in BARS.iter().enumerate() {
        let y = top + row as f64 * (BAR_HEIGHT + 22.0) + 16.0;
        sheet.text(LEFT, y - 4.0, "", &format!("{name}, share of a core's limit"));
        sheet.line([LEFT, y, width, y], &stroked("#bbb", 1.0, "3 3"));
        sheet.line([LEFT, y + BAR_HEIGHT, width, y + BAR_HEIGHT], &stroked("#444", 1.0, ""));
        for (core, usage) in compiled.partition.usage().enumerate() {
            let (need, limit) = (usage[*resource], target.limits()[*resource]);
            let tall = BAR_HEIGHT * (need as f64 / f64::from(limit.max(1))).clamp(0.0, 1.0);
            let size = [LEFT + f64::from(core.0) * each, y + BAR_HEIGHT - tall, (each * 0.85).min(24.0), tall];
            let colour = colour(mostly(compiled, core));
            sheet.titled(&format!("{core}: {need} of {limit}"), |sheet| sheet.rect(size, &filled(colour)));
        }
    }
}

/// The population of one copy with most of a core's compartments.
pub(crate) fn mostly(compiled: &Mapping, core: CoreId) -> PopulationId {
    let per_copy = compiled.one.populations().len().max(1) as u32;
    let mut counts: BTreeMap<u32, usize> = BTreeMap::new();
    for &id in compiled.partition.members()[core].iter() {
        let (population, _) = compiled.quantised.population_of(id);
        *counts.entry(population.0 % per_copy).or_default() += 1;
    }
    let most = counts.into_iter().max_by_key(|&(population, count)| (count, std::cmp::Reverse(population)));
    PopulationId(most.map_or(0, |(population, _)| population))
}

fn colour(population: PopulationId) -> &'static str {
    COLOURS[population.index() % COLOURS.len()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_compile::{CopyPlacement, DEFAULT_RATE, Options, explore};
    use nsim_ir::firing_rates::Rates;
    use nsim_testing::{limits, slip, target};

    #[test]
    fn every_core_and_population_is_drawn_once() {
        let board = target(2, 1, limits());
        let options = Options { copies: 40, placement: CopyPlacement::Packed, ..Options::default() };
        let rates = Rates::assumed(DEFAULT_RATE);
        let compiled = explore::map(slip(3150).into(), &board, &options, &rates).unwrap();
        let picture = svg(&compiled, &board, &compiled.links());
        assert_eq!(picture.matches(" compartments, mostly ").count(), 40);
        // 40 cores are ten tiles; every tile but the corner's has inputs come over a link.
        assert!(picture.matches(" messages a step</title><line").count() >= 9, "{picture}");
        assert!(picture.contains("test on test-board: 40 cores on 1 chip<") && picture.contains(">touch<"));
        assert!(picture.starts_with("<svg") && picture.ends_with("</svg>\n") && !picture.contains("NaN"));
    }
}
