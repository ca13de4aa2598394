//! Nine cameras around the origin, and their exports in the formats of other programs.

use super::{save_image, write};
use glam::{DMat3, DQuat, DVec3};
use serde_json::{Value, json};
use std::{fs, path::Path};
use trimip_core::{Camera, Intrinsics, Lens};
use trimip_data::Scene;

/// Returns a pinhole for photographs of 60 × 40 pixels.
pub fn pinhole() -> Intrinsics {
    Intrinsics { width: 60, height: 40, fx: 51.5, fy: 52.5, cx: 29.0, cy: 21.0, lens: Lens::default() }
}

/// Returns nine cameras around the origin, camera-to-world with OpenGL axes.
pub fn cameras(intrinsics: Intrinsics) -> Vec<Camera> {
    let place = |i: i32| {
        let turn = 0.7 * f64::from(i);
        DVec3::new(3.0 * turn.cos(), 3.0 * turn.sin(), 0.3 * f64::from(i % 3))
    };
    let look = |i: i32| Camera::look_at(intrinsics, place(i), DVec3::new(0.1, 0.2, 0.1), DVec3::Z);
    (0..9).map(look).collect()
}

/// Returns the path of the photograph of a camera.
pub fn name(index: usize) -> String {
    format!("images/{index}.png")
}

pub fn save_images(root: &Path, size: [u32; 2]) {
    (0..9).for_each(|index| save_image(&root.join(name(index)), size[0], size[1]));
}

/// Asserts that the training views have the poses and intrinsics of `expected`, in order of their names. Every 8th camera is a test view.
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

/// Returns the world-to-camera rotation and translation in the axes of computer vision.
pub fn vision(camera: &Camera) -> (DMat3, DVec3) {
    let to_world = camera.rotation * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    (to_world.transpose(), -(to_world.transpose() * camera.origin))
}

/// Writes a scene of ARKitScenes: photographs 0.1 s apart, and poses 2 ms before each photograph. Returns the trajectory.
pub fn arkitscenes(root: &Path, all: &[Camera]) -> String {
    let mut trajectory = String::new();
    for (index, camera) in all.iter().enumerate() {
        let (rotation, t) = vision(camera);
        let (axis, angle) = DQuat::from_mat3(&rotation).to_axis_angle();
        let r = axis * angle;
        let time = 305.3 + 0.1 * index as f64;
        trajectory += &format!("{} {} {} {} {} {} {}\n", time - 0.002, r.x, r.y, r.z, t.x, t.y, t.z);
        save_image(&root.join(format!("lowres_wide/41069021_{time:.3}.png")), 60, 40);
        let intrinsics = root.join("lowres_wide_intrinsics");
        fs::create_dir_all(&intrinsics).unwrap();
        // The names of some files have a time that was rounded differently.
        let rounded = time + [0.0, 0.001, -0.001][index % 3];
        fs::write(intrinsics.join(format!("41069021_{rounded:.3}.pincam")), "60 40 51.5 52.5 29 21\n")
            .unwrap();
    }
    fs::write(root.join("lowres_wide.traj"), &trajectory).unwrap();
    trajectory
}

/// Writes a raw export of Polycam; `kind` is "corrected_" for poses and photographs that Polycam corrected.
pub fn polycam(root: &Path, all: &[Camera], kind: &str) {
    let root = root.join("keyframes");
    fs::create_dir_all(root.join(format!("{kind}cameras"))).unwrap();
    for (index, camera) in all.iter().enumerate() {
        let [x, y, z] = camera.rotation.transpose().to_cols_array_2d();
        let o = camera.origin;
        // ARKit's axes x, y, z are y, z, x here.
        let rows = [[y, [o.y; 3]], [z, [o.z; 3]], [x, [o.x; 3]]];
        let mut document = json!({ "fx": 51.5, "fy": 52.5, "cx": 29.0, "cy": 21.0, "width": 60, "height": 40, "blur_score": 90.0 });
        for (i, [axes, [at, ..]]) in rows.iter().enumerate() {
            (0..3).for_each(|j| document[format!("t_{i}{j}")] = json!(axes[j]));
            document[format!("t_{i}3")] = json!(at);
        }
        write(&root.join(format!("{kind}cameras/{index}.json")), &document);
        save_image(&root.join(format!("{kind}images/{index}.png")), 60, 40);
    }
}

/// Returns `transforms.json` with a frame for each camera. The size and the pinhole are those of `intrinsics`.
pub fn transforms(all: &[Camera], intrinsics: Intrinsics) -> Value {
    let frame = |(index, camera): (usize, &Camera)| {
        let [x, y, z] = camera.rotation.transpose().to_cols_array_2d();
        let row = |axes: [f64; 3], at: f64| [axes[0], axes[1], axes[2], at];
        let o = camera.origin;
        json!({
            "file_path": name(index),
            "transform_matrix": [row(x, o.x), row(y, o.y), row(z, o.z), [0.0, 0.0, 0.0, 1.0]],
        })
    };
    let Intrinsics { width, height, fx, fy, cx, cy, .. } = intrinsics;
    json!({
        "w": width, "h": height, "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy,
        "frames": all.iter().enumerate().map(frame).collect::<Vec<_>>(),
    })
}
