//! Keyword arguments, each read once by name; an unread one is an error, as in Python.

use std::ops::RangeInclusive;
use std::path::PathBuf;

use nsim::ir::base::diagnostic::Diagnostic;
use pyo3::conversion::FromPyObjectOwned;
use pyo3::exceptions::{PyOverflowError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Characters of a value that messages show.
const SHOWN: usize = 40;

/// Keyword arguments that have not been read.
pub struct Keywords<'py>(Option<Bound<'py, PyDict>>);

impl<'py> Keywords<'py> {
    /// Copies the keyword arguments of a call.
    pub fn new(given: Option<&Bound<'py, PyDict>>) -> PyResult<Self> {
        Ok(Keywords(given.map(|given| given.copy()).transpose()?))
    }

    /// The value of an argument, unless it is omitted or `None`.
    pub fn take<T: FromPyObjectOwned<'py>>(&self, name: &str) -> PyResult<Option<T>> {
        let Some(given) = &self.0 else { return Ok(None) };
        let Some(value) = given.get_item(name)? else { return Ok(None) };
        given.del_item(name)?;
        if value.is_none() {
            return Ok(None);
        }
        value.extract().map(Some).map_err(|error: T::Error| wrong(name, &value, error.into()))
    }

    /// Copies one argument alone, which remains unread here.
    pub fn only(&self, name: &str) -> PyResult<Self> {
        let value = self.0.as_ref().map(|given| given.get_item(name)).transpose()?.flatten();
        let alone = value.map(|value| {
            let alone = PyDict::new(value.py());
            alone.set_item(name, value).map(|()| alone)
        });
        Ok(Keywords(alone.transpose()?))
    }

    /// A whole number within bounds.
    pub fn whole(&self, name: &str, bounds: RangeInclusive<u64>) -> PyResult<Option<u64>> {
        self.take::<Bound<'_, PyAny>>(name)?.map(|value| whole(name, &value, bounds)).transpose()
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
            None => Err(usage(
                format!("{name} is '{given}', which is not supported"),
                &format!("{name} is one of {}", known()),
            )),
        }
    }

    /// Refuses an argument that has not been read.
    pub fn refuse_unread(&self) -> PyResult<()> {
        match self.0.as_ref().and_then(|left| left.keys().iter().next()) {
            None => Ok(()),
            Some(name) => Err(PyTypeError::new_err(format!("unexpected keyword argument '{name}'"))),
        }
    }
}

/// A whole number within bounds.
pub fn whole(name: &str, value: &Bound<'_, PyAny>, bounds: RangeInclusive<u64>) -> PyResult<u64> {
    let number = value.extract::<u64>();
    match number {
        Ok(number) if bounds.contains(&number) => Ok(number),
        Err(error) if !error.is_instance_of::<PyOverflowError>(value.py()) => Err(wrong(name, value, error)),
        _ => {
            let (least, most) = bounds.into_inner();
            let message = format!("{name} is {}, outside of {least} to {most}", short_repr(value));
            Err(usage(message, &format!("give {name} a whole number from {least} to {most}")))
        }
    }
}

/// The exception for an argument out of its range, or of another type.
fn wrong(name: &str, value: &Bound<'_, PyAny>, error: PyErr) -> PyErr {
    let (py, said) = (value.py(), error.value(value.py()));
    if error.is_instance_of::<PyOverflowError>(py) || error.is_instance_of::<PyValueError>(py) {
        let value = short_repr(value);
        let help = match value.contains('-') {
            true => format!("give {name} a number that is not negative"),
            false => format!("give {name} a smaller number, or the right number of values"),
        };
        return usage(format!("{name} is {value}, which is not supported: {said}"), &help);
    }
    match error.is_instance_of::<PyTypeError>(py) {
        true => PyTypeError::new_err(format!("{name}: {said}")),
        false => error,
    }
}

/// The beginning of a value as Python writes it.
fn short_repr(value: &Bound<'_, PyAny>) -> String {
    let text = value.repr().map_or_else(|_| "a number of many digits".to_string(), |text| text.to_string());
    if text.chars().count() <= SHOWN { text } else { text.chars().take(SHOWN).chain(" ..".chars()).collect() }
}

/// The exception for an invalid argument, and its remedy.
pub fn usage(message: String, help: &str) -> PyErr {
    Python::attach(|py| crate::error::exception(py, Diagnostic::new("usage", message).help(help)))
}
