//! `trimip.Camera`: a pose, the size of a picture, a projection.

use crate::error::{raised, refused};
use crate::value;
use glam::DVec3;
use numpy::{AllowTypeChange, PyArray1, PyArray2, PyArrayLike1, PyArrayLikeDyn, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::Value;
use trimip::view::cameras::{MAX_SIDE, aimed, posed, resized};
use trimip::{Intrinsics, data};

/// Any array-like object of numbers.
pub type Numbers<'py> = PyArrayLikeDyn<'py, f64, AllowTypeChange>;

/// Three numbers.
type Three<'py> = PyArrayLike1<'py, f64, AllowTypeChange>;

/// A camera: a pose in the world, a picture size, and a projection.
#[pyclass(frozen, from_py_object, module = "trimip")]
#[derive(Clone)]
pub struct Camera(pub trimip::Camera);

/// The projection of a camera, as given in Python.
struct Projection<'a, 'py> {
    width: i64,
    height: i64,
    fov: Option<f64>,
    focal: [Option<f64>; 2],
    centre: [Option<f64>; 2],
    lens: Option<&'a Bound<'py, PyDict>>,
}

impl Projection<'_, '_> {
    fn intrinsics(&self) -> PyResult<Intrinsics> {
        let Self { width, height, fov, focal: [fx, fy], centre: [cx, cy], lens } = *self;
        let side = |side: i64| u32::try_from(side).ok().filter(|side| (1..=MAX_SIDE as u32).contains(side));
        let (Some(width), Some(height)) = (side(width), side(height)) else {
            let advice = format!("give from one to {MAX_SIDE} pixels along each side");
            return Err(refused("Camera", format!("{width} by {height} pixels"), &advice));
        };
        let mut k = match (fov, fx) {
            (Some(fov), None) if fov > 0.0 && fov < 180.0 => {
                Intrinsics::from_angle(width, height, fov.to_radians())
            }
            (None, Some(fx)) if fx > 0.0 && fx.is_finite() => {
                Intrinsics { fx, fy: fx, ..Intrinsics::from_angle(width, height, 1.0) }
            }
            _ => {
                let advice = "give either `fov` (horizontal, degrees, above 0 and below 180) or `fx` (pixels, above 0)";
                return Err(refused("Camera", "needs one focal length", advice));
            }
        };
        k.fy = fy.unwrap_or(k.fy);
        k.cx = cx.unwrap_or(k.cx);
        k.cy = cy.unwrap_or(k.cy);
        if !(k.fy > 0.0 && [k.fy, k.cx, k.cy].iter().all(|number| number.is_finite())) {
            return Err(refused("Camera", "a projection that is not finite", "check fy, cx and cy"));
        }
        if let Some(lens) = lens {
            k.lens =
                data::lens_of(&"lens".into(), &value::json(lens)?, &Value::Object(serde_json::Map::new()))
                    .map_err(raised)?;
        }
        Ok(k)
    }
}

#[pymethods]
impl Camera {
    /// Creates a camera from a camera-to-world matrix [R|t], 3×4 or 4×4, with OpenGL axes (x right, y up, the camera looks along −z). Give
    /// either `fov` (horizontal, degrees) or `fx` (pixels); `lens` has the keys of transforms.json (k1, k2, p1, p2, …).
    #[new]
    #[pyo3(signature = (pose, width, height, *, fov=None, fx=None, fy=None, cx=None, cy=None, lens=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords in Python")]
    fn new(
        pose: Numbers<'_>,
        width: i64,
        height: i64,
        fov: Option<f64>,
        fx: Option<f64>,
        fy: Option<f64>,
        cx: Option<f64>,
        cy: Option<f64>,
        lens: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let k = Projection { width, height, fov, focal: [fx, fy], centre: [cx, cy], lens }.intrinsics()?;
        let numbers: Vec<f64> = pose.as_array().iter().copied().collect();
        Ok(Self(posed("pose", &numbers, k).map_err(raised)?))
    }

    /// Creates a camera at `eye` that looks at `target`; `up` is z by default.
    #[staticmethod]
    #[pyo3(signature = (eye, target, width, height, *, up=None, fov=None, fx=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords in Python")]
    fn look_at(
        eye: Three<'_>,
        target: Three<'_>,
        width: i64,
        height: i64,
        up: Option<Three<'_>>,
        fov: Option<f64>,
        fx: Option<f64>,
    ) -> PyResult<Self> {
        let k = Projection { width, height, fov, focal: [fx, None], centre: [None; 2], lens: None };
        let up = up.map_or(Ok(DVec3::Z), |up| vector("up", &up))?;
        let (eye, target) = (vector("eye", &eye)?, vector("target", &target)?);
        Ok(Self(aimed("Camera.look_at", eye, target, up, k.intrinsics()?).map_err(raised)?))
    }

    /// Creates one camera per matrix of `poses`, [N, 3|4, 4]. The projection has the parameters of `Camera`, each as one number for all
    /// cameras or as one per camera.
    #[staticmethod]
    #[pyo3(signature = (poses, width, height, *, fov=None, fx=None, fy=None, cx=None, cy=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords in Python")]
    fn batch(
        poses: Numbers<'_>,
        width: i64,
        height: i64,
        fov: Option<Numbers<'_>>,
        fx: Option<Numbers<'_>>,
        fy: Option<Numbers<'_>>,
        cx: Option<Numbers<'_>>,
        cy: Option<Numbers<'_>>,
    ) -> PyResult<Vec<Self>> {
        let poses = poses.as_array();
        if poses.ndim() != 3 {
            let found = format!("an array of shape {:?}", poses.shape());
            return Err(refused("poses", found, "give [N, 3, 4] or [N, 4, 4]"));
        }
        let count = poses.shape()[0];
        let each = |name: &str, own: &Option<Numbers<'_>>| -> PyResult<Vec<Option<f64>>> {
            let Some(own) = own else { return Ok(vec![None; count]) };
            let own = own.as_array();
            match own.len() {
                1 => Ok(vec![own.first().copied(); count]),
                length if length == count => Ok(own.iter().map(|&number| Some(number)).collect()),
                length => {
                    Err(refused(name, format!("{length} numbers for {count} poses"), "give one, or one each"))
                }
            }
        };
        let [fov, fx, fy, cx, cy] =
            [each("fov", &fov)?, each("fx", &fx)?, each("fy", &fy)?, each("cx", &cx)?, each("cy", &cy)?];
        let one = |(i, pose): (usize, numpy::ndarray::ArrayViewD<'_, f64>)| {
            let (focal, centre) = ([fx[i], fy[i]], [cx[i], cy[i]]);
            let k = Projection { width, height, fov: fov[i], focal, centre, lens: None }.intrinsics()?;
            let numbers: Vec<f64> = pose.iter().copied().collect();
            Ok(Self(posed(format!("poses[{i}]"), &numbers, k).map_err(raised)?))
        };
        poses.outer_iter().map(|pose| pose.into_dyn()).enumerate().map(one).collect()
    }

    /// Returns the same view with `factor` times as many pixels along each side.
    fn resized(&self, factor: f64) -> PyResult<Self> {
        let advice = format!("give a number above 0 that keeps the picture within {MAX_SIDE} pixels");
        let resized = resized(self.0.intrinsics, factor);
        let intrinsics =
            resized.map_err(|_| refused("factor", format!("{factor} is out of range"), &advice))?;
        Ok(Self(trimip::Camera { intrinsics, ..self.0 }))
    }

    /// Camera-to-world matrix [R|t], [3, 4], OpenGL axes.
    #[getter]
    fn pose<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let (r, t) = (self.0.rotation, self.0.origin);
        let row = |i: usize| [r.col(0)[i], r.col(1)[i], r.col(2)[i], t[i]];
        PyArray1::from_vec(py, [row(0), row(1), row(2)].concat()).reshape([3, 4])
    }

    /// Width of the picture, pixels.
    #[getter]
    fn width(&self) -> u32 {
        self.0.intrinsics.width
    }

    /// Height of the picture, pixels.
    #[getter]
    fn height(&self) -> u32 {
        self.0.intrinsics.height
    }

    /// Focal length along x, pixels.
    #[getter]
    fn fx(&self) -> f64 {
        self.0.intrinsics.fx
    }

    /// Focal length along y, pixels.
    #[getter]
    fn fy(&self) -> f64 {
        self.0.intrinsics.fy
    }

    /// Principal point along x, pixels.
    #[getter]
    fn cx(&self) -> f64 {
        self.0.intrinsics.cx
    }

    /// Principal point along y, pixels.
    #[getter]
    fn cy(&self) -> f64 {
        self.0.intrinsics.cy
    }

    /// Creates a camera from its pickled text.
    #[staticmethod]
    fn _restored(text: &str) -> PyResult<Self> {
        serde_json::from_str(text).map(Self).map_err(|error| {
            refused("Camera", format!("a pickle of another version: {error}"), "pickle it again")
        })
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, (String,))> {
        let text = serde_json::to_string(&slf.get().0);
        let text = text.map_err(|error| refused("Camera", error, "choose a camera with finite numbers"))?;
        Ok((slf.get_type().getattr("_restored")?, (text,)))
    }

    fn __repr__(&self) -> String {
        let k = self.0.intrinsics;
        format!(
            "Camera({}×{}, fx={:.2}, fy={:.2}, at {:?})",
            k.width,
            k.height,
            k.fx,
            k.fy,
            self.0.origin.to_array()
        )
    }
}

fn vector(name: &str, numbers: &Three<'_>) -> PyResult<DVec3> {
    let numbers: Vec<f64> = numbers.as_array().iter().copied().collect();
    match numbers[..] {
        [x, y, z] if numbers.iter().all(|number| number.is_finite()) => Ok(DVec3::new(x, y, z)),
        _ => Err(refused(name, format!("{} numbers", numbers.len()), "give three finite numbers")),
    }
}
