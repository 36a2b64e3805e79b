//! A mapping as a picture: cores on their chips, what they hold, what links carry, and how full
//! they are.
//!
//! In come a compiled program, its target and the load of every link; out goes one SVG text, the
//! same for the same mapping. Chips without a core in use are left out, row by row and column by
//! column of chips. A core is a square filled from below by the resource that it uses most of, in
//! the colour of the population that most of its compartments belong to; a link between tiles is as
//! thick as it is loaded. Below, a bar a core shows the use of each resource.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use nsim_compile::Mapping;
use nsim_compile::explore::traffic::Links;
use nsim_files::table::count;
use nsim_ir::base::id::{CoreId, PopulationId};
use nsim_ir::base::names::markup;
use nsim_ir::hardware::Target;
use nsim_ir::resource::Resource;

const COLOURS: [&str; 8] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#f0e442", "#7f7f7f"];
const CORE: f64 = 15.0;
const LINK: f64 = 9.0;
const GAP: f64 = 20.0;
const LEFT: f64 = 20.0;
const TOP: f64 = 56.0;
/// Room for the legend, on the right.
const LEGEND: f64 = 185.0;
/// Populations that the legend names.
const MOST_NAMES: usize = 24;
/// Cores that bars are drawn for; more would be thinner than a line.
const MOST_BARS: usize = 512;
const BAR_HEIGHT: f64 = 54.0;
const BARS: [(Resource, &str); 4] = [
    (Resource::Compartments, "compartments"),
    (Resource::AxonsIn, "axons in"),
    (Resource::AxonsOut, "axons out"),
    (Resource::SynapseWords, "synapse words"),
];

/// The picture.
#[must_use]
pub fn svg<P>(compiled: &Mapping<P>, target: &Target, links: &Links) -> String {
    let mesh = compiled.placement.mesh();
    let limits = target.limits();
    let side = (f64::from(mesh.cores_per_tile)).sqrt().ceil().max(1.0);
    let tile = side * CORE + LINK;
    let used: std::collections::BTreeSet<u32> = compiled.placement.sites().iter().map(|site| site.chip).collect();
    let rank = |of: fn(u32, u32) -> u32| -> BTreeMap<u32, usize> {
        let all: std::collections::BTreeSet<u32> = used.iter().map(|&chip| of(chip, mesh.chips_x)).collect();
        all.into_iter().enumerate().map(|(rank, at)| (at, rank)).collect()
    };
    let (columns, rows) = (rank(|chip, wide| chip % wide), rank(|chip, wide| chip / wide));
    let (wide, high) = (f64::from(mesh.width) * tile + GAP, f64::from(mesh.height) * tile + GAP);
    let corner = |chip: u32| {
        let (column, row) = (columns[&(chip % mesh.chips_x)], rows[&(chip / mesh.chips_x)]);
        (LEFT + column as f64 * wide, TOP + row as f64 * high)
    };
    let bars_top = TOP + rows.len() as f64 * high + 8.0;
    let cores = compiled.partition.cores();
    let with_bars = cores <= MOST_BARS;
    let legend = names(compiled);
    let width = (LEFT * 2.0 + columns.len() as f64 * wide).max(560.0) + LEGEND + 5.0;
    let bars_height = if with_bars { BARS.len() as f64 * (BAR_HEIGHT + 22.0) + 20.0 } else { 20.0 };
    let height = (bars_top + bars_height).max(TOP + 130.0 + 18.0 * legend.len() as f64);
    let mut out = String::new();
    let _ = writeln!(
        out,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" \
         viewBox=\"0 0 {width:.0} {height:.0}\" font-family=\"sans-serif\" font-size=\"11\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n\
         <text x=\"{LEFT}\" y=\"22\" font-size=\"14\">{} on {}: {} on {}</text>\n\
         <text x=\"{LEFT}\" y=\"40\" fill=\"#555\">cores are filled by the resource that they use most of; \
         the busiest link carries {:.3} messages a step</text>",
        markup(&compiled.one.parts().name),
        markup(target.name()),
        count(cores as u64, "core"),
        count(u64::from(compiled.placement.chips_used()), "chip"),
        links.busiest()
    );
    // Links first, so that cores lie above them.
    for &chip in &used {
        let (x0, y0) = corner(chip);
        let _ = writeln!(
            out,
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"none\" stroke=\"#999\"/>",
            x0 - 4.0,
            y0 - 4.0,
            wide - GAP + 8.0 - LINK,
            high - GAP + 8.0 - LINK
        );
        let (left, top) = ((chip % mesh.chips_x) * mesh.width, (chip / mesh.chips_x) * mesh.height);
        for y in 0..mesh.height {
            for x in 0..mesh.width {
                let middle = |x: u32, y: u32| {
                    let half = side * CORE / 2.0;
                    (x0 + f64::from(x) * tile + half, y0 + f64::from(y) * tile + half)
                };
                let (ax, ay) = middle(x, y);
                for (load, to) in [
                    (links.east_west(left + x, top + y), (x + 1 < mesh.width).then(|| middle(x + 1, y))),
                    (links.north_south(left + x, top + y), (y + 1 < mesh.height).then(|| middle(x, y + 1))),
                ] {
                    if let Some((bx, by)) = to.filter(|_| load > 0.0) {
                        let (colour, thick) = link(load / links.busiest().max(f64::MIN_POSITIVE));
                        let _ = writeln!(
                            out,
                            "<line x1=\"{ax:.1}\" y1=\"{ay:.1}\" x2=\"{bx:.1}\" y2=\"{by:.1}\" stroke=\"{colour}\" \
                             stroke-width=\"{thick:.2}\"><title>{load:.4} messages a step</title></line>"
                        );
                    }
                }
            }
        }
    }
    for (core, usage) in compiled.partition.usage().enumerate() {
        let site = compiled.placement.site(core);
        let (x0, y0) = corner(site.chip);
        let x = x0 + f64::from(site.x) * tile + f64::from(site.core % side as u32) * CORE;
        let y = y0 + f64::from(site.y) * tile + f64::from(site.core / side as u32) * CORE;
        let (resource, most) = limits
            .against(usage.of)
            .map(|(capacity, need, limit)| (capacity, need as f64 / limit.max(1) as f64))
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .unwrap_or((Resource::Compartments.into(), 0.0));
        let (name, colour) = colour(compiled, core);
        let inner = CORE - 1.0;
        let filled = inner * most.clamp(0.0, 1.0);
        let _ = writeln!(
            out,
            "<g><title>{core}: {} compartments, mostly {}; {:.0} % of {}</title>\
             <rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{inner}\" height=\"{inner}\" fill=\"#eee\" stroke=\"#444\" \
             stroke-width=\"0.5\"/><rect x=\"{x:.1}\" y=\"{:.1}\" width=\"{inner}\" height=\"{filled:.1}\" \
             fill=\"{colour}\"/></g>",
            usage[Resource::Compartments],
            markup(&name),
            100.0 * most,
            resource.name(),
            y + inner - filled,
        );
    }
    let x = width - LEGEND;
    for (index, (name, colour)) in legend.iter().enumerate() {
        let y = TOP + 18.0 * index as f64;
        let (fill, said) = colour.map_or(("none", " (beside others)"), |colour| (colour, ""));
        let _ = writeln!(
            out,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"12\" height=\"12\" fill=\"{fill}\" stroke=\"#444\" \
             stroke-width=\"0.5\"/><text x=\"{:.1}\" y=\"{:.1}\">{}{said}</text>",
            x + 17.0,
            y + 10.0,
            markup(name)
        );
    }
    scales(&mut out, (x, TOP + 18.0 * legend.len() as f64 + 16.0), links.busiest());
    if with_bars {
        bars(&mut out, compiled, target, bars_top, width - LEGEND - 25.0);
    }
    out += "</svg>\n";
    out
}

/// How full a core is drawn, and how thick a link.
fn scales(out: &mut String, (x, top): (f64, f64), busiest: f64) {
    let _ = writeln!(out, "<text x=\"{x:.1}\" y=\"{top:.1}\" fill=\"#555\">of its fullest resource</text>");
    for (index, percent) in [25, 50, 100].into_iter().enumerate() {
        let (left, y) = (x + 46.0 * index as f64, top + 6.0);
        let (inner, filled) = (CORE - 1.0, (CORE - 1.0) * f64::from(percent) / 100.0);
        let _ = writeln!(
            out,
            "<rect x=\"{left:.1}\" y=\"{y:.1}\" width=\"{inner}\" height=\"{inner}\" fill=\"#eee\" stroke=\"#444\" \
             stroke-width=\"0.5\"/><rect x=\"{left:.1}\" y=\"{:.1}\" width=\"{inner}\" height=\"{filled:.1}\" \
             fill=\"#666\"/><text x=\"{:.1}\" y=\"{:.1}\" font-size=\"9\">{percent} %</text>",
            y + inner - filled,
            left + inner + 3.0,
            y + 11.0
        );
    }
    if busiest <= 0.0 {
        return;
    }
    let top = top + 42.0;
    let _ = writeln!(out, "<text x=\"{x:.1}\" y=\"{top:.1}\" fill=\"#555\">messages a step on a link</text>");
    for (index, part) in [0.1, 0.5, 1.0].into_iter().enumerate() {
        let y = top + 13.0 + 15.0 * index as f64;
        let (colour, thick) = link(part);
        let _ = writeln!(
            out,
            "<path d=\"M{x:.1} {y:.1}h24\" stroke=\"{colour}\" stroke-width=\"{thick:.2}\"/><text x=\"{:.1}\" \
             y=\"{:.1}\">{}</text>",
            x + 30.0,
            y + 4.0,
            three_digits(part * busiest)
        );
    }
}

/// Colour and thickness of a link that carries this part of what the busiest does.
fn link(part: f64) -> (&'static str, f64) {
    (if part > 0.66 { "#b2182b" } else { "#777" }, 0.4 + 5.0 * part)
}

fn three_digits(number: f64) -> String {
    let decimals = (2.0 - number.abs().max(1e-9).log10().floor()).clamp(0.0, 6.0) as usize;
    format!("{number:.decimals$}")
}

/// A bar a core for each resource.
fn bars<P>(out: &mut String, compiled: &Mapping<P>, target: &Target, top: f64, width: f64) {
    let each = (width - LEFT) / compiled.partition.cores().max(1) as f64;
    for (row, (resource, name)) in BARS.iter().enumerate() {
        let y = top + row as f64 * (BAR_HEIGHT + 22.0) + 16.0;
        let _ = writeln!(
            out,
            "<text x=\"{LEFT}\" y=\"{:.1}\">{name}, of what a core has</text>\n<line x1=\"{LEFT}\" y1=\"{y:.1}\" \
             x2=\"{width:.1}\" y2=\"{y:.1}\" stroke=\"#bbb\" stroke-dasharray=\"3 3\"/>\n<line x1=\"{LEFT}\" \
             y1=\"{:.1}\" x2=\"{width:.1}\" y2=\"{:.1}\" stroke=\"#444\"/>",
            y - 4.0,
            y + BAR_HEIGHT,
            y + BAR_HEIGHT
        );
        for (core, usage) in compiled.partition.usage().enumerate() {
            let (need, limit) = (usage[*resource], target.limits()[*resource]);
            let tall = BAR_HEIGHT * (need as f64 / f64::from(limit.max(1))).clamp(0.0, 1.0);
            let _ = writeln!(
                out,
                "<rect x=\"{:.2}\" y=\"{:.1}\" width=\"{:.2}\" height=\"{tall:.1}\" fill=\"{}\"><title>{core}: {need} \
                 of \
                 {limit}</title></rect>",
                LEFT + f64::from(core.0) * each,
                y + BAR_HEIGHT - tall,
                (each * 0.85).min(24.0),
                colour(compiled, core).1
            );
        }
    }
}

/// A population by the name that all its copies have, and its colour.
fn colour<P>(compiled: &Mapping<P>, core: CoreId) -> (String, &'static str) {
    let mut counts: BTreeMap<u32, usize> = BTreeMap::new();
    let per_copy = compiled.one.populations().len() as u32;
    for &id in &compiled.partition.members()[core] {
        let (population, _) = compiled.quantised.population_of(id);
        *counts.entry(population.0 % per_copy.max(1)).or_default() += 1;
    }
    let most = counts.into_iter().max_by_key(|&(population, count)| (count, std::cmp::Reverse(population)));
    let population = most.map_or(0, |(population, _)| population);
    let name = compiled.one.populations().get(PopulationId(population)).map_or("", |p| p.name.as_str());
    (name.to_string(), COLOURS[population as usize % COLOURS.len()])
}

/// Populations with compartments and their colours; of those that no core holds most of, without.
fn names<P>(compiled: &Mapping<P>) -> Vec<(String, Option<&'static str>)> {
    let mut known = std::collections::BTreeSet::new();
    for core in compiled.partition.usage().ids() {
        known.insert(colour(compiled, core));
    }
    let held = compiled.one.populations().iter().filter(|population| population.first_compartment().is_some());
    held.take(MOST_NAMES)
        .map(|population| {
            let found = known.iter().find(|(name, _)| *name == population.name);
            (population.name.clone(), found.map(|(_, colour)| *colour))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_compile::{CopyPlacement, DEFAULT_RATE, Form, Options, explore};
    use nsim_ir::firing_rates::Rates;
    use nsim_testing::{limits, slip, target};

    #[test]
    fn every_core_and_population_is_drawn_once() {
        let board = target(2, 1, limits());
        let options = Options { copies: 40, placement: CopyPlacement::Packed, ..Options::default() };
        let rates = Rates::assumed(DEFAULT_RATE);
        let compiled = explore::map(slip(3150).into(), &board, &options, &rates, Form::Written).unwrap();
        let picture = svg(&compiled, &board, &compiled.links());
        assert_eq!(picture.matches("<g><title>core").count(), 40);
        // 40 cores are ten tiles; every tile but the corner's has inputs come over a link.
        assert!(picture.matches("<line x1").count() > 9, "{picture}");
        assert!(picture.contains("test on test-board: 40 cores on 1 chip<") && picture.contains(">touch<"));
        assert!(picture.starts_with("<svg") && picture.ends_with("</svg>\n") && !picture.contains("NaN"));
    }
}
