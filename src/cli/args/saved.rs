//! Saved JSON results of commands.

use std::path::Path;

use serde_json::Value;

use nsim_files as io;
use nsim_files::write::checksum;
use nsim_ir::base::diagnostic::{Diagnostic, SourceText};
use nsim_session::error::Error;

/// Whether a file name has the extension of a saved result.
pub fn is_result(name: &str) -> bool {
    Path::new(name).extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json"))
}

/// Types of the values that pages and pictures read: schema (empty: all), type, and paths. `[]` is
/// each item of a list, `*` each value of an object. A value may be absent or null, where unknown.
const TYPES: &[(&str, Type, &[&str])] = &[
    ("", Type::Text, &["model", "target", "against", "input[]", "populations[].name", "inputs[].name"]),
    ("", Type::Object, &["populations[]", "inputs[]", "cores[]", "warnings[]", "rows[]", "layers[]", "attribution[]"]),
    ("", Type::Number, &["samples", "timesteps", "copies", "populations[].spikes", "inputs[].spikes"]),
    ("", Type::Number, &["cores[].spikes", "cores[].energy_pj", "cores[].busy_us", "layers[].coincidence"]),
    ("nsim.run/1", Type::Number, &["predicted[]", "labels[]", "decided_at[]", "output_counts[][]", "us_per_timestep"]),
    ("nsim.run/1", Type::Number, &["accuracy", "activity.*", "skipped.*"]),
    ("nsim.energy/1", Type::Text, &["rows[].hardware", "rows[].unit", "rows[].source", "mode", "deployment"]),
    ("nsim.energy/1", Type::Number, &["rows[].static_mw", "rows[].dynamic_mw", "rows[].total_mw", "rows[].edp_pjs"]),
    ("nsim.energy/1", Type::Number, &["rows[].latency_us", "rows[].energy_uj", "rows[].low.*", "rows[].high.*"]),
    ("nsim.energy/1", Type::Number, &["breakdown_pj_per_timestep.*", "time_us_per_timestep.*", "per_timestep_uj.*"]),
    ("nsim.energy/1", Type::Text, &["constants[].name", "constants[].unit", "constants[].source"]),
    ("nsim.energy/1", Type::Number, &["constants[].value"]),
];

#[derive(Debug, Clone, Copy, PartialEq)]
enum Type {
    Text,
    Number,
    Object,
}

impl Type {
    fn name(self) -> &'static str {
        match self {
            Type::Text => "a text",
            Type::Number => "a number",
            Type::Object => "an object",
        }
    }

    /// The type of a value; `None` for any other.
    fn from_value(value: &Value) -> Option<Type> {
        match value {
            Value::String(_) => Some(Type::Text),
            Value::Number(_) => Some(Type::Number),
            Value::Object(_) => Some(Type::Object),
            Value::Array(_) | Value::Bool(_) | Value::Null => None,
        }
    }
}

/// The first value at a path below `value` that has another type, as a sentence.
fn wrong_type(value: &Value, path: &str, wanted: Type, at: &str) -> Option<String> {
    if value.is_null() {
        return None;
    }
    if let Some(rest) = path.strip_prefix("[]") {
        let Some(items) = value.as_array() else { return Some(format!("{at} is not a list")) };
        let mut items = items.iter().enumerate();
        return items.find_map(|(place, item)| wrong_type(item, rest, wanted, &format!("{at}[{place}]")));
    }
    let Some(rest) = path.strip_prefix('.') else {
        return (Type::from_value(value) != Some(wanted)).then(|| format!("{at} is not {}", wanted.name()));
    };
    let end = rest.find(['.', '[']).unwrap_or(rest.len());
    let (name, rest) = rest.split_at(end);
    let Some(fields) = value.as_object() else { return Some(format!("{at} is not an object")) };
    let mut named = fields.iter().filter(|(field, _)| name == "*" || name == *field);
    named.find_map(|(field, value)| wrong_type(value, rest, wanted, format!("{at}.{field}").trim_start_matches('.')))
}

/// A saved result of one of these schemas, and its text.
///
/// # Errors
/// `report.result` for other text, another schema, types or checksum; when the file cannot be read.
pub fn read(path: &Path, schemas: &[&str], help: &str) -> Result<(Value, SourceText), Error> {
    let text = io::text::read_text(path)?;
    let wrong = |message: String| Diagnostic::new("report.result", message).in_file(path).help(help);
    let result: Value = serde_json::from_str(text.text()).map_err(|error| wrong(format!("is not JSON: {error}")))?;
    let schema = result["schema"].as_str().unwrap_or_default();
    if !schemas.contains(&schema) {
        return Err(wrong(format!("holds '{schema}', not {}", schemas.join(" or "))).into());
    }
    match checksum::holds(&result) {
        Some(true) => {}
        Some(false) => {
            let message = "was changed or damaged after it was printed: its checksum does not match".to_string();
            return Err(wrong(message).into());
        }
        None => tracing::warn!("{} has no checksum, so a damaged number in it is not detected", path.display()),
    }
    let of_schema = TYPES.iter().filter(|(of, ..)| of.is_empty() || *of == schema);
    let mut values =
        of_schema.flat_map(|(_, wanted, paths)| paths.iter().map(move |path| (format!(".{path}"), *wanted)));
    if let Some(problem) = values.find_map(|(path, wanted)| wrong_type(&result, &path, wanted, "")) {
        return Err(wrong(format!("was not printed by nsim: {problem}")).into());
    }
    Ok((result, text))
}
