//! The result of `nsim bench batch` as text, JSON, CSV and a chart.

use serde_json::{Value, json};

use crate::charts::plot;
use crate::charts::plot::{Axis, Series};
use nsim_files::table::{Column, csv_of, table_of};
use nsim_study::batch_sizes::{BatchFigure, BatchRow, Crossing, crossings};

/// Everything that the report says.
#[derive(Debug)]
pub struct BatchReport<'a> {
    /// The network.
    pub model: &'a str,
    /// Timesteps of a sample.
    pub steps: u32,
    /// Those of the chip first.
    pub rows: &'a [BatchRow],
    /// Why some hardware has no row.
    pub notes: &'a [String],
}

fn three(x: f64) -> String {
    let decimals = (2 - x.abs().max(1e-9).log10().floor() as i32).clamp(0, 9) as usize;
    format!("{x:.decimals$}")
}

const COLUMNS: [Column<BatchRow>; 7] = [
    ("hardware", |row| row.hardware.clone()),
    ("batch", |row| row.batch.to_string()),
    ("at once", |row| row.together.to_string()),
    ("batch, ms", |row| three(row.batch_ms)),
    ("a sample, ms", |row| three(row.sample_ms())),
    ("samples/s", |row| three(row.throughput())),
    ("uJ a sample", |row| {
        let mark = if BatchFigure::Energy.value_in(row).is_some() { "" } else { " (assumed)" };
        row.energy_uj.map_or("unknown".to_string(), |energy| three(energy) + mark)
    }),
];

/// A crossing in words.
fn sentence(one: &Crossing, chip: &str) -> String {
    let Crossing { hardware, figure, from, last } = one;
    let what = figure.name();
    match from {
        Some(1) => format!("{hardware} needs less {what} a sample than {chip} at every size"),
        Some(from) => format!("{hardware} needs less {what} a sample than {chip} from batches of {from} on"),
        None => format!("{hardware} needs no less {what} a sample than {chip} at batches of {last}"),
    }
}

impl BatchReport<'_> {
    fn chip(&self) -> &str {
        self.rows.first().map_or("the chip", |row| &row.hardware)
    }

    /// `nsim.bench/1`.
    #[must_use]
    pub fn json(&self) -> Value {
        let row = |row: &BatchRow| {
            json!({
                "hardware": row.hardware, "batch": row.batch, "together": row.together, "batch_ms": row.batch_ms,
                "sample_ms": row.sample_ms(), "samples_per_s": row.throughput(), "energy_uj": row.energy_uj,
                "source": row.source.name(), "power_source": row.power_source.name(), "note": row.note,
            })
        };
        let crossing = |one: &Crossing| {
            json!({
                "hardware": one.hardware, "figure": one.figure.name(), "from": one.from,
                "text": sentence(one, self.chip()),
            })
        };
        json!({
            "schema": "nsim.bench/1", "name": "batch", "model": self.model, "timesteps": self.steps,
            "rows": self.rows.iter().map(row).collect::<Vec<_>>(),
            "crossings": crossings(self.rows).iter().map(crossing).collect::<Vec<_>>(), "notes": self.notes,
        })
    }

    /// A row for each hardware and size.
    ///
    /// # Errors
    /// Never in practice: the rows are built in memory.
    pub fn csv(&self) -> Result<String, csv::Error> {
        let columns: [Column<BatchRow>; 9] = [
            ("hardware", |row| row.hardware.clone()),
            ("batch", |row| row.batch.to_string()),
            ("together", |row| row.together.to_string()),
            ("batch_ms", |row| row.batch_ms.to_string()),
            ("sample_ms", |row| row.sample_ms().to_string()),
            ("samples_per_s", |row| row.throughput().to_string()),
            ("energy_uj", |row| row.energy_uj.map_or_else(String::new, |energy| energy.to_string())),
            ("source", |row| row.source.name().to_string()),
            ("power_source", |row| row.power_source.name().to_string()),
        ];
        csv_of(self.rows, &columns)
    }

    /// For people.
    #[must_use]
    pub fn text(&self) -> String {
        let mut out = format!(
            "{}, {} timesteps a sample; no sample of a batch is ready before the batch\n\n{}\n",
            self.model,
            self.steps,
            table_of(self.rows, &COLUMNS, 1)
        );
        let sentences: Vec<String> = crossings(self.rows).iter().map(|one| sentence(one, self.chip())).collect();
        for line in sentences.iter().chain(self.notes) {
            out += &format!("\n{line}");
        }
        out + "\n"
    }

    /// Energy of a sample over the batch size; a line for each hardware whose power is known.
    #[must_use]
    pub fn svg(&self) -> String {
        let mut lines: Vec<(&str, Vec<(f64, f64)>)> = Vec::new();
        for row in self.rows {
            let Some(energy) = row.energy_uj else { continue };
            let point = (f64::from(row.batch), energy);
            match lines.iter_mut().find(|(name, _)| *name == row.hardware) {
                Some((_, points)) => points.push(point),
                None => lines.push((&row.hardware, vec![point])),
            }
        }
        let line =
            |(name, points): (&str, Vec<(f64, f64)>)| Series::Line { name: name.to_string(), points, band: Vec::new() };
        let series: Vec<Series> = lines.into_iter().map(line).collect();
        plot::chart("energy of a sample", &Axis::log("samples of a batch"), &Axis::log("energy (uJ)"), &series)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_cost::estimate::FigureSource;

    #[test]
    fn all_forms_have_every_row_and_assumptions_are_marked() {
        let row = |hardware: &str, batch: u32, power_source| BatchRow {
            hardware: hardware.to_string(),
            batch,
            together: batch,
            batch_ms: 2.0,
            energy_uj: Some(3.0 / f64::from(batch)),
            source: FigureSource::Measured,
            power_source,
            note: String::new(),
        };
        let modelled = FigureSource::Modelled;
        let rows = [
            row("chip", 1, modelled),
            row("chip", 8, modelled),
            row("cpu", 1, FigureSource::Assumed),
            row("cpu", 8, FigureSource::Assumed),
        ];
        let notes = ["no GPU".to_string()];
        let report = BatchReport { model: "m", steps: 10, rows: &rows, notes: &notes };
        let (json, text) = (report.json(), report.text());
        assert_eq!((json["rows"].as_array().unwrap().len(), &json["rows"][1]["sample_ms"]), (4, &json!(0.25)));
        // Both take as long: neither needs less time, and nothing is said of an assumed energy.
        assert_eq!(json["crossings"].as_array().unwrap().len(), 1);
        assert!(text.contains("cpu needs no less time a sample than chip at batches of 8"), "{text}");
        assert!(text.contains("(assumed)") && text.contains("no GPU"), "{text}");
        assert_eq!(report.csv().unwrap().lines().count(), 5);
        assert!(report.svg().starts_with("<svg"));
    }
}
