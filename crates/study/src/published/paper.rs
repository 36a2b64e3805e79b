//! The tables of the paper on visual and tactile sensing (Taunyazov et al., RSS 2020) beside stored
//! results.
//!
//! Input: files of rows that trainings left, `{"rows": [..]}` each. Output: one row for each
//! printed figure and for each stored one, in the order of the tables. A figure that nothing was
//! measured for has none, and its note says why. Errors: `paper.results` for a file that cannot be
//! read as rows.

use serde::{Deserialize, Serialize};

use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// The results that the program carries: name, text.
const STORED: &[(&str, &str)] = include!(concat!(env!("OUT_DIR"), "/paper_results.rs"));

/// One figure of a table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PaperRow {
    /// `accuracy`, `srm`, `ann`, `early`, `offline` or `realtime`.
    pub table: String,
    /// `slip` or `container`.
    pub task: String,
    /// `tactile`, `vision` or `both`.
    pub modality: String,
    /// `count`, `weighted`, or none where no loss of spike counts is meant.
    #[serde(default)]
    pub loss: Option<String>,
    /// What the figure is, with its unit last.
    pub quantity: String,
    /// As the paper prints it.
    #[serde(default)]
    pub published: Option<f64>,
    /// As it came out here.
    #[serde(default)]
    pub measured: Option<f64>,
    /// Standard deviation of what was measured, over the folds.
    #[serde(default)]
    pub deviation: Option<f64>,
    /// Ends of the interval that holds the share behind what was measured in 95 of 100 cases, over
    /// all samples tested.
    #[serde(default)]
    pub low: Option<f64>,
    /// See `low`.
    #[serde(default)]
    pub high: Option<f64>,
    /// What was measured, fold by fold.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub folds: Vec<f64>,
    /// What the shipped network of the first fold came to when it was run now.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shipped: Option<f64>,
    /// Standard deviation that the paper prints.
    #[serde(default)]
    pub published_deviation: Option<f64>,
    /// The network of a comparison, what the figure rests on, or why there is none.
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
#[must_use]
pub fn stored(provenance: &serde_json::Value, rows: &[PaperRow]) -> String {
    let lines: Vec<String> = rows.iter().map(|row| serde_json::json!(row).to_string()).collect();
    format!("{{\n\"provenance\": {provenance:#},\n\"rows\": [\n{}\n]\n}}\n", lines.join(",\n"))
}

/// Printed and stored figures, joined.
///
/// # Errors
/// `paper.results` for a stored file that cannot be read.
pub fn rows(more: Vec<PaperRow>) -> Result<Vec<PaperRow>> {
    let mut measured = more;
    for (name, text) in STORED {
        for row in parse(name, text)? {
            // What is given is newer than what is stored.
            if !measured.iter().any(|given| same(given, &row)) {
                measured.push(row);
            }
        }
    }
    Ok(joined(printed(), measured))
}

/// Whether two rows are about the same figure: of the same network where rows compare networks.
fn same(a: &PaperRow, b: &PaperRow) -> bool {
    let figure = |row: &PaperRow| (row.table.clone(), row.task.clone(), row.modality.clone(), row.loss.clone());
    let network = |row: &PaperRow| row.note.split([',', ';']).next().unwrap_or("").trim().to_lowercase();
    figure(a) == figure(b) && a.quantity == b.quantity && (a.table != "ann" || network(a) == network(b))
}

fn joined(printed: Vec<PaperRow>, mut measured: Vec<PaperRow>) -> Vec<PaperRow> {
    let mut all = Vec::with_capacity(printed.len() + measured.len());
    for mut row in printed {
        match measured.iter().position(|found| same(found, &row)) {
            Some(at) => {
                let found = measured.remove(at);
                row = PaperRow { published: row.published, published_deviation: row.published_deviation, ..found };
            }
            None if row.note.is_empty() => row.note = "not measured".to_string(),
            None => row.note += "; not measured",
        }
        all.push(row);
    }
    all.append(&mut measured);
    let place = |row: &PaperRow| TABLES.iter().position(|table| *table == row.table).unwrap_or(TABLES.len());
    all.sort_by_key(place);
    all
}

/// The tables, in the order in which they are shown.
pub const TABLES: [&str; 6] = ["accuracy", "srm", "ann", "early", "offline", "realtime"];
const MODALITIES: [&str; 3] = ["tactile", "vision", "both"];

/// A printed figure with its deviation.
type Printed = (f64, f64);

/// Accuracies by task, then loss, for touch, vision and both (tables "Container & Weight
/// Classification" and "Slip Detection Accuracy").
const ACCURACIES: [(&str, &str, [Printed; 3]); 4] = [
    ("slip", "count", [(0.82, 0.045), (1.0, 0.0), (1.0, 0.0)]),
    ("slip", "weighted", [(0.91, 0.020), (1.0, 0.0), (1.0, 0.0)]),
    ("container", "count", [(0.71, 0.045), (0.73, 0.064), (0.81, 0.039)]),
    ("container", "weighted", [(0.71, 0.023), (0.72, 0.065), (0.80, 0.048)]),
];

/// The same of the networks that it compares with.
const COMPARED: [(&str, &str, [Printed; 3]); 4] = [
    ("slip", "MLP-GRU", [(0.87, 0.059), (1.0, 0.0), (1.0, 0.0)]),
    ("slip", "CNN-3D", [(0.44, 0.086), (0.55, 0.100), (0.77, 0.117)]),
    ("container", "MLP-GRU", [(0.50, 0.059), (0.43, 0.054), (0.44, 0.062)]),
    ("container", "CNN-3D", [(0.75, 0.061), (0.68, 0.022), (0.80, 0.041)]),
];

/// Power and time of the deployed network: mode, then whose, quantity and figure.
const HARDWARE: [(&str, &str, f64); 16] = [
    ("offline", "static_mw", 11.9),
    ("offline", "dynamic_mw", 21.7),
    ("offline", "total_mw", 33.7),
    ("offline", "latency_us", 231.0),
    ("offline", "gpu_static_mw", 3594.0),
    ("offline", "gpu_dynamic_mw", 56296.0),
    ("offline", "gpu_total_mw", 59890.0),
    ("offline", "gpu_latency_us", 21.0),
    ("realtime", "static_mw", 12.1),
    ("realtime", "dynamic_mw", 20.23),
    ("realtime", "total_mw", 32.3),
    ("realtime", "latency_us", 1039.9),
    ("realtime", "gpu_static_mw", 3594.0),
    ("realtime", "gpu_dynamic_mw", 58336.0),
    ("realtime", "gpu_total_mw", 61930.0),
    ("realtime", "gpu_latency_us", 1045.6),
];

/// A row without figures.
#[must_use]
pub fn blank(table: &str, task: &str, modality: &str, quantity: &str) -> PaperRow {
    PaperRow {
        table: table.to_string(),
        task: task.to_string(),
        modality: modality.to_string(),
        loss: None,
        quantity: quantity.to_string(),
        published: None,
        measured: None,
        deviation: None,
        low: None,
        high: None,
        folds: Vec::new(),
        shipped: None,
        published_deviation: None,
        note: String::new(),
    }
}

/// Every printed figure.
fn printed() -> Vec<PaperRow> {
    let mut rows = Vec::new();
    let accuracy = |table: &str, task: &str, modality: &str, (mean, deviation): Printed| PaperRow {
        published: Some(mean),
        published_deviation: Some(deviation),
        ..blank(table, task, modality, "accuracy")
    };
    for (task, loss, figures) in ACCURACIES {
        for (modality, figure) in MODALITIES.iter().zip(figures) {
            for table in ["accuracy", "srm"] {
                rows.push(PaperRow { loss: Some(loss.to_string()), ..accuracy(table, task, modality, figure) });
            }
        }
    }
    for (task, network, figures) in COMPARED {
        for (modality, figure) in MODALITIES.iter().zip(figures) {
            rows.push(PaperRow { note: network.to_string(), ..accuracy("ann", task, modality, figure) });
        }
    }
    for (mode, quantity, figure) in HARDWARE {
        let gpu = quantity.starts_with("gpu");
        let note = if gpu { "RTX 2080 Ti" } else { "Loihi, one of 32 copies" };
        rows.push(PaperRow {
            published: Some(figure),
            note: note.to_string(),
            ..blank(mode, "slip", "both", quantity)
        });
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_ships_can_be_read_and_every_printed_figure_has_a_row() {
        let rows = rows(Vec::new()).unwrap();
        for row in printed() {
            assert_eq!(rows.iter().filter(|found| same(found, &row)).count(), 1, "{row:?}");
        }
        assert!(rows.iter().all(|row| TABLES.contains(&row.table.as_str()) && !row.note.is_empty()));
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
