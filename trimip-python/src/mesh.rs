//! `trimip.Mesh`: the surface of a model.

use crate::calls::detached;
use crate::error::raised;
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use std::path::PathBuf;
use trimip::mesh;

/// A triangle mesh in the world of the photographs' cameras.
#[pyclass(frozen, module = "trimip")]
pub struct Mesh(pub mesh::Mesh);

#[pymethods]
impl Mesh {
    /// Positions of the vertices relative to `origin`, world units: float32 [vertices, 3].
    #[getter]
    fn positions<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        threes(py, &self.0.positions)
    }

    /// Origin of `positions` in the coordinates of the photographs: three numbers, which are 0 unless the photographs
    /// are far from the origin of their coordinates. Written files have the coordinates of the photographs.
    #[getter]
    fn origin(&self) -> [f64; 3] {
        self.0.origin.numbers()
    }

    /// Unit normals of the vertices, outward: float32 [vertices, 3].
    #[getter]
    fn normals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        threes(py, &self.0.normals)
    }

    /// Colours of the vertices: float32 [vertices, 3] in [0, 1]; [0, 3] without colours.
    #[getter]
    fn colors<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        threes(py, &self.0.colors)
    }

    /// Vertex indices of the triangles, counterclockwise as seen from outside: uint32 [triangles, 3].
    #[getter]
    fn triangles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        threes(py, &self.0.triangles)
    }

    /// Enclosed volume, cubic world units.
    #[getter]
    fn volume(&self) -> f64 {
        self.0.volume()
    }

    /// True if the mesh is closed, manifold and oriented.
    #[getter]
    fn is_closed(&self) -> bool {
        self.0.defects() == mesh::Defects::default()
    }

    /// Writes a PLY, OBJ, GLB or USDZ file, as the file extension specifies; returns its size in bytes.
    fn write(&self, py: Python<'_>, path: PathBuf) -> PyResult<u64> {
        detached(py, || mesh::write(&self.0, &path))?.map_err(raised)
    }

    fn __repr__(&self) -> String {
        format!("Mesh({} vertices, {} triangles)", self.0.positions.len(), self.0.triangles.len())
    }
}

fn threes<'py, T: numpy::Element + Copy>(
    py: Python<'py>,
    rows: &[[T; 3]],
) -> PyResult<Bound<'py, PyArray2<T>>> {
    PyArray1::from_vec(py, rows.as_flattened().to_vec()).reshape([rows.len(), 3])
}
