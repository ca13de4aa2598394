//! Cameras from command-line arguments: a matrix, or a position and its target.

use glam::DVec3;
use serde_json::Value;
use std::path::Path;
use trimip::view::cameras::{aimed, flatten, posed};
use trimip::{Camera, Error, Intrinsics, Place, Result};
use trimip_core::text;

/// Parses three numbers separated by commas.
pub fn vector(place: impl Into<Place>, text: &str) -> Result<DVec3> {
    match numbers(text).as_deref() {
        Some(&[x, y, z]) if DVec3::new(x, y, z).is_finite() => Ok(DVec3::new(x, y, z)),
        _ => Err(Error::input(place, format!("`{text}` is not a position"), "write three numbers as x,y,z")),
    }
}

/// Parses `eye/target` as a camera.
pub fn look_at(text: &str, up: DVec3, intrinsics: Intrinsics) -> Result<Camera> {
    let place = Place::argument("look-at", text);
    let Some((eye, target)) = text.split_once('/') else {
        return Err(Error::input(place, "has no '/'", "write eye/target, such as 4,0,2/0,0,0"));
    };
    let (eye, target) = (vector(&place, eye)?, vector(&place, target)?);
    aimed(&place, eye, target, up, intrinsics)
}

/// Parses a camera-to-world matrix: numbers, JSON, or a file with either.
pub fn pose(text: &str, intrinsics: Intrinsics) -> Result<Camera> {
    let as_file = Path::new(text);
    let content;
    let (place, source) = if as_file.is_file() {
        content = text::read(as_file, "name an existing file of cameras")?;
        (Place::from(as_file), content.as_str())
    } else {
        (Place::option("pose"), text)
    };
    let matrix =
        serde_json::from_str::<Value>(source).map_or_else(|_| numbers(source), |json| flatten(&json));
    let Some(matrix) = matrix else {
        return Err(Error::input(
            place,
            "has no matrix",
            "give 12 or 16 numbers row by row, as JSON or separated by commas, or the path of a file that has them",
        ));
    };
    posed(&place, &matrix, intrinsics)
}

fn numbers(text: &str) -> Option<Vec<f64>> {
    let separators = |c: char| c == ',' || c.is_whitespace();
    text.split(separators).filter(|word| !word.is_empty()).map(|word| word.parse().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;

    fn intrinsics() -> Intrinsics {
        Intrinsics::from_angle(80, 60, 0.7)
    }

    #[test]
    fn a_pose_is_read_in_every_spelling() {
        let rows = "1,0,0,3, 0,1,0,4, 0,0,1,5";
        let nested = "[[1,0,0,3],[0,1,0,4],[0,0,1,5],[0,0,0,1]]";
        for text in [rows, &format!("[{rows}]"), nested, &format!("{{\"transform_matrix\": {nested}}}")] {
            let camera = pose(text, intrinsics()).unwrap();
            assert_eq!(
                (camera.origin, camera.rotation),
                (DVec3::new(3.0, 4.0, 5.0), DMat3::IDENTITY),
                "{text}"
            );
        }
        for text in
            ["", "1,2,3", "a/b", "{}", "2,0,0,3, 0,1,0,4, 0,0,1,5", "-1,0,0,3, 0,1,0,4, 0,0,1,5", "[nan]"]
        {
            assert_eq!(pose(text, intrinsics()).unwrap_err().kind(), trimip_core::ErrorKind::Input, "{text}");
        }
    }

    #[test]
    fn a_camera_along_up_is_refused() {
        assert!(look_at("4,0,2/0,0,0", DVec3::Z, intrinsics()).is_ok());
        for text in ["0,0,4/0,0,0", "1,1,1/1,1,1", "1,2/0,0,0", "4,0,2"] {
            assert_eq!(
                look_at(text, DVec3::Z, intrinsics()).unwrap_err().kind(),
                trimip_core::ErrorKind::Input,
                "{text}"
            );
        }
    }
}
