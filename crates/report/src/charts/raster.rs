//! A recording as SVG: a dot for each spike, step by channel, one panel a sense.
//!
//! Input: the spikes of each sense and when what decides the class begins. Output: one SVG text,
//! the same for the same spikes. Dots of one kind are one path, so that ten thousand of them stay a
//! file of some hundred kilobytes.

use std::fmt::Write as _;

use crate::charts::plot::{
    Axis, BOTTOM, COLOURS, HEIGHT, LEFT, Mark, RIGHT, Scale, TOP, WIDTH, frame, legend, text_at,
};
use nsim_ir::base::names::markup;

/// The spikes of one sense.
#[derive(Debug, Clone, PartialEq)]
pub struct Panel {
    /// What its channels are.
    pub label: String,
    /// How many there are; channel 0 is at the top.
    pub channels: u32,
    /// Its share of the height.
    pub share: f64,
    /// Spikes as (step, channel), under the name of their kind.
    pub kinds: Vec<(String, Vec<(u32, u32)>)>,
}

/// One recording.
#[derive(Debug, Clone, PartialEq)]
pub struct Raster {
    /// The title.
    pub title: String,
    /// Timesteps.
    pub steps: u32,
    /// Milliseconds of a timestep.
    pub timestep_ms: f64,
    /// When what decides the class begins, in ms from the start.
    pub onset_ms: Option<f64>,
    /// From top to bottom.
    pub panels: Vec<Panel>,
}

/// Pixels between two panels.
const GAP: f64 = 16.0;

impl Raster {
    /// The picture.
    #[must_use]
    pub fn svg(&self) -> String {
        let mut out = frame(&self.title, "time into the sample, ms", "");
        let end_ms = f64::from(self.steps) * self.timestep_ms;
        let across = Scale::new(&Axis::linear(""), [0.0, end_ms].into_iter(), LEFT, WIDTH - RIGHT);
        let at = |ms: f64| across.place(ms).unwrap_or(LEFT);
        let gaps = GAP * self.panels.len().saturating_sub(1) as f64;
        let shares: f64 = self.panels.iter().map(|panel| panel.share).sum();
        let (mut top, mut kinds) = (TOP, 0);
        for panel in &self.panels {
            let height = (HEIGHT - BOTTOM - TOP - gaps) * panel.share / shares;
            let row = height / f64::from(panel.channels.max(1));
            let length = at(self.timestep_ms) - at(0.0);
            _ = writeln!(
                out,
                r##"<rect x="{LEFT}" y="{top:.1}" width="{:.1}" height="{height:.1}" fill="none" stroke="#999"/>"##,
                at(end_ms) - LEFT
            );
            let middle = top + height / 2.0;
            _ = writeln!(
                out,
                r#"<text x="18" y="{middle:.1}" text-anchor="middle" transform="rotate(-90 18 {middle:.1})">{}</text>"#,
                markup(&panel.label)
            );
            text_at(&mut out, LEFT - 8.0, top + 10.0, "end", "0");
            text_at(&mut out, LEFT - 8.0, top + height, "end", &panel.channels.saturating_sub(1).to_string());
            for (name, spikes) in &panel.kinds {
                let colour = COLOURS[kinds % COLOURS.len()];
                let mut path = String::new();
                for &(step, channel) in spikes {
                    let (x, y) = (at(f64::from(step) * self.timestep_ms), top + (f64::from(channel) + 0.5) * row);
                    _ = write!(path, "M{x:.1} {y:.1}h{:.1}", length.max(1.0));
                }
                let width = row.clamp(0.8, 4.0);
                _ = writeln!(out, r#"<path d="{path}" stroke="{colour}" stroke-width="{width:.1}" fill="none"/>"#);
                legend(&mut out, kinds, (colour, Mark::Dot), name);
                kinds += 1;
            }
            top += height + GAP;
        }
        // The axis is rounded up, the panels end with the recording.
        for (x, label) in across.ticks().into_iter().filter(|(x, _)| *x <= at(end_ms) + 0.5) {
            text_at(&mut out, x, HEIGHT - BOTTOM + 18.0, "middle", &label);
        }
        if let Some(onset) = self.onset_ms {
            let x = at(onset);
            _ = writeln!(
                out,
                r##"<line x1="{x:.1}" y1="{:.1}" x2="{x:.1}" y2="{:.1}" stroke="#000" stroke-dasharray="5 3"/>"##,
                TOP - 8.0,
                HEIGHT - BOTTOM + 22.0
            );
            text_at(&mut out, x, HEIGHT - BOTTOM + 34.0, "middle", &format!("onset {onset:.0} ms"));
        }
        out + "</svg>\n"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_spike_has_its_dot_and_the_onset_its_line() {
        let panel = |share: f64, spikes: &[(u32, u32)]| Panel {
            label: "channels".into(),
            channels: 4,
            share,
            kinds: vec![("spike".into(), spikes.to_vec()), ("none".into(), Vec::new())],
        };
        let raster = Raster {
            title: "a < b".into(),
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
        let still = Raster { onset_ms: None, panels: Vec::new(), steps: 0, ..raster }.svg();
        assert!(!still.contains("onset") && !still.contains("NaN"));
    }
}
