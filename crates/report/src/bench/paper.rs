//! The result of `nsim bench paper` as text, JSON, CSV and Markdown.

use serde_json::{Value, json};

use nsim_files::table::{Column, csv_of, four, markdown_of, or_empty, table_of};
use nsim_study::published::cells::leads;
use nsim_study::published::paper::{PaperRow, TABLES};

/// Everything that the report says.
#[derive(Debug)]
pub struct PaperReport<'a> {
    /// The rows, table by table.
    pub rows: &'a [PaperRow],
}

fn figure(value: Option<f64>) -> String {
    or_empty(value.map(|x| if x.abs() < 10.0 { four(x) } else { format!("{x:.1}") }))
}

/// Ends of an interval.
fn interval(row: &PaperRow) -> String {
    match (row.low, row.high) {
        (Some(low), Some(high)) => format!("{low:.3}..{high:.3}"),
        _ => String::new(),
    }
}

const COLUMNS: [Column<PaperRow>; 10] = [
    ("task", |row| row.task.clone()),
    ("modality", |row| row.modality.clone()),
    ("loss", |row| row.loss.clone().unwrap_or_default()),
    ("quantity", |row| row.quantity.clone()),
    ("note", |row| row.note.clone()),
    ("published", |row| figure(row.published)),
    ("sd", |row| figure(row.published_deviation)),
    ("measured", |row| figure(row.measured)),
    ("sd", |row| figure(row.deviation)),
    ("95 % interval", interval),
];

/// What a table shows.
fn title(table: &str) -> &'static str {
    match table {
        "accuracy" => "Accuracy over the whole sample, neurons of the chip",
        "srm" => "Accuracy with spike-response neurons, whole and by time",
        "ann" => "Networks without spikes",
        "early" => "Early decisions",
        "offline" => "Hardware, as fast as possible",
        _ => "Hardware, in real time",
    }
}

impl PaperReport<'_> {
    fn rows_of(&self, table: &str) -> Vec<&PaperRow> {
        self.rows.iter().filter(|row| row.table == table).collect()
    }

    /// `nsim.bench/1`.
    #[must_use]
    pub fn json(&self) -> Value {
        json!({ "schema": "nsim.bench/1", "name": "paper", "rows": self.rows })
    }

    /// A row a figure.
    ///
    /// # Errors
    /// Never in practice: the rows are built in memory.
    pub fn csv(&self) -> Result<String, csv::Error> {
        let number = |x: Option<f64>| or_empty(x.map(|x| x.to_string()));
        let mut rows = Vec::with_capacity(self.rows.len());
        rows.extend(self.rows.iter().map(|row| {
            let PaperRow { published, published_deviation, measured, deviation, low, high, shipped, .. } = row;
            let figures = [published, published_deviation, measured, deviation, low, high, shipped];
            (row, figures.map(|figure| number(*figure)))
        }));
        let columns: [Column<(&PaperRow, [String; 7])>; 13] = [
            ("table", |(row, _)| row.table.clone()),
            ("task", |(row, _)| row.task.clone()),
            ("modality", |(row, _)| row.modality.clone()),
            ("loss", |(row, _)| row.loss.clone().unwrap_or_default()),
            ("quantity", |(row, _)| row.quantity.clone()),
            ("published", |(_, n)| n[0].clone()),
            ("published_deviation", |(_, n)| n[1].clone()),
            ("measured", |(_, n)| n[2].clone()),
            ("deviation", |(_, n)| n[3].clone()),
            ("low", |(_, n)| n[4].clone()),
            ("high", |(_, n)| n[5].clone()),
            ("shipped", |(_, n)| n[6].clone()),
            ("note", |(row, _)| row.note.clone()),
        ];
        csv_of(&rows, &columns)
    }

    /// Sections of a document.
    #[must_use]
    pub fn markdown(&self) -> String {
        let section = |table: &&str| {
            let rows = self.rows_of(table);
            (!rows.is_empty()).then(|| format!("## {}\n\n{}\n", title(table), markdown_of(rows, &COLUMNS)))
        };
        TABLES.iter().filter_map(section).collect()
    }

    /// The tables alone.
    #[must_use]
    pub fn tables(&self) -> String {
        let section = |table: &&str| {
            let rows = self.rows_of(table);
            (!rows.is_empty()).then(|| format!("{}\n\n{}\n\n", title(table), table_of(rows, &COLUMNS, 5)))
        };
        TABLES.iter().filter_map(section).collect()
    }

    /// For people.
    #[must_use]
    pub fn text(&self) -> String {
        let accuracies = self.rows_of("accuracy");
        let have = accuracies.iter().filter(|row| row.measured.is_some()).count();
        let mut out = self.tables();
        let said = "cells of the table of accuracies are measured, of scenes that were simulated unless the note says \
                    otherwise";
        out += &format!("{have} {said}\n");
        let run: Vec<_> = accuracies.iter().filter_map(|row| Some((row, row.shipped?))).collect();
        if !run.is_empty() {
            let as_stored = |(row, shipped): &&(&&PaperRow, f64)| row.folds.first() == Some(shipped);
            let same = run.iter().filter(as_stored).count();
            let all = run.len();
            out += &format!(
                "{all} shipped networks, the first fold of a cell each, ran on simulated cores: {same} came to what \
                 is stored\n"
            );
        }
        for lead in leads(self.rows) {
            out += &format!("{lead}\n");
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_study::published::paper::rows;

    #[test]
    fn every_form_has_every_table() {
        let rows = rows(Vec::new()).unwrap();
        let report = PaperReport { rows: &rows };
        let json = report.json();
        assert_eq!((&json["schema"], &json["name"]), (&json!("nsim.bench/1"), &json!("paper")));
        for key in ["table", "task", "modality", "loss", "quantity", "published", "measured", "deviation", "note"] {
            assert!(json["rows"][0].get(key).is_some(), "{key}");
        }
        assert_eq!(report.csv().unwrap().lines().count(), rows.len() + 1);
        let (text, markdown) = (report.text(), report.markdown());
        for table in ["accuracy", "ann", "offline", "realtime"] {
            assert!(text.contains(title(table)) && markdown.contains(title(table)), "{table}");
        }
    }
}
