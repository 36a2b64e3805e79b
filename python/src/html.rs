//! Tables for notebooks, and data frames.
//!
//! Input: rows of the reports' JSON, and the columns to show. Output: one HTML table. Text is
//! escaped: names come from users' files.

use pyo3::prelude::*;
use serde_json::{Value, json};

use crate::keywords::usage;
use crate::value::to_python;

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// The flat key of a bound: `energy_uj` of `low` is `energy_low_uj`.
fn flat_key(parent: &str, key: &str) -> String {
    match (parent, key.rsplit_once('_')) {
        ("low" | "high", Some((name, unit))) => format!("{name}_{parent}_{unit}"),
        _ => format!("{parent}_{key}"),
    }
}

/// A row without objects: their entries, at any depth, are columns.
fn flat(row: &Value) -> Value {
    let mut out = serde_json::Map::new();
    for (key, value) in row.as_object().into_iter().flatten() {
        match value {
            Value::Object(_) => {
                let inner = flat(value);
                out.extend(
                    inner.as_object().into_iter().flatten().map(|(sub, cell)| (flat_key(key, sub), cell.clone())),
                );
            }
            _ => _ = out.insert(key.clone(), value.clone()),
        }
    }
    Value::Object(out)
}

fn cell_html(value: &Value) -> String {
    match value {
        Value::Number(number) if number.as_f64() == Some(0.0) => "0".to_string(),
        Value::Null => String::new(),
        Value::String(text) => escaped(text),
        Value::Number(number) if number.is_f64() => {
            let number = number.as_f64().unwrap_or(f64::NAN);
            // Four digits: no constant is more accurate.
            let decimals = (3 - number.abs().max(1e-9).log10().floor() as i32).clamp(0, 12) as usize;
            format!("{number:.decimals$}")
        }
        other => escaped(&other.to_string()),
    }
}

/// A table with a caption.
pub fn table(caption: &str, columns: &[&str], rows: &[Value]) -> String {
    let head: String = columns.iter().map(|column| format!("<th>{}</th>", escaped(column))).collect();
    let row = |row: &Value| {
        let cells: String = columns.iter().map(|column| format!("<td>{}</td>", cell_html(&row[*column]))).collect();
        format!("<tr>{cells}</tr>")
    };
    let body: String = rows.iter().map(row).collect();
    format!("<table><caption>{}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>", escaped(caption))
}

/// A table of populations: name, kind and shape.
pub fn populations<S: Copy + Into<u64>>(caption: &str, populations: &[(String, &'static str, Vec<S>)]) -> String {
    let row = |(name, kind, shape): &(String, &'static str, Vec<S>)| {
        let axes: Vec<u64> = shape.iter().map(|&axis| axis.into()).collect();
        json!({ "name": name, "kind": kind, "shape": axes })
    };
    let rows: Vec<Value> = populations.iter().map(row).collect();
    table(&caption.replace(['<', '>'], ""), &["name", "kind", "shape"], &rows)
}

/// Rows as a data frame of pandas, or of polars where only that is installed.
pub fn frame<'py>(py: Python<'py>, rows: &Value) -> PyResult<Bound<'py, PyAny>> {
    let library = py.import("pandas").or_else(|_| py.import("polars")).map_err(|_| {
        usage("tables are data frames of pandas, which is not installed".to_string(), "install it: pip install pandas")
    })?;
    let rows: Vec<Value> = rows.as_array().into_iter().flatten().map(flat).collect();
    library.call_method1("DataFrame", (to_python(py, &Value::Array(rows))?,))
}

/// Keys of the first row whose values are neither objects nor arrays.
pub fn columns(rows: &[Value]) -> Vec<&str> {
    let keys = rows.first().and_then(Value::as_object).into_iter().flatten();
    keys.filter(|(_, value)| !value.is_object() && !value.is_array()).map(|(key, _)| key.as_str()).collect()
}
