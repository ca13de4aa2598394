//! Cameras of a COLMAP model: the camera models by number and name, with the order of their parameters in the files (COLMAP's
//! sensor/models.h), and what they are to a renderer. Lengths in pixels; the centre of the upper left pixel is (0.5, 0.5).

use trimip_core::{Intrinsics, Lens};

/// A camera model.
#[derive(Debug, PartialEq)]
pub(super) struct Kind {
    pub(super) number: i32,
    pub(super) name: &'static str,
    fisheye: bool,
    /// Names of the parameters in the order of the files: f is both focal lengths, d1 to d3 are OpenCV's k4 to k6.
    pub(super) parameters: &'static [&'static str],
}

impl Kind {
    const fn new(
        number: i32,
        name: &'static str,
        fisheye: bool,
        parameters: &'static [&'static str],
    ) -> Self {
        Self { number, name, fisheye, parameters }
    }
}

/// The models that have a lens here.
pub(super) const KINDS: [Kind; 10] = [
    Kind::new(0, "SIMPLE_PINHOLE", false, &["f", "cx", "cy"]),
    Kind::new(1, "PINHOLE", false, &["fx", "fy", "cx", "cy"]),
    Kind::new(2, "SIMPLE_RADIAL", false, &["f", "cx", "cy", "k1"]),
    Kind::new(3, "RADIAL", false, &["f", "cx", "cy", "k1", "k2"]),
    Kind::new(4, "OPENCV", false, &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"]),
    Kind::new(5, "OPENCV_FISHEYE", true, &["fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"]),
    Kind::new(
        6,
        "FULL_OPENCV",
        false,
        &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "d1", "d2", "d3"],
    ),
    Kind::new(8, "SIMPLE_RADIAL_FISHEYE", true, &["f", "cx", "cy", "k1"]),
    Kind::new(9, "RADIAL_FISHEYE", true, &["f", "cx", "cy", "k1", "k2"]),
    Kind::new(
        10,
        "THIN_PRISM_FISHEYE",
        true,
        &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1"],
    ),
];

/// The models of COLMAP that have none.
const OTHERS: [(i32, &str); 8] = [
    (7, "FOV"),
    (11, "RAD_TAN_THIN_PRISM_FISHEYE"),
    (12, "SIMPLE_DIVISION"),
    (13, "DIVISION"),
    (14, "SIMPLE_FISHEYE"),
    (15, "FISHEYE"),
    (16, "EUCM"),
    (17, "EQUIRECTANGULAR"),
];

/// What to do about a model that has none.
pub(super) const ADVICE: &str = "run COLMAP's image_undistorter, which writes PINHOLE cameras and their images, or calibrate with OPENCV or \
     OPENCV_FISHEYE";

impl Kind {
    pub(super) fn of_number(number: i32) -> Result<&'static Self, String> {
        KINDS.iter().find(|kind| kind.number == number).ok_or_else(|| {
            match OTHERS.iter().find(|(other, _)| *other == number) {
                Some((_, name)) => format!("has the camera model {name}, which is not supported"),
                None => format!("has the camera model {number}, which is unknown"),
            }
        })
    }

    pub(super) fn of_name(name: &str) -> Result<&'static Self, String> {
        KINDS.iter().find(|kind| kind.name == name).ok_or_else(|| {
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
    /// Its number, which images name.
    pub id: u32,
    kind: &'static Kind,
    width: u32,
    height: u32,
    parameters: Box<[f64]>,
}

impl ModelCamera {
    /// A camera with the parameters in the order of the files; the error says what is wrong with it.
    pub(super) fn new(
        id: u32,
        kind: &'static Kind,
        size: [u64; 2],
        parameters: Box<[f64]>,
    ) -> Result<Self, String> {
        let [width, height] = size.map(|side| u32::try_from(side).unwrap_or(0));
        if width == 0 || height == 0 {
            return Err(format!("is {}x{} pixels", size[0], size[1]));
        }
        if parameters.len() != kind.parameters.len() {
            return Err(format!(
                "has {} parameters, but {} has {}: {}",
                parameters.len(),
                kind.name,
                kind.parameters.len(),
                kind.parameters.join(", ")
            ));
        }
        for (name, value) in kind.parameters.iter().zip(&parameters) {
            if !value.is_finite() {
                return Err(format!("has a {name} that is not finite"));
            }
            if name.starts_with('f') && *value <= 0.0 {
                return Err(format!("has the focal length {value}"));
            }
        }
        Ok(Self { id, kind, width, height, parameters })
    }

    /// Name of its camera model.
    pub fn model(&self) -> &'static str {
        self.kind.name
    }

    /// Size, projection in pixels, and lens.
    pub fn intrinsics(&self) -> Intrinsics {
        let stated = |key: &str| {
            let place = self.kind.parameters.iter().position(|name| *name == key)?;
            self.parameters.get(place).copied()
        };
        let term = |key: &str| stated(key).unwrap_or(0.0);
        let focal = |key: &str| stated(key).unwrap_or_else(|| term("f"));
        let radial = ["k1", "k2", "k3", "k4"].map(term);
        let tangential = ["p1", "p2"].map(term);
        let lens = if self.kind.fisheye {
            Lens::fisheye(radial, tangential, ["sx1", "sy1"].map(term))
        } else {
            Lens::perspective(radial, tangential, ["d1", "d2", "d3"].map(term))
        };
        Intrinsics {
            width: self.width,
            height: self.height,
            fx: focal("fx"),
            fy: focal("fy"),
            cx: term("cx"),
            cy: term("cy"),
            lens,
        }
    }
}
