//! Converts Python dictionaries to settings, and JSON values to Python.

use crate::error::{raised, refused};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyInt, PyList, PyString, PyTuple};
use serde_json::Value as Json;
use std::path::PathBuf;
use trimip::{SettingValue, Settings};

/// Converts a Python value to the value of a setting; errors name the setting by its `path`.
fn setting_value(path: &str, value: &Bound<'_, PyAny>) -> PyResult<SettingValue> {
    // In Python, `True` is also an int, so booleans are checked first.
    if let Ok(value) = value.cast::<PyBool>() {
        return Ok(value.is_true().into());
    }
    if value.is_instance_of::<PyInt>() {
        return Ok(value.extract::<i64>()?.into());
    }
    if value.is_instance_of::<PyFloat>() {
        return Ok(value.extract::<f64>()?.into());
    }
    if value.is_instance_of::<PyString>() {
        return Ok(value.extract::<String>()?.into());
    }
    if value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>() {
        let items = value.try_iter()?.map(|item| setting_value(path, &item?));
        return Ok(items.collect::<PyResult<Vec<_>>>()?.into());
    }
    // Paths and numpy numbers.
    if let Ok(path) = value.extract::<PathBuf>() {
        return Ok(path.display().to_string().into());
    }
    if value.hasattr("item")? {
        return setting_value(path, &value.call_method0("item")?);
    }
    let kind = value.get_type().name()?.to_string();
    Err(refused(
        path,
        format!("a value of type {kind}"),
        "give a number, a text, a truth value or a list of them",
    ))
}

/// Applies a dictionary of settings: `{"train.seconds": 60}` or `{"train": {"seconds": 60}}`.
pub fn apply(settings: &mut Settings, values: &Bound<'_, PyDict>) -> PyResult<()> {
    put(settings, "", values)
}

fn put(settings: &mut Settings, section: &str, values: &Bound<'_, PyDict>) -> PyResult<()> {
    for (key, value) in values {
        let key: String = key.extract()?;
        let path = if section.is_empty() { key } else { format!("{section}.{key}") };
        match value.cast::<PyDict>() {
            Ok(inner) => put(settings, &path, inner)?,
            Err(_) => settings.set(&path, setting_value(&path, &value)?).map_err(raised)?,
        }
    }
    Ok(())
}

/// Converts a dictionary to assignments as on the command line: `section.key=value`.
pub fn assignments(values: Option<&Bound<'_, PyDict>>) -> PyResult<Vec<String>> {
    let mut all = Vec::new();
    if let Some(values) = values {
        flatten(&mut all, "", values)?;
    }
    Ok(all)
}

fn flatten(all: &mut Vec<String>, section: &str, values: &Bound<'_, PyDict>) -> PyResult<()> {
    for (key, value) in values {
        let key: String = key.extract()?;
        let path = if section.is_empty() { key } else { format!("{section}.{key}") };
        match value.cast::<PyDict>() {
            Ok(inner) => flatten(all, &path, inner)?,
            Err(_) => all.push(format!("{path}={}", setting_value(&path, &value)?)),
        }
    }
    Ok(())
}

/// Converts a value to Python through JSON.
pub fn python<'py>(py: Python<'py>, value: &impl serde::Serialize) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(value).map_err(|error| raised(trimip::Error::run(error)))?;
    py.import("json")?.call_method1("loads", (text,))
}

/// Converts a dictionary to JSON with Python's `json`.
pub fn json(value: &Bound<'_, PyDict>) -> PyResult<Json> {
    let text: String = value.py().import("json")?.call_method1("dumps", (value,))?.extract()?;
    serde_json::from_str(&text).map_err(|error| refused("lens", error, "give the keys of transforms.json"))
}
