//! Tables of measurements (`mapping/measurements`): figures of published workloads on the chip.
//!
//! Input: a path or the name of a shipped table. Output: a [`MeasurementsFile`] with known units
//! and figures, and a positive number in every cell.

use serde::Deserialize;

use nsim_cost::estimate::RowUnit;
use nsim_cost::job::Mode;
use nsim_files::shipped;
use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText};
use nsim_ir::spanned::{Spanned, parse};

/// One cell of a table.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeasuredCell {
    /// `x86`, `neuron` or `total`.
    pub unit: Spanned<String>,
    /// A figure of a report's row, such as `static_mw`.
    pub figure: Spanned<String>,
    /// The printed text; its last digit gives the rounding.
    pub printed: Spanned<String>,
}

impl MeasuredCell {
    /// The value and half a unit of its last digit, when it is a positive decimal.
    pub fn value(&self) -> Option<(f64, f64)> {
        let text = self.printed.value.trim();
        let digits = text.split_once('.').map_or(0, |(_, fraction)| fraction.len());
        let value: f64 = text.parse().ok().filter(|value: &f64| value.is_finite() && *value > 0.0)?;
        (digits <= 12).then(|| (value, 0.5 * 10f64.powi(-(digits as i32))))
    }
}

/// A table of measurements of one workload.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename = "Measurements")]
pub struct MeasurementsFile {
    /// The table's name.
    pub name: String,
    /// Paper and table.
    pub source: String,
    /// Method of measurement, and its unknown details.
    pub notes: String,
    /// The model whose activity represents the workload.
    pub model: String,
    /// Name of the target that was measured.
    pub target: String,
    /// Number of copies; each figure is the share of one.
    pub copies: u32,
    /// The mode of the run.
    pub mode: Mode,
    /// Timesteps of a sample.
    pub steps_per_sample: u32,
    /// The cells.
    pub cells: Vec<MeasuredCell>,
}

/// Units of a row that a table may name.
pub const UNITS: [&str; 3] = [RowUnit::X86.name(), RowUnit::Neuron.name(), RowUnit::Total.name()];
/// Figures of a row that a table may name.
pub const FIGURES: [&str; 6] = ["static_mw", "dynamic_mw", "total_mw", "latency_us", "energy_uj", "edp_pjs"];

/// Loads a table: a path, `-`, or a shipped name.
///
/// # Errors
/// `measurements.*`, `io.*`.
pub fn load_measurements(argument: &str) -> Result<MeasurementsFile> {
    let (source, _) = shipped::path_or_shipped_text(
        argument,
        shipped::MEASUREMENTS,
        "table of measurements",
        "measurements.unknown",
    )?;
    measurements(&source)
}

/// Parses and checks a table.
///
/// # Errors
/// `measurements.syntax`, `measurements.name`, `measurements.cell`.
pub fn measurements(source: &SourceText) -> Result<MeasurementsFile> {
    let file: MeasurementsFile = parse(source, "measurements.syntax")?;
    let known = |what: &str, name: &Spanned<String>, names: &[&str]| match names.contains(&name.value.as_str()) {
        true => Ok(()),
        false => Err(Diagnostic::new("measurements.name", format!("there is no {what} {}", name.value))
            .help(format!("there are: {}", names.join(", ")))
            .at(source, name.span)),
    };
    for cell in &file.cells {
        known("unit", &cell.unit, &UNITS)?;
        known("figure", &cell.figure, &FIGURES)?;
        if cell.value().is_none() {
            let message = format!("'{}' is not a positive decimal", cell.printed.value);
            return Err(Diagnostic::new("measurements.cell", message).at(source, cell.printed.span));
        }
    }
    if file.copies == 0 || file.cells.is_empty() {
        let message = "a table has at least one copy and one cell";
        return Err(Diagnostic::new("measurements.cell", message).in_file(source.path()));
    }
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shipped_tables_are_well_formed() {
        for table in shipped::MEASUREMENTS {
            assert_eq!(measurements(&table.source()).unwrap().cells.len(), 14);
        }
    }

    #[test]
    fn what_a_table_names_has_to_exist() {
        let text = shipped::MEASUREMENTS[0].text;
        let wrong = |from: &str, to: &str| {
            let problem = measurements(&SourceText::new("t.ron", text.replacen(from, to, 1))).unwrap_err();
            assert!(problem.position().is_some(), "{problem}");
            problem.message
        };
        assert!(wrong("unit: \"x86\"", "unit: \"x87\"").contains("no unit x87"));
        assert!(wrong("\"0.19\"", "\"-0.19\"").contains("'-0.19'"));
    }

    #[test]
    fn the_last_digit_says_how_a_cell_is_rounded() {
        let file = measurements(&shipped::MEASUREMENTS[0].source()).unwrap();
        let of = |printed: &str| file.cells.iter().find(|cell| cell.printed.value == printed).unwrap().value().unwrap();
        assert_eq!((of("0.19"), of("231")), ((0.19, 0.005), (231.0, 0.5)));
    }
}
