//! The result of `nsim bench paper` as text, JSON and CSV.

use serde_json::{Value, json};

use nsim_files::table::{table, wrapped};
use nsim_study::published::cells::leads;
use nsim_study::published::paper::{PaperRow, TABLES};

/// Ends of an interval.
fn interval(row: &PaperRow) -> String {
    match (row.low, row.high) {
        (Some(low), Some(high)) => format!("{low:.3}..{high:.3}"),
        _ => String::new(),
    }
}

/// A mean with its deviation, where there is one.
fn mean(mean: Option<f64>, deviation: Option<f64>) -> String {
    let digits = |x: f64| if x.abs() < 10.0 { format!("{x:.3}") } else { format!("{x:.1}") };
    let deviation = deviation.map_or(String::new(), |deviation| format!("\u{b1}{}", digits(deviation)));
    mean.map_or(String::new(), |mean| digits(mean) + &deviation)
}

/// What is said of a figure in CSV.
const KEYS: &str =
    "table,task,modality,loss,quantity,published,published_deviation,measured,deviation,low,high,shipped,note";

/// `nsim.bench/1`.
pub fn json(rows: &[PaperRow]) -> Value {
    json!({ "schema": "nsim.bench/1", "name": "paper", "rows": rows })
}

/// A row a figure.
pub fn csv(rows: &[PaperRow]) -> String {
    nsim_files::table::csv(rows, KEYS)
}

/// The tables alone, those that have rows.
pub fn tables(rows: &[PaperRow]) -> String {
    let of = |name: &str| rows.iter().filter(|row| row.table == name).collect::<Vec<_>>();
    let all = TABLES.iter().map(|(name, title)| (title, of(name))).filter(|(_, rows)| !rows.is_empty());
    all.map(|(title, rows)| format!("{title}\n\n{}\n", table_with_notes(&rows))).collect()
}

/// A table, and its notes by their numbers.
fn table_with_notes(rows: &[&PaperRow]) -> String {
    let (mut notes, mut lines): (Vec<&str>, Vec<Vec<String>>) = Default::default();
    for row in rows {
        let known = notes.iter().position(|note| *note == row.note);
        let note = known.unwrap_or_else(|| {
            notes.push(&row.note);
            notes.len() - 1
        });
        let cell = format!("{} {} {}", row.task, row.modality, row.loss.as_deref().unwrap_or_default());
        let figures = [mean(row.published, row.published_deviation), mean(row.measured, row.deviation), interval(row)];
        let note = if row.note.is_empty() { String::new() } else { (note + 1).to_string() };
        lines.push([cell, row.quantity.clone()].into_iter().chain(figures).chain([note]).collect());
    }
    let mut out = table(&["cell", "quantity", "published", "measured", "95 % interval", "note"], &lines);
    for (number, note) in (1..).zip(notes).filter(|(_, note)| !note.is_empty()) {
        out += &wrapped(&format!("{number}: {note}"));
    }
    out
}

/// For people.
pub fn text(rows: &[PaperRow]) -> String {
    let accuracies = || rows.iter().filter(|row| row.table == "accuracy");
    let have = accuracies().filter(|row| row.measured.is_some()).count();
    let mut out = tables(rows);
    out += &wrapped(&format!(
        "{have} cells of the table of accuracies are measured, of scenes that were simulated unless the note says \
         otherwise"
    ));
    let run: Vec<&PaperRow> = accuracies().filter(|row| row.shipped.is_some()).collect();
    if !run.is_empty() {
        let same = run.iter().filter(|row| row.folds.first().copied() == row.shipped).count();
        out += &wrapped(&format!(
            "{} shipped networks, the first fold of a cell each, ran on simulated cores: {same} came to what is stored",
            run.len()
        ));
    }
    leads(rows).into_iter().fold(out, |out, lead| out + &wrapped(&lead))
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
        let text = text(&rows);
        assert!(TABLES.iter().all(|(_, title)| text.contains(title)), "{text}");
    }
}
