//! Writes cameras as the text files of a COLMAP model without points.

use super::lenses::ModelCamera;
use glam::{DMat3, DQuat};
use std::fmt::Write;
use trimip_core::{Camera, Error, Intrinsics, Result};

/// The text files of a COLMAP model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Texts {
    /// Content of `cameras.txt`: one camera for each distinct projection.
    pub cameras: String,
    /// Content of `images.txt`: one image for each camera, without features.
    pub images: String,
}

impl Texts {
    /// Returns the files for `cameras`, one image each, in their order. A camera is written with the model of COLMAP that has the
    /// fewest parameters and describes it exactly. All numbers are written with the digits that identify their f64.
    ///
    /// # Errors
    /// When COLMAP has no model for a camera, as for an orthographic one; or a name contains a line break.
    pub fn of(cameras: &[(String, Camera)]) -> Result<Self> {
        let mut texts = Self {
            cameras: "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n".into(),
            images: "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# (no features)\n".into(),
        };
        let mut known: Vec<Intrinsics> = Vec::new();
        for (index, (name, camera)) in cameras.iter().enumerate() {
            if name.contains(['\n', '\r']) {
                return Err(Error::input(
                    format!("{name:?}"),
                    "the name contains a line break",
                    "rename the photograph",
                ));
            }
            let id = known.iter().position(|other| *other == camera.intrinsics).unwrap_or_else(|| {
                known.push(camera.intrinsics);
                known.len() - 1
            });
            let [w, x, y, z, tx, ty, tz] = pose(camera);
            // A String accepts everything.
            let _ = writeln!(
                texts.images,
                "{} {w:?} {x:?} {y:?} {z:?} {tx:?} {ty:?} {tz:?} {} {name}\n",
                index + 1,
                id + 1
            );
        }
        for (index, intrinsics) in known.iter().enumerate() {
            let camera = ModelCamera::of(index as u32 + 1, intrinsics).ok_or_else(|| {
                Error::input(
                    format!("a camera of the model {}", intrinsics.lens.model.definition().name),
                    "COLMAP has no such camera model",
                    "choose another format",
                )
            })?;
            let numbers: Vec<String> =
                camera.parameters().iter().map(|number| format!("{number:?}")).collect();
            let _ = writeln!(
                texts.cameras,
                "{} {} {} {} {}",
                camera.id,
                camera.model(),
                intrinsics.width,
                intrinsics.height,
                numbers.join(" ")
            );
        }
        Ok(texts)
    }
}

/// Returns the rotation from world to camera as a quaternion w, x, y, z, then the translation, in COLMAP's axes: x right, y down,
/// z ahead.
fn pose(camera: &Camera) -> [f64; 7] {
    let r = camera.rotation;
    let to_camera = DMat3::from_cols(r.x_axis, -r.y_axis, -r.z_axis).transpose();
    let [x, y, z, w] = DQuat::from_mat3(&to_camera).normalize().to_array();
    // The translation belongs to the rotation that the quaternion describes after rounding.
    let rounded = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
    let t = -(rounded * camera.origin);
    [w, x, y, z, t.x, t.y, t.z]
}

#[cfg(test)]
mod tests {
    use super::super::model::File;
    use super::super::text;
    use super::*;
    use crate::colmap::Model as ColmapModel;
    use glam::DVec3;
    use trimip_core::Lens;
    use trimip_core::geometry::projections::Model;

    fn read(texts: &Texts) -> Vec<Camera> {
        let [cameras, images] = [("cameras.txt", &texts.cameras), ("images.txt", &texts.images)]
            .map(|(name, text)| File { name, bytes: text.as_bytes() });
        let model = ColmapModel {
            cameras: text::cameras(cameras).unwrap(),
            images: text::images(images).unwrap(),
            points: Vec::new(),
        };
        model.cameras_of_images("images.txt").unwrap()
    }

    #[test]
    fn cameras_come_back() {
        let k = Intrinsics {
            width: 50,
            height: 40,
            fx: 60.1,
            fy: 61.0,
            cx: 24.3,
            cy: 21.0,
            ..Default::default()
        };
        let square = Intrinsics { fy: 60.1, ..k };
        let perspective =
            |radial, tangential, denominator| Lens::perspective(radial, tangential, denominator);
        let fisheye = |radial, tangential, prism| Lens::fisheye(radial, tangential, prism);
        let lenses = [
            (square, perspective([0.0; 4], [0.0; 2], [0.0; 3]), "SIMPLE_PINHOLE"),
            (k, perspective([0.0; 4], [0.0; 2], [0.0; 3]), "PINHOLE"),
            (square, perspective([0.1, 0.0, 0.0, 0.0], [0.0; 2], [0.0; 3]), "SIMPLE_RADIAL"),
            (square, perspective([0.1, -0.02, 0.0, 0.0], [0.0; 2], [0.0; 3]), "RADIAL"),
            (k, perspective([0.1, -0.02, 0.0, 0.0], [0.001, 0.003], [0.0; 3]), "OPENCV"),
            (k, perspective([0.1, -0.02, 0.01, 0.0], [0.001, 0.003], [0.01, 0.0, 0.0]), "FULL_OPENCV"),
            (k, fisheye([0.1, -0.02, 0.01, 0.003], [0.0; 2], [0.0; 2]), "OPENCV_FISHEYE"),
            (k, fisheye([0.1, -0.02, 0.01, 0.0], [0.001, 0.0], [0.0, 0.002]), "THIN_PRISM_FISHEYE"),
        ];
        for (k, lens, model) in lenses {
            let intrinsics = Intrinsics { lens, ..k };
            let camera = |x: f64| {
                let eye = DVec3::new(x, 1.25, 2.5);
                ("a b.jpg".to_string(), Camera::look_at(intrinsics, eye, DVec3::new(0.1, 0.5, 0.0), DVec3::Z))
            };
            let cameras = [camera(3.0), camera(-700.0)];
            let texts = Texts::of(&cameras).unwrap();
            assert!(texts.cameras.contains(&format!("\n1 {model} 50 40 ")), "{}", texts.cameras);
            assert_eq!(texts.cameras.lines().count(), 2, "both have one projection");
            for (found, (_, camera)) in read(&texts).iter().zip(&cameras) {
                assert_eq!(found.intrinsics, camera.intrinsics);
                assert!((found.origin - camera.origin).length() < 1e-9 * camera.origin.length());
                let turned = (found.rotation - camera.rotation).to_cols_array();
                assert!(turned.iter().all(|part| part.abs() < 1e-12), "{turned:?}");
            }
        }
    }

    #[test]
    fn cameras_that_colmap_does_not_have_are_refused() {
        let lens = Lens::of(
            Model::ALL.iter().copied().find(|model| model.definition().name == "orthographic").unwrap(),
        );
        let camera = Camera::look_at(
            Intrinsics { width: 4, height: 4, fx: 4.0, fy: 4.0, cx: 2.0, cy: 2.0, lens },
            DVec3::X,
            DVec3::ZERO,
            DVec3::Z,
        );
        let error = Texts::of(&[("a".into(), camera)]).unwrap_err();
        assert!(error.message().contains("COLMAP has no such camera model"), "{error}");
        assert!(
            Texts::of(&[("a\nb".into(), Camera { intrinsics: Intrinsics::from_angle(4, 4, 1.0), ..camera })])
                .is_err()
        );
    }
}
