//! The result of a calibration as text, JSON (`nsim.calibration/1`) and CSV.

use std::fmt::Write;

use serde::Serialize;
use serde_json::{Value, json};

use super::format::{plain, short};
use crate::desc::published::measurement::MeasurementsFile;
use crate::desc::target::constants::{Residual, Unit};
use crate::report::text::{csv_text, wrapped};

/// A constant that was fitted.
#[derive(Debug, Clone, Serialize)]
pub struct Fitted<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its value.
    pub value: f64,
    /// In this unit.
    pub unit: Unit,
}

/// Everything that the report says.
#[derive(Debug)]
pub struct CalibrationReport<'a> {
    /// The tables.
    pub tables: &'a [MeasurementsFile],
    /// The preset that gave everything else.
    pub start: &'a str,
    /// The preset that came out.
    pub preset: &'a str,
    /// What the figures are the activity of.
    pub activity: &'a str,
    /// Seed of the input, if it was made from one.
    pub seed: Option<u64>,
    /// What was fitted; nothing when the table was only compared.
    pub fitted: Vec<Fitted<'a>>,
    /// The table's cells beside the model's.
    pub residuals: &'a [Residual],
    /// What to be wary of.
    pub notes: &'a [String],
}

impl CalibrationReport<'_> {
    /// The object for what did not fit on its target.
    #[must_use]
    pub fn nothing(table: &str) -> Value {
        json!({
            "schema": "nsim.calibration/1", "table": table, "model": null, "target": null, "start": null,
            "preset": null, "fitted": [], "residuals": [], "worst_percent": null, "notes": [],
        })
    }

    /// Something of each table, each once.
    fn each(&self, part: fn(&MeasurementsFile) -> &String) -> String {
        let mut parts: Vec<&str> = self.tables.iter().map(|table| part(table).as_str()).collect();
        parts.dedup();
        parts.join(", ")
    }

    /// The largest deviation in percent.
    fn worst(&self) -> f64 {
        self.residuals.iter().map(|residual| residual.percent.abs()).fold(0.0, f64::max)
    }

    /// The object of `nsim.calibration/1`.
    #[must_use]
    pub fn json(&self) -> Value {
        json!({
            "schema": "nsim.calibration/1",
            "table": self.each(|table| &table.name),
            "model": self.each(|table| &table.model),
            "target": self.each(|table| &table.target),
            "fits": true,
            "start": self.start,
            "preset": self.preset,
            "activity": self.activity,
            "seed": self.seed,
            "fitted": self.fitted,
            "residuals": self.residuals,
            "worst_percent": self.worst(),
            "notes": self.notes,
        })
    }

    /// The cells as comma-separated values with a header.
    ///
    /// # Errors
    /// When the writer fails, which for one in memory it does not.
    pub fn csv(&self) -> Result<String, csv::Error> {
        let mut writer = csv::Writer::from_writer(Vec::new());
        for residual in self.residuals {
            writer.serialize(residual)?;
        }
        csv_text(writer)
    }

    /// The report for people.
    #[must_use]
    pub fn text(&self) -> String {
        let mut out = String::new();
        for table in self.tables {
            let _ = writeln!(out, "{} on {}, {}", table.name, table.target, table.mode.name());
            out += &wrapped(&table.source);
        }
        out += &wrapped(&format!("Activity: {}.", self.activity));
        out.push('\n');
        if !self.fitted.is_empty() {
            let mut table = plain(&["Constant", "Value", "Unit"]);
            for fitted in &self.fitted {
                table.add_row([fitted.name.to_string(), short(fitted.value), format!("{:?}", fitted.unit)]);
            }
            let _ = writeln!(out, "Fitted; everything else is from {}:\n{}\n", self.start, table.trim_fmt());
        }
        let mut table = plain(&["Cell", "Printed", "Model", "Deviation (%)"]);
        for Residual { cell, printed, model, percent } in self.residuals {
            table.add_row([cell.clone(), printed.clone(), short(*model), format!("{percent:+.2}")]);
        }
        let what = if self.fitted.is_empty() { "Predicted" } else { "Fitted" };
        let _ = writeln!(out, "{what} cells, energy as published tables compute it:\n{}\n", table.trim_fmt());
        let _ = writeln!(out, "Largest deviation {:.2} %, before the rounding of the print.", self.worst());
        for note in self.notes {
            out += &wrapped(&format!("Note: {note}"));
        }
        out
    }
}
