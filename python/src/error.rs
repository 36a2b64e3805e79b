//! Errors and warnings of the library as Python's.

use std::ffi::CString;

use nsim::base::diagnostic::{Diagnostic, Position};
use pyo3::exceptions::{PyException, PyUserWarning};
use pyo3::prelude::*;

pyo3::create_exception!(
    nsim,
    Error,
    PyException,
    "What nsim cannot do: `code` names the problem, `place` is FILE:LINE:COLUMN or None, `help` says what to change or is None."
);

pyo3::create_exception!(
    nsim,
    Warning,
    PyUserWarning,
    "What stands out in a run, such as a population that never spikes, and what would change it."
);

/// Warns of what stands out in a run.
pub fn warn(py: Python<'_>, found: &[nsim::drive::warnings::Warning]) -> PyResult<()> {
    for warning in found {
        let message = match &warning.population {
            Some(population) => format!("'{population}': {}", warning.message),
            None => warning.message.clone(),
        };
        let message = CString::new(message.replace('\0', "")).unwrap_or_default();
        PyErr::warn(py, &py.get_type::<Warning>(), &message, 1)?;
    }
    Ok(())
}

/// The exception for an error.
pub fn raised(py: Python<'_>, error: impl Into<nsim::Error>) -> PyErr {
    let error = error.into();
    let (code, place, help) = match &error {
        nsim::Error::Input(diagnostic) => (diagnostic.code, place(diagnostic), diagnostic.help.clone()),
        nsim::Error::Usage(_) => ("usage", None, None),
        nsim::Error::Fault(_) => ("fault", None, None),
    };
    let raised = Error::new_err(error.to_string());
    let value = raised.value(py);
    let set = value.setattr("code", code).and_then(|()| value.setattr("place", place));
    match set.and_then(|()| value.setattr("help", help.as_deref())) {
        Ok(()) => raised,
        Err(other) => other,
    }
}

fn place(diagnostic: &Diagnostic) -> Option<String> {
    let file = diagnostic.file()?.display();
    Some(match diagnostic.position() {
        Some(Position { line, column }) => format!("{file}:{line}:{column}"),
        None => file.to_string(),
    })
}
