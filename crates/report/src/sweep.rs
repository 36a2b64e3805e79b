//! Plot of two columns of a sweep's table.
//!
//! Input: a table, the names of two of its columns. Output: the rows on the front; an SVG with a
//! point for each row that has a number in both, and the front. Errors: `sweep.column` for an
//! unknown column, or one without numbers.

use std::collections::{BTreeSet, HashMap};

use crate::charts::draw::Axis;
use crate::charts::plot::{self, Series};
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::names::did_you_mean;
use nsim_study::pareto::on_front;
use nsim_study::sweep::table::Table;
use nsim_study::sweep::variants::FIGURES;

/// Name of a column without its unit, and the unit, if the name ends in one.
fn name_and_unit(column: &str) -> (&str, Option<&str>) {
    let units = [("_uj", "uJ"), ("_us", "us"), ("_mw", "mW"), ("_pjs", "pJ s")];
    let name_and_unit = units.into_iter().find_map(|(end, unit)| Some((column.strip_suffix(end)?, Some(unit))));
    name_and_unit.unwrap_or((column, None))
}

/// Name of a column in a title.
fn title_text(column: &str) -> String {
    name_and_unit(column).0.replace('_', " ")
}

/// Label of a column's axis; energies and times are per timestep.
fn label(column: &str) -> String {
    match (column, name_and_unit(column)) {
        ("energy_uj" | "latency_us", (name, Some(unit))) => format!("{name} ({unit} a timestep)"),
        (_, (_, Some(unit))) => format!("{} ({unit})", title_text(column)),
        _ => column.to_string(),
    }
}

/// Index of a column, by its name.
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

/// 1 or -1, after which less of a column is better, as of swept limits; `None` for neither.
fn to_less(table: &Table<'_>, column: &str) -> Option<f64> {
    if table.sweep().is_of_chip(column) {
        return Some(1.0);
    }
    let unit = column.rsplit('_').next().unwrap_or_default();
    match column {
        "accuracy" => Some(-1.0),
        "cores" | "chips" | "spikes" | "synaptic_events" | "messages" | "hops" | "used_percent" => Some(1.0),
        _ => FIGURES.contains(&column).then_some(1.0).filter(|_| ["mw", "us", "uj", "pjs"].contains(&unit)),
    }
}

/// Rows with a number in both columns, sorted by x; the best x is first, if one is better.
fn points(table: &Table<'_>, [x, y]: [&str; 2]) -> Result<Vec<(u64, f64, f64)>> {
    let columns = table.columns();
    let places = [check(&columns, x)?, check(&columns, y)?];
    let number = |record: &[String], place: usize| record[place].parse::<f64>().ok().filter(|x| x.is_finite());
    let point = |(record, (variant, ..)): (Vec<String>, (u64, String, bool))| {
        Some((variant, number(&record, places[0])?, number(&record, places[1])?))
    };
    let mut points: Vec<_> = table.records().zip(table.places()).filter_map(point).collect();
    let sign = to_less(table, x).unwrap_or(1.0);
    points.sort_by(|a, b| (sign * a.1).total_cmp(&(sign * b.1)));
    Ok(points)
}

/// Columns without a better direction.
pub fn without_direction<'a>(table: &Table<'_>, axes: [&'a str; 2]) -> Vec<&'a str> {
    axes.into_iter().filter(|column| to_less(table, column).is_none()).collect()
}

/// Number of variants on the front that equal another one in both columns.
///
/// # Errors
/// `sweep.column`.
pub fn ties(table: &Table<'_>, axes: [&str; 2]) -> Result<usize> {
    let front = table.front.clone().unwrap_or_default();
    let bits = points(table, axes)?.into_iter().filter(|point| front.contains(&point.0));
    let bits: Vec<_> = bits.map(|(_, x, y)| (x.to_bits(), y.to_bits())).collect();
    Ok(bits.iter().filter(|one| bits.iter().filter(|other| other == one).count() > 1).count())
}

/// Variants on the front: no other is at least as good in both columns and better in one. `None`
/// where a column has no better direction.
///
/// # Errors
/// `sweep.column`.
pub fn front(table: &Table<'_>, axes: [&str; 2]) -> Result<Option<BTreeSet<u64>>> {
    let points = points(table, axes)?;
    let [Some(x), Some(y)] = axes.map(|column| to_less(table, column)) else { return Ok(None) };
    let on = on_front(&points.iter().map(|point| (x * point.1, y * point.2)).collect::<Vec<_>>());
    Ok(Some(points.iter().zip(on).filter(|(_, on)| *on).map(|(point, _)| point.0).collect()))
}

/// The Wilson intervals of the accuracy, over a column.
fn intervals(table: &Table<'_>, x: &str) -> Result<Vec<(f64, f64, f64)>> {
    let [low, high] = ["accuracy_low", "accuracy_high"].map(|end| points(table, [x, end]));
    let high: HashMap<u64, f64> = high?.into_iter().map(|(variant, _, high)| (variant, high)).collect();
    let both = |(variant, x, low): (u64, f64, f64)| Some((x, low, *high.get(&variant)?));
    Ok(low?.into_iter().filter_map(both).collect())
}

/// SVG of a column over another: the front of the table, and each point labelled with its values on
/// the axes of the sweep.
///
/// # Errors
/// `sweep.column`.
pub fn svg(table: &Table<'_>, [x, y]: [&str; 2]) -> Result<String> {
    let places: HashMap<u64, (String, bool)> =
        table.places().map(|(variant, values, on_front)| (variant, (values, on_front))).collect();
    let points = points(table, [x, y])?.into_iter().map(|(variant, x, y)| {
        let (values, on_front) = places[&variant].clone();
        ((x, y, values), on_front)
    });
    let points: Vec<_> = points.collect();
    if points.is_empty() {
        return Err(Diagnostic::new("sweep.column", format!("no row has numbers in both columns {x} and {y}")));
    }
    let title = format!("{} over {}", title_text(y), title_text(x));
    let intervals = if y == "accuracy" { intervals(table, x)? } else { Vec::new() };
    let mut series = match table.front {
        Some(_) => plot::front_series(points.into_iter()),
        None => {
            let name = format!("{} variants", points.len());
            let points = points.into_iter().map(|(point, _)| point).collect();
            vec![Series::Points(name, points)]
        }
    };
    if !intervals.is_empty() {
        series.push(Series::Intervals("interval of 95 %".to_string(), intervals));
    }
    Ok(plot::chart(&title, &Axis::linear(label(x)), &Axis::linear(label(y)), &series))
}
