//! The result of `nsim bench published` as text, JSON, CSV and SVG.

use serde_json::{Value, json};

use crate::bench::published::{Held, PublishedRow, held};
use crate::report::charts::plot::{self, Axis, Series};
use crate::report::text::{Column, csv_of, table_of};

/// Everything that the report says.
#[derive(Debug)]
pub struct PublishedReport<'a> {
    /// The rows, each figure by all evidence and without its work.
    pub rows: &'a [PublishedRow],
}

/// Three digits: no constant is known better.
fn three(x: f64) -> String {
    let decimals = (2 - x.abs().log10().floor() as i32).clamp(0, 6) as usize;
    if x == 0.0 { "0".to_string() } else { format!("{x:.decimals$}") }
}

fn percent(x: f64) -> String {
    format!("{:.0} %", 100.0 * x)
}

const COLUMNS: [Column<PublishedRow>; 9] = [
    ("workload", |row| format!("{}{}", row.workload, if row.first_hand { "" } else { " (second-hand)" })),
    ("quantity", |row| format!("{}, {}", row.quantity.name(), row.quantity.unit())),
    ("published", |row| three(row.published)),
    ("predicted", |row| three(row.predicted.value)),
    ("low", |row| three(row.predicted.low)),
    ("high", |row| three(row.predicted.high)),
    ("ratio", |row| format!("{:.2}", row.ratio())),
    ("accounting", |row| row.accounting.name().to_string()),
    ("activity", |row| row.activity.name().to_string()),
];

impl PublishedReport<'_> {
    /// `nsim.bench/1`.
    #[must_use]
    pub fn json(&self) -> Value {
        let row = |row: &PublishedRow| {
            json!({
                "work": row.work,
                "workload": row.workload,
                "quantity": row.quantity.name(),
                "kind": row.quantity.kind(),
                "unit": row.quantity.unit(),
                "published": row.published,
                "predicted": row.predicted.value,
                "low": row.predicted.low,
                "high": row.predicted.high,
                "left_out": row.left_out,
                "first_hand": row.first_hand,
                "accounting": row.accounting,
                "activity": row.activity,
                "source": row.source,
                "cause": row.cause,
            })
        };
        json!({ "schema": "nsim.bench/1", "name": "published", "rows": self.rows.iter().map(row).collect::<Vec<_>>() })
    }

    /// A row a figure.
    ///
    /// # Errors
    /// Never in practice: the rows are built in memory.
    pub fn csv(&self) -> Result<String, csv::Error> {
        let columns: [Column<PublishedRow>; 14] = [
            ("work", |row| row.work.clone()),
            ("workload", |row| row.workload.clone()),
            ("quantity", |row| row.quantity.name().to_string()),
            ("kind", |row| row.quantity.kind().name().to_string()),
            ("unit", |row| row.quantity.unit().to_string()),
            ("published", |row| row.published.to_string()),
            ("predicted", |row| row.predicted.value.to_string()),
            ("low", |row| row.predicted.low.to_string()),
            ("high", |row| row.predicted.high.to_string()),
            ("left_out", |row| row.left_out.to_string()),
            ("accounting", |row| row.accounting.name().to_string()),
            ("source", |row| row.source.clone()),
            ("first_hand", |row| row.first_hand.to_string()),
            ("cause", |row| row.cause.clone().unwrap_or_default()),
        ];
        csv_of(self.rows, &columns)
    }

    fn of_kind(&self, left_out: bool) -> impl Iterator<Item = &PublishedRow> {
        self.rows.iter().filter(move |row| row.left_out == left_out)
    }

    /// For people.
    #[must_use]
    pub fn text(&self) -> String {
        let mut out = format!(
            "predicted by all evidence\n\n{}\n\nwithout what is known from the work itself\n\n{}\n",
            table_of(self.of_kind(false), &COLUMNS, 2),
            table_of(self.of_kind(true), &COLUMNS, 2)
        );
        if let Some(held) = held(self.rows, true) {
            out += &format!("\n{}\n", summary(&held));
        }
        if let Some(Held { energy_error, time_error, far, .. }) = held(self.rows, false) {
            out += &format!(
                "by all evidence, its own included: {} and {}; {far} are off by more than 2.5 times\n",
                error(energy_error),
                error(time_error)
            );
        }
        for row in self.of_kind(true) {
            if let Some(cause) = row.cause.as_ref().filter(|_| !(0.4..=2.5).contains(&row.ratio())) {
                out += &format!("  {}, {}: {cause}\n", row.workload, row.quantity.name());
            }
        }
        out
    }

    /// Published against predicted, with intervals and the line on which they are equal.
    #[must_use]
    pub fn svg(&self) -> String {
        let own: Vec<&PublishedRow> = self.of_kind(true).filter(|row| row.published > 0.0).collect();
        let ends = own.iter().map(|row| row.published);
        let (low, high) = ends.fold((f64::INFINITY, 0.0), |(low, high): (f64, f64), x| (low.min(x), high.max(x)));
        let equal = vec![(low, low), (high, high)];
        let mut series = vec![Series::Line { name: "equal".to_string(), points: equal, band: Vec::new() }];
        series.push(Series::Intervals {
            name: "90 % interval".to_string(),
            points: own.iter().map(|row| (row.published, row.predicted.low, row.predicted.high)).collect(),
        });
        series.push(Series::Points {
            name: "predicted, its work left out".to_string(),
            points: own.iter().map(|row| (row.published, row.predicted.value, String::new())).collect(),
            joined: false,
        });
        plot::chart("published and predicted (mW, us, nJ)", &Axis::log("published"), &Axis::log("predicted"), &series)
    }
}

fn error(error: Option<f64>) -> String {
    error.map_or("none".to_string(), percent)
}

/// How well the predictions held, in a line or two.
fn summary(held: &Held) -> String {
    format!(
        "{} figures of {} works, each without its own work: median error {} of energies and powers, {} of times;\n{} lie in \
         their intervals, whose median width is a factor of {:.2}; {} are off by more than 2.5 times",
        held.figures,
        held.works,
        error(held.energy_error),
        error(held.time_error),
        percent(held.inside),
        held.width,
        held.far
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::published::predict::Predicted;
    use crate::desc::published::workload::{Accounting, Quantity};
    use crate::desc::target::constants::Status;

    fn row(left_out: bool, published: f64) -> PublishedRow {
        PublishedRow {
            work: "w".to_string(),
            workload: "w-1".to_string(),
            quantity: Quantity::StepTime,
            published,
            predicted: Predicted { value: 10.0, low: 5.0, high: 20.0 },
            left_out,
            first_hand: true,
            accounting: Accounting::Profiler,
            activity: Status::Assumed,
            source: "s".to_string(),
            cause: Some("slow host".to_string()),
        }
    }

    #[test]
    fn json_has_the_keys_of_the_contract() {
        let json = PublishedReport { rows: &[row(true, 8.0)] }.json();
        for key in [
            "work",
            "workload",
            "quantity",
            "kind",
            "unit",
            "published",
            "predicted",
            "low",
            "high",
            "left_out",
            "accounting",
            "source",
            "cause",
        ] {
            assert!(json["rows"][0].get(key).is_some(), "{key}");
        }
        assert_eq!((&json["rows"][0]["kind"], &json["rows"][0]["accounting"]), (&json!("time"), &json!("profiler")));
    }

    #[test]
    fn the_text_counts_what_was_left_out_and_names_causes_of_what_is_far_off() {
        let rows = [row(false, 8.0), row(true, 8.0), row(true, 40.0)];
        let text = PublishedReport { rows: &rows }.text();
        assert!(text.contains("2 figures of 1 works"), "{text}");
        assert!(text.contains("median error none of energies and powers, 50 % of times"), "{text}");
        assert!(text.contains("50 % lie in"), "{text}");
        assert!(text.contains("w-1, step time: slow host"), "{text}");
        assert_eq!(three(0.012_345), "0.0123");
        assert_eq!(three(1234.5), "1234");
    }
}
