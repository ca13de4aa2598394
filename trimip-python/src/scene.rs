//! `trimip.Scene`: photographs with their cameras.

use crate::calls::detached;
use crate::camera::Camera;
use crate::error::{raised, refused};
use crate::value;
use numpy::{PyArray1, PyArray3, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use trimip::{Config, Frames, ViewSet, data};

/// Photographs with their cameras: the training and the test views of a folder, or of the built-in scene.
#[pyclass(frozen, module = "trimip")]
pub struct Scene {
    config: Config,
    set: data::TestSet,
}

impl Scene {
    fn frames(&self, split: &str) -> PyResult<&dyn Frames> {
        match split {
            "test" => Ok(&*self.set.frames),
            "train" => Ok(&*self.set.photographs),
            other => Err(refused("split", format!("\"{other}\""), "give \"test\" or \"train\"")),
        }
    }

    /// Loads a frame at all scales. Returns it with the index of the view that is reduced by `scale`.
    fn load(&self, py: Python<'_>, index: usize, split: &str, scale: u32) -> PyResult<(ViewSet, usize)> {
        let frames = self.frames(split)?;
        if index >= frames.len() {
            let advice = "give a smaller index";
            return Err(refused("index", format!("{index} of {} {split} views", frames.len()), advice));
        }
        let set = detached(py, || frames.load(index))?.map_err(raised)?;
        match set.scales.iter().position(|own| own.factor == scale) {
            Some(at) => Ok((set, at)),
            None => {
                let have: Vec<u32> = set.scales.iter().map(|own| own.factor).collect();
                Err(refused(
                    "scale",
                    scale,
                    &format!("give one of {have:?}; data.scales sets how many there are"),
                ))
            }
        }
    }
}

#[pymethods]
impl Scene {
    /// Opens a folder of photographs. Without `root`, opens the data that `settings` select; the default is the built-in scene.
    #[new]
    #[pyo3(signature = (root=None, settings=None))]
    fn new(py: Python<'_>, root: Option<PathBuf>, settings: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let mut all = trimip::settings::defaults();
        match root {
            Some(root) => all.set("data.root", root.display().to_string()),
            None => all.set("data.format", "builtin"),
        }
        .map_err(raised)?;
        if let Some(settings) = settings {
            value::apply(&mut all, settings)?;
        }
        let config = Config::from_settings(&all).map_err(raised)?;
        let set = detached(py, || data::open_test(&config.section()?))?.map_err(raised)?;
        Ok(Self { config, set })
    }

    /// Name of the scene's folder, or "builtin".
    #[getter]
    fn name(&self) -> &str {
        &self.set.name
    }

    /// Warnings about the data, one line each.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.set.warnings.clone()
    }

    /// Returns the number of photographs of a split.
    #[pyo3(signature = (split="test"))]
    fn count(&self, split: &str) -> PyResult<usize> {
        Ok(self.frames(split)?.len())
    }

    /// Returns the cameras of a split ("test" or "train") at full size.
    #[pyo3(signature = (split="test"))]
    fn cameras(&self, split: &str) -> PyResult<Vec<Camera>> {
        let frames = self.frames(split)?;
        let all = frames.cameras();
        let each = (all.len() / frames.len().max(1)).max(1);
        Ok(all.into_iter().step_by(each).map(Camera).collect())
    }

    /// Returns a photograph, composited over the background of the settings: float32 [height, width, 3] in [0, 1].
    #[pyo3(signature = (index, split="test", scale=1))]
    fn photograph<'py>(
        &self,
        py: Python<'py>,
        index: usize,
        split: &str,
        scale: u32,
    ) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let (set, at) = self.load(py, index, split, scale)?;
        let k = set.views[at].camera.intrinsics;
        let rgb = set.composited(at, self.config.data.background);
        PyArray1::from_vec(py, rgb.into_flattened()).reshape([k.height as usize, k.width as usize, 3])
    }

    /// Returns the stored RGBA pixels of a photograph: uint8 [height, width, 4]. Alpha is the opacity or, for masked
    /// captures, the share of the pixel that is kept.
    #[pyo3(signature = (index, split="test", scale=1))]
    fn pixels<'py>(
        &self,
        py: Python<'py>,
        index: usize,
        split: &str,
        scale: u32,
    ) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let (set, at) = self.load(py, index, split, scale)?;
        let k = set.views[at].camera.intrinsics;
        let pixels = set.pixels_of(at).to_vec();
        PyArray1::from_vec(py, pixels.into_flattened()).reshape([k.height as usize, k.width as usize, 4])
    }

    fn __repr__(&self) -> String {
        let (test, train) = (self.set.frames.len(), self.set.photographs.len());
        format!("Scene({:?}, {train} training and {test} test views)", self.set.name)
    }
}
