//! The result of `nsim bench published` as text, JSON, CSV and SVG.

use serde_json::{Value, json};

use crate::charts::draw::Axis;
use crate::charts::plot::{self, Series};
use nsim_files::table::{table, three, wrapped};
use nsim_study::published::{PublishedRow, factors_by_work, geometric_mean};

/// Factor above which the report gives the cause of a deviation.
const FAR: f64 = 1.5;

fn end(row: &PublishedRow, of: fn((f64, f64)) -> f64) -> String {
    row.interval.map_or_else(|| "-".to_string(), |interval| three(of(interval)))
}

/// A table of rows, grouped by workload.
fn rows_table<'r>(rows: impl Iterator<Item = &'r PublishedRow>) -> String {
    let (mut lines, mut last) = (Vec::new(), "");
    for row in rows {
        if std::mem::replace(&mut last, &row.workload) != row.workload {
            lines.push([&row.workload, "", "", "", "", ""].map(str::to_string).to_vec());
        }
        let ratio = format!("{:.2}", row.predicted / row.published);
        let figures = [three(row.published), three(row.predicted), end(row, |ends| ends.0), end(row, |ends| ends.1)];
        let quantity = format!("  {}, {}", row.quantity.name(), row.quantity.unit());
        lines.push(std::iter::once(quantity).chain(figures).chain([ratio]).collect());
    }
    table(&["workload", "printed", "predicted", "low", "high", "ratio"], &lines)
}

/// Keys of a figure in CSV.
const KEYS: &str = "work,workload,chip,quantity,kind,unit,published,predicted,low,high,left_out,judged,accounting,source,\
                    first_hand,cause";

/// `nsim.bench/1`.
pub fn json(rows: &[PublishedRow]) -> Value {
    fn row(row: &PublishedRow) -> Value {
        json!({
            "work": row.work, "workload": row.workload, "chip": row.chip, "quantity": row.quantity.name(),
            "kind": row.quantity.kind(), "unit": row.quantity.unit(), "published": row.published,
            "predicted": row.predicted, "low": row.interval.map(|interval| interval.0),
            "high": row.interval.map(|interval| interval.1), "left_out": row.left_out, "judged": row.judged,
            "first_hand": row.first_hand, "accounting": row.quantity.accounting(), "activity": row.activity,
            "assumed": row.assumed, "source": row.source, "cause": row.cause,
        })
    }
    json!({ "schema": "nsim.bench/1", "name": "published", "rows": rows.iter().map(row).collect::<Vec<_>>() })
}

/// CSV with a row for each figure.
pub fn csv(rows: &[PublishedRow]) -> String {
    nsim_files::table::csv(json(rows)["rows"].as_array().into_iter().flatten(), KEYS)
}

fn rows_with_omission(rows: &[PublishedRow], left_out: bool) -> impl Iterator<Item = &PublishedRow> {
    rows.iter().filter(move |row| row.left_out == left_out)
}

/// Chips with rows that exclude a work's own results, in order.
fn chips(rows: &[PublishedRow]) -> Vec<&str> {
    let mut chips: Vec<&str> = Vec::new();
    for row in rows_with_omission(rows, true) {
        if !chips.contains(&row.chip.as_str()) {
            chips.push(&row.chip);
        }
    }
    chips
}

/// The result as text.
pub fn text(rows: &[PublishedRow]) -> String {
    let mut out = String::new();
    let chips = chips(rows);
    for chip in &chips {
        let of_chip = rows_table(rows_with_omission(rows, true).filter(|row| row.chip == *chip));
        let gap = if out.is_empty() { "" } else { "\n" };
        out += &format!("{gap}on {chip}, predicted without results of a work's own authors\n\n{of_chip}");
    }
    let second_hand = || rows.iter().filter(|row| !row.first_hand);
    if second_hand().next().is_some() {
        out += &format!("\npublished values known second-hand\n\n{}", rows_table(second_hand()));
    }
    let without: Vec<&PublishedRow> = rows_with_omission(rows, true).filter(|row| row.interval.is_none()).collect();
    if without.iter().any(|row| row.quantity.class().is_some()) {
        out += "\n-: no interval, because the error of a changed constant is unknown (--set)\n";
    } else if !without.is_empty() {
        out += "\n-: no interval, because too few works print such figures\n";
    }
    let kinds = [(false, "power and energy"), (true, "time")];
    for (chip, (time, name)) in chips.iter().flat_map(|chip| kinds.map(|kind| (chip, kind))) {
        let by_work = factors_by_work(rows, chip, time);
        let (Some(mean), Some(worst)) =
            (geometric_mean(by_work.values().copied()), by_work.values().copied().reduce(f64::max))
        else {
            continue;
        };
        out.push('\n');
        out += &wrapped(&format!(
            "{name} on {chip}, median factor of each of {} works: mean {mean:.2}, worst {worst:.2}",
            by_work.len()
        ));
        let works = by_work.iter().map(|(work, factor)| format!("{work} {factor:.2}")).collect::<Vec<_>>();
        out += &wrapped(&works.join(", "));
    }
    let mut said: Vec<&str> = Vec::new();
    for row in rows_with_omission(rows, true).filter(|row| row.factor() > FAR) {
        if let Some(cause) = row.cause.as_deref().filter(|cause| !said.contains(cause)) {
            out += &wrapped(&format!("{}, {}: {cause}", row.workload, row.quantity.name()));
            said.push(cause);
        }
    }
    let mut last = "";
    for row in rows_with_omission(rows, true).filter(|row| !row.assumed.is_empty()) {
        if std::mem::replace(&mut last, &row.workload) != row.workload {
            out += &wrapped(&format!("{} assumes: {}", row.workload, row.assumed.join("; ")));
        }
    }
    if rows.iter().any(|row| row.work != rows[0].work) {
        out += "a single work: --only WORK, such as --only vt-snn\n";
    }
    out
}

/// SVG of published against predicted values, with intervals and the line of equality.
pub fn svg(rows: &[PublishedRow]) -> String {
    let own: Vec<&PublishedRow> = rows_with_omission(rows, true).filter(|row| row.published > 0.0).collect();
    let ends = own.iter().map(|row| row.published);
    let (low, high) = ends.fold((f64::INFINITY, 0.0), |(low, high): (f64, f64), x| (low.min(x), high.max(x)));
    let intervals = own.iter().filter_map(|row| Some((row.published, row.interval?.0, row.interval?.1)));
    let points = own.iter().map(|row| (row.published, row.predicted, String::new()));
    let series = [
        Series::Line("equal".to_string(), vec![(low, low), (high, high)]),
        Series::Intervals("80 % interval".to_string(), intervals.collect()),
        Series::Points("predicted without results of the authors".to_string(), points.collect()),
    ];
    plot::chart("published and predicted (mW, us, nJ)", &Axis::log("published"), &Axis::log("predicted"), &series)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_energy::published::workload::Quantity;
    use nsim_ir::hardware::constants::Status;

    fn row(left_out: bool, published: f64) -> PublishedRow {
        PublishedRow {
            work: "w".to_string(),
            workload: "w-1".to_string(),
            chip: "c".to_string(),
            quantity: Quantity::StepTime,
            published,
            predicted: 10.0,
            interval: Some((5.0, 20.0)),
            left_out,
            judged: left_out,
            first_hand: true,
            activity: Status::Assumed,
            assumed: vec!["rates".to_string()],
            source: "s".to_string(),
            cause: Some("slow host".to_string()),
        }
    }

    #[test]
    fn json_has_the_keys_of_the_contract() {
        let json = json(&[row(true, 8.0)]);
        assert_eq!((&json["rows"][0]["kind"], &json["rows"][0]["accounting"]), (&json!("time"), &json!("profiler")));
        assert_eq!(csv(&[row(true, 8.0)]).lines().count(), 2);
    }

    #[test]
    fn a_row_that_judges_nothing_is_in_the_table_of_its_chip_and_in_no_average() {
        let other = PublishedRow { chip: "d".to_string(), workload: "other".to_string(), ..row(true, 80.0) };
        let unknown = PublishedRow { judged: false, ..other.clone() };
        let text = text(&[row(false, 8.0), row(true, 8.0), PublishedRow { published: 10.0, ..other }, unknown]);
        let (_, rest) = text.split_once("on d, predicted without results of a work's own authors").unwrap();
        assert!(rest.contains("time on c, median factor of each of 1 works: mean 1.25, worst 1.25"), "{text}");
        assert!(
            rest.contains("80") && rest.contains("time on d, median factor of each of 1 works: mean 1.00"),
            "{text}"
        );
    }

    #[test]
    fn the_text_counts_what_was_left_out_and_names_causes_of_what_is_far_off() {
        let rows = [row(false, 8.0), row(true, 8.0), row(true, 40.0)];
        let text = text(&rows);
        // 1.25 and 4: their median is 2.24.
        assert!(text.contains("time on c, median factor of each of 1 works: mean 2.24, worst 2.24"), "{text}");
        assert!(text.contains("w-1, step time: slow host") && text.contains("w-1 assumes: rates"), "{text}");
    }
}
