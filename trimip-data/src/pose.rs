//! Camera-to-world matrices from JSON: 4×4 or 3×4 rows that must be a rotation and a translation.

use crate::json::Node;
use glam::{DMat3, DVec3};
use serde_json::Value;
use trimip_core::{Error, Place, Result};

/// Largest |R·Rᵀ − I| that counts as a rotation written with few digits.
const ROTATION_TOLERANCE: f64 = 1e-3;
/// Rotations that deviate more are corrected. Smaller deviations come from storage in f32, and these rotations are kept bit for bit.
const CORRECTED_ABOVE: f64 = 1e-5;

/// Reads the rotation and the camera centre under `key`.
pub(crate) fn read(node: &Node<'_>, key: &str) -> Result<(DMat3, DVec3)> {
    parse(&node.place, key, node.required(key)?)
}

/// Reads the rotation and the camera centre from the rows of a matrix called `key` at `place`.
pub(crate) fn parse(place: &Place, key: &str, value: &Value) -> Result<(DMat3, DVec3)> {
    let wrong = |what: String| {
        Error::input(place, format!("\"{key}\" {what}"), "export the pose again or remove the entry")
    };
    let rows = matrix(value)
        .filter(|rows| rows.len() == 3 || rows.len() == 4)
        .filter(|rows| rows.iter().all(|row| row.len() == 4))
        .ok_or_else(|| wrong("is not a 4x4 or 3x4 matrix of numbers".into()))?;
    if rows.iter().flatten().any(|entry| !entry.is_finite()) {
        return Err(wrong(NOT_FINITE.into()));
    }
    if let Some(last) = rows.get(3)
        && (last[3] - 1.0).abs().max(last[0].abs()).max(last[1].abs()).max(last[2].abs()) > ROTATION_TOLERANCE
    {
        return Err(wrong(format!("has the last row {last:?} instead of 0 0 0 1")));
    }
    checked([0, 1, 2].map(|row| [0, 1, 2, 3].map(|column| rows[row][column]))).map_err(wrong)
}

/// Message about a matrix with a NaN or an infinity.
const NOT_FINITE: &str = "holds a number that is not finite";

/// Returns the rotation and the camera centre in the rows of a matrix. A uniform scale of the axes, as of a scaled
/// camera object, is divided out, because it does not change the rays. The error describes what is wrong.
pub(crate) fn checked(rows: [[f64; 4]; 3]) -> std::result::Result<(DMat3, DVec3), String> {
    if rows.iter().flatten().any(|entry| !entry.is_finite()) {
        return Err(NOT_FINITE.into());
    }
    let column = |c: usize| DVec3::new(rows[0][c], rows[1][c], rows[2][c]);
    let lengths = [0, 1, 2].map(|c| column(c).length());
    let scale = lengths.iter().sum::<f64>() / 3.0;
    let alike = lengths.iter().all(|length| (length - scale).abs() <= ROTATION_TOLERANCE * scale);
    let is_scaled = alike && scale.is_normal() && (scale - 1.0).abs() > ROTATION_TOLERANCE;
    let factor = if is_scaled { scale.recip() } else { 1.0 };
    let rotation = DMat3::from_cols(column(0) * factor, column(1) * factor, column(2) * factor);
    let deviation = deviation(rotation);
    if deviation > ROTATION_TOLERANCE || !deviation.is_finite() {
        return Err(format!(
            "is not a rotation: |R R^T - I| is {deviation:.1e}, its axes have the lengths {:.4}, {:.4}, {:.4}",
            lengths[0], lengths[1], lengths[2]
        ));
    }
    let determinant = rotation.determinant();
    if determinant < 0.0 {
        return Err(format!("mirrors the scene: its determinant is {determinant:.3} instead of 1"));
    }
    Ok((if deviation > CORRECTED_ABOVE { nearest_rotation(rotation) } else { rotation }, column(3)))
}

/// Returns the rotation around `axis` by an angle of its length in radians.
pub(crate) fn around(axis: DVec3) -> DMat3 {
    let angle = axis.length();
    if angle == 0.0 { DMat3::IDENTITY } else { DMat3::from_axis_angle(axis / angle, angle) }
}

/// Returns the rows of numbers in a value, or `None` if an entry is something else.
pub(crate) fn matrix(value: &Value) -> Option<Vec<Vec<f64>>> {
    let row = |row: &Value| row.as_array()?.iter().map(Value::as_f64).collect::<Option<Vec<f64>>>();
    value.as_array()?.iter().map(row).collect()
}

/// Returns the largest entry of |R·Rᵀ − I|.
fn deviation(rotation: DMat3) -> f64 {
    let product = rotation * rotation.transpose() - DMat3::IDENTITY;
    product.to_cols_array().iter().fold(0.0, |largest: f64, entry| {
        // `max` would let a NaN pass.
        if entry.is_nan() { f64::NAN } else { largest.max(entry.abs()) }
    })
}

/// Returns the nearest rotation: the orthogonal factor of a polar decomposition, by Newton's iteration R ← (R + R⁻ᵀ)/2
/// (Higham 1986). Each iteration squares the deviation.
fn nearest_rotation(mut rotation: DMat3) -> DMat3 {
    for _ in 0..4 {
        rotation = (rotation + rotation.transpose().inverse()) * 0.5;
    }
    rotation
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn error(value: Value) -> String {
        parse(&"f.json: frame 3 (r_3)".into(), "transform_matrix", &value).unwrap_err().message()
    }

    #[test]
    fn three_and_four_rows_are_the_same_pose() {
        let three = json!([[0.0, 0.0, 1.0, 5.0], [1.0, 0.0, 0.0, 6.0], [0, 1, 0, 7]]);
        let mut four = three.clone();
        four.as_array_mut().unwrap().push(json!([0, 0, 0, 1]));
        let (rotation, origin) = parse(&"".into(), "", &three).unwrap();
        assert_eq!((rotation, origin), parse(&"".into(), "", &four).unwrap());
        assert_eq!(origin, DVec3::new(5.0, 6.0, 7.0));
        // Columns are the camera's axes.
        assert_eq!(rotation.x_axis, DVec3::Y);
    }

    #[test]
    fn each_broken_pose_is_told_apart() {
        let cases = [
            (json!([[1, 0, 0, 0], [0, 1, 0, 0]]), "4x4 or 3x4"),
            (json!([[1, 0, 0], [0, 1, 0], [0, 0, 1]]), "4x4 or 3x4"),
            (json!([[1, 0, 0, 0], [0, 1, 0, null], [0, 0, 1, 0]]), "4x4 or 3x4"),
            (json!("identity"), "4x4 or 3x4"),
            (json!([[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]), "lengths 2.0000, 1.0000, 1.0000"),
            (json!([[1e200, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]), "not a rotation"),
            (json!([[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]]), "not a rotation"),
            (json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0]]), "mirrors the scene: its determinant is -1"),
            (json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 2]]), "last row"),
        ];
        for (value, expected) in cases {
            let message = error(value);
            assert!(message.starts_with("f.json: frame 3 (r_3): \"transform_matrix\" "), "{message}");
            assert!(message.contains(expected), "{message}");
        }
    }

    #[test]
    fn axes_of_one_length_are_a_rotation() {
        for scale in [1e-4, 0.25, 2.0, 1e6] {
            let rows = json!([[0, 0, scale, 5], [scale, 0, 0, 6], [0, scale, 0, 7]]);
            let (rotation, origin) = parse(&"".into(), "", &rows).unwrap();
            assert!(deviation(rotation) < 1e-14 && (rotation.x_axis - DVec3::Y).length() < 1e-14);
            assert_eq!(origin, DVec3::new(5.0, 6.0, 7.0));
            assert!(
                error(json!([[scale, 0, 0, 0], [0, scale, 0, 0], [0, 0, -scale, 0]])).contains("mirrors")
            );
            assert!(
                error(json!([[scale, 0, 0, 0], [0, scale, 0, 0], [0, 0, 3.0 * scale, 0]]))
                    .contains("lengths")
            );
        }
    }

    #[test]
    fn small_deviations_are_corrected_and_tiny_ones_kept() {
        let (rotation, _) =
            parse(&"".into(), "", &json!([[1.0004, 0, 0, 0], [0, 0.9999, 1e-4, 0], [0, 0, 1, 0]])).unwrap();
        assert!(deviation(rotation) < 1e-14);
        let (rotation, _) =
            parse(&"".into(), "", &json!([[1.0000001, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]])).unwrap();
        assert_eq!(rotation.x_axis.x, 1.000_000_1);
    }
}
