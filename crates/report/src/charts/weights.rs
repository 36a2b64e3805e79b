//! The weights of a rule while it learns: their distribution over time, and each before and after.
//!
//! Input: a [`WeightHistory`], and the ends of each synapse. Output: one SVG text, the same for the
//! same weights. Dark cells of the upper chart have many synapses. A cell of a matrix is the mean
//! of the synapses between some sources and some targets: blue above 0, orange below.

use super::draw::{Axis, BOTTOM, COLOURS, GREY, HEIGHT, LEFT, MIDDLE, RIGHT, Scale, Sheet, TOP, WIDTH};
use nsim_session::weights::WeightHistory;

/// The most ranges of weights, and of sources or targets.
const MOST: usize = 48;
/// Width and height of a matrix.
const MATRIX: f64 = 264.0;

/// The picture; `ends` has the source and the target of each row.
pub fn weights(title: &str, history: &WeightHistory, ends: &[(u32, u32)]) -> String {
    let mut sheet = Sheet::new((WIDTH, HEIGHT + MATRIX + 70.0), LEFT, title);
    sheet.text(((LEFT + RIGHT) / 2.0, HEIGHT - 14.0), MIDDLE, "timestep");
    sheet.upright((TOP + BOTTOM) / 2.0, "weight");
    distribution(&mut sheet, history);
    let greatest = history.first.iter().chain(&history.last).map(|weight| weight.unsigned_abs()).max().unwrap_or(0);
    let top = HEIGHT + 30.0;
    for (name, weights, left) in [("before", &history.first, LEFT), ("after", &history.last, LEFT + MATRIX + 40.0)] {
        let name = format!("{name}: sources across, targets down");
        sheet.text((left + MATRIX / 2.0, top - 8.0), MIDDLE, &name);
        matrix(&mut sheet, (left, top), (weights, ends), f64::from(greatest.max(1)));
    }
    sheet.text((LEFT, top + MATRIX + 20.0), GREY, &format!("the strongest colour is a weight of {greatest}"));
    sheet.svg()
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

/// The mean weight between ranges of sources and of targets.
fn matrix(sheet: &mut Sheet, (left, top): (f64, f64), (weights, ends): (&[i32], &[(u32, u32)]), greatest: f64) {
    let sources = ends.iter().map(|(source, _)| *source as usize + 1).max().unwrap_or(1);
    let targets = ends.iter().map(|(_, target)| *target as usize + 1).max().unwrap_or(1);
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
