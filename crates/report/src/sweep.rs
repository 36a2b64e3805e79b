//! A picture of two columns of a table.
//!
//! Input: a table, the names of two of its columns. Output: an SVG with a point for each row that
//! has a number in both; nothing else is shown. Errors: `sweep.column` for a name that no column
//! has, or one without numbers.

use crate::charts::draw::Axis;
use crate::charts::plot::{Series, chart};
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::names::did_you_mean;
use nsim_study::sweep::table::Table;

/// Columns whose unit is not in their name.
fn label(column: &str) -> String {
    match column.rsplit_once('_') {
        Some((name, unit @ ("uj" | "us" | "mw"))) => format!(
            "{name} ({})",
            if unit == "mw" {
                "mW"
            } else if unit == "uj" {
                "uJ"
            } else {
                unit
            }
        ),
        Some((name, "pjs")) => format!("{name} (pJ s)"),
        _ => column.to_string(),
    }
}

/// Whether a table of these columns can be drawn.
///
/// # Errors
/// `sweep.column`.
pub fn check(columns: &[&str], name: &str) -> Result<usize> {
    columns.iter().position(|column| *column == name).ok_or_else(|| {
        let meant = did_you_mean(name, columns.iter().copied());
        Diagnostic::new("sweep.column", format!("there is no column '{name}'"))
            .help(format!("{meant}columns are {}", columns.join(", ")))
    })
}

/// The picture of a column over another.
///
/// # Errors
/// `sweep.column`.
pub fn svg(table: &Table<'_>, [x, y]: [&str; 2]) -> Result<String> {
    let columns = table.columns();
    let places = [check(&columns, x)?, check(&columns, y)?];
    let number = |record: &[String], place: usize| record[place].parse::<f64>().ok().filter(|x| x.is_finite());
    let point = |record: Vec<String>| Some((number(&record, places[0])?, number(&record, places[1])?, String::new()));
    let points: Vec<_> = table.records().filter_map(point).collect();
    if points.is_empty() {
        return Err(Diagnostic::new("sweep.column", format!("no row has a number under both {x} and {y}")));
    }
    let name = format!("{} variants", points.len());
    let series = [Series::Points { name, points, joined: false }];
    Ok(chart(&format!("{y} over {x}"), &Axis::linear(label(x)), &Axis::linear(label(y)), &series))
}
