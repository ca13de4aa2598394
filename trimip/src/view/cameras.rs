//! Cameras from a matrix, a position and target, or a path file. World units, OpenGL axes. A pose that is not rigid or
//! an invalid projection is refused; the error states its location.

use glam::{DMat3, DVec3};
use serde::Deserialize;
use serde_json::Value;
use std::path::Path;
use trimip_core::{Advice, Camera, Error, Intrinsics, Lens, Place, Result, scene::origin::LocalOrigin, text};

/// Largest width or height of a rendered picture, pixels.
pub const MAX_SIDE: f64 = 16_384.0;

/// A camera and the name of its pictures.
pub type Named = (String, Camera);

/// Returns a camera at `eye` that looks at `target`.
///
/// # Errors
/// When the line of sight is parallel to `up`, so the camera's roll is undefined; `place` appears in the message.
pub fn aimed(
    place: impl Into<Place>,
    eye: DVec3,
    target: DVec3,
    up: DVec3,
    intrinsics: Intrinsics,
) -> Result<Camera> {
    let back = eye - target;
    if up.cross(back).length() <= 1e-9 * up.length() * back.length() {
        return Err(Error::input(
            place,
            "the camera looks along its up axis, or is at its target",
            Advice::Argument("choose another {up}, such as {up} 0,1,0".into()),
        ));
    }
    Ok(Camera::look_at(intrinsics, eye, target, up))
}

/// Returns all numbers in a JSON value, in order; for an object, the numbers of its `transform_matrix`.
pub fn flatten(json: &Value) -> Option<Vec<f64>> {
    match json {
        Value::Number(number) => Some(vec![number.as_f64()?]),
        Value::Array(items) => {
            items.iter().map(flatten).collect::<Option<Vec<_>>>().map(|parts| parts.concat())
        }
        Value::Object(fields) => flatten(fields.get("transform_matrix")?),
        _ => None,
    }
}

/// Returns a camera from the 12 or 16 numbers of a camera-to-world matrix, row by row. The 3×3 block must be a rotation.
///
/// # Errors
/// When there are not 12 or 16 finite numbers, or their 3×3 block is no rotation; `place` appears in the message.
pub fn posed(place: impl Into<Place>, matrix: &[f64], intrinsics: Intrinsics) -> Result<Camera> {
    let place = place.into();
    let refuse = |what: String| {
        Err(Error::input(
            &place,
            what,
            "expected a camera-to-world matrix [R|t] with a rotation R, OpenGL axes",
        ))
    };
    if ![12, 16].contains(&matrix.len()) {
        return refuse(format!("has {} numbers instead of 12 or 16", matrix.len()));
    }
    if matrix.iter().any(|value| !value.is_finite()) {
        return refuse("has a number that is not finite".into());
    }
    let column = |c: usize| DVec3::new(matrix[c], matrix[4 + c], matrix[8 + c]);
    let rotation = DMat3::from_cols(column(0), column(1), column(2));
    let error = (rotation.transpose() * rotation - DMat3::IDENTITY).to_cols_array();
    if error.iter().any(|e| e.abs() > 1e-3) || rotation.determinant() < 0.0 {
        return refuse("has no rotation in its upper left 3×3 block".into());
    }
    Ok(Camera { intrinsics, rotation, origin: column(3) })
}

/// Projection fields of a path file, in its header or in a frame.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
struct Projection {
    w: Option<f64>,
    h: Option<f64>,
    camera_angle_x: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
}

/// The projection that a node of a path file states.
struct Stated {
    projection: Projection,
    extent: Option<f64>,
}

/// Reads the cameras of a file in the format of `transforms_test.json`, in the order of the file; missing fields come
/// from `fallback`. The file has the coordinates of the photographs; the returned cameras are relative to `origin`.
///
/// # Errors
/// When the file cannot be read, or a frame has an invalid camera.
pub fn path(file: &Path, fallback: Intrinsics, origin: LocalOrigin) -> Result<Vec<Named>> {
    let stated = path_of(&file.display().to_string(), &read(file)?, fallback)?;
    Ok(stated.into_iter().map(|(name, camera)| (name, origin.local(camera))).collect())
}

/// Like [`path`], but each camera has the name that its frame states as `file_path`, if it states one.
///
/// # Errors
/// As [`path`].
pub fn named_path(file: &Path, fallback: Intrinsics, origin: LocalOrigin) -> Result<Vec<Named>> {
    let text = read(file)?;
    let cameras = path_of(&file.display().to_string(), &text, fallback)?;
    let json: Value = serde_json::from_str(&text).unwrap_or_default();
    let named = cameras.into_iter().enumerate().map(|(i, (number, camera))| {
        let stated = json["frames"][i]["file_path"].as_str().filter(|name| !name.is_empty());
        (stated.map_or(number, String::from), origin.local(camera))
    });
    Ok(named.collect())
}

/// Like [`path`], from the text of the file and in its coordinates; `place` names the file in messages.
///
/// # Errors
/// As [`path`].
pub fn path_of(place: &str, text: &str, fallback: Intrinsics) -> Result<Vec<Named>> {
    let broken = |error: serde_json::Error| {
        Error::input(
            place,
            format!("is not a camera path: {error}"),
            "expected JSON like transforms_test.json",
        )
    };
    let json: Value = serde_json::from_str(text).map_err(broken)?;
    let head: Projection = Projection::deserialize(&json).map_err(broken)?;
    let Some(frames) = json.get("frames").and_then(Value::as_array).filter(|frames| !frames.is_empty())
    else {
        return Err(Error::input(place, "has no `frames`", "expected JSON like transforms_test.json"));
    };
    let mut cameras = Vec::new();
    for (i, frame) in frames.iter().enumerate() {
        let place = Place::part(place, format_args!("frames[{i}]"));
        let own = Projection::deserialize(frame).map_err(broken)?;
        let Some(matrix) = frame.get("transform_matrix").and_then(flatten) else {
            return Err(Error::input(place, "has no `transform_matrix`", "add a 4×4 camera-to-world matrix"));
        };
        let lens = trimip_data::lens_of(&place, &json, frame)?;
        let own = Stated { projection: own, extent: extent(frame, lens) };
        let head = Stated { projection: head, extent: extent(&json, lens) };
        let intrinsics = Intrinsics { lens, ..projected(&place, own, head, lens, fallback)? };
        cameras.push((format!("{i:04}"), posed(&place, &matrix, intrinsics)?));
    }
    Ok(cameras)
}

/// Returns the width of the longer side of a picture in world units, for lens models that state it (orthographic).
fn extent(node: &Value, lens: Lens) -> Option<f64> {
    node.get(lens.model.definition().extent_key?)?.as_f64()
}

fn projected(
    place: &Place,
    own: Stated,
    head: Stated,
    lens: Lens,
    fallback: Intrinsics,
) -> Result<Intrinsics> {
    let definition = lens.model.definition();
    let pick = |f: fn(&Projection) -> Option<f64>| f(&own.projection).or(f(&head.projection));
    let width = pick(|p| p.w).unwrap_or(fallback.width.into());
    let height = pick(|p| p.h).unwrap_or(fallback.height.into());
    // A frame's focal length overrides the file's; both may be given in pixels or as an angle.
    let focal = |Stated { projection: p, extent }: &Stated| {
        let angle = p.camera_angle_x.filter(|_| definition.angles);
        let x = p.fl_x.or(angle.map(|angle| 0.5 * width / (0.5 * angle).tan()));
        let x = x.or(extent.map(|extent| width.max(height) / extent));
        x.or(p.fl_y).map(|x| (x, p.fl_y.unwrap_or(x)))
    };
    let usual = || match definition.focal {
        Some(focal) => focal(width, height).into(),
        // The focal length of a pinhole does not apply to another lens model.
        None if !definition.angles => (f64::NAN, f64::NAN),
        None => [fallback.fx * width / f64::from(fallback.width); 2].into(),
    };
    let (fx, fy) = focal(&own).or(focal(&head)).unwrap_or_else(usual);
    let sane = [width, height].iter().all(|side| (1.0..=MAX_SIDE).contains(side));
    let (cx, cy) = (pick(|p| p.cx).unwrap_or(0.5 * width), pick(|p| p.cy).unwrap_or(0.5 * height));
    if !(sane && fx > 0.0 && fy > 0.0 && [fx, fy, cx, cy].iter().all(|value| value.is_finite())) {
        return Err(Error::input(
            place,
            format!("has {width}×{height} pixels and focal length {fx}, {fy}"),
            "expected 1 to 16384 pixels and a focal length above 0",
        ));
    }
    Ok(Intrinsics { width: width as u32, height: height as u32, fx, fy, cx, cy, ..Intrinsics::default() })
}

/// Returns the same view with `factor` times as many pixels along each side.
///
/// # Errors
/// When a side has less than one or more than 16384 pixels.
pub fn resized(k: Intrinsics, factor: f64) -> Result<Intrinsics> {
    let side = |pixels: u32| (f64::from(pixels) * factor).round().max(1.0);
    let (width, height) = (side(k.width), side(k.height));
    if !(factor.is_finite() && factor > 0.0 && width <= MAX_SIDE && height <= MAX_SIDE) {
        return Err(Error::input(
            Place::argument("scale", factor),
            "out of range",
            "expected a number above 0 that keeps the pictures within 16384 pixels",
        ));
    }
    let (x, y) = (width / f64::from(k.width), height / f64::from(k.height));
    Ok(Intrinsics {
        width: width as u32,
        height: height as u32,
        fx: k.fx * x,
        fy: k.fy * y,
        cx: k.cx * x,
        cy: k.cy * y,
        lens: k.lens,
    })
}

fn read(file: &Path) -> Result<String> {
    text::read(file, "name an existing file of cameras")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn intrinsics() -> Intrinsics {
        Intrinsics::from_angle(80, 60, 0.7)
    }

    #[test]
    fn a_path_uses_its_own_projection_first() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("path.json");
        let matrix = "[[1,0,0,3],[0,1,0,4],[0,0,1,5],[0,0,0,1]]";
        let text = format!(
            "{{\"w\": 100, \"h\": 50, \"fl_x\": 120, \"fl_y\": 110, \"frames\": [{{\"transform_matrix\": {matrix}}},
              {{\"transform_matrix\": {matrix}, \"fl_x\": 60}},
              {{\"transform_matrix\": {matrix}, \"camera_angle_x\": {}}}]}}",
            std::f64::consts::FRAC_PI_2
        );
        std::fs::write(&file, text).unwrap();
        let cameras = path(&file, intrinsics(), LocalOrigin::default()).unwrap();
        let k = cameras[1].1.intrinsics;
        assert_eq!((cameras.len(), k.width, k.height, k.fx, k.fy, k.cx), (3, 100, 50, 60.0, 60.0, 50.0));
        let [first, last] = [0, 2].map(|at: usize| cameras[at].1.intrinsics);
        assert_eq!((first.fx, first.fy), (120.0, 110.0));
        assert!((last.fx - 50.0).abs() < 1e-9 && last.fy == last.fx, "{last:?}");
        std::fs::write(&file, "{\"frames\": [{\"transform_matrix\": [1]}]}").unwrap();
        assert!(
            path(&file, intrinsics(), LocalOrigin::default()).unwrap_err().message().contains("frames[0]")
        );
    }

    #[test]
    fn resizing_keeps_the_field_of_view() {
        let k = resized(intrinsics(), 0.5).unwrap();
        assert_eq!((k.width, k.height, k.cx), (40, 30, 20.0));
        assert!((k.fx * 2.0 - intrinsics().fx).abs() < 1e-12);
        assert!(resized(intrinsics(), -1.0).is_err() && resized(intrinsics(), 1e9).is_err());
    }
}
