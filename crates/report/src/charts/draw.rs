//! Drawing primitives: a sheet of SVG, its palette, axes with ticks, a legend.
//!
//! Input: shapes and words in the units of the sheet. Output: one SVG text, the same for the same
//! input. Styles are SVG attributes. Colours are from Okabe and Ito ("Color universal design",
//! 2008), then five from Tol's muted ones ("Colour schemes", SRON 2021). Colour-blind people can
//! distinguish them; the page uses them too.

use std::fmt::Write as _;

use nsim_ir::base::names::markup;

/// The palette.
pub const COLOURS: [&str; 12] = [
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#332288", "#882255", "#999933",
    "#44aa99", "#bbbbbb",
];
pub(super) const WIDTH: f64 = 760.0;
pub(super) const HEIGHT: f64 = 440.0;
/// Edges of the area between the axes of a chart.
pub(super) const LEFT: f64 = 76.0;
pub(super) const RIGHT: f64 = WIDTH - 190.0;
pub(super) const TOP: f64 = 44.0;
pub(super) const BOTTOM: f64 = HEIGHT - 64.0;

pub(super) const MIDDLE: &str = r#"text-anchor="middle""#;
pub(super) const END: &str = r#"text-anchor="end""#;
pub(super) const SMALL: &str = r#"font-size="9""#;
pub(super) const GREY: &str = r##"fill="#555""##;
/// A line of the grid.
const THIN: &str = r##"stroke="#ddd""##;

/// Style of a filled shape.
pub(super) fn filled(colour: &str) -> String {
    format!(r#"fill="{colour}""#)
}

/// The style of a line, with these dashes or none.
pub(super) fn stroked(colour: &str, width: f64, dashes: &str) -> String {
    format!(r#"fill="none" stroke="{colour}" stroke-width="{width:.2}" stroke-dasharray="{dashes}""#)
}

/// One axis of a chart.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Axis {
    /// Its quantity, with unit.
    pub label: String,
    /// Whether it is logarithmic; then only positive numbers are drawn.
    pub log: bool,
}

impl Axis {
    /// A linear axis.
    pub fn linear(label: impl Into<String>) -> Axis {
        Axis { label: label.into(), log: false }
    }

    /// A logarithmic axis.
    pub fn log(label: impl Into<String>) -> Axis {
        Axis { label: label.into(), log: true }
    }
}

/// Mark of a series in the legend.
#[derive(Debug, Clone, Copy)]
pub(super) enum Mark {
    /// Filled.
    Area,
    /// A line with these dashes.
    Line(&'static str),
    /// Points.
    Dot,
}

/// An SVG text under construction.
pub(super) struct Sheet(String);

impl Sheet {
    /// A white sheet with a title, which begins at `left`.
    pub fn new((width, height): (f64, f64), left: f64, title: &str) -> Sheet {
        let mut sheet = Sheet(format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" \
             font-family=\"sans-serif\" font-size=\"12\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
        ));
        sheet.text(left, 22.0, r#"font-size="15""#, title);
        sheet
    }

    /// A sheet for a chart, with the names of its axes.
    pub fn chart(title: &str, x: &str, y: &str) -> Sheet {
        let mut sheet = Sheet::new((WIDTH, HEIGHT), LEFT, title);
        sheet.text((LEFT + RIGHT) / 2.0, HEIGHT - 14.0, MIDDLE, x);
        sheet.upright((TOP + BOTTOM) / 2.0, y);
        sheet
    }

    /// Adds a rectangle, from left, top, width and height.
    pub fn rect(&mut self, [x, y, width, height]: [f64; 4], style: &str) {
        _ = writeln!(self.0, r#"<rect x="{x:.1}" y="{y:.1}" width="{width:.2}" height="{height:.2}" {style}/>"#);
    }

    pub fn line(&mut self, [x1, y1, x2, y2]: [f64; 4], style: &str) {
        _ = writeln!(self.0, r#"<line x1="{x1:.1}" y1="{y1:.1}" x2="{x2:.1}" y2="{y2:.1}" {style}/>"#);
    }

    /// Adds a path of SVG commands.
    pub fn path(&mut self, commands: &str, style: &str) {
        _ = writeln!(self.0, r#"<path d="{commands}" {style}/>"#);
    }

    /// Adds one line through points.
    pub fn through(&mut self, points: &[(f64, f64)], style: &str) {
        let points = points.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect::<Vec<_>>().join(" ");
        _ = writeln!(self.0, r#"<polyline points="{points}" {style}/>"#);
    }

    pub fn dot(&mut self, x: f64, y: f64, colour: &str) {
        _ = writeln!(self.0, r#"<circle cx="{x:.1}" cy="{y:.1}" r="4" fill="{colour}"/>"#);
    }

    pub fn text(&mut self, x: f64, y: f64, style: &str, words: &str) {
        _ = writeln!(self.0, r#"<text x="{x:.1}" y="{y:.1}" {style}>{}</text>"#, markup(words));
    }

    /// Adds vertical words along the left edge, around height `y`.
    pub fn upright(&mut self, y: f64, words: &str) {
        self.text(18.0, y, &format!(r#"{MIDDLE} transform="rotate(-90 18 {y:.1})""#), words);
    }

    /// Adds shapes with a tooltip.
    pub fn titled(&mut self, words: &str, draw: impl FnOnce(&mut Sheet)) {
        _ = write!(self.0, "<g><title>{}</title>", markup(words));
        draw(self);
        self.0 += "</g>\n";
    }

    /// Adds ticks below the chart, up to `end`, with an optional grid.
    pub fn ticks_across(&mut self, scale: &Scale, end: f64, grid: bool) {
        for (x, label) in scale.ticks().into_iter().filter(|(x, _)| *x <= end + 0.5) {
            if grid {
                self.line([x, TOP, x, BOTTOM], THIN);
            }
            self.text(x, BOTTOM + 18.0, MIDDLE, &label);
        }
    }

    /// Adds ticks left of the chart, with a grid.
    pub fn ticks_up(&mut self, scale: &Scale) {
        for (y, label) in scale.ticks() {
            self.line([LEFT, y, RIGHT, y], THIN);
            self.text(LEFT - 8.0, y + 4.0, END, &label);
        }
    }

    /// Adds entry `index` of the legend.
    pub fn legend(&mut self, index: usize, colour: &str, mark: Mark, name: &str) {
        let (x, y) = (RIGHT + 14.0, TOP + 8.0 + 18.0 * index as f64);
        match mark {
            Mark::Area => self.rect([x, y - 9.0, 12.0, 10.0], &filled(colour)),
            Mark::Line(dash) => self.line([x - 10.0, y - 4.0, x + 14.0, y - 4.0], &stroked(colour, 2.0, dash)),
            Mark::Dot => self.dot(x + 6.0, y - 4.0, colour),
        }
        self.text(x + 18.0, y, "", name);
    }

    /// The whole text.
    pub fn svg(self) -> String {
        self.0 + "</svg>\n"
    }
}

/// A map from numbers to positions on the sheet.
pub(super) struct Scale {
    log: bool,
    /// Distance of ticks, of a linear scale.
    step: f64,
    low: f64,
    high: f64,
    from: f64,
    to: f64,
}

impl Scale {
    pub fn new(axis: &Axis, numbers: impl Iterator<Item = f64>, from: f64, to: f64) -> Scale {
        let shown = numbers.filter(|n| n.is_finite() && (!axis.log || *n >= f64::MIN_POSITIVE));
        let (mut low, mut high) = shown.fold((f64::MAX, f64::MIN), |(low, high), n| (low.min(n), high.max(n)));
        if low > high {
            (low, high) = if axis.log { (1.0, 10.0) } else { (0.0, 1.0) };
        }
        let mut between = 0.0;
        if axis.log {
            // Rounding the smallest and the largest numbers would leave the range of doubles.
            (low, high) = (round_below(low).max(f64::MIN_POSITIVE), round_above(high).min(f64::MAX));
            if high < 9.0 * low {
                (low, high) = (10f64.powf(low.log10().floor()), 10f64.powf(high.log10().ceil()).min(f64::MAX));
            }
            if high <= low {
                high = 10.0 * low;
            }
        } else {
            if high / 6.0 - low / 6.0 < f64::MIN_POSITIVE {
                (low, high) = (low - 0.5 * low.abs().max(1.0), high + 0.5 * high.abs().max(1.0));
            }
            // Ends beyond the range of doubles are clamped.
            (low, high) = (low.max(f64::MIN), high.min(f64::MAX));
            between = step((high / 2.0 - low / 2.0) / 3.0);
            // A sum of shares may miss its tick by its last digit.
            let [first, last] = [(low / between + 1e-9).floor(), (high / between - 1e-9).ceil()];
            (low, high) = (first * between, last * between);
            (low, high) = (low.max(f64::MIN), high.min(f64::MAX));
        }
        Scale { log: axis.log, step: between, low, high, from, to }
    }

    pub fn place(&self, number: f64) -> Option<f64> {
        let share = match self.log {
            // Subnormal numbers have fewer digits, and the smallest no decade.
            true if number >= f64::MIN_POSITIVE => self.above_low(number) / self.above_low(self.high),
            true => return None,
            false => (number / 2.0 - self.low / 2.0) / (self.high / 2.0 - self.low / 2.0),
        };
        share.is_finite().then_some(self.from + share * (self.to - self.from))
    }

    /// The logarithm of a number over the lowest, since a ratio of numbers may overflow.
    fn above_low(&self, number: f64) -> f64 {
        let ratio = number / self.low;
        if ratio.is_finite() { ratio.ln() } else { number.ln() - self.low.ln() }
    }

    pub fn ticks(&self) -> Vec<(f64, String)> {
        let numbers: Vec<f64> = if self.log {
            let (from, to) = (self.low.log10().floor() as i32, self.high.log10().ceil() as i32);
            let digits: &[f64] = if (self.high / self.low).log10() > 3.5 { &[1.0] } else { &ROUND_DIGITS };
            let every = 1 + (to - from) as usize / MOST_DECADES;
            let all = (from..=to)
                .step_by(every)
                .flat_map(|decade| digits.iter().map(move |digit| digit * 10f64.powi(decade)));
            all.filter(|n| (self.low * 0.999..=self.high * 1.001).contains(n)).collect()
        } else {
            // Multiples of the step, so that one of them is exactly 0 where the axis passes it.
            let [first, last] = [self.low, self.high].map(|end| (end / self.step).round() as i64);
            (first..=last).map(|k| self.step * k as f64).collect()
        };
        numbers.into_iter().filter_map(|n| Some((self.place(n)?, number(n)))).collect()
    }
}

/// Greatest number of decades with a tick each.
const MOST_DECADES: usize = 40;

/// First digits of the ends of a logarithmic axis, and of the steps of a linear one.
const ROUND_DIGITS: [f64; 3] = [1.0, 2.0, 5.0];

/// The largest 1, 2 or 5 times a power of ten that is at most this.
fn round_below(number: f64) -> f64 {
    let decade = 10f64.powf(number.log10().floor());
    let digit = ROUND_DIGITS.into_iter().rev().find(|digit| digit * decade / 1.000_001 <= number);
    digit.unwrap_or(1.0) * decade
}

/// The smallest 1, 2 or 5 times a power of ten that is at least this.
fn round_above(number: f64) -> f64 {
    let decade = 10f64.powf(number.log10().floor());
    let digit = ROUND_DIGITS.into_iter().find(|digit| digit * decade >= number * 0.999_999);
    digit.unwrap_or(10.0) * decade
}

/// The smallest round step that is at least this.
fn step(rough: f64) -> f64 {
    let decade = 10f64.powf(rough.log10().floor());
    ROUND_DIGITS.into_iter().find(|digit| rough / decade <= *digit).unwrap_or(10.0) * decade
}

fn number(n: f64) -> String {
    let text = format!("{n:.6}");
    let short = text.trim_end_matches('0').trim_end_matches('.');
    match short {
        "-0" | "" => "0".to_string(),
        _ if n != 0.0 && (n.abs() < 1e-4 || n.abs() >= 1e6) => format!("{n:.0e}"),
        _ => short.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_follow_the_numbers() {
        let linear = Scale::new(&Axis::linear(""), [0.0, 10.0].into_iter(), 100.0, 200.0);
        assert_eq!([0.0, 5.0, 10.0].map(|n| linear.place(n)), [Some(100.0), Some(150.0), Some(200.0)]);
        let log = Scale::new(&Axis::log(""), [0.01, 1.0].into_iter(), 0.0, 100.0);
        assert_eq!((log.place(0.0), log.place(0.01), log.place(1.0)), (None, Some(0.0), Some(100.0)));
        assert!((log.place(0.1).unwrap() - 50.0).abs() < 1e-9);
        let ticks: Vec<String> = log.ticks().into_iter().map(|(_, label)| label).collect();
        assert_eq!(ticks, ["0.01", "0.02", "0.05", "0.1", "0.2", "0.5", "1"]);
        let both = Scale::new(&Axis::linear(""), [-0.58, 0.59].into_iter(), 0.0, 120.0);
        let shares = Scale::new(&Axis::linear(""), [0.0, 100.000_000_000_000_01].into_iter(), 0.0, 120.0);
        assert_eq!(shares.ticks().last().map(|(_, label)| label.clone()), Some("100".to_string()));
        let ticks: Vec<String> = both.ticks().into_iter().map(|(_, label)| label).collect();
        assert_eq!(ticks, ["-0.6", "-0.4", "-0.2", "0", "0.2", "0.4", "0.6"]);
        for ends in [[f64::MIN, f64::MAX], [-1e308, 1e308], [f64::MAX; 2], [0.0, 5e-324], [5e-324, f64::MAX]] {
            for axis in [Axis::linear(""), Axis::log("")] {
                let scale = Scale::new(&axis, ends.into_iter(), 0.0, 100.0);
                let places: Vec<f64> = ends.into_iter().filter_map(|end| scale.place(end)).collect();
                assert!(!places.is_empty() || ends[1] < 1e-300 || axis.log, "{ends:?}");
                assert!(places.iter().all(|at| (-5.0..=105.0).contains(at)), "{ends:?}: {places:?}");
                let ticks = scale.ticks();
                assert!((1..=60).contains(&ticks.len()) && ticks.iter().all(|(at, _)| at.is_finite()), "{ends:?}");
            }
        }
        let tight = Scale::new(&Axis::log(""), [0.06, 75.0].into_iter(), 0.0, 100.0);
        assert!((tight.low, tight.high) == (0.05, 100.0), "{} to {}", tight.low, tight.high);
    }
}
