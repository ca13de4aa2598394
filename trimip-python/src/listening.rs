//! Callbacks and Ctrl-C during long work. Both stop the work through one flag.

use crate::value;
use pyo3::prelude::*;
use pyo3::types::PyBool;
use serde::Serialize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

/// A callback, and the exception that stopped the work.
pub struct Listener {
    callback: Option<Py<PyAny>>,
    /// Set when the work must stop.
    pub stop: AtomicBool,
    raised: Mutex<Option<PyErr>>,
}

impl Listener {
    /// Creates the listener of work that has not started.
    pub fn new(callback: Option<Py<PyAny>>) -> Self {
        Self { callback, stop: AtomicBool::new(false), raised: Mutex::new(None) }
    }

    /// Checks for Ctrl-C.
    pub fn check_signals(&self) {
        Python::attach(|py| self.keep(py.check_signals()));
    }

    /// Calls the callback with an event as a dictionary. The work stops if the callback returns False or raises an exception.
    pub fn tell(&self, event: &impl Serialize) {
        let Some(callback) = &self.callback else { return };
        Python::attach(|py| {
            let answer = value::python(py, event).and_then(|event| callback.call1(py, (event,)));
            if answer.as_ref().is_ok_and(|answer| answer.bind(py).is(PyBool::new(py, false))) {
                self.stop.store(true, Ordering::Relaxed);
            }
            self.keep(answer.map(drop));
        });
    }

    /// Returns the exception that Python raised; called after the work has ended.
    pub fn end(self) -> PyResult<()> {
        let raised = self.raised.into_inner().unwrap_or_else(PoisonError::into_inner);
        raised.map_or(Ok(()), Err)
    }

    /// Stops the work if `outcome` is an error, and keeps the first error.
    fn keep(&self, outcome: PyResult<()>) {
        if let Err(error) = outcome {
            self.stop.store(true, Ordering::Relaxed);
            self.raised.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
        }
    }
}
