//! Python exceptions for the library's errors, one class per cause.

use pyo3::create_exception;
use pyo3::exceptions::PyException;
use pyo3::prelude::*;
use trimip::{Advice, ErrorKind, Place};

create_exception!(
    trimip,
    Error,
    PyException,
    "Any error of trimip: one line with what, where and what to do."
);
create_exception!(trimip, InputError, Error, "A file, a setting or an argument is wrong.");
create_exception!(trimip, RunError, Error, "A run failed with valid input, or missed its quality floor.");
create_exception!(trimip, DeviceError, Error, "The device is missing, too small or lost.");

/// Converts an error to its exception, with the parts of the error as attributes.
pub fn raised(error: trimip::Error) -> PyErr {
    let raised = match error.kind() {
        ErrorKind::Input => InputError::new_err(error.message()),
        ErrorKind::Device => DeviceError::new_err(error.message()),
        _ => RunError::new_err(error.message()),
    };
    let with_parts = Python::attach(|py| {
        let value = raised.value(py);
        value.setattr("place", error.place().map(Place::to_string))?;
        value.setattr("path", error.place().and_then(Place::file))?;
        let line = match error.place() {
            Some(Place::Text { line, .. }) => Some(*line),
            _ => None,
        };
        value.setattr("line", line)?;
        value.setattr("found", error.found())?;
        value.setattr("advice", error.advice().map(Advice::to_string))
    });
    with_parts.err().unwrap_or(raised)
}

/// Creates the exception for a wrong argument.
pub fn refused(place: &str, what: impl std::fmt::Display, advice: &str) -> PyErr {
    raised(trimip::Error::input(place, what, advice))
}
