//! Tri-MipRF from Python. The module `trimip._trimip`; `python/trimip` is the package around it.
//!
//! Arrays are numpy's, errors are exceptions with the text of the program, and the interpreter is free while this library
//! works. Each file is one class: `camera`, `scene`, `model`, `mesh`, `train`; `capture` is one function;
//! `listening` brings callbacks and Ctrl-C to long work, `value` converts settings and
//! events, `error` errors.

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

/// Fills the module.
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
