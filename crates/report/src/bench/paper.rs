//! The result of `nsim bench paper` as text, JSON, CSV and Markdown.

use serde_json::{Value, json};

use nsim_files::table::{Column, four, markdown_of, or_empty, table_of};
use nsim_study::published::cells::leads;
use nsim_study::published::paper::{PaperRow, TABLES};

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

/// What is said of a figure in CSV.
const KEYS: &str =
    "table,task,modality,loss,quantity,published,published_deviation,measured,deviation,low,high,shipped,note";

/// Every table that has rows, by its title.
fn sections(rows: &[PaperRow], section: impl Fn(&str, Vec<&PaperRow>) -> String) -> String {
    let of = |name: &str| rows.iter().filter(|row| row.table == name).collect::<Vec<_>>();
    let all = TABLES.iter().map(|(name, title)| (title, of(name))).filter(|(_, rows)| !rows.is_empty());
    all.map(|(title, rows)| section(title, rows)).collect()
}

/// `nsim.bench/1`.
pub fn json(rows: &[PaperRow]) -> Value {
    json!({ "schema": "nsim.bench/1", "name": "paper", "rows": rows })
}

/// A row a figure.
pub fn csv(rows: &[PaperRow]) -> String {
    nsim_files::table::csv(rows, KEYS)
}

/// Sections of a document.
pub fn markdown(rows: &[PaperRow]) -> String {
    sections(rows, |title, rows| format!("## {title}\n\n{}\n", markdown_of(rows, &COLUMNS)))
}

/// The tables alone.
pub fn tables(rows: &[PaperRow]) -> String {
    sections(rows, |title, rows| format!("{title}\n\n{}\n\n", table_of(rows, &COLUMNS, 5)))
}

/// For people.
pub fn text(rows: &[PaperRow]) -> String {
    let accuracies = || rows.iter().filter(|row| row.table == "accuracy");
    let have = accuracies().filter(|row| row.measured.is_some()).count();
    let mut out = format!(
        "{}{have} cells of the table of accuracies are measured, of scenes that were simulated unless the note says \
         otherwise\n",
        tables(rows)
    );
    let run: Vec<&PaperRow> = accuracies().filter(|row| row.shipped.is_some()).collect();
    if !run.is_empty() {
        let same = run.iter().filter(|row| row.folds.first().copied() == row.shipped).count();
        out += &format!(
            "{} shipped networks, the first fold of a cell each, ran on simulated cores: {same} came to what is \
             stored\n",
            run.len()
        );
    }
    leads(rows).into_iter().fold(out, |out, lead| out + &lead + "\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_study::published::paper::rows;

    #[test]
    fn every_form_has_every_table() {
        let rows = rows(Vec::new()).unwrap();
        for key in KEYS.split(',').filter(|key| *key != "shipped") {
            assert!(json(&rows)["rows"][0].get(key).is_some(), "{key}");
        }
        assert_eq!(csv(&rows).lines().count(), rows.len() + 1);
        let (text, markdown) = (text(&rows), markdown(&rows));
        assert!(TABLES.iter().all(|(_, title)| text.contains(title) && markdown.contains(title)), "{text}");
    }
}
