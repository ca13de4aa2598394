//! Nine cameras around the origin, which exports of other programs describe.

use super::save_image;
use glam::{DMat3, DVec3};
use std::path::Path;
use trimip_core::{Camera, Intrinsics, Lens};
use trimip_data::Scene;

/// A pinhole for photographs of 60 × 40 pixels.
pub fn pinhole() -> Intrinsics {
    Intrinsics { width: 60, height: 40, fx: 51.5, fy: 52.5, cx: 29.0, cy: 21.0, lens: Lens::default() }
}

/// Nine cameras around the origin, camera-to-world with OpenGL axes.
pub fn cameras(intrinsics: Intrinsics) -> Vec<Camera> {
    let place = |i: i32| {
        let turn = 0.7 * f64::from(i);
        DVec3::new(3.0 * turn.cos(), 3.0 * turn.sin(), 0.3 * f64::from(i % 3))
    };
    let look = |i: i32| Camera::look_at(intrinsics, place(i), DVec3::new(0.1, 0.2, 0.1), DVec3::Z);
    (0..9).map(look).collect()
}

/// The photograph of a camera.
pub fn name(index: usize) -> String {
    format!("images/{index}.png")
}

pub fn save_images(root: &Path, size: [u32; 2]) {
    (0..9).for_each(|index| save_image(&root.join(name(index)), size[0], size[1]));
}

/// The training views have the poses and intrinsics of `expected`, in order of their names; every 8th is a test view.
pub fn assert_cameras(scene: &Scene, expected: &[Camera]) {
    let kept = expected.iter().enumerate().filter(|(index, _)| index % 8 != 0).map(|(_, camera)| camera);
    assert_eq!((scene.train.views.len(), scene.test.len()), (7, 2));
    for (view, expected) in scene.train.views.iter().zip(kept) {
        let found = view.camera;
        assert!((found.origin - expected.origin).length() < 1e-9, "{found:?}, not {expected:?}");
        let apart = found.rotation - expected.rotation;
        assert!(apart.to_cols_array().iter().all(|entry| entry.abs() < 1e-9), "{found:?}, not {expected:?}");
        let (k, other) = (found.intrinsics, expected.intrinsics);
        assert_eq!((k.width, k.height, k.lens), (other.width, other.height, other.lens));
        for (a, b) in [(k.fx, other.fx), (k.fy, other.fy), (k.cx, other.cx), (k.cy, other.cy)] {
            assert!((a - b).abs() < 1e-9, "{k:?}, not {other:?}");
        }
    }
}

/// World-to-camera rotation and translation in the axes of computer vision.
pub fn vision(camera: &Camera) -> (DMat3, DVec3) {
    let to_world = camera.rotation * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    (to_world.transpose(), -(to_world.transpose() * camera.origin))
}
