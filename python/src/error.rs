//! Errors and warnings of the library as Python's.

use std::ffi::CString;

use nsim::ir::base::diagnostic::{Diagnostic, Position};
use nsim::ir::base::warning::Warning as Record;
use pyo3::exceptions::{PyException, PyUserWarning};
use pyo3::prelude::*;
use serde_json::{Value, json};

use crate::value::to_python;

pyo3::create_exception!(
    nsim,
    Error,
    PyException,
    "An error of nsim: `code` names the problem, `place` is FILE:LINE:COLUMN or None, `help` is the remedy or None; \
     `reasons` has a dictionary for each problem."
);

pyo3::create_exception!(
    nsim,
    Warning,
    PyUserWarning,
    "A warning about a run, such as a population that never spikes, with a remedy."
);

/// Words of a shell, and their equivalents in Python.
const IN_PYTHON: [(&str, &str); 4] = [
    (" of nsim import", " of nsim.load and from_nir"),
    ("nsim convert", "network.convert(spikes)"),
    ("nsim agree", "network.agree(spikes)"),
    ("--set decision=GreatestV", "decision='GreatestV' of from_torch and from_nir"),
];

/// Values of options in messages.
const VALUES: [&str; 8] =
    ["rails", "zero", "subtract", "subtract-later", "exponential", "search", "oheo-gulch", "inclusive"];

/// A message with the arguments of Python instead of the options of the command line: `dt_ms=` for
/// `--dt`. Names such as `a--b.ron` are unchanged.
pub fn python_message(text: &str) -> String {
    let text = IN_PYTHON.iter().fold(text.to_string(), |text, (shell, python)| text.replace(shell, python));
    let mut parts = text.split("--");
    let mut out = parts.next().unwrap_or_default().to_string();
    for part in parts {
        if !out.ends_with([' ', '(', '`', '\n']) && !out.is_empty() {
            out += &format!("--{part}");
            continue;
        }
        let end = part.find(|c: char| !(c.is_ascii_lowercase() || c == '-')).unwrap_or(part.len());
        let (name, rest) = part.split_at(end);
        let name = match name {
            "" => {
                out += &format!("--{part}");
                continue;
            }
            "dt" => "dt_ms".to_string(),
            "input" => "spikes".to_string(),
            other => other.replace('-', "_"),
        };
        let value = rest.strip_prefix([' ', '=']).unwrap_or_default();
        let value =
            &value[..value.find(|c: char| !(c.is_ascii_alphanumeric() || ".-".contains(c))).unwrap_or(value.len())];
        let number = value.trim_end_matches('.');
        let (said, taken) = match value {
            _ if name == "force" => ("force=True".to_string(), 0),
            _ if name == "set" => ("in the model's file".to_string(), 0),
            _ if VALUES.contains(&value)
                || (name == "target" && value.starts_with(|c: char| c.is_ascii_lowercase())) =>
            {
                (format!("{name}='{value}'"), 1 + value.len())
            }
            _ if number.parse::<f64>().is_ok() => (format!("{name}={number}"), 1 + number.len()),
            _ => (format!("{name}="), 0),
        };
        out += &(said + &rest[taken..]);
    }
    out
}

/// The warnings with the arguments of Python in their messages.
pub fn in_python(warnings: Vec<Record>) -> Vec<Record> {
    let translated = |warning: Record| Record { message: python_message(&warning.message), ..warning };
    warnings.into_iter().map(translated).collect()
}

/// Issues warnings that are not among those `known`, which the caller has issued before.
pub fn warn(py: Python<'_>, warnings: &[Record], known: &[Record]) -> PyResult<()> {
    let new = warnings.iter().filter(|warning| !known.contains(warning));
    new.map(Record::to_string).try_for_each(|message| issue_warning(py, &message))
}

/// Issues a warning.
pub fn issue_warning(py: Python<'_>, message: &str) -> PyResult<()> {
    let message = CString::new(message.replace('\0', "")).unwrap_or_default();
    PyErr::warn(py, &py.get_type::<Warning>(), &message, 1)
}

/// The exception for an error. Its text includes every problem and the help, as Python prints only
/// the text.
pub fn exception(py: Python<'_>, error: impl Into<nsim::Error>) -> PyErr {
    let error = error.into();
    let diagnostic = error.diagnostic();
    let reasons = match (&error, &diagnostic) {
        (nsim::Error::DoesNotFit(reasons), _) => reasons.iter().map(|reason| json!(reason)).collect(),
        (_, Some(first)) => std::iter::once(&**first).chain(first.others()).map(problem_dictionary).collect(),
        (_, None) => vec![json!({ "code": error.code(), "message": error.to_string(), "place": null, "help": null })],
    };
    let mut text = python_message(&error.to_string());
    let (mut problem, mut help): (Option<String>, Option<String>) = (None, None);
    if let Some(first) = &diagnostic {
        help = first.help.as_deref().map(python_message);
        help.iter().for_each(|help| text += &format!("\n  help: {help}"));
        first.others().iter().for_each(|other| text += &format!("\n{}", python_message(&other.to_string())));
        problem = place(first);
    }
    let exception = Error::new_err(text);
    let value = exception.value(py);
    let set = || {
        value.setattr("code", error.code())?;
        value.setattr("place", problem)?;
        value.setattr("help", help.as_deref())?;
        value.setattr("reasons", to_python(py, &Value::Array(reasons))?)
    };
    match set() {
        Ok(()) => exception,
        Err(other) => other,
    }
}

/// A problem as a dictionary.
fn problem_dictionary(problem: &Diagnostic) -> Value {
    let help = problem.help.as_deref().map(python_message);
    json!({ "code": problem.code, "message": python_message(&problem.message), "place": place(problem), "help": help })
}

fn place(diagnostic: &Diagnostic) -> Option<String> {
    let file = diagnostic.file()?.display();
    Some(match diagnostic.position() {
        Some(Position { line, column }) => format!("{file}:{line}:{column}"),
        None => file.to_string(),
    })
}
