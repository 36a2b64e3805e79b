//! A sample step by step as pictures: spikes of populations, potentials of compartments.
//!
//! Input: a [`Timeline`] of a network. Output: one SVG text each. What a timeline left out is said
//! in the picture.

use std::fmt::Write as _;

use super::plot::{Axis, BOTTOM, COLOURS, HEIGHT, LEFT, RIGHT, Scale, TOP, WIDTH, frame, text_at};
use super::raster::{Panel, Raster};
use nsim_files::table::count;
use nsim_ir::base::id::PopulationId;
use nsim_ir::quantised::Quantised;
use nsim_session::timeline::Timeline;

/// Points of a curve; a longer one shows the largest potential of each group of steps.
const MOST_POINTS: usize = 1_500;
/// Between two panels.
const GAP: f64 = 10.0;
/// A panel is as high as so many times the lowest at most.
const MOST_SHARE: f64 = 3.0;

/// A compartment whose potential is drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct Traced {
    /// Population and index.
    pub name: String,
    /// Its threshold.
    pub threshold: f64,
}

/// Panels of a raster; more would be thinner than their names.
const MOST_PANELS: usize = 24;

/// Spikes of the first of these populations, each in a panel of its own.
#[must_use]
pub fn raster(title: &str, network: &Quantised, timeline: &Timeline, shown: &[PopulationId]) -> String {
    let panel = |&id: &PopulationId| {
        let raster = &timeline.rasters[id.0 as usize];
        let name = &network.populations()[id].name;
        let mut kind = count(raster.spikes.len() as u64, "spike");
        if raster.every > 1 {
            kind = format!("{kind}, 1 unit in {}", raster.every);
        }
        if raster.cut {
            kind += ", no more kept";
        }
        Panel {
            label: name.clone(),
            channels: raster.units,
            share: f64::from(raster.units).sqrt().clamp(4.0, 4.0 * MOST_SHARE),
            kinds: vec![(kind, raster.spikes.clone())],
        }
    };
    let (steps, all) = timeline.steps;
    let first = if steps < all { format!(" (first {steps} of {all} steps)") } else { String::new() };
    let drawn = &shown[..shown.len().min(MOST_PANELS)];
    let cut = if drawn.len() < shown.len() {
        format!(", {MOST_PANELS} of {} populations", shown.len())
    } else {
        String::new()
    };
    Raster {
        title: format!("{title}{first}{cut}"),
        steps,
        timestep_ms: network.parts().timestep_ms,
        onset_ms: None,
        panels: drawn.iter().map(panel).collect(),
    }
    .svg()
}

/// Potentials over time in parts of their thresholds, a panel for each compartment; the timeline
/// holds those of `traced`, in this order.
#[must_use]
pub fn voltage(title: &str, network: &Quantised, timeline: &Timeline, traced: &[Traced]) -> String {
    let timestep_ms = network.parts().timestep_ms;
    let steps = timeline.steps.0 as usize;
    let group = steps.div_ceil(MOST_POINTS).max(1);
    let reduced = if group > 1 { format!(", the largest of {group} steps each") } else { String::new() };
    let mut out = frame(title, "time into the sample, ms", &format!("potential (dashed: threshold){reduced}"));
    let end_ms = steps as f64 * timestep_ms;
    let across = Scale::new(&Axis::linear(""), [0.0, end_ms].into_iter(), LEFT, WIDTH - RIGHT);
    let at = |ms: f64| across.place(ms).unwrap_or(LEFT);
    let each = (HEIGHT - BOTTOM - TOP) / traced.len().max(1) as f64;
    for (row, (of, trace)) in traced.iter().zip(&timeline.potentials).enumerate() {
        let (top, bottom) = (TOP + each * row as f64, TOP + each * (row as f64 + 1.0) - GAP);
        let largest = trace.chunks(group).map(|part| part.iter().copied().max().unwrap_or(0));
        let parts: Vec<f64> = largest.map(|v| f64::from(v) / of.threshold).collect();
        let (low, high) = parts.iter().fold((0.0, 1.0), |(low, high): (f64, f64), &v| (low.min(v), high.max(v)));
        let up = |v: f64| bottom - (v - low) / (high - low) * (bottom - top);
        _ = writeln!(
            out,
            r##"<rect x="{LEFT}" y="{top:.1}" width="{:.1}" height="{:.1}" fill="none" stroke="#bbb"/>"##,
            at(end_ms) - LEFT,
            bottom - top
        );
        for (level, dash) in [(0.0, ""), (1.0, "4 3")] {
            _ = writeln!(
                out,
                r##"<path d="M{LEFT} {:.1}H{:.1}" stroke="#888" stroke-width="0.8" stroke-dasharray="{dash}" fill="none"/>"##,
                up(level),
                at(end_ms)
            );
            text_at(&mut out, LEFT - 6.0, up(level) + 4.0, "end", &level.to_string());
        }
        // A point stands at the end of its steps.
        let points = parts.iter().enumerate().map(|(point, &v)| {
            let ms = ((point + 1) * group).min(steps) as f64 * timestep_ms;
            format!("{:.1},{:.1}", at(ms), up(v))
        });
        let colour = COLOURS[row % COLOURS.len()];
        let points = points.collect::<Vec<_>>().join(" ");
        _ = writeln!(out, r#"<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.3"/>"#);
        text_at(&mut out, WIDTH - RIGHT + 10.0, (top + bottom) / 2.0 + 4.0, "start", &of.name);
    }
    for (x, label) in across.ticks().into_iter().filter(|(x, _)| *x <= at(end_ms) + 0.5) {
        text_at(&mut out, x, HEIGHT - BOTTOM + 14.0, "middle", &label);
    }
    out + "</svg>\n"
}
