//! One sample over time as SVG, a panel below another: spikes of senses or populations, potentials
//! and messages of compartments.
//!
//! Input: a recording, or a [`Timeline`] of a network. Output: one SVG text, the same for the same
//! input. The picture states the omissions of a timeline. Dots of one kind are one path, so that
//! ten thousand of them take some hundred kilobytes.

use std::fmt::Write as _;

use super::draw::{Axis, BOTTOM, COLOURS, END, LEFT, MIDDLE, Mark, RIGHT, Scale, Sheet, TOP, stroked};
use nsim_dynamics::thresholds;
use nsim_files::table::count;
use nsim_ir::base::id::{CompartmentId, PopulationId};
use nsim_ir::quantised::Quantised;
use nsim_session::Quantity;
use nsim_session::timeline::Timeline;

/// Space between two panels.
const GAP: f64 = 12.0;
/// Greatest number of points of a curve; a longer one has the maximum of each group of steps.
const MOST_POINTS: usize = 1_500;
/// Greatest ratio of the heights of two rasters.
const MOST_SHARE: f64 = 3.0;
/// Greatest number of panels of a raster; more would be thinner than their names.
const MOST_PANELS: usize = 24;

/// Content of a panel.
#[derive(Debug, Clone, PartialEq)]
pub enum Content {
    /// Spikes of `n` channels as (step, channel), under the name of their kind, the first on top.
    Spikes(u32, Vec<(String, Vec<(u32, u32)>)>),
    /// A potential in thresholds, by steps.
    Potential(Vec<(usize, f64)>),
}

/// A sense, a population or a compartment.
#[derive(Debug, Clone, PartialEq)]
pub struct Panel {
    /// Name of the sense, population or compartment.
    pub label: String,
    /// Its share of the height.
    pub share: f64,
    /// Its content.
    pub content: Content,
}

/// One sample.
#[derive(Debug, Clone, PartialEq)]
pub struct Panels {
    /// Title above the panels.
    pub title: String,
    /// Common quantity of all panels; empty where panels name their own.
    pub y_label: String,
    /// Timesteps.
    pub steps: u32,
    /// Milliseconds of a timestep.
    pub timestep_ms: f64,
    /// Time of the event that decides the class, ms from the start.
    pub onset_ms: Option<f64>,
    /// Panels, from top to bottom.
    pub panels: Vec<Panel>,
}

impl Panels {
    /// The picture.
    pub fn svg(&self) -> String {
        let mut sheet = Sheet::chart(&self.title, "time into the sample, ms", &self.y_label);
        let end_ms = f64::from(self.steps) * self.timestep_ms;
        let across = Scale::new(&Axis::linear(""), [0.0, end_ms].into_iter(), LEFT, RIGHT);
        let at = |steps: f64| across.place(steps * self.timestep_ms).unwrap_or(LEFT);
        let end = at(f64::from(self.steps));
        let gaps = GAP * self.panels.len().saturating_sub(1) as f64;
        let shares: f64 = self.panels.iter().map(|panel| panel.share).sum();
        let (mut top, mut kinds) = (TOP, 0);
        for (number, panel) in self.panels.iter().enumerate() {
            let height = (BOTTOM - TOP - gaps) * panel.share / shares;
            sheet.rect([LEFT, top, end - LEFT, height], &stroked("#999", 1.0, ""));
            match &panel.content {
                Content::Spikes(channels, of_kinds) => {
                    sheet.upright(top + height / 2.0, &panel.label);
                    sheet.text(LEFT - 8.0, top + 10.0, END, "0");
                    sheet.text(LEFT - 8.0, top + height, END, &channels.saturating_sub(1).to_string());
                    let (row, length) = (height / f64::from((*channels).max(1)), (at(1.0) - at(0.0)).max(1.0));
                    for (name, spikes) in of_kinds {
                        let colour = COLOURS[kinds % COLOURS.len()];
                        let mut path = String::new();
                        for &(step, channel) in spikes {
                            let y = top + (f64::from(channel) + 0.5) * row;
                            _ = write!(path, "M{:.1} {y:.1}h{length:.1}", at(f64::from(step)));
                        }
                        sheet.path(&path, &stroked(colour, row.clamp(0.8, 4.0), ""));
                        sheet.legend(kinds, colour, Mark::Dot, name);
                        kinds += 1;
                    }
                }
                Content::Potential(points) => {
                    let values = points.iter().map(|point| point.1);
                    let (low, high) = values.fold((0.0, 1.0), |(low, high): (f64, f64), v| (low.min(v), high.max(v)));
                    let up = |v: f64| top + height - (v - low) / (high - low) * height;
                    for (level, dashes) in [(0.0, ""), (1.0, "4 3")] {
                        sheet.line([LEFT, up(level), end, up(level)], &stroked("#888", 0.8, dashes));
                        sheet.text(LEFT - 6.0, up(level) + 4.0, END, &level.to_string());
                    }
                    let points: Vec<_> = points.iter().map(|&(step, v)| (at(step as f64), up(v))).collect();
                    sheet.through(&points, &stroked(COLOURS[number % COLOURS.len()], 1.3, ""));
                    sheet.text(RIGHT + 10.0, top + height / 2.0 + 4.0, "", &panel.label);
                }
            }
            top += height + GAP;
        }
        // The axis is rounded up, the panels end with the recording.
        sheet.ticks_across(&across, end, false);
        if let Some(onset) = self.onset_ms {
            let x = at(onset / self.timestep_ms);
            sheet.line([x, TOP - 8.0, x, BOTTOM + 22.0], &stroked("#000", 1.0, "5 3"));
            sheet.text(x, BOTTOM + 34.0, MIDDLE, &format!("onset {onset:.0} ms"));
        }
        sheet.svg()
    }
}

/// SVG of the spikes of the first of these populations, each in its own panel.
pub fn raster(title: &str, network: &Quantised, timeline: &Timeline, shown: &[PopulationId]) -> String {
    let panel = |&id: &PopulationId| {
        let raster = &timeline.rasters[id.0 as usize];
        let mut kind = count(raster.spikes.len() as u64, "spike");
        if raster.every > 1 {
            kind = format!("{kind}, 1 unit in {}", raster.every);
        }
        if raster.cut {
            kind += ", truncated";
        }
        Panel {
            label: network.populations()[id].name.clone(),
            share: f64::from(raster.units).sqrt().clamp(4.0, 4.0 * MOST_SHARE),
            content: Content::Spikes(raster.units, vec![(kind, raster.spikes.clone())]),
        }
    };
    let (steps, all) = timeline.steps;
    let first = if steps < all { format!(" (first {steps} of {all} steps)") } else { String::new() };
    let drawn = &shown[..shown.len().min(MOST_PANELS)];
    let cut = match drawn.len() < shown.len() {
        true => format!(", {MOST_PANELS} of {} populations", shown.len()),
        false => String::new(),
    };
    let (title, timestep_ms) = (format!("{title}{first}{cut}"), network.parts().timestep_ms);
    let panels = drawn.iter().map(panel).collect();
    Panels { title, y_label: String::new(), steps, timestep_ms, onset_ms: None, panels }.svg()
}

/// SVG with a panel for each compartment: potentials as fractions of their thresholds, messages and
/// potentials without thresholds as fractions of the greatest, which a label gives. The timeline
/// has the traces of `traced`, in this order. 0 represents no message.
pub fn traces(title: &str, network: &Quantised, timeline: &Timeline, traced: &[Traced], quantity: Quantity) -> String {
    let is_message = quantity == Quantity::Message;
    let steps = timeline.steps.0;
    let group = (steps as usize).div_ceil(MOST_POINTS).max(1);
    let reduced = if group > 1 { format!(", a point is the largest of {group} steps") } else { String::new() };
    let largest = |part: &[i32]| match is_message {
        true => part.iter().copied().max_by_key(|value| value.unsigned_abs()),
        false => part.iter().copied().max(),
    };
    let panel = |(of, trace): (&Traced, &Vec<i32>)| {
        let (label, whole) = match of.threshold.filter(|_| !is_message) {
            None => {
                let greatest = trace.iter().map(|value| value.unsigned_abs()).max().unwrap_or(0);
                (format!("{}: {greatest}", of.name), f64::from(greatest.max(1)))
            }
            Some(threshold) => (of.name.clone(), threshold),
        };
        // A point is at the end of its steps.
        let end = |point: usize| ((point + 1) * group).min(steps as usize);
        let points = trace.chunks(group).filter_map(largest).enumerate();
        let points = points.map(|(point, value)| (end(point), f64::from(value) / whole)).collect();
        Panel { label, share: 1.0, content: Content::Potential(points) }
    };
    let panels = traced.iter().zip(&timeline.traces).map(panel).collect();
    let y_label = match (is_message, traced.iter().all(|of| of.threshold.is_some())) {
        (true, _) => "message (dashed: the greatest)",
        (false, true) => "potential (dashed: threshold)",
        (false, false) => "potential (dashed: threshold, or the number beside it)",
    };
    let (title, y_label) = (title.to_string(), format!("{y_label}{reduced}"));
    Panels { title, y_label, steps, timestep_ms: network.parts().timestep_ms, onset_ms: None, panels }.svg()
}

/// A compartment whose potential or messages are drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct Traced {
    /// Population and index.
    pub name: String,
    /// Its threshold; none for a kind whose potential is a word of state.
    pub threshold: Option<f64>,
}

/// At most `most` compartments to draw: of each population the named unit, or the most active.
pub fn traced(
    network: &Quantised,
    populations: impl IntoIterator<Item = (PopulationId, Option<u32>, usize)>,
    quantity: Quantity,
    spikes: impl Fn(CompartmentId) -> u64,
    most: usize,
) -> (Vec<CompartmentId>, Vec<Traced>) {
    let thresholds = thresholds(network);
    let (mut ids, mut traced) = (Vec::new(), Vec::new());
    for (id, named, of_each) in populations {
        let population = &network.populations()[id];
        let (Some(first), Some(kind)) = (population.first_compartment(), population.neuron_kind()) else { continue };
        if quantity == Quantity::Potential && kind.potential().is_none() {
            continue;
        }
        let has_threshold = kind.table().registers;
        let mut units: Vec<u32> = named.map_or_else(|| (0..population.shape.len()).collect(), |unit| vec![unit]);
        units.sort_by_key(|&unit| std::cmp::Reverse(spikes(CompartmentId(first.0 + unit))));
        units.truncate(of_each.min(most - ids.len()));
        units.sort_unstable();
        for unit in units {
            ids.push(CompartmentId(first.0 + unit));
            let name = format!("{}[{}]", population.name, network.index_before_pruning(id, unit));
            let threshold = has_threshold.then(|| thresholds[(first.0 + unit) as usize]);
            traced.push(Traced { name, threshold });
        }
    }
    (ids, traced)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_spike_has_its_dot_and_the_onset_its_line() {
        let panel = |share: f64, spikes: &[(u32, u32)]| {
            let kinds = vec![("spike".into(), spikes.to_vec()), ("none".into(), Vec::new())];
            Panel { label: "channels".into(), share, content: Content::Spikes(4, kinds) }
        };
        let raster = Panels {
            title: "a < b".into(),
            y_label: String::new(),
            steps: 10,
            timestep_ms: 2.0,
            onset_ms: Some(6.0),
            panels: vec![panel(1.0, &[(0, 0), (9, 3)]), panel(3.0, &[(5, 1)])],
        };
        let svg = raster.svg();
        // Twenty milliseconds over 494 pixels from 76 on: step 9 begins at 18 ms.
        assert_eq!(svg.matches("h49.4").count(), 3);
        assert!(svg.contains("M76.0 ") && svg.contains(&format!("M{:.1} ", 76.0 + 18.0 * 24.7)), "{svg}");
        assert!(svg.contains("onset 6 ms") && svg.contains("a &lt; b") && svg.ends_with("</svg>\n"));
        assert_eq!(svg.matches("<path").count(), 4);
        let still = Panels { onset_ms: None, panels: Vec::new(), steps: 0, ..raster }.svg();
        assert!(!still.contains("onset") && !still.contains("NaN"));
    }
}
