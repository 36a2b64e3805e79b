//! The tables of the paper on visual and tactile sensing (Taunyazov et al., RSS 2020) next to
//! stored results.
//!
//! Input: files of rows from trainings, `{"rows": [..]}` each. Output: one row for each printed
//! figure and for each stored one, in the order of the tables. A printed figure without a
//! measurement has a note about it. Errors: `paper.results` for a file that cannot be read as rows.

use serde::{Deserialize, Serialize};

use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// Embedded results: name, text.
const STORED: &[(&str, &str)] = include!(concat!(env!("OUT_DIR"), "/paper_results.rs"));

/// One figure of a table.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PaperRow {
    /// `accuracy`, `srm`, `ann`, `early`, `offline` or `realtime`.
    pub table: String,
    /// `slip` or `container`.
    pub task: String,
    /// `tactile`, `vision` or `both`.
    pub modality: String,
    /// `count`, `weighted`, or none where no loss of spike counts is meant.
    pub loss: Option<String>,
    /// Name of the quantity, with its unit last.
    pub quantity: String,
    /// Value in the paper.
    pub published: Option<f64>,
    /// Value measured with nsim.
    pub measured: Option<f64>,
    /// Standard deviation of the measured value over the folds.
    pub deviation: Option<f64>,
    /// Lower end of the 95 % interval of the measured share, over all tested samples.
    pub low: Option<f64>,
    /// Upper end of this interval.
    pub high: Option<f64>,
    /// Measured values, fold by fold.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub folds: Vec<f64>,
    /// Result of the shipped network of the first fold, run now.
    pub shipped: Option<f64>,
    /// Standard deviation that the paper prints.
    pub published_deviation: Option<f64>,
    /// Network of a comparison, basis of the figure, or reason for its absence.
    #[serde(default)]
    pub note: String,
}

#[derive(Deserialize)]
struct Stored {
    rows: Vec<PaperRow>,
}

/// Rows of a file of results.
///
/// # Errors
/// `paper.results`.
pub fn parse(name: &str, text: &str) -> Result<Vec<PaperRow>> {
    let stored: std::result::Result<Stored, _> = serde_json::from_str(text);
    stored.map(|stored| stored.rows).map_err(|error| Diagnostic::new("paper.results", format!("{name}: {error}")))
}

/// A file of rows, one a line, that [`parse`] reads.
pub fn stored(provenance: &serde_json::Value, rows: &[PaperRow]) -> String {
    let lines: Vec<String> = rows.iter().map(|row| serde_json::json!(row).to_string()).collect();
    format!("{{\n\"provenance\": {provenance:#},\n\"rows\": [\n{}\n]\n}}\n", lines.join(",\n"))
}

/// Printed figures joined with the given and the stored ones.
///
/// # Errors
/// `paper.results` for a stored file that cannot be read.
pub fn rows(more: Vec<PaperRow>) -> Result<Vec<PaperRow>> {
    let (mut printed, mut measured) = (Vec::new(), more);
    for (name, text) in STORED {
        for row in parse(name, text)? {
            // Given rows are newer than stored ones.
            if row.published.is_some() {
                printed.push(row);
            } else if !measured.iter().any(|given| same(given, &row)) {
                measured.push(row);
            }
        }
    }
    let mut all = Vec::with_capacity(printed.len() + measured.len());
    for mut row in printed {
        match measured.iter().position(|found| same(found, &row)) {
            Some(at) => {
                let own_row = measured.remove(at);
                row = PaperRow { published: row.published, published_deviation: row.published_deviation, ..own_row };
            }
            None if row.note.is_empty() => row.note = "not measured".to_string(),
            None => row.note += "; not measured",
        }
        all.push(row);
    }
    all.append(&mut measured);
    all.sort_by_key(|row| TABLES.iter().position(|(table, _)| *table == row.table).unwrap_or(TABLES.len()));
    Ok(all)
}

impl PaperRow {
    /// A row without figures.
    pub fn new(table: &str, task: &str, modality: &str, quantity: &str) -> PaperRow {
        let [table, task, modality, quantity] = [table, task, modality, quantity].map(str::to_string);
        PaperRow { table, task, modality, quantity, ..PaperRow::default() }
    }
}

/// Whether two rows are about the same figure: of the same network where rows compare networks.
fn same(a: &PaperRow, b: &PaperRow) -> bool {
    fn figure(row: &PaperRow) -> (String, String, String, Option<String>) {
        (row.table.clone(), row.task.clone(), row.modality.clone(), row.loss.clone())
    }
    fn network(row: &PaperRow) -> String {
        row.note.split([',', ';']).next().unwrap_or("").trim().to_lowercase()
    }
    figure(a) == figure(b) && a.quantity == b.quantity && (a.table != "ann" || network(a) == network(b))
}

/// The tables in order of display, with their titles.
pub const TABLES: [(&str, &str); 6] = [
    ("accuracy", "Accuracy over the whole sample, neurons of the chip"),
    ("srm", "Accuracy with spike-response neurons, whole and by time"),
    ("ann", "Networks without spikes"),
    ("early", "Early decisions"),
    ("offline", "Hardware, as fast as possible"),
    ("realtime", "Hardware, in real time"),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_ships_can_be_read_and_every_printed_figure_has_a_row() {
        let rows = rows(Vec::new()).unwrap();
        let stored = STORED.iter().flat_map(|(name, text)| parse(name, text).unwrap());
        let printed: Vec<PaperRow> = stored.filter(|row| row.published.is_some()).collect();
        assert_eq!(printed.len(), 24 + 12 + 36 + 2);
        for row in printed {
            assert_eq!(rows.iter().filter(|found| same(found, &row)).count(), 1, "{row:?}");
        }
        assert!(rows.iter().all(|row| TABLES.iter().any(|(table, _)| *table == row.table) && !row.note.is_empty()));
    }

    #[test]
    fn a_measured_figure_takes_the_place_of_the_printed_row() {
        let given = r#"{"rows": [
            {"table": "accuracy", "task": "slip", "modality": "tactile", "loss": "weighted", "quantity": "accuracy",
             "measured": 0.5, "deviation": 0.1, "note": "synthetic"},
            {"table": "ann", "task": "slip", "modality": "both", "quantity": "accuracy", "measured": 0.25,
             "note": "CNN-3D, synthetic"},
            {"table": "ann", "task": "slip", "modality": "both", "quantity": "parameters", "measured": 9,
             "note": "CNN-3D"}]}"#;
        let rows = rows(parse("given", given).unwrap()).unwrap();
        let of = |text: &str| rows.iter().filter(|row| row.note == text).collect::<Vec<_>>();
        let [cell] = of("synthetic")[..] else { panic!("{rows:?}") };
        assert_eq!((cell.published, cell.measured, cell.published_deviation), (Some(0.91), Some(0.5), Some(0.02)));
        assert_eq!(of("CNN-3D, synthetic")[0].published, Some(0.77));
        assert_eq!(of("CNN-3D")[0].published, None);
        assert_eq!(parse("bad", "[]").unwrap_err().code, "paper.results");
    }
}
