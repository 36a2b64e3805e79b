//! The weights of a rule while it learns: their distribution over time, each before and after, and
//! the traces of one synapse.
//!
//! Input: a [`WeightHistory`]. Output: one SVG text, the same for the same weights. Dark cells of
//! the upper chart have many synapses. A cell of a matrix is the mean of the synapses between some
//! sources and some targets: blue above 0, orange below. The panels below show the synapse that
//! changed most: spikes as lines, with the traces of that side, and its weight.

use super::draw::{Axis, BOTTOM, COLOURS, END, GREY, HEIGHT, LEFT, MIDDLE, RIGHT, Scale, Sheet, TOP, WIDTH, stroked};
use nsim_session::weights::{OneSynapse, WeightHistory};

/// The most ranges of weights, and of sources or targets.
const MOST: usize = 48;
/// Width and height of a matrix.
const MATRIX: f64 = 264.0;
/// Height of a panel of one synapse, with the space below it.
const PANEL: f64 = 70.0;

/// The picture.
pub fn weights(title: &str, history: &WeightHistory) -> String {
    let below = if history.most_changed.is_some() { 3.0 * PANEL + 50.0 } else { 0.0 };
    let mut sheet = Sheet::new((WIDTH, HEIGHT + MATRIX + 70.0 + below), LEFT, title);
    sheet.text((LEFT + RIGHT) / 2.0, HEIGHT - 14.0, MIDDLE, "timestep");
    sheet.upright((TOP + BOTTOM) / 2.0, "weight");
    distribution(&mut sheet, history);
    let greatest = history.first.iter().chain(&history.last).map(|weight| weight.unsigned_abs()).max().unwrap_or(0);
    let top = HEIGHT + 30.0;
    for (name, weights, left) in [("before", &history.first, LEFT), ("after", &history.last, LEFT + MATRIX + 40.0)] {
        let name = format!("{name}: sources across, targets down");
        sheet.text(left + MATRIX / 2.0, top - 8.0, MIDDLE, &name);
        matrix(&mut sheet, left, top, weights, &history.ends, f64::from(greatest.max(1)));
    }
    let [sources, targets] = units(&history.ends).map(|units| units.div_ceil(MOST));
    let mean =
        if sources * targets > 1 { format!(", a cell the mean of {sources} x {targets} units") } else { String::new() };
    let words = format!("the strongest colour is a weight of {greatest}{mean}");
    sheet.text(LEFT, top + MATRIX + 20.0, GREY, &words);
    if let Some(one) = &history.most_changed {
        one_synapse(&mut sheet, top + MATRIX + 70.0, one, history.ends[one.row]);
    }
    sheet.svg()
}

/// Spikes and traces of both ends of a synapse, and its weight, over time.
fn one_synapse(sheet: &mut Sheet, top: f64, one: &OneSynapse, (source, target): (u32, u32)) {
    let name = format!("the synapse that changed most, from source {source} to target {target}; grey lines are spikes");
    sheet.text(LEFT, top - 10.0, "", &name);
    let end = one.times.last().copied().unwrap_or(1);
    let x = Scale::new(&Axis::linear(""), [0.0, f64::from(end)].into_iter(), LEFT, RIGHT);
    let at = |step: u32| x.place(f64::from(step)).unwrap_or(LEFT);
    let traces = one
        .traces
        .each_ref()
        .map(|side| side.iter().map(|(trace, values)| (trace.name(), values.as_slice())).collect::<Vec<_>>());
    let [pre, post] = traces;
    let panels = [
        ("source", pre, &one.spikes[0]),
        ("target", post, &one.spikes[1]),
        ("weight", vec![("w", one.weights.as_slice())], &Vec::new()),
    ];
    for (number, (name, curves, spikes)) in panels.into_iter().enumerate() {
        let (top, height) = (top + PANEL * number as f64, PANEL - 16.0);
        sheet.rect([LEFT, top, at(end) - LEFT, height], &stroked("#999", 1.0, ""));
        sheet.upright(top + height / 2.0, name);
        for &step in spikes {
            sheet.line([at(step), top, at(step), top + height], &stroked("#bbb", 0.8, ""));
        }
        let values = curves.iter().flat_map(|(_, values)| values.iter().copied());
        let (low, high) = values.fold((0, 1), |(low, high), value| (low.min(value), high.max(value)));
        let up = |value: i32| top + height - f64::from(value - low) / f64::from(high - low) * height;
        for level in [low, high] {
            sheet.text(LEFT - 6.0, up(level) + 4.0, END, &level.to_string());
        }
        for (index, (name, values)) in curves.iter().enumerate() {
            let points: Vec<_> = one.times.iter().zip(*values).map(|(&time, &value)| (at(time), up(value))).collect();
            sheet.through(&points, &stroked(COLOURS[index % COLOURS.len()], 1.3, ""));
            let below = top + 12.0 + 14.0 * index as f64;
            sheet.text(RIGHT + 10.0, below, &format!(r#"fill="{}""#, COLOURS[index % COLOURS.len()]), name);
        }
    }
}

/// A column for each time, a cell for each range of weights that any synapse has.
fn distribution(sheet: &mut Sheet, history: &WeightHistory) {
    let all = || history.counts.iter().flat_map(|(_, counts)| counts.keys());
    let (Some(&low), Some(&high)) = (all().min(), all().max()) else { return };
    let steps = history.counts.last().map_or(0, |(step, _)| *step);
    let x = Scale::new(&Axis::linear(""), [0.0, f64::from(steps)].into_iter(), LEFT, RIGHT);
    let y = Scale::new(&Axis::linear(""), [f64::from(low), f64::from(high) + 1.0].into_iter(), BOTTOM, TOP);
    sheet.ticks_up(&y);
    sheet.ticks_across(&x, RIGHT, false);
    let synapses = history.first.len().max(1) as f64;
    let range = (high - low) as usize / MOST + 1;
    for pair in history.counts.windows(2) {
        let [(from, _), (to, counts)] = pair else { continue };
        let mut by_range = vec![0u32; (high - low) as usize / range + 1];
        counts.iter().for_each(|(weight, count)| by_range[(weight - low) as usize / range] += count);
        for (index, &count) in by_range.iter().enumerate().filter(|(_, count)| **count > 0) {
            let first = low + (index * range) as i32;
            let places = [x.place(f64::from(*from)), x.place(f64::from(*to))];
            let heights = [y.place(f64::from(first)), y.place(f64::from(first + range as i32))];
            if let ([Some(left), Some(right)], [Some(bottom), Some(top)]) = (places, heights) {
                // The square root shows few synapses, too.
                let style = cell(COLOURS[0], (f64::from(count) / synapses).sqrt());
                let last = first + range as i32 - 1;
                sheet.titled(&format!("step {to}: {count} synapses of {first} to {last}"), |sheet| {
                    sheet.rect([left, top, right - left, bottom - top], &style);
                });
            }
        }
    }
}

/// Numbers of sources and of targets.
fn units(ends: &[(u32, u32)]) -> [usize; 2] {
    let sources = ends.iter().map(|(source, _)| *source as usize + 1).max().unwrap_or(1);
    let targets = ends.iter().map(|(_, target)| *target as usize + 1).max().unwrap_or(1);
    [sources, targets]
}

/// The mean weight between ranges of sources and of targets.
fn matrix(sheet: &mut Sheet, left: f64, top: f64, weights: &[i32], ends: &[(u32, u32)], greatest: f64) {
    let [sources, targets] = units(ends);
    let (columns, rows) = (sources.min(MOST), targets.min(MOST));
    let mut cells = vec![(0i64, 0i64); columns * rows];
    for (weight, (source, target)) in weights.iter().zip(ends) {
        let (column, row) = (*source as usize * columns / sources, *target as usize * rows / targets);
        let (sum, count) = &mut cells[row * columns + column];
        (*sum, *count) = (*sum + i64::from(*weight), *count + 1);
    }
    let (width, height) = (MATRIX / columns as f64, MATRIX / rows as f64);
    sheet.rect([left, top, MATRIX, MATRIX], r##"fill="none" stroke="#ddd""##);
    for (index, (sum, count)) in cells.into_iter().enumerate().filter(|(_, (_, count))| *count > 0) {
        let mean = sum as f64 / count as f64;
        let colour = if mean < 0.0 { COLOURS[1] } else { COLOURS[0] };
        let at = [left + width * (index % columns) as f64, top + height * (index / columns) as f64, width, height];
        sheet.rect(at, &cell(colour, mean.abs() / greatest));
    }
}

fn cell(colour: &str, opacity: f64) -> String {
    format!(r#"fill="{colour}" fill-opacity="{opacity:.2}""#)
}
