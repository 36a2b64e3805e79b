//! Results as Python's own values.

use nsim::files::write::checksum;
use pyo3::prelude::*;

/// JSON as Python's own dictionaries and lists; a result as the command line prints it.
pub fn to_python<'py>(py: Python<'py>, value: &serde_json::Value) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (checksum::printed(value.clone()).to_string(),))
}
