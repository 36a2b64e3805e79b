//! Charts as SVG: lines, scattered points with a front, bars.
//!
//! Input: named series of finite numbers. Output: one SVG text, the same for the same numbers.
//! Written by hand: the three charts that results need are a few rectangles, lines and words.
//! Colours are those of Okabe and Ito ("Color universal design", 2008), then five of Tol's muted
//! ones ("Colour schemes", SRON 2021), told apart by people who see fewer; series differ in dashes
//! or marks too.

use std::fmt::Write as _;

use nsim_ir::base::names::markup;

pub(super) const WIDTH: f64 = 760.0;
pub(super) const HEIGHT: f64 = 440.0;
pub(super) const LEFT: f64 = 76.0;
pub(super) const RIGHT: f64 = 190.0;
pub(super) const TOP: f64 = 44.0;
pub(super) const BOTTOM: f64 = 64.0;
pub(super) const COLOURS: [&str; 12] = [
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#332288", "#882255", "#999933",
    "#44aa99", "#bbbbbb",
];
const DASHES: [&str; 4] = ["", "7 3", "2 3", "9 3 2 3"];

/// One axis of a chart.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Axis {
    /// What it shows, with its unit.
    pub label: String,
    /// Whether equal distances are equal factors; then only positive numbers are shown.
    pub log: bool,
}

impl Axis {
    /// Equal distances are equal differences.
    #[must_use]
    pub fn linear(label: impl Into<String>) -> Axis {
        Axis { label: label.into(), log: false }
    }

    /// Equal distances are equal factors.
    #[must_use]
    pub fn log(label: impl Into<String>) -> Axis {
        Axis { label: label.into(), log: true }
    }
}

/// Numbers of a chart under one name.
#[derive(Debug, Clone, PartialEq)]
pub enum Series {
    /// A line through points in order of x.
    Line {
        /// Its name in the legend.
        name: String,
        /// (x, y).
        points: Vec<(f64, f64)>,
    },
    /// Single points with words beside them.
    Points {
        /// Their name in the legend.
        name: String,
        /// x, y, and the text.
        points: Vec<(f64, f64, String)>,
        /// Whether steps join them, as for a front on which less is better.
        joined: bool,
    },
    /// Upright lines between two numbers.
    Intervals {
        /// Their name in the legend.
        name: String,
        /// x, low and high.
        points: Vec<(f64, f64, f64)>,
    },
}

/// A chart of lines and points.
#[must_use]
pub fn chart(title: &str, x: &Axis, y: &Axis, series: &[Series]) -> String {
    let numbers: Vec<(f64, f64)> = series.iter().flat_map(extent).collect();
    let across = Scale::new(x, numbers.iter().map(|p| p.0), LEFT, WIDTH - RIGHT);
    let up = Scale::new(y, numbers.iter().map(|p| p.1), HEIGHT - BOTTOM, TOP);
    let mut out = frame(title, &x.label, &y.label);
    for (at, label) in across.ticks() {
        _ = writeln!(
            out,
            r##"<line x1="{at:.1}" y1="{TOP}" x2="{at:.1}" y2="{:.1}" stroke="#ddd"/>"##,
            HEIGHT - BOTTOM
        );
        text_at(&mut out, at, HEIGHT - BOTTOM + 18.0, "middle", &label);
    }
    for (at, label) in up.ticks() {
        _ = writeln!(out, r##"<line x1="{LEFT}" y1="{at:.1}" x2="{:.1}" y2="{at:.1}" stroke="#ddd"/>"##, WIDTH - RIGHT);
        text_at(&mut out, LEFT - 8.0, at + 4.0, "end", &label);
    }
    // A front lies above what it is the front of, and its labels are placed first.
    let is_front = |one: &Series| matches!(one, Series::Points { joined: true, .. });
    let mut order: Vec<(usize, &Series)> = series.iter().enumerate().collect();
    order.sort_by_key(|(_, one)| is_front(one));
    let mut labels = Labels::default();
    for (index, one) in order {
        let (colour, dash) = (COLOURS[index % COLOURS.len()], DASHES[index % DASHES.len()]);
        let (name, mark) = match one {
            Series::Line { name, points } => {
                let place = |&(px, py): &(f64, f64)| Some((across.place(px)?, up.place(py)?));
                let line: Vec<(f64, f64)> = points.iter().filter_map(place).collect();
                _ = writeln!(
                    out,
                    r#"<polyline points="{}" fill="none" stroke="{colour}" stroke-width="2" stroke-dasharray="{dash}"/>"#,
                    path(&line)
                );
                (name, Mark::Line(dash))
            }
            Series::Intervals { name, points } => {
                let mut path = String::new();
                for &(x, low, high) in points {
                    if let (Some(x), Some(low), Some(high)) = (across.place(x), up.place(low), up.place(high)) {
                        _ = write!(path, "M{x:.1} {low:.1}V{high:.1}");
                    }
                }
                _ = writeln!(
                    out,
                    r#"<path d="{path}" fill="none" stroke="{colour}" stroke-width="1.2" opacity="0.6"/>"#
                );
                (name, Mark::Line(""))
            }
            Series::Points { name, points, joined } => {
                let mut placed: Vec<(f64, f64, &str)> = points
                    .iter()
                    .filter_map(|(px, py, label)| Some((across.place(*px)?, up.place(*py)?, label.as_str())))
                    .collect();
                if *joined {
                    placed.sort_by(|a, b| a.0.total_cmp(&b.0));
                    let corners = placed.windows(2).flat_map(|pair| [(pair[1].0, pair[0].1), (pair[1].0, pair[1].1)]);
                    let line: Vec<(f64, f64)> = placed.first().map(|p| (p.0, p.1)).into_iter().chain(corners).collect();
                    _ = writeln!(
                        out,
                        r#"<polyline points="{}" fill="none" stroke="{colour}" stroke-width="1.5" stroke-dasharray="5 3"/>"#,
                        path(&line)
                    );
                }
                for (px, py, label) in placed {
                    _ = writeln!(out, r#"<circle cx="{px:.1}" cy="{py:.1}" r="4" fill="{colour}"/>"#);
                    labels.add(is_front(one), px, py, label);
                }
                (name, Mark::Dot)
            }
        };
        legend(&mut out, index, (colour, mark), name);
    }
    labels.write(&mut out);
    out + "</svg>\n"
}

/// A chart of bars: one group a category, one bar a series in it.
#[must_use]
pub fn bars(title: &str, y: &Axis, categories: &[String], series: &[(String, Vec<f64>)]) -> String {
    barred(title, y, categories, series, false)
}

/// A chart of bars: one a category, its series on top of each other. Their numbers are not
/// negative.
#[must_use]
pub fn stacked(title: &str, y: &Axis, categories: &[String], series: &[(String, Vec<f64>)]) -> String {
    barred(title, y, categories, series, true)
}

/// A series' colour; those beyond the colours there are take them again, half through.
fn colour(index: usize) -> String {
    let half = if index < COLOURS.len() { "" } else { "80" };
    format!("{}{half}", COLOURS[index % COLOURS.len()])
}

fn barred(title: &str, y: &Axis, categories: &[String], series: &[(String, Vec<f64>)], stacked: bool) -> String {
    let value = |series: &(String, Vec<f64>), place: usize| series.1.get(place).copied().unwrap_or(0.0);
    let tops: Vec<f64> = match stacked {
        true => (0..categories.len()).map(|place| series.iter().map(|one| value(one, place)).sum()).collect(),
        false => series.iter().flat_map(|(_, values)| values.iter().copied()).collect(),
    };
    let numbers = tops.into_iter();
    let zero = if y.log { None } else { Some(0.0) };
    let up = Scale::new(y, numbers.chain(zero), HEIGHT - BOTTOM, TOP);
    let mut out = frame(title, "", &y.label);
    for (at, label) in up.ticks() {
        _ = writeln!(out, r##"<line x1="{LEFT}" y1="{at:.1}" x2="{:.1}" y2="{at:.1}" stroke="#ddd"/>"##, WIDTH - RIGHT);
        text_at(&mut out, LEFT - 8.0, at + 4.0, "end", &label);
    }
    let ground = up.place(0.0).unwrap_or(HEIGHT - BOTTOM);
    let group = (WIDTH - RIGHT - LEFT) / categories.len().max(1) as f64;
    let beside = if stacked { 1 } else { series.len().max(1) };
    let bar = group * 0.8 / beside as f64;
    for (place, category) in categories.iter().enumerate() {
        let from = LEFT + group * (place as f64 + 0.1);
        let mut below = 0.0;
        for (index, one) in series.iter().enumerate() {
            if place >= one.1.len() {
                continue;
            }
            let (foot, upto) = if stacked { (below, below + value(one, place)) } else { (0.0, value(one, place)) };
            below = upto;
            let Some(top) = up.place(upto) else { continue };
            let ground = up.place(foot).unwrap_or(ground);
            _ = writeln!(
                out,
                r#"<rect x="{:.1}" y="{:.1}" width="{:.1}" height="{:.1}" fill="{}"/>"#,
                from + if stacked { 0.0 } else { bar * index as f64 },
                top.min(ground),
                (bar - 1.0).max(0.5),
                (top - ground).abs(),
                colour(index)
            );
        }
        let middle = from + group * 0.4;
        // Labels stand straight below their groups if all have room.
        if categories.iter().all(|category| 6.2 * category.chars().count() as f64 <= group) {
            text_at(&mut out, middle, HEIGHT - BOTTOM + 18.0, "middle", category);
            continue;
        }
        _ = writeln!(
            out,
            r#"<text x="{middle:.1}" y="{:.1}" font-size="10" text-anchor="end" transform="rotate(-24 {middle:.1} {:.1})">{}</text>"#,
            HEIGHT - BOTTOM + 14.0,
            HEIGHT - BOTTOM + 14.0,
            markup(category)
        );
    }
    _ = writeln!(
        out,
        r##"<line x1="{LEFT}" y1="{ground:.1}" x2="{:.1}" y2="{ground:.1}" stroke="#333"/>"##,
        WIDTH - RIGHT
    );
    for (index, (name, _)) in series.iter().enumerate() {
        legend(&mut out, index, (&colour(index), Mark::Area), name);
    }
    out + "</svg>\n"
}

/// Words beside points, where there is room around them. Those that would lie over others or over
/// points everywhere are left out; a front's come first.
#[derive(Default)]
struct Labels(Vec<(bool, f64, f64, String)>);

impl Labels {
    fn add(&mut self, first: bool, x: f64, y: f64, text: &str) {
        self.0.push((first, x, y, text.to_string()));
    }

    fn write(mut self, out: &mut String) {
        self.0.sort_by_key(|(first, ..)| !first);
        // From, to and the middle of each line of words, and of each point.
        let mut taken: Vec<(f64, f64, f64)> = self.0.iter().map(|(_, x, y, _)| (x - 4.0, x + 4.0, *y)).collect();
        for (_, x, y, text) in self.0 {
            let wide = 5.0 * text.chars().count() as f64;
            let places = [(x + 6.0, y - 5.0), (x + 6.0, y + 5.0), (x - 6.0 - wide, y - 5.0), (x - 6.0 - wide, y + 5.0)];
            let upright = [(x - wide / 2.0, y - 9.0), (x - wide / 2.0, y + 10.0), (x + 7.0, y), (x - 7.0 - wide, y)];
            let free = |&(left, middle): &(f64, f64)| {
                left >= LEFT - 10.0
                    && (TOP..HEIGHT - BOTTOM - 2.0).contains(&middle)
                    && left + wide <= WIDTH
                    && taken.iter().all(|&(from, to, at)| left + wide < from || left > to || (middle - at).abs() > 8.5)
            };
            if let Some((left, middle)) = places.into_iter().chain(upright).find(free) {
                small(out, left, middle + 3.0, &text);
                taken.push((left, left + wide, middle));
            }
        }
    }
}

fn extent(series: &Series) -> Vec<(f64, f64)> {
    match series {
        Series::Line { points, .. } => points.clone(),
        Series::Points { points, .. } => points.iter().map(|p| (p.0, p.1)).collect(),
        Series::Intervals { points, .. } => points.iter().flat_map(|p| [(p.0, p.1), (p.0, p.2)]).collect(),
    }
}

/// Numbers to places on the paper.
pub(super) struct Scale {
    log: bool,
    /// From tick to tick, of a linear one.
    step: f64,
    low: f64,
    high: f64,
    from: f64,
    to: f64,
}

impl Scale {
    pub(super) fn new(axis: &Axis, numbers: impl Iterator<Item = f64>, from: f64, to: f64) -> Scale {
        let shown = numbers.filter(|n| n.is_finite() && (!axis.log || *n >= f64::MIN_POSITIVE));
        let (mut low, mut high) = shown.fold((f64::MAX, f64::MIN), |(low, high), n| (low.min(n), high.max(n)));
        if low > high {
            (low, high) = if axis.log { (1.0, 10.0) } else { (0.0, 1.0) };
        }
        let mut between = 0.0;
        if axis.log {
            // The smallest and the largest numbers have no rounder neighbours.
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
            // The difference of the greatest numbers is none.
            (low, high) = (low.max(f64::MIN), high.min(f64::MAX));
            between = step((high / 2.0 - low / 2.0) / 3.0);
            (low, high) = ((low / between).floor() * between, (high / between).ceil() * between);
            (low, high) = (low.max(f64::MIN), high.min(f64::MAX));
        }
        Scale { log: axis.log, step: between, low, high, from, to }
    }

    pub(super) fn place(&self, number: f64) -> Option<f64> {
        let share = match self.log {
            // Smaller numbers have fewer digits, and the smallest no decade.
            true if number >= f64::MIN_POSITIVE => self.above_low(number) / self.above_low(self.high),
            true => return None,
            false => (number / 2.0 - self.low / 2.0) / (self.high / 2.0 - self.low / 2.0),
        };
        share.is_finite().then_some(self.from + share * (self.to - self.from))
    }

    /// The logarithm of a number over the lowest; the ratio of the greatest to the smallest number
    /// is none.
    fn above_low(&self, number: f64) -> f64 {
        let ratio = number / self.low;
        if ratio.is_finite() { ratio.ln() } else { number.ln() - self.low.ln() }
    }

    pub(super) fn ticks(&self) -> Vec<(f64, String)> {
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

/// Decades that have a tick each.
const MOST_DECADES: usize = 40;

/// First digits of the ends of a logarithmic axis.
const ROUND_DIGITS: [f64; 3] = [1.0, 2.0, 5.0];

/// The largest 1, 2 or 5 times a power of ten that is at most this.
fn round_below(number: f64) -> f64 {
    let decade = 10f64.powf(number.log10().floor());
    let digit = ROUND_DIGITS.into_iter().rev().find(|digit| digit * decade / 1.000_001 <= number);
    digit.unwrap_or(1.0) * decade
}

/// The smallest that is at least this.
fn round_above(number: f64) -> f64 {
    let decade = 10f64.powf(number.log10().floor());
    let digit = ROUND_DIGITS.into_iter().find(|digit| digit * decade >= number * 0.999_999);
    digit.unwrap_or(10.0) * decade
}

/// The round step next above this.
fn step(rough: f64) -> f64 {
    let decade = 10f64.powf(rough.log10().floor());
    let digit = rough / decade;
    decade
        * if digit > 5.0 {
            10.0
        } else if digit > 2.0 {
            5.0
        } else if digit > 1.0 {
            2.0
        } else {
            1.0
        }
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

fn path(points: &[(f64, f64)]) -> String {
    points.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect::<Vec<_>>().join(" ")
}

pub(super) fn text_at(out: &mut String, x: f64, y: f64, anchor: &str, text: &str) {
    _ = writeln!(out, r#"<text x="{x:.1}" y="{y:.1}" text-anchor="{anchor}">{}</text>"#, markup(text));
}

fn small(out: &mut String, x: f64, y: f64, text: &str) {
    _ = writeln!(out, r#"<text x="{x:.1}" y="{y:.1}" font-size="9">{}</text>"#, markup(text));
}

/// How a series is drawn, for the legend.
#[derive(Debug, Clone, Copy)]
pub(super) enum Mark {
    /// Filled.
    Area,
    /// A line with these dashes.
    Line(&'static str),
    /// Points.
    Dot,
}

pub(super) fn legend(out: &mut String, index: usize, (colour, mark): (&str, Mark), name: &str) {
    let y = TOP + 8.0 + 18.0 * index as f64;
    let x = WIDTH - RIGHT + 14.0;
    let middle = y - 4.0;
    _ = match mark {
        Mark::Area => writeln!(out, r#"<rect x="{x:.1}" y="{:.1}" width="12" height="10" fill="{colour}"/>"#, y - 9.0),
        Mark::Line(dash) => writeln!(
            out,
            r#"<line x1="{:.1}" y1="{middle:.1}" x2="{:.1}" y2="{middle:.1}" stroke="{colour}" stroke-width="2" stroke-dasharray="{dash}"/>"#,
            x - 10.0,
            x + 14.0
        ),
        Mark::Dot => writeln!(out, r#"<circle cx="{:.1}" cy="{middle:.1}" r="4" fill="{colour}"/>"#, x + 6.0),
    };
    text_at(out, x + 18.0, y, "start", name);
}

pub(super) fn frame(title: &str, x: &str, y: &str) -> String {
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" font-family=\"sans-serif\" \
         font-size=\"12\">\n<rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"white\"/>\n"
    );
    _ = writeln!(out, r#"<text x="{LEFT}" y="22" font-size="15">{}</text>"#, markup(title));
    text_at(&mut out, (LEFT + WIDTH - RIGHT) / 2.0, HEIGHT - 14.0, "middle", x);
    let middle = (TOP + HEIGHT - BOTTOM) / 2.0;
    _ = writeln!(
        out,
        r#"<text x="18" y="{middle:.1}" text-anchor="middle" transform="rotate(-90 18 {middle:.1})">{}</text>"#,
        markup(y)
    );
    out
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

    #[test]
    fn every_number_has_its_mark_and_words_are_escaped() {
        let line = Series::Line { name: "a<b".into(), points: vec![(0.0, 1.0), (1.0, 2.0)] };
        let points = Series::Points {
            name: "p".into(),
            points: vec![(0.2, 1.0, "x".into()), (0.1, 2.0, "y".into())],
            joined: true,
        };
        let svg = chart("t & u", &Axis::linear("x"), &Axis::linear("y"), &[line, points]);
        // Two points and the legend's.
        assert_eq!(svg.matches("<circle").count(), 3);
        assert_eq!(svg.matches("<polyline").count(), 2);
        assert!(svg.contains("a&lt;b") && svg.contains("t &amp; u") && svg.ends_with("</svg>\n"));
        let tower = |values: [f64; 2]| ("s".to_string(), values.to_vec());
        let svg = stacked("b", &Axis::linear("y"), &["c".into()], &[tower([30.0, 0.0]), tower([70.0, 0.0])]);
        let tops: Vec<f64> = svg
            .split("<rect x=\"")
            .skip(1)
            .take(2)
            .map(|rect| rect.split("height=\"").nth(1).unwrap().split('"').next().unwrap().parse().unwrap())
            .collect();
        // The second stands on the first: their heights are as 30 to 70.
        assert!((tops[1] / tops[0] - 70.0 / 30.0).abs() < 0.01, "{tops:?} {svg}");
        let svg = bars("b", &Axis::linear("y"), &["c".into(), "d".into()], &[("s".into(), vec![1.0, -2.0])]);
        assert_eq!(svg.matches("<rect").count(), 1 + 2 + 1);
    }

    #[test]
    fn words_do_not_lie_over_each_other_and_a_front_keeps_its_own() {
        let near = |label: &str| {
            vec![(1.0, 1.0, label.to_string()), (1.001, 1.001, label.to_string()), (9.0, 9.0, "far".into())]
        };
        let other = Series::Points { name: "others".into(), points: near("other"), joined: false };
        let front = Series::Points { name: "front".into(), points: near("best"), joined: true };
        let svg = chart("", &Axis::linear(""), &Axis::linear(""), &[front, other]);
        let words = svg.lines().filter(|line| line.contains("font-size=\"9\""));
        let words: Vec<(f64, f64, f64)> = words
            .map(|line| {
                let number = |name: &str| -> f64 {
                    line.split(&format!(" {name}=\"")).nth(1).unwrap().split('"').next().unwrap().parse().unwrap()
                };
                let text = line.split('>').nth(1).unwrap().split('<').next().unwrap();
                (number("x"), number("x") + 5.0 * text.len() as f64, number("y"))
            })
            .collect();
        for (index, a) in words.iter().enumerate() {
            let apart = |b: &(f64, f64, f64)| a.1 < b.0 || b.1 < a.0 || (a.2 - b.2).abs() > 8.0;
            assert!(words[..index].iter().all(apart), "{svg}");
        }
        assert_eq!((svg.matches(">best<").count(), svg.matches(">far<").count()), (2, 2), "{svg}");
        // The front is drawn last.
        assert!(svg.rfind(COLOURS[0]).unwrap() > svg.rfind(COLOURS[1]).unwrap());
    }

    #[test]
    fn nothing_and_one_number_still_make_a_chart() {
        assert!(chart("", &Axis::log(""), &Axis::linear(""), &[]).contains("svg"));
        let one = Series::Line { name: String::new(), points: vec![(3.0, 3.0)] };
        assert!(!chart("", &Axis::log(""), &Axis::linear(""), &[one]).contains("NaN"));
    }
}
