//! The result of `nsim inspect` as text, JSON (`nsim.inspect/1`) and CSV.
//!
//! Input: kind, facts and tables of the parts of a file. Output: strings.

use std::fmt::Write as _;

use serde_json::{Value, json};

use nsim_files::table::{count, csv_text, table, three, wrapped_at};

/// Rows of a table in the text, unless the table sets another number.
const SHOWN_ROWS: usize = 16;
/// Characters of a real number above which the text has three of its digits.
const LONG: usize = 8;

/// Findings of a file: facts about the whole, and tables of its parts.
#[derive(Debug, Clone)]
pub struct Findings {
    /// Kind of the file.
    pub kind: &'static str,
    /// Name and value; null is unknown.
    pub facts: Vec<(&'static str, Value)>,
    /// Tables of its parts.
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
    /// Number of rows in the text; JSON has all.
    pub rows_in_text: usize,
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
        FindingsTable { key, columns, rows: rows.into_iter().map(values).collect(), rows_in_text: SHOWN_ROWS }
    }
}

/// A number, without a fraction if it is whole.
pub fn number(x: f64) -> Value {
    if x.fract() == 0.0 && x.abs() < 9e15 { json!(x as i64) } else { json!(x) }
}

/// Text of a value: bare strings, lists as `[2, 3]`, `-` for null.
fn value_text(value: &Value) -> String {
    match value {
        Value::Null => "-".to_string(),
        Value::String(text) => text.clone(),
        Value::Array(items) => format!("[{}]", items.iter().map(value_text).collect::<Vec<_>>().join(", ")),
        // A long real number has three digits.
        Value::Number(x) if x.is_f64() && x.to_string().len() > LONG => x.as_f64().map_or_else(String::new, three),
        Value::Object(fields) => {
            fields.iter().map(|(name, value)| format!("{name} {}", value_text(value))).collect::<Vec<_>>().join(", ")
        }
        other => other.to_string(),
    }
}

impl Findings {
    /// The findings as text.
    pub fn text(&self, file: &str) -> String {
        let mut out = format!("{file}: {}\n", self.kind);
        let width = self.facts.iter().map(|(key, _)| key.len()).max().unwrap_or(0);
        // Notes on a chip are paragraphs and omitted here.
        for (key, value) in self.facts.iter().filter(|(key, value)| !value.is_null() && *key != "chip_notes") {
            let value = wrapped_at(&value_text(value), width + 4);
            let _ = writeln!(out, "  {key:width$}  {value}");
        }
        for part in self.tables.iter().filter(|part| part.rows_in_text > 0) {
            // Sources are sentences, and the printed rows are of one preset: both are omitted.
            let is_shown = |at: &usize| !["source", "preset"].contains(&part.columns[*at]);
            let columns: Vec<usize> = (0..part.columns.len()).filter(is_shown).collect();
            let header: Vec<&str> = columns.iter().map(|&at| part.columns[at]).collect();
            let row = |row: &Vec<Value>| columns.iter().map(|&at| value_text(&row[at])).collect();
            let rows: Vec<Vec<String>> = part.rows.iter().take(part.rows_in_text).map(row).collect();
            let _ = write!(out, "\n{}\n{}", part.key, table(&header, &rows));
            if part.rows.len() > rows.len() || header.len() < part.columns.len() {
                let all = count(part.rows.len() as u64, "row");
                let _ = writeln!(out, "{} of {all}; --format json has all rows and fields", rows.len());
            }
        }
        out
    }

    /// `nsim.inspect/1`.
    pub fn json(&self, schema: &str, file: &str) -> Value {
        let mut object = json!({ "schema": schema, "kind": self.kind, "file": file });
        for (key, value) in &self.facts {
            object[*key] = value.clone();
        }
        for part in &self.tables {
            let row = |row: &Vec<Value>| part.columns.iter().copied().zip(row.iter().cloned()).collect::<Value>();
            object[part.key] = part.rows.iter().map(row).collect();
        }
        object
    }

    /// The first table; facts as key and value when there is none.
    pub fn csv(&self) -> String {
        fn cell(value: &Value) -> String {
            if value.is_null() { String::new() } else { value_text(value) }
        }
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
