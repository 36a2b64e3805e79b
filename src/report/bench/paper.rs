//! The result of `nsim bench paper` as text, JSON, CSV and Markdown.

use serde_json::{Value, json};

use crate::bench::published::paper::{PaperRow, TABLES};
use crate::report::text::{Column, csv_of, four, markdown_of, or_empty, table_of};

/// Everything that the report says.
#[derive(Debug)]
pub struct PaperReport<'a> {
    /// The rows, table by table.
    pub rows: &'a [PaperRow],
}

fn figure(value: Option<f64>) -> String {
    or_empty(value.map(|x| if x.abs() < 10.0 { four(x) } else { format!("{x:.1}") }))
}

const COLUMNS: [Column<PaperRow>; 9] = [
    ("task", |row| row.task.clone()),
    ("modality", |row| row.modality.clone()),
    ("loss", |row| row.loss.clone().unwrap_or_default()),
    ("quantity", |row| row.quantity.clone()),
    ("note", |row| row.note.clone()),
    ("published", |row| figure(row.published)),
    ("sd", |row| figure(row.published_deviation)),
    ("measured", |row| figure(row.measured)),
    ("sd", |row| figure(row.deviation)),
];

/// What a table shows.
fn title(table: &str) -> &'static str {
    match table {
        "accuracy" => "Accuracy over the whole sample",
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
        rows.extend(
            self.rows
                .iter()
                .map(|row| (row, [row.published, row.published_deviation, row.measured, row.deviation].map(number))),
        );
        let columns: [Column<(&PaperRow, [String; 4])>; 10] = [
            ("table", |(row, _)| row.table.clone()),
            ("task", |(row, _)| row.task.clone()),
            ("modality", |(row, _)| row.modality.clone()),
            ("loss", |(row, _)| row.loss.clone().unwrap_or_default()),
            ("quantity", |(row, _)| row.quantity.clone()),
            ("published", |(_, n)| n[0].clone()),
            ("published_deviation", |(_, n)| n[1].clone()),
            ("measured", |(_, n)| n[2].clone()),
            ("deviation", |(_, n)| n[3].clone()),
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
        let have = self.rows_of("accuracy").iter().filter(|row| row.measured.is_some()).count();
        let tables = self.tables();
        format!(
            "{tables}{have} cells of the table of accuracies are measured, of scenes that were simulated unless the note says otherwise\n"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::published::paper::rows;

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
