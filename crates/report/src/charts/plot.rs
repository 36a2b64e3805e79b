//! Charts as SVG: lines, scattered points with a front, bars.
//!
//! Input: named series of finite numbers. Output: one SVG text, the same for the same numbers.
//! Series differ in dashes or marks as well as in colour.

use std::fmt::Write as _;

use super::draw::{
    Axis, BOTTOM, COLOURS, END, LEFT, MIDDLE, Mark, RIGHT, SMALL, Scale, Sheet, TOP, WIDTH, filled, stroked,
};

use nsim_files::table::three;

const DASHES: [&str; 4] = ["", "7 3", "2 3", "9 3 2 3"];

/// A series of a chart, under its name in the legend.
#[derive(Debug, Clone, PartialEq)]
pub enum Series {
    /// A line through points (x, y) in order of x.
    Line(String, Vec<(f64, f64)>),
    /// Single points: x, y and label.
    Points(String, Vec<(f64, f64, String)>),
    /// Points joined by steps; the best x is first.
    Front(String, Vec<(f64, f64, String)>),
    /// Vertical lines: x, low and high.
    Intervals(String, Vec<(f64, f64, f64)>),
}

/// A chart of lines and points.
pub fn chart(title: &str, x: &Axis, y: &Axis, series: &[Series]) -> String {
    let numbers: Vec<(f64, f64)> = series.iter().flat_map(extent).collect();
    let across = Scale::new(x, numbers.iter().map(|p| p.0), LEFT, RIGHT);
    let up = Scale::new(y, numbers.iter().map(|p| p.1), BOTTOM, TOP);
    let place = |x: f64, y: f64| Some((across.place(x)?, up.place(y)?));
    let mut sheet = Sheet::chart(title, &x.label, &y.label);
    sheet.ticks_across(&across, RIGHT, true);
    sheet.ticks_up(&up);
    // A front is drawn above the other points, and its labels are placed first.
    fn is_front(one: &Series) -> bool {
        matches!(one, Series::Front(..))
    }
    let mut order: Vec<(usize, &Series)> = series.iter().enumerate().collect();
    order.sort_by_key(|(_, one)| is_front(one));
    let mut labels = Vec::new();
    for (index, one) in order {
        let (colour, dash) = (COLOURS[index % COLOURS.len()], DASHES[index % DASHES.len()]);
        let (name, mark) = match one {
            Series::Line(name, points) => {
                let line: Vec<(f64, f64)> = points.iter().filter_map(|&(x, y)| place(x, y)).collect();
                sheet.through(&line, &stroked(colour, 2.0, dash));
                (name, Mark::Line(dash))
            }
            Series::Intervals(name, points) => {
                let mut path = String::new();
                for &(x, low, high) in points {
                    if let (Some((x, low)), Some(high)) = (place(x, low), up.place(high)) {
                        _ = write!(path, "M{x:.1} {low:.1}V{high:.1}");
                    }
                }
                sheet.path(&path, &(stroked(colour, 1.2, "") + r#" opacity="0.6""#));
                (name, Mark::Line(""))
            }
            Series::Points(name, points) | Series::Front(name, points) => {
                let placed = |(x, y, label): &'_ (f64, f64, String)| Some((place(*x, *y)?, label.clone()));
                let placed: Vec<((f64, f64), String)> = points.iter().filter_map(placed).collect();
                if is_front(one) {
                    let corners = placed.windows(2).flat_map(|pair| [(pair[1].0.0, pair[0].0.1), pair[1].0]);
                    let line: Vec<(f64, f64)> = placed.first().map(|p| p.0).into_iter().chain(corners).collect();
                    sheet.through(&line, &stroked(colour, 1.5, "5 3"));
                }
                for (at, label) in placed {
                    sheet.dot(at.0, at.1, colour);
                    labels.push((is_front(one), at.0, at.1, label));
                }
                (name, Mark::Dot)
            }
        };
        sheet.legend(index, colour, mark, name);
    }
    write_labels(&mut sheet, labels);
    sheet.svg()
}

/// Points on a front, joined, and dominated ones, each with its label; the best x is first.
pub fn front_series(points: impl Iterator<Item = ((f64, f64, String), bool)>) -> Vec<Series> {
    let (front, others): (Vec<_>, Vec<_>) = points.partition(|(_, on_front)| *on_front);
    let [front, others] = [front, others].map(|points| points.into_iter().map(|(point, _)| point).collect::<Vec<_>>());
    let behind = (!others.is_empty()).then(|| Series::Points("behind it".to_string(), others));
    std::iter::once(Series::Front("on the front".to_string(), front)).chain(behind).collect()
}

/// A chart of bars: one group a category, one bar a series in it.
pub fn bars(title: &str, y: &str, categories: &[String], series: &[(String, Vec<f64>)]) -> String {
    barred(title, y, categories, series, false)
}

/// A chart of stacked bars, one a category. Their numbers are not negative.
pub fn stacked(title: &str, y: &str, categories: &[String], series: &[(String, Vec<f64>)]) -> String {
    barred(title, y, categories, series, true)
}

/// Colour of a series; after the last one they repeat, half transparent.
fn colour(index: usize) -> String {
    let half = if index < COLOURS.len() { "" } else { "80" };
    format!("{}{half}", COLOURS[index % COLOURS.len()])
}

/// Writes the names of groups below the chart, line by line, and returns the width of a group.
fn name_groups(sheet: &mut Sheet, names: &[String]) -> f64 {
    let group = (RIGHT - LEFT) / names.len().max(1) as f64;
    let lines = || names.iter().flat_map(|name| name.lines());
    // Names are horizontal if all of them fit.
    let has_room = lines().all(|line| 6.2 * line.chars().count() as f64 <= group);
    for (place, name) in names.iter().enumerate() {
        for (number, line) in name.lines().enumerate() {
            let (x, y) = (LEFT + group * (place as f64 + 0.5), BOTTOM + 14.0 * (number + 1) as f64);
            let turned = format!(r#"{END} {SMALL} transform="rotate(-20 {x:.1} {y:.1})""#);
            sheet.text(x, y + if has_room { 4.0 } else { 0.0 }, if has_room { MIDDLE } else { &turned }, line);
        }
    }
    group
}

/// A number, and the ends of its interval, if known.
pub type Marked = (f64, Option<(f64, f64)>);

/// A chart with a row a category and a panel a series, each on its own logarithmic axis.
pub fn panels(title: &str, categories: &[String], series: &[(String, Vec<Option<Marked>>)]) -> String {
    let (left, wide, tall, top) = (215.0, 150.0, 38.0, TOP + 24.0);
    let bottom = top + tall * categories.len() as f64;
    let mut sheet = Sheet::new((left + (wide + 16.0) * series.len() as f64, bottom + 30.0), 14.0, title);
    let middle = |row: usize| top + tall * (row as f64 + 0.5);
    for (row, name) in categories.iter().enumerate() {
        for (number, line) in name.lines().enumerate() {
            sheet.text(left - 10.0, middle(row) + 2.0 + 13.0 * number as f64, END, line);
        }
    }
    for (index, (name, marks)) in series.iter().enumerate() {
        let (colour, from) = (colour(index), left + (wide + 16.0) * index as f64);
        let known = || marks.iter().enumerate().filter_map(|(row, mark)| Some((row, (*mark)?)));
        let ends = known().flat_map(|(_, (value, interval))| {
            let (low, high) = interval.unwrap_or((value, value));
            [low, value, high]
        });
        // The label of a point at an end stays within the panel.
        let across = Scale::new(&Axis::log(""), ends, from + 18.0, from + wide - 18.0);
        sheet.rect([from, top, wide, bottom - top], &stroked("#999", 1.0, ""));
        sheet.text(from + wide / 2.0, top - 8.0, MIDDLE, name);
        let mut last = f64::MIN;
        for (x, label) in across.ticks() {
            if x - last >= 34.0 {
                sheet.line([x, top, x, bottom], &stroked("#ddd", 1.0, ""));
                sheet.text(x, bottom + 14.0, &format!("{MIDDLE} {SMALL}"), &label);
                last = x;
            }
        }
        for (row, (value, interval)) in known() {
            let y = middle(row) + 4.0;
            if let Some([low, high]) = interval.and_then(|(low, high)| Some([across.place(low)?, across.place(high)?]))
            {
                sheet.line([low, y, high, y], &stroked(&colour, 2.0, ""));
            }
            if let Some(x) = across.place(value) {
                sheet.dot(x, y, &colour);
                sheet.text(x, y - 8.0, MIDDLE, &three(value));
            }
        }
    }
    sheet.svg()
}

fn barred(title: &str, y: &str, categories: &[String], series: &[(String, Vec<f64>)], stacked: bool) -> String {
    fn value(series: &(String, Vec<f64>), place: usize) -> f64 {
        series.1.get(place).copied().unwrap_or(0.0)
    }
    let tops: Vec<f64> = match stacked {
        true => (0..categories.len()).map(|place| series.iter().map(|one| value(one, place)).sum()).collect(),
        false => series.iter().flat_map(|(_, values)| values.iter().copied()).collect(),
    };
    let up = Scale::new(&Axis::linear(""), tops.into_iter().chain([0.0]), BOTTOM, TOP);
    let mut sheet = Sheet::chart(title, "", y);
    sheet.ticks_up(&up);
    let ground = up.place(0.0).unwrap_or(BOTTOM);
    let group = name_groups(&mut sheet, categories);
    let bar = group * 0.8 / if stacked { 1.0 } else { series.len().max(1) as f64 };
    for place in 0..categories.len() {
        let from = LEFT + group * (place as f64 + 0.1);
        let mut below = 0.0;
        for (index, one) in series.iter().enumerate().filter(|(_, one)| place < one.1.len()) {
            let (foot, upto) = if stacked { (below, below + value(one, place)) } else { (0.0, value(one, place)) };
            below = upto;
            let Some(top) = up.place(upto) else { continue };
            let foot = up.place(foot).unwrap_or(ground);
            let left = from + if stacked { 0.0 } else { bar * index as f64 };
            let size = [left, top.min(foot), (bar - 1.0).max(0.5), (top - foot).abs()];
            sheet.rect(size, &filled(&colour(index)));
        }
    }
    sheet.line([LEFT, ground, RIGHT, ground], &stroked("#333", 1.0, ""));
    for (index, (name, _)) in series.iter().enumerate() {
        sheet.legend(index, &colour(index), Mark::Area, name);
    }
    sheet.svg()
}

/// Writes labels next to points where there is room, a front's first; others are omitted.
fn write_labels(sheet: &mut Sheet, mut labels: Vec<(bool, f64, f64, String)>) {
    labels.sort_by_key(|(first, ..)| !first);
    // Left end, right end and middle height of each label and each point.
    let mut taken: Vec<(f64, f64, f64)> = labels.iter().map(|(_, x, y, _)| (x - 4.0, x + 4.0, *y)).collect();
    for (_, x, y, text) in labels {
        let wide = 5.0 * text.chars().count() as f64;
        let places = [(x + 6.0, y - 5.0), (x + 6.0, y + 5.0), (x - 6.0 - wide, y - 5.0), (x - 6.0 - wide, y + 5.0)];
        let upright = [(x - wide / 2.0, y - 9.0), (x - wide / 2.0, y + 10.0), (x + 7.0, y), (x - 7.0 - wide, y)];
        let free = |&(left, middle): &(f64, f64)| {
            left >= LEFT - 10.0
                && (TOP..BOTTOM - 2.0).contains(&middle)
                && left + wide <= WIDTH
                && taken.iter().all(|&(from, to, at)| left + wide < from || left > to || (middle - at).abs() > 8.5)
        };
        if let Some((left, middle)) = places.into_iter().chain(upright).find(free) {
            sheet.text(left, middle + 3.0, SMALL, &text);
            taken.push((left, left + wide, middle));
        }
    }
}

fn extent(series: &Series) -> Vec<(f64, f64)> {
    match series {
        Series::Line(_, points) => points.clone(),
        Series::Points(_, points) | Series::Front(_, points) => points.iter().map(|p| (p.0, p.1)).collect(),
        Series::Intervals(_, points) => points.iter().flat_map(|p| [(p.0, p.1), (p.0, p.2)]).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_has_its_mark_and_words_are_escaped() {
        let line = Series::Line("a<b".into(), vec![(0.0, 1.0), (1.0, 2.0)]);
        let points = Series::Front("p".into(), vec![(0.1, 2.0, "y".into()), (0.2, 1.0, "x".into())]);
        let svg = chart("t & u", &Axis::linear("x"), &Axis::linear("y"), &[line, points]);
        // Two points and the legend's.
        assert_eq!(svg.matches("<circle").count(), 3);
        assert_eq!(svg.matches("<polyline").count(), 2);
        assert!(svg.contains("a&lt;b") && svg.contains("t &amp; u") && svg.ends_with("</svg>\n"));
        let tower = |values: [f64; 2]| ("s".to_string(), values.to_vec());
        let svg = stacked("b", "y", &["c".into()], &[tower([30.0, 0.0]), tower([70.0, 0.0])]);
        let tops: Vec<f64> = svg
            .split("<rect x=\"")
            .skip(1)
            .take(2)
            .map(|rect| rect.split("height=\"").nth(1).unwrap().split('"').next().unwrap().parse().unwrap())
            .collect();
        // The second bar is above the first: their heights are as 30 to 70.
        assert!((tops[1] / tops[0] - 70.0 / 30.0).abs() < 0.01, "{tops:?} {svg}");
        let svg = bars("b", "y", &["c".into(), "d".into()], &[("s".into(), vec![1.0, -2.0])]);
        assert_eq!(svg.matches("<rect").count(), 1 + 2 + 1);
        let known = vec![Some((3.0, Some((1.0, 9.0)))), None];
        let svg = panels("m", &["c".into(), "d".into()], &[("s".into(), known)]);
        // A point with its value and its interval.
        assert!(svg.contains(">3.00<"), "{svg}");
        assert_eq!((svg.matches("<circle").count(), svg.matches("stroke-width=\"2.00\"").count()), (1, 1), "{svg}");
    }

    #[test]
    fn words_do_not_lie_over_each_other_and_a_front_keeps_its_own() {
        let near = |label: &str| {
            vec![(1.0, 1.0, label.to_string()), (1.001, 1.001, label.to_string()), (9.0, 9.0, "far".into())]
        };
        let other = Series::Points("others".into(), near("other"));
        let front = Series::Front("front".into(), near("best"));
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
        let one = Series::Line(String::new(), vec![(3.0, 3.0)]);
        assert!(!chart("", &Axis::log(""), &Axis::linear(""), &[one]).contains("NaN"));
    }
}
