//! Cameras of a COLMAP model: the camera models by number and name, with the order of their parameters in the files (COLMAP's
//! sensor/models.h), and the conversion to intrinsics. Lengths are in pixels; the centre of the upper left pixel is (0.5, 0.5).

use trimip_core::geometry::projections::{Colmap, Model};
use trimip_core::{Intrinsics, Lens};

/// A camera model of COLMAP, and the camera model of this program that it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Kind {
    model: Model,
    colmap: &'static Colmap,
}

/// Returns the camera models of COLMAP that the registry has.
fn kinds() -> impl Iterator<Item = Kind> {
    let of = |model: &Model| {
        let model = *model;
        model.definition().colmap.iter().map(move |colmap| Kind { model, colmap })
    };
    Model::ALL.iter().flat_map(of)
}

/// Numbers and names of further models of COLMAP. Messages call them unsupported, not unknown, unless the registry has them.
const OTHERS: [(i32, &str); 5] =
    [(7, "FOV"), (11, "RAD_TAN_THIN_PRISM_FISHEYE"), (12, "SIMPLE_DIVISION"), (13, "DIVISION"), (16, "EUCM")];

/// Advice for a model that is not supported.
pub(super) const ADVICE: &str = "run COLMAP's image_undistorter, which writes PINHOLE cameras and their images, or calibrate with OPENCV or \
     OPENCV_FISHEYE";

impl Kind {
    pub(super) fn of_number(number: i32) -> Result<Self, String> {
        kinds().find(|kind| kind.colmap.number == number).ok_or_else(|| {
            match OTHERS.iter().find(|(other, _)| *other == number) {
                Some((_, name)) => format!("has the camera model {name}, which is not supported"),
                None => format!("has the camera model {number}, which is unknown"),
            }
        })
    }

    /// Returns the names of the parameters in the order of the files.
    pub(super) fn parameters(self) -> &'static [&'static str] {
        self.colmap.parameters
    }

    pub(super) fn of_name(name: &str) -> Result<Self, String> {
        kinds().find(|kind| kind.colmap.name == name).ok_or_else(|| {
            let known = OTHERS.iter().any(|(_, other)| *other == name);
            let name: String = name.chars().take(40).collect();
            format!(
                "has the camera model {name}, which is {}",
                if known { "not supported" } else { "unknown" }
            )
        })
    }
}

/// A camera of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelCamera {
    /// Its number, by which images refer to it.
    pub id: u32,
    kind: Kind,
    width: u32,
    height: u32,
    parameters: Box<[f64]>,
}

impl ModelCamera {
    /// Creates a camera from parameters in the order of the files. The error describes what is wrong.
    pub(super) fn new(id: u32, kind: Kind, size: [u64; 2], parameters: Box<[f64]>) -> Result<Self, String> {
        let [width, height] = size.map(|side| u32::try_from(side).unwrap_or(0));
        if width == 0 || height == 0 {
            return Err(format!("is {}x{} pixels", size[0], size[1]));
        }
        if parameters.len() != kind.parameters().len() {
            return Err(format!(
                "has {} parameters, but {} has {}: {}",
                parameters.len(),
                kind.colmap.name,
                kind.parameters().len(),
                kind.parameters().join(", ")
            ));
        }
        for (name, value) in kind.parameters().iter().zip(&parameters) {
            if name.starts_with('f') && *value <= 0.0 {
                return Err(format!("has the focal length {value}"));
            }
            if matches!(*name, "w" | "h") && *value <= 0.0 {
                return Err(format!("has an image of {value} pixels"));
            }
        }
        Ok(Self { id, kind, width, height, parameters })
    }

    /// Returns the camera that describes `intrinsics` exactly with the fewest parameters; `None` if no model of COLMAP can.
    pub(super) fn of(id: u32, intrinsics: &Intrinsics) -> Option<Self> {
        let lens = &intrinsics.lens;
        let value = |name: &str| match name {
            "f" | "fx" => intrinsics.fx,
            "fy" => intrinsics.fy,
            "cx" => intrinsics.cx,
            "cy" => intrinsics.cy,
            "k1" => lens.radial[0],
            "k2" => lens.radial[1],
            "k3" => lens.radial[2],
            "k4" => lens.radial[3],
            "d1" => lens.denominator[0],
            "d2" => lens.denominator[1],
            "d3" => lens.denominator[2],
            "p1" => lens.tangential[0],
            "p2" => lens.tangential[1],
            "sx1" => lens.prism[0],
            "sy1" => lens.prism[1],
            "w" => f64::from(intrinsics.width),
            "h" => f64::from(intrinsics.height),
            _ => 0.0,
        };
        let size = [intrinsics.width, intrinsics.height].map(u64::from);
        let of_kind = |kind: Kind| {
            Self::new(id, kind, size, kind.parameters().iter().map(|name| value(name)).collect()).ok()
        };
        let fitting = kinds().filter_map(of_kind).filter(|camera| camera.intrinsics() == *intrinsics);
        fitting.min_by_key(|camera| camera.parameters.len())
    }

    /// Returns the parameters in the order of the files.
    pub(super) fn parameters(&self) -> &[f64] {
        &self.parameters
    }

    /// Returns false if a parameter is not finite, because the calibration failed.
    pub fn is_finite(&self) -> bool {
        self.parameters.iter().all(|parameter| parameter.is_finite())
    }

    /// Returns the name of its camera model.
    pub fn model(&self) -> &'static str {
        self.kind.colmap.name
    }

    /// Returns its size, projection in pixels, and lens.
    pub fn intrinsics(&self) -> Intrinsics {
        let stated = |key: &str| {
            let place = self.kind.parameters().iter().position(|name| *name == key)?;
            self.parameters.get(place).copied()
        };
        let term = |key: &str| stated(key).unwrap_or(0.0);
        let size = [("w", self.width), ("h", self.height)]
            .map(|(key, side)| stated(key).unwrap_or_else(|| f64::from(side)));
        let usual = self.kind.model.definition().focal.map(|focal| focal(size[0], size[1]));
        let focal = |key: &str, axis: usize| {
            stated(key).or(stated("f")).or(usual.map(|usual| usual[axis])).unwrap_or(0.0)
        };
        let centre = |key: &str, axis: usize| stated(key).unwrap_or(0.5 * size[axis]);
        let radial = ["k1", "k2", "k3", "k4"].map(term);
        let tangential = ["p1", "p2"].map(term);
        let lens = match self.kind.model {
            Model::Perspective => Lens::perspective(radial, tangential, ["d1", "d2", "d3"].map(term)),
            Model::Fisheye => Lens::fisheye(radial, tangential, ["sx1", "sy1"].map(term)),
            other => Lens::of(other),
        };
        Intrinsics {
            width: self.width,
            height: self.height,
            fx: focal("fx", 0),
            fy: focal("fy", 1),
            cx: centre("cx", 0),
            cy: centre("cy", 1),
            lens,
        }
    }
}
