//! Keyword arguments, each taken once by name; one that is left over is an error, as in Python.

use std::path::PathBuf;

use pyo3::conversion::FromPyObjectOwned;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Keyword arguments that are still to be taken.
pub struct Keywords<'py>(Option<Bound<'py, PyDict>>);

impl<'py> Keywords<'py> {
    /// Those of a call.
    pub fn new(given: Option<&Bound<'py, PyDict>>) -> PyResult<Self> {
        Ok(Keywords(given.map(|given| given.copy()).transpose()?))
    }

    /// The value of an argument, unless it is left out or `None`.
    pub fn take<T: FromPyObjectOwned<'py>>(&self, name: &str) -> PyResult<Option<T>> {
        let Some(given) = &self.0 else { return Ok(None) };
        let Some(value) = given.get_item(name)? else { return Ok(None) };
        given.del_item(name)?;
        if value.is_none() {
            return Ok(None);
        }
        value.extract().map(Some).map_err(Into::into)
    }

    /// A path or a name, as text.
    pub fn path(&self, name: &str) -> PyResult<Option<String>> {
        Ok(self.take::<PathBuf>(name)?.map(|path| path.to_string_lossy().into_owned()))
    }

    /// One of a closed set of values, by its name.
    pub fn one_of<T: Copy>(&self, name: &str, all: &[T], name_of: fn(T) -> &'static str) -> PyResult<Option<T>> {
        let Some(given) = self.take::<String>(name)? else { return Ok(None) };
        let found = all.iter().copied().find(|&value| name_of(value) == given);
        let known = || all.iter().map(|&value| name_of(value)).collect::<Vec<_>>().join(", ");
        match found {
            Some(value) => Ok(Some(value)),
            None => Err(usage(format!("{name} is one of {}, not '{given}'", known()))),
        }
    }

    /// Whether every argument was taken.
    pub fn none_left(&self) -> PyResult<()> {
        match self.0.as_ref().and_then(|left| left.keys().iter().next()) {
            None => Ok(()),
            Some(name) => Err(PyTypeError::new_err(format!("unexpected keyword argument '{name}'"))),
        }
    }
}

/// The exception for an argument that makes no sense.
pub fn usage(message: String) -> PyErr {
    Python::attach(|py| crate::error::raised(py, nsim::Error::Usage(message)))
}
