//! The bounding box that a transforms file states: around points from structure from motion (`ply_file_path`,
//! nerfstudio), or Instant-NGP's `aabb_scale` with `scale` and `offset`. Lengths are in world units of the file's poses.

use crate::{json::Node, ply, split::Split};
use std::path::Path;
use trimip_core::{Aabb, Error, Result, plain_file, scene_plan::StatedBox};

/// Defaults of `scale` and `offset`: Instant-NGP's unit cube in world units.
const NGP: (f64, f64) = (0.33, 0.5);

/// Reads the box and the points that `file` in `root` states, as a split without frames. A box around the points takes
/// precedence over Instant-NGP's cube. A file of points that cannot be read is left out with a warning.
pub(crate) fn read(root: &Path, file: &Node<'_>) -> Result<Split> {
    let mut facts = Split::default();
    if let Some(named) = file.text("ply_file_path")? {
        let path = root.join(named.replace('\\', "/"));
        match plain_file::read(&path) {
            Ok(bytes) => {
                facts.cloud.points = ply::points(&path.display().to_string(), &bytes)?;
                facts.stated = facts.cloud.stated(&format!("of {named}"));
            }
            Err(error) => {
                let what = format!("\"ply_file_path\" {} cannot be read: {error}", path.display());
                facts.warnings.push(format!("{}: {what}; its points are left out", file.place));
            }
        }
    }
    if facts.stated.is_none() {
        facts.stated = cube(file)?;
    }
    Ok(facts)
}

/// Returns the cube of Instant-NGP.
pub(crate) fn cube(file: &Node<'_>) -> Result<Option<StatedBox>> {
    let Some(aabb_scale) = file.number("aabb_scale")? else { return Ok(None) };
    let scale = file.number("scale")?.unwrap_or(NGP.0);
    let offset = match file.get("offset") {
        None => [NGP.1; 3],
        Some(_) => {
            let entries = file.array("offset")?;
            let number = |i: usize| entries.get(i).and_then(serde_json::Value::as_f64);
            match [number(0), number(1), number(2)] {
                [Some(x), Some(y), Some(z)] => [x, y, z],
                _ => return Err(wrong(file, "offset", "three numbers")),
            }
        }
    };
    if !(scale > 0.0 && scale.is_finite()) {
        return Err(wrong(file, "scale", "a number above 0"));
    }
    if !(aabb_scale > 0.0 && aabb_scale.is_finite()) {
        return Err(wrong(file, "aabb_scale", "a number above 0"));
    }
    let corner = |sign: f64| offset.map(|offset| (0.5 + sign * 0.5 * aabb_scale - offset) / scale);
    let aabb = Aabb { min: corner(-1.0), max: corner(1.0) };
    if !aabb.min.iter().chain(&aabb.max).all(|side| side.is_finite()) {
        return Err(wrong(
            file,
            "aabb_scale",
            "a number that makes a finite box with \"scale\" and \"offset\"",
        ));
    }
    Ok(Some(StatedBox { aabb, source: format!("of aabb_scale {aabb_scale}"), around_points: false }))
}

fn wrong(file: &Node<'_>, key: &str, expected: &str) -> Error {
    Error::input(
        &file.place,
        format!("\"{key}\" has no valid value"),
        format!("expected {expected}, or no such key"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use std::fs;

    #[test]
    fn aabb_scale_is_the_cube_of_instant_ngp() {
        let root = Path::new("");
        let of = |value: serde_json::Value| {
            read(root, &Node::new("a.json", &value).unwrap())
                .map(|facts| facts.stated.map(|found| found.aabb))
        };
        let cube = of(json!({ "aabb_scale": 4 })).unwrap().unwrap();
        assert!(
            (0..3)
                .all(|axis| (cube.max[axis] - 2.0 / 0.33).abs() < 1e-12 && cube.min[axis] == -cube.max[axis])
        );
        let moved = of(json!({ "aabb_scale": 1, "scale": 0.5, "offset": [0.5, 0.0, 1.0] })).unwrap().unwrap();
        assert_eq!((moved.min, moved.max), ([-1.0, 0.0, -2.0], [1.0, 2.0, 0.0]));
        assert_eq!(of(json!({})).unwrap(), None);
        for broken in [
            json!({ "aabb_scale": 0 }),
            json!({ "aabb_scale": 1, "offset": [1] }),
            json!({ "aabb_scale": "4" }),
            json!({ "aabb_scale": 1e200, "scale": 1e-200 }),
        ] {
            assert_eq!(of(broken).unwrap_err().kind(), trimip_core::ErrorKind::Input);
        }
    }

    #[test]
    fn points_of_a_ply_file_bound_the_scene_but_for_outliers() {
        let folder = tempfile::tempdir().unwrap();
        let mut text = "ply\nformat ascii 1.0\nelement vertex 201\nproperty float x\nproperty float y\nproperty float z\n\
                        property uchar red\nend_header\n"
            .to_string();
        for i in 0..200 {
            let at = f64::from(i) / 199.0;
            text += &format!("{at} {} {} 7\n", 2.0 * at, -at);
        }
        text += "1000 1000 1000 7\n";
        fs::write(folder.path().join("points.ply"), text).unwrap();
        let value = json!({ "ply_file_path": "points.ply", "aabb_scale": 16 });
        let Split { stated, cloud, .. } = read(folder.path(), &Node::new("a.json", &value).unwrap()).unwrap();
        let found = stated.unwrap();
        assert_eq!((cloud.points.len(), cloud.points[3].color), (201, [7, 0, 0]));
        assert!(found.source.contains("201 points"), "{}", found.source);
        for (axis, [low, high]) in [[0.0, 1.0], [0.0, 2.0], [-1.0, 0.0]].into_iter().enumerate() {
            let side = high - low;
            assert!((found.aabb.min[axis] - low).abs() < 0.06 * side, "{found:?}");
            assert!((found.aabb.max[axis] - high).abs() < 0.06 * side, "{found:?}");
        }
        let value = json!({ "ply_file_path": "absent.ply" });
        let left_out = read(folder.path(), &Node::new("a.json", &value).unwrap()).unwrap();
        assert!(left_out.cloud.points.is_empty() && left_out.stated.is_none());
        assert!(left_out.warnings[0].contains("absent.ply cannot be read"));
    }
}
