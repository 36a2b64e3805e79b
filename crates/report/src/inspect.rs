//! The result of `nsim inspect` as text, JSON (`nsim.inspect/1`) and CSV.
//!
//! Input: what was found in a file: its kind, facts about the whole, tables of its parts. Output:
//! strings.

use std::fmt::Write as _;

use comfy_table::CellAlignment;
use serde_json::{Map, Value, json};

use nsim_files::table::csv_text;

/// What was found: facts about the whole, and tables of its parts.
#[derive(Debug, Clone)]
pub struct Findings {
    /// What kind of file it is.
    pub kind: &'static str,
    /// Name and value; what is null is not known.
    pub facts: Vec<(&'static str, Value)>,
    /// Of its parts.
    pub tables: Vec<FindingsTable>,
}

/// A table of parts.
#[derive(Debug, Clone)]
pub struct FindingsTable {
    /// Its name.
    pub key: &'static str,
    /// Names of its columns.
    pub columns: &'static [&'static str],
    /// A value for each column.
    pub rows: Vec<Vec<Value>>,
}

impl FindingsTable {
    /// A table of rows that are JSON arrays, a value for each column.
    pub fn new(
        key: &'static str,
        columns: &'static [&'static str],
        rows: impl IntoIterator<Item = Value>,
    ) -> FindingsTable {
        let values = |row| match row {
            Value::Array(values) => values,
            single => vec![single],
        };
        FindingsTable { key, columns, rows: rows.into_iter().map(values).collect() }
    }
}

/// A number as people write it: without a fraction when it has none.
pub fn number(x: f64) -> Value {
    if x.fract() == 0.0 && x.abs() < 9e15 { json!(x as i64) } else { json!(x) }
}

/// A value for people: strings bare, lists as `[2, 3]`, nothing for what is not known.
fn shown(value: &Value) -> String {
    match value {
        Value::Null => "-".to_string(),
        Value::String(text) => text.clone(),
        Value::Array(items) => format!("[{}]", items.iter().map(shown).collect::<Vec<_>>().join(", ")),
        other => other.to_string(),
    }
}

impl Findings {
    /// For people.
    pub fn text(&self, file: &str) -> String {
        let mut out = format!("{file}: {}\n", self.kind);
        let width = self.facts.iter().map(|(key, _)| key.len()).max().unwrap_or(0);
        for (key, value) in self.facts.iter().filter(|(_, value)| !value.is_null()) {
            let value = nsim_files::table::wrapped_at(&shown(value), width + 4);
            let _ = writeln!(out, "  {key:width$}  {value}");
        }
        for part in &self.tables {
            let mut table = nsim_files::table::table(part.columns.iter().copied());
            for row in &part.rows {
                table.add_row(row.iter().map(shown));
            }
            for (index, column) in table.column_iter_mut().enumerate() {
                if !part.rows.is_empty() && part.rows.iter().all(|row| row[index].is_number() || row[index].is_null()) {
                    column.set_cell_alignment(CellAlignment::Right);
                }
            }
            let _ = writeln!(out, "\n{}\n{}", part.key, nsim_files::table::narrowed(&mut table).trim_fmt());
        }
        out
    }

    /// `nsim.inspect/1`.
    pub fn json(&self, schema: &str, file: &str) -> Value {
        let mut object = Map::new();
        object.insert("schema".into(), json!(schema));
        object.insert("kind".into(), json!(self.kind));
        object.insert("file".into(), json!(file));
        for (key, value) in &self.facts {
            object.insert((*key).into(), value.clone());
        }
        for part in &self.tables {
            let rows = part.rows.iter().map(|row| {
                part.columns.iter().zip(row).map(|(column, value)| ((*column).to_string(), value.clone())).collect()
            });
            object.insert(part.key.into(), Value::Array(rows.map(Value::Object).collect()));
        }
        Value::Object(object)
    }

    /// The first table; facts as key and value when there is none.
    pub fn csv(&self) -> String {
        let cell = |value: &Value| if value.is_null() { String::new() } else { shown(value) };
        let header = |columns: &[&str]| columns.iter().map(ToString::to_string).collect();
        match self.tables.first() {
            Some(part) => csv_text(header(part.columns), part.rows.iter().map(|row| row.iter().map(cell).collect())),
            None => {
                let facts = self.facts.iter().map(|(key, value)| vec![(*key).to_string(), cell(value)]);
                csv_text(header(&["key", "value"]), facts)
            }
        }
    }
}
