//! The bounding box that a transforms file states: points from structure from motion (`ply_file_path`, nerfstudio), or
//! Instant-NGP's `aabb_scale` with `scale` and `offset`. World units of the file's poses.

use crate::{describe::count, json::Node};
use ply_rs_bw::{
    parser::Parser,
    ply::{DefaultElement, Property},
};
use std::{fs::File, io::BufReader, path::Path};
use trimip_core::{Aabb, Error, Result, scene_plan::StatedBox};

/// Defaults of `scale` and `offset`: Instant-NGP's unit cube in world units.
const NGP: (f64, f64) = (0.33, 0.5);

/// Share of the points dropped as outliers at each end of an axis.
const OUTLIERS: f64 = 0.02;

/// Margin at each end, as a share of the points' extent.
const MARGIN: f64 = 0.05;

/// Fewest points from which a box is made.
const LEAST_POINTS: usize = 100;

/// The box that `file` in `root` states; points take precedence.
pub(crate) fn read(root: &Path, file: &Node<'_>) -> Result<Option<StatedBox>> {
    if let Some(value) = file.get("ply_file_path") {
        let named = value.as_str().ok_or_else(|| file.unexpected("ply_file_path", "a text", value))?;
        let points = points(&root.join(named), &file.place)?;
        if points.len() >= LEAST_POINTS {
            let source = format!("around {} of {named}", count(points.len(), "point"));
            return Ok(Some(StatedBox { aabb: around(&points), source }));
        }
    }
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
    Ok(Some(StatedBox { aabb, source: format!("of aabb_scale {aabb_scale}") }))
}

fn wrong(file: &Node<'_>, key: &str, expected: &str) -> Error {
    Error::input(
        &file.place,
        format!("\"{key}\" has no valid value"),
        format!("expected {expected}, or no such key"),
    )
}

/// Positions of the vertices of a PLY file.
fn points(path: &Path, place: &str) -> Result<Vec<[f64; 3]>> {
    let unreadable = |error: &dyn std::fmt::Display| {
        Error::input(
            place,
            format!("\"ply_file_path\" {}: {error}", path.display()),
            "export the points again, or remove the key",
        )
    };
    let file = File::open(path).map_err(|error| unreadable(&error))?;
    let ply = Parser::<DefaultElement>::new()
        .read_ply(&mut BufReader::new(file))
        .map_err(|error| unreadable(&error))?;
    let vertices = ply.payload.get("vertex").map_or(&[][..], Vec::as_slice);
    let number = |property: Option<&Property>| match property {
        Some(Property::Float(value)) => Some(f64::from(*value)),
        Some(Property::Double(value)) => Some(*value),
        _ => None,
    };
    let points = vertices.iter().filter_map(|vertex| {
        let at = ["x", "y", "z"].map(|key| number(vertex.get(key)));
        let [Some(x), Some(y), Some(z)] = at else { return None };
        [x, y, z].iter().all(|value| value.is_finite()).then_some([x, y, z])
    });
    Ok(points.collect())
}

/// The box around all points except outliers, with a margin.
fn around(points: &[[f64; 3]]) -> Aabb<f64> {
    let range = |axis: usize| {
        let mut values: Vec<f64> = points.iter().map(|point| point[axis]).collect();
        values.sort_by(f64::total_cmp);
        let cut = (OUTLIERS * values.len() as f64) as usize;
        let (low, high) = (values[cut], values[values.len() - 1 - cut]);
        let margin = MARGIN * (high - low).max(f64::MIN_POSITIVE);
        [low - margin, high + margin]
    };
    let ranges = [range(0), range(1), range(2)];
    Aabb { min: ranges.map(|[low, _]| low), max: ranges.map(|[_, high]| high) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn aabb_scale_is_the_cube_of_instant_ngp() {
        let root = Path::new("");
        let of = |value: serde_json::Value| {
            read(root, &Node::new("a.json", &value).unwrap()).map(|b| b.map(|b| b.aabb))
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
        ] {
            assert_eq!(of(broken).unwrap_err().exit_code(), 2);
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
        std::fs::write(folder.path().join("points.ply"), text).unwrap();
        let value = json!({ "ply_file_path": "points.ply", "aabb_scale": 16 });
        let found = read(folder.path(), &Node::new("a.json", &value).unwrap()).unwrap().unwrap();
        assert!(found.source.contains("201 points"), "{}", found.source);
        for (axis, [low, high]) in [[0.0, 1.0], [0.0, 2.0], [-1.0, 0.0]].into_iter().enumerate() {
            let side = high - low;
            assert!((found.aabb.min[axis] - low).abs() < 0.06 * side, "{found:?}");
            assert!((found.aabb.max[axis] - high).abs() < 0.06 * side, "{found:?}");
        }
        let value = json!({ "ply_file_path": "absent.ply" });
        let error = read(folder.path(), &Node::new("a.json", &value).unwrap()).unwrap_err();
        assert!(error.exit_code() == 2 && error.message.contains("absent.ply"), "{error}");
    }
}
