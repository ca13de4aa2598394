//! `trimip.Model`: a trained model that can be rendered, queried and measured.

use crate::calls::{detached, expect_memory};
use crate::camera::{Camera, Numbers};
use crate::error::{raised, refused};
use crate::mesh::Mesh;
use crate::value;
use numpy::{PyArray1, PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};
use trimip::mesh::{self, Extraction, Goal, Surface};
use trimip::run::lock_for_writing;
use trimip::view::{PerceptualMetrics, TestViews, Watching, evaluate, pictures};
use trimip::{Viewer, backends, data, settings};
use trimip_core::{Query, field::encoders, run::evaluate::ViewResult, scene::origin::LocalOrigin};

/// Bytes of a rendered pixel: as the library returns it, and as the arrays of a [`Frame`] hold it.
const BYTES_OF_PIXEL: u64 = 2 * size_of::<trimip_core::Pixel>() as u64;

/// Bytes of a queried point: its coordinates and direction as given and as the library takes them, and the answer twice.
const BYTES_OF_QUERY: u64 = 2
    * (size_of::<[f64; 6]>() + size_of::<Query>() + size_of::<trimip_core::engine::batch::Radiance>()) as u64;

/// Rendered views as arrays: [height, width, …] for one view, [views, height, width, …] for several.
#[pyclass(frozen, get_all, module = "trimip")]
pub struct Frame {
    /// RGB over the background of the model: float32 […, 3].
    color: Py<PyArrayDyn<f32>>,
    /// Opacity in [0, 1]: float32 […].
    opacity: Py<PyArrayDyn<f32>>,
    /// Distance along the optical axis, world units: float32 […]; infinite where the ray hits nothing.
    depth: Py<PyArrayDyn<f32>>,
}

impl Frame {
    /// Collects frames of equal size; `shape` is the shape of the opacities.
    fn of(py: Python<'_>, shape: &[usize], frames: &[trimip::Frame]) -> PyResult<Self> {
        let colors = frames.iter().flat_map(|frame| frame.rgb()).flatten().collect();
        let opacities = frames.iter().flat_map(pictures::opacity).collect();
        let depths = frames.iter().flat_map(|frame| pictures::depth(frame, f32::INFINITY)).collect();
        let array = |numbers: Vec<f32>, shape: &[usize]| -> PyResult<Py<PyArrayDyn<f32>>> {
            Ok(PyArray1::from_vec(py, numbers).reshape(shape.to_vec())?.unbind())
        };
        Ok(Self {
            color: array(colors, &[shape, &[3]].concat())?,
            opacity: array(opacities, shape)?,
            depth: array(depths, shape)?,
        })
    }
}

impl Frame {
    /// Returns the picture as an 8-bit PNG; `None` for several views.
    fn png(&self, py: Python<'_>) -> PyResult<Option<Vec<u8>>> {
        let [height, width] = *self.opacity.bind(py).shape() else { return Ok(None) };
        let color =
            self.color.bind(py).to_vec().map_err(|error| refused("Frame", error, "copy its arrays"))?;
        let picture = pictures::rgb_image(width as u32, height as u32, color.as_chunks::<3>().0);
        detached(py, || pictures::png(picture))?.map(Some).map_err(raised)
    }
}

#[pymethods]
impl Frame {
    /// Writes the colours of a single view as an 8-bit PNG. Several views have to be rendered and saved one by one.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let place = path.display().to_string();
        if path.extension().is_none_or(|ending| !ending.eq_ignore_ascii_case("png")) {
            return Err(refused(&place, "is not the name of a PNG file", "give a name that ends in .png"));
        }
        let several = || refused("Frame", "holds several views", "render the view to save");
        let png = self.png(py)?.ok_or_else(several)?;
        detached(py, || trimip_core::atomic::write_atomically(&path, &png))?.map_err(raised)
    }

    /// Returns the PNG that a notebook shows; None for several views.
    fn _repr_png_<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyBytes>>> {
        Ok(self.png(py)?.map(|png| PyBytes::new(py, &png)))
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        format!("Frame({:?})", self.opacity.bind(py).shape())
    }
}

/// Checks Python for Ctrl-C, and keeps the exception until the work has stopped.
#[derive(Default)]
pub struct Interrupted(Option<PyErr>);

impl Interrupted {
    /// Returns false once Ctrl-C has been pressed.
    pub fn goes_on(&mut self) -> bool {
        if self.0.is_none() {
            self.0 = Python::attach(|py| py.check_signals()).err();
        }
        self.0.is_none()
    }

    /// Raises the exception, if there is one.
    pub fn raise(self) -> PyResult<()> {
        self.0.map_or(Ok(()), Err)
    }
}

impl Watching for Interrupted {
    fn rendering(&mut self, _: usize, _: usize, _: f64) -> bool {
        self.goes_on()
    }

    fn view(&mut self, _: &ViewResult<'_>, _: usize, _: usize) -> bool {
        self.goes_on()
    }
}

/// A trained model on a backend. Several threads may share a model; their calls take turns.
#[pyclass(frozen, module = "trimip")]
pub struct Model {
    model: trimip::model::Model,
    viewer: Mutex<Box<dyn Viewer>>,
}

impl Model {
    /// Loads a model onto the backend that its settings name.
    pub fn open(py: Python<'_>, model: trimip::model::Model) -> PyResult<Self> {
        let viewer = detached(py, || backends::load(&model))?.map_err(raised)?;
        Ok(Self { model, viewer: Mutex::new(viewer) })
    }

    /// Returns the origin of the model's coordinates in the coordinates of the photographs, which Python uses.
    fn origin(&self) -> LocalOrigin {
        LocalOrigin::of(&self.model.config.data)
    }

    /// Runs `work` on the viewer with the interpreter lock released. A thread that holds this lock never waits for the viewer.
    fn work<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut dyn Viewer, &mut Interrupted) -> trimip::Result<Option<T>> + Send,
    ) -> PyResult<T> {
        let mut interrupted = Interrupted::default();
        let done = detached(py, || {
            let mut viewer = self.viewer.lock().unwrap_or_else(PoisonError::into_inner);
            work(&mut **viewer, &mut interrupted)
        })?;
        interrupted.raise()?;
        done.map_err(raised)?.ok_or_else(|| raised(trimip::Error::stopped()))
    }

    fn queries(
        &self,
        points: &Numbers<'_>,
        directions: Option<&Numbers<'_>>,
        radius: Option<f64>,
    ) -> PyResult<Vec<Query>> {
        let count = points.as_array().len() / 3;
        expect_memory(&format!("a query of {count} points"), count as u64 * BYTES_OF_QUERY)?;
        let points = threes("points", points)?;
        let directions = match directions.map(|given| threes("directions", given)).transpose()? {
            None => vec![[0.0, 0.0, -1.0]; count],
            Some(given) if given.len() == 1 => vec![given[0]; count],
            Some(given) if given.len() == count => given,
            Some(given) => {
                let found = format!("{} rows for {count} points", given.len());
                return Err(refused("directions", found, "give one, or one for each point"));
            }
        };
        let radius = radius.unwrap_or_else(|| 0.5 * f64::from(self.model.config.step_length()));
        if !(radius > 0.0 && radius.is_finite()) {
            return Err(refused("radius", radius, "give a length above 0, in world units"));
        }
        let one = |(point, direction): ([f64; 3], [f64; 3])| {
            let unit = glam::DVec3::from_array(direction).try_normalize();
            let unit = unit.ok_or_else(|| {
                refused("directions", "has a zero vector", "give vectors with a length above 0")
            })?;
            let direction = unit.to_array().map(|number| number as f32);
            Ok(Query { point: self.origin().local(point), radius: radius as f32, direction })
        };
        points.into_iter().zip(directions).map(one).collect()
    }
}

#[pymethods]
impl Model {
    /// Loads the model of a run folder or a model file. `settings` override settings of rendering and of the data.
    #[staticmethod]
    #[pyo3(signature = (path, settings=None))]
    fn load(py: Python<'_>, path: PathBuf, settings: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let assignments = value::assignments(settings)?;
        let model = detached(py, || {
            let mut model = trimip::read_model(&path)?;
            settings::override_model(&mut model, &assignments)?;
            Ok(model)
        })?;
        Self::open(py, model.map_err(raised)?)
    }

    /// Renders one view. Its arrays have the shape [height, width, …].
    fn render(&self, py: Python<'_>, camera: &Camera) -> PyResult<Frame> {
        let camera = self.origin().local(camera.0);
        expect_room(1, &camera)?;
        let frame = self.work(py, |viewer, interrupted| {
            viewer.render_watched(&camera, &mut |_, _| interrupted.goes_on())
        })?;
        Frame::of(py, &[frame.height as usize, frame.width as usize], &[frame])
    }

    /// Renders the views of cameras that have equal picture sizes. The arrays have the shape [views, height, width, …].
    fn render_batch(&self, py: Python<'_>, cameras: Vec<Camera>) -> PyResult<Frame> {
        let Some(first) = cameras.first().map(|camera| camera.0.intrinsics) else {
            return Err(refused("cameras", "none", "give at least one"));
        };
        expect_room(cameras.len(), &cameras[0].0)?;
        let size = [first.height, first.width];
        if cameras.iter().any(|camera| [camera.0.intrinsics.height, camera.0.intrinsics.width] != size) {
            return Err(refused("cameras", "pictures of different sizes", "render them one by one"));
        }
        let origin = self.origin();
        let frames = self.work(py, |viewer, interrupted| {
            let mut frames = Vec::with_capacity(cameras.len());
            for camera in &cameras {
                match viewer.render_watched(&origin.local(camera.0), &mut |_, _| interrupted.goes_on())? {
                    Some(frame) => frames.push(frame),
                    None => return Ok(None),
                }
            }
            Ok(Some(frames))
        })?;
        Frame::of(py, &[frames.len(), size[0] as usize, size[1] as usize], &frames)
    }

    /// Returns density, float32 […] per world unit, and colour, float32 […, 3], at `points`, […, 3] in world units. `directions` are the
    /// viewing directions from the eye to the points, […, 3] or a single one (default: −z). `radius` is the radius of the queried spheres,
    /// world units (default: half a marching step).
    #[pyo3(signature = (points, directions=None, radius=None))]
    #[expect(clippy::type_complexity, reason = "two arrays")]
    fn query<'py>(
        &self,
        py: Python<'py>,
        points: Numbers<'py>,
        directions: Option<Numbers<'py>>,
        radius: Option<f64>,
    ) -> PyResult<(Bound<'py, PyArrayDyn<f32>>, Bound<'py, PyArrayDyn<f32>>)> {
        let shape = leading(&points);
        let queries = self.queries(&points, directions.as_ref(), radius)?;
        let found = self.work(py, |viewer, _| viewer.query(&queries).map(Some))?;
        let density = found.iter().map(|radiance| radiance.density).collect();
        let color: Vec<f32> = found.iter().flat_map(|radiance| radiance.rgb).collect();
        let color = PyArray1::from_vec(py, color).reshape([&shape[..], &[3]].concat())?;
        Ok((PyArray1::from_vec(py, density).reshape(shape)?, color))
    }

    /// Returns the encoder's features at `points`, with `radius` as in `query`: float32 […, features].
    #[pyo3(signature = (points, radius=None))]
    fn features<'py>(
        &self,
        py: Python<'py>,
        points: Numbers<'py>,
        radius: Option<f64>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let queries = self.queries(&points, None, radius)?;
        let config = &self.model.config;
        let width = encoders::of(config).width(config);
        let bytes = (queries.len() * width * size_of::<f32>()) as u64;
        expect_memory(&format!("features of {} points", queries.len()), bytes)?;
        let found = self.work(py, |viewer, _| viewer.features(&queries).map(Some))?;
        PyArray1::from_vec(py, found).reshape([&leading(&points)[..], &[width]].concat())
    }

    /// Extracts the surface where the density crosses `level` (default: the density at which a marching step has an optical depth of 0.2). In
    /// contracted space without a `level`, extracts the surface on which the depths of the training views agree.
    /// The grid has `resolution` cells along the longest side, and the mesh is simplified to about `triangles` triangles (0: all are kept).
    /// The mesh is closed unless the scene has a crop (`scene.crop`) or is contracted.
    #[pyo3(signature = (resolution=512, *, level=None, triangles=100_000, specks=0.02, colors=true))]
    #[expect(clippy::too_many_arguments, reason = "keywords in Python")]
    fn mesh(
        &self,
        py: Python<'_>,
        resolution: u32,
        level: Option<f64>,
        triangles: usize,
        specks: f64,
        colors: bool,
    ) -> PyResult<Mesh> {
        let goal = if triangles == 0 { Goal::Everything } else { Goal::Triangles(triangles) };
        let model = &self.model;
        let extracted = self.work(py, |viewer, interrupted| {
            // If the photographs are missing, there are no cameras, and hidden parts are determined from the surface only.
            let cameras = model.config.section().and_then(|config| data::open_test(&config));
            let cameras = cameras.map(|set| set.train).unwrap_or_default();
            let mut what = Extraction {
                resolution,
                level,
                specks,
                goal,
                colors,
                ..Extraction::of(&model.config, &cameras)
            };
            if level.is_some() {
                what.surface = Surface::Density;
            }
            mesh::extract(viewer, model, &what, &cameras, &mut |_| interrupted.goes_on())
        })?;
        Ok(Mesh(extracted.mesh))
    }

    /// Measures every `stride`-th test view at every scale, as `trimip-cli eval` does. Returns a dictionary with `stride`, `scales` and
    /// `views` (PSNR, SSIM, …), `mean` and `seconds`.
    #[pyo3(signature = (stride=1))]
    fn evaluate<'py>(&self, py: Python<'py>, stride: usize) -> PyResult<Bound<'py, PyAny>> {
        let config = &self.model.config;
        let measured = self.work(py, |viewer, interrupted| {
            let mut perceptual = PerceptualMetrics::open(&config.eval)?;
            let set = data::open_test(&config.section()?)?;
            let test = TestViews { frames: &*set.frames, data: &config.data, stride };
            evaluate(viewer, test, &mut perceptual, interrupted, None)
        })?;
        value::python(
            py,
            &serde_json::json!({
                "stride": stride,
                "scales": measured.scales,
                "mean": measured.mean,
                "views": measured.views,
                "seconds": measured.seconds,
            }),
        )
    }

    /// Writes the model file, whose name ends in .safetensors, and returns its size in bytes.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<u64> {
        if path.extension().is_none_or(|ending| !ending.eq_ignore_ascii_case("safetensors")) {
            let place = path.display().to_string();
            return Err(refused(
                &place,
                "is not the name of a model file",
                "give a name that ends in .safetensors",
            ));
        }
        let write = || {
            let _held = lock_for_writing(&path)?;
            self.model.write(&path)
        };
        detached(py, write)?.map_err(raised)
    }

    /// All settings, as nested dictionaries.
    #[getter]
    fn config<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let settings = settings::of(&self.model.config).map_err(raised)?;
        value::python(py, &settings)
    }

    /// Origin of the model's local coordinates (`aabb`, mesh positions) in the coordinates of the photographs, which cameras and points
    /// use: three numbers, which are 0 unless the photographs are far from the origin of their coordinates (data.origin).
    #[getter]
    fn local_origin(&self) -> [f64; 3] {
        self.origin().numbers()
    }

    /// Lower and upper corner of the scene's box, world units, relative to `local_origin`.
    #[getter]
    fn aabb(&self) -> ([f32; 3], [f32; 3]) {
        (self.model.config.scene.aabb_min, self.model.config.scene.aabb_max)
    }

    /// Names of the backend and the device.
    #[getter]
    fn device(&self, py: Python<'_>) -> PyResult<String> {
        self.work(py, |viewer, _| Ok(Some(format!("{}: {}", viewer.backend(), viewer.device_name()))))
    }

    fn __repr__(&self) -> String {
        format!("Model({:?}, {})", self.model.config.encoder.kind, self.model.config.backend)
    }
}

/// Checks that there is memory for `views` pictures of the size of `camera`.
fn expect_room(views: usize, camera: &trimip::Camera) -> PyResult<()> {
    let [width, height] = [camera.intrinsics.width, camera.intrinsics.height].map(u64::from);
    let bytes = views as u64 * width * height * BYTES_OF_PIXEL;
    expect_memory(&format!("rendering {views} × {width} × {height} pixels"), bytes)
}

/// Returns the shape of points without their last axis of three numbers; [1] for a single point.
fn leading(points: &Numbers<'_>) -> Vec<usize> {
    let array = points.as_array();
    match array.ndim() {
        0 | 1 => vec![1],
        dimensions => array.shape()[..dimensions - 1].to_vec(),
    }
}

/// Converts an array to rows of three finite numbers. The array may have any leading axes, or none for a single row.
fn threes(name: &str, numbers: &Numbers<'_>) -> PyResult<Vec<[f64; 3]>> {
    let array = numbers.as_array();
    if array.shape().last() != Some(&3) {
        return Err(refused(name, format!("an array of shape {:?}", array.shape()), "give […, 3]"));
    }
    let flat: Vec<f64> = array.iter().copied().collect();
    if flat.iter().any(|number| !number.is_finite()) {
        return Err(refused(name, "a number that is not finite", "leave such rows out"));
    }
    Ok(flat.as_chunks::<3>().0.to_vec())
}
