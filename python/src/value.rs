//! Results as Python's own values.

use nsim::files::write::checksum;
use pyo3::prelude::*;

/// Converts JSON to dictionaries and lists of Python; results as the command line prints them.
pub fn to_python<'py>(py: Python<'py>, value: &serde_json::Value) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (checksum::printed(value.clone()).to_string(),))
}
