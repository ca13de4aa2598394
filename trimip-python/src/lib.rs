//! Python bindings of Tri-MipRF: the native module `trimip._trimip`, which the package in `python/trimip` wraps.
//!
//! Arrays are numpy arrays, errors are exceptions with the program's text, and the interpreter lock is released while the library works.
//! `camera`, `scene`, `model`, `mesh` and `train` have one class each, and `capture` one function. `listening` handles callbacks and Ctrl-C
//! during long work, `calls` runs the library without the interpreter lock, `value` converts settings and events, `error` converts errors.

mod calls;
mod camera;
mod capture;
mod error;
mod listening;
mod mesh;
mod model;
mod scene;
mod train;
mod value;

use pyo3::prelude::*;

/// Registers the classes and functions of the module.
#[pymodule]
fn _trimip(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("Error", py.get_type::<error::Error>())?;
    module.add("InputError", py.get_type::<error::InputError>())?;
    module.add("RunError", py.get_type::<error::RunError>())?;
    module.add("DeviceError", py.get_type::<error::DeviceError>())?;
    module.add_class::<camera::Camera>()?;
    module.add_class::<scene::Scene>()?;
    module.add_class::<model::Frame>()?;
    module.add_class::<model::Model>()?;
    module.add_class::<mesh::Mesh>()?;
    module.add_class::<train::Run>()?;
    module.add_function(wrap_pyfunction!(capture::capture, module)?)?;
    module.add_function(wrap_pyfunction!(capture::run_guard, module)?)?;
    module.add_function(wrap_pyfunction!(train::train, module)?)?;
    module.add_function(wrap_pyfunction!(train::defaults, module)?)?;
    module.add_function(wrap_pyfunction!(train::systems, module)?)?;
    module.add_function(wrap_pyfunction!(train::backends, module)?)?;
    Ok(())
}
